/* SPDX-License-Identifier: Apache-2.0
 * Every line of bridge.c, and the thread of output_pwm.c on plain files. */
#include <errno.h>
#include <linux/gpio.h>
#include <math.h>
#include <stdarg.h>
#include <string.h>
#include <sys/ioctl.h>
#include <sys/mman.h>
#include <time.h>
#include <unistd.h>

#include "check.h"
#include "exchange.h"
#include "rt.h"

static const int64_t MS = 1000000, START_NS = 5000000000;
static const uint64_t PERIOD_NS = 50000;

static exchange shared_exchange;

static const uint64_t DIRECTION_BIT = 1u << 3;
static const uint64_t POWER_BIT = 1u << 5;
static _Atomic uint64_t bits_set_to;
static _Atomic uint64_t bits_that_changed;

/* Replaces the C library's function: GPIO lines that keep their values. */
int ioctl(int fd, unsigned long request, ...)
{
    va_list rest;
    va_start(rest, request);
    const struct gpio_v2_line_values *values = va_arg(rest, const struct gpio_v2_line_values *);
    va_end(rest);
    if (fd != 99 || request != GPIO_V2_LINE_SET_VALUES_IOCTL) {
        errno = ENOTTY;
        return -1;
    }
    uint64_t before = bits_set_to;
    bits_set_to = (before & ~values->mask) | (values->bits & values->mask);
    bits_that_changed |= before ^ bits_set_to;
    return 0;
}

/* A bridge with one pin for the duty, and one, active low, that selects backward. */
static bridge_config config_of(int fd)
{
    bridge_config config = {
        .exchange = &shared_exchange,
        .outputs_fd = 99,
        .inputs_fd = -1,
        .event_fd = -1,
        .period_ns = MS,
        .setpoint_timeout_ns = 100 * MS,
        .stopping_ns = 300 * MS,
        .joint_count = 1,
        .output_count = 2,
        .joint = {{.sign = 1.0, .rest_mode = BRIDGE_BRAKE}},
        .output = {{.fd = fd, .period_ns = PERIOD_NS, .slope = {0.0, 0.0, 1.0, 1.0}},
                   {.fd = -1, .bit = 3, .inverted = 1, .base = {0.0, 0.0, 0.0, 1.0}}},
    };
    return config;
}

static setpoints duty_of(double duty, uint32_t enabled, int64_t stamp_ns)
{
    return (setpoints){
        .stamp_ns = stamp_ns, .enabled = enabled, .joint_count = 1, .joint = {{.duty = duty}}};
}

static double level_at(bridge_state *state, const bridge_control *control, double duty,
                       uint32_t enabled, int64_t age_ns, int64_t now_ns)
{
    const bridge_config config = config_of(3);
    setpoints newest = duty_of(duty, enabled, now_ns - age_ns);
    double level[PWM_OUTPUTS_MAX];
    bridge_step(state, &config, control, &newest, now_ns, level);
    return level[0];
}

static void only_armed_enabled_and_fresh_set_points_move(void)
{
    bridge_state state = {0};
    bridge_control off = {0}, arm = {.mode = PWM_ARMED, .number = 1};
    CHECK(level_at(&state, &off, 0.5, 1, 0, START_NS) == 0.0);
    CHECK(level_at(&state, &arm, 0.5, 0, 0, START_NS + MS) == 0.0);
    CHECK(level_at(&state, &arm, 0.5, 1, 0, START_NS + 2 * MS) == 0.5);
    CHECK(level_at(&state, &arm, -0.5, 1, 0, START_NS + 3 * MS) == 0.5);
    CHECK(level_at(&state, &arm, 7.0, 1, 0, START_NS + 4 * MS) == 1.0);
    CHECK(level_at(&state, &arm, -7.0, 1, 0, START_NS + 4 * MS) == 1.0);
    CHECK(level_at(&state, &arm, (double)NAN, 1, 0, START_NS + 4 * MS) == 0.0);
    CHECK(level_at(&state, &arm, 0.5, 0, 0, START_NS + 5 * MS) == 0.0 &&
          state.drive.fault_reasons == DRIVE_FAULT_NOT_ENABLED);
    CHECK(level_at(&state, &arm, 0.5, 1, 0, START_NS + 6 * MS) == 0.0);
}

static void old_set_points_or_a_late_thread_brake_and_then_coast(void)
{
    bridge_state state = {0};
    bridge_control arm = {.mode = PWM_ARMED, .number = 1};
    CHECK(level_at(&state, &arm, 0.5, 1, 101 * MS, START_NS) == 0.0 &&
          state.drive.mode == DRIVE_READY);
    arm.number++;
    CHECK(level_at(&state, &arm, 0.5, 1, 0, START_NS + MS) == 0.5);
    CHECK(level_at(&state, &arm, 0.5, 1, 101 * MS, START_NS + 2 * MS) == 0.0 &&
          state.drive.stopping);
    CHECK(level_at(&state, &arm, 0.5, 1, 0, START_NS + 302 * MS) == 0.0 && !state.drive.stopping);
    arm.number++;
    CHECK(level_at(&state, &arm, 0.5, 1, 0, START_NS + 303 * MS) == 0.5);
    CHECK(level_at(&state, &arm, 0.5, 1, 0, START_NS + 500 * MS) == 0.0 &&
          state.drive.fault_reasons == DRIVE_FAULT_LEFT_ALONE);
    bridge_control stop = {.mode = PWM_STOP, .number = 9};
    CHECK(level_at(&state, &stop, 0.5, 1, 0, START_NS + 501 * MS) == 0.0 && !state.drive.stopping);
    arm.number = 10;
    CHECK(level_at(&state, &arm, 0.5, 1, 0, START_NS + 502 * MS) == 0.5);
    stop.number = 11;
    CHECK(level_at(&state, &stop, 0.5, 1, 0, START_NS + 503 * MS) == 0.0 && state.drive.stopping);
}

/* The mailbox keeps only the newest request. An overtaken one may have been a stop. */
static void a_stop_that_an_arming_overtakes_still_takes_the_power(void)
{
    bridge_state state = {0};
    bridge_control arm = {.mode = PWM_ARMED, .number = 1};
    CHECK(level_at(&state, &arm, 0.5, 1, 0, START_NS) == 0.5);
    arm.number = 3;
    CHECK(level_at(&state, &arm, 0.5, 1, 0, START_NS + MS) == 0.0 &&
          state.drive.mode == DRIVE_READY);
    CHECK(state.drive.request_seen == 3 && state.drive.fault_reasons == 0 && !state.drive.stopping);
    CHECK(level_at(&state, &arm, 0.5, 1, 0, START_NS + 2 * MS) == 0.0);
    arm.number = 4;
    CHECK(level_at(&state, &arm, 0.5, 1, 0, START_NS + 3 * MS) == 0.5);
    bridge_control stop = {.mode = PWM_STOP, .number = 5};
    CHECK(level_at(&state, &stop, 0.5, 1, 0, START_NS + 4 * MS) == 0.0 && state.drive.stopping);
    arm.number = 7; /* the bridge brakes, and a power-off may have been overtaken */
    CHECK(level_at(&state, &arm, 0.5, 1, 0, START_NS + 5 * MS) == 0.0 &&
          state.drive.mode == DRIVE_READY && !state.drive.stopping);
    arm.number = 9; /* the bridge has no power that could be taken */
    CHECK(level_at(&state, &arm, 0.5, 1, 0, START_NS + 6 * MS) == 0.5);
}

static void a_pump_toggles_only_in_cycles_that_may_move(void)
{
    bridge_config config = config_of(3);
    config.output[1].pumps = 1;
    bridge_state state = {0};
    bridge_control arm = {.mode = PWM_ARMED, .number = 1};
    double level[PWM_OUTPUTS_MAX], before = 0.0;
    for (int i = 0; i < 10; i++) {
        setpoints newest = duty_of(0.0, 1, START_NS + i * MS);
        bridge_step(&state, &config, &arm, &newest, START_NS + i * MS, level);
        CHECK(i == 0 || level[1] == 1.0 - before);
        before = level[1];
    }
    for (int i = 10; i < 14; i++) {
        setpoints newest = duty_of(0.0, 0, START_NS + i * MS);
        bridge_step(&state, &config, &arm, &newest, START_NS + i * MS, level);
        CHECK(level[1] == 0.0);
    }
    config.output[1].fd = 3;
    config.output[1].period_ns = PERIOD_NS;
    CHECK(bridge_config_check(&config) == -EINVAL);
}

static void a_level_is_a_part_of_the_period(void)
{
    bridge_pin pin = {.period_ns = PERIOD_NS};
    CHECK(bridge_duty_ns(&pin, 0.5) == 25000 && bridge_duty_ns(&pin, 2.0) == PERIOD_NS);
    CHECK(bridge_duty_ns(&pin, -1.0) == 0 && bridge_duty_ns(&pin, (double)NAN) == 0);
    pin.inverted = 1;
    CHECK(bridge_duty_ns(&pin, 0.2) == 40000);
}

static void an_invalid_config_is_refused(void)
{
    bridge_config config = config_of(3);
    CHECK(bridge_config_check(&config) == 0);
    config.output[0].base[BRIDGE_FORWARD] = (double)NAN;
    CHECK(bridge_config_check(&config) == -EINVAL && pwm_line_start(0, &config) == -EINVAL);
    config = config_of(3);
    config.output[1].bit = 64;
    CHECK(bridge_config_check(&config) == -EINVAL);
    config = config_of(3);
    config.joint[0].sign = 0.5;
    CHECK(bridge_config_check(&config) == -EINVAL);
    config = config_of(3);
    config.output[0].joint = 1;
    CHECK(bridge_config_check(&config) == -EINVAL);
    config = config_of(3);
    config.joint_count = 0;
    CHECK(bridge_config_check(&config) == -EINVAL && pwm_line_start(LINES_MAX, &config) == -EINVAL);
}

static unsigned long duty_in(int fd)
{
    char text[32] = {0};
    CHECK(pread(fd, text, sizeof text - 1, 0) >= 0);
    return strtoul(text, NULL, 10);
}

static uint32_t requests;

static void arm_line_1(void)
{
    pwm_line_put_control(1, &(bridge_control){.mode = PWM_ARMED, .number = ++requests});
}

/* Waits until the file has `duty_ns`; sends set-points of `duty`, or no set-points if it is 0. A
 * busy machine may delay this program, so that the thread stops by itself. So a motor that is to
 * turn is armed again. */
static bool comes_true(int fd, unsigned long duty_ns, double duty)
{
    for (int i = 0; i < 10000; i++) {
        setpoints newest = duty_of(duty, 1, clock_now_ns());
        bridge_report report;
        if (duty != 0.0) {
            exchange_put_setpoints(&shared_exchange, 1, &newest);
        }
        if (duty_in(fd) == duty_ns) {
            return true;
        }
        CHECK(pwm_line_read_report(1, &report) == 0);
        if (duty_ns > 0 && report.armed == 0 && report.stopping == 0 && report.number == requests) {
            arm_line_1();
        }
        (void)nanosleep(&(struct timespec){.tv_nsec = MS}, NULL);
    }
    return false;
}

static void the_thread_writes_the_files_and_ends_at_rest(void)
{
    int fd = memfd_create("duty_cycle", MFD_CLOEXEC);
    bridge_config config = config_of(fd);
    config.output_count = 1; /* without GPIO lines */
    config.outputs_fd = -1;
    bridge_report report;
    exchange_init(&shared_exchange);
    CHECK(pwm_line_stop(1) == -ESRCH && pwm_line_read_report(1, &report) == -ESRCH);
    CHECK(pwm_line_start(1, &config) == 0 && pwm_line_start(1, &config) == -EBUSY);
    CHECK(comes_true(fd, 0, 0.5));
    arm_line_1();
    CHECK(comes_true(fd, 25000, 0.5));
    CHECK(comes_true(fd, 0, 0.0));
    CHECK(comes_true(fd, 25000, 0.5)); /* after the brake has ended */
    CHECK(pwm_line_stop(1) == 0 && duty_in(fd) == 0);
    CHECK(pwm_line_read_report(1, &report) == 0 && report.running == 0 && report.error == 0 &&
          report.cycles > 0);
    CHECK(report.rest_error == 0);
    CHECK(close(fd) == 0);
}

static void the_thread_ends_with_the_errno_and_the_pin(void)
{
    int ends[2];
    CHECK(pipe(ends) == 0);
    bridge_config config = config_of(ends[1]); /* pwrite to a pipe fails with ESPIPE */
    config.output_count = 1;
    bridge_report report = {.running = 1};
    CHECK(pwm_line_start(2, &config) == 0);
    for (int i = 0; i < 10000 && report.running != 0; i++) {
        (void)nanosleep(&(struct timespec){.tv_nsec = MS}, NULL);
        CHECK(pwm_line_read_report(2, &report) == 0);
    }
    CHECK(report.running == 0 && report.error == ESPIPE && report.error_output == 0);
    CHECK(report.rest_error == ESPIPE && report.rest_output == 0);
    CHECK(pwm_line_stop(2) == 0 && close(ends[0]) == 0 && close(ends[1]) == 0);
}

static bool ends(uint32_t line, double duty, bridge_report *report)
{
    for (int i = 0; i < 10000 && report->running != 0; i++) {
        setpoints newest = duty_of(duty, 1, clock_now_ns());
        exchange_put_setpoints(&shared_exchange, line, &newest);
        (void)nanosleep(&(struct timespec){.tv_nsec = MS}, NULL);
        CHECK(pwm_line_read_report(line, report) == 0);
    }
    return report->running == 0;
}

static void pins_are_brought_to_rest_after_a_failure(void)
{
    int fd = memfd_create("duty_cycle", MFD_CLOEXEC);
    bridge_config config = config_of(fd);
    config.inputs_fd = 98; /* a descriptor that is not open */
    config.joint[0].fault_mask = 1;
    bridge_report report = {.running = 1};
    exchange_init(&shared_exchange);
    CHECK(pwm_line_start(2, &config) == 0 && ends(2, 0.5, &report) && pwm_line_stop(2) == 0);
    CHECK(report.error == ENOTTY && report.rest_error == 0 && close(fd) == 0);
}

/* The motor runs at `duty`. Then writes of the duty fail, and the set-point changes to `then`.
 * Returns the GPIO lines that changed. */
static uint64_t changed_at_a_failure(const bridge_config *wanted, double duty, double then)
{
    int fd = memfd_create("duty_cycle", MFD_CLOEXEC), pipe_ends[2];
    CHECK(pipe(pipe_ends) == 0);
    bridge_config config = *wanted;
    config.output[0].fd = fd;
    bridge_report report = {.running = 1};
    exchange_init(&shared_exchange);
    CHECK(pwm_line_start(1, &config) == 0);
    CHECK(comes_true(fd, 0, duty));
    arm_line_1();
    CHECK(comes_true(fd, 25000, duty));
    CHECK(((bits_set_to & DIRECTION_BIT) != 0) == (duty > 0.0));
    CHECK(dup2(pipe_ends[1], fd) == fd); /* from here on writes to it fail with ESPIPE */
    bits_that_changed = 0;
    CHECK(ends(1, then, &report));
    CHECK(report.error == ESPIPE && report.error_output == 0);
    CHECK(pwm_line_stop(1) == 0);
    CHECK(close(fd) == 0 && close(pipe_ends[0]) == 0 && close(pipe_ends[1]) == 0);
    return bits_that_changed;
}

static void a_motor_whose_duty_cannot_be_cleared_gets_no_direction_change(void)
{
    bridge_config config = config_of(-1);
    CHECK(changed_at_a_failure(&config, 0.5, -0.5) == 0);
    CHECK(changed_at_a_failure(&config, -0.5, 0.5) == 0); /* 0 would select forward */
    CHECK(changed_at_a_failure(&config, -0.5, -0.25) == 0);
}

static void lines_that_remove_power_do_so_even_when_the_duty_cannot_be_cleared(void)
{
    bridge_config config = config_of(-1);
    config.output[2] = (bridge_pin){.fd = -1, .bit = 5, .base = {0.0, 1.0, 1.0, 1.0}};
    config.output_count = 3;
    CHECK(changed_at_a_failure(&config, 0.5, -0.5) == POWER_BIT);
    CHECK((changed_at_a_failure(&config, -0.5, 0.5) & POWER_BIT) != 0 &&
          (bits_set_to & POWER_BIT) == 0);
}

int main(void)
{
    only_armed_enabled_and_fresh_set_points_move();
    old_set_points_or_a_late_thread_brake_and_then_coast();
    a_stop_that_an_arming_overtakes_still_takes_the_power();
    a_pump_toggles_only_in_cycles_that_may_move();
    a_level_is_a_part_of_the_period();
    an_invalid_config_is_refused();
    the_thread_writes_the_files_and_ends_at_rest();
    the_thread_ends_with_the_errno_and_the_pin();
    pins_are_brought_to_rest_after_a_failure();
    a_motor_whose_duty_cannot_be_cleared_gets_no_direction_change();
    lines_that_remove_power_do_so_even_when_the_duty_cannot_be_cleared();
    return checks_report("bridge");
}
