/* SPDX-License-Identifier: Apache-2.0
 * Every line of the gyro's part of the core, for the sanitizers, with hostile samples. What it promises is tested in
 * tests/rt/test_gyro.py. */
#include "check.h"
#include "exchange.h"

#include <math.h>
#include <string.h>

static const int64_t SAMPLE_NS = 5000000;
static const int64_t START_NS = 1000000000;
static const gyro_config CONFIG = {
    .used = 1, .timeout_s = 0.05, .bias_max_rad_s = 0.5, .still_variance_rad2_s2 = 1e-4,
    .heading_variance_rad2_per_s = 1e-7, .turn_variance_rad2_per_rad = 1e-4,
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

/* `samples` times this rate. */
static void say(sensor *s, double rate_rad_s, int samples, bool wheels_rest)
{
    for (int i = 0; i < samples; i++) {
        s->now_ns += SAMPLE_NS;
        imu_sample sample = {.stamp_ns = s->now_ns, .angular_rad_s = {0.0, 0.0, rate_rad_s}, .epoch = s->epoch};
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
    CHECK(!turned(&s, &turn_rad));                   /* from when on? */
    CHECK(turned(&s, &turn_rad) && turn_rad == 0.0);
    CHECK(s.state.still == 1);
    gyro_state before = s.state;                     /* the newest sample once more: no news */
    s.now_ns -= SAMPLE_NS;
    say(&s, 9.0, 1, true);
    CHECK(memcmp(&before, &s.state, sizeof before) == 0);
    say(&s, 0.6, 200, false);
    CHECK(turned(&s, &turn_rad) && fabs(turn_rad - 0.5) < 0.002);
    s.now_ns += SAMPLE_NS;                           /* beyond the newest sample: as it went on */
    CHECK(turned(&s, &turn_rad) && fabs(turn_rad - 0.5 * 0.005) < 1e-12);
    s.now_ns += 20 * SAMPLE_NS;
    CHECK(!turned(&s, &turn_rad));
    CHECK(gyro_status(&s.state, &CONFIG, s.now_ns) == GYRO_STALE);
    say(&s, 0.6, 2, false);                          /* after a gap it begins anew */
    CHECK(!turned(&s, &turn_rad));
    CHECK(turned(&s, &turn_rad));
    say(&s, 0.1, 1000, true);                        /* the zero is measured again */
    CHECK(fabs(s.state.bias_rad_s - 0.1) < 1e-6);
    CHECK(gyro_status(&s.state, &(gyro_config){0}, s.now_ns) == GYRO_NONE);
}

/* Moving at 0.5 rad/s more than its zero, its turn asked for; then what breaks the way. */
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

static void a_part_of_the_way_that_is_not_known_is_no_turn(void)
{
    sensor s = on_the_move();
    s.epoch++;                                       /* another sensor, or the same after its start */
    say(&s, 0.6, 2, false);
    is_broken_once(&s);
    s = on_the_move();
    imu_sample sample = {.stamp_ns = s.now_ns + 1, .angular_rad_s = {0.0, 0.0, 0.6}, .saturated = 1};
    gyro_take(&s.state, &CONFIG, &sample, s.now_ns + 1, false);
    say(&s, 0.6, 1, false);
    is_broken_once(&s);
    s = on_the_move();
    s.now_ns += 20 * SAMPLE_NS;                      /* it was silent for longer than its timeout */
    say(&s, 0.6, 1, false);
    is_broken_once(&s);
    CHECK(s.state.refused == 0);
    sample = (imu_sample){.stamp_ns = s.now_ns + 20000000, .angular_rad_s = {0.0, 0.0, 0.6}};
    gyro_take(&s.state, &CONFIG, &sample, s.now_ns, false);
    CHECK(s.state.refused == 1);                     /* of the future */
}

static void the_zero_is_the_mean_of_a_second_that_begins_when_the_chassis_has_come_to_rest(void)
{
    sensor s = new_sensor();
    say(&s, 0.4, 90, true);                          /* it swings on */
    for (int i = 0; i < 220; i++)
        say(&s, i % 2 == 0 ? 0.101 : 0.099, 1, true);
    CHECK(s.state.bias_stamp_ns != 0 && fabs(s.state.bias_rad_s - 0.1) < 1e-4);
    double variance_rad2_s2 = 1e-6, mean_variance_rad2_s2 = variance_rad2_s2 / 200.0 + 1e-9;
    CHECK(fabs(s.state.rate_variance_rad2_s2 / variance_rad2_s2 - 1.0) < 0.02);
    CHECK(fabs(s.state.bias_variance_rad2_s2 / mean_variance_rad2_s2 - 1.0) < 0.02);
    for (int i = 0; i < 200; i++)                    /* a second more: as good as the first, and a little wander */
        say(&s, i % 2 == 0 ? 0.101 : 0.099, 1, true);
    double before = mean_variance_rad2_s2 + 1e-9, after = before * mean_variance_rad2_s2 / (before + mean_variance_rad2_s2);
    CHECK(fabs(s.state.bias_variance_rad2_s2 / after - 1.0) < 0.02);
    CHECK(s.state.still == 1);
}

static void wheels_that_turn_begin_the_rest_anew(void)
{
    sensor s = new_sensor();
    say(&s, 0.0, 250, true);                         /* 1.25 s of the 1.5 that it takes */
    say(&s, 0.0, 1, false);
    say(&s, 0.0, 250, true);
    CHECK(s.state.bias_stamp_ns == 0);
    say(&s, 0.0, 60, true);
    CHECK(s.state.bias_stamp_ns != 0 && s.state.still == 1);
    say(&s, 0.5, 1, true);                           /* the wheels rest, and somebody turns it */
    CHECK(s.state.still == 0);
}

static void no_zero_of_a_base_that_moves(void)
{
    sensor s = new_sensor();
    say(&s, 0.6, 1000, true);                        /* too much for a zero */
    CHECK(gyro_status(&s.state, &CONFIG, s.now_ns) == GYRO_UNBIASED);
    for (int i = 0; i < 1000; i++)
        say(&s, i % 2 == 0 ? 0.1 : -0.1, 1, true);   /* shaken */
    CHECK(s.state.bias_stamp_ns == 0);
    say(&s, 0.0, 1000, true);
    int64_t known_ns = s.state.bias_stamp_ns;
    CHECK(known_ns != 0);
    say(&s, 0.05, 1000, true);                       /* turned slowly */
    CHECK(s.state.bias_stamp_ns == known_ns && s.state.still == 0);
}

static void hostile_samples_leave_finite_numbers(void)
{
    static const double RATES[] = {NAN, INFINITY, -INFINITY, 1e300, -1e300, 99.0, 0.0};
    static const int64_t STAMPS[] = {0, 1, -1, INT64_MAX, INT64_MIN, START_NS, START_NS + 1};
    sensor s = new_sensor();
    say(&s, 0.0, 400, true);
    for (size_t r = 0; r < sizeof RATES / sizeof RATES[0]; r++)
        for (size_t t = 0; t < sizeof STAMPS / sizeof STAMPS[0]; t++)
            for (uint32_t saturated = 0; saturated < 2; saturated++) {
                imu_sample sample = {.stamp_ns = STAMPS[t], .angular_rad_s = {NAN, NAN, RATES[r]},
                                     .saturated = saturated, .epoch = (uint32_t)t};
                double turn_rad = 0.0;
                gyro_take(&s.state, &CONFIG, &sample, s.now_ns, saturated != 0);
                say(&s, RATES[r], 2, false);
                (void)turned(&s, &turn_rad);
                CHECK(isfinite(turn_rad) && isfinite(s.state.yaw_rad) && isfinite(s.state.bias_rad_s));
            }
    CHECK(s.state.refused > 0);
}

static void turning_against_the_wheels_is_remembered(void)
{
    sensor s = new_sensor();
    say(&s, 0.0, 400, true);
    CHECK(!gyro_reversed(&s.state, 0.9, -0.9) && !gyro_reversed(&s.state, 0.5, 0.5));
    CHECK(!gyro_reversed(&s.state, 3.0, -0.01));     /* noise */
    CHECK(gyro_reversed(&s.state, -1.1, 1.1) && gyro_reversed(&s.state, 9.0, 9.0));
    CHECK(gyro_status(&s.state, &CONFIG, s.now_ns) == GYRO_REVERSED);
    s = new_sensor();
    for (int i = 0; i < 10; i++)                     /* as often with them: a wheel slipped */
        CHECK(!gyro_reversed(&s.state, 0.6, -0.6) && !gyro_reversed(&s.state, 0.6, 0.6));
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
    a_part_of_the_way_that_is_not_known_is_no_turn();
    the_zero_is_the_mean_of_a_second_that_begins_when_the_chassis_has_come_to_rest();
    wheels_that_turn_begin_the_rest_anew();
    no_zero_of_a_base_that_moves();
    hostile_samples_leave_finite_numbers();
    turning_against_the_wheels_is_remembered();
    the_newest_sample_crosses_the_exchange();
    return checks_report("test_gyro");
}
