/* SPDX-License-Identifier: Apache-2.0
 *
 * duties.h: speeds of wheels as duties, and which joints do not get theirs. A part of core.c, as snapshot.h is.
 */
#ifndef MOTORD_DUTIES_H
#define MOTORD_DUTIES_H

#include "rt.h"
#include "wheel.h"

/* Why duties are not what the speeds ask for, and of which joints: bit n is joint n. */
typedef struct {
    uint32_t reasons;
    uint32_t clamped;
    uint32_t slewing;
} duty_reasons;

/* speed → PWM of one wheel */
static inline void set_wheel(core_state *state, uint32_t j, double wanted_rad_s, double dt_s, duty_reasons *found)
{
    const joint_config *joint = &state->config.joint[j];
    joint_setpoint *setpoint = &state->wheels.joint[j];
    double speed_rad_s = wheel_rounded(joint, wanted_rad_s);
    pwm_output output = wheel_duty(&joint->pwm, setpoint->duty, speed_rad_s, dt_s);
    setpoint->velocity_rad_s = state->snapshot.joint[j].setpoint_rad_s = speed_rad_s;
    setpoint->duty = state->snapshot.joint[j].duty = output.duty;
    if (output.reasons != 0) {
        found->reasons |= output.reasons;
        found->clamped |= output.reasons & REASON_DUTY_CLAMPED ? 1U << j : 0;
        found->slewing |= output.reasons & REASON_DUTY_SLEW ? 1U << j : 0;
    }
}

static inline void keep_reasons(core_state *state, const duty_reasons *found)
{
    state->wheels.reasons = found->reasons;
    state->snapshot.reason.duty_clamped = found->clamped;
    state->snapshot.reason.duty_slew = found->slewing;
}

#endif
