/* SPDX-License-Identifier: Apache-2.0
 *
 * loops.h: the speed loops of a base's wheels in a tick. A part of core.c, like snapshot.h.
 *
 * Duties of the open-loop map stay in core_wheels: a wheel without trusted feedback gets them, and
 * they slew the ramp. Outputs of a loop replace them when the set-points are written. */
#ifndef MOTORD_LOOPS_H
#define MOTORD_LOOPS_H

#include "watch.h"
#include "wheel.h"

#include <math.h>
#include <string.h>

/* after a longer pause the ramps continue as if it had been this long */
static const double DT_MAX_S = 0.1;
static const double OVERSPEED = 1.5; /* times the speed limit: more than the overshoot of a
                                        well-tuned loop */
/* limit of the integral of a loop without gains, below which the open-loop map takes over */
static const double INTEGRAL_GONE = 1e-4;

/* Whether the loop's gains make it do anything. */
static inline bool loop_is_on(const core_state *state, uint32_t j)
{
    const speed_loop_gains *gains = &state->gains[j];
    uint32_t kind = state->config.joint[j].speed_loop.kind;
    bool some = gains->gain_u_s_per_rad > 0.0 || gains->integral_u_per_rad > 0.0 ||
                gains->derivative_u_s2_per_rad > 0.0 || gains->acceleration_u_s2_per_rad > 0.0;
    return kind == SPEED_LOOP_TORQUE || (kind == SPEED_LOOP_DUTY && some);
}

/* Take the gains of all joints or, if one of them is out of range, of no joint. A loop whose gains
 * change continues from its last output; one that begins continues from the duty of the map. */
static inline void take_gains(core_state *state, const core_control *control)
{
    uint32_t count = state->config.joint_count;
    state->gains_seen = control->gains_count;
    for (uint32_t j = 0; j < count; j++) {
        if (!speed_loop_gains_good(&control->gains[j])) {
            return;
        }
    }
    for (uint32_t j = 0; j < count; j++) {
        if (memcmp(&state->gains[j], &control->gains[j], sizeof state->gains[j]) == 0) {
            continue;
        }
        state->gains[j] = control->gains[j];
        state->speed_loop[j].begun = 0;
        if (!(state->loops & 1U << j) && loop_is_on(state, j)) {
            state->speed_loop[j].output_u = state->wheels.joint[j].duty;
            state->loops |= 1U << j;
            state->extras = 1;
        }
    }
}

static inline bool runs_away(const joint_config *joint, double velocity_rad_s)
{
    double limit = fmax(joint->velocity_max_rad_s, -joint->velocity_min_rad_s);
    return fabs(velocity_rad_s) > OVERSPEED * limit;
}

/* Return the output while a wheel's speed is unknown: no torque, or the duty of the open-loop
 * map. */
static inline double without_loop(const core_state *state, uint32_t j)
{
    bool duty = state->config.joint[j].speed_loop.kind == SPEED_LOOP_DUTY &&
                !state->speed_loop[j].overspeed;
    return duty ? state->wheels.joint[j].duty : 0.0;
}

/* Set the range of the output: a duty rises away from zero at most by its slew, from the dead
 * band's edge. */
static inline void bound_output(const joint_config *joint, double last_u, speed_loop_input *input,
                                double dt_s)
{
    input->low_u = joint->speed_loop.output_min_u;
    input->high_u = joint->speed_loop.output_max_u;
    if (joint->speed_loop.kind != SPEED_LOOP_DUTY || !(joint->pwm.slew_per_s < INFINITY)) {
        return;
    }
    double rises = joint->pwm.slew_per_s * dt_s;
    input->high_u = fmin(input->high_u, fmax(last_u, joint->pwm.dead_band) + rises);
    input->low_u = fmax(input->low_u, -(fmax(-last_u, joint->pwm.dead_band) + rises));
}

/* Return the loop's output: 0 without power, the output without a loop if nothing is measured or
 * the wheel ran away. */
static inline double loop_output(core_state *state, uint32_t j, double dt_s)
{
    const joint_config *joint = &state->config.joint[j];
    speed_loop_state *loop = &state->speed_loop[j];
    double velocity_rad_s = state->odometry.joint[j].velocity_rad_s;
    if (!(state->armed | state->holding)) {
        *loop = (speed_loop_state){0};
        return 0.0;
    }
    if (!state->stale[j] && runs_away(joint, velocity_rad_s)) {
        loop->overspeed = 1;
        watch_latch(state, FAULT_OVERSPEED);
    }
    if (state->stale[j] || loop->overspeed || state->plausible[j].doubted ||
        !isfinite(velocity_rad_s)) {
        *loop =
            (speed_loop_state){.output_u = without_loop(state, j), .overspeed = loop->overspeed};
        return loop->output_u;
    }
    speed_loop_input input = {
        .want_rad_s = state->wheels.joint[j].velocity_rad_s,
        .measured_rad_s = velocity_rad_s,
        .rest_rad_s = state->config.rest_velocity_rad_s,
    };
    bound_output(joint, loop->output_u, &input, dt_s);
    return speed_loop_step(loop, &joint->speed_loop, &state->gains[j], &input, dt_s);
}

/* End a loop whose gains are all zero, once its integral is gone: only the open-loop map is
 * left. */
static inline void end_loop(core_state *state, uint32_t j)
{
    if (!loop_is_on(state, j) && fabs(state->speed_loop[j].integral_u) < INTEGRAL_GONE) {
        state->loops &= ~(1U << j);
        state->snapshot.joint[j].duty = state->wheels.joint[j].duty;
        state->snapshot.speed_loop[j] = (speed_loop_shown){0};
    }
}

/* Take new gains, and do a step of each loop. Not called without gains and loops: then a tick costs
 * one comparison. */
__attribute__((noinline)) static void set_loops(core_state *state, const tick *t)
{
    const core_control *control = &t->input->control;
    double dt_s = t->dt_s < DT_MAX_S ? t->dt_s : DT_MAX_S;
    if (control->gains_count != state->gains_seen) {
        take_gains(state, control);
    }
    for (uint32_t j = 0; j < state->config.joint_count; j++) {
        if (!(state->loops & 1U << j)) {
            continue;
        }
        double output_u = loop_output(state, j, dt_s);
        if (state->config.joint[j].speed_loop.kind == SPEED_LOOP_TORQUE) {
            state->wheels.joint[j].torque_n_m = output_u;
        } else {
            state->snapshot.joint[j].duty = output_u;
        }
        state->snapshot.speed_loop[j] =
            (speed_loop_shown){output_u, state->speed_loop[j].integral_u};
        end_loop(state, j);
    }
}

/* Discard the outputs of all loops. */
static inline void loops_off(core_state *state)
{
    memset(state->speed_loop, 0, sizeof state->speed_loop);
    memset(state->snapshot.speed_loop, 0, sizeof state->snapshot.speed_loop);
}

static inline void loops_write_duties(const core_state *state, setpoints *out)
{
    for (uint32_t j = 0; j < state->config.joint_count; j++) {
        if ((state->loops & 1U << j) && state->config.joint[j].speed_loop.kind == SPEED_LOOP_DUTY) {
            out->joint[j].duty = state->speed_loop[j].output_u;
        }
    }
}

#endif
