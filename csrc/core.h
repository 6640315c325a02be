/* SPDX-License-Identifier: Apache-2.0
 * core.h: what the pure files share among themselves and Python does not see. */
#ifndef MOTORD_CORE_H
#define MOTORD_CORE_H

#include "rt.h"

#pragma GCC visibility push(hidden)

/* Nothing to do: limit_step() would give the velocity that is there. */
static inline bool limit_settled(const limit_state *state, const axis_limits *limits, double want_u_s)
{
    double velocity_u_s = state->velocity_u_s;
    return velocity_u_s == want_u_s && state->acceleration_u_s2 == 0.0 && velocity_u_s <= limits->velocity_u_s
        && velocity_u_s >= -limits->velocity_u_s;
}

/* An angle in -pi..pi. */
double angle_wrap(double angle_rad);
/* Sine and cosine of an angle in -pi..pi, within 1e-15: the same bits on every machine, which the C library
 * does not promise (it picks fused multiply-add where the CPU has it) and a replay needs. */
void angle_sine_cosine(double angle_rad, double *sine, double *cosine);

/* A side of the base is not heard: let the variance grow as if nothing were known of what the set-points
 * make the wheels do meanwhile. */
void odometry_drift(odometry_state *state, const core_config *config, const double *setpoint_rad_s, double dt_s);
/* false: a number in it is not finite */
bool odometry_finite(const odometry_state *state, uint32_t joint_count);

#pragma GCC visibility pop

#endif
