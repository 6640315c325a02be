/* SPDX-License-Identifier: Apache-2.0
 * test_can_steps: one drive of a CAN bus: which state each request and each look sets, keeps and
 * clears. */
#include "can_wire.h"

static can_drive_state *drive;

static void begin_drive(void)
{
    begin_with(2);
    drive = &w.machine.drive[0];
    w.machine.newest = (setpoints){.stamp_ns = w.now_ns,
                                   .enabled = 1,
                                   .joint_count = 2,
                                   .joint = {{.velocity_rad_s = 1.0}, {.velocity_rad_s = 1.0}}};
    for (uint32_t i = 0; i < CAN_INPUTS_MAX; i++) {
        drive->received_ns[i] = w.now_ns;
    }
    drive->last_sent_ns = w.now_ns;
}

static void obey(uint32_t mode, uint32_t unseen)
{
    w.machine.control.drive[0].count += 1 + unseen;
    w.machine.control.drive[0].mode = mode;
    w.machine.notify = false;
    can_obey_request(&w.machine, 0, w.now_ns);
    CHECK(w.machine.notify);
    w.machine.notify = false;
    can_obey_request(&w.machine, 0, w.now_ns); /* the same count is no new request */
    CHECK(!w.machine.notify);
}

static void a_set_up_resets_all_state_but_a_stop_that_goes_on(void)
{
    for (uint32_t powered = 0; powered < 3; powered++) {
        for (uint32_t from = 0; from < 2; from++) {
            begin_drive();
            drive->state.mode = from == 0 ? DRIVE_OFF : DRIVE_BACK;
            drive->state.epoch = 4, drive->state.fault_reasons = 0xff,
            drive->state.still_enabled = 2, drive->slow_cycles = 5;
            drive->state.back = drive->may_turn = true;
            drive->state.sent_motion = powered == 1;
            drive->state.stopping = powered == 2;
            drive->state.enabled = 1;
            w.now_ns += 7 * MS;
            obey(DRIVE_READY, 0);
            CHECK(drive->state.mode == DRIVE_READY && drive->state.epoch == 5 &&
                  drive->state.fault_reasons == 0 && drive->state.still_enabled == 0);
            CHECK(!drive->state.back && drive->may_turn == (powered == 2) &&
                  drive->slow_cycles == 0 && drive->last_sent_ns == w.now_ns);
            CHECK(drive->state.stopping == (powered == 2) && !drive->state.sent_motion &&
                  drive->state.enabled == 2);
            for (uint32_t i = 0; i < CAN_INPUTS_MAX; i++) {
                CHECK(drive->received_ns[i] == w.now_ns);
            }
        }
    }
}

static void it_is_armed_when_nothing_prevents_it_and_its_state_is_reset(void)
{
    for (uint32_t against = 0; against < 8; against++) {
        begin_drive();
        drive->state.mode = against == 6 ? DRIVE_OFF : DRIVE_READY;
        drive->state.was_enabled = true;
        drive->state.enabled_count = 3, w.machine.enabled_count = 8;
        drive->state.fault_reasons = 0xff, drive->state.still_enabled = 2, drive->state.enabled = 1;
        w.now_ns += against == 1 ? 100 * MS + 1 : 100 * MS;
        drive->state.stopping = against == 2;
        drive->state.stop = against == 3 ? STOP_POWER_OFF : STOP_NOTHING;
        drive->state.off_due = against == 7;
        w.machine.control.shut_down = against == 4;
        obey(DRIVE_ARMED, against == 5 ? 1 : 0);
        /* an overtaken request may have been a stop; nothing here needs one */
        bool armed = against == 0 || against == 5;
        CHECK((drive->state.mode == DRIVE_ARMED) == armed && drive->may_turn == armed);
        if (armed) {
            CHECK(!drive->state.was_enabled && drive->state.enabled_count == 8 &&
                  drive->state.fault_reasons == 0 && drive->state.still_enabled == 0);
            CHECK(drive->state.enabled == 2 && drive->last_sent_ns == w.now_ns);
        }
    }
}

/* A drive may have power if it is armed, stopping, was sent motion, or reports that it is enabled.
 * A request that was not seen may have been a stop. */
static void switching_off_and_overtaken_requests_take_the_power_of_a_powered_drive(void)
{
    static const uint32_t MODES[] = {DRIVE_OFF, DRIVE_READY, DRIVE_ARMED, DRIVE_STAND_DOWN};
    for (uint32_t has = 0; has < 5; has++) {
        for (uint32_t unseen = 0; unseen < 3; unseen++) {
            for (uint32_t i = 0; i < 4; i++) {
                uint32_t mode = MODES[i];
                begin_drive();
                drive->state.mode = has == 1 ? DRIVE_ARMED : DRIVE_READY;
                drive->state.stopping = has == 2;
                drive->state.sent_motion = has == 3;
                drive->state.off_due = has == 4;
                drive->state.enabled = 1;
                drive->state.back = has != 0; /* it counts as power, too */
                uint32_t stops = drive->stops;
                obey(mode, unseen);
                bool off = has != 0 && (unseen != 0 || mode == DRIVE_OFF);
                CHECK(drive->state.stop == (off ? STOP_POWER_OFF : STOP_NOTHING) &&
                      drive->state.stopping == (has == 2 && !off));
                CHECK(drive->state.off_due == (has == 4 && !off));
                CHECK(drive->stops == stops + off + (unseen != 0) + (mode == DRIVE_STAND_DOWN));
                uint32_t expected = mode == DRIVE_OFF ? DRIVE_OFF : DRIVE_READY;
                if (mode == DRIVE_ARMED && !off && has != 2 && has != 4) {
                    expected = DRIVE_ARMED;
                }
                if (mode == DRIVE_READY && has == 1 && !off) {
                    expected = DRIVE_ARMED; /* an armed drive is set up */
                }
                CHECK(drive->state.mode == expected &&
                      drive->state.back == (has != 0 && mode != DRIVE_OFF));
                CHECK(has != 1 || mode == DRIVE_OFF || expected == DRIVE_ARMED ||
                      drive->state.enabled == 2);
            }
        }
    }
    begin_drive();
    drive->state.mode = DRIVE_UNRESPONSIVE;
    obey(DRIVE_READY, 0);
    CHECK(drive->state.mode == DRIVE_UNRESPONSIVE);
    uint32_t stops = drive->stops;
    obey(DRIVE_STAND_DOWN, 0);
    CHECK(drive->state.mode == DRIVE_UNRESPONSIVE && drive->stops == stops + 1);
}

/* Checks whether and why an armed drive stops after a look. */
static void guarded(uint32_t why, uint32_t stop)
{
    for (uint32_t i = 0; i < CAN_INPUTS_MAX; i++) {
        drive->received_ns[i] = w.now_ns;
    }
    w.machine.joint[0].feedback.velocity_rad_s = 1.0;
    can_guard(&w.machine, 0, w.now_ns);
    CHECK(drive->state.fault_reasons == why && drive->state.stop == stop &&
          drive->state.mode == (why == 0 ? DRIVE_ARMED : DRIVE_READY));
    CHECK(drive->state.stopping == (stop == STOP_QUICK));
    CHECK(stop != STOP_QUICK || drive->state.off_by_ns == w.now_ns + 1000 * MS);
}

static void begin_armed(void)
{
    begin_drive();
    drive->state.mode = DRIVE_ARMED;
    drive->may_turn = true;
}

static void an_armed_drive_is_stopped_when_set_points_grow_old(void)
{
    begin_armed();
    w.now_ns += 100 * MS;
    guarded(0, STOP_NOTHING);
    w.now_ns += 1;
    guarded(DRIVE_FAULT_SETPOINTS_OLD, STOP_QUICK);
}

static void an_armed_drive_left_alone_longer_than_its_watchdog_is_stopped(void)
{
    for (uint32_t how = 0; how < 3; how++) {
        begin_armed();
        w.now_ns += 500 * MS;
        w.machine.newest.stamp_ns = w.now_ns;
        guarded(0, STOP_NOTHING);
        w.now_ns += 1;
        w.machine.table.drive[0].watchdog_ns = how == 1 ? 0 : how == 2 ? 1 : 500 * MS;
        guarded(how == 1 ? 0 : (uint32_t)DRIVE_FAULT_LEFT_ALONE,
                how == 1 ? STOP_NOTHING : STOP_QUICK);
    }
}

static void an_armed_drive_whose_set_points_are_no_longer_enabled_loses_its_power(void)
{
    begin_armed();
    w.machine.newest.enabled = 0;
    drive->state.enabled_count = w.machine.enabled_count = 7;
    guarded(0, STOP_NOTHING); /* not enabled yet since the arming */
    w.machine.newest.enabled = 1;
    guarded(0, STOP_NOTHING);
    CHECK(drive->state.was_enabled);
    w.machine.newest.enabled = 0;
    guarded(DRIVE_FAULT_NOT_ENABLED, STOP_POWER_OFF);
    begin_armed();
    w.machine.newest.enabled = 0;
    drive->state.enabled_count = 7, w.machine.enabled_count = 8; /* enabled and disabled between two
                                                                    looks */
    guarded(DRIVE_FAULT_NOT_ENABLED, STOP_POWER_OFF);
}

int main(void)
{
    a_set_up_resets_all_state_but_a_stop_that_goes_on();
    it_is_armed_when_nothing_prevents_it_and_its_state_is_reset();
    switching_off_and_overtaken_requests_take_the_power_of_a_powered_drive();
    an_armed_drive_is_stopped_when_set_points_grow_old();
    an_armed_drive_left_alone_longer_than_its_watchdog_is_stopped();
    an_armed_drive_whose_set_points_are_no_longer_enabled_loses_its_power();
    return checks_report("can steps");
}
