/* SPDX-License-Identifier: Apache-2.0
 * One drive of a CAN bus: how it is polled, when it counts as unresponsive, and which frames it is
 * sent then, because it may still receive. */
#include "can_wire.h"

enum { ASK = 0x600, SLOW = 0x610, PROBE = 0x620 };

static void begin_with_polls(void)
{
    begin_with(1);
    can_drive *drive = table_of(0);
    drive->poll_count = 2;
    drive->probe_count = 1;
    drive->slow_count = 2;
    drive->poll[0] = packet_of(ASK, 0);
    drive->poll[1] = packet_of(ASK + 1, 0);
    drive->slow[0] = packet_of(SLOW, 0);
    drive->slow[1] = packet_of(SLOW + 1, 0);
    drive->probe[0] = packet_of(PROBE, 0);
    restart();
    go_on(20 * MS);
    request(0, DRIVE_READY);
}

static void a_drive_is_polled_in_each_cycle_and_slow_requests_take_turns(void)
{
    begin_with_polls();
    go_on(320 * MS - (w.now_ns - w.sent_ns[0]));
    CHECK(count_sent(ASK) == 32 && count_sent(ASK + 1) == 32 && count_sent(SPEED) == 32 &&
          count_sent(PROBE) == 0);
    CHECK(count_sent(SLOW) == 2 && count_sent(SLOW + 1) == 2);
    uint32_t first = 0;
    while (w.sent[first].id != SLOW) {
        CHECK(w.sent[first++].id != SLOW + 1);
    }
}

static void an_unresponsive_drive_is_probed_less_and_less_often(void)
{
    begin_with_polls();
    for (uint32_t again = 0; again < 2; again++) {
        w.silent = true;
        while (state_of(0)->state.mode != DRIVE_UNRESPONSIVE) {
            forget_sent();
            go_on(MS);
        }
        go_on(10000 * MS);
        CHECK(count_sent(PROBE) >= 8 && w.sent_count == count_sent(PROBE));
        const int64_t pauses_ms[] = {100, 200, 400, 800, 1600, 2000, 2000};
        for (uint32_t i = 0; i < 7; i++) {
            int64_t pause_ns = w.sent_ns[i + 1] - w.sent_ns[i];
            CHECK(pause_ns >= pauses_ms[i] * MS && pause_ns <= (pauses_ms[i] + 10) * MS);
        }
        w.silent = false;
        go_on(50 * MS);
        request(0, DRIVE_READY);
        CHECK(state_of(0)->state.mode == DRIVE_READY && state_of(0)->unresponsive == again + 1);
    }
}

static void
an_unresponsive_drive_that_may_turn_gets_zero_and_quick_stops_and_is_off_after_a_second(void)
{
    begin_with(1);
    arm_and_go();
    w.silent = true;
    while (state_of(0)->state.mode == DRIVE_ARMED) {
        go_on(MS);
    }
    forget_sent();
    int64_t unresponsive_ns = w.now_ns;
    go_on(950 * MS);
    CHECK(first_sent_ns(0, QUICK_STOP) > 0 && first_sent_ns(0, DISABLE) == 0 &&
          !state_of(0)->state.sent_motion);
    for (uint32_t i = 0; i < w.sent_count; i++) {
        CHECK(speed_in(&w.sent[i]) == 0);
    }
    go_on(1000 * MS);
    CHECK(first_sent_ns(0, DISABLE) > unresponsive_ns + 1000 * MS);
}

static void a_probe_that_the_bus_took_in_part_is_sent_again_in_the_next_cycle(void)
{
    begin_with(1);
    can_drive *drive = table_of(0);
    drive->quick_stop_count = 2;
    drive->quick_stop[1] = drive->quick_stop[0];
    drive->quick_stop[0] = (can_write){.packet = packet_of(CONTROL, 1)}; /* the bus does not take
                                                                            this one */
    restart();
    arm_and_go();
    w.not_taken = CONTROL;
    become_unresponsive();
    forget_sent();
    go_on(50 * MS);
    CHECK(count_sent(SPEED) >= 8); /* two in each cycle: stop and zero */
    w.not_taken = 0;
    go_on(12 * MS);
    CHECK(count_sent(CONTROL) == 1);
    forget_sent();
    go_on(50 * MS);
    CHECK(w.sent_count == 0);
}

static void
an_unresponsive_drive_is_sent_to_stop_in_each_cycle_until_the_bus_has_taken_its_zero(void)
{
    begin_with(1);
    table_of(0)->quick_stop[0] = (can_write){.packet = packet_of(CONTROL, 1)};
    restart();
    arm_and_go();
    w.not_taken = SPEED;
    become_unresponsive();
    forget_sent();
    go_on(50 * MS);
    CHECK(count_sent(CONTROL) >= 4 && state_of(0)->state.sent_motion);
    w.not_taken = 0;
    go_on(12 * MS);
    CHECK(speed_in(newest_of(0)) == 0 && !state_of(0)->state.sent_motion);
}

static void a_drive_switched_off_while_it_came_back_stays_off(void)
{
    begin_with(1);
    arm_and_go();
    become_unresponsive();
    w.silent = w.powered = false;
    w.full = true;
    go_on(30 * MS);
    CHECK(state_of(0)->state.mode == DRIVE_BACK);
    request(0, DRIVE_OFF);
    w.full = false;
    go_on(30 * MS);
    CHECK(state_of(0)->state.mode == DRIVE_OFF && first_sent_ns(0, DISABLE) > 0);
}

static void a_request_of_off_does_not_end_the_stops_of_an_unresponsive_drive(void)
{
    begin_with(1);
    arm_and_go();
    become_unresponsive();
    go_on(100 * MS);
    forget_sent();
    request(0, DRIVE_OFF);
    go_on(3000 * MS);
    CHECK(state_of(0)->state.mode == DRIVE_UNRESPONSIVE && first_sent_ns(0, QUICK_STOP) > 0 &&
          first_sent_ns(0, DISABLE) > first_sent_ns(0, QUICK_STOP));
    w.silent = w.powered = false;
    forget_sent();
    go_on(50 * MS);
    CHECK(state_of(0)->state.mode == DRIVE_BACK && first_sent_ns(0, DISABLE) > 0);
}

static void a_newly_set_up_drive_has_the_time_of_its_silence_for_its_first_frame(void)
{
    begin_with(1);
    w.silent = true;
    request(0, DRIVE_READY);
    go_on(190 * MS);
    CHECK(state_of(0)->state.mode == DRIVE_READY);
    go_on(30 * MS);
    CHECK(state_of(0)->state.mode == DRIVE_UNRESPONSIVE && state_of(0)->missing == 2);
}

/* The drive's frames arrive all the time, but it is set up again only when it has answered its
 * hello. */
static void a_drive_with_a_hello_is_back_when_it_has_answered(void)
{
    begin_with(1);
    can_drive *drive = table_of(0);
    drive->input_count = 3;
    drive->hello = 3;
    drive->match[2].input = 3;
    restart();
    go_on(50 * MS);
    CHECK(state_of(0)->state.mode == DRIVE_OFF && state_of(0)->missing == 3);
    const uint8_t answer[8] = {0x43};
    (void)say(ANSWER, answer, 8);
    step();
    CHECK(state_of(0)->missing == 0);
    arm_and_go();
    CHECK(state_of(0)->missing == 0);
    become_unresponsive();
    w.silent = w.powered = false;
    go_on(500 * MS);
    /* its old answer does not count any more */
    CHECK(state_of(0)->state.mode == DRIVE_UNRESPONSIVE && state_of(0)->missing == 3);
    (void)say(ANSWER, answer, 8);
    go_on(20 * MS);
    CHECK(state_of(0)->state.mode == DRIVE_BACK && state_of(0)->missing == 0 &&
          speed_in(newest_of(0)) == 0);
    go_on(5050 * MS);
    CHECK(state_of(0)->missing == 3);
}

static void the_stop_at_the_end_waits_for_the_bus_even_when_the_drive_is_unresponsive(void)
{
    begin_with(1);
    arm_and_go();
    w.reported_rad_s = 1.0;
    w.full = w.silent = true;
    forget_sent();
    w.machine.control.shut_down = 1;
    go_on(250 * MS);
    CHECK(state_of(0)->state.mode == DRIVE_UNRESPONSIVE && w.machine.end.stage == END_RESTING);
    w.full = false;
    go_on(2 * MS);
    CHECK(w.sent[0].data[0] == QUICK_STOP && speed_in(&w.sent[0]) == 0);
    go_on(300 * MS);
    CHECK(w.machine.end.stage == END_SILENT && first_sent_ns(0, DISABLE) > 0);
}

int main(void)
{
    a_drive_is_polled_in_each_cycle_and_slow_requests_take_turns();
    an_unresponsive_drive_is_probed_less_and_less_often();
    an_unresponsive_drive_that_may_turn_gets_zero_and_quick_stops_and_is_off_after_a_second();
    a_probe_that_the_bus_took_in_part_is_sent_again_in_the_next_cycle();
    an_unresponsive_drive_is_sent_to_stop_in_each_cycle_until_the_bus_has_taken_its_zero();
    a_drive_switched_off_while_it_came_back_stays_off();
    a_request_of_off_does_not_end_the_stops_of_an_unresponsive_drive();
    a_newly_set_up_drive_has_the_time_of_its_silence_for_its_first_frame();
    a_drive_with_a_hello_is_back_when_it_has_answered();
    the_stop_at_the_end_waits_for_the_bus_even_when_the_drive_is_unresponsive();
    return checks_report("can unresponsive");
}
