/* SPDX-License-Identifier: Apache-2.0
 * The small pure functions of angle.c, pwm.c and speed_loop.c with their exact numbers. */
#include <math.h>
#include <string.h>

#include "check.h"
#include "core.h"
#include "torque_loop.h"

/* ------------------------------------------------------------------------------- angles */
static const double PI = 3.14159265358979323846;

static void an_angle_is_wrapped_into_half_a_turn_to_both_sides(void)
{
    CHECK(angle_wrap(PI) == PI && angle_wrap(-PI) == -PI && angle_wrap(3.0) == 3.0);
    CHECK(fabs(angle_wrap(4.0) - (4.0 - 2.0 * PI)) < 1e-15 &&
          fabs(angle_wrap(-4.0) + 4.0 - 2.0 * PI) < 1e-15);
    CHECK(fabs(angle_wrap(nextafter(PI, 4.0)) + PI) < 1e-15);
}

static void sine_and_cosine_are_right_to_the_last_bits_and_zero_is_exact(void)
{
    direction found = angle_direction(0.0);
    CHECK(found.sine == 0.0 && found.cosine == 1.0);
    for (int i = -31415; i <= 31415; i++) {
        double angle_rad = i * 1e-4;
        found = angle_direction(angle_rad);
        CHECK(fabsl((long double)found.sine - sinl((long double)angle_rad)) < 1.7e-16L);
        CHECK(fabsl((long double)found.cosine - cosl((long double)angle_rad)) < 1.7e-16L);
    }
    found = angle_direction(PI); /* the part of pi that a double cannot hold */
    CHECK(fabs(found.sine / 1.2246467991473532e-16 - 1.0) < 1e-9 && found.cosine == -1.0);
}

/* A replay needs the same bits on every machine: they never change. */
static void sine_and_cosine_have_the_same_bits_everywhere(void)
{
    uint64_t digest = UINT64_C(14695981039346656037);
    for (int i = -31415; i <= 31415; i++) {
        uint64_t bits[2];
        direction both = angle_direction(i * 1e-4);
        memcpy(bits, &both, sizeof bits);
        digest = ((digest ^ bits[0]) * UINT64_C(1099511628211) ^ bits[1]) * UINT64_C(1099511628211);
    }
    CHECK(digest == UINT64_C(9666664522745705617));
}

static void the_angle_of_a_vector_is_right_to_the_last_bits_whatever_its_length(void)
{
    const double length[] = {1.0, 1e-9, 7e6};
    for (int n = 0; n < 3; n++) {
        for (int i = -31416; i <= 31416; i++) {
            double y = length[n] * sin(i * 1e-4), x = length[n] * cos(i * 1e-4);
            long double off_rad =
                fabsl((long double)angle_of(y, x) - atan2l((long double)y, (long double)x));
            CHECK(off_rad < 4.6e-16L && fabs(angle_of(y, x)) <= PI);
        }
    }
}

static void on_the_axes_the_angle_is_exact_and_nearly_so_on_the_diagonals(void)
{
    for (int i = 0; i < 2; i++) {
        double sign = i == 0 ? 1.0 : -1.0;
        CHECK(angle_of(0.0, 2.0) == 0.0 && angle_of(sign * 2.0, 0.0) == sign * 0.5 * PI);
        CHECK(fabs(angle_of(sign * 2.0, 2.0) - sign * 0.25 * PI) < 2e-16);
        CHECK(fabs(angle_of(sign * 2.0, -2.0) - sign * 0.75 * PI) < 5e-16);
        CHECK(fabs(angle_of(sign * 0.0, -2.0)) == PI);
    }
    CHECK(angle_of(0.0, 0.0) == 0.0 && angle_of(-0.0, 0.0) == 0.0 && angle_of(0.0, -0.0) == 0.0);
}

/* ---------------------------------------------------------------------------------- PWM */
static void a_speed_or_time_that_is_not_finite_gives_no_duty(void)
{
    const pwm_config config = {.dead_band = 0.1,
                               .duty_min = -1.0,
                               .duty_max = 1.0,
                               .slew_per_s = 1.0,
                               .full_duty_rad_s = 10.0};
    const double bad_dt_s[] = {0.0, -1.0, (double)NAN},
                 bad_rad_s[] = {(double)NAN, (double)INFINITY, -(double)INFINITY};
    for (int i = 0; i < 3; i++) {
        pwm_output no_time = pwm_step(&config, 0.0, 5.0, bad_dt_s[i]),
                   no_speed = pwm_step(&config, 0.0, bad_rad_s[i], 0.05);
        CHECK(no_time.duty == 0.0 && no_time.reasons == 0 && no_speed.duty == 0.0 &&
              no_speed.reasons == 0);
    }
    CHECK(fabs(pwm_step(&config, 0.0, 5.0, 0.05).duty - 0.15) < 1e-15);
}

/* --------------------------------------------------------------------------- speed loop */

static void the_torque_is_the_error_s_share_and_its_integral(void)
{
    const speed_loop_config loop = torque_loop(0.5, 4.0, 3.0);
    speed_loop_state state = {.begun = 1};
    CHECK(fabs(loop_step(&state, &loop, 3.0, 1.0, 0.1) - (1.0 + 0.8)) < 1e-12 &&
          fabs(state.integral_u - 0.8) < 1e-12);
    CHECK(fabs(loop_step(&state, &loop, 1.0, 2.0, 0.1) - (-0.5 + 0.4)) < 1e-12 &&
          fabs(state.integral_u - 0.4) < 1e-12);
    CHECK(!signbit(loop_step(&(speed_loop_state){.begun = 1}, &loop, 0.0, 0.0, 0.1)));
    CHECK(!signbit(
        loop_step(&(speed_loop_state){.begun = 1, .integral_u = -0.0}, &loop, -0.0, 0.0, 0.1)));
}

static void the_integral_is_held_where_it_would_drive_the_torque_beyond_its_limit(void)
{
    const speed_loop_config loop = torque_loop(0.5, 4.0, 3.0);
    speed_loop_state state = {.begun = 1, .integral_u = 1.0};
    CHECK(loop_step(&state, &loop, 10.0, 0.0, 0.01) == 3.0 && state.integral_u == 1.0);
    CHECK(loop_step(&state, &loop, -20.0, 0.0, 0.01) == -3.0 && state.integral_u == 1.0);
    state.integral_u = 3.0; /* the integral returns to the limit at once, because the error is
                               relative to the unlimited output */
    const speed_loop_config weak = torque_loop(0.0, 4.0, 2.0);
    CHECK(loop_step(&state, &weak, -1.0, 0.0, 0.1) == 2.0 && state.integral_u == 2.0);
    state.integral_u = -3.0; /* the same from the other side */
    CHECK(loop_step(&state, &weak, 1.0, 0.0, 0.1) == -2.0 && state.integral_u == -2.0);
    const speed_loop_config eager = torque_loop(0.02, 0.01, 0.001);
    state.integral_u = 0.0005; /* small products do not become zero: the integral is held, too */
    CHECK(loop_step(&state, &eager, 0.1, 0.0, 0.01) == 0.001 && state.integral_u == 0.0005);
}

static void input_that_is_not_finite_clears_the_integral(void)
{
    const speed_loop_config loop = torque_loop(0.5, 4.0, 3.0);
    const double bad[] = {(double)NAN, (double)INFINITY, -(double)INFINITY};
    for (int i = 0; i < 3; i++) {
        speed_loop_state state = {.begun = 1, .integral_u = 1.0};
        CHECK(loop_step(&state, &loop, bad[i], 1.0, 0.1) == 0.0 && state.integral_u == 0.0);
        state.integral_u = bad[i];
        CHECK(loop_step(&state, &loop, 1.0, 1.0, 0.1) == 0.0 && state.integral_u == 0.0);
    }
    speed_loop_state state = {.begun = 1, .integral_u = 1.0};
    CHECK(loop_step(&state, &loop, 1.0, 0.0, 0.0) == 0.0 && state.integral_u == 0.0);
}

/* -------------------------------------------------------------------------------- drift */
static const core_config FOUR_WHEELS = {
    .joint_count = 4,
    .twist_variance_floor_m2_s2 = 1e-5,
    .twist_variance_floor_rad2_s2 = 2e-5,
    .joint = {{.row = {1.0, 0.0, -0.25}, .wheel_radius_m = 0.1},
              {.row = {1.0, 0.0, 0.25}, .wheel_radius_m = 0.1},
              {.row = {1.0, 0.0, -0.25}, .wheel_radius_m = 0.1},
              {.row = {1.0, 0.0, 0.25}, .wheel_radius_m = 0.2}}};

/* The motion of the wheels is unknown: it may be up to their set-points, in both directions. */
static void a_blind_base_is_as_uncertain_as_its_set_points_may_have_carried_it(void)
{
    static odometry_state state;
    odometry_init(&state, &FOUR_WHEELS);
    state.pose_covariance[0] = 0.01;
    state.pose_covariance[3] = 0.04;
    state.pose_covariance[5] = 0.09;
    state.linear_m_s = -0.3;
    state.angular_rad_s = 0.5;
    state.twist_covariance[0] = state.twist_covariance[2] = 0.0;
    const joint_setpoint wheels[JOINTS_MAX] = {{.velocity_rad_s = 2.0},
                                               {.velocity_rad_s = -1.0},
                                               {.velocity_rad_s = -1.0},
                                               {.velocity_rad_s = 2.0}};
    /* the fastest wheel moves 0.04 m: 0.04 m straight on, or a turn of 0.16 rad */
    odometry_drift(&state, &FOUR_WHEELS, wheels, 0.1);
    CHECK(fabs(state.pose_covariance[0] - (0.01 + 0.04 * (0.2 + 0.04))) < 1e-15);
    CHECK(fabs(state.pose_covariance[3] - (0.04 + 0.04 * (0.4 + 0.04))) < 1e-15);
    CHECK(fabs(state.pose_covariance[5] - (0.09 + 0.16 * (0.6 + 0.16))) < 1e-15);
    CHECK(fabs(state.twist_covariance[0] - (1e-5 + 0.09)) < 1e-15 &&
          fabs(state.twist_covariance[2] - (2e-5 + 0.25)) < 1e-15);
    state.twist_covariance[0] = state.twist_covariance[2] = 7.0; /* more uncertain than the new
                                                                    value */
    odometry_drift(&state, &FOUR_WHEELS, (const joint_setpoint[JOINTS_MAX]){{0}}, 0.1);
    CHECK(state.twist_covariance[0] == 7.0 && state.twist_covariance[2] == 7.0);
    CHECK(fabs(state.pose_covariance[5] - (0.09 + 0.16 * (0.6 + 0.16))) < 1e-15);
}

int main(void)
{
    an_angle_is_wrapped_into_half_a_turn_to_both_sides();
    sine_and_cosine_are_right_to_the_last_bits_and_zero_is_exact();
    sine_and_cosine_have_the_same_bits_everywhere();
    the_angle_of_a_vector_is_right_to_the_last_bits_whatever_its_length();
    on_the_axes_the_angle_is_exact_and_nearly_so_on_the_diagonals();
    a_speed_or_time_that_is_not_finite_gives_no_duty();
    the_torque_is_the_error_s_share_and_its_integral();
    the_integral_is_held_where_it_would_drive_the_torque_beyond_its_limit();
    input_that_is_not_finite_clears_the_integral();
    a_blind_base_is_as_uncertain_as_its_set_points_may_have_carried_it();
    return checks_report("numbers");
}
