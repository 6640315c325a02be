/* SPDX-License-Identifier: Apache-2.0
 * core.h: what the pure files share among themselves and Python does not see. */
#ifndef MOTORD_CORE_H
#define MOTORD_CORE_H

#include "rt.h"

#pragma GCC visibility push(hidden)

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
