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
    (void)received_news();
    go_on(20 * MS);
    CHECK(w.peer.braking == 0 && w.machine.end.stage >= END_POWER_OFF);
    while (w.machine.end.stage != END_SILENT) {
        go_on(MS);
    }
    CHECK(w.now_ns <= asked_ns + 480 * MS && w.now_ns >= w.machine.last_sent_ns + w.table.period_ns && received_news());
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

int main(void)
{
    the_end_is_braked_switched_off_and_silent();
    the_end_waits_for_the_wheels_and_for_its_last_frame();
    the_end_comes_also_where_wheels_turn_and_nothing_goes_out();
    return checks_report("board end");
}
