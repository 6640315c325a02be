/* SPDX-License-Identifier: Apache-2.0
 * wheel.h: one wheel's share of kinematics, saturation and the PWM map, inline, for the tick and
 * the public functions. */
#ifndef MOTORD_WHEEL_H
#define MOTORD_WHEEL_H

#include "rt.h"

#include <math.h>

/* Return the wheel's rad/s for a twist, twist_u_s[AXES]. */
static inline double wheel_speed(const joint_config *joint, const double *twist_u_s)
{
    const wheel_row *row = &joint->row;
    double rim_m_s = row->x * twist_u_s[AXIS_LINEAR] + row->lever_m * twist_u_s[AXIS_ANGULAR] +
                     row->y * twist_u_s[AXIS_LATERAL];
    return rim_m_s / joint->wheel_radius_m;
}

/* Return a speed within the wheel's limits: rounding may put one beyond them by the last bit. NaN
 * stays NaN. */
static inline double wheel_rounded(const joint_config *joint, double speed_rad_s)
{
    double most_rad_s = joint->velocity_max_rad_s, least_rad_s = joint->velocity_min_rad_s;
    double below_rad_s = speed_rad_s > most_rad_s ? most_rad_s : speed_rad_s;
    return below_rad_s < least_rad_s ? least_rad_s : below_rad_s;
}

/* Return the fastest growth of the wheel's speed, away from zero, at which the duty keeps its
 * slew. */
static inline double wheel_acceleration(const pwm_config *config)
{
    return config->slew_per_s * config->full_duty_rad_s / (1.0 - config->dead_band);
}

static inline bool wheel_within(const joint_config *joint, double want_rad_s)
{
    return want_rad_s <= joint->velocity_max_rad_s && want_rad_s >= joint->velocity_min_rad_s;
}

/* Return the factor that brings a wheel that is beyond its limits to within them. */
static inline double wheel_share(const joint_config *joint, double want_rad_s)
{
    double want = fabs(want_rad_s);
    double limit = want_rad_s < 0.0 ? -joint->velocity_min_rad_s : joint->velocity_max_rad_s;
    if (!(want > limit) || isinf(want)) { /* NaN, on either side, never causes motion */
        return 0.0;
    }
    double quotient = fabs(limit / want);
    /* the quotient may have been rounded up */
    return want * quotient > limit ? nextafter(quotient, 0.0) : quotient;
}

/* Return the duty by a straight line that begins at the dead band's edge. A speed that is not
 * finite gives a duty that is not. */
static inline pwm_output wheel_duty(const pwm_config *config, double last_duty,
                                    double velocity_rad_s, double dt_s)
{
    if (velocity_rad_s == 0.0) {
        return (pwm_output){0};
    }
    bool back = velocity_rad_s < 0.0;
    double edge = back ? -config->dead_band : config->dead_band;
    double wanted = velocity_rad_s * (1.0 - config->dead_band) / config->full_duty_rad_s + edge;
    double duty = wanted > config->duty_max ? config->duty_max : wanted;
    duty = duty < config->duty_min ? config->duty_min : duty;
    uint32_t reasons = duty != wanted ? (uint32_t)REASON_DUTY_CLAMPED : 0;
    if (config->slew_per_s < INFINITY) {
        /* only away from zero; from the dead band's edge if the duty is less */
        double start = back ? -last_duty : last_duty;
        double reach =
            (start > config->dead_band ? start : config->dead_band) + config->slew_per_s * dt_s;
        if (fabs(duty) > reach) {
            duty = copysign(reach, duty);
            reasons |= REASON_DUTY_SLEW;
        }
    }
    return (pwm_output){duty + 0.0, reasons}; /* + 0.0: no negative zero */
}

#endif
