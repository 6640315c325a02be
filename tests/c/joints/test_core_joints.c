/* SPDX-License-Identifier: Apache-2.0
 * test_core_joints: ticks of joints without a base. */
#include "steered_bases.h"

static void ask(rig *r, uint32_t named, double pan_rad, double belt_rad_s)
{
    r->input.joints.named = named;
    r->input.joints.value_u[0] = pan_rad, r->input.joints.value_u[1] = belt_rad_s;
}

static void joints_move_independently_and_no_base_is_measured(void)
{
    core_config config = head_and_belt();
    rig r;
    ready(&r, &config);
    r.input.control.armed = 1;
    CHECK(tick(&r)->armed == 1 && r.out.positioned == 5);
    r.input.command.linear_m_s = r.input.command.angular_rad_s = 0.5; /* a twist moves no joint */
    CHECK(ticks(&r, 100)->at_rest == 1 && zero(&r) && r.out.position_rad[0] == 0.0 &&
          r.out.position_rad[2] == 0.0);
    ask(&r, 3, 1.0, -4.0);
    tick(&r);
    CHECK(close_to(r.out.joint[1].velocity_rad_s, -0.01) &&
          close_to(r.out.position_rad[0], 40e-6) && r.shown.at_rest == 0);
    CHECK(r.shown.reasons == REASON_JOINT_ACCELERATION && r.out.position_rad[2] == 0.0);
    ticks(&r, 1000);
    CHECK(r.out.joint[1].velocity_rad_s == -4.0 && close_to(r.out.joint[1].duty, -4.0 / 60.0) &&
          r.out.position_rad[0] == 1.0);
    CHECK(r.shown.reasons == 0 && fabs(r.shown.joint[0].position_rad - 1.0) < 1e-4 &&
          r.shown.odometry_degraded == 0);
    CHECK(r.shown.x_m == 0.0 && r.shown.heading_rad == 0.0 && r.shown.linear_m_s == 0.0);
    ask(&r, 0, 0.0, 0.0);
    ticks(&r, 500);
    CHECK(zero(&r) && r.shown.at_rest == 1 && r.out.position_rad[0] == 1.0);
}

static void every_stop_of_joints_ends_at_rest_and_leaves_no_target(void)
{
    static const stop_action ACTIONS[] = {STOP_RAMP, STOP_BRAKE, STOP_HOLD, STOP_COAST};
    for (int i = 0; i < COUNT_OF(ACTIONS); i++) {
        core_config config = head_and_belt();
        config.joint[1].own.jerk_u_s3 = 50.0;
        config.on_fault = config.on_timeout = ACTIONS[i];
        rig r;
        ready(&r, &config);
        r.input.control.armed = 1;
        tick(&r);
        ask(&r, 3, 2.0, 4.0);
        ticks(&r, 300);
        double before_rad_s = r.out.joint[1].velocity_rad_s;
        r.input.control.fault = 1;
        tick(&r);
        bool at_once = ACTIONS[i] == STOP_BRAKE || ACTIONS[i] == STOP_COAST;
        CHECK((r.out.joint[1].velocity_rad_s == 0.0) == at_once &&
              (r.out.joint[0].velocity_rad_s == 0.0) == at_once);
        /* without a jerk limit in a fault */
        CHECK(at_once || close_to(before_rad_s - r.out.joint[1].velocity_rad_s, 0.016));
        ticks(&r, 2500);
        CHECK(zero(&r) && r.out.enabled == (ACTIONS[i] == STOP_HOLD ? 1 : 0));
        double held_rad = r.state.steer.profile[0].position_rad;
        CHECK(held_rad > 0.1 && held_rad < 1.9 &&
              fabs(held_rad - r.shown.joint[0].position_rad) < 1e-4);
        for (int j = 0; j < JOINTS_MAX; j++) {
            CHECK(isnan(r.state.joints.target_rad[j]));
        }
        CHECK(r.out.positioned == (ACTIONS[i] == STOP_HOLD ? 5 : 0));
    }
}

static void a_late_tick_of_joints_is_a_step_of_a_tenth_of_a_second(void)
{
    static const double LATE_S[] = {0.1, 0.2, 5.0};
    for (int i = 0; i < COUNT_OF(LATE_S); i++) {
        core_config config = head_and_belt();
        rig r;
        ready(&r, &config);
        r.input.control.armed = 1;
        tick(&r);
        ask(&r, 3, 2.0, 4.0);
        prepare(&r);
        core_step(&r.state, &r.input, LATE_S[i], &r.out, &r.shown);
        CHECK(close_to(r.out.joint[1].velocity_rad_s, 1.0) &&
              close_to(r.out.joint[0].velocity_rad_s, 3.0));
    }
}

/* The set-point is not clamped to the end of the range, but moves there at its speed. */
static void a_late_tick_takes_no_set_point_past_its_goal(void)
{
    const core_config config = head_and_belt();
    for (int at = 1; at < 1200; at += 7) {
        rig r;
        ready(&r, &config);
        r.input.control.armed = 1;
        tick(&r);
        ask(&r, 1, 2.0, 0.0);
        for (int i = 0; i < 1300; i++) {
            double before_rad = r.out.position_rad[0], before_rad_s = r.out.joint[0].velocity_rad_s;
            double dt_s = i == at ? 0.09 : i % 3 == 0 ? 0.0003 : 0.001;
            prepare(&r);
            core_step(&r.state, &r.input, dt_s, &r.out, &r.shown);
            double speed_rad_s = r.out.joint[0].velocity_rad_s;
            CHECK(r.out.position_rad[0] <= 2.0 &&
                  close_to(r.out.position_rad[0], before_rad + speed_rad_s * dt_s));
            CHECK(fabs(speed_rad_s - before_rad_s) <= 40.0 * dt_s + 1e-12);
        }
        CHECK(r.out.position_rad[0] == 2.0 && r.shown.faults == 0);
    }
}

static void a_target_requires_power_a_finite_command_and_its_lease(void)
{
    core_config config = head_and_belt();
    rig r;
    ready(&r, &config);
    ask(&r, 3, 1.0, 2.0);
    ticks(&r, 10);
    CHECK(zero(&r) && r.out.positioned == 0 && r.state.steer.profile[0].position_rad == 0.0);
    ask(&r, 0, 0.0, 0.0);
    r.input.control.owner = 4;
    tick(&r);
    r.input.control.armed = 1;
    tick(&r);
    ask(&r, 3, 1.0, 2.0);
    ticks(&r, 100);
    r.input.control.owner = 5; /* another lease: the joints stop */
    ask(&r, 0, 0.0, 0.0);
    ticks(&r, 600);
    double held_rad = r.out.position_rad[0];
    CHECK(zero(&r) && held_rad > 0.0 && held_rad < 0.5);
    ask(&r, 3, NAN, 2.0);
    ticks(&r, 300);
    CHECK(zero(&r) && r.out.position_rad[0] == held_rad &&
          (r.shown.reasons & REASON_COMMAND_NOT_FINITE));
    ask(&r, 1, 1.0, 0.0);
    ticks(&r, 1000);
    CHECK(r.out.position_rad[0] == 1.0);
    r.input.control.stop = 1;
    ticks(&r, 10);
    r.input.control.stop = 0;
    ask(&r, 0, 0.0, 0.0);
    CHECK(ticks(&r, 500)->at_rest == 1 && r.out.position_rad[0] == 1.0);
}

static void joints_of_which_one_begins_to_move_are_not_at_rest(void)
{
    for (uint32_t moves = 0; moves < 3; moves++) {
        core_config config = head_and_belt();
        config.joint[0] = config.joint[1]; /* the first joint becomes a belt, too */
        rig r;
        ready(&r, &config);
        r.input.control.armed = 1;
        CHECK(tick(&r)->at_rest == 1);
        r.input.joints = (joint_command){.named = 1U << moves, .value_u = {0.5, 0.5, 0.5}};
        CHECK(tick(&r)->at_rest == 0 && r.out.joint[moves].velocity_rad_s > 0.0);
    }
}

static void joints_are_armed_without_a_command_that_moves_one(void)
{
    static const struct {
        uint32_t named;
        double pan_rad, belt_rad_s;
        uint32_t armed;
    } CASES[] = {{1, 0.0, 0.0, 0}, {2, 0.0, 1.0, 0}, {2, 0.0, NAN, 0},
                 {1, NAN, 0.0, 0}, {2, 0.0, 0.0, 1}, {0, NAN, NAN, 1}};
    for (int i = 0; i < COUNT_OF(CASES); i++) {
        core_config config = head_and_belt();
        rig r;
        ready(&r, &config);
        ask(&r, CASES[i].named, CASES[i].pan_rad, CASES[i].belt_rad_s);
        tick(&r);
        r.input.control.armed = 1;
        CHECK(tick(&r)->armed == CASES[i].armed && zero(&r));
    }
}

/* The joint's set-point begins at its measured position. */
static void without_power_a_joint_is_where_it_was_moved_to(void)
{
    core_config config = head_and_belt();
    rig r;
    ready(&r, &config);
    for (int again = 0; again < 2; again++) {
        r.input.control.armed = 0;
        tick(&r);
        for (int ms = 0; ms < 100; ms++) {
            r.position_rad[0] += again == 0 ? 0.004 : -0.011;
            tick(&r);
        }
        ticks(&r, 10);
        CHECK(r.out.positioned == 0 && r.out.position_rad[0] == 0.0 && r.shown.at_rest == 1);
        r.input.control.armed = 1;
        CHECK(tick(&r)->armed == 1 && fabs(r.out.position_rad[0] - r.position_rad[0]) < 2e-5 &&
              r.out.positioned == 5);
        CHECK(ticks(&r, 100)->at_rest == 1 &&
              fabs(r.out.position_rad[0] - (again == 0 ? 0.4 : -0.7)) < 2e-5);
    }
}

/* Without power there is no set-point, neither for the drive nor on the state page. The next move
 * begins at zero. */
static void without_power_a_belt_has_no_set_point_left(void)
{
    core_config config = head_and_belt();
    rig r;
    ready(&r, &config);
    r.input.control.armed = 1;
    tick(&r);
    ask(&r, 2, 0.0, 4.0);
    CHECK(ticks(&r, 1000)->joint[1].setpoint_rad_s == 4.0 &&
          close_to(r.shown.joint[1].duty, 4.0 / 60.0));
    r.input.control.armed = 0;
    r.stale = true; /* also in a tick without a measurement */
    tick(&r);
    CHECK(r.out.enabled == 0 && zero(&r) && r.shown.joint[1].setpoint_rad_s == 0.0 &&
          r.shown.joint[1].duty == 0.0);
    r.stale = false;
    ask(&r, 0, 0.0, 0.0);
    ticks(&r, 10);
    r.input.control.armed = 1;
    CHECK(tick(&r)->armed == 1 && zero(&r));
}

static void joints_begin_without_a_target(void)
{
    core_config config = head_and_belt();
    rig r;
    start(&r, &config);
    for (int j = 0; j < JOINTS_MAX; j++) {
        CHECK(isnan(r.state.joints.target_rad[j]));
    }
}

static void limits_of_joints_that_change_while_they_move_are_kept_from_then_on(void)
{
    core_config config = head_and_belt();
    rig r;
    ready(&r, &config);
    r.input.control.armed = 1;
    tick(&r);
    ask(&r, 2, 0.0, 4.0);
    CHECK(ticks(&r, 1000)->joint[1].setpoint_rad_s == 4.0);
    for (int j = 0; j < 3; j++) {
        r.input.control.joint_limits[j] = (axis_limits){1.5, 10.0, 16.0, INFINITY};
    }
    /* without a new count they do not apply */
    CHECK(ticks(&r, 500)->joint[1].setpoint_rad_s == 4.0);
    r.input.control.joint_limits_count++;
    CHECK(ticks(&r, 1000)->joint[1].setpoint_rad_s == 1.5 &&
          r.shown.reasons == REASON_JOINT_VELOCITY);
    CHECK(r.shown.reason.joint_velocity == 2);
}

static void the_full_number_of_joints_move(void)
{
    core_config config = heads_and_belts();
    rig r;
    ready(&r, &config);
    r.input.control.armed = 1;
    CHECK(tick(&r)->armed == 1 && r.out.positioned == 0xAA);
    r.input.joints =
        (joint_command){.named = 0xFF, .value_u = {2.0, 0.5, 3.0, 0.6, 4.0, 0.7, 5.0, 0.8}};
    ticks(&r, 1500);
    CHECK(r.shown.faults == 0 && r.shown.reasons == 0 && r.shown.at_rest == 0 &&
          r.shown.odometry_degraded == 0);
    CHECK(r.shown.steering.position_joints == 0xAA);
    for (uint32_t j = 0; j < JOINTS_MAX; j++) {
        CHECK((j % 2 == 0 ? r.out.joint[j].velocity_rad_s : r.out.position_rad[j]) ==
              r.input.joints.value_u[j]);
        CHECK(j % 2 == 0 || fabs(r.shown.joint[j].position_rad - r.input.joints.value_u[j]) < 1e-3);
    }
}

/* Of belts 0 and 2, only the first one would need more duty than its limit. */
static void a_belt_whose_duty_is_clamped_is_named(void)
{
    core_config config = heads_and_belts();
    config.joint[0].pwm.duty_max = 0.05;
    rig r;
    ready(&r, &config);
    r.input.control.armed = 1;
    tick(&r);
    r.input.joints = (joint_command){.named = 5, .value_u = {[0] = 4.0, [2] = 4.0}};
    ticks(&r, 1000);
    CHECK(r.shown.reasons == REASON_DUTY_CLAMPED && r.shown.reason.duty_clamped == 1 &&
          r.shown.reason.duty_slew == 0);
    CHECK(r.out.joint[0].duty == 0.05 && close_to(r.out.joint[2].duty, 4.0 / 60.0));
    r.input.joints = (joint_command){.named = 5, .value_u = {[0] = 1.0, [2] = 4.0}};
    CHECK(ticks(&r, 1000)->reasons == 0);
}

static void a_belt_whose_duty_grows_slowly_is_named(void)
{
    core_config config = head_and_belt();
    config.joint[1].pwm.slew_per_s = 0.1; /* 6 rad/s of the belt in a second */
    rig r;
    ready(&r, &config);
    r.input.control.armed = 1;
    tick(&r);
    ask(&r, 3, 0.9, 6.0);
    CHECK((ticks(&r, 200)->reasons & REASON_DUTY_SLEW) && r.shown.reason.duty_slew == 2 &&
          r.shown.reason.duty_clamped == 0);
}

/* If the position of one joint is unknown, nothing is armed. If that happens during motion, all
 * joints come to rest. */
static void a_joint_without_a_known_position_does_not_move(void)
{
    core_config config = head_and_belt();
    config.joint[0].position.reference = REFERENCE_HOMED;
    rig r;
    ready(&r, &config);
    r.input.control.armed = 1;
    CHECK(tick(&r)->armed == 0 && r.out.enabled == 0 && r.out.positioned == 0);
    CHECK((r.shown.reasons & REASON_POSITION_UNKNOWN) && r.shown.steering.position_unknown == 1);
    r.input.feedback[0].referenced = 1;
    r.input.control.armed = 0;
    tick(&r);
    r.input.control.armed = 1;
    CHECK(tick(&r)->armed == 1);
    ask(&r, 3, 1.0, 3.0);
    CHECK(ticks(&r, 100)->joint[1].setpoint_rad_s > 0.0);
    r.input.feedback[0].referenced = 0;
    CHECK(tick(&r)->faults == FAULT_POSITION_UNKNOWN && (r.out.positioned & 1) == 0);
    CHECK(ticks(&r, 1000)->joint[1].setpoint_rad_s == 0.0 && zero(&r));
}

static void a_warm_belt_is_derated_and_a_cold_one_is_not(void)
{
    for (int warm = 0; warm <= 1; warm++) {
        core_config config = head_and_belt();
        config.joint[1].derating.range[DERATED_BY_TEMPERATURE] = (derating_range){60.0, 80.0};
        rig r;
        start(&r, &config);
        r.input.feedback[1].temperature_c = warm ? 72.0 : 20.0;
        ticks(&r, 2);
        r.input.control.armed = 1;
        tick(&r);
        ask(&r, 2, 0.0, 8.0);
        ticks(&r, 2000);
        CHECK(close_to(r.out.joint[1].velocity_rad_s, warm ? 3.2 : 8.0));
        CHECK(((r.shown.reasons & REASON_DERATED) != 0) == warm &&
              (r.shown.derating.since_ns != 0) == warm);
    }
}

/* The numbers of a tick are checked even if the next set-point would replace them. */
static void a_duty_that_is_not_finite_is_a_fault_of_a_belt_too(void)
{
    core_config config = head_and_belt();
    rig r;
    ready(&r, &config);
    r.input.control.armed = 1;
    tick(&r);
    ask(&r, 2, 0.0, 4.0);
    ticks(&r, 100);
    r.state.wheels.joint[1].duty = NAN;
    CHECK((tick(&r)->faults & FAULT_STATE) != 0 && zero(&r));
}

static void a_lost_command_of_joints_is_a_reason_beside_their_own(void)
{
    core_config config = head_and_belt();
    rig r;
    ready(&r, &config);
    r.input.control.armed = 1;
    tick(&r);
    ask(&r, 2, 0.0, 4.0);
    ticks(&r, 1000);
    r.mute = true;
    CHECK(ticks(&r, 302)->reasons == (REASON_COMMAND_STALE | REASON_JOINT_ACCELERATION));
    r.stale = true; /* lost feedback is reported also without a base */
    CHECK(ticks(&r, 260)->odometry_degraded == 1);
}

int main(void)
{
    joints_move_independently_and_no_base_is_measured();
    every_stop_of_joints_ends_at_rest_and_leaves_no_target();
    a_late_tick_of_joints_is_a_step_of_a_tenth_of_a_second();
    a_late_tick_takes_no_set_point_past_its_goal();
    a_target_requires_power_a_finite_command_and_its_lease();
    joints_of_which_one_begins_to_move_are_not_at_rest();
    joints_are_armed_without_a_command_that_moves_one();
    without_power_a_joint_is_where_it_was_moved_to();
    without_power_a_belt_has_no_set_point_left();
    joints_begin_without_a_target();
    limits_of_joints_that_change_while_they_move_are_kept_from_then_on();
    the_full_number_of_joints_move();
    a_belt_whose_duty_is_clamped_is_named();
    a_belt_whose_duty_grows_slowly_is_named();
    a_joint_without_a_known_position_does_not_move();
    a_warm_belt_is_derated_and_a_cold_one_is_not();
    a_duty_that_is_not_finite_is_a_fault_of_a_belt_too();
    a_lost_command_of_joints_is_a_reason_beside_their_own();
    return checks_report("test_core_joints");
}
