/* SPDX-License-Identifier: Apache-2.0
 * A CAN bus between its cycles: the time of the next look, jobs that wait, notifications of
 * asyncio, and an end with several drives. */
#include "can_wire.h"

static void begin_with_a_slow_cycle(void)
{
    begin_with(3);
    w.table.period_ns = 1000 * MS;
    for (uint32_t i = 0; i < 3; i++) {
        table_of(i)->watchdog_ns = 0;
    }
    restart();
}

static int64_t next_look_ns(void)
{
    step();
    return w.wake_ns - w.now_ns;
}

static void a_moving_drive_is_checked_often_and_a_pending_stop_more_often(void)
{
    begin_with_a_slow_cycle();
    go_on(20 * MS);
    CHECK(next_look_ns() == 20 * MS);
    arm(2); /* the last of the three */
    w.machine.cycle.due_ns = w.now_ns + 500 * MS;
    CHECK(!state_of(2)->state.sent_motion && next_look_ns() == 5 * MS);
    w.machine.cycle.due_ns = w.now_ns;
    step();
    CHECK(state_of(2)->state.sent_motion && next_look_ns() == 5 * MS);
    w.full = true;
    w.enabled = 0;
    CHECK(next_look_ns() == MS && state_of(2)->state.mode == DRIVE_READY);
    w.full = false;
    CHECK(next_look_ns() == 20 * MS && !state_of(2)->state.sent_motion);
}

static void jobs_wait_in_order_and_are_checked_often(void)
{
    begin_with_a_slow_cycle();
    const uint32_t ids[3] = {CONTROL, CONTROL + 1, CONTROL + 2};
    for (uint32_t i = 0; i < 3; i++) {
        can_order order = {.write = {.packet = packet_of(ids[i], 1)},
                           .drive = i,
                           .expires_ns = w.now_ns + 1000 * MS};
        CHECK(can_machine_order(&w.machine, &order));
    }
    w.not_taken = CONTROL + 1;
    w.machine.notify = false;
    CHECK(next_look_ns() == MS && w.sent_count == 1 && w.sent[0].id == CONTROL && w.machine.notify);
    w.machine.notify = false;
    step();
    CHECK(!w.machine.notify && w.machine.order_count == 2);
    w.not_taken = 0;
    CHECK(next_look_ns() == 20 * MS && w.sent_count == 3 && w.sent[1].id == CONTROL + 1 &&
          w.sent[2].id == CONTROL + 2);
    CHECK(w.machine.notify && state_of(1)->orders_sent == 1 && w.machine.order_count == 0);
}

static void the_end_waits_until_the_last_drive_is_at_rest(void)
{
    begin_with(3);
    arm(2);
    for (uint32_t i = 0; i < 3; i++) {
        report_motion(i, 1.0F, 0.0F);
    }
    w.silent = true; /* from here on the test sends all reports */
    go_on(30 * MS);
    report_motion(2, 1.0F, 5.0F);
    forget_sent();
    w.machine.control.shut_down = 1;
    step();
    CHECK(first_sent_ns(2, QUICK_STOP) > 0);
    go_on(100 * MS);
    CHECK(w.machine.end.stage == END_RESTING && first_sent_ns(2, DISABLE) == 0);
    report_motion(2, 1.0F, 0.0F);
    go_on(12 * MS);
    CHECK(w.machine.end.stage == END_POWER_OFF);
    for (uint32_t i = 0; i < 3; i++) {
        report_state(i, 1);
    }
    w.machine.notify = false;
    go_on(12 * MS);
    CHECK(w.machine.end.stage == END_SILENT && w.machine.notify);
    for (uint32_t i = 0; i < 3; i++) {
        CHECK(first_sent_ns(i, DISABLE) > 0);
    }
}

static void asyncio_is_notified_of_errors_and_of_frames_that_it_listens_to(void)
{
    begin_with(2);
    const uint8_t error[8] = {0};
    w.machine.notify = false;
    CHECK(say(CAN_ID_ERROR | 0x40, error, 8) == CAN_DRIVES_MAX && w.machine.notify);
    w.machine.notify = false;
    report_state(1, 1);
    CHECK(!w.machine.notify);
    w.machine.control.listen = 2;
    report_state(0, 1);
    CHECK(!w.machine.notify);
    report_state(1, 1);
    CHECK(w.machine.notify);
}

static void the_report_has_the_counters_of_the_bus(void)
{
    begin_with(2);
    arm(1);
    go_on(200 * MS);
    w.full = true;
    go_on(20 * MS);
    const uint8_t nothing[2] = {0};
    (void)say(MOTION, nothing, 2);
    can_report report = {0};
    can_machine_report(&w.machine, &report);
    CHECK(report.cycles == w.machine.cycle.count && report.cycles >= 20 &&
          report.cycle_ns == 10 * MS);
    CHECK(report.received == report.drive[0].received + report.drive[1].received &&
          report.drive[1].received >= 40);
    CHECK(report.sent == w.sent_count && report.tx_full >= 2 && report.bad_frames == 1 &&
          report.shut_down == 0);
    CHECK(report.setpoints_ns == w.machine.newest.stamp_ns &&
          report.drive[1].received_ns == state_of(1)->newest_ns);
    CHECK(report.drive[1].received_ns > 0 && report.drive[1].mode == DRIVE_ARMED &&
          report.drive[0].mode == DRIVE_OFF);
    w.full = w.powered = false;
    w.machine.control.shut_down = 1;
    go_on(500 * MS);
    can_machine_report(&w.machine, &report);
    CHECK(report.shut_down == 1);
}

static void the_time_between_two_cycles_is_smoothed_over_eight(void)
{
    begin_with(1);
    const int64_t took_ms[] = {10, 18, 3}, smoothed_ms[] = {10, 11, 10};
    for (uint32_t i = 0; i < 3; i++) {
        w.machine.cycle.start_ns = w.now_ns - took_ms[i] * MS;
        w.machine.cycle.due_ns = w.now_ns;
        step();
        CHECK(w.machine.cycle.took_ns == smoothed_ms[i] * MS &&
              w.machine.cycle.start_ns == w.now_ns);
    }
}

static void a_waiting_order_is_checked_often_and_the_ninth_is_refused(void)
{
    begin_with(1);
    w.table.period_ns = 1000 * MS;
    restart();
    step();
    w.full = true;
    can_order order = {.write = {.packet = packet_of(CONTROL, 1)},
                       .expires_ns = w.now_ns + 50 * MS};
    CHECK(can_machine_order(&w.machine, &order));
    step();
    CHECK(w.wake_ns == w.now_ns + MS);
    for (uint32_t i = 1; i < CAN_WAITING_MAX; i++) {
        CHECK(can_machine_order(&w.machine, &order));
    }
    CHECK(!can_machine_order(&w.machine, &order) && w.machine.order_count == CAN_WAITING_MAX);
    w.now_ns = order.expires_ns; /* the orders expire */
    w.full = false;
    step();
    CHECK(count_sent(CONTROL) == 0 && state_of(0)->orders_dropped == CAN_WAITING_MAX);
}

static void the_first_drive_of_a_slow_bus_is_checked_often_while_it_moves_or_stops(void)
{
    begin_with(2);
    w.table.period_ns = 1000 * MS;
    table_of(0)->watchdog_ns = 0;
    restart();
    arm(0);
    w.machine.cycle.due_ns = w.now_ns + 500 * MS;
    step();
    CHECK(w.wake_ns == w.now_ns + 5 * MS);
    w.reported_rad_s = 1.0;
    report_motion(0, 1.0F, 1.0F);
    w.enabled = 2;
    w.now_ns += 101 * MS; /* old set-points: the drive comes to rest, and was sent no motion yet */
    report_state(0, 8);
    step();
    CHECK(state_of(0)->state.stopping && !state_of(0)->state.sent_motion &&
          w.wake_ns == w.now_ns + 5 * MS);
}

int main(void)
{
    a_moving_drive_is_checked_often_and_a_pending_stop_more_often();
    jobs_wait_in_order_and_are_checked_often();
    the_end_waits_until_the_last_drive_is_at_rest();
    asyncio_is_notified_of_errors_and_of_frames_that_it_listens_to();
    the_report_has_the_counters_of_the_bus();
    the_time_between_two_cycles_is_smoothed_over_eight();
    a_waiting_order_is_checked_often_and_the_ninth_is_refused();
    the_first_drive_of_a_slow_bus_is_checked_often_while_it_moves_or_stops();
    return checks_report("can looks");
}
