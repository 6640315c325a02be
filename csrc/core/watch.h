/* SPDX-License-Identifier: Apache-2.0
 *
 * watch.h: decides whether the base may move: ages of what was received, faults and their latch,
 * arming. NaN does not pass a comparison that permits motion. A part of core.c, like snapshot.h. */
#ifndef MOTORD_WATCH_H
#define MOTORD_WATCH_H

#include "fresh.h"
#include "independent.h"
#include "rest.h"
#include "snapshot.h"
#include "steer.h"

#include <float.h>
#include <math.h>
#include <string.h>

static const double LEAST_COMMAND = 1e-9; /* m/s, rad/s: a smaller command counts as zero, so that
                                             no denormal is ever carried on */

/* Return the seconds since a stamp, by wrapping arithmetic: no stamp, however wrong, is undefined
 * behaviour. */
static inline double age_s(int64_t now_ns, int64_t stamp_ns)
{
    return stamp_ns > 0 ? (double)(int64_t)((uint64_t)now_ns - (uint64_t)stamp_ns) * 1e-9
                        : INFINITY;
}

static inline uint64_t window_ns(double timeout_s)
{
    return fresh_window_ns((int64_t)(timeout_s * 1e9 + 0.5));
}

/* Take a command that differs from the last one. */
static inline void take_command(core_goal *goal, const twist_command *command)
{
    const double twist_u_s[AXES] = {command->linear_m_s, command->angular_rad_s,
                                    command->lateral_m_s};
    bool finite = isfinite(twist_u_s[0]) && isfinite(twist_u_s[1]) && isfinite(twist_u_s[2]);
    bool zero = true;
    for (int i = 0; i < AXES; i++) {
        goal->command_u_s[i] = twist_u_s[i];
        goal->wanted_u_s[i] = finite && fabs(twist_u_s[i]) >= LEAST_COMMAND ? twist_u_s[i] : 0.0;
        zero &= goal->wanted_u_s[i] == 0.0;
    }
    /* a command that is NaN does not arm: it is not zero */
    goal->zero = finite && zero;
    goal->command_reasons = finite ? 0 : REASON_COMMAND_NOT_FINITE;
    goal->known = 0;
}

/* Take a joint command. This is done in each tick, because it may change without a new number. */
static inline void take_joints(core_state *state, const joint_command *command)
{
    bool finite = joint_command_finite(command, &state->config);
    state->goal.zero = finite && joint_command_zero(command, &state->config);
    state->goal.command_reasons = finite ? 0 : REASON_COMMAND_NOT_FINITE;
}

static inline void read_command(core_state *state, tick *t)
{
    const twist_command *command = &t->input->command;
    core_goal *goal = &state->goal;
    int64_t now_ns = t->input->now_ns;
    /* a NaN always differs from the last command */
    if (command->linear_m_s != goal->command_u_s[AXIS_LINEAR] ||
        command->angular_rad_s != goal->command_u_s[AXIS_ANGULAR] ||
        command->lateral_m_s != goal->command_u_s[AXIS_LATERAL]) {
        take_command(goal, command);
    }
    if (state->config.independent) {
        take_joints(state, &t->input->joints);
    }
    t->command_age_s = age_s(now_ns, command->stamp_ns);
    t->command_fresh = now_ns <= command->expires_ns &&
                       fresh_within(now_ns, command->stamp_ns, state->command_window_ns);
    t->command_zero = !t->command_fresh || goal->zero;
    t->reasons = t->command_fresh ? goal->command_reasons : (uint32_t)REASON_COMMAND_STALE;
}

/* Find the joints that send feedback, and the ages of their feedback. */
static inline void judge_feedback(core_state *state, tick *t)
{
    int64_t now_ns = t->input->now_ns;
    uint64_t within_ns = state->feedback_window_ns;
    state->silent = 0;
    for (uint32_t j = 0; j < state->config.joint_count; j++) {
        int64_t stamp_ns = t->input->feedback[j].stamp_ns;
        if (stamp_ns <= 0 || stamp_ns > now_ns) {
            state->snapshot.joint[j].feedback_age_s = stamp_ns <= 0 ? INFINITY : 0.0;
        }
        state->stale[j] = !fresh_within(now_ns, stamp_ns, within_ns);
        state->silent |= state->stale[j];
    }
}

static inline bool drive_disabled(const core_state *state, const joint_feedback *feedback)
{
    for (uint32_t j = 0; j < state->config.joint_count; j++) {
        if (feedback[j].enabled == 0 && feedback[j].stamp_ns > state->armed_ns) {
            return true;
        }
    }
    return false;
}

static inline void read_feedback(core_state *state, tick *t)
{
    int64_t now_ns = t->input->now_ns;
    uint32_t faults = 0, enabled = ~0U;
    /* age of the oldest stamp; a stamp from the future has the greatest */
    uint64_t is_new = state->silent, oldest_ns = 0;
    const joint_feedback *feedback = t->input->feedback;
    const joint_odometry *used = state->odometry.joint;
    joint_state *shown = state->snapshot.joint, *end = shown + state->config.joint_count;
    for (; shown != end; shown++, feedback++, used++) {
        uint64_t stamp_ns = (uint64_t)feedback->stamp_ns, age_ns = (uint64_t)now_ns - stamp_ns;
        shown->feedback_age_s = (double)(int64_t)age_ns * 1e-9;
        is_new |= stamp_ns ^ (uint64_t)used->stamp_ns;
        oldest_ns = age_ns > oldest_ns ? age_ns : oldest_ns;
        faults |= feedback->drive_faults;
        enabled &= feedback->enabled; /* 0 if a drive is not enabled; then a closer look follows */
    }
    /* all are fresh, as in the previous tick: no joint needs a closer look */
    int64_t first_ns = (int64_t)((uint64_t)now_ns - oldest_ns);
    bool received = state->silent == 0 && now_ns >= first_ns &&
                    fresh_within(now_ns, first_ns, state->feedback_window_ns);
    if (!received) {
        judge_feedback(state, t);
    }
    if (state->positions) {
        state->steer.unknown = steer_unknown(&state->config, t->input->feedback, state->stale,
                                             state->odometry.angle_rad);
    }
    t->is_new = is_new != 0 || !received;
    t->any_stale = state->silent != 0;
    t->drive_disabled = enabled == 0 && drive_disabled(state, t->input->feedback);
    t->drive_fault = faults != 0;
}

/* Read all that decides this tick, once. */
static inline void look(core_state *state, const core_input *input, double dt_s, tick *t)
{
    t->input = input;
    t->dt_s = dt_s > 0.0 && dt_s <= DBL_MAX ? dt_s : 0.0;
    t->saturation = 1.0;
    t->checksum = 0.0;
    t->heartbeat_fresh =
        fresh_within(input->now_ns, input->control.heartbeat_ns, state->heartbeat_window_ns);
    read_command(state, t);
    read_feedback(state, t);
}

/* Clear the faults only when their causes are gone and nothing moves or is commanded to. Feedback
 * that was not trusted is trusted again: a person has looked at the wheel. A reset never arms. */
static inline void reset(core_state *state, const tick *t)
{
    const core_control *control = &t->input->control;
    bool cause =
        control->estop || control->fault || t->any_stale || t->drive_fault || state->steer.unknown;
    if (cause || !t->command_zero || state->rest == REST_TURNING) {
        return;
    }
    state->faults = 0;
    state->holding = 0;
    state->doubted = 0;
    state->odometry.distrusted = 0;
    state->snapshot.doubt = (feedback_doubt){0};
    see_rest(state, t->input->now_ns);
}

static inline void obey_counters(core_state *state, const tick *t)
{
    const core_control *control = &t->input->control;
    if (control->reset_count != state->reset_seen) {
        state->reset_seen = control->reset_count;
        reset(state, t);
    }
    if (control->odometry_reset_count != state->odometry_reset_seen) {
        state->odometry_reset_seen = control->odometry_reset_count;
        odometry_reset(&state->odometry, &state->config);
        snapshot_write_feedback(state, t->input->feedback);
    }
}

static inline void take_limits(core_state *state, const base_limits *limits)
{
    char name[FIELD_NAME_BYTES];
    /* limits of an axis that the base does not have have no effect */
    bool same = memcmp(limits, &state->limits, offsetof(base_limits, lateral)) == 0 &&
                (state->axes < AXES ||
                 memcmp(&limits->lateral, &state->limits.lateral, sizeof limits->lateral) == 0);
    if (same || base_limits_check(limits, name) != NULL) {
        return;
    }
    state->limits = *limits;
    state->goal.known = 0;
}

static inline uint32_t causes(const core_state *state, const tick *t)
{
    uint32_t found = 0;
    if (t->input->control.estop) {
        found |= FAULT_ESTOP;
    }
    if (t->input->suspended) { /* all other causes follow from the suspend */
        return found | FAULT_SUSPENDED;
    }
    if (t->input->control.fault) {
        found |= FAULT_EXTERNAL;
    }
    if (t->dt_s == 0.0) {
        found |= FAULT_TIME_STEP;
    }
    if (!state->armed) {
        return found;
    }
    if (!t->heartbeat_fresh) {
        found |= FAULT_HEARTBEAT_LOST;
    }
    if (t->any_stale) {
        found |= FAULT_FEEDBACK_STALE;
    }
    if (t->drive_fault) {
        found |= FAULT_DRIVE;
    }
    if (t->drive_disabled) {
        found |= FAULT_DRIVE_DISABLED;
    }
    if (state->steer.unknown) {
        found |= FAULT_POSITION_UNKNOWN;
    }
    return found;
}

/* The e-stop's action replaces any other one in progress. Nothing replaces it, except for a drive
 * that does not follow its set-point: no set-point stops that, so the power goes off at once. A
 * ramp does not help a wheel that turns in the wrong direction either. */
static inline stop_action watch_fault_action(const core_state *state)
{
    stop_action action =
        state->faults & FAULT_ESTOP ? state->config.on_estop : state->config.on_fault;
    if (state->faults & FAULT_RUNAWAY) {
        return STOP_COAST;
    }
    return (state->faults & FAULT_DIRECTION) && action != STOP_COAST ? STOP_BRAKE : action;
}

/* When disarmed, a motion in progress ends by the stop action of the robot file. */
static inline void watch_latch(core_state *state, uint32_t faults)
{
    state->faults |= faults;
    if (state->faults == 0) {
        return;
    }
    if (state->armed) {
        state->armed = 0;
        state->holding = 1;
        state->zero_since_ns = 0;
    }
    if (watch_fault_action(state) == STOP_COAST) {
        state->holding = 0;
    }
}

static inline void arm_or_disarm(core_state *state, const tick *t)
{
    const core_control *control = &t->input->control;
    bool edge = control->armed && !state->armed_seen;
    state->armed_seen = control->armed;
    if (edge && state->faults == 0 && !t->any_stale && !t->drive_fault && !state->steer.unknown &&
        t->heartbeat_fresh && t->command_zero && !control->stop) {
        state->armed = 1;
        state->armed_ns = t->input->now_ns;
        state->commanded = 0;
    }
    if (!control->armed) {
        state->armed = 0;
    }
    /* a base that was armed before its first command does not move, so it need not coast */
    bool lapsed = control->stop || (!t->command_fresh && state->commanded);
    if (lapsed && state->config.on_timeout == STOP_COAST) {
        state->armed = 0;
    }
    state->commanded |= t->command_fresh;
}

/* Whether the base is armed, requested to continue, and without problems: the common tick, in which
 * nothing changes. */
static inline bool calm(const core_state *state, const tick *t)
{
    const core_control *control = &t->input->control;
    uint32_t attention = control->estop | control->fault | control->stop | t->input->suspended |
                         (control->reset_count ^ state->reset_seen) |
                         (control->odometry_reset_count ^ state->odometry_reset_seen);
    attention |= (uint32_t)t->any_stale | (uint32_t)t->drive_fault | (uint32_t)t->drive_disabled |
                 state->steer.unknown;
    uint32_t ready =
        state->armed & state->commanded & (uint32_t)t->heartbeat_fresh & (uint32_t)t->command_fresh;
    return attention == 0 && ready != 0 && control->armed != 0 && t->dt_s > 0.0;
}

/* Reads the input and decides whether the base may move: control, faults, arming. */
static inline void watch(core_state *state, const core_input *input, double dt_s, tick *t)
{
    look(state, input, dt_s, t);
    take_limits(state, &input->control.limits);
    t->go = t->calm = calm(state, t);
    if (t->calm) {
        return;
    }
    if (input->suspended) {
        gyro_lose(&state->odometry.gyro);
    }
    obey_counters(state, t);
    watch_latch(state, causes(state, t));
    arm_or_disarm(state, t);
    t->go = state->armed && !input->control.stop && t->command_fresh;
}

#endif
