/* SPDX-License-Identifier: Apache-2.0
 * bridge.c: from set-points to the levels of a bridge's pins. Pure: time is an argument. */
#include <errno.h>
#include <math.h>
#include <string.h>

#include "drive_state.h"
#include "fresh.h"
#include "rt.h"

static void take_back(bridge_state *state, uint32_t why, int64_t stop_until_ns)
{
    state->armed = 0;
    state->fault_reasons |= why;
    state->stop_until_ns = stop_until_ns;
}

static void obey_request(bridge_state *state, const bridge_config *config, const bridge_control *control, bool fresh,
                         int64_t now_ns)
{
    if (control->number == state->number) {
        return;
    }
    bool overtaken = control->number - state->number > 1; /* one that was never seen may have been a stop */
    bool powered = state->armed != 0 || state->stop_until_ns != 0;
    state->number = control->number;
    if (overtaken && powered && control->mode == PWM_ARMED) {
        state->armed = 0;
        state->fault_reasons = 0;
        state->stop_until_ns = 0;
    } else if (control->mode == PWM_ARMED && fresh) {
        state->armed = 1;
        state->was_enabled = state->fault_reasons = 0;
        state->enabled_count_armed = state->enabled_count;
        state->stop_until_ns = 0;
    } else if (control->mode == PWM_ARMED) {
        take_back(state, DRIVE_FAULT_SETPOINTS_OLD, 0);
    } else {
        bool braking = control->mode == PWM_STOP && state->armed != 0;
        state->armed = 0;
        state->stop_until_ns = braking ? now_ns + config->stopping_ns : 0;
    }
}

/* Old set-points, or a thread that was held up: brake. Not enabled any more: no power. */
static void look_at_setpoints(bridge_state *state, const bridge_config *config, const setpoints *newest, bool fresh,
                              int64_t now_ns)
{
    bool left_alone = state->last_ns != 0 && now_ns - state->last_ns > config->setpoint_timeout_ns;
    bool enabled = newest->enabled != 0;
    if (state->armed == 0) {
        return;
    }
    bool was_enabled = state->was_enabled != 0 || state->enabled_count_armed != state->enabled_count;
    uint32_t why = drive_fault_reason(fresh, left_alone, enabled, was_enabled);
    if (why != 0) {
        take_back(state, why, why == DRIVE_FAULT_NOT_ENABLED ? 0 : now_ns + config->stopping_ns);
    } else if (enabled) {
        state->was_enabled = 1;
    }
}

static double duty_of(const bridge_joint *joint, const setpoints *newest)
{
    double duty = joint->index < newest->joint_count ? newest->joint[joint->index].duty * joint->sign : 0.0;
    if (!isfinite(duty)) {
        return 0.0;
    }
    return duty > 1.0 ? 1.0 : duty < -1.0 ? -1.0 : duty;
}

static uint32_t mode_of(const bridge_state *state, const bridge_joint *joint, bool moving, double duty)
{
    if (state->armed != 0) {
        return !moving || duty == 0.0 ? joint->rest_mode : duty > 0.0 ? BRIDGE_FORWARD : BRIDGE_REVERSE;
    }
    return state->stop_until_ns != 0 ? BRIDGE_BRAKE : BRIDGE_COAST;
}

void bridge_step(bridge_state *state, const bridge_config *config, const bridge_control *control, const setpoints *newest,
                 int64_t now_ns, double *level)
{
    bool fresh = fresh_stamp(now_ns, newest->stamp_ns, config->setpoint_timeout_ns);
    obey_request(state, config, control, fresh, now_ns);
    look_at_setpoints(state, config, newest, fresh, now_ns);
    if (state->stop_until_ns != 0 && now_ns >= state->stop_until_ns) {
        state->stop_until_ns = 0;
    }
    state->last_ns = now_ns;
    bool moving = state->armed != 0 && newest->enabled != 0;
    state->phase ^= 1;
    for (uint32_t i = 0; i < config->output_count; i++) {
        const bridge_pin *output = &config->output[i];
        const bridge_joint *joint = &config->joint[output->joint];
        double duty = moving ? duty_of(joint, newest) : 0.0;
        uint32_t mode = mode_of(state, joint, moving, duty);
        double pumped = moving && state->phase != 0 ? 1.0 : 0.0;
        level[i] = output->pumps != 0 ? pumped : output->base[mode] + output->slope[mode] * fabs(duty);
    }
}

uint64_t bridge_duty_ns(const bridge_pin *output, double level)
{
    double part = level > 0.0 ? (level < 1.0 ? level : 1.0) : 0.0;
    uint64_t high_ns = (uint64_t)(part * (double)output->period_ns + 0.5);
    high_ns = high_ns < output->period_ns ? high_ns : output->period_ns;
    return output->inverted != 0 ? output->period_ns - high_ns : high_ns;
}

static bool output_is_good(const bridge_config *config, const bridge_pin *output)
{
    bool good = output->joint < config->joint_count;
    if (output->fd >= 0) {
        good = good && output->period_ns > 0 && output->period_ns <= INT64_MAX / 2;
    } else {
        good = good && config->outputs_fd >= 0 && output->bit < 64;
    }
    good = good && (output->pumps == 0 || output->fd < 0);
    for (uint32_t mode = 0; mode < BRIDGE_MODES; mode++) {
        double low = output->base[mode], high = low + output->slope[mode];
        good = good && low >= 0.0 && low <= 1.0 && high >= 0.0 && high <= 1.0; /* NaN is neither */
    }
    return good;
}

int bridge_config_check(const bridge_config *config)
{
    bool good = config->joint_count > 0 && config->joint_count <= JOINTS_MAX && config->output_count > 0 &&
                config->output_count <= PWM_OUTPUTS_MAX && config->period_ns > 0 && config->setpoint_timeout_ns > 0 &&
                config->stopping_ns >= 0 && config->priority >= 0 && config->priority <= 99;
    for (uint32_t i = 0; good && i < config->joint_count; i++) {
        const bridge_joint *joint = &config->joint[i];
        good = joint->index < JOINTS_MAX && (joint->sign == 1.0 || joint->sign == -1.0) &&
               (joint->rest_mode == BRIDGE_COAST || joint->rest_mode == BRIDGE_BRAKE) &&
               encoder_config_check(&joint->encoder) == 0;
    }
    for (uint32_t i = 0; good && i < config->output_count; i++) {
        good = output_is_good(config, &config->output[i]);
    }
    return good ? 0 : -EINVAL;
}
