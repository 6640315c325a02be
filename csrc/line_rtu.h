/* SPDX-License-Identifier: Apache-2.0
 * line_rtu.h: queues between asyncio and a line's thread: one writer, one reader, fixed places. */
#ifndef MOTORD_LINE_RTU_H
#define MOTORD_LINE_RTU_H

#include <stdatomic.h>

#include "line_machine.h"
#include "mailbox.h"

enum { RING_PLACES = 4 * LINE_ASKS_MAX };

/* Places are taken by position modulo RING_PLACES; head - tail of them are full. */
typedef struct {
    _Alignas(CACHE_LINE_BYTES) _Atomic uint32_t head;   /* the writer's */
    _Alignas(CACHE_LINE_BYTES) _Atomic uint32_t tail;   /* the reader's */
} ring;

bool ring_put(ring *r, void *places, const void *value, size_t value_bytes);
bool ring_take(ring *r, const void *places, void *value, size_t value_bytes);

#endif
