/* SPDX-License-Identifier: Apache-2.0
 * test_core_steered: ticks of bases whose wheels are steered. */
#include "steered_bases.h"

/* angle of the bicycle's wheel at a curvature of 0.8 / m: atan(0.3 * 0.8) */
static const double ANGLE_RAD = 0.23554498072086333;

static bool all_rest(const rig *r)
{
    return zero(r) && r->shown.setpoint_linear_m_s == 0.0 &&
           r->shown.setpoint_angular_rad_s == 0.0 && r->shown.lateral.setpoint_lateral_m_s == 0.0;
}

static void a_bicycle_points_its_wheel_drives_and_measures_its_curve(void)
{
    core_config config = bicycle();
    rig r;
    start(&r, &config);
    go(&r, 0.5, 0.4);
    CHECK(r.shown.reasons == 0 && close_to(r.out.joint[0].velocity_rad_s, 10.0) &&
          close_to(r.out.joint[0].duty, 10.0 / 60.0));
    CHECK(r.out.positioned == 2 && close_to(r.out.position_rad[1], ANGLE_RAD) &&
          r.out.position_rad[0] == 0.0);
    CHECK(close_to(r.shown.setpoint_linear_m_s, 0.5) &&
          close_to(r.shown.setpoint_angular_rad_s, 0.4));
    CHECK(fabs(r.shown.linear_m_s - 0.5) < 1e-3 && fabs(r.shown.angular_rad_s - 0.4) < 1e-3);
    CHECK(r.shown.odometry_degraded == 0 && r.shown.lateral.slip_m_s < 1e-4);
    CHECK(r.shown.steering.position_joints == 2 && r.shown.steering.misaligned_rad < 1e-4 &&
          r.shown.steering.position_unknown == 0);
    CHECK(fabs(r.shown.joint[1].position_rad - ANGLE_RAD) < 1e-4 &&
          r.shown.joint[1].setpoint_rad_s == 0.0);
    CHECK(fabs(r.shown.heading_rad - 0.8 * r.shown.distance_m) < 1e-3 && r.shown.heading_rad > 0.3);
    for (int ms = 0; ms < 1000; ms++) {
        double before_m_s = r.shown.setpoint_linear_m_s,
               before_rad_s = r.shown.setpoint_angular_rad_s;
        r.input.control.stop = 1; /* a stop keeps the curve and the deceleration */
        tick(&r);
        CHECK(close_to(r.shown.setpoint_angular_rad_s, 0.8 * r.shown.setpoint_linear_m_s));
        CHECK(before_m_s - r.shown.setpoint_linear_m_s < 1.5e-3 + 1e-9 &&
              before_rad_s >= r.shown.setpoint_angular_rad_s);
    }
    CHECK(all_rest(&r) && r.shown.at_rest == 1 && r.shown.armed == 1 &&
          close_to(r.out.position_rad[1], ANGLE_RAD));
}

static void each_wheel_of_a_swerve_base_rolls_at_the_speed_of_the_floor_under_it(void)
{
    core_config config = swerve_of_four();
    rig r;
    start(&r, &config);
    go(&r, 0.2, 0.0);
    r.input.command.lateral_m_s = 0.3;
    CHECK(close_to(ticks(&r, 2500)->lateral.setpoint_lateral_m_s, 0.3));
    r.input.command.angular_rad_s = 0.5;
    ticks(&r, 2500);
    CHECK(r.shown.reasons == 0 && r.out.positioned == 0x55 &&
          close_to(r.shown.lateral.setpoint_lateral_m_s, 0.3));
    for (int k = 0; k < 4; k++) {
        const wheel_module *at = &config.module[k];
        double x_m_s = 0.2 - 0.5 * at->y_m, y_m_s = 0.3 + 0.5 * at->x_m,
               angle_rad = r.out.position_rad[2 * k];
        CHECK(fabs(sin(angle_rad - atan2(y_m_s, x_m_s))) < 1e-9 && fabs(angle_rad) < 1.6);
        double rolls_rad_s = (x_m_s * cos(angle_rad) + y_m_s * sin(angle_rad)) / RADIUS_M;
        /* for the measured angle */
        CHECK(fabs(r.out.joint[2 * k + 1].velocity_rad_s - rolls_rad_s) < 1e-3);
        CHECK(r.out.joint[2 * k].duty == 0.0 &&
              fabs(r.out.joint[2 * k + 1].duty - rolls_rad_s / 60.0) < 1e-4);
    }
    CHECK(fabs(r.shown.linear_m_s - 0.2) < 1e-3 && fabs(r.shown.lateral.lateral_m_s - 0.3) < 1e-3);
    CHECK(fabs(r.shown.angular_rad_s - 0.5) < 2e-3);
}

static void a_base_that_begins_to_roll_is_not_at_rest(void)
{
    const core_config bases[] = {bicycle(), swerve_of_four()};
    for (int i = 0; i < COUNT_OF(bases); i++) {
        rig r;
        ready(&r, &bases[i]);
        r.input.control.armed = 1;
        CHECK(tick(&r)->at_rest == 1);
        r.input.command.linear_m_s = 0.5;
        CHECK(tick(&r)->setpoint_linear_m_s > 0.0 && r.shown.at_rest == 0);
    }
}

/* Late ticks while the joint brakes, and extra ticks, which commands cause. */
static void a_steering_joint_stays_within_its_range_with_late_and_extra_ticks(void)
{
    static const int64_t LATE_NS[] = {2000000, 10000000, 30000000, 90000000};
    const core_config config = bicycle();
    for (int late = 0; late < COUNT_OF(LATE_NS); late++) {
        for (int at = 1; at < 300; at += 3) {
            rig r;
            ready(&r, &config);
            r.input.control.armed = 1;
            tick(&r);
            r.input.command.linear_m_s = 0.5, r.input.command.angular_rad_s = 2.0;
            for (int i = 0; i < 400; i++) {
                double before_rad_s = r.out.joint[1].velocity_rad_s;
                int64_t dt_ns = i == at ? LATE_NS[late] : i % 3 == 0 ? 300000 : 1000000;
                prepare(&r);
                r.input.now_ns += dt_ns - TICK_NS;
                core_step(&r.state, &r.input, (double)dt_ns * 1e-9, &r.out, &r.shown);
                double change_rad_s = fabs(r.out.joint[1].velocity_rad_s - before_rad_s);
                CHECK(r.out.position_rad[1] <= 0.6 + 1e-12 &&
                      change_rad_s <= 40.0 * (double)dt_ns * 1e-9 + 1e-12);
            }
            CHECK(close_to(r.out.position_rad[1], 0.6) && r.shown.faults == 0);
        }
    }
}

/* Cases: each joint. The report ends with the cause. */
static void a_duty_at_its_limit_is_reported(void)
{
    for (int j = 0; j < 4; j++) {
        core_config config = j < 2 ? ackermann(WHEELBASE_M) : head_and_belt();
        config.joint[0] = j < 2 ? config.joint[0] : config.joint[1]; /* the first joint becomes a
                                                                        belt, too */
        config.joint[j % 2].pwm.duty_max = 0.1;
        rig r;
        ready(&r, &config);
        r.input.control.armed = 1;
        tick(&r);
        r.input.command.linear_m_s = 0.5;
        r.input.joints = (joint_command){.named = 3, .value_u = {7.0, 7.0}};
        ticks(&r, 1500);
        CHECK(r.shown.reasons == REASON_DUTY_CLAMPED && close_to(r.out.joint[j % 2].duty, 0.1));
        CHECK(r.shown.reason.duty_clamped == 1U << j % 2 && r.shown.reason.duty_slew == 0);
        r.input.command.linear_m_s = 0.2;
        r.input.joints.value_u[0] = r.input.joints.value_u[1] = 2.0;
        CHECK(ticks(&r, 1500)->reasons == 0);
    }
}

static void a_steered_base_waits_for_a_slow_duty_and_names_its_joint(void)
{
    core_config config = bicycle();
    config.limits.linear = (axis_limits){1.0, 100.0, 100.0, INFINITY};
    config.joint[0].row = (wheel_row){.x = 1.0};
    config.joint[0].pwm.slew_per_s = 1.0 / 60.0; /* 1 rad/s of the wheel in a second */
    rig r;
    ready(&r, &config);
    r.input.control.armed = 1;
    tick(&r);
    r.input.command.linear_m_s = 0.5;
    for (int ms = 0; ms < 1000; ms++) {
        CHECK((tick(&r)->reasons & REASON_DUTY_SLEW) && r.shown.reason.duty_slew == 1);
    }
    CHECK(fabs(r.shown.joint[0].setpoint_rad_s - 1.0) < 0.01);
}

/* Cases: each wheel. The check comes before the next duty is computed. */
static void a_duty_that_is_not_finite_is_noticed_at_once(void)
{
    core_config config = swerve_of_four();
    for (int k = 0; k < 4; k++) {
        rig r;
        start(&r, &config);
        go(&r, 0.2, 0.0);
        r.state.wheels.joint[2 * k + 1].duty = NAN;
        CHECK(tick(&r)->faults == FAULT_STATE && zero(&r) && r.shown.armed == 0);
    }
    core_config joints = head_and_belt();
    rig r;
    ready(&r, &joints);
    r.input.control.armed = 1;
    tick(&r);
    r.state.wheels.joint[1].duty = NAN;
    CHECK(tick(&r)->faults == FAULT_STATE && zero(&r));
}

static void at_rest_the_wheel_points_first(void)
{
    core_config config = bicycle();
    rig r;
    ready(&r, &config);
    r.input.control.armed = 1;
    CHECK(tick(&r)->armed == 1);
    r.input.command.linear_m_s = 0.5, r.input.command.angular_rad_s = 0.9;
    bool moved = false;
    for (int ms = 0; ms < 1000; ms++) {
        double off_rad = fabs(atan(0.3 * 1.8) - r.shown.joint[1].position_rad);
        CHECK(r.shown.setpoint_linear_m_s == 0.0 || off_rad < 0.26);
        tick(&r);
        moved |= r.shown.setpoint_linear_m_s != 0.0;
        if (!moved) { /* the wheel turns, so the base is not at rest */
            CHECK((r.shown.reasons & REASON_STEERING) && r.shown.at_rest == 0);
        }
    }
    CHECK(moved);
}

/* A curve that begins during motion ramps as slowly as the wheel turns, and every reason is
 * reported. */
static void a_curve_waits_for_its_wheel_and_the_base_does_not_slow_down(void)
{
    core_config config = bicycle();
    config.limits.angular = (axis_limits){2.0, 60.0, 60.0, INFINITY};
    rig r;
    start(&r, &config);
    go(&r, 0.5, 0.0);
    r.input.command.angular_rad_s = 2.0; /* a tighter curve than the wheel can steer */
    uint32_t reasons = 0;
    for (int ms = 0; ms < 1500; ms++) {
        reasons |= tick(&r)->reasons;
        CHECK(close_to(r.shown.setpoint_linear_m_s, 0.5) && r.shown.steering.misaligned_rad < 0.05);
        CHECK(r.shown.reasons & REASON_CURVATURE);
    }
    CHECK((reasons & REASON_STEERING) && r.shown.reasons == REASON_CURVATURE);
    CHECK(close_to(r.shown.setpoint_angular_rad_s, 0.5 * tan(0.6) / WHEELBASE_M));
}

static void every_stop_of_a_steered_base_ends_at_rest(void)
{
    static const stop_action ACTIONS[] = {STOP_RAMP, STOP_BRAKE, STOP_HOLD, STOP_COAST};
    for (int i = 0; i < COUNT_OF(ACTIONS); i++) {
        core_config config = bicycle();
        config.on_fault = config.on_timeout = ACTIONS[i];
        rig r;
        start(&r, &config);
        go(&r, 0.5, 0.4);
        r.input.command.angular_rad_s = -0.4;
        ticks(&r, 10);
        r.input.control.fault = 1;
        tick(&r);
        CHECK(r.shown.faults == FAULT_EXTERNAL &&
              r.out.enabled == (ACTIONS[i] == STOP_COAST ? 0 : 1));
        CHECK((r.out.joint[0].velocity_rad_s == 0.0) ==
              (ACTIONS[i] == STOP_BRAKE || ACTIONS[i] == STOP_COAST));
        ticks(&r, 2500);
        CHECK(all_rest(&r) && r.out.enabled == (ACTIONS[i] == STOP_HOLD ? 1 : 0));
        CHECK(r.out.positioned == (ACTIONS[i] == STOP_HOLD ? 2 : 0));
        if (ACTIONS[i] != STOP_HOLD) { /* without power the target is the position of the joint */
            CHECK(r.out.position_rad[1] == 0.0 &&
                  isnan(r.shown.steering.position_setpoints_rad[1]));
            CHECK(r.state.steer.enabled == 0 &&
                  r.state.steer.profile[1].position_rad == r.state.odometry.angle_rad[1]);
        }
    }
}

static void limits_of_the_lateral_axis_apply_where_the_base_strafes(void)
{
    core_config config = swerve_of_four();
    rig r;
    ready(&r, &config);
    double *velocity_m_s = &r.input.control.limits.lateral.velocity_u_s;
    *velocity_m_s = nextafter(*velocity_m_s, 1.0);
    tick(&r);
    CHECK(r.state.limits.lateral.velocity_u_s == *velocity_m_s);
    r.input.control.armed = 1;
    tick(&r);
    r.input.command.lateral_m_s = 0.6;
    CHECK(close_to(ticks(&r, 2500)->lateral.setpoint_lateral_m_s, 0.6));
    *velocity_m_s = 0.2;
    CHECK(close_to(ticks(&r, 2500)->lateral.setpoint_lateral_m_s, 0.2) &&
          r.shown.reasons == REASON_LATERAL_VELOCITY);
}

static void a_brake_holds_the_wheels_where_they_point(void)
{
    core_config config = bicycle();
    config.on_timeout = STOP_BRAKE;
    rig r;
    start(&r, &config);
    go(&r, 0.5, 0.4);
    r.input.control.stop = 1;
    CHECK(tick(&r)->armed == 1 && all_rest(&r) && close_to(r.out.position_rad[1], ANGLE_RAD));
    CHECK(ticks(&r, 500)->at_rest == 1 && r.out.positioned == 2 &&
          close_to(r.out.position_rad[1], ANGLE_RAD));
}

/* A late tick counts as a step of 0.1 s at most. */
static void a_late_tick_turns_a_wheel_by_no_more_than_its_speed(void)
{
    static const double LATE_S[] = {0.1, 0.2, 5.0};
    for (int i = 0; i < COUNT_OF(LATE_S); i++) {
        core_config config = bicycle();
        config.joint[1].position.acceleration_rad_s2 = 1.0;
        rig r;
        ready(&r, &config);
        r.input.control.armed = 1;
        tick(&r);
        r.input.command.linear_m_s = 0.5, r.input.command.angular_rad_s = 0.9;
        prepare(&r);
        core_step(&r.state, &r.input, LATE_S[i], &r.out, &r.shown);
        CHECK(close_to(r.out.position_rad[1], 0.01) &&
              close_to(r.out.joint[1].velocity_rad_s, 0.1));
        r.input.command.angular_rad_s = 0.0;
        rig straight;
        ready(&straight, &config);
        straight.input.control.armed = 1;
        tick(&straight);
        straight.input.command.linear_m_s = 0.5;
        prepare(&straight);
        core_step(&straight.state, &straight.input, LATE_S[i], &straight.out, &straight.shown);
        CHECK(close_to(straight.shown.setpoint_linear_m_s, 0.08)); /* limited by the jerk: 8 m/s3
                                                                      for 0.1 s */
    }
}

static void a_steered_base_whose_wheel_is_stuck_comes_to_rest_and_reports_it(void)
{
    core_config config = bicycle();
    config.joint[1].position.following_rad = 0.1, config.joint[1].position.following_s = 0.4;
    rig r;
    start(&r, &config);
    go(&r, 0.5, 0.0);
    r.input.command.angular_rad_s = 0.7;
    double stuck_rad = r.position_rad[1];
    int64_t began_ns = 0;
    for (int ms = 0; ms < 3000 && r.shown.faults == 0; ms++) {
        r.position_rad[1] = stuck_rad - r.out.joint[1].velocity_rad_s * 1e-3;
        tick(&r);
        double apart_rad = r.out.position_rad[1] - r.shown.joint[1].position_rad;
        began_ns = began_ns == 0 && apart_rad > 0.1 + 0.25 * fabs(r.out.joint[1].velocity_rad_s)
                       ? r.input.now_ns
                       : began_ns;
    }
    CHECK(r.shown.faults == FAULT_FOLLOWING_ERROR && r.shown.armed == 0 &&
          r.shown.doubt.joint == 1);
    CHECK(r.shown.doubt.fault == FAULT_FOLLOWING_ERROR && isnan(r.shown.doubt.reported_rad_s));
    CHECK(r.shown.doubt.since_ns > began_ns - 5 * MS_NS &&
          r.shown.doubt.since_ns <= r.input.now_ns - 400 * MS_NS);
    ticks(&r, 2500);
    CHECK(all_rest(&r) && r.out.enabled == 0);
    r.input.command.angular_rad_s = r.input.command.linear_m_s = 0.0;
    ticks(&r, 5);
    r.input.control.reset_count++;
    CHECK(tick(&r)->faults == 0 && r.shown.doubt.since_ns == 0 && r.shown.doubt.fault == 0);
}

static void a_steering_joint_that_loses_its_position_ends_at_rest_and_is_not_armed_again(void)
{
    core_config config = bicycle();
    config.joint[1].position.reference = REFERENCE_HOMED;
    rig r;
    start(&r, &config);
    CHECK(ticks(&r, 2)->steering.position_unknown == 2 &&
          (r.shown.reasons & REASON_POSITION_UNKNOWN));
    r.input.control.armed = 1;
    CHECK(tick(&r)->armed == 0 && r.shown.faults == 0 &&
          isnan(r.shown.steering.position_setpoints_rad[1]));
    r.input.control.armed = 0;
    r.input.feedback[1].referenced = 1;
    CHECK(ticks(&r, 2)->steering.position_unknown == 0 &&
          !(r.shown.reasons & REASON_POSITION_UNKNOWN));
    go(&r, 0.5, 0.4);
    r.input.feedback[1].referenced = 0;
    CHECK(tick(&r)->faults == FAULT_POSITION_UNKNOWN && r.shown.armed == 0 &&
          r.out.positioned == 0 && r.out.enabled == 1);
    r.input.command.linear_m_s = r.input.command.angular_rad_s = 0.0;
    CHECK(ticks(&r, 2500)->steering.position_unknown == 2 && all_rest(&r) && r.out.enabled == 0);
    rig both;
    start(&both, &config);
    both.input.feedback[1].referenced = 1;
    go(&both, 0.5, 0.4);
    both.input.feedback[1].referenced = 0, both.input.control.fault = 1;
    CHECK(tick(&both)->faults == (FAULT_POSITION_UNKNOWN | FAULT_EXTERNAL));
    for (uint32_t known = 0; known < 2; known++) {
        r.input.feedback[1].referenced = known;
        r.input.control.reset_count++;
        r.input.control.armed = 0;
        CHECK(tick(&r)->faults == (known ? 0U : FAULT_POSITION_UNKNOWN));
        r.input.control.armed = 1;
        CHECK(tick(&r)->armed == known);
    }
}

/* The joint counts as at its set-point after the time of its longest move. The odometry takes the
 * set-point as its angle. */
static void a_steering_joint_without_measurement_counts_as_at_its_set_point(void)
{
    core_config config = bicycle();
    config.joint[1].position.reference = REFERENCE_ESTIMATED;
    config.joint[1].counter_bits = 0;
    rig r;
    ready(&r, &config);
    r.input.control.armed = 1;
    tick(&r);
    r.input.command.linear_m_s = 0.5, r.input.command.angular_rad_s = 0.4;
    ticks(&r, 395); /* 1.2 rad at 3 rad/s */
    CHECK(r.shown.setpoint_linear_m_s == 0.0 && r.out.position_rad[1] == 0.0 &&
          (r.shown.reasons & REASON_STEERING));
    ticks(&r, 1500);
    CHECK(r.shown.reasons == 0 && close_to(r.shown.setpoint_linear_m_s, 0.5) &&
          close_to(r.shown.joint[1].position_rad, ANGLE_RAD));
    CHECK(fabs(r.shown.angular_rad_s - 0.4) < 1e-3);
}

int main(void)
{
    a_bicycle_points_its_wheel_drives_and_measures_its_curve();
    each_wheel_of_a_swerve_base_rolls_at_the_speed_of_the_floor_under_it();
    a_base_that_begins_to_roll_is_not_at_rest();
    a_steering_joint_stays_within_its_range_with_late_and_extra_ticks();
    a_duty_at_its_limit_is_reported();
    a_steered_base_waits_for_a_slow_duty_and_names_its_joint();
    a_duty_that_is_not_finite_is_noticed_at_once();
    at_rest_the_wheel_points_first();
    a_curve_waits_for_its_wheel_and_the_base_does_not_slow_down();
    every_stop_of_a_steered_base_ends_at_rest();
    limits_of_the_lateral_axis_apply_where_the_base_strafes();
    a_brake_holds_the_wheels_where_they_point();
    a_late_tick_turns_a_wheel_by_no_more_than_its_speed();
    a_steered_base_whose_wheel_is_stuck_comes_to_rest_and_reports_it();
    a_steering_joint_that_loses_its_position_ends_at_rest_and_is_not_armed_again();
    a_steering_joint_without_measurement_counts_as_at_its_set_point();
    return checks_report("test_core_steered");
}
