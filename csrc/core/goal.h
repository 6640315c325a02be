/* SPDX-License-Identifier: Apache-2.0
 *
 * goal.h: the goal of the ramp: the commanded twist within the limits of the base and its wheels. A
 * part of core.c, like snapshot.h. */
#ifndef MOTORD_GOAL_H
#define MOTORD_GOAL_H

#include <math.h>
#include <string.h>

#include "snapshot.h"
#include "steer.h"

static inline double within(double want, double limit)
{
    return fabs(want) <= limit ? want : copysign(limit, want);
}

/* Limit linear and lateral motion by one factor, so that the direction stays. Returns the
 * reasons. */
static inline uint32_t limit_direction(const core_state *state, double *twist_u_s)
{
    double linear_m_s = twist_u_s[AXIS_LINEAR], lateral_m_s = twist_u_s[AXIS_LATERAL];
    double linear = within(linear_m_s, state->limits.linear.velocity_u_s);
    double lateral = within(lateral_m_s, state->limits.lateral.velocity_u_s);
    twist_u_s[AXIS_LINEAR] = linear;
    twist_u_s[AXIS_LATERAL] = lateral;
    /* scale by the one of the two that has to fall by the larger part; without a quotient, which
     * may round up, and not by one that is 0 */
    if (fabs(linear * lateral_m_s) < fabs(lateral * linear_m_s)) {
        twist_u_s[AXIS_LATERAL] = within(lateral_m_s * (linear / linear_m_s), fabs(lateral));
    } else if (lateral_m_s != 0.0) {
        twist_u_s[AXIS_LINEAR] = within(linear_m_s * (lateral / lateral_m_s), fabs(linear));
    }
    return (linear != linear_m_s ? (uint32_t)REASON_LINEAR_VELOCITY : 0) |
           (lateral != lateral_m_s ? (uint32_t)REASON_LATERAL_VELOCITY : 0);
}

/* Limit all axes by one factor, so that no axis exceeds its derated limit and the direction stays.
 * Returns the reasons. */
static inline uint32_t derate(const core_state *state, double *twist_u_s)
{
    const axis_limits *limits[AXES] = {&state->limits.linear, &state->limits.angular,
                                       &state->limits.lateral};
    double scale = 1.0;
    if (state->snapshot.derating.since_ns == 0) {
        return 0;
    }
    for (int i = 0; i < AXES; i++) {
        double most_u_s = state->snapshot.derating.factor * limits[i]->velocity_u_s;
        if (fabs(twist_u_s[i]) > most_u_s) {
            scale = fmin(scale, most_u_s / fabs(twist_u_s[i]));
        }
    }
    for (int i = 0; i < AXES; i++) {
        twist_u_s[i] *= scale;
    }
    return scale < 1.0 ? (uint32_t)REASON_DERATED : 0;
}

/* Return the joint that has to be slowed down by the largest part. */
static inline uint32_t most_saturated(const core_config *config, const double *wheel_rad_s)
{
    uint32_t worst = 0;
    double least = INFINITY;
    for (uint32_t j = 0; j < config->joint_count; j++) {
        double factor = saturate_factor(&wheel_rad_s[j], &config->joint[j], 1);
        if (factor < least) {
            least = factor;
            worst = j;
        }
    }
    return worst;
}

/* Set the goal, scaled to what the wheels can do: the ramp runs straight to it, and nothing is
 * scaled afterwards. */
static inline void set_goal(core_state *state)
{
    core_goal *goal = &state->goal;
    const core_config *config = &state->config;
    double wheel_rad_s[JOINTS_MAX], *twist_u_s = goal->goal_u_s;
    memcpy(twist_u_s, goal->wanted_u_s, sizeof goal->goal_u_s);
    goal->reasons = 0;
    if (state->axes < AXES && twist_u_s[AXIS_LATERAL] != 0.0) {
        twist_u_s[AXIS_LATERAL] = 0.0;
        goal->reasons = REASON_LATERAL_IMPOSSIBLE;
    }
    if (state->steered && state->axes < AXES) {
        goal->reasons |=
            steer_within_reach(&state->steer, &state->limits, goal->wanted_u_s, twist_u_s);
    } else {
        goal->reasons |= limit_direction(state, twist_u_s);
        twist_u_s[AXIS_ANGULAR] =
            within(twist_u_s[AXIS_ANGULAR], state->limits.angular.velocity_u_s);
        goal->reasons |= twist_u_s[AXIS_ANGULAR] != goal->wanted_u_s[AXIS_ANGULAR]
                             ? (uint32_t)REASON_ANGULAR_VELOCITY
                             : 0;
    }
    goal->reasons |= derate(state, twist_u_s);
    if (state->steered) {
        steer_speeds(&state->steer, config, twist_u_s, wheel_rad_s);
    } else {
        kinematics_wheels(config, twist_u_s, wheel_rad_s);
    }
    goal->saturation = saturate_factor(wheel_rad_s, config->joint, config->joint_count);
    if (goal->saturation < 1.0) {
        goal->reasons |= (uint32_t)REASON_WHEEL_SATURATED;
        state->snapshot.reason.saturated_joint = most_saturated(config, wheel_rad_s);
    }
    for (int i = 0; i < AXES; i++) {
        twist_u_s[i] *= goal->saturation;
    }
    goal->known = 1;
}

static inline void choose_goal(core_state *state, tick *t, double *goal_u_s)
{
    const core_goal *goal = &state->goal;
    memset(goal_u_s, 0, sizeof goal->goal_u_s);
    if (!t->go || t->command_zero) {
        return;
    }
    if (!goal->known) {
        set_goal(state);
    }
    memcpy(goal_u_s, goal->goal_u_s, sizeof goal->goal_u_s);
    t->saturation = goal->saturation;
    t->reasons |= goal->reasons;
}

/* Find the joint that derates the base most. */
__attribute__((noinline)) static void take_derating(core_state *state, const tick *t)
{
    derating_shown now = {.factor = 1.0}, *shown = &state->snapshot.derating;
    for (uint32_t j = 0; j < state->config.joint_count; j++) {
        const derating_config *config = &state->config.joint[j].derating;
        uint32_t by = 0;
        if (!derating_used(config) || state->stale[j]) {
            continue;
        }
        double factor = derating_factor(&state->derating[j], config, &t->input->feedback[j], &by);
        if (factor < now.factor) {
            now = (derating_shown){.factor = factor, .joint = j, .by = by};
        }
    }
    bool same = now.joint == shown->joint && now.by == shown->by && shown->since_ns != 0;
    now.since_ns = now.factor < 1.0 ? (same ? shown->since_ns : t->input->now_ns) : 0;
    if (now.factor != shown->factor) {
        state->goal.known = 0;
    }
    *shown = now;
}

#endif
