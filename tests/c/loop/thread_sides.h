/* SPDX-License-Identifier: Apache-2.0
 * thread_sides.h: the loop's part for the thread of a line, and the socket pair that replaces its
 * medium. */
#ifndef MOTORD_TESTS_THREAD_SIDES_H
#define MOTORD_TESTS_THREAD_SIDES_H

#include <dirent.h>
#include <poll.h>
#include <pthread.h>
#include <stdatomic.h>
#include <string.h>
#include <sys/eventfd.h>
#include <sys/socket.h>
#include <unistd.h>

#include "check.h"
#include "exchange.h"

static exchange shared;
static _Atomic bool over;
static int ends[2]; /* 0: the end of the thread, 1: that of its peer */

/* Sends set-points that are fresh and not zero. */
static inline void *core(void *arg)
{
    (void)arg;
    while (!over) {
        setpoints out = {.stamp_ns = clock_now_ns(), .enabled = 1, .joint_count = JOINTS_MAX};
        out.joint[0].velocity_rad_s = 1.0;
        (void)exchange_put_setpoints(&shared, 0, &out);
        joint_feedback feedback;
        (void)exchange_take_feedback(&shared, 0, &feedback);
        (void)poll(NULL, 0, 1);
    }
    return NULL;
}

static inline line_place place_of_the_thread(void)
{
    return (line_place){.fd = ends[0], .event_fd = eventfd(0, EFD_NONBLOCK), .exchange = &shared};
}

/* Whether a thread of this process has this name. */
static inline bool a_thread_is_called(const char *name)
{
    char path[300], found[32];
    bool any = false;
    DIR *tasks = opendir("/proc/self/task");
    CHECK(tasks != NULL);
    for (struct dirent *task = readdir(tasks); task != NULL; task = readdir(tasks)) {
        (void)snprintf(path, sizeof path, "/proc/self/task/%s/comm", task->d_name);
        FILE *file = fopen(path, "r");
        if (file != NULL) {
            bool read = fgets(found, sizeof found, file) != NULL;
            any |= read && strncmp(found, name, strlen(name)) == 0 &&
                   strcmp(found + strlen(name), "\n") == 0;
            CHECK(fclose(file) == 0);
        }
    }
    CHECK(closedir(tasks) == 0);
    return any;
}

static const int64_t WAIT_NS = INT64_C(20000000000);

/* Waits a moment; fails later than WAIT_NS after `begin_ns`. */
static inline void look_again(int64_t begin_ns)
{
    CHECK(clock_now_ns() < begin_ns + WAIT_NS);
    (void)poll(NULL, 0, 1);
}

#define WAIT_UNTIL(condition)                                                                      \
    do {                                                                                           \
        for (int64_t since_ns = clock_now_ns(); !(condition); (void)poll(NULL, 0, 1)) {            \
            CHECK(clock_now_ns() < since_ns + WAIT_NS || !#condition);                             \
        }                                                                                          \
    } while (0)

#endif
