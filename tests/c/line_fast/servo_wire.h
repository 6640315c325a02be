/* SPDX-License-Identifier: Apache-2.0
 * servo_wire.h: the machine of a serial line on a wire in virtual time, with bus servos that answer
 * a group request in turn. */
#ifndef MOTORD_TESTS_SERVO_WIRE_H
#define MOTORD_TESTS_SERVO_WIRE_H

#include <string.h>

#include "check.h"
#include "line_machine.h"

enum { GOAL = 46, PRESENT = 58, TORQUE = 40, SERVO_CHARACTER_NS = 10000, SERVO_DELAY_NS = 50000 };

/* A wire with servos, and what each of them does with a group request. */
typedef struct {
    line_table table;
    line_machine machine;
    line_output out;
    int64_t now_ns;
    uint32_t silent;  /* bit n: receives, but does not answer */
    uint32_t damaged; /* bit n: its reply has a wrong bit */
    bool echoes;
    int16_t goal[LINE_DRIVES_MAX];
    bool torque[LINE_DRIVES_MAX];
    uint32_t sync_writes, sync_reads, asked_last;
    uint8_t bytes[2 * FRAME_BYTES_MAX];
    uint32_t count;
} servo_wire;

static servo_wire s;

static inline line_frame servo_packet(uint8_t unit, uint8_t code, const uint8_t *parameters,
                                      uint8_t count, uint32_t data)
{
    line_frame frame = {.request_bytes = 6U + count,
                        .reply_bytes = unit == 0xFE ? 0 : 6 + data,
                        .match_bytes = unit == 0xFE ? 0 : 4,
                        .match = {0xFF, 0xFF, unit, (uint8_t)(2 + data)},
                        .request_seal = SEAL_SUM,
                        .reply_seal = unit == 0xFE ? SEAL_NONE : SEAL_SUM,
                        .request = {0xFF, 0xFF, unit, (uint8_t)(count + 2), code}};
    memcpy(frame.request + 5, parameters, count);
    rtu_finish(&frame);
    return frame;
}

static inline line_frame servo_write(uint8_t unit, uint8_t address, uint16_t value)
{
    const uint8_t parameters[] = {address, (uint8_t)value, (uint8_t)(value >> 8)};
    return servo_packet(unit, 3, parameters, address == GOAL ? 3 : 2, 0);
}

static inline line_drive servo_drive(uint32_t joint)
{
    uint8_t unit = (uint8_t)(joint + 7);
    const uint8_t read[] = {PRESENT, 2}, torque[] = {TORQUE, 1};
    line_drive drive = {.tries = 3,
                        .extra_every = 4,
                        .period_ns = 10000000,
                        .turnaround_ns = 1000000,
                        .cyclic_count = 2,
                        .extra_count = 1,
                        .quick_stop_count = 1,
                        .disarm_count = 1,
                        .probe = 2};
    drive.cyclic[0].frame = servo_write(unit, GOAL, 0);
    drive.cyclic[0].setpoint_count = 1;
    drive.cyclic[0].setpoint[0] = (line_setpoint){.joint = joint,
                                                  .byte = 6,
                                                  .form = FORM_M16_LE,
                                                  .raw_per_si = 100.0,
                                                  .raw_min = -3000.0,
                                                  .raw_max = 3000.0};
    drive.cyclic[1].frame = servo_packet(unit, 2, read, 2, 2);
    drive.cyclic[1].field_count = 1;
    drive.cyclic[1].field[0] = (line_field){
        .joint = joint, .kind = FIELD_VELOCITY, .byte = 5, .form = FORM_M16_LE, .si_per_raw = 0.01};
    drive.extra[0].frame = servo_packet(unit, 2, torque, 2, 1);
    drive.extra[0].field_count = 1;
    drive.extra[0].field[0] = (line_field){.joint = joint,
                                           .kind = FIELD_ENABLED,
                                           .byte = 5,
                                           .equals_mask = 1,
                                           .equals = 1,
                                           .si_per_raw = 1.0};
    drive.quick_stop[0] = servo_write(unit, GOAL, 0);
    drive.disarm[0] = servo_write(unit, TORQUE, 0);
    return drive;
}

static inline void servos_begin(uint32_t drives, uint32_t echo)
{
    memset(&s, 0, sizeof s);
    s.now_ns = 1000000000;
    s.echoes = echo == ECHO_FIRST;
    s.table = (line_table){.drive_count = drives,
                           .echo = echo,
                           .character_ns = SERVO_CHARACTER_NS,
                           .gap_ns = 10000,
                           .late_ns = 120000000,
                           .setpoint_timeout_ns = 100000000,
                           .rest_velocity_rad_s = 0.1,
                           .group = {.used = 1,
                                     .data_byte = 6,
                                     .write_bytes = 7,
                                     .read_bytes = 7,
                                     .write = {0xFF, 0xFF, 0xFE, 4, 0x83, GOAL, 2},
                                     .read = {0xFF, 0xFF, 0xFE, 4, 0x82, PRESENT, 2}}};
    for (uint32_t i = 0; i < drives; i++) {
        s.table.drive[i] = servo_drive(i);
    }
    CHECK(line_machine_init(&s.machine, &s.table, 0, s.now_ns) == 0);
}

static inline int16_t signed_goal(const uint8_t *at)
{
    return (int16_t)rtu_read(at, FORM_M16_LE);
}

static inline void status(uint32_t number, const uint8_t *data, uint32_t count)
{
    uint8_t *to = s.bytes + s.count;
    if ((s.silent >> number & 1) != 0) {
        return;
    }
    to[0] = to[1] = 0xFF;
    to[2] = (uint8_t)(number + 7);
    to[3] = (uint8_t)(2 + count);
    to[4] = 0;
    if (count > 0) {
        memcpy(to + 5, data, count);
    }
    rtu_seal(to, 6 + count, SEAL_SUM);
    to[5] ^= (uint8_t)((s.damaged >> number & 1) << 3);
    s.count += 6 + count;
    s.now_ns += SERVO_DELAY_NS + (6 + count) * SERVO_CHARACTER_NS;
}

/* The servos carry out one packet of the bytes that were sent. Returns its length. */
static inline uint32_t obey_packet(const uint8_t *packet)
{
    uint32_t bytes = 4U + packet[3], unit = packet[2];
    CHECK(packet[0] == 0xFF && packet[1] == 0xFF && rtu_is_sealed(packet, bytes, SEAL_SUM));
    if (packet[4] == 0x83) {
        s.sync_writes++;
        for (uint32_t at = 7; at + 1 < bytes; at += 3) {
            s.goal[packet[at] - 7] = signed_goal(packet + at + 1);
        }
    } else if (packet[4] == 0x82) {
        s.sync_reads++;
        s.asked_last = 0;
        for (uint32_t at = 7; at + 1 < bytes; at++) {
            uint8_t velocity[2];
            s.asked_last |= 1U << (packet[at] - 7);
            rtu_write(velocity, FORM_M16_LE, s.goal[packet[at] - 7]);
            status(packet[at] - 7U, velocity, 2);
        }
    } else if (packet[4] == 2) {
        const uint8_t value[2] = {s.torque[unit - 7]};
        status(unit - 7, value, packet[6]);
    } else if (packet[4] == 3) {
        s.torque[unit - 7] = packet[5] == TORQUE ? packet[6] != 0 : s.torque[unit - 7];
        s.goal[unit - 7] = packet[5] == GOAL ? signed_goal(packet + 6) : s.goal[unit - 7];
        status(unit - 7, NULL, 0);
    }
    return bytes;
}

/* Makes one look. Set-points of the core are new: `velocity_rad_s` plus a tenth of the joint's
 * number. */
static inline void servos_step(double velocity_rad_s, uint32_t enabled)
{
    s.machine.newest =
        (setpoints){.stamp_ns = s.now_ns, .enabled = enabled, .joint_count = s.table.drive_count};
    for (uint32_t i = 0; i < s.table.drive_count; i++) {
        s.machine.newest.joint[i].velocity_rad_s = velocity_rad_s + 0.1 * i;
    }
    line_machine_step(&s.machine, s.now_ns, s.bytes, s.count, &s.out);
    s.count = 0;
    if (s.out.send == NULL) {
        s.now_ns = s.out.wake_ns > s.now_ns ? s.out.wake_ns : s.now_ns + 1;
        return;
    }
    line_machine_sent(&s.machine, s.now_ns);
    s.now_ns += s.out.send_bytes * SERVO_CHARACTER_NS;
    if (s.echoes) {
        memcpy(s.bytes, s.out.send, s.out.send_bytes);
        s.count = s.out.send_bytes;
    }
    for (uint32_t at = 0; at < s.out.send_bytes;) {
        at += obey_packet(s.out.send + at);
    }
    if (s.count == (s.echoes ? s.out.send_bytes : 0)) {
        s.now_ns = s.machine.until_ns;
    }
}

static inline void servos_go_on(double velocity_rad_s, int64_t for_ns)
{
    for (int64_t end_ns = s.now_ns + for_ns; s.now_ns < end_ns;) {
        servos_step(velocity_rad_s, 1);
    }
}

static inline void servo_request(uint32_t drive, uint32_t mode)
{
    s.machine.control.drive[drive].count++;
    s.machine.control.drive[drive].mode = mode;
}

static inline void servos_arm(void)
{
    for (uint32_t i = 0; i < s.table.drive_count; i++) {
        servo_request(i, DRIVE_READY);
    }
    servos_go_on(0.0, 50000000);
    for (uint32_t i = 0; i < s.table.drive_count; i++) {
        s.torque[i] = true;
        servo_request(i, DRIVE_ARMED);
    }
    servos_step(1.0, 1);
    for (uint32_t i = 0; i < s.table.drive_count; i++) {
        CHECK(s.machine.drive[i].state.mode == DRIVE_ARMED);
    }
}

/* Arms the drives and drives until a group request has been sent. */
static inline void group_goes_out(uint32_t drives, uint32_t echo)
{
    servos_begin(drives, echo);
    servos_arm();
    servos_go_on(1.0, 50000000);
    do {
        servos_step(1.0, 1);
    } while (s.machine.work != WORK_GROUP);
}

#endif
