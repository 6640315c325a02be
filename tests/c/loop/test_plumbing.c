/* SPDX-License-Identifier: Apache-2.0
 * Every line of mailbox.c, exchange.c, page.c, journal.c and schedule.c, in one thread. */
#include <errno.h>
#include <signal.h>
#include <stddef.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <unistd.h>

#include "check.h"
#include "exchange.h"
#include "ring.h"
#include "schedule.h"

static void a_mailbox_gives_the_newest_value(void)
{
    mailbox m;
    uint32_t slot[MAILBOX_SLOTS] = {0}, value = 7;
    mailbox_init(&m);
    CHECK(mailbox_take(&m, slot, &value, sizeof value) == 0 && value == 0);
    for (uint32_t sent = 1; sent <= 100; sent++) {
        mailbox_put(&m, slot, &sent, sizeof sent);
        if (sent % 3 == 0) {
            CHECK(mailbox_take(&m, slot, &value, sizeof value) == 1 && value == sent);
            CHECK(mailbox_take(&m, slot, &value, sizeof value) == 0 && value == sent);
        }
    }
}

/* Whether the slots of the writer, of the reader and of the newest value all differ. */
static bool slots_are_apart(const mailbox *m)
{
    return (1U << m->back | 1U << m->front | 1U << (m->middle & 3)) == 7;
}

/* This holds between the steps of both sides, too: the reader's slot is not written, and the
 * writer's slot is not read. */
static void writer_reader_and_the_newest_value_never_share_a_slot(void)
{
    /* any old content */
    mailbox m = {.middle = UINT32_MAX, .back = UINT32_MAX, .front = UINT32_MAX};
    uint32_t slot[MAILBOX_SLOTS] = {0}, value = 0;
    mailbox_init(&m);
    CHECK(mailbox_take(&m, slot, &value, sizeof value) == 0);
    for (uint32_t turn = 0, pattern = 0xB5C3; turn < 64;
         turn++, pattern = pattern << 15 | pattern >> 1) {
        if ((pattern & 1) != 0) {
            mailbox_put(&m, slot, &turn, sizeof turn);
        } else {
            (void)mailbox_take(&m, slot, &value, sizeof value);
        }
        CHECK(slots_are_apart(&m));
    }
}

static void a_ring_gives_all_in_order_and_takes_no_more_than_it_holds(void)
{
    ring r = {.head = UINT32_MAX - 1, .tail = UINT32_MAX - 1}; /* so that its positions wrap
                                                                  round */
    uint64_t places[4], out = 0;
    CHECK(!ring_take(&r, places, 4, &out, sizeof out));
    for (uint64_t round = 0; round < 3; round++) {
        for (uint64_t n = 0; n < 4; n++) {
            uint64_t value = 10 * round + n;
            CHECK(ring_put(&r, places, 4, &value, sizeof value));
        }
        CHECK(!ring_put(&r, places, 4, &out, sizeof out));
        for (uint64_t n = 0; n < 4; n++) {
            CHECK(ring_take(&r, places, 4, &out, sizeof out) && out == 10 * round + n);
        }
        CHECK(!ring_take(&r, places, 4, &out, sizeof out));
    }
}

static void each_value_has_a_box_of_its_own(void)
{
    static exchange x;
    static lease_permissions permissions = {.lease = {{.number = 5}}};
    static command_report report = {.commander = 6};
    core_control control = {.armed = 1};
    joint_feedback feedback = {0};
    setpoints out = {0};
    CHECK(exchange_bytes() == sizeof x && exchange_bytes() % CACHE_LINE_BYTES == 0);
    exchange_init(&x);
    exchange_put_permissions(&x, &permissions);
    exchange_put_commands(&x, &report);
    exchange_put_control(&x, &control);
    for (uint32_t joint = 0; joint < JOINTS_MAX; joint++) {
        CHECK(exchange_put_feedback(&x, joint, &(joint_feedback){.count = 100 + joint}) == 0);
    }
    for (uint32_t line = 0; line < LINES_MAX; line++) {
        CHECK(exchange_put_setpoints(&x, line, &(setpoints){.tick = 200 + line}) == 0);
    }
    permissions.lease[0].number = 0;
    report.commander = 0;
    control.armed = 0;
    CHECK(exchange_take_permissions(&x, &permissions) == 1 && permissions.lease[0].number == 5);
    CHECK(exchange_take_commands(&x, &report) == 1 && report.commander == 6);
    CHECK(exchange_take_control(&x, &control) == 1 && control.armed == 1);
    for (uint32_t joint = 0; joint < JOINTS_MAX; joint++) {
        CHECK(exchange_take_feedback(&x, joint, &feedback) == 1 && feedback.count == 100 + joint);
    }
    for (uint32_t line = 0; line < LINES_MAX; line++) {
        CHECK(exchange_take_setpoints(&x, line, &out) == 1 && out.tick == 200 + line);
    }
    CHECK(exchange_put_feedback(&x, JOINTS_MAX, &feedback) == -EINVAL);
    CHECK(exchange_take_feedback(&x, JOINTS_MAX, &feedback) == -EINVAL);
    CHECK(exchange_put_setpoints(&x, LINES_MAX, &out) == -EINVAL);
    CHECK(exchange_take_setpoints(&x, LINES_MAX, &out) == -EINVAL);
    uint64_t takes = exchange_line_takes(&x, 1);
    CHECK(exchange_take_setpoints(&x, 1, &out) == 0 && exchange_line_takes(&x, 1) == takes + 1);
    CHECK(exchange_line_wake(&x, 0) == -1 && exchange_set_line_wake(&x, 0, 7) == 0 &&
          exchange_line_wake(&x, 0) == 7);
    CHECK(exchange_set_line_wake(&x, LINES_MAX, 7) == -EINVAL &&
          exchange_line_wake(&x, LINES_MAX) == -1);
}

/* Old content of the memory counts neither as a value nor as a wake-up or a count. */
static void an_exchange_begins_empty_in_memory_that_was_used_before(void)
{
    static exchange x;
    static lease_permissions permissions, no_permissions;
    static command_report report, no_report;
    static const core_control no_control;
    static const setpoints no_setpoints;
    static const imu_sample no_sample;
    core_control control;
    joint_feedback feedback;
    setpoints out;
    imu_sample sample;
    memset(&x, 0xAA, sizeof x);
    exchange_init(&x);
    CHECK(exchange_take_permissions(&x, &permissions) == 0 &&
          memcmp(&permissions, &no_permissions, sizeof permissions) == 0);
    CHECK(exchange_take_commands(&x, &report) == 0 &&
          memcmp(&report, &no_report, sizeof report) == 0);
    CHECK(exchange_take_control(&x, &control) == 0 &&
          memcmp(&control, &no_control, sizeof control) == 0);
    CHECK(exchange_take_imu(&x, &sample) == 0 && memcmp(&sample, &no_sample, sizeof sample) == 0);
    for (uint32_t joint = 0; joint < JOINTS_MAX; joint++) {
        CHECK(exchange_take_feedback(&x, joint, &feedback) == 0 && feedback.stamp_ns == 0 &&
              feedback.count == 0);
    }
    for (uint32_t line = 0; line < LINES_MAX; line++) {
        CHECK(exchange_line_takes(&x, line) == 0 && exchange_enabled_count(&x, line) == 0);
        CHECK(exchange_line_wake(&x, line) == -1);
        CHECK(exchange_take_setpoints(&x, line, &out) == 0 &&
              memcmp(&out, &no_setpoints, sizeof out) == 0);
    }
    CHECK(slots_are_apart(&x.permissions.mailbox) && slots_are_apart(&x.commands.mailbox) &&
          slots_are_apart(&x.control.mailbox));
    CHECK(slots_are_apart(&x.imu.mailbox));
    for (uint32_t joint = 0; joint < JOINTS_MAX; joint++) {
        CHECK(slots_are_apart(&x.feedback[joint].mailbox));
    }
    for (uint32_t line = 0; line < LINES_MAX; line++) {
        CHECK(slots_are_apart(&x.setpoints[line].mailbox));
    }
    sample.stamp_ns = 9;
    exchange_put_imu(&x, &sample);
    CHECK(exchange_take_imu(&x, &sample) == 1 && sample.stamp_ns == 9);
}

static void set_points_carry_how_often_they_became_enabled(void)
{
    static exchange x;
    exchange_init(&x);
    const uint32_t enabled[] = {0, 1, 1, 0, 0, 1, 1, 1, 0, 1};
    const uint64_t counts[] = {0, 1, 1, 1, 1, 2, 2, 2, 2, 3};
    for (uint32_t i = 0; i < 10; i++) {
        CHECK(exchange_put_setpoints(&x, LINES_MAX - 1, &(setpoints){.enabled = enabled[i]}) == 0);
        CHECK(exchange_enabled_count(&x, LINES_MAX - 1) == counts[i]);
    }
    CHECK(exchange_enabled_count(&x, 0) == 0 && exchange_enabled_count(&x, LINES_MAX) == 0);
    CHECK(exchange_enabled_count(&x, LINES_MAX + 1) == 0);
}

/* While set-points are copied, a signal handler looks at the exchange like the thread of a line.
 * The second half of the set-points is in a page that cannot be read before this look. */
static exchange looked_at;
static uint8_t *second_half;
static volatile uint64_t count_meanwhile;

static void look_meanwhile(int signal)
{
    (void)signal;
    count_meanwhile = exchange_enabled_count(&looked_at, 0);
    CHECK(mprotect(second_half, (size_t)sysconf(_SC_PAGESIZE), PROT_READ | PROT_WRITE) == 0);
}

static void no_count_is_ahead_of_its_set_points(void)
{
    size_t page_bytes = (size_t)sysconf(_SC_PAGESIZE);
    uint8_t *pages =
        mmap(NULL, 2 * page_bytes, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);
    CHECK(pages != MAP_FAILED);
    second_half = pages + page_bytes;
    setpoints *value = (setpoints *)(void *)(second_half - offsetof(setpoints, joint)), out;
    struct sigaction before, look = {.sa_handler = look_meanwhile};
    exchange_init(&looked_at);
    *value = (setpoints){.enabled = 1};
    count_meanwhile = 9;
    CHECK(sigaction(SIGSEGV, &look, &before) == 0 &&
          mprotect(second_half, page_bytes, PROT_NONE) == 0);
    CHECK(exchange_put_setpoints(&looked_at, 0, value) == 0);
    CHECK(sigaction(SIGSEGV, &before, NULL) == 0 && munmap(pages, 2 * page_bytes) == 0);
    CHECK(count_meanwhile == 0 && exchange_enabled_count(&looked_at, 0) == 1);
    CHECK(exchange_take_setpoints(&looked_at, 0, &out) == 1 && out.enabled == 1);
}

/* Offsets from docs/state-page.md, independent of page.c. */
enum {
    LAYOUT_VERSION_AT = 8,
    SLOT_STRIDE_AT = 20,
    WRITER_PID_AT = 28,
    PUBLISHED_AT = 32,
    SLOTS_AT = 64
};

static void set_word(uint8_t *page, size_t offset, uint64_t value)
{
    memcpy(page + offset, &value, sizeof value);
}

static void a_page_is_read_as_it_was_written(uint8_t *page)
{
    robot_state written, read;
    CHECK(page_init(NULL) == -EINVAL);
    CHECK(page_init(page + 8) == -EINVAL);
    CHECK(page_read(page, &read) == -EPROTO);
    CHECK(page_init(page) == 0);
    CHECK(page_read(page, &read) == -ENODATA);
    for (uint64_t tick = 1; tick <= 9; tick++) {
        memset(&written, (int)tick, sizeof written);
        page_write(page, &written);
        CHECK(page_read(page, &read) == 0);
        CHECK(memcmp(&written, &read, sizeof read) == 0);
    }
}

/* A reader sees an odd number while a slot is being written. Here that number itself is the content
 * to be written. */
static void a_slot_is_marked_while_it_is_written(uint8_t *page)
{
    uint64_t mark;
    CHECK(page_init(page) == 0);
    page_write(page, (const robot_state *)(const void *)(page + SLOTS_AT));
    memcpy(&mark, page + SLOTS_AT + sizeof mark, sizeof mark);
    CHECK(mark == 1);
}

static uint32_t place(const uint8_t *memory, size_t offset)
{
    uint32_t value;
    memcpy(&value, memory + offset, sizeof value);
    return value;
}

static void all_zero(const uint8_t *memory, size_t bytes)
{
    for (size_t i = 0; i < bytes; i++) {
        CHECK(memory[i] == 0);
    }
}

static void a_page_begins_empty_in_memory_that_was_used_before(uint8_t *page)
{
    robot_state read;
    memset(page, 0xAA, PAGE_BYTES + 64);
    CHECK(page_init(page) == 0 && page_read(page, &read) == -ENODATA);
    CHECK(memcmp(page, "MOTORD\0\1", 8) == 0 &&
          place(page, LAYOUT_VERSION_AT) == PAGE_LAYOUT_VERSION);
    CHECK(place(page, WRITER_PID_AT) == (uint32_t)getpid());
    uint32_t stride = place(page, SLOT_STRIDE_AT);
    for (uint32_t slot = 0; slot < 4; slot++) {
        all_zero(page + SLOTS_AT + slot * stride, 8 + sizeof(robot_state));
    }
    CHECK(page[SLOTS_AT + 4 * stride] == 0xAA); /* bytes after the last slot are unchanged */
}

static void a_page_that_cannot_be_trusted_is_refused(uint8_t *page)
{
    robot_state read;
    uint32_t stride;
    uint8_t magic = page[0];
    page[0] = 'm';
    CHECK(page_read(page, &read) == -EPROTO);
    page[0] = magic;
    page[LAYOUT_VERSION_AT]++;
    CHECK(page_read(page, &read) == -EPROTO);
    page[LAYOUT_VERSION_AT]--;
    CHECK(page_read(page, &read) == 0);
    memcpy(&stride, page + SLOT_STRIDE_AT, sizeof stride);
    /* nine have been written, so the newest is in the first slot: as if the writer had stopped in
     * the middle of it */
    set_word(page, SLOTS_AT, 2 * 9 - 1);
    CHECK(page_read(page, &read) == -EAGAIN);
    set_word(page, SLOTS_AT, 2 * 9);
    CHECK(page_read(page, &read) == 0);
    set_word(page, PUBLISHED_AT, 10); /* the slot of the tenth still holds the sixth */
    CHECK(page_read(page, &read) == -EAGAIN);
    CHECK(stride == 8 + sizeof read + (64 - (8 + sizeof read) % 64) % 64);
}

/* Offsets from docs/replay.md. */
enum {
    RECORD_COUNT_AT = 12,
    RECORD_STRIDE_AT = 16,
    RECORDS_AT = 20,
    RECORD_BYTES_AT = 24,
    CHECKPOINT_COUNT_AT = 28,
    CHECKPOINT_STRIDE_AT = 32,
    CHECKPOINTS_AT = 36,
    CHECKPOINT_BYTES_AT = 40,
    JOURNAL_WRITER_PID_AT = 44,
    WRITTEN_AT = 48
};

/* Copies the content of a slot to `out`. Returns whether the slot holds the complete record
 * `number`. */
static bool holds(const uint8_t *slot, uint64_t number, void *out, size_t bytes)
{
    uint64_t sequence;
    memcpy(&sequence, slot, sizeof sequence);
    memcpy(out, slot + sizeof sequence, bytes);
    return sequence == 2 * number;
}

static void a_journal_holds_input_and_output(void)
{
    static core_state state, kept;
    core_input input;
    setpoints out;
    robot_state snapshot;
    journal_record record;
    uint64_t written[2];
    uint8_t *journal = aligned_alloc(64, (journal_bytes() + 63) / 64 * 64);
    CHECK(journal != NULL && journal_init(NULL) == -EINVAL && journal_init(journal + 8) == -EINVAL);
    CHECK(journal_init(journal) == 0);
    memset(&input, 1, sizeof input);
    memset(&out, 2, sizeof out);
    memset(&snapshot, 3, sizeof snapshot);
    for (uint64_t tick = 1; tick <= JOURNAL_RECORDS + 1; tick++) {
        state.tick = tick - 1;
        journal_before(journal, &state);
        out.tick = tick;
        snapshot.tick = tick;
        journal_after(journal, &input, 0.001, &out, &snapshot);
    }
    memcpy(written, journal + WRITTEN_AT, sizeof written);
    CHECK(written[0] == JOURNAL_RECORDS + 1 &&
          written[1] == 1 + JOURNAL_RECORDS / JOURNAL_CHECKPOINT_EVERY);
    const uint8_t *records = journal + place(journal, RECORDS_AT);
    /* the first slot is used for the second time */
    CHECK(holds(records, JOURNAL_RECORDS + 1, &record, sizeof record));
    CHECK(record.tick == JOURNAL_RECORDS + 1 && record.dt_s == 0.001 &&
          record.digest == journal_digest(&snapshot));
    CHECK(memcmp(&record.input, &input, sizeof input) == 0 &&
          memcmp(&record.out, &out, sizeof out) == 0);
    CHECK(holds(records + place(journal, RECORD_STRIDE_AT), 2, &record, sizeof record) &&
          record.tick == 2);
    const uint8_t *states = journal + place(journal, CHECKPOINTS_AT);
    CHECK(holds(states + place(journal, CHECKPOINT_STRIDE_AT), 2, &kept, sizeof kept));
    CHECK(kept.tick == JOURNAL_CHECKPOINT_EVERY);
    uint64_t digest = journal_digest(&snapshot);
    snapshot.joint[JOINTS_MAX - 1].jumps ^= 1;
    CHECK(journal_digest(&snapshot) != digest);
    free(journal);
}

static void a_journal_begins_empty_with_its_layout(void)
{
    uint8_t *journal = aligned_alloc(64, (journal_bytes() + 63) / 64 * 64);
    CHECK(journal != NULL);
    memset(journal, 0xAA, journal_bytes());
    CHECK(journal_init(journal) == 0);
    CHECK(memcmp(journal, "MOTORDJ\1", 8) == 0 &&
          place(journal, LAYOUT_VERSION_AT) == JOURNAL_LAYOUT_VERSION);
    CHECK(place(journal, RECORD_COUNT_AT) == JOURNAL_RECORDS &&
          place(journal, CHECKPOINT_COUNT_AT) == JOURNAL_CHECKPOINTS);
    CHECK(place(journal, RECORD_BYTES_AT) == sizeof(journal_record) &&
          place(journal, CHECKPOINT_BYTES_AT) == sizeof(core_state));
    CHECK(place(journal, JOURNAL_WRITER_PID_AT) == (uint32_t)getpid());
    all_zero(journal + WRITTEN_AT, 16);
    for (uint32_t i = 0; i < JOURNAL_RECORDS; i++) {
        all_zero(
            journal + place(journal, RECORDS_AT) + i * (size_t)place(journal, RECORD_STRIDE_AT), 8);
    }
    for (uint32_t i = 0; i < JOURNAL_CHECKPOINTS; i++) {
        all_zero(journal + place(journal, CHECKPOINTS_AT) +
                     i * (size_t)place(journal, CHECKPOINT_STRIDE_AT),
                 8);
    }
    free(journal);
}

/* FNV-1a of 64 bits over words: see docs/replay.md. */
static void a_digest_is_the_same_in_any_program(void)
{
    robot_state snapshot;
    uint64_t words[sizeof snapshot / 8], digest = UINT64_C(14695981039346656037);
    for (size_t w = 0; w < sizeof snapshot / 8; w++) {
        words[w] = w * UINT64_C(0x9E3779B97F4A7C15) + 1;
        digest = (digest ^ words[w]) * UINT64_C(1099511628211);
    }
    memcpy(&snapshot, words, sizeof snapshot);
    CHECK(journal_digest(&snapshot) == digest);
}

static void a_late_tick_skips_and_never_bursts(void)
{
    CHECK(schedule_period_ns(1000) == 1000000 && schedule_period_ns(3) == 333333333);
    for (int64_t late_ns = 0; late_ns <= 500; late_ns++) {
        int64_t deadline_ns = 1000;
        uint64_t skipped = schedule_next(&deadline_ns, 100, 1000 + late_ns);
        CHECK(deadline_ns % 100 == 0);                             /* on the grid */
        CHECK(deadline_ns >= 1000 + late_ns);                      /* not in the past */
        CHECK(deadline_ns - 100 < 1000 + late_ns || skipped == 0); /* the first such time */
        CHECK((int64_t)skipped == (deadline_ns - 1100) / 100);
    }
}

int main(void)
{
    static _Alignas(64) uint8_t page[PAGE_BYTES + 64];
    a_mailbox_gives_the_newest_value();
    writer_reader_and_the_newest_value_never_share_a_slot();
    a_ring_gives_all_in_order_and_takes_no_more_than_it_holds();
    each_value_has_a_box_of_its_own();
    an_exchange_begins_empty_in_memory_that_was_used_before();
    set_points_carry_how_often_they_became_enabled();
    no_count_is_ahead_of_its_set_points();
    a_page_is_read_as_it_was_written(page);
    a_page_that_cannot_be_trusted_is_refused(page);
    a_slot_is_marked_while_it_is_written(page);
    a_page_begins_empty_in_memory_that_was_used_before(page);
    a_journal_holds_input_and_output();
    a_journal_begins_empty_with_its_layout();
    a_digest_is_the_same_in_any_program();
    a_late_tick_skips_and_never_bursts();
    return checks_report("plumbing");
}
