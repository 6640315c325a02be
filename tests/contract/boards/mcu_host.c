/* SPDX-License-Identifier: Apache-2.0
 *
 * mcu_host FD: docs/mcu/motord_mcu.c as a board with two motors, on the master side of a pty. A
 * letter on stdin makes a fault ('f') or ends it ('g'), restarts the board ('r'), makes it mute
 * ('m'), makes it ignore what it receives ('d'), makes it normal again ('w'), gives it a sensor
 * whose x axis points up ('i'), or turns its first motor by hand ('t') and releases it ('s'). When
 * the set-points of the motors change it prints a line.
 */
#include "motord_mcu.h"

#include <fcntl.h>
#include <poll.h>
#include <stdio.h>
#include <stdlib.h>
#include <time.h>
#include <unistd.h>

enum { MOTORS = 2, COUNTS_PER_TURN = 1320 };
static const double BY_HAND_RAD_S = -4.0, RAMP_RAD_S2 = 200.0, TURN_RAD = 6.283185307179586,
                    FULL_DUTY_RAD_S = 20.0;

typedef struct {
    double velocity_rad_s, angle_rad;
} motor;

static uint32_t now_us(void)
{
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (uint32_t)((uint64_t)now.tv_sec * 1000000u + (uint64_t)now.tv_nsec / 1000u);
}

static double toward(double value, double target, double step)
{
    return value < target ? (value + step < target ? value + step : target)
                          : (value - step > target ? value - step : target);
}

static void turn(motor *motors, const motord_board *board, double dt_s, int by_hand,
                 motord_measured *measured)
{
    for (int i = 0; i < MOTORS; i++) {
        const double duty_rad_s = board->setpoint[i].duty * 1e-4 * FULL_DUTY_RAD_S;
        const double hand_rad_s = by_hand && i == 0 ? BY_HAND_RAD_S : 0.0;
        const double sent_rad_s =
            board->setpoint[i].velocity_mrad_s * 1e-3 + duty_rad_s + hand_rad_s;
        motors[i].velocity_rad_s = toward(motors[i].velocity_rad_s, sent_rad_s, RAMP_RAD_S2 * dt_s);
        motors[i].angle_rad += motors[i].velocity_rad_s * dt_s;
        measured[i].count = (int32_t)(motors[i].angle_rad * COUNTS_PER_TURN / TURN_RAD);
        measured[i].velocity_mrad_s = (int32_t)(motors[i].velocity_rad_s * 1000.0);
        measured[i].current_10ma = (int16_t)(25 * (i + 1));
    }
}

static void put(const motord_board *board)
{
    static int last[4] = {-1, 0, 0, 0};
    const int now[4] = {board->enabled + 2 * board->braking,
                        (int)board->setpoint[0].velocity_mrad_s,
                        (int)board->setpoint[1].velocity_mrad_s, board->setpoint[0].duty};
    if (now[0] == last[0] && now[1] == last[1] && now[2] == last[2] && now[3] == last[3]) {
        return;
    }
    for (int i = 0; i < 4; i++) {
        last[i] = now[i];
    }
    printf("%d %d %d %d %d\n", board->enabled, board->braking, now[1], now[2], now[3]);
    fflush(stdout);
}

int main(int argc, char **argv)
{
    const int fd = argc > 1 ? atoi(argv[1]) : -1;
    motord_board board;
    motord_measured measured[MOTORS] = {{0, 0, 0}};
    motord_health health = {0, 2400, 310};
    motor motors[MOTORS] = {{0, 0}};
    int mute = 0, ignores = 0, senses = 0, by_hand = 0;
    uint32_t before_us = now_us();
    fcntl(fd, F_SETFL, O_NONBLOCK);
    motord_board_init(&board, MOTORS, before_us);
    for (;;) {
        struct pollfd ready[2] = {{fd, POLLIN, 0}, {0, POLLIN, 0}};
        poll(ready, 2, 1);
        uint8_t data[512], sent[MOTORD_SENT_BYTES_MAX];
        if (ready[1].revents) {
            if (read(0, data, 1) <= 0) {
                return 0;
            }
            health.faults = data[0] == 'f' ? 1 : data[0] == 'g' ? 0 : health.faults;
            mute = data[0] == 'm' ? 1 : data[0] == 'w' ? 0 : mute;
            ignores = data[0] == 'd' ? 1 : data[0] == 'w' ? 0 : ignores;
            senses |= data[0] == 'i';
            by_hand = data[0] == 't' ? 1 : data[0] == 's' ? 0 : by_hand;
            if (data[0] == 'r') {
                motord_board_init(&board, MOTORS, now_us());
            }
        }
        const ssize_t size = read(fd, data, sizeof data);
        for (ssize_t i = 0; i < size && !ignores; i++) {
            motord_board_byte(&board, data[i], now_us());
        }
        const uint32_t at_us = now_us();
        motord_board_watch(&board, at_us);
        turn(motors, &board, (at_us - before_us) * 1e-6, by_hand, measured);
        before_us = at_us;
        if (senses) {
            const motord_imu imu = {{(int32_t)(motors[1].velocity_rad_s * 1e6), 0, MOTORD_NO_RATE},
                                    {9807, 0, MOTORD_NO_ACCELERATION},
                                    0};
            motord_board_imu(&board, &imu);
        }
        const size_t length = motord_board_feedback(&board, at_us, measured, &health, sent);
        if (length > 0 && !mute && write(fd, sent, length) < 0) {
            usleep(1000); /* no program has opened the other end */
        }
        put(&board);
    }
}
