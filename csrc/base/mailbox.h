/* SPDX-License-Identifier: Apache-2.0
 * mailbox.h: a triple buffer between one writer and one reader, which keeps the newest value.
 *
 * The writer owns one slot, the reader another; the third lies between them and changes hands by
 * one atomic exchange. So neither ever waits, and neither can see half a value. A sequence lock
 * over plain memory would be smaller, but it is a data race by the language's rules, and
 * ThreadSanitizer reports it. */
#ifndef MOTORD_MAILBOX_H
#define MOTORD_MAILBOX_H

#include <stdatomic.h>
#include <stddef.h>
#include <stdint.h>

enum { MAILBOX_SLOTS = 3, CACHE_LINE_BYTES = 64 };

/* The slots of the two sides. The caller keeps the slots themselves, MAILBOX_SLOTS of the same
 * size. */
typedef struct {
    /* slot between the two, and whether it is new */
    _Alignas(CACHE_LINE_BYTES) _Atomic uint32_t middle;
    _Alignas(CACHE_LINE_BYTES) uint32_t back;  /* the writer's slot */
    _Alignas(CACHE_LINE_BYTES) uint32_t front; /* the reader's slot */
} mailbox;

/* Set a mailbox up before either side uses it. The caller zeroes the slots. */
void mailbox_init(mailbox *m);
/* Put a value, from the writer's side. Wait-free. */
void mailbox_put(mailbox *m, void *slots, const void *value, size_t value_bytes);
/* Copy the newest value, on the reader's side. Returns 1 if it was not taken before, else 0. */
int mailbox_take(mailbox *m, const void *slots, void *value, size_t value_bytes);

#endif
