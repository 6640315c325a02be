/* SPDX-License-Identifier: Apache-2.0
 * fuzz_line.c: the machine of a serial line with random drives, requests and set-points. For any
 * input, motion is sent only to an armed drive and only while the core requests it, the line keeps
 * its silence, no value is taken from an answer to another request, each stop ends, and the line
 * ends. */
#include <math.h>

#include "line_wire.h"
#include "tape.h"

#define FUZZ_NAME "fuzz_line"
enum { FUZZ_MAX = 192, UNITS = 3 };

static int64_t silent_ns; /* time since which no byte is on the wire */
static uint32_t modes[UNITS];
static uint8_t late[8], late_bytes;

static void set_points(uint8_t choice)
{
    static const double values[] = {0.0, 1.0, -3.0, 1e300, NAN, INFINITY, -0.0, 0.004};
    setpoints *to = &w.machine.newest;
    if (choice % 4 != 0) {
        to->stamp_ns = choice % 16 == 1 ? w.now_ns + 50 * MS : choice % 16 == 2 ? -5 : w.now_ns;
    }
    to->enabled = choice >> 4 & 1;
    to->joint_count = choice % 8 == 7 ? 1 : UNITS;
    for (uint32_t i = 0; i < UNITS; i++) {
        to->joint[i].velocity_rad_s = values[((choice >> 5) + i) & 7];
    }
}

static void requests(uint8_t choice)
{
    uint32_t drive = choice % UNITS, what = choice / 8;
    if (what < DRIVE_UNRESPONSIVE || what == DRIVE_STAND_DOWN) {
        request(drive, what);
    } else if (what == 8) {
        line_request request = {.id = choice,
                                .expires_ns = w.now_ns + 40 * MS,
                                .turnaround_ns = 5 * MS,
                                .drive = drive,
                                .frame = frame_of((uint8_t)(drive + 1), READ, STATUS, 1)};
        (void)line_machine_request(&w.machine, &request);
    } else if (what == 9) {
        w.machine.control.shut_down = 1;
    } else if (what == 10) {
        line_machine_kick(&w.machine, w.now_ns);
    }
}

/* The correct answer of a drive. Its status is 100 + its unit, so that each value identifies its
 * drive. */
static uint32_t honest(const uint8_t *request, uint8_t *out)
{
    if (request[1] == WRITE) {
        memcpy(out, request, 8);
        return 8;
    }
    const uint8_t reply[7] = {request[0], READ, 2, 0, (uint8_t)(100 + request[0])};
    memcpy(out, reply, 7);
    rtu_seal(out, 7, SEAL_CRC16);
    return 7;
}

static void answer(const uint8_t *request, uint8_t choice)
{
    uint8_t other[8];
    memcpy(other, request, 8);
    w.count = honest(request, w.bytes);
    switch (choice % 16) {
    case 1: /* nothing */ w.count = 0; break;
    case 2: /* flips one bit, which CRC-16 always detects */
        w.bytes[next_byte() % w.count] ^= (uint8_t)(1U << next_byte() % 8);
        break;
    case 3: /* a part of the answer */ w.count = next_byte() % w.count; break;
    case 4: /* another drive answers */
        other[0] = (uint8_t)(1 + request[0] % UNITS);
        rtu_seal(other, 8, SEAL_CRC16);
        w.count = honest(other, w.bytes);
        break;
    case 5: /* a refusal */
        memcpy(w.bytes, (const uint8_t[]){request[0], (uint8_t)(request[1] | 0x80), 2}, 3);
        rtu_seal(w.bytes, 5, SEAL_CRC16);
        w.count = 5;
        break;
    case 6: /* garbage before the answer */
        memmove(w.bytes + 3, w.bytes, w.count);
        memset(w.bytes, 0xF0, 3);
        w.count += 3;
        break;
    case 7: /* kept for a later request */
        memcpy(late, w.bytes, w.count);
        late_bytes = (uint8_t)w.count;
        w.count = 0;
        break;
    case 8: /* the kept answer first */
        memmove(w.bytes + late_bytes, w.bytes, w.count);
        memcpy(w.bytes, late, late_bytes);
        w.count += late_bytes;
        break;
    default: break;
    }
}

static bool may_move(uint32_t drive)
{
    const setpoints *from = &w.machine.newest;
    double wanted = drive < from->joint_count ? from->joint[drive].velocity_rad_s : 0.0;
    return w.machine.drive[drive].state.mode == DRIVE_ARMED && from->enabled == 1 &&
           from->stamp_ns > 0 && w.now_ns - from->stamp_ns <= w.table.setpoint_timeout_ns &&
           isfinite(wanted) && wanted != 0.0;
}

static void judge_request(const uint8_t *request)
{
    uint32_t drive = request[0] - 1U;
    CHECK(request[0] >= 1 && request[0] <= UNITS && w.machine.end.stage != END_SILENT);
    CHECK(w.now_ns - silent_ns >= GAP_NS);
    CHECK(rtu_is_sealed(request, 8, SEAL_CRC16));
    if (request[1] == WRITE && request[3] == SPEED && (request[4] != 0 || request[5] != 0)) {
        CHECK(may_move(drive) && w.machine.end.stage == END_NOT);
    }
}

static void judge_modes(void)
{
    for (uint32_t i = 0; i < UNITS; i++) {
        uint32_t now = w.machine.drive[i].state.mode;
        judge_mode(modes[i], now, &w.machine.control.drive[i]);
        modes[i] = now;
        double velocity = w.machine.joint[i].feedback.velocity_rad_s;
        CHECK(isnan(velocity) || fabs(velocity - 0.01 * (101.0 + i)) < 1e-9);
    }
}

static void step(void)
{
    line_machine_step(&w.machine, w.now_ns, w.bytes, w.count, &w.out);
    silent_ns = w.count > 0 ? w.now_ns : silent_ns;
    w.count = 0;
    judge_modes();
    if (w.out.send == NULL) {
        CHECK(w.out.wake_ns > w.now_ns || w.machine.answered);
        return;
    }
    uint8_t request[8];
    memcpy(request, w.out.send, 8);
    judge_request(request);
    line_machine_sent(&w.machine, w.now_ns);
    silent_ns = w.machine.end_ns;
    answer(request, next_byte());
}

/* Advances the time to the answer, to the time that the machine requested, or to a look before
 * that. */
static void pass_time(uint8_t choice)
{
    if (w.machine.work != WORK_NONE) {
        int64_t answered_ns = w.machine.end_ns + DEVICE_NS + w.count * CHARACTER_NS;
        w.now_ns = w.count > 0       ? answered_ns
                   : choice % 4 == 0 ? w.machine.end_ns + 1
                                     : w.machine.until_ns;
        w.now_ns = w.now_ns > silent_ns ? w.now_ns : silent_ns;
    } else if (choice % 8 == 1) {
        w.now_ns += (int64_t)next_byte() * MS / 4;
    } else {
        w.now_ns = w.out.wake_ns > w.now_ns ? w.out.wake_ns : w.now_ns;
    }
}

static bool stop_waits(void)
{
    bool waits = false;
    for (uint32_t i = 0; i < UNITS; i++) {
        waits |= w.machine.drive[i].state.stop != STOP_NOTHING;
    }
    return waits && w.machine.end.stage == END_NOT;
}

/* The tape is at its end: from now on every drive answers and no byte is lost, so each stop
 * ends. */
static void stops_end(void)
{
    put_tape(NULL, 0);
    for (int64_t good_ns = w.now_ns; stop_waits(); pass_time(2)) {
        w.machine.newest.stamp_ns = w.now_ns;
        step();
        CHECK(w.now_ns <= good_ns + 1000 * MS);
    }
}

static void once(const uint8_t *data, size_t size)
{
    put_tape(data, size);
    begin_with(UNITS, next_byte() % 2 == 0 ? 0 : 2);
    silent_ns = w.now_ns;
    late_bytes = 0;
    memset(modes, 0, sizeof modes);
    while (tape_left > 4) {
        uint8_t choice = next_byte();
        if (choice & 1) {
            requests(next_byte());
        }
        if (choice & 2) {
            set_points(next_byte());
        }
        step();
        pass_time(choice >> 2);
    }
    stops_end();
    w.machine.control.shut_down = 1;
    int64_t asked_ns = w.now_ns;
    while (w.machine.end.stage != END_SILENT) {
        step();
        pass_time(2);
        CHECK(w.now_ns <= asked_ns + 3100 * MS);
    }
    for (uint32_t i = 0; i < 3; i++) {
        step();
        CHECK(w.out.send == NULL);
        pass_time(2);
    }
}

#include "fuzz.h"
