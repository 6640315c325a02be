/* SPDX-License-Identifier: Apache-2.0
 *
 * check.c: checks every number of a configuration before it is used.
 */
#include "core.h"

#include <math.h>
#include <stdio.h>

/* Limits for "greater than zero" and "finite": wide enough for any machine, narrow enough that no
 * product of two or three such numbers leaves the range of a double. */
#define LEAST 1e-12
#define MOST 1e9

static const double HALF_TURN_RAD = 3.1415;
static const double ROUNDING = 1e-9;

typedef struct {
    const char *name;
    size_t offset;
    double low;
    double high;
} rule;

#define RULE(type, field, low, high) {#field, offsetof(type, field), low, high}
#define COUNT(rules) (sizeof(rules) / sizeof(rules)[0])

static const rule LIMIT_RULES[] = {
    RULE(base_limits, linear.velocity_u_s, LEAST, MOST),
    RULE(base_limits, linear.acceleration_u_s2, LEAST, MOST),
    RULE(base_limits, linear.deceleration_u_s2, LEAST, MOST),
    RULE(base_limits, linear.jerk_u_s3, LEAST, INFINITY),
    RULE(base_limits, angular.velocity_u_s, LEAST, MOST),
    RULE(base_limits, angular.acceleration_u_s2, LEAST, MOST),
    RULE(base_limits, angular.deceleration_u_s2, LEAST, MOST),
    RULE(base_limits, angular.jerk_u_s3, LEAST, INFINITY),
    RULE(base_limits, lateral.velocity_u_s, LEAST, MOST),
    RULE(base_limits, lateral.acceleration_u_s2, LEAST, MOST),
    RULE(base_limits, lateral.deceleration_u_s2, LEAST, MOST),
    RULE(base_limits, lateral.jerk_u_s3, LEAST, INFINITY),
};

static const rule CONFIG_RULES[] = {
    RULE(core_config, command_timeout_s, LEAST, MOST),
    RULE(core_config, feedback_timeout_s, LEAST, MOST),
    RULE(core_config, heartbeat_timeout_s, LEAST, MOST),
    RULE(core_config, rest_velocity_rad_s, LEAST, MOST),
    RULE(core_config, distance_variance_m2_per_m, LEAST, MOST),
    RULE(core_config, turn_variance_rad2_per_rad, LEAST, MOST),
    RULE(core_config, pose_variance_floor_m2, LEAST, MOST),
    RULE(core_config, heading_variance_floor_rad2, LEAST, MOST),
    RULE(core_config, twist_variance_floor_m2_s2, LEAST, MOST),
    RULE(core_config, twist_variance_floor_rad2_s2, LEAST, MOST),
};

/* Rules for a base with a gyro. */
static const rule GYRO_RULES[] = {
    RULE(core_config, gyro.timeout_s, LEAST, MOST),
    RULE(core_config, gyro.bias_max_rad_s, LEAST, MOST),
    RULE(core_config, gyro.still_variance_rad2_s2, LEAST, MOST),
    RULE(core_config, gyro.heading_variance_rad2_per_s, LEAST, MOST),
    RULE(core_config, gyro.turn_variance_rad2_per_rad, LEAST, MOST),
};

static const rule JOINT_RULES[] = {
    RULE(joint_config, row.x, -2.0, 2.0),
    RULE(joint_config, row.y, -2.0, 2.0),
    RULE(joint_config, row.lever_m, -MOST, MOST),
    RULE(joint_config, wheel_radius_m, LEAST, MOST),
    RULE(joint_config, velocity_min_rad_s, -MOST, 0.0),
    RULE(joint_config, velocity_max_rad_s, LEAST, MOST),
    RULE(joint_config, pwm.dead_band, 0.0, 1.0),
    RULE(joint_config, pwm.duty_min, -1.0, 0.0),
    RULE(joint_config, pwm.duty_max, 0.0, 1.0),
    RULE(joint_config, pwm.slew_per_s, LEAST, INFINITY),
    RULE(joint_config, pwm.full_duty_rad_s, LEAST, MOST),
    RULE(joint_config, speed_loop.gains.gain_u_s_per_rad, 0.0, MOST),
    RULE(joint_config, speed_loop.gains.integral_u_per_rad, 0.0, MOST),
    RULE(joint_config, speed_loop.gains.derivative_u_s2_per_rad, 0.0, MOST),
    RULE(joint_config, speed_loop.gains.static_u, 0.0, MOST),
    RULE(joint_config, speed_loop.gains.viscous_u_s_per_rad, 0.0, MOST),
    RULE(joint_config, speed_loop.gains.acceleration_u_s2_per_rad, 0.0, MOST),
    RULE(joint_config, speed_loop.filter_s, 0.0, MOST),
    RULE(joint_config, speed_loop.correction_max_u, 0.0, MOST),
    RULE(joint_config, speed_loop.output_min_u, -MOST, 0.0),
    RULE(joint_config, speed_loop.output_max_u, 0.0, MOST),
    RULE(joint_config, derating.range[DERATED_BY_TEMPERATURE].full, -MOST, MOST),
    RULE(joint_config, derating.range[DERATED_BY_TEMPERATURE].none, -MOST, MOST),
    RULE(joint_config, derating.range[DERATED_BY_CURRENT].full, -MOST, MOST),
    RULE(joint_config, derating.range[DERATED_BY_CURRENT].none, -MOST, MOST),
    RULE(joint_config, derating.range[DERATED_BY_VOLTAGE].full, -MOST, MOST),
    RULE(joint_config, derating.range[DERATED_BY_VOLTAGE].none, -MOST, MOST),
    RULE(joint_config, plausible.setpoint_min_rad_s, 0.0, MOST),
    RULE(joint_config, plausible.slow_rad_s, 0.0, MOST),
    RULE(joint_config, plausible.short_rad_s, 0.0, MOST),
    RULE(joint_config, plausible.beyond_rad_s, 0.0, MOST),
    RULE(joint_config, plausible.apart_rad_s, 0.0, MOST),
    RULE(joint_config, plausible.progress_rad_s, 0.0, MOST),
    RULE(joint_config, plausible.direction_s, 0.0, MOST),
    RULE(joint_config, plausible.stall_s, 0.0, MOST),
    RULE(joint_config, plausible.following_s, 0.0, MOST),
    RULE(joint_config, plausible.runaway_s, 0.0, MOST),
    RULE(joint_config, plausible.apart_s, 0.0, MOST),
};

/* Rules for a joint without a base that takes velocities. */
static const rule OWN_RULES[] = {
    RULE(joint_config, own.acceleration_u_s2, LEAST, MOST),
    RULE(joint_config, own.deceleration_u_s2, LEAST, MOST),
    RULE(joint_config, own.jerk_u_s3, LEAST, INFINITY),
};

/* Rules for new limits of a running joint without a base. */
static const rule CHANGED_RULES[] = {
    RULE(axis_limits, velocity_u_s, LEAST, MOST),
    RULE(axis_limits, acceleration_u_s2, LEAST, MOST),
    RULE(axis_limits, deceleration_u_s2, LEAST, MOST),
    RULE(axis_limits, jerk_u_s3, LEAST, INFINITY),
};

/* Rules for a joint that takes positions. */
static const rule POSITION_RULES[] = {
    RULE(joint_config, position.position_min_rad, -MOST, 0.0),
    RULE(joint_config, position.position_max_rad, 0.0, MOST),
    RULE(joint_config, position.velocity_rad_s, LEAST, MOST),
    RULE(joint_config, position.acceleration_rad_s2, LEAST, MOST),
    RULE(joint_config, position.following_rad, 0.0, MOST),
    RULE(joint_config, position.following_s, 0.0, MOST),
};

static const rule MODULE_RULES[] = {
    RULE(wheel_module, x_m, -MOST, MOST),
    RULE(wheel_module, y_m, -MOST, MOST),
    RULE(wheel_module, angle_rad, -7.0, 7.0),
};

/* Return the first field out of its range. NaN is out of every range. */
static const char *first_bad(const void *values, const rule *rules, size_t count)
{
    for (size_t i = 0; i < count; i++) {
        const double *value = (const void *)((const char *)values + rules[i].offset);
        if (!(*value >= rules[i].low && *value <= rules[i].high)) {
            return rules[i].name;
        }
    }
    return NULL;
}

static const char *bad_joint_field(const joint_config *joint)
{
    const char *bad = first_bad(joint, JOINT_RULES, COUNT(JOINT_RULES));
    if (bad != NULL) {
        return bad;
    }
    uint32_t bits = joint->counter_bits;
    if (bits != 0 && bits != 8 && bits != 12 && bits != 15 && bits != 16 && bits != 24 &&
        bits != 32 && bits != 64) {
        return "counter_bits";
    }
    if (joint->counter_mantissa_bits > 53) {
        return "counter_mantissa_bits";
    }
    if (bits != 0 && !(fabs(joint->rad_per_count) >= LEAST && fabs(joint->rad_per_count) <= MOST)) {
        return "rad_per_count";
    }
    const derating_range *range = joint->derating.range;
    if (range[DERATED_BY_TEMPERATURE].none < range[DERATED_BY_TEMPERATURE].full ||
        range[DERATED_BY_CURRENT].none < range[DERATED_BY_CURRENT].full ||
        range[DERATED_BY_VOLTAGE].none > range[DERATED_BY_VOLTAGE].full) {
        return "derating.range";
    }
    if (joint->speed_loop.kind > SPEED_LOOP_DUTY) {
        return "speed_loop.kind";
    }
    if (joint->position.used == 0) {
        return joint->line < LINES_MAX ? NULL : "line";
    }
    bad = first_bad(joint, POSITION_RULES, COUNT(POSITION_RULES));
    if (bad != NULL) {
        return bad;
    }
    if (!(joint->position.position_min_rad < joint->position.position_max_rad)) {
        return "position.position_max_rad";
    }
    if (joint->position.used != 1 || joint->position.reference > REFERENCE_ESTIMATED) {
        return joint->position.used != 1 ? "position.used" : "position.reference";
    }
    if (bits == 0 && joint->position.reference != REFERENCE_ESTIMATED) {
        return "counter_bits"; /* an angle that is measured needs it */
    }
    return joint->line < LINES_MAX ? NULL : "line";
}

/* A fixed wheel of a base with modules rolls straight on, on the axle about which the base turns:
 * on any other axle it would slide. */
static const char *bad_module_field(const core_config *config, const wheel_module *module,
                                    uint32_t *named)
{
    const char *bad = first_bad(module, MODULE_RULES, COUNT(MODULE_RULES));
    if (bad != NULL) {
        return bad;
    }
    uint32_t own[2] = {module->steering, module->traction};
    for (int i = 0; i < 2; i++) {
        const char *name = i == 0 ? "steering" : "traction";
        if (own[i] > config->joint_count) {
            return name;
        }
        uint32_t bit = own[i] == 0 ? 0 : 1U << (own[i] - 1);
        if ((*named & bit) ||
            (own[i] != 0 && (config->joint[own[i] - 1].position.used == 1) != (i == 0))) {
            return name;
        }
        *named |= bit;
    }
    if (module->steering != 0) {
        const position_config *range = &config->joint[module->steering - 1].position;
        bool enough = range->position_max_rad - range->position_min_rad >= HALF_TURN_RAD;
        if (kinematics_strafes(config)) {
            return enough ? NULL : "steering";
        }
        return module->x_m != 0.0 ? NULL : "x_m";
    }
    if (fabs(module->x_m) > ROUNDING || fabs(module->angle_rad) > ROUNDING) {
        return module->angle_rad != 0.0 ? "angle_rad" : "x_m";
    }
    return NULL;
}

/* Every joint belongs to one module, with one role. */
static const char *bad_modules(const core_config *config, char *name)
{
    uint32_t named = 0, steered = 0;
    if (config->module_count > JOINTS_MAX) {
        return "module_count";
    }
    for (uint32_t i = 0; i < config->module_count; i++) {
        const char *bad = bad_module_field(config, &config->module[i], &named);
        if (bad != NULL) {
            snprintf(name, FIELD_NAME_BYTES, "module[%u].%s", i, bad);
            return name;
        }
        steered += config->module[i].steering != 0;
    }
    for (uint32_t j = 0; j < config->joint_count; j++) {
        if (config->independent == 1) {
            continue;
        }
        if (config->module_count > 0 ? !(named >> j & 1U) : config->joint[j].position.used != 0) {
            snprintf(name, FIELD_NAME_BYTES, "joint[%u]: no module", j);
            return name;
        }
    }
    return config->module_count > 0 && steered == 0 ? "module_count" : NULL;
}

static const char *bad_base_field(const core_config *config)
{
    if (config->independent > 1 || (config->independent == 1 && config->module_count != 0)) {
        return "independent";
    }
    if (config->joint_count < (config->independent ? 1 : 2) || config->joint_count > JOINTS_MAX) {
        return "joint_count";
    }
    if ((uint32_t)config->on_timeout > STOP_COAST) {
        return "on_timeout";
    }
    if ((uint32_t)config->on_fault > STOP_COAST) {
        return "on_fault";
    }
    if ((uint32_t)config->on_estop > STOP_COAST) {
        return "on_estop";
    }
    const char *bad = first_bad(config, CONFIG_RULES, COUNT(CONFIG_RULES));
    if (bad != NULL || config->gyro.used == 0) {
        return bad;
    }
    return config->gyro.used == 1 && !config->independent
               ? first_bad(config, GYRO_RULES, COUNT(GYRO_RULES))
               : "gyro.used";
}

bool joint_limits_good(const axis_limits *limits)
{
    return first_bad(limits, CHANGED_RULES, COUNT(CHANGED_RULES)) == NULL;
}

const char *base_limits_check(const base_limits *limits, char *name)
{
    const char *bad = first_bad(limits, LIMIT_RULES, COUNT(LIMIT_RULES));
    if (bad == NULL) {
        return NULL;
    }
    snprintf(name, FIELD_NAME_BYTES, "%s", bad);
    return name;
}

const char *core_config_check(const core_config *config, char *name)
{
    const char *bad = bad_base_field(config);
    if (bad != NULL) {
        snprintf(name, FIELD_NAME_BYTES, "%s", bad);
        return name;
    }
    if (base_limits_check(&config->limits, name) != NULL) {
        snprintf(name, FIELD_NAME_BYTES, "limits.%s",
                 first_bad(&config->limits, LIMIT_RULES, COUNT(LIMIT_RULES)));
        return name;
    }
    for (uint32_t j = 0; j < config->joint_count; j++) {
        bad = bad_joint_field(&config->joint[j]);
        if (bad == NULL && config->independent && !config->joint[j].position.used) {
            bad = first_bad(&config->joint[j], OWN_RULES, COUNT(OWN_RULES));
        }
        if (bad != NULL) {
            snprintf(name, FIELD_NAME_BYTES, "joint[%u].%s", j, bad);
            return name;
        }
    }
    bad = bad_modules(config, name);
    if (bad != NULL) {
        return bad == name ? name : (snprintf(name, FIELD_NAME_BYTES, "%s", bad), name);
    }
    if (config->independent) {
        return NULL;
    }
    twist_inverse all;
    kinematics_invert(config, (1U << config->joint_count) - 1U, &all);
    if (!all.determined) {
        snprintf(name, FIELD_NAME_BYTES, config->module_count > 0 ? "module" : "joint.row");
        return name;
    }
    return NULL;
}
