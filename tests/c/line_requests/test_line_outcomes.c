/* SPDX-License-Identifier: Apache-2.0
 * test_line_outcomes: the effect of each answer of a drive and of each failure, also of the frames
 * of a stop. */
#include "line_cycle.h"

static void a_reply_that_took_longer_than_usual_gives_no_value(void)
{
    for (uint32_t late = 0; late < 3; late++) {
        begin_directions(0.0);
        drive->direction_sent[0] = DIRECTION_REST;
        line_cycle_begin(&w.machine, 0, w.now_ns);
        CHECK(sends() == frame_to(SPEED, 0));
        answers_with(0);
        CHECK(sends() == frame_to(STATUS, 1));
        drive->usual_ns = late == 2 ? 0 : DEVICE_NS - (int64_t)late; /* 0: not known yet */
        w.machine.joint[0].feedback.velocity_rad_s = 7.0;
        uint64_t exchanges = drive->count.exchanges;
        answers_with(150);
        CHECK(w.machine.joint[0].feedback.velocity_rad_s == (late == 1 ? 7.0 : 1.5) &&
              drive->place == 2);
        CHECK(drive->count.exchanges == exchanges + 1);
    }
}

/* The drive received nothing for longer than its watchdog waits and has stopped by itself, so the
 * line stops it. */
static void an_answer_after_its_watchdog_stops_an_armed_drive(void)
{
    for (uint32_t how = 0; how < 5; how++) {
        begin_directions(0.0);
        drive->direction_sent[0] = DIRECTION_REST;
        line_cycle_begin(&w.machine, 0, w.now_ns);
        CHECK(sends() == frame_to(SPEED, 0));
        drive->failures = 2;
        drive->owed_count = 0;
        drive->answered_ns = w.machine.end_ns - 500 * MS - (how != 1);
        drive->state.mode = how == 2 ? DRIVE_READY : DRIVE_ARMED;
        w.machine.table.drive[0].watchdog_ns = how == 3 ? 0 : how == 4 ? 1 : 500 * MS;
        answers_with(0);
        bool alone = how == 0 || how == 4;
        CHECK(drive->state.fault_reasons == (alone ? (uint32_t)DRIVE_FAULT_LEFT_ALONE : 0) &&
              drive->state.stopping == alone);
        CHECK(drive->failures == 0 && drive->place == !alone); /* a stopped drive ends its cycle */
    }
}

static void an_unanswered_request_gives_no_turn_around(void)
{
    for (uint32_t bytes = 0; bytes < 2; bytes++) {
        begin_directions(0.0);
        drive->direction_sent[0] = DIRECTION_REST;
        line_cycle_begin(&w.machine, 0, w.now_ns);
        CHECK(sends() == frame_to(SPEED, 0));
        w.machine.transaction.frame.reply_bytes = bytes;
        drive->smoothed_ns = 0;
        answers_with(0);
        CHECK((drive->smoothed_ns == 0) == (bytes == 0) && drive->place == 1);
    }
}

static void an_unresponsive_drive_that_answers_is_switched_off_first(void)
{
    begin_directions(0.0);
    drive->state.mode = DRIVE_UNRESPONSIVE;
    line_frame frame;
    line_next_probe(&w.machine, 0, w.now_ns, &frame);
    w.machine.transaction.frame = frame;
    w.machine.work = WORK_PROBE;
    w.machine.end_ns = w.now_ns;
    drive->smoothed_ns = 0;
    answers_with(0);
    CHECK(drive->state.back && drive->state.stop == STOP_POWER_OFF &&
          drive->state.mode == DRIVE_UNRESPONSIVE && drive->smoothed_ns == DEVICE_NS + 1);
}

static void each_failure_is_counted_by_its_kind(void)
{
    static const struct {
        uint32_t failure, no_reply, bad_reply, refused;
    } KINDS[] = {{ANSWER_NO_REPLY, 1, 0, 0},
                 {ANSWER_BAD_REPLY, 0, 1, 0},
                 {ANSWER_NEVER_SILENT, 0, 1, 0},
                 {ANSWER_REFUSED, 0, 0, 1}};
    for (uint32_t i = 0; i < 4; i++) {
        for (uint32_t current = 0; current < 2; current++) {
            begin_directions(0.0);
            line_cycle_begin(&w.machine, 0, w.now_ns);
            (void)sends();
            w.machine.current = current;
            drive->deadline_ns = 1 * MS;
            line_drive_failed(&w.machine, 0, KINDS[i].failure, 4, w.now_ns);
            CHECK(drive->failures == 1 && drive->last_failure == KINDS[i].failure &&
                  drive->last_exception == 4);
            CHECK(drive->count.no_reply == KINDS[i].no_reply &&
                  drive->count.bad_reply == KINDS[i].bad_reply);
            CHECK(drive->count.refused == KINDS[i].refused && drive->count.exchanges == 1);
            bool refused = KINDS[i].refused != 0;
            CHECK(drive->deadline_ns == (refused ? 1 : 2) * MS && drive->owed_count == !refused);
            int64_t late_ns =
                w.machine.end_ns + w.machine.table.drive[0].turnaround_ns + 8 * CHARACTER_NS;
            CHECK(drive->silent_until_ns == (refused ? 0 : late_ns));
            CHECK(drive->stage == STAGE_IDLE &&
                  w.machine.current == (current == 0 ? (uint32_t)LINE_DRIVES_MAX : 1));
        }
    }
}

static void as_many_failures_as_tries_make_a_drive_unresponsive(void)
{
    for (uint32_t how = 0; how < 5; how++) {
        begin_directions(0.0);
        line_cycle_begin(&w.machine, 0, w.now_ns);
        (void)sends();
        drive->state.mode = how == 1 ? DRIVE_READY : how >= 2 && how < 4 ? DRIVE_OFF : DRIVE_ARMED;
        drive->state.stop = how == 3 ? STOP_QUICK : STOP_NOTHING;
        drive->failures = how == 4 ? 1 : 2;
        line_drive_failed(&w.machine, 0, ANSWER_NO_REPLY, 0, w.now_ns);
        CHECK((drive->state.mode == DRIVE_UNRESPONSIVE) == (how != 2 && how != 4));
    }
    for (uint32_t failures = 1; failures < 3; failures++) {
        begin_directions(0.0);
        drive->failures = failures;
        drive->due_ns = 1;
        line_drive_not_reached(&w.machine, 0, w.now_ns);
        CHECK(drive->due_ns == w.now_ns && drive->last_failure == ANSWER_NEVER_SILENT &&
              drive->last_exception == 0);
        CHECK((drive->state.mode == DRIVE_UNRESPONSIVE) == (failures == 2) &&
              drive->count.bad_reply == 1);
    }
}

/* At the end of the line a frame of the newest stop that gets no reply is not repeated at once, so
 * that each frame is sent. */
static void at_the_end_a_frame_that_fails_makes_room_for_the_next(void)
{
    for (uint32_t how = 0; how < 3; how++) {
        begin_directions(0.0);
        line_stop_now(&w.machine, 0, STOP_POWER_OFF);
        line_frame frame;
        CHECK(line_next_stop(&w.machine, 0, &frame));
        w.machine.transaction.frame = frame;
        w.machine.transaction.frame.request[5] ^= (uint8_t)(how == 2); /* a frame of an older
                                                                          stop */
        w.machine.work = WORK_STOP;
        w.machine.end.stage = how == 0 ? 0 : 2;
        w.machine.table.drive[0].tries = 100;
        line_drive_failed(&w.machine, 0, ANSWER_NO_REPLY, 0, w.now_ns);
        CHECK(drive->stop_failures == 1 && drive->stop_place == (how == 1) &&
              drive->stop_done == 0);
    }
}

static void a_frame_that_no_longer_belongs_to_the_stop_is_not_marked_done(void)
{
    for (uint32_t behind = 0; behind < 2; behind++) {
        begin_directions(0.0);
        line_stop_now(&w.machine, 0, STOP_POWER_OFF);
        w.machine.table.drive[0].disarm_count = 2 - behind;
        drive->stop_place = 1;
        w.machine.transaction.frame = w.machine.table.drive[0].disarm[1];
        w.machine.work = WORK_STOP;
        answers_with(0);
        CHECK(drive->stop_done == (behind != 0 ? 0 : 2));
    }
}

static void a_frame_of_a_stop_that_is_refused_repeatedly_counts_as_done(void)
{
    for (uint32_t older = 0; older < 2; older++) {
        begin_directions(0.0);
        drive->state.mode = DRIVE_OFF;
        line_stop_now(&w.machine, 0, STOP_POWER_OFF);
        drive->stop_done = 1;
        line_frame frame;
        CHECK(line_next_stop(&w.machine, 0, &frame) && drive->stop_place == 1);
        w.machine.transaction.frame = frame;
        w.machine.transaction.frame.request[5] ^= (uint8_t)older;
        w.machine.work = WORK_STOP;
        for (uint32_t i = 1; i <= 3; i++) {
            CHECK(drive->stop_done == 1 && !drive->stop_refused && drive->stop_failures == i - 1);
            drive->failures = 0;
            line_drive_failed(&w.machine, 0, ANSWER_REFUSED, 1, w.now_ns);
        }
        CHECK(drive->stop_done == (older != 0 ? 1 : 3) && drive->stop_refused == (older == 0) &&
              drive->stop_failures == 0);
        /* the result of an older stop changes nothing */
        w.machine.transaction.frame.request[5] ^= 0x40;
        drive->failures = 0, drive->stop_failures = 2;
        line_drive_failed(&w.machine, 0, ANSWER_REFUSED, 1, w.now_ns);
        CHECK(drive->stop_refused == (older == 0));
    }
}

int main(void)
{
    a_reply_that_took_longer_than_usual_gives_no_value();
    an_answer_after_its_watchdog_stops_an_armed_drive();
    an_unanswered_request_gives_no_turn_around();
    an_unresponsive_drive_that_answers_is_switched_off_first();
    each_failure_is_counted_by_its_kind();
    as_many_failures_as_tries_make_a_drive_unresponsive();
    at_the_end_a_frame_that_fails_makes_room_for_the_next();
    a_frame_that_no_longer_belongs_to_the_stop_is_not_marked_done();
    a_frame_of_a_stop_that_is_refused_repeatedly_counts_as_done();
    return checks_report("line outcomes");
}
