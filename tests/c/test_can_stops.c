/* SPDX-License-Identifier: Apache-2.0
 * A drive that turns, and a bus that takes nothing just when it has to be stopped. */
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

static void standing_down_tells_zero_at_once_to_a_drive_that_is_told_nothing_at_rest(void)
{
    begin_with(1);
    w.table.drive[0].idle_setpoints = 0;
    restart();
    arm(0);
    go_on(30 * MS);
    forget_sent();
    wish(0, DRIVE_STAND_DOWN);
    CHECK(w.sent_count == 1 && speed_in(newest_of(0)) == 0);
    w.machine.control.drive[0].arming_until_ns = INT64_MAX;   /* its power is Python's to take: nothing more is said */
    go_on(50 * MS);
    CHECK(count_sent(SPEED) == 1);
}

static void switching_off_one_that_has_not_heard_its_zero_takes_its_power(void)
{
    drive_off_on_a_full_bus();
    wish(0, DRIVE_STAND_DOWN);
    wish(0, DRIVE_OFF);
    w.full = false;
    go_on(2 * MS);
    CHECK(told_ns(0, DISABLE) > 0 && speed_in(newest_of(0)) == 0);
}

static void a_stop_that_waits_outlives_a_new_set_up(void)
{
    drive_off_on_a_full_bus();
    wish(0, DRIVE_OFF);
    wish(0, DRIVE_READY);
    wish(0, DRIVE_ARMED);
    CHECK(w.machine.drive[0].mode == DRIVE_READY);   /* not before it has been stopped */
    w.full = false;
    go_on(2 * MS);
    CHECK(told_ns(0, DISABLE) > 0 && speed_in(newest_of(0)) == 0);
}

static void a_quiet_drive_is_told_to_stop_in_each_cycle_until_the_bus_takes_it(void)
{
    drive_off_on_a_full_bus();
    w.silent = true;
    go_on(330 * MS);
    CHECK(w.machine.drive[0].mode == DRIVE_QUIET);
    w.full = false;
    int64_t taken_ns = w.now_ns;
    go_on(12 * MS);
    CHECK(told_ns(0, QUICK_STOP) >= taken_ns && speed_in(newest_of(0)) == 0);
}

static void one_that_falls_silent_after_a_set_up_it_did_not_hear_is_told_to_stop(void)
{
    drive_off_on_a_full_bus();
    wish(0, DRIVE_OFF);
    wish(0, DRIVE_READY);
    w.silent = true;
    go_on(330 * MS);
    CHECK(w.machine.drive[0].mode == DRIVE_QUIET);
    w.full = false;
    go_on(12 * MS);
    CHECK(told_ns(0, QUICK_STOP) > 0 && speed_in(newest_of(0)) == 0);
}

static void one_that_was_armed_is_told_to_stop_over_a_reopening_though_nobody_hears_it(void)
{
    begin_with(2);
    arm(0);
    go_on(30 * MS);
    w.silent = true;
    restart();
    forget_sent();
    int64_t opened_ns = w.now_ns;
    go_on(12 * MS);
    CHECK(w.machine.drive[0].mode == DRIVE_OFF);
    CHECK(told_ns(0, QUICK_STOP) >= opened_ns && speed_in(newest_of(0)) == 0);
    CHECK(count_sent(SPEED + 1) == 0);   /* it was never armed */
    go_on(2500 * MS);
    CHECK(told_ns(0, DISABLE) > opened_ns);
    w.silent = false;
    go_on(100 * MS);
    forget_sent();
    go_on(2500 * MS);
    CHECK(count_sent(SPEED) == 0);   /* heard: its set-up is Python's */
    wish(0, DRIVE_READY);
    restart();
    forget_sent();
    go_on(100 * MS);
    CHECK(count_sent(SPEED) == 0);   /* and since then it does not turn */
}

int main(void)
{
    one_that_was_armed_is_told_to_stop_over_a_reopening_though_nobody_hears_it();
    standing_down_tells_zero_at_once_to_a_drive_that_is_told_nothing_at_rest();
    switching_off_one_that_has_not_heard_its_zero_takes_its_power();
    a_stop_that_waits_outlives_a_new_set_up();
    a_quiet_drive_is_told_to_stop_in_each_cycle_until_the_bus_takes_it();
    one_that_falls_silent_after_a_set_up_it_did_not_hear_is_told_to_stop();
    return checks_report("can stops");
}
