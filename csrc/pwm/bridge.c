/* SPDX-License-Identifier: Apache-2.0
 * bridge.c: the levels of a bridge's pins from set-points. Pure: time is an argument. */
#include <errno.h>
#include <math.h>
#include <string.h>

#include "drive_state.h"
#include "fresh.h"
#include "rt.h"

static void begin_brake(bridge_state *state, const bridge_config *config, drive_stop stop,
                        int64_t now_ns)
{
    if (stop == STOP_QUICK) {
        state->brake_until_ns = now_ns + config->stopping_ns;
    }
}

static drive_view view_of(const bridge_state *state, const bridge_config *config,
                          const setpoints *newest, int64_t now_ns)
{
    int64_t last_ns = state->last_ns != 0 ? state->last_ns : now_ns;
    return (drive_view){.now_ns = now_ns,
                        .fresh = fresh_stamp(now_ns, newest->stamp_ns, config->setpoint_timeout_ns),
                        .enabled = newest->enabled == 1,
                        .left_alone =
                            drive_left_alone(last_ns, now_ns, config->setpoint_timeout_ns),
                        .enabled_count = state->enabled_count};
}

static void obey_request(bridge_state *state, const bridge_config *config,
                         const bridge_control *control, const drive_view *view)
{
    drive_state *drive = &state->drive;
    uint32_t mode = control->mode == PWM_ARMED ? DRIVE_ARMED : DRIVE_STAND_DOWN;
    drive_answer answer =
        drive_obey(drive, &(mode_request){.mode = mode, .count = control->number}, view);
    if (answer.request == REQUEST_NONE) {
        return;
    }
    if (mode == DRIVE_ARMED && drive->mode != DRIVE_ARMED && !view->fresh) {
        drive->fault_reasons |= DRIVE_FAULT_SETPOINTS_OLD;
    } else if (control->mode == PWM_OFF) {
        (void)drive_power_off(drive);
    } else if (control->mode == PWM_STOP && answer.request == REQUEST_STAND_DOWN) {
        /* a braking bridge continues to brake */
        begin_brake(state, config, drive_quick_stop(drive, 0, view->now_ns), view->now_ns);
    }
}

static double duty_of(const bridge_joint *joint, const setpoints *newest)
{
    double duty =
        joint->index < newest->joint_count ? newest->joint[joint->index].duty * joint->sign : 0.0;
    if (!isfinite(duty)) {
        return 0.0;
    }
    return duty > 1.0 ? 1.0 : duty < -1.0 ? -1.0 : duty;
}

static uint32_t mode_of(const drive_state *drive, const bridge_joint *joint, bool moving,
                        double duty)
{
    if (drive->mode == DRIVE_ARMED) {
        return !moving || duty == 0.0 ? joint->rest_mode
               : duty > 0.0           ? BRIDGE_FORWARD
                                      : BRIDGE_REVERSE;
    }
    return drive->stopping ? BRIDGE_BRAKE : BRIDGE_COAST;
}

/* Move a servo to the newest position, and keep its pulses at the newest target until it has
 * stopped. Before the first position, and without power, it gets no pulses. */
static void hold_positions(bridge_state *state, const bridge_config *config,
                           const setpoints *newest, bool moving)
{
    bool powered = state->drive.mode == DRIVE_ARMED || state->drive.stopping;
    state->holds = powered ? state->holds : 0;
    for (uint32_t j = 0; j < config->joint_count; j++) {
        const bridge_joint *joint = &config->joint[j];
        if (joint->full_rad == 0.0 || !moving || joint->index >= newest->joint_count ||
            !(newest->positioned >> joint->index & 1U)) {
            continue;
        }
        double duty = newest->position_rad[joint->index] / joint->full_rad * joint->sign;
        if (isfinite(duty)) {
            state->held_duty[j] = duty > 1.0 ? 1.0 : duty < -1.0 ? -1.0 : duty;
            state->holds |= 1U << j;
        }
    }
}

static uint32_t servo_mode(const bridge_state *state, uint32_t j)
{
    if (!(state->holds >> j & 1U)) {
        return BRIDGE_COAST;
    }
    return state->held_duty[j] < 0.0 ? BRIDGE_REVERSE : BRIDGE_FORWARD;
}

void bridge_step(bridge_state *state, const bridge_config *config, const bridge_control *control,
                 const setpoints *newest, int64_t now_ns, double *level)
{
    drive_state *drive = &state->drive;
    drive_view view = view_of(state, config, newest, now_ns);
    drive->mode = drive->mode == DRIVE_OFF ? DRIVE_READY : drive->mode; /* a bridge has no set-up */
    obey_request(state, config, control, &view);
    begin_brake(state, config, drive_guard(drive, &view), now_ns);
    (void)drive_end_stopping(drive, now_ns >= state->brake_until_ns, now_ns);
    state->last_ns = now_ns;
    bool moving = drive_may_move(drive, view.fresh, view.enabled);
    state->phase ^= 1;
    hold_positions(state, config, newest, moving);
    for (uint32_t i = 0; i < config->output_count; i++) {
        const bridge_pin *output = &config->output[i];
        const bridge_joint *joint = &config->joint[output->joint];
        double duty = moving ? duty_of(joint, newest) : 0.0;
        uint32_t mode = mode_of(drive, joint, moving, duty);
        if (joint->full_rad != 0.0) {
            mode = servo_mode(state, output->joint);
            duty = state->held_duty[output->joint];
        }
        double pumped = moving && state->phase != 0 ? 1.0 : 0.0;
        level[i] =
            output->pumps != 0 ? pumped : output->base[mode] + output->slope[mode] * fabs(duty);
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
        good = good && low >= 0.0 && low <= 1.0 && high >= 0.0 && high <= 1.0; /* false for NaN */
    }
    return good;
}

int bridge_config_check(const bridge_config *config)
{
    bool good = config->joint_count > 0 && config->joint_count <= JOINTS_MAX &&
                config->output_count > 0 && config->output_count <= PWM_OUTPUTS_MAX &&
                config->period_ns > 0 && config->setpoint_timeout_ns > 0 &&
                config->stopping_ns >= 0 && config->priority >= 0 && config->priority <= 99;
    for (uint32_t i = 0; good && i < config->joint_count; i++) {
        const bridge_joint *joint = &config->joint[i];
        good = joint->index < JOINTS_MAX && (joint->sign == 1.0 || joint->sign == -1.0) &&
               joint->full_rad >= 0.0 && joint->full_rad <= 1000.0 &&
               (joint->rest_mode == BRIDGE_COAST || joint->rest_mode == BRIDGE_BRAKE) &&
               encoder_config_check(&joint->encoder) == 0;
    }
    for (uint32_t i = 0; good && i < config->output_count; i++) {
        good = output_is_good(config, &config->output[i]);
    }
    return good ? 0 : -EINVAL;
}
