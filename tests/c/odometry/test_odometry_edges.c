/* SPDX-License-Identifier: Apache-2.0
 * test_odometry_edges: the bounds up to which a travel is accepted, and the state after a start
 * and a reset. */
#include "odometry_base.h"

static void a_narrow_counter_continues_beyond_its_end(void)
{
    base b = begun(16);
    for (int j = 0; j < 2; j++) {
        b.feedback[j].count = 65530;
    }
    received(&b, STEP_NS, 0, NAN);
    for (int j = 0; j < 2; j++) {
        b.feedback[j].count = 4;
    }
    CHECK(near(received(&b, STEP_NS, 0, NAN)->position_rad, 10 * COUNT_RAD) &&
          b.state.joint[0].jumps == 0);
    for (int j = 0; j < 2; j++) {
        b.feedback[j].count = 65500;
    }
    CHECK(near(received(&b, STEP_NS, 0, NAN)->position_rad, -30 * COUNT_RAD) &&
          b.state.joint[0].jumps == 0);
}

static void the_reach_of_a_joint_is_computed_at_the_beginning(void)
{
    base b = begun(16);
    const joint_constants *c = &b.state.joint[0].constant;
    CHECK(c->reach_rad_s == 52.5 && c->counter_bits_unused == 48 &&
          near(c->counter_round_rad, 65536 * COUNT_RAD));
    CHECK(near(c->counter_unused_max_rad, 16384 * COUNT_RAD) &&
          near(c->counter_slack_rad, 4 * COUNT_RAD));
    b.config.joint[0].velocity_min_rad_s = -40.0;
    b.config.joint[0].counter_bits = 32;
    odometry_init(&b.state, &b.config);
    CHECK(c->reach_rad_s == 60.0 && c->counter_unused_max_rad == 15.0);
    CHECK(b.state.joint[1].constant.reach_rad_s == 52.5);
    for (int j = 0; j < JOINTS_MAX; j++) {
        CHECK(isnan(b.state.joint[j].velocity_rad_s) && b.state.joint[j].position_rad == 0.0);
    }
}

/* Travel of one side from before the reset is not part of an arc after it. */
static void a_reset_waits_for_both_sides_again(void)
{
    for (int first = 0; first < 2; first++) {
        base b = begun(32);
        received(&b, STEP_NS, 0, NAN);
        b.state.gyro.referenced = 1;
        comes(&b, first, STEP_NS, 1000, NAN);
        take(&b);
        odometry_reset(&b.state, &b.config);
        CHECK(b.state.gyro.referenced == 0 && b.state.joint[first].pending_rad == 0.0 &&
              b.state.degraded == 0);
        int64_t stamp_ns = b.state.stamp_ns;
        comes(&b, 1 - first, STEP_NS, 1000, NAN);
        take(&b);
        CHECK(b.state.distance_m == 0.0 && b.state.stamp_ns == stamp_ns &&
              b.state.joint[1 - first].pending_rad > 0.0);
        comes(&b, first, STEP_NS, 1000, NAN);
        take(&b);
        CHECK(near(b.state.distance_m, 1000 * COUNT_RAD * 0.1) && near(b.state.turned_rad, 0.0));
    }
}

/* A counter that wraps after one turn was silent for so long that it may have done so. The
 * velocities decide. */
static void velocities_that_are_certain_enough_decide_about_whole_turns(void)
{
    static const struct {
        int64_t steps, counts;
        double before_rad_s, after_rad_s;
        bool believed;
    } CASES[] = {
        /* 1.19 rad of change and 0.37 rad of error are below a quarter turn, 1.57 rad */
        {11, 19505, 34.0 - 10.85, 34.0 + 10.85, true},
        {11, 19505, 34.0 - 10.90, 34.0 + 10.90, false},
        {11, 27640, 34.0, 34.0, true}, /* 1.56 rad from the measured travel */
        {11, 27744, 34.0, 34.0, false},
        {11, 11369, 34.0, 34.0, true},
        {11, 11265, 34.0, 34.0, false},
        {25, 44329, 34.0, 34.0, true}, /* as long as the feedback timeout */
        {26, 46102, 34.0, 34.0, false},
        {11, -27640, -34.0, -34.0, true},
        {11, -27744, -34.0, -34.0, false},
    };
    for (size_t i = 0; i < sizeof CASES / sizeof CASES[0]; i++) {
        base b = begun(15);
        received(&b, STEP_NS, 0, CASES[i].before_rad_s);
        received(&b, CASES[i].steps * STEP_NS, CASES[i].counts, CASES[i].after_rad_s);
        bool believed = near(b.state.joint[0].position_rad, (double)CASES[i].counts * COUNT_RAD);
        CHECK(believed == CASES[i].believed && (b.state.degraded == 0) == CASES[i].believed);
    }
}

/* --- reach of a step, and what earlier steps left of theirs */

static void a_refused_sample_adds_no_reach_after_an_accepted_one(void)
{
    base b = begun(32);
    received(&b, STEP_NS, 0, NAN);
    CHECK(received(&b, STEP_NS, 20000, NAN)->jumps == 1);
    CHECK(received(&b, STEP_NS, -20000, NAN)->jumps == 1 && b.state.joint[0].position_rad == 0.0);
    CHECK(received(&b, STEP_NS, 10430, NAN)->jumps == 2); /* 2 rad: only 1.575 rad are left */
}

static void an_estimate_is_corrected_by_the_counts_that_follow(void)
{
    base b = begun(32);
    received(&b, STEP_NS, 0, 20.0);
    for (int times = 1; times <= 3; times++) {
        CHECK(near(received(&b, STEP_NS, 90000, 30.0)->position_rad,
                   ((times - 1) * 1000) * COUNT_RAD + (times == 1 ? 0.25 : 0.30)));
        CHECK(received(&b, STEP_NS, -89000, 30.0)->jumps == (uint32_t)times &&
              b.state.degraded == 0);
        CHECK(near(b.state.joint[0].position_rad, times * 1000 * COUNT_RAD));
    }
}

static void a_new_origin_clears_all_older_state(void)
{
    base b = begun(32);
    for (int i = 0; i < 10; i++) {
        received(&b, STEP_NS, 0, NAN);
    }
    b.feedback[0].epoch++, b.feedback[1].epoch++;
    received(&b, STEP_NS, 5000, NAN);
    CHECK(received(&b, STEP_NS, 10430, NAN)->jumps == 1);
}

static void a_counter_that_stays_where_it_jumped_to_is_followed_from_there(void)
{
    for (int far = 0; far < 2; far++) {
        base b = begun(32);
        received(&b, STEP_NS, 0, NAN);
        CHECK(received(&b, STEP_NS, 1000000, NAN)->jumps == 1);
        int64_t counts = far ? 2742 : 2741;
        CHECK(received(&b, STEP_NS, counts, NAN)->jumps == (far ? 2 : 1));
        CHECK(near(b.state.joint[0].position_rad, far ? 0.0 : 2741 * COUNT_RAD));
        for (int step = 1; step <= 3 && !far; step++) {
            CHECK(near(received(&b, STEP_NS, 500, NAN)->position_rad,
                       (2741 + step * 500) * COUNT_RAD));
            CHECK(b.state.joint[0].jumps == 1 && b.state.degraded == 0);
        }
    }
}

/* The distance that a sample catches up took longer than the time since the last sample. */
static void a_speed_is_that_of_the_time_in_which_the_distance_was_covered(void)
{
    base b = begun(32);
    received(&b, STEP_NS, 0, NAN);
    CHECK(near(received(&b, STEP_NS, 1000, NAN)->velocity_rad_s, 1000 * COUNT_RAD / 0.01));
    b = begun(32);
    for (int i = 0; i < 3; i++) {
        received(&b, STEP_NS, 0, NAN);
    }
    /* within the four counts */
    CHECK(near(received(&b, STEP_NS, -2741, NAN)->velocity_rad_s, -2741 * COUNT_RAD / 0.01));
    b = begun(32);
    for (int i = 0; i < 3; i++) {
        received(&b, STEP_NS, 0, NAN);
    }
    CHECK(near(received(&b, STEP_NS, 2742, NAN)->velocity_rad_s, 2742 * COUNT_RAD / 0.03));
}

static void a_counter_that_has_used_all_its_reach_has_none_left(void)
{
    base b = begun(32);
    received(&b, STEP_NS, 0, NAN);
    CHECK(received(&b, STEP_NS, 2741, NAN)->jumps == 0 && b.state.joint[0].unused_rad == 0.0);
    CHECK(received(&b, STEP_NS, 2742, NAN)->jumps == 1);
}

/* In two steps since the last accepted sample a wheel can reach 5475.8 counts, and four. */
static void after_a_refused_sample_all_time_since_the_last_good_one_counts(void)
{
    for (int far = 0; far < 2; far++) {
        base b = begun(32);
        received(&b, STEP_NS, 0, NAN);
        received(&b, STEP_NS, 90000, NAN);
        received(&b, STEP_NS, (far ? 5480 : 5479) - 90000, NAN);
        CHECK(b.state.joint[0].jumps == (far ? 2 : 1));
        CHECK(far || near(b.state.joint[0].velocity_rad_s, 5479 * COUNT_RAD / 0.02));
    }
    base b = begun(32);
    for (int i = 0; i < 4; i++) {
        received(&b, STEP_NS, 0, NAN);
    }
    received(&b, STEP_NS, 90000, NAN);
    /* the steps before the jump have left their reach */
    CHECK(received(&b, STEP_NS, 6000 - 90000, NAN)->jumps == 1);
}

static void a_nearby_new_origin_is_no_travel_either(void)
{
    base b = begun(32);
    received(&b, STEP_NS, 0, 4.0);
    b.feedback[0].epoch++, b.feedback[1].epoch++;
    CHECK(near(received(&b, STEP_NS, 1000, 6.0)->position_rad, 0.05) &&
          b.state.joint[0].jumps == 0 && b.state.degraded == 1);
    CHECK(b.state.joint[0].epoch == 1);
}

/* One side has two samples before the other has one. The kind of each is reported. */
static void an_estimate_among_several_samples_of_a_side_is_kept(void)
{
    for (int seed = 0; seed < 2; seed++) {
        base b = begun(32);
        if (!seed) {
            received(&b, STEP_NS, 0, 20.0);
        }
        comes(&b, 0, STEP_NS, seed ? 0 : 90000, 20.0);
        take(&b);
        comes(&b, 0, STEP_NS, seed ? 1000 : -89000, 20.0);
        take(&b);
        comes(&b, 1, 2 * STEP_NS, 1000, 20.0);
        take(&b);
        CHECK(b.state.degraded == 1 &&
              near(b.state.distance_m, seed ? 0.0 : 1000 * COUNT_RAD * 0.1));
    }
}

/* A wheel of the same side that restarts does not clear the report. */
static void a_wheel_without_feedback_is_reported_whatever_the_others_measure(void)
{
    base b = begun(32);
    b.config.joint_count = 4;
    b.config.joint[2] = b.config.joint[0], b.config.joint[3] = b.config.joint[1];
    odometry_init(&b.state, &b.config);
    uint32_t stale[JOINTS_MAX] = {1, 0, 0, 1};
    for (int step = 0; step < 3; step++) {
        for (int j = 0; j < 4; j++) {
            comes(&b, j, STEP_NS, 100, NAN);
        }
        stale[3] = step < 2;
        odometry_step(&b.state, &b.config, b.feedback, stale, b.setpoint);
        CHECK(b.state.degraded == 1 && b.state.blind == 0);
    }
}

/* Small turns use a series, others the sine: both are exact to the last bits next to the change. */
static void the_chord_of_an_arc_is_right_to_the_last_bits(void)
{
    static const double HALF_RAD[] = {1e-4, 0.05, 0.0999, 0.1001, 0.14, 0.3, 0.9};
    for (size_t i = 0; i < sizeof HALF_RAD / sizeof HALF_RAD[0]; i++) {
        base b = begun(32);
        for (int j = 0; j < 2; j++) {
            b.config.joint[j].velocity_max_rad_s = 1e4;
        }
        odometry_init(&b.state, &b.config);
        received(&b, STEP_NS, 0, NAN);
        int64_t turn = (int64_t)(HALF_RAD[i] * 0.5 / (0.1 * COUNT_RAD)), travel = 40000;
        comes(&b, 0, STEP_NS, travel - turn, NAN);
        comes(&b, 1, STEP_NS, travel + turn, NAN);
        take(&b);
        long double half_rad = (long double)turn * (long double)COUNT_RAD * 0.1L / 0.5L;
        long double chord_m =
            (long double)travel * (long double)COUNT_RAD * 0.1L * sinl(half_rad) / half_rad;
        CHECK(fabs((double)(hypotl(b.state.x_m, b.state.y_m) / chord_m - 1.0L)) < 1.5e-15);
    }
}

/* With a gyro the heading is as uncertain as the gyro, however the wheels slip. It does not depend
 * on the error of the distance. */
static void a_turn_by_the_gyro_has_the_gyro_s_variance(void)
{
    base b = begun(32);
    b.config.gyro = (gyro_config){.used = 1,
                                  .timeout_s = 0.05,
                                  .heading_variance_rad2_per_s = 1e-5,
                                  .turn_variance_rad2_per_rad = 1e-3};
    received(&b, STEP_NS, 0, NAN);
    gyro_state *gyro = &b.state.gyro;
    gyro->stamp_ns = gyro->bias_stamp_ns = b.feedback[0].stamp_ns;
    received(&b, STEP_NS, 0, NAN);
    CHECK(b.state.by_gyro == 0 && gyro->referenced == 1);
    comes(&b, 0, STEP_NS, 1000, NAN);
    comes(&b, 1, STEP_NS, 1400, NAN);
    gyro->stamp_ns = b.feedback[0].stamp_ns;
    gyro->yaw_rad = 0.02;
    take(&b);
    spread_look(&b.state, &b.config, b.feedback[0].stamp_ns);
    double turn_rad2 = 0.01 * (1e-5 + 2.0 * 0.02 * 0.02 * 1e-9) + 1e-3 * 0.02,
           moved_m = 1200 * COUNT_RAD * 0.1;
    CHECK(b.state.by_gyro == 1 && near(b.state.heading_rad, 0.02) &&
          near(b.state.distance_m, moved_m));
    CHECK(fabs(b.state.pose_covariance[5] / turn_rad2 - 1.0) < 1e-9 &&
          b.state.twist_covariance[1] == 0.0);
    CHECK(fabs(b.state.pose_covariance[2] / (-0.5 * turn_rad2 * moved_m * sin(0.01)) - 1.0) < 1e-9);
}

/* The speed is the measured rate, or zero if the base stands still. */
static void the_speed_of_a_turn_is_the_gyro_s(void)
{
    for (uint32_t still = 0; still < 2; still++) {
        base b = begun(32);
        b.config.gyro = (gyro_config){.used = 1, .timeout_s = 0.05};
        b.config.twist_variance_floor_rad2_s2 = 2e-3;
        received(&b, STEP_NS, 0, NAN);
        gyro_state *gyro = &b.state.gyro;
        gyro->rate_variance_rad2_s2 = 5e-4;
        for (int step = 0; step < 2; step++) {
            gyro->stamp_ns = gyro->bias_stamp_ns = b.feedback[0].stamp_ns + STEP_NS;
            gyro->rate_rad_s = 0.7;
            gyro->still = still;
            received(&b, STEP_NS, 100, NAN);
        }
        CHECK(b.state.by_gyro == 1 && b.state.angular_rad_s == (still ? 0.0 : 0.7));
        CHECK(near(b.state.twist_covariance[2], 2e-3 + 5e-4));
    }
}

static void no_variance_of_the_pose_is_below_its_floor(void)
{
    base b = begun(32);
    b.config.pose_variance_floor_m2 = 1e-4, b.config.heading_variance_floor_rad2 = 2e-4;
    received(&b, STEP_NS, 0, NAN);
    received(&b, SPREAD_EVERY_NS - 1, 0, NAN); /* before the next check */
    CHECK(b.state.pose_covariance[0] < 1e-4 && b.state.pose_covariance[5] < 2e-4);
    received(&b, 1, 0, NAN);
    CHECK(b.state.pose_covariance[0] == 1e-4 && b.state.pose_covariance[3] == 1e-4 &&
          b.state.pose_covariance[5] == 2e-4);
}

/* One wheel of a side restarts while the other is silent. Travel of the other side in this time is
 * no arc. */
static void a_side_that_only_starts_makes_no_turn(void)
{
    for (int side = 0; side < 2; side++) {
        base b = begun(32);
        b.config.joint_count = 4;
        b.config.joint[2] = b.config.joint[0], b.config.joint[3] = b.config.joint[1];
        odometry_init(&b.state, &b.config);
        for (int step = 0; step < 5; step++) {
            uint32_t stale[JOINTS_MAX] = {0};
            stale[side] = step == 2;
            stale[side + 2] = step == 3;
            for (int j = 0; j < 4; j++) {
                comes(&b, j, STEP_NS, 1000, NAN);
            }
            odometry_step(&b.state, &b.config, b.feedback, stale, b.setpoint);
            int arcs = step < 3 ? step : step - 1;
            CHECK(near(b.state.distance_m, arcs * 1000 * COUNT_RAD * 0.1) &&
                  near(b.state.turned_rad, 0.0));
            CHECK(b.state.blind == 0 && b.state.degraded == (step == 2 || step == 3));
        }
    }
}

/* All wheels of a side are silent: the pose does not move, and later moves as far as the counters
 * did. */
static void a_side_that_was_silent_adds_the_missed_travel(void)
{
    base b = begun(32);
    received(&b, STEP_NS, 0, NAN);
    const uint32_t stale[JOINTS_MAX] = {[1] = 1};
    for (int step = 0; step < 10; step++) {
        comes(&b, 0, STEP_NS, 1000, NAN);
        odometry_step(&b.state, &b.config, b.feedback, stale, b.setpoint);
        CHECK(b.state.degraded == 1 && b.state.blind == 1 && b.state.distance_m == 0.0 &&
              b.state.turned_rad == 0.0);
    }
    comes(&b, 0, STEP_NS, 1000, NAN);
    comes(&b, 1, 11 * STEP_NS, 11000, NAN);
    take(&b);
    CHECK(b.state.degraded == 0 && b.state.blind == 0 &&
          near(b.state.x_m, 11000 * COUNT_RAD * 0.1));
    CHECK(near(b.state.heading_rad, 0.0));
}

/* Cases: each side, which has not reported before. */
static void a_side_that_reports_later_makes_no_turn(void)
{
    for (uint32_t silent = 0; silent < 2; silent++) {
        base b = begun(32);
        for (int step = 0; step < 4; step++) {
            uint32_t stale[JOINTS_MAX] = {0};
            stale[silent] = step < 2;
            comes(&b, 0, STEP_NS, 1000, NAN);
            comes(&b, 1, STEP_NS, 1000, NAN);
            odometry_step(&b.state, &b.config, b.feedback, stale, b.setpoint);
            CHECK(b.state.blind == (step < 2) && b.state.degraded == (step < 3) &&
                  near(b.state.turned_rad, 0.0));
            CHECK(near(b.state.distance_m, step < 3 ? 0.0 : 1000 * COUNT_RAD * 0.1));
        }
    }
}

/* The newest stamp was from a wheel that is silent now. Since then no time has passed, so no speed
 * is measured. */
static void samples_no_newer_than_the_last_arc_give_no_speed(void)
{
    for (int64_t short_ns = 0; short_ns < 2; short_ns++) {
        base b = begun(32);
        b.config.joint_count = 4;
        b.config.joint[2] = b.config.joint[0], b.config.joint[3] = b.config.joint[1];
        odometry_init(&b.state, &b.config);
        uint32_t stale[JOINTS_MAX] = {0};
        for (int step = 0; step < 3; step++) {
            stale[2] = step == 2;
            for (int j = 0; j < 4; j++) {
                comes(&b, j, step == 0 ? STEP_NS + (j == 2 ? STEP_NS + short_ns : 0) : STEP_NS, 100,
                      NAN);
            }
            odometry_step(&b.state, &b.config, b.feedback, stale, b.setpoint);
        }
        CHECK(near(b.state.distance_m, 200 * COUNT_RAD * 0.1) &&
              near(b.state.linear_m_s, 100 * COUNT_RAD * 0.1 / 0.01));
    }
}

int main(void)
{
    samples_no_newer_than_the_last_arc_give_no_speed();
    a_side_that_only_starts_makes_no_turn();
    a_side_that_was_silent_adds_the_missed_travel();
    a_side_that_reports_later_makes_no_turn();
    the_speed_of_a_turn_is_the_gyro_s();
    no_variance_of_the_pose_is_below_its_floor();
    a_turn_by_the_gyro_has_the_gyro_s_variance();
    the_chord_of_an_arc_is_right_to_the_last_bits();
    a_wheel_without_feedback_is_reported_whatever_the_others_measure();
    a_refused_sample_adds_no_reach_after_an_accepted_one();
    an_estimate_is_corrected_by_the_counts_that_follow();
    a_new_origin_clears_all_older_state();
    a_counter_that_stays_where_it_jumped_to_is_followed_from_there();
    a_speed_is_that_of_the_time_in_which_the_distance_was_covered();
    a_counter_that_has_used_all_its_reach_has_none_left();
    after_a_refused_sample_all_time_since_the_last_good_one_counts();
    a_nearby_new_origin_is_no_travel_either();
    an_estimate_among_several_samples_of_a_side_is_kept();
    a_narrow_counter_continues_beyond_its_end();
    the_reach_of_a_joint_is_computed_at_the_beginning();
    a_reset_waits_for_both_sides_again();
    velocities_that_are_certain_enough_decide_about_whole_turns();
    return checks_report("test_odometry_edges");
}
