/* SPDX-License-Identifier: Apache-2.0
 * test_line_cycle: the cycle of one drive, frame by frame: directions, set-points, reads, and its
 * end. */
#include "line_cycle.h"

/* Makes a whole cycle, which sends these frames. Each one is answered. */
static void goes(const uint32_t *frames, uint32_t count)
{
    line_cycle_begin(&w.machine, 0, w.now_ns);
    for (uint32_t i = 0; i < count; i++) {
        CHECK(sends() == frames[i]);
        answers_with(0);
    }
    CHECK(sends() == NO_FRAME && drive->stage == STAGE_IDLE &&
          w.machine.current == LINE_DRIVES_MAX);
    drive->cycle_count = 1;
}
#define GOES(...)                                                                                  \
    goes((const uint32_t[]){__VA_ARGS__},                                                          \
         sizeof((const uint32_t[]){__VA_ARGS__}) / sizeof(uint32_t))

static void a_new_direction_is_sent_after_rest_and_its_first_magnitude(void)
{
    begin_directions(1.0);
    uint32_t rest = frame_to(DIRECTION, DIRECTION_REST),
             forward = frame_to(DIRECTION, DIRECTION_FORWARD),
             reverse = frame_to(DIRECTION, DIRECTION_REVERSE);
    uint32_t fast = frame_to(SPEED, 100), slow = frame_to(SPEED, 50), still = frame_to(SPEED, 0),
             status = frame_to(STATUS, 1);
    GOES(rest, fast, forward, status);
    CHECK(drive->direction_sent[0] == DIRECTION_FORWARD &&
          drive->direction_last[0] == DIRECTION_FORWARD && drive->state.sent_motion);
    want(0.5);
    GOES(slow, status);
    want(-0.5);
    GOES(rest, slow, reverse, status);
    CHECK(drive->direction_sent[0] == DIRECTION_REVERSE &&
          drive->direction_last[0] == DIRECTION_REVERSE);
    want(0.0);
    GOES(still, rest, status);
    CHECK(drive->direction_sent[0] == DIRECTION_REST &&
          drive->direction_last[0] == DIRECTION_REVERSE && !drive->state.sent_motion);
    GOES(still, status);
    want(0.5);
    GOES(slow, forward, status);
    CHECK(drive->direction_sent[0] == DIRECTION_FORWARD &&
          drive->direction_last[0] == DIRECTION_FORWARD);
}

static void an_unacknowledged_or_outdated_direction_is_unknown(void)
{
    begin_directions(1.0);
    GOES(frame_to(DIRECTION, DIRECTION_REST), frame_to(SPEED, 100),
         frame_to(DIRECTION, DIRECTION_FORWARD), frame_to(STATUS, 1));
    want(-1.0);
    line_cycle_begin(&w.machine, 0, w.now_ns);
    CHECK(sends() == frame_to(DIRECTION, DIRECTION_REST) &&
          drive->direction_sent[0] == DIRECTION_UNKNOWN);
    answers_with(0);
    CHECK(drive->direction_sent[0] == DIRECTION_REST && drive->place == 1);
    CHECK(sends() == frame_to(SPEED, 100));
    answers_with(0);
    CHECK(sends() == frame_to(DIRECTION, DIRECTION_REVERSE));
    want(0.0); /* changes while the request is in transit */
    answers_with(0);
    CHECK(drive->direction_sent[0] == DIRECTION_UNKNOWN &&
          drive->direction_last[0] == DIRECTION_FORWARD);
}

/* There are two exchanges of set-points. The drive moves if one of them is not zero. */
static void motion_in_any_exchange_counts_as_motion(void)
{
    for (uint32_t which = 0; which < 2; which++) {
        begin_directions(0.0);
        line_drive *table = &w.machine.table.drive[0];
        table->direction_count = 0;
        table->cyclic[2] = table->cyclic[1];
        table->cyclic[1] = table->cyclic[0];
        table->cyclic[1].setpoint[0].joint = 1;
        table->cyclic_count = 3;
        w.machine.newest.joint[which].velocity_rad_s = 1.0;
        GOES(frame_to(SPEED, which == 0 ? 100 : 0), frame_to(SPEED, which == 1 ? 100 : 0),
             frame_to(STATUS, 1));
        CHECK(drive->state.sent_motion);
        w.machine.newest.joint[which].velocity_rad_s = 0.0;
        GOES(frame_to(SPEED, 0), frame_to(SPEED, 0), frame_to(STATUS, 1));
        CHECK(!drive->state.sent_motion);
    }
}

static void each_of_several_directions_is_sent(void)
{
    begin_directions(1.0);
    line_drive *table = &w.machine.table.drive[0];
    table->direction_count = 2;
    table->direction[1] =
        (line_direction){.rest = frame_of(1, WRITE, DIRECTION + 1, DIRECTION_REST),
                         .forward = frame_of(1, WRITE, DIRECTION + 1, DIRECTION_FORWARD),
                         .reverse = frame_of(1, WRITE, DIRECTION + 1, DIRECTION_REVERSE)};
    drive->direction_sent[0] = DIRECTION_FORWARD;
    uint32_t fast = frame_to(SPEED, 100), status = frame_to(STATUS, 1);
    GOES(frame_to(DIRECTION + 1, DIRECTION_REST), fast, frame_to(DIRECTION + 1, DIRECTION_FORWARD),
         status);
    want(-1.0);
    GOES(frame_to(DIRECTION, DIRECTION_REST), frame_to(DIRECTION + 1, DIRECTION_REST), fast,
         frame_to(DIRECTION, DIRECTION_REVERSE), frame_to(DIRECTION + 1, DIRECTION_REVERSE),
         status);
}

/* The direction "rest" would release the brake; it is sent with the power-off. */
static void a_drive_that_is_stopping_gets_no_direction(void)
{
    begin_directions(1.0);
    drive->state.mode = DRIVE_READY;
    drive->state.stopping = true;
    w.machine.joint[0].feedback.velocity_rad_s = 3.0;
    line_cycle_begin(&w.machine, 0, w.now_ns);
    CHECK(sends() == frame_to(SPEED, 0));
    answers_with(0);
    CHECK(sends() == frame_to(STATUS, 1));
}

static void ranges_of_a_drive_that_reports_no_power_are_read_in_turn(void)
{
    begin_directions(0.0);
    w.machine.table.drive[0].extra[0].field_count = 0;
    w.machine.table.drive[0].extra[1].field_count = 0;
    drive->direction_sent[0] = DIRECTION_REST;
    uint32_t still = frame_to(SPEED, 0), status = frame_to(STATUS, 1);
    drive->state.mode = DRIVE_READY;
    drive->state.enabled = 2;
    drive->cycle_count = 4;
    GOES(still, status, frame_to(EXTRA, 1));
    CHECK(drive->state.enabled == 2);
    drive->cycle_count = 5;
    GOES(still, status);
    drive->cycle_count = 8;
    GOES(still, status, frame_to(EXTRA + 1, 1));
}

static void ranges_are_read_in_turn_and_the_one_with_the_power_first(void)
{
    begin_directions(0.0);
    drive->direction_sent[0] = DIRECTION_REST;
    uint32_t still = frame_to(SPEED, 0), status = frame_to(STATUS, 1);
    drive->state.mode = DRIVE_READY;
    drive->state.enabled = 0;
    drive->cycle_count = 4;
    GOES(still, status, frame_to(EXTRA, 1));
    CHECK(drive->extra_next == 1 && drive->state.enabled == 0);
    drive->cycle_count = 8;
    GOES(still, status, frame_to(EXTRA + 1, 1));
    CHECK(drive->extra_next == 0);
    drive->cycle_count = 7, drive->extra_next = 1;
    GOES(still, status);
    drive->state.enabled = 2;
    GOES(still, status, frame_to(EXTRA, 1));
    w.machine.table.drive[0].extra_count = 1;
    drive->state.enabled = 2, drive->cycle_count = 7, drive->extra_next = 0;
    GOES(still, status, frame_to(EXTRA, 1));
    w.machine.table.drive[0].extra_count = 0;
    drive->state.enabled = 2, drive->cycle_count = 8;
    GOES(still, status);
}

static void cycles_follow_each_other_by_their_period_and_late_ones_are_not_caught_up(void)
{
    begin_directions(0.0);
    drive->due_ns = w.now_ns;
    drive->cycle_start_ns = drive->cycle_ns = 0;
    line_cycle_begin(&w.machine, 0, w.now_ns);
    CHECK(drive->due_ns == w.now_ns + 20 * MS && drive->cycle_start_ns == w.now_ns &&
          drive->cycle_ns == 0);
    CHECK(drive->stage == STAGE_REST && drive->place == 0 && w.machine.current == 0);
    w.now_ns += 24 * MS;
    line_cycle_begin(&w.machine, 0, w.now_ns);
    CHECK(drive->cycle_ns == 24 * MS && drive->due_ns == w.now_ns + 16 * MS);
    w.now_ns += 16 * MS;
    drive->place = 3, drive->cycle_motion = true;
    w.machine.newest.tick = 99;
    line_cycle_begin(&w.machine, 0, w.now_ns);
    CHECK(drive->cycle_ns == 23 * MS && drive->due_ns == w.now_ns + 20 * MS);
    CHECK(drive->place == 0 && !drive->cycle_motion && drive->frozen.tick == 99);
    w.now_ns += 40 * MS;
    line_cycle_begin(&w.machine, 0, w.now_ns);
    CHECK(drive->due_ns == w.now_ns);
    w.now_ns = drive->due_ns + 20 * MS + 1;
    line_cycle_begin(&w.machine, 0, w.now_ns);
    CHECK(drive->due_ns == w.now_ns);
}

/* Ends a cycle that has no more frames to send. */
static void ends(void)
{
    line_frame frame;
    w.machine.notify = false;
    w.machine.current = 0;
    w.machine.feedback_mask = 0;
    drive->stage = STAGE_EXTRA, drive->place = 1;
    uint64_t cycles = drive->count.cycles, count = drive->cycle_count;
    CHECK(!line_next_in_cycle(&w.machine, 0, w.now_ns, &frame));
    CHECK(drive->count.cycles == cycles + 1 && drive->cycle_count == count + 1 &&
          w.machine.feedback_mask == 1);
    CHECK(drive->stage == STAGE_IDLE && w.machine.current == LINE_DRIVES_MAX);
}

static void the_end_of_a_cycle_evaluates_the_reports_of_the_drive(void)
{
    begin_directions(0.0);
    drive->lost_setup = true;
    ends();
    CHECK(drive->state.mode == DRIVE_OFF && drive->state.fault_reasons == DRIVE_FAULT_LOST_SETUP &&
          drive->state.stop == STOP_POWER_OFF);
    begin_directions(0.0);
    ends();
    CHECK(drive->state.mode == DRIVE_ARMED && drive->state.stop == STOP_NOTHING);
    drive->state.enabled = drive->enabled_before = 0;
    ends();
    CHECK(drive->state.mode == DRIVE_OFF &&
          drive->state.fault_reasons == DRIVE_FAULT_DISABLED_ITSELF &&
          drive->state.stop == STOP_POWER_OFF);
    for (uint32_t how = 0; how < 3; how++) {
        begin_directions(0.0);
        drive->state.mode = DRIVE_READY, drive->state.enabled = 2;
        drive->state.stopping = how != 2, drive->state.off_by_ns = INT64_MAX;
        w.machine.joint[0].feedback.velocity_rad_s = how == 1 ? 0.2 : 0.05;
        ends();
        CHECK(drive->state.stop == (how == 0 ? STOP_POWER_OFF : STOP_NOTHING) &&
              drive->state.stopping == (how == 1));
    }
}

/* The fault came between the two reads. A power-off would clear it before it is read. */
static void why_a_drive_disabled_itself_is_read_before_it_is_switched_off(void)
{
    begin_directions(1.0);
    drive->direction_sent[0] = DIRECTION_FORWARD;
    line_drive *table = &w.machine.table.drive[0];
    table->cyclic[1].field[0] =
        (line_field){.kind = FIELD_FAULT, .byte = 3, .form = FORM_U16, .si_per_raw = 1.0};
    table->cyclic[1].field_count = 1;
    drive->cycle_count = 4;
    for (uint32_t cycle = 0; cycle < 2; cycle++) {
        CHECK(drive->state.mode == DRIVE_ARMED && drive->state.stop == STOP_NOTHING);
        line_cycle_begin(&w.machine, 0, w.now_ns);
        CHECK(sends() == frame_to(SPEED, 100));
        answers_with(0);
        CHECK(sends() == frame_to(STATUS, 1));
        answers_with(cycle == 0 ? 0 : 8);
        if (cycle == 0) {
            CHECK(sends() == frame_to(EXTRA, 1));
            answers_with(0);
        }
        CHECK(sends() == NO_FRAME);
    }
    CHECK(w.machine.joint[0].fault_word == 8);
    CHECK(drive->state.mode == DRIVE_OFF &&
          drive->state.fault_reasons == DRIVE_FAULT_DISABLED_ITSELF &&
          drive->state.stop == STOP_POWER_OFF);
}

/* A drive that was without power may have lost its set-up. It is switched off, even if it has power
 * again. */
static void an_armed_drive_that_lost_its_power_for_a_cycle_is_disarmed(void)
{
    for (uint32_t how = 0; how < 2; how++) {
        begin_directions(0.0);
        drive->state.mode = how == 0 ? DRIVE_ARMED : DRIVE_READY;
        drive->enabled_before = 0, drive->state.enabled = 1;
        drive->arming_until_ns = INT64_MAX;
        ends();
        CHECK(drive->state.mode == (how == 0 ? DRIVE_OFF : DRIVE_READY));
        CHECK(drive->state.stop == (how == 0 ? STOP_POWER_OFF : STOP_NOTHING));
    }
    begin_directions(0.0);
    /* without power before its arming in the same cycle */
    drive->state.mode = DRIVE_READY, drive->enabled_before = 0;
    request(0, DRIVE_ARMED);
    w.machine.newest.stamp_ns = w.now_ns;
    line_obey_request(&w.machine, 0, w.now_ns);
    CHECK(drive->state.mode == DRIVE_ARMED);
    drive->state.enabled = 1;
    ends();
    CHECK(drive->state.mode == DRIVE_ARMED && drive->state.stop == STOP_NOTHING);
}

/* Each cycle takes power that was not requested, and it is reported once. */
static void a_drive_that_is_enabled_without_being_armed_is_switched_off(void)
{
    for (uint32_t how = 0; how < 7; how++) {
        begin_directions(0.0);
        drive->state.mode = how == 1 ? DRIVE_OFF : DRIVE_READY;
        drive->state.enabled = how == 2 ? 2 : 1;
        drive->state.stopping = how == 3, drive->state.off_by_ns = INT64_MAX;
        w.machine.joint[0].feedback.velocity_rad_s = 3.0;
        drive->state.stop = how == 4 ? STOP_QUICK : STOP_NOTHING;
        drive->cycle_start_ns = w.now_ns;
        drive->arming_until_ns = how == 5 ? w.now_ns + 1 : w.now_ns;
        drive->state.still_enabled = how == 6 ? 2 : 1; /* of three reports */
        drive->state.fault_reasons = drive->state.reported_reasons = DRIVE_FAULT_LEFT_ALONE;
        ends();
        bool nobody = how == 0 || how == 6;
        CHECK(drive->state.stop == (nobody     ? STOP_POWER_OFF
                                    : how == 4 ? STOP_QUICK
                                               : STOP_NOTHING));
        CHECK(drive->state.still_enabled == (how == 6 ? 3 : nobody ? 2 : 1));
        CHECK(drive->state.fault_reasons ==
              (DRIVE_FAULT_LEFT_ALONE | (how == 6 ? (uint32_t)DRIVE_FAULT_STILL_ENABLED : 0)));
        CHECK(w.machine.notify == (how == 6));
    }
    drive->state.stop = STOP_NOTHING, drive->state.mode = DRIVE_READY;
    ends();
    CHECK(drive->state.still_enabled == 4 && !w.machine.notify);
    drive->state.enabled = 0;
    ends();
    CHECK(drive->state.still_enabled == 0);
}

static void the_core_gets_the_feedback_of_a_cycle_with_its_last_read(void)
{
    begin_directions(0.0);
    drive->direction_sent[0] = DIRECTION_REST;
    drive->cycle_count = 4;
    /* beyond the count */
    w.machine.table.drive[0].cyclic[2] = w.machine.table.drive[0].cyclic[1];
    line_cycle_begin(&w.machine, 0, w.now_ns);
    w.machine.feedback_mask = 0;
    CHECK(sends() == frame_to(SPEED, 0));
    answers_with(0);
    CHECK(w.machine.feedback_mask == 0);
    CHECK(sends() == frame_to(STATUS, 1));
    answers_with(150);
    CHECK(w.machine.feedback_mask == 1 && w.machine.joint[0].feedback.velocity_rad_s == 1.5 &&
          drive->stage == STAGE_READ);
    CHECK(drive->answered_ns == w.machine.end_ns && drive->count.received_ns == w.now_ns);
    drive->stage = STAGE_IDLE; /* stopped in the cycle */
    CHECK(sends() == NO_FRAME);
}

/* After two writes without a read the first answer completes the feedback. With a read, only the
 * read does. */
static void writes_give_the_core_no_feedback_while_a_read_is_outstanding(void)
{
    for (uint32_t reads = 0; reads < 2; reads++) {
        begin_directions(0.0);
        line_drive *table = &w.machine.table.drive[0];
        table->direction_count = 0;
        table->cyclic[2] = table->cyclic[1];
        table->cyclic[1] = table->cyclic[0];
        table->cyclic_count = 2 + reads;
        line_cycle_begin(&w.machine, 0, w.now_ns);
        w.machine.feedback_mask = 0;
        CHECK(sends() == frame_to(SPEED, 0));
        answers_with(0);
        CHECK(w.machine.feedback_mask == !reads);
    }
}

int main(void)
{
    a_new_direction_is_sent_after_rest_and_its_first_magnitude();
    an_unacknowledged_or_outdated_direction_is_unknown();
    motion_in_any_exchange_counts_as_motion();
    each_of_several_directions_is_sent();
    a_drive_that_is_stopping_gets_no_direction();
    ranges_are_read_in_turn_and_the_one_with_the_power_first();
    ranges_of_a_drive_that_reports_no_power_are_read_in_turn();
    cycles_follow_each_other_by_their_period_and_late_ones_are_not_caught_up();
    the_end_of_a_cycle_evaluates_the_reports_of_the_drive();
    why_a_drive_disabled_itself_is_read_before_it_is_switched_off();
    an_armed_drive_that_lost_its_power_for_a_cycle_is_disarmed();
    a_drive_that_is_enabled_without_being_armed_is_switched_off();
    the_core_gets_the_feedback_of_a_cycle_with_its_last_read();
    writes_give_the_core_no_feedback_while_a_read_is_outstanding();
    return checks_report("line cycle");
}
