/* SPDX-License-Identifier: Apache-2.0
 * line_thread.h: the life of a line's thread, whatever its medium: what the kernel grants it, what wakes it, its end. */
#ifndef MOTORD_LINE_THREAD_H
#define MOTORD_LINE_THREAD_H

#include <poll.h>
#include <pthread.h>
#include <stdatomic.h>

#include "loop.h"

/* Where it runs and whom it tells. */
typedef struct {
    uint32_t line;
    int32_t event_fd;           /* eventfd of asyncio, the caller's; -1: none */
    int32_t priority;           /* SCHED_FIFO 1..99; 0: SCHED_OTHER */
    uint64_t cpu_mask;          /* bit n: CPU n; 0: no affinity */
    exchange *exchange;         /* NULL: the loop's */
} line_place;

/* In static storage: the loop may write to wake_fd at any time, so it stays open for good. */
typedef struct {
    line_place at;
    loop_grant grant;
    pthread_t thread;
    int wake_fd;
    bool made;                  /* wake_fd is there */
    bool joinable;
    long page_fault_base;
    uint64_t page_faults;
    int64_t reported_ns;
    _Atomic bool running;
    _Atomic bool stop_asked;
} line_thread;

/* -------------------------------------------------------------------------------- from the caller's thread */
/* Before the medium's own preparation. 0; -EINVAL; -EBUSY: it has not been stopped; -errno: there is no eventfd. */
int line_thread_prepare(line_thread *t, const line_place *at);
/* `run` begins with line_thread_begin and ends with line_thread_end. 0 or -errno: then there is no thread. */
int line_thread_start(line_thread *t, void *(*run)(void *), void *arg);
int line_thread_stop(line_thread *t);                       /* joins; 0 or -ESRCH */
void line_thread_wake(const line_thread *t);

/* --------------------------------------------------------------------------------------------- in the thread */
void line_thread_begin(line_thread *t, const char *name);   /* as the kernel shows it: at most 15 characters */
void line_thread_end(line_thread *t);                       /* its last report has been put */
/* There is something that asyncio wants to hear. */
void line_thread_tell(const line_thread *t);
/* Page faults count from when it has `worked`: its memory has been touched by then. */
void line_thread_count_page_faults(line_thread *t, bool worked);
/* Now and then a report is due, whatever happens: true, and page_faults is counted for it. */
bool line_thread_report_is_due(line_thread *t, bool worked, int64_t now_ns);
/* Until one of `fds`, a wake or the time; fds[0] is the wake's own place. 1: it was woken; 0; -errno. */
int line_thread_wait(const line_thread *t, struct pollfd *fds, nfds_t count, int64_t until_ns);

#endif
