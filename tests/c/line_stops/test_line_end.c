/* SPDX-License-Identifier: Apache-2.0
 * The end of a serial line: rest, then power-off, then silence, each with a time limit. */
#include "line_wire.h"

static const int64_t REST_NS = 350 * 1000000, END_NS = 480 * 1000000,
                     POWER_OFF_END_NS = 2980LL * 1000000;

static void look_at(int64_t now_ns)
{
    w.machine.notify = false;
    line_shut_down(&w.machine, now_ns);
}

static void an_armed_drive_is_stopped_at_once_and_one_that_is_not_armed_is_not(void)
{
    begin_with(2, 0);
    w.machine.table.broadcast_stop_count = 2;
    line_drive_state *armed = &w.machine.drive[1], *ready = &w.machine.drive[0];
    armed->state.mode = DRIVE_ARMED, ready->state.mode = DRIVE_READY;
    armed->due_ns = ready->due_ns = w.now_ns + 1000 * MS;
    look_at(w.now_ns);
    CHECK(w.machine.end.stage == END_NOT && armed->state.mode == DRIVE_ARMED);
    w.machine.control.shut_down = 1;
    look_at(w.now_ns);
    CHECK(w.machine.end.stage == END_RESTING && !w.machine.notify && w.machine.broadcasts == 2);
    CHECK(armed->state.mode == DRIVE_READY && armed->state.stopping &&
          armed->state.stop == STOP_QUICK);
    CHECK(armed->due_ns == w.now_ns && armed->state.off_by_ns == w.now_ns + REST_NS);
    CHECK(!ready->state.stopping && ready->state.stop == STOP_NOTHING &&
          ready->due_ns == w.now_ns + 1000 * MS);
}

/* Cases: each kind of work that has to be finished before the power goes off. */
static void the_power_goes_off_when_every_stop_and_every_broadcast_is_done(void)
{
    for (int what = 0; what < 5; what++) {
        begin_with(2, 0);
        w.machine.control.shut_down = 1;
        line_drive_state *first = &w.machine.drive[0], *last = &w.machine.drive[1];
        first->state.stopping = what == 0;
        first->state.stop = what == 1 ? STOP_QUICK : STOP_NOTHING;
        last->state.stopping = what == 2;
        w.machine.broadcasts = what == 3 ? 1 : what == 4 ? 2 : 0;
        look_at(w.now_ns);
        CHECK(w.machine.end.stage == END_RESTING && last->state.stop == STOP_NOTHING);
        first->state.stopping = last->state.stopping = false;
        first->state.stop = STOP_NOTHING;
        w.machine.broadcasts = 0;
        look_at(w.now_ns + MS);
        CHECK(w.machine.end.stage == END_POWER_OFF && first->state.stop == STOP_POWER_OFF &&
              last->state.stop == STOP_POWER_OFF && !w.machine.notify);
        first->state.stop = STOP_NOTHING;
        look_at(w.now_ns + 2 * MS);
        CHECK(w.machine.end.stage == END_POWER_OFF);
        last->state.stop = STOP_NOTHING;
        look_at(w.now_ns + 3 * MS);
        CHECK(w.machine.end.stage == END_SILENT && w.machine.notify);
    }
}

static void a_drive_that_does_not_come_to_rest_still_loses_its_power_at_the_end(void)
{
    begin_with(2, 0);
    w.machine.drive[0].state.mode = DRIVE_ARMED;
    w.machine.control.shut_down = 1;
    int64_t begun_ns = w.now_ns;
    look_at(begun_ns);
    look_at(begun_ns + REST_NS - 1);
    CHECK(w.machine.end.stage == END_RESTING && w.machine.drive[0].state.stopping);
    look_at(begun_ns + REST_NS);
    CHECK(w.machine.end.stage == END_POWER_OFF && !w.machine.drive[0].state.stopping &&
          w.machine.drive[0].state.stop == STOP_POWER_OFF);
    w.machine.drive[0].stop_sent = w.machine.drive[1].stop_sent =
        (1U << w.machine.table.drive[0].disarm_count) - 1;
    look_at(begun_ns + END_NS - 1);
    CHECK(w.machine.end.stage == END_POWER_OFF && !w.machine.notify);
    look_at(begun_ns + END_NS);
    CHECK(w.machine.end.stage == END_SILENT && w.machine.notify);
}

/* A drive whose replies are lost may still receive. A silent neighbour does not reduce its time. */
static void
the_end_waits_until_each_drive_was_sent_each_frame_of_its_power_off_but_not_for_ever(void)
{
    uint32_t frames = drive_of(1).disarm_count, all = (1U << frames) - 1;
    /* in the last run the last frame is sent late */
    for (uint32_t missing = 0; missing <= frames; missing++) {
        bool comes = missing == frames;
        begin_with(2, 0);
        w.machine.control.shut_down = 1;
        int64_t begun_ns = w.now_ns;
        look_at(begun_ns);
        look_at(begun_ns);
        CHECK(w.machine.end.stage == END_POWER_OFF && frames > 0);
        w.machine.drive[0].state.stop = STOP_NOTHING;
        w.machine.drive[1].stop_sent = all & ~(1U << (comes ? frames - 1 : missing));
        look_at(begun_ns + END_NS);
        CHECK(w.machine.end.stage == END_POWER_OFF);
        w.machine.drive[1].stop_sent |= comes ? all : 0;
        look_at(begun_ns + POWER_OFF_END_NS - 1);
        CHECK(w.machine.end.stage == (comes ? 3 : 2));
        look_at(begun_ns + POWER_OFF_END_NS);
        CHECK(w.machine.end.stage == END_SILENT);
    }
}

static void the_end_does_not_clear_a_notification(void)
{
    begin_with(2, 0);
    w.machine.notify = true;
    line_shut_down(&w.machine, w.now_ns);
    CHECK(w.machine.notify && w.machine.end.stage == END_NOT);
}

/* The entry after the last drive looks like a drive that moves and stops. It is neither read nor
 * changed. */
static void a_line_has_eight_drives_at_most(void)
{
    line_drive_state mover = {.state.mode = DRIVE_ARMED,
                              .state.stop = STOP_QUICK,
                              .state.stopping = true,
                              .may_turn = true};
    begin_with(LINE_DRIVES_MAX, 0);
    uint8_t behind[sizeof w.machine.joint];
    memcpy(w.machine.joint, &mover, sizeof mover < sizeof behind ? sizeof mover : sizeof behind);
    memcpy(behind, w.machine.joint, sizeof behind);
    w.machine.control.shut_down = 1;
    look_at(w.now_ns);
    CHECK(w.machine.end.stage == END_POWER_OFF &&
          memcmp(behind, w.machine.joint, sizeof behind) == 0);
    for (uint32_t i = 0; i < LINE_DRIVES_MAX; i++) {
        CHECK(w.machine.drive[i].state.stop == STOP_POWER_OFF);
        w.machine.drive[i].state.stop = STOP_NOTHING;
    }
    look_at(w.now_ns);
    CHECK(w.machine.end.stage == END_SILENT && memcmp(behind, w.machine.joint, sizeof behind) == 0);
}

int main(void)
{
    an_armed_drive_is_stopped_at_once_and_one_that_is_not_armed_is_not();
    the_power_goes_off_when_every_stop_and_every_broadcast_is_done();
    a_drive_that_does_not_come_to_rest_still_loses_its_power_at_the_end();
    the_end_waits_until_each_drive_was_sent_each_frame_of_its_power_off_but_not_for_ever();
    the_end_does_not_clear_a_notification();
    a_line_has_eight_drives_at_most();
    return checks_report("line end");
}
