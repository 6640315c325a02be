/* SPDX-License-Identifier: Apache-2.0
 *
 * speed.c: the measured twist, and its uncertainty. Time is an argument.
 *
 * There are up to two measures of it: the travel over a window, and the speeds that the drives
 * report. The window is the time in which the base's greatest acceleration moves a wheel by one
 * step of its counter: a shorter one shows steps that are no motion, a longer one hides an
 * acceleration that the counter shows (windows by the resolution: Janabi-Sharifi, Hayward & Chen,
 * Discrete-time adaptive windowing for velocity estimation, IEEE Trans. Control Systems Technology
 * 8(6), 2000).
 *
 * What a measure is worth is seen a moment later, when the travel around it is known: the travel to
 * both sides of it, over the time between, is its reference. Both measures are weighed by the
 * inverse of their mean square errors (Bates & Granger, The combination of forecasts, Operational
 * Research Quarterly 20(4), 1969). The covariance is the mean square error of what was published,
 * less that of the reference itself: the error of the travel is the same there, over a longer time.
 */
#include "core.h"

#include <math.h>
#include <string.h>

static const double WINDOW_MAX_S = 0.25;
/* The reference reaches this far to both sides, or as many windows: longer than the window, so that
 * both do not begin at the same step. */
static const double AROUND_S = 0.06;
static const double AROUND_WINDOWS = 1.5;
static const double SEEN_FOR_S = 1.0; /* time constant of the mean square errors */
static const uint32_t SEEN_MAX = 1000;
/* Part of a mean square error that is left whatever the reference explains of it. */
static const double LEFT_PART = 0.2;
/* The looks cover the reference in so many parts; LOOKS are more. */
static const int64_t PARTS = 24;

/* Places of the axes' products, of which the covariance has one each. */
static const int PRODUCT[AXES][AXES] = {{0, 1, 2}, {1, 3, 4}, {2, 4, 5}};

typedef struct {
    double window_s;
    double step2_u2[AXES]; /* variance of the travel by the steps of the counters */
} resolution;

static double larger(double a, double b)
{
    return a > b ? a : b;
}

double counter_step_rad(const joint_odometry *joint, const joint_config *config)
{
    double count_rad = fabs(joint->constant.counter_rad);
    if (config->counter_mantissa_bits == 0 || joint->constant.counter_round_rad == 0.0) {
        return count_rad;
    }
    double count = (double)counter_difference(joint->count, 0, config->counter_bits);
    int exponent;
    (void)frexp(count, &exponent); /* |count| is in 2^(exponent - 1) .. 2^exponent */
    int step = exponent - (int)config->counter_mantissa_bits;
    return step > 0 ? ldexp(count_rad, step) : count_rad;
}

/* Whether the travel of a joint is part of the base's: it is known, and the joint does not steer.
 */
static bool moves_base(const twist_inverse *used, uint32_t joint)
{
    return used->inverse[AXIS_LINEAR][joint] != 0.0 || used->inverse[AXIS_ANGULAR][joint] != 0.0 ||
           used->inverse[AXIS_LATERAL][joint] != 0.0;
}

static resolution resolution_of(const odometry_state *state, const core_config *config)
{
    const axis_limits *linear = &config->limits.linear;
    double acceleration_m_s2 = larger(linear->acceleration_u_s2, linear->deceleration_u_s2);
    double greatest_m = 0.0;
    resolution found = {0};
    for (uint32_t j = 0; j < config->joint_count; j++) {
        if (!moves_base(&state->used, j)) {
            continue;
        }
        double step_m =
            counter_step_rad(&state->joint[j], &config->joint[j]) * config->joint[j].wheel_radius_m;
        greatest_m = larger(greatest_m, step_m);
        for (int i = 0; i < AXES; i++) {
            double share_u = state->used.inverse[i][j] * step_m;
            found.step2_u2[i] += share_u * share_u / 12.0; /* evenly spread over one step */
        }
    }
    double window_s = sqrt(2.0 * greatest_m / acceleration_m_s2);
    found.window_s = window_s < WINDOW_MAX_S ? window_s : WINDOW_MAX_S;
    return found;
}

static const speed_look *look_before(const speed_state *speed, uint32_t back)
{
    return &speed->look[(speed->newest + LOOKS - back) % LOOKS];
}

/* Get the travel at a moment, between the looks around it. false: that was before the first look.
 */
static bool travel_at(const speed_state *speed, const speed_look *now, int64_t stamp_ns,
                      double *travel_u)
{
    const speed_look *later = now;
    for (uint32_t back = 0; back < speed->looks; back++) {
        const speed_look *look = look_before(speed, back);
        if (look->stamp_ns <= stamp_ns) {
            double part =
                (double)(stamp_ns - look->stamp_ns) / (double)(later->stamp_ns - look->stamp_ns);
            for (int i = 0; i < AXES; i++) {
                travel_u[i] = look->travel_u[i] + part * (later->travel_u[i] - look->travel_u[i]);
            }
            return true;
        }
        later = look;
    }
    return false;
}

/* Measure by the travel over the window or, if the samples are rarer, since the last one. Returns
 * the time that the travel took. */
static double by_travel(const speed_state *speed, speed_look *now, double window_s)
{
    double before_u[AXES];
    int64_t begin_ns = now->stamp_ns - (int64_t)(window_s * 1e9);
    const speed_look *last = look_before(speed, 0), *first = look_before(speed, speed->looks - 1);
    begin_ns = begin_ns < last->stamp_ns ? begin_ns : last->stamp_ns;
    if (!travel_at(speed, now, begin_ns, before_u)) {
        begin_ns = first->stamp_ns;
        memcpy(before_u, first->travel_u, sizeof before_u);
    }
    double elapsed_s = (double)(now->stamp_ns - begin_ns) * 1e-9;
    for (int i = 0; i < AXES; i++) {
        now->by_travel_u_s[i] = (now->travel_u[i] - before_u[i]) / elapsed_s;
    }
    return elapsed_s;
}

/* Measure by what the drives report. Nothing is known if one of them reports no possible speed. */
static void by_drives(const odometry_state *state, const core_config *config,
                      const joint_feedback *feedback, speed_look *now)
{
    uint32_t reported = 0;
    for (uint32_t j = 0; j < config->joint_count; j++) {
        double reported_rad_s = feedback[j].velocity_rad_s;
        if (!moves_base(&state->used, j)) {
            continue;
        }
        if (!(fabs(reported_rad_s) <= state->joint[j].constant.reach_rad_s)) {
            return;
        }
        double rim_m_s = reported_rad_s * config->joint[j].wheel_radius_m;
        for (int i = 0; i < AXES; i++) {
            now->by_drives_u_s[i] += state->used.inverse[i][j] * rim_m_s;
        }
        reported = 1;
    }
    now->reported = reported;
}

/* Return a mean square error without that of the reference. */
static double own_part(double seen2, double reference2)
{
    return larger(seen2 - reference2, LEFT_PART * seen2);
}

/* Combine both measures. */
static void combine(const speed_state *speed, const resolution *of, double elapsed_s,
                    speed_look *now)
{
    for (int i = 0; i < AXES; i++) {
        double steps2 = 2.0 * of->step2_u2[i] / (elapsed_s * elapsed_s);
        double travel2 =
            larger(own_part(speed->travel2_u2_s2[i], speed->reference2_u2_s2[i]), steps2);
        double drives2 = own_part(speed->drives2_u2_s2[i], speed->reference2_u2_s2[i]);
        double part = travel2 + drives2 > 0.0 ? travel2 / (travel2 + drives2) : 1.0;
        part = now->reported ? part : 0.0;
        now->twist_u_s[i] =
            now->by_travel_u_s[i] + part * (now->by_drives_u_s[i] - now->by_travel_u_s[i]);
    }
}

/* Update the mean square errors by those of one look. While nothing moves nothing is learnt. */
static void learn(speed_state *speed, const speed_look *look, const double *reference_u_s)
{
    double travel_u_s[AXES], drives_u_s[AXES], twist_u_s[AXES], sum = 0.0;
    for (int i = 0; i < AXES; i++) {
        travel_u_s[i] = look->by_travel_u_s[i] - reference_u_s[i];
        drives_u_s[i] = look->by_drives_u_s[i] - reference_u_s[i];
        twist_u_s[i] = look->twist_u_s[i] - reference_u_s[i];
        sum += fabs(reference_u_s[i]) + fabs(look->by_travel_u_s[i]) + fabs(look->by_drives_u_s[i]);
    }
    if (sum == 0.0) {
        return;
    }
    double elapsed_s = (double)(look->stamp_ns - speed->seen_ns) * 1e-9;
    elapsed_s = elapsed_s < SEEN_FOR_S ? elapsed_s : SEEN_FOR_S;
    speed->seen += speed->seen < SEEN_MAX;
    double part = larger(elapsed_s / (SEEN_FOR_S + elapsed_s), 1.0 / (double)speed->seen);
    for (int i = 0; i < AXES; i++) {
        speed->travel2_u2_s2[i] += part * (travel_u_s[i] * travel_u_s[i] - speed->travel2_u2_s2[i]);
        if (look->reported) {
            speed->drives2_u2_s2[i] +=
                part * (drives_u_s[i] * drives_u_s[i] - speed->drives2_u2_s2[i]);
        }
        for (int k = i; k < AXES; k++) {
            double *product = &speed->twist2_u2_s2[PRODUCT[i][k]];
            *product += part * (twist_u_s[i] * twist_u_s[k] - *product);
        }
    }
}

/* Judge the newest look whose surroundings are known. */
static void judge(speed_state *speed, const resolution *of, double took_s, const speed_look *now)
{
    double around_s = larger(AROUND_S, AROUND_WINDOWS * of->window_s), before_u[AXES];
    int64_t middle_ns = now->stamp_ns - (int64_t)(around_s * 1e9);
    const speed_look *look = NULL;
    for (uint32_t back = 0; back < speed->looks && look == NULL; back++) {
        look = look_before(speed, back)->stamp_ns <= middle_ns ? look_before(speed, back) : NULL;
    }
    if (look == NULL || look->stamp_ns <= speed->seen_ns) {
        return;
    }
    int64_t half_ns = now->stamp_ns - look->stamp_ns;
    if (!travel_at(speed, now, look->stamp_ns - half_ns, before_u)) {
        return;
    }
    double elapsed_s = 2.0 * (double)half_ns * 1e-9, reference_u_s[AXES];
    /* the same error at both ends of a travel, over a longer time */
    double share2 = took_s * took_s / (elapsed_s * elapsed_s);
    for (int i = 0; i < AXES; i++) {
        reference_u_s[i] = (now->travel_u[i] - before_u[i]) / elapsed_s;
        speed->reference2_u2_s2[i] = speed->travel2_u2_s2[i] * share2;
    }
    learn(speed, look, reference_u_s);
    speed->seen_ns = look->stamp_ns;
}

/* Keep the look, unless the last one was only just before it. */
static void keep(speed_state *speed, const resolution *of, const speed_look *now)
{
    double around_s = larger(AROUND_S, AROUND_WINDOWS * of->window_s);
    int64_t least_ns = (int64_t)(around_s * 1e9) / PARTS;
    if (speed->looks != 0 && now->stamp_ns - look_before(speed, 0)->stamp_ns < least_ns) {
        return;
    }
    speed->newest = (speed->newest + 1) % LOOKS;
    speed->look[speed->newest] = *now;
    speed->looks += speed->looks < LOOKS;
}

static void publish(odometry_state *state, const core_config *config, const speed_look *now)
{
    const speed_state *speed = &state->speed;
    const base_limits *limits = &config->limits;
    const axis_limits *axis[AXES] = {&limits->linear, &limits->angular, &limits->lateral};
    double slip2_m2_s2 = state->spread.slip_m_s * state->spread.slip_m_s, covariance[6];
    double part[AXES], floor_u2_s2[AXES] = {config->twist_variance_floor_m2_s2,
                                            config->twist_variance_floor_rad2_s2,
                                            config->twist_variance_floor_m2_s2};
    for (int i = 0; i < AXES; i++) {
        double seen2 = speed->twist2_u2_s2[PRODUCT[i][i]];
        part[i] = seen2 > 0.0 ? own_part(seen2, speed->reference2_u2_s2[i]) / seen2 : 1.0;
    }
    for (int i = 0; i < AXES; i++) {
        for (int k = i; k < AXES; k++) {
            double slip2 = 0.0;
            for (uint32_t j = 0; j < config->joint_count; j++) {
                slip2 += state->used.inverse[i][j] * state->used.inverse[k][j] * slip2_m2_s2;
            }
            covariance[PRODUCT[i][k]] =
                speed->twist2_u2_s2[PRODUCT[i][k]] * sqrt(part[i] * part[k]) + slip2;
        }
        double *own = &covariance[PRODUCT[i][i]];
        if (speed->seen == 0) { /* as much as the speed may have changed meanwhile */
            double change_u_s = axis[i]->acceleration_u_s2 * AROUND_S;
            *own += change_u_s * change_u_s;
        }
        *own += floor_u2_s2[i];
    }
    state->linear_m_s = now->twist_u_s[AXIS_LINEAR];
    state->angular_rad_s = now->twist_u_s[AXIS_ANGULAR];
    state->twist_covariance[0] = covariance[PRODUCT[AXIS_LINEAR][AXIS_LINEAR]];
    state->twist_covariance[1] = covariance[PRODUCT[AXIS_LINEAR][AXIS_ANGULAR]];
    state->twist_covariance[2] = covariance[PRODUCT[AXIS_ANGULAR][AXIS_ANGULAR]];
    if (state->used.strafes) {
        state->lateral_m_s = now->twist_u_s[AXIS_LATERAL];
        state->lateral_covariance[0] = covariance[PRODUCT[AXIS_LINEAR][AXIS_LATERAL]];
        state->lateral_covariance[1] = covariance[PRODUCT[AXIS_LATERAL][AXIS_LATERAL]];
        state->lateral_covariance[2] = covariance[PRODUCT[AXIS_ANGULAR][AXIS_LATERAL]];
    }
}

/* Add the travel from each joint's sample to the newest one, at the last twist: joints are sampled
 * one after another. Steered wheels have no rows; theirs are sampled as one. */
static void align(const odometry_state *state, const core_config *config, double *travel_u)
{
    const double twist_u[AXES] = {state->linear_m_s, state->angular_rad_s, state->lateral_m_s};
    if (!state->twist_known || config->module_count != 0) {
        return;
    }
    for (uint32_t j = 0; j < config->joint_count; j++) {
        const wheel_row *row = &config->joint[j].row;
        double rim_m_s = row->x * twist_u[AXIS_LINEAR] + row->lever_m * twist_u[AXIS_ANGULAR] +
                         row->y * twist_u[AXIS_LATERAL];
        double rim_m = rim_m_s * (double)(state->stamp_ns - state->joint[j].stamp_ns) * 1e-9;
        for (int i = 0; i < AXES; i++) {
            travel_u[i] += state->used.inverse[i][j] * rim_m;
        }
    }
}

void speed_begin(speed_state *speed, int64_t stamp_ns)
{
    speed->looks = stamp_ns != 0;
    speed->look[speed->newest] = (speed_look){.stamp_ns = stamp_ns};
    memcpy(speed->look[speed->newest].travel_u, speed->travel_u, sizeof speed->travel_u);
}

bool speed_take(odometry_state *state, const core_config *config, const joint_feedback *feedback,
                const double *moved_u)
{
    speed_state *speed = &state->speed;
    speed_look now = {.stamp_ns = state->stamp_ns};
    for (int i = 0; i < AXES; i++) {
        now.travel_u[i] = speed->travel_u[i] += moved_u[i];
    }
    align(state, config, now.travel_u);
    if (speed->looks != 0 && now.stamp_ns <= look_before(speed, 0)->stamp_ns) {
        return false;
    }
    resolution of = resolution_of(state, config);
    bool known = speed->looks != 0;
    if (known) {
        double elapsed_s = by_travel(speed, &now, of.window_s);
        by_drives(state, config, feedback, &now);
        combine(speed, &of, elapsed_s, &now);
        judge(speed, &of, elapsed_s, &now);
        publish(state, config, &now);
    }
    keep(speed, &of, &now);
    return known;
}
