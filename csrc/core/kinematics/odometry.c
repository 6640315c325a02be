/* SPDX-License-Identifier: Apache-2.0
 *
 * odometry.c: the pose and its uncertainty, from counters.
 *
 * Each joint sums its travel from its own samples. When every joint with feedback has brought one,
 * the sum is integrated as one exact arc: the base's twist counts as constant meanwhile. If a
 * counter does not show how far a wheel has gone (it jumped, its origin moved, or there is no
 * counter), the drive's measured velocity replaces it, and `degraded` is set. */
#include "travel.h"

#include <math.h>

typedef struct {
    double rim_m[JOINTS_MAX]; /* travel of the joints that brought one */
    uint32_t joints;          /* bit n: joint n did so */
    int64_t stamp_ns;         /* stamp of the newest sample */
    uint32_t degraded;
} arc;

/* The base's motion, in its frame in the middle of the arc, as if straight on. */
typedef struct {
    double x_m;
    double y_m;
    double turn_rad;
} motion;

int64_t counter_difference(uint64_t now, uint64_t before, uint32_t bits)
{
    return bits == 0 || bits > 64 ? 0 : shortest_difference(now, before, 64 - bits);
}

static void pose_to_origin(odometry_state *state, const core_config *config)
{
    state->x_m = state->y_m = state->heading_rad = 0.0;
    for (int i = 0; i < 6; i++) {
        state->pose_covariance[i] = 0.0;
    }
    state->spread = (spread_state){0};
    spread_floor(state, config);
}

void odometry_init(odometry_state *state, const core_config *config)
{
    *state = (odometry_state){0};
    gyro_init(&state->gyro);
    for (uint32_t j = 0; j < JOINTS_MAX; j++) {
        state->joint[j].velocity_rad_s = NAN;
        state->angle_rad[j] = state->arc_rad[j] = NAN;
    }
    for (uint32_t j = 0; j < config->joint_count; j++) {
        state->joint[j].constant = constants_of(&config->joint[j], config->feedback_timeout_s);
        if (config->joint[j].position.used &&
            config->joint[j].position.reference == REFERENCE_ESTIMATED) {
            state->angle_rad[j] = 0.0; /* angle at which its profile begins */
        }
    }
    pose_to_origin(state, config);
    kinematics_invert(config, (1U << config->joint_count) - 1U, &state->used);
    state->lateral_covariance[1] =
        kinematics_strafes(config) ? config->twist_variance_floor_m2_s2 : 0.0;
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

/* Collect the travel of the joints into one arc. A joint that was left out begins anew: the base
 * has moved without it. */
static void collect(odometry_state *state, const core_config *config, const uint32_t *stale,
                    arc *found)
{
    uint32_t seen = NOTHING, joints = 0, degraded = 0;
    int64_t newest_ns = 0;
    for (uint32_t j = 0; j < config->joint_count; j++) {
        joint_odometry *joint = &state->joint[j];
        double rim_m = joint->pending_rad * joint->constant.wheel_radius_m;
        if (__builtin_expect(stale[j] | (joint->fresh & SEED), 0)) {
            if (stale[j]) {
                joint->last = NONE;
                degraded = 1;
            } else {
                modules_take_angle(state, config, j);
                /* only part of the distance is known, so it is dropped */
                degraded |= joint->pending_rad != 0.0;
                newest_ns = joint->stamp_ns > newest_ns ? joint->stamp_ns : newest_ns;
            }
            rim_m = 0.0;
        } else {
            newest_ns = joint->stamp_ns > newest_ns ? joint->stamp_ns : newest_ns;
            joints |= 1U << j;
            seen |= joint->fresh;
        }
        found->rim_m[j] = rim_m;
        joint->pending_rad = 0.0;
        joint->fresh = NOTHING;
    }
    found->stamp_ns = newest_ns;
    found->joints = joints;
    found->degraded = degraded | ((seen & ESTIMATE) != 0) | (state->distrusted != 0);
}

/* Return sin(h) / h, without cancellation near zero; the first term left out is below 3e-18. */
static double sine_over(double half_rad)
{
    double q = half_rad * half_rad;
    if (q < 0.01) {
        return 1.0 +
               q * (q * (q * (q * (1.0 / 362880.0) - 1.0 / 5040.0) + 1.0 / 120.0) - 1.0 / 6.0);
    }
    return angle_direction(angle_wrap(half_rad)).sine / half_rad;
}

/* Compute the inverse for another set of joints, which is rare: one has become silent, or is back.
 * With modules the inverse changes each time. */
__attribute__((noinline)) static void look_anew(odometry_state *state, const core_config *config,
                                                uint32_t joints)
{
    if (config->module_count > 0) {
        modules_look(state, config, joints);
    } else {
        spread_look(state, config, state->spread.stamp_ns);
        kinematics_invert(config, joints, &state->used);
    }
}

/* Whether these joints determine the motion. */
static inline bool determined(odometry_state *state, const core_config *config, uint32_t joints)
{
    if (joints != state->used.joints) {
        look_anew(state, config, joints);
    }
    return state->used.determined != 0;
}

static motion by_wheels(odometry_state *state, const arc *found, uint32_t joint_count)
{
    const twist_inverse *used = &state->used;
    const double *rim_m = found->rim_m, *y = used->inverse[AXIS_LATERAL];
    double *since_m = state->spread.rim_m;
    motion moved = {0.0, 0.0, 0.0};
    for (uint32_t j = 0; j < joint_count; j++) {
        moved.x_m += used->inverse[AXIS_LINEAR][j] * rim_m[j];
        moved.turn_rad += used->inverse[AXIS_ANGULAR][j] * rim_m[j];
        since_m[j] += rim_m[j];
    }
    for (uint32_t j = 0; j < joint_count && used->strafes; j++) {
        moved.y_m += y[j] * rim_m[j];
    }
    return moved;
}

/* Look at the motion before this arc, which spread.rim_m already contains. */
static void look_before(odometry_state *state, const core_config *config, const arc *found)
{
    for (uint32_t j = 0; j < config->joint_count; j++) {
        state->spread.rim_m[j] -= found->rim_m[j];
    }
    spread_look(state, config, state->spread.stamp_ns);
    for (uint32_t j = 0; j < config->joint_count; j++) {
        state->spread.rim_m[j] = found->rim_m[j];
    }
}

/* Take the distance from the wheels and the turn from the gyro: their errors are independent. */
static void turn_by_gyro(odometry_state *state, const core_config *config, const arc *found,
                         motion *moved)
{
    double turn_rad, variance_rad2 = 0.0;
    state->by_gyro =
        config->gyro.used &&
        gyro_turn(&state->gyro, &config->gyro, state->stamp_ns, &turn_rad, &variance_rad2) &&
        !gyro_reversed(&state->gyro, moved->turn_rad, turn_rad);
    if (state->by_gyro != state->spread.by_gyro) {
        look_before(state, config, found);
        state->spread.by_gyro = state->by_gyro;
    }
    if (!state->by_gyro) {
        return;
    }
    moved->turn_rad = turn_rad;
    state->spread.gyro_rad2 += variance_rad2;
}

/* Measure the twist by the wheels, and the turn rate by the gyro if that has the turn. */
static void measure_twist(odometry_state *state, const core_config *config,
                          const joint_feedback *feedback, const double *moved_u)
{
    if (!speed_take(state, config, feedback, moved_u)) {
        return;
    }
    state->twist_known = 1;
    if (state->by_gyro) {
        state->angular_rad_s = state->gyro.still ? 0.0 : state->gyro.rate_rad_s;
        state->twist_covariance[1] = state->lateral_covariance[2] = 0.0; /* of different sensors */
        state->twist_covariance[2] =
            config->twist_variance_floor_rad2_s2 + state->gyro.rate_variance_rad2_s2;
    }
}

/* Apply the exponential of a constant twist in SE(2) (Lynch & Park, Modern Robotics, 2017, 13.4):
 * the length times sin(h) / h, in the heading of half the turn h. */
static void follow(odometry_state *state, const motion *moved)
{
    double chord = sine_over(0.5 * moved->turn_rad);
    direction middle = angle_direction(angle_wrap(state->heading_rad + 0.5 * moved->turn_rad));
    double x_m = moved->x_m * middle.cosine - moved->y_m * middle.sine;
    double y_m = moved->x_m * middle.sine + moved->y_m * middle.cosine;
    state->x_m += chord * x_m;
    state->y_m += chord * y_m;
    state->spread.x_m += x_m;
    state->spread.y_m += y_m;
    state->heading_rad = angle_wrap(state->heading_rad + moved->turn_rad);
    state->distance_m += sqrt(moved->x_m * moved->x_m + moved->y_m * moved->y_m);
    state->turned_rad += fabs(moved->turn_rad);
}

static void integrate(odometry_state *state, const core_config *config,
                      const joint_feedback *feedback, const uint32_t *stale)
{
    arc found;
    collect(state, config, stale, &found);
    int64_t before_ns = state->stamp_ns;
    state->degraded = found.degraded;
    state->stamp_ns = found.stamp_ns > before_ns ? found.stamp_ns : before_ns;
    bool known = found.joints != 0 && determined(state, config, found.joints);
    if (config->module_count != 0) {
        modules_end_arc(state);
    }
    if (!known) {
        /* some have only just begun: the others alone make no arc */
        state->degraded |= found.joints != 0;
        speed_begin(&state->speed, state->stamp_ns);
        state->spread.stamp_ns =
            state->spread.stamp_ns == 0 ? state->stamp_ns : state->spread.stamp_ns;
        return;
    }
    motion moved = by_wheels(state, &found, config->joint_count);
    const double moved_u[AXES] = {moved.x_m, moved.turn_rad, moved.y_m};
    if (config->module_count > 0 && before_ns > 0 && found.stamp_ns > before_ns) {
        modules_slip(state, config, found.joints, found.rim_m, moved_u,
                     (double)(found.stamp_ns - before_ns) * 1e-9);
    }
    turn_by_gyro(state, config, &found, &moved);
    follow(state, &moved);
    if (found.stamp_ns - state->spread.stamp_ns >= SPREAD_EVERY_NS) {
        spread_look(state, config, found.stamp_ns);
    }
    measure_twist(state, config, feedback, moved_u);
}

/* Return the joints whose feedback is used: one bit each. */
static uint32_t received(const odometry_state *state, const core_config *config,
                         const uint32_t *stale)
{
    uint32_t joints = 0;
    for (uint32_t j = 0; j < config->joint_count; j++) {
        joints |= (stale[j] ? 0U : 1U) << j;
    }
    return joints & ~state->distrusted;
}

static void take_sample(joint_odometry *joint, const joint_feedback *sample, double setpoint_rad_s,
                        double timeout_s)
{
    if (sample->stamp_ns <= joint->stamp_ns) {
        return;
    }
    if (!take_next(joint, sample)) {
        take(joint, sample, setpoint_rad_s, timeout_s);
    }
    joint->stamp_ns = sample->stamp_ns;
}

/* Take the sample of a joint whose counter is wrong: its speed still shows whether it turns, but
 * its travel does not count. */
static void take_distrusted(joint_odometry *joint, const joint_feedback *sample, double timeout_s)
{
    double before_rad = joint->position_rad;
    take_sample(joint, sample, 0.0, timeout_s);
    joint->left_out_rad += joint->position_rad - before_rad;
    joint->pending_rad = 0.0;
    joint->fresh = SEED;
}

void odometry_step(odometry_state *state, const core_config *config, const joint_feedback *feedback,
                   const uint32_t *stale, const joint_setpoint *setpoint)
{
    uint32_t silent = 0, missing = 0;
    for (uint32_t j = 0; j < config->joint_count; j++) {
        joint_odometry *joint = &state->joint[j];
        if (stale[j]) {
            silent++;
            continue;
        }
        if (state->distrusted >> j & 1U) {
            silent++;
            take_distrusted(joint, &feedback[j], config->feedback_timeout_s);
            continue;
        }
        take_sample(joint, &feedback[j], setpoint[j].velocity_rad_s, config->feedback_timeout_s);
        missing += joint->fresh == NOTHING;
    }
    if (silent != 0) {
        state->degraded = 1;
    }
    state->blind = silent != 0 && !determined(state, config, received(state, config, stale));
    if (state->blind) {
        state->twist_known = 0;
        speed_begin(&state->speed, 0); /* travel may be lost meanwhile */
    }
    if (missing == 0 && !state->blind) {
        integrate(state, config, feedback, stale);
    }
}
