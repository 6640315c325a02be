/* SPDX-License-Identifier: Apache-2.0
 * Sends one command every 20 ms: cc -o send_command send_command.c
 * ./send_command SOCKET TOKEN V_M_S W_RAD_S COUNT     with socket and token as `lease` has
 *                                                     answered (docs/commands.md) */
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <time.h>
#include <unistd.h>

struct command {
    uint32_t magic;
    uint16_t version, kind;
    uint8_t token[16];
    uint64_t sequence;
    int64_t stamp_ns;
    uint32_t lifetime_ms, reserved;
    double linear_m_s, angular_rad_s;
};

static int64_t now_ns(void)
{
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (int64_t)now.tv_sec * 1000000000 + now.tv_nsec;
}

int main(int argc, char **argv)
{
    if (argc != 6 || strlen(argv[2]) != 32) {
        fprintf(stderr, "usage: %s SOCKET TOKEN V_M_S W_RAD_S COUNT\n", argv[0]);
        return 2;
    }
    struct sockaddr_un to = {.sun_family = AF_UNIX};
    struct command command = {.magic = 0x434D544D,
                              .version = 1,
                              .kind = 1,
                              .linear_m_s = atof(argv[3]),
                              .angular_rad_s = atof(argv[4])};
    strncpy(to.sun_path, argv[1], sizeof to.sun_path - 1);
    for (int i = 0; i < 16; i++) {
        char digits[3] = {argv[2][2 * i], argv[2][2 * i + 1], 0};
        command.token[i] = (uint8_t)strtoul(digits, NULL, 16);
    }
    int fd = socket(AF_UNIX, SOCK_DGRAM, 0);
    for (int left = atoi(argv[5]); left > 0; left--) {
        command.sequence++;
        command.stamp_ns = now_ns();
        if (sendto(fd, &command, sizeof command, 0, (struct sockaddr *)&to, sizeof to) !=
            sizeof command) {
            perror(argv[1]);
            return 1;
        }
        usleep(20000);
    }
    close(fd);
    return 0;
}
