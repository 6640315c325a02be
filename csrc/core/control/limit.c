/* SPDX-License-Identifier: Apache-2.0
 *
 * limit.c: the ramp of a twist under limits of velocity, acceleration, deceleration and jerk, exact
 * in whole steps.
 *
 * The twists that the limits of base and wheels allow are a convex set. The ramp runs along the
 * straight line from the present twist to the goal, and one number drives it: the share of what is
 * left that is covered in a second. So every twist between is allowed where both ends are, nothing
 * is scaled after the ramp, and a stop keeps its curvature. What holds in every step:
 *
 * Velocity: each axis stays between where it is and its goal, so it passes neither the goal nor its
 * limit. An axis beyond a limit that has been lowered comes back by its deceleration.
 * Acceleration: each axis keeps its acceleration where its speed grows and its deceleration where
 * it falls. A step through zero keeps both. The axis with the least room sets the pace of all.
 * Jerk: the acceleration of an axis never grows by more than jerk * dt in a step. While goal and
 * limits stay as they are, it never falls by more either: it is eased before the goal, and before a
 * change of sign after which less is allowed. When a new goal or new limits turn the line, an axis
 * drops at once what no longer fits: stopping and keeping to the line matter more than gears.
 * `urgent` leaves the jerk out.
 */
#include "core.h"
#include "wheel.h"

#include <float.h>
#include <string.h>

/* First bits of the four reasons of each axis, counted from the linear one. */
static const uint32_t SHIFT_OF_AXIS[AXES] = {
    [AXIS_LINEAR] = 0, [AXIS_ANGULAR] = 4, [AXIS_LATERAL] = 11};
_Static_assert(REASON_LINEAR_VELOCITY << 4 == REASON_ANGULAR_VELOCITY, "SHIFT_OF_AXIS");
_Static_assert(REASON_LINEAR_VELOCITY << 11 == REASON_LATERAL_VELOCITY, "SHIFT_OF_AXIS");

/* Share of the remaining change that a second covers, and the limit that bounds it. */
typedef struct {
    double rate_s;
    double sum_s; /* sum of all examined rates, which are not negative: NaN if one is NaN */
    uint32_t reason;
} pace;

static inline void bind(pace *least, double rate_s, uint32_t reason)
{
    least->sum_s += rate_s;
    if (rate_s < least->rate_s) {
        least->rate_s = rate_s;
        least->reason = reason;
    }
}

/* Return the largest rate that can still fall to zero, by `step` each step, before `gap` is used
 * up; `gap` is the rest, over dt. Falling from a, n steps cover n a - step n (n - 1) / 2, and the
 * fewest that reach zero are the smallest n with gap <= step n (n + 1) / 2. */
static double easing(double gap_s, double step_s)
{
    double steps = ceil((sqrt(1.0 + 8.0 * gap_s / step_s) - 1.0) * 0.5);
    return gap_s / steps + 0.5 * step_s * (steps - 1.0);
}

/* Return the largest rate from which `step` each step still leads to `after` or less in the step
 * that covers `gap`. Falling from a, n steps before it: n a - step n (n - 1) / 2 <= gap and a -
 * step n <= after, with the largest such n. */
static double turning(double gap_s, double after_s, double step_s)
{
    if (!(gap_s > after_s)) {
        return after_s;
    }
    if (step_s == INFINITY) {
        return gap_s;
    }
    double half_s = after_s - 0.5 * step_s;
    double steps = floor((sqrt(half_s * half_s + 2.0 * step_s * gap_s) - half_s) / step_s);
    if (steps < 1.0) {
        return after_s;
    }
    double by_after_s = after_s + steps * step_s;
    double by_gap_s = gap_s / steps + 0.5 * step_s * (steps - 1.0);
    return by_after_s < by_gap_s ? by_after_s : by_gap_s;
}

/* Whether a speed changes its sign before the goal, and may then gain less than it may lose
 * before. */
static inline bool turns(double from, double goal, double gains, double loses)
{
    return from * goal < 0.0 && gains < loses;
}

/* Apply the limits of one axis: on its acceleration, and on the growth of it. */
static inline void keep_axis(pace *least, pace *step, const limit_state *axis,
                             const axis_limits *limits, double goal_u_s, double dt_s, bool urgent,
                             uint32_t shift)
{
    double from_u_s = axis->velocity_u_s, change_u_s = goal_u_s - from_u_s,
           size_u_s = fabs(change_u_s);
    if (size_u_s == 0.0) {
        return;
    }
    bool rising = fabs(goal_u_s) > fabs(from_u_s) && from_u_s * goal_u_s >= 0.0;
    double bound_u_s2 = rising ? limits->acceleration_u_s2 : limits->deceleration_u_s2;
    uint32_t reason = rising ? REASON_LINEAR_ACCELERATION : REASON_LINEAR_DECELERATION;
    if (!urgent) {
        double step_u_s2 = limits->jerk_u_s3 * dt_s;
        double along_u_s2 = change_u_s < 0.0 ? -axis->acceleration_u_s2 : axis->acceleration_u_s2;
        double soft_u_s2 = (along_u_s2 > 0.0 ? along_u_s2 : 0.0) + step_u_s2;
        bind(step, step_u_s2 / size_u_s, (uint32_t)REASON_LINEAR_JERK << shift);
        if (soft_u_s2 < bound_u_s2) {
            bound_u_s2 = soft_u_s2;
            reason = REASON_LINEAR_JERK;
        }
    }
    bind(least, bound_u_s2 / size_u_s, reason << shift);
}

/* Ease a speed by `step` each step, so that at its change of sign it changes by no more than it may
 * gain afterwards. */
static void keep_turn(pace *least, double from, double goal, double gains, double step_s,
                      double dt_s, uint32_t reason)
{
    double change = fabs(goal - from);
    bind(least, turning(fabs(from) / (change * dt_s), gains / change, step_s), reason);
}

/* Apply the duty slews, which bound how fast a wheel's speed grows. This is the last of the bounds:
 * slewing is the joint with the least room. */
static void keep_duties(pace *least, const core_config *base, const limit_state *axis,
                        const double *goal_u_s, double step_s, double dt_s, uint32_t *slewing)
{
    double from_u_s[AXES];
    for (int i = 0; i < AXES; i++) {
        from_u_s[i] = axis[i].velocity_u_s;
    }
    for (uint32_t j = 0; j < base->joint_count; j++) {
        const joint_config *joint = &base->joint[j];
        double from_rad_s = wheel_speed(joint, from_u_s);
        double goal_rad_s = wheel_speed(joint, goal_u_s);
        double gains_rad_s2 = wheel_acceleration(&joint->pwm), before_s = least->rate_s;
        if (turns(from_rad_s, goal_rad_s, gains_rad_s2, INFINITY)) {
            keep_turn(least, from_rad_s, goal_rad_s, gains_rad_s2, step_s, dt_s, REASON_DUTY_SLEW);
        } else if (fabs(goal_rad_s) > fabs(from_rad_s)) {
            bind(least, gains_rad_s2 / fabs(goal_rad_s - from_rad_s), REASON_DUTY_SLEW);
        }
        *slewing = least->rate_s < before_s ? 1U << j : *slewing;
    }
}

static uint32_t rest(limit_state *axis)
{
    for (int i = 0; i < AXES; i++) {
        axis[i] = (limit_state){0};
    }
    return 0;
}

static void move(limit_state *axis, uint32_t axes, const double *goal_u_s, double rate_s,
                 bool arrives, double dt_s)
{
    for (uint32_t i = 0; i < axes; i++) {
        double from_u_s = axis[i].velocity_u_s, change_u_s = goal_u_s[i] - from_u_s;
        double next_u_s = from_u_s + change_u_s * rate_s * dt_s;
        /* the change is rounded, so a last step could pass the goal by a rounding */
        if (arrives || (goal_u_s[i] - next_u_s) * change_u_s < 0.0) {
            next_u_s = goal_u_s[i];
        }
        axis[i] = (limit_state){next_u_s, change_u_s * rate_s};
    }
}

uint32_t ramp_joint_step(limit_state *axis, uint32_t axes, const base_limits *limits,
                         const core_config *slewed, const double *goal_u_s, double dt_s,
                         bool urgent, uint32_t *slewing)
{
    const axis_limits *of[AXES] = {&limits->linear, &limits->angular, &limits->lateral};
    double goal[AXES] = {0.0}, sum = 0.0, goals = 0.0;
    for (uint32_t i = 0; i < axes; i++) {
        goal[i] = goal_u_s[i] + 0.0; /* no negative zero */
        sum += fabs(axis[i].velocity_u_s) + fabs(axis[i].acceleration_u_s2);
        goals += fabs(goal[i]);
    }
    if (!(sum <= DBL_MAX) || !(dt_s > 0.0 && dt_s <= DBL_MAX)) {
        return rest(axis);
    }
    if (!(goals <= DBL_MAX)) {
        memset(goal, 0, sizeof goal);
    }

    pace whole = {1.0 / dt_s, 0.0, 0}, least = whole, step = {INFINITY, 0.0, 0};
    for (uint32_t i = 0; i < axes; i++) {
        keep_axis(&least, &step, &axis[i], of[i], goal[i], dt_s, urgent, SHIFT_OF_AXIS[i]);
    }
    if (step.rate_s < whole.rate_s) {
        bind(&least, easing(whole.rate_s, step.rate_s), step.reason);
    }
    for (uint32_t i = 0; i < axes; i++) {
        if (turns(axis[i].velocity_u_s, goal[i], of[i]->acceleration_u_s2,
                  of[i]->deceleration_u_s2)) {
            keep_turn(&least, axis[i].velocity_u_s, goal[i], of[i]->acceleration_u_s2, step.rate_s,
                      dt_s, (uint32_t)REASON_LINEAR_ACCELERATION << SHIFT_OF_AXIS[i]);
        }
    }
    if (slewed != NULL) {
        keep_duties(&least, slewed, axis, goal, step.rate_s, dt_s, slewing);
    }

    move(axis, axes, goal, least.rate_s, least.reason == 0, dt_s);
    sum = 0.0;
    for (uint32_t i = 0; i < axes; i++) {
        sum += fabs(axis[i].velocity_u_s) + fabs(axis[i].acceleration_u_s2);
    }
    return sum <= DBL_MAX && !isnan(least.sum_s + step.sum_s) ? least.reason : rest(axis);
}

uint32_t ramp_step(limit_state *axis, uint32_t axes, const base_limits *limits,
                   const core_config *slewed, const double *goal_u_s, double dt_s, bool urgent)
{
    uint32_t slewing = 0;
    return ramp_joint_step(axis, axes, limits, slewed, goal_u_s, dt_s, urgent, &slewing);
}
