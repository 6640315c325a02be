/* SPDX-License-Identifier: Apache-2.0
 *
 * steer.c: steered wheels. The twist moves the base, and the angles of its wheels follow; if they
 * cannot follow at once, the twist waits.
 *
 * The ramp of limit.c runs straight from twist to twist, and on that line each wheel's direction
 * changes: by v x dv / |v|^2 for the speed v of the floor under the wheel. Three rules keep the
 * wheels in their directions:
 *
 * If a wheel would have to turn around on that line, the base comes to rest first: from there the
 * wheel may roll backward. The ramp is paced so that no wheel's direction changes faster than its
 * joint follows. A wheel that does not yet point in its direction slows the base down, to rest if
 * it is far off. */
#include "steer.h"

#include <math.h>

static const double HALF_TURN_RAD = 3.14159265358979323846;
/* Angle errors of a wheel: below FULL the base drives at full speed, above NOT it rests; between
 * them the speed falls in proportion. At FULL a wheel slides sideways by 5 % of the distance that
 * it rolls. */
static const double ALIGNED_FULL_RAD = 0.05;
static const double ALIGNED_NOT_RAD = 0.25;
/* Allowed lag of a profile behind a direction: its braking distance, v^2 / 2 a. */
static const double LAG_RAD = 0.04;
static const double PACE_PART = 0.8; /* part of a joint's speed: the rest is for catching up */
/* Part of the fastest floor speed below which a wheel has no direction. */
static const double STANDS_PART = 1e-6;
/* Rounding beyond the end of a range that counts as at the end. */
static const double ROUNDING_RAD = 1e-6;
/* Curvature for an endless range on a base that nothing drives on the spot: its wheel at 80
 * degrees. */
static const double CURVATURE_TAN = 5.67;

typedef struct {
    double x_m_s;
    double y_m_s;
} floor_speed;

static floor_speed speed_under(const wheel_module *module, const double *twist_u_s)
{
    return (floor_speed){twist_u_s[AXIS_LINEAR] - module->y_m * twist_u_s[AXIS_ANGULAR],
                         twist_u_s[AXIS_LATERAL] + module->x_m * twist_u_s[AXIS_ANGULAR]};
}

static double size_of(floor_speed v)
{
    return sqrt(v.x_m_s * v.x_m_s + v.y_m_s * v.y_m_s);
}

static bool moves(const double *twist_u_s)
{
    return twist_u_s[AXIS_LINEAR] != 0.0 || twist_u_s[AXIS_ANGULAR] != 0.0 ||
           twist_u_s[AXIS_LATERAL] != 0.0;
}

static const position_config *steering_of(const core_config *config, const wheel_module *module)
{
    return &config->joint[module->steering - 1].position;
}

static double fastest(const core_config *config, const double *twist_u_s)
{
    double most_m_s = 0.0;
    for (uint32_t i = 0; i < config->module_count; i++) {
        most_m_s = fmax(most_m_s, size_of(speed_under(&config->module[i], twist_u_s)));
    }
    return most_m_s;
}

/* -------------------------------------------------------------------------------- reach */
/* Return the curvature of a base whose fixed wheels are on y, when a wheel points to angle_rad: the
 * line across the wheel meets y at the centre. For x > 0; endless if the wheel points at least as
 * far as for a turn on the spot. */
static double curvature_at(double x_m, double y_m, double angle_rad)
{
    bool left = angle_rad > 0.0;
    double spot_rad = left ? angle_of(x_m, -y_m) : angle_of(-x_m, y_m);
    if (angle_rad == 0.0) {
        return 0.0;
    }
    if (left ? angle_rad >= spot_rad - ROUNDING_RAD : angle_rad <= spot_rad + ROUNDING_RAD) {
        return left ? (double)INFINITY : -(double)INFINITY;
    }
    direction d = angle_direction(angle_wrap(angle_rad));
    return d.sine / (x_m * d.cosine + y_m * d.sine);
}

/* Whether a driven wheel turns the base while the others stand across. */
static bool drives_on_spot(const core_config *config)
{
    bool rolls = false;
    for (uint32_t i = 0; i < config->module_count; i++) {
        const wheel_module *module = &config->module[i];
        rolls |= module->traction != 0 &&
                 (module->y_m != 0.0 || (module->steering != 0 && module->x_m != 0.0));
    }
    return rolls;
}

static void find_reach(steer_state *steer, const core_config *config)
{
    double least = -INFINITY, most = INFINITY;
    bool rolls = drives_on_spot(config);
    for (uint32_t i = 0; i < config->module_count; i++) {
        const wheel_module *module = &config->module[i];
        if (module->steering == 0) {
            continue;
        }
        const position_config *range = steering_of(config, module);
        double low_rad = module->angle_rad + range->position_min_rad,
               high_rad = module->angle_rad + range->position_max_rad;
        bool behind = module->x_m < 0.0;
        double x_m = fabs(module->x_m);
        double low = curvature_at(x_m, module->y_m, behind ? -high_rad : low_rad);
        double high = curvature_at(x_m, module->y_m, behind ? -low_rad : high_rad);
        double endless = rolls || x_m == 0.0 ? (double)INFINITY : CURVATURE_TAN / x_m;
        least = fmax(least, fmax(low, -endless));
        most = fmin(most, fmin(high, endless));
    }
    steer->curvature_min_per_m = fmin(least, 0.0);
    steer->curvature_max_per_m = fmax(most, 0.0);
    steer->turns_on_spot = rolls && isinf(least) && isinf(most);
}

void steer_init(steer_state *steer, const core_config *config)
{
    *steer = (steer_state){.pace_rad_s = INFINITY, .misaligned_rad = INFINITY};
    for (uint32_t j = 0; j < config->joint_count; j++) {
        const position_config *own = &config->joint[j].position;
        if (own->used) {
            double lagging_rad_s = sqrt(2.0 * own->acceleration_rad_s2 * LAG_RAD);
            steer->pace_rad_s =
                fmin(steer->pace_rad_s, fmin(PACE_PART * own->velocity_rad_s, lagging_rad_s));
        }
    }
    if (!kinematics_strafes(config)) {
        find_reach(steer, config);
        return;
    }
    steer->curvature_min_per_m = -INFINITY;
    steer->curvature_max_per_m = INFINITY;
    steer->turns_on_spot = 1;
}

bool kinematics_spins(const core_config *config)
{
    steer_state steer = {.turns_on_spot = 1};
    if (config->module_count > 0) {
        steer_init(&steer, config);
    }
    return steer.turns_on_spot != 0;
}

uint32_t steer_within_reach(const steer_state *steer, const base_limits *limits,
                            const double *wanted_u_s, double *goal_u_s)
{
    double linear_m_s = wanted_u_s[AXIS_LINEAR], angular_rad_s = wanted_u_s[AXIS_ANGULAR];
    uint32_t reasons = 0;
    if (linear_m_s == 0.0 && angular_rad_s != 0.0 && !steer->turns_on_spot) {
        angular_rad_s = 0.0;
        reasons |= REASON_TURN_IMPOSSIBLE;
    }
    if (linear_m_s != 0.0) {
        double low = linear_m_s * steer->curvature_min_per_m,
               high = linear_m_s * steer->curvature_max_per_m;
        double kept_rad_s = fmin(fmax(angular_rad_s, fmin(low, high)), fmax(low, high));
        reasons |= kept_rad_s != angular_rad_s ? (uint32_t)REASON_CURVATURE : 0;
        angular_rad_s = kept_rad_s;
    }
    /* both by one factor, so that the curve stays */
    double factor = 1.0;
    if (fabs(linear_m_s) > limits->linear.velocity_u_s) {
        factor = limits->linear.velocity_u_s / fabs(linear_m_s);
        reasons |= REASON_LINEAR_VELOCITY;
    }
    if (fabs(angular_rad_s) * factor > limits->angular.velocity_u_s) {
        factor = limits->angular.velocity_u_s / fabs(angular_rad_s);
        reasons |= REASON_ANGULAR_VELOCITY;
    }
    double most_m_s = limits->linear.velocity_u_s, most_rad_s = limits->angular.velocity_u_s;
    goal_u_s[AXIS_LINEAR] = fmin(fmax(linear_m_s * factor, -most_m_s), most_m_s);
    goal_u_s[AXIS_ANGULAR] = fmin(fmax(angular_rad_s * factor, -most_rad_s), most_rad_s);
    return reasons;
}

/* --------------------------------------------------------------------------- directions */
/* Find the angle of a module's joint for that motion of the floor, forward or backward, the nearest
 * to near_rad within its range. false: out of reach, and found_rad is the nearest end. */
static bool aim_of(const core_config *config, const wheel_module *module, floor_speed v,
                   double near_rad, double *found_rad)
{
    const position_config *range = steering_of(config, module);
    double aim_rad = angle_of(v.y_m_s, v.x_m_s) - module->angle_rad;
    aim_rad += rint((near_rad - aim_rad) / HALF_TURN_RAD) * HALF_TURN_RAD;
    if (aim_rad > range->position_max_rad + ROUNDING_RAD) {
        aim_rad -= ceil((aim_rad - range->position_max_rad - ROUNDING_RAD) / HALF_TURN_RAD) *
                   HALF_TURN_RAD;
    }
    if (aim_rad < range->position_min_rad - ROUNDING_RAD) {
        aim_rad += ceil((range->position_min_rad - ROUNDING_RAD - aim_rad) / HALF_TURN_RAD) *
                   HALF_TURN_RAD;
    }
    bool reached = aim_rad <= range->position_max_rad + ROUNDING_RAD;
    if (!reached &&
        aim_rad - range->position_max_rad > range->position_min_rad + HALF_TURN_RAD - aim_rad) {
        aim_rad -= HALF_TURN_RAD; /* beyond both ends, and nearer to the lower one */
    }
    *found_rad = fmin(fmax(aim_rad, range->position_min_rad), range->position_max_rad);
    return reached;
}

void steer_speeds(const steer_state *steer, const core_config *config, const double *twist_u_s,
                  double *wheel_rad_s)
{
    double aim_rad[JOINTS_MAX] = {0.0};
    for (uint32_t i = 0; i < config->module_count; i++) {
        const wheel_module *module = &config->module[i];
        if (module->steering != 0) {
            uint32_t j = module->steering - 1;
            (void)aim_of(config, module, speed_under(module, twist_u_s),
                         steer->profile[j].position_rad, &aim_rad[j]);
        }
    }
    steer_wheels(config, twist_u_s, aim_rad, wheel_rad_s);
}

void steer_wheels(const core_config *config, const double *twist_u_s, const double *angle_rad,
                  double *wheel_rad_s)
{
    for (uint32_t j = 0; j < config->joint_count; j++) {
        wheel_rad_s[j] = 0.0;
    }
    for (uint32_t i = 0; i < config->module_count; i++) {
        const wheel_module *module = &config->module[i];
        if (module->traction != 0) {
            floor_speed v = speed_under(module, twist_u_s);
            direction d = angle_direction(angle_wrap(module_angle(module, angle_rad)));
            uint32_t j = module->traction - 1;
            wheel_rad_s[j] =
                (v.x_m_s * d.cosine + v.y_m_s * d.sine) / config->joint[j].wheel_radius_m +
                0.0; /* no negative zero */
        }
    }
}

/* ---------------------------------------------------------------------- before the ramp */
uint32_t steer_unknown(const core_config *config, const joint_feedback *feedback,
                       const uint32_t *stale, const double *angle_rad)
{
    uint32_t unknown = 0;
    for (uint32_t j = 0; j < config->joint_count; j++) {
        const position_config *own = &config->joint[j].position;
        bool homed = own->reference != REFERENCE_HOMED || feedback[j].referenced == 1;
        bool known = own->reference == REFERENCE_ESTIMATED || (homed && isfinite(angle_rad[j]));
        unknown |= (own->used && !stale[j] && !known ? 1U : 0U) << j;
    }
    return unknown;
}

/* Whether a wheel would have to turn around on the straight line to that goal. */
static bool turns_around(const core_config *config, const double *from_u_s, const double *goal_u_s)
{
    bool strafes = kinematics_strafes(config);
    double linear = from_u_s[AXIS_LINEAR] * goal_u_s[AXIS_LINEAR];
    if (!strafes && linear != 0.0) {
        return linear < 0.0;
    }
    for (uint32_t i = 0; i < config->module_count; i++) {
        const wheel_module *module = &config->module[i];
        floor_speed v = speed_under(module, from_u_s), w = speed_under(module, goal_u_s);
        if (module->steering != 0 && v.x_m_s * w.x_m_s + v.y_m_s * w.y_m_s < 0.0) {
            return true;
        }
    }
    return false;
}

/* Return the largest angle between a wheel and the direction in which that twist rolls it. Wheels
 * that stand are left out. */
static double misaligned(const steer_state *steer, const core_config *config,
                         const double *twist_u_s, const double *angle_rad)
{
    double worst_rad = 0.0, stands_m_s = STANDS_PART * fastest(config, twist_u_s);
    for (uint32_t i = 0; i < config->module_count; i++) {
        const wheel_module *module = &config->module[i];
        floor_speed v = speed_under(module, twist_u_s);
        if (module->steering == 0 || !(size_of(v) > stands_m_s)) {
            continue;
        }
        uint32_t j = module->steering - 1;
        double aim_rad, at_rad = angle_rad[j];
        bool reached = aim_of(config, module, v, steer->profile[j].position_rad, &aim_rad);
        double off_rad = fabs(aim_rad - at_rad);
        worst_rad = reached && steer->unsure_s[j] <= 0.0 && isfinite(off_rad)
                        ? fmax(worst_rad, off_rad)
                        : (double)INFINITY;
    }
    return worst_rad;
}

static double share_of(double misaligned_rad)
{
    double share = (ALIGNED_NOT_RAD - misaligned_rad) / (ALIGNED_NOT_RAD - ALIGNED_FULL_RAD);
    return share > 0.0 ? fmin(share, 1.0) : 0.0;
}

/* Return the share of the remaining change that a second may cover, so that no wheel's direction
 * changes faster than it can. */
static double pace_of(const steer_state *steer, const core_config *config, const double *from_u_s,
                      const double *goal_u_s)
{
    double rate_s = INFINITY;
    for (uint32_t i = 0; i < config->module_count; i++) {
        const wheel_module *module = &config->module[i];
        floor_speed v = speed_under(module, from_u_s), w = speed_under(module, goal_u_s);
        double across = fabs(v.x_m_s * w.y_m_s - v.y_m_s * w.x_m_s); /* v x (w - v) */
        double square = v.x_m_s * v.x_m_s + v.y_m_s * v.y_m_s;
        if (module->steering != 0 && across > STANDS_PART * size_of(w) * sqrt(square)) {
            rate_s = fmin(rate_s, steer->pace_rad_s * square / across);
        }
    }
    return rate_s;
}

uint32_t steer_goal(steer_state *steer, const core_config *config, const limit_state *axis,
                    const double *angle_rad, double *goal_u_s, double *rate_max_s)
{
    double from_u_s[AXES];
    uint32_t reasons = 0;
    *rate_max_s = INFINITY;
    for (int i = 0; i < AXES; i++) {
        from_u_s[i] = axis[i].velocity_u_s;
    }
    bool rests = !moves(from_u_s);
    steer->misaligned_rad = 0.0;
    if (rests && !moves(goal_u_s)) {
        return 0;
    }
    double scale = 1.0;
    if (!rests && moves(goal_u_s) && turns_around(config, from_u_s, goal_u_s)) {
        scale = 0.0;
        reasons = REASON_STEERING;
    }
    steer->misaligned_rad = misaligned(steer, config, rests ? goal_u_s : from_u_s, angle_rad);
    double share = share_of(steer->misaligned_rad);
    reasons |= share < 1.0 ? (uint32_t)REASON_STEERING : 0;
    for (int i = 0; i < AXES; i++) {
        goal_u_s[i] *= scale * share;
    }
    if (!rests && moves(goal_u_s)) {
        *rate_max_s = pace_of(steer, config, from_u_s, goal_u_s);
    }
    return reasons;
}

uint32_t steer_pace(const limit_state *from, limit_state *axis, const double *goal_u_s,
                    double rate_max_s, double dt_s)
{
    double most = rate_max_s * dt_s, done = 0.0, whole = 0.0;
    for (int i = 0; i < AXES; i++) {
        done += fabs(axis[i].velocity_u_s - from[i].velocity_u_s);
        whole += fabs(goal_u_s[i] - from[i].velocity_u_s);
    }
    if (!(done > most * whole)) {
        return 0;
    }
    double share = most * whole / done;
    for (int i = 0; i < AXES; i++) {
        double change_u_s = (axis[i].velocity_u_s - from[i].velocity_u_s) * share;
        axis[i] = (limit_state){from[i].velocity_u_s + change_u_s, change_u_s / dt_s};
    }
    return REASON_STEERING;
}

/* ----------------------------------------------------------------------------- after it */
bool steer_sure(steer_state *steer, const core_config *config, uint32_t j, double dt_s)
{
    const position_config *own = &config->joint[j].position;
    if (!steer->enabled && own->reference == REFERENCE_ESTIMATED) {
        steer->unsure_s[j] = (own->position_max_rad - own->position_min_rad) / own->velocity_rad_s;
    }
    bool sure = steer->unsure_s[j] <= 0.0;
    steer->unsure_s[j] = fmax(steer->unsure_s[j] - dt_s, 0.0);
    return sure;
}

void steer_joints(steer_state *steer, const core_config *config, const double *twist_u_s,
                  const double *goal_u_s, double dt_s)
{
    const double *aim_u_s = moves(twist_u_s) ? twist_u_s : goal_u_s;
    double stands_m_s = STANDS_PART * fastest(config, aim_u_s);
    for (uint32_t i = 0; i < config->module_count; i++) {
        const wheel_module *module = &config->module[i];
        if (module->steering == 0) {
            continue;
        }
        uint32_t j = module->steering - 1;
        const position_config *own = steering_of(config, module);
        position_profile *profile = &steer->profile[j];
        floor_speed v = speed_under(module, aim_u_s);
        double goal_rad = NAN; /* hold */
        bool sure = steer_sure(steer, config, j, dt_s);
        if (sure && size_of(v) > stands_m_s) {
            (void)aim_of(config, module, v, profile->position_rad, &goal_rad);
        }
        if (dt_s > 0.0) {
            position_step(profile, own, goal_rad, dt_s);
        }
    }
    steer->enabled = 1;
}

void steer_released(steer_state *steer, const core_config *config, const double *angle_rad)
{
    for (uint32_t j = 0; j < config->joint_count; j++) {
        const position_config *own = &config->joint[j].position;
        if (own->used) {
            bool measured_too = own->reference != REFERENCE_ESTIMATED && isfinite(angle_rad[j]);
            steer->profile[j].position_rad =
                measured_too ? angle_rad[j] : steer->profile[j].position_rad;
            steer->profile[j].velocity_rad_s = 0.0;
        }
    }
    steer->enabled = 0;
    steer->misaligned_rad = 0.0;
}

bool steer_setpoints(const steer_state *steer, const core_config *config, joint_setpoint *joint,
                     double *angle_rad)
{
    bool moving = false;
    for (uint32_t j = 0; j < config->joint_count; j++) {
        const position_config *own = &config->joint[j].position;
        const position_profile *profile = &steer->profile[j];
        if (own->used) {
            joint[j] = (joint_setpoint){.velocity_rad_s = profile->velocity_rad_s};
            moving |= profile->velocity_rad_s != 0.0;
        }
        if (own->used && own->reference == REFERENCE_ESTIMATED) {
            angle_rad[j] = profile->position_rad;
        }
    }
    return moving;
}

uint32_t steer_positions(const steer_state *steer, const core_config *config, bool enabled,
                         double *position_rad)
{
    uint32_t positioned = 0;
    for (uint32_t j = 0; j < config->joint_count; j++) {
        double at_rad = steer->profile[j].position_rad;
        bool counts = enabled && config->joint[j].position.used && !(steer->unknown >> j & 1U) &&
                      isfinite(at_rad);
        position_rad[j] = counts ? at_rad : 0.0;
        positioned |= (counts ? 1U : 0U) << j;
    }
    return positioned;
}
