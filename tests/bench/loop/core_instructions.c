/* SPDX-License-Identifier: Apache-2.0
 *
 * core_instructions.c: core_step() at 1 kHz, for an instruction counter.
 *
 *     core_instructions moving|ramping|rest TICKS FEEDBACK_EVERY_TICKS [skid|omni|car|swerve
 *     JOINTS]
 *
 * The default base is a four-wheel skid drive. A car has one or two steered wheels beside its
 * driven ones; in a swerve base half of the joints steer.
 * Feedback of all wheels comes in every FEEDBACK_EVERY_TICKS-th tick. Moving: a new request every 2
 * s, so that ramps, easing, wheel saturation and curves are all exercised. Ramping: a new request
 * every 50 ms, so that no ramp ever ends. Rest: armed, with a fresh command of zero.
 */
#include "good_config.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

static const int64_t TICK_NS = 1000000;

static core_config wheels(uint32_t joints)
{
    core_config config = good_config();
    config.joint_count = joints;
    config.limits.lateral = config.limits.linear;
    for (uint32_t j = 0; j < joints; j++) {
        joint_config *joint = &config.joint[j];
        *joint = config.joint[j % 2];
        joint->velocity_min_rad_s = -12.0, joint->velocity_max_rad_s = 12.0;
        joint->counter_bits = 32;
        joint->plausible =
            (plausible_config){1.5, 0.3, 6.0, 6.0, 1.5, 0.15, 0.5, 1.0, 1.0, 0.5, 1.0, 3, 0};
        joint->pwm.slew_per_s = INFINITY;
    }
    return config;
}

static void place(core_config *config, double x_m, double y_m, uint32_t steering, uint32_t traction)
{
    config->module[config->module_count++] = (wheel_module){x_m, y_m, 0.0, steering, traction};
    for (uint32_t j = 0; j < config->joint_count; j++) {
        config->joint[j].row = (wheel_row){0};
    }
    if (steering > 0) {
        config->joint[steering - 1].position =
            (position_config){1, REFERENCE_ABSOLUTE, 0, -1.7, 1.7, 6.0, 60.0, 0.0, 0.0};
    }
}

/* Returns omni wheels in a circle, a car whose last joints steer, or modules of two joints. */
static core_config base_of(const char *kind, uint32_t joints)
{
    core_config config = wheels(joints);
    double part = 6.283185307179586 / (double)joints;
    for (uint32_t j = 0; strcmp(kind, "omni") == 0 && j < joints; j++) {
        double angle_rad = part * (double)j;
        config.joint[j].row = (wheel_row){-sin(angle_rad), cos(angle_rad), 0.25};
    }
    uint32_t steered = joints > 3 ? 2 : 1;
    for (uint32_t j = 0; strcmp(kind, "car") == 0 && j < joints; j++) {
        double y_m = j % 2 == 0 ? 0.2 : -0.2;
        bool steers = j >= joints - steered;
        place(&config, steers ? 0.4 : 0.0, steered == 1 && steers ? 0.0 : y_m, steers ? j + 1 : 0,
              steers ? 0 : j + 1);
    }
    for (uint32_t j = 0; strcmp(kind, "swerve") == 0 && j < joints; j += 2) {
        place(&config, 0.3 * cos(part * j), 0.3 * sin(part * j), j + 1, j + 2);
    }
    return config;
}

/* Makes feedback of wheels that follow their set-points exactly. */
static void turn_wheels(const core_config *config, const setpoints *out, core_input *input,
                        double *position_rad, double dt_s)
{
    for (uint32_t j = 0; j < config->joint_count; j++) {
        joint_feedback *feedback = &input->feedback[j];
        bool steers = out->positioned >> j & 1U;
        position_rad[j] =
            steers ? out->position_rad[j] : position_rad[j] + out->joint[j].velocity_rad_s * dt_s;
        feedback->stamp_ns = input->now_ns;
        feedback->count =
            (uint64_t)(int64_t)floor(position_rad[j] / config->joint[j].rad_per_count);
        feedback->velocity_rad_s = out->joint[j].velocity_rad_s;
        feedback->current_a = feedback->voltage_v = feedback->temperature_c = 1.0;
        feedback->enabled = 1;
    }
}

/* Makes the command of a tick. leg_ticks: duration of a request; 0: always rest. */
static void command(core_input *input, long tick, long leg_ticks)
{
    input->now_ns += TICK_NS;
    input->control.heartbeat_ns = input->now_ns;
    input->control.armed = tick > 0;
    input->command.stamp_ns = input->now_ns;
    input->command.expires_ns = input->now_ns + 1000000000;
    input->command.linear_m_s = 0.0;
    input->command.angular_rad_s = 0.0;
    if (leg_ticks > 0 && tick > 1) {
        /* forward and back, straight and curved, beyond the wheels' limits at times */
        long leg = tick / leg_ticks;
        input->command.linear_m_s = leg % 4 == 3 ? -0.8 : 0.4 + 0.2 * (double)(leg % 4);
        input->command.angular_rad_s = -1.8 + 0.6 * (double)(leg % 7);
    }
}

int main(int argc, char **argv)
{
    if (argc != 4 && argc != 6) {
        return 2;
    }
    long leg_ticks = strcmp(argv[1], "moving") == 0    ? 2000
                     : strcmp(argv[1], "ramping") == 0 ? 50
                                                       : 0;
    long ticks = atol(argv[2]), every = atol(argv[3]);
    static core_state state;
    static core_input input;
    static setpoints out;
    const robot_state *shown = &state.snapshot;
    double position_rad[JOINTS_MAX] = {0};
    core_config config = argc == 6 ? base_of(argv[4], (uint32_t)atoi(argv[5])) : wheels(4);
    if (every < 1 || core_init(&state, &config) != 0) {
        return 2;
    }
    input.control.limits = config.limits;
    for (long tick = 0; tick < ticks; tick++) {
        command(&input, tick, leg_ticks);
        if (tick % every == 0) {
            turn_wheels(&config, &out, &input, position_rad, (double)every * 1e-3);
        }
        core_step(&state, &input, 1e-3, &out, NULL); /* as the loop calls it */
    }
    /* a robot that is in fault, or stands when it should move, would make the figure meaningless */
    bool moved = shown->distance_m > 0.1;
    return shown->armed && shown->faults == 0 && moved == (leg_ticks > 0) ? 0 : 1;
}
