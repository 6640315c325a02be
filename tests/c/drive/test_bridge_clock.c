/* SPDX-License-Identifier: Apache-2.0
 * The thread of a line of bridges, on a plain file, after a suspend of the computer. */
#include <sys/mman.h>
#include <sys/syscall.h>
#include <time.h>
#include <unistd.h>

#include "check.h"
#include "exchange.h"
#include "rt.h"

static const int64_t MS = 1000000;

static exchange shared;
static _Atomic int64_t slept_s;

/* Replaces the C library's function: a computer that was suspended for `slept_s`, while
 * CLOCK_MONOTONIC stood still. */
int clock_gettime(clockid_t clock, struct timespec *out)
{
    long failed = syscall(SYS_clock_gettime, clock, out);
    out->tv_sec += failed == 0 && clock == CLOCK_BOOTTIME ? slept_s : 0;
    return (int)failed;
}

static void wait_until_armed(uint32_t armed, bridge_report *report)
{
    int64_t begin_ns = clock_now_ns();
    do {
        CHECK(clock_now_ns() < begin_ns + 20000 * MS);
        (void)nanosleep(&(struct timespec){.tv_nsec = MS}, NULL);
        CHECK(pwm_line_read_report(0, report) == 0);
    } while (report->armed != armed);
}

static unsigned long duty_in(int fd)
{
    char text[32] = {0};
    CHECK(pread(fd, text, sizeof text - 1, 0) >= 0);
    return strtoul(text, NULL, 10);
}

/* The loop has not ticked since the suspend: by CLOCK_MONOTONIC the set-points are new, and they
 * are not zero. */
static void set_points_from_before_a_suspend_take_the_power(void)
{
    int fd = memfd_create("duty_cycle", MFD_CLOEXEC);
    bridge_config config = {
        .exchange = &shared,
        .outputs_fd = -1,
        .inputs_fd = -1,
        .event_fd = -1,
        .period_ns = MS,
        .setpoint_timeout_ns = 60000 * MS,
        .joint_count = 1,
        .output_count = 1,
        .joint = {{.sign = 1.0}},
        .output = {{.fd = fd, .period_ns = 50000, .slope = {0.0, 0.0, 1.0, 1.0}}},
    };
    const setpoints newest = {
        .stamp_ns = clock_now_ns(), .enabled = 1, .joint_count = 1, .joint = {{.duty = 0.5}}};
    bridge_report report;
    exchange_init(&shared);
    CHECK(exchange_put_setpoints(&shared, 0, &newest) == 0);
    CHECK(pwm_line_start(0, &config) == 0);
    pwm_line_put_control(0, &(bridge_control){.mode = PWM_ARMED, .number = 1});
    wait_until_armed(1, &report);
    CHECK(duty_in(fd) == 25000);
    slept_s = 3600;
    wait_until_armed(0, &report);
    CHECK((report.fault_reasons & DRIVE_FAULT_SETPOINTS_OLD) != 0 && duty_in(fd) == 0);
    CHECK(clock_now_ns() - newest.stamp_ns < config.setpoint_timeout_ns);
    CHECK(pwm_line_stop(0) == 0 && close(fd) == 0);
}

int main(void)
{
    set_points_from_before_a_suspend_take_the_power();
    return 0;
}
