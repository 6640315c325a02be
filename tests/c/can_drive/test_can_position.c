/* SPDX-License-Identifier: Apache-2.0
 * Positions on a CAN bus: a drive without power gets its own position; a drive that must not move
 * gets no target. */
#include <math.h>

#include "can_position_rig.h"
#include "joint_values.h"

static void a_drive_without_power_gets_its_own_position(void)
{
    begin();
    wanted_rad = 1.0, positioned = 1;
    run(2.25F, 50 * MS);
    CHECK(count_sent(SPEED) == 0); /* the drive is not set up */
    ask_for(DRIVE_READY);
    forget_sent();
    run(2.25F, 50 * MS);
    CHECK(count_sent(SPEED) >= 4 && target_in(newest_of(0)) == 2.25F);
    run(-3.5F, 50 * MS); /* a person turns the drive by hand */
    CHECK(target_in(newest_of(0)) == -3.5F && !state_of(0)->state.sent_motion &&
          !can_wants_motion(m, 0));
    run(11.0F, 10 * MS); /* a position that is no valid target */
    forget_sent();
    run(11.0F, 50 * MS);
    CHECK(count_sent(SPEED) == 0);
    w.now_ns += 6 * MS;
    report_motion(0, NAN, 0.0F);
    put();
    step();
    CHECK(isnan(m->joint[0].place.measured));
    forget_sent();
    w.powered = true; /* the drive should have no power */
    run(2.25F, 10 * MS);
    CHECK(count_sent(SPEED) <= 1); /* at most the power-off, and no target */
}

static void an_armed_drive_gets_its_targets_and_nothing_without_one(void)
{
    static const double NO_PLACES[] = {NAN, INFINITY, 0.5};
    for (uint32_t i = 0; i < 3; i++) {
        begin();
        make_armed();
        CHECK(!state_of(0)->state.sent_motion);
        wanted_rad = 0.5, positioned = 1;
        run(2.25F, 50 * MS);
        CHECK(target_in(newest_of(0)) == 2.25F && state_of(0)->state.sent_motion &&
              !can_differs(m, 0));
        wanted_rad = 1e300;
        run(2.25F, 20 * MS);
        CHECK(target_in(newest_of(0)) == 10.0F);
        forget_sent();
        wanted_rad = NO_PLACES[i], positioned = i < 2;
        run(2.25F, 100 * MS);
        CHECK(count_sent(SPEED) == 0 && !state_of(0)->state.sent_motion && !can_wants_motion(m, 0));
        CHECK(state_of(0)->state.mode == DRIVE_ARMED);
    }
}

/* A drive that received nothing for the time of its watchdog may have stopped by itself. The line
 * stops it, too. */
static void a_drive_whose_targets_are_withheld_too_long_is_left_alone(void)
{
    begin();
    make_armed();
    wanted_rad = 0.5, positioned = 1;
    run(2.25F, 50 * MS);
    positioned = 0;
    run(2.25F, 700 * MS);
    CHECK((state_of(0)->state.fault_reasons & DRIVE_FAULT_LEFT_ALONE) != 0 &&
          state_of(0)->state.mode == DRIVE_READY);
}

static void a_drive_that_does_not_answer_gets_stops_and_no_target(void)
{
    begin();
    make_armed();
    wanted_rad = 0.5, positioned = 1;
    run(2.25F, 50 * MS);
    for (int64_t end_ns = w.now_ns + 1000 * MS; w.now_ns < end_ns; w.now_ns += 2 * MS) {
        put();
        step();
        if (state_of(0)->state.mode == DRIVE_ARMED) {
            forget_sent();
        }
    }
    CHECK(state_of(0)->state.mode == DRIVE_UNRESPONSIVE);
    for (uint32_t i = 0; i < w.sent_count; i++) {
        CHECK(w.sent[i].id != SPEED || w.sent[i].data[0] == QUICK_STOP ||
              w.sent[i].data[0] == DISABLE);
    }
}

/* 2 rad/s are one turn a second. A position is fresh for 0.1 s, in which the drive moves by 0.1
 * turns. */
static void begin_at_limited_speed(void)
{
    begin();
    table_of(0)->output[0].setpoint[0].scale.raw_per_s = 1.0;
    restart();
}

static void the_first_target_is_its_own_position_and_later_ones_move_from_there(void)
{
    begin_at_limited_speed();
    make_armed();
    wanted_rad = 0.6, positioned = 1; /* 2.3 turns */
    forget_sent();
    run(2.25F, 2 * MS);
    while (count_sent(SPEED) == 0) {
        run(2.25F, 2 * MS);
    }
    CHECK(target_in(newest_of(0)) == 2.25F);
    wanted_rad = 2.0; /* 3.0 turns */
    float last = 2.25F;
    int64_t began_ns = w.now_ns;
    while (last < 3.0F && w.now_ns < began_ns + 2000 * MS) {
        run(2.25F, 10 * MS);
        float now = target_in(newest_of(0));
        CHECK(now >= last && now - last <= 0.0201F);
        last = now;
    }
    CHECK(last == 3.0F && w.now_ns >= began_ns + 690 * MS);
}

static void a_first_target_far_from_its_position_takes_the_power(void)
{
    static const double WANTED_RAD[] = {0.69, 0.31, 0.71, 0.29, 16.0, -24.0};
    for (uint32_t i = 0; i < 6; i++) {
        begin_at_limited_speed();
        make_armed();
        forget_sent();
        wanted_rad = WANTED_RAD[i], positioned = 1;
        run(2.25F, 10 * MS);
        CHECK((state_of(0)->state.mode == DRIVE_ARMED) == (i < 2));
        CHECK(((state_of(0)->state.fault_reasons & DRIVE_FAULT_POSITION_UNKNOWN) != 0) == (i >= 2));
        for (uint32_t n = 0; n < w.sent_count && i >= 2; n++) {
            CHECK(w.sent[n].id != SPEED ||
                  (w.sent[n].data[0] == DISABLE && target_in(&w.sent[n]) == 2.25F));
        }
    }
}

/* Cases: the position is out of range, old or NaN. The drive is not armed, and gets no frame that
 * would power it. */
static void a_drive_whose_position_is_missing_gets_no_power(void)
{
    for (uint32_t why = 0; why < 4; why++) {
        begin_at_limited_speed();
        run(2.25F, 20 * MS);
        ask_for(DRIVE_READY);
        run(why == 1 ? 10.5F : 2.25F, 20 * MS);
        w.machine.joint[0].place.measured_ns -= why == 2 ? 300 * MS : 0;
        w.machine.joint[0].place.measured =
            why == 3 ? (double)NAN : w.machine.joint[0].place.measured;
        can_order order = {
            .expires_ns = w.now_ns + 500 * MS, .guarded = 1, .stops = state_of(0)->stops};
        order.write = table_of(0)->disarm[0];
        order.write.packet.data[0] = 0x0F;
        CHECK(can_machine_order(&w.machine, &order));
        uint32_t dropped = state_of(0)->orders_dropped;
        ask_for(DRIVE_ARMED);
        CHECK((state_of(0)->state.mode == DRIVE_ARMED) == (why == 0));
        CHECK(((state_of(0)->state.fault_reasons & DRIVE_FAULT_POSITION_UNKNOWN) != 0) ==
              (why != 0));
        CHECK(state_of(0)->orders_dropped == dropped + (why != 0));
    }
}

static void its_reference_is_reported_beside_its_power(void)
{
    begin();
    table_of(0)->input[0].field_count = 2;
    table_of(0)->input[0].field[1] = (can_field){
        .place = {.length = 8},
        .meaning = {.kind = FIELD_REFERENCED, .equals_mask = 8, .equals = 8, .si_per_raw = 1.0}};
    restart();
    CHECK(m->joint[0].feedback.referenced == 2);
    ask_for(DRIVE_READY);
    run(1.0F, 10 * MS);
    CHECK(m->joint[0].feedback.referenced == 0 && state_of(0)->state.enabled == 0);
    w.powered = true;
    report_state(0, 8);
    CHECK(m->joint[0].feedback.referenced == 1 && state_of(0)->state.enabled == 1);
}

/* A stop contains a target, too: the drive's position, or its last target while the position is
 * unknown. */
static void a_stop_keeps_the_target_in_its_frame(void)
{
    static const float AT[] = {3.0F, 11.0F}, KEPT[] = {3.0F, 2.25F};
    for (uint32_t i = 0; i < 2; i++) {
        begin();
        make_armed();
        wanted_rad = 0.5, positioned = 1;
        run(2.25F, 50 * MS);
        make_stopping(AT[i]);
        CHECK(target_in(quick_stop_sent()) == KEPT[i]);
    }
}

/* The second target of the frame is a number of turns in 16 bits. */
static void a_stop_keeps_each_target_of_its_frame_and_no_other_byte(void)
{
    static const can_setpoint SECOND = {
        .place = {.start_bit = 48, .length = 16, .form = CAN_SIGNED},
        .scale = {.kind = SETPOINT_POSITION,
                  .raw_per_si = 0.5,
                  .raw_offset = 2.0,
                  .raw_min = -10.0,
                  .raw_max = 10.0,
                  .raw_per_s = 1e6}};
    for (uint32_t count = 1; count <= 2; count++) {
        begin();
        can_output *output = &table_of(0)->output[0];
        output->packet.bytes = 8;
        output->setpoint[1] = SECOND;
        output->setpoint_count = count;
        restart();
        make_armed();
        wanted_rad = 0.5, positioned = 1;
        run(2.25F, 50 * MS);
        make_stopping(5.0F);
        CHECK(target_in(quick_stop_sent()) == 5.0F);
        CHECK(can_get(state_of(0)->held[0], &SECOND.place) == (count == 2 ? 5 : 0));
    }
}

static void a_frame_is_sent_only_when_each_of_its_targets_is_known(void)
{
    begin();
    run(2.25F, 20 * MS);
    ask_for(DRIVE_READY);
    run(2.25F, 20 * MS);
    can_machine *machine = &w.machine;
    can_setpoint *setpoint = machine->table.drive[0].output[0].setpoint;
    CHECK(can_sends(m, 0, 0));
    setpoint[1] = setpoint[0];
    setpoint[1].scale.raw_max = 1.0; /* the position is out of this range */
    CHECK(can_sends(m, 0, 0));
    machine->table.drive[0].output[0].setpoint_count = 2;
    CHECK(!can_sends(m, 0, 0));
    machine->table.drive[0].output[0].setpoint_count = 1;
    setpoint[0].scale.raw_max = 2.25;
    CHECK(can_sends(m, 0, 0));
    setpoint[0].scale.raw_max = 2.0;
    CHECK(!can_sends(m, 0, 0));
    setpoint[0].scale.raw_min = 2.25, setpoint[0].scale.raw_max = 10.0;
    CHECK(can_sends(m, 0, 0));
    setpoint[0].scale.raw_min = 2.5;
    CHECK(!can_sends(m, 0, 0));
}

/* A drive gets its own position as target only at rest without power. */
static void only_a_ready_drive_without_power_keeps_its_own_position_as_target(void)
{
    static const uint32_t MODES[] = {DRIVE_OFF, DRIVE_READY, DRIVE_ARMED, DRIVE_UNRESPONSIVE,
                                     DRIVE_BACK};
    begin();
    run(2.25F, 20 * MS);
    ask_for(DRIVE_READY);
    run(2.25F, 20 * MS);
    positioned = 0;
    put();
    for (uint32_t i = 0; i < 5 * 3; i++) {
        drive_state *state = &w.machine.drive[0].state;
        state->mode = MODES[i / 3], state->enabled = i % 3;
        CHECK(can_sends(m, 0, 0) == (MODES[i / 3] == DRIVE_READY && i % 3 != 1));
    }
}

static void a_target_of_a_joint_without_set_points_is_not_sent(void)
{
    begin();
    make_armed();
    wanted_rad = 0.5, positioned = 1;
    put();
    CHECK(can_sends(m, 0, 0));
    w.machine.newest.joint_count = 0;
    CHECK(!can_sends(m, 0, 0));
}

static void a_target_of_minus_zero_is_sent_as_zero(void)
{
    static const uint8_t ZEROS[4];
    begin();
    run(-0.0F, 20 * MS);
    ask_for(DRIVE_READY);
    forget_sent();
    run(-0.0F, 50 * MS);
    CHECK(memcmp(newest_of(0)->data + 2, ZEROS, sizeof ZEROS) == 0);
}

static void a_joint_without_set_points_gets_no_target(void)
{
    setpoints from = {
        .enabled = 1, .joint_count = 2, .positioned = UINT32_MAX, .position_rad = {1.0, 2.0, 3.0}};
    double position_rad = 7.0;
    CHECK(setpoint_position(&from, 1, &position_rad) && position_rad == 2.0);
    CHECK(!setpoint_position(&from, 2, &position_rad) && position_rad == 2.0);
    from.joint_count = JOINTS_MAX + 1;
    CHECK(setpoint_position(&from, JOINTS_MAX - 1, &position_rad));
    CHECK(!setpoint_position(&from, JOINTS_MAX, &position_rad));
    from.positioned = 1;
    CHECK(!setpoint_position(&from, 1, &position_rad) &&
          setpoint_position(&from, 0, &position_rad));
    from.enabled = 0;
    CHECK(!setpoint_position(&from, 0, &position_rad));
}

/* The drive has a second target in its frame or a second frame, for another joint, whose position
 * is unknown. */
static void begin_with_two(uint32_t targets, uint32_t frames)
{
    begin();
    can_drive *drive = table_of(0);
    can_output *output = &drive->output[0];
    output->packet.bytes = 8;
    output->setpoint[1] = output->setpoint[0];
    output->setpoint[1].place = (can_place){.start_bit = 48, .length = 16, .form = CAN_SIGNED};
    output->setpoint[1].scale.joint = 1;
    output->setpoint_count = targets;
    drive->output[1] = *output;
    drive->output[1].setpoint[0] = output->setpoint[1];
    drive->output[1].setpoint_count = 1;
    drive->output_count = frames;
    restart();
    w.machine.joint[1].place = (position_place){.measured = NAN, .sent = NAN};
    run(2.25F, 20 * MS);
    ask_for(DRIVE_READY);
    run(2.25F, 20 * MS);
}

static void each_target_of_each_frame_needs_its_own_position_and_no_other(void)
{
    for (uint32_t i = 0; i < 4; i++) {
        begin_with_two(1 + i % 2, 1 + i / 2);
        w.machine.joint[1].place = (position_place){.measured = NAN, .sent = NAN};
        CHECK(can_place_is_missing(m, 0) == (i != 0));
        w.machine.joint[1].place =
            (position_place){.measured = 2.0, .measured_ns = w.now_ns, .sent = NAN};
        CHECK(!can_place_is_missing(m, 0));
        w.machine.joint[0].place.measured = NAN;
        CHECK(can_place_is_missing(m, 0));
    }
}

static void each_target_of_each_frame_restarts_while_the_drive_is_not_armed_and_no_other(void)
{
    for (uint32_t i = 0; i < 4; i++) {
        begin_with_two(1 + i % 2, 1 + i / 2);
        w.machine.joint[0].place.sent = w.machine.joint[1].place.sent = 1.0;
        can_begin_positions(&w.machine, 0);
        CHECK(isnan(m->joint[0].place.sent) && isnan(m->joint[1].place.sent) == (i != 0));
    }
    begin();
    make_armed();
    w.machine.joint[0].place.sent = 1.0;
    step();
    CHECK(m->joint[0].place.sent == 1.0);
    ask_for(DRIVE_STAND_DOWN);
    CHECK(isnan(m->joint[0].place.sent));
}

static void each_target_that_left_is_the_start_of_the_next_one_and_no_other(void)
{
    for (uint32_t count = 1; count <= 2; count++) {
        begin_with_two(count, 1);
        w.machine.joint[1].place =
            (position_place){.measured = 2.0, .measured_ns = w.now_ns, .sent = NAN};
        w.powered = true;
        ask_for(DRIVE_ARMED);
        wanted_rad = 0.5, positioned = 1;
        put();
        w.machine.newest.joint_count = 2;
        w.machine.newest.position_rad[1] = 0.0;
        w.machine.newest.positioned = 3;
        w.machine.joint[0].place.sent = w.machine.joint[1].place.sent = NAN;
        can_note_positions(&w.machine, 0, 0);
        CHECK(m->joint[0].place.sent == 2.25);
        CHECK(isnan(m->joint[1].place.sent) == (count == 1) &&
              (count == 1 || m->joint[1].place.sent == 2.0));
    }
}

/* A position is read once in a cycle, and three cycles are longer than the time-out. */
static void on_a_slow_bus_a_position_is_fresh_for_three_cycles(void)
{
    static const int64_t AGES_NS[] = {201 * 1000000, 299 * 1000000, 301 * 1000000, 399 * 1000000};
    for (uint32_t i = 0; i < 4; i++) {
        begin();
        w.table.period_ns = w.table.setpoint_timeout_ns = 100 * MS;
        restart();
        run(2.25F, 20 * MS);
        ask_for(DRIVE_READY);
        run(2.25F, 20 * MS);
        w.machine.joint[0].place.measured_ns = w.now_ns - AGES_NS[i];
        ask_for(DRIVE_ARMED);
        CHECK((state_of(0)->state.mode == DRIVE_ARMED) == (i < 2));
        CHECK(((state_of(0)->state.fault_reasons & DRIVE_FAULT_POSITION_UNKNOWN) != 0) == (i >= 2));
    }
}

/* The time since the newest target counts until the kick. Without it the new target would equal the
 * old one. */
static void a_new_target_is_sent_at_once_as_far_as_the_joint_s_speed_allows(void)
{
    begin();
    w.machine.table.drive[0].output[0].setpoint[0].scale.raw_per_s = 10.0;
    make_armed();
    wanted_rad = 0.5, positioned = 1;
    run(2.25F, 50 * MS);
    w.now_ns = w.machine.cycle.due_ns;
    put();
    step();
    CHECK(target_in(newest_of(0)) == 2.25F && m->joint[0].place.sent_ns == w.now_ns);
    wanted_rad = 1.0;
    put();
    CHECK(!can_differs(m, 0)); /* without time the target does not change */
    w.now_ns += MS;
    forget_sent();
    put();
    can_machine_kick(&w.machine, w.now_ns);
    step();
    CHECK(w.sent_count == 1 && target_in(newest_of(0)) == 2.26F);
}

int main(void)
{
    on_a_slow_bus_a_position_is_fresh_for_three_cycles();
    a_new_target_is_sent_at_once_as_far_as_the_joint_s_speed_allows();
    each_target_of_each_frame_needs_its_own_position_and_no_other();
    each_target_of_each_frame_restarts_while_the_drive_is_not_armed_and_no_other();
    each_target_that_left_is_the_start_of_the_next_one_and_no_other();
    a_stop_keeps_the_target_in_its_frame();
    a_stop_keeps_each_target_of_its_frame_and_no_other_byte();
    a_frame_is_sent_only_when_each_of_its_targets_is_known();
    only_a_ready_drive_without_power_keeps_its_own_position_as_target();
    a_target_of_a_joint_without_set_points_is_not_sent();
    a_target_of_minus_zero_is_sent_as_zero();
    a_joint_without_set_points_gets_no_target();
    a_drive_without_power_gets_its_own_position();
    an_armed_drive_gets_its_targets_and_nothing_without_one();
    a_drive_whose_targets_are_withheld_too_long_is_left_alone();
    a_drive_that_does_not_answer_gets_stops_and_no_target();
    its_reference_is_reported_beside_its_power();
    the_first_target_is_its_own_position_and_later_ones_move_from_there();
    a_first_target_far_from_its_position_takes_the_power();
    a_drive_whose_position_is_missing_gets_no_power();
    return checks_report("can position");
}
