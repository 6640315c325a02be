/* SPDX-License-Identifier: Apache-2.0 */
#include "mailbox.h"

#include <string.h>

static const uint32_t FRESH = 4; /* set by the writer, cleared by the reader */
static const uint32_t SLOT = 3;

void mailbox_init(mailbox *m)
{
    m->back = 0;
    m->front = 2;
    atomic_store_explicit(&m->middle, 1, memory_order_release);
}

void mailbox_put(mailbox *m, void *slots, const void *value, size_t value_bytes)
{
    memcpy((char *)slots + m->back * value_bytes, value, value_bytes);
    m->back = atomic_exchange_explicit(&m->middle, m->back | FRESH, memory_order_acq_rel) & SLOT;
}

int mailbox_take(mailbox *m, const void *slots, void *value, size_t value_bytes)
{
    int fresh = (atomic_load_explicit(&m->middle, memory_order_relaxed) & FRESH) != 0;
    if (fresh) {
        m->front = atomic_exchange_explicit(&m->middle, m->front, memory_order_acq_rel) & SLOT;
    }
    memcpy(value, (const char *)slots + m->front * value_bytes, value_bytes);
    return fresh;
}
