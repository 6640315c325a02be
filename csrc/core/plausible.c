/* SPDX-License-Identifier: Apache-2.0
 *
 * plausible.c: checks whether a wheel follows its set-point, and whether its feedback can be true.
 *
 * A check that fails for its time is a fault. Checks against the set-point pause while the wheel
 * comes nearer to it: a drive whose own ramp is slower than the core's may lag as long as it takes.
 * Speeds are smoothed, so that a coarse encoder, or a slowly updated counter, works like any
 * other. */
#include "core.h"

#include <math.h>

static const double SMOOTHING_S = 0.2;
static const double APART = 0.5; /* part of the larger speed */
static const int64_t JUMPS_WITHIN_NS = 1000000000;

enum { DIRECTION = 0, STALL = 1, FOLLOWING = 2, RUNAWAY = 3, IMPLAUSIBLE = 4, CHECKS = 5 };
static const uint32_t FAULTS[CHECKS] = {
    FAULT_DIRECTION, FAULT_STALL, FAULT_FOLLOWING_ERROR, FAULT_RUNAWAY, FAULT_IMPLAUSIBLE_FEEDBACK,
};
static const uint32_t BY_SETPOINT = 1U << DIRECTION | 1U << STALL | 1U << FOLLOWING | 1U << RUNAWAY;

static void begin(plausible_state *state, const joint_odometry *joint)
{
    double velocity_rad_s = isfinite(joint->velocity_rad_s) ? joint->velocity_rad_s : 0.0;
    *state = (plausible_state){
        .stamp_ns = joint->stamp_ns,
        .position_rad = joint->position_rad,
        .measured_rad_s = velocity_rad_s,
        .reported_rad_s = velocity_rad_s,
        .jumps = joint->jumps,
        .jumps_before = joint->jumps,
    };
}

/* Update the measured and the reported speed, smoothed alike, so that a common lag makes no
 * difference, and the distance of reported values from their mean: +343 and -343 in turn have a
 * plausible mean. */
static void measure(plausible_state *state, const joint_odometry *joint, double reported_rad_s)
{
    double elapsed_s = (double)(joint->stamp_ns - state->stamp_ns) * 1e-9;
    double share_per_s = 1.0 / (SMOOTHING_S + elapsed_s);
    double travel_rad = joint->position_rad - state->position_rad;
    state->measured_rad_s += (travel_rad - state->measured_rad_s * elapsed_s) * share_per_s;
    if (isfinite(reported_rad_s)) {
        double share = elapsed_s * share_per_s;
        state->reported_rad_s += (reported_rad_s - state->reported_rad_s) * share;
        state->rough_rad_s +=
            (fabs(reported_rad_s - state->reported_rad_s) - state->rough_rad_s) * share;
    } else {
        state->reported_rad_s = state->measured_rad_s;
    }
    state->position_rad = joint->position_rad;
    state->stamp_ns = joint->stamp_ns;
}

/* Return the checks that fail now: bit n for check n. */
static uint32_t suspicions(const plausible_state *state, const plausible_config *config,
                           double setpoint_rad_s)
{
    double wanted_rad_s = fabs(setpoint_rad_s), speed_rad_s = fabs(state->measured_rad_s);
    bool against = setpoint_rad_s * state->measured_rad_s < 0.0;
    /* a set-point of zero never makes a wheel too slow */
    double along_rad_s = against ? -speed_rad_s : speed_rad_s;
    double reported_rad_s = fabs(state->reported_rad_s);
    double allowed_rad_s = APART * (speed_rad_s > reported_rad_s ? speed_rad_s : reported_rad_s);
    bool slow = speed_rad_s < config->slow_rad_s, back = along_rad_s <= -config->slow_rad_s;
    uint32_t found = 0;
    if ((slow || back) && wanted_rad_s >= config->setpoint_min_rad_s) {
        found = slow ? 1U << STALL : 1U << DIRECTION;
    }
    if (wanted_rad_s - along_rad_s > config->short_rad_s) {
        found |= 1U << FOLLOWING;
    }
    if (speed_rad_s - wanted_rad_s > config->beyond_rad_s) {
        found |= 1U << RUNAWAY;
    }
    if (fabs(state->measured_rad_s - state->reported_rad_s) >
            config->apart_rad_s + allowed_rad_s /* not the same speed */
        /* no speed at all */
        || state->rough_rad_s > config->beyond_rad_s + allowed_rad_s) {
        found |= 1U << IMPLAUSIBLE;
    }
    return found;
}

/* Whether the wheel has come nearer to its set-point than before, or beyond it: it is only slow. */
static bool comes_nearer(plausible_state *state, const plausible_config *config,
                         double setpoint_rad_s)
{
    uint32_t faster = setpoint_rad_s > state->measured_rad_s;
    double gained_rad_s = state->measured_rad_s - state->nearest_rad_s;
    bool begun = state->faster == faster && (state->suspicious & BY_SETPOINT);
    if (begun && !((faster ? gained_rad_s : -gained_rad_s) > config->progress_rad_s)) {
        return false;
    }
    state->faster = faster;
    state->nearest_rad_s = state->measured_rad_s;
    return true;
}

static bool jumps_too_often(plausible_state *state, const plausible_config *config, uint32_t jumps)
{
    if (state->stamp_ns - state->jumped_ns > JUMPS_WITHIN_NS) {
        state->jumped_ns = state->stamp_ns;
        state->jumps_before = state->jumps;
    }
    state->jumps = jumps;
    return config->jumps_max != 0 && jumps - state->jumps_before >= config->jumps_max;
}

/* Return the first check that has failed for its time; CHECKS: no check. */
static uint32_t overdue(plausible_state *state, const plausible_config *config, uint32_t found)
{
    const double limit_s[CHECKS] = {
        config->direction_s, config->stall_s, config->following_s,
        config->runaway_s,   config->apart_s,
    };
    uint32_t first = CHECKS;
    for (uint32_t check = 0; check < CHECKS; check++) {
        uint32_t bit = 1U << check;
        if (!(state->suspicious & bit)) {
            state->since_ns[check] = state->stamp_ns;
        }
        double held_s = (double)(state->stamp_ns - state->since_ns[check]) * 1e-9;
        if ((found & bit) && limit_s[check] > 0.0 && held_s >= limit_s[check] && first == CHECKS) {
            first = check;
        }
    }
    state->suspicious = found;
    return first;
}

static void doubt(plausible_state *state, uint32_t check, int64_t since_ns, double setpoint_rad_s,
                  double reported_rad_s, feedback_doubt *why)
{
    state->doubted = 1;
    *why = (feedback_doubt){
        .since_ns = since_ns,
        .setpoint_rad_s = setpoint_rad_s,
        .measured_rad_s = state->measured_rad_s,
        .reported_rad_s = reported_rad_s,
        .fault = FAULTS[check],
    };
}

bool plausible(plausible_state *state, const plausible_config *config, const joint_odometry *joint,
               double reported_rad_s, double setpoint_rad_s, feedback_doubt *why)
{
    if (state->stamp_ns == 0) {
        begin(state, joint);
        return true;
    }
    measure(state, joint, reported_rad_s);
    if (joint->jumps != state->jumps && jumps_too_often(state, config, joint->jumps)) {
        doubt(state, IMPLAUSIBLE, state->jumped_ns, setpoint_rad_s, reported_rad_s, why);
        return false;
    }
    uint32_t found = suspicions(state, config, setpoint_rad_s);
    if ((found | state->suspicious) == 0) {
        return true;
    }
    if ((found & BY_SETPOINT) && comes_nearer(state, config, setpoint_rad_s)) {
        state->suspicious &= ~BY_SETPOINT;
    }
    uint32_t check = overdue(state, config, found);
    if (check == CHECKS) {
        return true;
    }
    doubt(state, check, state->since_ns[check], setpoint_rad_s, reported_rad_s, why);
    return false;
}
