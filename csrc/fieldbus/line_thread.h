/* SPDX-License-Identifier: Apache-2.0
 * line_thread.h: the life of a line's thread, on any medium: its scheduling, its wake-ups, its
 * exchange with asyncio, its end. */
#ifndef MOTORD_LINE_THREAD_H
#define MOTORD_LINE_THREAD_H

#include <poll.h>
#include <pthread.h>
#include <stdatomic.h>

#include "loop.h"
#include "ring.h"

/* Slots of the mailboxes, with the medium's own types: MAILBOX_SLOTS each. A report begins with its
 * line_life. */
typedef struct {
    void *control;
    size_t control_bytes;
    void *report;
    size_t report_bytes;
} line_slots;

/* In static storage: the loop may write to wake_fd at any time, so it is never closed. */
typedef struct {
    line_place at;
    line_slots slots;
    mailbox control;
    mailbox report;
    histogram round_trips;
    loop_grant grant;
    pthread_t thread;
    uint32_t line;
    int wake_fd;
    bool made; /* wake_fd exists */
    bool joinable;
    long page_fault_base;
    uint64_t page_faults;
    int64_t reported_ns;
    _Atomic bool running;
    _Atomic bool stop_requested;
} line_thread;

/* ----------------------------------------- from the caller's thread; NULL: no such line */
/* Prepare a thread, before the medium's own preparation. Returns 0; -EINVAL; -EBUSY: it has not
 * been stopped; -errno: there is no eventfd. */
int line_thread_prepare(line_thread *t, uint32_t line, const line_place *at,
                        const line_slots *slots);
/* Start the thread, once there is a first report. `run` begins with line_thread_begin and ends with
 * line_thread_end. Returns 0 or -errno: then there is no thread. */
int line_thread_start(line_thread *t, void *(*run)(void *), void *arg);
int line_thread_stop(line_thread *t); /* joins; 0 or -ESRCH */
void line_thread_put_control(line_thread *t, const void *control);
/* Returns 0 or -ESRCH: never started. */
int line_thread_read_report(line_thread *t, void *out);
int line_thread_read_round_trips(const line_thread *t, histogram *out); /* 0 or -EINVAL */
/* Put an entry into the thread's queue, and wake the thread. Returns 0 or -EAGAIN: full. */
int line_thread_hand_over(const line_thread *t, ring *to, void *places, uint32_t count,
                          const void *value, size_t value_bytes);

/* ------------------------------------------------------------------------ in the thread */
/* name: as the kernel shows it, at most 15 characters */
void line_thread_begin(line_thread *t, const char *name);
void line_thread_end(line_thread *t); /* after the last report was put */
void line_thread_take_control(line_thread *t, void *out);
/* Take the set-points. Returns the number of times that they became enabled. */
uint64_t line_thread_take_setpoints(const line_thread *t, setpoints *out);
/* Put the feedback of the joints of a mask. `joints` has JOINTS_MAX of the medium's own structures,
 * each of which begins with its joint_feedback. */
void line_thread_put_feedback(const line_thread *t, uint32_t mask, const void *joints,
                              size_t joint_bytes);
/* Put a report, after filling in its life. */
void line_thread_put_report(line_thread *t, line_life *report, bool running, int error);
/* Wake asyncio for new data. */
void line_thread_notify(const line_thread *t);
/* Count page faults from the time when the thread has `worked`: its memory has been touched by
 * then. */
void line_thread_count_page_faults(line_thread *t, bool worked);
/* Whether a report is due without any change, as at regular times; then page_faults is counted for
 * it. */
bool line_thread_report_is_due(line_thread *t, bool worked, int64_t now_ns);
/* Wait for one of `fds`, a wake or the time; fds[0] is the place for the wake. Returns 1: woken; 0;
 * -errno. */
int line_thread_wait(const line_thread *t, struct pollfd *fds, nfds_t count, int64_t until_ns);
/* Read a port after poll. Returns the number of bytes, or 0; -errno: the port is lost. */
int line_thread_read_port(const line_thread *t, short revents, uint8_t *bytes, uint32_t room);

#endif
