/* SPDX-License-Identifier: Apache-2.0
 * The thread of a board on a port that takes little, is full, or fails: no frame is torn, none goes
 * out behind older ones, and a new command does not wait for its cycle. */
#include <errno.h>
#include <stdarg.h>
#include <sys/ioctl.h>
#include <sys/syscall.h>

#include "board_wire.h"
#include "thread_sides.h"

enum { WIRE_BYTES = 1 << 20, FRAME_BYTES = 8 };

static const int64_t LONG_NS = INT64_C(100000000000);

/* The port: what it takes of a write, what its driver holds, the error that it returns next. */
static struct {
    _Atomic uint32_t takes;   /* bytes of one write; 0: it is full */
    _Atomic uint32_t waiting; /* bytes in the driver's queue */
    _Atomic int fails_once, fails;
    _Atomic bool no_queue; /* the driver does not report its queue */
    _Atomic uint32_t writes, written;
    _Atomic uint32_t frame_bytes; /* of the newest frame that was begun */
    char wire[WIRE_BYTES];
} port;

/* Replaces the C library's function, for the port. */
ssize_t write(int fd, const void *bytes, size_t count)
{
    if (fd != ends[0]) {
        return syscall(SYS_write, fd, bytes, count);
    }
    int error = atomic_exchange(&port.fails_once, 0);
    error = error != 0 ? error : port.fails;
    if (error == 0 && port.takes == 0) {
        error = EAGAIN;
    }
    if (error != 0) {
        errno = error;
        return -1;
    }
    uint32_t went = count < port.takes ? (uint32_t)count : port.takes, at = port.written;
    CHECK(at + went < WIRE_BYTES);
    memcpy(port.wire + at, bytes, went);
    port.writes++;
    port.written = at + went;
    return went;
}

/* Replaces the C library's function, for the port's queue. */
int ioctl(int fd, unsigned long request, ...)
{
    va_list more;
    va_start(more, request);
    int *waiting = va_arg(more, int *);
    va_end(more);
    if (fd != ends[0] || request != TIOCOUTQ || port.no_queue) {
        errno = ENOTTY;
        return -1;
    }
    *waiting = (int)port.waiting;
    return 0;
}

static board_report report(void)
{
    board_report out;
    CHECK(board_read_report(0, &out) == 0);
    return out;
}

static void put(double velocity_rad_s)
{
    const uint64_t one = 1;
    setpoints newest = {.stamp_ns = clock_now_ns(), .enabled = 1, .joint_count = 2};
    newest.joint[0].velocity_rad_s = newest.joint[1].velocity_rad_s = velocity_rad_s;
    CHECK(exchange_put_setpoints(&shared, 0, &newest) == 0);
    CHECK(syscall(SYS_write, exchange_line_wake(&shared, 0), &one, sizeof one) == sizeof one);
}

/* A board that is sent lines of text as "+255,+255\n", each joint the same number. */
static void begin_thread(int64_t period_ns)
{
    board_table table = text_table(false);
    table.period_ns = period_ns;
    table.setpoint_timeout_ns = LONG_NS;
    memset(&port, 0, sizeof port);
    port.takes = BOARD_WIRE_MAX;
    exchange_init(&shared);
    CHECK(socketpair(AF_UNIX, SOCK_STREAM | SOCK_NONBLOCK, 0, ends) == 0);
    board_config config = {.at = place_of_the_thread()};
    CHECK(board_start(0, &config, &table) == 0);
    board_put_control(0, &(board_control){.request = {.count = 1, .mode = DRIVE_READY}});
    WAIT_UNTIL(report().mode == DRIVE_READY && exchange_line_wake(&shared, 0) >= 0);
    put(0.0);
    board_put_control(0, &(board_control){.request = {.count = 2, .mode = DRIVE_ARMED}});
    WAIT_UNTIL(report().mode == DRIVE_ARMED);
    CHECK(a_thread_is_called("motord-board"));
}

static void end_thread(void)
{
    CHECK(board_stop(0) == 0);
    CHECK(close(ends[0]) == 0 && close(ends[1]) == 0);
}

/* Returns the number of whole lines on the wire, and checks each: both numbers are the same. */
static uint32_t whole_frames(void)
{
    uint32_t frames = 0, from = 0;
    for (uint32_t at = 0; at < port.written; at++) {
        if (port.wire[at] != '\n') {
            continue;
        }
        char line[64] = {0};
        CHECK(at - from < sizeof line);
        memcpy(line, port.wire + from, at - from);
        char *comma = strchr(line, ',');
        CHECK(comma != NULL && comma != line && strlen(line) == 2 * (size_t)(comma - line) + 1);
        CHECK(strncmp(line, comma + 1, (size_t)(comma - line)) == 0);
        from = at + 1;
        frames++;
    }
    return frames;
}

static void a_frame_that_the_port_takes_in_pieces_is_not_torn(void)
{
    begin_thread(MS);
    for (uint32_t takes = 1; takes < 6; takes++) {
        port.takes = takes;
        uint32_t before = whole_frames();
        for (int i = 0; whole_frames() < before + 10; i++) {
            put(i % 2 == 0 ? 1.0 : 0.0);
            (void)poll(NULL, 0, 1);
        }
    }
    CHECK(report().no_room > 0);
    end_thread();
    (void)whole_frames();
}

static void a_frame_is_finished_although_the_queue_is_full_behind_it(void)
{
    begin_thread(MS);
    port.takes = 2;
    uint32_t writes = port.writes;
    WAIT_UNTIL(port.writes > writes);
    port.waiting = 1000;
    WAIT_UNTIL(port.written > 0 && port.wire[port.written - 1] == '\n');
    uint64_t refused = report().no_room;
    writes = port.writes;
    WAIT_UNTIL(report().no_room > refused + 3 || port.writes > writes);
    CHECK(port.writes == writes);
    end_thread();
}

static void nothing_goes_out_behind_more_than_two_waiting_frames(void)
{
    begin_thread(MS);
    WAIT_UNTIL(report().sent > 3);
    const uint32_t frame = (uint32_t)strlen("0,0\n");
    port.waiting = 2 * frame + 1;
    uint64_t refused = report().no_room;
    WAIT_UNTIL(report().no_room > refused + 1);
    uint32_t writes = port.writes;
    refused = report().no_room;
    WAIT_UNTIL(report().no_room > refused + 5 || port.writes > writes);
    CHECK(port.writes == writes);
    port.waiting = 2 * frame;
    uint64_t sent = report().sent;
    WAIT_UNTIL(report().sent > sent + 5);
    port.waiting = 1000;
    port.no_queue = true;
    sent = report().sent;
    WAIT_UNTIL(report().sent > sent + 5);
    (void)whole_frames();
    end_thread();
}

static void a_stop_goes_out_as_soon_as_the_full_port_takes_bytes(void)
{
    begin_thread(MS);
    put(1.0);
    WAIT_UNTIL(report().sent_motion != 0);
    port.takes = 0;
    uint64_t refused = report().no_room;
    put(0.0);
    WAIT_UNTIL(report().no_room > refused + 3);
    CHECK(report().sent_motion != 0 && report().life.running != 0);
    uint32_t written = port.written;
    port.takes = BOARD_WIRE_MAX;
    WAIT_UNTIL(report().sent_motion == 0);
    CHECK(memcmp(port.wire + written, "0,0\n", 4) == 0);
    end_thread();
}

static void an_interrupted_write_is_repeated_and_a_failed_one_ends_the_thread(void)
{
    begin_thread(MS);
    WAIT_UNTIL(report().sent > 3);
    uint64_t refused = report().no_room;
    port.fails_once = EINTR;
    WAIT_UNTIL(port.fails_once == 0);
    uint64_t sent = report().sent;
    WAIT_UNTIL(report().sent > sent + 3);
    CHECK(report().no_room == refused && report().life.running != 0);
    port.fails = ENODEV;
    WAIT_UNTIL(report().life.running == 0);
    CHECK(report().life.error == ENODEV);
    end_thread();
}

static void a_new_command_does_not_wait_for_the_cycle(void)
{
    begin_thread(LONG_NS);
    put(1.0);
    WAIT_UNTIL(report().sent_motion != 0);
    put(0.0);
    WAIT_UNTIL(report().sent_motion == 0);
    CHECK(whole_frames() <= 6);
    end_thread();
}

/* Each round has a cause: a cycle or a look after 5 ms, a wake-up, bytes. */
static void a_woken_thread_sleeps_again(void)
{
    begin_thread(LONG_NS);
    board_report before = report();
    int64_t begin_ns = clock_now_ns();
    put(1.0);
    put(0.5);
    WAIT_UNTIL(report().life.rounds > before.life.rounds + 20);
    uint64_t rounds = report().life.rounds - before.life.rounds;
    CHECK(rounds <= (uint64_t)((clock_now_ns() - begin_ns) / MS) + 30);
    end_thread();
}

static void a_board_that_another_program_left_running_gets_a_quick_stop_first(void)
{
    board_table table = frames_table();
    memset(&port, 0, sizeof port);
    port.takes = BOARD_WIRE_MAX;
    exchange_init(&shared);
    CHECK(socketpair(AF_UNIX, SOCK_STREAM | SOCK_NONBLOCK, 0, ends) == 0);
    board_config config = {.at = place_of_the_thread(), .left_running = 1};
    CHECK(board_start(LINES_MAX, &config, &table) == -EINVAL);
    CHECK(board_start(0, &config, &table) == 0);
    WAIT_UNTIL(port.written > 0 && memchr(port.wire + 1, 0, port.written - 1) != NULL);
    const char *end = memchr(port.wire + 1, 0, port.written - 1);
    uint8_t raw[BOARD_FRAME_MAX];
    uint32_t bytes = (uint32_t)(end - port.wire) - 1;
    CHECK(board_frame_parse((const uint8_t *)port.wire + 1, bytes, raw) > 0);
    CHECK(raw[BOARD_HEAD_BYTES + CONTROL] == CONTROL_BRAKE);
    CHECK(report().mode == DRIVE_READY && report().stopping == 1);
    end_thread();
    board_report out;
    CHECK(board_stop(LINES_MAX) == -ESRCH && board_read_report(LINES_MAX, &out) == -ESRCH);
}

static void an_order_that_is_not_good_reaches_no_board(void)
{
    begin_thread(MS);
    const board_order good = {.write = {.place = at(0, 4, 1), .raw = 0}};
    board_order order = good;
    order.write.place.byte = 5;
    CHECK(board_put_order(0, &order) == -EINVAL);
    order = good;
    order.write.place.bytes = 0;
    CHECK(board_put_order(0, &order) == -EINVAL);
    order.write.place.bytes = 9;
    CHECK(board_put_order(0, &order) == -EINVAL);
    CHECK(board_put_order(1, &good) == -ESRCH && board_put_order(LINES_MAX, &good) == -ESRCH);
    CHECK(report().orders_sent == 0 && report().orders_dropped == 0);
    CHECK(board_put_order(0, &good) == 0);
    WAIT_UNTIL(report().orders_sent == 1);
    end_thread();
    CHECK(board_put_order(0, &good) == -ESRCH);
}

int main(void)
{
    a_frame_that_the_port_takes_in_pieces_is_not_torn();
    a_frame_is_finished_although_the_queue_is_full_behind_it();
    nothing_goes_out_behind_more_than_two_waiting_frames();
    a_stop_goes_out_as_soon_as_the_full_port_takes_bytes();
    an_interrupted_write_is_repeated_and_a_failed_one_ends_the_thread();
    a_new_command_does_not_wait_for_the_cycle();
    a_woken_thread_sleeps_again();
    a_board_that_another_program_left_running_gets_a_quick_stop_first();
    an_order_that_is_not_good_reaches_no_board();
    return checks_report("board port");
}
