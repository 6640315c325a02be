/* SPDX-License-Identifier: Apache-2.0
 * The end of a board's line in virtual time: the board is braked and switched off, and the line is
 * silent. */
#include "board_wire.h"

static void the_end_brakes_switches_off_and_is_silent(void)
{
    begin();
    arm_and_turn();
    w.machine.control.shut_down = 1;
    step();
    CHECK(w.peer.braking == 1 && w.peer.enabled == 0);
    go_on(100 * MS);
    CHECK(w.machine.end.stage == END_SILENT && w.peer.braking == 0 &&
          last_sent(CONTROL, 1, 0) == CONTROL_OFF);
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
    CHECK(w.now_ns <= asked_ns + 480 * MS &&
          w.now_ns >= w.machine.last_sent_ns + w.table.period_ns && received_changes());
    board_report report;
    board_machine_report(&w.machine, &report);
    CHECK(report.shut_down == 1 && report.mode == DRIVE_READY && report.sent == w.machine.sent);
}

static void the_end_comes_even_when_wheels_turn_and_nothing_can_be_sent(void)
{
    begin();
    arm_and_turn();
    w.stuck = w.full = true;
    w.machine.control.shut_down = 1;
    step();
    go_on(500 * MS);
    CHECK(w.machine.end.stage == END_SILENT);
}

/* The line ends after the order to enable the board, and before its arming. */
static void a_board_that_was_enabled_and_is_not_armed_is_switched_off(void)
{
    begin();
    set_up();
    w.machine.control.request.arming_until_ns = w.now_ns + 1000 * MS;
    order(CONTROL, 1, CONTROL_ENABLE, 1);
    CHECK(w.peer.enabled == 1 && w.machine.state.mode == DRIVE_READY);
    w.machine.control.shut_down = 1;
    step();
    CHECK(w.peer.enabled == 0 && last_sent(CONTROL, 1, 0) == CONTROL_OFF &&
          w.machine.end.stage == END_POWER_OFF);
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

/* Shuts the line down and waits until it is silent. The wire is cut until `cut_until_ns`. */
static board_report ends(int64_t cut_until_ns)
{
    board_report report;
    w.machine.control.shut_down = 1;
    while (w.machine.end.stage != END_SILENT) {
        w.mute = w.receives_nothing = w.now_ns < cut_until_ns;
        go_on(MS);
    }
    board_machine_report(&w.machine, &report);
    return report;
}

static void a_board_that_was_seen_without_power_is_not_waited_for(void)
{
    begin();
    set_up();
    go_on(100 * MS);
    CHECK(w.machine.state.enabled == 0);
    int64_t asked_ns = w.now_ns;
    CHECK(ends(INT64_MAX).stop_waits == 0 && w.now_ns < asked_ns + 2 * w.table.period_ns + 10 * MS);
}

/* The wire of a board that turns is cut. Returns the time, when the board is unresponsive on
 * request. */
static int64_t cut_off(bool unresponsive)
{
    begin();
    arm_and_turn();
    w.mute = w.receives_nothing = true;
    while (unresponsive && w.machine.state.mode != DRIVE_UNRESPONSIVE) {
        go_on(MS);
    }
    return w.now_ns;
}

static void a_board_that_is_cut_off_for_a_while_is_sent_its_power_off_until_it_receives_it(void)
{
    for (int unresponsive = 0; unresponsive < 2; unresponsive++) {
        int64_t asked_ns = cut_off(unresponsive != 0);
        CHECK(ends(asked_ns + 150 * MS).stop_waits == 0 && w.peer.enabled == 0);
        CHECK(w.now_ns > asked_ns + 150 * MS && w.now_ns < asked_ns + END_OFF_NS);
    }
}

static void a_board_that_does_not_confirm_its_power_off_is_reported(void)
{
    for (int unresponsive = 0; unresponsive < 2; unresponsive++) {
        int64_t asked_ns = cut_off(unresponsive != 0);
        CHECK(ends(INT64_MAX).stop_waits == 1);
        CHECK(w.now_ns >= asked_ns + END_OFF_NS && w.now_ns < asked_ns + END_OFF_NS + 30 * MS);
    }
}

static void the_end_waits_a_little_longer_for_a_board_that_sends_and_does_not_receive(void)
{
    begin();
    arm_and_turn();
    w.stuck = true;
    w.receives_nothing = true;
    int64_t asked_ns = w.now_ns;
    w.machine.control.shut_down = 1;
    while (w.machine.end.stage != END_SILENT) {
        go_on(MS);
    }
    CHECK(w.machine.off_waits && w.now_ns >= asked_ns + END_OFF_NS + 500 * MS &&
          w.now_ns < asked_ns + END_OFF_NS + 530 * MS);
}

/* The time of the end is over. The power-off has been sent, and the board has been silent for
 * `silent_ns`. */
static void ends_after_a_silence_of(int64_t silent_ns)
{
    begin();
    arm_and_turn();
    w.stuck = w.receives_nothing = true;
    w.machine.control.shut_down = 1;
    step();
    go_on(END_REST_NS + 20 * MS);
    CHECK(w.machine.end.stage == END_POWER_OFF && w.machine.off_first_ns > 0);
    w.now_ns = w.machine.end.off_by_ns;
    w.machine.received_ns = w.now_ns - silent_ns;
    step();
}

static void the_end_waits_for_a_board_until_it_is_unresponsive(void)
{
    ends_after_a_silence_of(150 * MS);
    CHECK(w.machine.end.stage == END_POWER_OFF && w.machine.state.mode == DRIVE_READY);
    ends_after_a_silence_of(150 * MS + 1);
    CHECK(w.machine.end.stage == END_SILENT && w.machine.state.mode == DRIVE_UNRESPONSIVE);
}

static void the_end_waits_half_a_second_longer_for_a_board_that_sends(void)
{
    ends_after_a_silence_of(0);
    w.now_ns = w.machine.received_ns = w.machine.end.off_by_ns + 500 * MS - 1;
    step();
    CHECK(w.machine.end.stage == END_POWER_OFF);
    w.now_ns++;
    step();
    CHECK(w.machine.end.stage == END_SILENT && w.machine.off_waits);
}

int main(void)
{
    a_board_that_was_seen_without_power_is_not_waited_for();
    a_board_that_is_cut_off_for_a_while_is_sent_its_power_off_until_it_receives_it();
    a_board_that_does_not_confirm_its_power_off_is_reported();
    the_end_waits_a_little_longer_for_a_board_that_sends_and_does_not_receive();
    the_end_waits_for_a_board_until_it_is_unresponsive();
    the_end_waits_half_a_second_longer_for_a_board_that_sends();
    the_end_brakes_switches_off_and_is_silent();
    the_end_waits_for_the_wheels_and_for_its_last_frame();
    the_end_comes_even_when_wheels_turn_and_nothing_can_be_sent();
    a_board_that_was_enabled_and_is_not_armed_is_switched_off();
    the_end_waits_no_longer_than_it_may();
    return checks_report("board end");
}
