/* SPDX-License-Identifier: Apache-2.0
 * core_rig.h: the core with a base of four wheels, which follow their set-points. Time advances by
 * ticks. */
#ifndef MOTORD_TESTS_CORE_RIG_H
#define MOTORD_TESTS_CORE_RIG_H

#include <math.h>
#include <stddef.h>
#include <string.h>

#include "check.h"
#include "core.h"
#include "good_config.h"

static const int64_t TICK_NS = 1000000;

typedef struct {
    core_config config;
    core_state state;
    core_input input;
    setpoints out;
    robot_state shown;
    double position_rad[JOINTS_MAX];
    bool stale; /* feedback is not refreshed */
    bool mute;  /* the command is not refreshed */
} rig;

/* A sensor whose samples are fresh for `timeout_s`. */
static inline gyro_config good_gyro(double timeout_s)
{
    return (gyro_config){.used = 1,
                         .timeout_s = timeout_s,
                         .bias_max_rad_s = 0.5,
                         .still_variance_rad2_s2 = 1e-4,
                         .heading_variance_rad2_per_s = 1e-7,
                         .turn_variance_rad2_per_rad = 1e-4};
}

/* A check that finds a wheel that stands still although its set-point is not zero. */
static inline plausible_config finds_a_stall(void)
{
    return (plausible_config){.slow_rad_s = 0.3,
                              .setpoint_min_rad_s = 1.0,
                              .short_rad_s = 100.0,
                              .beyond_rad_s = 100.0,
                              .apart_rad_s = 100.0,
                              .stall_s = 0.5};
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

/* --- ticks by hand: the input is good, except for what a test changes */
static const int64_t MS_NS = 1000000;

/* One field of the input: a level, a number, or a stamp with an age. */
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

/* Makes the input of the next tick, in which everything is good. */
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
