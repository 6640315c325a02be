/* SPDX-License-Identifier: Apache-2.0
 * servo_slave.c: bus servos on a pty that take the time of a real wire, and answer at once: the
 * master causes the rest of a cycle's time. A request has arrived when its bytes would have passed
 * the wire, a reply is handed over when its last byte would have come.
 *
 *     servo_slave feetech|dynamixel BAUDRATE [PRIORITY]     prints the pty's name; then a line of
 *     JSON for each line on stdin: number of sync reads and of bad packets, seconds, and the part
 *     of this time in which the wire was busy, all since the line before
 */
#include <errno.h>
#include <fcntl.h>
#include <poll.h>
#include <sched.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/prctl.h>
#include <termios.h>
#include <time.h>
#include <unistd.h>

enum {
    READ = 2,
    WRITE = 3,
    STATUS = 0x55,
    SYNC_READ = 0x82,
    SYNC_WRITE = 0x83,
    BYTES_MAX = 1024,
    ALL = 0xFE
};

static const int64_t NS_PER_S = 1000000000;

static bool dynamixel;
static int64_t character_ns, wire_ns, busy_ns, since_ns;
static uint64_t cycles, bad;
static uint8_t table[256][256];
static uint8_t out[BYTES_MAX];

static int64_t now_ns(void)
{
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (int64_t)now.tv_sec * NS_PER_S + now.tv_nsec;
}

static void sleep_until(int64_t until_ns)
{
    struct timespec until = {.tv_sec = until_ns / NS_PER_S, .tv_nsec = until_ns % NS_PER_S};
    while (clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &until, NULL) == EINTR) {
    }
}

static uint16_t crc16(const uint8_t *bytes, int count)
{
    uint32_t crc = 0;
    for (int i = 0; i < count; i++) {
        crc ^= (uint32_t)bytes[i] << 8;
        for (int bit = 0; bit < 8; bit++) {
            crc = (crc & 0x8000) != 0 ? crc << 1 ^ 0x8005 : crc << 1;
        }
    }
    return (uint16_t)crc;
}

static uint8_t sum(const uint8_t *bytes, int count)
{
    uint32_t all = 0;
    for (int i = 0; i < count; i++) {
        all += bytes[i];
    }
    return (uint8_t)~all;
}

static void occupy(int bytes)
{
    int64_t now = now_ns();
    wire_ns = (wire_ns > now ? wire_ns : now) + bytes * character_ns;
    busy_ns += bytes * character_ns;
}

/* Sends a status packet. No value of this bench needs byte stuffing. */
static void answer(int fd, int unit, const uint8_t *data, int count)
{
    int bytes = 0;
    if (dynamixel) {
        memcpy(out,
               (const uint8_t[]){0xFF, 0xFF, 0xFD, 0, (uint8_t)unit, (uint8_t)(count + 4), 0,
                                 STATUS, 0},
               9);
        memcpy(out + 9, data, (size_t)count);
        uint16_t crc = crc16(out, 9 + count);
        out[9 + count] = (uint8_t)crc;
        out[10 + count] = (uint8_t)(crc >> 8);
        bytes = 11 + count;
    } else {
        memcpy(out, (const uint8_t[]){0xFF, 0xFF, (uint8_t)unit, (uint8_t)(count + 2), 0}, 5);
        memcpy(out + 5, data, (size_t)count);
        out[5 + count] = sum(out + 2, 3 + count);
        bytes = 6 + count;
    }
    occupy(bytes);
    sleep_until(wire_ns);
    if (write(fd, out, (size_t)bytes) != bytes) {
        exit(1);
    }
}

static int number(const uint8_t *at)
{
    return dynamixel ? at[0] | at[1] << 8 : at[0];
}

static void obey(int fd, const uint8_t *packet, int bytes)
{
    int head = dynamixel ? 7 : 4, width = dynamixel ? 2 : 1, seal = dynamixel ? 2 : 1;
    int unit = packet[dynamixel ? 4 : 2], code = packet[head],
        first = number(packet + head + 1) & 0xFF;
    const uint8_t *rest = packet + head + 1 + width, *end = packet + bytes - seal;
    int count = rest + width <= end ? number(rest) : 0;
    if (code == READ) {
        answer(fd, unit, table[unit] + first, count);
    } else if (code == WRITE) {
        memcpy(table[unit] + first, rest, (size_t)(end - rest));
        if (unit != ALL) {
            answer(fd, unit, NULL, 0);
        }
    } else if (code == SYNC_WRITE) {
        for (const uint8_t *row = rest + width; row + count < end; row += count + 1) {
            memcpy(table[row[0]] + first, row + 1, (size_t)count);
        }
    } else if (code == SYNC_READ) {
        cycles++;
        for (const uint8_t *at = rest + width; at < end; at++) {
            answer(fd, *at, table[*at] + first, count);
        }
    }
}

static int whole(const uint8_t *bytes, int count)
{
    int head = dynamixel ? 7 : 4;
    int all = count < head ? 0 : head + (dynamixel ? bytes[5] | bytes[6] << 8 : bytes[3]);
    return all > 0 && all <= count ? all : 0;
}

static bool is_good(const uint8_t *packet, int bytes)
{
    return dynamixel ? crc16(packet, bytes - 2) == (packet[bytes - 2] | packet[bytes - 1] << 8)
                     : sum(packet + 2, bytes - 3) == packet[bytes - 1];
}

static void print_stats(void)
{
    int64_t now = now_ns();
    printf("{\"cycles\": %llu, \"bad\": %llu, \"seconds\": %.6f, \"busy\": %.4f}\n",
           (unsigned long long)cycles, (unsigned long long)bad, (double)(now - since_ns) * 1e-9,
           (double)busy_ns / (double)(now - since_ns));
    fflush(stdout);
    cycles = bad = 0;
    busy_ns = 0;
    since_ns = now;
}

static void serve(int fd)
{
    uint8_t bytes[BYTES_MAX];
    int count = 0;
    for (;;) {
        struct pollfd fds[2] = {{.fd = fd, .events = POLLIN}, {.fd = 0, .events = POLLIN}};
        (void)poll(fds, 2, -1);
        if ((fds[1].revents & (POLLIN | POLLHUP)) != 0) {
            char line[64];
            if (read(0, line, sizeof line) <= 0) {
                return;
            }
            print_stats();
        }
        if ((fds[0].revents & POLLIN) == 0) {
            continue;
        }
        ssize_t came = read(fd, bytes + count, sizeof bytes - (size_t)count);
        occupy(came > 0 ? (int)came : 0);
        count += came > 0 ? (int)came : 0;
        for (int all; (all = whole(bytes, count)) > 0;) {
            if (bytes[0] != 0xFF || !is_good(bytes, all)) {
                bad++;
                count = 0;
                break;
            }
            obey(fd, bytes, all);
            count -= all;
            memmove(bytes, bytes + all, (size_t)count);
        }
    }
}

int main(int argc, char **argv)
{
    if (argc < 3) {
        fprintf(stderr, "usage: %s feetech|dynamixel BAUDRATE [PRIORITY]\n", argv[0]);
        return 2;
    }
    dynamixel = argv[1][0] == 'd';
    character_ns = (int64_t)(10e9 / atof(argv[2]));
    const int model = dynamixel ? 1060 : 777; /* XL430-W250 at address 0, STS3215 at address 3 */
    for (int unit = 0; unit < 256; unit++) {
        table[unit][dynamixel ? 0 : 3] = (uint8_t)(model & 0xFF);
        table[unit][dynamixel ? 1 : 4] = (uint8_t)(model >> 8);
    }
    struct sched_param param = {.sched_priority = argc > 3 ? atoi(argv[3]) : 0};
    prctl(PR_SET_TIMERSLACK, 1UL, 0UL, 0UL, 0UL);
    if (param.sched_priority > 0 && sched_setscheduler(0, SCHED_FIFO, &param) != 0) {
        fprintf(stderr, "no SCHED_FIFO: %s\n", strerror(errno));
    }
    mlockall(MCL_CURRENT);
    struct termios raw;
    int fd = posix_openpt(O_RDWR | O_NOCTTY);
    if (fd < 0 || grantpt(fd) != 0 || unlockpt(fd) != 0) {
        return 1;
    }
    int other = open(ptsname(fd), O_RDWR | O_NOCTTY); /* open: no hang-up between two clients */
    tcgetattr(other, &raw);
    cfmakeraw(&raw);
    tcsetattr(other, TCSANOW, &raw);
    printf("%s\n", ptsname(fd));
    fflush(stdout);
    since_ns = now_ns();
    serve(fd);
    return 0;
}
