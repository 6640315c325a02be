/* SPDX-License-Identifier: Apache-2.0
 * good_config.h: a base of four wheels: left, right, left, right. tests/bench/core_instructions.c
 * uses it, too. */
#ifndef MOTORD_TESTS_GOOD_CONFIG_H
#define MOTORD_TESTS_GOOD_CONFIG_H

#include "rt.h"

static inline core_config good_config(void)
{
    axis_limits linear = {1.0, 1.0, 1.5, 8.0}, angular = {2.0, 3.0, 4.0, 30.0},
                lateral = {0.8, 0.9, 1.2, 6.0};
    core_config config = {
        .joint_count = 4,
        .limits = {linear, angular, lateral},
        .command_timeout_s = 0.3,
        .feedback_timeout_s = 0.25,
        .heartbeat_timeout_s = 0.5,
        .rest_velocity_rad_s = 0.05,
        .on_timeout = STOP_RAMP,
        .on_fault = STOP_RAMP,
        .on_estop = STOP_BRAKE,
        .distance_variance_m2_per_m = 1e-4,
        .turn_variance_rad2_per_rad = 1e-3,
        .pose_variance_floor_m2 = 1e-6,
        .heading_variance_floor_rad2 = 1e-6,
        .twist_variance_floor_m2_s2 = 1e-5,
        .twist_variance_floor_rad2_s2 = 1e-5,
    };
    for (uint32_t j = 0; j < config.joint_count; j++) {
        config.joint[j] = (joint_config){
            .row = {1.0, 0.0, j % 2 == 0 ? -0.25 : 0.25},
            .wheel_radius_m = 0.1,
            .velocity_min_rad_s = -9.0,
            .velocity_max_rad_s = 9.0,
            .rad_per_count = 6.283185307179586 / 4096.0,
            .counter_bits = 16,
            .pwm = {0.05, -1.0, 1.0, 100.0, 12.5},
        };
    }
    return config;
}

#endif
