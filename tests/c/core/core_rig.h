/* SPDX-License-Identifier: Apache-2.0
 * core_rig.h: a base of four wheels around the core. Wheels follow their set-points; time goes
 * by ticks. */
#ifndef MOTORD_TESTS_CORE_RIG_H
#define MOTORD_TESTS_CORE_RIG_H

#include <math.h>
#include <stddef.h>
#include <string.h>

#include "check.h"
#include "core.h"

static const int64_t TICK_NS = 1000000;

typedef struct {
    core_config config;
    core_state state;
    core_input input;
    setpoints out;
    robot_state shown;
    double position_rad[JOINTS_MAX];
    bool stale; /* feedback is not refreshed */
    bool mute;  /* nor the command */
} rig;

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

static inline void start(rig *r, const core_config *config)
{
    memset(r, 0, sizeof *r);
    r->config = *config;
    r->input.now_ns = 1000000000;
    r->input.control.limits = config->limits;
    for (uint32_t j = 0; j < config->joint_count; j++) {
        r->input.feedback[j].enabled = 1;
    }
    CHECK(core_init(&r->state, config) == 0);
}

static inline const robot_state *tick(rig *r)
{
    r->input.now_ns += TICK_NS;
    r->input.control.heartbeat_ns = r->input.now_ns;
    if (!r->mute) {
        r->input.command.stamp_ns = r->input.now_ns;
        r->input.command.expires_ns = r->input.now_ns + 1000000000;
    }
    for (uint32_t j = 0; j < r->config.joint_count && !r->stale; j++) {
        joint_feedback *feedback = &r->input.feedback[j];
        r->position_rad[j] += r->out.joint[j].velocity_rad_s * 1e-3;
        feedback->velocity_rad_s = r->out.joint[j].velocity_rad_s;
        feedback->count =
            (uint64_t)(int64_t)floor(r->position_rad[j] / r->config.joint[j].rad_per_count);
        feedback->stamp_ns = r->input.now_ns;
    }
    core_step(&r->state, &r->input, 1e-3, &r->out, &r->shown);
    return &r->shown;
}

static inline const robot_state *ticks(rig *r, int count)
{
    for (int i = 0; i < count; i++) {
        tick(r);
    }
    return &r->shown;
}

static inline void go(rig *r, double linear_m_s, double angular_rad_s)
{
    tick(r);
    r->input.control.armed = 1;
    CHECK(tick(r)->armed == 1);
    r->input.command.linear_m_s = linear_m_s;
    r->input.command.angular_rad_s = angular_rad_s;
    CHECK(ticks(r, 1500)->faults == 0);
}

static inline bool zero(const rig *r)
{
    for (uint32_t j = 0; j < JOINTS_MAX; j++) {
        if (r->out.joint[j].velocity_rad_s != 0.0 || r->out.joint[j].duty != 0.0) {
            return false;
        }
    }
    return true;
}

/* --- a tick by hand: all is well, but for what is changed */
static const int64_t MS_NS = 1000000;

/* One field of the input: a level, a number, or a stamp that is so much older than now. */
typedef struct {
    enum { LEVEL, NUMBER, AGE } kind;
    size_t at;
    int64_t level_or_age_ns;
    double number;
    uint32_t expected;
} change;

#define LEVEL_OF(field, level, expected) {LEVEL, offsetof(core_input, field), level, 0.0, expected}
#define NUMBER_OF(field, number, expected)                                                         \
    {NUMBER, offsetof(core_input, field), 0, number, expected}
#define AGE_OF(field, age_ns, expected) {AGE, offsetof(core_input, field), age_ns, 0.0, expected}
#define COUNT_OF(table) ((int)(sizeof(table) / sizeof(table)[0]))

static const int64_t NEVER = INT64_MAX;

static inline void apply(core_input *input, const change *of)
{
    char *field = (char *)input + of->at;
    int64_t stamp_ns = of->level_or_age_ns == NEVER ? 0 : input->now_ns - of->level_or_age_ns;
    uint32_t level = (uint32_t)of->level_or_age_ns;
    switch (of->kind) {
    case LEVEL: memcpy(field, &level, sizeof level); break;
    case NUMBER: memcpy(field, &of->number, sizeof of->number); break;
    case AGE: memcpy(field, &stamp_ns, sizeof stamp_ns); break;
    }
}

/* The input of the next tick, in which all is well. */
static inline void prepare(rig *r)
{
    core_input *input = &r->input;
    input->now_ns += TICK_NS;
    input->control.heartbeat_ns = input->command.stamp_ns = input->now_ns;
    input->command.expires_ns = input->now_ns + 1000000000;
    for (uint32_t j = 0; j < r->config.joint_count; j++) {
        input->feedback[j].stamp_ns = input->now_ns;
        input->feedback[j].velocity_rad_s = r->out.joint[j].velocity_rad_s;
        r->position_rad[j] += r->out.joint[j].velocity_rad_s * 1e-3;
        input->feedback[j].count =
            (uint64_t)(int64_t)floor(r->position_rad[j] / r->config.joint[j].rad_per_count);
    }
}

static inline const robot_state *step(rig *r)
{
    core_step(&r->state, &r->input, 1e-3, &r->out, &r->shown);
    return &r->shown;
}

static inline const robot_state *step_with(rig *r, const change *of)
{
    prepare(r);
    apply(&r->input, of);
    return step(r);
}

static inline void ready(rig *r, const core_config *config)
{
    start(r, config);
    ticks(r, 2);
}

#endif
