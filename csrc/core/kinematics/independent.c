/* SPDX-License-Identifier: Apache-2.0
 *
 * independent.c: joints without a base, each with its own limits: a pan-tilt head, a lift, a
 * conveyor.
 *
 * A joint that takes velocities follows the ramp of limit.c. One that takes positions goes to its
 * target by position.c, within its range. A target belongs to the lease that gave it: it ends with
 * that lease, and with every stop. */
#include "independent.h"
#include "steer.h"

#include <math.h>
#include <string.h>

static bool names(const joint_command *command, uint32_t j)
{
    return command->named >> j & 1U;
}

bool joint_command_finite(const joint_command *command, const core_config *config)
{
    bool finite = true;
    for (uint32_t j = 0; j < config->joint_count; j++) {
        finite &= !names(command, j) || isfinite(command->value_u[j]);
    }
    return finite;
}

bool joint_command_zero(const joint_command *command, const core_config *config)
{
    bool zero = true;
    for (uint32_t j = 0; j < config->joint_count; j++) {
        zero &= !names(command, j) ||
                (config->joint[j].position.used == 0 && command->value_u[j] == 0.0);
    }
    return zero;
}

static void forget_targets(joints_state *joints)
{
    for (uint32_t j = 0; j < JOINTS_MAX; j++) {
        joints->target_rad[j] = NAN;
    }
}

void independent_halt(joints_state *joints, steer_state *steer, const core_config *config)
{
    forget_targets(joints);
    memset(joints->velocity_rad_s, 0, sizeof joints->velocity_rad_s);
    memset(joints->acceleration_rad_s2, 0, sizeof joints->acceleration_rad_s2);
    for (uint32_t j = 0; j < config->joint_count; j++) {
        steer->profile[j].velocity_rad_s = 0.0;
    }
}

static double within(double value, double low, double high)
{
    return fmin(fmax(value, low), high);
}

void independent_own_limits(axis_limits *in_force, const core_config *config)
{
    for (uint32_t j = 0; j < config->joint_count; j++) {
        const joint_config *joint = &config->joint[j];
        const position_config *own = &joint->position;
        axis_limits of_position = {own->velocity_rad_s, own->acceleration_rad_s2,
                                   own->acceleration_rad_s2, INFINITY};
        in_force[j] = own->used ? of_position : joint->own;
        if (!own->used) {
            in_force[j].velocity_u_s = fmax(joint->velocity_max_rad_s, -joint->velocity_min_rad_s);
        }
    }
}

void independent_take_limits(core_state *state, const core_control *control)
{
    if (control->joint_limits_count == state->joint_limits_seen) {
        return;
    }
    uint32_t count = state->config.joint_count;
    state->joint_limits_seen = control->joint_limits_count;
    for (uint32_t j = 0; j < count; j++) {
        if (!joint_limits_good(&control->joint_limits[j])) {
            return;
        }
    }
    memcpy(state->joint_limits, control->joint_limits, count * sizeof *state->joint_limits);
}

static uint32_t step_velocity(joints_state *joints, const joint_config *joint,
                              const joints_input *input, uint32_t j)
{
    const axis_limits *own = &input->limits[j];
    double wanted_rad_s =
        input->command != NULL && names(input->command, j) ? input->command->value_u[j] : 0.0;
    double least_rad_s = fmax(joint->velocity_min_rad_s, -own->velocity_u_s);
    double most_rad_s = fmin(joint->velocity_max_rad_s, own->velocity_u_s);
    double allowed_rad_s = within(wanted_rad_s, least_rad_s, most_rad_s);
    double goal_rad_s[AXES] = {
        within(allowed_rad_s, input->factor * least_rad_s, input->factor * most_rad_s)};
    limit_state axis[AXES] = {{joints->velocity_rad_s[j], joints->acceleration_rad_s2[j]}};
    base_limits limits = {.linear = *own};
    uint32_t reasons = allowed_rad_s != wanted_rad_s ? (uint32_t)REASON_JOINT_VELOCITY : 0;
    reasons |= goal_rad_s[0] != allowed_rad_s ? (uint32_t)REASON_DERATED : 0;
    if (ramp_step(axis, 1, &limits, NULL, goal_rad_s, input->dt_s, input->urgent) != 0) {
        reasons |= REASON_JOINT_ACCELERATION;
    }
    joints->velocity_rad_s[j] = axis[0].velocity_u_s;
    joints->acceleration_rad_s2[j] = axis[0].acceleration_u_s2;
    return reasons;
}

/* Whether the joint comes to rest before its goal and the end of its range when it brakes with
 * this. */
static bool stops_in_time(const position_profile *profile, const position_config *own,
                          double goal_rad, double braking_rad_s2, double dt_s)
{
    double velocity_rad_s = profile->velocity_rad_s,
           end_rad = own->position_max_rad - profile->position_rad;
    double left_rad = (goal_rad - profile->position_rad) * (velocity_rad_s < 0.0 ? -1.0 : 1.0);
    if (velocity_rad_s < 0.0) {
        end_rad = profile->position_rad - own->position_min_rad;
    }
    if (left_rad >= 0.0) { /* false for NaN (no goal), and for a goal that lies behind */
        end_rad = fmin(end_rad, left_rad);
    }
    double needs_rad =
        velocity_rad_s * velocity_rad_s / (2.0 * braking_rad_s2) + fabs(velocity_rad_s) * dt_s;
    return needs_rad <= end_rad;
}

/* Apply the limits in force. With a lowered acceleration, a joint that already brakes would pass
 * its goal, or the end of its range: it continues to brake with its old one, gets no faster, and
 * takes the new one as soon as that is enough. */
static void take_limits(joints_state *joints, const position_profile *profile, position_config *own,
                        const axis_limits *limits, double goal_rad, double dt_s, uint32_t j)
{
    double *braking_rad_s2 = &joints->braking_rad_s2[j], lowered_rad_s2 = limits->acceleration_u_s2;
    own->velocity_rad_s = fmin(own->velocity_rad_s, limits->velocity_u_s);
    if (lowered_rad_s2 >= *braking_rad_s2 || profile->velocity_rad_s == 0.0 ||
        stops_in_time(profile, own, goal_rad, lowered_rad_s2, dt_s)) {
        *braking_rad_s2 = lowered_rad_s2;
    } else {
        own->velocity_rad_s = fmin(own->velocity_rad_s, fabs(profile->velocity_rad_s));
    }
    own->acceleration_rad_s2 = *braking_rad_s2;
}

static uint32_t step_position(joints_state *joints, steer_state *steer, const core_config *config,
                              const joints_input *input, uint32_t j)
{
    position_config own = config->joint[j].position;
    uint32_t reasons = 0;
    if (input->command != NULL && names(input->command, j)) {
        joints->target_rad[j] = input->command->value_u[j];
    }
    double target_rad = joints->target_rad[j];
    double goal_rad = isnan(target_rad)
                          ? target_rad
                          : within(target_rad, own.position_min_rad, own.position_max_rad);
    if (target_rad != goal_rad && !isnan(target_rad)) {
        reasons |= REASON_JOINT_POSITION;
    }
    take_limits(joints, &steer->profile[j], &own, &input->limits[j], goal_rad, input->dt_s, j);
    if (input->factor < 1.0 && goal_rad != steer->profile[j].position_rad && !isnan(goal_rad)) {
        own.velocity_rad_s *= input->factor;
        reasons |= REASON_DERATED;
    }
    bool sure = steer_sure(steer, config, j, input->dt_s);
    position_profile *profile = &steer->profile[j];
    double from_rad = profile->position_rad;
    if (input->dt_s > 0.0) {
        position_step(profile, &own, sure ? goal_rad : (double)NAN, input->dt_s);
    }
    if (from_rad >= own.position_min_rad && from_rad <= own.position_max_rad) {
        /* if rounded, the last step could pass the end */
        profile->position_rad =
            within(profile->position_rad, own.position_min_rad, own.position_max_rad);
    }
    return reasons;
}

static void name_joint(reasons_shown *named, uint32_t reasons, uint32_t j)
{
    named->joint_velocity |= reasons & REASON_JOINT_VELOCITY ? 1U << j : 0;
    named->joint_acceleration |= reasons & REASON_JOINT_ACCELERATION ? 1U << j : 0;
    named->joint_position |= reasons & REASON_JOINT_POSITION ? 1U << j : 0;
}

uint32_t independent_step(joints_state *joints, steer_state *steer, const core_config *config,
                          const joints_input *input, double *velocity_rad_s, reasons_shown *named)
{
    uint32_t reasons = 0;
    named->joint_velocity = named->joint_acceleration = named->joint_position = 0;
    if (input->command == NULL || input->owner != joints->owner) {
        forget_targets(joints);
    }
    joints->owner = input->owner;
    for (uint32_t j = 0; j < config->joint_count; j++) {
        uint32_t own = config->joint[j].position.used
                           ? step_position(joints, steer, config, input, j)
                           : step_velocity(joints, &config->joint[j], input, j);
        reasons |= own;
        name_joint(named, own, j);
        velocity_rad_s[j] = joints->velocity_rad_s[j];
    }
    steer->enabled = 1;
    return reasons;
}
