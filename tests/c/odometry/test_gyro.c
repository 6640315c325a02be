/* SPDX-License-Identifier: Apache-2.0
 * test_gyro: zero, turn and status of the gyro alone, exact to the nanosecond, also with hostile
 * samples. */
#include "check.h"
#include "exchange.h"

#include <math.h>
#include <string.h>

static const int64_t SAMPLE_NS = 5000000;
static const int64_t START_NS = 1000000000;
static const gyro_config CONFIG = {
    .used = 1,
    .timeout_s = 0.05,
    .bias_max_rad_s = 0.5,
    .still_variance_rad2_s2 = 1e-4,
    .heading_variance_rad2_per_s = 1e-7,
    .turn_variance_rad2_per_rad = 1e-4,
};

typedef struct {
    gyro_state state;
    int64_t now_ns;
    uint32_t epoch;
} sensor;

static sensor new_sensor(void)
{
    sensor s = {.now_ns = START_NS};
    gyro_init(&s.state);
    return s;
}

/* The sensor reports this rate in so many samples. */
static void say(sensor *s, double rate_rad_s, int samples, bool wheels_rest)
{
    for (int i = 0; i < samples; i++) {
        s->now_ns += SAMPLE_NS;
        imu_sample sample = {
            .stamp_ns = s->now_ns, .angular_rad_s = {0.0, 0.0, rate_rad_s}, .epoch = s->epoch};
        gyro_take(&s->state, &CONFIG, &sample, s->now_ns, wheels_rest);
    }
}

static bool turned(sensor *s, double *turn_rad)
{
    double variance_rad2 = -1.0;
    bool known = gyro_turn(&s->state, &CONFIG, s->now_ns, turn_rad, &variance_rad2);
    CHECK(!known || variance_rad2 >= 0.0);
    return known;
}

static void the_turn_is_the_rate_times_the_time(void)
{
    sensor s = new_sensor();
    double turn_rad;
    CHECK(gyro_status(&s.state, &CONFIG, s.now_ns) == GYRO_NONE);
    say(&s, 0.1, 400, true);
    CHECK(gyro_status(&s.state, &CONFIG, s.now_ns) == GYRO_USED);
    CHECK(fabs(s.state.bias_rad_s - 0.1) < 1e-12);
    CHECK(!turned(&s, &turn_rad)); /* the turn since when is unknown */
    CHECK(turned(&s, &turn_rad) && turn_rad == 0.0);
    CHECK(s.state.still == 1);
    gyro_state before = s.state; /* the newest sample once more changes nothing */
    s.now_ns -= SAMPLE_NS;
    say(&s, 9.0, 1, true);
    CHECK(memcmp(&before, &s.state, sizeof before) == 0);
    say(&s, 0.6, 200, false);
    CHECK(turned(&s, &turn_rad) && fabs(turn_rad - 0.5) < 0.002);
    s.now_ns += SAMPLE_NS; /* after the newest sample: extrapolated */
    CHECK(turned(&s, &turn_rad) && fabs(turn_rad - 0.5 * 0.005) < 1e-12);
    s.now_ns += 20 * SAMPLE_NS;
    CHECK(!turned(&s, &turn_rad));
    CHECK(gyro_status(&s.state, &CONFIG, s.now_ns) == GYRO_STALE);
    say(&s, 0.6, 2, false); /* the integral restarts after a gap */
    CHECK(!turned(&s, &turn_rad));
    CHECK(turned(&s, &turn_rad));
    say(&s, 0.1, 1000, true); /* the zero is measured again */
    CHECK(fabs(s.state.bias_rad_s - 0.1) < 1e-6);
    CHECK(gyro_status(&s.state, &(gyro_config){0}, s.now_ns) == GYRO_NONE);
}

/* The sensor moves at 0.5 rad/s above its zero, and its turn is known. The test then breaks the
 * integral. */
static sensor on_the_move(void)
{
    sensor s = new_sensor();
    double turn_rad;
    say(&s, 0.1, 400, true);
    say(&s, 0.6, 10, false);
    CHECK(!turned(&s, &turn_rad) && turned(&s, &turn_rad));
    return s;
}

static void is_broken_once(sensor *s)
{
    double turn_rad;
    CHECK(!turned(s, &turn_rad));
    say(s, 0.6, 10, false);
    CHECK(turned(s, &turn_rad) && fabs(turn_rad - 0.5 * 0.05) < 1e-9);
}

static void an_incomplete_angle_is_no_turn(void)
{
    sensor s = on_the_move();
    s.epoch++; /* another sensor, or the same one restarted */
    say(&s, 0.6, 2, false);
    is_broken_once(&s);
    s = on_the_move();
    imu_sample sample = {
        .stamp_ns = s.now_ns + 1, .angular_rad_s = {0.0, 0.0, 0.6}, .saturated = 1};
    gyro_take(&s.state, &CONFIG, &sample, s.now_ns + 1, false);
    say(&s, 0.6, 1, false);
    is_broken_once(&s);
    s = on_the_move();
    s.now_ns += 20 * SAMPLE_NS; /* silence longer than the timeout */
    say(&s, 0.6, 1, false);
    is_broken_once(&s);
    CHECK(s.state.refused == 0);
    sample = (imu_sample){.stamp_ns = s.now_ns + 20000000, .angular_rad_s = {0.0, 0.0, 0.6}};
    gyro_take(&s.state, &CONFIG, &sample, s.now_ns, false);
    CHECK(s.state.refused == 1); /* a sample from the future */
}

static void the_zero_is_the_mean_of_a_second_that_begins_when_the_chassis_has_come_to_rest(void)
{
    sensor s = new_sensor();
    say(&s, 0.4, 90, true); /* the chassis still swings */
    for (int i = 0; i < 220; i++) {
        say(&s, i % 2 == 0 ? 0.101 : 0.099, 1, true);
    }
    CHECK(s.state.bias_stamp_ns != 0 && fabs(s.state.bias_rad_s - 0.1) < 1e-4);
    double variance_rad2_s2 = 1e-6, mean_variance_rad2_s2 = variance_rad2_s2 / 200.0 + 1e-9;
    CHECK(fabs(s.state.rate_variance_rad2_s2 / variance_rad2_s2 - 1.0) < 0.02);
    CHECK(fabs(s.state.bias_variance_rad2_s2 / mean_variance_rad2_s2 - 1.0) < 0.02);
    for (int i = 0; i < 200; i++) { /* another second, as good as the first; the zero may wander a
                                       little */
        say(&s, i % 2 == 0 ? 0.101 : 0.099, 1, true);
    }
    double before = mean_variance_rad2_s2 + 1e-9,
           after = before * mean_variance_rad2_s2 / (before + mean_variance_rad2_s2);
    CHECK(fabs(s.state.bias_variance_rad2_s2 / after - 1.0) < 0.02);
    CHECK(s.state.still == 1);
}

static void turning_wheels_restart_the_time_of_rest(void)
{
    sensor s = new_sensor();
    say(&s, 0.0, 250, true); /* 1.25 s of the 1.5 s that a zero takes */
    say(&s, 0.0, 1, false);
    say(&s, 0.0, 250, true);
    CHECK(s.state.bias_stamp_ns == 0);
    say(&s, 0.0, 60, true);
    CHECK(s.state.bias_stamp_ns != 0 && s.state.still == 1);
    say(&s, 0.5, 1, true); /* the wheels rest, and a person turns the base */
    CHECK(s.state.still == 0);
}

static void a_base_that_moves_gives_no_zero(void)
{
    sensor s = new_sensor();
    say(&s, 0.6, 1000, true); /* too much for a zero */
    CHECK(gyro_status(&s.state, &CONFIG, s.now_ns) == GYRO_UNBIASED);
    for (int i = 0; i < 1000; i++) {
        say(&s, i % 2 == 0 ? 0.1 : -0.1, 1, true); /* the base is shaken */
    }
    CHECK(s.state.bias_stamp_ns == 0);
    say(&s, 0.0, 1000, true);
    int64_t known_ns = s.state.bias_stamp_ns;
    CHECK(known_ns != 0);
    say(&s, 0.05, 1000, true); /* the base is turned slowly */
    CHECK(s.state.bias_stamp_ns == known_ns && s.state.still == 0);
}

static void hostile_samples_leave_finite_numbers(void)
{
    static const double RATES[] = {NAN, INFINITY, -INFINITY, 1e300, -1e300, 99.0, 0.0};
    static const int64_t STAMPS[] = {0, 1, -1, INT64_MAX, INT64_MIN, START_NS, START_NS + 1};
    sensor s = new_sensor();
    say(&s, 0.0, 400, true);
    for (size_t r = 0; r < sizeof RATES / sizeof RATES[0]; r++) {
        for (size_t t = 0; t < sizeof STAMPS / sizeof STAMPS[0]; t++) {
            for (uint32_t saturated = 0; saturated < 2; saturated++) {
                imu_sample sample = {.stamp_ns = STAMPS[t],
                                     .angular_rad_s = {NAN, NAN, RATES[r]},
                                     .saturated = saturated,
                                     .epoch = (uint32_t)t};
                double turn_rad = 0.0;
                gyro_take(&s.state, &CONFIG, &sample, s.now_ns, saturated != 0);
                say(&s, RATES[r], 2, false);
                (void)turned(&s, &turn_rad);
                CHECK(isfinite(turn_rad) && isfinite(s.state.yaw_rad) &&
                      isfinite(s.state.bias_rad_s));
            }
        }
    }
    CHECK(s.state.refused > 0);
}

static void turning_against_the_wheels_is_remembered(void)
{
    sensor s = new_sensor();
    say(&s, 0.0, 400, true);
    CHECK(!gyro_reversed(&s.state, 0.9, -0.9) && !gyro_reversed(&s.state, 0.5, 0.5));
    CHECK(!gyro_reversed(&s.state, 3.0, -0.01)); /* noise of the wheels */
    CHECK(gyro_reversed(&s.state, -1.1, 1.1) && gyro_reversed(&s.state, 9.0, 9.0));
    CHECK(gyro_status(&s.state, &CONFIG, s.now_ns) == GYRO_REVERSED);
    s = new_sensor();
    for (int i = 0; i < 10; i++) { /* as often with the wheels as against them: a wheel slipped */
        CHECK(!gyro_reversed(&s.state, 0.6, -0.6) && !gyro_reversed(&s.state, 0.6, 0.6));
    }
}

/* ----------------------------------------------- exact to the nanosecond and to the bit */
typedef struct {
    gyro_state state;
    gyro_config config;
} exact;

static exact new_exact(void)
{
    exact e = {.config = CONFIG};
    e.config.timeout_s = 0.5;
    gyro_init(&e.state);
    return e;
}

static void report_at(exact *e, int64_t stamp_ns, double rate_rad_s, bool wheels_rest)
{
    imu_sample sample = {.stamp_ns = stamp_ns, .angular_rad_s = {0.0, 0.0, rate_rad_s}};
    gyro_take(&e->state, &e->config, &sample, stamp_ns, wheels_rest);
}

/* The base is at rest from START_NS on. So many samples come between 0.5 s and 1.5 s after it,
 * `apart_rad_s` above and below `middle_rad_s`. */
static void rest(exact *e, int samples, double middle_rad_s, double apart_rad_s)
{
    const int64_t settled_ns = START_NS + 500000000;
    report_at(e, START_NS, middle_rad_s, true);
    report_at(e, settled_ns - 1, 9.0, true); /* the chassis swings until the last moment */
    for (int i = 0; i < samples - 1; i++) {
        report_at(e, settled_ns + i * 50000000,
                  middle_rad_s + (i % 2 == 0 ? apart_rad_s : -apart_rad_s), true);
    }
    report_at(e, settled_ns + 999999999, middle_rad_s + apart_rad_s, true);
}

static const int64_t RESTED_NS = 2500000000; /* START_NS + 1.5 s */

static void the_zero_takes_twenty_samples_and_a_second_after_half_a_second(void)
{
    exact e = new_exact();
    rest(&e, 19, 0.1, 0.0);
    CHECK(e.state.window_samples == 19 && e.state.bias_stamp_ns == 0);
    report_at(&e, RESTED_NS, 0.1, true);
    CHECK(e.state.bias_stamp_ns == RESTED_NS && fabs(e.state.bias_rad_s - 0.1) < 1e-15);
    e = new_exact();
    rest(&e, 18, 0.1, 0.0);
    report_at(&e, RESTED_NS, 0.1, true);
    CHECK(e.state.window_samples == 19 && e.state.bias_stamp_ns == 0);
}

static void the_noise_is_the_samples_variance_and_may_be_as_great_as_is_allowed(void)
{
    exact e = new_exact();
    rest(&e, 19, 0.0, 0.001);
    report_at(&e, RESTED_NS, -0.001, true);
    double variance_rad2_s2 = e.state.rate_variance_rad2_s2;
    CHECK(fabs(variance_rad2_s2 / (20e-6 / 19.0) - 1.0) < 1e-3 && fabs(e.state.bias_rad_s) < 1e-15);
    CHECK(fabs(e.state.rate_rad_s - (-0.001 - e.state.bias_rad_s)) < 1e-15);
    const double limits_rad2_s2[] = {variance_rad2_s2, nextafter(variance_rad2_s2, 0.0)};
    for (int i = 0; i < 2; i++) {
        e = new_exact();
        e.config.still_variance_rad2_s2 = limits_rad2_s2[i];
        rest(&e, 19, 0.0, 0.001);
        report_at(&e, RESTED_NS, -0.001, true);
        CHECK((e.state.bias_stamp_ns != 0) == (i == 0));
    }
}

static void a_zero_may_be_as_far_off_as_is_allowed_and_the_rate_follows_it(void)
{
    const double means_rad_s[] = {0.5, -0.5, nextafter(0.5, 1.0)};
    for (int i = 0; i < 3; i++) {
        exact e = new_exact();
        rest(&e, 19, means_rad_s[i], 0.0);
        report_at(&e, RESTED_NS, means_rad_s[i], true);
        CHECK((e.state.bias_stamp_ns != 0) == (i < 2));
        CHECK(e.state.rate_rad_s == (i < 2 ? 0.0 : means_rad_s[i]));
    }
}

/* A gyro whose zero is known, and is 0. */
static exact at_rest(double noise_rad_s)
{
    exact e = new_exact();
    e.config.still_variance_rad2_s2 = 1.0;
    rest(&e, 19, 0.0, noise_rad_s);
    report_at(&e, RESTED_NS, -noise_rad_s, true);
    CHECK(e.state.bias_stamp_ns == RESTED_NS && fabs(e.state.bias_rad_s) < 1e-15);
    return e;
}

static void a_mean_that_is_more_than_a_fiftieth_off_is_a_slow_turn(void)
{
    const double means_rad_s[] = {0.0199, 0.02, -0.02, 0.0201, 0.029};
    for (int i = 0; i < 5; i++) {
        exact e = at_rest(0.0);
        for (int n = 1; n <= 20; n++) {
            report_at(&e, RESTED_NS + n * 50000000, means_rad_s[i], true);
        }
        CHECK((e.state.bias_stamp_ns != RESTED_NS) == (i < 3));
    }
}

static bool stands_at(exact e, double rate_rad_s)
{
    report_at(&e, RESTED_NS + 1, rate_rad_s, true);
    return e.state.still == 1;
}

static void it_counts_as_still_within_a_hundredth_or_five_deviations_of_its_noise(void)
{
    exact noiseless = at_rest(0.0), noisy = at_rest(0.01);
    CHECK(stands_at(noiseless, 0.01) && stands_at(noiseless, -0.01) &&
          !stands_at(noiseless, 0.0101) && !stands_at(noiseless, -0.011));
    double limit_rad_s = 5.0 * sqrt(20e-4 / 19.0);
    CHECK(stands_at(noisy, 0.999 * limit_rad_s * sqrt(0.1)) && stands_at(noisy, 0.0512) &&
          !stands_at(noisy, 0.0515));
    noisy = at_rest(0.001); /* five deviations of its noise are below 0.01 rad/s */
    CHECK(stands_at(noisy, 0.0099));
}

static void rates_and_stamps_are_taken_to_the_end_of_their_range(void)
{
    exact e = new_exact();
    report_at(&e, START_NS, 100.0, false);
    report_at(&e, START_NS + 1, -100.0, false);
    CHECK(e.state.refused == 0);
    report_at(&e, START_NS + 2, nextafter(100.0, 101.0), false);
    CHECK(e.state.refused == 1);
    imu_sample sample = {.stamp_ns = START_NS + 3 + 10000000, .angular_rad_s = {0.0, 0.0, 0.1}};
    gyro_take(&e.state, &e.config, &sample, START_NS + 3, false);
    CHECK(e.state.refused == 1 && e.state.stamp_ns == sample.stamp_ns);
    sample.stamp_ns += 2;
    gyro_take(&e.state, &e.config, &sample, START_NS + 4, false);
    CHECK(e.state.refused == 2 && e.state.stamp_ns == sample.stamp_ns - 2);
    sample.stamp_ns -= 2; /* the same sample again, after another one */
    gyro_take(&e.state, &e.config, &sample, START_NS + 4, false);
    CHECK(e.state.refused == 3);
}

static void a_gap_as_long_as_the_timeout_is_still_allowed(void)
{
    double turn_rad, variance_rad2;
    exact e = at_rest(0.0);
    report_at(&e, RESTED_NS + 1, 0.2, false);
    CHECK(!gyro_turn(&e.state, &e.config, RESTED_NS + 1, &turn_rad, &variance_rad2));
    report_at(&e, RESTED_NS + 1 + 500000000, 0.2, false);
    CHECK(e.state.epoch == 0);
    CHECK(gyro_status(&e.state, &e.config, e.state.stamp_ns + 500000000) == GYRO_USED);
    CHECK(gyro_status(&e.state, &e.config, e.state.stamp_ns + 500000001) == GYRO_STALE);
    double yaw_rad = e.state.yaw_rad;
    report_at(&e, e.state.stamp_ns + 500000001, 0.2, false);
    /* missing samples are not integrated */
    CHECK(e.state.epoch == 1 && e.state.yaw_rad == yaw_rad);
}

static void a_broken_integral_is_stale_at_once_and_restarts_its_rest(void)
{
    double turn_rad, variance_rad2;
    exact e = at_rest(0.0);
    CHECK(e.state.still == 1);
    imu_sample saturated = {
        .stamp_ns = RESTED_NS + 1, .angular_rad_s = {0.0, 0.0, 0.0}, .saturated = 1};
    gyro_take(&e.state, &e.config, &saturated, RESTED_NS + 1, true);
    CHECK(e.state.still == 0 && gyro_status(&e.state, &e.config, RESTED_NS + 1) == GYRO_STALE);
    CHECK(!gyro_turn(&e.state, &e.config, RESTED_NS + 1, &turn_rad, &variance_rad2));
    double yaw_rad = e.state.yaw_rad;
    for (int i = 0; i < 30; i++) {
        report_at(&e, RESTED_NS + 2 + i * 50000000, 0.005, true); /* for 1.45 s */
    }
    CHECK(e.state.bias_stamp_ns == RESTED_NS && fabs(e.state.yaw_rad - yaw_rad) < 0.01);
    report_at(&e, RESTED_NS + 2 + 1500000000, 0.005, true);
    CHECK(e.state.bias_stamp_ns == RESTED_NS + 2 + 1500000000);
}

static void a_moment_without_a_known_angle_begins_a_new_turn(void)
{
    double turn_rad, variance_rad2;
    exact e = at_rest(0.0);
    report_at(&e, RESTED_NS + 1, 0.2, false);
    int64_t received_ns = e.state.stamp_ns;
    CHECK(!gyro_turn(&e.state, &e.config, received_ns, &turn_rad, &variance_rad2));
    CHECK(gyro_turn(&e.state, &e.config, received_ns, &turn_rad, &variance_rad2));
    CHECK(!gyro_turn(&e.state, &e.config, received_ns + 600000000, &turn_rad, &variance_rad2));
    CHECK(!gyro_turn(&e.state, &e.config, received_ns + 1, &turn_rad, &variance_rad2));
    CHECK(gyro_turn(&e.state, &e.config, received_ns + 2, &turn_rad, &variance_rad2));
}

static void a_base_that_stands_has_turned_by_zero_with_certainty(void)
{
    double turn_rad, variance_rad2 = -1.0;
    exact e = at_rest(0.001);
    CHECK(!gyro_turn(&e.state, &e.config, RESTED_NS, &turn_rad, &variance_rad2));
    report_at(&e, RESTED_NS + 50000000, 0.001, true);
    report_at(&e, RESTED_NS + 100000000, 0.001, true);
    CHECK(gyro_turn(&e.state, &e.config, RESTED_NS + 100000000, &turn_rad, &variance_rad2));
    CHECK(e.state.still == 1 && turn_rad == 0.0 && variance_rad2 == 0.0);
}

static void the_variance_of_a_turn_is_of_its_noise_its_scale_and_the_age_of_its_zero(void)
{
    double turn_rad, variance_rad2;
    exact e = at_rest(0.001);
    e.config.turn_variance_rad2_per_rad = 3e-7;
    for (int64_t at_ns = RESTED_NS + 100000000; at_ns <= RESTED_NS + 10000000000;
         at_ns += 100000000) {
        report_at(&e, at_ns, 0.5, false);
    }
    CHECK(!gyro_turn(&e.state, &e.config, RESTED_NS + 9800000000, &turn_rad, &variance_rad2));
    CHECK(gyro_turn(&e.state, &e.config, RESTED_NS + 9900000000, &turn_rad, &variance_rad2));
    CHECK(gyro_turn(&e.state, &e.config, RESTED_NS + 10000000000, &turn_rad, &variance_rad2));
    double zero_rad2_s2 = e.state.bias_variance_rad2_s2 + 1e-9 * 10.0;
    double wanted_rad2 = 0.1 * (1e-7 + 2.0 * zero_rad2_s2 * 10.0) + 3e-7 * fabs(turn_rad);
    CHECK(fabs(turn_rad - 0.05) < 1e-4 && fabs(variance_rad2 / wanted_rad2 - 1.0) < 1e-9);
}

static void a_turn_against_the_wheels_beyond_a_quarter_and_one_radian_means_reversed(void)
{
    gyro_state state;
    gyro_init(&state);
    for (int i = 0; i < 100; i++) {
        CHECK(!gyro_reversed(&state, 0.2, 0.2)); /* in the same direction, with any size of steps */
    }
    CHECK(!gyro_reversed(&state, 1.0, -0.25) && state.opposed_rad == 0.0);
    CHECK(!gyro_reversed(&state, 1.0, -0.245) && state.opposed_rad == 0.0);
    /* exactly one radian */
    CHECK(!gyro_reversed(&state, 0.5, -0.1275) && !gyro_reversed(&state, 0.5, -0.1275));
    CHECK(state.opposed_rad == 1.0 && gyro_reversed(&state, 1e-6, -1e-6));
}

static void the_newest_sample_crosses_the_exchange(void)
{
    static exchange x;
    imu_sample in = {.stamp_ns = 7, .angular_rad_s = {1.0, 2.0, 3.0}}, out;
    exchange_init(&x);
    CHECK(exchange_take_imu(&x, &out) == 0 && out.stamp_ns == 0);
    exchange_put_imu(&x, &in);
    CHECK(exchange_take_imu(&x, &out) == 1 && memcmp(&in, &out, sizeof in) == 0);
    CHECK(exchange_take_imu(&x, &out) == 0 && memcmp(&in, &out, sizeof in) == 0);
}

int main(void)
{
    the_turn_is_the_rate_times_the_time();
    an_incomplete_angle_is_no_turn();
    the_zero_is_the_mean_of_a_second_that_begins_when_the_chassis_has_come_to_rest();
    turning_wheels_restart_the_time_of_rest();
    a_base_that_moves_gives_no_zero();
    hostile_samples_leave_finite_numbers();
    turning_against_the_wheels_is_remembered();
    the_zero_takes_twenty_samples_and_a_second_after_half_a_second();
    the_noise_is_the_samples_variance_and_may_be_as_great_as_is_allowed();
    a_zero_may_be_as_far_off_as_is_allowed_and_the_rate_follows_it();
    a_mean_that_is_more_than_a_fiftieth_off_is_a_slow_turn();
    it_counts_as_still_within_a_hundredth_or_five_deviations_of_its_noise();
    rates_and_stamps_are_taken_to_the_end_of_their_range();
    a_gap_as_long_as_the_timeout_is_still_allowed();
    a_broken_integral_is_stale_at_once_and_restarts_its_rest();
    a_moment_without_a_known_angle_begins_a_new_turn();
    a_base_that_stands_has_turned_by_zero_with_certainty();
    the_variance_of_a_turn_is_of_its_noise_its_scale_and_the_age_of_its_zero();
    a_turn_against_the_wheels_beyond_a_quarter_and_one_radian_means_reversed();
    the_newest_sample_crosses_the_exchange();
    return checks_report("test_gyro");
}
