/* SPDX-License-Identifier: Apache-2.0
 * Every line of guard.c, and output_guard.c on descriptors that are not GPIO lines. */
#include <errno.h>
#include <linux/gpio.h>
#include <string.h>
#include <sys/ioctl.h>
#include <unistd.h>

#include "check.h"
#include "guard.h"

static const int64_t MS = 1000000, START_NS = 5000000000;

/* A contact that closes to ground, with a pull-up: the line is high when it is open. */
static guard_config open_is_high(void)
{
    return (guard_config){.estop = 1, .estop_fd = -1, .estop_high = 1};
}

static void an_open_contact_stops_and_a_closed_one_does_not(void)
{
    guard_config config = open_is_high();
    CHECK(estop_judge(&config, &(estop_reading){.known = true, .high = true}) == ESTOP_ACTIVE);
    CHECK(estop_judge(&config, &(estop_reading){.known = true, .high = false}) == ESTOP_CLEAR);
    config.estop_high = 0;
    CHECK(estop_judge(&config, &(estop_reading){.known = true, .high = true}) == ESTOP_CLEAR);
    CHECK(estop_judge(&config, &(estop_reading){.known = true, .high = false}) == ESTOP_ACTIVE);
}

static void a_contact_that_was_open_between_two_ticks_stops(void)
{
    guard_config config = open_is_high();
    CHECK(estop_judge(&config, &(estop_reading){.known = true, .opened = true}) == ESTOP_ACTIVE);
    config.estop_high = 0;
    CHECK(estop_judge(&config, &(estop_reading){.known = true, .high = true, .opened = true}) ==
          ESTOP_ACTIVE);
}

static void an_unknown_level_counts_as_a_lost_input(void)
{
    guard_config config = open_is_high();
    CHECK(estop_judge(&config, &(estop_reading){.known = false, .high = false}) == ESTOP_LOST);
}

static void a_lost_input_stays_lost(void)
{
    int ends[2];
    guard g;
    CHECK(pipe(ends) == 0);
    guard_config config = open_is_high();
    config.estop_fd = ends[0]; /* readable, but not a GPIO line */
    CHECK(write(ends[1], "x", 1) == 1);
    guard_init(&g, &config);
    CHECK(g.estop_input == ESTOP_CLEAR);
    CHECK(guard_read_estop(&g));
    CHECK(g.estop_input == ESTOP_LOST);
    CHECK(close(ends[0]) == 0);
    CHECK(close(ends[1]) == 0);
    CHECK(guard_read_estop(&g));
    CHECK(g.estop_input == ESTOP_LOST && g.lost);
}

static void without_pins_nothing_stops_and_nothing_is_written(void)
{
    guard g;
    guard_init(&g, &(guard_config){0});
    CHECK(g.estop_input == ESTOP_NONE);
    CHECK(!guard_read_estop(&g));
    guard_drive_watchdog(&g, &(watchdog_input){.now_ns = START_NS, .heartbeat_ns = START_NS});
    guard_rest(&g);
    CHECK(g.watchdog_edges == 0 && g.watchdog_errno == 0 && g.watchdog_well == 0);
}

static void a_pin_that_cannot_be_written_is_reported_with_the_reason(void)
{
    guard g;
    guard_init(&g, &(guard_config){.watchdog = 1,
                                   .watchdog_fd = -1,
                                   .watchdog_every_ticks = 1,
                                   .heartbeat_timeout_ns = MS});
    CHECK(ioctl(-1, GPIO_V2_LINE_SET_VALUES_IOCTL, &(struct gpio_v2_line_values){0}) != 0);
    /* EBADF; an emulator without this request reports another errno */
    const int reason = errno;
    guard_drive_watchdog(&g, &(watchdog_input){.now_ns = START_NS, .heartbeat_ns = START_NS});
    CHECK(g.watchdog_edges == 1 && g.watchdog_errno == reason && g.watchdog_well == 1);
    guard_rest(&g);
    CHECK(g.watchdog_well == 0);
}

/* ------------------------------------------------------------------------- the watchdog */
typedef struct {
    guard_config config;
    watchdog_state state;
    watchdog_input input;
} rig;

/* A tick is 1 ms, line 1 has a time-out of 50 ms, and all parts run. */
static rig living(void)
{
    rig r = {.config = {.watchdog = 1, .watchdog_every_ticks = 1, .heartbeat_timeout_ns = 500 * MS},
             .input = {.now_ns = START_NS, .heartbeat_ns = START_NS}};
    r.config.line_timeout_ns[1] = 50 * MS;
    return r;
}

/* Makes ticks of 1 ms. Returns how often the pin changed. `asyncio`, `line`: whether that part
 * gives signs of life. */
static uint32_t edges_in(rig *r, uint32_t ticks, bool asyncio, bool line)
{
    uint32_t edges = 0;
    for (uint32_t i = 0; i < ticks; i++) {
        bool before = r->state.high;
        r->input.now_ns += MS;
        r->input.heartbeat_ns = asyncio ? r->input.now_ns : r->input.heartbeat_ns;
        r->input.takes[1] += line;
        (void)watchdog_step(&r->state, &r->config, &r->input);
        edges += r->state.high != before;
    }
    return edges;
}

static void while_all_parts_run_the_pin_changes_at_its_configured_rate(void)
{
    rig r = living();
    r.input.enabled = true;
    CHECK(edges_in(&r, 1000, true, true) == 1000);
    r.config.watchdog_every_ticks = 10;
    CHECK(edges_in(&r, 1000, true, true) == 100);
}

static void without_a_first_heartbeat_it_does_not_move(void)
{
    rig r = living();
    r.input.heartbeat_ns = 0;
    CHECK(edges_in(&r, 100, false, true) == 0 && !r.state.high);
}

static void when_asyncio_hangs_the_pin_stops_low_and_it_resumes_with_asyncio(void)
{
    rig r = living();
    (void)edges_in(&r, 100, true, true);
    CHECK(edges_in(&r, 500, false, true) == 500);
    (void)edges_in(&r, 1, false, true);
    CHECK(edges_in(&r, 500, false, true) == 0 && !r.state.high);
    CHECK(edges_in(&r, 100, true, true) == 100);
}

static void a_line_without_enabled_drives_may_stand_still(void)
{
    rig r = living();
    CHECK(edges_in(&r, 1000, true, false) == 1000);
}

static void newly_enabled_drives_give_their_line_its_full_time(void)
{
    rig r = living();
    (void)edges_in(&r, 1000, true, false);
    r.input.enabled = true;
    CHECK(edges_in(&r, 51, true, false) == 51);
    (void)edges_in(&r, 1, true, false);
    CHECK(edges_in(&r, 100, true, false) == 0 && !r.state.high);
}

static void a_line_that_hangs_counts_until_it_resumes_even_with_no_drive_enabled(void)
{
    rig r = living();
    r.input.enabled = true;
    (void)edges_in(&r, 100, true, true);
    (void)edges_in(&r, 52, true, false);
    r.input.enabled = false;
    CHECK(edges_in(&r, 1000, true, false) == 0);
    r.input.enabled = true; /* enabling is no sign of life */
    CHECK(edges_in(&r, 100, true, false) == 0);
    r.input.enabled = false;
    CHECK(edges_in(&r, 100, true, true) == 100);
    CHECK(edges_in(&r, 1000, true, false) == 1000);
}

static void the_first_line_is_watched_as_the_others_are(void)
{
    rig r = living();
    r.config.line_timeout_ns[0] = 50 * MS;
    r.input.enabled = true;
    CHECK(edges_in(&r, 51, true, true) == 51); /* line 0 takes no set-points */
    (void)edges_in(&r, 1, true, true);
    CHECK(edges_in(&r, 100, true, true) == 0);
    r.config.line_timeout_ns[0] = -1;
    CHECK(guard_config_check(&r.config) == -EINVAL);
}

static void a_heartbeat_that_never_came_does_not_count_right_after_boot(void)
{
    guard_config config = {.watchdog = 1, .watchdog_every_ticks = 1, .heartbeat_timeout_ns = 1};
    watchdog_state state = {0};
    CHECK(guard_config_check(&config) == 0);
    CHECK(!watchdog_step(&state, &config, &(watchdog_input){.now_ns = 1, .heartbeat_ns = 0}));
    CHECK(watchdog_step(&state, &config, &(watchdog_input){.now_ns = 2, .heartbeat_ns = 1}));
    CHECK(!watchdog_step(&state, &config, &(watchdog_input){.now_ns = 3, .heartbeat_ns = 1}));
}

static void a_heartbeat_from_the_future_does_not_count(void)
{
    guard_config config = {
        .watchdog = 1, .watchdog_every_ticks = 1, .heartbeat_timeout_ns = 500 * MS};
    for (int64_t ahead_ns = 10 * MS; ahead_ns < 2000 * MS; ahead_ns += 990 * MS) {
        watchdog_state state = {0};
        bool well = watchdog_step(
            &state, &config,
            &(watchdog_input){.now_ns = START_NS, .heartbeat_ns = START_NS + ahead_ns});
        CHECK(well == (ahead_ns == 10 * MS)); /* a little ahead: written during the tick */
    }
}

static void after_a_hang_the_first_edge_comes_when_its_time_has_passed(void)
{
    rig r = living();
    r.config.watchdog_every_ticks = 10;
    (void)edges_in(&r, 505, true, true);
    (void)edges_in(&r, 600, false, true);
    CHECK(!r.state.high && edges_in(&r, 9, true, true) == 0 && edges_in(&r, 1, true, true) == 1 &&
          r.state.high);
}

static void an_invalid_config_is_refused(void)
{
    guard_config config = living().config;
    CHECK(guard_config_check(&config) == 0);
    CHECK(guard_config_check(&(guard_config){0}) == 0);
    config.watchdog_every_ticks = 0;
    CHECK(guard_config_check(&config) == -EINVAL);
    config = living().config;
    config.heartbeat_timeout_ns = 0;
    CHECK(guard_config_check(&config) == -EINVAL);
    config = living().config;
    config.line_timeout_ns[3] = -1;
    CHECK(guard_config_check(&config) == -EINVAL);
}

int main(void)
{
    an_open_contact_stops_and_a_closed_one_does_not();
    a_contact_that_was_open_between_two_ticks_stops();
    an_unknown_level_counts_as_a_lost_input();
    a_lost_input_stays_lost();
    without_pins_nothing_stops_and_nothing_is_written();
    a_pin_that_cannot_be_written_is_reported_with_the_reason();
    while_all_parts_run_the_pin_changes_at_its_configured_rate();
    without_a_first_heartbeat_it_does_not_move();
    when_asyncio_hangs_the_pin_stops_low_and_it_resumes_with_asyncio();
    a_line_without_enabled_drives_may_stand_still();
    newly_enabled_drives_give_their_line_its_full_time();
    a_line_that_hangs_counts_until_it_resumes_even_with_no_drive_enabled();
    the_first_line_is_watched_as_the_others_are();
    a_heartbeat_that_never_came_does_not_count_right_after_boot();
    a_heartbeat_from_the_future_does_not_count();
    after_a_hang_the_first_edge_comes_when_its_time_has_passed();
    an_invalid_config_is_refused();
    return checks_report("guard");
}
