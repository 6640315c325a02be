/* SPDX-License-Identifier: Apache-2.0
 * seqlock.h: a sequence lock for one writer and any number of readers in any process, which hold no
 * lock and cannot disturb the writer.
 *
 * The data are atomic words. A release store and an acquire load of each word replace the fences of
 * H. Boehm, "Can seqlocks get along with programming language memory models?" (MSPC 2012):
 * ThreadSanitizer cannot see fences, and on x86-64 both are plain moves. */
#ifndef MOTORD_SEQLOCK_H
#define MOTORD_SEQLOCK_H

#include <stdatomic.h>
#include <string.h>

#include "rt.h"

enum { WORD_BYTES = 8 };

/* Write data. The sequence is 2 number while `number` (from 1) is whole, and odd during the
 * write. */
static inline void seqlock_write(_Atomic uint64_t *sequence, _Atomic uint64_t *word,
                                 uint64_t number, const void *data, size_t words)
{
    atomic_store_explicit(sequence, 2 * number - 1, memory_order_relaxed);
    for (size_t w = 0; w < words; w++) {
        uint64_t value;
        memcpy(&value, (const char *)data + w * WORD_BYTES, WORD_BYTES);
        atomic_store_explicit(&word[w], value, memory_order_release);
    }
    atomic_store_explicit(sequence, 2 * number, memory_order_release);
}

/* Read data. Returns false if the slot has another number, or was overwritten meanwhile. */
static inline bool seqlock_read(const _Atomic uint64_t *sequence, const _Atomic uint64_t *word,
                                uint64_t number, void *data, size_t words)
{
    if (atomic_load_explicit(sequence, memory_order_acquire) != 2 * number) {
        return false;
    }
    for (size_t w = 0; w < words; w++) {
        uint64_t value = atomic_load_explicit(&word[w], memory_order_acquire);
        memcpy((char *)data + w * WORD_BYTES, &value, WORD_BYTES);
    }
    return atomic_load_explicit(sequence, memory_order_acquire) == 2 * number;
}

#endif
