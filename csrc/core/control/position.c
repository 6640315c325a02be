/* SPDX-License-Identifier: Apache-2.0
 *
 * position.c: the motion of a joint to an angle: the fastest within velocity and acceleration that
 * ends at rest at the goal, whatever time its steps take. */
#include "core.h"

#include <math.h>

/* Return the largest speed from which, after this step, the joint can still come to rest before the
 * goal: v dt + v^2 / 2 a is no more than the rest of the distance. A step that brakes by a dt
 * covers less than v^2 / 2 a does in that time, whether it is as long as this one or not: the next
 * one may be late, or early. This form of the root is exact near the goal, too, where v is small
 * beside a dt. */
static double braking(double left_rad, double acceleration_rad_s2, double dt_s)
{
    double step_rad_s = acceleration_rad_s2 * dt_s,
           twice_rad2_s2 = 2.0 * acceleration_rad_s2 * left_rad;
    return twice_rad2_s2 / (step_rad_s + sqrt(step_rad_s * step_rad_s + twice_rad2_s2));
}

void position_step(position_profile *profile, const position_config *config, double goal_rad,
                   double dt_s)
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
        double fastest_rad_s = braking(fabs(left_rad), config->acceleration_rad_s2, dt_s);
        wanted_rad_s = copysign(fmin(config->velocity_rad_s, fastest_rad_s), left_rad);
    }
    double next_rad_s =
        fmin(fmax(wanted_rad_s, before_rad_s - step_rad_s), before_rad_s + step_rad_s);
    double moved_rad = next_rad_s * dt_s;
    /* if rounded, the last step is the whole distance, or passes the goal; the next one drops the
     * remaining speed */
    bool arrives = next_rad_s == wanted_rad_s && fabs(moved_rad) >= fabs(left_rad);
    profile->position_rad = arrives ? goal_rad : from_rad + moved_rad;
    profile->velocity_rad_s = next_rad_s;
}

/* Lag of a position loop behind a target that moves: its speed over the loop's gain, which is 4 / s
 * or more. */
static const double LAG_S = 0.25;
static const double NEARER_PART = 0.1; /* part of following_rad by which a joint has to come nearer
                                          to count as coming nearer */

bool position_follows(position_following *following, const position_config *config,
                      double apart_rad, double velocity_rad_s, int64_t now_ns)
{
    double allowed_rad = config->following_rad + LAG_S * fabs(velocity_rad_s);
    if (!(config->following_s > 0.0) || !(apart_rad > allowed_rad)) {
        following->since_ns = 0;
        return true;
    }
    if (following->since_ns == 0 ||
        apart_rad < following->nearest_rad - NEARER_PART * config->following_rad) {
        *following = (position_following){.since_ns = now_ns, .nearest_rad = apart_rad};
    }
    return (double)(now_ns - following->since_ns) * 1e-9 < config->following_s;
}
