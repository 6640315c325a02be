/* SPDX-License-Identifier: Apache-2.0
 * page.c: the state page: one writer, any number of readers in any process, which hold no lock and
 * cannot disturb the writer. The layout is public: docs/state-page.md.
 *
 * Each slot is a sequence lock (seqlock.h). The writer uses the slots in turn, so a reader is
 * overtaken only if it sleeps for SLOTS - 1 ticks. */
#include <errno.h>
#include <stdatomic.h>
#include <string.h>
#include <unistd.h>

#include "rt.h"
#include "seqlock.h"

enum { SLOTS = 4, WORDS = sizeof(robot_state) / WORD_BYTES, TRIES = 8 };
static const char MAGIC[WORD_BYTES] = {'M', 'O', 'T', 'O', 'R', 'D', 0, 1};

typedef struct {
    _Atomic uint64_t magic;
    _Atomic uint32_t layout_version;
    _Atomic uint32_t payload_bytes;
    _Atomic uint32_t slot_count;
    _Atomic uint32_t slot_stride_bytes;
    _Atomic uint32_t slot_offset_bytes;
    _Atomic uint32_t writer_pid;
    /* number of snapshots so far; the newest is in slot (published - 1) % SLOTS */
    _Atomic uint64_t published;
    _Atomic uint64_t reserved[3];
} page_header;

typedef struct {
    /* 2 n: snapshot n (from 1) is whole; odd: it is being written */
    _Alignas(64) _Atomic uint64_t sequence;
    _Atomic uint64_t word[WORDS];
} page_slot;

typedef struct {
    page_header header;
    page_slot slot[SLOTS];
} page;

_Static_assert(sizeof(robot_state) % WORD_BYTES == 0, "the payload is whole words");
_Static_assert(sizeof(page_header) == 64, "documented in docs/state-page.md");
_Static_assert(offsetof(page_header, layout_version) == 8, "documented");
_Static_assert(offsetof(page_header, payload_bytes) == 12, "documented");
_Static_assert(offsetof(page_header, slot_count) == 16, "documented");
_Static_assert(offsetof(page_header, slot_stride_bytes) == 20, "documented");
_Static_assert(offsetof(page_header, slot_offset_bytes) == 24, "documented");
_Static_assert(offsetof(page_header, writer_pid) == 28, "documented");
_Static_assert(offsetof(page_header, published) == 32, "documented");
_Static_assert(offsetof(page, slot) == 64 && offsetof(page_slot, word) == WORD_BYTES, "documented");
_Static_assert(sizeof(page) <= PAGE_BYTES, "the page holds all slots");
_Static_assert(sizeof(_Atomic uint64_t) == WORD_BYTES && ATOMIC_LLONG_LOCK_FREE == 2,
               "a lock hidden in an atomic word would not work between processes");

static uint64_t magic_word(void)
{
    uint64_t word;
    memcpy(&word, MAGIC, sizeof word);
    return word;
}

int page_init(void *memory)
{
    if (memory == NULL || (uintptr_t)memory % 64 != 0) {
        return -EINVAL;
    }
    page *p = memory;
    page_header *header = &p->header;
    atomic_store_explicit(&header->magic, 0, memory_order_relaxed);
    atomic_store_explicit(&header->published, 0, memory_order_release);
    for (uint32_t i = 0; i < SLOTS; i++) {
        atomic_store_explicit(&p->slot[i].sequence, 0, memory_order_release);
        for (uint32_t w = 0; w < WORDS; w++) {
            atomic_store_explicit(&p->slot[i].word[w], 0, memory_order_release);
        }
    }
    atomic_store_explicit(&header->layout_version, PAGE_LAYOUT_VERSION, memory_order_relaxed);
    atomic_store_explicit(&header->payload_bytes, sizeof(robot_state), memory_order_relaxed);
    atomic_store_explicit(&header->slot_count, SLOTS, memory_order_relaxed);
    atomic_store_explicit(&header->slot_stride_bytes, sizeof(page_slot), memory_order_relaxed);
    atomic_store_explicit(&header->slot_offset_bytes, offsetof(page, slot), memory_order_relaxed);
    atomic_store_explicit(&header->writer_pid, (uint32_t)getpid(), memory_order_relaxed);
    atomic_store_explicit(&header->magic, magic_word(), memory_order_release);
    return 0;
}

void page_write(void *memory, const robot_state *state)
{
    page *p = memory;
    uint64_t number = atomic_load_explicit(&p->header.published, memory_order_relaxed) + 1;
    page_slot *slot = &p->slot[(number - 1) % SLOTS];
    seqlock_write(&slot->sequence, slot->word, number, state, WORDS);
    atomic_store_explicit(&p->header.published, number, memory_order_release);
}

static bool is_our_layout(const page_header *header)
{
    return atomic_load_explicit(&header->magic, memory_order_acquire) == magic_word() &&
           atomic_load_explicit(&header->layout_version, memory_order_relaxed) ==
               PAGE_LAYOUT_VERSION &&
           atomic_load_explicit(&header->payload_bytes, memory_order_relaxed) ==
               sizeof(robot_state) &&
           atomic_load_explicit(&header->slot_count, memory_order_relaxed) == SLOTS &&
           atomic_load_explicit(&header->slot_stride_bytes, memory_order_relaxed) ==
               sizeof(page_slot) &&
           atomic_load_explicit(&header->slot_offset_bytes, memory_order_relaxed) ==
               offsetof(page, slot);
}

int page_read(const void *memory, robot_state *out)
{
    const page *p = memory;
    if (!is_our_layout(&p->header)) {
        return -EPROTO;
    }
    for (int try = 0; try < TRIES; try++) {
        uint64_t number = atomic_load_explicit(&p->header.published, memory_order_acquire);
        if (number == 0) {
            return -ENODATA;
        }
        const page_slot *slot = &p->slot[(number - 1) % SLOTS];
        if (seqlock_read(&slot->sequence, slot->word, number, out, WORDS)) {
            return 0;
        }
    }
    return -EAGAIN;
}
