/* SPDX-License-Identifier: Apache-2.0
 *
 * rest.h: whether the robot rests. It is at rest when that was seen; what was not seen is unknown.
 * A part of core.c, like snapshot.h. */
#ifndef MOTORD_REST_H
#define MOTORD_REST_H

#include <math.h>

#include "core.h"

/* Return REST_* of a joint by what it measures. */
static inline uint32_t joint_rest(const core_state *state, uint32_t j)
{
    double speed_rad_s = fabs(state->odometry.joint[j].velocity_rad_s);
    if (state->stale[j]) {
        return REST_UNKNOWN;
    }
    if (speed_rad_s >= state->config.rest_velocity_rad_s) {
        return REST_TURNING;
    }
    bool known = isfinite(speed_rad_s) || state->config.joint[j].unmeasured != 0;
    return known && !(state->doubted >> j & 1U) ? REST_AT_REST : REST_UNKNOWN;
}

/* Judge all joints by their newest feedback. */
static inline void see_rest(core_state *state, int64_t now_ns)
{
    uint32_t found = REST_AT_REST;
    for (uint32_t j = 0; j < state->config.joint_count; j++) {
        uint32_t rest = joint_rest(state, j);
        int64_t *since_ns = &state->snapshot.rest.rest_unknown_since_ns[j];
        *since_ns = rest != REST_UNKNOWN ? 0 : *since_ns != 0 ? *since_ns : now_ns;
        if (rest == REST_TURNING || (rest == REST_UNKNOWN && found == REST_AT_REST)) {
            found = rest;
        }
    }
    state->joints_rest = found;
}

/* Take the set-points of this tick, too. */
static inline void note_rest(core_state *state, bool moving, int64_t now_ns)
{
    state->rest = moving ? (uint32_t)REST_TURNING : state->joints_rest;
    if (moving) {
        state->zero_since_ns = 0;
    } else if (state->zero_since_ns == 0) {
        state->zero_since_ns = now_ns;
    }
}

#endif
