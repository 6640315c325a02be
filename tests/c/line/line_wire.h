/* SPDX-License-Identifier: Apache-2.0
 * line_wire.h: the machine of a serial line on a wire in virtual time, with drives that answer or
 * do not answer. */
#ifndef MOTORD_TESTS_LINE_WIRE_H
#define MOTORD_TESTS_LINE_WIRE_H

#include <string.h>

#include "check.h"
#include "line_machine.h"

enum {
    WRITE = 6,
    READ = 3,
    SPEED = 0x10,
    STATUS = 0x20,
    CONDITION = 0x2f,
    CONTROL = 0x30,
    RELEASE = 0x31,
    QUICK_STOP = 5,
    DISABLE = 7
};
enum { POWERED = 1, SET_UP = 2 }; /* bits of CONDITION */

static const int64_t MS = 1000000, DEVICE_NS = 500000, CHARACTER_NS = 86805, GAP_NS = 1750000;

/* A wire with its drives. Bit n of `dead`: drive n neither receives nor answers; of `mute`: it
 * receives only. */
typedef struct {
    line_table table;
    line_machine machine;
    line_output out;
    int64_t now_ns;
    uint32_t dead;
    uint32_t mute;
    uint32_t turning;                       /* bit n: drive n reports that its wheel turns */
    int16_t place;                          /* what STATUS reads as at rest; 0: 9 */
    int64_t quick_stop_ns[LINE_DRIVES_MAX]; /* time of the first quick stop; 0: never */
    int64_t power_off_ns[LINE_DRIVES_MAX];
    uint8_t condition;     /* what CONDITION reads as, for a single drive */
    bool old, not_enabled; /* about the set-points of the core */
    uint32_t motion_sent;  /* frames with a speed that is not zero */
    bool echoes;
    bool babbles;            /* a device sends an unrequested byte each ms */
    uint32_t unacknowledged; /* bit n: frame n of a power-off is not answered, but takes the
                                power */
    bool keeps_power;        /* such a frame does not take the power */
    uint32_t power_offs[LINE_DRIVES_MAX]; /* frames of `disarm` that each drive received */
    uint32_t released[LINE_DRIVES_MAX];   /* of these, the last frame */
    uint32_t sent_off[LINE_DRIVES_MAX];   /* frames sent to each drive, received or not */
    uint32_t quick_stop_sent[LINE_DRIVES_MAX];
    uint8_t refused; /* a register that each drive refuses; 0: none */
    uint32_t refusals;
    uint8_t bytes[2 * FRAME_BYTES_MAX];
    uint32_t count;
} wire;

static wire w;

static inline line_frame frame_of(uint8_t unit, uint8_t function, uint8_t address, uint8_t value)
{
    line_frame frame = {.request_bytes = 8,
                        .request_seal = SEAL_CRC16,
                        .reply_seal = SEAL_CRC16,
                        .has_exceptions = 1,
                        .request = {unit, function, 0, address, 0, value}};
    rtu_seal(frame.request, 8, SEAL_CRC16);
    if (function == WRITE) {
        frame.reply_bytes = 8;
        frame.echo_bytes = 6;
    } else {
        frame.reply_bytes = 7;
        frame.match_bytes = 3;
        memcpy(frame.match, (const uint8_t[]){unit, READ, 2}, 3);
    }
    return frame;
}

static inline line_drive drive_of(uint32_t joint)
{
    uint8_t unit = (uint8_t)(joint + 1);
    line_drive drive = {.tries = 3,
                        .extra_every = 4,
                        .period_ns = 20 * MS,
                        .turnaround_ns = 5 * MS,
                        .watchdog_ns = 500 * MS,
                        .cyclic_count = 2,
                        .quick_stop_count = 1,
                        .disarm_count = 2,
                        .probe = 2};
    drive.cyclic[0].frame = frame_of(unit, WRITE, SPEED, 0);
    drive.cyclic[0].setpoint_count = 1;
    drive.cyclic[0].setpoint[0] = (line_setpoint){.joint = joint,
                                                  .byte = 4,
                                                  .form = FORM_I16,
                                                  .raw_per_si = 100.0,
                                                  .raw_min = -1000.0,
                                                  .raw_max = 1000.0};
    drive.cyclic[1].frame = frame_of(unit, READ, STATUS, 1);
    drive.cyclic[1].field_count = 1;
    drive.cyclic[1].field[0] = (line_field){
        .joint = joint, .kind = FIELD_VELOCITY, .byte = 3, .form = FORM_I16, .si_per_raw = 0.01};
    drive.quick_stop[0] = frame_of(unit, WRITE, CONTROL, QUICK_STOP);
    drive.disarm[0] = frame_of(unit, WRITE, CONTROL, DISABLE);
    drive.disarm[1] = frame_of(unit, WRITE, RELEASE, 0);
    return drive;
}

static inline void begin_with(uint32_t drives, uint32_t echo)
{
    memset(&w, 0, sizeof w);
    w.now_ns = 1000 * MS;
    w.echoes = echo != 0;
    w.table = (line_table){.drive_count = drives,
                           .echo = echo,
                           .character_ns = (double)CHARACTER_NS,
                           .gap_ns = GAP_NS,
                           .late_ns = 120 * MS,
                           .setpoint_timeout_ns = 100 * MS,
                           .rest_velocity_rad_s = 0.1};
    for (uint32_t i = 0; i < drives; i++) {
        w.table.drive[i] = drive_of(i);
    }
    CHECK(line_machine_init(&w.machine, &w.table, 0, w.now_ns) == 0);
}

static inline void answer_on_the_wire(const uint8_t *request)
{
    uint32_t number = request[0] - 1U;
    w.now_ns += 8 * CHARACTER_NS;
    if (w.echoes) {
        memcpy(w.bytes, request, 8);
        w.count = 8;
    }
    bool power_off = request[1] == WRITE &&
                     (request[3] == RELEASE || (request[3] == CONTROL && request[5] == DISABLE));
    w.sent_off[number] += power_off;
    w.motion_sent += request[1] == WRITE && request[3] == SPEED && (request[4] | request[5]) != 0;
    w.quick_stop_sent[number] +=
        request[1] == WRITE && request[3] == CONTROL && request[5] == QUICK_STOP;
    if ((w.dead >> number & 1) != 0) {
        return;
    }
    w.power_offs[number] += power_off;
    w.condition &= power_off && !w.keeps_power ? (uint8_t)~POWERED : UINT8_MAX;
    w.released[number] += request[1] == WRITE && request[3] == RELEASE;
    if (power_off && w.power_off_ns[number] == 0) {
        w.power_off_ns[number] = w.now_ns;
    }
    if (request[1] == WRITE && request[3] == CONTROL && request[5] == QUICK_STOP &&
        w.quick_stop_ns[number] == 0) {
        w.quick_stop_ns[number] = w.now_ns;
    }
    bool unacknowledged = power_off && (w.unacknowledged >> (request[3] == RELEASE) & 1) != 0;
    w.turning &= unacknowledged && !w.keeps_power ? ~(1U << number) : ~0U;
    if ((w.mute >> number & 1) != 0 || unacknowledged) {
        return;
    }
    if (request[3] == w.refused && w.refused != 0) {
        uint8_t refusal[5] = {request[0], request[1] | 0x80, 4};
        rtu_seal(refusal, 5, SEAL_CRC16);
        memcpy(w.bytes + w.count, refusal, 5);
        w.count += 5;
        w.refusals++;
        w.now_ns += DEVICE_NS + 5 * CHARACTER_NS;
        return;
    }
    uint8_t read_reply[7] = {request[0], READ, 2, 0, (w.turning >> number & 1) != 0 ? 200 : 9};
    if (request[3] == CONDITION) {
        rtu_write(read_reply + 3, FORM_U16, w.condition);
    } else if (w.place != 0) {
        rtu_write(read_reply + 3, FORM_I16, w.place);
    }
    rtu_seal(read_reply, 7, SEAL_CRC16);
    uint32_t length = request[1] == READ ? 7 : 8;
    memcpy(w.bytes + w.count, request[1] == READ ? read_reply : request, length);
    w.count += length;
    w.now_ns += DEVICE_NS + length * CHARACTER_NS;
}

/* Makes one look. Set-points of the core are not zero, and new unless `old` is set. */
static inline void go_on(void)
{
    int64_t stamp_ns = w.old ? w.machine.newest.stamp_ns : w.now_ns;
    w.machine.newest = (setpoints){
        .stamp_ns = stamp_ns, .enabled = !w.not_enabled, .joint_count = w.table.drive_count};
    for (uint32_t i = 0; i < w.table.drive_count; i++) {
        w.machine.newest.joint[i].velocity_rad_s = 1.0;
    }
    line_machine_step(&w.machine, w.now_ns, w.bytes, w.count, &w.out);
    w.count = 0;
    if (w.out.send != NULL) {
        line_machine_sent(&w.machine, w.now_ns);
        answer_on_the_wire(w.out.send);
        if (w.count == 0 && !w.babbles) {
            /* a look in the middle of the wait */
            w.now_ns += (w.machine.until_ns - w.now_ns) / 2;
        }
    } else if (!w.babbles) {
        /* a step never requests an immediate wake-up without need */
        CHECK(w.out.wake_ns > w.now_ns || w.machine.answered);
        w.now_ns = w.out.wake_ns;
    }
    if (w.babbles) {
        w.now_ns += MS;
        w.bytes[w.count++] = 0x55;
    }
}

static inline void request(uint32_t drive, uint32_t mode)
{
    w.machine.control.drive[drive].count++;
    w.machine.control.drive[drive].mode = mode;
}

static inline void arm(uint32_t drive)
{
    request(drive, DRIVE_READY);
    go_on();
    request(drive, DRIVE_ARMED);
    go_on();
    CHECK(w.machine.drive[drive].state.mode == DRIVE_ARMED);
}

#endif
