/* SPDX-License-Identifier: Apache-2.0
 * rtu_slave.c: Modbus RTU drives on a pty that take the time of a real wire, and judge their
 * master.
 *
 * A pty carries a frame in no time. Here a request has arrived when its bytes would have passed the
 * wire; the reply begins after the silence that marks the end of a frame, and is handed over when
 * its last byte would have come. So one exchange takes (request + reply) characters and two
 * silences: that is the wire's limit, and the client causes all time beyond it. A request that
 * comes before the second silence is over is a violation (5 % are tolerated: clocks round).
 *
 *     rtu_slave BAUDRATE GAP_US [PRIORITY]     prints the pty's name; then a line of JSON for each
 *     line on stdin: for "stats" the counters, which then restart at zero; for "changed" the time
 *     of the first request that changed a register since the last "changed"
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

enum { FRAME_MAX = 256, KEPT_MAX = 1 << 17, UNITS = 248 };

static const int64_t NS_PER_S = 1000000000;
static const int64_t LATE_NS = 2000000; /* a later reply: this machine was held up */

static int64_t character_ns, gap_ns, wire_free_ns, request_ns;
static uint16_t registers[UNITS][0x10000];
static float parts[KEPT_MAX]; /* the wire's limit divided by the duration of each exchange */
static uint32_t kept;
static uint64_t requests, bad_crc, violations, excused;
static bool was_late;      /* our own reply was late: a client that did not wait is excused */
static int64_t changed_ns; /* first byte of the first request that changed a register; 0: no such */
static int64_t limits_ns, first_ns, last_ns, last_limit_ns;

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
    uint32_t crc = 0xFFFF;
    for (int i = 0; i < count; i++) {
        crc ^= bytes[i];
        for (int bit = 0; bit < 8; bit++) {
            crc = (crc & 1) != 0 ? crc >> 1 ^ 0xA001 : crc >> 1;
        }
    }
    return (uint16_t)crc;
}

static int seal(uint8_t *frame, int count)
{
    uint16_t crc = crc16(frame, count);
    frame[count] = (uint8_t)crc;
    frame[count + 1] = (uint8_t)(crc >> 8);
    return count + 2;
}

static int word(const uint8_t *at)
{
    return at[0] << 8 | at[1];
}

static int request_bytes(const uint8_t *frame, int count)
{
    int function = count > 1 ? frame[1] : 0;
    if (function == 3 || function == 6) {
        return 8;
    }
    if (function == 16) {
        return count > 6 ? 9 + frame[6] : FRAME_MAX;
    }
    return function == 23 ? (count > 10 ? 13 + frame[10] : FRAME_MAX) : FRAME_MAX;
}

static int read_out(uint8_t *reply, const uint8_t *frame)
{
    int address = word(frame + 2), count = word(frame + 4);
    reply[2] = (uint8_t)(2 * count);
    for (int i = 0; i < count && i < 120; i++) {
        uint16_t value = registers[frame[0]][(uint16_t)(address + i)];
        reply[3 + 2 * i] = (uint8_t)(value >> 8);
        reply[4 + 2 * i] = (uint8_t)value;
    }
    return seal(reply, 3 + 2 * count);
}

static void write_in(int unit, int address, const uint8_t *words, int count)
{
    for (int i = 0; i < count; i++) {
        uint16_t *to = &registers[unit][(uint16_t)(address + i)];
        if (*to != (uint16_t)word(words + 2 * i)) {
            *to = (uint16_t)word(words + 2 * i);
            changed_ns = changed_ns == 0 ? request_ns : changed_ns;
        }
    }
}

static int make_reply(uint8_t *reply, const uint8_t *frame, int count)
{
    memcpy(reply, frame, 6);
    if (frame[1] == 3) {
        return read_out(reply, frame);
    }
    if (frame[1] == 6) {
        write_in(frame[0], word(frame + 2), frame + 4, 1);
        return seal(reply, 6);
    }
    if (frame[1] == 16) {
        write_in(frame[0], word(frame + 2), frame + 7, frame[6] / 2);
        return seal(reply, 6);
    }
    write_in(frame[0], word(frame + 6), frame + 11, frame[10] / 2);
    (void)count;
    return read_out(reply, frame);
}

static void judge(int64_t arrived_ns, int64_t limit_ns)
{
    if (last_ns != 0) {
        int64_t took_ns = arrived_ns - last_ns;
        bool early = arrived_ns - wire_free_ns < gap_ns - gap_ns / 20;
        violations += early && !was_late;
        excused += early && was_late;
        if (kept < KEPT_MAX) {
            parts[kept++] = (float)((double)last_limit_ns / (double)took_ns);
        }
        limits_ns += last_limit_ns;
    } else {
        first_ns = arrived_ns;
    }
    last_ns = arrived_ns;
    last_limit_ns = limit_ns;
    requests++;
}

static void answer(int fd, const uint8_t *frame, int count)
{
    uint8_t reply[FRAME_MAX];
    if (crc16(frame, count) != 0 || frame[0] == 0 || frame[0] >= UNITS) {
        bad_crc++;
        return;
    }
    int bytes = make_reply(reply, frame, count);
    judge(request_ns, (count + bytes) * character_ns + 2 * gap_ns);
    wire_free_ns = request_ns + (count + bytes) * character_ns + gap_ns;
    sleep_until(wire_free_ns);
    if (write(fd, reply, (size_t)bytes) != bytes) {
        exit(1);
    }
    int64_t handed_ns = now_ns();
    was_late = handed_ns - wire_free_ns > LATE_NS;
    wire_free_ns = handed_ns; /* the latest time at which the client has it */
}

static int by_size(const void *one, const void *other)
{
    float a = *(const float *)one, b = *(const float *)other;
    return (a > b) - (a < b);
}

static void print_stats(void)
{
    double span_ns = (double)(last_ns - first_ns);
    qsort(parts, kept, sizeof parts[0], by_size);
    printf(
        "{\"requests\": %llu, \"bad_crc\": %llu, \"violations\": %llu, \"excused\": %llu, "
        "\"fraction_p50\": %.4f, \"fraction_p01\": %.4f, \"throughput\": %.4f, \"per_s\": %.1f}\n",
        (unsigned long long)requests, (unsigned long long)bad_crc, (unsigned long long)violations,
        (unsigned long long)excused, kept > 0 ? (double)parts[kept / 2] : 0.0,
        kept > 0 ? (double)parts[kept / 100] : 0.0, span_ns > 0 ? (double)limits_ns / span_ns : 0.0,
        span_ns > 0 ? (double)(requests - 1) * 1e9 / span_ns : 0.0);
    fflush(stdout);
    kept = 0;
    requests = bad_crc = violations = excused = 0;
    limits_ns = first_ns = last_ns = 0;
}

static int open_pty(void)
{
    struct termios raw;
    int fd = posix_openpt(O_RDWR | O_NOCTTY);
    if (fd < 0 || grantpt(fd) != 0 || unlockpt(fd) != 0) {
        exit(1);
    }
    int other = open(ptsname(fd), O_RDWR | O_NOCTTY); /* open: no hang-up between two clients */
    tcgetattr(other, &raw);
    cfmakeraw(&raw);
    tcsetattr(other, TCSANOW, &raw);
    printf("%s\n", ptsname(fd));
    fflush(stdout);
    return fd;
}

static void serve(int fd)
{
    uint8_t frame[FRAME_MAX];
    int count = 0;
    for (;;) {
        struct pollfd fds[2] = {{.fd = fd, .events = POLLIN}, {.fd = 0, .events = POLLIN}};
        struct timespec silence = {.tv_nsec = 5000000};
        int ready = ppoll(fds, 2, count > 0 ? &silence : NULL, NULL);
        if (ready == 0) {
            bad_crc++; /* a frame that does not end */
            count = 0;
        }
        if ((fds[1].revents & (POLLIN | POLLHUP)) != 0) {
            char line[64];
            if (read(0, line, sizeof line) <= 0) {
                return;
            }
            if (line[0] == 'c') {
                printf("{\"changed_ns\": %lld}\n", (long long)changed_ns);
                fflush(stdout);
                changed_ns = 0;
            } else {
                print_stats();
            }
        }
        if ((fds[0].revents & POLLIN) != 0) {
            int64_t received_ns = now_ns();
            ssize_t came = read(fd, frame + count, sizeof frame - (size_t)count);
            request_ns = count == 0 ? received_ns : request_ns;
            count += came > 0 ? (int)came : 0;
            if (count >= request_bytes(frame, count)) {
                answer(fd, frame, count);
                count = 0;
            }
        }
    }
}

int main(int argc, char **argv)
{
    if (argc < 3) {
        fprintf(stderr, "usage: %s BAUDRATE GAP_US [PRIORITY]\n", argv[0]);
        return 2;
    }
    character_ns = (int64_t)(10e9 / atof(argv[1]));
    gap_ns = (int64_t)(atof(argv[2]) * 1e3);
    struct sched_param param = {.sched_priority = argc > 3 ? atoi(argv[3]) : 0};
    prctl(PR_SET_TIMERSLACK, 1UL, 0UL, 0UL, 0UL);
    if (param.sched_priority > 0 && sched_setscheduler(0, SCHED_FIFO, &param) != 0) {
        fprintf(stderr, "no SCHED_FIFO: %s\n", strerror(errno));
    }
    mlockall(MCL_CURRENT);
    int32_t latency_us = 0; /* motord's daemon sets this, too; here it helps all masters */
    int awake = open("/dev/cpu_dma_latency", O_WRONLY);
    if (awake < 0 || write(awake, &latency_us, sizeof latency_us) < 0) {
        fprintf(stderr, "the CPUs may sleep deeply: %s\n", strerror(errno));
    }
    for (int unit = 0; unit < UNITS; unit++) {
        memset(registers[unit], 0, sizeof registers[unit]);
    }
    serve(open_pty());
    return 0;
}
