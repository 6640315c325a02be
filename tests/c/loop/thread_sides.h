/* SPDX-License-Identifier: Apache-2.0
 * thread_sides.h: the loop's part for the thread of a line, and the socket pair that replaces its
 * medium. */
#ifndef MOTORD_TESTS_THREAD_SIDES_H
#define MOTORD_TESTS_THREAD_SIDES_H

#include <poll.h>
#include <pthread.h>
#include <stdatomic.h>
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

/* Waits a moment; fails later than 20 s after `begin_ns`. */
static inline void look_again(int64_t begin_ns)
{
    CHECK(clock_now_ns() < begin_ns + INT64_C(20000000000));
    (void)poll(NULL, 0, 1);
}

#endif
