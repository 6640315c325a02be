/* SPDX-License-Identifier: Apache-2.0
 * steered_bases.h: each kind of base with steered wheels, and joints without a base, based on
 * good_config(). */
#ifndef MOTORD_TESTS_STEERED_BASES_H
#define MOTORD_TESTS_STEERED_BASES_H

#include "core_rig.h"

static const double WHEELBASE_M = 0.3;
static const double RADIUS_M = 0.05;

static inline joint_config rolling(void)
{
    joint_config joint = good_config().joint[0];
    joint.row = (wheel_row){0.0, 0.0, 0.0};
    joint.wheel_radius_m = RADIUS_M;
    joint.velocity_min_rad_s = -60.0, joint.velocity_max_rad_s = 60.0;
    joint.rad_per_count = 1e-5, joint.counter_bits = 64;
    joint.pwm = (pwm_config){0.0, -1.0, 1.0, INFINITY, 60.0};
    joint.own = (axis_limits){8.0, 10.0, 16.0, INFINITY};
    return joint;
}

static inline joint_config turning_within(double range_rad)
{
    joint_config joint = rolling();
    joint.position = (position_config){
        .used = 1,
        .position_min_rad = -range_rad,
        .position_max_rad = range_rad,
        .velocity_rad_s = 3.0,
        .acceleration_rad_s2 = 40.0,
    };
    return joint;
}

/* A base that has no joints and modules yet. The module after the last one must not count. */
static inline core_config empty_base(uint32_t joints, uint32_t modules, uint32_t steering,
                                     uint32_t traction)
{
    core_config base = good_config();
    memset(base.joint, 0, sizeof base.joint);
    base.joint_count = joints, base.module_count = modules;
    base.module[modules] = (wheel_module){5.0, 3.0, 1.0, steering, traction};
    return base;
}

/* Joint 0 rolls the rear wheel, joint 1 steers the front wheel. */
static inline core_config bicycle(void)
{
    core_config base = empty_base(2, 2, 2, 1);
    base.joint[0] = rolling(), base.joint[1] = turning_within(0.6);
    base.module[0] = (wheel_module){.x_m = WHEELBASE_M, .steering = 2};
    base.module[1] = (wheel_module){.traction = 1};
    return base;
}

/* Joint 0 rolls the front wheel, joint 1 steers it. */
static inline core_config tricycle(void)
{
    core_config base = empty_base(2, 3, 2, 1);
    base.joint[0] = rolling(), base.joint[1] = turning_within(1.6);
    base.module[0] = (wheel_module){.x_m = WHEELBASE_M, .steering = 2, .traction = 1};
    base.module[1] = (wheel_module){.y_m = 0.1};
    base.module[2] = (wheel_module){.y_m = -0.1};
    return base;
}

/* Joints 0 and 1 roll two fixed wheels. Joints 2 and 3 steer two others, in front of them or behind
 * them. */
static inline core_config ackermann(double wheelbase_m)
{
    core_config base = empty_base(4, 4, 3, 1);
    base.joint[0] = base.joint[1] = rolling();
    base.joint[2] = base.joint[3] = turning_within(0.7);
    base.module[0] = (wheel_module){.x_m = wheelbase_m, .y_m = 0.1, .steering = 3};
    base.module[1] = (wheel_module){.x_m = wheelbase_m, .y_m = -0.1, .steering = 4};
    base.module[2] = (wheel_module){.y_m = 0.1, .traction = 1};
    base.module[3] = (wheel_module){.y_m = -0.1, .traction = 2};
    return base;
}

/* Joints 0 and 2 steer two wheels, joints 1 and 3 roll them. */
static inline core_config swerve(void)
{
    core_config base = empty_base(4, 2, 1, 2);
    base.joint[0] = base.joint[2] = turning_within(3.2);
    base.joint[1] = base.joint[3] = rolling();
    base.module[0] = (wheel_module){.x_m = 0.3, .y_m = 0.1, .steering = 1, .traction = 2};
    base.module[1] =
        (wheel_module){.x_m = -0.2, .y_m = -0.2, .angle_rad = 0.3, .steering = 3, .traction = 4};
    return base;
}

/* A wheel at each corner: joints 0, 2, 4 and 6 steer, joints 1, 3, 5 and 7 roll them. */
static inline core_config swerve_of_four(void)
{
    core_config base = empty_base(8, 4, 1, 2);
    for (uint32_t k = 0; k < 4; k++) {
        base.joint[2 * k] = turning_within(3.2), base.joint[2 * k + 1] = rolling();
        base.module[k] = (wheel_module){.x_m = k < 2 ? 0.3 : -0.3, .y_m = k % 2 == 0 ? 0.2 : -0.2};
        base.module[k].steering = 2 * k + 1, base.module[k].traction = 2 * k + 2;
    }
    return base;
}

/* Joint 0 pans, joint 1 is a belt, joint 2 tilts. */
static inline core_config head_and_belt(void)
{
    core_config joints = empty_base(3, 0, 1, 2);
    joints.independent = 1;
    joints.joint[0] = turning_within(2.0), joints.joint[2] = turning_within(0.8);
    joints.joint[1] = rolling();
    joints.joint[1].velocity_min_rad_s = -8.0, joints.joint[1].velocity_max_rad_s = 8.0;
    return joints;
}

/* The largest number of joints: even ones are belts, odd ones are heads. */
static inline core_config heads_and_belts(void)
{
    core_config joints = empty_base(JOINTS_MAX, 0, 1, 2);
    joints.independent = 1;
    for (uint32_t j = 0; j < JOINTS_MAX; j++) {
        joints.joint[j] = j % 2 == 0 ? rolling() : turning_within(2.0);
    }
    return joints;
}

/* --- random numbers, the same in every run */
static uint64_t noise = 88172645463325252U;

static inline double any(double least, double most)
{
    noise ^= noise << 13, noise ^= noise >> 7, noise ^= noise << 17;
    return least + (most - least) * (double)(noise % 100001) * 1e-5;
}

static inline bool close_to(double value, double expected)
{
    return fabs(value - expected) < 1e-9;
}

#endif
