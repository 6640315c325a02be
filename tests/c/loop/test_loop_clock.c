/* SPDX-License-Identifier: Apache-2.0
 * The loop on clocks that jump or stop. The test gives each tick its time. */
#include <math.h>
#include <string.h>
#include <sys/syscall.h>
#include <time.h>
#include <unistd.h>

#include "check.h"
#include "fresh.h"
#include "good_config.h"
#include "loop.h"

static const int64_t MS = 1000000;

static loop_work work;
static int64_t now_ns;
static int64_t slept_ns;

/* Replaces the C library's function: a computer that was suspended for `slept_ns`, while
 * CLOCK_MONOTONIC stood still. */
int clock_gettime(clockid_t clock, struct timespec *out)
{
    long failed = syscall(SYS_clock_gettime, clock, out);
    if (failed == 0 && clock == CLOCK_BOOTTIME) {
        int64_t ns = out->tv_nsec + slept_ns;
        out->tv_sec += ns / 1000000000;
        out->tv_nsec = ns % 1000000000;
    }
    return (int)failed;
}

/* A base with two wheels that report their speeds. */
static core_config base(void)
{
    core_config config = good_config();
    config.joint_count = 2;
    config.limits.linear = (axis_limits){1.0, 5.0, 5.0, INFINITY};
    config.joint[0].counter_bits = config.joint[1].counter_bits = 0;
    return config;
}

static void receive_drives(void)
{
    for (uint32_t joint = 0; joint < 2; joint++) {
        joint_feedback feedback = {.stamp_ns = now_ns,
                                   .velocity_rad_s = work.out.joint[joint].velocity_rad_s,
                                   .enabled = 2};
        CHECK(exchange_put_feedback(&work.exchange, joint, &feedback) == 0);
    }
}

static void beat(uint32_t armed)
{
    const core_control control = {
        .heartbeat_ns = now_ns, .armed = armed, .limits = work.core.config.limits};
    exchange_put_control(&work.exchange, &control);
}

static int command(double linear_m_s)
{
    static uint64_t sequence;
    const command_datagram datagram = {.magic = COMMAND_MAGIC,
                                       .version = COMMAND_VERSION,
                                       .kind = COMMAND_TWIST,
                                       .sequence = ++sequence,
                                       .stamp_ns = now_ns,
                                       .linear_m_s = linear_m_s};
    return arbiter_submit(&work.arbiter, &datagram, sizeof datagram, now_ns, true);
}

static void tick(int64_t after_ns)
{
    now_ns += after_ns;
    receive_drives();
    beat(1);
    loop_tick(&work, now_ns, now_ns);
}

/* Arms the base and drives until it has the commanded speed. */
static void drive(void)
{
    const loop_config loop = {.rate_hz = 1000, .event_fd = -1, .command_fd = -1};
    const core_config config = base();
    memset(&work, 0, sizeof work);
    CHECK(loop_work_init(&work, &loop, &config) == 0);
    exchange_put_permissions(
        &work.exchange, &(lease_permissions){.lease = {{.number = 1, .lifetime_ns = 300 * MS}}});
    now_ns = clock_now_ns();
    beat(0);
    receive_drives();
    loop_tick(&work, now_ns, now_ns);
    CHECK(command(0.0) == 0);
    tick(MS);
    for (uint32_t i = 0; i < 200; i++) {
        CHECK(command(0.5) == 0);
        tick(MS);
    }
    CHECK(work.core.snapshot.armed == 1 && work.core.snapshot.faults == 0 &&
          work.core.snapshot.setpoint_linear_m_s == 0.5);
}

static void a_clock_that_has_not_moved_between_two_ticks_causes_no_fault(void)
{
    drive();
    uint64_t tick_before = work.core.snapshot.tick;
    CHECK(command(0.4) == 0);
    loop_extra_tick(&work, now_ns);
    loop_tick(&work, now_ns, now_ns);
    CHECK(work.core.snapshot.faults == 0 && work.core.snapshot.setpoint_linear_m_s == 0.5);
    tick(10 * MS);
    CHECK(work.core.snapshot.faults == 0 && work.core.snapshot.armed == 1 &&
          work.core.snapshot.setpoint_linear_m_s < 0.5);
    CHECK(work.core.snapshot.dt_s == 10e-3 && work.core.snapshot.tick == tick_before + 1);
}

static void a_clock_that_stands_still_for_long_stops_the_base(void)
{
    drive();
    for (uint32_t i = 0; i < 100; i++) {
        loop_tick(&work, now_ns, now_ns);
        CHECK(work.core.snapshot.faults == 0);
    }
    loop_tick(&work, now_ns, now_ns);
    CHECK(work.core.snapshot.faults == FAULT_TIME_STEP && work.out.joint[0].velocity_rad_s == 0.0);
}

static void a_tick_in_which_the_clock_moves_excuses_those_before(void)
{
    drive();
    for (uint32_t i = 0; i < 1000; i++) {
        CHECK(command(0.5) == 0);
        loop_extra_tick(&work, now_ns);
        tick(i % 50 == 0 ? 40 * MS : 0);
        CHECK(work.core.snapshot.faults == 0 && work.core.snapshot.setpoint_linear_m_s == 0.5);
    }
}

static void a_clock_that_runs_backwards_stops_the_base_at_once(void)
{
    drive();
    tick(-1);
    CHECK(work.core.snapshot.faults == FAULT_TIME_STEP && work.out.joint[0].velocity_rad_s == 0.0);
}

/* From here on the time is that of the real clock, which shows that the computer was suspended. */
static void wake_up(int64_t after_ns)
{
    while (clock_now_ns() <= now_ns) { /* the test's own time was ahead of the clock */
        (void)usleep(1000);
    }
    slept_ns += after_ns;
    now_ns = clock_now_ns();
}

static void after_a_suspend_the_base_stands_at_once_disarmed_by_a_fault(void)
{
    drive();
    wake_up(3600 * 1000 * MS);
    loop_tick(&work, now_ns, now_ns);
    CHECK(work.core.snapshot.faults == FAULT_SUSPENDED && work.core.snapshot.armed == 0);
    CHECK(work.out.joint[0].velocity_rad_s == 0.0 && work.out.joint[1].velocity_rad_s == 0.0);
    for (uint32_t i = 0; i < 100; i++) { /* the drives answer again, and the source continues */
        (void)command(0.5);
        tick(MS);
        CHECK(work.out.joint[0].velocity_rad_s == 0.0 &&
              work.core.snapshot.faults == FAULT_SUSPENDED);
    }
}

static void stamps_from_before_a_suspend_are_not_fresh_after_it(void)
{
    drive();
    const command_datagram on_its_direction = {.magic = COMMAND_MAGIC,
                                               .version = COMMAND_VERSION,
                                               .kind = COMMAND_TWIST,
                                               .sequence = UINT64_MAX / 4,
                                               .stamp_ns = now_ns,
                                               .linear_m_s = 0.5};
    exchange_put_imu(&work.exchange, &(imu_sample){.stamp_ns = now_ns});
    wake_up(10 * MS);
    loop_tick(&work, now_ns, now_ns);
    CHECK(work.input.imu.stamp_ns == 0);
    CHECK((work.core.snapshot.reasons & REASON_COMMAND_STALE) != 0);
    CHECK(work.core.snapshot.joint[0].stale == 1 && work.core.snapshot.joint[1].stale == 1);
    CHECK(work.input.control.heartbeat_ns == 0);
    CHECK(work.arbiter.report.commander == 0 && work.arbiter.report.lease[0].fresh == 0);
    CHECK(arbiter_submit(&work.arbiter, &on_its_direction, sizeof on_its_direction, now_ns, true) ==
          1 + REFUSED_AGE);
    now_ns = clock_now_ns();
    receive_drives();
    exchange_put_imu(&work.exchange, &(imu_sample){.stamp_ns = now_ns});
    loop_tick(&work, now_ns, now_ns);
    CHECK(work.input.imu.stamp_ns == now_ns);
    CHECK(work.core.snapshot.joint[0].stale == 0 && work.core.snapshot.joint[1].stale == 0);
}

static void a_disarmed_base_is_not_moved_by_waiting_commands_either(void)
{
    drive();
    beat(0);
    now_ns += MS;
    loop_tick(&work, now_ns, now_ns);
    CHECK(work.core.snapshot.armed == 0 && work.core.snapshot.faults == 0);
    wake_up(1000 * MS);
    loop_tick(&work, now_ns, now_ns);
    CHECK(work.core.snapshot.faults == FAULT_SUSPENDED && work.core.snapshot.armed == 0);
}

static void clocks_read_at_different_times_are_not_a_suspend(void)
{
    drive();
    slept_ns += 2 * MS;
    wake_up(0);
    tick(0);
    CHECK(work.core.snapshot.faults == 0);
}

int main(void)
{
    after_a_suspend_the_base_stands_at_once_disarmed_by_a_fault();
    stamps_from_before_a_suspend_are_not_fresh_after_it();
    a_disarmed_base_is_not_moved_by_waiting_commands_either();
    clocks_read_at_different_times_are_not_a_suspend();
    a_clock_that_has_not_moved_between_two_ticks_causes_no_fault();
    a_clock_that_stands_still_for_long_stops_the_base();
    a_tick_in_which_the_clock_moves_excuses_those_before();
    a_clock_that_runs_backwards_stops_the_base_at_once();
    return checks_report("loop clock");
}
