/* SPDX-License-Identifier: Apache-2.0
 * output_guard.c on GPIO lines that keep their levels, whose chip fails and comes back. */
#include <errno.h>
#include <fcntl.h>
#include <linux/gpio.h>
#include <stdarg.h>
#include <sys/syscall.h>
#include <unistd.h>

#include "check.h"
#include "guard.h"

enum { WATCHDOG_FD = 9998 };
static const int64_t MS = 1000000, START_NS = 5000000000;

static int input[2]; /* the input's events, in a pipe */

static struct {
    bool high;       /* level of the input */
    int level_fails; /* errno of the requests; 0: they succeed */
    int events_fail;
    bool is_empty; /* a read of events has no byte */
    int write_fails;
    uint64_t bits; /* newest level of the output, and number of writes */
    uint32_t writes;
} chip;

/* Replaces the C library's function: the requests of GPIO lines. */
int ioctl(int fd, unsigned long request, ...)
{
    va_list more;
    va_start(more, request);
    struct gpio_v2_line_values *values = va_arg(more, struct gpio_v2_line_values *);
    va_end(more);
    CHECK(values->mask == 1);
    int error = ENOTTY;
    if (fd == input[0] && request == GPIO_V2_LINE_GET_VALUES_IOCTL) {
        error = chip.level_fails;
        values->bits = chip.high;
    } else if (fd == WATCHDOG_FD && request == GPIO_V2_LINE_SET_VALUES_IOCTL) {
        error = chip.write_fails;
        chip.writes++;
        chip.bits = error == 0 ? values->bits : chip.bits;
    }
    errno = error;
    return error == 0 ? 0 : -1;
}

/* Replaces the C library's function: a device that is gone. */
ssize_t read(int fd, void *bytes, size_t count)
{
    if (fd == input[0] && chip.is_empty) {
        return 0;
    }
    if (fd == input[0] && chip.events_fail != 0) {
        errno = chip.events_fail;
        return -1;
    }
    return syscall(SYS_read, fd, bytes, count);
}

static guard contact(uint32_t open_is_high)
{
    guard g;
    chip.high = open_is_high == 0;
    chip.level_fails = chip.events_fail = chip.write_fails = 0;
    guard_init(&g, &(guard_config){.estop = 1, .estop_fd = input[0], .estop_high = open_is_high});
    return g;
}

static void edge(void)
{
    const struct gpio_v2_line_event event = {.id = GPIO_V2_LINE_EVENT_RISING_EDGE};
    CHECK(write(input[1], &event, sizeof event) == sizeof event);
}

static void the_contact_stops_while_it_is_open(void)
{
    for (uint32_t open_is_high = 0; open_is_high < 2; open_is_high++) {
        guard g = contact(open_is_high);
        CHECK(!guard_read_estop(&g) && g.estop_input == ESTOP_CLEAR);
        chip.high = !chip.high;
        CHECK(guard_read_estop(&g) && g.estop_input == ESTOP_ACTIVE);
        CHECK(guard_read_estop(&g));
        chip.high = !chip.high;
        CHECK(!guard_read_estop(&g) && g.estop_input == ESTOP_CLEAR && !g.lost);
    }
}

static void a_pulse_between_two_ticks_stops_in_one_of_them(void)
{
    guard g = contact(1);
    edge();
    edge();
    CHECK(guard_read_estop(&g) && g.estop_input == ESTOP_ACTIVE);
    CHECK(!guard_read_estop(&g) && g.estop_input == ESTOP_CLEAR);
}

static void a_lost_input_is_lost_also_when_its_chip_answers_again(void)
{
    for (int part = 0; part < 2; part++) {
        guard g = contact(1);
        CHECK(!guard_read_estop(&g));
        *(part == 0 ? &chip.level_fails : &chip.events_fail) = ENODEV;
        CHECK(guard_read_estop(&g) && g.estop_input == ESTOP_LOST && g.lost);
        chip.level_fails = chip.events_fail = 0;
        for (int i = 0; i < 3; i++) {
            CHECK(guard_read_estop(&g) && g.estop_input == ESTOP_LOST);
        }
        guard_init(&g, &(guard_config){.estop = 1, .estop_fd = input[0], .estop_high = 1});
        CHECK(!guard_read_estop(&g));
    }
}

static void a_read_without_an_event_or_an_interrupted_one_loses_nothing(void)
{
    const int harmless[] = {EAGAIN, EINTR};
    for (int i = 0; i < 2; i++) {
        guard g = contact(1);
        chip.events_fail = harmless[i];
        CHECK(!guard_read_estop(&g) && g.estop_input == ESTOP_CLEAR);
    }
    guard g = contact(1);
    chip.is_empty = true;
    CHECK(!guard_read_estop(&g) && g.estop_input == ESTOP_CLEAR);
    chip.is_empty = false;
}

/* ------------------------------------------------------------------------- the watchdog */
static guard with_a_watchdog(void)
{
    guard g;
    chip.write_fails = 0;
    chip.writes = 0;
    chip.bits = 0;
    guard_init(&g, &(guard_config){.watchdog = 1,
                                   .watchdog_fd = WATCHDOG_FD,
                                   .watchdog_every_ticks = 2,
                                   .heartbeat_timeout_ns = MS});
    return g;
}

static void tick(guard *g, bool alive)
{
    const watchdog_input seen = {.now_ns = START_NS, .heartbeat_ns = alive ? START_NS : 0};
    guard_drive_watchdog(g, &seen);
}

static void the_pin_has_each_new_level_and_is_written_for_no_other_reason(void)
{
    guard g = with_a_watchdog();
    for (uint32_t edges = 1; edges <= 6; edges++) {
        tick(&g, true);
        CHECK(chip.writes == edges - 1);
        tick(&g, true);
        CHECK(chip.writes == edges && g.watchdog_edges == edges && chip.bits == edges % 2);
        CHECK(g.watchdog_well == 1 && g.watchdog_errno == 0);
    }
}

static void the_pin_of_a_hanging_program_goes_low_once(void)
{
    guard g = with_a_watchdog();
    tick(&g, true);
    tick(&g, true);
    CHECK(chip.bits == 1);
    tick(&g, false);
    CHECK(chip.bits == 0 && chip.writes == 2 && g.watchdog_well == 0);
    tick(&g, false);
    CHECK(chip.writes == 2);
}

static void at_the_end_the_pin_is_low(void)
{
    guard g = with_a_watchdog();
    tick(&g, true);
    tick(&g, true);
    CHECK(chip.bits == 1);
    guard_rest(&g);
    CHECK(chip.bits == 0 && g.watchdog_well == 0 && chip.writes == 2);
}

static void the_error_of_a_pin_is_reported_until_a_write_succeeds(void)
{
    guard g = with_a_watchdog();
    chip.write_fails = EIO;
    tick(&g, true);
    tick(&g, true);
    CHECK(g.watchdog_errno == EIO && g.watchdog_edges == 1);
    chip.write_fails = 0;
    tick(&g, true);
    tick(&g, true);
    CHECK(g.watchdog_errno == 0 && g.watchdog_edges == 2);
}

int main(void)
{
    CHECK(pipe2(input, O_NONBLOCK) == 0);
    the_contact_stops_while_it_is_open();
    a_pulse_between_two_ticks_stops_in_one_of_them();
    a_lost_input_is_lost_also_when_its_chip_answers_again();
    a_read_without_an_event_or_an_interrupted_one_loses_nothing();
    the_pin_has_each_new_level_and_is_written_for_no_other_reason();
    the_pin_of_a_hanging_program_goes_low_once();
    at_the_end_the_pin_is_low();
    the_error_of_a_pin_is_reported_until_a_write_succeeds();
    return checks_report("guard lines");
}
