/* SPDX-License-Identifier: Apache-2.0
 * The thread of a board on a socket pair. The reference board, asyncio and the loop are threads,
 * too, so that sanitizers find data races. The threads share only what api_board.h and the exchange
 * pass on. */
#include <errno.h>

#include "board_wire.h"
#include "thread_sides.h"

/* Does what the loop of docs/mcu/motord_mcu.ino does. `arg` counts how often a wheel was to
 * turn. */
static void *sketch(void *arg)
{
    unsigned long *turned = arg;
    motord_board board;
    motord_measured measured[MOTORS] = {{0}};
    motord_health health = {.voltage_10mv = 2400};
    motord_board_init(&board, MOTORS, (uint32_t)(clock_now_ns() / 1000));
    while (!over) {
        uint8_t in[256], out[MOTORD_SENT_BYTES_MAX];
        uint32_t now_us = (uint32_t)(clock_now_ns() / 1000);
        ssize_t count = recv(ends[1], in, sizeof in, MSG_DONTWAIT);
        for (ssize_t i = 0; i < count; i++) {
            motord_board_byte(&board, in[i], now_us);
        }
        size_t size = motord_board_feedback(&board, now_us, measured, &health, out);
        if (size > 0) {
            (void)send(ends[1], out, size, MSG_DONTWAIT | MSG_NOSIGNAL);
        }
        *turned += board.setpoint[0].velocity_mrad_s == 1000;
        (void)poll(NULL, 0, 1);
    }
    return NULL;
}

static board_report wait_for(uint32_t mode)
{
    board_report report;
    int64_t begin_ns = clock_now_ns();
    do {
        look_again(begin_ns);
        CHECK(board_read_report(0, &report) == 0);
    } while (report.life.running != 0 && report.mode != mode);
    return report;
}

static void write_out(uint32_t byte, uint32_t bytes, int64_t raw)
{
    board_report report;
    board_order order = {.write = {.place = at(byte, bytes, 0), .raw = raw}};
    CHECK(board_read_report(0, &report) == 0);
    uint32_t before = report.orders_sent;
    CHECK(board_put_order(0, &order) == 0);
    do {
        (void)poll(NULL, 0, 1);
        CHECK(board_read_report(0, &report) == 0 && report.life.running != 0);
    } while (report.orders_sent == before || report.knows_ns < report.written_ns);
}

static void a_line_is_set_up_armed_and_stopped(void)
{
    board_control control = {
        .request = {.count = 1, .mode = DRIVE_READY, .arming_until_ns = INT64_MAX}};
    write_out(CONTROL, 1, CONTROL_RESTART_NOTED);
    write_out(WATCHDOG, 2, WATCHDOG_MS);
    board_put_control(0, &control);
    (void)wait_for(DRIVE_READY);
    write_out(CONTROL, 1, CONTROL_ENABLE);
    control.request.count = 2;
    control.request.mode = DRIVE_ARMED;
    board_put_control(0, &control);
    board_report report = wait_for(DRIVE_ARMED);
    uint64_t received = report.received;
    while (report.mode == DRIVE_ARMED && report.received < received + 50) {
        report = wait_for(DRIVE_ARMED);
    }
    histogram trips;
    CHECK(board_histogram_read(0, &trips) == 0 && trips.samples > 0);
    control.shut_down = 1;
    board_put_control(0, &control);
    int64_t begin_ns = clock_now_ns();
    do {
        look_again(begin_ns);
        CHECK(board_read_report(0, &report) == 0);
    } while (report.shut_down == 0);
    CHECK(board_stop(0) == 0 && board_stop(0) == -ESRCH);
}

int main(void)
{
    pthread_t loop, peer;
    unsigned long turned = 0;
    board_table table = frames_table();
    table.silence_ns = 5000 * MS; /* long, because a sanitizer makes everything slow */
    table.setpoint_timeout_ns = 5000 * MS;
    exchange_init(&shared);
    CHECK(socketpair(AF_UNIX, SOCK_STREAM | SOCK_NONBLOCK, 0, ends) == 0);
    board_config config = {.at = place_of_the_thread()};
    CHECK(pthread_create(&loop, NULL, core, NULL) == 0 &&
          pthread_create(&peer, NULL, sketch, &turned) == 0);
    CHECK(board_start(0, &config, &table) == 0 && board_start(0, &config, &table) == -EBUSY);
    a_line_is_set_up_armed_and_stopped();
    CHECK(board_start(0, &config, &table) == 0);
    over = true;
    CHECK(pthread_join(loop, NULL) == 0 && pthread_join(peer, NULL) == 0);
    CHECK(turned > 0);
    CHECK(close(ends[1]) == 0);
    int32_t error = wait_for(DRIVE_ARMED).life.error;
    /* the other end is closed: the thread reports it and ends */
    CHECK(error == EIO || error == EPIPE);
    CHECK(board_stop(0) == 0);
    return checks_report("board thread");
}
