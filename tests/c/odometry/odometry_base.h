/* SPDX-License-Identifier: Apache-2.0
 * odometry_base.h: the odometry of two wheels, whose counts and stamps the test sets. A wheel can
 * reach 52.5 rad/s: 2737.9 counts in a step; four more are accepted. */
#ifndef MOTORD_TESTS_ODOMETRY_BASE_H
#define MOTORD_TESTS_ODOMETRY_BASE_H

#include <math.h>
#include <string.h>

#include "check.h"
#include "core.h"

static const int64_t STEP_NS = 10000000;
static const double COUNT_RAD = 6.283185307179586 / 32768.0;
static const uint32_t RECEIVED[JOINTS_MAX] = {0};

typedef struct {
    core_config config;
    odometry_state state;
    joint_feedback feedback[JOINTS_MAX];
    joint_setpoint setpoint[JOINTS_MAX];
} base;

static inline base begun(uint32_t bits)
{
    base b = {.config = {.joint_count = 2,
                         .feedback_timeout_s = 0.25,
                         /* so great that the speed is that of the last step */
                         .limits.linear.acceleration_u_s2 = 1e12,
                         .distance_variance_m2_per_m = 1e-4,
                         .turn_variance_rad2_per_rad = 1e-3}};
    for (int j = 0; j < 2; j++) {
        b.config.joint[j] = (joint_config){.row = {1.0, 0.0, (2.0 * j - 1.0) * 0.25},
                                           .wheel_radius_m = 0.1,
                                           .velocity_min_rad_s = -35.0,
                                           .velocity_max_rad_s = 35.0,
                                           .rad_per_count = COUNT_RAD,
                                           .counter_bits = bits};
    }
    odometry_init(&b.state, &b.config);
    return b;
}

static inline void comes(base *b, int j, int64_t after_ns, int64_t counts, double velocity_rad_s)
{
    b->feedback[j].stamp_ns += after_ns;
    b->feedback[j].count += (uint64_t)counts;
    b->feedback[j].velocity_rad_s = velocity_rad_s;
}

static inline void take(base *b)
{
    odometry_step(&b->state, &b->config, b->feedback, RECEIVED, b->setpoint);
}

static inline const joint_odometry *received(base *b, int64_t after_ns, int64_t counts,
                                             double velocity_rad_s)
{
    for (int j = 0; j < 2; j++) {
        comes(b, j, after_ns, counts, velocity_rad_s);
    }
    take(b);
    return &b->state.joint[0];
}

static inline bool near(double value, double expected)
{
    return fabs(value - expected) < 1e-9;
}

#endif
