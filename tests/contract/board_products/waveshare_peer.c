/* SPDX-License-Identifier: Apache-2.0
 *
 * waveshare_peer FD: the driver board of a Waveshare UGV, on the master side of a pty. It was
 * written only from the firmware's sources (waveshareteam/ugv_base_ros: json_cmd.h, uart_ctrl.h,
 * ugv_advance.h, movtion_module.h): lines of JSON, wheels that follow at once, odometers in whole
 * centimetres, a heartbeat of 3 s unless T 136 sets another, feedback after T 131 has switched it
 * on. 'm' on stdin makes it mute, 'w' normal again. When its motors change it prints a line: left
 * and right mm/s, and 1 after the heartbeat has stopped them.
 */
#include <fcntl.h>
#include <poll.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

static double left_m_s, right_m_s, left_m, right_m;
static long heartbeat_ms = 3000, interval_ms;
static long last_command_ms;
static int flows;

static long now_ms(void)
{
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return now.tv_sec * 1000 + now.tv_nsec / 1000000;
}

/* Reads the number with this name like ArduinoJson; 0 if it is missing. */
static double number_of(const char *line, const char *name)
{
    const char *found = strstr(line, name);
    return found == NULL ? 0.0 : strtod(found + strlen(name), NULL);
}

static void obey(const char *line)
{
    switch ((int)number_of(line, "\"T\":")) {
    case 1:
        left_m_s = number_of(line, "\"L\":");
        right_m_s = number_of(line, "\"R\":");
        last_command_ms = now_ms();
        break;
    case 131: flows = number_of(line, "\"cmd\":") > 0.0; break;
    case 136: heartbeat_ms = (long)number_of(line, "\"cmd\":"); break;
    case 142: interval_ms = (long)number_of(line, "\"cmd\":"); break;
    default: break;
    }
}

static void receive(int fd)
{
    static char line[256];
    static size_t count;
    char bytes[512];
    const ssize_t size = read(fd, bytes, sizeof bytes);
    for (ssize_t i = 0; i < size; i++) {
        if (bytes[i] == '\n') {
            line[count] = '\0';
            obey(line);
            count = 0;
        } else if (count < sizeof line - 1) {
            line[count++] = bytes[i];
        }
    }
}

static void say(int fd)
{
    char line[512];
    const int size =
        snprintf(line, sizeof line,
                 "{\"T\":1001,\"L\":%g,\"R\":%g,\"ax\":-12,\"ay\":3,\"az\":8190,\"gx\":0,\"gy\":-1,"
                 "\"gz\":2,\"mx\":211,"
                 "\"my\":-87,\"mz\":400,\"odl\":%ld,\"odr\":%ld,\"v\":%d}\r\n",
                 left_m_s, right_m_s, (long)(left_m * 100.0), (long)(right_m * 100.0), 1187);
    if (write(fd, line, (size_t)size) < 0) {
        usleep(1000); /* no program has opened the other end */
    }
}

int main(int argc, char **argv)
{
    const int fd = argc > 1 ? atoi(argv[1]) : -1;
    int last[3] = {0, 0, -1}, mute = 0;
    long before_ms = now_ms(), reported_ms = 0;
    (void)fcntl(fd, F_SETFL, O_NONBLOCK);
    for (;;) {
        struct pollfd in = {.fd = 0, .events = POLLIN};
        char letter = 0;
        if (poll(&in, 1, 2) > 0 && read(0, &letter, 1) <= 0) {
            return 0;
        }
        mute = letter == 'm' ? 1 : letter == 'w' ? 0 : mute;
        receive(fd);
        const long at_ms = now_ms();
        const int late = at_ms - last_command_ms > heartbeat_ms;
        left_m_s = late ? 0.0 : left_m_s;
        right_m_s = late ? 0.0 : right_m_s;
        left_m += left_m_s * (double)(at_ms - before_ms) * 1e-3;
        right_m += right_m_s * (double)(at_ms - before_ms) * 1e-3;
        before_ms = at_ms;
        const int now[3] = {(int)(left_m_s * 1000.0), (int)(right_m_s * 1000.0), late};
        if (memcmp(now, last, sizeof now) != 0) {
            printf("%d %d %d\n", now[0], now[1], now[2]);
            fflush(stdout);
            memcpy(last, now, sizeof now);
        }
        if (flows && !mute && at_ms - reported_ms >= interval_ms && at_ms > reported_ms) {
            reported_ms = at_ms;
            say(fd);
        }
    }
}
