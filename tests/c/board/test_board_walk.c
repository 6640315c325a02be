/* SPDX-License-Identifier: Apache-2.0
 * A board in every mode, and the effect of every event. */
#include "board_wire.h"
#include "drive_walk.h"

static bool keeps_power;
static uint64_t power_offs;

static void begin_board(void)
{
    begin();
    keeps_power = false;
    power_offs = 0;
    w.stuck = true;
    w.measured[0].velocity_mrad_s = 3000;
}

/* READY takes a set-up: a board without one reports that, and does not stay READY. */
static void request_mode(uint32_t mode)
{
    if (mode == DRIVE_READY && w.machine.state.mode == DRIVE_OFF) {
        set_up();
    } else {
        request(mode);
    }
}

static void arm_board(void)
{
    if (w.machine.state.mode == DRIVE_READY && !w.machine.state.stopping) {
        w.machine.control.request.arming_until_ns = w.now_ns + 1000 * MS;
        order(CONTROL, 1, CONTROL_ENABLE, 1);
    }
    request(DRIVE_ARMED);
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
    w.mute = true;
}

static void answer_again(void)
{
    w.mute = false;
}

static void disable_itself(void)
{
    switch_off(&w.peer, 0);
}

static void lose_setup(void)
{
    motord_board_init(&w.peer, MOTORS, (uint32_t)(w.now_ns / 1000));
}

static void stay_enabled(void)
{
    keeps_power = true;
}

static void end_line(void)
{
    w.machine.control.shut_down = 1;
}

static void go_on_for(int64_t for_ns)
{
    for (int64_t end_ns = w.now_ns + for_ns; w.now_ns < end_ns;) {
        uint32_t sent = w.sent_count;
        w.peer.enabled |= keeps_power;
        go_on(MS);
        power_offs += w.sent_count != sent && last_sent(CONTROL, 1, 0) == CONTROL_OFF;
    }
}

static const drive_state *state_of_drive(void)
{
    return &w.machine.state;
}

static uint64_t motion_sent(void)
{
    return w.moving_count;
}

static uint64_t power_offs_sent(void)
{
    return power_offs;
}

int main(void)
{
    const walk_medium medium = {
        .kind = ON_BOARD,
        .begin = begin_board,
        .set_up = set_up,
        .arm = arm_board,
        .request = request_mode,
        .old = setpoints_old,
        .not_enabled = setpoints_not_enabled,
        .silent = fall_silent,
        .answers = answer_again,
        .disabled = disable_itself,
        .lost_setup = lose_setup,
        .still_enabled = stay_enabled,
        .end = end_line,
        .go_on = go_on_for,
        .state = state_of_drive,
        .motion = motion_sent,
        .power_offs = power_offs_sent,
    };
    return walk_all(&medium, 72, "board walk");
}
