/* SPDX-License-Identifier: Apache-2.0
 *
 * pwm.c: the open-loop map from a wheel's speed to a duty: a straight line that begins at the dead band's edge.
 */
#include "core.h"

#include <math.h>

/* How far the duty may go: the slew starts where the duty is, or at the dead band's edge where it is less. */
static double reach(const pwm_config *config, double last_duty, double dt_s)
{
    double from = last_duty > config->dead_band ? last_duty : config->dead_band;
    return from + config->slew_per_s * dt_s;
}

pwm_output pwm_step(const pwm_config *config, double last_duty, double velocity_rad_s, double dt_s)
{
    double sign = velocity_rad_s < 0.0 ? -1.0 : 1.0;
    double share = fabs(velocity_rad_s) / config->full_duty_rad_s;
    if (!isfinite(velocity_rad_s) || !(share > 0.0) || !(dt_s > 0.0))
        return (pwm_output){0};
    double limit = velocity_rad_s < 0.0 ? -config->duty_min : config->duty_max;
    if (!(limit > 0.0)) /* an output that cannot turn this way */
        return (pwm_output){0.0, REASON_DUTY_CLAMPED};

    pwm_output out = {config->dead_band + (1.0 - config->dead_band) * share, 0};
    if (!(out.duty <= limit)) {
        out.duty = limit;
        out.reasons |= REASON_DUTY_CLAMPED;
    }
    double reachable = reach(config, sign * last_duty, dt_s);
    if (!(out.duty <= reachable)) {
        out.duty = reachable;
        out.reasons |= REASON_DUTY_SLEW;
    }
    out.duty *= sign;
    return out;
}
