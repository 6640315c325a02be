/* SPDX-License-Identifier: Apache-2.0
 * line_cycle.h: one drive of a line; tests step its cycle frame by frame and answer by answer. */
#ifndef MOTORD_TESTS_LINE_CYCLE_H
#define MOTORD_TESTS_LINE_CYCLE_H

#include "line_wire.h"

enum { DIRECTION = 0x40, EXTRA = 0x50, NO_FRAME = 0xffff };

static line_drive_state *drive;

/* A drive that is sent magnitude and direction, and has two extra ranges, which are read in
 * turn. */
static inline void begin_directions(double wanted_rad_s)
{
    begin_with(2, 0);
    line_drive *table = &w.table.drive[0];
    table->direction_count = 1;
    table->direction[0] =
        (line_direction){.rest = frame_of(1, WRITE, DIRECTION, DIRECTION_REST),
                         .forward = frame_of(1, WRITE, DIRECTION, DIRECTION_FORWARD),
                         .reverse = frame_of(1, WRITE, DIRECTION, DIRECTION_REVERSE)};
    table->cyclic[0].setpoint[0].magnitude = 1;
    table->cyclic[0].setpoint[0].raw_min = 0.0;
    table->extra_count = 2;
    for (uint32_t i = 0; i < 2; i++) {
        table->extra[i].frame = frame_of(1, READ, (uint8_t)(EXTRA + i), 1);
        table->extra[i].field_count = 1;
        table->extra[i].field[0] = (line_field){.kind = FIELD_ENABLED,
                                                .byte = 3,
                                                .form = FORM_U16,
                                                .equals_mask = 0xff,
                                                .equals = 1,
                                                .si_per_raw = 1.0};
    }
    CHECK(line_machine_init(&w.machine, &w.table, 0, w.now_ns) == 0);
    w.machine.newest = (setpoints){.stamp_ns = w.now_ns,
                                   .enabled = 1,
                                   .joint_count = 2,
                                   .joint = {{.velocity_rad_s = wanted_rad_s}}};
    drive = &w.machine.drive[0];
    drive->state.mode = DRIVE_ARMED;
    drive->state.enabled = drive->enabled_before = 1;
    drive->cycle_count = 1; /* extra ranges are read in every fourth cycle, not in this one */
    drive->answered_ns = w.now_ns;
}

static inline void want(double velocity_rad_s)
{
    w.machine.newest.joint[0].velocity_rad_s = velocity_rad_s;
}

/* Sends the next frame of the cycle. Returns its register and value; NO_FRAME: the cycle is
 * over. */
static inline uint32_t sends(void)
{
    line_frame frame;
    if (!line_next_in_cycle(&w.machine, 0, w.now_ns, &frame)) {
        return NO_FRAME;
    }
    w.machine.work = WORK_CYCLE;
    w.machine.worker = 0;
    w.machine.transaction.frame = frame;
    w.machine.start_ns = w.now_ns;
    w.machine.end_ns = w.now_ns + 8 * CHARACTER_NS;
    return (uint32_t)frame.request[3] << 8 | frame.request[5];
}

static inline void answers_with(uint8_t value)
{
    const line_frame *frame = &w.machine.transaction.frame;
    w.now_ns = w.machine.end_ns + DEVICE_NS + frame->reply_bytes * CHARACTER_NS;
    uint8_t reply[8] = {1, READ, 2, 0, value};
    line_drive_answered(&w.machine, 0, reply, w.now_ns);
    w.machine.work = WORK_NONE;
}

static inline uint32_t frame_to(uint32_t address, uint32_t value)
{
    return address << 8 | value;
}

#endif
