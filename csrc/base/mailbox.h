/* SPDX-License-Identifier: Apache-2.0
 * mailbox.h: newest value wins, between one writer and one reader: a triple buffer.
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

/* Which side holds which slot. The slots themselves lie beside it, MAILBOX_SLOTS of the same
 * size. */
typedef struct {
    /* slot between the two, and whether it is new */
    _Alignas(CACHE_LINE_BYTES) _Atomic uint32_t middle;
    _Alignas(CACHE_LINE_BYTES) uint32_t back;  /* the writer's slot */
    _Alignas(CACHE_LINE_BYTES) uint32_t front; /* the reader's slot */
} mailbox;

/* Before either side uses it. The caller zeroes the slots. */
void mailbox_init(mailbox *m);
/* The writer's side: wait-free. */
void mailbox_put(mailbox *m, void *slots, const void *value, size_t value_bytes);
/* The reader's side: copies the newest value; 1 when it was not taken before, else 0. */
int mailbox_take(mailbox *m, const void *slots, void *value, size_t value_bytes);

#endif
