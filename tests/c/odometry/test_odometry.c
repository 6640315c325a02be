/* SPDX-License-Identifier: Apache-2.0
 * test_odometry: counters that are narrow, late or wrong, and the pose compared with a second
 * implementation. */
#include "odometry_base.h"

static void the_velocity_decides_about_an_unseen_turn_of_a_counter(void)
{
    for (int sign = -1; sign <= 1; sign += 2) {
        base b = begun(15);
        received(&b, STEP_NS, 0, 34.0 * sign);
        CHECK(near(received(&b, 11 * STEP_NS, 19792 * sign, 34.0 * sign)->position_rad,
                   19792 * sign * COUNT_RAD));
        CHECK(b.state.degraded == 0);
        received(&b, 30 * STEP_NS, 100, 34.0 * sign); /* longer than the timeout */
        CHECK(b.state.degraded == 1 &&
              near(b.state.joint[0].position_rad, 19792 * sign * COUNT_RAD + 34.0 * 0.25 * sign));
        received(&b, 11 * STEP_NS, 10000, NAN);
        CHECK(b.state.degraded == 1 && isnan(b.state.joint[0].velocity_rad_s));
        received(&b, STEP_NS, 0, 0.0);
        received(&b, 11 * STEP_NS, 10000, 34.0 * sign); /* the velocity has changed too much in
                                                           between */
        CHECK(b.state.degraded == 1);
    }
}

static void a_single_wrong_count_is_undone_and_a_lasting_jump_is_followed(void)
{
    base b = begun(32);
    received(&b, STEP_NS, 0, NAN);
    received(&b, STEP_NS, 1000, NAN);
    CHECK(received(&b, STEP_NS, 1000000, NAN)->jumps == 1 && b.state.degraded == 1);
    CHECK(near(received(&b, STEP_NS, -998000, NAN)->position_rad, 3000 * COUNT_RAD) &&
          b.state.degraded == 0);
    CHECK(received(&b, STEP_NS, 1000000, NAN)->jumps == 2);
    CHECK(received(&b, STEP_NS, -3000000, NAN)->jumps == 3);
    CHECK(near(received(&b, STEP_NS, 500, NAN)->position_rad, 3500 * COUNT_RAD) &&
          b.state.joint[0].jumps == 3);
    CHECK(near(b.state.joint[0].velocity_rad_s, 500 * COUNT_RAD / 0.01) && b.state.degraded == 0);
}

static void a_sample_that_is_no_newer_than_the_last_is_ignored(void)
{
    base b = begun(32);
    received(&b, STEP_NS, 0, NAN);
    int64_t stamp_ns = b.state.stamp_ns;
    static const int64_t AFTER_NS[] = {0, -1, 1 - STEP_NS, -STEP_NS, INT64_MIN + 1};
    for (size_t i = 0; i < sizeof AFTER_NS / sizeof AFTER_NS[0]; i++) {
        b.feedback[0].stamp_ns = b.feedback[1].stamp_ns = stamp_ns;
        CHECK(received(&b, AFTER_NS[i], 50, NAN)->position_rad == 0.0 &&
              b.state.stamp_ns == stamp_ns && b.state.x_m == 0.0);
    }
}

/* A counter catches up what it can reach in the feedback timeout, and no more. */
static void the_catching_up_of_a_counter_at_rest_is_bounded(void)
{
    for (int far = 0; far < 2; far++) {
        base b = begun(32);
        for (int i = 0; i < 300; i++) {
            received(&b, STEP_NS, 0, NAN);
        }
        int64_t most = (int64_t)(1.5 * 35.0 * (0.25 + 0.01) / COUNT_RAD) + 4;
        CHECK(received(&b, STEP_NS, most + far, NAN)->jumps == (uint32_t)far);
    }
}

static void a_counter_that_comes_late_catches_up(void)
{
    base b = begun(32);
    received(&b, STEP_NS, 0, NAN);
    for (int i = 0; i < 9; i++) {
        received(&b, STEP_NS, 0, NAN);
    }
    CHECK(near(received(&b, STEP_NS, 18000, NAN)->position_rad, 18000 * COUNT_RAD) &&
          b.state.joint[0].jumps == 0);
    CHECK(b.state.joint[0].velocity_rad_s <= 1.5 * 35.0);
    CHECK(received(&b, STEP_NS, 18000, NAN)->jumps == 1);
}

static void an_impossible_velocity_is_no_travel(void)
{
    base b = begun(0);
    received(&b, STEP_NS, 0, 5.0);
    CHECK(near(received(&b, STEP_NS, 0, 5.0)->position_rad, 0.05));
    CHECK(received(&b, STEP_NS, 0, 343.0)->jumps == 1 && near(b.state.joint[0].position_rad, 0.05));
    received(&b, STEP_NS, 0, NAN);
    CHECK(isnan(b.state.joint[0].velocity_rad_s) && b.state.joint[0].jumps == 1);
}

/* --- the pose, compared with a second implementation with long double and whole matrices */

typedef struct {
    double x_m, y_m, heading_rad, distance_m, turned_rad, p[3][3];
} expected_pose;

static void expect_arc(expected_pose *e, const core_config *config, double left_m, double right_m)
{
    double moved_m = 0.5 * (left_m + right_m), turn_rad = (right_m - left_m) / 0.5, b = 0.5;
    double middle_rad = e->heading_rad + 0.5 * turn_rad, s = sin(middle_rad), c = cos(middle_rad);
    long double h = e->heading_rad, radius_m = fabs(turn_rad) > 1e-9
                                                   ? (long double)moved_m / (long double)turn_rad
                                                   : 0.0L;
    e->x_m += fabs(turn_rad) > 1e-9
                  ? (double)(radius_m * (sinl(h + (long double)turn_rad) - sinl(h)))
                  : moved_m * c;
    e->y_m += fabs(turn_rad) > 1e-9
                  ? (double)(radius_m * (cosl(h) - cosl(h + (long double)turn_rad)))
                  : moved_m * s;
    double pose[3][3] = {{1, 0, -moved_m * s}, {0, 1, moved_m * c}, {0, 0, 1}};
    double wheels[3][2] = {{0.5 * c + moved_m * s / (2 * b), 0.5 * c - moved_m * s / (2 * b)},
                           {0.5 * s - moved_m * c / (2 * b), 0.5 * s + moved_m * c / (2 * b)},
                           {-1 / b, 1 / b}};
    double of_side[2] = {config->distance_variance_m2_per_m * fabs(left_m),
                         config->distance_variance_m2_per_m * fabs(right_m)};
    double next[3][3] = {0};
    for (int i = 0; i < 3; i++) {
        for (int j = 0; j < 3; j++) {
            for (int k = 0; k < 3; k++) {
                for (int l = 0; l < 3; l++) {
                    next[i][j] += pose[i][k] * e->p[k][l] * pose[j][l];
                }
            }
            for (int side = 0; side < 2; side++) {
                next[i][j] += wheels[i][side] * of_side[side] * wheels[j][side];
            }
        }
    }
    next[2][2] += config->turn_variance_rad2_per_rad * fabs(turn_rad);
    memcpy(e->p, next, sizeof next);
    e->heading_rad = remainder(e->heading_rad + turn_rad, 2.0 * 3.14159265358979323846);
    e->distance_m += fabs(moved_m);
    e->turned_rad += fabs(turn_rad);
}

static bool close_to(double value, double expected)
{
    return fabs(value - expected) <= 1e-9 * (1e-6 + fabs(expected));
}

static void check_pose(const odometry_state *state, const expected_pose *e)
{
    CHECK(fabs(state->x_m - e->x_m) < 1e-9 && fabs(state->y_m - e->y_m) < 1e-9);
    CHECK(fabs(remainder(state->heading_rad - e->heading_rad, 2.0 * 3.14159265358979323846)) <
          1e-9);
    CHECK(near(state->distance_m, e->distance_m) && near(state->turned_rad, e->turned_rad));
    CHECK(close_to(state->pose_covariance[0], e->p[0][0]) &&
          close_to(state->pose_covariance[1], e->p[0][1]));
    CHECK(close_to(state->pose_covariance[2], e->p[0][2]) &&
          close_to(state->pose_covariance[3], e->p[1][1]));
    CHECK(close_to(state->pose_covariance[4], e->p[1][2]) &&
          close_to(state->pose_covariance[5], e->p[2][2]));
}

static uint64_t noise = 88172645463325252U;

static int64_t any(int64_t least, int64_t most)
{
    noise ^= noise << 13, noise ^= noise >> 7, noise ^= noise << 17;
    return least + (int64_t)(noise % (uint64_t)(most - least + 1));
}

/* Four wheels of different sizes and counts. The wheels of a side move together, along an exact
 * arc. Each step is checked. */
static void pose_and_covariance_are_those_of_exact_arcs(void)
{
    core_config config = begun(32).config;
    config.joint_count = 4;
    config.pose_variance_floor_m2 = config.heading_variance_floor_rad2 = 1e-4;
    config.twist_variance_floor_m2_s2 = 1e-3, config.twist_variance_floor_rad2_s2 = 2e-3;
    config.joint[2] = config.joint[0], config.joint[3] = config.joint[1];
    config.joint[2].wheel_radius_m = config.joint[3].wheel_radius_m = 0.05;
    config.joint[3].rad_per_count = -COUNT_RAD;
    odometry_state state;
    odometry_init(&state, &config);
    CHECK(state.twist_covariance[0] == 1e-3 && state.twist_covariance[1] == 0.0 &&
          state.twist_covariance[2] == 2e-3);
    CHECK(state.pose_covariance[0] == 1e-4 && state.pose_covariance[3] == 1e-4 &&
          state.pose_covariance[5] == 1e-4);
    expected_pose e = {.p = {{1e-4, 0, 0}, {0, 1e-4, 0}, {0, 0, 1e-4}}};
    joint_feedback feedback[JOINTS_MAX] = {0};
    const uint32_t stale[JOINTS_MAX] = {0};
    const joint_setpoint wheels[JOINTS_MAX] = {{0}};
    double position_rad[4] = {0};
    for (int step = 0; step < 3000; step++) {
        int64_t after_ns = any(SPREAD_EVERY_NS / 1000000, 90) * 1000000,
                most = (int64_t)(17.0 / COUNT_RAD * (double)after_ns * 1e-9);
        double side_m[2] = {0.0, 0.0};
        int kind = step % 5; /* kinds: a curve, straight on, on the spot, small, at rest */
        int64_t common = any(-most, most), left = any(-most, most), small = any(-3, 3);
        for (int j = 0; j < 4; j++) {
            int64_t count = kind == 0   ? (j % 2 ? common : left)
                            : kind == 1 ? common
                            : kind == 2 ? (j % 2 ? common : -common)
                            : kind == 3 ? (j % 2 ? small : 1)
                                        : 0;
            double per_count = j == 3 ? -COUNT_RAD : COUNT_RAD;
            count = (j == 3 ? -count : count) * (j < 2 ? 1 : 2);        /* half the radius */
            feedback[j].count += step == 0 ? 1 << 30 : (uint64_t)count; /* no restart is near */
            feedback[j].stamp_ns += after_ns;
            feedback[j].velocity_rad_s = NAN;
            side_m[j % 2] += 0.5 * (double)count * per_count * config.joint[j].wheel_radius_m;
            position_rad[j] += step == 0 ? 0.0 : (double)count * per_count;
        }
        odometry_step(&state, &config, feedback, stale, wheels);
        if (step == 0) {
            continue;
        }
        expect_arc(&e, &config, side_m[0], side_m[1]);
        check_pose(&state, &e);
        double elapsed_s = (double)after_ns * 1e-9, moved_m = 0.5 * (side_m[0] + side_m[1]);
        double turn_rad = (side_m[1] - side_m[0]) / 0.5;
        CHECK(near(state.linear_m_s, moved_m / elapsed_s) &&
              near(state.angular_rad_s, turn_rad / elapsed_s));
        CHECK(step == 1 || state.twist_covariance[0] >= 1e-3);
        CHECK(step == 1 || state.twist_covariance[2] >= 2e-3);
        CHECK(state.degraded == 0 && state.blind == 0 && state.stamp_ns == feedback[0].stamp_ns);
        for (int j = 0; j < 4; j++) {
            CHECK(near(state.joint[j].position_rad, position_rad[j]) && state.joint[j].jumps == 0);
        }
    }
    odometry_reset(&state, &config);
    e = (expected_pose){.distance_m = e.distance_m,
                        .turned_rad = e.turned_rad,
                        .p = {{1e-4, 0, 0}, {0, 1e-4, 0}, {0, 0, 1e-4}}};
    check_pose(&state, &e);
    CHECK(state.epoch == 1 && near(state.joint[2].position_rad, position_rad[2]));
}

/* Travel of one side from before the reset is not part of the pose after it. */
static void a_reset_throws_away_what_is_pending(void)
{
    base b = begun(32);
    received(&b, STEP_NS, 0, NAN);
    comes(&b, 0, STEP_NS, 1000, NAN);
    take(&b);
    CHECK(b.state.joint[0].pending_rad > 0.0 && b.state.distance_m == 0.0);
    odometry_reset(&b.state, &b.config);
    received(&b, STEP_NS, 0, NAN);
    CHECK(b.state.distance_m == 0.0 && b.state.x_m == 0.0 && b.state.heading_rad == 0.0);
}

/* The deviations grow as if all wheels were as fast as the fastest one by its set-point. */
static void without_a_side_the_deviations_grow_by_the_distance(void)
{
    base b = begun(32);
    b.config.joint_count = 4;
    b.config.joint[2] = b.config.joint[0], b.config.joint[3] = b.config.joint[1],
    b.config.joint[4] = b.config.joint[0];
    b.state.pose_covariance[0] = 0.04, b.state.pose_covariance[3] = 0.09,
    b.state.pose_covariance[5] = 0.01;
    b.state.linear_m_s = -0.6, b.state.angular_rad_s = 0.4;
    b.config.twist_variance_floor_m2_s2 = 1e-3, b.config.twist_variance_floor_rad2_s2 = 2e-3;
    const joint_setpoint wheels[JOINTS_MAX] = {{.velocity_rad_s = -2.0},
                                               {.velocity_rad_s = 3.0},
                                               {.velocity_rad_s = 1.0},
                                               {.velocity_rad_s = 4.0},
                                               {.velocity_rad_s = 9.0}};
    odometry_drift(&b.state, &b.config, wheels, 0.5);
    double moved_m = 0.2, turn_rad = (0.2 + 0.2) / 0.5; /* all at 4 rad/s and 0.1 m for 0.5 s */
    CHECK(near(sqrt(b.state.pose_covariance[0]), 0.2 + moved_m) &&
          near(sqrt(b.state.pose_covariance[3]), 0.3 + moved_m));
    CHECK(near(sqrt(b.state.pose_covariance[5]), 0.1 + turn_rad));
    CHECK(near(b.state.twist_covariance[0], 1e-3 + 0.36) &&
          near(b.state.twist_covariance[2], 2e-3 + 0.16));
    b.state.twist_covariance[0] = b.state.twist_covariance[2] = 5.0;
    odometry_drift(&b.state, &b.config, (const joint_setpoint[JOINTS_MAX]){{0}}, 0.5);
    CHECK(b.state.twist_covariance[0] == 5.0 && b.state.twist_covariance[2] == 5.0);
    CHECK(near(sqrt(b.state.pose_covariance[0]), 0.2 + moved_m));
}

static void every_number_of_the_state_is_checked(void)
{
    odometry_state s = begun(32).state;
    double *const NUMBERS[] = {
        &s.x_m,
        &s.y_m,
        &s.heading_rad,
        &s.distance_m,
        &s.turned_rad,
        &s.linear_m_s,
        &s.angular_rad_s,
        &s.pose_covariance[0],
        &s.pose_covariance[1],
        &s.pose_covariance[2],
        &s.pose_covariance[3],
        &s.pose_covariance[4],
        &s.pose_covariance[5],
        &s.lateral_m_s,
        &s.lateral_covariance[0],
        &s.lateral_covariance[1],
        &s.lateral_covariance[2],
        &s.spread.slip_m_s,
        &s.twist_covariance[0],
        &s.twist_covariance[1],
        &s.twist_covariance[2],
        &s.gyro.yaw_rad,
        &s.gyro.bias_rad_s,
        &s.gyro.bias_variance_rad2_s2,
        &s.joint[0].position_rad,
        &s.joint[1].position_rad,
    };
    CHECK(odometry_finite(&s, 2));
    for (size_t i = 0; i < sizeof NUMBERS / sizeof NUMBERS[0]; i++) {
        double before = *NUMBERS[i];
        *NUMBERS[i] = NAN;
        CHECK(!odometry_finite(&s, 2));
        *NUMBERS[i] = -INFINITY;
        CHECK(!odometry_finite(&s, 2));
        *NUMBERS[i] = before;
    }
    s.joint[2].position_rad = NAN; /* beyond the joints of the base */
    CHECK(odometry_finite(&s, 2));
}

/* --- one sample: it may move 1.5 times 35 rad/s, and four counts */

static void the_possible_travels_of_a_counter_decide_which_is_accepted(void)
{
    static const struct {
        uint32_t bits;
        int64_t steps, counts; /* number of steps of 0.01 s, and counts in them */
        double before_rad_s, velocity_rad_s, travel_rad;
        uint32_t jumps, degraded;
    } CASES[] = {
        /* after a silence, a wide counter adds all that was missed */
        {32, 500, 30000, NAN, NAN, 30000 * COUNT_RAD, 0, 0},
        {32, 1, 2741, NAN, NAN, 2741 * COUNT_RAD, 0, 0}, /* 0.525 rad are 2737.9 counts, plus 4 */
        {32, 1, 2742, NAN, NAN, 0.0, 1, 1},
        {32, 1, -2741, NAN, NAN, -2741 * COUNT_RAD, 0, 0},
        {32, 1, -2742, NAN, NAN, 0.0, 1, 1},
        {32, 1, 9000, 20.0, 30.0, 0.25, 1, 1}, /* the mean of both velocities is used */
        {32, 1, 9000, NAN, 30.0, 0.30, 1, 1},
        {32, 1, 9000, 20.0, NAN, 0.0, 1, 1},
        {32, 1, 9000, 20.0, 85.1, 0.0, 1, 1}, /* 52.55 rad/s: no wheel is so fast */
        {32, 1, 9000, 20.0, 84.9, 0.5245, 1, 1},
        {32, 40, 200000, 20.0, 20.0, 20.0 * 0.25, 1, 1}, /* no longer than the feedback timeout */
        /* too long ago to find its turns from the velocity */
        {16, 40, 30000, 14.0, 14.5, 30000 * COUNT_RAD, 0, 1},
        {15, 11, 19792, 34.0, 34.0, 19792 * COUNT_RAD, 0, 0},
        {15, 11, 19792, 14.0, 54.0, 34.0 * 0.11, 0, 1}, /* the velocity has changed too much */
        /* one turn less would be faster than any wheel */
        {12, 1, 1300, NAN, NAN, 1300 * COUNT_RAD, 0, 0},
        {12, 1, -1300, NAN, NAN, -1300 * COUNT_RAD, 0, 0},
    };
    for (size_t i = 0; i < sizeof CASES / sizeof CASES[0]; i++) {
        base b = begun(CASES[i].bits);
        received(&b, STEP_NS, 0, CASES[i].before_rad_s);
        received(&b, CASES[i].steps * STEP_NS, CASES[i].counts, CASES[i].velocity_rad_s);
        if (CASES[i].bits == 16) {
            CHECK(b.state.degraded == 1 &&
                  near(b.state.joint[0].position_rad, 0.5 * (14.0 + 14.5) * 0.25));
            continue;
        }
        CHECK(near(b.state.joint[0].position_rad, CASES[i].travel_rad) &&
              b.state.joint[0].jumps == CASES[i].jumps);
        CHECK(b.state.degraded == CASES[i].degraded);
        CHECK(near(b.state.distance_m, fabs(CASES[i].travel_rad) * 0.1));
    }
}

/* In a new epoch the origin of the counter may have moved, so one step uses the drive's
 * velocity. */
static void a_moved_origin_is_no_travel(void)
{
    base b = begun(32);
    received(&b, STEP_NS, 0, 4.0);
    b.feedback[0].epoch++, b.feedback[1].epoch++;
    CHECK(near(received(&b, STEP_NS, 100000, 6.0)->position_rad, 0.05) &&
          b.state.joint[0].jumps == 0 && b.state.degraded == 1);
    CHECK(near(received(&b, STEP_NS, 100, 6.0)->position_rad, 0.05 + 100 * COUNT_RAD) &&
          b.state.degraded == 0);
}

/* Without a counter the odometry uses the measured velocity, else the set-point, for at most the
 * feedback timeout. */
static void without_a_counter_the_velocity_or_the_set_point_is_integrated(void)
{
    static const uint32_t stale[JOINTS_MAX] = {0};
    base b = begun(0);
    received(&b, STEP_NS, 0, 0.0);
    static const struct {
        int64_t steps;
        double velocity_rad_s, setpoint_rad_s, travel_rad;
        uint32_t jumps;
    } CASES[] = {
        {1, 5.0, 9.0, 0.05, 0},     {1, NAN, 9.0, 0.09, 0}, {40, 5.0, 9.0, 1.25, 0},
        {1, -52.4, 0.0, -0.524, 0}, {1, 52.6, 0.0, 0.0, 1}, {1, NAN, NAN, 0.0, 1},
    };
    for (int i = 0; i < 6; i++) {
        double before_rad = b.state.joint[1].position_rad;
        uint32_t jumps = b.state.joint[1].jumps;
        joint_setpoint wheels[JOINTS_MAX] = {{.velocity_rad_s = CASES[i].setpoint_rad_s},
                                             {.velocity_rad_s = CASES[i].setpoint_rad_s}};
        for (int j = 0; j < 2; j++) {
            b.feedback[j].stamp_ns += CASES[i].steps * STEP_NS,
                b.feedback[j].velocity_rad_s = CASES[i].velocity_rad_s;
        }
        odometry_step(&b.state, &b.config, b.feedback, stale, wheels);
        CHECK(near(b.state.joint[1].position_rad - before_rad, CASES[i].travel_rad));
        CHECK(b.state.joint[1].jumps == jumps + CASES[i].jumps && b.state.degraded == 1);
        CHECK(isnan(CASES[i].velocity_rad_s)
                  ? isnan(b.state.joint[1].velocity_rad_s)
                  : b.state.joint[1].velocity_rad_s == CASES[i].velocity_rad_s);
    }
}

/* One of two wheels of a side falls silent, returns, and adds no travel before it has a
 * reference. */
static void a_wheel_that_was_silent_restarts_and_is_reported_degraded(void)
{
    core_config config = begun(32).config;
    config.joint_count = 4;
    config.joint[2] = config.joint[0], config.joint[3] = config.joint[1];
    odometry_state state;
    odometry_init(&state, &config);
    joint_feedback feedback[JOINTS_MAX] = {0};
    uint32_t stale[JOINTS_MAX] = {0};
    const joint_setpoint wheels[JOINTS_MAX] = {{0}};
    for (int step = 1; step <= 8; step++) {
        stale[2] = step == 4 || step == 5;
        for (int j = 0; j < 4; j++) {
            feedback[j].velocity_rad_s = NAN;
            feedback[j].count += 1000;
            if (!stale[j]) {
                feedback[j].stamp_ns = step * STEP_NS;
            }
        }
        odometry_step(&state, &config, feedback, stale, wheels);
        CHECK(state.degraded == stale[2] && state.blind == 0 && state.stamp_ns == step * STEP_NS);
        CHECK(near(state.distance_m, (step - 1) * 1000 * COUNT_RAD * 0.1) &&
              fabs(state.heading_rad) < 1e-12);
    }
    /* its travel without feedback is unknown */
    CHECK(near(state.joint[2].position_rad, 4000 * COUNT_RAD));
    stale[0] = stale[2] = 1;
    odometry_step(&state, &config, feedback, stale, wheels);
    CHECK(state.blind == 1 && state.degraded == 1);
    stale[0] = stale[1] = stale[3] = 0, stale[2] = 1;
    odometry_step(&state, &config, feedback, stale, wheels);
    CHECK(state.blind == 0);
}

int main(void)
{
    the_velocity_decides_about_an_unseen_turn_of_a_counter();
    a_single_wrong_count_is_undone_and_a_lasting_jump_is_followed();
    a_sample_that_is_no_newer_than_the_last_is_ignored();
    the_catching_up_of_a_counter_at_rest_is_bounded();
    a_counter_that_comes_late_catches_up();
    an_impossible_velocity_is_no_travel();
    pose_and_covariance_are_those_of_exact_arcs();
    a_reset_throws_away_what_is_pending();
    without_a_side_the_deviations_grow_by_the_distance();
    every_number_of_the_state_is_checked();
    the_possible_travels_of_a_counter_decide_which_is_accepted();
    a_moved_origin_is_no_travel();
    without_a_counter_the_velocity_or_the_set_point_is_integrated();
    a_wheel_that_was_silent_restarts_and_is_reported_degraded();
    return checks_report("test_odometry");
}
