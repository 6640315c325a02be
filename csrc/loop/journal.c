/* SPDX-License-Identifier: Apache-2.0
 * journal.c: input and output of the core, tick by tick, for the recorder. */
#include <errno.h>
#include <stdatomic.h>
#include <string.h>
#include <unistd.h>

#include "rt.h"
#include "seqlock.h"

enum {
    RECORD_WORDS = sizeof(journal_record) / WORD_BYTES,
    STATE_WORDS = sizeof(core_state) / WORD_BYTES
};
static const char MAGIC[WORD_BYTES] = {'M', 'O', 'T', 'O', 'R', 'D', 'J', 1};
static const uint64_t FNV_OFFSET = 0xcbf29ce484222325u, FNV_PRIME = 0x100000001b3u;

typedef struct {
    _Atomic uint64_t magic;
    _Atomic uint32_t layout_version;
    _Atomic uint32_t record_count;
    _Atomic uint32_t record_stride_bytes;
    _Atomic uint32_t record_offset_bytes;
    _Atomic uint32_t record_bytes;
    _Atomic uint32_t checkpoint_count;
    _Atomic uint32_t checkpoint_stride_bytes;
    _Atomic uint32_t checkpoint_offset_bytes;
    _Atomic uint32_t checkpoint_bytes;
    _Atomic uint32_t writer_pid;
    _Atomic uint64_t records;     /* number of records so far; the newest is in slot (records - 1) %
                                     JOURNAL_RECORDS */
    _Atomic uint64_t checkpoints; /* number of checkpoints so far */
} journal_header;

typedef struct {
    _Alignas(64) _Atomic uint64_t sequence;
    _Atomic uint64_t word[RECORD_WORDS];
} record_slot;

typedef struct {
    _Alignas(64) _Atomic uint64_t sequence;
    _Atomic uint64_t word[STATE_WORDS];
} checkpoint_slot;

typedef struct {
    journal_header header;
    record_slot record[JOURNAL_RECORDS];
    checkpoint_slot checkpoint[JOURNAL_CHECKPOINTS];
} journal;

_Static_assert(sizeof(journal_record) % WORD_BYTES == 0 && sizeof(core_state) % WORD_BYTES == 0,
               "whole words");
_Static_assert(sizeof(robot_state) % WORD_BYTES == 0, "whole words");
_Static_assert(sizeof(journal_header) == 64 && offsetof(journal_header, records) == 48,
               "documented in docs/replay.md");

size_t journal_bytes(void)
{
    return sizeof(journal);
}

int journal_init(void *memory)
{
    if (memory == NULL || (uintptr_t)memory % 64 != 0) {
        return -EINVAL;
    }
    uint64_t magic;
    journal *j = memory;
    journal_header *header = &j->header;
    atomic_store_explicit(&header->magic, 0, memory_order_relaxed);
    atomic_store_explicit(&header->records, 0, memory_order_release);
    atomic_store_explicit(&header->checkpoints, 0, memory_order_release);
    for (uint32_t i = 0; i < JOURNAL_RECORDS; i++) {
        atomic_store_explicit(&j->record[i].sequence, 0, memory_order_release);
    }
    for (uint32_t i = 0; i < JOURNAL_CHECKPOINTS; i++) {
        atomic_store_explicit(&j->checkpoint[i].sequence, 0, memory_order_release);
    }
    atomic_store_explicit(&header->layout_version, JOURNAL_LAYOUT_VERSION, memory_order_relaxed);
    atomic_store_explicit(&header->record_count, JOURNAL_RECORDS, memory_order_relaxed);
    atomic_store_explicit(&header->record_stride_bytes, sizeof(record_slot), memory_order_relaxed);
    atomic_store_explicit(&header->record_offset_bytes, offsetof(journal, record),
                          memory_order_relaxed);
    atomic_store_explicit(&header->record_bytes, sizeof(journal_record), memory_order_relaxed);
    atomic_store_explicit(&header->checkpoint_count, JOURNAL_CHECKPOINTS, memory_order_relaxed);
    atomic_store_explicit(&header->checkpoint_stride_bytes, sizeof(checkpoint_slot),
                          memory_order_relaxed);
    atomic_store_explicit(&header->checkpoint_offset_bytes, offsetof(journal, checkpoint),
                          memory_order_relaxed);
    atomic_store_explicit(&header->checkpoint_bytes, sizeof(core_state), memory_order_relaxed);
    atomic_store_explicit(&header->writer_pid, (uint32_t)getpid(), memory_order_relaxed);
    memcpy(&magic, MAGIC, sizeof magic);
    atomic_store_explicit(&header->magic, magic, memory_order_release);
    return 0;
}

void journal_before(void *memory, const core_state *state)
{
    journal *j = memory;
    if (atomic_load_explicit(&j->header.records, memory_order_relaxed) % JOURNAL_CHECKPOINT_EVERY !=
        0) {
        return;
    }
    uint64_t number = atomic_load_explicit(&j->header.checkpoints, memory_order_relaxed) + 1;
    checkpoint_slot *slot = &j->checkpoint[(number - 1) % JOURNAL_CHECKPOINTS];
    seqlock_write(&slot->sequence, slot->word, number, state, STATE_WORDS);
    atomic_store_explicit(&j->header.checkpoints, number, memory_order_release);
}

void journal_after(void *memory, const core_input *input, double dt_s, const setpoints *out,
                   const robot_state *snapshot)
{
    journal *j = memory;
    journal_record record = {.tick = out->tick,
                             .dt_s = dt_s,
                             .digest = journal_digest(snapshot),
                             .input = *input,
                             .out = *out};
    uint64_t number = atomic_load_explicit(&j->header.records, memory_order_relaxed) + 1;
    record_slot *slot = &j->record[(number - 1) % JOURNAL_RECORDS];
    seqlock_write(&slot->sequence, slot->word, number, &record, RECORD_WORDS);
    atomic_store_explicit(&j->header.records, number, memory_order_release);
}

uint64_t journal_digest(const robot_state *snapshot)
{
    uint64_t digest = FNV_OFFSET;
    for (size_t w = 0; w < sizeof *snapshot / WORD_BYTES; w++) {
        uint64_t word;
        memcpy(&word, (const char *)snapshot + w * WORD_BYTES, WORD_BYTES);
        digest = (digest ^ word) * FNV_PRIME;
    }
    return digest;
}
