/* SPDX-License-Identifier: Apache-2.0
 * A drive on a serial line in every mode, and the effect of every event. */
#include "drive_walk.h"
#include "line_wire.h"

/* The drive also reports whether it has power and has kept its set-up. */
static void begin_line(void)
{
    begin_with(1, 0);
    line_exchange *condition = &w.table.drive[0].cyclic[2];
    condition->frame = frame_of(1, READ, CONDITION, 1);
    condition->field_count = 2;
    condition->field[0] = (line_field){.kind = FIELD_ENABLED,
                                       .byte = 3,
                                       .form = FORM_U16,
                                       .equals_mask = POWERED,
                                       .equals = POWERED};
    condition->field[1] = (line_field){
        .kind = FIELD_KEPT, .byte = 3, .form = FORM_U16, .equals_mask = SET_UP, .equals = SET_UP};
    w.table.drive[0].cyclic_count = 3;
    CHECK(line_machine_init(&w.machine, &w.table, 0, w.now_ns) == 0);
    w.condition = SET_UP;
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
    w.condition |= POWERED;
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

static void answer_again(void)
{
    w.dead = 0;
}

static void disable_itself(void)
{
    w.condition &= (uint8_t)~POWERED;
}

static void lose_setup(void)
{
    w.condition &= (uint8_t)~SET_UP;
}

static void stay_enabled(void)
{
    w.condition |= POWERED;
    w.keeps_power = true;
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

static uint64_t power_offs_received(void)
{
    return w.power_offs[0];
}

int main(void)
{
    const walk_medium medium = {
        .kind = ON_RS485,
        .begin = begin_line,
        .set_up = set_up_drive,
        .arm = arm_drive,
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
        .power_offs = power_offs_received,
    };
    return walk_all(&medium, 72, "line walk");
}
