/* SPDX-License-Identifier: Apache-2.0
 *
 * The board's side of motord's frames (docs/mcu-frame.md) in plain C99: no heap, no I/O, no clock
 * of its own. Give it every byte that comes and the time; it returns what the motors shall do, and
 * makes the frames that go back. When nothing good has come for the time that motord requested, it
 * switches the motors off by itself.
 */
#ifndef MOTORD_MCU_H
#define MOTORD_MCU_H

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#define MOTORD_MOTORS_MAX 4
#define MOTORD_FRAME_BYTES_MAX 200                         /* without stuffing */
#define MOTORD_SENT_BYTES_MAX (MOTORD_FRAME_BYTES_MAX + 4) /* stuffed, between its two zeros */
#define MOTORD_WATCHDOG_MS_MAX 2000u /* longer ones are cut down, and read back so */

/* What one motor shall do; zeros unless `motord_board.enabled`. Use the one that your board can
 * follow. */
typedef struct {
    int32_t velocity_mrad_s; /* of the motor's shaft */
    int16_t duty;            /* -10000 to 10000 */
} motord_setpoint;

/* What you measure at one motor. */
typedef struct {
    int32_t count; /* encoder edges, free running, wraps */
    int32_t velocity_mrad_s;
    int16_t current_10ma;
} motord_measured;

/* What you measure at the board. A bit of `faults` switches off; it is latched until it is
 * cleared. */
typedef struct {
    uint16_t faults;
    uint16_t voltage_10mv;
    int16_t temperature_100mc; /* 0.1 degC */
} motord_health;

#define MOTORD_NO_RATE INT32_MIN /* an axis that the sensor does not measure */
#define MOTORD_NO_ACCELERATION INT16_MIN

/* What an inertial sensor on the board measures, about its own axes. */
typedef struct {
    int32_t rate_urad_s[3]; /* 0.000001 rad/s */
    int16_t acceleration_mm_s2[3];
    uint8_t saturated; /* a rate was at the end of its scale */
} motord_imu;

typedef struct {
    /* for you to read */
    uint8_t enabled; /* follow the set-points */
    uint8_t braking; /* not enabled: short the windings until rest; else let them turn freely */
    motord_setpoint setpoint[MOTORD_MOTORS_MAX];
    uint32_t frames_good, frames_bad;
    /* its own */
    uint8_t motors, control, stopped_by_silence, restarted, has_received;
    uint16_t watchdog_ms, feedback_ms, received_sequence, sequence, faults;
    uint32_t received_us, fed_us;
    motord_imu imu;
    uint8_t has_imu;
    uint8_t received[MOTORD_SENT_BYTES_MAX];
    size_t received_bytes;
} motord_board;

void motord_board_init(motord_board *board, uint8_t motors, uint32_t now_us);

/* A byte has come. Set-points are in force when this returns. */
void motord_board_byte(motord_board *board, uint8_t byte, uint32_t now_us);

/* Call it at least every millisecond, also from a timer's interrupt if your loop may hang: it is
 * the watchdog. */
void motord_board_watch(motord_board *board, uint32_t now_us);

/* The frame to send now, or 0 bytes where none is due yet. `sent` has MOTORD_SENT_BYTES_MAX
 * bytes. */
size_t motord_board_feedback(motord_board *board, uint32_t now_us, const motord_measured *motor,
                             const motord_health *health, uint8_t *sent);

/* The sensor has been read: it goes with the next feedback, once. Without a sensor never call
 * it. */
void motord_board_imu(motord_board *board, const motord_imu *imu);

#ifdef __cplusplus
}
#endif
#endif
