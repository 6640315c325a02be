/* SPDX-License-Identifier: Apache-2.0
 * check.h: the minimum for a C test. A failed check prints its place and ends the program. */
#ifndef MOTORD_TESTS_CHECK_H
#define MOTORD_TESTS_CHECK_H

#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>

static _Atomic unsigned long checks_done;

#define CHECK(condition)                                                                           \
    do {                                                                                           \
        atomic_fetch_add_explicit(&checks_done, 1, memory_order_relaxed);                          \
        if (!(condition)) {                                                                        \
            fprintf(stderr, "%s:%d: not true: %s\n", __FILE__, __LINE__, #condition);              \
            exit(1);                                                                               \
        }                                                                                          \
    } while (0)

static inline int checks_report(const char *name)
{
    printf("%s: %lu checks\n", name, (unsigned long)checks_done);
    return 0;
}

#endif
