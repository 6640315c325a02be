/* SPDX-License-Identifier: Apache-2.0
 * One drive of a CAN bus, step by step: which frames it is sent, when its state is cleared, and
 * when asyncio is notified. */
#include "can_wire.h"

enum { SECOND = 0x700 };

static bool took_changes(void)
{
    bool notify = w.machine.notify;
    w.machine.notify = false;
    return notify;
}

static void hold(uint32_t byte, uint8_t value)
{
    can_order order = {.write = {.packet = packet_of(SPEED, 4), .output = 1},
                       .expires_ns = w.now_ns + 1000 * MS};
    order.write.packet.data[byte] = value;
    order.write.mask[byte] = 0xFF;
    CHECK(can_machine_order(&w.machine, &order));
    step();
}

/* ------------------------------------------------------------------ frames to the drive */
static void a_drive_that_gets_all_its_frames_is_never_left_alone(void)
{
    begin_with(1);
    arm(0);
    go_on(3000 * MS);
    CHECK(state_of(0)->state.mode == DRIVE_ARMED && state_of(0)->state.fault_reasons == 0 &&
          w.machine.tx_full == 0);
    CHECK(w.machine.sent == w.sent_count && w.sent_count >= 290);
}

static void a_frame_that_the_bus_does_not_take_does_not_feed_the_watchdog(void)
{
    begin_with(1);
    arm_and_go();
    uint64_t sent = w.machine.sent;
    w.full = true;
    go_on(480 * MS);
    CHECK(state_of(0)->state.mode == DRIVE_ARMED && w.machine.sent == sent &&
          w.machine.tx_full >= 47);
    go_on(50 * MS);
    CHECK(state_of(0)->state.mode == DRIVE_READY &&
          state_of(0)->state.fault_reasons == DRIVE_FAULT_LEFT_ALONE);
}

static void a_write_to_a_frame_of_the_cycle_keeps_the_other_held_bytes(void)
{
    begin_with(1);
    arm(0);
    hold(0, ENABLE);
    hold(1, 0x5A);
    CHECK(newest_of(0)->data[0] == ENABLE && newest_of(0)->data[1] == 0x5A);
    go_on(30 * MS);
    CHECK(newest_of(0)->data[0] == ENABLE && newest_of(0)->data[1] == 0x5A &&
          speed_in(newest_of(0)) == 100);
}

static void held_bytes_are_cleared_with_the_drive(void)
{
    begin_with(1);
    table_of(0)->disarm[0].mask[1] = 0; /* byte 1 is not part of the stop */
    table_of(0)->quick_stop[0].mask[1] = 0;
    restart();
    arm(0);
    hold(1, 0x5A);
    w.powered = false;
    go_on(20 * MS);
    CHECK(state_of(0)->state.mode == DRIVE_OFF && newest_of(0)->data[0] == DISABLE &&
          newest_of(0)->data[1] == 0);
    CHECK(state_of(0)->state.fault_reasons == DRIVE_FAULT_DISABLED_ITSELF);
    request(0, DRIVE_READY);
    CHECK(state_of(0)->state.fault_reasons == 0);
    arm(0);
    hold(1, 0x5A);
    forget_sent();
    become_unresponsive();
    CHECK(first_sent_ns(0, QUICK_STOP) > 0 && newest_of(0)->data[1] == 0);
}

/* A drive of two wheels in two frames. */
static void begin_with_two_frames(void)
{
    begin_with(1);
    can_drive *drive = table_of(0);
    drive->output_count = 2;
    drive->output[1] = drive->output[0];
    drive->output[1].packet.id = SECOND;
    drive->output[1].packet.data[1] = 0x77;
    drive->output[1].setpoint[0].scale.joint = 1;
    restart();
}

static void a_drive_counts_as_moving_while_one_of_its_frames_carries_motion(void)
{
    begin_with_two_frames();
    arm(0);
    w.enabled = 2;
    w.machine.newest = (setpoints){
        .stamp_ns = w.now_ns, .enabled = 1, .joint_count = 2, .joint = {{.velocity_rad_s = 1.0}}};
    go_on(15 * MS);
    CHECK(state_of(0)->state.sent_motion && speed_in(newest_of(0)) == 100);
    CHECK(w.sent[w.sent_count - 1].id == SECOND && w.sent[w.sent_count - 1].data[1] == 0x77);
    w.machine.newest = (setpoints){.stamp_ns = w.now_ns,
                                   .enabled = 1,
                                   .joint_count = 2,
                                   .joint = {[1] = {.velocity_rad_s = 1.0}}};
    go_on(15 * MS);
    CHECK(state_of(0)->state.sent_motion && speed_in(newest_of(0)) == 0);
}

static void zero_is_sent_again_until_the_bus_has_taken_it_for_all_wheels(void)
{
    begin_with_two_frames();
    arm_and_go();
    w.velocity_rad_s = 0.0;
    w.not_taken = SECOND;
    go_on(20 * MS);
    CHECK(state_of(0)->state.sent_motion);
    w.not_taken = 0;
    forget_sent();
    step();
    CHECK(!state_of(0)->state.sent_motion && count_sent(SECOND) >= 1);
}

static void motion_that_only_some_frames_carried_is_followed_by_zero(void)
{
    begin_with_two_frames();
    w.not_taken = SECOND;
    arm(0);
    go_on(30 * MS);
    CHECK(state_of(0)->state.sent_motion);
    w.velocity_rad_s = 0.0;
    w.not_taken = 0;
    forget_sent();
    step();
    CHECK(speed_in(newest_of(0)) == 0 && !state_of(0)->state.sent_motion);
}

/* -------------------------------------------------------------------------------- power */
static void a_drive_with_power_that_was_not_armed_is_switched_off_and_reported_once(void)
{
    begin_with(1);
    go_on(20 * MS);
    request(0, DRIVE_READY);
    forget_sent();
    (void)took_changes();
    report_state(0, 8);
    report_state(0, 8);
    report_state(0, 1); /* the count of reports restarts */
    report_state(0, 8);
    report_state(0, 8);
    CHECK(state_of(0)->state.fault_reasons == 0 && !took_changes());
    report_state(0, 8);
    CHECK(state_of(0)->state.fault_reasons == DRIVE_FAULT_STILL_ENABLED && took_changes());
    report_state(0, 8);
    CHECK(!took_changes() && count_sent(SPEED) == 0); /* feedback causes no frame */
    uint32_t stops = state_of(0)->stops;
    w.now_ns = w.machine.cycle.due_ns;
    step();
    CHECK(w.sent_count == 2 && w.sent[0].data[0] == DISABLE &&
          state_of(0)->state.mode == DRIVE_READY);
    CHECK(state_of(0)->stops == stops + 1);
}

/* A drive that gets no frame at rest, not even zero, and cannot report whether it has power. */
static void begin_without_reported_power(void)
{
    begin_with(1);
    can_drive *drive = table_of(0);
    drive->idle_setpoints = drive->reports_enabled = 0;
    drive->input[0].field_count = 0;
    drive->disarm[0] = (can_write){.packet = packet_of(CONTROL, 1)};
    restart();
    go_on(20 * MS);
    request(0, DRIVE_READY);
}

static void a_drive_without_reported_power_gets_power_offs_periodically_unless_it_is_armed(void)
{
    begin_without_reported_power();
    forget_sent();
    go_on(320 * MS);
    CHECK(count_sent(CONTROL) >= 3 && count_sent(CONTROL) <= 4 && count_sent(SPEED) == 0);
    w.machine.control.drive[0].arming_until_ns = w.now_ns + 200 * MS;
    forget_sent();
    go_on(160 * MS);
    CHECK(w.sent_count == 0);
    w.machine.control.drive[0].arming_until_ns = 0;
    request(0, DRIVE_ARMED);
    forget_sent();
    go_on(200 * MS);
    CHECK(count_sent(CONTROL) == 0 && count_sent(SPEED) >= 19);
    w.reported_rad_s = 1.0;
    go_on(20 * MS);
    w.enabled = 2;
    go_on(105 * MS);
    forget_sent();
    go_on(300 * MS); /* the drive comes to rest, and keeps its power until then */
    CHECK(state_of(0)->state.stopping && count_sent(CONTROL) == 0 && count_sent(SPEED) >= 29);
    w.reported_rad_s = 0.0;
    w.machine.control.drive[0].arming_until_ns = INT64_MAX;
    go_on(100 * MS);
    CHECK(!state_of(0)->state.stopping && count_sent(CONTROL) == 1); /* the power-off is sent
                                                                        once */
}

static void time_without_set_points_before_arming_does_not_count_as_left_alone(void)
{
    begin_without_reported_power();
    go_on(2000 * MS);
    request(0, DRIVE_ARMED);
    go_on(50 * MS);
    CHECK(state_of(0)->state.mode == DRIVE_ARMED && state_of(0)->state.fault_reasons == 0);
}

static void a_stop_of_two_frames_resumes_at_the_one_that_was_not_taken(void)
{
    begin_with(1);
    can_drive *drive = table_of(0);
    drive->disarm_count = 2;
    drive->disarm[1] = (can_write){.packet = packet_of(CONTROL, 1)};
    restart();
    arm_and_go();
    forget_sent();
    w.not_taken = CONTROL;
    w.enabled = 0;
    step();
    CHECK(w.sent[0].id == SPEED && w.sent[0].data[0] == DISABLE &&
          state_of(0)->state.stop == STOP_POWER_OFF);
    w.not_taken = 0;
    forget_sent();
    go_on(MS);
    CHECK(w.sent[0].id == CONTROL && count_sent(CONTROL) == 1 &&
          state_of(0)->state.stop == STOP_NOTHING);
}

static void a_drive_without_frames_at_rest_gets_nothing_after_its_power_off(void)
{
    begin_without_reported_power();
    request(0, DRIVE_ARMED);
    go_on(30 * MS);
    CHECK(state_of(0)->state.sent_motion);
    w.enabled = 0;
    step();
    CHECK(!state_of(0)->state.sent_motion && w.sent[w.sent_count - 1].id == CONTROL);
    uint32_t speeds = count_sent(SPEED);
    go_on(100 * MS);
    CHECK(count_sent(SPEED) == speeds);
}

static void switching_off_takes_the_power_of_a_powered_drive_and_sends_others_nothing(void)
{
    begin_without_reported_power();
    forget_sent();
    request(0, DRIVE_OFF);
    CHECK(w.sent_count == 0);
    request(0, DRIVE_READY);
    w.velocity_rad_s = 0.0; /* zero is sent to the armed drive */
    request(0, DRIVE_ARMED);
    go_on(30 * MS);
    forget_sent();
    request(0, DRIVE_OFF);
    CHECK(w.sent_count == 1 && w.sent[0].id == CONTROL);
    request(0, DRIVE_READY);
    request(0, DRIVE_ARMED);
    w.reported_rad_s = 1.0;
    go_on(20 * MS);
    w.enabled = 2; /* old set-points: a quick stop that waits for rest */
    go_on(120 * MS);
    CHECK(state_of(0)->state.stopping && !state_of(0)->state.sent_motion);
    forget_sent();
    request(0, DRIVE_OFF);
    CHECK(w.sent_count == 1 && w.sent[0].id == CONTROL);
}

/* ----------------------------------------------------------------------------- feedback */
static void reports_from_before_a_change_do_not_count_after_it(void)
{
    begin_with(1);
    go_on(20 * MS);
    request(0, DRIVE_READY);
    go_on(20 * MS);
    CHECK(state_of(0)->state.enabled == 0);
    request(0, DRIVE_ARMED);
    CHECK(state_of(0)->state.enabled == 2);
    w.powered = true;
    go_on(20 * MS);
    CHECK(state_of(0)->state.enabled == 1);
    request(0, DRIVE_STAND_DOWN);
    CHECK(state_of(0)->state.enabled == 2);
    w.machine.control.drive[0].arming_until_ns = INT64_MAX;
    go_on(20 * MS);
    CHECK(state_of(0)->state.enabled == 1);
    request(0, DRIVE_ARMED);
    go_on(20 * MS);
    w.enabled = 0;
    w.full = true;
    step();
    CHECK(state_of(0)->state.enabled == 2 && state_of(0)->state.mode == DRIVE_READY);
    report_state(0, 8);
    CHECK(state_of(0)->state.enabled == 1);
    w.full = false;
    step();
    CHECK(state_of(0)->state.enabled == 2 && newest_of(0)->data[0] == DISABLE);
}

static void after_its_set_up_the_core_gets_feedback_only_when_all_of_it_is_new(void)
{
    begin_with(1);
    arm_and_go();
    request(0, DRIVE_OFF);
    w.machine.feedback_mask = 0;
    request(0, DRIVE_READY);
    w.now_ns += 6 * MS;
    report_motion(0, 1.0F, 0.0F);
    CHECK(w.machine.feedback_mask == 0);
    report_state(0, 1);
    CHECK(w.machine.feedback_mask == 1 && w.machine.joint[0].feedback.epoch == 2);
}

static void after_the_next_arming_it_may_wait_again_for_the_core(void)
{
    begin_with(1);
    arm_and_go();
    w.machine.control.drive[0].arming_until_ns = INT64_MAX;
    request(0, DRIVE_STAND_DOWN);
    w.enabled = 0;
    request(0, DRIVE_ARMED);
    go_on(100 * MS);
    CHECK(state_of(0)->state.mode == DRIVE_ARMED && speed_in(newest_of(0)) == 0);
    w.enabled = 1;
    go_on(20 * MS);
    CHECK(speed_in(newest_of(0)) == 100);
    w.enabled = 0;
    step();
    CHECK(state_of(0)->state.mode == DRIVE_READY &&
          state_of(0)->state.fault_reasons == DRIVE_FAULT_NOT_ENABLED);
    w.enabled = 1;
    request(0, DRIVE_ARMED);
    CHECK(state_of(0)->state.mode == DRIVE_ARMED && state_of(0)->state.fault_reasons == 0);
}

/* ------------------------------------------------------------- notifications of asyncio */
static void asyncio_is_notified_of_each_change(void)
{
    begin_with(1);
    go_on(20 * MS);
    (void)took_changes();
    request(0, DRIVE_READY);
    CHECK(took_changes());
    go_on(20 * MS);
    CHECK(!took_changes());
    request(0, DRIVE_ARMED);
    w.powered = true;
    CHECK(took_changes());
    go_on(30 * MS);
    CHECK(!took_changes());
    w.enabled = 0;
    step();
    CHECK(took_changes());
    w.enabled = 1;
    go_on(50 * MS);
    (void)took_changes();
    w.silent = true;
    w.powered = false;
    while (state_of(0)->state.mode != DRIVE_UNRESPONSIVE) {
        go_on(MS);
    }
    CHECK(took_changes());
    go_on(30 * MS);
    CHECK(!took_changes());
    w.full = true;
    w.silent = false;
    go_on(20 * MS);
    /* its probes have braked it: its set-up takes its power */
    CHECK(state_of(0)->state.mode == DRIVE_BACK && !state_of(0)->state.back && took_changes());
    go_on(20 * MS);
    CHECK(!took_changes());
}

static void a_change_in_any_of_its_frames_is_noticed_and_in_no_other(void)
{
    for (uint32_t other = 0; other < 3; other++) {
        begin_with_two_frames();
        for (uint32_t o = 0; o < 2; o++) {
            can_packet packet;
            (void)can_build(&w.machine, 0, o, &packet);
            memcpy(w.machine.drive[0].last_sent[o], packet.data, packet.bytes);
        }
        /* a frame beyond the count */
        w.machine.table.drive[0].output[2] = w.machine.table.drive[0].output[1];
        CHECK(!can_differs(&w.machine, 0));
        w.machine.drive[0].last_sent[other][0] ^= 1;
        CHECK(can_differs(&w.machine, 0) == (other < 2));
    }
}

static void an_unchanged_drive_does_not_clear_a_notification(void)
{
    begin_with(1);
    w.machine.notify = true;
    can_check_power(&w.machine, 0, w.now_ns);
    CHECK(w.machine.notify);
}

int main(void)
{
    a_drive_that_gets_all_its_frames_is_never_left_alone();
    a_frame_that_the_bus_does_not_take_does_not_feed_the_watchdog();
    a_write_to_a_frame_of_the_cycle_keeps_the_other_held_bytes();
    held_bytes_are_cleared_with_the_drive();
    a_drive_counts_as_moving_while_one_of_its_frames_carries_motion();
    zero_is_sent_again_until_the_bus_has_taken_it_for_all_wheels();
    motion_that_only_some_frames_carried_is_followed_by_zero();
    a_drive_with_power_that_was_not_armed_is_switched_off_and_reported_once();
    a_drive_without_reported_power_gets_power_offs_periodically_unless_it_is_armed();
    time_without_set_points_before_arming_does_not_count_as_left_alone();
    a_stop_of_two_frames_resumes_at_the_one_that_was_not_taken();
    a_drive_without_frames_at_rest_gets_nothing_after_its_power_off();
    switching_off_takes_the_power_of_a_powered_drive_and_sends_others_nothing();
    reports_from_before_a_change_do_not_count_after_it();
    after_its_set_up_the_core_gets_feedback_only_when_all_of_it_is_new();
    after_the_next_arming_it_may_wait_again_for_the_core();
    asyncio_is_notified_of_each_change();
    a_change_in_any_of_its_frames_is_noticed_and_in_no_other();
    an_unchanged_drive_does_not_clear_a_notification();
    return checks_report("can drive");
}
