/* SPDX-License-Identifier: Apache-2.0
 *
 * Both ends of the hoverboard FOC firmware's UART. It was written only from the firmware's sources
 * (EFeru/hoverboard-firmware-hack-FOC: Src/util.c, Src/main.c, Inc/config.h) and shares no code
 * with motord:
 *
 * hoverboard_peer board FD [mixed]              is the main board, on the master side of a pty. A
 *                                               letter on stdin makes it mute ('m'), spoils its
 *                                               check sums ('x'), or makes it normal again ('w').
 *                                               When its motors change it prints a line: left and
 *                                               right rpm, and 1 after a time-out.
 * hoverboard_peer host PORT FIRST SECOND        drives a board: sends FIRST and SECOND word of the
 *                                               command until stdin ends, then zeros. For each good
 *                                               feedback it prints a line: right and left rpm,
 *                                               voltage, temperature.
 */
#include <fcntl.h>
#include <poll.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <termios.h>
#include <time.h>
#include <unistd.h>

enum { START = 0xABCD, LOOP_MS = 5, TIMEOUT_LOOPS = 160, HOST_MS = 20 };

typedef struct {
    uint16_t start;
    int16_t steer, speed;
    uint16_t checksum;
} SerialCommand;

typedef struct {
    uint16_t start;
    int16_t cmd1, cmd2, speedR_meas, speedL_meas, batVoltage, boardTemp;
    uint16_t cmdLed, checksum;
} SerialFeedback;

_Static_assert(sizeof(SerialCommand) == 8 && sizeof(SerialFeedback) == 18, "as on the wire");

static int64_t now_ms(void)
{
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (int64_t)now.tv_sec * 1000 + now.tv_nsec / 1000000;
}

static uint16_t checksum_of(const SerialFeedback *f)
{
    return (uint16_t)(f->start ^ f->cmd1 ^ f->cmd2 ^ f->speedR_meas ^ f->speedL_meas ^
                      f->batVoltage ^ f->boardTemp ^ f->cmdLed);
}

static int clamp(int value)
{
    return value > 1000 ? 1000 : value < -1000 ? -1000 : value;
}

/* Returns a byte of stdin, or 0. Sets `ended` at the end of stdin. */
static char letter(int *ended)
{
    struct pollfd in = {.fd = 0, .events = POLLIN};
    char byte = 0;
    if (poll(&in, 1, 0) > 0 && read(0, &byte, 1) <= 0) {
        *ended = 1;
    }
    return byte;
}

/* ---------------------------------------------------------------------------- the board */
static int board(int fd, int mixed)
{
    SerialCommand command = {0};
    int timeout = 0, mute = 0, spoiled = 0, ended = 0, last[3] = {0, 0, -1};
    double left_rpm = 0, right_rpm = 0;
    (void)fcntl(fd, F_SETFL, O_NONBLOCK);
    for (unsigned loop = 0; !ended; loop++) {
        uint8_t bytes[512];
        const ssize_t size = read(fd, bytes, sizeof bytes);
        /* The firmware takes the bytes between two idle moments as a command if they are as long as
         * one. Here several commands may have arrived. */
        for (ssize_t at = 0; size > 0 && size % 8 == 0 && at < size; at += 8) {
            SerialCommand in;
            memcpy(&in, bytes + at, sizeof in);
            if (in.start == START && in.checksum == (uint16_t)(in.start ^ in.steer ^ in.speed)) {
                command = in;
                timeout = 0;
            }
        }
        const int late = ++timeout > TIMEOUT_LOOPS;
        const int first = late ? 0 : clamp(command.steer), second = late ? 0 : clamp(command.speed);
        const int left = mixed ? clamp(second + first / 2) : first,
                  right = mixed ? clamp(second - first / 2) : second;
        left_rpm += (left - left_rpm) * 0.2;
        right_rpm += (right - right_rpm) * 0.2;
        if (left != last[0] || right != last[1] || late != last[2]) {
            printf("%d %d %d\n", left, right, late);
            fflush(stdout);
            last[0] = left, last[1] = right, last[2] = late;
        }
        /* the right motor is mounted in reverse, and its measured speed has the motor's own sign */
        if (loop % 2 == 0 && !mute) {
            SerialFeedback out = {.start = START,
                                  .cmd1 = (int16_t)first,
                                  .cmd2 = (int16_t)second,
                                  .batVoltage = 3912};
            out.speedR_meas = (int16_t)-right_rpm, out.speedL_meas = (int16_t)left_rpm,
            out.boardTemp = 287;
            out.checksum = (uint16_t)(checksum_of(&out) ^ spoiled);
            if (write(fd, &out, sizeof out) < 0) {
                timeout += 0; /* no program has opened the other end */
            }
        }
        const char what = letter(&ended);
        mute = what == 'm' ? 1 : what == 'w' ? 0 : mute;
        spoiled = what == 'x' ? 0x0100 : what == 'w' ? 0 : spoiled;
        usleep(LOOP_MS * 1000);
    }
    return 0;
}

/* ----------------------------------------------------------------------------- the host */
static void send_command(int fd, int first, int second)
{
    SerialCommand out = {START, (int16_t)first, (int16_t)second, 0};
    out.checksum = (uint16_t)(out.start ^ out.steer ^ out.speed);
    if (write(fd, &out, sizeof out) != (ssize_t)sizeof out) {
        exit(1);
    }
}

/* Reads like the firmware's own Arduino example: a start word anywhere begins a frame. */
static void receive(uint8_t byte)
{
    static uint8_t before, frame[sizeof(SerialFeedback)];
    static size_t count;
    if ((uint16_t)(byte << 8 | before) == START) {
        frame[0] = before, frame[1] = byte;
        count = 2;
    } else if (count >= 2 && count < sizeof frame) {
        frame[count++] = byte;
    }
    if (count == sizeof frame) {
        SerialFeedback in;
        memcpy(&in, frame, sizeof in);
        if (in.start == START && in.checksum == checksum_of(&in)) {
            printf("%d %d %d %d\n", in.speedR_meas, in.speedL_meas, in.batVoltage, in.boardTemp);
            fflush(stdout);
        }
        count = 0;
    }
    before = byte;
}

static int host(const char *port, int first, int second)
{
    const int fd = open(port, O_RDWR | O_NOCTTY | O_NONBLOCK);
    struct termios raw;
    if (fd < 0 || tcgetattr(fd, &raw) != 0) {
        return 1;
    }
    cfmakeraw(&raw);
    (void)cfsetspeed(&raw, B115200);
    (void)tcsetattr(fd, TCSANOW, &raw);
    int ended = 0;
    for (int64_t due_ms = now_ms(); !ended;) {
        uint8_t bytes[256];
        const ssize_t size = read(fd, bytes, sizeof bytes);
        for (ssize_t i = 0; i < size; i++) {
            receive(bytes[i]);
        }
        if (now_ms() >= due_ms) {
            send_command(fd, first, second);
            due_ms = now_ms() + HOST_MS;
        }
        (void)letter(&ended);
        usleep(1000);
    }
    send_command(fd, 0, 0);
    (void)tcdrain(fd);
    return close(fd);
}

int main(int argc, char **argv)
{
    if (argc >= 3 && strcmp(argv[1], "board") == 0) {
        return board(atoi(argv[2]), argc > 3);
    }
    return argc == 5 && strcmp(argv[1], "host") == 0 ? host(argv[2], atoi(argv[3]), atoi(argv[4]))
                                                     : 2;
}
