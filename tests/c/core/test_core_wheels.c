/* SPDX-License-Identifier: Apache-2.0
 * test_core_wheels: from a twist to the set-points of the drives, in ticks in which something
 * changes. */
#include "steered_bases.h"
#include "torque_loop.h"

static void a_base_that_turned_on_the_spot_stands_still_afterwards(void)
{
    core_config config = good_config();
    rig r;
    start(&r, &config);
    go(&r, 0.0, 0.8);
    CHECK(fabs(r.out.joint[1].velocity_rad_s - 2.0) < 1e-9 && r.shown.at_rest == 0);
    r.input.command.angular_rad_s = 0.4;
    ticks(&r, 1500);
    CHECK(fabs(r.out.joint[1].velocity_rad_s - 1.0) < 1e-9 &&
          fabs(r.out.joint[0].velocity_rad_s + 1.0) < 1e-9);
    r.input.command.angular_rad_s = 0.0;
    CHECK(ticks(&r, 1500)->armed == 1 && zero(&r) && r.shown.at_rest == 1);
}

/* If the ramp kept its acceleration at the end, the next ramp would begin with it despite the jerk
 * limit. */
static void a_ramp_that_has_arrived_leaves_no_acceleration(void)
{
    static const double ACCELERATIONS_M_S2[] = {1.0, 0.1, 1.5}; /* also in rad/s2 */
    const double dt_s = 1.0 / 1024.0; /* an exact binary number, so that the step arrives with
                                         exactly this acceleration */
    core_config config = good_config();
    config.limits.linear = config.limits.angular = (axis_limits){1.0, 2.0, 2.0, INFINITY};
    for (int i = 0; i < COUNT_OF(ACCELERATIONS_M_S2); i++) {
        rig r;
        ready(&r, &config);
        r.input.control.armed = 1;
        prepare(&r);
        CHECK(step(&r)->armed == 1);
        r.input.command.linear_m_s = r.input.command.angular_rad_s = ACCELERATIONS_M_S2[i] * dt_s;
        prepare(&r);
        core_step(&r.state, &r.input, dt_s, &r.out, &r.shown);
        CHECK(r.shown.setpoint_linear_m_s == ACCELERATIONS_M_S2[i] * dt_s);
        for (int axis = AXIS_LINEAR; axis <= AXIS_ANGULAR; axis++) {
            CHECK(r.state.axis[axis].acceleration_u_s2 == ACCELERATIONS_M_S2[i]);
        }
        prepare(&r);
        core_step(&r.state, &r.input, dt_s, &r.out, &r.shown);
        for (int axis = 0; axis < AXES; axis++) {
            CHECK(r.state.axis[axis].acceleration_u_s2 == 0.0);
        }
    }
}

/* A late tick continues the ramp by 0.1 s at most. */
static void a_late_tick_of_a_stop_is_a_step_of_the_ramp(void)
{
    static const double LATE_S[] = {0.1, 0.2, 1.0};
    core_config config = good_config();
    for (int i = 0; i < COUNT_OF(LATE_S); i++) {
        rig r;
        start(&r, &config);
        go(&r, 0.6, 0.0);
        r.input.control.fault = 1;
        prepare(&r);
        core_step(&r.state, &r.input, LATE_S[i], &r.out, &r.shown);
        CHECK(r.shown.faults == FAULT_EXTERNAL &&
              fabs(r.shown.setpoint_linear_m_s - 0.45) < 1e-12 && r.out.enabled == 1);
    }
}

/* The duty of one wheel may only grow slowly. The whole base waits for it. */
static void the_slew_of_any_single_duty_slows_the_base(void)
{
    for (int slow = 0; slow < 4; slow++) {
        core_config config = good_config();
        config.limits.linear = (axis_limits){1.0, 100.0, 100.0, INFINITY};
        for (int j = 0; j < 4; j++) {
            /* 1 rad/s of the wheel in a second */
            config.joint[j].pwm.slew_per_s = j == slow ? 0.95 / 12.5 : INFINITY;
        }
        rig r;
        ready(&r, &config);
        r.input.control.armed = 1;
        tick(&r);
        r.input.command.linear_m_s = 0.5;
        for (int ms = 0; ms < 1000; ms++) {
            CHECK((tick(&r)->reasons & REASON_DUTY_SLEW) && r.shown.reason.duty_slew == 1U << slow);
            CHECK(r.shown.reason.duty_clamped == 0);
        }
        CHECK(fabs(r.shown.joint[slow].setpoint_rad_s - 1.0) < 0.01);
        ticks(&r, 5000);
        CHECK(fabs(r.shown.setpoint_linear_m_s - 0.5) < 1e-12 && r.shown.reasons == 0);
    }
}

/* Before the base reverses, it slows down for the wheel whose duty may only grow slowly
 * afterwards. */
static void in_a_reversal_the_wheel_that_has_to_be_eased_is_named(void)
{
    core_config config = good_config();
    config.joint[1].pwm.slew_per_s = 0.2;
    rig r;
    start(&r, &config);
    go(&r, 0.5, 0.0);
    ticks(&r, 2500);
    r.input.command.linear_m_s = -0.5;
    for (int ms = 0; ms < 5000 && r.shown.setpoint_linear_m_s > 0.0; ms++) {
        tick(&r);
    }
    CHECK(r.shown.setpoint_linear_m_s <= 0.0 && r.shown.reason.duty_slew == 1U << 1);
}

/* The twist is constant or ramps down, and one duty is too small: it grows by its slew, and the
 * wheel is named. */
static void a_duty_behind_its_goal_grows_by_its_slew_and_is_named(void)
{
    core_config bases[] = {good_config(), swerve_of_four()};
    for (int i = 0; i < 2 * COUNT_OF(bases); i++) {
        core_config *config = &bases[i / 2];
        uint32_t late = i < 2 ? 2 : 3;
        for (uint32_t j = 0; j < config->joint_count; j++) {
            config->joint[j].pwm.slew_per_s = 1.0;
        }
        rig r;
        start(&r, config);
        go(&r, 0.3, 0.0);
        double duty = r.out.joint[late].duty;
        CHECK(duty > 0.09 && r.shown.reasons == 0);
        r.state.wheels.joint[late].duty = 0.05;
        r.state.wheels.known = 0;
        /* the speed falls, so the slew does not slow the ramp */
        r.input.command.linear_m_s = i % 2 == 0 ? 0.3 : 0.25;
        for (int ms = 1; ms <= 20; ms++) {
            CHECK(fabs(tick(&r)->joint[late].duty - (0.05 + ms * 1e-3)) < 1e-9);
            CHECK((r.shown.reasons & REASON_DUTY_SLEW) && r.shown.reason.duty_slew == 1U << late);
            CHECK(r.shown.reason.duty_clamped == 0);
        }
        CHECK(ticks(&r, 800)->reasons == 0 && (i % 2 != 0 || r.out.joint[late].duty == duty));
    }
}

/* Ticks without a change use the last results. */
static void the_wheel_set_points_of_a_twist_are_computed_once(void)
{
    core_config config = good_config();
    rig r;
    start(&r, &config);
    go(&r, 0.3, 0.0);
    double duty = r.out.joint[2].duty;
    r.state.wheels.joint[2].duty = 0.125;
    r.state.axis[AXIS_LATERAL].acceleration_u_s2 = NAN; /* an axis that the base does not have */
    CHECK(ticks(&r, 3)->armed == 1 && r.out.joint[2].duty == 0.125);
    r.input.command.linear_m_s = 0.2;
    ticks(&r, 500);
    r.input.command.linear_m_s = 0.3;
    CHECK(ticks(&r, 500)->reasons == 0 && r.out.joint[2].duty == duty && r.shown.faults == 0);
}

static void each_wheel_whose_duty_is_clamped_is_named(void)
{
    for (uint32_t wheels = 1; wheels < 16; wheels++) {
        core_config config = good_config();
        for (uint32_t j = 0; j < 4; j++) {
            config.joint[j].pwm.duty_max = wheels >> j & 1U ? 0.1 : 1.0;
        }
        rig r;
        start(&r, &config);
        go(&r, 0.3, 0.0);
        CHECK(r.shown.reasons == REASON_DUTY_CLAMPED && r.shown.reason.duty_clamped == wheels);
        CHECK(r.shown.reason.duty_slew == 0);
    }
}

/* Going forward the duty of one wheel is clamped, going backward that of another. Only the present
 * one is named. */
static void a_wheel_is_named_only_while_its_own_duty_is_clamped(void)
{
    core_config config = good_config();
    config.joint[0].pwm.duty_max = 0.1;
    config.joint[1].pwm.duty_min = -0.1;
    rig r;
    start(&r, &config);
    go(&r, 0.3, 0.0);
    CHECK(r.shown.reasons == REASON_DUTY_CLAMPED && r.shown.reason.duty_clamped == 1U << 0);
    go(&r, -0.3, 0.0);
    CHECK(r.shown.reasons == REASON_DUTY_CLAMPED && r.shown.reason.duty_clamped == 1U << 1);
}

static void set_points_carry_their_time_and_their_number_of_joints(void)
{
    core_config config = good_config();
    rig r;
    start(&r, &config);
    for (int i = 1; i <= 3; i++) {
        memset(&r.out, 0xff, sizeof r.out), memset(&r.shown, 0xff, sizeof r.shown);
        prepare(&r);
        for (int j = 0; j < 4; j++) {
            r.input.feedback[j].velocity_rad_s = 0.0, r.input.feedback[j].count = 0;
        }
        step(&r);
        CHECK(r.out.stamp_ns == r.input.now_ns && r.out.joint_count == 4 &&
              r.out.tick == (uint64_t)i);
        CHECK(memcmp(&r.shown, &r.state.snapshot, sizeof r.shown) == 0);
        CHECK(r.shown.stamp_ns == r.input.now_ns && r.shown.joint_count == 4 &&
              r.shown.tick == (uint64_t)i);
        CHECK(r.out.enabled == 0 && zero(&r) && r.out.joint[7].torque_n_m == 0.0);
        CHECK(r.out.positioned == 0 && r.out.reserved == 0);
        for (int j = 0; j < JOINTS_MAX; j++) {
            CHECK(r.out.position_rad[j] == 0.0);
        }
    }
}

/* Neither old bytes in the core's memory nor invalid limits matter. */
static void a_core_begins_with_its_own_limits_in_uninitialised_memory(void)
{
    core_config config = good_config();
    rig r, dirty;
    ready(&r, &config);
    ready(&dirty, &config);
    memset(&dirty.state, 0x5a, sizeof dirty.state);
    CHECK(core_init(&dirty.state, &config) == 0);
    dirty.input.control.limits.linear.velocity_u_s = NAN;
    go(&dirty, 5.0, 0.0);
    CHECK(fabs(dirty.shown.setpoint_linear_m_s - 0.9) < 1e-9 && dirty.shown.tick == 1502);
    CHECK(dirty.shown.reasons == (REASON_LINEAR_VELOCITY | REASON_WHEEL_SATURATED) &&
          dirty.shown.joint[5].stale == 0);
}

/* The last entry of each table is used, and nothing beyond it. */
static void a_base_of_as_many_wheels_as_there_can_be(void)
{
    core_config config = good_config();
    config.joint_count = JOINTS_MAX;
    for (int j = 4; j < JOINTS_MAX; j++) {
        config.joint[j] = config.joint[j - 4];
    }
    config.joint[JOINTS_MAX - 1].speed_loop = torque_loop(1.0, 4.0, 8.0);
    config.joint[JOINTS_MAX - 1].plausible = finds_a_stall();
    rig r;
    start(&r, &config);
    go(&r, 0.4, 0.2);
    for (int ms = 0; ms < 2000 && r.shown.faults == 0; ms++) {
        r.position_rad[JOINTS_MAX - 1] -= r.out.joint[JOINTS_MAX - 1].velocity_rad_s * 1e-3;
        tick(&r);
    }
    CHECK(r.shown.faults == FAULT_STALL && r.shown.doubt.joint == JOINTS_MAX - 1);
    CHECK(r.out.joint[JOINTS_MAX - 1].torque_n_m == 0.0 &&
          r.out.joint[JOINTS_MAX - 1].velocity_rad_s > 1.0);
    r.input.control.estop = 1;
    CHECK(tick(&r)->faults == (FAULT_STALL | FAULT_ESTOP) && zero(&r));
    r.input.feedback[JOINTS_MAX - 1].stamp_ns = 0;
    r.stale = true;
    CHECK(tick(&r)->joint[JOINTS_MAX - 1].stale == 1);
}

/* A speed loop of any wheel gives its torque, also with a small gain. Without a loop there is no
 * torque. */
static void each_wheel_with_a_speed_loop_gets_its_torque(void)
{
    for (int own = -1; own < 4; own++) {
        core_config config = good_config();
        if (own >= 0) {
            config.joint[own].speed_loop = torque_loop(0.01, 0.04, 0.05);
        }
        rig r;
        start(&r, &config);
        go(&r, 0.3, 0.0);
        for (int j = 0; j < 4; j++) {
            prepare(&r);
            r.input.feedback[j].velocity_rad_s = 0.0;
            step(&r);
            CHECK(j == own ? r.out.joint[j].torque_n_m > 0.0 && r.out.joint[j].torque_n_m <= 0.05
                           : r.out.joint[j].torque_n_m == 0.0);
        }
    }
}

static void a_wheel_runs_away_beyond_its_larger_limit_of_either_direction(void)
{
    for (int back = 0; back < 2; back++) {
        for (int sign = -1; sign <= 1; sign += 2) {
            core_config config = good_config();
            config.on_fault = STOP_HOLD;
            for (int j = 0; j < 4; j++) {
                config.joint[j].counter_bits = 0;
                config.joint[j].velocity_min_rad_s = back ? -8.0 : -4.0;
                config.joint[j].velocity_max_rad_s = back ? 4.0 : 8.0;
                config.joint[j].speed_loop = torque_loop(1.0, 4.0, 8.0);
            }
            rig r;
            start(&r, &config);
            go(&r, 0.2, 0.0);
            prepare(&r);
            r.input.feedback[3].velocity_rad_s = sign * 12.0;
            CHECK(step(&r)->faults == 0);
            prepare(&r);
            r.input.feedback[3].velocity_rad_s = sign * 12.01;
            CHECK(step(&r)->faults == FAULT_OVERSPEED);
        }
    }
}

/* In a curve each side has its own speed, and the slowest joint limits the base. */
static void a_twist_gives_each_wheel_its_speed_and_any_wheel_may_be_at_its_limit(void)
{
    core_config config = good_config();
    double wheel_rad_s[JOINTS_MAX] = {[4] = 7.0};
    kinematics_wheels(&config, (const double[AXES]){0.4, 0.2, 0.0}, wheel_rad_s);
    for (int j = 0; j < 4; j++) {
        CHECK(fabs(wheel_rad_s[j] - (j % 2 == 0 ? 3.5 : 4.5)) < 1e-12);
    }
    CHECK(wheel_rad_s[4] == 7.0);
    for (int slow = 0; slow < 4; slow++) {
        config = good_config();
        config.joint[slow].velocity_max_rad_s = 0.5 * wheel_rad_s[slow];
        CHECK(fabs(saturate_factor(wheel_rad_s, config.joint, 4) - 0.5) < 1e-12);
    }
}

int main(void)
{
    a_twist_gives_each_wheel_its_speed_and_any_wheel_may_be_at_its_limit();
    a_base_that_turned_on_the_spot_stands_still_afterwards();
    a_ramp_that_has_arrived_leaves_no_acceleration();
    a_late_tick_of_a_stop_is_a_step_of_the_ramp();
    the_slew_of_any_single_duty_slows_the_base();
    in_a_reversal_the_wheel_that_has_to_be_eased_is_named();
    a_duty_behind_its_goal_grows_by_its_slew_and_is_named();
    the_wheel_set_points_of_a_twist_are_computed_once();
    each_wheel_whose_duty_is_clamped_is_named();
    a_wheel_is_named_only_while_its_own_duty_is_clamped();
    set_points_carry_their_time_and_their_number_of_joints();
    a_core_begins_with_its_own_limits_in_uninitialised_memory();
    a_base_of_as_many_wheels_as_there_can_be();
    each_wheel_with_a_speed_loop_gets_its_torque();
    a_wheel_runs_away_beyond_its_larger_limit_of_either_direction();
    return checks_report("test_core_wheels");
}
