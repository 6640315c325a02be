/* SPDX-License-Identifier: Apache-2.0
 *
 * following.h: checks whether joints that take positions are where their set-points are. A part of
 * core.c, like snapshot.h.
 */
#ifndef MOTORD_FOLLOWING_H
#define MOTORD_FOLLOWING_H

#include <math.h>

#include "watch.h"

/* Number of joints that have power: all, or 0. */
static inline uint32_t joints_with_power(const core_state *state)
{
    return state->armed | state->holding ? state->config.joint_count : 0;
}

/* Check whether each joint that takes positions is at its set-point. A joint that measures nothing
 * counts as there. */
__attribute__((noinline)) static void doubt_positions(core_state *state, tick *t)
{
    steer_state *steer = &state->steer;
    int64_t now_ns = t->input->now_ns;
    for (uint32_t j = 0; j < state->config.joint_count; j++) {
        const position_config *own = &state->config.joint[j].position;
        const position_profile *profile = &steer->profile[j];
        position_following *following = &steer->following[j];
        if (!own->used || state->stale[j]) {
            continue;
        }
        if (joints_with_power(state) == 0) {
            following->since_ns = 0;
            continue;
        }
        double apart_rad = fabs(profile->position_rad - state->odometry.angle_rad[j]);
        int64_t since_ns = following->since_ns;
        if (position_follows(following, own, apart_rad, profile->velocity_rad_s, now_ns)) {
            continue;
        }
        state->doubted |= 1U << j;
        if (state->snapshot.doubt.fault == 0) {
            state->snapshot.doubt =
                (feedback_doubt){.since_ns = since_ns,
                                 .setpoint_rad_s = profile->velocity_rad_s,
                                 .measured_rad_s = state->odometry.joint[j].velocity_rad_s,
                                 .reported_rad_s = NAN,
                                 .fault = FAULT_FOLLOWING_ERROR,
                                 .joint = j};
        }
        watch_latch(state, FAULT_FOLLOWING_ERROR);
        t->calm = false;
    }
}

#endif
