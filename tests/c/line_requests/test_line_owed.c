/* SPDX-License-Identifier: Apache-2.0
 * test_line_owed: how late a reply may be, how soon is too soon, and how the turn-around of a drive
 * is learned. */
#include "line_wire.h"

static line_drive_state *drive;

static void begin_asking(void)
{
    begin_with(1, 0);
    drive = &w.machine.drive[0];
    w.machine.transaction.frame = frame_of(1, READ, STATUS, 1);
    w.machine.work = WORK_CYCLE;
    w.machine.worker = 0;
    w.machine.start_ns = w.machine.end_ns = w.now_ns;
    w.machine.table.drive[0].turnaround_ns = 100 * MS;
}

/* Time at which the reply ends, if the drive begins it `took_ns` after the earliest moment. */
static int64_t reply_after(int64_t took_ns)
{
    return w.machine.end_ns + line_reply_ns(&w.machine, &w.machine.transaction.frame) + took_ns;
}

static void a_reply_may_be_late_for_twice_its_bound_and_at_least_120_ms(void)
{
    static const struct {
        int64_t turnaround_ms, late_ms;
    } BOUNDS[] = {{5, 120}, {60, 120}, {61, 122}, {300, 600}};
    for (uint32_t i = 0; i < 4; i++) {
        begin_asking();
        w.machine.table.drive[0].turnaround_ns = BOUNDS[i].turnaround_ms * MS;
        line_owe(&w.machine, 0);
        CHECK(drive->owed_count == 1 && drive->owed[0].count == 1 &&
              drive->failed_ns == w.machine.end_ns);
        CHECK(drive->owed[0].until_ns == reply_after(BOUNDS[i].late_ms * MS));
        CHECK(line_may_be_late(&w.machine, 0, &w.machine.transaction.frame,
                               drive->owed[0].until_ns - 1));
        CHECK(!line_may_be_late(&w.machine, 0, &w.machine.transaction.frame,
                                drive->owed[0].until_ns));
    }
}

/* Doubtful is a reply that took less than half of the shortest turn-around so far, by more than 0.5
 * ms, within two seconds after a failure. */
static void a_reply_that_comes_too_soon_after_a_failure_is_doubtful_once(void)
{
    static const struct {
        int64_t failed_ago_ns, least_ns, took_ns;
        bool doubtful;
    } CASES[] = {
        {1000000000, 4000000, 1499999, true},
        {1000000000, 4000000, 1500000, false},
        {1999999999, 4000000, 1000000, true},
        {2000000000, 4000000, 1000000, false},
        {1000000000, 0, 0, false},
        {4999999999, 4000000, 0, false},
    };
    for (uint32_t i = 0; i < 6; i++) {
        begin_asking();
        w.machine.start_ns = w.machine.end_ns = w.now_ns = 5000 * MS;
        drive->failed_ns = w.now_ns - CASES[i].failed_ago_ns;
        drive->least_ns = CASES[i].least_ns;
        CHECK(line_is_doubtful(&w.machine, 0, reply_after(CASES[i].took_ns)) == CASES[i].doubtful);
        CHECK(drive->least_ns == (CASES[i].doubtful ? 0 : CASES[i].least_ns));
        CHECK(!line_is_doubtful(&w.machine, 0, reply_after(CASES[i].took_ns)));
    }
}

/* Soon after the start of the machine its clock is near 0, and 0 stands for "never failed". */
static void a_drive_that_never_failed_may_answer_at_any_time(void)
{
    for (int64_t failed_ns = 0; failed_ns <= 1; failed_ns++) {
        begin_asking();
        w.machine.start_ns = w.machine.end_ns = 1000 * MS;
        drive->failed_ns = failed_ns, drive->least_ns = 4 * MS;
        CHECK(line_is_doubtful(&w.machine, 0, reply_after(0)) == (failed_ns != 0));
    }
}

static void only_the_reply_to_a_known_request_is_doubted(void)
{
    for (uint32_t against = 0; against < 5; against++) {
        begin_asking();
        w.machine.start_ns = w.machine.end_ns = 1000 * MS;
        drive->failed_ns = 999 * MS, drive->least_ns = 4 * MS;
        w.machine.transaction.frame.reply_bytes = against == 1 ? 0 : against == 2 ? 1 : 7;
        w.machine.transaction.frame.exact = against == 3;
        w.machine.work = against == 4 ? WORK_PROBE : WORK_CYCLE;
        CHECK(line_is_doubtful(&w.machine, 0, reply_after(0)) == (against == 0 || against == 2));
    }
}

/* Replies that repeat their request are equal. Either may be taken, unless another write may have
 * come between. */
static void a_reply_that_repeats_its_request_is_doubtful_after_another_write(void)
{
    line_frame write = frame_of(1, WRITE, CONTROL, 1), other = frame_of(1, WRITE, SPEED, 1),
               read = frame_of(1, READ, STATUS, 1);
    /* the shortest possible frames */
    write.echo_bytes = 1, write.request_bytes = 3, write.reply_bytes = 9;
    for (uint32_t between = 0; between < 3; between++) {
        begin_asking();
        w.machine.transaction.frame = write;
        line_owe(&w.machine, 0);
        CHECK(drive->owed[0].look.repeats && drive->owed[0].look.head_bytes == 1);
        w.machine.transaction.frame = between == 2 ? other : read;
        if (between > 0) {
            line_owe(&w.machine, 0);
        }
        CHECK(line_may_be_late(&w.machine, 0, &write, w.now_ns) == (between == 2));
    }
}

static void a_turn_around_is_learned_with_its_spread(void)
{
    static const struct {
        int64_t smoothed_ns, variation_ns, expected_ns;
    } KNOWN[] = {
        {20000000, 0, 20500000}, {20000000, 125000, 20500000}, {20000000, 1000000, 24000000},
        {1000000, 0, 10000000},  {9500000, 0, 10000000},       {9500001, 0, 10000001},
        {0, 0, 100000000},       {99900000, 0, 100000000},     {20000000, 110000, 20500000},
        {1, 0, 10000000},        {20000000, 150000, 20600000},
    };
    for (uint32_t i = 0; i < 11; i++) {
        begin_asking();
        drive->smoothed_ns = KNOWN[i].smoothed_ns;
        drive->variation_ns = KNOWN[i].variation_ns;
        CHECK(line_expected_turnaround_ns(&w.machine, 0) == KNOWN[i].expected_ns);
    }
    begin_asking();
    w.machine.table.drive[0].reply_timeout_ns = 7 * MS;
    CHECK(line_expected_turnaround_ns(&w.machine, 0) == 7 * MS);
    w.machine.table.drive[0].reply_timeout_ns = 1;
    CHECK(line_expected_turnaround_ns(&w.machine, 0) == 1);
    /* on a pseudo-terminal bytes take no time */
    for (int64_t took_ns = -5; took_ns <= 1; took_ns += 3) {
        begin_asking();
        drive->smoothed_ns = 0;
        line_learn_turnaround(&w.machine, 0, reply_after(took_ns));
        CHECK(drive->smoothed_ns == (took_ns > 0 ? took_ns + 1 : 1) && drive->variation_ns == 0);
    }
    begin_asking();
    drive->smoothed_ns = 0;
    line_learn_turnaround(&w.machine, 0, reply_after(8 * MS));
    CHECK(drive->smoothed_ns == 8 * MS + 1 && drive->variation_ns == 4 * MS &&
          drive->deadline_ns == 24 * MS + 1);
    line_learn_turnaround(&w.machine, 0, reply_after(16 * MS + 1));
    CHECK(drive->smoothed_ns == 9 * MS + 1 && drive->variation_ns == 5 * MS &&
          drive->usual_ns == 29 * MS + 1);
    line_learn_turnaround(&w.machine, 0, reply_after(1 * MS + 1));
    CHECK(drive->smoothed_ns == 8 * MS + 1 && drive->variation_ns == 5 * MS + 750000 &&
          drive->deadline_ns == 31 * MS + 1);
}

/* The stamp is at most the middle of the exchange, and at most half of the shortest turn-around
 * after the request. */
static void a_value_was_taken_in_the_middle_or_soon_after_the_request(void)
{
    begin_asking();
    w.machine.end_ns = w.machine.start_ns + 4 * MS;
    drive->least_ns = 6 * MS;
    CHECK(line_stamp(&w.machine, 0, w.machine.start_ns + 12 * MS) == w.machine.start_ns + 6 * MS);
    CHECK(line_stamp(&w.machine, 0, w.machine.start_ns + 14 * MS) == w.machine.start_ns + 7 * MS);
    CHECK(line_stamp(&w.machine, 0, w.machine.start_ns + 90 * MS) == w.machine.start_ns + 7 * MS);
}

/* The reply only shows that the drive is present: it may belong to another request. One late reply
 * fewer is expected. */
static void a_doubtful_reply_ends_the_cycle_and_holds_the_drive(void)
{
    for (uint32_t current = 0; current < 2; current++) {
        begin_asking();
        line_owe(&w.machine, 0);
        int64_t reply_ns = line_reply_ns(&w.machine, &w.machine.transaction.frame);
        drive->stage = STAGE_READ;
        w.machine.current = current;
        line_doubt(&w.machine, 0, w.now_ns + MS);
        CHECK(drive->count.exchanges == 1 && drive->count.received_ns == w.now_ns + MS &&
              drive->stage == STAGE_IDLE);
        CHECK(w.machine.current == (current == 0 ? (uint32_t)LINE_DRIVES_MAX : 1));
        CHECK(drive->owed_count == 1 && drive->owed[0].count == 1); /* two were owed, and one has
                                                                       arrived */
        CHECK(drive->held_until_ns == drive->owed[0].until_ns &&
              drive->held_until_ns == w.now_ns + MS + 200 * MS + reply_ns);
    }
    begin_asking();
    line_doubt(&w.machine, 0, w.now_ns + MS); /* no other reply was owed: this one may still
                                                 arrive */
    CHECK(drive->owed_count == 1 && drive->owed[0].count == 1);
}

/* More owed replies than the line can distinguish: it waits in silence until all have expired. */
static void too_many_owed_replies_hold_the_drive_until_all_have_expired(void)
{
    begin_asking();
    for (uint8_t i = 0; i <= OWED_MAX; i++) {
        w.machine.transaction.frame = frame_of(1, READ, STATUS, 1);
        w.machine.transaction.frame.match[2] = (uint8_t)(2 + i);
        CHECK(drive->held_until_ns == 0);
        w.machine.end_ns += MS;
        line_owe(&w.machine, 0);
        CHECK(drive->owed_count == (i < OWED_MAX ? i + 1U : OWED_MAX));
    }
    CHECK(drive->held_until_ns == drive->owed[OWED_MAX - 1].until_ns &&
          drive->held_until_ns == reply_after(4 * 200 * MS));
    /* the oldest one was dropped */
    CHECK(drive->owed[0].look.head[2] == 3 &&
          drive->owed[OWED_MAX - 1].look.head[2] == 2 + OWED_MAX);
    w.machine.start_ns = drive->held_until_ns; /* all of them have expired */
    line_owe(&w.machine, 0);
    CHECK(drive->owed_count == 1 && drive->owed[0].count == 1);
}

/* Only a reply that certainly answers its request shows how short a turn-around may be; 0: not
 * known. */
static void the_shortest_turn_around_is_that_of_a_certain_reply(void)
{
    begin_asking();
    line_settle(&w.machine, 0, reply_after(3 * MS));
    CHECK(drive->least_ns == 3 * MS + 1);
    line_settle(&w.machine, 0, reply_after(4 * MS));
    CHECK(drive->least_ns == 3 * MS + 1);
    line_settle(&w.machine, 0, reply_after(0));
    CHECK(drive->least_ns == 1);
    drive->least_ns = 0;
    line_owe(&w.machine, 0);
    line_owe(&w.machine, 0);
    int64_t until_ns = drive->owed[0].until_ns;
    w.machine.end_ns += 7 * MS;
    line_settle(&w.machine, 0, reply_after(3 * MS)); /* perhaps the reply to the older request: one
                                                        is still owed */
    CHECK(drive->least_ns == 0 && drive->owed_count == 1 &&
          drive->owed[0].until_ns == until_ns + 7 * MS);
    for (uint32_t how = 0; how < 2; how++) {
        begin_asking();
        w.machine.transaction.frame.exact = how == 0;
        w.machine.transaction.frame.reply_bytes = how == 0 ? 7 : 0;
        line_settle(&w.machine, 0, reply_after(3 * MS));
        line_owe(&w.machine, 0);
        CHECK(drive->least_ns == 0 && drive->owed_count == 0);
    }
}

static void owe(const line_frame *frame)
{
    w.machine.transaction.frame = *frame;
    line_owe(&w.machine, 0);
}

static line_frame write_to(uint32_t place)
{
    static const uint8_t ADDRESSES[] = {SPEED, STATUS, CONTROL, RELEASE};
    return frame_of(1, WRITE, ADDRESSES[place], 1);
}

/* A reply that is owed again becomes the newest one. */
static void a_reply_that_is_owed_again_leaves_the_others_in_their_order(void)
{
    for (uint32_t count = 1; count <= OWED_MAX; count++) {
        for (uint32_t again = 0; again < count; again++) {
            begin_asking();
            for (uint32_t i = 0; i <= count; i++) {
                line_frame frame = write_to(i < count ? i : again);
                drive->probe_at_ns = drive->probe_pause_ns = drive->answered_ns =
                    drive->smoothed_ns = 7;
                owe(&frame);
            }
            CHECK(drive->owed_count == count && drive->held_until_ns == 0);
            CHECK(drive->owed[count - 1].until_ns ==
                  reply_after((count < OWED_MAX ? count + 1 : OWED_MAX) * 200 * MS));
            for (uint32_t i = 0; i < count; i++) {
                line_frame frame = write_to(i == count - 1 ? again : i < again ? i : i + 1);
                CHECK(memcmp(drive->owed[i].look.head, frame.request,
                             drive->owed[i].look.head_bytes) == 0);
                CHECK(drive->owed[i].count == (i == count - 1 ? 2U : 1U));
            }
            CHECK(drive->probe_at_ns == 7 && drive->probe_pause_ns == 7 &&
                  drive->answered_ns == 7 && drive->smoothed_ns == 7);
        }
    }
}

/* A drive answers in the order of its requests. */
static void a_certain_reply_ends_the_wait_for_all_older_ones(void)
{
    for (uint32_t certain = 0; certain < 3; certain++) {
        begin_asking();
        for (uint32_t i = 0; i < 3; i++) {
            line_frame frame = write_to(i);
            owe(&frame);
        }
        line_frame frame = w.machine.transaction.frame = write_to(certain);
        line_settle(&w.machine, 0, reply_after(MS));
        CHECK(drive->owed_count == 3 - certain);
        /* its own reply may arrive twice */
        CHECK(drive->owed[2 - certain].until_ns == reply_after((3 - certain) * 200 * MS));
        CHECK(!line_may_be_late(&w.machine, 0, &frame, w.now_ns));
    }
}

int main(void)
{
    a_reply_that_is_owed_again_leaves_the_others_in_their_order();
    a_certain_reply_ends_the_wait_for_all_older_ones();
    a_drive_that_never_failed_may_answer_at_any_time();
    only_the_reply_to_a_known_request_is_doubted();
    a_reply_that_repeats_its_request_is_doubtful_after_another_write();
    a_doubtful_reply_ends_the_cycle_and_holds_the_drive();
    too_many_owed_replies_hold_the_drive_until_all_have_expired();
    the_shortest_turn_around_is_that_of_a_certain_reply();
    a_reply_may_be_late_for_twice_its_bound_and_at_least_120_ms();
    a_reply_that_comes_too_soon_after_a_failure_is_doubtful_once();
    a_turn_around_is_learned_with_its_spread();
    a_value_was_taken_in_the_middle_or_soon_after_the_request();
    return checks_report("line owed");
}
