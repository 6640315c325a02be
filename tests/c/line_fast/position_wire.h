/* SPDX-License-Identifier: Apache-2.0
 * position_wire.h: one drive on a serial line that takes positions. */
#ifndef MOTORD_POSITION_WIRE_H
#define MOTORD_POSITION_WIRE_H

#include <math.h>
#include <stdlib.h>

#include "line_wire.h"

static const double FAR = 1e300;
enum { HERE = 1500 };
static line_machine *const m = &w.machine;
static line_setpoint *const setpoint = &w.table.drive[0].cyclic[0].setpoint[0];
static uint32_t targets, reads;
static int16_t newest_target;

/* One drive that takes positions, at 1000 counts per rad; an angle of 0 is 2000 counts. */
static inline void begin(void)
{
    begin_with(1, 0);
    *setpoint = (line_setpoint){.kind = SETPOINT_POSITION,
                                .byte = 4,
                                .form = FORM_I16,
                                .raw_per_si = -1000.0,
                                .raw_offset = 2000.0,
                                .raw_min = 100.0,
                                .raw_max = 4000.0,
                                .raw_per_s = 1e6};
    line_exchange *reads_it = &w.table.drive[0].cyclic[1];
    reads_it->field[1] = reads_it->field[0];
    reads_it->field[1].kind = FIELD_COUNT;
    reads_it->field[0].si_per_raw = 1e-6; /* the drive rests */
    reads_it->field_count = 2;
    w.place = HERE;
    CHECK(line_machine_init(m, &w.table, 0, w.now_ns) == 0);
    targets = reads = 0;
}

static inline void want(double position_rad, uint32_t positioned)
{
    m->newest = (setpoints){.stamp_ns = w.now_ns, .enabled = 1, .joint_count = 1};
    m->newest.joint[0] = (joint_setpoint){.velocity_rad_s = 1.0};
    m->newest.position_rad[0] = position_rad;
    m->newest.positioned = positioned != 0;
}

static inline void look(void)
{
    line_machine_step(m, w.now_ns, w.bytes, w.count, &w.out);
    w.count = 0;
    if (w.out.send == NULL) {
        w.now_ns = w.out.wake_ns;
        return;
    }
    line_machine_sent(m, w.now_ns);
    reads += w.out.send[1] == READ;
    if (w.out.send[1] == WRITE && w.out.send[3] == SPEED) {
        targets++;
        newest_target = (int16_t)rtu_read(w.out.send + 4, FORM_I16);
    }
    answer_on_the_wire(w.out.send);
    w.now_ns = w.count == 0 ? m->until_ns : w.now_ns;
}

static inline void go_to(double position_rad, uint32_t positioned, int64_t for_ns)
{
    for (int64_t end_ns = w.now_ns + for_ns; w.now_ns < end_ns;) {
        want(position_rad, positioned);
        look();
    }
}

static inline void arm_it(void)
{
    request(0, DRIVE_READY);
    go_to(NAN, 0, 50 * MS);
    request(0, DRIVE_ARMED);
    want(NAN, 0);
    look();
    CHECK(m->drive[0].state.mode == DRIVE_ARMED);
}

#endif
