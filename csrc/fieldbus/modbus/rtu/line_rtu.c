/* SPDX-License-Identifier: Apache-2.0
 * line_rtu.c: the thread of a serial line: the port, the clock, the waiting. The machine decides
 * what is sent and when. */
#include <errno.h>
#include <linux/gpio.h>
#include <string.h>
#include <sys/ioctl.h>
#include <termios.h>
#include <time.h>
#include <unistd.h>

#include "line_machine.h"
#include "line_thread.h"
#include "line_trace.h"

#ifndef TIOCSER_TEMT
#define TIOCSER_TEMT 0x01 /* linux/serial.h: the transmitter is empty */
#endif

static const int64_t NS_PER_S = 1000000000;
static const int64_t DRAIN_LIMIT_NS = 2 * 1000000;

enum { RING_PLACES = 4 * LINE_REQUESTS_MAX };

typedef struct {
    line_thread life;
    line_machine machine;
    line_config config;
    line_control control[MAILBOX_SLOTS];
    line_report report[MAILBOX_SLOTS];
    ring requests, answers;
    line_request request_place[RING_PLACES];
    line_answer answer_place[RING_PLACES];
    line_report out;
} rtu_thread;

static rtu_thread threads[LINES_MAX];

static line_thread *life_of(uint32_t line)
{
    return line < LINES_MAX ? &threads[line].life : NULL;
}

/* ----------------------------------------------------------------------------- the port */
static void sleep_until(int64_t until_ns)
{
    if (until_ns <= clock_now_ns()) {
        return; /* the kernel would still set a timer, and return late */
    }
    struct timespec until = {.tv_sec = until_ns / NS_PER_S, .tv_nsec = until_ns % NS_PER_S};
    while (clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &until, NULL) == EINTR) {
    }
}

static int turn(const rtu_thread *t, bool talking)
{
    struct gpio_v2_line_values values = {.bits = talking == (t->config.de_active_high != 0),
                                         .mask = 1};
    if (t->config.de_fd < 0) {
        return 0;
    }
    return ioctl(t->config.de_fd, GPIO_V2_LINE_SET_VALUES_IOCTL, &values) == 0 ? 0 : -errno;
}

static int write_all(const rtu_thread *t, const uint8_t *bytes, uint32_t count)
{
    for (uint32_t sent = 0; sent < count;) {
        ssize_t wrote = write(t->life.at.fd, bytes + sent, count - sent);
        if (wrote > 0) {
            sent += (uint32_t)wrote;
        } else if (wrote < 0 && errno != EAGAIN && errno != EINTR) {
            return -errno;
        } else {
            struct pollfd port = {.fd = t->life.at.fd, .events = POLLOUT};
            int ready = poll(&port, 1, 100);
            if (ready == 0 || (port.revents & (POLLERR | POLLNVAL)) != 0) {
                return -EIO; /* an output buffer that does not empty means that the port is lost */
            }
        }
    }
    return 0;
}

/* Wait until the last bit has left the shift register, if the driver reports that (not on ptys and
 * some adapters). */
static void wait_until_sent(const rtu_thread *t)
{
    sleep_until(t->machine.end_ns);
    int64_t limit_ns = t->machine.end_ns + DRAIN_LIMIT_NS;
    int status = TIOCSER_TEMT;
    while (ioctl(t->life.at.fd, TIOCSERGETLSR, &status) == 0 && (status & TIOCSER_TEMT) == 0 &&
           clock_now_ns() < limit_ns) {
        sleep_until(clock_now_ns() + (int64_t)t->machine.table.character_ns);
    }
}

static int send_request(rtu_thread *t, const line_output *out)
{
    int error = turn(t, true);
    if (error == 0 && t->config.de_fd >= 0) {
        sleep_until(clock_now_ns() + t->config.de_before_ns);
    }
    if (error == 0) {
        error = write_all(t, out->send, out->send_bytes);
    }
    int64_t sent_ns = clock_now_ns();
    line_machine_sent(&t->machine, sent_ns);
    trace_bytes(t->life.line, true, sent_ns, out->send, out->send_bytes);
    if (t->config.de_fd >= 0) {
        wait_until_sent(t);
        sleep_until(clock_now_ns() + t->config.de_after_ns);
        int released = turn(t, false);
        error = error != 0 ? error : released;
    }
    return error;
}

/* ------------------------------------------------------------------------ the hand-over */
static void put_report(rtu_thread *t, bool running, int error)
{
    line_machine_report(&t->machine, &t->out);
    line_thread_put_report(&t->life, &t->out.life, running, error);
}

static void report_now_and_then(rtu_thread *t, int64_t now_ns, bool notify)
{
    if (line_thread_report_is_due(&t->life, t->out.exchanges > 0, now_ns) || notify) {
        put_report(t, true, 0);
    }
    if (notify) {
        line_thread_notify(&t->life);
    }
}

static void take_requests(rtu_thread *t)
{
    line_request request;
    while (t->machine.request_count < LINE_REQUESTS_MAX &&
           ring_take(&t->requests, t->request_place, RING_PLACES, &request, sizeof request)) {
        (void)line_machine_request(&t->machine, &request);
    }
}

static void hand_on(rtu_thread *t, const line_output *out)
{
    line_thread_put_feedback(&t->life, out->feedback_mask, t->machine.joint,
                             sizeof t->machine.joint[0]);
    if (out->answered) {
        (void)ring_put(&t->answers, t->answer_place, RING_PLACES, &t->machine.answer,
                       sizeof t->machine.answer);
    }
    if (t->machine.round_trip_ns > 0) {
        histogram_add(&t->life.round_trips, t->machine.round_trip_ns);
    }
}

/* --------------------------------------------------------------------------- the thread */
/* Wait for bytes, a wake or the time. Returns the number of bytes or -errno. */
static int wait_for_wakeup(rtu_thread *t, int64_t until_ns, uint8_t *bytes, uint32_t room)
{
    struct pollfd fds[2] = {[1] = {.fd = t->life.at.fd, .events = POLLIN}};
    int woken = line_thread_wait(&t->life, fds, 2, until_ns);
    if (woken < 0) {
        return woken;
    }
    if (woken > 0) {
        t->machine.enabled_count = line_thread_take_setpoints(&t->life, &t->machine.newest);
        line_machine_kick(&t->machine, clock_now_ns());
    }
    return line_thread_read_port(&t->life, fds[1].revents, bytes, room);
}

static int round_trip(rtu_thread *t, const uint8_t *bytes, uint32_t count, int64_t *wake_ns)
{
    line_output out;
    t->machine.enabled_count = line_thread_take_setpoints(&t->life, &t->machine.newest);
    line_thread_take_control(&t->life, &t->machine.control);
    take_requests(t);
    int64_t now_ns = clock_now_ns();
    line_machine_step(&t->machine, now_ns, bytes, count, &out);
    t->out.life.rounds++;
    int error = out.send != NULL ? send_request(t, &out) : 0;
    hand_on(t, &out);
    report_now_and_then(t, now_ns, out.notify);
    *wake_ns = out.send != NULL ? t->machine.until_ns : out.wake_ns;
    return error;
}

static void *run(void *arg)
{
    rtu_thread *t = arg;
    uint8_t bytes[FRAME_BYTES_MAX] = {0};
    int64_t wake_ns = 0;
    int count = 0, error = 0;
    line_thread_begin(&t->life, "motord-line");
    while (!t->life.stop_requested && error == 0) {
        error = round_trip(t, bytes, (uint32_t)count, &wake_ns);
        count = error == 0 ? wait_for_wakeup(t, wake_ns, bytes, sizeof bytes) : 0;
        error = count < 0 ? count : error;
    }
    (void)turn(t, false);
    line_thread_count_page_faults(&t->life, t->out.exchanges > 0);
    put_report(t, false, -error);
    line_thread_end(&t->life);
    return NULL;
}

/* ----------------------------------------------------------------------------- its life */
/* Return the newest epoch of the last start: a drive may have lost its power and its counter
 * since. */
static uint32_t last_epoch(const line_machine *m)
{
    uint32_t epoch = 0;
    for (uint32_t i = 0; i < LINE_DRIVES_MAX; i++) {
        epoch = m->drive[i].state.epoch > epoch ? m->drive[i].state.epoch : epoch;
    }
    return epoch;
}

static int prepare(rtu_thread *t, uint32_t line, const line_config *config, const line_table *table)
{
    const line_slots slots = {t->control, sizeof t->control[0], t->report, sizeof t->report[0]};
    uint32_t epoch = last_epoch(&t->machine);
    int error = line_thread_prepare(&t->life, line, &config->at, &slots);
    error = error == 0 ? line_machine_init(&t->machine, table, config->may_turn, clock_now_ns())
                       : error;
    if (error == 0 && config->left_running != 0) {
        line_take_over(&t->machine, clock_now_ns());
    }
    if (error != 0) {
        return error;
    }
    for (uint32_t i = 0; i < LINE_DRIVES_MAX; i++) {
        t->machine.drive[i].state.epoch = epoch;
    }
    t->config = *config;
    memset(&t->requests, 0, sizeof t->requests);
    memset(&t->answers, 0, sizeof t->answers);
    memset(&t->out, 0, sizeof t->out);
    put_report(t, true, 0);
    return 0;
}

int line_start(uint32_t line, const line_config *config, const line_table *table)
{
    int error = line < LINES_MAX ? prepare(&threads[line], line, config, table) : -EINVAL;
    return error == 0 ? line_thread_start(&threads[line].life, run, &threads[line]) : error;
}

int line_stop(uint32_t line)
{
    return line_thread_stop(life_of(line));
}

void line_put_control(uint32_t line, const line_control *control)
{
    line_thread_put_control(life_of(line), control);
}

int line_put_request(uint32_t line, const line_request *request)
{
    if (line >= LINES_MAX || !threads[line].life.running) {
        return -ESRCH;
    }
    if (!line_frame_is_good(&request->frame)) {
        return -EINVAL;
    }
    rtu_thread *t = &threads[line];
    return line_thread_hand_over(&t->life, &t->requests, t->request_place, RING_PLACES, request,
                                 sizeof *request);
}

int line_take_answer(uint32_t line, line_answer *out)
{
    return line < LINES_MAX && ring_take(&threads[line].answers, threads[line].answer_place,
                                         RING_PLACES, out, sizeof *out);
}

int line_read_report(uint32_t line, line_report *out)
{
    return line_thread_read_report(life_of(line), out);
}

int line_histogram_read(uint32_t line, histogram *out)
{
    return line_thread_read_round_trips(life_of(line), out);
}
