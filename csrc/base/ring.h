/* SPDX-License-Identifier: Apache-2.0
 * ring.h: queues between asyncio and a line's thread, with one writer, one reader and fixed
 * places. */
#ifndef MOTORD_RING_H
#define MOTORD_RING_H

#include <stdatomic.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "mailbox.h"

/* Places are numbered modulo their count, a power of two. head - tail of them are full. */
typedef struct {
    _Alignas(CACHE_LINE_BYTES) _Atomic uint32_t head; /* the writer's */
    _Alignas(CACHE_LINE_BYTES) _Atomic uint32_t tail; /* the reader's */
} ring;

/* false: full */
bool ring_put(ring *r, void *places, uint32_t count, const void *value, size_t value_bytes);
/* false: empty */
bool ring_take(ring *r, const void *places, uint32_t count, void *value, size_t value_bytes);

#endif
