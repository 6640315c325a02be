/* SPDX-License-Identifier: Apache-2.0
 * steer.h: what the tick needs of a base with modules. */
#ifndef MOTORD_STEER_H
#define MOTORD_STEER_H

#include "core.h"

#pragma GCC visibility push(hidden)

void steer_init(steer_state *steer, const core_config *config);

/* Bit n: joint n sends feedback, but its position is unknown. */
uint32_t steer_unknown(const core_config *config, const joint_feedback *feedback,
                       const uint32_t *stale, const double *angle_rad);

/* A goal that the limits of velocity allow, brought to a curvature that the steering reaches;
 * returns the reasons. */
uint32_t steer_within_reach(const steer_state *steer, const base_limits *limits,
                            const double *wanted_u_s, double *goal_u_s);
/* Wheel speeds of a twist when all wheels point to where they are to roll. */
void steer_speeds(const steer_state *steer, const core_config *config, const double *twist_u_s,
                  double *wheel_rad_s);

/* Before the ramp: the base comes to rest before a goal that would turn a wheel around, and slows
 * down while its wheels do not point there. rate_max_s: the fastest ramp that the wheels can
 * follow. Returns the reasons. */
uint32_t steer_goal(steer_state *steer, const core_config *config, const limit_state *axis,
                    const double *angle_rad, double *goal_u_s, double *rate_max_s);
/* Shortens a step of the ramp that is faster than that: the ramp is straight, so a part of the step
 * keeps all limits, too. */
uint32_t steer_pace(const limit_state *from, limit_state *axis, const double *goal_u_s,
                    double rate_max_s, double dt_s);
/* After it: one step of each steering joint towards where the twist, or at rest the goal, rolls its
 * wheel to; with neither it holds. dt_s 0: no step. */
void steer_joints(steer_state *steer, const core_config *config, const double *twist_u_s,
                  const double *goal_u_s, double dt_s);
/* Whether joint j is where its profile is. A joint that measures nothing may be anywhere when it
 * gets power, so it gets the time of its longest move. Once a tick. */
bool steer_sure(steer_state *steer, const core_config *config, uint32_t j, double dt_s);
/* They have no power: their profiles follow their positions. */
void steer_released(steer_state *steer, const core_config *config, const double *angle_rad);
/* rad/s of the rolling joints, by the wheels' real angles. */
void steer_wheels(const core_config *config, const double *twist_u_s, const double *angle_rad,
                  double *wheel_rad_s);
/* The speeds of joints that take positions, and the estimated positions of those that measure
 * nothing; returns whether one moves. */
bool steer_setpoints(const steer_state *steer, const core_config *config, joint_setpoint *joint,
                     double *angle_rad);

/* Their set-points, and the mask of those that count. */
uint32_t steer_positions(const steer_state *steer, const core_config *config, bool enabled,
                         double *position_rad);

#pragma GCC visibility pop

#endif
