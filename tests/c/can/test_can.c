/* SPDX-License-Identifier: Apache-2.0
 * The machine of a CAN bus in virtual time: the frames that it sends, which feedback counts, and
 * when it stops drives. */
#include "can_wire.h"

/* ------------------------------------------------------------------------------- values */
static void numbers_are_read_and_written_at_their_place(void)
{
    uint8_t data[8] = {0};
    can_put(data, &(can_place){.start_bit = 4, .length = 12}, 0xABC);
    CHECK(data[0] == 0xC0 && data[1] == 0xAB);
    memset(data, 0xFF, sizeof data);
    can_put(data, &(can_place){.start_bit = 8, .length = 16, .big_endian = 1, .form = CAN_SIGNED},
            -2);
    CHECK(data[0] == 0xFF && data[1] == 0xFF && data[2] == 0xFE && data[3] == 0xFF);
    CHECK(can_get(data,
                  &(can_place){
                      .start_bit = 8, .length = 16, .big_endian = 1, .form = CAN_SIGNED}) == -2);
    for (uint32_t start = 0; start <= 32; start++) {
        for (uint32_t big = 0; big < 2; big++) {
            can_place place = {
                .start_bit = start, .length = 32, .big_endian = big, .form = CAN_UNSIGNED};
            memset(data, 0x5A, sizeof data);
            can_put(data, &place, 0x12345678);
            CHECK(can_get(data, &place) == 0x12345678);
        }
    }
}

static void a_set_point_that_is_not_finite_or_too_large_is_harmless(void)
{
    begin_with(1);
    arm(0);
    const double bad[] = {(double)NAN, (double)INFINITY, -(double)INFINITY};
    for (uint32_t i = 0; i < 3; i++) {
        w.velocity_rad_s = bad[i];
        go_on(30 * MS);
        CHECK(speed_in(newest_of(0)) == 0);
    }
    w.velocity_rad_s = 1e300;
    go_on(30 * MS);
    CHECK(speed_in(newest_of(0)) == 1000);
    w.velocity_rad_s = -2.0;
    go_on(30 * MS);
    CHECK(speed_in(newest_of(0)) == -200);
}

static void minus_zero_is_sent_as_zero(void)
{
    begin_with(1);
    can_setpoint *setpoint = &w.table.drive[0].output[0].setpoint[0];
    w.table.drive[0].output[0].packet.bytes = 8;
    *setpoint = (can_setpoint){.place = {.start_bit = 32, .length = 32, .form = CAN_FLOAT},
                               .scale = {.raw_per_si = -1.0, .raw_min = -10.0, .raw_max = 10.0}};
    restart();
    arm(0);
    w.velocity_rad_s = 0.0;
    go_on(20 * MS);
    CHECK(can_get(newest_of(0)->data, &setpoint->place) == 0);
    w.velocity_rad_s = 1.0;
    go_on(20 * MS);
    CHECK(can_get(newest_of(0)->data, &setpoint->place) == 0xBF800000);
}

static void feedback_is_counts_and_si_with_the_kernel_s_stamp(void)
{
    begin_with(1);
    arm(0);
    report_motion(0, 1.0F, 0.0F);
    w.now_ns += MS;
    report_motion(0, -0.25F, 3.0F); /* too soon after the last frame to count */
    CHECK(w.machine.joint[0].feedback.count == 1000);
    w.now_ns += 6 * MS;
    report_motion(0, -0.25F, 3.0F);
    const joint_feedback *feedback = &w.machine.joint[0].feedback;
    CHECK(feedback->count == (1ULL << 32) - 250 && feedback->velocity_rad_s == 3.0);
    CHECK(feedback->stamp_ns == w.now_ns && feedback->epoch == 1 && isnan(feedback->current_a));
    CHECK((w.machine.feedback_mask & 1) == 1);
    w.machine.feedback_mask = 0;
    w.now_ns += 10 * MS;
    report_motion(0, NAN, 1.0F);
    CHECK(w.machine.feedback_mask == 0);
}

/* --------------------------------------------------------------------------- frames out */
static void only_zero_is_sent_before_arming_and_nothing_before_the_set_up(void)
{
    begin_with(2);
    go_on(100 * MS);
    CHECK(w.sent_count == 0);
    request(0, DRIVE_READY);
    go_on(100 * MS);
    CHECK(count_sent(SPEED) >= 9 && count_sent(SPEED + 1) == 0);
    for (uint32_t i = 0; i < w.sent_count; i++) {
        CHECK(speed_in(&w.sent[i]) == 0);
    }
}

static void received_frames_cause_no_frames_to_be_sent(void)
{
    begin_with(1);
    arm(0);
    go_on(50 * MS);
    forget_sent();
    for (uint32_t i = 0; i < 1000; i++) {
        report_state(0, 8);
        report_motion(0, 1.0F, 1.0F);
        w.now_ns += MS / 100;
        step();
    }
    CHECK(w.sent_count <= 2); /* at most the frames of two cycles */
}

static void held_bytes_are_sent_with_the_set_points(void)
{
    begin_with(1);
    arm(0);
    can_order order = {.write = {.packet = packet_of(SPEED, 4), .output = 1, .mask = {0xFF, 0xFF}},
                       .expires_ns = w.now_ns + 1000 * MS};
    order.write.packet.data[0] = ENABLE;
    CHECK(can_machine_order(&w.machine, &order));
    step();
    CHECK(newest_of(0)->data[0] == ENABLE);
    go_on(50 * MS);
    CHECK(newest_of(0)->data[0] == ENABLE && speed_in(newest_of(0)) == 100);
}

static void an_order_of_a_job_that_was_stopped_is_not_sent(void)
{
    begin_with(1);
    arm(0);
    can_order order = {.write = {.packet = packet_of(CONTROL, 1)},
                       .expires_ns = w.now_ns + 1000 * MS,
                       .guarded = 1,
                       .stops = w.machine.drive[0].stops};
    CHECK(can_machine_order(&w.machine, &order));
    request(0, DRIVE_STAND_DOWN);
    CHECK(count_sent(CONTROL) == 0 && w.machine.order_count == 0);
    order.stops = w.machine.drive[0].stops;
    CHECK(can_machine_order(&w.machine, &order));
    step();
    CHECK(count_sent(CONTROL) == 1);
}

static void one_sync_ends_each_cycle_after_the_set_points_of_all(void)
{
    begin_with(2);
    w.table.sync_count = 1;
    w.table.sync[0] = packet_of(0x80, 0);
    restart();
    arm(0);
    arm(1);
    forget_sent();
    go_on(100 * MS);
    CHECK(count_sent(0x80) == count_sent(SPEED) && count_sent(0x80) >= 9);
    for (uint32_t i = 0; i + 2 < w.sent_count; i += 3) {
        CHECK(w.sent[i].id == SPEED && w.sent[i + 1].id == SPEED + 1 && w.sent[i + 2].id == 0x80);
    }
}

static void a_full_bus_loses_set_points_and_then_gets_newer_ones(void)
{
    begin_with(1);
    arm(0);
    go_on(30 * MS);
    forget_sent();
    w.full = true;
    go_on(50 * MS);
    CHECK(w.machine.tx_full >= 4 && w.machine.drive[0].state.mode == DRIVE_ARMED);
    w.full = false;
    w.velocity_rad_s = 3.0;
    go_on(10 * MS);
    CHECK(w.sent_count <= 2 && speed_in(&w.sent[0]) == 300);
}

static void an_order_waits_while_the_bus_is_full_and_not_for_ever(void)
{
    begin_with(1);
    can_order order = {.write = {.packet = packet_of(CONTROL, 1)},
                       .expires_ns = w.now_ns + 50 * MS};
    w.full = true;
    CHECK(can_machine_order(&w.machine, &order));
    go_on(20 * MS);
    w.full = false;
    go_on(5 * MS);
    CHECK(count_sent(CONTROL) == 1);
    w.full = true;
    order.expires_ns = w.now_ns + 50 * MS;
    CHECK(can_machine_order(&w.machine, &order));
    go_on(60 * MS);
    w.full = false;
    go_on(20 * MS);
    CHECK(count_sent(CONTROL) == 1 && w.machine.order_count == 0);
    CHECK(w.machine.drive[0].orders_sent == 1 && w.machine.drive[0].orders_dropped == 1);
}

/* ----------------------------------------------------------------------------- stopping */
static void old_set_points_are_a_quick_stop_and_then_power_off_at_rest(void)
{
    begin_with(1);
    arm(0);
    w.reported_rad_s = 1.0;
    go_on(50 * MS);
    forget_sent();
    int64_t last_ns = w.now_ns;
    w.enabled = 2;
    go_on(150 * MS);
    int64_t stopped_ns = first_sent_ns(0, QUICK_STOP);
    CHECK(stopped_ns > last_ns && stopped_ns <= last_ns + 110 * MS &&
          first_sent_ns(0, DISABLE) == 0);
    CHECK(speed_in(newest_of(0)) == 0 &&
          w.machine.drive[0].state.fault_reasons == DRIVE_FAULT_SETPOINTS_OLD);
    w.reported_rad_s = 0.0;
    go_on(30 * MS);
    CHECK(first_sent_ns(0, DISABLE) > stopped_ns);
    w.enabled = 1;
    w.powered = false;
    go_on(100 * MS);
    CHECK(w.machine.drive[0].state.mode == DRIVE_READY && speed_in(newest_of(0)) == 0);
}

static void a_wheel_that_keeps_turning_loses_its_power_after_a_second(void)
{
    begin_with(1);
    arm(0);
    w.reported_rad_s = 1.0;
    go_on(50 * MS);
    int64_t last_ns = w.now_ns;
    w.enabled = 2;
    go_on(1300 * MS);
    CHECK(first_sent_ns(0, DISABLE) > last_ns + 1000 * MS &&
          first_sent_ns(0, DISABLE) < last_ns + 1150 * MS);
}

static void clearing_enabled_takes_the_power_at_once(void)
{
    begin_with(1);
    arm(0);
    go_on(50 * MS);
    forget_sent();
    w.enabled = 0;
    step();
    CHECK(w.sent[0].data[0] == DISABLE && speed_in(&w.sent[0]) == 0);
    CHECK(w.machine.drive[0].state.mode == DRIVE_READY &&
          w.machine.drive[0].state.fault_reasons == DRIVE_FAULT_NOT_ENABLED);
}

static void a_stop_that_the_bus_did_not_take_is_sent_again(void)
{
    begin_with(1);
    arm(0);
    go_on(50 * MS);
    forget_sent();
    w.full = true;
    w.enabled = 0;
    go_on(30 * MS);
    w.full = false;
    step();
    CHECK(w.sent[0].data[0] == DISABLE);
}

static void a_set_point_of_zero_does_not_wait_for_its_cycle(void)
{
    begin_with(1);
    w.table.period_ns = 1000 * MS;
    w.table.drive[0].watchdog_ns = 0;
    restart();
    arm(0);
    go_on(2000 * MS);
    CHECK(w.machine.drive[0].state.sent_motion);
    w.velocity_rad_s = 0.0;
    go_on(10 * MS);
    CHECK(speed_in(newest_of(0)) == 0 && !w.machine.drive[0].state.sent_motion);
}

static void a_pause_longer_than_the_watchdog_stops_the_drive(void)
{
    begin_with(1);
    arm(0);
    go_on(50 * MS);
    w.now_ns += 600 * MS; /* without frames for so long, a drive with a watchdog stops */
    report_state(0, 8);
    report_motion(0, 1.0F, 1.0F);
    step();
    CHECK(w.machine.drive[0].state.fault_reasons == DRIVE_FAULT_LEFT_ALONE &&
          w.machine.drive[0].state.mode == DRIVE_READY);
}

static void an_armed_drive_that_reports_it_is_not_enabled_is_off(void)
{
    begin_with(1);
    arm(0);
    go_on(50 * MS);
    w.powered = false;
    go_on(20 * MS);
    CHECK(w.machine.drive[0].state.mode == DRIVE_OFF &&
          w.machine.drive[0].state.fault_reasons == DRIVE_FAULT_DISABLED_ITSELF);
    CHECK(newest_of(0)->data[0] == DISABLE && speed_in(newest_of(0)) == 0);
}

static void a_drive_that_stays_enabled_is_sent_its_power_off_once_a_cycle(void)
{
    begin_with(1);
    go_on(20 * MS);
    request(0, DRIVE_READY);
    w.powered = true;
    go_on(50 * MS);
    CHECK((w.machine.drive[0].state.fault_reasons & DRIVE_FAULT_STILL_ENABLED) != 0);
    forget_sent();
    for (uint32_t i = 0; i < 1000; i++) {
        report_state(0, 8);
        w.now_ns += MS / 100;
        step();
    }
    CHECK(w.sent_count <= 4);
}

static void a_drive_that_is_being_armed_may_report_that_it_is_enabled(void)
{
    begin_with(1);
    go_on(20 * MS);
    request(0, DRIVE_READY);
    w.machine.control.drive[0].arming_until_ns = w.now_ns + 500 * MS;
    w.powered = true;
    forget_sent();
    go_on(100 * MS);
    CHECK(first_sent_ns(0, DISABLE) == 0 && w.machine.drive[0].state.fault_reasons == 0);
}

static void shutting_down_stops_and_then_takes_the_power_within_half_a_second(void)
{
    begin_with(2);
    arm(0);
    w.reported_rad_s = 1.0;
    go_on(50 * MS);
    forget_sent();
    int64_t asked_ns = w.now_ns;
    w.machine.control.shut_down = 1;
    go_on(360 * MS);
    w.powered = false;
    go_on(140 * MS);
    CHECK(w.machine.end.stage == END_SILENT);
    CHECK(first_sent_ns(0, QUICK_STOP) == asked_ns && first_sent_ns(1, QUICK_STOP) == 0);
    CHECK(first_sent_ns(0, DISABLE) >= asked_ns + 350 * MS &&
          first_sent_ns(1, DISABLE) >= asked_ns + 350 * MS);
    forget_sent();
    go_on(100 * MS);
    CHECK(w.sent_count == 0);
}

/* ----------------------------------------------------------------------------- presence */
static void a_silent_drive_is_unresponsive_and_comes_back_disarmed_in_a_new_epoch(void)
{
    begin_with(1);
    arm(0);
    go_on(50 * MS);
    w.silent = true;
    int64_t silent_ns = w.now_ns;
    forget_sent();
    while (w.machine.drive[0].state.mode == DRIVE_ARMED) {
        go_on(5 * MS);
    }
    CHECK(w.machine.drive[0].state.mode == DRIVE_UNRESPONSIVE && w.now_ns - silent_ns < 230 * MS);
    go_on(50 * MS);
    CHECK(first_sent_ns(0, QUICK_STOP) > 0 && speed_in(newest_of(0)) == 0);
    go_on(3000 * MS);
    CHECK(first_sent_ns(0, DISABLE) > 0);
    w.silent = false;
    w.powered = false;
    go_on(50 * MS);
    CHECK(w.machine.drive[0].state.mode == DRIVE_BACK && newest_of(0)->data[0] == DISABLE);
    request(0, DRIVE_ARMED);
    CHECK(w.machine.drive[0].state.mode == DRIVE_BACK);
    request(0, DRIVE_READY);
    go_on(50 * MS);
    CHECK(w.machine.drive[0].state.mode == DRIVE_READY && w.machine.joint[0].feedback.epoch == 2);
    CHECK(speed_in(newest_of(0)) == 0);
}

static void one_missing_frame_makes_a_drive_unresponsive(void)
{
    begin_with(1);
    arm(0);
    w.silent = true;
    for (uint32_t i = 0; i < 60; i++) {
        report_motion(0, 1.0F, 1.0F);
        go_on(10 * MS);
    }
    CHECK(w.machine.drive[0].state.mode == DRIVE_UNRESPONSIVE && w.machine.drive[0].missing == 1);
}

static void epochs_continue_when_a_line_is_reopened(void)
{
    begin_with(1);
    arm(0);
    restart();
    arm(0);
    CHECK(w.machine.drive[0].state.epoch == 2);
}

static void only_frames_that_asyncio_listens_to_are_handed_on(void)
{
    begin_with(2);
    const uint8_t answer[8] = {0x43}, other[8] = {0x80};
    CHECK(say(ANSWER + 1, answer, 8) == CAN_FOR_NOBODY);
    w.machine.control.listen = 2;
    CHECK(say(ANSWER + 1, answer, 8) == 1 && say(ANSWER, answer, 8) == CAN_FOR_NOBODY);
    CHECK(say(CAN_ID_ERROR | 0x40, other, 8) == CAN_DRIVES_MAX);
    CHECK(w.machine.bad_frames == 0);
    CHECK(say(ANSWER, other, 8) == CAN_FOR_NOBODY && say(MOTION, other, 4) == CAN_FOR_NOBODY);
    CHECK(w.machine.bad_frames == 2);
    CHECK(say(0x7FF, other, 8) == CAN_FOR_NOBODY &&
          say(CAN_ID_REMOTE | MOTION, other, 8) == CAN_FOR_NOBODY);
    CHECK(w.machine.bad_frames == 2);
}

static void bytes_outside_of_the_mask_do_not_distinguish_frames(void)
{
    begin_with(1);
    can_match *match = &w.table.drive[0].match[2];
    match->begins_bytes = 3;
    memcpy(match->begins, (const uint8_t[]){0x43, 0, 0x60}, 3);
    memcpy(match->begins_mask, (const uint8_t[]){0xFF, 0, 0xFF}, 3);
    restart();
    w.machine.control.listen = 1;
    const uint8_t same[8] = {0x43, 0x99, 0x60}, other[8] = {0x43, 0x99, 0x61};
    CHECK(say(ANSWER, same, 8) == 0 && say(ANSWER, other, 8) == CAN_FOR_NOBODY);
}

/* -------------------------------------------------------------------------------- table */
static bool is_bad(void)
{
    char name[FIELD_NAME_BYTES];
    return can_table_check(&w.table, name) != NULL;
}

static void a_table_that_points_outside_of_its_frames_is_refused(void)
{
    begin_with(2);
    CHECK(!is_bad());
    can_drive *drive = &w.table.drive[1];
    drive->output[0].setpoint[0].place.start_bit = 17;
    CHECK(is_bad());
    drive->output[0].setpoint[0].place.start_bit = UINT32_MAX;
    CHECK(is_bad());
    begin_with(2);
    drive->match[1].bytes = 7; /* shorter than the values that it holds */
    CHECK(is_bad());
    begin_with(2);
    drive->input[0].field[0].meaning.joint = JOINTS_MAX;
    CHECK(is_bad());
    begin_with(2);
    drive->output[0].setpoint[0].scale.raw_per_si = (double)NAN;
    CHECK(is_bad());
    begin_with(2);
    drive->disarm[0].output = 2;
    CHECK(is_bad());
    begin_with(2);
    drive->match[0].input = 3;
    CHECK(is_bad());
    begin_with(2);
    drive->output[0].packet.bytes = 9; /* too long for a classic frame */
    CHECK(is_bad());
}

int main(void)
{
    numbers_are_read_and_written_at_their_place();
    a_set_point_that_is_not_finite_or_too_large_is_harmless();
    minus_zero_is_sent_as_zero();
    feedback_is_counts_and_si_with_the_kernel_s_stamp();
    only_zero_is_sent_before_arming_and_nothing_before_the_set_up();
    received_frames_cause_no_frames_to_be_sent();
    held_bytes_are_sent_with_the_set_points();
    an_order_of_a_job_that_was_stopped_is_not_sent();
    one_sync_ends_each_cycle_after_the_set_points_of_all();
    bytes_outside_of_the_mask_do_not_distinguish_frames();
    a_full_bus_loses_set_points_and_then_gets_newer_ones();
    an_order_waits_while_the_bus_is_full_and_not_for_ever();
    old_set_points_are_a_quick_stop_and_then_power_off_at_rest();
    a_wheel_that_keeps_turning_loses_its_power_after_a_second();
    clearing_enabled_takes_the_power_at_once();
    a_stop_that_the_bus_did_not_take_is_sent_again();
    a_set_point_of_zero_does_not_wait_for_its_cycle();
    a_pause_longer_than_the_watchdog_stops_the_drive();
    an_armed_drive_that_reports_it_is_not_enabled_is_off();
    a_drive_that_stays_enabled_is_sent_its_power_off_once_a_cycle();
    a_drive_that_is_being_armed_may_report_that_it_is_enabled();
    shutting_down_stops_and_then_takes_the_power_within_half_a_second();
    a_silent_drive_is_unresponsive_and_comes_back_disarmed_in_a_new_epoch();
    one_missing_frame_makes_a_drive_unresponsive();
    epochs_continue_when_a_line_is_reopened();
    only_frames_that_asyncio_listens_to_are_handed_on();
    a_table_that_points_outside_of_its_frames_is_refused();
    return checks_report("can");
}
