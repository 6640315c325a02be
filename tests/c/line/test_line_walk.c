/* SPDX-License-Identifier: Apache-2.0
 * A drive on a serial line in every mode, and every event. */
#include "drive_walk.h"
#include "line_wire.h"

static void begin_line(void)
{
    begin_with(1, 0);
    w.turning = 1;
}

static void request_mode(uint32_t mode)
{
    request(0, mode);
    go_on();
}

static void set_up_drive(void)
{
    request_mode(DRIVE_READY);
}

static void arm_drive(void)
{
    request_mode(DRIVE_ARMED);
}

static void setpoints_old(void)
{
    w.old = true;
}

static void setpoints_not_enabled(void)
{
    w.not_enabled = true;
}

static void fall_silent(void)
{
    w.dead = 1;
}

static void end_line(void)
{
    w.machine.control.shut_down = 1;
}

static void go_on_for(int64_t for_ns)
{
    for (int64_t end_ns = w.now_ns + for_ns; w.now_ns < end_ns;) {
        go_on();
    }
}

static const drive_state *state_of_drive(void)
{
    return &w.machine.drive[0].state;
}

static uint64_t motion_sent(void)
{
    return w.motion_sent;
}

int main(void)
{
    const walk_medium medium = {ON_RS485,     begin_line,    set_up_drive,          arm_drive,
                                request_mode, setpoints_old, setpoints_not_enabled, fall_silent,
                                end_line,     go_on_for,     state_of_drive,        motion_sent};
    return walk_all(&medium, 40, "line walk");
}
