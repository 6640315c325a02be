/* SPDX-License-Identifier: Apache-2.0
 *
 * derating.c: the factor of the base's speed limits that a joint permits. A low pass smooths
 * measured values, so that the current of a ramp, and the voltage drop under it, do not make the
 * base oscillate. */
#include "rt.h"

#include <math.h>

static const double SMOOTHING_S = 1.0;

bool derating_used(const derating_config *config)
{
    bool used = false;
    for (int by = 0; by < DERATINGS; by++) {
        used |= config->range[by].full != config->range[by].none;
    }
    return used;
}

static void measure(derating_state *state, const joint_feedback *feedback)
{
    const double now[DERATINGS] = {feedback->temperature_c, fabs(feedback->current_a),
                                   feedback->voltage_v};
    double elapsed_s = (double)(feedback->stamp_ns - state->stamp_ns) * 1e-9;
    for (int by = 0; by < DERATINGS; by++) {
        if (!isfinite(now[by])) {
            continue;
        }
        bool first = !isfinite(state->measured[by]);
        double share = first ? 1.0 : elapsed_s / (SMOOTHING_S + elapsed_s);
        state->measured[by] =
            first ? now[by] : state->measured[by] + (now[by] - state->measured[by]) * share;
    }
    state->stamp_ns = feedback->stamp_ns;
}

double derating_factor(derating_state *state, const derating_config *config,
                       const joint_feedback *feedback, uint32_t *by)
{
    if (state->stamp_ns == 0) {
        for (int i = 0; i < DERATINGS; i++) {
            state->measured[i] = (double)NAN;
        }
    }
    if (feedback->stamp_ns > state->stamp_ns) {
        measure(state, feedback);
    }
    double least = 1.0;
    for (uint32_t i = 0; i < DERATINGS; i++) {
        const derating_range *range = &config->range[i];
        double factor = (range->none - state->measured[i]) / (range->none - range->full);
        if (range->full != range->none && factor < least) { /* NaN is not less */
            least = factor;
            *by = i;
        }
    }
    return least > 0.0 ? least : 0.0;
}
