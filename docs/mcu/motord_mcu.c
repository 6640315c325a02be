/* SPDX-License-Identifier: Apache-2.0 */
#include "motord_mcu.h"

#include <string.h>

enum { VERSION = 1, SETPOINTS = 0x01, FEEDBACK = 0x81 };
enum {
    HEAD_BYTES = 8,
    CRC_BYTES = 2,
    SETPOINTS_HEAD = 6,
    SETPOINTS_MOTOR = 6,
    FEEDBACK_HEAD = 16,
    FEEDBACK_MOTOR = 10,
    FEEDBACK_IMU = 20
};
enum { CONTROL_ENABLE = 1, CONTROL_BRAKE = 2, CONTROL_CLEAR = 4, CONTROL_RESTART_NOTED = 8 };
enum {
    STATUS_ENABLED = 1,
    STATUS_BRAKING = 2,
    STATUS_STOPPED_BY_SILENCE = 4,
    STATUS_RESTARTED = 8,
    STATUS_IMU = 16
};
enum { IMU_SATURATED = 1 };
enum { FIRST_WATCHDOG_MS = 100, FIRST_FEEDBACK_MS = 100 };

static uint16_t get16(const uint8_t *at)
{
    return (uint16_t)(at[0] | (uint16_t)((uint16_t)at[1] << 8));
}

static uint32_t get32(const uint8_t *at)
{
    return get16(at) | (uint32_t)get16(at + 2) << 16;
}

static void put16(uint8_t *at, uint16_t value)
{
    at[0] = (uint8_t)value;
    at[1] = (uint8_t)(value >> 8);
}

static void put32(uint8_t *at, uint32_t value)
{
    put16(at, (uint16_t)value);
    put16(at + 2, (uint16_t)(value >> 16));
}

/* CRC-16/IBM-3740: polynomial 0x1021, not reflected, start 0xFFFF. */
static uint16_t crc16(const uint8_t *data, size_t size)
{
    uint16_t crc = 0xFFFF;
    for (size_t i = 0; i < size; i++) {
        crc = (uint16_t)(crc ^ (uint16_t)((uint16_t)data[i] << 8));
        for (int bit = 0; bit < 8; bit++) {
            crc = (uint16_t)(crc & 0x8000 ? (crc << 1) ^ 0x1021 : crc << 1);
        }
    }
    return crc;
}

/* Consistent overhead byte stuffing (Cheshire & Baker 1999), of less than 255 bytes. */
static size_t stuff(const uint8_t *data, size_t size, uint8_t *out)
{
    size_t code = 0, at = 1;
    for (size_t i = 0; i < size; i++) {
        if (data[i] == 0) {
            out[code] = (uint8_t)(at - code);
            code = at++;
        } else {
            out[at++] = data[i];
        }
    }
    out[code] = (uint8_t)(at - code);
    return at;
}

/* In place; 0: it is not stuffed. */
static size_t unstuff(uint8_t *data, size_t size)
{
    size_t from = 0, to = 0;
    while (from < size) {
        const size_t code = data[from];
        if (from + code > size) {
            return 0;
        }
        memmove(data + to, data + from + 1, code - 1);
        to += code - 1;
        from += code;
        if (from < size && code < 255) {
            data[to++] = 0;
        }
    }
    return to;
}

static void rest(motord_board *board)
{
    memset(board->setpoint, 0, sizeof board->setpoint);
}

static void switch_off(motord_board *board, uint8_t braking)
{
    board->enabled = 0;
    board->braking = braking;
    rest(board);
}

void motord_board_init(motord_board *board, uint8_t motors, uint32_t now_us)
{
    memset(board, 0, sizeof *board);
    board->motors = motors < MOTORD_MOTORS_MAX ? motors : MOTORD_MOTORS_MAX;
    board->restarted = 1;
    board->watchdog_ms = FIRST_WATCHDOG_MS;
    board->feedback_ms = FIRST_FEEDBACK_MS;
    board->received_us = board->fed_us = now_us;
}

static int is_silent(const motord_board *board, uint32_t now_us)
{
    return now_us - board->received_us > (uint32_t)board->watchdog_ms * 1000u;
}

void motord_board_watch(motord_board *board, uint32_t now_us)
{
    if (!is_silent(board, now_us)) {
        return;
    }
    board->has_received = 0; /* the next sender may begin with any sequence */
    /* silent also when the clock has gone round */
    board->received_us = now_us - (uint32_t)board->watchdog_ms * 1000u - 1u;
    if (board->enabled) {
        board->stopped_by_silence = 1;
        switch_off(board, 1);
    }
}

static int all_zero(const uint8_t *data, size_t size)
{
    for (size_t i = 0; i < size; i++) {
        if (data[i] != 0) {
            return 0;
        }
    }
    return 1;
}

/* Enabling takes an edge, set-points of zero, no fault and a restart that was noted. */
static void obey_control(motord_board *board, uint8_t control, int at_zero)
{
    const uint8_t rising = (uint8_t)(control & ~board->control);
    board->control = control;
    if (control & CONTROL_RESTART_NOTED) {
        board->restarted = 0;
    }
    if (rising & CONTROL_CLEAR) {
        board->faults = 0;
    }
    if (!(control & CONTROL_ENABLE)) {
        board->stopped_by_silence = 0;
        switch_off(board, (control & CONTROL_BRAKE) != 0);
    } else if ((rising & CONTROL_ENABLE) && at_zero && !board->faults && !board->restarted) {
        board->enabled = 1;
        board->braking = 0;
    }
}

static void obey(motord_board *board, const uint8_t *payload, uint8_t motors, uint32_t now_us)
{
    const uint8_t *motor = payload + SETPOINTS_HEAD;
    const uint16_t watchdog_ms = get16(payload + 2);
    board->received_us = now_us;
    board->has_received = 1;
    board->watchdog_ms =
        watchdog_ms < MOTORD_WATCHDOG_MS_MAX ? watchdog_ms : MOTORD_WATCHDOG_MS_MAX;
    board->feedback_ms = get16(payload + 4);
    obey_control(board, payload[0], all_zero(motor, (size_t)motors * SETPOINTS_MOTOR));
    rest(board);
    if (!board->enabled) {
        return;
    }
    for (uint8_t i = 0; i < motors && i < board->motors; i++, motor += SETPOINTS_MOTOR) {
        const int16_t duty = (int16_t)get16(motor + 4);
        board->setpoint[i].velocity_mrad_s = (int32_t)get32(motor);
        board->setpoint[i].duty = (int16_t)(duty > 10000 ? 10000 : duty < -10000 ? -10000 : duty);
    }
}

static int take(motord_board *board, uint32_t now_us)
{
    uint8_t *raw = board->received;
    const size_t size = unstuff(raw, board->received_bytes);
    if (size < HEAD_BYTES + SETPOINTS_HEAD + CRC_BYTES || size > MOTORD_FRAME_BYTES_MAX) {
        return 0;
    }
    if (get16(raw + size - CRC_BYTES) != crc16(raw, size - CRC_BYTES) || raw[0] != VERSION ||
        raw[1] != SETPOINTS) {
        return 0;
    }
    const uint8_t motors = raw[HEAD_BYTES + 1];
    if (size != HEAD_BYTES + SETPOINTS_HEAD + (size_t)motors * SETPOINTS_MOTOR + CRC_BYTES) {
        return 0;
    }
    const uint16_t sequence = get16(raw + 2);
    if (board->has_received && (int16_t)(sequence - board->received_sequence) <= 0) {
        return 0; /* old, or received already */
    }
    board->received_sequence = sequence;
    obey(board, raw + HEAD_BYTES, motors, now_us);
    return 1;
}

void motord_board_byte(motord_board *board, uint8_t byte, uint32_t now_us)
{
    motord_board_watch(board, now_us);
    if (byte != 0) {
        if (board->received_bytes < sizeof board->received) {
            board->received[board->received_bytes++] = byte;
        }
        return;
    }
    if (board->received_bytes != 0) {
        if (take(board, now_us)) {
            board->frames_good++;
        } else {
            board->frames_bad++;
        }
    }
    board->received_bytes = 0;
}

static uint8_t status_of(const motord_board *board)
{
    return (uint8_t)((board->enabled ? STATUS_ENABLED : 0) | (board->braking ? STATUS_BRAKING : 0) |
                     (board->stopped_by_silence ? STATUS_STOPPED_BY_SILENCE : 0) |
                     (board->restarted ? STATUS_RESTARTED : 0) | (board->has_imu ? STATUS_IMU : 0));
}

void motord_board_imu(motord_board *board, const motord_imu *imu)
{
    board->imu = *imu;
    board->has_imu = 1;
}

static uint8_t *put_imu(motord_board *board, uint8_t *at)
{
    for (int i = 0; i < 3; i++) {
        put32(at + 4 * i, (uint32_t)board->imu.rate_urad_s[i]);
        put16(at + 12 + 2 * i, (uint16_t)board->imu.acceleration_mm_s2[i]);
    }
    put16(at + 18, board->imu.saturated ? IMU_SATURATED : 0);
    board->has_imu = 0;
    return at + FEEDBACK_IMU;
}

size_t motord_board_feedback(motord_board *board, uint32_t now_us, const motord_measured *motor,
                             const motord_health *health, uint8_t *sent)
{
    uint8_t raw[HEAD_BYTES + FEEDBACK_HEAD + FEEDBACK_MOTOR * MOTORD_MOTORS_MAX + FEEDBACK_IMU +
                CRC_BYTES];
    uint8_t *payload = raw + HEAD_BYTES, *at = payload + FEEDBACK_HEAD;
    motord_board_watch(board, now_us);
    board->faults |= health->faults;
    if (board->faults && board->enabled) {
        switch_off(board, 1);
    }
    if (now_us - board->fed_us < (uint32_t)board->feedback_ms * 1000u) {
        return 0;
    }
    board->fed_us = now_us;

    const uint32_t held = (now_us - board->received_us) / 100u;
    raw[0] = VERSION;
    raw[1] = FEEDBACK;
    put16(raw + 2, board->sequence++);
    put32(raw + 4, now_us);
    payload[0] = status_of(board);
    payload[1] = board->motors;
    put16(payload + 2, board->watchdog_ms);
    put16(payload + 4, board->feedback_ms);
    put16(payload + 6, board->received_sequence);
    put16(payload + 8, (uint16_t)(held < 0xFFFF ? held : 0xFFFF));
    put16(payload + 10, board->faults);
    put16(payload + 12, health->voltage_10mv);
    put16(payload + 14, (uint16_t)health->temperature_100mc);
    for (uint8_t i = 0; i < board->motors; i++, at += FEEDBACK_MOTOR) {
        put32(at, (uint32_t)motor[i].count);
        put32(at + 4, (uint32_t)motor[i].velocity_mrad_s);
        put16(at + 8, (uint16_t)motor[i].current_10ma);
    }
    if (board->has_imu) {
        at = put_imu(board, at);
    }
    put16(at, crc16(raw, (size_t)(at - raw)));
    sent[0] = 0;
    const size_t stuffed = stuff(raw, (size_t)(at - raw) + CRC_BYTES, sent + 1);
    sent[stuffed + 1] = 0;
    return stuffed + 2;
}
