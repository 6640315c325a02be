/* SPDX-License-Identifier: Apache-2.0
 * can_position_rig.h: a drive on a CAN bus whose joint takes positions. */
#ifndef MOTORD_TESTS_CAN_POSITION_RIG_H
#define MOTORD_TESTS_CAN_POSITION_RIG_H

#include "can_wire.h"

static const can_machine *const m = &w.machine;
static double wanted_rad;
static uint32_t positioned;

/* The drive takes and reports its position as a float in turns. An angle of 0 is two turns. */
static inline void begin(void)
{
    begin_with(1);
    can_output *output = &table_of(0)->output[0];
    output->packet.bytes = 6;
    output->setpoint[0] =
        (can_setpoint){.place = {.start_bit = 16, .length = 32, .form = CAN_FLOAT},
                       .scale = {.kind = SETPOINT_POSITION,
                                 .raw_per_si = 0.5,
                                 .raw_offset = 2.0,
                                 .raw_min = -10.0,
                                 .raw_max = 10.0,
                                 .raw_per_s = 1e6}};
    restart();
    w.enabled = 2; /* `step` leaves the set-points to the test */
    positioned = 0;
}

static inline float target_in(const can_packet *packet)
{
    float target;
    memcpy(&target, packet->data + 2, sizeof target);
    return target;
}

static inline void report_all(float turns)
{
    report_state(0, w.powered ? 8 : 1);
    report_motion(0, turns, 0.0F);
}

static inline void put(void)
{
    w.machine.newest = (setpoints){.stamp_ns = w.now_ns, .enabled = 1, .joint_count = 1};
    w.machine.newest.position_rad[0] = wanted_rad;
    w.machine.newest.positioned = positioned ? 1U : 0U;
}

static inline void run(float at_turns, int64_t for_ns)
{
    for (int64_t end_ns = w.now_ns + for_ns; w.now_ns < end_ns; w.now_ns += 2 * MS) {
        put();
        report_all(at_turns);
        step();
    }
}

static inline void ask_for(uint32_t mode)
{
    put();
    w.machine.control.drive[0].count++;
    w.machine.control.drive[0].mode = mode;
    step();
}

static inline void make_armed(void)
{
    run(2.25F, 20 * MS);
    ask_for(DRIVE_READY);
    run(2.25F, 20 * MS);
    w.powered = true;
    ask_for(DRIVE_ARMED);
    CHECK(state_of(0)->state.mode == DRIVE_ARMED);
}

static inline void make_stopping(float at_turns)
{
    forget_sent();
    w.now_ns += 6 * MS;
    report_all(at_turns);
    w.machine.newest.stamp_ns = w.now_ns - 10000 * MS;
    step();
    CHECK(state_of(0)->state.mode == DRIVE_READY &&
          (state_of(0)->state.fault_reasons & DRIVE_FAULT_SETPOINTS_OLD) != 0);
}

static inline const can_packet *quick_stop_sent(void)
{
    for (uint32_t i = 0; i < w.sent_count; i++) {
        if (w.sent[i].id == SPEED && w.sent[i].data[0] == QUICK_STOP) {
            return &w.sent[i];
        }
    }
    CHECK(false);
    return NULL;
}

#endif
