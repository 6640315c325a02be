/* SPDX-License-Identifier: Apache-2.0
 * test_limit: single steps of the ramp, and whole ramps compared with the physically shortest
 * time. */
#include <float.h>
#include <math.h>

#include "check.h"
#include "core.h"

static const double DT_S = 0.01;
static const base_limits PLAIN = {
    {2.0, 1.0, 1.5, INFINITY}, {4.0, 3.0, 4.0, INFINITY}, {1.5, 0.8, 1.2, INFINITY}};
static const base_limits SOFT = {{2.0, 1.0, 1.5, 8.0}, {4.0, 3.0, 4.0, 30.0}, {1.5, 0.8, 1.2, 6.0}};

static bool near(double value, double expected)
{
    return fabs(value - expected) < 1e-12;
}

/* Steps of 0.01 s, which begin at a constant linear, angular and lateral velocity. */
static const struct {
    bool soft, urgent;
    double from[AXES], goal[AXES], expected[AXES];
    uint32_t reason;
} STEPS[] = {
    {false, false, {0.0, 0.0}, {1.0, 0.0}, {0.01, 0.0}, REASON_LINEAR_ACCELERATION},
    {false, false, {0.0, 0.0}, {-1.0, 0.0}, {-0.01, 0.0}, REASON_LINEAR_ACCELERATION},
    {false, false, {0.5, 0.0}, {1.0, 0.0}, {0.51, 0.0}, REASON_LINEAR_ACCELERATION},
    {false, false, {1.0, 0.0}, {0.5, 0.0}, {0.985, 0.0}, REASON_LINEAR_DECELERATION},
    {false, false, {-1.0, 0.0}, {0.0, 0.0}, {-0.985, 0.0}, REASON_LINEAR_DECELERATION},
    {false, false, {3.0, 0.0}, {2.0, 0.0}, {2.985, 0.0}, REASON_LINEAR_DECELERATION},
    {false, false, {0.995, 0.0}, {1.0, 0.0}, {1.0, 0.0}, 0},
    {false, false, {0.01, 0.0}, {0.0, 0.0}, {0.0, 0.0}, 0},
    {false, false, {0.0, 0.0}, {0.01, 0.0}, {0.01, 0.0}, 0},
    {false, false, {1.0, 1.0}, {1.0, 1.0}, {1.0, 1.0}, 0},
    {false, false, {0.0, 0.0}, {0.1, 0.0}, {0.01, 0.0}, REASON_LINEAR_ACCELERATION},
    /* through zero: after it no more than the acceleration, before it no more than the
     * deceleration */
    {false, false, {0.02, 0.0}, {-1.0, 0.0}, {0.005, 0.0}, REASON_LINEAR_DECELERATION},
    {false, false, {0.012, 0.0}, {-1.0, 0.0}, {0.0, 0.0}, REASON_LINEAR_ACCELERATION},
    {false, false, {0.005, 0.0}, {-1.0, 0.0}, {-0.005, 0.0}, REASON_LINEAR_ACCELERATION},
    {false, false, {0.0, -0.035}, {0.0, 1.0}, {0.0, 0.0}, REASON_ANGULAR_ACCELERATION},
    {false, false, {0.0, -0.02}, {0.0, 1.0}, {0.0, 0.01}, REASON_ANGULAR_ACCELERATION},
    /* the axis with the least room slows both */
    {false, false, {0.0, 0.0}, {1.0, 1.0}, {0.01, 0.01}, REASON_LINEAR_ACCELERATION},
    {false, false, {0.0, 0.0}, {0.1, 1.0}, {0.003, 0.03}, REASON_ANGULAR_ACCELERATION},
    {false, false, {0.0, 2.0}, {0.1, 0.0}, {0.002, 1.96}, REASON_ANGULAR_DECELERATION},
    {true, false, {0.0, 0.0}, {1.0, 0.0}, {0.0008, 0.0}, REASON_LINEAR_JERK},
    {true, false, {0.0, 0.0}, {-1.0, 0.0}, {-0.0008, 0.0}, REASON_LINEAR_JERK},
    {true, false, {0.0, 0.0}, {0.0, -2.0}, {0.0, -0.003}, REASON_ANGULAR_JERK},
    {true, true, {0.0, 0.0}, {1.0, 0.0}, {0.01, 0.0}, REASON_LINEAR_ACCELERATION},
    {true, true, {1.0, 0.0}, {0.0, 0.0}, {0.985, 0.0}, REASON_LINEAR_DECELERATION},
    {true, true, {0.01, 0.0}, {0.0, 0.0}, {0.0, 0.0}, 0},
    /* lateral */
    {false, false, {0.0}, {0.0, 0.0, 1.0}, {0.0, 0.0, 0.008}, REASON_LATERAL_ACCELERATION},
    {false, false, {0.0, 0.0, 1.0}, {0.0}, {0.0, 0.0, 0.988}, REASON_LATERAL_DECELERATION},
    {true, false, {0.0}, {0.0, 0.0, -1.0}, {0.0, 0.0, -0.0006}, REASON_LATERAL_JERK},
};

static void one_step_keeps_each_limit_and_names_it(void)
{
    for (size_t i = 0; i < sizeof STEPS / sizeof STEPS[0]; i++) {
        limit_state axis[AXES] = {
            {STEPS[i].from[0], 0.0}, {STEPS[i].from[1], 0.0}, {STEPS[i].from[2], 0.0}};
        uint32_t reason = ramp_step(axis, AXES, STEPS[i].soft ? &SOFT : &PLAIN, NULL, STEPS[i].goal,
                                    DT_S, STEPS[i].urgent);
        for (int a = 0; a < AXES; a++) {
            CHECK(near(axis[a].velocity_u_s, STEPS[i].expected[a]));
            CHECK(fabs(axis[a].acceleration_u_s2 -
                       (STEPS[i].expected[a] - STEPS[i].from[a]) / DT_S) < 1e-9);
        }
        CHECK(reason == STEPS[i].reason);
    }
}

static void an_acceleration_is_kept_in_its_direction_and_dropped_against_it(void)
{
    static const struct {
        double acceleration, goal, expected;
    } CASES[] = {{0.5, 2.0, 1.0 + 0.0058}, {-0.5, 2.0, 1.0 + 0.0008}, {-0.5, 0.0, 1.0 - 0.0058},
                 {0.5, 0.0, 1.0 - 0.0008}, {0.95, 2.0, 1.0 + 0.01},   {-1.45, 0.0, 1.0 - 0.015}};
    for (int i = 0; i < 6; i++) {
        limit_state axis[AXES] = {{1.0, CASES[i].acceleration}};
        ramp_step(axis, AXES, &SOFT, NULL, (const double[AXES]){CASES[i].goal, 0.0}, DT_S, false);
        CHECK(near(axis[0].velocity_u_s, CASES[i].expected));
    }
}

/* The shortest time in which a speed can change by `change`. */
static double shortest_s(double change, double acceleration, double jerk)
{
    return change >= acceleration * acceleration / jerk
               ? change / acceleration + acceleration / jerk
               : 2.0 * sqrt(change / jerk);
}

static uint64_t noise = 88172645463325252U;

static double any(double least, double most)
{
    noise ^= noise << 13, noise ^= noise >> 7, noise ^= noise << 17;
    return least + (most - least) * (double)(noise % 100001) * 1e-5;
}

static void a_ramp_takes_the_shortest_time_and_is_soft_at_both_ends(void)
{
    for (int round = 0; round < 400; round++) {
        int a = round % AXES;
        base_limits limits = SOFT;
        axis_limits *of = a == AXIS_LINEAR    ? &limits.linear
                          : a == AXIS_ANGULAR ? &limits.angular
                                              : &limits.lateral;
        *of = (axis_limits){5.0, any(0.5, 4.0), any(0.5, 4.0), any(2.0, 50.0)};
        bool falls = round % 3 == 0, back = round % 5 == 0;
        double sign = back ? -1.0 : 1.0, from = falls ? any(0.5, 3.0) : 0.0,
               goal[AXES] = {0.0, 0.0};
        goal[a] = falls ? 0.0 : sign * any(0.2, 3.0);
        limit_state axis[AXES] = {0};
        axis[a].velocity_u_s = sign * from;
        double apart = round % 2 == 0 ? any(0.0, 0.5) : 0.0; /* so that neither end is zero */
        goal[a] += sign * apart, axis[a].velocity_u_s += sign * apart;
        double bound = falls ? of->deceleration_u_s2 : of->acceleration_u_s2, last = 0.0,
               most = 0.0;
        int steps = 0;
        for (; axis[a].velocity_u_s != goal[a] && steps < 5000; steps++) {
            double before = axis[a].velocity_u_s;
            ramp_step(axis, AXES, &limits, NULL, goal, DT_S, false);
            double now = (axis[a].velocity_u_s - before) / DT_S * (falls ? -sign : sign);
            CHECK(now > 0.0 && now <= bound + 1e-9 &&
                  fabs(now - last) <= of->jerk_u_s3 * DT_S + 1e-9);
            last = now;
            most = fmax(most, now);
        }
        CHECK(last <= of->jerk_u_s3 * DT_S + 1e-9);
        double expected_s = shortest_s(fabs(goal[a] - sign * (from + apart)), bound, of->jerk_u_s3);
        CHECK(steps * DT_S >= expected_s - 1.5 * DT_S && steps * DT_S <= expected_s + 0.5 * DT_S);
    }
}

/* The shortest time from `from` to zero, with an acceleration of at most `gains` at zero, and on to
 * `to`. */
static double shortest_through_zero_s(double from, double to, double gains, double loses,
                                      double jerk)
{
    double most = fmin(loses, sqrt(jerk * from + 0.5 * gains * gains));
    double eased = (most * most + most * most - gains * gains) / (2.0 * jerk);
    double before_s = most / jerk + (most - gains) / jerk + fmax(0.0, from - eased) / most;
    return before_s + (to - gains * gains / (2.0 * jerk)) / gains + gains / jerk;
}

/* If the acceleration limit is below that of the deceleration, the ramp eases before it passes
 * zero. */
static void a_change_of_sign_is_eased_and_loses_no_time(void)
{
    for (int round = 0; round < 200; round++) {
        base_limits limits = SOFT;
        double gains = any(0.5, 2.0), loses = gains + any(0.1, 2.0), jerk = any(4.0, 50.0);
        limits.linear = (axis_limits){5.0, gains, loses, jerk};
        double from = any(gains * gains / jerk, 3.0), goal[AXES] = {-any(1.0, 3.0), 0.0};
        limit_state axis[AXES] = {{from, 0.0}};
        double last = 0.0;
        int steps = 0;
        for (; axis[0].velocity_u_s != goal[0] && steps < 5000; steps++) {
            double before = axis[0].velocity_u_s;
            ramp_step(axis, AXES, &limits, NULL, goal, DT_S, false);
            double now = (before - axis[0].velocity_u_s) / DT_S;
            CHECK(now <= (before > 0.0 ? loses : gains) + 1e-9);
            if (axis[0].velocity_u_s < -1e-9 && before > 0.0) { /* a step through zero keeps both
                                                                   limits */
                CHECK(now <= gains + 1e-9);
            }
            CHECK(fabs(now - last) <= jerk * DT_S + 1e-9);
            last = now;
        }
        double expected_s = shortest_through_zero_s(from, -goal[0], gains, loses, jerk);
        CHECK(steps * DT_S >= expected_s - 1.5 * DT_S && steps * DT_S <= expected_s + 0.5 * DT_S);
    }
}

static core_config with_slew(double slew_per_s)
{
    core_config base = {.joint_count = 2};
    for (int j = 0; j < 2; j++) {
        base.joint[j] = (joint_config){.row = {1.0, 0.0, (2.0 * j - 1.0) * 0.25},
                                       .wheel_radius_m = 0.1,
                                       .pwm = {0.2, -1.0, 1.0, slew_per_s, 16.0}};
    }
    return base;
}

static void a_duty_slew_bounds_the_acceleration_of_a_wheel(void)
{
    /* 0.1 of duty per second, at 16 rad/s for 0.8 of duty: 2 rad/s2 at the wheel, which is 0.2
     * m/s2, or 0.8 rad/s2 in a turn */
    core_config base = with_slew(0.1);
    static const struct {
        double from[AXES], goal[AXES], expected[AXES];
        uint32_t reason;
    } CASES[] = {
        {{0.0, 0.0}, {1.0, 0.0}, {0.002, 0.0}, REASON_DUTY_SLEW},
        {{0.0, 0.0}, {-1.0, 0.0}, {-0.002, 0.0}, REASON_DUTY_SLEW},
        {{0.0, 0.0}, {0.0, 1.0}, {0.0, 0.008}, REASON_DUTY_SLEW},
        {{1.0, 0.0}, {0.0, 0.0}, {0.985, 0.0}, REASON_LINEAR_DECELERATION},
        {{0.5, 0.0}, {0.5, 1.0}, {0.5, 0.008}, REASON_DUTY_SLEW},
        {{0.5, 0.0}, {0.5, -1.0}, {0.5, -0.008}, REASON_DUTY_SLEW},
        {{0.5, 0.0}, {0.4, 0.4}, {0.485, 0.06}, 0},
        {{0.01, 0.0}, {-1.0, 0.0}, {0.0, 0.0}, REASON_DUTY_SLEW},
        {{0.001, 0.0}, {-1.0, 0.0}, {-0.001, 0.0}, REASON_DUTY_SLEW},
        {{0.5, 0.0}, {0.5, 0.0}, {0.5, 0.0}, 0},
    };
    for (size_t i = 0; i < sizeof CASES / sizeof CASES[0]; i++) {
        limit_state axis[AXES] = {{CASES[i].from[0], 0.0}, {CASES[i].from[1], 0.0}};
        uint32_t reason = ramp_step(axis, AXES, &PLAIN, &base, CASES[i].goal, DT_S, false);
        if (i == 6) { /* the left wheel slows down, the right one keeps its speed: only the
                         deceleration counts */
            CHECK(reason == REASON_LINEAR_DECELERATION || reason == REASON_ANGULAR_ACCELERATION);
            continue;
        }
        CHECK(near(axis[0].velocity_u_s, CASES[i].expected[0]) &&
              near(axis[1].velocity_u_s, CASES[i].expected[1]));
        CHECK(reason == CASES[i].reason);
    }
}

static void a_goal_within_a_step_is_reached_exactly(void)
{
    for (int round = 0; round < 1000; round++) {
        double goal[AXES] = {any(-1.0, 1.0), any(-1.0, 1.0)};
        limit_state axis[AXES] = {{goal[0] + any(-0.009, 0.009), 0.0},
                                  {goal[1] + any(-0.02, 0.02), 0.0}};
        CHECK(ramp_step(axis, AXES, &PLAIN, NULL, goal, DT_S, false) == 0);
        CHECK(axis[0].velocity_u_s == goal[0] && axis[1].velocity_u_s == goal[1]);
        /* a distance that is divided and multiplied by dt_s is rounded */
        double dt_s = any(0.001, 0.05);
        axis[0] = axis[1] = (limit_state){0};
        goal[0] = any(-0.9, 0.9) * dt_s, goal[1] = any(-0.9, 0.9) * dt_s;
        CHECK(ramp_step(axis, AXES, &PLAIN, NULL, goal, dt_s, false) == 0);
        CHECK(axis[0].velocity_u_s == goal[0] && axis[1].velocity_u_s == goal[1]);
    }
}

static void the_largest_finite_numbers_stay_finite(void)
{
    limit_state axis[AXES] = {{DBL_MAX, 0.0}};
    CHECK(ramp_step(axis, AXES, &PLAIN, NULL, (const double[AXES]){0.0, 0.0}, DT_S, false) ==
          REASON_LINEAR_DECELERATION);
    CHECK(axis[0].velocity_u_s == DBL_MAX && near(axis[0].acceleration_u_s2, -1.5));
    axis[0] = (limit_state){0};
    CHECK(ramp_step(axis, AXES, &PLAIN, NULL, (const double[AXES]){DBL_MAX, 0.0}, DT_S, false) ==
          REASON_LINEAR_ACCELERATION);
    CHECK(near(axis[0].velocity_u_s, 0.01));
    axis[0] = (limit_state){0};
    CHECK(ramp_step(axis, AXES, &PLAIN, NULL, (const double[AXES]){1.0, 0.0}, DBL_MAX, true) == 0 &&
          axis[0].velocity_u_s == 1.0);
    axis[0] = (limit_state){-DBL_MAX, 0.0}; /* the distance overflows */
    CHECK(ramp_step(axis, AXES, &PLAIN, NULL, (const double[AXES]){DBL_MAX, 0.0}, DT_S, false) ==
          0);
    CHECK(axis[0].velocity_u_s == 0.0 && axis[0].acceleration_u_s2 == 0.0);
    const axis_limits endless = {1e300, INFINITY, INFINITY, INFINITY},
                      plain = {1.0, 1.0, 1.0, INFINITY};
    for (int a = 0; a < AXES; a++) { /* the acceleration overflows */
        base_limits limits = {a == 0 ? endless : plain, a == 1 ? endless : plain,
                              a == 2 ? endless : plain};
        limit_state still[AXES] = {{0.0, 0.0}};
        double goal[AXES] = {0.0};
        goal[a] = 1e10;
        CHECK(ramp_step(still, AXES, &limits, NULL, goal, 1e-300, false) == 0);
        CHECK(still[a].velocity_u_s == 0.0 && still[a].acceleration_u_s2 == 0.0);
    }
}

static void a_state_that_is_not_finite_rests_and_such_a_goal_is_zero(void)
{
    static const double BAD[] = {NAN, INFINITY, -INFINITY};
    for (int i = 0; i < 3; i++) {
        for (int a = 0; a < AXES; a++) {
            limit_state axis[AXES] = {{1.0, 0.5}, {1.0, 0.5}};
            double goal[AXES] = {1.0, 1.0};
            axis[a].velocity_u_s = BAD[i];
            CHECK(ramp_step(axis, AXES, &PLAIN, NULL, goal, DT_S, false) == 0 &&
                  axis[0].velocity_u_s == 0.0);
            CHECK(axis[1].velocity_u_s == 0.0 && axis[0].acceleration_u_s2 == 0.0 &&
                  axis[1].acceleration_u_s2 == 0.0);
            axis[0] = axis[1] = (limit_state){1.0, 0.5};
            axis[a].acceleration_u_s2 = BAD[i];
            CHECK(ramp_step(axis, AXES, &PLAIN, NULL, goal, DT_S, false) == 0 &&
                  axis[0].velocity_u_s + axis[1].velocity_u_s == 0.0);
            axis[0] = axis[1] = (limit_state){1.0, 0.5};
            CHECK(ramp_step(axis, AXES, &PLAIN, NULL, goal, BAD[i], false) == 0 &&
                  axis[0].velocity_u_s + axis[1].velocity_u_s == 0.0);
            axis[0] = axis[1] = (limit_state){1.0, 0.0};
            goal[a] = BAD[i];
            CHECK(ramp_step(axis, AXES, &PLAIN, NULL, goal, DT_S, false) ==
                  REASON_LINEAR_DECELERATION);
            CHECK(near(axis[0].velocity_u_s, 0.985) && near(axis[1].velocity_u_s, 0.985));
            axis[0] = axis[1] = (limit_state){0};
            CHECK(ramp_step(axis, AXES, &PLAIN, NULL, goal, DT_S, false) == 0);
            CHECK(axis[0].velocity_u_s == 0.0 && axis[1].velocity_u_s == 0.0);
        }
    }
    limit_state axis[AXES] = {{1.0, 0.5}, {1.0, 0.5}};
    CHECK(ramp_step(axis, AXES, &PLAIN, NULL, (const double[AXES]){0.5, 0.5}, 0.0, false) == 0 &&
          axis[0].velocity_u_s == 0.0);
    axis[0] = axis[1] = (limit_state){1.0, 0.5};
    CHECK(ramp_step(axis, AXES, &PLAIN, NULL, (const double[AXES]){0.5, 0.5}, 0.0, true) == 0 &&
          axis[0].velocity_u_s == 0.0);
    axis[0] = axis[1] = (limit_state){0};
    core_config base = with_slew(INFINITY); /* infinite, so no limit */
    CHECK(ramp_step(axis, AXES, &PLAIN, &base, (const double[AXES]){1.0, 0.0}, DT_S, false) ==
          REASON_LINEAR_ACCELERATION);
    CHECK(near(axis[0].velocity_u_s, 0.01));
    axis[0] = axis[1] = (limit_state){0.001, 0.0};
    ramp_step(axis, AXES, &PLAIN, NULL, (const double[AXES]){-0.0, -0.0}, DT_S, false);
    CHECK(axis[0].velocity_u_s == 0.0 && !signbit(axis[0].velocity_u_s) &&
          !signbit(axis[1].velocity_u_s));
}

int main(void)
{
    one_step_keeps_each_limit_and_names_it();
    an_acceleration_is_kept_in_its_direction_and_dropped_against_it();
    a_ramp_takes_the_shortest_time_and_is_soft_at_both_ends();
    a_change_of_sign_is_eased_and_loses_no_time();
    a_duty_slew_bounds_the_acceleration_of_a_wheel();
    a_goal_within_a_step_is_reached_exactly();
    the_largest_finite_numbers_stay_finite();
    a_state_that_is_not_finite_rests_and_such_a_goal_is_zero();
    return checks_report("test_limit");
}
