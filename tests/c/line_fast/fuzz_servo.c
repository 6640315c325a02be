/* SPDX-License-Identifier: Apache-2.0
 * fuzz_servo.c: bus servos and a wire that behave at random. For any input, a status is valid by
 * another algorithm, unstuffing reverses stuffing, motion is sent only to armed servos and only
 * while the core requests it, no value is taken from another servo, each stop ends, and the line
 * ends. */
#include <math.h>

#include "servo_wire.h"
#include "tape.h"

#define FUZZ_NAME "fuzz_servo"
enum { FUZZ_MAX = 224, SERVOS = 3 };

static const int64_t STEP_MS = 1000000;

/* ------------------------------------------------------------------------------ packets */
/* CRC-16 with the manual's polynomial, but in reflected form and bit by bit, so that it checks the
 * other one. */
static uint16_t other_crc(const uint8_t *bytes, uint32_t count)
{
    uint32_t crc = 0;
    for (uint32_t bit = 0; bit < 8 * count; bit++) {
        uint32_t byte = bytes[bit / 8], next = (byte >> (7 - bit % 8) & 1U) ^ (crc >> 15 & 1U);
        crc = (crc << 1 & 0xFFFF) ^ (next != 0 ? 0x8005U : 0);
    }
    return (uint16_t)crc;
}

static void packets(const uint8_t *data)
{
    uint32_t count = data[0] % 32;
    line_frame status = {
        .request_bytes = 11 + count,
        .request_seal = SEAL_STUFFED,
        .request = {0xFF, 0xFF, 0xFD, 0, data[1], (uint8_t)(4 + count), 0, 0x55, data[2] & 0x80}};
    for (uint32_t i = 0; i < count; i++) {
        static const uint8_t likely[4] = {0xFF, 0xFF, 0xFD, 0x00};
        status.request[9 + i] = data[3] & 1 ? likely[data[4 + i] & 3] : data[4 + i];
    }
    uint8_t before[64], after[FRAME_BYTES_MAX], wire[FRAME_BYTES_MAX + 64] = {0};
    memcpy(before, status.request + 9, count);
    rtu_finish(&status);
    CHECK(status.request_bytes >= 11 + count && status.request_bytes <= 11 + count + count / 3 + 1);
    CHECK(rtu_unstuff(status.request, status.request_bytes, after) == 11 + count &&
          memcmp(after + 9, before, count) == 0);
    uint16_t stated = (uint16_t)rtu_read(status.request + status.request_bytes - 2, FORM_U16_LE);
    CHECK(stated == other_crc(status.request, status.request_bytes - 2));
    uint32_t garbage = data[40] % 32;
    memcpy(wire, data + 41, garbage);
    memcpy(wire + garbage, status.request, status.request_bytes);
    line_frame asked = {.reply_bytes = 11 + count,
                        .match_bytes = 5,
                        .reply_seal = SEAL_STUFFED,
                        .has_exceptions = 1};
    memcpy(asked.match, (const uint8_t[]){0xFF, 0xFF, 0xFD, 0, data[1]}, 5);
    received found = rtu_hunt(&asked, wire, 0, wire, garbage + status.request_bytes);
    CHECK(found.kind == RECEIVED_REFUSED ||
          (found.kind == RECEIVED_ANSWER && found.offset <= garbage));
    uint8_t *flipped = wire + garbage + data[74] % status.request_bytes;
    *flipped ^= (uint8_t)(1U << data[75] % 8);
    found = rtu_hunt(&asked, wire, garbage, wire, garbage + status.request_bytes);
    CHECK(found.kind == RECEIVED_MORE); /* CRC-16 detects a wrong bit */
}

/* -------------------------------------------------------------------------- the machine */
static bool may_move(uint32_t number)
{
    const setpoints *from = &s.machine.newest;
    return s.machine.drive[number].state.mode == DRIVE_ARMED && from->enabled == 1 &&
           from->stamp_ns > 0 && s.now_ns - from->stamp_ns <= s.table.setpoint_timeout_ns &&
           isfinite(from->joint[number].velocity_rad_s) &&
           from->joint[number].velocity_rad_s != 0.0;
}

static void choose_setpoints(uint8_t choice)
{
    static const double values[] = {0.0, 1.0, -3.0, 1e300, NAN, INFINITY, -0.0, 0.004};
    setpoints *to = &s.machine.newest;
    to->stamp_ns = choice % 4 != 0 ? s.now_ns : to->stamp_ns;
    to->enabled = choice >> 4 & 1;
    to->joint_count = SERVOS;
    for (uint32_t i = 0; i < SERVOS; i++) {
        to->joint[i].velocity_rad_s = values[((choice >> 5) + i) & 7];
    }
}

static void choose_request(uint8_t choice)
{
    uint32_t drive = choice % SERVOS, what = choice / 8;
    if (what < DRIVE_UNRESPONSIVE || what == DRIVE_STAND_DOWN) {
        servo_request(drive, what);
    } else if (what == 9) {
        s.machine.control.shut_down = 1;
    } else if (what == 10) {
        line_machine_kick(&s.machine, s.now_ns);
    }
}

/* Each goal that is not zero goes to a servo that may move now. */
static void judge(const uint8_t *packet)
{
    uint32_t bytes = 4U + packet[3];
    CHECK(packet[0] == 0xFF && packet[1] == 0xFF && rtu_is_sealed(packet, bytes, SEAL_SUM));
    CHECK(s.machine.end.stage != END_SILENT);
    for (uint32_t at = 7; packet[4] == 0x83 && at + 1 < bytes; at += 3) {
        CHECK(packet[at] >= 7 && packet[at] < 7 + SERVOS);
        CHECK(signed_goal(packet + at + 1) == 0 ||
              (may_move(packet[at] - 7U) && s.machine.end.stage == END_NOT));
    }
    CHECK(packet[4] != 3 || packet[5] != GOAL || signed_goal(packet + 6) == 0);
}

static void spoil(uint8_t choice)
{
    uint32_t at = s.count > 0 ? next_byte() % s.count : 0;
    if (s.count == 0 || choice % 4 != 0) {
        return;
    }
    switch (choice / 4 % 4) {
    case 0: s.bytes[at] ^= (uint8_t)(1U << next_byte() % 8); break;
    case 1: s.count = at; break;
    case 2:
        memmove(s.bytes + 3, s.bytes, s.count);
        memset(s.bytes, next_byte(), 3);
        s.count += 3;
        break;
    default: s.count = 0;
    }
}

static void look(uint8_t choice)
{
    line_machine_step(&s.machine, s.now_ns, s.bytes, s.count, &s.out);
    s.count = 0;
    if (s.out.send == NULL) {
        CHECK(s.out.wake_ns > s.now_ns || s.machine.answered);
        s.now_ns = s.out.wake_ns > s.now_ns ? s.out.wake_ns : s.now_ns + 1;
        return;
    }
    for (uint32_t at = 0; at < s.out.send_bytes; at += 4U + s.out.send[at + 3]) {
        judge(s.out.send + at);
    }
    line_machine_sent(&s.machine, s.now_ns);
    s.now_ns += s.out.send_bytes * SERVO_CHARACTER_NS;
    for (uint32_t at = 0; at < s.out.send_bytes;) {
        at += obey_packet(s.out.send + at);
    }
    spoil(choice);
    s.now_ns = s.count == 0 && choice % 2 == 0 ? s.machine.until_ns : s.now_ns;
}

static bool stop_waits(void)
{
    bool waits = false;
    for (uint32_t i = 0; i < SERVOS; i++) {
        waits |= s.machine.drive[i].state.stop != STOP_NOTHING;
    }
    return waits && s.machine.end.stage == END_NOT;
}

/* From now on every servo answers and no byte is lost: each stop ends, even after late replies. */
static void stops_end(void)
{
    s.silent = 0;
    for (int64_t good_ns = s.now_ns; stop_waits(); look(1)) {
        s.machine.newest.stamp_ns = s.now_ns;
        CHECK(s.now_ns <= good_ns + 1000 * STEP_MS);
    }
}

static void machine(const uint8_t *data, size_t size)
{
    put_tape(data, size);
    servos_begin(SERVOS, next_byte() % 2 == 0 ? ECHO_NONE : ECHO_UNKNOWN);
    while (tape_left > 4) {
        uint8_t choice = next_byte();
        if (choice & 1) {
            choose_request(next_byte());
        }
        if (choice & 2) {
            choose_setpoints(next_byte());
        }
        s.silent = choice & 4 ? next_byte() & 7U : s.silent;
        look(next_byte());
    }
    stops_end();
    s.machine.control.shut_down = 1;
    int64_t asked_ns = s.now_ns;
    while (s.machine.end.stage != END_SILENT) {
        look(1);
        CHECK(s.now_ns <= asked_ns + 3100 * STEP_MS);
    }
    for (uint32_t i = 0; i < SERVOS; i++) {
        CHECK(s.goal[i] == 0 || !s.torque[i] || (s.silent >> i & 1) != 0);
    }
}

static void once(const uint8_t *data, size_t size)
{
    uint8_t all[FUZZ_MAX] = {0};
    memcpy(all, data, size);
    packets(all);
    machine(data, size);
}

#include "fuzz.h"
