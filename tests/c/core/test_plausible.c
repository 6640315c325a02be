/* SPDX-License-Identifier: Apache-2.0
 * test_plausible: each check of the feedback alone, at its bounds. */
#include <math.h>

#include "check.h"
#include "core.h"

static const int64_t STEP_NS = 10000000;
static const double STEP_S = 0.01;

static const plausible_config CHECKS = {
    .setpoint_min_rad_s = 1.5,
    .slow_rad_s = 0.3,
    .short_rad_s = 6.0,
    .beyond_rad_s = 6.0,
    .apart_rad_s = 1.5,
    .progress_rad_s = 0.15,
    .direction_s = 0.5,
    .stall_s = 1.0,
    .following_s = 1.0,
    .runaway_s = 0.5,
    .apart_s = 1.0,
    .jumps_max = 3,
};

typedef struct {
    plausible_config config;
    plausible_state state;
    joint_odometry joint;
    feedback_doubt why;
} wheel;

/* Checks a wheel like the core does. */
static bool taken(wheel *w, double reported_rad_s, double setpoint_rad_s)
{
    return !plausible_due(&w->state, &w->joint) ||
           plausible(&w->state, &w->config, &w->joint, reported_rad_s, setpoint_rad_s, &w->why);
}

static wheel begun(double speed_rad_s)
{
    wheel w = {.config = CHECKS, .joint = {.stamp_ns = STEP_NS, .velocity_rad_s = speed_rad_s}};
    CHECK(taken(&w, NAN, 0.0));
    return w;
}

/* Returns the seconds until a fault; INFINITY: no fault within `seconds`. */
static double until_fault(wheel *w, double seconds, double turns_rad_s, double reported_rad_s,
                          double setpoint_rad_s)
{
    for (int step = 1; step <= (int)(seconds / STEP_S + 0.5); step++) {
        w->joint.stamp_ns += STEP_NS;
        w->joint.position_rad += turns_rad_s * STEP_S;
        w->joint.velocity_rad_s = turns_rad_s;
        if (!taken(w, reported_rad_s, setpoint_rad_s)) {
            return step * STEP_S;
        }
    }
    return INFINITY;
}

static bool near(double value, double expected)
{
    return fabs(value - expected) < 0.015;
}

static void each_check_has_its_fault_and_its_time(void)
{
    for (int sign = -1; sign <= 1; sign += 2) {
        double s = sign;
        wheel w = begun(-5.0 * s);
        CHECK(near(until_fault(&w, 3.0, -5.0 * s, -5.0 * s, 5.0 * s), 0.51) &&
              w.why.fault == FAULT_DIRECTION);
        CHECK(w.why.setpoint_rad_s == 5.0 * s && near(w.why.measured_rad_s, -5.0 * s) &&
              w.why.reported_rad_s == -5.0 * s);
        CHECK(w.why.since_ns == 2 * STEP_NS && w.why.joint == 0 && w.state.doubted == 1);
        w = begun(0.0);
        CHECK(near(until_fault(&w, 3.0, 0.0, NAN, 5.0 * s), 1.01) && w.why.fault == FAULT_STALL &&
              isnan(w.why.reported_rad_s));
        w = begun(5.0 * s);
        CHECK(near(until_fault(&w, 3.0, 5.0 * s, 5.0 * s, 12.0 * s), 1.01) &&
              w.why.fault == FAULT_FOLLOWING_ERROR);
        w = begun(12.0 * s);
        CHECK(near(until_fault(&w, 3.0, 12.0 * s, 12.0 * s, 5.0 * s), 0.51) &&
              w.why.fault == FAULT_RUNAWAY);
        w = begun(12.0 * s);
        CHECK(near(until_fault(&w, 3.0, 12.0 * s, 12.0 * s, 0.0), 0.51) &&
              w.why.fault == FAULT_RUNAWAY);
        w = begun(5.0 * s);
        double found_s = until_fault(&w, 3.0, 5.0 * s, 0.0, 5.0 * s);
        CHECK(found_s > 1.0 && found_s < 1.5 && w.why.fault == FAULT_IMPLAUSIBLE_FEEDBACK &&
              near(w.why.measured_rad_s, 5.0 * s));
    }
}

static void a_deviation_within_its_tolerance_is_no_fault(void)
{
    wheel w = begun(0.0);
    CHECK(isinf(until_fault(&w, 3.0, 0.0, 0.0, 1.49)));
    w = begun(0.31);
    CHECK(isinf(until_fault(&w, 3.0, 0.31, 0.31, 1.5)));
    w = begun(-0.29);
    CHECK(near(until_fault(&w, 3.0, -0.29, -0.29, 1.5), 1.01) && w.why.fault == FAULT_STALL);
    w = begun(-0.31);
    CHECK(near(until_fault(&w, 3.0, -0.31, -0.31, 1.5), 0.51) && w.why.fault == FAULT_DIRECTION);
    w = begun(6.01);
    CHECK(isinf(until_fault(&w, 3.0, 6.01, 6.01, 12.0)));
    w = begun(10.99);
    CHECK(isinf(until_fault(&w, 3.0, 10.99, 10.99, 5.0)));
    w = begun(5.0);
    CHECK(isinf(until_fault(&w, 3.0, 5.0, 12.9, 5.0))); /* a difference of 7.9; allowed are 1.5 and
                                                           half of 12.9 */
    w = begun(5.0);
    CHECK(until_fault(&w, 3.0, 5.0, 13.1, 5.0) < 3.0);
}

static void a_time_of_zero_switches_a_check_off(void)
{
    wheel w = begun(-5.0);
    w.config.direction_s = w.config.stall_s = w.config.following_s = w.config.runaway_s =
        w.config.apart_s = 0.0;
    w.config.jumps_max = 0;
    CHECK(isinf(until_fault(&w, 3.0, -5.0, 50.0, 5.0)));
    CHECK(isinf(until_fault(&w, 3.0, 0.0, 0.0, 15.0)));
    CHECK(isinf(until_fault(&w, 3.0, 25.0, 25.0, 1.0)));
    w.joint.jumps = 100;
    CHECK(isinf(until_fault(&w, 0.1, 25.0, 25.0, 25.0)));
}

/* Cases: both directions. With a set-point of zero, a speed that is too high is a runaway or no
 * fault. */
static void no_wheel_is_too_slow_for_a_set_point_of_zero(void)
{
    for (int sign = -1; sign <= 1; sign += 2) {
        wheel w = begun(7.0 * sign);
        w.config.runaway_s = 0.0;
        CHECK(isinf(until_fault(&w, 3.0, 7.0 * sign, 7.0 * sign, 0.0)));
        CHECK(isinf(until_fault(&w, 3.0, 7.0 * sign, 7.0 * sign, -0.0)));
    }
}

static void a_check_may_be_short(void)
{
    wheel w = begun(12.0);
    w.config.runaway_s = 0.05;
    CHECK(near(until_fault(&w, 3.0, 12.0, 12.0, 0.0), 0.06) && w.why.fault == FAULT_RUNAWAY);
}

static void
a_wheel_that_approaches_its_set_point_is_slow_and_one_that_stops_approaching_is_a_fault(void)
{
    wheel w = begun(0.0);
    double speed_rad_s = 0.0;
    for (; speed_rad_s < 8.0; speed_rad_s += 0.01) {
        CHECK(isinf(until_fault(&w, STEP_S, speed_rad_s, speed_rad_s, 15.0)));
    }
    double found_s = until_fault(&w, 3.0, speed_rad_s, speed_rad_s, 15.0);
    CHECK(found_s > 1.0 && found_s < 2.0 && w.why.fault == FAULT_FOLLOWING_ERROR);
    w = begun(15.0);
    for (speed_rad_s = 15.0; speed_rad_s > 0.0; speed_rad_s -= 0.01) {
        CHECK(isinf(until_fault(&w, STEP_S, speed_rad_s, speed_rad_s, 0.0)));
    }
    /* the nearest speed of the last approach does not count for this one */
    for (; speed_rad_s < 5.0; speed_rad_s += 0.01) {
        CHECK(isinf(until_fault(&w, STEP_S, speed_rad_s, speed_rad_s, 15.0)));
    }
}

static void a_check_that_passes_again_restarts_its_time(void)
{
    wheel w = begun(0.0);
    for (int times = 0; times < 5; times++) {
        CHECK(isinf(until_fault(&w, 0.9, 0.0, 0.0, 5.0)));
        CHECK(isinf(until_fault(&w, 0.2, 0.0, 0.0, 0.0)));
    }
}

static void jumps_count_within_a_second(void)
{
    wheel w = begun(5.0);
    for (int times = 0; times < 6; times++) {
        w.joint.jumps++;
        CHECK(isinf(until_fault(&w, 0.6, 5.0, 5.0, 5.0)));
    }
    w = begun(5.0);
    w.joint.jumps = 2;
    CHECK(isinf(until_fault(&w, 0.5, 5.0, 5.0, 5.0)));
    w.joint.jumps++;
    CHECK(near(until_fault(&w, 0.5, 5.0, 5.0, 5.0), STEP_S) &&
          w.why.fault == FAULT_IMPLAUSIBLE_FEEDBACK);
}

static void an_impossible_reported_velocity_is_a_fault_whatever_its_mean(void)
{
    wheel w = begun(5.0);
    double found_s = INFINITY;
    for (int step = 0; step < 300 && isinf(found_s); step++) {
        if (!isinf(until_fault(&w, STEP_S, 5.0, step % 2 == 0 ? 343.0 : -343.0, 5.0))) {
            found_s = step * STEP_S;
        }
    }
    CHECK(found_s < 1.5 && w.why.fault == FAULT_IMPLAUSIBLE_FEEDBACK &&
          fabs(w.why.reported_rad_s) == 343.0);
}

static void a_repeated_sample_and_a_late_velocity_are_ignored(void)
{
    wheel w = begun(NAN);
    plausible_state before = w.state;
    CHECK(taken(&w, 1e9, 1e9));
    CHECK(before.stamp_ns == w.state.stamp_ns && before.measured_rad_s == 0.0 &&
          w.state.measured_rad_s == 0.0);
    CHECK(isinf(until_fault(&w, 2.0, 5.0, NAN, 5.0)));
    CHECK(isinf(until_fault(&w, 2.0, 5.0, 5.0, 5.0)));
    CHECK(near(w.state.reported_rad_s, 5.0));
}

/* A wheel whose smoothed measures have exactly these values, also after the next sample. */
static wheel steady(double measured_rad_s, double reported_rad_s)
{
    wheel w = begun(0.0);
    w.config.slow_rad_s = 0.25, w.config.progress_rad_s = 0.125;
    w.state.measured_rad_s = measured_rad_s;
    w.state.reported_rad_s = reported_rad_s;
    w.joint.stamp_ns += STEP_NS;
    w.joint.position_rad += measured_rad_s * ((double)STEP_NS * 1e-9);
    return w;
}

enum { DIRECTION = 1, STALL = 2, FOLLOWING = 4, RUNAWAY = 8, IMPLAUSIBLE = 16 };

static void each_tolerance_ends_at_its_bound(void)
{
    static const struct {
        double measured_rad_s, reported_rad_s, rough_rad_s, setpoint_rad_s;
        uint32_t suspicious;
    } CASES[] = {
        {-0.25, -0.25, 0, 1.5, DIRECTION},
        {-0.2499, -0.2499, 0, 1.5, STALL},
        {0.25, 0.25, 0, 1.5, 0},
        {0.2499, 0.2499, 0, 1.5, STALL},
        {-0.25, -0.25, 0, 1.4999, 0},
        {0.0, 0.0, 0, 1.4999, 0},
        {0.25, 0.25, 0, -1.5, DIRECTION},
        {-0.2499, -0.2499, 0, -1.5, STALL},
        {6.0, 6.0, 0, 12.0, 0},
        {6.0, 6.0, 0, 12.001, FOLLOWING},
        {-6.0, -6.0, 0, -12.001, FOLLOWING},
        {12.0, 12.0, 0, 6.0, 0},
        {12.001, 12.001, 0, 6.0, RUNAWAY},
        {-12.001, -12.001, 0, -6.0, RUNAWAY},
        {12.001, 12.001, 0, -6.0, DIRECTION | FOLLOWING | RUNAWAY},
        {4.0, 0.5, 0, 4.0, 0},
        {4.0, 0.49, 0, 4.0, IMPLAUSIBLE},
        {1.0, 5.0, 0, 1.0, 0},
        {1.0, 5.01, 0, 1.0, IMPLAUSIBLE},
        {-4.0, -0.49, 0, -4.0, IMPLAUSIBLE},
        {2.0, -0.51, 0, 2.0, IMPLAUSIBLE},
        {2.0, -0.49, 0, 2.0, 0},
        {-7.0, -7.0, 0, 0.05, FOLLOWING | RUNAWAY},
        {7.0, 7.0, 0, -0.05, FOLLOWING | RUNAWAY},
        {0.0, 0.0, 6.29, 0.0, 0},
        {0.0, 0.0, 6.31, 0.0, IMPLAUSIBLE}, /* the next sample reduces it by one twenty-first */
        {4.0, 4.0, 8.39, 4.0, 0},
        {4.0, 4.0, 8.41, 4.0, IMPLAUSIBLE},
    };
    for (size_t i = 0; i < sizeof CASES / sizeof CASES[0]; i++) {
        wheel w = steady(CASES[i].measured_rad_s, CASES[i].reported_rad_s);
        w.state.rough_rad_s = CASES[i].rough_rad_s;
        CHECK(plausible(&w.state, &w.config, &w.joint, CASES[i].reported_rad_s,
                        CASES[i].setpoint_rad_s, &w.why));
        CHECK(w.state.suspicious == CASES[i].suspicious && w.state.doubted == 0);
    }
    wheel first = steady(0.0, 0.0), second = first;
    first.state.rough_rad_s = second.state.rough_rad_s = 6.3;
    CHECK(plausible(&first.state, &first.config, &first.joint, 0.0, 0.0, &first.why));
    second.config.beyond_rad_s = first.state.rough_rad_s; /* exactly the largest that is allowed */
    CHECK(plausible(&second.state, &second.config, &second.joint, 0.0, 0.0, &second.why) &&
          second.state.suspicious == 0);
}

static void approaching_the_set_point_restarts_the_time_of_a_check(void)
{
    static const struct {
        double measured_rad_s, nearest_rad_s, setpoint_rad_s;
        uint32_t faster, suspicious, anew;
    } CASES[] = {
        {-1.0, -2.0, 2.0, 1, DIRECTION, 1},    {-2.0, -2.0, 2.0, 1, DIRECTION, 0},
        {0.125, -0.125, 2.0, 1, STALL, 1},     {4.125, 4.0, 12.0, 1, FOLLOWING, 0},
        {4.126, 4.0, 12.0, 1, FOLLOWING, 1},   {3.0, 4.0, 12.0, 1, FOLLOWING, 0},
        {4.0, 4.0, 12.0, 0, FOLLOWING, 1},     {4.0, 4.0, 12.0, 1, IMPLAUSIBLE, 1},
        {4.0, 4.0, 12.0, 1, STALL, 0},         {12.875, 13.0, 6.0, 0, RUNAWAY, 0},
        {12.874, 13.0, 6.0, 0, RUNAWAY, 1},    {14.0, 13.0, 6.0, 0, RUNAWAY, 0},
        {-12.874, -13.0, -6.0, 1, RUNAWAY, 1}, {-4.126, -4.0, -12.0, 0, FOLLOWING, 1},
    };
    for (size_t i = 0; i < sizeof CASES / sizeof CASES[0]; i++) {
        wheel w = steady(CASES[i].measured_rad_s, CASES[i].measured_rad_s);
        w.state.nearest_rad_s = CASES[i].nearest_rad_s;
        w.state.faster = CASES[i].faster;
        w.state.suspicious = CASES[i].suspicious;
        for (int check = 0; check < 5; check++) {
            w.state.since_ns[check] = 1;
        }
        CHECK(plausible(&w.state, &w.config, &w.joint, NAN, CASES[i].setpoint_rad_s, &w.why));
        int check = CASES[i].suspicious == DIRECTION       ? 0
                    : fabs(CASES[i].measured_rad_s) < 0.25 ? 1
                    : fabs(CASES[i].setpoint_rad_s) > 10.0 ? 2
                                                           : 3;
        bool was = (CASES[i].suspicious >> check & 1) != 0;
        CHECK(w.state.since_ns[check] == (CASES[i].anew || !was ? w.joint.stamp_ns : 1));
        CHECK(w.state.nearest_rad_s ==
              (CASES[i].anew ? CASES[i].measured_rad_s : CASES[i].nearest_rad_s));
        CHECK(w.state.faster == (CASES[i].setpoint_rad_s > CASES[i].measured_rad_s));
    }
}

static void a_check_is_due_at_its_time_and_the_first_of_several_is_named(void)
{
    for (int late = 0; late < 2; late++) {
        wheel w = steady(0.0, 0.0);
        w.state.suspicious = STALL, w.state.faster = 1;
        w.state.since_ns[1] = w.joint.stamp_ns - 1000000000 + 1 - late;
        CHECK(plausible(&w.state, &w.config, &w.joint, NAN, 5.0, &w.why) == !late);
        CHECK(!late ||
              (w.why.fault == FAULT_STALL && w.why.since_ns == w.joint.stamp_ns - 1000000000));
    }
    wheel w = steady(-7.0, -7.0);
    w.state.suspicious = DIRECTION | FOLLOWING | RUNAWAY, w.state.faster = 1,
    w.state.nearest_rad_s = -7.0;
    w.joint.stamp_ns += 4 * STEP_NS, w.joint.position_rad = 5 * -7.0 * STEP_S;
    w.state.since_ns[0] = w.state.since_ns[2] = w.state.since_ns[3] = w.joint.stamp_ns - 2000000000;
    CHECK(!plausible(&w.state, &w.config, &w.joint, -7.0, 0.5, &w.why));
    /* the set-point is too small for a fault of direction */
    CHECK(w.why.fault == FAULT_FOLLOWING_ERROR && w.why.measured_rad_s < -6.9);
}

static void
speeds_are_smoothed_over_a_fifth_of_a_second_and_samples_that_come_faster_are_taken_together(void)
{
    wheel w = begun(2.0);
    w.joint.stamp_ns += 4999999;
    w.joint.position_rad = 1.0;
    CHECK(!plausible_due(&w.state, &w.joint));
    w.joint.stamp_ns += 1;
    CHECK(plausible_due(&w.state, &w.joint));
    CHECK(plausible(&w.state, &w.config, &w.joint, 3.0, 2.0, &w.why) &&
          w.state.stamp_ns == w.joint.stamp_ns);
    CHECK(fabs(w.state.measured_rad_s - (2.0 + (1.0 - 2.0 * 0.005) / 0.205)) < 1e-12 &&
          w.state.position_rad == 1.0);
    double reported_rad_s = 2.0 + 1.0 * 0.005 / 0.205;
    CHECK(fabs(w.state.reported_rad_s - reported_rad_s) < 1e-12);
    CHECK(fabs(w.state.rough_rad_s - (3.0 - reported_rad_s) * 0.005 / 0.205) < 1e-12);
    w = begun(0.0);
    CHECK(isinf(until_fault(&w, 0.2, 5.0, NAN, 5.0)));
    CHECK(w.state.measured_rad_s > 2.9 && w.state.measured_rad_s < 3.4 &&
          w.state.reported_rad_s == w.state.measured_rad_s);
}

static void jumps_of_a_second_ago_still_count_and_older_ones_do_not(void)
{
    for (int late = 0; late < 2; late++) {
        wheel w = steady(5.0, 5.0);
        w.state.jumped_ns = w.joint.stamp_ns - 1000000000 - late;
        w.state.jumps = 7, w.state.jumps_before = 5, w.joint.jumps = 8;
        CHECK(plausible(&w.state, &w.config, &w.joint, 5.0, 5.0, &w.why) == late &&
              w.state.jumps == 8);
        CHECK(w.state.jumps_before == (late ? 7U : 5U));
        CHECK(w.state.jumped_ns == (late ? w.joint.stamp_ns : w.joint.stamp_ns - 1000000000));
        CHECK(late ||
              (w.why.fault == FAULT_IMPLAUSIBLE_FEEDBACK && w.why.since_ns == w.state.jumped_ns));
    }
}

int main(void)
{
    each_check_has_its_fault_and_its_time();
    a_deviation_within_its_tolerance_is_no_fault();
    a_time_of_zero_switches_a_check_off();
    no_wheel_is_too_slow_for_a_set_point_of_zero();
    a_check_may_be_short();
    a_wheel_that_approaches_its_set_point_is_slow_and_one_that_stops_approaching_is_a_fault();
    a_check_that_passes_again_restarts_its_time();
    jumps_count_within_a_second();
    an_impossible_reported_velocity_is_a_fault_whatever_its_mean();
    a_repeated_sample_and_a_late_velocity_are_ignored();
    each_tolerance_ends_at_its_bound();
    approaching_the_set_point_restarts_the_time_of_a_check();
    a_check_is_due_at_its_time_and_the_first_of_several_is_named();
    speeds_are_smoothed_over_a_fifth_of_a_second_and_samples_that_come_faster_are_taken_together();
    jumps_of_a_second_ago_still_count_and_older_ones_do_not();
    return checks_report("test_plausible");
}
