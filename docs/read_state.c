/* SPDX-License-Identifier: Apache-2.0
 * Prints the robot's state once:   gcc -Icsrc docs/read_state.c -o read_state && ./read_state
 *                                   /run/motord/demo.page */
#include <fcntl.h>
#include <inttypes.h>
#include <stdio.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <time.h>
#include "rt.h"

int main(int argc, char **argv)
{
    const char *path = argc > 1 ? argv[1] : "/run/motord/demo.page",
               magic[8] = {'M', 'O', 'T', 'O', 'R', 'D', 0, 1};
    struct stat file = {0};
    int fd = open(path, O_RDONLY);
    if (fd < 0 || fstat(fd, &file) != 0 || file.st_size < PAGE_BYTES) {
        return fprintf(stderr, "%s: no page there\n", path), 1;
    }
    const uint8_t *page = mmap(NULL, PAGE_BYTES, PROT_READ, MAP_SHARED, fd, 0);
    /* 2 layout, 3 payload, 4 slots, 5 stride, 6 offset, 7 pid */
    const uint32_t *head = (const uint32_t *)page;
    /* a damaged header must not lead past the end of the mapping */
    if (page == MAP_FAILED || memcmp(page, magic, sizeof magic) != 0 ||
        head[2] != PAGE_LAYOUT_VERSION || head[3] < sizeof(robot_state) || head[4] == 0 ||
        head[5] % 8 != 0 || head[6] % 8 != 0 || head[5] < 8 || head[5] - 8 < head[3] ||
        head[6] < 64 || head[6] > PAGE_BYTES || head[4] > (PAGE_BYTES - head[6]) / head[5]) {
        return fprintf(stderr, "%s: not a page that this program knows\n", path), 1;
    }
    for (int try = 0; try < 100; try++) {
        robot_state state = {0};
        uint64_t number = __atomic_load_n((const uint64_t *)(page + 32), __ATOMIC_ACQUIRE);
        if (number == 0) {
            continue; /* no tick yet */
        }
        const uint64_t *slot =
            (const uint64_t *)(page + head[6] + (number - 1) % head[4] * head[5]);
        if (__atomic_load_n(&slot[0], __ATOMIC_ACQUIRE) != 2 * number) {
            continue;
        }
        for (size_t i = 0; i < sizeof state / 8; i++) {
            uint64_t word = __atomic_load_n(&slot[1 + i], __ATOMIC_ACQUIRE);
            memcpy((char *)&state + 8 * i, &word, 8);
        }
        if (__atomic_load_n(&slot[0], __ATOMIC_RELAXED) != 2 * number) {
            continue; /* overtaken: take the newer one */
        }
        struct timespec now;
        clock_gettime(CLOCK_MONOTONIC, &now);
        double age_s =
            (double)(now.tv_sec * INT64_C(1000000000) + now.tv_nsec - state.stamp_ns) * 1e-9;
        return printf("tick %" PRIu64
                      " x_m %.17g y_m %.17g heading_rad %.17g armed %u faults %u age_s %.6f\n",
                      state.tick, state.x_m, state.y_m, state.heading_rad, state.armed,
                      state.faults, age_s) < 0;
    }
    return fprintf(stderr, "%s: no whole snapshot in 100 tries\n", path), 1;
}
