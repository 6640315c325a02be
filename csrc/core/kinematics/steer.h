/* SPDX-License-Identifier: Apache-2.0
 * steer.h: functions for a base with modules, for the tick. */
#ifndef MOTORD_STEER_H
#define MOTORD_STEER_H

#include "core.h"

#pragma GCC visibility push(hidden)

void steer_init(steer_state *steer, const core_config *config);

/* Return the joints that send feedback but whose position is unknown: bit n for joint n. */
uint32_t steer_unknown(const core_config *config, const joint_feedback *feedback,
                       const uint32_t *stale, const double *angle_rad);

/* Bring a goal to a curvature that the steering reaches, within the limits of velocity. Returns the
 * reasons. */
uint32_t steer_within_reach(const steer_state *steer, const base_limits *limits,
                            const double *wanted_u_s, double *goal_u_s);
/* Compute the wheel speeds of a twist when all wheels point in their rolling directions. */
void steer_speeds(const steer_state *steer, const core_config *config, const double *twist_u_s,
                  double *wheel_rad_s);

/* Called before the ramp. The base comes to rest before a goal that would turn a wheel around, and
 * slows down while its wheels point elsewhere. rate_max_s receives the fastest ramp that the wheels
 * can follow. Returns the reasons. */
uint32_t steer_goal(steer_state *steer, const core_config *config, const limit_state *axis,
                    const double *angle_rad, double *goal_u_s, double *rate_max_s);
/* Shorten a step of the ramp that is faster than that. The ramp is straight, so a part of the step
 * keeps all limits, too. */
uint32_t steer_pace(const limit_state *from, limit_state *axis, const double *goal_u_s,
                    double rate_max_s, double dt_s);
/* Called after the ramp. Do one step of each steering joint towards the direction in which the
 * twist, or at rest the goal, rolls its wheel; without both it holds. dt_s 0: no step. */
void steer_joints(steer_state *steer, const core_config *config, const double *twist_u_s,
                  const double *goal_u_s, double dt_s);
/* Whether joint j is where its profile is. A joint that measures nothing may be anywhere when it
 * gets power, so it gets the time of its longest move. To be called once a tick. */
bool steer_sure(steer_state *steer, const core_config *config, uint32_t j, double dt_s);
/* Make the profiles follow the positions of joints without power. */
void steer_released(steer_state *steer, const core_config *config, const double *angle_rad);
/* Compute rad/s of the driven joints, by the wheels' real angles. */
void steer_wheels(const core_config *config, const double *twist_u_s, const double *angle_rad,
                  double *wheel_rad_s);
/* Set the speeds of joints that take positions, and the estimated positions of those that measure
 * nothing. Returns whether one moves. */
bool steer_setpoints(const steer_state *steer, const core_config *config, joint_setpoint *joint,
                     double *angle_rad);

/* Write the joints' position set-points. Returns the mask of the valid ones. */
uint32_t steer_positions(const steer_state *steer, const core_config *config, bool enabled,
                         double *position_rad);

#pragma GCC visibility pop

#endif
