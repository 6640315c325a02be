/* SPDX-License-Identifier: Apache-2.0
 * The thread of a CAN bus on a socket that is full, has an error, or whose stamps come from a clock
 * that was set: frames keep the time when they came, and a new command does not wait for its
 * cycle. */
#include <errno.h>
#include <fcntl.h>
#include <linux/can.h>
#include <netinet/in.h>
#include <sys/syscall.h>
#include <time.h>

#include "can_wire.h"
#include "thread_sides.h"

enum { FRAMES_OF_A_BATCH = 32 };

static const int64_t LONG_NS = INT64_C(100000000000), LONG_AGO_NS = INT64_C(10000000000);
static const int64_t NO_STAMP = INT64_MIN;

/* The socket, and the times of its calls. */
static struct {
    _Atomic int64_t shown_age_ns; /* of frames by their stamp; NO_STAMP: they have none */
    _Atomic bool hides;           /* it delivers no frame and no error */
    _Atomic bool confirms;        /* what it delivers was sent by the thread itself */
    _Atomic int fails_once;
    _Atomic int send_fails; /* errno of each send; 0: it takes frames */
    _Atomic int64_t stamped_ns, returned_ns;
    /* the newest two calls that left it empty, and the two before the newest frames */
    _Atomic int64_t emptied_ns[2], before_ns[2];
} bus;

static int64_t wall_ns(void)
{
    struct timespec wall;
    CHECK(clock_gettime(CLOCK_REALTIME, &wall) == 0);
    return (int64_t)wall.tv_sec * 1000000000 + wall.tv_nsec;
}

static void put_stamp(struct msghdr *message, int64_t stamp_ns)
{
    struct timespec stamp = {.tv_sec = stamp_ns / 1000000000, .tv_nsec = stamp_ns % 1000000000};
    message->msg_controllen = CMSG_SPACE(sizeof stamp);
    struct cmsghdr *one = CMSG_FIRSTHDR(message);
    one->cmsg_level = SOL_SOCKET;
    one->cmsg_type = SO_TIMESTAMPNS;
    one->cmsg_len = CMSG_LEN(sizeof stamp);
    memcpy(CMSG_DATA(one), &stamp, sizeof stamp);
}

static void note_call(int64_t called_ns, bool delivered, bool emptied)
{
    bus.returned_ns = delivered ? clock_now_ns() : (int64_t)bus.returned_ns;
    for (int i = 0; delivered && i < 2; i++) {
        bus.before_ns[i] = (int64_t)bus.emptied_ns[i];
    }
    if (emptied) {
        bus.emptied_ns[1] = (int64_t)bus.emptied_ns[0];
        bus.emptied_ns[0] = called_ns;
    }
}

/* Replaces the C library's function: adds the stamps that a socket pair does not have. */
int recvmmsg(int fd, struct mmsghdr *message, unsigned count, int flags, struct timespec *timeout)
{
    int64_t called_ns = clock_now_ns();
    int error = atomic_exchange(&bus.fails_once, 0), got = -1;
    error = error == 0 && bus.hides ? EAGAIN : error;
    if (error == 0) {
        got = (int)syscall(SYS_recvmmsg, fd, message, count, flags, timeout);
        error = got < 0 ? errno : 0;
    }
    bus.stamped_ns = got > 0 ? clock_now_ns() : (int64_t)bus.stamped_ns;
    for (int i = 0; i < got; i++) {
        if (bus.shown_age_ns != NO_STAMP) {
            put_stamp(&message[i].msg_hdr, wall_ns() - bus.shown_age_ns);
        }
        message[i].msg_hdr.msg_flags |= bus.confirms ? MSG_CONFIRM : 0;
    }
    note_call(called_ns, got > 0, got < 0 ? error == EAGAIN : got < (int)count);
    errno = error;
    return got;
}

/* Replaces the C library's function: a bus that takes no frame. */
ssize_t send(int fd, const void *bytes, size_t count, int flags)
{
    if (fd == ends[0] && bus.send_fails != 0) {
        errno = bus.send_fails;
        return -1;
    }
    return syscall(SYS_sendto, fd, bytes, count, flags, NULL, 0);
}

static can_report report(void)
{
    can_report out;
    CHECK(can_read_report(0, &out) == 0);
    return out;
}

static bool left_running;

static void begin_on(int own, int other, int64_t period_ns)
{
    ends[0] = own;
    ends[1] = other;
    memset(&bus, 0, sizeof bus);
    begin_with(1);
    w.table.period_ns = period_ns;
    w.table.setpoint_timeout_ns = LONG_NS;
    table_of(0)->watchdog_ns = 0;
    table_of(0)->input[0].silence_ns = table_of(0)->input[1].silence_ns = LONG_NS;
    exchange_init(&shared);
    can_config config = {.at = place_of_the_thread(), .before.left_running = left_running};
    CHECK(can_start(LINES_MAX, &config, &w.table) == -EINVAL);
    CHECK(can_start(0, &config, &w.table) == 0);
    can_put_control(0, &(can_control){.listen = 1});
}

static void begin_thread(int64_t period_ns)
{
    int both[2];
    CHECK(socketpair(AF_UNIX, SOCK_SEQPACKET | SOCK_NONBLOCK, 0, both) == 0);
    begin_on(both[0], both[1], period_ns);
}

static void end_thread(void)
{
    CHECK(can_stop(0) == 0);
    CHECK(close(ends[0]) == 0 && close(ends[1]) == 0);
}

static void send_frame(uint32_t id, uint8_t bytes, const void *data)
{
    struct can_frame frame = {.can_id = id, .can_dlc = bytes};
    memcpy(frame.data, data, bytes < 8 ? bytes : 8);
    CHECK(send(ends[1], &frame, sizeof frame, 0) == (ssize_t)sizeof frame);
}

static void send_state(void)
{
    send_frame(STATE, 1, (const uint8_t[]){8});
}

static can_received received_frame(void)
{
    can_received out;
    WAIT_UNTIL(can_take_received(0, &out) != 0);
    return out;
}

/* ------------------------------------------------------------------------------- stamps */
/* Sends a frame while the thread has no look that finds it for some time, and returns the stamp. */
static int64_t stamp_of_a_frame(int64_t shown_age_ns)
{
    bus.shown_age_ns = shown_age_ns;
    int64_t emptied_ns = bus.emptied_ns[0];
    WAIT_UNTIL(bus.emptied_ns[0] != emptied_ns); /* after this look the thread waits some ms */
    int64_t sent_ns = clock_now_ns();
    send_state();
    int64_t stamp_ns = received_frame().stamp_ns;
    CHECK(stamp_ns <= clock_now_ns());
    CHECK(shown_age_ns != 0 || stamp_ns >= sent_ns);
    return stamp_ns;
}

static void a_frame_is_dated_by_its_age_when_it_is_read(void)
{
    begin_thread(LONG_NS);
    for (int i = 0; i < 5; i++) {
        CHECK(stamp_of_a_frame(0) >= bus.before_ns[0]);
        /* the age is that of the kernel's stamp, and the thread reads the clocks after the call */
        int64_t stamp_ns = stamp_of_a_frame(1000);
        CHECK(stamp_ns >= bus.before_ns[0] && stamp_ns >= bus.stamped_ns - MS / 10);
        CHECK(stamp_of_a_frame(NO_STAMP) >= bus.returned_ns);
        /* the wall clock was set back: no frame is from the future */
        CHECK(stamp_of_a_frame(-LONG_AGO_NS) >= bus.returned_ns);
        CHECK(stamp_of_a_frame(-1 * MS) >= bus.before_ns[0]);
    }
    end_thread();
}

static void no_frame_is_older_than_the_look_that_found_the_socket_empty(void)
{
    begin_thread(LONG_NS);
    for (int i = 0; i < 5; i++) {
        int64_t stamp_ns = stamp_of_a_frame(LONG_AGO_NS);
        CHECK(stamp_ns > bus.before_ns[1] && stamp_ns <= bus.before_ns[0]);
    }
    end_thread();
}

static void frames_of_a_full_batch_and_those_behind_it_came_since_the_same_look(void)
{
    begin_thread(LONG_NS);
    bus.hides = true;
    bus.shown_age_ns = LONG_AGO_NS;
    const int count = FRAMES_OF_A_BATCH + 5;
    for (int i = 0; i < count; i++) {
        send_state();
    }
    int64_t emptied_ns = bus.emptied_ns[0];
    WAIT_UNTIL(bus.emptied_ns[0] != emptied_ns);
    bus.hides = false;
    int64_t first_ns = received_frame().stamp_ns;
    for (int i = 1; i < count; i++) {
        CHECK(received_frame().stamp_ns == first_ns);
    }
    CHECK(first_ns > bus.before_ns[1] && first_ns <= bus.before_ns[0]);
    end_thread();
}

/* ------------------------------------------------------------------------------- frames */
static void frames_that_are_none_are_counted_and_not_read(void)
{
    begin_thread(LONG_NS);
    send_frame(STATE, 9, (const uint8_t[8]){8}); /* longer than a frame of this kind may be */
    CHECK(send(ends[1], "short", 5, 0) == 5);
    send_state();
    CHECK(received_frame().packet.id == STATE);
    can_received more;
    CHECK(can_take_received(0, &more) == 0);
    WAIT_UNTIL(report().bad_frames == 2);
    CHECK(report().drive[0].received == 1);
    end_thread();
}

static void a_frame_that_the_thread_sent_itself_is_not_the_drives(void)
{
    begin_thread(LONG_NS);
    bus.confirms = true;
    send_state();
    WAIT_UNTIL(bus.returned_ns != 0);
    bus.confirms = false;
    send_state();
    (void)received_frame();
    WAIT_UNTIL(report().drive[0].received > 0);
    CHECK(report().drive[0].received == 1);
    end_thread();
}

static void an_order_that_is_not_good_reaches_no_bus(void)
{
    begin_thread(LONG_NS);
    const can_order good = {.write = {.packet = packet_of(CONTROL, 1)},
                            .expires_ns = clock_now_ns() + LONG_NS};
    can_order order = good;
    order.drive = 1;
    CHECK(can_put_order(0, &order) == -EINVAL);
    order.drive = CAN_DRIVES_MAX;
    CHECK(can_put_order(0, &order) == -EINVAL);
    order = good;
    order.write.output = 2;
    CHECK(can_put_order(0, &order) == -EINVAL);
    CHECK(can_put_order(1, &good) == -ESRCH && can_put_order(LINES_MAX, &good) == -ESRCH);
    CHECK(can_put_order(0, &good) == 0);
    WAIT_UNTIL(report().drive[0].orders_sent == 1);
    struct can_frame frame;
    while (recv(ends[1], &frame, sizeof frame, MSG_DONTWAIT) > 0 && frame.can_id != CONTROL) {
    }
    CHECK(frame.can_id == CONTROL && report().drive[0].orders_dropped == 0);
    end_thread();
    CHECK(can_put_order(0, &good) == -ESRCH);
}

/* ------------------------------------------------------------------------------- errors */
/* The kernel gives a socket's error once: to poll and getsockopt here, not to a read. */
static void an_error_of_the_socket_that_poll_reports_ends_the_thread(void)
{
    struct sockaddr_in nowhere = {.sin_family = AF_INET, .sin_addr.s_addr = htonl(INADDR_LOOPBACK)};
    socklen_t size = sizeof nowhere;
    int closed = socket(AF_INET, SOCK_DGRAM, 0), own = socket(AF_INET, SOCK_DGRAM, 0);
    CHECK(bind(closed, (struct sockaddr *)&nowhere, sizeof nowhere) == 0);
    CHECK(getsockname(closed, (struct sockaddr *)&nowhere, &size) == 0);
    CHECK(connect(own, (struct sockaddr *)&nowhere, sizeof nowhere) == 0 && close(closed) == 0);
    begin_on(own, open("/dev/null", O_RDWR), LONG_NS);
    bus.hides = true;
    int64_t emptied_ns = bus.emptied_ns[0];
    WAIT_UNTIL(bus.emptied_ns[0] != emptied_ns);
    CHECK(syscall(SYS_sendto, own, "x", 1, 0, NULL, 0) == 1);
    WAIT_UNTIL(report().life.running == 0);
    CHECK(report().life.error == ECONNREFUSED);
    end_thread();
}

static void a_read_that_fails_ends_the_thread_and_an_interrupted_one_does_not(void)
{
    begin_thread(LONG_NS);
    bus.fails_once = EINTR;
    WAIT_UNTIL(bus.fails_once == 0);
    send_state();
    (void)received_frame();
    bus.fails_once = ENETDOWN;
    WAIT_UNTIL(report().life.running == 0);
    CHECK(report().life.error == ENETDOWN);
    end_thread();
}

/* ---------------------------------------------------------------------- set-points, now */
static void put(double velocity_rad_s)
{
    const uint64_t one = 1;
    setpoints newest = {.stamp_ns = clock_now_ns(), .enabled = 1, .joint_count = 1};
    newest.joint[0].velocity_rad_s = velocity_rad_s;
    CHECK(exchange_put_setpoints(&shared, 0, &newest) == 0);
    CHECK(write(exchange_line_wake(&shared, 0), &one, sizeof one) == sizeof one);
}

static void arm_thread(void)
{
    can_control control = {.listen = 1};
    const float at_rest[2] = {1.0F, 0.0F};
    send_state();
    send_frame(MOTION, 8, at_rest);
    (void)received_frame();
    (void)received_frame();
    WAIT_UNTIL(exchange_line_wake(&shared, 0) >= 0);
    control.drive[0] =
        (mode_request){.count = 1, .mode = DRIVE_READY, .arming_until_ns = INT64_MAX};
    can_put_control(0, &control);
    WAIT_UNTIL(report().drive[0].mode == DRIVE_READY);
    put(0.0);
    control.drive[0].count = 2;
    control.drive[0].mode = DRIVE_ARMED;
    can_put_control(0, &control);
    WAIT_UNTIL(report().drive[0].mode == DRIVE_ARMED);
    CHECK(a_thread_is_called("motord-can"));
}

/* Returns the speed in the newest frame that the drive has received; INT16_MIN: it has none. */
static int16_t newest_speed(void)
{
    struct can_frame frame;
    can_packet packet = packet_of(0, 8);
    int16_t speed = INT16_MIN;
    while (recv(ends[1], &frame, sizeof frame, MSG_DONTWAIT) > 0) {
        if (frame.can_id == SPEED) {
            memcpy(packet.data, frame.data, 8);
            speed = speed_in(&packet);
        }
    }
    return speed;
}

static void a_new_command_does_not_wait_for_the_cycle(void)
{
    begin_thread(LONG_NS);
    arm_thread();
    put(1.0);
    WAIT_UNTIL(newest_speed() == 100);
    put(0.5);
    WAIT_UNTIL(newest_speed() == 50);
    put(0.0);
    WAIT_UNTIL(newest_speed() == 0);
    end_thread();
}

/* Each round has a cause: a look after 5 ms, a wake-up, a frame. */
static void a_woken_thread_sleeps_again(void)
{
    begin_thread(LONG_NS);
    arm_thread();
    uint64_t before = report().life.rounds;
    int64_t begin_ns = clock_now_ns();
    put(1.0);
    put(0.5);
    WAIT_UNTIL(report().life.rounds > before + 20);
    CHECK(report().life.rounds - before <= (uint64_t)((clock_now_ns() - begin_ns) / MS) + 30);
    end_thread();
}

static void a_drive_that_another_program_left_running_gets_a_quick_stop_first(void)
{
    struct can_frame frame = {0};
    left_running = true;
    begin_thread(LONG_NS);
    left_running = false;
    WAIT_UNTIL(recv(ends[1], &frame, sizeof frame, MSG_DONTWAIT) > 0);
    CHECK(frame.can_id == SPEED && frame.data[0] == QUICK_STOP);
    CHECK(report().drive[0].mode == DRIVE_READY && report().drive[0].may_turn == 1);
    end_thread();
}

static void of_a_line_that_does_not_exist_nothing_is_known(void)
{
    can_report out;
    can_received frame;
    CHECK(can_stop(LINES_MAX) == -ESRCH && can_read_report(LINES_MAX, &out) == -ESRCH);
    CHECK(can_take_received(LINES_MAX, &frame) == 0);
}

static void a_full_bus_is_tried_again_and_one_that_is_down_ends_the_thread(void)
{
    begin_thread(10 * MS);
    arm_thread();
    can_put_control(0, &(can_control){.drive[0] = {.count = 2, /* Python receives no frames */
                                                   .mode = DRIVE_ARMED,
                                                   .arming_until_ns = INT64_MAX}});
    const int full[] = {ENOBUFS, EAGAIN};
    for (int i = 0; i < 2; i++) {
        uint64_t refused = report().tx_full;
        bus.send_fails = full[i];
        WAIT_UNTIL(report().tx_full > refused + 3);
        CHECK(report().life.running != 0);
        bus.send_fails = 0;
        put(1.0 + i);
        WAIT_UNTIL(newest_speed() == 100 * (1 + i));
    }
    bus.send_fails = ENETDOWN;
    WAIT_UNTIL(report().life.running == 0);
    CHECK(report().life.error == ENETDOWN);
    end_thread();
}

int main(void)
{
    a_frame_is_dated_by_its_age_when_it_is_read();
    no_frame_is_older_than_the_look_that_found_the_socket_empty();
    frames_of_a_full_batch_and_those_behind_it_came_since_the_same_look();
    frames_that_are_none_are_counted_and_not_read();
    a_frame_that_the_thread_sent_itself_is_not_the_drives();
    an_order_that_is_not_good_reaches_no_bus();
    an_error_of_the_socket_that_poll_reports_ends_the_thread();
    a_read_that_fails_ends_the_thread_and_an_interrupted_one_does_not();
    a_new_command_does_not_wait_for_the_cycle();
    a_woken_thread_sleeps_again();
    a_drive_that_another_program_left_running_gets_a_quick_stop_first();
    of_a_line_that_does_not_exist_nothing_is_known();
    a_full_bus_is_tried_again_and_one_that_is_down_ends_the_thread();
    return checks_report("can socket");
}
