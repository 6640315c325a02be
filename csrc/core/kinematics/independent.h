/* SPDX-License-Identifier: Apache-2.0
 * independent.h: what the tick needs of joints without a base. */
#ifndef MOTORD_INDEPENDENT_H
#define MOTORD_INDEPENDENT_H

#include "core.h"

#pragma GCC visibility push(hidden)

/* The input of a step, beside the configuration. */
typedef struct {
    const joint_command *command; /* NULL: all come to rest */
    const axis_limits *limits;    /* in force, by joint */
    uint32_t owner;               /* the lease in command */
    double factor;                /* 0..1, of each joint's speed limit */
    double dt_s;
    bool urgent; /* leave out the jerk limits */
} joints_input;

/* One step of each joint, within its own limits; velocity_rad_s: of those that take velocities.
 * Returns the reasons; `named`: of which joints they are. */
uint32_t independent_step(joints_state *joints, steer_state *steer, const core_config *config,
                          const joints_input *input, double *velocity_rad_s, reasons_shown *named);
/* Where they have changed: limits of all joints or, where one is out of range, of none. Moving
 * joints reach them by deceleration. */
void independent_take_limits(core_state *state, const core_control *control);
/* Those of the configuration. */
void independent_own_limits(axis_limits *in_force, const core_config *config);
/* All stop in this step and drop their targets. */
void independent_halt(joints_state *joints, steer_state *steer, const core_config *config);
/* Whether it requests no motion: no position, and no speed but zero. A value that is not finite
 * is no such request. */
bool joint_command_zero(const joint_command *command, const core_config *config);
bool joint_command_finite(const joint_command *command, const core_config *config);

#pragma GCC visibility pop

#endif
