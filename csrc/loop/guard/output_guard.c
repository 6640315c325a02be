/* SPDX-License-Identifier: Apache-2.0
 * output_guard.c: the emergency stop's input and the watchdog's output, by descriptors that the
 * caller opened. Source: kernel, include/uapi/linux/gpio.h (v2) and
 * Documentation/userspace-api/gpio/gpio-v2-line-event-read.rst. */
#include <errno.h>
#include <linux/gpio.h>
#include <string.h>
#include <sys/ioctl.h>
#include <unistd.h>

#include "guard.h"

enum {
    EVENTS_A_TICK = 16
}; /* events of a contact that bounces: the kernel keeps this many, and the level shows the
      others */

void guard_init(guard *g, const guard_config *config)
{
    g->config = *config;
    g->watchdog = (watchdog_state){0};
    g->lost = false;
    g->estop_input = config->estop != 0 ? ESTOP_CLEAR : ESTOP_NONE;
    g->watchdog_well = 0;
    g->watchdog_edges = 0;
    g->watchdog_errno = 0;
}

/* Read the events first: a later edge is in the level. The request is for one kind of edge, so each
 * event is such an edge: with both kinds the kernel reports an edge by the level that it finds
 * later, and a short pulse is lost. */
static estop_reading read_input(int fd)
{
    estop_reading reading = {.known = true};
    struct gpio_v2_line_event events[EVENTS_A_TICK];
    ssize_t size = read(fd, events, sizeof events);
    if (size < 0 && errno != EAGAIN && errno != EINTR) {
        reading.known = false;
    }
    reading.opened = size > 0;
    struct gpio_v2_line_values values = {.mask = 1};
    if (ioctl(fd, GPIO_V2_LINE_GET_VALUES_IOCTL, &values) != 0) {
        reading.known = false;
    }
    reading.high = (values.bits & 1) != 0;
    return reading;
}

bool guard_read_estop(guard *g)
{
    if (g->config.estop == 0) {
        return false;
    }
    estop_reading reading = read_input(g->config.estop_fd);
    reading.known = reading.known && !g->lost;
    uint32_t found = estop_judge(&g->config, &reading);
    g->lost = found == ESTOP_LOST;
    g->estop_input = found;
    return found != ESTOP_CLEAR;
}

static void write_level(guard *g, bool high)
{
    struct gpio_v2_line_values values = {.bits = high, .mask = 1};
    g->watchdog_errno =
        ioctl(g->config.watchdog_fd, GPIO_V2_LINE_SET_VALUES_IOCTL, &values) == 0 ? 0 : errno;
}

void guard_drive_watchdog(guard *g, const watchdog_input *input)
{
    if (g->config.watchdog == 0) {
        return;
    }
    bool before = g->watchdog.high;
    g->watchdog_well = watchdog_step(&g->watchdog, &g->config, input);
    if (g->watchdog.high != before) {
        g->watchdog_edges++;
        write_level(g, g->watchdog.high);
    }
}

void guard_rest(guard *g)
{
    if (g->config.watchdog != 0) {
        write_level(g, false);
        g->watchdog_well = 0;
    }
}
