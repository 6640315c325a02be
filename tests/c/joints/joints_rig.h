/* SPDX-License-Identifier: Apache-2.0
 * joints_rig.h: single steps of joints without a base. */
#ifndef MOTORD_TESTS_JOINTS_RIG_H
#define MOTORD_TESTS_JOINTS_RIG_H

#include "independent.h"
#include "steer.h"
#include "steered_bases.h"

enum { PAN, BELT, TILT };
static const double DT_S = 0.01;

/* Joints and their state; `begin_with` starts them as after a halt. */
typedef struct {
    core_config config;
    joints_state joints;
    steer_state steer;
    joint_command command;
    joints_input input;
    double velocity_rad_s[JOINTS_MAX];
    reasons_shown named;
    axis_limits limits[JOINTS_MAX];
} joints_rig;

static inline void begin_with(joints_rig *r, core_config config)
{
    memset(r, 0, sizeof *r);
    r->config = config;
    independent_own_limits(r->limits, &r->config);
    r->input =
        (joints_input){.command = &r->command, .limits = r->limits, .factor = 1.0, .dt_s = DT_S};
    steer_init(&r->steer, &r->config);
    independent_halt(&r->joints, &r->steer, &r->config);
}

static inline void begin(joints_rig *r)
{
    begin_with(r, head_and_belt());
    r->velocity_rad_s[TILT] = r->velocity_rad_s[3] = 9.0;
}

static inline void command(joints_rig *r, uint32_t j, double value_u)
{
    r->command.named |= 1U << j;
    r->command.value_u[j] = value_u;
}

static inline uint32_t step_joints(joints_rig *r, int count)
{
    uint32_t reasons = 0;
    for (int i = 0; i < count; i++) {
        reasons = independent_step(&r->joints, &r->steer, &r->config, &r->input, r->velocity_rad_s,
                                   &r->named);
    }
    return reasons;
}

static inline double angle(const joints_rig *r, int j)
{
    return r->steer.profile[j].position_rad;
}

#endif
