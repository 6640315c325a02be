/* SPDX-License-Identifier: Apache-2.0
 * The thread of a line of bridges, on a plain file: it carries out what the loop and asyncio send
 * before its next cycle. */
#include <errno.h>
#include <linux/gpio.h>
#include <stdarg.h>
#include <sys/mman.h>
#include <sys/syscall.h>
#include <time.h>
#include <unistd.h>

#include "check.h"
#include "exchange.h"
#include "rt.h"

enum { GPIO_FD = 9999 };
static const int64_t MS = 1000000, HOUR = INT64_C(3600000000000);

static exchange shared;

static _Atomic uint64_t lines, line_writes;

/* Replaces the C library's function: GPIO lines that keep their values. */
int ioctl(int fd, unsigned long request, ...)
{
    va_list more;
    va_start(more, request);
    const struct gpio_v2_line_values *values = va_arg(more, const struct gpio_v2_line_values *);
    va_end(more);
    if (fd != GPIO_FD || request != GPIO_V2_LINE_SET_VALUES_IOCTL) {
        errno = ENOTTY;
        return -1;
    }
    lines = values->bits;
    line_writes++;
    return 0;
}

static _Atomic int64_t ahead_ns;

/* Replaces the C library's function: the computer has been running for longer, or started just
 * now. */
int clock_gettime(clockid_t clock, struct timespec *out)
{
    long error = syscall(SYS_clock_gettime, clock, out);
    int64_t ns = (int64_t)out->tv_sec * 1000000000 + out->tv_nsec;
    ns += clock == CLOCK_MONOTONIC || clock == CLOCK_BOOTTIME ? ahead_ns : 0;
    *out = (struct timespec){.tv_sec = ns / 1000000000, .tv_nsec = ns % 1000000000};
    return (int)error;
}

/* Replaces the C library's function, by the same clock. */
int clock_nanosleep(clockid_t clock, int flags, const struct timespec *until, struct timespec *left)
{
    CHECK(clock == CLOCK_MONOTONIC && flags == TIMER_ABSTIME);
    int64_t ns = (int64_t)until->tv_sec * 1000000000 + until->tv_nsec - ahead_ns;
    const struct timespec real = {.tv_sec = ns / 1000000000, .tv_nsec = ns % 1000000000};
    return (int)syscall(SYS_clock_nanosleep, clock, flags, &real, left);
}

/* From here on the computer has been running for this time. */
static void begin_at(int64_t uptime_ns)
{
    ahead_ns += uptime_ns - clock_now_ns();
    exchange_init(&shared);
}

static unsigned long duty_in(int fd)
{
    char text[32] = {0};
    CHECK(pread(fd, text, sizeof text - 1, 0) >= 0);
    return strtoul(text, NULL, 10);
}

static void wait_for_duty(int fd, unsigned long duty_ns)
{
    int64_t begin_ns = clock_now_ns();
    while (duty_in(fd) != duty_ns) {
        CHECK(clock_now_ns() < begin_ns + 20000 * MS);
        (void)nanosleep(&(struct timespec){.tv_nsec = MS}, NULL);
    }
}

/* Sends set-points and wakes the line, like the loop. */
static void put(double duty)
{
    const uint64_t one = 1;
    const setpoints newest = {
        .stamp_ns = clock_now_ns(), .enabled = 1, .joint_count = 1, .joint = {{.duty = duty}}};
    CHECK(exchange_put_setpoints(&shared, 0, &newest) == 0);
    CHECK(write(exchange_line_wake(&shared, 0), &one, sizeof one) == sizeof one);
}

static bridge_config with_a_cycle_of_an_hour(int fd)
{
    return (bridge_config){
        .exchange = &shared,
        .outputs_fd = -1,
        .inputs_fd = -1,
        .event_fd = -1,
        .period_ns = HOUR,
        .setpoint_timeout_ns = HOUR,
        .joint_count = 1,
        .output_count = 1,
        .joint = {{.sign = 1.0}},
        .output = {{.fd = fd, .period_ns = 50000, .slope = {0.0, 0.0, 1.0, 1.0}}},
    };
}

static void wait_until_it_listens(void)
{
    int64_t begin_ns = clock_now_ns();
    while (exchange_line_wake(&shared, 0) < 0) {
        CHECK(clock_now_ns() < begin_ns + 20000 * MS);
        (void)nanosleep(&(struct timespec){.tv_nsec = MS}, NULL);
    }
}

static void a_command_and_a_stop_do_not_wait_for_the_cycle(void)
{
    int fd = memfd_create("duty_cycle", MFD_CLOEXEC);
    const bridge_config config = with_a_cycle_of_an_hour(fd);
    bridge_report report;
    CHECK(pwm_line_start(0, &config) == 0);
    wait_until_it_listens();
    put(0.5);
    pwm_line_put_control(0, &(bridge_control){.mode = PWM_ARMED, .number = 1});
    wait_for_duty(fd, 25000);
    put(0.25);
    wait_for_duty(fd, 12500);
    put(0.0);
    wait_for_duty(fd, 0);
    put(0.25);
    wait_for_duty(fd, 12500);
    pwm_line_put_control(0, &(bridge_control){.mode = PWM_OFF, .number = 2});
    wait_for_duty(fd, 0);
    CHECK(pwm_line_read_report(0, &report) == 0 && report.late_cycles == 0);
    CHECK(pwm_line_stop(0) == 0 && exchange_line_wake(&shared, 0) == -1);
    CHECK(close(fd) == 0);
}

static void ending_the_line_does_not_wait_for_the_cycle_and_leaves_no_level(void)
{
    int fd = memfd_create("duty_cycle", MFD_CLOEXEC);
    const bridge_config config = with_a_cycle_of_an_hour(fd);
    CHECK(pwm_line_start(0, &config) == 0);
    wait_until_it_listens();
    put(0.5);
    pwm_line_put_control(0, &(bridge_control){.mode = PWM_ARMED, .number = 1});
    wait_for_duty(fd, 25000);
    CHECK(pwm_line_stop(0) == 0 && duty_in(fd) == 0);
    CHECK(close(fd) == 0);
}

static void a_thread_that_is_woken_continuously_still_pauses(void)
{
    int fd = memfd_create("duty_cycle", MFD_CLOEXEC);
    const bridge_config config = with_a_cycle_of_an_hour(fd);
    bridge_report report;
    CHECK(pwm_line_start(0, &config) == 0);
    wait_until_it_listens();
    int64_t begin_ns = clock_now_ns();
    for (int i = 0; i < 20000; i++) {
        put(0.0);
    }
    CHECK(pwm_line_stop(0) == 0 && pwm_line_read_report(0, &report) == 0);
    CHECK(report.cycles <= (uint64_t)((clock_now_ns() - begin_ns) / MS) + 3);
    CHECK(close(fd) == 0);
}

static void a_pump_does_not_change_where_no_cycle_is_due(void)
{
    int fd = memfd_create("duty_cycle", MFD_CLOEXEC);
    bridge_config config = with_a_cycle_of_an_hour(fd);
    config.outputs_fd = GPIO_FD;
    config.output_count = 2;
    config.output[1] = (bridge_pin){.fd = -1, .pumps = 1};
    CHECK(pwm_line_start(0, &config) == 0);
    wait_until_it_listens();
    put(0.5);
    pwm_line_put_control(0, &(bridge_control){.mode = PWM_ARMED, .number = 1});
    wait_for_duty(fd, 25000);
    uint64_t pumped = lines, writes = line_writes;
    for (int i = 1; i <= 6; i++) {
        put(0.05 * i);
        wait_for_duty(fd, 2500UL * (unsigned long)i);
        CHECK(lines == pumped && line_writes == writes);
    }
    CHECK(pwm_line_stop(0) == 0 && lines == 0);
    CHECK(close(fd) == 0);
}

int main(void)
{
    const int64_t uptimes_ns[] = {1000 * MS, HOUR - 1000 * MS, HOUR + 1000 * MS, 1000 * HOUR};
    for (size_t i = 0; i < sizeof uptimes_ns / sizeof *uptimes_ns; i++) {
        begin_at(uptimes_ns[i]);
        a_command_and_a_stop_do_not_wait_for_the_cycle();
        ending_the_line_does_not_wait_for_the_cycle_and_leaves_no_level();
        a_thread_that_is_woken_continuously_still_pauses();
        a_pump_does_not_change_where_no_cycle_is_due();
    }
    return 0;
}
