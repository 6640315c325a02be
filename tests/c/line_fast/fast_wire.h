/* SPDX-License-Identifier: Apache-2.0
 * fast_wire.h: the machine of a serial line on a wire in virtual time, with Dynamixels that answer
 * a fast sync read in one packet. */
#ifndef MOTORD_TESTS_FAST_WIRE_H
#define MOTORD_TESTS_FAST_WIRE_H

#include <math.h>
#include <string.h>

#include "check.h"
#include "line_machine.h"

enum {
    SERVOS = 3,
    GOAL = 104,
    PRESENT = 128,
    TORQUE = 64,
    DATA = 4,
    HEAD = 8,
    BLOCK = DATA + 4,
    ALL = 0xFE
};
static const int64_t MS = 1000000, CHARACTER_NS = 10000, DELAY_NS = 50000;

static struct {
    line_table table;
    line_machine machine;
    line_output out;
    int64_t now_ns;
    uint32_t silent;         /* bit n: it does not answer, which ends the common packet */
    uint32_t errors;         /* bit n: it refuses the read */
    uint32_t swapped;        /* 1: the second and third one answer in the wrong order */
    bool alert, echoes, old; /* old: firmware without fast reads */
    uint32_t cut, flip; /* of the common packet; cut: length that arrives, 0: all; flip: 1 + index
                           of a byte with a wrong bit, 0: no byte */
    int32_t goal[SERVOS];
    bool torque[SERVOS];
    uint32_t fast, plain, asked;
    uint8_t bytes[RECEIVED_BYTES_MAX];
    uint32_t count;
} s;
static const line_machine *const m = &s.machine;

static inline line_frame packet(uint32_t unit, uint32_t code, const uint8_t *parameters,
                                uint32_t count, uint32_t data)
{
    uint32_t length = count + 3;
    line_frame frame = {
        .request_bytes = 10 + count,
        .reply_bytes = 11 + data,
        .match_bytes = 5,
        .match = {0xFF, 0xFF, 0xFD, 0, (uint8_t)unit},
        .request_seal = SEAL_STUFFED,
        .reply_seal = SEAL_STUFFED,
        .has_exceptions = 1,
        .request = {0xFF, 0xFF, 0xFD, 0, (uint8_t)unit, (uint8_t)length, 0, (uint8_t)code}};
    memcpy(frame.request + HEAD, parameters, count);
    rtu_finish(&frame);
    return frame;
}

static inline line_drive servo(uint32_t joint)
{
    uint32_t unit = joint + 1;
    const uint8_t goal[] = {GOAL, 0, 0, 0, 0, 0}, read[] = {PRESENT, 0, DATA, 0},
                  torque[] = {TORQUE, 0, 1, 0};
    const uint8_t off[] = {TORQUE, 0, 0};
    line_drive drive = {.tries = 3,
                        .extra_every = 50,
                        .period_ns = 10 * MS,
                        .turnaround_ns = MS,
                        .cyclic_count = 2,
                        .extra_count = 1,
                        .quick_stop_count = 1,
                        .disarm_count = 1,
                        .probe = 2};
    drive.cyclic[0].frame = packet(unit, 3, goal, sizeof goal, 0);
    drive.cyclic[0].setpoint_count = 1;
    drive.cyclic[0].setpoint[0] = (line_setpoint){.joint = joint,
                                                  .byte = 10,
                                                  .form = FORM_I32_LE,
                                                  .raw_per_si = 100.0,
                                                  .raw_min = -3000.0,
                                                  .raw_max = 3000.0};
    drive.cyclic[1].frame = packet(unit, 2, read, sizeof read, DATA);
    drive.cyclic[1].field_count = 1;
    drive.cyclic[1].field[0] = (line_field){
        .joint = joint, .kind = FIELD_VELOCITY, .byte = 9, .form = FORM_I32_LE, .si_per_raw = 0.01};
    drive.extra[0].frame = packet(unit, 2, torque, sizeof torque, 1);
    drive.extra[0].field_count = 1;
    drive.extra[0].field[0] = (line_field){.joint = joint,
                                           .kind = FIELD_ENABLED,
                                           .byte = 9,
                                           .equals_mask = 1,
                                           .equals = 1,
                                           .si_per_raw = 1.0};
    drive.quick_stop[0] = packet(unit, 3, goal, sizeof goal, 0);
    drive.disarm[0] = packet(unit, 3, off, sizeof off, 0);
    return drive;
}

static inline line_table table_of(uint32_t echo)
{
    line_table table = {
        .drive_count = SERVOS,
        .echo = echo,
        .character_ns = (double)CHARACTER_NS,
        .gap_ns = 10000,
        .late_ns = 120000000,
        .setpoint_timeout_ns = 100 * MS,
        .rest_velocity_rad_s = 0.1,
        .group = {.used = 1,
                  .fast = 1,
                  .data_byte = 10,
                  .write_bytes = 12,
                  .read_bytes = 12,
                  .write = {0xFF, 0xFF, 0xFD, 0, ALL, 7, 0, 0x83, GOAL, 0, DATA, 0},
                  .read = {0xFF, 0xFF, 0xFD, 0, ALL, 7, 0, 0x82, PRESENT, 0, DATA, 0}}};
    for (uint32_t i = 0; i < SERVOS; i++) {
        table.drive[i] = servo(i);
    }
    return table;
}

/* ---------------------------------------------------------------- answers of the servos */
static inline void status(uint32_t number, const uint8_t *data, uint32_t count)
{
    if ((s.silent >> number & 1) != 0) {
        return;
    }
    line_frame reply = {
        .request_bytes = 11 + count,
        .request_seal = SEAL_STUFFED,
        .request = {0xFF, 0xFF, 0xFD, 0, (uint8_t)(number + 1), (uint8_t)(4 + count), 0, 0x55}};
    reply.request[HEAD] = (s.errors >> number & 1) != 0 ? 7 : 0;
    if (count > 0) {
        memcpy(reply.request + 9, data, count);
    }
    rtu_finish(&reply);
    memcpy(s.bytes + s.count, reply.request, reply.request_bytes);
    s.count += reply.request_bytes;
    s.now_ns += DELAY_NS + reply.request_bytes * CHARACTER_NS;
}

static inline void answer_together(const uint8_t *units, uint32_t count)
{
    uint8_t *to = s.bytes + s.count;
    uint32_t length = HEAD - 7 + count * BLOCK, at = HEAD;
    const uint8_t head[HEAD] = {0xFF, 0xFF, 0xFD, 0, ALL, (uint8_t)length, (uint8_t)(length >> 8),
                                0x55};
    memcpy(to, head, HEAD);
    for (uint32_t i = 0; i < count; i++) {
        uint32_t number = units[s.swapped != 0 && i > 0 ? count - i : i] - 1U;
        if ((s.silent >> number & 1) != 0) {
            break;
        }
        to[at] = (uint8_t)(((s.errors >> number & 1) != 0 ? 7 : 0) | (s.alert ? 0x80 : 0));
        to[at + 1] = (uint8_t)(number + 1);
        rtu_write(to + at + 2, FORM_I32_LE, s.goal[number]);
        at += BLOCK;
        rtu_seal(to, at, SEAL_STUFFED);
    }
    uint32_t came = at == HEAD || s.old ? 0 : s.cut > 0 && s.cut < at ? s.cut : at;
    if (s.flip > 0 && s.flip <= came) {
        to[s.flip - 1] ^= 0x10;
    }
    s.count += came;
    s.now_ns += came > 0 ? DELAY_NS + came * CHARACTER_NS : 0;
}

static inline uint32_t obey(const uint8_t *wire)
{
    uint8_t plain[FRAME_BYTES_MAX];
    uint32_t bytes = (uint32_t)rtu_read(wire + 5, FORM_U16_LE) + 7, unit = wire[4];
    CHECK(rtu_is_sealed(wire, bytes, SEAL_STUFFED));
    uint32_t end = rtu_unstuff(wire, bytes, plain) - 2;
    if (plain[7] == 0x83) {
        for (uint32_t at = 12; at < end; at += 1 + DATA) {
            s.goal[plain[at] - 1] = (int32_t)rtu_read(plain + at + 1, FORM_I32_LE);
        }
    } else if (plain[7] == 0x82 || plain[7] == 0x8A) {
        s.asked = 0;
        for (uint32_t at = 12; at < end; at++) {
            s.asked |= 1U << (plain[at] - 1);
        }
        if (plain[7] == 0x8A) {
            s.fast++;
            answer_together(plain + 12, end - 12);
            return bytes;
        }
        s.plain++;
        for (uint32_t at = 12; at < end; at++) {
            uint8_t velocity[DATA];
            rtu_write(velocity, FORM_I32_LE, s.goal[plain[at] - 1]);
            status(plain[at] - 1U, velocity, DATA);
        }
    } else if (plain[7] == 2) {
        const uint8_t value[DATA] = {s.torque[unit - 1]};
        status(unit - 1, value, plain[10]);
    } else if (plain[7] == 3) {
        s.torque[unit - 1] = plain[8] == TORQUE ? plain[10] != 0 : s.torque[unit - 1];
        s.goal[unit - 1] =
            plain[8] == GOAL ? (int32_t)rtu_read(plain + 10, FORM_I32_LE) : s.goal[unit - 1];
        status(unit - 1, NULL, 0);
    }
    return bytes;
}

/* -------------------------------------------------------------------------- the machine */
static inline void look(double velocity_rad_s)
{
    s.machine.newest = (setpoints){.stamp_ns = s.now_ns, .enabled = 1, .joint_count = SERVOS};
    for (uint32_t i = 0; i < SERVOS; i++) {
        s.machine.newest.joint[i].velocity_rad_s = velocity_rad_s + 0.1 * i;
    }
    line_machine_step(&s.machine, s.now_ns, s.bytes, s.count, &s.out);
    s.count = 0;
    if (s.out.send == NULL) {
        s.now_ns = s.out.wake_ns > s.now_ns ? s.out.wake_ns : s.now_ns + 1;
        return;
    }
    line_machine_sent(&s.machine, s.now_ns);
    s.now_ns += s.out.send_bytes * CHARACTER_NS;
    if (s.echoes) {
        memcpy(s.bytes, s.out.send, s.out.send_bytes);
        s.count = s.out.send_bytes;
    }
    uint32_t copied = s.count;
    for (uint32_t at = 0; at < s.out.send_bytes;) {
        at += obey(s.out.send + at);
    }
    s.now_ns = s.count == copied ? m->until_ns : s.now_ns;
}

static inline void go_on(double velocity_rad_s, int64_t for_ns)
{
    for (int64_t end_ns = s.now_ns + for_ns; s.now_ns < end_ns;) {
        look(velocity_rad_s);
    }
}

static inline void request_all(uint32_t mode)
{
    for (uint32_t i = 0; i < SERVOS; i++) {
        s.machine.control.drive[i].count++;
        s.machine.control.drive[i].mode = mode;
    }
}

static inline void begin_armed(uint32_t echo)
{
    memset(&s, 0, sizeof s);
    s.now_ns = 1000 * MS;
    s.echoes = echo == ECHO_FIRST;
    s.table = table_of(echo);
    CHECK(line_machine_init(&s.machine, &s.table, 0, s.now_ns) == 0);
    request_all(DRIVE_READY);
    go_on(0.0, 50 * MS);
    memset(s.torque, 1, sizeof s.torque);
    request_all(DRIVE_ARMED);
    go_on(1.0, 50 * MS);
    for (uint32_t i = 0; i < SERVOS; i++) {
        CHECK(m->drive[i].state.mode == DRIVE_ARMED);
    }
}

static inline bool measures(uint32_t number, double velocity_rad_s)
{
    return fabs(m->joint[number].feedback.velocity_rad_s - velocity_rad_s) < 1e-9;
}

#endif
