/* SPDX-License-Identifier: Apache-2.0
 *
 * odometry.c: from counters to a pose with its uncertainty.
 *
 * Each joint gathers its travel from its own samples; when every joint that is heard has brought one, the
 * gathered travel is integrated as one exact arc. Where a counter cannot say how far a wheel has gone (it
 * jumped, its origin moved, there is none), the drive's measured velocity stands in, and `degraded` says so.
 */
#include "core.h"

#include <math.h>

/* A wheel may turn faster than its configured limit (downhill, pushed) without its counter being called wrong. */
static const double JUMP_MARGIN = 1.5;
static const double JUMP_SLACK_COUNTS = 4.0;

/* joint_odometry.fresh: what came since the last integration; the worst of several counts. */
enum { NOTHING = 0, TRAVEL = 1, ESTIMATE = 2, SEED = 3 };

typedef struct {
    double travel_m[2];         /* left, right: sums, then means */
    uint32_t joints[2];         /* that brought a travel */
    int64_t stamp_ns;           /* newest */
    uint32_t degraded;
} arc;

/* What the base did, with the variances of what is not known of it. */
typedef struct {
    double distance_m;
    double turn_rad;
    double distance_m2;
    double distance_turn_m_rad;
    double turn_rad2;
    double scrub_rad2;          /* of the heading alone */
} motion;

int64_t counter_difference(uint64_t now, uint64_t before, uint32_t bits)
{
    if (bits == 0 || bits > 64)
        return 0;
    uint32_t shift = 64 - bits;
    /* the counter's sign bit becomes the word's; the shift back extends it */
    return (int64_t)((now - before) << shift) >> shift;
}

/* b for a NaN in a: a floor holds */
static double larger(double a, double b)
{
    return a > b ? a : b;
}

static void floor_covariance(odometry_state *state, const core_config *config)
{
    double *p = state->pose_covariance;
    p[0] = larger(p[0], config->pose_variance_floor_m2);
    p[3] = larger(p[3], config->pose_variance_floor_m2);
    p[5] = larger(p[5], config->heading_variance_floor_rad2);
}

static void pose_to_origin(odometry_state *state, const core_config *config)
{
    state->x_m = state->y_m = state->heading_rad = 0.0;
    for (int i = 0; i < 6; i++)
        state->pose_covariance[i] = 0.0;
    floor_covariance(state, config);
}

void odometry_init(odometry_state *state, const core_config *config)
{
    *state = (odometry_state){0};
    gyro_init(&state->gyro);
    for (uint32_t j = 0; j < JOINTS_MAX; j++)
        state->joint[j].velocity_rad_s = NAN;
    pose_to_origin(state, config);
    state->twist_covariance[0] = config->twist_variance_floor_m2_s2;
    state->twist_covariance[2] = config->twist_variance_floor_rad2_s2;
}

void odometry_reset(odometry_state *state, const core_config *config)
{
    pose_to_origin(state, config);
    state->epoch++;
    state->gyro.referenced = 0;
    for (uint32_t j = 0; j < JOINTS_MAX; j++) {
        state->joint[j].pending_rad = 0.0;
        state->joint[j].fresh = NOTHING;
    }
}

bool odometry_finite(const odometry_state *state, uint32_t joint_count)
{
    const double *p = state->pose_covariance, *q = state->twist_covariance;
    /* a sum with an infinity or a NaN in it is one itself */
    double sum = state->x_m + state->y_m + state->heading_rad + state->distance_m + state->turned_rad
        + state->linear_m_s + state->angular_rad_s
        + p[0] + p[1] + p[2] + p[3] + p[4] + p[5] + q[0] + q[1] + q[2]
        + state->gyro.yaw_rad + state->gyro.bias_rad_s + state->gyro.bias_variance_rad2_s2;
    for (uint32_t j = 0; j < joint_count; j++)
        sum += state->joint[j].position_rad + state->joint[j].pending_rad;
    return isfinite(sum);
}

/* How far the wheel went by the drive's own measure, or without one by `otherwise`. After a silence the speed of now says
 * nothing about all of it. */
static double travel_by_velocity(const joint_feedback *sample, double elapsed_s, double timeout_s, double otherwise_rad_s)
{
    double velocity_rad_s = isfinite(sample->velocity_rad_s) ? sample->velocity_rad_s : otherwise_rad_s;
    return velocity_rad_s * (elapsed_s < timeout_s ? elapsed_s : timeout_s);
}

/* Could the counter have gone round unseen in a silence? */
static bool ambiguous(const joint_config *joint, double reach_rad, double elapsed_s, double timeout_s)
{
    return elapsed_s > timeout_s && reach_rad > fabs(joint->rad_per_count) * ldexp(0.5, (int)joint->counter_bits);
}

static void gather(joint_odometry *joint, uint32_t kind, double travel_rad)
{
    joint->pending_rad += travel_rad;
    joint->position_rad += travel_rad;
    joint->fresh = kind > joint->fresh ? kind : joint->fresh;
}

/* One new sample of a joint that has been seeded. */
static void take(joint_odometry *joint, const joint_config *config, const joint_feedback *sample,
                 double setpoint_rad_s, double timeout_s)
{
    double elapsed_s = (double)(sample->stamp_ns - joint->stamp_ns) * 1e-9;
    double top_rad_s = larger(config->velocity_max_rad_s, -config->velocity_min_rad_s);
    double reach_rad = JUMP_MARGIN * top_rad_s * elapsed_s;
    double travel_rad;
    bool known = true;

    if (config->counter_bits == 0) {
        travel_rad = travel_by_velocity(sample, elapsed_s, timeout_s, setpoint_rad_s);
    } else {
        int64_t counts = counter_difference(sample->count, joint->count, config->counter_bits);
        travel_rad = (double)counts * config->rad_per_count;
        known = sample->epoch == joint->epoch && !ambiguous(config, reach_rad, elapsed_s, timeout_s);
        reach_rad += JUMP_SLACK_COUNTS * fabs(config->rad_per_count);
    }
    if (known && !(fabs(travel_rad) <= reach_rad)) {
        joint->jumps++;
        known = false;
    }
    joint->velocity_rad_s = sample->velocity_rad_s;
    if (!isfinite(sample->velocity_rad_s))
        joint->velocity_rad_s = known && config->counter_bits != 0 ? travel_rad / elapsed_s : NAN;
    if (!known) {
        travel_rad = travel_by_velocity(sample, elapsed_s, timeout_s, 0.0);
        if (!(fabs(travel_rad) <= reach_rad))
            travel_rad = 0.0;
    }
    gather(joint, known && config->counter_bits != 0 ? TRAVEL : ESTIMATE, travel_rad);
}

static void take_if_new(joint_odometry *joint, const joint_config *config, const joint_feedback *sample,
                        double setpoint_rad_s, double timeout_s)
{
    if (sample->stamp_ns <= joint->stamp_ns)
        return;
    if (joint->seeded) {
        take(joint, config, sample, setpoint_rad_s, timeout_s);
    } else {
        gather(joint, SEED, 0.0);
        joint->velocity_rad_s = isfinite(sample->velocity_rad_s) ? sample->velocity_rad_s : NAN;
    }
    joint->seeded = 1;
    joint->count = sample->count;
    joint->stamp_ns = sample->stamp_ns;
    joint->epoch = sample->epoch;
}

/* Empties the joints into one arc. A joint left out seeds again, for its side has gone on without it. */
static arc collect(odometry_state *state, const core_config *config, const uint32_t *stale)
{
    arc found = {0};
    for (uint32_t j = 0; j < config->joint_count; j++) {
        joint_odometry *joint = &state->joint[j];
        uint32_t right = config->joint[j].side > 0.0;
        if (stale[j]) {
            joint->seeded = 0;
            found.degraded = 1;
        } else if (joint->fresh == SEED) {
            found.degraded |= joint->pending_rad != 0.0; /* only part of the way is known: thrown away */
        } else {
            found.travel_m[right] += joint->pending_rad * config->joint[j].wheel_radius_m;
            found.joints[right]++;
            found.degraded |= joint->fresh == ESTIMATE;
        }
        if (!stale[j] && joint->stamp_ns > found.stamp_ns)
            found.stamp_ns = joint->stamp_ns;
        joint->pending_rad = 0.0;
        joint->fresh = NOTHING;
    }
    for (int side = 0; side < 2; side++)
        if (found.joints[side] != 0)
            found.travel_m[side] /= found.joints[side];
    return found;
}

/* sin(h) / h, without the cancellation near zero; the first term left out is below 1e-18 */
static double sine_over(double half_rad)
{
    double q = half_rad * half_rad;
    if (q < 0.01)
        return 1.0 - q / 6.0 * (1.0 - q / 20.0 * (1.0 - q / 42.0 * (1.0 - q / 72.0 * (1.0 - q / 110.0))));
    double sine, cosine;
    angle_sine_cosine(angle_wrap(half_rad), &sine, &cosine);
    return sine / half_rad;
}

static motion by_wheels(const core_config *config, const arc *found)
{
    double left_m = found->travel_m[0], right_m = found->travel_m[1];
    double left_m2 = config->distance_variance_m2_per_m * fabs(left_m);
    double right_m2 = config->distance_variance_m2_per_m * fabs(right_m);
    double over_track = 1.0 / config->track_m;
    return (motion){
        .distance_m = 0.5 * (left_m + right_m),
        .turn_rad = (right_m - left_m) / config->track_m,
        .distance_m2 = 0.25 * (right_m2 + left_m2),
        .distance_turn_m_rad = 0.5 * (right_m2 - left_m2) * over_track,
        .turn_rad2 = (right_m2 + left_m2) * over_track * over_track,
        .scrub_rad2 = config->turn_variance_rad2_per_rad * fabs(right_m - left_m) * over_track,
    };
}

/* The way is the wheels', the turn the gyro's: their errors have nothing to do with each other. */
static void turn_by_gyro(odometry_state *state, const core_config *config, int64_t moment_ns, motion *moved)
{
    double turn_rad, variance_rad2;
    state->by_gyro = config->gyro.used && gyro_turn(&state->gyro, &config->gyro, moment_ns, &turn_rad, &variance_rad2)
        && !gyro_reversed(&state->gyro, moved->turn_rad, turn_rad);
    if (!state->by_gyro)
        return;
    moved->turn_rad = turn_rad;
    moved->turn_rad2 = variance_rad2;
    moved->distance_turn_m_rad = moved->scrub_rad2 = 0.0;
}

/* Siegwart & Nourbakhsh, Autonomous Mobile Robots, 5.2.4: the errors of way and turn are carried into the pose by the
 * Jacobians of the motion; the scrub of turning is added to the heading. */
static void grow_pose_covariance(odometry_state *state, const core_config *config, const motion *moved,
                                 double sine, double cosine)
{
    double *p = state->pose_covariance;
    double a = -moved->distance_m * sine, b = moved->distance_m * cosine;
    double xx = p[0] + a * (2.0 * p[2] + a * p[5]);
    double xy = p[1] + a * p[4] + b * p[2] + a * b * p[5];
    double xh = p[2] + a * p[5];
    double yy = p[3] + b * (2.0 * p[4] + b * p[5]);
    double yh = p[4] + b * p[5];

    /* half of the turn's error is there in the middle of the arc, whose direction the way has */
    double turn_x = 0.5 * a, turn_y = 0.5 * b;
    double ss = moved->distance_m2, st = moved->distance_turn_m_rad, tt = moved->turn_rad2;
    p[0] = xx + ss * cosine * cosine + 2.0 * st * cosine * turn_x + tt * turn_x * turn_x;
    p[1] = xy + ss * cosine * sine + st * (cosine * turn_y + sine * turn_x) + tt * turn_x * turn_y;
    p[2] = xh + st * cosine + tt * turn_x;
    p[3] = yy + ss * sine * sine + 2.0 * st * sine * turn_y + tt * turn_y * turn_y;
    p[4] = yh + st * sine + tt * turn_y;
    p[5] += tt + moved->scrub_rad2;
    floor_covariance(state, config);
}

static void measure_twist(odometry_state *state, const core_config *config, const motion *moved, double elapsed_s)
{
    double per_s2 = 1.0 / (elapsed_s * elapsed_s);
    state->linear_m_s = moved->distance_m / elapsed_s;
    state->angular_rad_s = moved->turn_rad / elapsed_s;
    state->twist_covariance[0] = config->twist_variance_floor_m2_s2 + moved->distance_m2 * per_s2;
    state->twist_covariance[1] = moved->distance_turn_m_rad * per_s2;
    state->twist_covariance[2] = config->twist_variance_floor_rad2_s2 + (moved->turn_rad2 + moved->scrub_rad2) * per_s2;
    if (state->by_gyro) {
        state->angular_rad_s = state->gyro.still ? 0.0 : state->gyro.rate_rad_s;
        state->twist_covariance[2] = config->twist_variance_floor_rad2_s2 + state->gyro.rate_variance_rad2_s2;
    }
}

static void integrate(odometry_state *state, const core_config *config, const uint32_t *stale)
{
    arc found = collect(state, config, stale);
    int64_t before_ns = state->stamp_ns;
    state->degraded = found.degraded;
    if (found.stamp_ns > before_ns)
        state->stamp_ns = found.stamp_ns;
    if (found.joints[0] == 0 || found.joints[1] == 0) {
        /* one side has only just been seeded: what the other has gone alone is no arc */
        state->degraded |= found.joints[0] != found.joints[1];
        return;
    }
    motion moved = by_wheels(config, &found);
    turn_by_gyro(state, config, state->stamp_ns, &moved);
    double chord_m = moved.distance_m * sine_over(0.5 * moved.turn_rad);
    double sine, cosine;
    angle_sine_cosine(angle_wrap(state->heading_rad + 0.5 * moved.turn_rad), &sine, &cosine);

    state->x_m += chord_m * cosine;
    state->y_m += chord_m * sine;
    state->heading_rad = angle_wrap(state->heading_rad + moved.turn_rad);
    state->distance_m += fabs(moved.distance_m);
    state->turned_rad += fabs(moved.turn_rad);
    grow_pose_covariance(state, config, &moved, sine, cosine);
    if (before_ns > 0 && found.stamp_ns > before_ns)
        measure_twist(state, config, &moved, (double)(found.stamp_ns - before_ns) * 1e-9);
}

static bool both_sides_heard(const core_config *config, const uint32_t *stale)
{
    bool heard[2] = {false, false};
    for (uint32_t j = 0; j < config->joint_count; j++)
        if (!stale[j])
            heard[config->joint[j].side > 0.0] = true;
    return heard[0] && heard[1];
}

void odometry_step(odometry_state *state, const core_config *config, const joint_feedback *feedback,
                   const uint32_t *stale, const double *setpoint_rad_s)
{
    bool complete = true, any_stale = false;
    for (uint32_t j = 0; j < config->joint_count; j++) {
        joint_odometry *joint = &state->joint[j];
        if (stale[j]) {
            any_stale = true;
            continue;
        }
        take_if_new(joint, &config->joint[j], &feedback[j], setpoint_rad_s[j], config->feedback_timeout_s);
        if (joint->fresh == NOTHING)
            complete = false;
    }
    if (any_stale)
        state->degraded = 1;
    state->blind = any_stale && !both_sides_heard(config, stale);
    if (complete && !state->blind)
        integrate(state, config, stale);
}

void odometry_drift(odometry_state *state, const core_config *config, const double *setpoint_rad_s, double dt_s)
{
    double side_m[2] = {0.0, 0.0};
    for (uint32_t j = 0; j < config->joint_count; j++) {
        double travel_m = fabs(setpoint_rad_s[j]) * config->joint[j].wheel_radius_m * dt_s;
        uint32_t right = config->joint[j].side > 0.0;
        side_m[right] = larger(side_m[right], travel_m);
    }
    double distance_m = 0.5 * (side_m[0] + side_m[1]);
    double turn_rad = (side_m[0] + side_m[1]) / config->track_m;
    double *p = state->pose_covariance;
    p[0] += distance_m * (2.0 * sqrt(p[0]) + distance_m);
    p[3] += distance_m * (2.0 * sqrt(p[3]) + distance_m);
    p[5] += turn_rad * (2.0 * sqrt(p[5]) + turn_rad);
    /* the last measured twist is all there is: as uncertain as it is large */
    double linear = state->linear_m_s * state->linear_m_s, angular = state->angular_rad_s * state->angular_rad_s;
    state->twist_covariance[0] = larger(state->twist_covariance[0], config->twist_variance_floor_m2_s2 + linear);
    state->twist_covariance[2] = larger(state->twist_covariance[2], config->twist_variance_floor_rad2_s2 + angular);
}
