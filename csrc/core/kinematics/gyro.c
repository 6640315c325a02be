/* SPDX-License-Identifier: Apache-2.0
 *
 * gyro.c: the turn of the base between two moments, from the yaw rate of a sensor. Time is an
 * argument.
 *
 * Heading from the gyro, distance from the wheels: Borenstein & Feng, Gyrodometry: a new method for
 * combining data from gyros and odometry in mobile robots, ICRA 1996. The zero-rate offset is
 * estimated while the base stands still, as in the zero-velocity updates of inertial navigation
 * (Groves, Principles of GNSS, Inertial, and Multisensor Integrated Navigation Systems, 2nd ed.,
 * 15.3), by a Kalman filter of one state whose truth wanders.
 */
#include <math.h>

#include "fresh.h"
#include "rt.h"

static const double RATE_MAX_RAD_S = 100.0; /* no base turns so fast */
static const int64_t SETTLE_NS = 500000000; /* time for which the chassis may swing after the wheels
                                               rest */
static const int64_t WINDOW_NS = 1000000000;
static const uint64_t WINDOW_SAMPLES_MIN = 20;
/* Drift of the zero: by 1e-3 rad/s in a quarter of an hour, like that of cheap sensors when they
 * warm up. */
static const double BIAS_WANDER_RAD2_S3 = 1e-9;
/* Greatest change of a known zero. A greater one is a slow turn: someone moves the robot. */
static const double BIAS_STEP_MAX_RAD_S = 0.02;
/* limit for a base that stands: this rate, or this many deviations of the noise */
static const double STILL_RAD_S = 0.01;
static const double STILL_DEVIATIONS = 5.0;
static const double OPPOSED_MAX_RAD = 1.0; /* wheels and gyro may turn against each other by this:
                                              more is not slip */
static const double OPPOSED_PART = 0.25;   /* part of the wheels' turn; a smaller turn of the gyro
                                              is noise */

void gyro_init(gyro_state *state)
{
    *state = (gyro_state){0};
}

static double seconds(int64_t later_ns, int64_t earlier_ns)
{
    return (double)(later_ns - earlier_ns) * 1e-9;
}

static void begin_window(gyro_state *state, int64_t now_ns)
{
    state->window_since_ns = now_ns;
    state->window_mean_rad_s = state->window_squares_rad2_s2 = 0.0;
    state->window_samples = 0;
}

/* Begin a new integral: a part of the turn is unknown. */
static void break_integral(gyro_state *state)
{
    state->epoch++;
    state->stamp_ns = 0;
    state->still = 0;
    state->still_since_ns = 0;
}

void gyro_lose(gyro_state *state)
{
    if (state->stamp_ns != 0) {
        break_integral(state);
    }
}

static bool is_number(const imu_sample *sample)
{
    return fabs(sample->angular_rad_s[2]) <= RATE_MAX_RAD_S; /* NaN is not a valid rate */
}

/* Estimate the offset: the mean over a second at rest measures it. */
static void estimate(gyro_state *state, const gyro_config *config, int64_t now_ns)
{
    double samples = (double)state->window_samples, mean_rad_s = state->window_mean_rad_s;
    double variance_rad2_s2 = state->window_squares_rad2_s2 / (samples - 1.0);
    bool known = state->bias_stamp_ns != 0;
    if (variance_rad2_s2 > config->still_variance_rad2_s2 ||
        fabs(mean_rad_s) > config->bias_max_rad_s ||
        (known && fabs(mean_rad_s - state->bias_rad_s) > BIAS_STEP_MAX_RAD_S)) {
        return;
    }
    double measured_rad2_s2 = variance_rad2_s2 / samples + BIAS_WANDER_RAD2_S3;
    double before_rad2_s2 = state->bias_variance_rad2_s2;
    if (known) {
        before_rad2_s2 += BIAS_WANDER_RAD2_S3 * seconds(now_ns, state->bias_stamp_ns);
    }
    double gain = known ? before_rad2_s2 / (before_rad2_s2 + measured_rad2_s2) : 1.0;
    double step_rad_s = gain * (mean_rad_s - state->bias_rad_s);
    state->bias_rad_s += step_rad_s;
    state->rate_rad_s -= step_rad_s;
    state->bias_variance_rad2_s2 = known ? (1.0 - gain) * before_rad2_s2 : measured_rad2_s2;
    state->rate_variance_rad2_s2 = variance_rad2_s2;
    state->bias_stamp_ns = now_ns;
}

/* Add a sample to mean and variance: Welford, Note on a method for calculating corrected sums of
 * squares and products, Technometrics 4(3), 1962. */
static void gather(gyro_state *state, double raw_rad_s)
{
    double distance_rad_s = raw_rad_s - state->window_mean_rad_s;
    state->window_samples++;
    state->window_mean_rad_s += distance_rad_s / (double)state->window_samples;
    state->window_squares_rad2_s2 += distance_rad_s * (raw_rad_s - state->window_mean_rad_s);
}

static void watch_rest(gyro_state *state, const gyro_config *config, double raw_rad_s)
{
    int64_t now_ns = state->stamp_ns;
    if (state->still_since_ns == 0) {
        state->still_since_ns = now_ns;
        begin_window(state, now_ns + SETTLE_NS);
    }
    if (now_ns < state->still_since_ns + SETTLE_NS) {
        return;
    }
    gather(state, raw_rad_s);
    if (now_ns - state->window_since_ns >= WINDOW_NS &&
        state->window_samples >= WINDOW_SAMPLES_MIN) {
        estimate(state, config, now_ns);
        begin_window(state, now_ns);
    }
    double limit_rad_s = STILL_DEVIATIONS * sqrt(state->rate_variance_rad2_s2);
    state->still =
        state->bias_stamp_ns != 0 &&
        fabs(state->rate_rad_s) <= (limit_rad_s > STILL_RAD_S ? limit_rad_s : STILL_RAD_S);
}

static void integrate(gyro_state *state, const gyro_config *config, const imu_sample *sample)
{
    double rate_rad_s = sample->angular_rad_s[2] - state->bias_rad_s;
    double elapsed_s = seconds(sample->stamp_ns, state->stamp_ns);
    if (state->stamp_ns != 0 && elapsed_s > config->timeout_s) {
        break_integral(state);
    }
    if (state->stamp_ns != 0) {
        state->yaw_rad += 0.5 * (state->rate_rad_s + rate_rad_s) * elapsed_s; /* trapezoidal rule */
    }
    state->rate_rad_s = rate_rad_s;
    state->stamp_ns = sample->stamp_ns;
}

void gyro_take(gyro_state *state, const gyro_config *config, const imu_sample *sample,
               int64_t now_ns, bool wheels_rest)
{
    if (!wheels_rest) {
        state->still = 0;
        state->still_since_ns = 0;
    }
    if (sample->stamp_ns == state->seen_stamp_ns) {
        return;
    }
    state->seen_stamp_ns = sample->stamp_ns;
    if (sample->epoch != state->sensor_epoch || sample->saturated != 0) {
        break_integral(state);
    }
    state->sensor_epoch = sample->epoch;
    bool in_order =
        sample->stamp_ns > state->stamp_ns && fresh_within(now_ns, sample->stamp_ns, INT64_MAX);
    if (!in_order || sample->saturated != 0 || !is_number(sample)) {
        state->refused++;
        return;
    }
    integrate(state, config, sample);
    if (wheels_rest) {
        watch_rest(state, config, sample->angular_rad_s[2]);
    }
}

/* Whether the newest sample is near enough to a moment to give the rate there. */
static bool near(const gyro_state *state, const gyro_config *config, int64_t moment_ns)
{
    return state->stamp_ns != 0 && fabs(seconds(moment_ns, state->stamp_ns)) <= config->timeout_s;
}

bool gyro_turn(gyro_state *state, const gyro_config *config, int64_t moment_ns, double *turn_rad,
               double *variance_rad2)
{
    if (state->bias_stamp_ns == 0 || !near(state, config, moment_ns)) {
        state->referenced = 0;
        return false;
    }
    /* The part extrapolated beyond the newest sample is subtracted by the next call: it does not
     * add up. */
    double yaw_rad = state->yaw_rad + state->rate_rad_s * seconds(moment_ns, state->stamp_ns);
    bool known =
        state->referenced && state->used_epoch == state->epoch && moment_ns >= state->used_ns;
    double elapsed_s = known ? seconds(moment_ns, state->used_ns) : 0.0;
    *turn_rad = known && !state->still ? yaw_rad - state->used_rad : 0.0;
    state->used_rad = yaw_rad;
    state->used_ns = moment_ns;
    state->used_epoch = state->epoch;
    state->referenced = 1;
    /* The offset's error is the same at all times since its estimate, so its part of the heading's
     * variance is (error t)^2: 2 error^2 t dt more in dt. */
    double since_s = fabs(seconds(moment_ns, state->bias_stamp_ns));
    double bias_rad2_s2 = state->bias_variance_rad2_s2 + BIAS_WANDER_RAD2_S3 * since_s;
    *variance_rad2 =
        state->still
            ? 0.0
            : elapsed_s * (config->heading_variance_rad2_per_s + 2.0 * bias_rad2_s2 * since_s) +
                  config->turn_variance_rad2_per_rad * fabs(*turn_rad);
    return known;
}

bool gyro_reversed(gyro_state *state, double wheels_rad, double gyro_rad)
{
    bool against = wheels_rad * gyro_rad < 0.0 && fabs(gyro_rad) > OPPOSED_PART * fabs(wheels_rad);
    if (against) {
        state->opposed_rad += fabs(wheels_rad);
    } else {
        state->opposed_rad = fmax(state->opposed_rad - fabs(wheels_rad), 0.0);
    }
    if (state->opposed_rad > OPPOSED_MAX_RAD) {
        state->reversed = 1;
    }
    return state->reversed != 0;
}

uint32_t gyro_status(const gyro_state *state, const gyro_config *config, int64_t now_ns)
{
    if (config->used == 0 || (state->stamp_ns == 0 && state->epoch == 0)) {
        return GYRO_NONE;
    }
    if (state->reversed) {
        return GYRO_REVERSED;
    }
    if (!near(state, config, now_ns)) {
        return GYRO_STALE;
    }
    return state->bias_stamp_ns == 0 ? GYRO_UNBIASED : GYRO_USED;
}
