/* SPDX-License-Identifier: Apache-2.0
 * Every line of encoder.c: structures of kernel events through a pipe, the file of a counter, and
 * the thread of bridges with both. */
#include <errno.h>
#include <fcntl.h>
#include <linux/gpio.h>
#include <math.h>
#include <stdio.h>
#include <string.h>
#include <sys/mman.h>
#include <time.h>
#include <unistd.h>

#include "check.h"
#include "exchange.h"

enum { LINE_A = 17, LINE_B = 27, BURST = 1300 };
static const int64_t MS = 1000000, START_NS = 1000000000;
static const double PER_COUNT = 0.005;
static _Alignas(64) exchange mailboxes;

static encoder_config edges_on(int fd)
{
    return (encoder_config){.kind = ENCODER_EDGES,
                            .fd = fd,
                            .a_offset = LINE_A,
                            .b_offset = LINE_B,
                            .rad_per_count = PER_COUNT};
}

typedef struct {
    int out, in;
    uint32_t step, sequence;
} wheel;

static wheel new_wheel(void)
{
    int fds[2];
    CHECK(pipe2(fds, O_NONBLOCK) == 0);
    CHECK(fcntl(fds[1], F_SETPIPE_SZ, 1 << 18) > 0);
    return (wheel){.out = fds[1], .in = fds[0]};
}

static void turn(wheel *w, int edges, int64_t gap_ns)
{
    for (int i = 0; i < edges; i++) {
        /* order of edges in forward direction: A rises, B rises, A falls, B falls */
        struct gpio_v2_line_event event = {
            .timestamp_ns = (uint64_t)(START_NS + (int64_t)w->sequence * gap_ns),
            .id = w->step < 2 ? GPIO_V2_LINE_EVENT_RISING_EDGE : GPIO_V2_LINE_EVENT_FALLING_EDGE,
            .offset = w->step % 2 == 0 ? LINE_A : LINE_B,
            .seqno = ++w->sequence,
        };
        w->step = (w->step + 1) % 4;
        CHECK(write(w->out, &event, sizeof event) == sizeof event);
    }
}

static void events_of_the_kernel_are_counted(void)
{
    wheel w = new_wheel();
    encoder_config config = edges_on(w.in);
    encoder_state state;
    encoder_init(&state, &config);
    CHECK(encoder_read(&state, &config, START_NS) == 0 && state.count == 0);
    turn(&w, 40, MS);
    CHECK(encoder_read(&state, &config, START_NS) == 0 && state.count == 40);
    (void)encoder_velocity_rad_s(&state, &config, START_NS + 40 * MS);
    turn(&w, 40, MS);
    CHECK(encoder_read(&state, &config, START_NS) == 0 && state.count == 80);
    CHECK(fabs(encoder_velocity_rad_s(&state, &config, START_NS + 80 * MS) - 1000.0 * PER_COUNT) <
          1e-9);
    CHECK(fabs(encoder_velocity_rad_s(&state, &config, START_NS + 89 * MS) - 100.0 * PER_COUNT) <
          1e-9);
    CHECK(encoder_velocity_rad_s(&state, &config, START_NS + 400 * MS) == 0.0);
    turn(&w, BURST, MS); /* more edges than one look reads */
    CHECK(encoder_read(&state, &config, START_NS) == 0 && state.count == 80 + 1024);
    CHECK(encoder_read(&state, &config, START_NS) == 0 && state.count == 80 + BURST);
    w.sequence += 2; /* the kernel dropped two edges */
    turn(&w, 1, MS);
    CHECK(encoder_read(&state, &config, START_NS) == 0 && state.lost == 2 && state.epoch == 1);
    CHECK(state.illegal == 0);
    w.step = (w.step + 3) % 4; /* an edge to the present level */
    turn(&w, 1, MS);
    CHECK(encoder_read(&state, &config, START_NS) == 0 && state.illegal == 1);
    CHECK(close(w.out) == 0);
    CHECK(encoder_read(&state, &config, START_NS) == -ENODEV);
    CHECK(close(w.in) == 0);
    CHECK(encoder_read(&state, &config, START_NS) == -EBADF);
}

/* Makes one edge: `levels` are those of A and B after it. */
static void go_to(encoder_state *state, const encoder_config *config, uint32_t levels,
                  int64_t stamp_ns)
{
    uint32_t changed = state->levels ^ levels;
    CHECK(changed == 1 || changed == 2);
    encoder_edge(state, config, changed == 2 ? LINE_A : LINE_B, (levels & changed) != 0, 0,
                 stamp_ns);
}

static void backward_counts_down_from_wherever_it_turns_round(void)
{
    static const uint32_t FORWARD[4] = {0, 2, 3, 1}; /* values of 2 A + B when A leads B */
    encoder_config config = edges_on(-1);
    for (uint32_t first = 0; first < 4; first++) {
        config.levels = FORWARD[first];
        encoder_state state;
        encoder_init(&state, &config);
        for (uint32_t i = 1; i <= 6; i++) {
            go_to(&state, &config, FORWARD[(first + i) % 4], START_NS);
            CHECK(state.count == (int64_t)i);
        }
        for (uint32_t i = 1; i <= 12; i++) {
            go_to(&state, &config, FORWARD[(first + 6 + 16 - i) % 4], START_NS);
            CHECK(state.count == 6 - (int64_t)i);
        }
        CHECK(state.illegal == 0 && state.lost == 0 && state.epoch == 0);
    }
}

static void the_number_of_events_wraps_without_a_loss(void)
{
    encoder_config config = edges_on(-1);
    encoder_state state;
    encoder_init(&state, &config);
    encoder_edge(&state, &config, LINE_A, true, UINT32_MAX - 1, START_NS);
    encoder_edge(&state, &config, LINE_B, true, UINT32_MAX, START_NS);
    encoder_edge(&state, &config, LINE_A, false, 0, START_NS);
    CHECK(state.count == 3 && state.lost == 0 && state.epoch == 0);
}

static void a_wheel_that_trembles_over_one_edge_stands(void)
{
    encoder_config config = edges_on(-1);
    encoder_state state;
    encoder_init(&state, &config);
    for (int i = 1; i <= 400; i++) {
        go_to(&state, &config, i % 2 == 0 ? 0 : 2, START_NS + i * MS);
        CHECK(i % 2 != 0 || encoder_velocity_rad_s(&state, &config, START_NS + i * MS) == 0.0);
    }
}

static void a_counter_goes_by_the_shorter_arc(void)
{
    const encoder_config config = {.kind = ENCODER_COUNTER, .ceiling = 9, .rad_per_count = 1.0};
    const struct {
        uint64_t raw;
        int64_t count;
    } steps[] = {{0, 0}, {4, 4}, {9, -1}, {0, 0}, {9, -1}, {3, 3}, {3, 3}};
    encoder_state state;
    encoder_init(&state, &config);
    for (size_t i = 0; i < sizeof steps / sizeof steps[0]; i++) {
        encoder_counter(&state, &config, steps[i].raw, START_NS + (int64_t)i * MS);
        CHECK(state.count == steps[i].count);
    }
    CHECK(state.edge_ns == START_NS + 5 * MS); /* the same count is no edge */
    encoder_counter(&state, &config, 10, START_NS);
    CHECK(state.illegal == 1 && state.count == 3);
}

static void a_wheel_is_no_faster_than_one_count_in_the_time_of_its_silence(void)
{
    const encoder_config config = {
        .kind = ENCODER_COUNTER, .ceiling = UINT64_MAX, .rad_per_count = 1.0};
    encoder_state state;
    encoder_init(&state, &config);
    encoder_counter(&state, &config, 0, START_NS);
    encoder_counter(&state, &config, 10, START_NS);
    CHECK(encoder_velocity_rad_s(&state, &config, START_NS) == 0.0); /* the time of the last edge is
                                                                        unknown */
    encoder_counter(&state, &config, 0, START_NS + 10 * MS);
    CHECK(fabs(encoder_velocity_rad_s(&state, &config, START_NS + 10 * MS) + 1000.0) < 1e-6);
    CHECK(fabs(encoder_velocity_rad_s(&state, &config, START_NS + 10 * MS + MS / 2) + 1000.0) <
          1e-6);
    CHECK(fabs(encoder_velocity_rad_s(&state, &config, START_NS + 12 * MS) + 500.0) < 1e-6);
    CHECK(fabs(encoder_velocity_rad_s(&state, &config, START_NS + 250 * MS) + 1000.0 / 240.0) <
          1e-6);
    CHECK(encoder_velocity_rad_s(&state, &config, START_NS + 261 * MS) == 0.0);
    encoder_counter(&state, &config, 1, START_NS + 300 * MS);
    CHECK(fabs(encoder_velocity_rad_s(&state, &config, START_NS + 300 * MS) - 1000.0 / 290.0) <
          1e-6);
    /* noise: too soon after the last edge to measure a speed */
    encoder_counter(&state, &config, 2, START_NS + 300 * MS + 999);
    CHECK(fabs(encoder_velocity_rad_s(&state, &config, START_NS + 300 * MS + 999) -
               1000.0 / 290.0) < 1e-6);
}

static int file_with(const char *text)
{
    int fd = memfd_create("count", 0);
    CHECK(fd >= 0 && write(fd, text, strlen(text)) == (ssize_t)strlen(text));
    return fd;
}

/* Writes a number in one piece, like a file of the kernel. Behind the line's end the tail of a
 * longer number may remain. */
static void say(int fd, const char *text)
{
    CHECK(pwrite(fd, text, strlen(text), 0) == (ssize_t)strlen(text));
}

static void a_counter_is_read_from_its_file(void)
{
    encoder_config config = {.kind = ENCODER_COUNTER, .ceiling = 65535, .rad_per_count = PER_COUNT};
    encoder_state state;
    config.fd = file_with("65530\n");
    encoder_init(&state, &config);
    CHECK(encoder_read(&state, &config, START_NS) == 0 && state.count == 0);
    CHECK(encoder_read(&state, &config, START_NS + MS) == 0 && state.edge_ns == 0);
    say(config.fd, "4\n");
    CHECK(encoder_read(&state, &config, START_NS + 2 * MS) == 0 && state.count == 10);
    say(config.fd, "65530\n");
    CHECK(encoder_read(&state, &config, START_NS + 3 * MS) == 0 && state.count == 0);
    say(config.fd, "65536\n");
    CHECK(encoder_read(&state, &config, START_NS + 4 * MS) == 0 && state.illegal == 1);
    say(config.fd, "many\n");
    CHECK(encoder_read(&state, &config, START_NS) == -EIO);
    say(config.fd, "99999999999999999999999\n");
    CHECK(encoder_read(&state, &config, START_NS) == -EIO);
    CHECK(close(config.fd) == 0);
    CHECK(encoder_read(&state, &config, START_NS) == -EBADF);
    config.kind = ENCODER_NONE;
    CHECK(encoder_read(&state, &config, START_NS) == 0 && encoder_config_check(&config) == 0);
    config.kind = 9;
    CHECK(encoder_config_check(&config) == -EINVAL);
}

/* Files of the kernel hold a whole number and a line's end. Text after that does not count. */
static void an_empty_file_is_an_error_and_text_after_the_number_is_ignored(void)
{
    encoder_config config = {
        .kind = ENCODER_COUNTER, .ceiling = UINT64_MAX, .rad_per_count = PER_COUNT};
    encoder_state state;
    encoder_init(&state, &config);
    config.fd = file_with("");
    errno = 0;
    CHECK(encoder_read(&state, &config, START_NS) == -EIO && state.seeded == 0);
    say(config.fd, "12 and a line that goes on for more than any number is long");
    CHECK(encoder_read(&state, &config, START_NS) == 0 && state.raw == 12);
    say(config.fd, "1234567890123456789012345678901234567890");
    CHECK(encoder_read(&state, &config, START_NS) == -EIO);
    CHECK(ftruncate(config.fd, 0) == 0);
    say(config.fd, "54321");
    CHECK(encoder_read(&state, &config, START_NS) == 0 && state.raw == 54321);
    CHECK(ftruncate(config.fd, 0) == 0);
    say(config.fd, "7"); /* without a line's end, and without the rest of the number before */
    CHECK(encoder_read(&state, &config, START_NS) == 0 && state.raw == 7);
    CHECK(close(config.fd) == 0);
}

static void a_writer_that_has_gone_is_reported_with_the_next_look(void)
{
    wheel w = new_wheel();
    encoder_config config = edges_on(w.in);
    encoder_state state;
    encoder_init(&state, &config);
    turn(&w, 1, MS);
    CHECK(close(w.out) == 0);
    CHECK(encoder_read(&state, &config, START_NS) == 0 && state.count == 1);
    CHECK(encoder_read(&state, &config, START_NS) == -ENODEV);
    CHECK(close(w.in) == 0);
}

/* An encoder at 1000 counts/s, whose last count was at START_NS + 10 ms. */
static encoder_state counting(const encoder_config *config)
{
    encoder_state state;
    encoder_init(&state, config);
    encoder_counter(&state, config, 0, START_NS);
    encoder_counter(&state, config, 1, START_NS);
    (void)encoder_velocity_rad_s(&state, config, START_NS);
    encoder_counter(&state, config, 11, START_NS + 10 * MS);
    CHECK(fabs(encoder_velocity_rad_s(&state, config, START_NS + 10 * MS) - 1000.0) < 1e-9);
    return state;
}

static void silence_slows_a_wheel_down_and_a_quarter_of_a_second_stops_it(void)
{
    const encoder_config config = {
        .kind = ENCODER_COUNTER, .ceiling = UINT64_MAX, .rad_per_count = 1.0};
    encoder_state state = counting(&config);
    int64_t last_ns = START_NS + 10 * MS;
    CHECK(fabs(encoder_velocity_rad_s(&state, &config, last_ns + MS + MS / 20) - 1e9 / 1050000.0) <
          1e-9);
    CHECK(fabs(encoder_velocity_rad_s(&state, &config, last_ns + 250 * MS) - 4.0) < 1e-9);
    CHECK(encoder_velocity_rad_s(&state, &config, last_ns + 250 * MS + 1) == 0.0);
    state = counting(&config);
    encoder_counter(&state, &config, 10011, last_ns + 1000); /* soon, but not too soon to measure a
                                                                speed */
    CHECK(fabs(encoder_velocity_rad_s(&state, &config, last_ns + 1000) - 1e10) < 1.0);
    CHECK(fabs(encoder_velocity_rad_s(&state, &config, last_ns + 1001) - 1e9) < 1.0);
}

static void a_config_at_the_edge_of_its_range_is_good(void)
{
    encoder_config config = {.kind = ENCODER_COUNTER, .fd = 0, .ceiling = 1, .rad_per_count = 1.0};
    CHECK(encoder_config_check(&config) == 0);
    config.rad_per_count = 0.1;
    CHECK(encoder_config_check(&config) == 0);
    config.rad_per_count = -1.0;
    CHECK(encoder_config_check(&config) == 0);
    config.rad_per_count = 0.0;
    CHECK(encoder_config_check(&config) == -EINVAL);
    config.rad_per_count = 1.0;
    config.ceiling = 0;
    CHECK(encoder_config_check(&config) == -EINVAL);
    config.ceiling = 1;
    config.fd = -1;
    CHECK(encoder_config_check(&config) == -EINVAL);
    config = edges_on(3);
    CHECK(encoder_config_check(&config) == 0);
    config.rad_per_count = INFINITY;
    CHECK(encoder_config_check(&config) == -EINVAL);
    config = edges_on(3);
    config.b_offset = config.a_offset;
    CHECK(encoder_config_check(&config) == -EINVAL);
}

/* A bridge with one output and joints without encoders. */
static bridge_config bridge_of(uint32_t joints, int duty_fd)
{
    bridge_config config = {
        .exchange = &mailboxes,
        .outputs_fd = -1,
        .inputs_fd = -1,
        .event_fd = -1,
        .period_ns = 2 * MS,
        .setpoint_timeout_ns = 100 * MS,
        .stopping_ns = 300 * MS,
        .epoch = 3,
        .joint_count = joints,
        .output_count = 1,
        .output = {{.fd = duty_fd, .period_ns = 50000, .slope = {0.0, 0.0, 1.0, 1.0}}},
    };
    for (uint32_t j = 0; j < joints; j++) {
        config.joint[j].index = j;
        config.joint[j].sign = 1.0;
    }
    return config;
}

static bool comes_true(uint32_t joint, uint64_t count, joint_feedback *out)
{
    const struct timespec moment = {.tv_nsec = 5 * MS};
    for (int tries = 0; tries < 4000; tries++) {
        (void)exchange_take_feedback(&mailboxes, joint, out);
        if (out->stamp_ns > 0 && out->count == count) {
            return true;
        }
        (void)nanosleep(&moment, NULL);
    }
    return false;
}

static void the_thread_of_bridges_feeds_back_what_its_encoders_count(void)
{
    wheel w = new_wheel();
    int duty = file_with("0\n"), counter = file_with("100\n");
    bridge_config config = bridge_of(3, duty);
    config.joint[0].encoder = edges_on(w.in);
    config.joint[1].encoder = (encoder_config){
        .kind = ENCODER_COUNTER, .fd = counter, .ceiling = UINT64_MAX, .rad_per_count = -1.0};
    joint_feedback found;
    bridge_report report;
    exchange_init(&mailboxes);
    config.joint[0].encoder.rad_per_count = NAN;
    CHECK(pwm_line_start(0, &config) == -EINVAL);
    config.joint[0].encoder.rad_per_count = PER_COUNT;
    CHECK(pwm_line_start(0, &config) == 0);
    turn(&w, 9, MS);
    CHECK(comes_true(0, 9, &found) && found.epoch == 3u << 16 && isfinite(found.velocity_rad_s));
    CHECK(comes_true(1, 0, &found));
    CHECK(comes_true(2, 0, &found) && isnan(found.velocity_rad_s));
    say(counter, "95\n");
    CHECK(comes_true(1, (uint64_t)-5, &found));
    w.sequence += 4;
    turn(&w, 1, MS);
    CHECK(comes_true(0, 10, &found) && found.epoch == (3u << 16) + 1);
    CHECK(close(w.out) == 0); /* the chip is gone: the motors come to rest */
    const struct timespec moment = {.tv_nsec = 5 * MS};
    int tries = 0;
    do {
        (void)nanosleep(&moment, NULL);
        CHECK(pwm_line_read_report(0, &report) == 0);
    } while (report.running && tries++ < 4000);
    CHECK(!report.running && report.error == ENODEV && report.error_output == -2 &&
          report.encoder_lost == 4);
    CHECK(pwm_line_stop(0) == 0);
}

static void counts_of_a_board_are_fed_back_with_its_own_time(void)
{
    int duty = file_with("0\n");
    bridge_config config = bridge_of(2, duty);
    config.joint[0].encoder = (encoder_config){
        .kind = ENCODER_REPORTED, .fd = -1, .ceiling = UINT64_MAX, .rad_per_count = -0.5};
    joint_feedback found, other;
    exchange_init(&mailboxes);
    encoder_sample sample = {.count = 70, .stamp_ns = START_NS, .origin = 1};
    pwm_line_put_sample(0, 0, &sample); /* the line does not run yet */
    config.joint[0].encoder.ceiling = 0;
    CHECK(pwm_line_start(0, &config) == -EINVAL);
    config.joint[0].encoder.ceiling = UINT64_MAX;
    CHECK(pwm_line_start(0, &config) == 0);
    CHECK(comes_true(1, 0, &other)); /* feedback comes, but only of the other joint */
    CHECK(exchange_take_feedback(&mailboxes, 0, &found) == 0 || found.stamp_ns == 0);
    pwm_line_put_sample(0, 0, &sample);
    CHECK(comes_true(0, 0, &found) && found.stamp_ns == START_NS && found.epoch == 3u << 16);
    sample = (encoder_sample){.count = 60, .stamp_ns = START_NS + 10 * MS, .origin = 1};
    pwm_line_put_sample(0, 0, &sample);
    CHECK(comes_true(0, (uint64_t)-10, &found) && found.stamp_ns == START_NS + 10 * MS);
    sample = (encoder_sample){.count = 50, .stamp_ns = START_NS + 20 * MS, .origin = 1};
    pwm_line_put_sample(0, 0, &sample);
    CHECK(comes_true(0, (uint64_t)-20, &found));
    CHECK(fabs(found.velocity_rad_s - 0.5 * 10 / 0.01) < 1e-6);
    sample = (encoder_sample){.count = 4000, .stamp_ns = START_NS + 30 * MS, .origin = 2};
    pwm_line_put_sample(0, 0, &sample); /* the board has restarted: the new count is no motion */
    for (int tries = 0; tries < 4000 && found.epoch == 3u << 16; tries++) {
        (void)nanosleep(&(struct timespec){.tv_nsec = 5 * MS}, NULL);
        (void)exchange_take_feedback(&mailboxes, 0, &found);
    }
    CHECK(found.count == (uint64_t)-20);
    CHECK(found.epoch == (3u << 16) + 1 && found.stamp_ns == START_NS + 30 * MS);
    pwm_line_put_sample(0, 1, &sample); /* this joint has no reported encoder */
    CHECK(comes_true(1, 0, &other) && isnan(other.velocity_rad_s));
    CHECK(pwm_line_stop(0) == 0);
}

int main(void)
{
    events_of_the_kernel_are_counted();
    backward_counts_down_from_wherever_it_turns_round();
    the_number_of_events_wraps_without_a_loss();
    a_wheel_that_trembles_over_one_edge_stands();
    a_counter_goes_by_the_shorter_arc();
    a_wheel_is_no_faster_than_one_count_in_the_time_of_its_silence();
    a_counter_is_read_from_its_file();
    an_empty_file_is_an_error_and_text_after_the_number_is_ignored();
    a_writer_that_has_gone_is_reported_with_the_next_look();
    silence_slows_a_wheel_down_and_a_quarter_of_a_second_stops_it();
    a_config_at_the_edge_of_its_range_is_good();
    the_thread_of_bridges_feeds_back_what_its_encoders_count();
    counts_of_a_board_are_fed_back_with_its_own_time();
    return checks_report("test_encoder");
}
