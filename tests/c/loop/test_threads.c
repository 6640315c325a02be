/* SPDX-License-Identifier: Apache-2.0
 * Data that threads share, used by real threads: for ThreadSanitizer, and to check the values. Each
 * value is made from one number, so a mixture of two values is detected. */
#include <errno.h>
#include <math.h>
#include <pthread.h>
#include <sched.h>
#include <string.h>
#include <sys/epoll.h>
#include <sys/eventfd.h>
#include <sys/mman.h>
#include <sys/socket.h>
#include <unistd.h>

#include "check.h"
#include "exchange.h"
#include "line_trace.h"
#include "rt.h"

enum { ROUNDS = 100000, LOOP_TICKS = 300, LOOP_RUNS = 2 };

static exchange shared_exchange;
static _Alignas(64) uint8_t page[PAGE_BYTES];
static histogram shared_histogram;
static _Atomic bool done;

static pthread_t spawn(void *(*run)(void *), void *arg)
{
    pthread_t thread;
    CHECK(pthread_create(&thread, NULL, run, arg) == 0);
    return thread;
}

static void *writes(void *unused)
{
    (void)unused;
    exchange *x = &shared_exchange;
    robot_state state;
    memset(&state, 0, sizeof state);
    for (uint64_t n = 1; n <= ROUNDS; n++) {
        double f = (double)n;
        joint_feedback feedback = {
            .stamp_ns = (int64_t)n, .count = n, .velocity_rad_s = f, .temperature_c = f};
        CHECK(exchange_put_feedback(x, 3, &feedback) == 0);
        exchange_put_commands(
            x, &(command_report){.accepted = n, .lease = {{.linear_m_s = f, .angular_rad_s = f}}});
        state.tick = n;
        state.x_m = f;
        state.joint[JOINTS_MAX - 1].jumps = (uint32_t)n;
        page_write(page, &state);
        histogram_add(&shared_histogram, (int64_t)n);
        if (n % 64 == 0) {
            (void)sched_yield();
        }
    }
    done = true;
    return NULL;
}

static void *takes(void *unused)
{
    (void)unused;
    exchange *x = &shared_exchange;
    joint_feedback feedback;
    static command_report report;
    uint64_t last = 0, fresh = 0;
    while (!done || last < ROUNDS) {
        bool is_new = exchange_take_feedback(x, 3, &feedback) == 1;
        CHECK(is_new ? feedback.count > last : feedback.count == last);
        CHECK((uint64_t)feedback.stamp_ns == feedback.count &&
              feedback.velocity_rad_s == (double)feedback.count &&
              feedback.temperature_c == (double)feedback.count);
        last = feedback.count;
        fresh += is_new;
        (void)exchange_take_commands(x, &report);
        CHECK(report.lease[0].linear_m_s == (double)report.accepted &&
              report.lease[0].angular_rad_s == (double)report.accepted);
        (void)sched_yield();
    }
    CHECK(fresh > 0);
    return NULL;
}

static void *reads_the_page(void *unused)
{
    (void)unused;
    robot_state state;
    uint64_t last = 0;
    while (!done || last < ROUNDS) {
        int code = page_read(page, &state);
        CHECK(code == 0 || code == -EAGAIN || (code == -ENODATA && last == 0));
        if (code == 0) {
            CHECK(state.tick >= last && state.x_m == (double)state.tick &&
                  state.joint[JOINTS_MAX - 1].jumps == state.tick);
            last = state.tick;
        }
        (void)sched_yield();
    }
    return NULL;
}

static void *reads_the_histogram(void *unused)
{
    (void)unused;
    histogram copy;
    uint64_t last = 0;
    while (last < ROUNDS) {
        histogram_copy(&copy, &shared_histogram);
        CHECK(copy.samples >= last);
        CHECK(histogram_percentile_ns(&copy, 0.5) <= copy.max_ns);
        last = copy.samples;
        (void)sched_yield();
    }
    return NULL;
}

/* An entry is read completely or not at all. The newest one can be read until it is overwritten. */
static void *reads_the_trace(void *unused)
{
    (void)unused;
    trace_entry entry;
    uint64_t number = 0;
    while (number < ROUNDS) {
        number = line_trace_newest(0);
        if (line_trace_read(0, number, &entry) == 1) {
            CHECK(entry.stamp_ns == (int64_t)number && entry.bytes == 1 + number % TRACE_BYTES_MAX);
            for (uint32_t i = 0; i < entry.bytes; i++) {
                CHECK(entry.data[i] == (uint8_t)number);
            }
        }
        (void)sched_yield();
    }
    return NULL;
}

static void *writes_the_trace(void *unused)
{
    (void)unused;
    uint8_t data[TRACE_BYTES_MAX];
    CHECK(line_trace_switch(0, 1) == 0);
    for (uint64_t number = 1; number <= ROUNDS; number++) {
        memset(data, (uint8_t)number, sizeof data);
        trace_bytes(0, true, (int64_t)number, data, 1 + (uint32_t)(number % TRACE_BYTES_MAX));
    }
    return NULL;
}

static void entries_of_a_trace_are_whole_or_refused(void)
{
    pthread_t threads[] = {spawn(reads_the_trace, NULL), spawn(reads_the_trace, NULL),
                           spawn(writes_the_trace, NULL)};
    for (size_t i = 0; i < sizeof threads / sizeof *threads; i++) {
        CHECK(pthread_join(threads[i], NULL) == 0);
    }
}

static void values_cross_whole_and_in_order(void)
{
    exchange_init(&shared_exchange);
    CHECK(page_init(page) == 0);
    pthread_t threads[] = {spawn(takes, NULL), spawn(reads_the_page, NULL),
                           spawn(reads_the_page, NULL), spawn(reads_the_histogram, NULL),
                           spawn(writes, NULL)};
    for (size_t i = 0; i < sizeof threads / sizeof *threads; i++) {
        CHECK(pthread_join(threads[i], NULL) == 0);
    }
}

static core_config base(void)
{
    core_config config;
    memset(&config, 0, sizeof config);
    axis_limits axis = {
        .velocity_u_s = 1, .acceleration_u_s2 = 5, .deceleration_u_s2 = 5, .jerk_u_s3 = INFINITY};
    config.joint_count = 2;
    config.limits = (base_limits){.linear = axis, .angular = axis, .lateral = axis};
    /* long, because a slow machine is no fault here */
    config.command_timeout_s = config.feedback_timeout_s = config.heartbeat_timeout_s = 60;
    config.rest_velocity_rad_s = 0.05;
    config.distance_variance_m2_per_m = config.turn_variance_rad2_per_rad = 1e-3;
    config.pose_variance_floor_m2 = config.heading_variance_floor_rad2 = 1e-6;
    config.twist_variance_floor_m2_s2 = config.twist_variance_floor_rad2_s2 = 1e-6;
    for (uint32_t joint = 0; joint < 2; joint++) {
        config.joint[joint] = (joint_config){
            .row = {1.0, 0.0, joint == 0 ? -0.2 : 0.2},
            .wheel_radius_m = 0.1,
            .velocity_min_rad_s = -20,
            .velocity_max_rad_s = 20,
            .rad_per_count = 0.001,
            .counter_bits = 32,
            .pwm = {.duty_min = -1, .duty_max = 1, .slew_per_s = INFINITY, .full_duty_rad_s = 20}};
    }
    return config;
}

/* The thread of a line: takes set-points, and feeds back that the drive follows them. */
static void *is_the_line(void *unused)
{
    (void)unused;
    exchange *x = loop_exchange();
    setpoints wanted;
    double count[2] = {0, 0};
    while (!done) {
        CHECK(exchange_take_setpoints(x, 0, &wanted) >= 0);
        for (uint32_t joint = 0; joint < 2; joint++) {
            double velocity_rad_s = wanted.joint[joint].velocity_rad_s;
            count[joint] += velocity_rad_s; /* travel of 1 ms, at 0.001 rad per count */
            joint_feedback feedback = {.stamp_ns = clock_now_ns(),
                                       .count = (uint64_t)(int64_t)count[joint],
                                       .velocity_rad_s = velocity_rad_s,
                                       .enabled = 2};
            CHECK(exchange_put_feedback(x, joint, &feedback) == 0);
        }
        usleep(1000);
    }
    return NULL;
}

static int door[2];

/* The thread of asyncio: sends heartbeats and commands, and reads the state, until the wheels have
 * turned and enough ticks have passed. */
static void *is_asyncio(void *config)
{
    exchange *x = loop_exchange();
    loop_status status;
    robot_state state;
    static histogram h;
    static command_report commands;
    exchange_put_permissions(
        x, &(lease_permissions){.lease = {{.number = 1, .lifetime_ns = 1000000000}}});
    bool turned = false;
    for (uint64_t n = 1; !turned || status.ticks < LOOP_TICKS; n++) {
        int64_t now_ns = clock_now_ns();
        core_control control = {.heartbeat_ns = now_ns,
                                .armed = n % 100 > 20,
                                .limits = ((core_config *)config)->limits};
        double linear_m_s = n % 100 > 40 ? 0.3 : 0;
        exchange_put_control(x, &control);
        command_datagram command = {.magic = COMMAND_MAGIC,
                                    .version = COMMAND_VERSION,
                                    .kind = COMMAND_TWIST,
                                    .sequence = n,
                                    .stamp_ns = now_ns,
                                    .linear_m_s = linear_m_s};
        CHECK(send(door[0], &command, sizeof command, 0) == (ssize_t)sizeof command);
        CHECK(exchange_take_commands(x, &commands) >= 0);
        loop_status_read(&status);
        CHECK(loop_state_read(&state) == 0);
        turned = turned || state.setpoint_linear_m_s > 0;
        CHECK(loop_histogram_read((uint32_t)(n % HISTOGRAM_KINDS), &h) == 0);
        if (n % 50 == 0) {
            CHECK(loop_histogram_clear() == 0);
        }
        usleep(1000);
    }
    done = true;
    return NULL;
}

static void check_rest(const void *shared_page)
{
    loop_status status;
    setpoints last;
    robot_state own, shared;
    loop_status_read(&status);
    CHECK(!status.running && status.ticks >= LOOP_TICKS);
    for (uint32_t line = 0; line < LINES_MAX; line++) {
        CHECK(exchange_take_setpoints(loop_exchange(), line, &last) >= 0 && last.enabled == 0 &&
              last.joint_count == 2);
        CHECK(last.joint[0].velocity_rad_s == 0 && last.joint[0].duty == 0 &&
              last.joint[1].velocity_rad_s == 0);
    }
    CHECK(loop_state_read(&own) == 0 && page_read(shared_page, &shared) == 0);
    CHECK(memcmp(&own, &shared, sizeof own) == 0);
    CHECK(!own.armed && !own.enabled && own.setpoint_linear_m_s == 0 &&
          own.stamp_ns == last.stamp_ns);
}

static void the_loop_runs_between_asyncio_and_a_line(void)
{
    CHECK(socketpair(AF_UNIX, SOCK_DGRAM | SOCK_NONBLOCK, 0, door) == 0);
    core_config core = base();
    loop_config loop = {.rate_hz = 1000,
                        .notify_every_ticks = 10,
                        .page_fd = memfd_create("page", 0),
                        .journal_fd = memfd_create("journal", 0),
                        .event_fd = eventfd(0, EFD_NONBLOCK),
                        .command_fd = epoll_create1(0),
                        .stop_fd = -1};
    struct epoll_event listened = {.events = EPOLLIN, .data.fd = door[1]};
    CHECK(epoll_ctl(loop.command_fd, EPOLL_CTL_ADD, door[1], &listened) == 0);
    void *shared_page;
    CHECK(loop.page_fd >= 0 && loop.event_fd >= 0 && ftruncate(loop.page_fd, PAGE_BYTES) == 0);
    shared_page = mmap(NULL, PAGE_BYTES, PROT_READ, MAP_SHARED, loop.page_fd, 0);
    CHECK(shared_page != MAP_FAILED);
    for (int run = 0; run < LOOP_RUNS; run++) {
        done = false;
        CHECK(loop_start(&loop, &core) == 0);
        CHECK(loop_start(&loop, &core) == -EBUSY);
        pthread_t line = spawn(is_the_line, NULL), asyncio = spawn(is_asyncio, &core);
        CHECK(pthread_join(asyncio, NULL) == 0 && pthread_join(line, NULL) == 0);
        CHECK(loop_stop() == 0);
        CHECK(loop_stop() == -ESRCH);
        check_rest(shared_page);
    }
}

int main(void)
{
    entries_of_a_trace_are_whole_or_refused();
    values_cross_whole_and_in_order();
    the_loop_runs_between_asyncio_and_a_line();
    return checks_report("threads");
}
