/* SPDX-License-Identifier: Apache-2.0
 * How the line of a board ends, in virtual time: braked, switched off, silent. */
#include "board_wire.h"

static void the_end_is_braked_switched_off_and_silent(void)
{
    begin();
    arm_and_turn();
    w.machine.control.shut_down = 1;
    step();
    CHECK(w.peer.braking == 1 && w.peer.enabled == 0);
    go_on(100 * MS);
    CHECK(w.machine.end.stage == END_SILENT && w.peer.braking == 0 && last_sent(CONTROL, 1, 0) == CONTROL_OFF);
    uint32_t before = w.sent_count;
    request(DRIVE_ARMED);
    go_on(200 * MS);
    CHECK(w.sent_count == before && w.machine.state.mode == DRIVE_READY);
}

static void the_end_waits_for_the_wheels_and_for_its_last_frame(void)
{
    begin();
    arm_and_turn();
    w.stuck = true;
    w.machine.control.shut_down = 1;
    int64_t asked_ns = w.now_ns;
    step();
    go_on(340 * MS);
    CHECK(w.peer.braking == 1 && w.machine.end.stage == END_RESTING);
    (void)received_changes();
    go_on(20 * MS);
    CHECK(w.peer.braking == 0 && w.machine.end.stage >= END_POWER_OFF);
    while (w.machine.end.stage != END_SILENT) {
        go_on(MS);
    }
    CHECK(w.now_ns <= asked_ns + 480 * MS && w.now_ns >= w.machine.last_sent_ns + w.table.period_ns && received_changes());
    board_report report;
    board_machine_report(&w.machine, &report);
    CHECK(report.shut_down == 1 && report.mode == DRIVE_READY && report.sent == w.machine.sent);
}

static void the_end_comes_also_where_wheels_turn_and_nothing_goes_out(void)
{
    begin();
    arm_and_turn();
    w.stuck = w.full = true;
    w.machine.control.shut_down = 1;
    step();
    go_on(500 * MS);
    CHECK(w.machine.end.stage == END_SILENT);
}

/* Between the order to enable it and its arming. */
static void a_board_that_was_enabled_and_is_not_armed_is_switched_off(void)
{
    begin();
    set_up();
    w.machine.control.request.arming_until_ns = w.now_ns + 1000 * MS;
    order(CONTROL, 1, CONTROL_ENABLE, 1);
    CHECK(w.peer.enabled == 1 && w.machine.state.mode == DRIVE_READY);
    w.machine.control.shut_down = 1;
    step();
    CHECK(w.peer.enabled == 0 && last_sent(CONTROL, 1, 0) == CONTROL_OFF && w.machine.end.stage == END_POWER_OFF);
}

static void the_end_waits_no_longer_than_it_may(void)
{
    begin();
    arm_and_turn();
    w.stuck = w.full = true;
    w.machine.control.shut_down = 1;
    step();
    int64_t asked_ns = w.now_ns;
    w.now_ns = asked_ns + END_REST_NS;
    step();
    w.now_ns = asked_ns + END_OFF_NS - 1;
    step();
    CHECK(w.machine.end.stage == END_POWER_OFF);
    w.now_ns++;
    step();
    CHECK(w.machine.end.stage == END_SILENT);
}

int main(void)
{
    the_end_is_braked_switched_off_and_silent();
    the_end_waits_for_the_wheels_and_for_its_last_frame();
    the_end_comes_also_where_wheels_turn_and_nothing_goes_out();
    a_board_that_was_enabled_and_is_not_armed_is_switched_off();
    the_end_waits_no_longer_than_it_may();
    return checks_report("board end");
}
