/* SPDX-License-Identifier: Apache-2.0
 * A line that is never silent: stops are sent nevertheless, and its drives become unresponsive. */
#include "line_wire.h"

static const int64_t LONG_GAP_NS = 20 * MS;
/* Time until a frame that gets no silence is sent: the gap, the bound, its exchange and a look. */
static const int64_t FRAME_NS = LONG_GAP_NS + 20 * MS + 5 * MS;

static void begin_turning(uint32_t drives)
{
    begin_with(drives, 0);
    w.table.gap_ns = LONG_GAP_NS;
    CHECK(line_machine_init(&w.machine, &w.table, 0, w.now_ns) == 0);
    for (uint32_t i = 0; i < drives; i++) {
        arm(i);
    }
    while (!w.machine.drive[drives - 1].state.sent_motion) {
        go_on();
    }
}

static void babble_for(int64_t for_ns)
{
    w.babbles = true;
    for (int64_t end_ns = w.now_ns + for_ns; w.now_ns < end_ns;) {
        go_on();
    }
}

static void a_power_off_is_sent(void)
{
    begin_turning(2);
    babble_for(10 * MS);
    request(0, DRIVE_OFF);
    babble_for(2 * FRAME_NS + 30 * MS);
    CHECK(w.power_offs[0] == 2 && w.released[0] == 1 && w.power_offs[1] == 0);
    /* the answers are found among the noise */
    CHECK(w.machine.drive[0].state.stop == STOP_NOTHING);
}

static void a_quick_stop_is_sent(void)
{
    begin_turning(1);
    babble_for(10 * MS);
    w.machine.newest.stamp_ns = 0; /* no set-points any more */
    line_machine_step(&w.machine, w.now_ns, w.bytes, 0, &w.out);
    babble_for(FRAME_NS + 10 * MS);
    CHECK(w.quick_stop_ns[0] > 0);
}

static void all_drives_are_switched_off_at_the_end(void)
{
    begin_turning(2);
    babble_for(10 * MS);
    w.machine.control.shut_down = 1;
    babble_for(500 * MS);
    CHECK(w.machine.end.stage == END_SILENT);
    for (uint32_t i = 0; i < 2; i++) {
        CHECK(w.quick_stop_ns[i] > 0 && w.released[i] > 0 &&
              w.machine.drive[i].state.stop == STOP_NOTHING);
    }
}

static void a_stop_waits_for_the_full_silence_after_noise_has_ended(void)
{
    begin_turning(1);
    babble_for(10 * MS);
    w.babbles = false;
    int64_t received_ns = w.now_ns;
    request(0, DRIVE_OFF);
    while (w.power_offs[0] == 0) {
        go_on();
    }
    CHECK(w.machine.start_ns - received_ns >= LONG_GAP_NS);
}

static void only_an_urgent_request_is_sent(void)
{
    begin_turning(1);
    babble_for(10 * MS);
    line_request request = {.id = 1,
                            .expires_ns = INT64_MAX,
                            .turnaround_ns = 5 * MS,
                            .frame = frame_of(1, READ, STATUS, 1)};
    CHECK(line_machine_request(&w.machine, &request));
    uint64_t before = w.machine.exchanges;
    babble_for(100 * MS);
    CHECK(w.machine.exchanges == before && w.machine.request_count == 1);
    request.id = 2;
    request.urgent = 1;
    CHECK(line_machine_request(&w.machine, &request));
    babble_for(FRAME_NS);
    CHECK(w.machine.exchanges == before + 1 && w.machine.request_count == 1 &&
          w.machine.request[0].id == 1);
}

/* The noise hides all replies, so drives count as unresponsive. One that may turn gets its stop
 * repeatedly. */
static void its_drives_become_unresponsive_and_are_stopped(void)
{
    begin_turning(2);
    w.machine.table.drive[0].watchdog_ns = w.machine.table.drive[1].watchdog_ns = 0;
    while (w.machine.work != WORK_NONE) {
        go_on();
    }
    w.dead = 3;
    babble_for(700 * MS);
    CHECK(w.machine.drive[0].state.mode == DRIVE_ARMED);
    babble_for(100 * MS);
    for (uint32_t i = 0; i < 2; i++) {
        CHECK(w.machine.drive[i].state.mode == DRIVE_UNRESPONSIVE &&
              w.machine.drive[i].state.fault_reasons == DRIVE_FAULT_UNRESPONSIVE);
        CHECK(w.machine.drive[i].count.bad_reply >= 3);
    }
    babble_for(3000 * MS);
    CHECK(w.quick_stop_sent[0] >= 2 && w.quick_stop_sent[1] >= 2);
    w.babbles = false;
    w.dead = 0;
    for (int64_t end_ns = w.now_ns + 5000 * MS; w.now_ns < end_ns;) {
        go_on();
    }
    CHECK(w.machine.drive[0].state.mode == DRIVE_BACK &&
          w.machine.drive[1].state.mode == DRIVE_BACK);
}

static void noise_before_a_turn_that_has_just_come_is_not_a_failure(void)
{
    begin_turning(1);
    w.machine.table.drive[0].period_ns = 1000 * MS;
    w.machine.table.drive[0].watchdog_ns = 0;
    for (uint32_t i = 0; i < 4; i++) {
        go_on();
    }
    while (w.machine.work != WORK_NONE || w.machine.drive[0].due_ns > w.now_ns + 20 * MS) {
        go_on();
    }
    babble_for(100 * MS);
    CHECK(w.machine.drive[0].failures == 0);
}

int main(void)
{
    a_power_off_is_sent();
    a_quick_stop_is_sent();
    all_drives_are_switched_off_at_the_end();
    a_stop_waits_for_the_full_silence_after_noise_has_ended();
    only_an_urgent_request_is_sent();
    its_drives_become_unresponsive_and_are_stopped();
    noise_before_a_turn_that_has_just_come_is_not_a_failure();
    return checks_report("line noise");
}
