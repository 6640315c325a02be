/* SPDX-License-Identifier: Apache-2.0
 *
 * core.c: one tick, from command and feedback to set-points and the snapshot. Time is an argument.
 *
 * The order is core_step()'s at the foot of the page. Set-points are built from zero in each tick.
 */
#include "core.h"
#include "wheel.h"

#include <errno.h>
#include <math.h>
#include <string.h>

static const double DT_MAX_S = 0.1; /* after a longer pause the ramps go on as if it had been this */
static const int64_t HOLD_AT_ZERO_NS = 2000000000; /* after a fault: zero this long, and the power goes off anyway */

static void zero_at_once(core_state *state, tick *t, setpoints *out)
{
    for (uint32_t j = 0; j < state->config.joint_count; j++) {
        joint_state *joint = &state->snapshot.joint[j];
        t->checksum += joint->duty;
        out->joint[j].velocity_rad_s = joint->setpoint_rad_s = 0.0;
        out->joint[j].duty = joint->duty = 0.0;
    }
    state->linear = state->angular = (limit_state){0};
    t->moving = false;
}

/* false: no ramp, the set-points are zero now */
static bool may_ramp(const core_state *state, const tick *t)
{
    if (t->dt_s == 0.0)
        return false;
    if (state->holding)
        return watch_fault_action(state) != STOP_BRAKE;
    bool stopping = t->input->control.stop || !t->command_fresh;
    return state->armed && !(stopping && state->config.on_timeout == STOP_BRAKE);
}

static double within(double want, double limit)
{
    return fabs(want) <= limit ? want : copysign(limit, want);
}

/* The twist to ramp to. Scaled to what the wheels can do before the ramp; else the two axes, scaled after
 * it alone, would settle at the ratio of their accelerations and not at that of the command. */
static void set_goal(core_state *state, const tick *t)
{
    core_goal *goal = &state->goal;
    double wheel_rad_s[JOINTS_MAX];
    const core_config *config = &state->config;
    double linear_m_s = within(t->wanted_linear_m_s, state->limits.linear.velocity_u_s);
    double angular_rad_s = within(t->wanted_angular_rad_s, state->limits.angular.velocity_u_s);
    goal->wanted_linear_m_s = t->wanted_linear_m_s;
    goal->wanted_angular_rad_s = t->wanted_angular_rad_s;
    kinematics_wheels(config, linear_m_s, angular_rad_s, wheel_rad_s);
    goal->saturation = saturate_factor(wheel_rad_s, config->joint, config->joint_count);
    goal->linear_m_s = linear_m_s * goal->saturation;
    goal->angular_rad_s = angular_rad_s * goal->saturation;
    goal->reasons = (linear_m_s != t->wanted_linear_m_s ? (uint32_t)REASON_LINEAR_VELOCITY : 0)
        | (angular_rad_s != t->wanted_angular_rad_s ? (uint32_t)REASON_ANGULAR_VELOCITY : 0);
    goal->known = 1;
}

static void choose_goal(core_state *state, tick *t, double *linear_m_s, double *angular_rad_s)
{
    const core_goal *goal = &state->goal;
    *linear_m_s = *angular_rad_s = 0.0;
    if (!state->armed || t->input->control.stop || t->command_zero)
        return;
    if (t->wanted_linear_m_s != goal->wanted_linear_m_s || t->wanted_angular_rad_s != goal->wanted_angular_rad_s
        || !goal->known)
        set_goal(state, t);
    *linear_m_s = goal->linear_m_s;
    *angular_rad_s = goal->angular_rad_s;
    t->saturation = goal->saturation;
    t->reasons |= goal->reasons;
}

/* The speeds that the ramps want of the wheels, and the common factor that saturates them. */
static double wish_speeds(const core_state *state, double *wheel_rad_s)
{
    uint32_t count = state->config.joint_count;
    double linear_m_s = state->linear.velocity_u_s;
    double turn_m_s = state->angular.velocity_u_s * state->config.track_m * 0.5;
    double factor = 1.0;
    for (uint32_t j = 0; j < count; j++) {
        const joint_config *joint = &state->config.joint[j];
        double speed_rad_s = wheel_speed(joint, linear_m_s, turn_m_s);
        wheel_rad_s[j] = speed_rad_s;
        if (!wheel_within(joint, speed_rad_s))
            factor = fmin(factor, wheel_share(joint, speed_rad_s));
    }
    return factor;
}

static void set_wheels(core_state *state, tick *t, double dt_s, setpoints *out)
{
    double wheel_rad_s[JOINTS_MAX];
    double factor = wish_speeds(state, wheel_rad_s);
    if (factor < 1.0) {
        /* back into the ramps, or they would wind up beyond what the wheels do */
        state->linear.velocity_u_s *= factor;
        state->angular.velocity_u_s *= factor;
        t->saturation *= factor;
    }
    uint32_t count = state->config.joint_count;
    uint32_t reasons = t->saturation < 1.0 ? REASON_WHEEL_SATURATED : 0;
    double checksum = t->checksum;
    for (uint32_t j = 0; j < count; j++) {
        joint_state *joint = &state->snapshot.joint[j];
        double speed_rad_s = wheel_rad_s[j] * factor;
        double last_duty = joint->duty;
        pwm_output output = wheel_duty(&state->config.joint[j].pwm, last_duty, speed_rad_s, dt_s);
        out->joint[j].velocity_rad_s = joint->setpoint_rad_s = speed_rad_s;
        out->joint[j].duty = joint->duty = output.duty;
        reasons |= output.reasons;
        checksum += last_duty + output.duty;
    }
    t->checksum = checksum;
    t->reasons |= reasons;
    t->moving = state->linear.velocity_u_s != 0.0 || state->angular.velocity_u_s != 0.0;
}

/* goal → limit → kinematics → saturate → PWM */
static void drive(core_state *state, tick *t, setpoints *out)
{
    if (!may_ramp(state, t)) {
        zero_at_once(state, t, out);
        return;
    }
    double dt_s = t->dt_s < DT_MAX_S ? t->dt_s : DT_MAX_S;
    bool urgent = state->holding != 0;
    double linear_m_s, angular_rad_s;
    choose_goal(state, t, &linear_m_s, &angular_rad_s);
    limited linear = limit_step(&state->linear, &state->limits.linear, linear_m_s, dt_s, urgent);
    limited angular = limit_step(&state->angular, &state->limits.angular, angular_rad_s, dt_s, urgent);
    t->reasons |= linear.reasons | angular.reasons << 4;
    set_wheels(state, t, dt_s, out);
}

static bool all_slow(const core_state *state)
{
    for (uint32_t j = 0; j < state->config.joint_count; j++)
        /* a wheel that measures nothing (NaN) is as fast as its set-point */
        if (!state->stale[j] && fabs(state->odometry.joint[j].velocity_rad_s) >= state->config.rest_velocity_rad_s)
            return false;
    return true;
}

/* Without a new sample and without a joint that has gone silent there is nothing to measure. */
static void measure(core_state *state, tick *t)
{
    if (!t->news)
        return;
    double setpoint_rad_s[JOINTS_MAX];
    for (uint32_t j = 0; j < state->config.joint_count; j++)
        setpoint_rad_s[j] = state->snapshot.joint[j].setpoint_rad_s;
    odometry_step(&state->odometry, &state->config, t->input->feedback, state->stale, setpoint_rad_s);
    if (state->odometry.blind)
        odometry_drift(&state->odometry, &state->config, setpoint_rad_s, t->dt_s);
    if (!odometry_finite(&state->odometry, state->config.joint_count)) {
        uint32_t epoch = state->odometry.epoch;
        odometry_init(&state->odometry, &state->config);
        state->odometry.epoch = epoch + 1;
        t->checksum = NAN;
    }
    state->slow = all_slow(state);
    snapshot_write_feedback(state, t);
}

/* The last look at what has been computed: nothing that is not a number leaves. */
static void guard(core_state *state, tick *t, setpoints *out)
{
    if (isfinite(t->checksum))
        return;
    zero_at_once(state, t, out);
    t->saturation = 1.0;
    state->goal.known = 0;
    watch_latch(state, FAULT_STATE);
}

/* When a fault has brought the base to rest, the power goes off. */
static void release(core_state *state, const tick *t)
{
    int64_t now_ns = t->input->now_ns;
    if (watch_fault_action(state) == STOP_HOLD)
        return;
    if (t->moving)
        state->zero_since_ns = 0;
    else if (state->zero_since_ns == 0)
        state->zero_since_ns = now_ns;
    /* unsigned: a clock that runs backwards ends the hold as well */
    uint64_t zero_ns = (uint64_t)now_ns - (uint64_t)state->zero_since_ns;
    bool overdue = !t->moving && zero_ns > (uint64_t)HOLD_AT_ZERO_NS;
    if ((state->at_rest && !t->any_stale) || overdue)
        state->holding = 0;
}

int core_init(core_state *state, const core_config *config)
{
    char name[FIELD_NAME_BYTES];
    if (core_config_check(config, name) != NULL)
        return -EINVAL;
    memset(state, 0, sizeof *state);
    state->config = *config;
    state->limits = config->limits;
    state->silent = 1;
    state->slow = 1;
    state->at_rest = 1;
    state->snapshot.joint_count = config->joint_count;
    odometry_init(&state->odometry, config);
    return 0;
}

void core_step(core_state *state, const core_input *input, double dt_s, setpoints *out, robot_state *snapshot)
{
    tick t;
    memset(out, 0, sizeof *out);
    state->tick++;
    watch(state, input, dt_s, &t);
    drive(state, &t, out);
    measure(state, &t);
    guard(state, &t, out);
    state->at_rest = !t.moving && state->slow;
    if (state->holding)
        release(state, &t);
    out->stamp_ns = input->now_ns;
    out->tick = state->tick;
    out->enabled = state->armed | state->holding;
    out->joint_count = state->config.joint_count;
    snapshot_write(state, &t);
    *snapshot = state->snapshot;
}
