/* SPDX-License-Identifier: Apache-2.0
 * board_imu.c: the samples of an inertial sensor on the board, in the base's axes. */
#include <math.h>

#include "board_machine.h"

enum {
    HAS_IMU = 16,
    STATUS_AT = 0,
    MOTORS_AT = 1,
    HEAD_BYTES = 16,
    MOTOR_BYTES = 10,
    IMU_BYTES = 20,
    SATURATED = 1
};
enum { RATE_BYTES = 4, ACCELERATION_BYTES = 2, ACCELERATIONS_AT = 12, FLAGS_AT = 18 };

static const double RATE_UNIT_RAD_S = 1e-6, ACCELERATION_UNIT_M_S2 = 1e-3;

static uint32_t begin_of(const uint8_t *payload)
{
    return HEAD_BYTES + MOTOR_BYTES * (uint32_t)payload[MOTORS_AT];
}

bool board_imu_fits(const uint8_t *payload, uint32_t feedback_bytes)
{
    return (payload[STATUS_AT] & HAS_IMU) == 0 || feedback_bytes >= begin_of(payload) + IMU_BYTES;
}

/* Return a value in SI; NaN: the least number of its size means that nothing was measured. */
static double si_at(const uint8_t *payload, uint32_t byte, uint32_t bytes, double unit)
{
    board_place place = {.byte = byte, .bytes = bytes, .is_signed = 1};
    int64_t raw = board_get(payload, &place);
    return raw == board_raw_min(&place) ? (double)NAN : (double)raw * unit;
}

static double along(const board_imu *imu, uint32_t base_axis, const double *sensor)
{
    double value = sensor[imu->axis[base_axis]];
    return imu->backward[base_axis] != 0 ? -value : value;
}

static void note(board_machine *m, const double *rate, const double *acceleration, bool saturated)
{
    const board_imu *imu = &m->table.imu;
    m->imu = (imu_sample){.stamp_ns = m->stamp_ns, .saturated = saturated, .epoch = imu->epoch};
    for (uint32_t axis = 0; axis < 3; axis++) {
        m->imu.angular_rad_s[axis] = along(imu, axis, rate);
        m->imu.acceleration_m_s2[axis] = along(imu, axis, acceleration);
    }
    m->imu_is_new = true;
}

static void read_frame(board_machine *m)
{
    uint32_t begin = begin_of(m->feedback_payload);
    double rate[3], acceleration[3];
    for (uint32_t axis = 0; axis < 3; axis++) {
        rate[axis] =
            si_at(m->feedback_payload, begin + RATE_BYTES * axis, RATE_BYTES, RATE_UNIT_RAD_S);
        acceleration[axis] =
            si_at(m->feedback_payload, begin + ACCELERATIONS_AT + ACCELERATION_BYTES * axis,
                  ACCELERATION_BYTES, ACCELERATION_UNIT_M_S2);
    }
    note(m, rate, acceleration, (m->feedback_payload[begin + FLAGS_AT] & SATURATED) != 0);
}

void board_imu_read(board_machine *m)
{
    const board_imu *imu = &m->table.imu;
    if (imu->used == 0) {
        return;
    }
    if (m->table.dialect == BOARD_TEXT) {
        const double rate[3] = {
            NAN, NAN, (double)board_get(m->feedback_payload, &imu->rate_z) * RATE_UNIT_RAD_S};
        const double acceleration[3] = {NAN, NAN, NAN};
        note(m, rate, acceleration, false);
    } else if ((m->feedback_payload[STATUS_AT] & HAS_IMU) != 0) {
        read_frame(m);
    }
}
