/* SPDX-License-Identifier: Apache-2.0
 *
 * duties.h: duties of wheel speeds, and the joints that do not reach theirs. A part of core.c, like
 * snapshot.h.
 */
#ifndef MOTORD_DUTIES_H
#define MOTORD_DUTIES_H

#include "rt.h"
#include "wheel.h"

/* Compute speed → PWM of one wheel. */
static inline uint32_t set_wheel(core_state *state, uint32_t j, double wanted_rad_s, double dt_s)
{
    const joint_config *joint = &state->config.joint[j];
    joint_setpoint *setpoint = &state->wheels.joint[j];
    double speed_rad_s = wheel_rounded(joint, wanted_rad_s);
    pwm_output output = wheel_duty(&joint->pwm, setpoint->duty, speed_rad_s, dt_s);
    setpoint->velocity_rad_s = state->snapshot.joint[j].setpoint_rad_s = speed_rad_s;
    setpoint->duty = state->snapshot.joint[j].duty = output.duty;
    return output.reasons;
}

/* Find the joints that cause the reasons, which is rare. slewing: bit n: joint n slows the ramp
 * down. A duty that differs from that of its speed has been slewed. */
__attribute__((noinline)) static void name_duties(core_state *state, uint32_t slewing)
{
    reasons_shown *to = &state->snapshot.reason;
    to->duty_clamped = 0;
    to->duty_slew = slewing;
    for (uint32_t j = 0; j < state->config.joint_count; j++) {
        const joint_setpoint *setpoint = &state->wheels.joint[j];
        if (state->config.joint[j].position.used) {
            continue;
        }
        double speed_rad_s = setpoint->velocity_rad_s,
               unslewed = copysign((double)INFINITY, speed_rad_s);
        pwm_output output = wheel_duty(&state->config.joint[j].pwm, unslewed, speed_rad_s, 0.0);
        to->duty_clamped |= output.reasons & REASON_DUTY_CLAMPED ? 1U << j : 0;
        to->duty_slew |= setpoint->duty != output.duty ? 1U << j : 0;
    }
}

#endif
