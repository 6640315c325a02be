/* SPDX-License-Identifier: Apache-2.0
 *
 * core.c: one tick, from command and feedback to set-points and the snapshot. Time is an argument.
 *
 * The order is core_step()'s at the foot of the page. Two rules hold everywhere: set-points are built from zero
 * in each tick, and every comparison that lets something move is written so that NaN does not pass it.
 */
#include "core.h"

#include <errno.h>
#include <math.h>
#include <string.h>

static const double FUTURE_S = 0.010;        /* a stamp may be this much ahead of the tick: read while it began */
static const double DT_MAX_S = 0.1;          /* after a longer pause the ramps go on as if it had been this */
static const double LEAST_WISH = 1e-9;       /* m/s, rad/s: less is zero, so that no denormal is ever carried on */
static const int64_t HOLD_AT_ZERO_NS = 2000000000; /* after a fault: zero this long, and the power goes off anyway */

/* What one tick knows beside its state. */
typedef struct {
    const core_input *input;
    double dt_s;                /* 0: not a time step */
    double wanted_linear_m_s;
    double wanted_angular_rad_s;
    double command_age_s;
    double saturation;
    uint32_t reasons;
    bool command_fresh;
    bool command_zero;
    bool heartbeat_fresh;
    bool broken;                /* a number of the state was not finite */
    bool any_stale;
    bool drive_fault;
    bool drive_disabled;
    uint32_t stale[JOINTS_MAX];
    double age_s[JOINTS_MAX];
} tick;

/* INFINITY: never. Both stamps above zero, so that their difference cannot overflow. */
static double age_s(int64_t now_ns, int64_t stamp_ns)
{
    return now_ns > 0 && stamp_ns > 0 ? (double)(now_ns - stamp_ns) * 1e-9 : INFINITY;
}

static bool fresh(double age_s, double timeout_s)
{
    return age_s >= -FUTURE_S && age_s <= timeout_s;
}

static void read_command(const core_state *state, tick *t)
{
    const twist_command *command = &t->input->command;
    t->wanted_linear_m_s = t->wanted_angular_rad_s = 0.0;
    t->command_zero = true;
    t->command_age_s = age_s(t->input->now_ns, command->stamp_ns);
    t->command_fresh =
        fresh(t->command_age_s, state->config.command_timeout_s) && t->input->now_ns <= command->expires_ns;
    if (!t->command_fresh) {
        t->reasons |= REASON_COMMAND_STALE;
    } else if (!isfinite(command->linear_m_s) || !isfinite(command->angular_rad_s)) {
        t->reasons |= REASON_COMMAND_NOT_FINITE;
        t->command_zero = false; /* whoever sends this shall not arm */
    } else {
        t->wanted_linear_m_s = fabs(command->linear_m_s) < LEAST_WISH ? 0.0 : command->linear_m_s;
        t->wanted_angular_rad_s = fabs(command->angular_rad_s) < LEAST_WISH ? 0.0 : command->angular_rad_s;
        t->command_zero = t->wanted_linear_m_s == 0.0 && t->wanted_angular_rad_s == 0.0;
    }
}

static void read_feedback(const core_state *state, tick *t)
{
    t->any_stale = t->drive_fault = t->drive_disabled = false;
    for (uint32_t j = 0; j < state->config.joint_count; j++) {
        const joint_feedback *feedback = &t->input->feedback[j];
        t->age_s[j] = age_s(t->input->now_ns, feedback->stamp_ns);
        t->stale[j] = !fresh(t->age_s[j], state->config.feedback_timeout_s);
        t->any_stale |= t->stale[j] != 0;
        t->drive_fault |= feedback->drive_faults != 0;
        t->drive_disabled |= feedback->enabled == 0 && feedback->stamp_ns > state->armed_ns;
    }
}

/* Everything this tick will decide by, read once. */
static void look(const core_state *state, const core_input *input, double dt_s, tick *t)
{
    t->input = input;
    t->dt_s = dt_s > 0.0 && isfinite(dt_s) ? dt_s : 0.0;
    t->saturation = 1.0;
    t->reasons = 0;
    double beat_age_s = age_s(input->now_ns, input->control.heartbeat_ns);
    t->heartbeat_fresh = fresh(beat_age_s, state->config.heartbeat_timeout_s);
    double sum = state->linear.velocity_u_s + state->linear.acceleration_u_s2
        + state->angular.velocity_u_s + state->angular.acceleration_u_s2;
    for (uint32_t j = 0; j < state->config.joint_count; j++)
        sum += state->duty[j];
    t->broken = !isfinite(sum);
    read_command(state, t);
    read_feedback(state, t);
}

/* Faults go only when their causes are gone and nothing moves or wants to. A reset never arms. */
static void reset(core_state *state, const tick *t)
{
    const core_control *control = &t->input->control;
    bool cause = control->estop || control->fault || t->any_stale || t->drive_fault;
    if (cause || !t->command_zero || !state->at_rest)
        return;
    state->faults = 0;
    state->holding = 0;
}

static void obey_control(core_state *state, const tick *t)
{
    const core_control *control = &t->input->control;
    if (control->reset_count != state->reset_seen)
        reset(state, t);
    state->reset_seen = control->reset_count;
    if (control->odometry_reset_count != state->odometry_reset_seen)
        odometry_reset(&state->odometry, &state->config);
    state->odometry_reset_seen = control->odometry_reset_count;
    if (base_limits_good(&control->limits))
        state->limits = control->limits;
}

static uint32_t causes(const core_state *state, const tick *t)
{
    uint32_t found = 0;
    if (t->input->control.estop)
        found |= FAULT_ESTOP;
    if (t->input->control.fault)
        found |= FAULT_EXTERNAL;
    if (t->dt_s == 0.0)
        found |= FAULT_TIME_STEP;
    if (t->broken)
        found |= FAULT_STATE;
    if (!state->armed)
        return found;
    if (!t->heartbeat_fresh)
        found |= FAULT_HEARTBEAT_LOST;
    if (t->any_stale)
        found |= FAULT_FEEDBACK_STALE;
    if (t->drive_fault)
        found |= FAULT_DRIVE;
    if (t->drive_disabled)
        found |= FAULT_DRIVE_DISABLED;
    return found;
}

/* The e-stop's action replaces any other that is under way, and nothing replaces it. */
static stop_action fault_action(const core_state *state)
{
    return state->faults & FAULT_ESTOP ? state->config.on_estop : state->config.on_fault;
}

static void latch_faults(core_state *state, const tick *t)
{
    state->faults |= causes(state, t);
    if (state->faults != 0 && state->armed) {
        state->armed = 0;
        state->holding = 1;
        state->zero_since_ns = 0;
    }
    if (state->holding && fault_action(state) == STOP_COAST)
        state->holding = 0;
}

static void arm_or_disarm(core_state *state, const tick *t)
{
    const core_control *control = &t->input->control;
    bool edge = control->armed && !state->armed_seen;
    bool well = state->faults == 0 && !t->any_stale && !t->drive_fault && t->heartbeat_fresh && t->command_zero
        && !control->stop;
    state->armed_seen = control->armed;
    if (edge && well) {
        state->armed = 1;
        state->armed_ns = t->input->now_ns;
        state->commanded = 0;
    }
    state->commanded |= t->command_fresh;
    /* a base armed before its first command has nothing to coast from */
    bool lapsed = control->stop || (!t->command_fresh && state->commanded);
    if (!control->armed || (lapsed && state->config.on_timeout == STOP_COAST))
        state->armed = 0;
}

static void zero_at_once(core_state *state)
{
    state->linear = state->angular = (limit_state){0};
    for (uint32_t j = 0; j < JOINTS_MAX; j++)
        state->setpoint_rad_s[j] = state->duty[j] = 0.0;
}

/* false: no ramp, the set-points are zero now */
static bool may_ramp(const core_state *state, const tick *t)
{
    if (t->dt_s == 0.0 || t->broken)
        return false;
    if (state->holding)
        return fault_action(state) != STOP_BRAKE;
    bool stopping = t->input->control.stop || !t->command_fresh;
    return state->armed && !(stopping && state->config.on_timeout == STOP_BRAKE);
}

static double factor(const core_state *state, double linear_m_s, double angular_rad_s, double *wheel_rad_s)
{
    kinematics_wheels(&state->config, linear_m_s, angular_rad_s, wheel_rad_s);
    return saturate_factor(wheel_rad_s, state->config.joint, state->config.joint_count);
}

static double within(double want, double limit)
{
    return fabs(want) <= limit ? want : copysign(limit, want);
}

/* The twist to ramp to. Scaled to what the wheels can do before the ramp, else the two axes, scaled after
 * it alone, would settle at the ratio of their accelerations and not at that of the command. */
static void choose_goal(const core_state *state, tick *t, double *linear_m_s, double *angular_rad_s)
{
    *linear_m_s = *angular_rad_s = 0.0;
    if (!state->armed || t->input->control.stop || t->command_zero)
        return;
    double wheel_rad_s[JOINTS_MAX];
    *linear_m_s = within(t->wanted_linear_m_s, state->limits.linear.velocity_u_s);
    *angular_rad_s = within(t->wanted_angular_rad_s, state->limits.angular.velocity_u_s);
    if (*linear_m_s != t->wanted_linear_m_s)
        t->reasons |= REASON_LINEAR_VELOCITY;
    if (*angular_rad_s != t->wanted_angular_rad_s)
        t->reasons |= REASON_ANGULAR_VELOCITY;
    t->saturation = factor(state, *linear_m_s, *angular_rad_s, wheel_rad_s);
    *linear_m_s *= t->saturation;
    *angular_rad_s *= t->saturation;
}

static void set_wheels(core_state *state, tick *t, double dt_s)
{
    double *wheel_rad_s = state->setpoint_rad_s;
    double share = factor(state, state->linear.velocity_u_s, state->angular.velocity_u_s, wheel_rad_s);
    if (share < 1.0) {
        /* back into the ramps, or they would wind up beyond what the wheels do */
        state->linear.velocity_u_s *= share;
        state->angular.velocity_u_s *= share;
        t->saturation *= share;
    }
    if (t->saturation < 1.0)
        t->reasons |= REASON_WHEEL_SATURATED;
    for (uint32_t j = 0; j < state->config.joint_count; j++) {
        wheel_rad_s[j] *= share;
        pwm_output output = pwm_step(&state->config.joint[j].pwm, state->duty[j], wheel_rad_s[j], dt_s);
        state->duty[j] = output.duty;
        t->reasons |= output.reasons;
    }
}

/* goal → limit → kinematics → saturate → PWM */
static void drive(core_state *state, tick *t)
{
    if (!may_ramp(state, t)) {
        zero_at_once(state);
        return;
    }
    double dt_s = t->dt_s < DT_MAX_S ? t->dt_s : DT_MAX_S;
    bool urgent = state->holding != 0;
    double linear_m_s, angular_rad_s;
    choose_goal(state, t, &linear_m_s, &angular_rad_s);
    limited linear = limit_step(&state->linear, &state->limits.linear, linear_m_s, dt_s, urgent);
    limited angular = limit_step(&state->angular, &state->limits.angular, angular_rad_s, dt_s, urgent);
    t->reasons |= linear.reasons | angular.reasons << 4;
    set_wheels(state, t, dt_s);
}

static void measure(core_state *state, const tick *t)
{
    odometry_step(&state->odometry, &state->config, t->input->feedback, t->stale, state->setpoint_rad_s);
    if (state->odometry.blind)
        odometry_drift(&state->odometry, &state->config, state->setpoint_rad_s, t->dt_s);
}

/* The last look at what has been computed: nothing that is not a number leaves. */
static void guard(core_state *state, const tick *t)
{
    double sum = 0.0;
    for (uint32_t j = 0; j < state->config.joint_count; j++)
        sum += state->setpoint_rad_s[j] + state->duty[j];
    bool odometry_good = odometry_finite(&state->odometry, state->config.joint_count);
    if (isfinite(sum) && odometry_good)
        return;
    if (!odometry_good) {
        uint32_t epoch = state->odometry.epoch;
        odometry_init(&state->odometry, &state->config);
        state->odometry.epoch = epoch + 1;
    }
    zero_at_once(state);
    state->faults |= FAULT_STATE;
    latch_faults(state, t);
}

/* At rest? And when a fault has brought the base to rest, the power goes off. */
static void settle(core_state *state, const tick *t)
{
    bool zero = true, slow = true;
    for (uint32_t j = 0; j < state->config.joint_count; j++) {
        zero = zero && state->setpoint_rad_s[j] == 0.0;
        /* a wheel that measures nothing (NaN) is as fast as its set-point */
        bool fast = fabs(state->odometry.joint[j].velocity_rad_s) >= state->config.rest_velocity_rad_s;
        slow = slow && (t->stale[j] || !fast);
    }
    state->at_rest = zero && slow;
    if (!state->holding || fault_action(state) == STOP_HOLD)
        return;
    if (!zero)
        state->zero_since_ns = 0;
    else if (state->zero_since_ns == 0)
        state->zero_since_ns = t->input->now_ns;
    /* unsigned: a clock that runs backwards ends the hold as well */
    bool overdue = zero && (uint64_t)t->input->now_ns - (uint64_t)state->zero_since_ns > (uint64_t)HOLD_AT_ZERO_NS;
    if ((state->at_rest && !t->any_stale) || overdue)
        state->holding = 0;
}

static void write_setpoints(const core_state *state, const tick *t, setpoints *out)
{
    memset(out, 0, sizeof *out);
    out->stamp_ns = t->input->now_ns;
    out->tick = state->tick;
    out->enabled = state->armed || state->holding;
    out->joint_count = state->config.joint_count;
    for (uint32_t j = 0; j < state->config.joint_count; j++)
        out->joint[j] = (joint_setpoint){state->setpoint_rad_s[j], state->duty[j]};
}

/* a measure as it is, NaN for what no sensor measures */
static double measured(double value)
{
    return value + (value - value);
}

static void write_joint(const core_state *state, const tick *t, uint32_t j, joint_state *to)
{
    const joint_feedback *feedback = &t->input->feedback[j];
    const joint_odometry *odometry = &state->odometry.joint[j];
    to->position_rad = odometry->position_rad;
    to->velocity_rad_s = odometry->velocity_rad_s;
    to->setpoint_rad_s = state->setpoint_rad_s[j];
    to->duty = state->duty[j];
    to->current_a = measured(feedback->current_a);
    to->voltage_v = measured(feedback->voltage_v);
    to->temperature_c = measured(feedback->temperature_c);
    to->feedback_age_s = t->age_s[j] > 0.0 ? t->age_s[j] : 0.0;
    to->drive_faults = feedback->drive_faults;
    to->enabled = feedback->enabled;
    to->stale = t->stale[j];
    to->jumps = odometry->jumps;
}

static void write_odometry(const odometry_state *from, robot_state *to)
{
    to->odometry_degraded = from->degraded;
    to->odometry_epoch = from->epoch;
    to->odometry_stamp_ns = from->stamp_ns;
    to->x_m = from->x_m;
    to->y_m = from->y_m;
    to->heading_rad = from->heading_rad;
    to->distance_m = from->distance_m;
    to->turned_rad = from->turned_rad;
    to->linear_m_s = from->linear_m_s;
    to->angular_rad_s = from->angular_rad_s;
    memcpy(to->pose_covariance, from->pose_covariance, sizeof to->pose_covariance);
    memcpy(to->twist_covariance, from->twist_covariance, sizeof to->twist_covariance);
}

static uint32_t all_reasons(const core_state *state, const tick *t)
{
    uint32_t reasons = t->reasons;
    if (!state->armed)
        reasons |= REASON_NOT_ARMED;
    if (t->input->control.stop)
        reasons |= REASON_STOP_REQUESTED;
    if (state->faults != 0)
        reasons |= REASON_FAULT;
    return reasons;
}

static void write_snapshot(const core_state *state, const tick *t, robot_state *to)
{
    to->stamp_ns = t->input->now_ns;
    to->tick = state->tick;
    to->machine_state = t->input->control.machine_state;
    to->owner = t->input->control.owner;
    to->reasons = all_reasons(state, t);
    to->faults = state->faults;
    to->armed = state->armed;
    to->enabled = state->armed || state->holding;
    to->at_rest = state->at_rest;
    to->joint_count = state->config.joint_count;
    to->dt_s = t->dt_s;
    to->command_age_s = t->command_age_s > 0.0 ? t->command_age_s : 0.0;
    to->wanted_linear_m_s = t->wanted_linear_m_s;
    to->wanted_angular_rad_s = t->wanted_angular_rad_s;
    to->setpoint_linear_m_s = state->linear.velocity_u_s;
    to->setpoint_angular_rad_s = state->angular.velocity_u_s;
    to->saturation = t->saturation;
    write_odometry(&state->odometry, to);
    uint32_t used = state->config.joint_count;
    for (uint32_t j = 0; j < used; j++)
        write_joint(state, t, j, &to->joint[j]);
    memset(&to->joint[used], 0, (JOINTS_MAX - used) * sizeof to->joint[0]);
}

int core_init(core_state *state, const core_config *config)
{
    char name[FIELD_NAME_BYTES];
    if (core_config_check(config, name) != NULL)
        return -EINVAL;
    memset(state, 0, sizeof *state);
    state->config = *config;
    state->limits = config->limits;
    state->at_rest = 1;
    odometry_init(&state->odometry, config);
    return 0;
}

void core_step(core_state *state, const core_input *input, double dt_s, setpoints *out, robot_state *snapshot)
{
    tick t;
    state->tick++;
    look(state, input, dt_s, &t);
    obey_control(state, &t);
    latch_faults(state, &t);
    arm_or_disarm(state, &t);
    drive(state, &t);
    measure(state, &t);
    guard(state, &t);
    settle(state, &t);
    write_setpoints(state, &t, out);
    write_snapshot(state, &t, snapshot);
}

/* every byte of both outputs is a field, so that no padding carries what was there before */
_Static_assert(sizeof(joint_state) == 8 * 8 + 4 * 4, "padding in joint_state");
_Static_assert(sizeof(setpoints) == 8 + 8 + 4 + 4 + JOINTS_MAX * 16, "padding in setpoints");
_Static_assert(sizeof(robot_state) == 8 + 8 + 10 * 4 + 7 * 8 + 8 + 7 * 8 + 9 * 8 + JOINTS_MAX * 80,
               "padding in robot_state");
