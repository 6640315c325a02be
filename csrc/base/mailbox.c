/* SPDX-License-Identifier: Apache-2.0 */
#include "mailbox.h"

#include <string.h>

static const uint32_t FRESH = 4; /* set by the writer, cleared by the reader */
static const uint32_t SLOT = 3;

void mailbox_init(mailbox *box)
{
    box->back = 0;
    box->front = 2;
    atomic_store_explicit(&box->middle, 1, memory_order_release);
}

void mailbox_put(mailbox *box, void *slots, const void *value, size_t value_bytes)
{
    memcpy((char *)slots + box->back * value_bytes, value, value_bytes);
    box->back = atomic_exchange_explicit(&box->middle, box->back | FRESH, memory_order_acq_rel) & SLOT;
}

int mailbox_take(mailbox *box, const void *slots, void *value, size_t value_bytes)
{
    int fresh = (atomic_load_explicit(&box->middle, memory_order_relaxed) & FRESH) != 0;
    if (fresh) {
        box->front = atomic_exchange_explicit(&box->middle, box->front, memory_order_acq_rel) & SLOT;
    }
    memcpy(value, (const char *)slots + box->front * value_bytes, value_bytes);
    return fresh;
}
