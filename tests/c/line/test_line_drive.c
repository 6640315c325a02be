/* SPDX-License-Identifier: Apache-2.0
 * test_line_drive: one drive of a serial line: which state each change sets, keeps and clears. */
#include "line_wire.h"

static line_drive_state *begin_drive(void)
{
    begin_with(2, 0);
    w.machine.newest = (setpoints){.stamp_ns = w.now_ns,
                                   .enabled = 1,
                                   .joint_count = 2,
                                   .joint = {{.velocity_rad_s = 1.0}, {.velocity_rad_s = 1.0}}};
    w.machine.notify = false;
    return &w.machine.drive[0];
}

static line_drive_state *begin_armed(void)
{
    line_drive_state *drive = begin_drive();
    drive->state.mode = DRIVE_ARMED;
    drive->may_turn = true;
    drive->answered_ns = w.now_ns;
    return drive;
}

static void a_stop_begins_with_its_first_frame_whatever_was_in_transit(void)
{
    line_drive_state *drive = begin_drive();
    for (uint32_t current = 0; current < 2; current++) {
        drive->stop_place = 1, drive->stop_done = 3, drive->stop_failures = 2,
        drive->stop_refused = true;
        drive->stage = STAGE_READ;
        for (uint32_t direction = 0; direction < DRIVE_DIRECTIONS_MAX; direction++) {
            drive->direction_sent[direction] = DIRECTION_FORWARD;
        }
        w.machine.current = current;
        line_stop_now(&w.machine, 0, STOP_POWER_OFF);
        CHECK(drive->state.stop == STOP_POWER_OFF && drive->stop_place == 0 &&
              drive->stop_done == 0);
        CHECK(drive->stop_failures == 0 && !drive->stop_refused && drive->stage == STAGE_IDLE);
        for (uint32_t direction = 0; direction < DRIVE_DIRECTIONS_MAX; direction++) {
            CHECK(drive->direction_sent[direction] == DIRECTION_UNKNOWN);
        }
        CHECK(w.machine.current == (current == 0 ? (uint32_t)LINE_DRIVES_MAX : 1));
    }
}

static void reasons_gather(void)
{
    line_drive_state *drive = begin_armed();
    drive->state.enabled = 1;
    drive_take_back(&drive->state, DRIVE_FAULT_LEFT_ALONE, DRIVE_READY);
    CHECK(drive->state.fault_reasons == DRIVE_FAULT_LEFT_ALONE &&
          drive->state.mode == DRIVE_READY && drive->state.enabled == 2);
    drive_take_back(&drive->state, DRIVE_FAULT_UNRESPONSIVE, DRIVE_UNRESPONSIVE);
    CHECK(drive->state.fault_reasons == (DRIVE_FAULT_LEFT_ALONE | DRIVE_FAULT_UNRESPONSIVE) &&
          drive->state.mode == DRIVE_UNRESPONSIVE);
}

static void a_drive_that_was_armed_before_the_port_was_opened_is_stopped_and_stays_off(void)
{
    line_drive_state *drive = begin_drive();
    w.machine.table.broadcast_stop_count = 2;
    line_stop_before_setup(&w.machine, 0, w.now_ns);
    CHECK(drive->may_turn && drive->state.mode == DRIVE_OFF && drive->state.fault_reasons == 0 &&
          drive->state.stopping);
    CHECK(drive->state.stop == STOP_QUICK && drive->state.off_by_ns == w.now_ns + 1000 * MS &&
          drive->due_ns == w.now_ns);
    CHECK(w.machine.broadcasts == 2 && w.machine.drive[1].state.stop == STOP_NOTHING);
}

static void a_reply_takes_the_time_of_its_bytes(void)
{
    begin_with(1, 0);
    line_frame frame = {.reply_bytes = 7};
    CHECK(line_reply_ns(&w.machine, &frame) == 7 * CHARACTER_NS);
}

/* Checks whether and why an armed drive stops after a look. */
static void guarded(line_drive_state *drive, uint32_t why, uint32_t stop)
{
    line_guard(&w.machine, 0, w.now_ns);
    CHECK(drive->state.fault_reasons == why && drive->state.stop == stop &&
          drive->state.mode == (why == 0 ? DRIVE_ARMED : DRIVE_READY));
    CHECK(drive->state.stopping == (stop == STOP_QUICK));
    CHECK(stop != STOP_QUICK ||
          (drive->state.off_by_ns == w.now_ns + 1000 * MS && drive->due_ns == w.now_ns));
}

static void an_armed_drive_is_stopped_when_set_points_grow_old(void)
{
    line_drive_state *drive = begin_armed();
    w.now_ns += 100 * MS;
    guarded(drive, 0, STOP_NOTHING);
    CHECK(line_fresh(&w.machine, w.now_ns) && !line_fresh(&w.machine, w.now_ns + 1));
    w.now_ns += 1;
    guarded(drive, DRIVE_FAULT_SETPOINTS_OLD, STOP_QUICK);
}

/* A request in transit to the drive may still get its answer; one to another drive does not
 * help. */
static void an_armed_drive_left_alone_longer_than_its_watchdog_is_stopped(void)
{
    for (uint32_t how = 0; how < 5; how++) {
        line_drive_state *drive = begin_armed();
        w.now_ns += 500 * MS;
        w.machine.newest.stamp_ns = w.now_ns;
        guarded(drive, 0, STOP_NOTHING);
        w.now_ns += 1;
        w.machine.table.drive[0].watchdog_ns = how == 4 ? 0 : how == 3 ? 1 : 500 * MS;
        w.machine.work = how == 0 || how == 3 ? WORK_NONE : WORK_CYCLE;
        w.machine.worker = how == 1 || how == 3 ? 0 : 1;
        bool alone = how == 0 || how == 2 || how == 3;
        guarded(drive, alone ? DRIVE_FAULT_LEFT_ALONE : 0, alone ? STOP_QUICK : STOP_NOTHING);
    }
}

static void an_armed_drive_whose_set_points_are_no_longer_enabled_loses_its_power(void)
{
    line_drive_state *drive = begin_armed();
    w.machine.newest.enabled = 0;
    drive->state.enabled_count = w.machine.enabled_count = 7;
    guarded(drive, 0, STOP_NOTHING); /* not enabled yet since the arming */
    w.machine.newest.enabled = 1;
    guarded(drive, 0, STOP_NOTHING);
    CHECK(drive->state.was_enabled);
    w.machine.newest.enabled = 0;
    guarded(drive, DRIVE_FAULT_NOT_ENABLED, STOP_POWER_OFF);
    drive = begin_armed();
    w.machine.newest.enabled = 0;
    drive->state.enabled_count = 7, w.machine.enabled_count = 8; /* enabled and disabled between two
                                                                    looks */
    guarded(drive, DRIVE_FAULT_NOT_ENABLED, STOP_POWER_OFF);
}

static void a_stop_does_not_wait_for_its_turn(void)
{
    for (uint32_t how = 0; how < 4; how++) {
        line_drive_state *drive = begin_armed();
        drive->state.sent_motion = how != 1;
        w.machine.newest.joint[0].velocity_rad_s = how == 2 ? 1.0 : 0.0;
        drive->due_ns = how == 3 ? w.now_ns - MS : w.now_ns + 9 * MS;
        line_guard(&w.machine, 0, w.now_ns);
        CHECK(drive->due_ns == (how == 0   ? w.now_ns
                                : how == 3 ? w.now_ns - MS
                                           : w.now_ns + 9 * MS));
    }
}

static void a_drive_that_does_not_come_to_rest_loses_its_power_in_time(void)
{
    for (uint32_t how = 0; how < 4; how++) {
        line_drive_state *drive = begin_drive();
        drive->state.mode = DRIVE_READY;
        drive->state.stopping = how != 1;
        drive->state.stop = how == 2 ? STOP_QUICK : STOP_NOTHING;
        drive->state.off_by_ns = how == 3 ? w.now_ns + 1 : w.now_ns;
        line_guard(&w.machine, 0, w.now_ns);
        CHECK(drive->state.stop == (how == 0   ? STOP_POWER_OFF
                                    : how == 2 ? STOP_QUICK
                                               : STOP_NOTHING));
        CHECK(drive->state.stopping == (how == 2 || how == 3));
    }
}

static void obey(uint32_t mode, uint32_t unseen)
{
    w.machine.control.drive[0].count += 1 + unseen;
    w.machine.control.drive[0].mode = mode;
    w.machine.notify = false;
    line_obey_request(&w.machine, 0, w.now_ns);
    CHECK(w.machine.notify);
    w.machine.notify = false;
    line_obey_request(&w.machine, 0, w.now_ns); /* the same count is no new request */
    CHECK(!w.machine.notify);
}

static void a_set_up_resets_all_state_but_a_pending_stop(void)
{
    for (uint32_t pending = 0; pending < 3; pending++) {
        for (uint32_t from = 0; from < 2; from++) {
            line_drive_state *drive = begin_drive();
            drive->state.mode = from == 0 ? DRIVE_OFF : DRIVE_BACK;
            drive->state.epoch = 4;
            drive->state.fault_reasons = 0xff, drive->failures = 5, drive->state.still_enabled = 6;
            drive->may_turn = drive->state.sent_motion = drive->state.back = true;
            drive->state.stop = pending == 1 ? STOP_QUICK : STOP_NOTHING;
            drive->state.stopping = pending == 2;
            drive->cycle_count = 9, drive->extra_next = 3, drive->cycle_start_ns = 77;
            drive->due_ns = drive->answered_ns = 1;
            for (uint32_t direction = 0; direction < DRIVE_DIRECTIONS_MAX; direction++) {
                drive->direction_sent[direction] = DIRECTION_REVERSE;
            }
            w.machine.joint[0].feedback.velocity_rad_s = 5.0;
            obey(DRIVE_READY, 0);
            CHECK(drive->state.mode == DRIVE_READY && drive->state.epoch == 5 &&
                  !drive->state.back);
            CHECK(drive->state.fault_reasons == 0 && drive->failures == 0 &&
                  drive->state.still_enabled == 0);
            CHECK(drive->may_turn == (pending != 0) && drive->state.sent_motion == (pending != 0));
            CHECK(drive->state.stop == (pending == 1 ? STOP_QUICK : STOP_NOTHING) &&
                  drive->state.stopping == (pending == 2));
            CHECK(drive->cycle_count == 0 && drive->extra_next == 0 && drive->cycle_start_ns == 0);
            CHECK(drive->due_ns == w.now_ns && drive->answered_ns == w.now_ns);
            for (uint32_t direction = 0; direction < DRIVE_DIRECTIONS_MAX; direction++) {
                CHECK(drive->direction_sent[direction] == DIRECTION_UNKNOWN);
            }
            CHECK(w.machine.joint[0].feedback.velocity_rad_s != 5.0);
        }
    }
}

static void it_is_armed_when_nothing_prevents_it_and_its_state_is_reset(void)
{
    for (uint32_t against = 0; against < 7; against++) {
        line_drive_state *drive = begin_drive();
        drive->state.mode = against == 6 ? DRIVE_OFF : DRIVE_READY;
        drive->state.was_enabled = true;
        drive->state.enabled_count = 3, w.machine.enabled_count = 8;
        drive->state.fault_reasons = 0xff, drive->state.still_enabled = 2, drive->state.enabled = 1;
        memset(drive->last_sent, 0x11, sizeof drive->last_sent);
        w.now_ns += against == 1 ? 100 * MS + 1 : 100 * MS;
        drive->state.stopping = against == 2;
        drive->state.stop = against == 3 ? STOP_POWER_OFF : STOP_NOTHING;
        w.machine.control.shut_down = against == 4;
        obey(DRIVE_ARMED, against == 5 ? 1 : 0);
        /* an overtaken request may have been a stop; nothing here needs one */
        bool armed = against == 0 || against == 5;
        CHECK((drive->state.mode == DRIVE_ARMED) == armed && drive->may_turn == armed);
        if (armed) {
            CHECK(!drive->state.was_enabled && drive->state.enabled_count == 8 &&
                  drive->state.fault_reasons == 0);
            CHECK(drive->state.still_enabled == 0 && drive->state.enabled == 2 &&
                  drive->last_sent[1][1] == 0 && drive->last_sent[0][0] == 0);
        }
    }
}

/* A drive may have power if it is armed, stopping, or was sent motion. A request that was not seen
 * may have been a stop. */
static void switching_off_and_overtaken_requests_take_the_power_of_a_powered_drive(void)
{
    for (uint32_t has = 0; has < 4; has++) {
        for (uint32_t unseen = 0; unseen < 2; unseen++) {
            for (uint32_t mode = DRIVE_OFF; mode <= DRIVE_STAND_DOWN; mode++) {
                if (mode != DRIVE_OFF && mode != DRIVE_READY && mode != DRIVE_ARMED &&
                    mode != DRIVE_STAND_DOWN) {
                    continue;
                }
                line_drive_state *drive = begin_drive();
                drive->state.mode = has == 1 ? DRIVE_ARMED : DRIVE_READY;
                drive->state.stopping = has == 2;
                drive->state.sent_motion = has == 3;
                drive->state.enabled = 1;
                drive->state.back = has != 0;
                drive->stage = STAGE_READ;
                drive->due_ns = w.now_ns + 9 * MS;
                w.machine.current = 0;
                obey(mode, unseen);
                bool off = has != 0 && (unseen != 0 || mode == DRIVE_OFF);
                CHECK(drive->state.stop == (off ? STOP_POWER_OFF : STOP_NOTHING) &&
                      drive->state.stopping == (has == 2 && !off));
                uint32_t expected = mode == DRIVE_OFF ? DRIVE_OFF : DRIVE_READY;
                if (mode == DRIVE_ARMED && !off && has != 2) {
                    expected = DRIVE_ARMED;
                }
                if (mode == DRIVE_READY && has == 1 && !off) {
                    expected = DRIVE_ARMED; /* an armed drive is set up */
                }
                CHECK(drive->state.mode == expected);
                CHECK(mode != DRIVE_OFF || (!drive->state.back && drive->stage == STAGE_IDLE &&
                                            w.machine.current == LINE_DRIVES_MAX));
                bool stands_down = has == 1 && unseen == 0 && mode == DRIVE_STAND_DOWN;
                CHECK(drive->due_ns == (stands_down ? w.now_ns : w.now_ns + 9 * MS));
                CHECK(has != 1 || !(stands_down || off) || mode == DRIVE_OFF ||
                      drive->state.enabled == 2);
            }
        }
    }
    line_drive_state *drive = begin_drive();
    drive->state.mode = DRIVE_READY;
    w.machine.current = 1;
    w.machine.control.drive[0].arming_until_ns = 1234;
    obey(DRIVE_OFF, 0);
    CHECK(w.machine.current == 1 && drive->arming_until_ns == 1234);
    drive->state.mode = DRIVE_UNRESPONSIVE;
    obey(DRIVE_READY, 0);
    CHECK(drive->state.mode == DRIVE_UNRESPONSIVE);
    obey(DRIVE_STAND_DOWN, 0);
    CHECK(drive->state.mode == DRIVE_UNRESPONSIVE);
}

static void each_frame_of_a_stop_is_sent_until_it_is_done(void)
{
    line_drive_state *drive = begin_drive();
    line_frame frame;
    line_stop_now(&w.machine, 0, STOP_POWER_OFF);
    CHECK(line_next_stop(&w.machine, 0, &frame) && frame.request[3] == CONTROL &&
          frame.request[5] == DISABLE);
    drive->stop_done = 1;
    CHECK(line_next_stop(&w.machine, 0, &frame) && frame.request[3] == RELEASE &&
          drive->stop_place == 1);
    drive->stop_done = 2;
    CHECK(line_next_stop(&w.machine, 0, &frame) && frame.request[3] == CONTROL &&
          drive->stop_place == 0);
    drive->stop_done = 3;
    drive->state.enabled = 1;
    CHECK(!line_next_stop(&w.machine, 0, &frame) && drive->state.stop == STOP_NOTHING &&
          drive->state.enabled == 2 && !w.machine.notify);
    line_stop_now(&w.machine, 0, STOP_QUICK);
    CHECK(line_next_stop(&w.machine, 0, &frame) && frame.request[3] == CONTROL &&
          frame.request[5] == QUICK_STOP);
    drive->stop_done = 1;
    drive->state.back = true;
    CHECK(!line_next_stop(&w.machine, 0, &frame) && drive->state.mode == DRIVE_BACK &&
          !drive->state.back && w.machine.notify);
}

static void the_next_unfinished_frame_of_a_stop_is_sent_in_rotation(void)
{
    line_drive_state *drive = begin_drive();
    line_frame frame;
    w.machine.table.drive[0].disarm_count = 3;
    w.machine.table.drive[0].disarm[2] = frame_of(1, WRITE, RELEASE, 1);
    line_stop_now(&w.machine, 0, STOP_POWER_OFF);
    drive->stop_place = 1, drive->stop_done = 2;
    CHECK(line_next_stop(&w.machine, 0, &frame) && drive->stop_place == 2 && frame.request[5] == 1);
    drive->stop_done = 6;
    CHECK(line_next_stop(&w.machine, 0, &frame) && drive->stop_place == 0 &&
          frame.request[3] == CONTROL);
}

static void an_unchanged_drive_does_not_clear_a_notification(void)
{
    line_frame frame;
    line_drive_state *drive = begin_drive();
    w.machine.notify = true;
    line_obey_request(&w.machine, 0, w.now_ns);
    CHECK(w.machine.notify);
    drive->state.stop = STOP_POWER_OFF;
    drive->stop_done = UINT32_MAX;
    CHECK(!line_next_stop(&w.machine, 0, &frame) && w.machine.notify &&
          drive->state.stop == STOP_NOTHING);
}

int main(void)
{
    the_next_unfinished_frame_of_a_stop_is_sent_in_rotation();
    a_stop_begins_with_its_first_frame_whatever_was_in_transit();
    reasons_gather();
    a_drive_that_was_armed_before_the_port_was_opened_is_stopped_and_stays_off();
    a_reply_takes_the_time_of_its_bytes();
    an_armed_drive_is_stopped_when_set_points_grow_old();
    an_armed_drive_left_alone_longer_than_its_watchdog_is_stopped();
    an_armed_drive_whose_set_points_are_no_longer_enabled_loses_its_power();
    a_stop_does_not_wait_for_its_turn();
    a_drive_that_does_not_come_to_rest_loses_its_power_in_time();
    a_set_up_resets_all_state_but_a_pending_stop();
    it_is_armed_when_nothing_prevents_it_and_its_state_is_reset();
    switching_off_and_overtaken_requests_take_the_power_of_a_powered_drive();
    each_frame_of_a_stop_is_sent_until_it_is_done();
    an_unchanged_drive_does_not_clear_a_notification();
    return checks_report("line drive");
}
