/* SPDX-License-Identifier: Apache-2.0
 *
 * core.c: one tick, from command and feedback to set-points and the snapshot. Time is an argument.
 *
 * core_step() at the end of the file has the order. Set-points are built from zero in each tick.
 */
#include "duties.h"
#include "following.h"
#include "goal.h"
#include "independent.h"
#include "loops.h"
#include "rest.h"
#include "snapshot.h"
#include "steer.h"
#include "watch.h"
#include "wheel.h"

#include <errno.h>
#include <math.h>
#include <string.h>

/* time of zero set-points after which the power goes off although no rest was seen */
static const int64_t HOLD_AT_ZERO_NS = 2000000000;

/* Return the sum of all set-points: not finite if one of them is not. */
static double setpoint_sum(const core_state *state)
{
    double sum = 0.0;
    for (uint32_t j = 0; j < state->config.joint_count; j++) {
        const joint_setpoint *setpoint = &state->wheels.joint[j];
        sum += setpoint->velocity_rad_s + setpoint->duty + setpoint->torque_n_m;
    }
    return sum;
}

static double axis_sum(const core_state *state)
{
    double sum = 0.0;
    for (uint32_t i = 0; i < state->axes; i++) {
        sum += state->axis[i].velocity_u_s + state->axis[i].acceleration_u_s2;
    }
    return sum;
}

static void zero_at_once(core_state *state, tick *t)
{
    t->checksum += setpoint_sum(state) + axis_sum(state);
    for (uint32_t j = 0; j < state->config.joint_count; j++) {
        state->snapshot.joint[j].setpoint_rad_s = state->snapshot.joint[j].duty = 0.0;
    }
    state->wheels = (core_wheels){0};
    memset(state->axis, 0, sizeof state->axis);
    if (state->config.independent) {
        independent_halt(&state->joints, &state->steer, &state->config);
    }
    t->moving = false;
}

/* Whether set-points may ramp; false: they are zero now. */
static bool may_ramp(const core_state *state, const tick *t)
{
    if (t->calm) {
        return true;
    }
    if (t->dt_s == 0.0 || t->input->suspended) {
        return false;
    }
    if (state->holding) {
        return watch_fault_action(state) != STOP_BRAKE;
    }
    bool stopping = t->input->control.stop || !t->command_fresh;
    return state->armed && !(stopping && state->config.on_timeout == STOP_BRAKE);
}

/* Do one step of the twist. Returns the joint whose duty slew bounds it: its bit, or 0. */
static inline uint32_t ramp(core_state *state, tick *t, const double *goal_u_s, double dt_s)
{
    const core_config *slewed = state->slewed ? &state->config : NULL;
    uint32_t slewing = 0;
    t->checksum += axis_sum(state);
    t->reasons |= ramp_joint_step(state->axis, state->axes, &state->limits, slewed, goal_u_s, dt_s,
                                  state->holding != 0, &slewing);
    return slewing;
}

/* Compute kinematics → PWM, for a twist that differs from that of the last tick. */
static void set_wheels(core_state *state, tick *t, double dt_s, uint32_t slewing)
{
    core_wheels *wheels = &state->wheels;
    double twist_u_s[AXES];
    uint32_t count = state->config.joint_count, reasons = 0;
    double checksum = t->checksum;
    wheels->moving = 0;
    for (int i = 0; i < AXES; i++) {
        twist_u_s[i] = state->axis[i].velocity_u_s;
        wheels->moving |= twist_u_s[i] != 0.0;
    }
    for (uint32_t j = 0; j < count; j++) {
        checksum += wheels->joint[j].duty;
        reasons |= set_wheel(state, j, wheel_speed(&state->config.joint[j], twist_u_s), dt_s);
    }
    t->checksum = checksum;
    wheels->reasons = reasons;
    if ((reasons | slewing) != 0) {
        name_duties(state, slewing);
    }
    wheels->known = !(reasons & REASON_DUTY_SLEW);
}

/* Whether the goal, which is within the limits, is reached: a ramp would change nothing. */
static bool settled(const core_state *state, const double *goal_u_s)
{
    for (uint32_t i = 0; i < state->axes; i++) {
        if (state->axis[i].velocity_u_s != goal_u_s[i] || state->axis[i].acceleration_u_s2 != 0.0) {
            return false;
        }
    }
    return true;
}

/* Compute goal → limit → modules → PWM, by the wheels' present angles. */
static void ramp_steered(core_state *state, tick *t, double *goal_u_s, double dt_s)
{
    const core_config *config = &state->config;
    const double *angle_rad = state->odometry.angle_rad;
    double wheel_rad_s[JOINTS_MAX], rate_max_s, twist_u_s[AXES];
    core_wheels *wheels = &state->wheels;
    uint32_t slewing = 0;
    wheels->moving = wheels->reasons = 0;
    t->reasons |= steer_goal(&state->steer, config, state->axis, angle_rad, goal_u_s, &rate_max_s);
    if (!settled(state, goal_u_s)) {
        limit_state from[AXES];
        memcpy(from, state->axis, sizeof from);
        slewing = ramp(state, t, goal_u_s, dt_s);
        t->reasons |= steer_pace(from, state->axis, goal_u_s, rate_max_s, dt_s);
    }
    for (int i = 0; i < AXES; i++) {
        twist_u_s[i] = wheels->twist_u_s[i] = state->axis[i].velocity_u_s;
        wheels->moving |= twist_u_s[i] != 0.0;
    }
    steer_wheels(config, twist_u_s, angle_rad, wheel_rad_s);
    for (uint32_t j = 0; j < config->joint_count; j++) {
        t->checksum += wheels->joint[j].duty;
        wheels->reasons |= set_wheel(state, j, wheel_rad_s[j], dt_s);
    }
    if ((wheels->reasons | slewing) != 0) {
        name_duties(state, slewing);
    }
    t->reasons |= wheels->reasons;
    t->moving = wheels->moving != 0;
}

/* Drive a base with modules: its wheels turn to their rolling directions, and the base waits for
 * them. */
__attribute__((noinline)) static void drive_steered(core_state *state, tick *t)
{
    steer_state *steer = &state->steer;
    double dt_s = t->dt_s < DT_MAX_S ? t->dt_s : DT_MAX_S;
    double goal_u_s[AXES] = {0.0}, aim_u_s[AXES] = {0.0};
    if (may_ramp(state, t)) {
        choose_goal(state, t, goal_u_s);
        memcpy(aim_u_s, goal_u_s, sizeof aim_u_s);
        ramp_steered(state, t, goal_u_s, dt_s);
    } else {
        zero_at_once(state, t);
    }
    if (!(state->armed | state->holding)) {
        steer_released(steer, &state->config, state->odometry.angle_rad);
        return;
    }
    steer_joints(steer, &state->config, state->wheels.twist_u_s, aim_u_s, dt_s);
    t->moving |=
        steer_setpoints(steer, &state->config, state->wheels.joint, state->odometry.angle_rad);
}

/* Move each joint by its own limits; those that take positions move like steering joints. */
static void ramp_independent(core_state *state, tick *t)
{
    const core_config *config = &state->config;
    double velocity_rad_s[JOINTS_MAX];
    core_wheels *wheels = &state->wheels;
    joints_input input = {
        .command = t->go && state->goal.command_reasons == 0 ? &t->input->joints : NULL,
        .limits = state->joint_limits,
        .owner = t->input->control.owner,
        .factor = state->snapshot.derating.since_ns != 0 ? state->snapshot.derating.factor : 1.0,
        .dt_s = t->dt_s < DT_MAX_S ? t->dt_s : DT_MAX_S,
        .urgent = state->holding != 0,
    };
    wheels->moving = wheels->reasons = 0;
    t->reasons |= independent_step(&state->joints, &state->steer, config, &input, velocity_rad_s,
                                   &state->snapshot.reason);
    for (uint32_t j = 0; j < config->joint_count; j++) {
        if (!config->joint[j].position.used) {
            t->checksum += wheels->joint[j].duty + velocity_rad_s[j];
            wheels->reasons |= set_wheel(state, j, velocity_rad_s[j], input.dt_s);
            wheels->moving |= velocity_rad_s[j] != 0.0;
        }
    }
    if (wheels->reasons != 0) {
        name_duties(state, 0);
    }
    t->reasons |= wheels->reasons;
    t->moving = wheels->moving != 0;
}

__attribute__((noinline)) static void drive_independent(core_state *state, tick *t)
{
    independent_take_limits(state, &t->input->control);
    if (!(state->armed | state->holding)) {
        zero_at_once(state, t);
        steer_released(&state->steer, &state->config, state->odometry.angle_rad);
        return;
    }
    if (may_ramp(state, t)) {
        ramp_independent(state, t);
    } else {
        zero_at_once(state, t);
    }
    t->moving |= steer_setpoints(&state->steer, &state->config, state->wheels.joint,
                                 state->odometry.angle_rad);
}

/* Compute goal → limit → kinematics → PWM. */
static void drive(core_state *state, tick *t)
{
    if (state->steered | state->config.independent) {
        if (state->steered) {
            drive_steered(state, t);
        } else {
            drive_independent(state, t);
        }
        return;
    }
    if (!may_ramp(state, t)) {
        zero_at_once(state, t);
        return;
    }
    core_wheels *wheels = &state->wheels;
    double dt_s = t->dt_s < DT_MAX_S ? t->dt_s : DT_MAX_S;
    double goal_u_s[AXES];
    uint32_t slewing = 0;
    choose_goal(state, t, goal_u_s);
    if (!settled(state, goal_u_s)) {
        slewing = ramp(state, t, goal_u_s, dt_s);
        wheels->known = 0;
    }
    if (!wheels->known) {
        set_wheels(state, t, dt_s, slewing);
    }
    t->reasons |= wheels->reasons;
    t->moving = wheels->moving != 0;
}

/* Take the gyro before the wheels, so that a turn which both have measured is in the pose at
 * once. */
static void take_gyro(core_state *state, const tick *t)
{
    const gyro_config *config = &state->config.gyro;
    if (!config->used) {
        return;
    }
    bool wheels_rest = state->rest == REST_AT_REST && !t->any_stale;
    gyro_take(&state->odometry.gyro, config, &t->input->imu, t->input->now_ns, wheels_rest);
}

/* Check whether the wheels follow their set-points. */
static void doubt(core_state *state, tick *t)
{
    feedback_doubt why;
    uint32_t count = joints_with_power(state);
    for (uint32_t j = 0; j < count; j++) {
        plausible_state *joint = &state->plausible[j];
        const joint_odometry *odometry = &state->odometry.joint[j];
        if (!plausible_due(joint, odometry) || state->stale[j]) {
            continue;
        }
        if (plausible(joint, &state->config.joint[j].plausible, odometry,
                      t->input->feedback[j].velocity_rad_s, state->wheels.joint[j].velocity_rad_s,
                      &why)) {
            continue;
        }
        why.joint = j;
        state->doubted |= 1U << j;
        state->odometry.distrusted |= (why.fault == FAULT_IMPLAUSIBLE_FEEDBACK ? 1U : 0U) << j;
        if (state->snapshot.doubt.fault == 0) {
            state->snapshot.doubt = why;
        }
        watch_latch(state, why.fault);
        t->calm = false;
        count = joints_with_power(state);
    }
    if (count != 0) {
        return;
    }
    for (uint32_t j = 0; j < state->config.joint_count; j++) {
        state->plausible[j].stamp_ns = 0;
    }
    if (t->moving) {
        zero_at_once(state, t);
    }
}

/* Measure, unless there is no new sample and no joint has become silent. */
static void measure(core_state *state, tick *t)
{
    take_gyro(state, t);
    if (!t->is_new) {
        return;
    }
    odometry_step(&state->odometry, &state->config, t->input->feedback, state->stale,
                  state->wheels.joint);
    if (state->config.independent) {
        for (uint32_t j = 0; j < state->config.joint_count; j++) {
            modules_take_angle(&state->odometry, &state->config, j);
        }
        state->odometry.degraded = t->any_stale; /* no motion of a base is missing */
    } else if (state->odometry.blind) {
        odometry_drift(&state->odometry, &state->config, state->wheels.joint, t->dt_s);
    }
    if (!odometry_finite(&state->odometry, state->config.joint_count)) {
        uint32_t epoch = state->odometry.epoch, distrusted = state->odometry.distrusted;
        odometry_init(&state->odometry, &state->config);
        state->odometry.epoch = epoch + 1;
        state->odometry.distrusted = distrusted;
        t->checksum = NAN;
    }
    if (state->positions) {
        doubt_positions(state, t);
    }
    doubt(state, t);
    see_rest(state, t->input->now_ns);
    if (state->derates) {
        take_derating(state, t);
    }
    snapshot_write_feedback(state, t->input->feedback);
}

/* Check the results a last time: no NaN leaves the core. */
static void guard(core_state *state, tick *t)
{
    if (isfinite(t->checksum + setpoint_sum(state))) {
        return;
    }
    zero_at_once(state, t);
    loops_off(state);
    t->calm = false;
    t->saturation = 1.0;
    state->goal.known = 0;
    watch_latch(state, FAULT_STATE);
}

bool core_may_power_off(const core_state *state, int64_t now_ns)
{
    /* unsigned, so a clock that runs backwards ends the time as well */
    uint64_t zero_ns = (uint64_t)now_ns - (uint64_t)state->zero_since_ns;
    bool overdue = state->zero_since_ns != 0 && zero_ns > (uint64_t)HOLD_AT_ZERO_NS;
    return state->rest == REST_AT_REST || overdue;
}

/* Switch the power off when a fault has brought the base to rest; if the base is to hold, only on
 * request. */
static void release(core_state *state, const tick *t)
{
    if (watch_fault_action(state) == STOP_HOLD && !t->input->control.release) {
        return;
    }
    if (core_may_power_off(state, t->input->now_ns)) {
        state->holding = 0;
    }
}

/* Write zero, or the wheels' set-points if this tick enables the drives. Every byte is written. */
static void write_setpoints(const core_state *state, const tick *t, setpoints *out)
{
    out->stamp_ns = t->input->now_ns;
    out->tick = state->tick;
    out->enabled = state->armed | state->holding;
    out->joint_count = state->config.joint_count;
    if (out->enabled) {
        memcpy(out->joint, state->wheels.joint, sizeof out->joint);
    } else {
        memset(out->joint, 0, sizeof out->joint);
    }
    for (uint32_t j = 0; j < JOINTS_MAX; j++) {
        out->position_rad[j] = 0.0;
    }
    out->positioned = out->reserved = 0;
}

/* Write what only some bases have: positions, a gyro, duties of speed loops. */
__attribute__((noinline)) static void write_extras(core_state *state, const tick *t, setpoints *out)
{
    if (state->positions) {
        out->positioned =
            steer_positions(&state->steer, &state->config, out->enabled != 0, out->position_rad);
        write_steering(state);
    }
    if (state->config.gyro.used) {
        write_imu(state, t->input);
    }
    if (out->enabled) {
        loops_write_duties(state, out);
    }
}

/* Note which extras the joints have, so that a base without them checks nothing in every tick. */
static void note_extras(core_state *state)
{
    for (uint32_t j = 0; j < state->config.joint_count; j++) {
        const joint_config *joint = &state->config.joint[j];
        state->snapshot.rest.rest_unmeasured |= (joint->unmeasured != 0 ? 1U : 0U) << j;
        state->slewed |= joint->pwm.slew_per_s < INFINITY;
        state->derates |= derating_used(&joint->derating);
        state->positions |= joint->position.used;
        state->gains[j] = joint->speed_loop.gains;
        state->loops |= (uint32_t)loop_is_on(state, j) << j;
    }
    state->extras = state->positions | state->config.gyro.used | state->loops;
}

int core_init(core_state *state, const core_config *config)
{
    char name[FIELD_NAME_BYTES];
    if (core_config_check(config, name) != NULL) {
        return -EINVAL;
    }
    memset(state, 0, sizeof *state);
    state->config = *config;
    state->limits = config->limits;
    state->command_window_ns = window_ns(config->command_timeout_s);
    state->feedback_window_ns = window_ns(config->feedback_timeout_s);
    state->heartbeat_window_ns = window_ns(config->heartbeat_timeout_s);
    state->axes = kinematics_strafes(config) ? AXES : AXIS_LATERAL;
    state->steered = config->module_count > 0;
    note_extras(state);
    if (state->steered) {
        steer_init(&state->steer, config);
    }
    if (config->independent) {
        independent_halt(&state->joints, &state->steer, config);
        independent_own_limits(state->joint_limits, config);
    }
    state->goal.zero = 1;
    state->silent = 1;
    state->snapshot.joint_count = config->joint_count;
    odometry_init(&state->odometry, config);
    return 0;
}

void core_step(core_state *state, const core_input *input, double dt_s, setpoints *out,
               robot_state *snapshot)
{
    tick t;
    state->tick++;
    watch(state, input, dt_s, &t);
    drive(state, &t);
    measure(state, &t);
    /* a single comparison for both conditions */
    if ((state->loops | (input->control.gains_count ^ state->gains_seen)) != 0) {
        set_loops(state, &t);
    }
    guard(state, &t);
    note_rest(state, t.moving, input->now_ns);
    if (state->holding) {
        release(state, &t);
    }
    write_setpoints(state, &t, out);
    snapshot_write(state, &t);
    if (state->extras) {
        write_extras(state, &t, out);
    }
    if (snapshot != NULL) {
        *snapshot = state->snapshot;
    }
}
