/* SPDX-License-Identifier: Apache-2.0
 *
 * api_journal.h: the part of the border that recording and replay need. Read after api.h, and like
 * it: typedefs, enums, comments and prototypes, no preprocessor line.
 */

/* ------------------------------------------------------------------------------------- journal
 * Shared memory into which the loop writes what went into the core in each tick and what came out,
 * and now and then the core's whole state, so that a replay may begin there. One writer, any number
 * of readers; a reader that is slower than the ring loses records, and no other reader anything.
 * docs/replay.md */
enum {
    JOURNAL_LAYOUT_VERSION = 12,
    JOURNAL_RECORDS = 4096,
    JOURNAL_CHECKPOINTS = 4,
    JOURNAL_CHECKPOINT_EVERY = 1024 /* records */
};

typedef struct {
    uint64_t tick; /* the core's, after the step */
    double dt_s;
    uint64_t digest; /* of the snapshot that came out */
    uint64_t reserved;
    core_input input;
    setpoints out;
} journal_record;

size_t journal_bytes(void);
int journal_init(void *journal); /* journal_bytes(), aligned to 64 */
/* Before a step: the state, where a checkpoint is due. */
void journal_before(void *journal, const core_state *state);
/* After it. */
void journal_after(void *journal, const core_input *input, double dt_s, const setpoints *out,
                   const robot_state *snapshot);
/* The steps of FNV-1a (G. Fowler, L. C. Noll, K.-P. Vo), over the snapshot's words of 64 bits in
 * place of bytes. */
uint64_t journal_digest(const robot_state *snapshot);
