/* SPDX-License-Identifier: Apache-2.0
 * The thread of a CAN bus and the wall clock, which the kernel uses to stamp frames. The clock may
 * be set while frames are in transit. */
#include <errno.h>
#include <linux/can.h>
#include <sys/syscall.h>
#include <time.h>

#include "can_wire.h"
#include "thread_sides.h"

enum { FRAMES = 12 };

static _Atomic int64_t wall_ahead_ns, slept_ns;

/* Replaces the C library's function. The wall clock differs from the time of the kernel's stamps by
 * `wall_ahead_ns`, and the computer was suspended for `slept_ns`, while CLOCK_MONOTONIC stood
 * still. */
int clock_gettime(clockid_t clock, struct timespec *out)
{
    long failed = syscall(SYS_clock_gettime, clock, out);
    if (failed == 0 && (clock == CLOCK_REALTIME || clock == CLOCK_BOOTTIME)) {
        int64_t ns = out->tv_nsec + (clock == CLOCK_REALTIME ? wall_ahead_ns : slept_ns);
        int64_t seconds = ns / 1000000000 - (ns % 1000000000 < 0);
        out->tv_sec += seconds;
        out->tv_nsec = ns - seconds * 1000000000;
    }
    return (int)failed;
}

static int64_t stamp_of_a_frame(void)
{
    const struct can_frame state = {.can_id = STATE, .can_dlc = 1, .data = {8}};
    can_received received;
    int64_t begin_ns = clock_now_ns();
    CHECK(send(ends[1], &state, sizeof state, 0) == (ssize_t)sizeof state);
    while (can_take_received(0, &received) == 0) {
        look_again(begin_ns);
    }
    return received.stamp_ns;
}

/* Each frame is read only when the frame before has been taken: its stamp is not older than the
 * sending of that frame. */
static void frames_have_their_true_age_while_the_wall_clock_is(int64_t ahead_ns)
{
    int64_t sent_ns[FRAMES];
    wall_ahead_ns = ahead_ns;
    for (uint32_t i = 0; i < FRAMES; i++) {
        sent_ns[i] = clock_now_ns();
        int64_t stamp_ns = stamp_of_a_frame();
        CHECK(stamp_ns <= clock_now_ns() && (i < 2 || stamp_ns >= sent_ns[i - 2]));
    }
}

static void wait_for(uint32_t mode, can_report *report)
{
    int64_t begin_ns = clock_now_ns();
    do {
        look_again(begin_ns);
        CHECK(can_read_report(0, report) == 0);
    } while (report->drive[0].mode != mode);
}

/* The loop has not ticked since the suspend: by CLOCK_MONOTONIC the set-points in the exchange are
 * new, and they request motion. */
static void set_points_from_before_a_suspend_stop_the_drive(void)
{
    can_report report;
    can_control control = {
        .drive = {{.count = 1, .mode = DRIVE_READY, .arming_until_ns = INT64_MAX}}};
    const setpoints newest = {.stamp_ns = clock_now_ns(),
                              .enabled = 1,
                              .joint_count = 1,
                              .joint = {{.velocity_rad_s = 1.0}}};
    CHECK(exchange_put_setpoints(&shared, 0, &newest) == 0);
    can_put_control(0, &control);
    wait_for(DRIVE_READY, &report);
    control.drive[0].count = 2;
    control.drive[0].mode = DRIVE_ARMED;
    can_put_control(0, &control);
    wait_for(DRIVE_ARMED, &report);
    slept_ns += 3600 * 1000 * MS;
    wait_for(DRIVE_READY, &report);
    CHECK(report.drive[0].fault_reasons == DRIVE_FAULT_SETPOINTS_OLD);
    CHECK(clock_now_ns() - newest.stamp_ns < w.table.setpoint_timeout_ns);
}

int main(void)
{
    const int stamped = 1;
    can_control control = {.listen = 1};
    begin_with(1);
    w.table.setpoint_timeout_ns = 60000 * MS;
    for (uint32_t i = 0; i < w.table.drive[0].input_count; i++) {
        w.table.drive[0].input[i].silence_ns = 0; /* a silent drive is no fault here */
    }
    exchange_init(&shared);
    CHECK(socketpair(AF_UNIX, SOCK_SEQPACKET | SOCK_NONBLOCK, 0, ends) == 0);
    if (setsockopt(ends[0], SOL_SOCKET, SO_TIMESTAMPNS, &stamped, sizeof stamped) != 0) {
        CHECK(errno == ENOPROTOOPT);
        fprintf(stderr,
                "can clock: not tested, for nothing stamps frames here (QEMU's user mode)\n");
        return 0;
    }
    can_config config = {.at = place_of_the_thread()};
    CHECK(can_start(0, &config, &w.table) == 0);
    can_put_control(0, &control);
    frames_have_their_true_age_while_the_wall_clock_is(0);
    frames_have_their_true_age_while_the_wall_clock_is(700 * MS);
    frames_have_their_true_age_while_the_wall_clock_is(999 * MS);
    frames_have_their_true_age_while_the_wall_clock_is(3600000 * MS);
    frames_have_their_true_age_while_the_wall_clock_is(-700 * MS);
    wall_ahead_ns = 0;
    set_points_from_before_a_suspend_stop_the_drive();
    CHECK(can_stop(0) == 0);
    return checks_report("can clock");
}
