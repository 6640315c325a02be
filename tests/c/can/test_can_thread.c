/* SPDX-License-Identifier: Apache-2.0
 * The thread of a CAN bus on a socket pair. Asyncio and the loop are threads, too, so that
 * sanitizers find data races. The threads share only what api_can.h and the exchange pass on. */
#include <errno.h>
#include <linux/can.h>

#include "can_wire.h"
#include "thread_sides.h"

/* The side of the drive: sends state and motion, and counts the frames that it receives. */
static void *drive(void *arg)
{
    unsigned long *received = arg;
    while (!over) {
        struct can_frame state = {.can_id = STATE, .can_dlc = 1, .data = {8}};
        struct can_frame motion = {.can_id = MOTION, .can_dlc = 8};
        struct canfd_frame in;
        (void)send(ends[1], &state, sizeof state, MSG_DONTWAIT);
        (void)send(ends[1], &motion, sizeof motion, MSG_DONTWAIT);
        while (recv(ends[1], &in, sizeof in, MSG_DONTWAIT) > 0) {
            (*received)++;
        }
        (void)poll(NULL, 0, 1);
    }
    return NULL;
}

static can_report wait_for(uint32_t mode)
{
    can_report report;
    int64_t begin_ns = clock_now_ns();
    do {
        look_again(begin_ns);
        CHECK(can_read_report(0, &report) == 0);
    } while (report.life.running != 0 && report.drive[0].mode != mode);
    return report;
}

static void a_line_is_set_up_armed_ordered_and_stopped(void)
{
    can_control control = {.listen = 1};
    control.drive[0] =
        (mode_request){.count = 1, .mode = DRIVE_READY, .arming_until_ns = INT64_MAX};
    can_put_control(0, &control);
    (void)wait_for(DRIVE_READY);
    control.drive[0].count = 2;
    control.drive[0].mode = DRIVE_ARMED;
    can_put_control(0, &control);
    (void)wait_for(DRIVE_ARMED);
    can_order order = {.write = {.packet = packet_of(CONTROL, 1)}};
    unsigned ordered = 0, taken = 0;
    while (ordered < 200 || taken < 200) {
        can_received received;
        order.expires_ns = clock_now_ns() + 100 * MS;
        ordered += can_put_order(0, &order) == 0;
        taken += can_take_received(0, &received) != 0;
        (void)poll(NULL, 0, 1);
    }
    control.shut_down = 1;
    can_put_control(0, &control);
    can_report report;
    int64_t begin_ns = clock_now_ns();
    do {
        look_again(begin_ns);
        CHECK(can_read_report(0, &report) == 0);
    } while (report.shut_down == 0);
    CHECK(can_stop(0) == 0 && can_stop(0) == -ESRCH);
}

int main(void)
{
    pthread_t loop, peer;
    unsigned long received = 0;
    begin_with(1);
    exchange_init(&shared);
    CHECK(socketpair(AF_UNIX, SOCK_SEQPACKET | SOCK_NONBLOCK, 0, ends) == 0);
    can_config config = {.at = place_of_the_thread()};
    CHECK(pthread_create(&loop, NULL, core, NULL) == 0 &&
          pthread_create(&peer, NULL, drive, &received) == 0);
    CHECK(can_start(0, &config, &w.table) == 0 && can_start(0, &config, &w.table) == -EBUSY);
    a_line_is_set_up_armed_ordered_and_stopped();
    CHECK(can_start(0, &config, &w.table) == 0);
    over = true;
    CHECK(pthread_join(loop, NULL) == 0 && pthread_join(peer, NULL) == 0);
    CHECK(received > 200);
    CHECK(close(ends[1]) == 0);
    /* the other end is closed: the thread reports it and ends */
    CHECK(wait_for(DRIVE_ARMED).life.error == ENODEV);
    CHECK(can_stop(0) == 0);
    return checks_report("can thread");
}
