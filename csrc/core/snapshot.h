/* SPDX-License-Identifier: Apache-2.0
 *
 * snapshot.h: the core's report. The snapshot is kept in the state and handed out as a copy, so
 * that a tick writes only what it changed. A part of core.c: compiled in one piece with it, the
 * tick stays in registers. */
#ifndef MOTORD_SNAPSHOT_H
#define MOTORD_SNAPSHOT_H

#include <math.h>

#include "core.h"

/* Values of one tick that are not in its state. */
typedef struct {
    const core_input *input;
    double dt_s; /* 0: not a valid time step */
    double command_age_s;
    double saturation;
    double checksum; /* sum of all used values: not finite if one of them is not */
    uint32_t reasons;
    bool calm; /* armed, requested to continue, and no problem */
    bool go;   /* armed, and with a valid command */
    bool command_fresh;
    bool command_zero;
    bool heartbeat_fresh;
    bool is_new; /* feedback is new, or missing, so there is something to measure */
    bool any_stale;
    bool drive_fault;
    bool drive_disabled;
    bool moving; /* a set-point is not zero */
} tick;

static inline void write_joint(const core_state *state, const joint_feedback *feedback, uint32_t j,
                               joint_state *to)
{
    const joint_odometry *odometry = &state->odometry.joint[j];
    to->position_rad = odometry->position_rad - odometry->left_out_rad;
    to->velocity_rad_s = odometry->velocity_rad_s;
    to->current_a = measured(feedback->current_a);
    to->voltage_v = measured(feedback->voltage_v);
    to->temperature_c = measured(feedback->temperature_c);
    to->drive_faults = feedback->drive_faults;
    to->enabled = feedback->enabled;
    to->stale = state->stale[j];
    to->jumps = odometry->jumps;
    if (state->stale[j]) { /* or never received: the last value is not the present one */
        to->position_rad = to->velocity_rad_s = (double)NAN;
        to->current_a = to->voltage_v = to->temperature_c = (double)NAN;
        to->enabled = 2;
    }
    if (state->odometry.distrusted >> j & 1U) {
        to->position_rad = (double)NAN;
    }
}

/* Time in which a wheel that counts as at rest may turn by a step of its counter. */
static const double COARSE_S = 0.2;

static inline void write_counters(core_state *state)
{
    uint32_t coarse = 0;
    for (uint32_t j = 0; j < state->config.joint_count; j++) {
        const joint_config *joint = &state->config.joint[j];
        bool grown = joint->counter_mantissa_bits != 0 &&
                     counter_step_rad(&state->odometry.joint[j], joint) >
                         state->config.rest_velocity_rad_s * COARSE_S;
        coarse |= (grown ? 1U : 0U) << j;
    }
    state->snapshot.counters.counter_coarse = coarse;
    state->snapshot.counters.counter_distrusted = state->odometry.distrusted;
}

/* Write the measured twist with its covariance; NaN where the wheels with fresh feedback do not
 * determine it. */
static inline void write_twist(const core_state *state, robot_state *to)
{
    const odometry_state *from = &state->odometry;
    double known = from->twist_known || state->config.independent ? 0.0 : (double)NAN;
    to->linear_m_s = from->linear_m_s + known;
    to->angular_rad_s = from->angular_rad_s + known;
    to->lateral.lateral_m_s = from->lateral_m_s + known;
    to->lateral.slip_m_s = from->spread.slip_m_s + known;
    for (int i = 0; i < 3; i++) {
        to->twist_covariance[i] = from->twist_covariance[i] + known;
        to->lateral.lateral_covariance[i] =
            state->axes == AXES ? from->lateral_covariance[i] + known : 0.0;
    }
}

static inline void snapshot_write_feedback(core_state *state, const joint_feedback *feedback)
{
    const odometry_state *from = &state->odometry;
    robot_state *to = &state->snapshot;
    to->odometry_degraded = from->degraded;
    to->odometry_epoch = from->epoch;
    to->odometry_stamp_ns = from->stamp_ns;
    to->x_m = from->x_m;
    to->y_m = from->y_m;
    to->heading_rad = from->heading_rad;
    to->distance_m = from->distance_m;
    to->turned_rad = from->turned_rad;
    for (int i = 0; i < 6; i++) {
        to->pose_covariance[i] = from->pose_covariance[i];
    }
    write_twist(state, to);
    for (uint32_t j = 0; j < state->config.joint_count; j++) {
        write_joint(state, &feedback[j], j, &to->joint[j]);
    }
    write_counters(state);
}

static inline void write_imu(core_state *state, const core_input *input)
{
    const gyro_config *config = &state->config.gyro;
    const gyro_state *gyro = &state->odometry.gyro;
    const imu_sample *from = &input->imu;
    imu_state *to = &state->snapshot.imu;
    bool known = gyro->bias_stamp_ns != 0;
    to->stamp_ns = from->stamp_ns;
    to->state = gyro_status(gyro, config, input->now_ns);
    for (int axis = 0; axis < 3; axis++) {
        bool old = to->state == GYRO_STALE;
        to->angular_rad_s[axis] = old ? (double)NAN : measured(from->angular_rad_s[axis]);
        to->acceleration_m_s2[axis] = old ? (double)NAN : measured(from->acceleration_m_s2[axis]);
    }
    to->angular_rad_s[2] -= gyro->bias_rad_s;
    to->bias_rad_s = known ? gyro->bias_rad_s : (double)NAN;
    to->bias_variance_rad2_s2 = known ? gyro->bias_variance_rad2_s2 : (double)NAN;
    to->rate_variance_rad2_s2 = known ? gyro->rate_variance_rad2_s2 : (double)NAN;
    to->heading_by_gyro = state->odometry.by_gyro;
    to->still = gyro->still;
    to->refused = gyro->refused;
}

static inline void write_steering(core_state *state)
{
    steering_state *to = &state->snapshot.steering;
    to->misaligned_rad = state->steer.misaligned_rad;
    to->position_unknown = state->steer.unknown;
    for (uint32_t j = 0; j < state->config.joint_count; j++) {
        bool takes = state->config.joint[j].position.used != 0;
        bool shown = takes && state->steer.enabled && !(state->steer.unknown >> j & 1U);
        to->position_setpoints_rad[j] = shown ? state->steer.profile[j].position_rad : (double)NAN;
        if (takes) {
            to->position_joints |= 1U << j;
            state->snapshot.joint[j].position_rad =
                state->stale[j] ? (double)NAN : state->odometry.angle_rad[j];
            state->snapshot.joint[j].setpoint_rad_s =
                shown ? state->wheels.joint[j].velocity_rad_s : 0.0;
        }
    }
}

static inline uint32_t all_reasons(const core_state *state, const tick *t)
{
    uint32_t reasons = t->reasons;
    if (t->calm) {
        return reasons;
    }
    if (!state->armed) {
        reasons |= REASON_NOT_ARMED;
    }
    if (state->steer.unknown) {
        reasons |= REASON_POSITION_UNKNOWN;
    }
    if (t->input->control.stop) {
        reasons |= REASON_STOP_REQUESTED;
    }
    if (state->faults != 0) {
        reasons |= REASON_FAULT;
    }
    return reasons;
}

/* Note the start time of each new reason. */
__attribute__((noinline)) static void note_reasons(robot_state *to, uint32_t reasons)
{
    uint32_t changed = to->reasons ^ reasons;
    for (uint32_t bit = 0; bit < REASONS_MAX; bit++) {
        if (changed & 1U << bit) {
            to->reason.since_ns[bit] = reasons & 1U << bit ? to->stamp_ns : 0;
        }
    }
    to->reasons = reasons;
}

static inline void snapshot_write(core_state *state, const tick *t)
{
    robot_state *to = &state->snapshot;
    to->stamp_ns = t->input->now_ns;
    to->tick = state->tick;
    to->machine_state = t->input->control.machine_state;
    to->owner = t->input->control.owner;
    uint32_t reasons = all_reasons(state, t);
    if (reasons != to->reasons) {
        note_reasons(to, reasons);
    }
    to->faults = state->faults;
    to->armed = state->armed;
    to->enabled = state->armed | state->holding;
    to->at_rest = state->rest == REST_AT_REST;
    to->rest.rest = state->rest;
    to->dt_s = t->dt_s;
    to->command_age_s = t->command_age_s > 0.0 ? t->command_age_s : 0.0;
    to->wanted_linear_m_s = t->command_fresh ? state->goal.wanted_u_s[AXIS_LINEAR] : 0.0;
    to->wanted_angular_rad_s = t->command_fresh ? state->goal.wanted_u_s[AXIS_ANGULAR] : 0.0;
    to->lateral.wanted_lateral_m_s = t->command_fresh ? state->goal.wanted_u_s[AXIS_LATERAL] : 0.0;
    to->lateral.setpoint_lateral_m_s = state->axis[AXIS_LATERAL].velocity_u_s;
    to->setpoint_linear_m_s = state->axis[AXIS_LINEAR].velocity_u_s;
    to->setpoint_angular_rad_s = state->axis[AXIS_ANGULAR].velocity_u_s;
    to->saturation = t->saturation;
}

/* every byte belongs to a field, so that no padding carries old memory */
_Static_assert(sizeof(joint_state) == 8 * 8 + 4 * 4, "padding in joint_state");
_Static_assert(sizeof(imu_state) == 10 * 8 + 4 * 4, "padding in imu_state");
_Static_assert(sizeof(feedback_doubt) == 4 * 8 + 2 * 4, "padding in feedback_doubt");
_Static_assert(sizeof(lateral_state) == 7 * 8, "padding in lateral_state");
_Static_assert(sizeof(steering_state) == (JOINTS_MAX + 1) * 8 + 2 * 4, "padding in steering_state");
_Static_assert(sizeof(speed_loop_shown) == 2 * 8, "padding in speed_loop_shown");
_Static_assert(sizeof(derating_shown) == 2 * 8 + 2 * 4, "padding in derating_shown");
_Static_assert(sizeof(reasons_shown) == REASONS_MAX * 8 + 6 * 4, "padding in reasons_shown");
_Static_assert(sizeof(rest_shown) == JOINTS_MAX * 8 + 2 * 4, "padding in rest_shown");
_Static_assert(sizeof(counters_shown) == 2 * 4, "padding in counters_shown");
_Static_assert(sizeof(setpoints) == 8 + 8 + 4 + 4 + JOINTS_MAX * 32 + 8, "padding in setpoints");
_Static_assert(sizeof(robot_state) == 8 + 8 + 10 * 4 + 7 * 8 + 8 + 7 * 8 + 9 * 8 + JOINTS_MAX * 80 +
                                          sizeof(imu_state) + sizeof(feedback_doubt) +
                                          sizeof(lateral_state) + sizeof(steering_state) +
                                          JOINTS_MAX * sizeof(speed_loop_shown) +
                                          sizeof(derating_shown) + sizeof(reasons_shown) +
                                          sizeof(rest_shown) + sizeof(counters_shown),
               "padding in robot_state");

#endif
