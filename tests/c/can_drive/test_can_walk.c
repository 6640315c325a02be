/* SPDX-License-Identifier: Apache-2.0
 * A drive on a CAN bus in every mode, and the effect of every event. */
#include "can_wire.h"
#include "drive_walk.h"

static uint64_t motion, power_offs;

static void begin_bus(void)
{
    begin_with(1);
    w.reported_rad_s = 1.0;
    motion = power_offs = 0;
    go_on(20 * MS);
}

static void request_mode(uint32_t mode)
{
    request(0, mode);
}

static void set_up_drive(void)
{
    request_mode(DRIVE_READY);
    go_on(20 * MS);
}

static void arm_drive(void)
{
    w.powered = true;
    request_mode(DRIVE_ARMED);
}

static void setpoints_old(void)
{
    w.enabled = 2;
}

static void setpoints_not_enabled(void)
{
    w.enabled = 0;
}

static void fall_silent(void)
{
    w.silent = true;
}

static void answer_again(void)
{
    w.silent = false;
}

static void disable_itself(void)
{
    w.powered = false;
}

/* The drive keeps the power that is set here, whatever it is sent. */
static void stay_enabled(void)
{
    w.powered = true;
}

static void end_line(void)
{
    w.machine.control.shut_down = 1;
}

static void go_on_for(int64_t for_ns)
{
    forget_sent();
    go_on(for_ns);
    for (uint32_t i = 0; i < w.sent_count; i++) {
        motion += w.sent[i].id == SPEED && (w.sent[i].data[2] | w.sent[i].data[3]) != 0;
        power_offs += w.sent[i].id == SPEED && w.sent[i].data[0] == DISABLE;
    }
    forget_sent();
}

static const drive_state *state_of_drive(void)
{
    return &w.machine.drive[0].state;
}

static uint64_t motion_sent(void)
{
    return motion;
}

static uint64_t power_offs_sent(void)
{
    return power_offs;
}

int main(void)
{
    const walk_medium medium = {
        .kind = ON_CAN,
        .begin = begin_bus,
        .set_up = set_up_drive,
        .arm = arm_drive,
        .request = request_mode,
        .old = setpoints_old,
        .not_enabled = setpoints_not_enabled,
        .silent = fall_silent,
        .answers = answer_again,
        .disabled = disable_itself,
        .still_enabled = stay_enabled,
        .end = end_line,
        .go_on = go_on_for,
        .state = state_of_drive,
        .motion = motion_sent,
        .power_offs = power_offs_sent,
    };
    return walk_all(&medium, 66, "can walk");
}
