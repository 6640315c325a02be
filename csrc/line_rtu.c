/* SPDX-License-Identifier: Apache-2.0
 * line_rtu.c: the thread of a serial line: the port, the clock, the waiting. What is said and when is the machine's. */
#include <errno.h>
#include <linux/gpio.h>
#include <poll.h>
#include <pthread.h>
#include <string.h>
#include <sys/eventfd.h>
#include <sys/ioctl.h>
#include <sys/resource.h>
#include <termios.h>
#include <time.h>
#include <unistd.h>

#include "line_machine.h"
#include "loop.h"
#include "ring.h"

#ifndef TIOCSER_TEMT
#define TIOCSER_TEMT 0x01   /* linux/serial.h: the transmitter is empty */
#endif

static const int64_t NS_PER_S = 1000000000;
static const int64_t REPORT_EVERY_NS = 40 * 1000000;
static const int64_t DRAIN_LIMIT_NS = 2 * 1000000;

enum { RING_PLACES = 4 * LINE_ASKS_MAX };

typedef struct {
    mailbox box;
    line_control slot[MAILBOX_SLOTS];
} control_box_line;

typedef struct {
    mailbox box;
    line_report slot[MAILBOX_SLOTS];
} report_box;

typedef struct {
    line_machine machine;
    line_config config;
    loop_grant grant;
    pthread_t thread;
    exchange *exchange;
    control_box_line control;
    report_box report;
    ring asks, answers;
    line_ask ask_place[RING_PLACES];
    line_answer answer_place[RING_PLACES];
    histogram round_trips;
    line_report out;
    uint32_t number;
    int wake_fd;
    bool made;                  /* wake_fd is there, for good: the loop may write to it at any time */
    bool joinable;
    bool pending;               /* an answer has found no place yet */
    uint64_t rounds;
    long page_fault_base;
    int64_t reported_ns;
    uint64_t exchanges_reported;
    _Atomic bool running;
    _Atomic bool stop_asked;
    _Atomic int error;
} line_thread;

static line_thread threads[LINES_MAX];

/* --------------------------------------------------------------------------------------------------- the port */
static void sleep_until(int64_t until_ns)
{
    if (until_ns <= clock_now_ns()) {
        return;   /* the kernel would set a timer all the same, and be back late */
    }
    struct timespec until = {.tv_sec = until_ns / NS_PER_S, .tv_nsec = until_ns % NS_PER_S};
    while (clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &until, NULL) == EINTR) {
    }
}

static int turn(const line_thread *t, bool talking)
{
    struct gpio_v2_line_values values = {.bits = talking == (t->config.de_active_high != 0), .mask = 1};
    if (t->config.de_fd < 0) {
        return 0;
    }
    return ioctl(t->config.de_fd, GPIO_V2_LINE_SET_VALUES_IOCTL, &values) == 0 ? 0 : -errno;
}

static int write_all(const line_thread *t, const uint8_t *bytes, uint32_t count)
{
    for (uint32_t sent = 0; sent < count;) {
        ssize_t wrote = write(t->config.fd, bytes + sent, count - sent);
        if (wrote > 0) {
            sent += (uint32_t)wrote;
        } else if (wrote < 0 && errno != EAGAIN && errno != EINTR) {
            return -errno;
        } else {
            struct pollfd port = {.fd = t->config.fd, .events = POLLOUT};
            int ready = poll(&port, 1, 100);
            if (ready == 0 || (port.revents & (POLLERR | POLLNVAL)) != 0) {
                return -EIO;   /* an output buffer that does not empty is no line */
            }
        }
    }
    return 0;
}

/* Until the last bit has left the shift register, where the driver can say so (not on ptys and some adapters). */
static void wait_until_sent(const line_thread *t)
{
    sleep_until(t->machine.end_ns);
    int64_t limit_ns = t->machine.end_ns + DRAIN_LIMIT_NS;
    int status = TIOCSER_TEMT;
    while (ioctl(t->config.fd, TIOCSERGETLSR, &status) == 0 && (status & TIOCSER_TEMT) == 0 &&
           clock_now_ns() < limit_ns) {
        sleep_until(clock_now_ns() + (int64_t)t->machine.table.character_ns);
    }
}

static int send_request(line_thread *t, const line_output *out)
{
    int error = turn(t, true);
    if (error == 0 && t->config.de_fd >= 0) {
        sleep_until(clock_now_ns() + t->config.de_before_ns);
    }
    if (error == 0) {
        error = write_all(t, out->send, out->send_bytes);
    }
    line_machine_sent(&t->machine, clock_now_ns());
    if (t->config.de_fd >= 0) {
        wait_until_sent(t);
        sleep_until(clock_now_ns() + t->config.de_after_ns);
        int released = turn(t, false);
        error = error != 0 ? error : released;
    }
    return error;
}

/* ------------------------------------------------------------------------------------------------- the hand-over */
static void tell(const line_thread *t)
{
    const uint64_t one = 1;
    if (t->config.event_fd >= 0 && write(t->config.event_fd, &one, sizeof one) < 0) {
        return;   /* full: it is told already */
    }
}

static void count_page_faults(line_thread *t)
{
    struct rusage usage;
    if (getrusage(RUSAGE_THREAD, &usage) == 0) {
        long faults = usage.ru_minflt + usage.ru_majflt;
        if (t->out.exchanges == 0) {
            t->page_fault_base = faults;
        }
        t->out.page_faults = (uint64_t)(faults - t->page_fault_base);
    }
}

static void put_report(line_thread *t, bool running, int error)
{
    line_machine_report(&t->machine, &t->out);
    t->out.running = running;
    t->out.error = error;
    t->out.policy = t->grant.policy;
    t->out.scheduler_errno = t->grant.scheduler_errno;
    t->out.rounds = t->rounds;
    mailbox_put(&t->report.box, t->report.slot, &t->out, sizeof t->out);
}

static void report_now_and_then(line_thread *t, int64_t now_ns, bool news)
{
    if (news || now_ns - t->reported_ns >= REPORT_EVERY_NS) {
        t->reported_ns = now_ns;
        count_page_faults(t);
        put_report(t, true, 0);
    }
    if (news) {
        tell(t);
    }
}

static void take_asks(line_thread *t)
{
    line_ask ask;
    while (t->machine.ask_count < LINE_ASKS_MAX && ring_take(&t->asks, t->ask_place, RING_PLACES, &ask, sizeof ask)) {
        (void)line_machine_ask(&t->machine, &ask);
    }
}

static void hand_on(line_thread *t, const line_output *out)
{
    for (uint32_t joint = 0; joint < JOINTS_MAX; joint++) {
        if ((out->feedback_mask >> joint & 1) != 0) {
            (void)exchange_put_feedback(t->exchange, joint, &t->machine.joint[joint].feedback);
        }
    }
    if (out->answered) {
        (void)ring_put(&t->answers, t->answer_place, RING_PLACES, &t->machine.answer, sizeof t->machine.answer);
    }
    if (t->machine.round_trip_ns > 0) {
        histogram_add(&t->round_trips, t->machine.round_trip_ns);
    }
}

/* -------------------------------------------------------------------------------------------------- the thread */
/* Bytes that came, or 0; -errno: the port is gone. */
static int read_port(const line_thread *t, short revents, uint8_t *bytes, uint32_t room)
{
    if ((revents & (POLLERR | POLLNVAL)) != 0) {
        return -EIO;
    }
    if ((revents & (POLLIN | POLLHUP)) == 0) {
        return 0;
    }
    ssize_t count = read(t->config.fd, bytes, room);
    if (count > 0) {
        return (int)count;
    }
    if (count < 0 && (errno == EAGAIN || errno == EINTR)) {
        return 0;
    }
    return count < 0 ? -errno : -EIO;
}

static void drain_wake(const line_thread *t)
{
    uint64_t count;
    if (read(t->wake_fd, &count, sizeof count) < 0) {
        return;
    }
}

/* Bytes, a wake or the time; the bytes' number or -errno. */
static int wait_for_news(line_thread *t, int64_t until_ns, uint8_t *bytes, uint32_t room)
{
    struct pollfd fds[2] = {{.fd = t->config.fd, .events = POLLIN}, {.fd = t->wake_fd, .events = POLLIN}};
    int64_t left_ns = until_ns - clock_now_ns();
    left_ns = left_ns > 0 ? left_ns : 0;
    struct timespec left = {.tv_sec = left_ns / NS_PER_S, .tv_nsec = left_ns % NS_PER_S};
    if (ppoll(fds, 2, &left, NULL) < 0) {
        return errno == EINTR ? 0 : -errno;
    }
    if ((fds[1].revents & POLLIN) != 0) {
        drain_wake(t);
        (void)exchange_take_setpoints(t->exchange, t->number, &t->machine.newest);
        line_machine_kick(&t->machine, clock_now_ns());
    }
    return read_port(t, fds[0].revents, bytes, room);
}

static int round_trip(line_thread *t, const uint8_t *bytes, uint32_t count, int64_t *wake_ns)
{
    line_output out;
    (void)exchange_take_setpoints(t->exchange, t->number, &t->machine.newest);
    (void)mailbox_take(&t->control.box, t->control.slot, &t->machine.control, sizeof t->machine.control);
    take_asks(t);
    int64_t now_ns = clock_now_ns();
    line_machine_step(&t->machine, now_ns, bytes, count, &out);
    t->rounds++;
    int error = out.send != NULL ? send_request(t, &out) : 0;
    hand_on(t, &out);
    report_now_and_then(t, now_ns, out.news);
    *wake_ns = out.send != NULL ? t->machine.until_ns : out.wake_ns;
    return error;
}

static void *run(void *arg)
{
    line_thread *t = arg;
    uint8_t bytes[FRAME_BYTES_MAX];
    int64_t wake_ns = 0;
    int count = 0, error = 0;
    loop_thread_prepare(&(loop_config){.cpu_mask = t->config.cpu_mask}, &t->grant);
    (void)pthread_setname_np(pthread_self(), "motord-line");
    while (!t->stop_asked && error == 0) {
        error = round_trip(t, bytes, (uint32_t)count, &wake_ns);
        count = error == 0 ? wait_for_news(t, wake_ns, bytes, sizeof bytes) : 0;
        error = count < 0 ? count : error;
    }
    (void)turn(t, false);
    t->error = -error;
    count_page_faults(t);
    put_report(t, false, -error);
    t->running = false;
    tell(t);
    return NULL;
}

/* ---------------------------------------------------------------------------------------------------- its life */
static int make_wake(line_thread *t)
{
    if (!t->made) {
        t->wake_fd = eventfd(0, EFD_NONBLOCK | EFD_CLOEXEC);
        if (t->wake_fd < 0) {
            return -errno;
        }
        t->made = true;
    }
    return 0;
}

/* The newest of the start before: a drive may have been switched off meanwhile, and its counter with it. */
static uint32_t last_epoch(const line_machine *m)
{
    uint32_t epoch = 0;
    for (uint32_t i = 0; i < LINE_DRIVES_MAX; i++) {
        epoch = m->drive[i].epoch > epoch ? m->drive[i].epoch : epoch;
    }
    return epoch;
}

static int prepare(line_thread *t, uint32_t line, const line_config *config, const line_table *table)
{
    int error = make_wake(t);
    uint32_t epoch = last_epoch(&t->machine);
    if (error == 0) {
        error = line_machine_init(&t->machine, table, clock_now_ns());
    }
    for (uint32_t i = 0; i < LINE_DRIVES_MAX; i++) {
        t->machine.drive[i].epoch = epoch;
    }
    t->number = line;
    t->config = *config;
    t->exchange = config->exchange != NULL ? config->exchange : loop_exchange();
    memset(&t->control, 0, sizeof t->control);
    memset(&t->report, 0, sizeof t->report);
    memset(&t->asks, 0, sizeof t->asks);
    memset(&t->answers, 0, sizeof t->answers);
    memset(&t->out, 0, sizeof t->out);
    mailbox_init(&t->control.box);
    mailbox_init(&t->report.box);
    histogram_clear(&t->round_trips);
    t->rounds = 0;
    t->reported_ns = 0;
    t->error = 0;
    t->stop_asked = false;
    return error;
}

int line_start(uint32_t line, const line_config *config, const line_table *table)
{
    if (line >= LINES_MAX || config->fd < 0 || config->priority < 0 || config->priority > 99) {
        return -EINVAL;
    }
    line_thread *t = &threads[line];
    if (t->joinable) {
        return -EBUSY;
    }
    int error = prepare(t, line, config, table);
    if (error == 0) {
        t->running = true;
        put_report(t, true, 0);
        error = loop_thread_create(&t->thread, &(loop_config){.priority = config->priority}, &t->grant, run, t);
    }
    t->joinable = t->running = error == 0;
    if (error == 0) {
        (void)exchange_set_line_wake(t->exchange, line, t->wake_fd);
    }
    return error;
}

static void wake(const line_thread *t)
{
    const uint64_t one = 1;
    if (write(t->wake_fd, &one, sizeof one) < 0) {
        return;   /* full: it is awake */
    }
}

int line_stop(uint32_t line)
{
    if (line >= LINES_MAX || !threads[line].joinable) {
        return -ESRCH;
    }
    line_thread *t = &threads[line];
    (void)exchange_set_line_wake(t->exchange, line, -1);
    t->stop_asked = true;
    wake(t);
    int error = pthread_join(t->thread, NULL);
    t->joinable = false;
    return -error;
}

void line_put_control(uint32_t line, const line_control *control)
{
    if (line < LINES_MAX && threads[line].made) {
        mailbox_put(&threads[line].control.box, threads[line].control.slot, control, sizeof *control);
        wake(&threads[line]);
    }
}

int line_put_ask(uint32_t line, const line_ask *ask)
{
    if (line >= LINES_MAX || !threads[line].running) {
        return -ESRCH;
    }
    if (!line_frame_is_good(&ask->frame)) {
        return -EINVAL;
    }
    if (!ring_put(&threads[line].asks, threads[line].ask_place, RING_PLACES, ask, sizeof *ask)) {
        return -EAGAIN;
    }
    wake(&threads[line]);
    return 0;
}

int line_take_answer(uint32_t line, line_answer *out)
{
    return line < LINES_MAX && ring_take(&threads[line].answers, threads[line].answer_place, RING_PLACES, out, sizeof *out);
}

int line_read_report(uint32_t line, line_report *out)
{
    if (line >= LINES_MAX || !threads[line].made) {
        return -ESRCH;
    }
    (void)mailbox_take(&threads[line].report.box, threads[line].report.slot, out, sizeof *out);
    return 0;
}

int line_histogram_read(uint32_t line, histogram *out)
{
    if (line >= LINES_MAX) {
        return -EINVAL;
    }
    histogram_copy(out, &threads[line].round_trips);
    return 0;
}
