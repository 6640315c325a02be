/* SPDX-License-Identifier: Apache-2.0
 *
 * limit.c: a velocity ramp under limits of velocity, acceleration, deceleration and jerk, exact in whole steps.
 *
 * In one step the velocity changes by acceleration * dt and the acceleration by at most jerk * dt. The velocity
 * never leaves the way from where it is to where it shall go. Jerk is the weakest of the four limits: an
 * acceleration that a new wish makes wrong, or too long, is dropped at once, for nobody shall be run over
 * to spare the gears.
 */
#include "core.h"

#include <float.h>
#include <math.h>

/* The largest acceleration that can still be let go, by `step` each step, before `gap` is used up; `gap` is
 * the missing velocity over dt. Falling from a, n steps cover n a - step n (n - 1) / 2, and the fewest
 * that reach zero are the smallest n with gap <= step n (n + 1) / 2. */
static double easing(double gap_u_s2, double step_u_s2)
{
    if (gap_u_s2 <= step_u_s2)
        return gap_u_s2;
    double steps = ceil((sqrt(1.0 + 8.0 * gap_u_s2 / step_u_s2) - 1.0) * 0.5);
    return gap_u_s2 / steps + 0.5 * step_u_s2 * (steps - 1.0);
}

static limited rest(limit_state *state)
{
    *state = (limit_state){0};
    return (limited){0};
}

/* One step towards `goal`, which lies on the same side of zero as the velocity, or at zero. */
static uint32_t approach(limit_state *state, const axis_limits *limits, double goal_u_s, double dt_s, bool urgent)
{
    double from_u_s = state->velocity_u_s;
    double away_u_s = goal_u_s - from_u_s;
    bool rising = fabs(goal_u_s) > fabs(from_u_s);
    double bound_u_s2 = rising ? limits->acceleration_u_s2 : limits->deceleration_u_s2;
    uint32_t reason = rising ? REASON_LINEAR_ACCELERATION : REASON_LINEAR_DECELERATION;
    double sign = away_u_s < 0.0 ? -1.0 : 1.0;
    double gap_u_s2 = fabs(away_u_s) / dt_s;

    if (!urgent) {
        double step_u_s2 = limits->jerk_u_s3 * dt_s;
        double along_u_s2 = sign * state->acceleration_u_s2;
        double soft_u_s2 = (along_u_s2 > 0.0 ? along_u_s2 : 0.0) + step_u_s2;
        double ease_u_s2 = easing(gap_u_s2, step_u_s2);
        if (ease_u_s2 < soft_u_s2)
            soft_u_s2 = ease_u_s2;
        if (soft_u_s2 < bound_u_s2) {
            bound_u_s2 = soft_u_s2;
            reason = REASON_LINEAR_JERK;
        }
    }
    if (gap_u_s2 <= bound_u_s2) {
        state->acceleration_u_s2 = sign * gap_u_s2;
        state->velocity_u_s = goal_u_s;
        return 0;
    }
    double next_u_s = from_u_s + sign * bound_u_s2 * dt_s;
    /* away is rounded, so a last step could pass the goal by a rounding */
    if ((goal_u_s - next_u_s) * sign < 0.0)
        next_u_s = goal_u_s;
    state->acceleration_u_s2 = sign * bound_u_s2;
    state->velocity_u_s = next_u_s;
    return reason;
}

limited limit_step(limit_state *state, const axis_limits *limits, double want_u_s, double dt_s, bool urgent)
{
    double from_u_s = state->velocity_u_s;
    if (!(fabs(from_u_s) + fabs(state->acceleration_u_s2) <= DBL_MAX) || !(dt_s > 0.0 && dt_s <= DBL_MAX))
        return rest(state);
    uint32_t reasons = 0;
    double target_u_s = want_u_s + 0.0; /* no negative zero */
    if (!(fabs(target_u_s) <= limits->velocity_u_s)) {
        if (!isfinite(want_u_s) || isnan(limits->velocity_u_s)) {
            target_u_s = 0.0;
        } else {
            target_u_s = copysign(limits->velocity_u_s, want_u_s);
            reasons = REASON_LINEAR_VELOCITY;
        }
    }
    if (from_u_s * target_u_s < 0.0) {
        /* through zero: stop with the deceleration, then start with the acceleration */
        uint32_t reason = approach(state, limits, 0.0, dt_s, urgent);
        reasons |= reason != 0 ? reason : (uint32_t)REASON_LINEAR_DECELERATION;
    } else {
        reasons |= approach(state, limits, target_u_s, dt_s, urgent);
    }
    if (!(fabs(state->velocity_u_s) <= DBL_MAX))
        return rest(state);
    return (limited){state->velocity_u_s, reasons};
}
