/* SPDX-License-Identifier: Apache-2.0
 * line_thread.c: the life of a line's thread, whatever its medium. */
#include "fresh.h"
#include "line_thread.h"
#include "line_trace.h"

#include <errno.h>
#include <string.h>
#include <sys/eventfd.h>
#include <sys/resource.h>
#include <time.h>
#include <unistd.h>

static const int64_t NS_PER_S = 1000000000;
static const int64_t REPORT_EVERY_NS = 40 * 1000000;

/* Wake an eventfd's reader. If the eventfd is full, the reader is woken already. */
static void add_one(int fd)
{
    const uint64_t one = 1;
    if (write(fd, &one, sizeof one) < 0) {
        return;
    }
}

/* ------------------------------------------------------------- from the caller's thread */
static void clear(line_thread *t, uint32_t line, const line_place *at, const line_slots *slots)
{
    t->at = *at;
    t->at.exchange = at->exchange != NULL ? at->exchange : loop_exchange();
    t->line = line;
    t->slots = *slots;
    memset(slots->control, 0, MAILBOX_SLOTS * slots->control_bytes);
    memset(slots->report, 0, MAILBOX_SLOTS * slots->report_bytes);
    mailbox_init(&t->control);
    mailbox_init(&t->report);
    histogram_clear(&t->round_trips);
    t->page_faults = 0;
    t->reported_ns = 0;
    t->stop_requested = false;
}

int line_thread_prepare(line_thread *t, uint32_t line, const line_place *at,
                        const line_slots *slots)
{
    if (t == NULL || at->fd < 0 || at->priority < 0 || at->priority > 99) {
        return -EINVAL;
    }
    if (t->joinable) {
        return -EBUSY;
    }
    if (!t->made) {
        t->wake_fd = eventfd(0, EFD_NONBLOCK | EFD_CLOEXEC);
        if (t->wake_fd < 0) {
            return -errno;
        }
        t->made = true;
    }
    clear(t, line, at, slots);
    return 0;
}

int line_thread_start(line_thread *t, void *(*run)(void *), void *arg)
{
    t->running = true; /* before it can end */
    int error = loop_thread_create(&t->thread, &(loop_config){.priority = t->at.priority},
                                   &t->grant, run, arg);
    if (error != 0) {
        t->running = false;
        return error;
    }
    t->joinable = true;
    (void)exchange_set_line_wake(t->at.exchange, t->line, t->wake_fd);
    return 0;
}

int line_thread_stop(line_thread *t)
{
    if (t == NULL || !t->joinable) {
        return -ESRCH;
    }
    (void)exchange_set_line_wake(t->at.exchange, t->line, -1);
    t->stop_requested = true;
    add_one(t->wake_fd);
    int error = pthread_join(t->thread, NULL);
    t->joinable = false;
    return -error;
}

void line_thread_put_control(line_thread *t, const void *control)
{
    if (t != NULL && t->made) {
        mailbox_put(&t->control, t->slots.control, control, t->slots.control_bytes);
        add_one(t->wake_fd);
    }
}

int line_thread_read_report(line_thread *t, void *out)
{
    if (t == NULL || !t->made) {
        return -ESRCH;
    }
    (void)mailbox_take(&t->report, t->slots.report, out, t->slots.report_bytes);
    return 0;
}

int line_thread_read_round_trips(const line_thread *t, histogram *out)
{
    if (t == NULL) {
        return -EINVAL;
    }
    histogram_copy(out, &t->round_trips);
    return 0;
}

int line_thread_hand_over(const line_thread *t, ring *to, void *places, uint32_t count,
                          const void *value, size_t value_bytes)
{
    if (!ring_put(to, places, count, value, value_bytes)) {
        return -EAGAIN;
    }
    add_one(t->wake_fd);
    return 0;
}

/* ------------------------------------------------------------------------ in the thread */
void line_thread_begin(line_thread *t, const char *name)
{
    loop_thread_prepare(&(loop_config){.cpu_mask = t->at.cpu_mask}, &t->grant);
    (void)pthread_setname_np(pthread_self(), name);
}

void line_thread_end(line_thread *t)
{
    t->running = false;
    line_thread_notify(t);
}

void line_thread_take_control(line_thread *t, void *out)
{
    (void)mailbox_take(&t->control, t->slots.control, out, t->slots.control_bytes);
}

uint64_t line_thread_take_setpoints(const line_thread *t, setpoints *out)
{
    uint64_t enabled_count = exchange_enabled_count(t->at.exchange, t->line);
    (void)exchange_take_setpoints(t->at.exchange, t->line, out);
    out->stamp_ns = stamp_since(out->stamp_ns, clock_resumed_ns());
    return enabled_count;
}

void line_thread_put_feedback(const line_thread *t, uint32_t mask, const void *joints,
                              size_t joint_bytes)
{
    for (uint32_t joint = 0; joint < JOINTS_MAX; joint++) {
        if ((mask >> joint & 1) != 0) {
            (void)exchange_put_feedback(t->at.exchange, joint,
                                        (const void *)((const char *)joints + joint * joint_bytes));
        }
    }
}

void line_thread_put_report(line_thread *t, line_life *report, bool running, int error)
{
    report->running = running;
    report->error = error;
    report->policy = t->grant.policy;
    report->scheduler_errno = t->grant.scheduler_errno;
    report->page_faults = t->page_faults;
    mailbox_put(&t->report, t->slots.report, report, t->slots.report_bytes);
}

void line_thread_notify(const line_thread *t)
{
    if (t->at.event_fd >= 0) {
        add_one(t->at.event_fd);
    }
}

void line_thread_count_page_faults(line_thread *t, bool worked)
{
    struct rusage usage;
    if (getrusage(RUSAGE_THREAD, &usage) == 0) {
        long faults = usage.ru_minflt + usage.ru_majflt;
        t->page_fault_base = worked ? t->page_fault_base : faults;
        t->page_faults = (uint64_t)(faults - t->page_fault_base);
    }
}

bool line_thread_report_is_due(line_thread *t, bool worked, int64_t now_ns)
{
    if (now_ns - t->reported_ns < REPORT_EVERY_NS) {
        return false;
    }
    t->reported_ns = now_ns;
    line_thread_count_page_faults(t, worked);
    return true;
}

int line_thread_wait(const line_thread *t, struct pollfd *fds, nfds_t count, int64_t until_ns)
{
    int64_t left_ns = until_ns - clock_now_ns();
    left_ns = left_ns > 0 ? left_ns : 0;
    struct timespec left = {.tv_sec = left_ns / NS_PER_S, .tv_nsec = left_ns % NS_PER_S};
    fds[0] = (struct pollfd){.fd = t->wake_fd, .events = POLLIN};
    int ready = ppoll(fds, count, &left, NULL);
    if (ready < 0) {
        for (nfds_t i = 0; i < count; i++) {
            fds[i].revents = 0;
        }
        return errno == EINTR ? 0 : -errno;
    }
    uint64_t wakes;
    return (fds[0].revents & POLLIN) != 0 && read(t->wake_fd, &wakes, sizeof wakes) > 0;
}

int line_thread_read_port(const line_thread *t, short revents, uint8_t *bytes, uint32_t room)
{
    if ((revents & (POLLERR | POLLNVAL)) != 0) {
        return -EIO;
    }
    if ((revents & (POLLIN | POLLHUP)) == 0) {
        return 0;
    }
    ssize_t count = read(t->at.fd, bytes, room);
    if (count > 0) {
        trace_bytes(t->line, false, clock_now_ns(), bytes, (uint32_t)count);
        return (int)count;
    }
    if (count < 0 && (errno == EAGAIN || errno == EINTR)) {
        return 0;
    }
    return count < 0 ? -errno : -EIO;
}
