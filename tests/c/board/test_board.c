/* SPDX-License-Identifier: Apache-2.0
 * The machine of a board in virtual time: the frames that it sends, which feedback counts, and when
 * it stops the board. */
#include "board_wire.h"

/* --------------------------------------------------------------------------- frames out */
static void only_zero_is_sent_before_arming(void)
{
    begin();
    go_on(200 * MS);
    CHECK(w.sent_count >= 19 && w.machine.state.mode == DRIVE_OFF);
    set_up();
    go_on(200 * MS);
    request(DRIVE_STAND_DOWN);
    go_on(50 * MS);
    CHECK(w.moving_count == 0 && w.peer.enabled == 0 && w.peer.frames_bad == 0);
}

static void the_newest_set_points_are_in_the_frame_that_leaves(void)
{
    begin();
    arm_and_turn();
    for (int32_t i = 1; i < 20; i++) {
        w.now_ns = w.machine.cycle.due_ns;
        w.velocity_rad_s = 0.5 * i;
        step();
        CHECK(last_sent(TARGET, 4, 1) == 500 * i && last_sent(TARGET + 6, 4, 1) == -500 * i);
        speak();
    }
}

static void a_set_point_that_is_not_finite_or_too_large_is_harmless(void)
{
    begin();
    arm();
    const double bad[] = {(double)NAN, (double)INFINITY, -(double)INFINITY};
    w.moving_count = 0;
    for (uint32_t i = 0; i < 3; i++) {
        w.velocity_rad_s = bad[i];
        go_on(30 * MS);
        CHECK(last_sent(TARGET, 4, 1) == 0);
    }
    w.velocity_rad_s = 1e300;
    go_on(30 * MS);
    CHECK(last_sent(TARGET, 4, 1) == 1000000 && last_sent(TARGET + 6, 4, 1) == -1000000);
}

static void a_set_point_of_zero_does_not_wait_for_its_cycle(void)
{
    begin();
    arm_and_turn();
    w.now_ns = w.machine.cycle.due_ns;
    step();
    w.velocity_rad_s = 0.0;
    w.now_ns += MS;
    uint32_t before = w.sent_count;
    step();
    CHECK(w.sent_count == before + 1 && last_sent(TARGET, 4, 1) == 0 && w.peer.enabled == 1);
}

static void a_stop_that_a_newer_request_overtook_is_still_carried_out(void)
{
    begin();
    arm_and_turn();
    w.machine.control.request.count++; /* a STAND_DOWN or OFF that the next request has replaced */
    request(DRIVE_ARMED);
    go_on(30 * MS);
    CHECK(w.machine.state.mode == DRIVE_READY && w.peer.enabled == 0);
    CHECK(last_sent(TARGET, 4, 1) == 0);
}

static void each_write_of_a_job_is_sent_in_a_frame_of_its_own(void)
{
    begin();
    set_up();
    board_order one = {.write = {.place = at(CONTROL, 1, 0), .raw = CONTROL_CLEAR}};
    CHECK(board_machine_order(&w.machine, &one));
    one.write.raw = 0;
    CHECK(!board_machine_order(&w.machine, &one)); /* the first one has not been sent yet */
    w.full = true;
    go_on(30 * MS);
    CHECK(w.machine.has_order && w.machine.no_room > 0);
    w.full = false;
    go_on(11 * MS);
    CHECK(!w.machine.has_order && last_sent(CONTROL, 1, 0) == CONTROL_CLEAR);
    CHECK(received_changes() && board_machine_order(&w.machine, &one));
    go_on(11 * MS);
    CHECK(last_sent(CONTROL, 1, 0) == 0 && received_changes());
}

static void a_guarded_write_is_dropped_when_the_board_was_stopped_meanwhile(void)
{
    begin();
    set_up();
    board_order one = {.write = {.place = at(CONTROL, 1, 0), .raw = CONTROL_ENABLE},
                       .guarded = 1,
                       .stops = w.machine.stops};
    request(DRIVE_STAND_DOWN);
    CHECK(board_machine_order(&w.machine, &one));
    go_on(50 * MS);
    CHECK(w.machine.orders_dropped == 1 && w.peer.enabled == 0);
}

static void a_new_start_continues_the_sequence(void)
{
    begin();
    arm_and_turn();
    uint32_t good = w.peer.frames_good;
    restart();
    go_on(20 * MS);
    CHECK(w.peer.frames_good >= good + 2 && w.peer.enabled == 0);
}

/* The new machine does not know the sequence of the program before it, which wraps at 65536. */
static void a_new_program_continues_the_sequence_that_the_board_has_received(void)
{
    const uint16_t received[] = {1, 300, 20000, 32767, 32768, 32769, 65535};
    for (uint32_t i = 0; i < sizeof received / sizeof received[0]; i++) {
        begin();
        arm_and_turn();
        w.peer.received_sequence = received[i];
        w.machine.sequence = 0;
        uint32_t refused = w.peer.frames_bad;
        restart();
        go_on(30 * MS);
        CHECK(w.peer.enabled == 0 && w.peer.stopped_by_silence == 0 &&
              w.peer.frames_bad <= refused + 1);
        go_on(30 * MS);
        CHECK(w.machine.knows_ns > w.now_ns - 30 * MS && w.peer.frames_bad <= refused + 1);
    }
}

static void the_board_refuses_a_late_frame(void)
{
    begin();
    arm_and_turn();
    uint8_t late[BOARD_WIRE_MAX];
    uint32_t count = w.sent_bytes;
    memcpy(late, w.sent, count);
    request(DRIVE_STAND_DOWN);
    go_on(30 * MS);
    uint32_t refused = w.peer.frames_bad;
    for (uint32_t i = 0; i < count; i++) {
        motord_board_byte(&w.peer, late[i], (uint32_t)(w.now_ns / 1000));
    }
    CHECK(w.peer.enabled == 0 && w.peer.setpoint[0].velocity_mrad_s == 0 &&
          w.peer.frames_bad == refused + 1);
}

/* ----------------------------------------------------------------------------- stopping */
static void old_set_points_brake_and_take_the_power_at_rest(void)
{
    begin();
    arm_and_turn();
    w.stuck = true;
    w.enabled = 2;
    go_on(125 * MS);
    CHECK((w.machine.state.fault_reasons & DRIVE_FAULT_SETPOINTS_OLD) != 0 &&
          w.machine.state.mode == DRIVE_READY);
    CHECK(w.peer.braking == 1 && w.peer.enabled == 0 && w.machine.state.stopping);
    go_on(300 * MS);
    CHECK(w.peer.braking == 1); /* the wheels still turn */
    w.stuck = false;
    go_on(50 * MS);
    CHECK(w.peer.braking == 0 && !w.machine.state.stopping);
    w.enabled = 1;
    w.moving_count = 0;
    go_on(200 * MS);
    CHECK(w.machine.state.mode == DRIVE_READY && w.peer.enabled == 0 && w.moving_count == 0);
}

static void a_wheel_rests_below_the_speed_of_the_table(void)
{
    for (uint32_t strict = 0; strict < 2; strict++) {
        begin();
        w.table.rest_velocity_rad_s = strict ? 0.02 : 1.5; /* the wheels turn at 1 rad/s */
        restart();
        arm_and_turn();
        w.stuck = true;
        w.enabled = 2;
        go_on(300 * MS);
        CHECK((w.machine.state.fault_reasons & DRIVE_FAULT_SETPOINTS_OLD) != 0 &&
              w.peer.braking == strict && w.machine.state.stopping == strict);
    }
}

static void a_wheel_that_does_not_come_to_rest_loses_its_power_after_a_second(void)
{
    begin();
    arm_and_turn();
    w.stuck = true;
    w.enabled = 2;
    go_on(1080 * MS);
    CHECK(w.peer.braking == 1);
    go_on(60 * MS);
    CHECK(w.peer.braking == 0 && w.peer.enabled == 0);
}

static void only_feedback_from_after_the_stop_proves_rest(void)
{
    begin();
    arm();
    go_on(20 * MS);
    w.stuck = true; /* the wheels turn, and the board reports 0 */
    w.measured[0].velocity_mrad_s = 0;
    w.measured[1].velocity_mrad_s = 0;
    go_on(20 * MS);
    w.mute = true;
    w.enabled = 2;
    go_on(115 * MS);
    CHECK(w.peer.braking == 1 && w.machine.state.stopping);
    w.mute = false;
    go_on(30 * MS);
    CHECK(w.peer.braking == 0);
}

static void a_core_that_clears_enabled_takes_the_power_at_once(void)
{
    begin();
    arm_and_turn();
    w.now_ns = w.machine.cycle.due_ns;
    step();
    w.enabled = 0;
    w.now_ns += MS;
    step(); /* no cycle is due */
    CHECK(w.peer.enabled == 0 && w.peer.braking == 0 && w.machine.state.mode == DRIVE_READY);
    CHECK(last_sent(CONTROL, 1, 0) == CONTROL_OFF && last_sent(TARGET, 4, 1) == 0);
}

static void a_stop_may_have_several_writes(void)
{
    board_table table = frames_table();
    table.quick_stop_count = table.disarm_count = 2;
    table.quick_stop[1] = (board_write){.place = at(4, 2, 0), .raw = 11};
    table.disarm[1] = (board_write){.place = at(4, 2, 0), .raw = 12};
    begin_with(table);
    go_on(20 * MS);
    CHECK(last_sent(4, 2, 0) == 11); /* what may turn when it is met is braked */
    arm_and_turn();
    w.stuck = true;
    w.enabled = 2;
    go_on(125 * MS);
    CHECK(last_sent(CONTROL, 1, 0) == CONTROL_BRAKE && last_sent(4, 2, 0) == 11);
    w.enabled = 1;
    request(DRIVE_ARMED);
    CHECK(w.machine.state.mode == DRIVE_READY); /* a board that comes to rest is not armed */
}

static void a_board_that_is_requested_off_is_off_at_once(void)
{
    begin();
    arm_and_turn();
    (void)received_changes();
    request(DRIVE_OFF);
    CHECK(w.machine.state.mode == DRIVE_OFF && w.peer.enabled == 0 && received_changes());
}

static void after_the_next_arming_it_waits_again_for_the_core(void)
{
    begin();
    arm_and_turn();
    request(DRIVE_STAND_DOWN);
    go_on(30 * MS);
    w.enabled = 0;
    w.machine.control.request.arming_until_ns = w.now_ns + 1000 * MS;
    order(CONTROL, 1, CONTROL_ENABLE, 1);
    request(DRIVE_ARMED);
    go_on(100 * MS);
    CHECK(w.machine.state.mode == DRIVE_ARMED && w.peer.enabled == 1);
    w.enabled = 1;
    go_on(30 * MS);
    w.enabled = 0;
    (void)received_changes();
    go_on(30 * MS);
    CHECK(w.machine.state.mode == DRIVE_READY && w.peer.enabled == 0 && received_changes());
}

static void standing_down_takes_the_power_with_the_next_frame(void)
{
    begin();
    arm_and_turn();
    request(DRIVE_STAND_DOWN);
    CHECK(w.machine.state.mode == DRIVE_READY && w.peer.enabled == 0 &&
          last_sent(TARGET, 4, 1) == 0);
    begin();
    arm();
    w.velocity_rad_s = 0.0;
    go_on(15 * MS);
    w.now_ns = w.machine.cycle.due_ns;
    step();
    w.now_ns += MS;
    request(DRIVE_STAND_DOWN); /* no cycle is due, and no motion is sent */
    CHECK(w.peer.enabled == 0);
}

static void a_port_that_takes_no_bytes_leaves_the_board_alone(void)
{
    begin();
    arm_and_turn();
    w.full = true;
    go_on((WATCHDOG_MS + 30) * MS);
    CHECK(w.machine.state.mode != DRIVE_ARMED &&
          (w.machine.state.fault_reasons & DRIVE_FAULT_LEFT_ALONE) != 0);
    CHECK(w.peer.enabled == 0 && w.peer.braking == 1); /* braked by its own watchdog */
    w.full = false;
    w.moving_count = 0;
    go_on(50 * MS);
    CHECK(w.moving_count == 0 && w.machine.state.mode != DRIVE_ARMED);
}

static void a_stop_that_the_port_did_not_take_is_sent_as_soon_as_the_port_takes_bytes(void)
{
    begin();
    arm_and_turn();
    w.full = true;
    w.enabled = 0;
    go_on(30 * MS);
    CHECK(w.machine.state.stop && w.peer.enabled == 1);
    w.full = false;
    w.now_ns = w.wake_ns;
    CHECK(w.wake_ns <= w.now_ns + MS);
    step();
    CHECK(w.peer.enabled == 0 && w.machine.state.stop == STOP_NOTHING);
}

static void a_board_that_receives_nothing_stops_by_itself_and_is_set_up_again(void)
{
    begin();
    arm_and_turn();
    w.receives_nothing = true;
    go_on((WATCHDOG_MS + 60) * MS);
    CHECK(w.peer.enabled == 0 && w.peer.braking == 1);
    w.receives_nothing = false;
    w.moving_count = 0;
    go_on(60 * MS);
    CHECK(w.machine.state.mode == DRIVE_OFF &&
          (w.machine.state.fault_reasons & DRIVE_FAULT_DISABLED_ITSELF) != 0);
    CHECK(w.peer.enabled == 0 && last_sent(CONTROL, 1, 0) == CONTROL_OFF);
}

static void a_restarted_board_has_lost_its_set_up(void)
{
    begin();
    arm_and_turn();
    motord_board_init(&w.peer, MOTORS, (uint32_t)(w.now_ns / 1000));
    go_on(250 * MS);
    CHECK(w.machine.state.mode == DRIVE_OFF &&
          (w.machine.state.fault_reasons & DRIVE_FAULT_LOST_SETUP) != 0 && w.peer.enabled == 0);
    CHECK(w.machine.state.epoch == 2); /* its counters may have begun again */
    set_up();
    CHECK(w.machine.state.epoch == 3);
}

static void a_board_that_is_enabled_without_arming_is_switched_off(void)
{
    begin();
    set_up();
    order(CONTROL, 1, CONTROL_ENABLE, 0);
    go_on(50 * MS);
    CHECK(w.peer.enabled == 0 && (w.machine.state.fault_reasons & DRIVE_FAULT_STILL_ENABLED) == 0);
    for (uint32_t i = 0; i < 3; i++) { /* a board that ignores its power-off */
        uint8_t frame[BOARD_WIRE_MAX],
            payload[BOARD_PAYLOAD_MAX] = {STATUS_ENABLED, MOTORS, WATCHDOG_MS};
        w.mute = true;
        go_on(20 * MS);
        board_place received = at(6, 2, 0);
        board_put(payload, &received, w.machine.sequence);
        uint32_t count = board_frame_build(BOARD_TYPE_FEEDBACK, i, 10000 * i, payload, 36, frame);
        board_machine_receive(&w.machine, frame, count, w.now_ns);
    }
    CHECK((w.machine.state.fault_reasons & DRIVE_FAULT_STILL_ENABLED) != 0 &&
          w.machine.state.mode == DRIVE_READY);
}

/* ----------------------------------------------------------------------------- presence */
static void a_mute_board_is_unresponsive_and_braked_and_comes_back_disarmed(void)
{
    begin();
    arm_and_turn();
    w.mute = true;
    go_on(180 * MS);
    CHECK(w.machine.state.mode == DRIVE_UNRESPONSIVE && w.peer.braking == 1 && w.peer.enabled == 0);
    CHECK(w.machine.feedback_bytes == 0 && received_changes());
    go_on(1200 * MS);
    CHECK(w.peer.braking == 1);
    uint32_t before = w.sent_count;
    w.moving_count = 0;
    go_on(200 * MS);
    CHECK(w.sent_count >= before + 19 && w.moving_count == 0); /* a stop in every cycle */
    request(DRIVE_ARMED);
    request(DRIVE_READY);
    CHECK(w.machine.state.mode == DRIVE_UNRESPONSIVE);
    order(CONTROL, 1, CONTROL_ENABLE, 0);
    CHECK(w.machine.orders_dropped == 1 && last_sent(CONTROL, 1, 0) == CONTROL_BRAKE);
    w.mute = false;
    go_on(30 * MS);
    CHECK(w.machine.state.mode == DRIVE_BACK && last_sent(CONTROL, 1, 0) == CONTROL_BRAKE &&
          w.machine.unresponsive == 1 && received_changes());
    set_up();
}

static void arming_needs_fresh_set_points_and_no_unfinished_stop(void)
{
    begin();
    set_up();
    w.enabled = 2;
    go_on(150 * MS);
    request(DRIVE_ARMED);
    CHECK(w.machine.state.mode == DRIVE_READY);
    w.enabled = 1;
    w.full = true;
    request(DRIVE_STAND_DOWN);
    request(DRIVE_ARMED);
    CHECK(w.machine.state.mode == DRIVE_READY && w.machine.state.stop != STOP_NOTHING);
}

/* ------------------------------------------------------------------------------ the end */
static void frames_are_sent_at_their_rate_and_old_set_points_are_noticed_in_between(void)
{
    board_table table = frames_table();
    begin_with(table);
    go_on(1000 * MS);
    CHECK(w.sent_count >= 98 && w.sent_count <= 101);
    table.period_ns = 100 * MS; /* a slow line */
    begin_with(table);
    arm();
    go_on(210 * MS);
    w.now_ns = w.machine.cycle.due_ns;
    step(); /* the next cycle is 100 ms away */
    int64_t last_ns = w.machine.newest.stamp_ns;
    w.enabled = 2;
    w.velocity_rad_s = 0.0;
    while (w.machine.state.mode == DRIVE_ARMED) {
        go_on(MS);
    }
    CHECK(w.machine.state.fault_reasons == DRIVE_FAULT_SETPOINTS_OLD && w.peer.braking == 1 &&
          w.now_ns <= last_ns + 108 * MS);
}

int main(void)
{
    only_zero_is_sent_before_arming();
    the_newest_set_points_are_in_the_frame_that_leaves();
    a_set_point_that_is_not_finite_or_too_large_is_harmless();
    a_set_point_of_zero_does_not_wait_for_its_cycle();
    a_stop_that_a_newer_request_overtook_is_still_carried_out();
    each_write_of_a_job_is_sent_in_a_frame_of_its_own();
    a_guarded_write_is_dropped_when_the_board_was_stopped_meanwhile();
    a_new_start_continues_the_sequence();
    a_new_program_continues_the_sequence_that_the_board_has_received();
    the_board_refuses_a_late_frame();
    old_set_points_brake_and_take_the_power_at_rest();
    a_wheel_rests_below_the_speed_of_the_table();
    a_wheel_that_does_not_come_to_rest_loses_its_power_after_a_second();
    only_feedback_from_after_the_stop_proves_rest();
    a_core_that_clears_enabled_takes_the_power_at_once();
    a_stop_may_have_several_writes();
    a_board_that_is_requested_off_is_off_at_once();
    after_the_next_arming_it_waits_again_for_the_core();
    standing_down_takes_the_power_with_the_next_frame();
    a_port_that_takes_no_bytes_leaves_the_board_alone();
    a_stop_that_the_port_did_not_take_is_sent_as_soon_as_the_port_takes_bytes();
    a_board_that_receives_nothing_stops_by_itself_and_is_set_up_again();
    a_restarted_board_has_lost_its_set_up();
    a_board_that_is_enabled_without_arming_is_switched_off();
    a_mute_board_is_unresponsive_and_braked_and_comes_back_disarmed();
    arming_needs_fresh_set_points_and_no_unfinished_stop();
    frames_are_sent_at_their_rate_and_old_set_points_are_noticed_in_between();
    return checks_report("board");
}
