/* SPDX-License-Identifier: Apache-2.0
 * wheel.h: one wheel's share of kinematics, saturation and the PWM map, in place, for the tick and the public
 * functions alike. */
#ifndef MOTORD_WHEEL_H
#define MOTORD_WHEEL_H

#include "rt.h"

#include <float.h>
#include <math.h>

/* Siegwart & Nourbakhsh, Autonomous Mobile Robots, 3.2.3: each side rolls at v -+ w b / 2. */
static inline double wheel_speed(const joint_config *joint, double linear_m_s, double turn_m_s)
{
    return (linear_m_s + joint->side * turn_m_s) / joint->wheel_radius_m;
}

/* The factor that brings a wheel within its limits. */
static inline double wheel_share(const joint_config *joint, double want_rad_s)
{
    if (want_rad_s <= joint->velocity_max_rad_s && want_rad_s >= joint->velocity_min_rad_s)
        return 1.0;
    double want = fabs(want_rad_s);
    double limit = want_rad_s < 0.0 ? -joint->velocity_min_rad_s : joint->velocity_max_rad_s;
    if (!(want > limit) || isinf(want)) /* NaN, on either side, is no reason to move */
        return 0.0;
    double quotient = fabs(limit / want);
    return want * quotient > limit ? nextafter(quotient, 0.0) : quotient; /* it may have been rounded up */
}

/* A straight line that begins at the dead band's edge, for a speed of either sign. */
static inline pwm_output wheel_duty(const pwm_config *config, double last_duty, double velocity_rad_s, double dt_s)
{
    bool back = velocity_rad_s < 0.0;
    double share = fabs(velocity_rad_s) / config->full_duty_rad_s;
    double limit = back ? -config->duty_min : config->duty_max;
    double start = back ? -last_duty : last_duty;
    if (!(share > 0.0 && share <= DBL_MAX))
        return (pwm_output){0};
    double duty = config->dead_band + (1.0 - config->dead_band) * share;
    uint32_t reasons = 0;
    if (!(duty <= limit)) {
        duty = limit > 0.0 ? limit : 0.0; /* 0: an output that cannot turn this way */
        reasons = REASON_DUTY_CLAMPED;
    }
    /* away from zero only; from the dead band's edge where the duty is less */
    if (!(duty <= start)) {
        double reachable = (start > config->dead_band ? start : config->dead_band) + config->slew_per_s * dt_s;
        if (!(duty <= reachable)) {
            duty = reachable;
            reasons |= REASON_DUTY_SLEW;
        }
    }
    return (pwm_output){back ? 0.0 - duty : duty, reasons};
}

#endif
