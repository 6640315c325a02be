/* SPDX-License-Identifier: Apache-2.0
 * loop.h: declarations that the loop's three files share. loop.c: its life, from start to stop;
 * loop_tick.c: one tick; loop_thread.c: scheduling and memory from the kernel. */
#ifndef MOTORD_LOOP_H
#define MOTORD_LOOP_H

#include <pthread.h>
#include <stdatomic.h>

#include "exchange.h"
#include "guard.h"
#include "ingress.h"
#include "loop_late.h"

/* All memory of a tick, in one static block that is written before the first tick. */
typedef struct {
    exchange exchange;
    /* the loop's own: readable before, while and after the loop runs */
    _Alignas(CACHE_LINE_BYTES) uint8_t page[PAGE_BYTES];
    void *shared_page; /* the caller's, mapped; NULL: no shared page */
    void *journal;     /* the caller's, mapped; NULL: no journal */
    int event_fd;
    uint32_t notify_every_ticks;
    ingress ingress;
    stop_requests stops;
    /* a request to disarm has brought the base to rest and is not acknowledged yet */
    bool disarmed;
    bool stop_arrived; /* a stop request came in this tick */
    guard guard;
    arbiter arbiter;
    lease_permissions permissions;
    int64_t used_stamp_ns; /* stamp of the command that HISTOGRAM_COMMAND counted last */
    bool armed;            /* the core was armed in the tick before */
    bool woken;            /* the previous tick had a new command */
    bool stopping;         /* the set-points of the last tick were zero */
    histogram histogram[HISTOGRAM_KINDS];
    late_log late;
    core_state core; /* includes the snapshot of the last tick */
    core_input input;
    setpoints out;
    robot_state notified; /* state at the last wake-up of event_fd's reader */
    int64_t last_ns;      /* time of the previous tick; 0: no tick yet */
    int64_t resumed_ns;   /* end of the newest noticed suspend */
    int64_t still_ns;     /* length of the periods in a row in which the clock has not moved */
    int64_t period_ns;
    long page_fault_base;
    _Atomic bool clear_histograms;
    _Atomic uint64_t ticks;
    _Atomic uint64_t overruns;
    _Atomic uint64_t page_faults;
    _Atomic int64_t tick_stamp_ns;
} loop_work;

/* Reset everything, before the thread starts. Returns 0 or -errno. */
int loop_work_init(loop_work *work, const loop_config *loop, const core_config *core);
/* Run the core on a separate state, in the thread before its first tick, so that the code's pages
 * are in memory. */
void loop_rehearse(loop_work *work, core_state *scratch);
void loop_tick(loop_work *work, int64_t now_ns, int64_t deadline_ns);
/* Do a tick's work between two ticks, because a datagram has come; it is not counted as a wake-up
 * on time. Does nothing if the clock has not moved since the last tick: the next one takes the
 * datagram. */
void loop_extra_tick(loop_work *work, int64_t now_ns);
/* Write the last set-points: zero, not enabled. */
void loop_rest(loop_work *work, int64_t now_ns);

/* Settings that the kernel granted, and errors of refused ones. Written before loop_start
 * returns. */
typedef struct {
    _Atomic int policy;
    _Atomic int priority;
    _Atomic int scheduler_errno;
    _Atomic int affinity_errno;
    _Atomic int memory_lock_errno;
    _Atomic int dma_latency_errno;
} loop_grant;

enum { LOOP_STACK_BYTES = 1024 * 1024, LOOP_STACK_PREFAULT_BYTES = 128 * 1024 };

/* Create a thread without signals, at the requested policy, or at SCHED_OTHER if that is refused.
 * Returns 0 or -errno. */
int loop_thread_create(pthread_t *thread, const loop_config *loop, loop_grant *grant,
                       void *(*run)(void *), void *arg);
/* Prepare the thread, from inside: name, affinity, timer slack, flush-to-zero, stack. */
void loop_thread_prepare(const loop_config *loop, loop_grant *grant);
void loop_memory_lock(loop_grant *grant);
/* Return a descriptor, to be kept open as long as the CPU must not sleep deeply, or -1. */
int loop_dma_latency_hold(loop_grant *grant);

#endif
