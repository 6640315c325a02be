/* SPDX-License-Identifier: Apache-2.0
 * joint_values.h: converts set-points and measured numbers, for lines on every medium. */
#ifndef MOTORD_JOINT_VALUES_H
#define MOTORD_JOINT_VALUES_H

#include <math.h>

#include "fault_word.h"
#include "rt.h"

/* Get the angle that the core commands a joint. false: no angle, and the joint stays at its
 * place. */
static inline bool setpoint_position(const setpoints *from, uint32_t joint, double *position_rad)
{
    if (from->enabled != 1 || joint >= from->joint_count || joint >= JOINTS_MAX ||
        !(from->positioned >> joint & 1U)) {
        return false;
    }
    *position_rad = from->position_rad[joint];
    return isfinite(*position_rad);
}

/* Return the core's set-point of a joint; 0 if it is missing or not a number, NaN for a position.
 * It is not checked here whether the joint may move. */
static inline double setpoint_of(const setpoints *from, uint32_t joint, uint32_t kind)
{
    if (kind == SETPOINT_POSITION) {
        double position_rad;
        return setpoint_position(from, joint, &position_rad) ? position_rad : (double)NAN;
    }
    if (joint >= from->joint_count || joint >= JOINTS_MAX) {
        return 0.0;
    }
    const joint_setpoint *setpoint = &from->joint[joint];
    double value = kind == SETPOINT_VELOCITY ? setpoint->velocity_rad_s
                   : kind == SETPOINT_DUTY   ? setpoint->duty
                                             : setpoint->torque_n_m;
    return isfinite(value) ? value : 0.0;
}

/* Limit a number to its ends, beyond which it would go out as another number. NaN: the smallest. */
static inline double within_span(double raw, double raw_min, double raw_max)
{
    return fmin(fmax(raw, raw_min), raw_max);
}

/* Return the number of a speed, duty or torque that the core commands; 0 if the joint may not
 * move. */
static inline double scaled(const setpoints *from, bool may_move, const setpoint_scale *scale)
{
    double si = may_move ? setpoint_of(from, scale->joint, scale->kind) : 0.0;
    return within_span(si * scale->raw_per_si, scale->raw_min, scale->raw_max);
}

static inline uint64_t count_mask(uint32_t counter_bits)
{
    return counter_bits >= 64 ? UINT64_MAX : (UINT64_C(1) << counter_bits) - 1;
}

/* Return the part of a fault word that stops the robot. */
static inline uint32_t fault_meant(const field_meaning *field, uint32_t word)
{
    return fault_that_stops(word, field->is_code != 0, field->harmless_bits, field->harmless,
                            field->harmless_codes);
}

/* Return a feedback without any known value. */
static inline joint_feedback feedback_unknown(void)
{
    return (joint_feedback){.velocity_rad_s = NAN,
                            .current_a = NAN,
                            .voltage_v = NAN,
                            .temperature_c = NAN,
                            .enabled = 2,
                            .referenced = 2};
}

/* Store a value of a kind that is measured in SI. Returns false for other kinds. */
static inline bool feedback_measured(joint_feedback *feedback, uint32_t kind, double si)
{
    switch (kind) {
    case FIELD_VELOCITY: feedback->velocity_rad_s = si; return true;
    case FIELD_CURRENT: feedback->current_a = si; return true;
    case FIELD_VOLTAGE: feedback->voltage_v = si; return true;
    case FIELD_TEMPERATURE: feedback->temperature_c = si; return true;
    default: return false;
    }
}

/* Whether a wheel is at rest. NaN is not: then the time limit decides. */
static inline bool feedback_at_rest(const joint_feedback *feedback, double rest_velocity_rad_s)
{
    return fabs(feedback->velocity_rad_s) < rest_velocity_rad_s;
}

#endif
