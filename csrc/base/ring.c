/* SPDX-License-Identifier: Apache-2.0 */
#include "ring.h"

#include <string.h>

bool ring_put(ring *r, void *places, uint32_t count, const void *value, size_t value_bytes)
{
    uint32_t head = atomic_load_explicit(&r->head, memory_order_relaxed);
    if (head - atomic_load_explicit(&r->tail, memory_order_acquire) == count) {
        return false;
    }
    memcpy((char *)places + head % count * value_bytes, value, value_bytes);
    atomic_store_explicit(&r->head, head + 1, memory_order_release);
    return true;
}

bool ring_take(ring *r, const void *places, uint32_t count, void *value, size_t value_bytes)
{
    uint32_t tail = atomic_load_explicit(&r->tail, memory_order_relaxed);
    if (atomic_load_explicit(&r->head, memory_order_acquire) == tail) {
        return false;
    }
    memcpy(value, (const char *)places + tail % count * value_bytes, value_bytes);
    atomic_store_explicit(&r->tail, tail + 1, memory_order_release);
    return true;
}
