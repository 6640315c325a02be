/* SPDX-License-Identifier: Apache-2.0
 * The small pure functions by their exact numbers: angle.c, pwm.c, speed_loop.c, check.c. */
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
    found = angle_direction(PI); /* the rest of pi that a double does not hold */
    CHECK(fabs(found.sine / 1.2246467991473532e-16 - 1.0) < 1e-9 && found.cosine == -1.0);
}

/* A replay needs the same bits on every machine, so they are never others. */
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
static void no_speed_that_is_a_number_or_no_time_is_no_duty(void)
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
    state.integral_u = 3.0; /* back from the limit it comes at once: the error is against what was
                               wanted */
    const speed_loop_config weak = torque_loop(0.0, 4.0, 2.0);
    CHECK(loop_step(&state, &weak, -1.0, 0.0, 0.1) == 2.0 && state.integral_u == 2.0);
    state.integral_u = -3.0; /* so from the other side */
    CHECK(loop_step(&state, &weak, 1.0, 0.0, 0.1) == -2.0 && state.integral_u == -2.0);
    const speed_loop_config eager = torque_loop(0.02, 0.01, 0.001);
    state.integral_u = 0.0005; /* small products are products: away from rest it is held, too */
    CHECK(loop_step(&state, &eager, 0.1, 0.0, 0.01) == 0.001 && state.integral_u == 0.0005);
}

static void what_cannot_be_reckoned_empties_the_integral(void)
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

/* Where the wheels go meanwhile is not known: as far as their set-points say, either way. */
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
    /* the fastest 0.04 m: 0.04 m straight on, or 0.16 rad */
    odometry_drift(&state, &FOUR_WHEELS, wheels, 0.1);
    CHECK(fabs(state.pose_covariance[0] - (0.01 + 0.04 * (0.2 + 0.04))) < 1e-15);
    CHECK(fabs(state.pose_covariance[3] - (0.04 + 0.04 * (0.4 + 0.04))) < 1e-15);
    CHECK(fabs(state.pose_covariance[5] - (0.09 + 0.16 * (0.6 + 0.16))) < 1e-15);
    CHECK(fabs(state.twist_covariance[0] - (1e-5 + 0.09)) < 1e-15 &&
          fabs(state.twist_covariance[2] - (2e-5 + 0.25)) < 1e-15);
    state.twist_covariance[0] = state.twist_covariance[2] = 7.0; /* it was more uncertain before */
    odometry_drift(&state, &FOUR_WHEELS, (const joint_setpoint[JOINTS_MAX]){{0}}, 0.1);
    CHECK(state.twist_covariance[0] == 7.0 && state.twist_covariance[2] == 7.0);
    CHECK(fabs(state.pose_covariance[5] - (0.09 + 0.16 * (0.6 + 0.16))) < 1e-15);
}

/* -------------------------------------------------------------------------------- check */
static core_config config;
static char bad_name[FIELD_NAME_BYTES];

static void reset_config(void)
{
    axis_limits limits = {1.0, 1.0, 1.0, 8.0};
    config = (core_config){
        .joint_count = 2,
        .limits = {limits, limits, limits},
        .command_timeout_s = 0.3,
        .feedback_timeout_s = 0.25,
        .heartbeat_timeout_s = 0.5,
        .rest_velocity_rad_s = 0.05,
        .distance_variance_m2_per_m = 1e-4,
        .turn_variance_rad2_per_rad = 1e-3,
        .pose_variance_floor_m2 = 1e-6,
        .heading_variance_floor_rad2 = 1e-6,
        .twist_variance_floor_m2_s2 = 1e-5,
        .twist_variance_floor_rad2_s2 = 1e-5,
    };
    for (uint32_t j = 0; j < JOINTS_MAX; j++) {
        config.joint[j] = (joint_config){.row = {1.0, 0.0, j % 2 == 0 ? -0.25 : 0.25},
                                         .wheel_radius_m = 0.1,
                                         .velocity_min_rad_s = -9.0,
                                         .velocity_max_rad_s = 9.0,
                                         .rad_per_count = 1e-3,
                                         .counter_bits = 16,
                                         .pwm = {0.05, -1.0, 1.0, 100.0, 12.5}};
    }
}

static bool is_good(void)
{
    return core_config_check(&config, bad_name) == NULL;
}

static bool refused(const char *name)
{
    return core_config_check(&config, bad_name) == bad_name && strcmp(bad_name, name) == 0;
}

static void is_between(double *value, double low, double high, const char *name)
{
    const double middle = *value;
    *value = low;
    CHECK(is_good());
    *value = high;
    CHECK(is_good());
    *value = nextafter(low, -(double)INFINITY);
    CHECK(refused(name));
    if (isfinite(high)) {
        *value = nextafter(high, (double)INFINITY);
        CHECK(refused(name));
    }
    *value = (double)NAN;
    CHECK(refused(name));
    *value = middle;
}

static void a_joint_s_numbers_have_their_range(void)
{
    reset_config();
    joint_config *joint = &config.joint[1];
    is_between(&joint->wheel_radius_m, 1e-12, 1e9, "joint[1].wheel_radius_m");
    is_between(&joint->velocity_min_rad_s, -1e9, 0.0, "joint[1].velocity_min_rad_s");
    is_between(&joint->pwm.dead_band, 0.0, 1.0, "joint[1].pwm.dead_band");
    is_between(&joint->pwm.duty_min, -1.0, 0.0, "joint[1].pwm.duty_min");
    is_between(&joint->pwm.duty_max, 0.0, 1.0, "joint[1].pwm.duty_max");
    is_between(&joint->pwm.slew_per_s, 1e-12, (double)INFINITY, "joint[1].pwm.slew_per_s");
    is_between(&joint->speed_loop.correction_max_u, 0.0, 1e9,
               "joint[1].speed_loop.correction_max_u");
    is_between(&joint->rad_per_count, 1e-12, 1e9, "joint[1].rad_per_count");
    joint->rad_per_count = -1e-12;
    CHECK(is_good());
    joint->rad_per_count = -1e9;
    CHECK(is_good());
    is_between(&joint->row.x, -2.0, 2.0, "joint[1].row.x");
    is_between(&joint->row.lever_m, -1e9, 1e9, "joint[1].row.lever_m");
}

static void counters_are_as_wide_as_drives_have_them(void)
{
    const uint64_t widths =
        1ULL << 0 | 1ULL << 8 | 1ULL << 12 | 1ULL << 15 | 1ULL << 16 | 1ULL << 24 | 1ULL << 32;
    reset_config();
    for (uint32_t bits = 0; bits <= 66; bits++) {
        config.joint[0].counter_bits = bits;
        bool good = bits == 64 || (bits < 64 && (widths >> bits & 1) != 0);
        CHECK(good ? is_good() : refused("joint[0].counter_bits"));
    }
    config.joint[0].counter_bits = 0;
    config.joint[0].rad_per_count = 0.0; /* nothing is counted */
    CHECK(is_good());
}

static void a_base_has_two_to_eight_wheels_and_they_are_not_all_on_one_side(void)
{
    reset_config();
    for (uint32_t joints = 0; joints <= JOINTS_MAX + 1; joints++) {
        config.joint_count = joints;
        CHECK(joints >= 2 && joints <= JOINTS_MAX ? is_good() : refused("joint_count"));
    }
    for (int side = -1; side <= 1; side += 2) {
        reset_config();
        config.joint[0].row.lever_m = config.joint[1].row.lever_m = 0.25 * side;
        CHECK(refused("joint.row"));
    }
    reset_config();
    config.joint_count = 4; /* three on one side, one on the other */
    config.joint[0].row.lever_m = config.joint[1].row.lever_m = config.joint[2].row.lever_m = 0.25;
    config.joint[3].row.lever_m = -0.25;
    CHECK(is_good());
    config.joint[0].line = LINES_MAX;
    CHECK(refused("joint[0].line"));
    config.joint[0].line = LINES_MAX - 1;
    CHECK(is_good());
}

static void limits_are_named_with_and_without_their_base(void)
{
    reset_config();
    config.limits.angular.jerk_u_s3 = 0.0;
    memset(bad_name, 0, sizeof bad_name);
    CHECK(base_limits_check(&config.limits, bad_name) == bad_name &&
          strcmp(bad_name, "angular.jerk_u_s3") == 0);
    CHECK(refused("limits.angular.jerk_u_s3"));
}

int main(void)
{
    an_angle_is_wrapped_into_half_a_turn_to_both_sides();
    sine_and_cosine_are_right_to_the_last_bits_and_zero_is_exact();
    sine_and_cosine_have_the_same_bits_everywhere();
    the_angle_of_a_vector_is_right_to_the_last_bits_whatever_its_length();
    on_the_axes_the_angle_is_exact_and_nearly_so_on_the_diagonals();
    no_speed_that_is_a_number_or_no_time_is_no_duty();
    the_torque_is_the_error_s_share_and_its_integral();
    the_integral_is_held_where_it_would_drive_the_torque_beyond_its_limit();
    what_cannot_be_reckoned_empties_the_integral();
    a_blind_base_is_as_uncertain_as_its_set_points_may_have_carried_it();
    a_joint_s_numbers_have_their_range();
    counters_are_as_wide_as_drives_have_them();
    a_base_has_two_to_eight_wheels_and_they_are_not_all_on_one_side();
    limits_are_named_with_and_without_their_base();
    return checks_report("numbers");
}
