/* SPDX-License-Identifier: Apache-2.0
 * A drive turns, and the CAN bus takes no frames when the drive has to be stopped. */
#include "can_wire.h"

static void drive_off_on_a_full_bus(void)
{
    begin_with(1);
    arm(0);
    go_on(30 * MS);
    CHECK(speed_in(newest_of(0)) == 100);
    forget_sent();
    w.full = true;
}

static void standing_down_sends_zero_at_once_to_a_drive_that_is_sent_nothing_at_rest(void)
{
    begin_with(1);
    w.table.drive[0].idle_setpoints = 0;
    restart();
    arm(0);
    go_on(30 * MS);
    forget_sent();
    request(0, DRIVE_STAND_DOWN);
    CHECK(w.sent_count == 1 && speed_in(newest_of(0)) == 0);
    /* Python is arming the drive, and takes its power itself: no more frames */
    w.machine.control.drive[0].arming_until_ns = INT64_MAX;
    go_on(50 * MS);
    CHECK(count_sent(SPEED) == 1);
}

static void switching_off_a_drive_that_has_not_received_zero_takes_its_power(void)
{
    drive_off_on_a_full_bus();
    request(0, DRIVE_STAND_DOWN);
    request(0, DRIVE_OFF);
    w.full = false;
    go_on(2 * MS);
    CHECK(first_sent_ns(0, DISABLE) > 0 && speed_in(newest_of(0)) == 0);
}

static void a_pending_stop_outlives_a_new_set_up(void)
{
    drive_off_on_a_full_bus();
    request(0, DRIVE_OFF);
    request(0, DRIVE_READY);
    request(0, DRIVE_ARMED);
    CHECK(w.machine.drive[0].state.mode == DRIVE_READY); /* not before the pending stop is sent */
    w.full = false;
    go_on(2 * MS);
    CHECK(first_sent_ns(0, DISABLE) > 0 && speed_in(newest_of(0)) == 0);
}

static void a_stop_that_a_newer_request_overtook_is_still_carried_out(void)
{
    drive_off_on_a_full_bus();
    w.full = false;
    w.machine.control.drive[0].count++; /* a STAND_DOWN or OFF that the next request has replaced */
    request(0, DRIVE_ARMED);
    CHECK(w.machine.drive[0].state.mode == DRIVE_READY);
    go_on(2 * MS);
    CHECK(first_sent_ns(0, DISABLE) > 0 && speed_in(newest_of(0)) == 0);
}

static void an_unresponsive_drive_is_sent_its_stop_in_each_cycle_until_the_bus_takes_it(void)
{
    drive_off_on_a_full_bus();
    w.silent = true;
    go_on(330 * MS);
    CHECK(w.machine.drive[0].state.mode == DRIVE_UNRESPONSIVE);
    w.full = false;
    int64_t taken_ns = w.now_ns;
    go_on(12 * MS);
    CHECK(first_sent_ns(0, QUICK_STOP) >= taken_ns && speed_in(newest_of(0)) == 0);
}

static void a_drive_that_falls_silent_after_a_lost_set_up_is_stopped(void)
{
    drive_off_on_a_full_bus();
    request(0, DRIVE_OFF);
    request(0, DRIVE_READY);
    w.silent = true;
    go_on(330 * MS);
    CHECK(w.machine.drive[0].state.mode == DRIVE_UNRESPONSIVE);
    w.full = false;
    go_on(12 * MS);
    CHECK(first_sent_ns(0, QUICK_STOP) > 0 && speed_in(newest_of(0)) == 0);
}

static void a_drive_that_was_armed_is_stopped_after_a_reopening_even_when_it_is_silent(void)
{
    begin_with(2);
    arm(0);
    go_on(30 * MS);
    w.silent = true;
    restart();
    forget_sent();
    int64_t opened_ns = w.now_ns;
    go_on(12 * MS);
    CHECK(w.machine.drive[0].state.mode == DRIVE_OFF);
    CHECK(first_sent_ns(0, QUICK_STOP) >= opened_ns && speed_in(newest_of(0)) == 0);
    CHECK(count_sent(SPEED + 1) == 0); /* this drive was never armed */
    go_on(2500 * MS);
    CHECK(first_sent_ns(0, DISABLE) > opened_ns);
    w.silent = false;
    go_on(100 * MS);
    forget_sent();
    go_on(2500 * MS);
    CHECK(count_sent(SPEED) == 0); /* the stop was received; now Python has to set the drive up */
    request(0, DRIVE_READY);
    restart();
    forget_sent();
    go_on(100 * MS);
    CHECK(count_sent(SPEED) == 0); /* the drive has not been turning since then */
}

/* ---------------------------------------------------- frames in the queue of a dead bus */
static uint32_t moving(uint32_t drive)
{
    uint32_t count = 0;
    for (uint32_t i = 0; i < w.sent_count; i++) {
        count += w.sent[i].id == SPEED + drive && speed_in(&w.sent[i]) != 0;
    }
    return count;
}

static void turning(uint32_t drives)
{
    begin_with(drives);
    for (uint32_t i = 0; i < drives; i++) {
        arm(i);
    }
    go_on(30 * MS);
    for (uint32_t i = 0; i < drives; i++) {
        CHECK(speed_in(newest_of(i)) == 100);
    }
    forget_sent();
}

static void a_bus_that_took_nothing_for_a_cycle_is_given_zero_first_and_then_the_newest(void)
{
    turning(2);
    w.machine.receives_own = true;
    w.full = true;
    go_on(40 * MS);
    w.full = false;
    w.velocity_rad_s = 2.0;
    while (w.sent_count == 0) {
        go_on(MS);
    }
    CHECK(moving(0) == 0 && moving(1) == 0);
    can_machine_left(&w.machine, SPEED);
    go_on(10 * MS);
    CHECK(speed_in(newest_of(0)) == 200 && speed_in(newest_of(1)) == 200 &&
          state_of(0)->state.mode == DRIVE_ARMED);
}

static void a_bus_that_takes_some_frames_of_a_cycle_is_given_motion(void)
{
    turning(2);
    w.machine.receives_own = true;
    can_machine_left(&w.machine, SPEED);
    w.not_taken = SPEED;
    for (uint32_t i = 0; i < 20; i++) {
        go_on(5 * MS);
        can_machine_left(&w.machine, SPEED);
    }
    CHECK(moving(1) == count_sent(SPEED + 1) && moving(1) >= 9);
}

static void at_most_two_cycles_of_motion_wait_in_the_kernel_followed_by_zero(void)
{
    turning(2);
    can_machine_left(&w.machine, SPEED);
    w.machine.receives_own = true; /* no frame is reported to have left any more */
    go_on(150 * MS);
    for (uint32_t i = 0; i < 2; i++) {
        CHECK(moving(i) >= 1 && moving(i) <= 2 && speed_in(newest_of(i)) == 0 &&
              state_of(i)->state.mode == DRIVE_ARMED);
    }
    CHECK(w.machine.tx_full >= 10); /* another node can see that the bus is blocked */
    can_machine_left(&w.machine, SPEED);
    forget_sent();
    go_on(10 * MS);
    CHECK(speed_in(newest_of(0)) == 100 && speed_in(newest_of(1)) == 100);
}

static void motion_that_leaves_in_its_cycle_continues(void)
{
    turning(1);
    w.machine.receives_own = true;
    can_machine_left(&w.machine, SPEED);
    for (uint32_t i = 0; i < 50; i++) {
        go_on(9 * MS);
        can_machine_left(&w.machine, SPEED);
        go_on(MS);
    }
    CHECK(moving(0) == count_sent(SPEED) && moving(0) >= 49);
}

/* A USB adapter reports later than one cycle of 1 ms that a frame has left. */
static void motion_reported_some_milliseconds_late_continues(void)
{
    turning(1);
    w.machine.table.period_ns = MS;
    w.machine.receives_own = true;
    go_on(10 * MS);
    can_machine_left(&w.machine, SPEED);
    forget_sent();
    for (uint32_t i = 0; i < 20; i++) {
        go_on(3 * MS);
        can_machine_left(&w.machine, SPEED);
    }
    CHECK(moving(0) == count_sent(SPEED) && moving(0) >= 50);
}

static void drives_that_another_program_left_running_stop_before_they_lose_their_power(void)
{
    begin_with(2);
    w.powered = true;
    w.reported_rad_s = 1.0;
    can_take_over(&w.machine, w.now_ns);
    go_on(500 * MS);
    for (uint32_t i = 0; i < 2; i++) {
        CHECK(state_of(i)->state.mode == DRIVE_READY && state_of(i)->state.stopping &&
              state_of(i)->may_turn);
        CHECK(state_of(i)->state.fault_reasons == 0);
    }
    CHECK(!state_of(2)->may_turn && !state_of(2)->state.stopping); /* the table has no third
                                                                      drive */
    for (uint32_t i = 0; i < w.sent_count; i++) {
        /* speed 0 */
        CHECK(w.sent[i].data[0] == QUICK_STOP && w.sent[i].data[2] == 0 && w.sent[i].data[3] == 0);
    }
    CHECK(count_sent(SPEED) > 2 && count_sent(SPEED + 1) > 2);
    w.reported_rad_s = 0.0;
    forget_sent();
    go_on(30 * MS);
    CHECK(w.sent_count > 0 && w.sent[w.sent_count - 1].data[0] == DISABLE);
    CHECK(!state_of(0)->state.stopping && !state_of(1)->state.stopping);
}

static void a_silent_drive_left_running_is_stopped_repeatedly_after_its_time_of_silence(void)
{
    begin_with(1);
    w.silent = true;
    can_take_over(&w.machine, w.now_ns);
    go_on(190 * MS);
    CHECK(state_of(0)->state.mode == DRIVE_READY &&
          state_of(0)->last_sent_ns >= w.now_ns - 11 * MS);
    go_on(210 * MS);
    CHECK(state_of(0)->state.mode == DRIVE_UNRESPONSIVE);
    forget_sent();
    go_on(500 * MS);
    CHECK(count_sent(SPEED) > 1 && w.sent[0].data[0] == QUICK_STOP);
}

/* ------------------------------------------------ confirmed by the drive's own report */
static void a_drive_that_is_back_gets_its_power_off_again_until_it_reports_no_power(void)
{
    begin_with(1);
    arm_and_go();
    become_unresponsive();
    go_on(1200 * MS); /* its probes take its power by now */
    forget_sent();
    w.silent = false; /* it still has power: the first power-off is lost */
    go_on(100 * MS);
    can_report report;
    can_machine_report(&w.machine, &report);
    CHECK(state_of(0)->state.mode == DRIVE_BACK && report.drive[0].stop_waits == 1);
    uint32_t stops = state_of(0)->stops, offs = count_sent(SPEED);
    CHECK(offs >= 5 && offs <= 12 && newest_of(0)->data[0] == DISABLE);
    w.powered = false;
    go_on(30 * MS);
    can_machine_report(&w.machine, &report);
    CHECK(report.drive[0].stop_waits == 0 && state_of(0)->stops == stops);
    forget_sent();
    go_on(500 * MS);
    CHECK(w.sent_count == 0 && state_of(0)->state.mode == DRIVE_BACK);
    w.powered = true; /* it was switched on by another: not by a lost power-off */
    go_on(100 * MS);
    CHECK(w.sent_count == 0);
}

static void a_drive_switched_off_by_request_gets_its_power_off_again_too(void)
{
    begin_with(1);
    arm_and_go();
    forget_sent();
    request(0, DRIVE_OFF);
    go_on(100 * MS);
    CHECK(state_of(0)->state.mode == DRIVE_OFF && count_sent(SPEED) >= 5);
    request(0, DRIVE_READY); /* set up again: from here on READY's own rule holds */
    can_report report;
    can_machine_report(&w.machine, &report);
    CHECK(report.drive[0].stop_waits == 0);
}

static void a_drive_whose_report_is_polled_is_polled_until_it_confirms_its_power_off(void)
{
    begin_with(1);
    table_of(0)->poll_count = 1;
    table_of(0)->poll[0] = packet_of(CONTROL, 0);
    restart();
    arm_and_go();
    become_unresponsive();
    go_on(1200 * MS); /* its probes take its power by now */
    w.silent = false;
    go_on(50 * MS);
    CHECK(state_of(0)->state.mode == DRIVE_BACK);
    forget_sent();
    go_on(50 * MS);
    CHECK(count_sent(CONTROL) >= 4);
    w.silent = true; /* no answer: its silence ends the polls */
    go_on(400 * MS);
    forget_sent();
    go_on(100 * MS);
    CHECK(count_sent(CONTROL) == 0);
    w.silent = w.powered = false;
    go_on(50 * MS);
    forget_sent();
    go_on(100 * MS);
    CHECK(w.sent_count == 0);
}

static void a_drive_that_cannot_report_its_power_gets_it_once(void)
{
    begin_with(1);
    table_of(0)->reports_enabled = 0;
    restart();
    arm_and_go();
    become_unresponsive();
    go_on(1200 * MS); /* its probes take its power by now */
    forget_sent();
    w.silent = false;
    go_on(100 * MS);
    can_report report;
    can_machine_report(&w.machine, &report);
    CHECK(state_of(0)->state.mode == DRIVE_BACK && count_sent(SPEED) == 1 &&
          report.drive[0].stop_waits == 0);
}

int main(void)
{
    drives_that_another_program_left_running_stop_before_they_lose_their_power();
    a_silent_drive_left_running_is_stopped_repeatedly_after_its_time_of_silence();
    a_bus_that_took_nothing_for_a_cycle_is_given_zero_first_and_then_the_newest();
    a_bus_that_takes_some_frames_of_a_cycle_is_given_motion();
    at_most_two_cycles_of_motion_wait_in_the_kernel_followed_by_zero();
    motion_that_leaves_in_its_cycle_continues();
    motion_reported_some_milliseconds_late_continues();
    a_drive_that_was_armed_is_stopped_after_a_reopening_even_when_it_is_silent();
    standing_down_sends_zero_at_once_to_a_drive_that_is_sent_nothing_at_rest();
    switching_off_a_drive_that_has_not_received_zero_takes_its_power();
    a_pending_stop_outlives_a_new_set_up();
    a_stop_that_a_newer_request_overtook_is_still_carried_out();
    an_unresponsive_drive_is_sent_its_stop_in_each_cycle_until_the_bus_takes_it();
    a_drive_that_falls_silent_after_a_lost_set_up_is_stopped();
    a_drive_that_is_back_gets_its_power_off_again_until_it_reports_no_power();
    a_drive_switched_off_by_request_gets_its_power_off_again_too();
    a_drive_whose_report_is_polled_is_polled_until_it_confirms_its_power_off();
    a_drive_that_cannot_report_its_power_gets_it_once();
    return checks_report("can stops");
}
