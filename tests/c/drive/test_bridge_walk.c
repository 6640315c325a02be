/* SPDX-License-Identifier: Apache-2.0
 * A motor on a bridge in every mode, and the effect of every event that can occur. */
#include <string.h>

#include "drive_walk.h"
#include "rt.h"

static const int64_t MS = 1000000;

static struct {
    bridge_config config;
    bridge_state state;
    bridge_control control;
    setpoints newest;
    int64_t now_ns;
    uint64_t motion, without_power;
    bool old;
} b;

static void begin_bridge(void)
{
    memset(&b, 0, sizeof b);
    b.now_ns = 5000 * MS;
    b.config = (bridge_config){
        .inputs_fd = -1,
        .event_fd = -1,
        .period_ns = MS,
        .setpoint_timeout_ns = 100 * MS,
        .stopping_ns = 1000 * MS, /* a second, because the wheel keeps turning */
        .joint_count = 1,
        .output_count = 1,
        .joint = {{.sign = 1.0, .rest_mode = BRIDGE_BRAKE}},
        .output = {{.fd = -1, .base = {0.0, 0.1, 0.2, 0.2}, .slope = {0.0, 0.0, 0.7, 0.7}}},
    };
    b.newest =
        (setpoints){.enabled = 1, .joint_count = 1, .joint = {{.duty = 0.5}}, .stamp_ns = b.now_ns};
    CHECK(bridge_config_check(&b.config) == 0);
}

static void set_up_bridge(void)
{
}

static void control_bridge(uint32_t mode)
{
    b.control.mode = mode;
    b.control.number++;
}

static void arm_bridge(void)
{
    control_bridge(PWM_ARMED);
}

static void request_of_bridge(uint32_t mode)
{
    CHECK(mode == DRIVE_STAND_DOWN);
    control_bridge(PWM_OFF);
}

static void setpoints_old(void)
{
    b.old = true;
}

static void setpoints_not_enabled(void)
{
    b.newest.enabled = 0;
}

static void end_bridge(void)
{
    control_bridge(PWM_STOP);
}

static void go_on_for(int64_t for_ns)
{
    for (int64_t end_ns = b.now_ns + for_ns; b.now_ns < end_ns; b.now_ns += MS) {
        double level[PWM_OUTPUTS_MAX] = {0};
        b.newest.stamp_ns = b.old ? b.newest.stamp_ns : b.now_ns;
        bridge_step(&b.state, &b.config, &b.control, &b.newest, b.now_ns, level);
        b.motion += level[0] > 0.3;
        b.without_power += level[0] == 0.0;
    }
}

static const drive_state *state_of_bridge(void)
{
    return &b.state.drive;
}

static uint64_t motion_sent(void)
{
    return b.motion;
}

static uint64_t periods_without_power(void)
{
    return b.without_power;
}

int main(void)
{
    const walk_medium medium = {
        .kind = ON_BRIDGE,
        .begin = begin_bridge,
        .set_up = set_up_bridge,
        .arm = arm_bridge,
        .request = request_of_bridge,
        .old = setpoints_old,
        .not_enabled = setpoints_not_enabled,
        .end = end_bridge,
        .go_on = go_on_for,
        .state = state_of_bridge,
        .motion = motion_sent,
        .power_offs = periods_without_power,
    };
    return walk_all(&medium, 15, "bridge walk");
}
