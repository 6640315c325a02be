/* SPDX-License-Identifier: Apache-2.0
 * core.h: what the pure files share among themselves and Python does not see. */
#ifndef MOTORD_CORE_H
#define MOTORD_CORE_H

#include "rt.h"

#pragma GCC visibility push(hidden)

/* What one tick knows beside its state. */
typedef struct {
    const core_input *input;
    double dt_s;                /* 0: what came was no time step */
    double wanted_linear_m_s;
    double wanted_angular_rad_s;
    double command_age_s;
    double saturation;
    double checksum;            /* of all that has been computed with: not finite when one of it is not */
    uint32_t reasons;
    bool command_fresh;
    bool command_zero;
    bool heartbeat_fresh;
    bool news;                  /* feedback is new, or missing: there is something to measure */
    bool any_stale;
    bool drive_fault;
    bool drive_disabled;
    bool moving;                /* a set-point is not zero */
} tick;

/* Reads the input and decides who may move: control, faults, arming. */
void watch(core_state *state, const core_input *input, double dt_s, tick *t);
/* Latches faults; armed no more, what is under way ends by the stop action of the robot file. */
void watch_latch(core_state *state, uint32_t faults);
/* The e-stop's action replaces any other that is under way, and nothing replaces it. */
stop_action watch_fault_action(const core_state *state);

/* What this tick tells; the rest of the snapshot is as it was. */
void snapshot_write(core_state *state, const tick *t);
/* What new feedback tells. */
void snapshot_write_feedback(core_state *state, const tick *t);

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
