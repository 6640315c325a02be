/* SPDX-License-Identifier: Apache-2.0
 * Each time of a drive on a CAN bus at its bound: still good, and too late one nanosecond later. */
#include "can_wire.h"

enum { SLOW = 0x610, PROBE = 0x620, OFF_WORD = 0x700 };

/* Makes a step with set-points of this stamp. */
static void step_with_stamp(int64_t stamp_ns)
{
    w.machine.newest.stamp_ns = stamp_ns;
    step();
}

static void arm_by_hand(void)
{
    arm(0);
    w.enabled = 2;
    w.machine.newest.enabled = 1;
}

static void set_points_are_good_until_their_timeout_and_ten_milliseconds_ahead(void)
{
    begin_with(1);
    table_of(0)->watchdog_ns = 0;
    restart();
    arm_by_hand();
    step_with_stamp(w.now_ns - 100 * MS);
    CHECK(state_of(0)->state.mode == DRIVE_ARMED);
    step_with_stamp(w.now_ns + 10 * MS);
    CHECK(state_of(0)->state.mode == DRIVE_ARMED);
    step_with_stamp(w.now_ns + 10 * MS + 1);
    CHECK(state_of(0)->state.mode == DRIVE_READY &&
          state_of(0)->state.fault_reasons == DRIVE_FAULT_SETPOINTS_OLD);
    begin_with(1);
    arm_by_hand();
    step_with_stamp(w.now_ns - 100 * MS - 1);
    CHECK(state_of(0)->state.mode == DRIVE_READY &&
          state_of(0)->state.fault_reasons == DRIVE_FAULT_SETPOINTS_OLD);
}

static void set_points_without_a_stamp_do_not_count_even_one_nanosecond_after_boot(void)
{
    begin_with(1);
    w.now_ns = 1;
    restart();
    arm_by_hand();
    step_with_stamp(1);
    CHECK(state_of(0)->state.mode == DRIVE_ARMED);
    step_with_stamp(0);
    CHECK(state_of(0)->state.mode == DRIVE_READY &&
          state_of(0)->state.fault_reasons == DRIVE_FAULT_SETPOINTS_OLD);
}

static void a_wheel_that_keeps_turning_has_exactly_a_second_to_come_to_rest(void)
{
    begin_with(1);
    arm_by_hand();
    report_motion(0, 1.0F, 1.0F);
    int64_t stopped_ns = w.now_ns;
    step_with_stamp(0);
    CHECK(state_of(0)->state.stopping);
    for (w.now_ns += 100 * MS; w.now_ns < stopped_ns + 1000 * MS; w.now_ns += 100 * MS) {
        report_state(0, 8);
        report_motion(0, 1.0F, 1.0F);
        step();
    }
    w.now_ns = stopped_ns + 1000 * MS - 1;
    step();
    CHECK(state_of(0)->state.stopping && first_sent_ns(0, DISABLE) == 0);
    w.now_ns++;
    step();
    CHECK(!state_of(0)->state.stopping && first_sent_ns(0, DISABLE) == stopped_ns + 1000 * MS);
}

static void a_quick_stop_also_sends_zero_at_once(void)
{
    begin_with(1);
    w.table.period_ns = 1000 * MS;
    table_of(0)->idle_setpoints = 0;
    table_of(0)->watchdog_ns = 0;
    table_of(0)->quick_stop[0] = (can_write){.packet = packet_of(CONTROL, 1)};
    restart();
    arm(0);
    w.machine.cycle.due_ns = w.now_ns;
    step();
    CHECK(state_of(0)->state.sent_motion);
    w.enabled = 2;
    report_motion(0, 1.0F, 1.0F);
    forget_sent();
    step_with_stamp(0);
    CHECK(count_sent(CONTROL) == 1 && count_sent(SPEED) == 1 && speed_in(newest_of(0)) == 0);
}

static void fault_reasons_add_up_until_the_next_set_up(void)
{
    begin_with(1);
    arm(0);
    go_on(30 * MS);
    w.enabled = 0;
    step();
    CHECK(state_of(0)->state.fault_reasons == DRIVE_FAULT_NOT_ENABLED);
    go_on(60 * MS); /* the drive still reports that it has power */
    CHECK(state_of(0)->state.fault_reasons ==
          (DRIVE_FAULT_NOT_ENABLED | DRIVE_FAULT_STILL_ENABLED));
    become_unresponsive();
    CHECK(state_of(0)->state.fault_reasons ==
          (DRIVE_FAULT_NOT_ENABLED | DRIVE_FAULT_STILL_ENABLED | DRIVE_FAULT_UNRESPONSIVE));
}

static void reports_of_power_count_from_the_end_of_its_arming(void)
{
    begin_with(1);
    go_on(20 * MS);
    request(0, DRIVE_READY);
    w.machine.control.drive[0].arming_until_ns = w.now_ns + 1;
    report_state(0, 8);
    CHECK(state_of(0)->state.still_enabled == 0);
    w.now_ns++;
    report_state(0, 8);
    CHECK(state_of(0)->state.still_enabled == 1);
    begin_with(1);
    table_of(0)->reports_enabled = 0;
    table_of(0)->slow_every = 1;
    table_of(0)->disarm[0] = (can_write){.packet = packet_of(OFF_WORD, 1)};
    restart();
    go_on(20 * MS);
    request(0, DRIVE_READY);
    forget_sent();
    w.machine.control.drive[0].arming_until_ns = w.machine.cycle.due_ns + 1;
    w.now_ns = w.machine.cycle.due_ns;
    step();
    CHECK(count_sent(SPEED) == 1 && count_sent(OFF_WORD) == 0);
    w.machine.control.drive[0].arming_until_ns = w.machine.cycle.due_ns;
    w.now_ns = w.machine.cycle.due_ns;
    step();
    CHECK(count_sent(OFF_WORD) == 1);
}

/* ------------------------------------------------------------------------------ silence */
static void silence_is_allowed_up_to_its_bound(void)
{
    begin_with(1);
    arm_by_hand();
    w.machine.newest.stamp_ns = w.now_ns + 200 * MS; /* in the future, so that only the silence is
                                                        checked */
    w.machine.table.setpoint_timeout_ns = 1000 * MS;
    report_state(0, 8);
    report_motion(0, 1.0F, 0.0F);
    int64_t received_ns = w.now_ns;
    w.now_ns = received_ns + 200 * MS;
    step();
    CHECK(state_of(0)->missing == 0);
    w.now_ns++;
    uint32_t stops = state_of(0)->stops;
    step();
    CHECK(state_of(0)->missing == 2 && state_of(0)->state.mode == DRIVE_UNRESPONSIVE &&
          state_of(0)->stops == stops + 1);
}

static void a_drive_is_missing_before_its_first_frame_and_when_any_of_its_frames_is_overdue(void)
{
    begin_with(1);
    table_of(0)->input[0].silence_ns = 1;
    w.now_ns = 1;
    restart();
    step();
    CHECK(state_of(0)->missing == 1);
    report_state(0, 1);
    report_motion(0, 1.0F, 0.0F);
    w.now_ns++;
    step();
    CHECK(state_of(0)->missing == 0);
    w.now_ns++;
    step();
    CHECK(state_of(0)->missing == 1);
}

static void an_answer_to_a_hello_is_good_for_five_seconds(void)
{
    begin_with(1);
    table_of(0)->hello = 1; /* 1: the answer is the first input */
    w.now_ns = 1;
    restart();
    step();
    CHECK(state_of(0)->missing == 1);
    report_state(0, 1);
    w.now_ns += 5000 * MS - 1;
    step();
    CHECK(state_of(0)->missing == 0);
    w.now_ns++;
    step();
    CHECK(state_of(0)->missing == 1);
}

static void an_old_answer_to_a_hello_does_not_count_for_an_unresponsive_drive(void)
{
    begin_with(1);
    table_of(0)->hello = 1;
    restart();
    arm(0);
    w.silent = true;
    while (state_of(0)->state.mode == DRIVE_ARMED) {
        report_state(0, 8);
        go_on(10 * MS); /* the drive sends no motion frames any more */
    }
    go_on(10 * MS);
    CHECK(state_of(0)->state.mode == DRIVE_UNRESPONSIVE && state_of(0)->missing == 1);
    report_state(0, 8);
    go_on(20 * MS);
    CHECK(state_of(0)->state.mode == DRIVE_BACK);
}

static void a_drive_that_falls_silent_while_it_stops_gets_quick_stops_again(void)
{
    begin_with(1);
    arm(0);
    w.reported_rad_s = 1.0;
    go_on(3000 * MS); /* so that all earlier frames are long ago */
    w.enabled = 2;
    go_on(110 * MS);
    CHECK(state_of(0)->state.stopping);
    become_unresponsive();
    CHECK(!state_of(0)->state.stopping);
    int64_t unresponsive_ns = state_of(0)->unresponsive_since_ns;
    CHECK(first_sent_ns(0, DISABLE) == 0);
    go_on(800 * MS);
    CHECK(first_sent_ns(0, DISABLE) == 0);
    go_on(1000 * MS);
    CHECK(first_sent_ns(0, DISABLE) > unresponsive_ns + 1000 * MS);
}

static void quick_stops_continue_for_a_second_of_silence(void)
{
    begin_with(1);
    table_of(0)->quick_stop[0] = (can_write){.packet = packet_of(CONTROL, 1)};
    table_of(0)->disarm[0] = (can_write){.packet = packet_of(OFF_WORD, 1)};
    restart();
    arm(0);
    go_on(30 * MS);
    w.not_taken = SPEED; /* the bus never takes it, so each cycle sends it again */
    become_unresponsive();
    int64_t unresponsive_ns = state_of(0)->unresponsive_since_ns;
    w.machine.cycle.due_ns = unresponsive_ns + 1000 * MS;
    w.now_ns = unresponsive_ns + 1000 * MS;
    forget_sent();
    step();
    CHECK(count_sent(CONTROL) == 1 && count_sent(OFF_WORD) == 0);
    w.machine.cycle.due_ns = ++w.now_ns;
    step();
    CHECK(count_sent(CONTROL) == 1 && count_sent(OFF_WORD) == 1);
}

static void an_unresponsive_drive_is_finally_probed_every_two_seconds(void)
{
    begin_with(1);
    w.table.period_ns = MS;
    table_of(0)->probe_count = 1;
    table_of(0)->probe[0] = packet_of(PROBE, 0);
    restart();
    go_on(20 * MS);
    request(0, DRIVE_READY);
    w.silent = true;
    while (state_of(0)->state.mode != DRIVE_UNRESPONSIVE) {
        go_on(MS);
    }
    forget_sent();
    go_on(8000 * MS);
    /* the pause of 100 ms before the first probe has begun earlier */
    const int64_t pauses_ms[] = {200, 400, 800, 1600, 2000, 2000};
    CHECK(w.sent_count >= 7);
    for (uint32_t i = 0; i < 6; i++) {
        CHECK(w.sent_ns[i + 1] - w.sent_ns[i] == pauses_ms[i] * MS);
    }
}

/* ----------------------------------------------------------------------------- watchdog */
static void a_drive_counts_as_left_alone_after_the_time_of_its_watchdog(void)
{
    begin_with(1);
    w.table.period_ns = 100000 * MS;
    w.table.setpoint_timeout_ns = 100000 * MS;
    table_of(0)->input[0].silence_ns = table_of(0)->input[1].silence_ns = 0;
    const int64_t watchdogs_ns[] = {1, 500 * MS};
    for (uint32_t i = 0; i < 2; i++) {
        table_of(0)->watchdog_ns = watchdogs_ns[i];
        restart();
        request(0, DRIVE_READY);
        request(0, DRIVE_ARMED);
        CHECK(state_of(0)->state.mode == DRIVE_ARMED);
        w.now_ns += watchdogs_ns[i];
        w.machine.cycle.due_ns = w.now_ns + MS;
        step();
        CHECK(state_of(0)->state.mode == DRIVE_ARMED);
        w.now_ns++;
        step();
        CHECK(state_of(0)->state.mode == DRIVE_READY &&
              state_of(0)->state.fault_reasons == DRIVE_FAULT_LEFT_ALONE);
    }
}

/* ---------------------------------------------------------------------- what is counted */
static void frames_that_the_bus_does_not_take_are_counted(void)
{
    begin_with(1);
    go_on(20 * MS);
    request(0, DRIVE_READY);
    w.full = true;
    uint64_t before = w.machine.tx_full, cycles = w.machine.cycle.count;
    go_on(100 * MS);
    CHECK(w.machine.cycle.count >= cycles + 9);
    CHECK(w.machine.tx_full - before == w.machine.cycle.count - cycles); /* each cycle has one
                                                                            frame */
}

static void standing_down_is_a_stop_and_ends_jobs(void)
{
    begin_with(1);
    arm(0);
    uint32_t stops = state_of(0)->stops;
    request(0, DRIVE_STAND_DOWN);
    CHECK(state_of(0)->stops == stops + 1 && state_of(0)->state.mode == DRIVE_READY);
}

static void a_request_that_was_overtaken_counts_as_a_stop(void)
{
    begin_with(1);
    arm(0);
    request(0, DRIVE_READY); /* an armed drive is set up already */
    CHECK(state_of(0)->state.mode == DRIVE_ARMED);
    uint32_t stops = state_of(0)->stops;
    w.machine.control.drive[0].count++;
    request(0, DRIVE_ARMED);
    CHECK(state_of(0)->state.mode == DRIVE_READY && state_of(0)->stops == stops + 2 &&
          state_of(0)->state.enabled == 2);
    CHECK(newest_of(0)->data[0] == DISABLE);
}

static void a_new_set_up_cancels_a_power_off_that_was_due(void)
{
    begin_with(1);
    go_on(20 * MS);
    request(0, DRIVE_READY);
    report_state(0, 8);
    CHECK(state_of(0)->state.off_due);
    request(0, DRIVE_OFF);
    request(0, DRIVE_READY);
    request(0, DRIVE_ARMED);
    CHECK(state_of(0)->state.mode == DRIVE_ARMED);
}

static void a_newly_armed_drive_waits_for_the_core_to_enable_it_again(void)
{
    begin_with(1);
    w.enabled = 0;
    w.machine.enabled_count = 5;
    go_on(20 * MS);
    request(0, DRIVE_READY);
    go_on(20 * MS);
    request(0, DRIVE_ARMED);
    w.powered = true;
    go_on(50 * MS);
    CHECK(state_of(0)->state.mode == DRIVE_ARMED);
    w.machine.enabled_count = 6; /* a look ago it was enabled, and it is not any more */
    step();
    CHECK(state_of(0)->state.mode == DRIVE_READY &&
          state_of(0)->state.fault_reasons == DRIVE_FAULT_NOT_ENABLED);
}

static void slow_requests_are_sent_in_the_first_cycle_and_then_by_turns(void)
{
    begin_with(1);
    can_drive *drive = table_of(0);
    drive->slow_every = 2;
    drive->slow_count = 3;
    for (uint32_t i = 0; i < 3; i++) {
        drive->slow[i] = packet_of(SLOW + i, 0);
    }
    restart();
    for (uint32_t again = 0; again < 2; again++) {
        go_on(20 * MS);
        w.now_ns = w.machine.cycle.due_ns - MS;
        forget_sent();
        request(0, DRIVE_READY);
        for (uint32_t i = 0; i < 10; i++) {
            w.now_ns = w.machine.cycle.due_ns;
            report_state(0, 1);
            report_motion(0, 1.0F, 0.0F);
            step();
        }
        uint32_t turn = 0;
        for (uint32_t i = 0; i < w.sent_count; i++) {
            if (w.sent[i].id >= SLOW) {
                /* after every second set-point frame */
                CHECK(w.sent[i].id == SLOW + turn % 3 && i == 3 * turn + 1);
                turn++;
            }
        }
        CHECK(turn == 5);
        request(0, DRIVE_OFF);
    }
    drive->slow_count = 1;
    restart();
    forget_sent();
    request(0, DRIVE_READY); /* the first cycle is due now */
    CHECK(count_sent(SLOW) == 1 && count_sent(SLOW + 1) == 0);
}

/* ------------------------------------------------------------------------------- values */
static void a_report_of_power_is_not_a_sample_of_a_joint(void)
{
    begin_with(1);
    can_drive *drive = table_of(0);
    drive->input[1] = (can_input){.fast = 1, .field_count = 1};
    drive->input[1].field[0] = (can_field){
        .place = {.length = 8}, .meaning = {.kind = FIELD_TEMPERATURE, .si_per_raw = 1.0}};
    restart();
    request(0, DRIVE_READY);
    report_motion(0, 1.0F, 0.0F);
    int64_t sampled_ns = w.now_ns;
    w.now_ns += 7 * MS;
    report_state(0, 8);
    CHECK(w.machine.feedback_mask == 1 && w.machine.joint[0].feedback.stamp_ns == sampled_ns);
    CHECK(w.machine.joint[0].feedback.enabled == 1);
}

static void values_of_all_joints_of_a_drive_are_cleared_with_it(void)
{
    begin_with(3);
    go_on(20 * MS);
    report_motion(2, 1.0F, 3.0F);
    CHECK(w.machine.joint[2].feedback.velocity_rad_s == 3.0);
    request(2, DRIVE_READY);
    CHECK(isnan(w.machine.joint[2].feedback.velocity_rad_s) &&
          w.machine.joint[2].feedback.count == 0);
}

static void motion_in_the_second_frame_alone_waits_for_its_cycle(void)
{
    begin_with(1);
    can_drive *drive = table_of(0);
    drive->output_count = 2;
    drive->output[1] = drive->output[0];
    drive->output[1].packet.id = OFF_WORD;
    drive->output[1].setpoint[0].scale.raw_per_si = -100.0;
    drive->output[1].setpoint[0].scale.joint = 1;
    drive->output[0].setpoint[0].scale.raw_max = 0.0; /* backward only */
    restart();
    arm(0);
    go_on(30 * MS);
    CHECK(state_of(0)->state.sent_motion && speed_in(newest_of(0)) == 0 &&
          state_of(0)->joints == 3);
    forget_sent();
    for (uint32_t i = 0; i < 100; i++) {
        w.now_ns += MS / 10;
        report_state(0, 8);
        report_motion(0, 1.0F, 0.0F);
        step();
    }
    CHECK(count_sent(SPEED) <= 2 && count_sent(OFF_WORD) <= 2); /* at most the frames of two
                                                                   cycles */
}

int main(void)
{
    set_points_are_good_until_their_timeout_and_ten_milliseconds_ahead();
    set_points_without_a_stamp_do_not_count_even_one_nanosecond_after_boot();
    a_wheel_that_keeps_turning_has_exactly_a_second_to_come_to_rest();
    a_quick_stop_also_sends_zero_at_once();
    fault_reasons_add_up_until_the_next_set_up();
    reports_of_power_count_from_the_end_of_its_arming();
    silence_is_allowed_up_to_its_bound();
    a_drive_is_missing_before_its_first_frame_and_when_any_of_its_frames_is_overdue();
    an_answer_to_a_hello_is_good_for_five_seconds();
    an_old_answer_to_a_hello_does_not_count_for_an_unresponsive_drive();
    a_drive_that_falls_silent_while_it_stops_gets_quick_stops_again();
    quick_stops_continue_for_a_second_of_silence();
    an_unresponsive_drive_is_finally_probed_every_two_seconds();
    a_drive_counts_as_left_alone_after_the_time_of_its_watchdog();
    frames_that_the_bus_does_not_take_are_counted();
    standing_down_is_a_stop_and_ends_jobs();
    a_request_that_was_overtaken_counts_as_a_stop();
    a_new_set_up_cancels_a_power_off_that_was_due();
    a_newly_armed_drive_waits_for_the_core_to_enable_it_again();
    slow_requests_are_sent_in_the_first_cycle_and_then_by_turns();
    a_report_of_power_is_not_a_sample_of_a_joint();
    values_of_all_joints_of_a_drive_are_cleared_with_it();
    motion_in_the_second_frame_alone_waits_for_its_cycle();
    return checks_report("can bounds");
}
