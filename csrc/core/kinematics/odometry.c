/* SPDX-License-Identifier: Apache-2.0
 *
 * odometry.c: from counters to a pose with its uncertainty.
 *
 * Each joint gathers its travel from its own samples; when every joint with feedback has brought one, the
 * gathered travel is integrated as one exact arc: the base's twist is taken for constant meanwhile. Where a
 * counter cannot say how far a wheel has gone (it jumped, its origin moved, there is none), the drive's
 * measured velocity stands in, and `degraded` is set.
 */
#include "core.h"

#include <math.h>

/* A wheel may turn faster than its configured limit (downhill, pushed) without its counter being called wrong. */
static const double JUMP_MARGIN = 1.5;
static const double JUMP_SLACK_COUNTS = 4.0;
/* Part of itself by which a measured velocity may be off: filtered, rounded to revolutions a minute, not quite in time. */
static const double VELOCITY_ERROR = 0.1;

/* Bits of joint_odometry.fresh: what came since the last integration. */
enum { NOTHING = 0, TRAVEL = 1 << 0, ESTIMATE = 1 << 1, SEED = 1 << 2 };

typedef struct {
    double rim_m[JOINTS_MAX]; /* of those that brought a travel */
    uint32_t joints;          /* bit n: joint n did */
    int64_t stamp_ns;         /* newest */
    uint32_t degraded;
} arc;

/* What the base did, in its frame in the middle of the arc, as if it had been straight on. */
typedef struct {
    double x_m;
    double y_m;
    double turn_rad;
} motion;

/* unused: bits of the word that are not the counter's, 0..63 */
static inline int64_t shortest_difference(uint64_t now, uint64_t before, uint32_t unused)
{
    /* the counter's sign bit becomes the word's; the shift back extends it */
    return (int64_t)((now - before) << unused) >> unused;
}

int64_t counter_difference(uint64_t now, uint64_t before, uint32_t bits)
{
    return bits == 0 || bits > 64 ? 0 : shortest_difference(now, before, 64 - bits);
}

/* b for a NaN in a: a floor holds */
static double larger(double a, double b)
{
    return a > b ? a : b;
}

static double smaller(double a, double b)
{
    return a < b ? a : b;
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

static joint_constants constants_of(const joint_config *joint, double timeout_s)
{
    joint_constants found = {
        .wheel_radius_m = joint->wheel_radius_m,
        .reach_rad_s = JUMP_MARGIN * larger(joint->velocity_max_rad_s, -joint->velocity_min_rad_s),
    };
    if (joint->counter_bits == 0) {
        return found;
    }
    double rad_per_count = fabs(joint->rad_per_count);
    found.counter_bits_unused = 64 - joint->counter_bits;
    found.counter_rad = joint->rad_per_count;
    found.counter_slack_rad = JUMP_SLACK_COUNTS * rad_per_count;
    found.counter_round_rad = ldexp(rad_per_count, (int)joint->counter_bits);
    found.counter_unused_max_rad = smaller(found.reach_rad_s * timeout_s, 0.25 * found.counter_round_rad);
    return found;
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
        if (config->joint[j].position.used && config->joint[j].position.reference == REFERENCE_ESTIMATED) {
            state->angle_rad[j] = 0.0; /* as its profile begins */
        }
    }
    pose_to_origin(state, config);
    kinematics_invert(config, (1U << config->joint_count) - 1U, &state->used);
    state->lateral_covariance[1] = kinematics_strafes(config) ? config->twist_variance_floor_m2_s2 : 0.0;
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

/* How far the wheel went by the drive's own measure, at both ends where it measured at both, or without one by `otherwise`.
 * After a silence the speed of now says nothing about all of it. */
static double travel_by_velocity(double before_rad_s, double now_rad_s, double elapsed_s, double timeout_s,
                                 double otherwise_rad_s)
{
    double mean_rad_s = isfinite(before_rad_s) ? 0.5 * (before_rad_s + now_rad_s) : now_rad_s;
    return (isfinite(mean_rad_s) ? mean_rad_s : otherwise_rad_s) * (elapsed_s < timeout_s ? elapsed_s : timeout_s);
}

/* Which of the travels that a counter can mean, whole turns of it apart, the measured velocity decides. Only where the next
 * one is three times as far from what was measured as the velocity can be off, and after no silence; else NaN. */
static double travel_by_turns(const joint_odometry *joint, const joint_feedback *sample, double travel_rad, double elapsed_s,
                              double timeout_s)
{
    double mean_rad = 0.5 * (joint->velocity_rad_s + sample->velocity_rad_s) * elapsed_s;
    double change_rad = 0.5 * fabs(sample->velocity_rad_s - joint->velocity_rad_s) * elapsed_s;
    double whole_rad = joint->constant.counter_round_rad;
    double found_rad = travel_rad + rint((mean_rad - travel_rad) / whole_rad) * whole_rad;
    double sure_rad = 0.25 * whole_rad;
    bool sure = elapsed_s <= timeout_s && change_rad + VELOCITY_ERROR * fabs(mean_rad) <= sure_rad &&
                fabs(found_rad - mean_rad) <= sure_rad;
    return sure ? found_rad : (double)NAN;
}

static inline void gather(joint_odometry *joint, uint32_t kind, double travel_rad)
{
    joint->pending_rad += travel_rad;
    joint->position_rad += travel_rad;
    joint->fresh |= kind;
}

/* Joints without a counter: the drive's velocity, or the set-point where it measures none. */
static void take_velocity(joint_odometry *joint, const joint_feedback *sample, double setpoint_rad_s, double elapsed_s,
                          double timeout_s)
{
    double travel_rad = travel_by_velocity(NAN, sample->velocity_rad_s, elapsed_s, timeout_s, setpoint_rad_s);
    if (!(fabs(travel_rad) <= joint->constant.reach_rad_s * elapsed_s)) {
        joint->jumps++;
        travel_rad = 0.0;
    }
    joint->velocity_rad_s = measured(sample->velocity_rad_s);
    gather(joint, ESTIMATE, travel_rad);
}

static inline double travel_since(const joint_odometry *joint, const joint_feedback *sample, uint64_t before)
{
    return (double)shortest_difference(sample->count, before, joint->constant.counter_bits_unused) * joint->constant.counter_rad;
}

static void believe(joint_odometry *joint, uint64_t count)
{
    joint->last = BELIEVED;
    joint->count = count;
    joint->since_rad = joint->credited_rad = 0.0;
}

/* From here on travel is counted from this sample. */
static void begin(joint_odometry *joint, const joint_feedback *sample)
{
    joint->epoch = sample->epoch;
    joint->unused_rad = 0.0;
    believe(joint, sample->count);
}

/* A sample that is refused moves nothing but by estimate: the next one is believed when it agrees with the last one that
 * was believed, or with the one that was refused. known: it gives a travel, though an impossible one. */
static void refuse(joint_odometry *joint, const joint_feedback *sample, bool known, double elapsed_s, double timeout_s)
{
    double fresh_rad = joint->constant.reach_rad_s * elapsed_s, before_rad_s = joint->velocity_rad_s;
    joint->velocity_rad_s = measured(sample->velocity_rad_s);
    if (known && joint->last == REFUSED) {
        double travel_rad = travel_since(joint, sample, joint->refused);
        if (fabs(travel_rad) <= fresh_rad + joint->constant.counter_slack_rad) {
            if (isnan(joint->velocity_rad_s)) {
                joint->velocity_rad_s = travel_rad / elapsed_s;
            }
            gather(joint, TRAVEL, travel_rad);
            begin(joint, sample);
            return;
        }
    }
    double estimate_rad = travel_by_velocity(before_rad_s, sample->velocity_rad_s, elapsed_s, timeout_s, 0.0);
    if (!(fabs(estimate_rad) <= fresh_rad)) {
        estimate_rad = 0.0;
    }
    gather(joint, ESTIMATE, estimate_rad);
    if (!known) {
        begin(joint, sample);
        return;
    }
    joint->jumps++;
    joint->last = REFUSED;
    joint->refused = sample->count;
    joint->credited_rad += estimate_rad;
}

/* Travel within reach_rad, of which sure_rad can have been turned since the last sample that was believed. */
static inline void go(joint_odometry *joint, const joint_feedback *sample, double travel_rad, double sure_rad, double reach_rad)
{
    const joint_constants *constant = &joint->constant;
    double distance_rad = fabs(travel_rad);
    joint->velocity_rad_s = measured(sample->velocity_rad_s);
    if (isnan(joint->velocity_rad_s)) {
        joint->velocity_rad_s =
            travel_rad * constant->reach_rad_s / (distance_rad <= sure_rad + constant->counter_slack_rad ? sure_rad : reach_rad);
    }
    joint->unused_rad = larger(0.0, smaller(reach_rad - distance_rad, constant->counter_unused_max_rad));
}

/* A counter that is renewed more slowly than it is read catches up in steps: what reach a sample leaves unused is the next
 * one's, for as long as feedback counts, and for a quarter of a narrow counter. A sample beyond that is refused. */
static void take_count(joint_odometry *joint, const joint_feedback *sample, double elapsed_s, double timeout_s)
{
    const joint_constants *constant = &joint->constant;
    double travel_rad = travel_since(joint, sample, joint->count);
    double sure_rad = joint->since_rad += constant->reach_rad_s * elapsed_s;
    double reach_rad = sure_rad + joint->unused_rad;
    bool known = sample->epoch == joint->epoch;
    /* could it have gone round the counter in the other direction? */
    if (known && constant->counter_round_rad - fabs(travel_rad) <= sure_rad) {
        travel_rad = travel_by_turns(joint, sample, travel_rad, elapsed_s, timeout_s);
        known = isfinite(travel_rad) && joint->last != REFUSED;
    }
    if (known && fabs(travel_rad) <= reach_rad + constant->counter_slack_rad) {
        gather(joint, TRAVEL, travel_rad - joint->credited_rad);
        go(joint, sample, travel_rad, sure_rad, reach_rad);
        believe(joint, sample->count);
    } else {
        refuse(joint, sample, known, elapsed_s, timeout_s);
    }
}

/* A new sample of any kind. Kept out of the loop over the joints, whose common case it would slow down. */
__attribute__((noinline)) static void take(joint_odometry *joint, const joint_feedback *sample, double setpoint_rad_s,
                                           double timeout_s)
{
    double elapsed_s = (double)(sample->stamp_ns - joint->stamp_ns) * 1e-9;
    if (joint->last == NONE) {
        gather(joint, SEED, 0.0);
        joint->velocity_rad_s = measured(sample->velocity_rad_s);
        begin(joint, sample);
    } else if (joint->constant.counter_round_rad == 0.0) {
        take_velocity(joint, sample, setpoint_rad_s, elapsed_s, timeout_s);
    } else {
        take_count(joint, sample, elapsed_s, timeout_s);
    }
}

/* The common case of take_count(): after a sample that was believed, one that can only mean this travel, within reach. */
static inline bool take_next(joint_odometry *joint, const joint_feedback *sample)
{
    const joint_constants *constant = &joint->constant;
    if (joint->last != BELIEVED || joint->epoch != sample->epoch) {
        return false;
    }
    double sure_rad = constant->reach_rad_s * ((double)(sample->stamp_ns - joint->stamp_ns) * 1e-9);
    double reach_rad = sure_rad + joint->unused_rad;
    double travel_rad = travel_since(joint, sample, joint->count), distance_rad = fabs(travel_rad);
    if (!(distance_rad + sure_rad < constant->counter_round_rad && distance_rad <= reach_rad + constant->counter_slack_rad)) {
        return false;
    }
    gather(joint, TRAVEL, travel_rad);
    go(joint, sample, travel_rad, sure_rad, reach_rad);
    joint->count = sample->count;
    return true;
}

/* Empties the joints into one arc. A joint left out seeds again, for the base has gone on without it. */
static void collect(odometry_state *state, const core_config *config, const uint32_t *stale, arc *found)
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
                degraded |= joint->pending_rad != 0.0; /* only part of the distance is known: thrown away */
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
    found->degraded = degraded | ((seen & ESTIMATE) != 0);
}

/* sin(h) / h, without the cancellation near zero; the first term left out is below 3e-18 */
static double sine_over(double half_rad)
{
    double q = half_rad * half_rad;
    if (q < 0.01) {
        return 1.0 + q * (q * (q * (q * (1.0 / 362880.0) - 1.0 / 5040.0) + 1.0 / 120.0) - 1.0 / 6.0);
    }
    return angle_direction(angle_wrap(half_rad)).sine / half_rad;
}

/* Others than before are rare: a joint has gone silent, or is back. Those of a base with modules are never the same. */
__attribute__((noinline)) static void look_anew(odometry_state *state, const core_config *config, uint32_t joints)
{
    if (config->module_count > 0) {
        modules_look(state, config, joints);
    } else {
        spread_look(state, config, state->spread.stamp_ns);
        kinematics_invert(config, joints, &state->used);
    }
}

/* Do these joints determine the motion? */
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

/* A look at what was done before this arc, which spread.rim_m has already. */
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

/* The distance is the wheels', the turn the gyro's: their errors have nothing to do with each other. */
static void turn_by_gyro(odometry_state *state, const core_config *config, const arc *found, motion *moved)
{
    double turn_rad, variance_rad2 = 0.0;
    state->by_gyro = config->gyro.used && gyro_turn(&state->gyro, &config->gyro, state->stamp_ns, &turn_rad, &variance_rad2) &&
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

static void measure_twist(odometry_state *state, const core_config *config, const motion *moved, double elapsed_s)
{
    const spread_state *spread = &state->spread;
    double per_s = 1.0 / elapsed_s;
    state->linear_m_s = moved->x_m * per_s;
    state->angular_rad_s = moved->turn_rad * per_s;
    state->twist_covariance[0] = config->twist_variance_floor_m2_s2 + spread->linear2_m2_s * per_s;
    state->twist_covariance[1] = spread->linear_angular_m_rad_s * per_s;
    state->twist_covariance[2] = config->twist_variance_floor_rad2_s2 + spread->angular2_rad2_s * per_s;
    if (state->used.strafes) {
        state->lateral_m_s = moved->y_m * per_s;
        state->lateral_covariance[0] = spread->linear_lateral_m2_s * per_s;
        state->lateral_covariance[1] = config->twist_variance_floor_m2_s2 + spread->lateral2_m2_s * per_s;
        state->lateral_covariance[2] = spread->lateral_angular_m_rad_s * per_s;
    }
    if (state->by_gyro) {
        state->angular_rad_s = state->gyro.still ? 0.0 : state->gyro.rate_rad_s;
        state->twist_covariance[2] = config->twist_variance_floor_rad2_s2 + state->gyro.rate_variance_rad2_s2;
    }
}

/* The exponential of a constant twist in SE(2) (Lynch & Park, Modern Robotics, 2017, 13.4): the straight way times sin(h) / h,
 * in the heading of half the turn h. */
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

static void integrate(odometry_state *state, const core_config *config, const uint32_t *stale)
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
        /* some have only just been seeded: what the others have gone alone is no arc */
        state->degraded |= found.joints != 0;
        state->spread.stamp_ns = state->spread.stamp_ns == 0 ? state->stamp_ns : state->spread.stamp_ns;
        return;
    }
    motion moved = by_wheels(state, &found, config->joint_count);
    if (config->module_count > 0 && before_ns > 0 && found.stamp_ns > before_ns) {
        const double twist_u[AXES] = {moved.x_m, moved.turn_rad, moved.y_m};
        modules_slip(state, config, found.joints, found.rim_m, twist_u, (double)(found.stamp_ns - before_ns) * 1e-9);
    }
    turn_by_gyro(state, config, &found, &moved);
    follow(state, &moved);
    if (found.stamp_ns - state->spread.stamp_ns >= SPREAD_EVERY_NS) {
        spread_look(state, config, found.stamp_ns);
    }
    if (before_ns > 0 && found.stamp_ns > before_ns) {
        measure_twist(state, config, &moved, (double)(found.stamp_ns - before_ns) * 1e-9);
    }
}

static uint32_t received(const core_config *config, const uint32_t *stale)
{
    uint32_t joints = 0;
    for (uint32_t j = 0; j < config->joint_count; j++) {
        joints |= (stale[j] ? 0U : 1U) << j;
    }
    return joints;
}

void odometry_step(odometry_state *state, const core_config *config, const joint_feedback *feedback, const uint32_t *stale,
                   const joint_setpoint *setpoint)
{
    uint32_t silent = 0, missing = 0;
    for (uint32_t j = 0; j < config->joint_count; j++) {
        joint_odometry *joint = &state->joint[j];
        if (stale[j]) {
            silent++;
            continue;
        }
        if (feedback[j].stamp_ns > joint->stamp_ns) {
            if (!take_next(joint, &feedback[j])) {
                take(joint, &feedback[j], setpoint[j].velocity_rad_s, config->feedback_timeout_s);
            }
            joint->stamp_ns = feedback[j].stamp_ns;
        }
        missing += joint->fresh == NOTHING;
    }
    if (silent != 0) {
        state->degraded = 1;
    }
    state->blind = silent != 0 && !determined(state, config, received(config, stale));
    if (missing == 0 && !state->blind) {
        integrate(state, config, stale);
    }
}
