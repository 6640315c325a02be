/* SPDX-License-Identifier: Apache-2.0
 * independent.h: functions for joints without a base, for the tick. */
#ifndef MOTORD_INDEPENDENT_H
#define MOTORD_INDEPENDENT_H

#include "core.h"

#pragma GCC visibility push(hidden)

/* Input to a step, beside the configuration. */
typedef struct {
    const joint_command *command; /* NULL: all joints come to rest */
    const axis_limits *limits;    /* limits in force, by joint */
    uint32_t owner;               /* the lease in command */
    double factor;                /* 0..1, factor of each joint's speed limit */
    double dt_s;
    bool urgent; /* leave out the jerk limits */
} joints_input;

/* Do one step of each joint, within its own limits. velocity_rad_s receives the speeds of those
 * that take velocities; `named` the joints that cause the reasons. Returns the reasons. */
uint32_t independent_step(joints_state *joints, steer_state *steer, const core_config *config,
                          const joints_input *input, double *velocity_rad_s, reasons_shown *named);
/* Take changed limits, for all joints or, if one is out of range, for no joint. Moving joints reach
 * them by deceleration. */
void independent_take_limits(core_state *state, const core_control *control);
/* Set the limits in force to those of the configuration. */
void independent_own_limits(axis_limits *in_force, const core_config *config);
/* Stop all joints in this step, and drop their targets. */
void independent_halt(joints_state *joints, steer_state *steer, const core_config *config);
/* Whether a command requests no motion: no position, and no speed but zero. False if a value is not
 * finite. */
bool joint_command_zero(const joint_command *command, const core_config *config);
bool joint_command_finite(const joint_command *command, const core_config *config);

#pragma GCC visibility pop

#endif
