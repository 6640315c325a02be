/* SPDX-License-Identifier: Apache-2.0
 * A board in every mode, and every event. */
#include "board_wire.h"
#include "drive_walk.h"

static void begin_board(void)
{
    begin();
    w.stuck = true;
    w.measured[0].velocity_mrad_s = 3000;
}

/* A board that is not set up says so, and is not READY for long. */
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

static void end_line(void)
{
    w.machine.control.shut_down = 1;
}

static const drive_state *state_of_drive(void)
{
    return &w.machine.state;
}

static uint64_t motion_sent(void)
{
    return w.moving_count;
}

int main(void)
{
    const walk_medium medium = {
        ON_BOARD,    begin_board, set_up, arm_board,      request_mode, setpoints_old, setpoints_not_enabled,
        fall_silent, end_line,    go_on,  state_of_drive, motion_sent};
    return walk_all(&medium, 40, "board walk");
}
