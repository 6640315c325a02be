/* SPDX-License-Identifier: Apache-2.0
 *
 * api_journal.h: the part of the border that recording and replay need. Read after api.h, and like
 * it: typedefs, enums, comments and prototypes, no preprocessor line.
 */

/* ------------------------------------------------------------------------------------- journal
 * Shared memory into which the loop writes the input and output of the core in each tick, and at
 * intervals the core's whole state, so that a replay may begin there. One writer, any number of
 * readers; a reader that is slower than the ring loses records, without effect on other readers.
 * docs/replay.md */
enum {
    JOURNAL_LAYOUT_VERSION = 12,
    JOURNAL_RECORDS = 4096,
    JOURNAL_CHECKPOINTS = 4,
    JOURNAL_CHECKPOINT_EVERY = 1024 /* records */
};

typedef struct {
    uint64_t tick; /* the core's tick number, after the step */
    double dt_s;
    uint64_t digest; /* digest of the resulting snapshot */
    uint64_t reserved;
    core_input input;
    setpoints out;
} journal_record;

size_t journal_bytes(void);
int journal_init(void *journal); /* journal_bytes(), aligned to 64 */
/* Write the state before a step, if a checkpoint is due. */
void journal_before(void *journal, const core_state *state);
/* Write the record after a step. */
void journal_after(void *journal, const core_input *input, double dt_s, const setpoints *out,
                   const robot_state *snapshot);
/* Return the FNV-1a hash (G. Fowler, L. C. Noll, K.-P. Vo) over the snapshot's words of 64 bits
 * instead of bytes. */
uint64_t journal_digest(const robot_state *snapshot);
