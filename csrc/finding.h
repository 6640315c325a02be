/* SPDX-License-Identifier: Apache-2.0
 * finding.h: the first bad field of a table, with the path to it. */
#ifndef MOTORD_FINDING_H
#define MOTORD_FINDING_H

#include <stdio.h>

#include "rt.h"

typedef struct {
    char *name;
    char path[FIELD_NAME_BYTES];
    bool bad;
} finding;

static inline void need(finding *f, bool good, const char *field)
{
    if (!good && !f->bad) {
        f->bad = true;
        (void)snprintf(f->name, FIELD_NAME_BYTES, "%.40s%.23s", f->path, field);
    }
}

#endif
