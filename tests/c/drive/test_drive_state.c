/* SPDX-License-Identifier: Apache-2.0
 * The rules of when a drive has to stop: every state and every event, compared with a table. */
#include "check.h"
#include "drive_state.h"

static const int64_t NOW_NS = 5000000000;
enum { MODES = 5, REQUESTS = 6 };
static const uint32_t MODE[MODES] = {DRIVE_OFF, DRIVE_READY, DRIVE_ARMED, DRIVE_UNRESPONSIVE,
                                     DRIVE_BACK};
static const uint32_t REQUEST[REQUESTS] = {DRIVE_OFF,        DRIVE_READY,        DRIVE_ARMED,
                                           DRIVE_STAND_DOWN, DRIVE_UNRESPONSIVE, DRIVE_BACK};

static drive_view good_view(void)
{
    return (drive_view){.now_ns = NOW_NS, .fresh = true, .enabled = true, .enabled_count = 7};
}

/* ----------------------------------------------------------------------------- requests */
/* The mode to which each request (column) leads from each mode (row), if nothing prevents it. */
static const uint32_t FOLLOWS[MODES][REQUESTS] = {
    {DRIVE_OFF, DRIVE_READY, DRIVE_OFF, DRIVE_OFF, DRIVE_OFF, DRIVE_OFF},
    {DRIVE_OFF, DRIVE_READY, DRIVE_ARMED, DRIVE_READY, DRIVE_READY, DRIVE_READY},
    {DRIVE_OFF, DRIVE_ARMED, DRIVE_ARMED, DRIVE_READY, DRIVE_ARMED, DRIVE_ARMED},
    {DRIVE_UNRESPONSIVE, DRIVE_UNRESPONSIVE, DRIVE_UNRESPONSIVE, DRIVE_UNRESPONSIVE,
     DRIVE_UNRESPONSIVE, DRIVE_UNRESPONSIVE},
    {DRIVE_OFF, DRIVE_READY, DRIVE_BACK, DRIVE_BACK, DRIVE_BACK, DRIVE_BACK},
};

static drive_request event_of(uint32_t from, uint32_t request)
{
    bool set_up = from == DRIVE_OFF || from == DRIVE_BACK;
    return request == DRIVE_OFF && from != DRIVE_UNRESPONSIVE   ? REQUEST_OFF
           : request == DRIVE_READY && set_up                   ? REQUEST_SET_UP
           : request == DRIVE_ARMED && from == DRIVE_READY      ? REQUEST_ARM
           : request == DRIVE_STAND_DOWN && from == DRIVE_ARMED ? REQUEST_STAND_DOWN
                                                                : REQUEST_SEEN;
}

static void each_request_leads_to_the_mode_of_the_table(void)
{
    for (int m = 0; m < MODES; m++) {
        for (int r = 0; r < REQUESTS; r++) {
            drive_state drive = {.mode = MODE[m],
                                 .request_seen = 3,
                                 .fault_reasons = 8,
                                 .still_enabled = 2,
                                 .enabled = 1,
                                 .epoch = 4};
            drive_view view = good_view();
            mode_request request = {.count = 4, .mode = REQUEST[r]};
            drive_answer answer = drive_obey(&drive, &request, &view);
            drive_request event = event_of(MODE[m], REQUEST[r]);
            bool begins = event == REQUEST_SET_UP || event == REQUEST_ARM;
            CHECK(drive.mode == FOLLOWS[m][r] && answer.request == event && !answer.overtaken &&
                  drive.request_seen == 4);
            bool powered = MODE[m] == DRIVE_ARMED || MODE[m] == DRIVE_BACK;
            CHECK(answer.stop ==
                  (powered && REQUEST[r] == DRIVE_OFF ? STOP_POWER_OFF : STOP_NOTHING));
            CHECK(drive.fault_reasons == (begins ? 0 : 8) &&
                  drive.still_enabled == (begins ? 0 : 2));
            CHECK(drive.epoch == (event == REQUEST_SET_UP ? 5 : 4));
            CHECK(drive.enabled == (event == REQUEST_ARM || event == REQUEST_STAND_DOWN ? 2 : 1));
            CHECK(drive.enabled_count == (event == REQUEST_ARM ? 7 : 0));
            answer = drive_obey(&drive, &request, &view);
            CHECK(answer.request == REQUEST_NONE && answer.stop == STOP_NOTHING &&
                  !answer.overtaken);
        }
    }
}

/* It is owed a power-off, which its probes send. Once it answers, the power-off is due at once. */
static void a_request_of_off_leaves_an_unresponsive_drive_to_its_probes_until_it_answers(void)
{
    const mode_request request = {.count = 1, .mode = DRIVE_OFF};
    const drive_view view = good_view();
    drive_state drive = {.mode = DRIVE_READY};
    drive_unresponsive(&drive);
    CHECK(drive_obey(&drive, &request, &view).request == REQUEST_SEEN);
    CHECK(drive.mode == DRIVE_UNRESPONSIVE && drive.request_seen == 1);
    CHECK(drive_answers(&drive, false) == STOP_POWER_OFF);
    drive.request_seen = 0;
    CHECK(drive_obey(&drive, &request, &view).request == REQUEST_OFF);
    CHECK(drive.mode == DRIVE_OFF && !drive.back);
}

static void a_drive_is_not_armed_while_any_condition_prevents_it(void)
{
    for (int against = 0; against < 7; against++) {
        drive_state drive = {.mode = DRIVE_READY, .was_enabled = true};
        drive_view view = good_view();
        mode_request request = {.count = 1, .mode = DRIVE_ARMED};
        view.fresh = against != 1;
        view.shut_down = against == 2;
        drive.stopping = against == 3;
        drive.stop = against == 4 ? STOP_QUICK : against == 5 ? STOP_POWER_OFF : STOP_NOTHING;
        drive.off_due = against == 6;
        drive_answer answer = drive_obey(&drive, &request, &view);
        CHECK(drive.mode == (against == 0 ? DRIVE_ARMED : DRIVE_READY));
        CHECK(answer.request == (against == 0 ? REQUEST_ARM : REQUEST_SEEN));
        CHECK(drive.was_enabled == (against != 0));
    }
}

/* An overtaken request may have been a stop: a drive that may have power loses it, and the newer
 * request does not arm it. */
static void a_request_that_was_overtaken_counts_as_a_stop(void)
{
    for (int m = 0; m < MODES; m++) {
        for (int r = 0; r < REQUESTS; r++) {
            for (int power = 0; power < 5; power++) {
                drive_state drive = {.mode = MODE[m], .request_seen = UINT32_MAX};
                drive.back = power == 4;
                drive.stopping = power == 1;
                drive.sent_motion = power == 2;
                drive.off_due = power == 3;
                drive_view view = good_view();
                mode_request request = {.count = 1, .mode = REQUEST[r]};
                drive_answer answer = drive_obey(&drive, &request, &view);
                bool powered = power > 0 || MODE[m] == DRIVE_ARMED || MODE[m] == DRIVE_BACK;
                CHECK(answer.overtaken && answer.stop == (powered ? STOP_POWER_OFF : STOP_NOTHING));
                CHECK(!drive.stopping && !drive.off_due);
                bool arms = MODE[m] == DRIVE_READY && REQUEST[r] == DRIVE_ARMED && !powered;
                CHECK((drive.mode == DRIVE_ARMED) == arms &&
                      (answer.request == REQUEST_ARM) == arms);
                CHECK(drive.back == (power == 4 && answer.request != REQUEST_OFF &&
                                     answer.request != REQUEST_SET_UP));
            }
        }
    }
}

/* ----------------------------------------------------------------------------- guarding */
static void a_drive_without_a_known_position_gets_no_power(void)
{
    drive_state drive = {.mode = DRIVE_READY};
    drive_view view = good_view();
    view.position_unknown = true;
    mode_request request = {.count = 1, .mode = DRIVE_ARMED};
    CHECK(drive_obey(&drive, &request, &view).request == REQUEST_SEEN && drive.mode == DRIVE_READY);
    CHECK(drive.fault_reasons == DRIVE_FAULT_POSITION_UNKNOWN &&
          drive_guard(&drive, &view) == STOP_NOTHING);
    drive = (drive_state){.mode = DRIVE_READY, .fault_reasons = DRIVE_FAULT_LEFT_ALONE};
    CHECK(drive_obey(&drive, &request, &view).request == REQUEST_SEEN);
    /* earlier reasons are kept */
    CHECK(drive.fault_reasons == (DRIVE_FAULT_LEFT_ALONE | DRIVE_FAULT_POSITION_UNKNOWN));
    drive = (drive_state){.mode = DRIVE_ARMED, .enabled = 1};
    CHECK(drive_guard(&drive, &view) == STOP_POWER_OFF && drive.mode == DRIVE_READY &&
          !drive.stopping);
    CHECK(drive.fault_reasons == DRIVE_FAULT_POSITION_UNKNOWN && drive.enabled == 2);
    view.fresh = false; /* the drive may be moving */
    drive = (drive_state){.mode = DRIVE_ARMED};
    CHECK(drive_guard(&drive, &view) == STOP_QUICK &&
          drive.fault_reasons == DRIVE_FAULT_SETPOINTS_OLD);
}

/* The first reason that is true decides. */
static void an_armed_drive_is_stopped_for_each_reason_in_order(void)
{
    for (uint32_t bits = 0; bits < 64; bits++) {
        bool fresh = bits & 1, alone = bits & 2, enabled = bits & 4, was = bits & 8,
             between = bits & 16, armed = bits & 32;
        drive_state drive = {
            .mode = armed ? DRIVE_ARMED : DRIVE_READY, .was_enabled = was, .enabled = 1};
        drive.enabled_count = between ? 6 : 7;
        drive_view view = {.now_ns = NOW_NS,
                           .fresh = fresh,
                           .left_alone = alone,
                           .enabled = enabled,
                           .enabled_count = 7};
        drive_stop stop = drive_guard(&drive, &view);
        uint32_t why = !armed                         ? 0
                       : !fresh                       ? DRIVE_FAULT_SETPOINTS_OLD
                       : alone                        ? DRIVE_FAULT_LEFT_ALONE
                       : !enabled && (was || between) ? DRIVE_FAULT_NOT_ENABLED
                                                      : 0;
        bool quick = why == DRIVE_FAULT_SETPOINTS_OLD || why == DRIVE_FAULT_LEFT_ALONE;
        CHECK(drive.fault_reasons == why && stop == (quick      ? STOP_QUICK
                                                     : why != 0 ? STOP_POWER_OFF
                                                                : STOP_NOTHING));
        CHECK(drive.mode == (armed && why == 0 ? DRIVE_ARMED : DRIVE_READY) &&
              drive.enabled == (why != 0 ? 2 : 1));
        CHECK(drive.stopping == quick && drive.off_by_ns == (quick ? NOW_NS + 1000000000 : 0));
        CHECK(drive.was_enabled == (was || (armed && why == 0 && enabled)));
        CHECK(drive_is_changed(&drive) == (why != 0) && !drive_is_changed(&drive));
    }
}

static void a_last_power_off_is_confirmed_by_the_drive_s_report(void)
{
    drive_last_off off = {0};
    /* no power-off has been sent */
    CHECK(!drive_is_off(&off, true, 0, NOW_NS) && !drive_is_off(&off, false, 2, NOW_NS));
    off.suffices = true;
    CHECK(!drive_is_off(&off, true, 0, NOW_NS));
    off.first_ns = off.newest_ns = NOW_NS;
    CHECK(drive_is_off(&off, true, 1, 0) && drive_is_off(&off, false, 2, 0));
    off.suffices = false;
    CHECK(drive_is_off(&off, true, 0, 0) && !drive_is_off(&off, true, 1, NOW_NS) &&
          !drive_is_off(&off, true, 2, NOW_NS));
}

static void without_reported_power_a_drive_has_to_send_between_two_power_offs(void)
{
    drive_last_off off = {.first_ns = NOW_NS, .newest_ns = NOW_NS + 10};
    CHECK(!drive_is_off(&off, false, 2, NOW_NS) && drive_is_off(&off, false, 2, NOW_NS + 1));
    CHECK(drive_is_off(&off, false, 2, NOW_NS + 10) && !drive_is_off(&off, false, 2, NOW_NS + 11));
    off.newest_ns = NOW_NS;
    /* only one power-off has been sent */
    CHECK(!drive_is_off(&off, false, 2, NOW_NS) && !drive_is_off(&off, false, 2, NOW_NS + 1));
}

static void a_drive_is_left_alone_when_it_got_nothing_for_longer_than_its_watchdog_waits(void)
{
    CHECK(!drive_left_alone(NOW_NS - 5, NOW_NS, 5) && drive_left_alone(NOW_NS - 6, NOW_NS, 5));
    CHECK(!drive_left_alone(NOW_NS, NOW_NS, 1) && drive_left_alone(0, NOW_NS, 1));
    CHECK(!drive_left_alone(0, NOW_NS, 0) && !drive_left_alone(0, NOW_NS, -1)); /* without a
                                                                                   watchdog */
    /* a frame was received in the meantime */
    CHECK(!drive_left_alone(NOW_NS + 6, NOW_NS, 5));
}

static void only_an_armed_drive_moves_by_fresh_set_points_that_are_enabled(void)
{
    for (int m = 0; m < MODES; m++) {
        for (uint32_t bits = 0; bits < 8; bits++) {
            bool fresh = bits & 1, enabled = bits & 2, wants = bits & 4, moved = bits & 2;
            drive_state drive = {.mode = MODE[m], .sent_motion = moved};
            CHECK(drive_may_move(&drive, fresh, enabled) ==
                  (MODE[m] == DRIVE_ARMED && fresh && enabled));
            bool cycled = MODE[m] == DRIVE_ARMED || MODE[m] == DRIVE_READY;
            CHECK(drive_has_to_rest(&drive, wants) == (cycled && moved && !wants));
        }
    }
}

static void the_power_goes_off_at_rest_or_in_time_but_not_before_the_stop_is_confirmed(void)
{
    for (uint32_t bits = 0; bits < 16; bits++) {
        bool stopping = bits & 1, rests = bits & 2, late = bits & 4, pending = bits & 8;
        drive_state drive = {.mode = DRIVE_READY, .stopping = stopping, .off_by_ns = NOW_NS};
        drive.stop = pending ? STOP_QUICK : STOP_NOTHING;
        bool off = stopping && !pending && (rests || late);
        CHECK(drive_end_stopping(&drive, rests, late ? NOW_NS : NOW_NS - 1) ==
              (off ? STOP_POWER_OFF : STOP_NOTHING));
        CHECK(drive.stopping == (stopping && !off));
    }
}

static void a_drive_that_reports_power_without_arming_is_switched_off(void)
{
    for (int m = 0; m < MODES; m++) {
        for (uint32_t bits = 0; bits < 24; bits++) {
            uint32_t word = bits % 3;
            bool settled = bits / 3 & 1, stopping = bits / 6 & 1, pending = bits / 12 & 1;
            drive_state drive = {
                .mode = MODE[m], .enabled = word, .stopping = stopping, .still_enabled = 1};
            drive.stop = pending ? STOP_POWER_OFF : STOP_NOTHING;
            drive_stop stop = drive_check_power(&drive, 2, settled);
            bool itself = MODE[m] == DRIVE_ARMED && word == 0;
            bool nobody = MODE[m] == DRIVE_READY && word == 1 && settled && !stopping && !pending;
            CHECK(stop == (itself || nobody ? STOP_POWER_OFF : STOP_NOTHING));
            CHECK(drive.mode == (itself ? DRIVE_OFF : MODE[m]));
            CHECK(drive.fault_reasons == (itself   ? DRIVE_FAULT_DISABLED_ITSELF
                                          : nobody ? DRIVE_FAULT_STILL_ENABLED
                                                   : 0U));
            CHECK(drive.still_enabled == (nobody ? 2U : word == 0 && !itself ? 0U : 1U));
        }
    }
    drive_state drive = {.mode = DRIVE_READY, .enabled = 1, .still_enabled = 0};
    CHECK(drive_check_power(&drive, 2, true) == STOP_POWER_OFF && drive.fault_reasons == 0 &&
          drive.still_enabled == 1);
    drive.enabled = 1, drive.still_enabled = 2;
    CHECK(drive_check_power(&drive, 2, true) == STOP_POWER_OFF && drive.fault_reasons == 0 &&
          drive.still_enabled == 3);
}

static void a_confirmed_stop_ends_the_unresponsive_mode(void)
{
    for (int m = 0; m < MODES; m++) {
        for (int back = 0; back < 2; back++) {
            drive_state drive = {
                .mode = MODE[m], .stop = STOP_POWER_OFF, .enabled = 1, .back = back == 1};
            CHECK(drive_stop_done(&drive) == (back == 1));
            CHECK(drive.stop == STOP_NOTHING && drive.enabled == 2 && !drive.back);
            CHECK(drive.mode == (back == 1 ? DRIVE_BACK : MODE[m]));
        }
    }
}

static void a_drive_that_stops_answering_keeps_only_its_fault_reasons_in_every_mode(void)
{
    for (int m = 0; m < MODES; m++) {
        for (uint32_t bits = 0; bits < 8; bits++) {
            drive_state drive = {
                .mode = MODE[m], .enabled = 1, .fault_reasons = DRIVE_FAULT_LEFT_ALONE};
            drive.stopping = bits & 1, drive.back = bits >> 1 & 1, drive.off_due = bits >> 2 & 1;
            drive.stop = STOP_QUICK;
            drive_unresponsive(&drive);
            CHECK(drive.mode == DRIVE_UNRESPONSIVE && drive.enabled == 2 &&
                  drive.stop == STOP_QUICK);
            CHECK(drive.fault_reasons == (DRIVE_FAULT_LEFT_ALONE | DRIVE_FAULT_UNRESPONSIVE));
            CHECK(!drive.stopping && !drive.back && !drive.off_due);
            for (int braking = 0; braking < 2; braking++) {
                drive.mode = DRIVE_UNRESPONSIVE;
                drive_stop stop = drive_answers(&drive, braking == 1);
                CHECK(stop == (braking == 1 ? STOP_NOTHING : STOP_POWER_OFF));
                CHECK(drive.back == (braking == 0) &&
                      drive.mode == (braking == 1 ? DRIVE_BACK : DRIVE_UNRESPONSIVE));
                CHECK(drive_stop_done(&drive) == (braking == 0) && drive.mode == DRIVE_BACK &&
                      !drive.back);
            }
        }
    }
}

static void a_drive_that_has_lost_its_set_up_gets_a_power_off(void)
{
    for (int m = 0; m < MODES; m++) {
        drive_state drive = {.mode = MODE[m], .enabled = 1, .stopping = true};
        CHECK(drive_lost_setup(&drive) == STOP_POWER_OFF && drive.mode == DRIVE_OFF &&
              !drive.stopping);
        CHECK(drive.fault_reasons == DRIVE_FAULT_LOST_SETUP && drive.enabled == 2);
    }
}

static void reasons_gather(void)
{
    drive_state drive = {.mode = DRIVE_ARMED, .enabled = 1};
    drive_take_back(&drive, DRIVE_FAULT_LEFT_ALONE, DRIVE_READY);
    CHECK(drive.fault_reasons == DRIVE_FAULT_LEFT_ALONE && drive.mode == DRIVE_READY &&
          drive.enabled == 2);
    drive_take_back(&drive, DRIVE_FAULT_UNRESPONSIVE, DRIVE_UNRESPONSIVE);
    CHECK(drive.fault_reasons == (DRIVE_FAULT_LEFT_ALONE | DRIVE_FAULT_UNRESPONSIVE) &&
          drive.mode == DRIVE_UNRESPONSIVE);
    CHECK(!drive_is_cycled(&drive));
}

int main(void)
{
    each_request_leads_to_the_mode_of_the_table();
    a_request_of_off_leaves_an_unresponsive_drive_to_its_probes_until_it_answers();
    a_drive_is_not_armed_while_any_condition_prevents_it();
    a_request_that_was_overtaken_counts_as_a_stop();
    an_armed_drive_is_stopped_for_each_reason_in_order();
    a_drive_is_left_alone_when_it_got_nothing_for_longer_than_its_watchdog_waits();
    a_last_power_off_is_confirmed_by_the_drive_s_report();
    without_reported_power_a_drive_has_to_send_between_two_power_offs();
    only_an_armed_drive_moves_by_fresh_set_points_that_are_enabled();
    a_drive_without_a_known_position_gets_no_power();
    the_power_goes_off_at_rest_or_in_time_but_not_before_the_stop_is_confirmed();
    a_drive_that_reports_power_without_arming_is_switched_off();
    a_confirmed_stop_ends_the_unresponsive_mode();
    a_drive_that_stops_answering_keeps_only_its_fault_reasons_in_every_mode();
    a_drive_that_has_lost_its_set_up_gets_a_power_off();
    reasons_gather();
    return checks_report("drive state");
}
