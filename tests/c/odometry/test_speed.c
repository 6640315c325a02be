/* SPDX-License-Identifier: Apache-2.0
 * The measured twist: by the travel over a window, by what the drives report, and how sure it is.
 */
#include "odometry_base.h"

static const double HALL_RAD = 6.283185307179586 / 90.0;

/* Two wheels with a counter of 90 steps a turn; the base's greatest acceleration is 1 m/s2. */
static base coarse(void)
{
    base b = begun(32);
    b.config.limits.linear = (axis_limits){1.0, 1.0, 0.5, INFINITY};
    b.config.limits.angular = (axis_limits){2.0, 2.0, 2.0, INFINITY};
    for (int j = 0; j < 2; j++) {
        b.config.joint[j].rad_per_count = HALL_RAD;
    }
    odometry_init(&b.state, &b.config);
    return b;
}

/* Drive straight on; return the greatest error of the speed in the last second. */
static double worst_m_s(base *b, double speed_rad_s, double reported_rad_s)
{
    double position_rad = 0.0, worst = 0.0;
    for (int step = 0; step < 300; step++) {
        position_rad += speed_rad_s * 0.01;
        for (int j = 0; j < 2; j++) {
            int64_t count = (int64_t)floor(position_rad / HALL_RAD);
            comes(b, j, STEP_NS, count - (int64_t)b->feedback[j].count, reported_rad_s);
        }
        take(b);
        double error_m_s = fabs(b->state.linear_m_s - 0.1 * speed_rad_s);
        worst = step >= 200 && error_m_s > worst ? error_m_s : worst;
    }
    return worst;
}

static void a_coarse_counter_is_looked_at_over_a_window(void)
{
    base b = coarse();
    double step_m = HALL_RAD * 0.1, window_s = sqrt(2.0 * step_m);
    double worst = worst_m_s(&b, 2.7, NAN);
    CHECK(worst <= 1.001 * step_m / window_s && worst < 0.1 * step_m / 0.01);
    CHECK(b.state.twist_covariance[0] > 1e-5 &&
          sqrt(b.state.twist_covariance[0]) < step_m / window_s);
}

static void what_the_drives_report_outweighs_a_coarse_counter(void)
{
    base b = coarse();
    CHECK(worst_m_s(&b, 3.0, 3.0) < 0.01);
    CHECK(b.state.joint[0].velocity_rad_s == 3.0);
}

/* It reports a speed that the counter does not show: after a moment the counter is believed. */
static void a_reported_speed_that_the_counter_contradicts_loses_its_weight(void)
{
    base b = coarse();
    CHECK(worst_m_s(&b, 3.0, 12.0) < 0.15);
    base fine = begun(32);
    for (int step = 0; step < 300; step++) {
        received(&fine, STEP_NS, 100, 9.0);
    }
    CHECK(fabs(fine.state.linear_m_s - 100.0 * COUNT_RAD / 0.01 * 0.1) < 0.01);
}

static void a_report_beyond_the_wheel_s_reach_is_none(void)
{
    const double impossible[] = {NAN, INFINITY, -1e9};
    for (int i = 0; i < 3; i++) {
        base b = begun(32);
        for (int step = 0; step < 3; step++) {
            received(&b, STEP_NS, 100, impossible[i]);
        }
        CHECK(near(b.state.linear_m_s, 100.0 * COUNT_RAD / 0.01 * 0.1));
    }
}

static void before_an_error_was_seen_the_speed_may_be_anything_within_the_ramps(void)
{
    base b = coarse();
    received(&b, STEP_NS, 0, NAN);
    received(&b, STEP_NS, 1, NAN);
    CHECK(b.state.twist_known == 1 && near(b.state.twist_covariance[0], 0.06 * 0.06));
    CHECK(near(b.state.twist_covariance[2], 0.12 * 0.12));
}

/* The right wheel is sampled 4 ms after the left one; both turn at the same speed. */
static void joints_that_are_sampled_one_after_another_are_aligned(void)
{
    base b = begun(32);
    received(&b, STEP_NS, 0, NAN);
    comes(&b, 1, 4000000, 40, NAN);
    comes(&b, 0, 0, 0, NAN);
    for (int step = 0; step < 100; step++) {
        comes(&b, 0, STEP_NS, 100, NAN);
        comes(&b, 1, STEP_NS, 100, NAN);
        take(&b);
    }
    CHECK(fabs(b.state.linear_m_s - 100.0 * COUNT_RAD / 0.01 * 0.1) < 1e-6);
    CHECK(fabs(b.state.angular_rad_s) < 1e-6);
}

/* A 32-bit floating-point number has 24 digits: 2^24 counts are exact, and so is each before. */
static void the_steps_of_a_floating_point_counter_grow_with_it(void)
{
    const struct {
        int64_t count;
        double steps;
    } rows[] = {{0, 1},          {1, 1},       {(1 << 24) - 1, 1}, {1 << 24, 2},
                {-(1 << 24), 2}, {1 << 25, 4}, {20000 * 8192, 16}, {-20000 * 8192, 16}};
    for (size_t i = 0; i < sizeof rows / sizeof rows[0]; i++) {
        base b = begun(32);
        b.config.joint[0].counter_mantissa_bits = 24;
        b.feedback[0].count = (uint32_t)rows[i].count;
        b.feedback[0].stamp_ns = STEP_NS;
        take(&b);
        CHECK(near(counter_step_rad(&b.state.joint[0], &b.config.joint[0]),
                   rows[i].steps * COUNT_RAD));
        CHECK(near(counter_step_rad(&b.state.joint[0], &b.config.joint[1]), COUNT_RAD));
    }
    base none = begun(0);
    none.config.joint[0].counter_mantissa_bits = 24;
    CHECK(counter_step_rad(&none.state.joint[0], &none.config.joint[0]) == 0.0);
}

/* --- counters that are not trusted */
static void the_travel_of_a_distrusted_counter_is_left_out(void)
{
    base b = begun(32);
    received(&b, STEP_NS, 0, NAN);
    received(&b, STEP_NS, 100, NAN);
    double x_m = b.state.x_m;
    b.state.distrusted = 2;
    received(&b, STEP_NS, 100, NAN);
    CHECK(b.state.x_m == x_m && b.state.blind == 1 && b.state.twist_known == 0);
    CHECK(b.state.degraded == 1 && near(b.state.joint[1].left_out_rad, 100 * COUNT_RAD));
    CHECK(near(b.state.joint[1].velocity_rad_s, 100 * COUNT_RAD / 0.01)); /* for rest */
    b.state.distrusted = 0;
    received(&b, STEP_NS, 0, NAN);
    received(&b, STEP_NS, 0, NAN);
    CHECK(fabs(b.state.heading_rad) < 1e-3 && b.state.twist_known == 1);
    CHECK(near(b.state.joint[1].left_out_rad, 100 * COUNT_RAD) && b.state.degraded == 0);
}

static void the_other_wheels_go_on_without_a_distrusted_one(void)
{
    base b = begun(32);
    b.config.joint_count = 4;
    b.config.joint[2] = b.config.joint[0], b.config.joint[3] = b.config.joint[1];
    odometry_init(&b.state, &b.config);
    for (int step = 0; step < 4; step++) {
        b.state.distrusted = step >= 2 ? 8 : 0;
        for (int j = 0; j < 4; j++) {
            comes(&b, j, STEP_NS, step == 0 ? 0 : j == 3 && step >= 2 ? -900 : 100, NAN);
        }
        take(&b);
    }
    CHECK(near(b.state.x_m, 300 * COUNT_RAD * 0.1) && near(b.state.heading_rad, 0.0));
    CHECK(b.state.degraded == 1 && b.state.blind == 0);
}

int main(void)
{
    a_coarse_counter_is_looked_at_over_a_window();
    what_the_drives_report_outweighs_a_coarse_counter();
    a_reported_speed_that_the_counter_contradicts_loses_its_weight();
    a_report_beyond_the_wheel_s_reach_is_none();
    before_an_error_was_seen_the_speed_may_be_anything_within_the_ramps();
    joints_that_are_sampled_one_after_another_are_aligned();
    the_steps_of_a_floating_point_counter_grow_with_it();
    the_travel_of_a_distrusted_counter_is_left_out();
    the_other_wheels_go_on_without_a_distrusted_one();
    return checks_report("test_speed");
}
