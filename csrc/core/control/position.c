/* SPDX-License-Identifier: Apache-2.0
 *
 * position.c: the motion of a joint to an angle, exact in whole steps: the fastest within velocity and acceleration that ends
 * at rest on the goal.
 */
#include "core.h"

#include <math.h>

static const double ROUNDING = 1e-9; /* of a step: no limit was in the way */

/* The largest speed that can still be let go, by `step` each step, before `gap` is used up; gap is what is left, over dt.
 * Falling from v, n steps cover n v - step n (n - 1) / 2, and the fewest that reach zero are the smallest n with
 * gap <= step n (n + 1) / 2. */
static double braking(double gap_rad_s, double step_rad_s)
{
    double steps = fmax(ceil((sqrt(1.0 + 8.0 * gap_rad_s / step_rad_s) - 1.0) * 0.5), 1.0);
    return gap_rad_s / steps + 0.5 * step_rad_s * (steps - 1.0);
}

void position_step(position_profile *profile, const position_config *config, double goal_rad, double dt_s)
{
    double from_rad = profile->position_rad, before_rad_s = profile->velocity_rad_s;
    if (!isfinite(from_rad) || !isfinite(before_rad_s) || !(dt_s > 0.0 && dt_s <= 1e9)) {
        profile->velocity_rad_s = 0.0;
        return;
    }
    double step_rad_s = config->acceleration_rad_s2 * dt_s;
    double left_rad = goal_rad - from_rad;
    double wanted_rad_s = 0.0;
    if (isfinite(left_rad) && left_rad != 0.0) {
        wanted_rad_s = copysign(fmin(config->velocity_rad_s, braking(fabs(left_rad) / dt_s, step_rad_s)), left_rad);
    }
    double change_rad_s = fmin(fmax(wanted_rad_s - before_rad_s, -step_rad_s), step_rad_s);
    double next_rad_s = before_rad_s + change_rad_s;
    double moved_rad = next_rad_s * dt_s;
    /* rounded, a last step could pass the goal; the next one lets go of what is left of the speed */
    bool there = fabs(moved_rad) >= fabs(left_rad) || (goal_rad - (from_rad + moved_rad)) * left_rad <= 0.0;
    bool free = fabs(change_rad_s - (wanted_rad_s - before_rad_s)) <= ROUNDING * step_rad_s;
    bool arrives = free && there && left_rad != 0.0 && wanted_rad_s != 0.0;
    profile->position_rad = arrives ? goal_rad : from_rad + moved_rad;
    profile->velocity_rad_s = next_rad_s;
}

/* A position loop lags behind a target that moves: its speed over the loop's gain, which is 4 / s and more. */
static const double LAG_S = 0.25;
static const double NEARER_PART = 0.1; /* of following_rad: by so much it comes nearer, or it does not */

bool position_follows(position_following *following, const position_config *config, double apart_rad, double velocity_rad_s,
                      int64_t now_ns)
{
    double allowed_rad = config->following_rad + LAG_S * fabs(velocity_rad_s);
    if (!(config->following_s > 0.0) || !(apart_rad > allowed_rad)) {
        following->since_ns = 0;
        return true;
    }
    if (following->since_ns == 0 || apart_rad < following->nearest_rad - NEARER_PART * config->following_rad) {
        *following = (position_following){.since_ns = now_ns, .nearest_rad = apart_rad};
    }
    return (double)(now_ns - following->since_ns) * 1e-9 < config->following_s;
}
