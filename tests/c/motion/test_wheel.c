/* SPDX-License-Identifier: Apache-2.0
 * test_wheel: the factor that keeps wheels within their limits, and the duty of a speed. */
#include <math.h>

#include "check.h"
#include "core.h"

static joint_config joint_of(double min_rad_s, double max_rad_s)
{
    return (joint_config){.velocity_min_rad_s = min_rad_s, .velocity_max_rad_s = max_rad_s};
}

static double factor_of(double want_rad_s, double min_rad_s, double max_rad_s)
{
    joint_config joint = joint_of(min_rad_s, max_rad_s);
    return saturate_factor(&want_rad_s, &joint, 1);
}

static void a_wheel_within_its_limits_does_not_scale_the_twist(void)
{
    CHECK(factor_of(0.0, -1.0, 2.0) == 1.0 && factor_of(2.0, -1.0, 2.0) == 1.0 &&
          factor_of(-1.0, -1.0, 2.0) == 1.0);
    CHECK(factor_of(0.0, 0.0, 2.0) == 1.0);
}

static void a_wheel_beyond_its_limit_is_brought_to_it(void)
{
    CHECK(factor_of(4.0, -1.0, 2.0) == 0.5 && factor_of(-4.0, -1.0, 2.0) == 0.25);
    CHECK(factor_of(0.5, -1.0, 0.25) == 0.5 && factor_of(-0.5, -0.25, 9.0) == 0.5 &&
          factor_of(0.05, -9.0, 0.025) == 0.5);
    /* the wheel cannot reverse */
    CHECK(factor_of(-1.0, 0.0, 2.0) == 0.0 && !signbit(factor_of(-1.0, 0.0, 2.0)));
    uint32_t rounded_up = 0;
    /* rounding never exceeds the limit, and the factor is not smaller than needed for that */
    for (int i = 1; i < 20000; i++) {
        double want_rad_s = 0.3 + i * 1.37e-3, quotient = 0.3 / want_rad_s,
               factor = factor_of(want_rad_s, -1.0, 0.3);
        bool beyond = want_rad_s * quotient > 0.3;
        rounded_up += beyond;
        CHECK(want_rad_s * factor <= 0.3 &&
              (beyond ? factor < quotient && nextafter(factor, 1.0) == quotient
                      : factor == quotient));
    }
    CHECK(rounded_up > 100);
}

static void an_input_that_is_not_finite_moves_nothing(void)
{
    CHECK(factor_of(NAN, -1.0, 2.0) == 0.0 && factor_of(INFINITY, -1.0, 2.0) == 0.0 &&
          factor_of(-INFINITY, -1.0, 2.0) == 0.0);
    CHECK(factor_of(1.0, -1.0, NAN) == 0.0 && factor_of(-1.0, NAN, 2.0) == 0.0);
}

static void all_wheels_take_the_factor_of_the_worst(void)
{
    const joint_config joints[] = {joint_of(-1.0, 1.0), joint_of(-1.0, 2.0), joint_of(-4.0, 4.0)};
    CHECK(saturate_factor((const double[]){2.0, 2.0, 4.0}, joints, 3) == 0.5);
    CHECK(saturate_factor((const double[]){1.0, 8.0, 8.0}, joints, 3) == 0.25);
    CHECK(saturate_factor((const double[]){1.0, 2.0, 16.0}, joints, 3) == 0.25);
    /* only the first two of three */
    CHECK(saturate_factor((const double[]){1.0, 2.0, 16.0}, joints, 2) == 1.0);
}

/* A step with a dead band of 0.2 and full duty at 10 rad/s: 0.2 + 0.08 per rad/s. */
static pwm_output step(double last_duty, double velocity_rad_s, double slew_per_s)
{
    pwm_config config = {.dead_band = 0.2,
                         .duty_min = -0.6,
                         .duty_max = 0.8,
                         .slew_per_s = slew_per_s,
                         .full_duty_rad_s = 10.0};
    return pwm_step(&config, last_duty, velocity_rad_s, 0.01);
}

static bool is_near(double value, double expected)
{
    return fabs(value - expected) < 1e-12;
}

static void a_duty_begins_at_the_dead_band_in_either_direction(void)
{
    CHECK(step(0.0, 0.0, INFINITY).duty == 0.0 && step(0.5, 0.0, 1.0).duty == 0.0);
    CHECK(is_near(step(0.0, 0.05, INFINITY).duty, 0.204) &&
          is_near(step(0.0, -0.05, INFINITY).duty, -0.204));
    CHECK(is_near(step(0.0, 0.5, INFINITY).duty, 0.24) &&
          is_near(step(0.0, -2.0, INFINITY).duty, -0.36));
    CHECK(step(0.0, 2.0, INFINITY).reasons == 0);
    CHECK(step(0.0, 9.0, INFINITY).duty == 0.8 &&
          step(0.0, 9.0, INFINITY).reasons == REASON_DUTY_CLAMPED);
    pwm_config forward = {
        .dead_band = 0.1, .duty_max = 1.0, .slew_per_s = INFINITY, .full_duty_rad_s = 10.0};
    pwm_output back = pwm_step(&forward, 0.0, -5.0, 0.01); /* it cannot reverse, so it rests */
    CHECK(back.duty == 0.0 && !signbit(back.duty) && back.reasons == REASON_DUTY_CLAMPED);
    CHECK(step(0.0, -9.0, INFINITY).duty == -0.6 &&
          step(0.0, -9.0, INFINITY).reasons == REASON_DUTY_CLAMPED);
}

/* The slew limits only growth away from zero. A duty inside the dead band grows from the band's
 * edge. */
static void a_duty_grows_no_faster_than_its_slew(void)
{
    CHECK(is_near(step(0.0, 5.0, 10.0).duty, 0.3) &&
          step(0.0, 5.0, 10.0).reasons == REASON_DUTY_SLEW);
    CHECK(is_near(step(0.3, 5.0, 10.0).duty, 0.4) && is_near(step(-0.3, -5.0, 10.0).duty, -0.4));
    CHECK(is_near(step(-0.3, 5.0, 10.0).duty, 0.3) && is_near(step(0.3, -5.0, 10.0).duty, -0.3));
    /* falls at once */
    CHECK(is_near(step(0.7, 1.0, 10.0).duty, 0.28) && step(0.7, 1.0, 10.0).reasons == 0);
    CHECK(step(0.3, 9.0, 10.0).reasons == (REASON_DUTY_CLAMPED | REASON_DUTY_SLEW));
    pwm_config exact = {.dead_band = 0.25,
                        .duty_min = -1.0,
                        .duty_max = 1.0,
                        .slew_per_s = 12.5,
                        .full_duty_rad_s = 6.0};
    pwm_output reached = pwm_step(&exact, 0.0, 1.0, 0.01);
    CHECK(reached.duty == 0.375 && reached.reasons == 0);
    exact.dead_band = 0.0;
    CHECK(signbit(pwm_step(&exact, 0.0, -5e-324, 0.01).duty) == 0);
}

int main(void)
{
    a_wheel_within_its_limits_does_not_scale_the_twist();
    a_wheel_beyond_its_limit_is_brought_to_it();
    an_input_that_is_not_finite_moves_nothing();
    all_wheels_take_the_factor_of_the_worst();
    a_duty_begins_at_the_dead_band_in_either_direction();
    a_duty_grows_no_faster_than_its_slew();
    return checks_report("wheel");
}
