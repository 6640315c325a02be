/* SPDX-License-Identifier: Apache-2.0
 * loop_late.h: the log of late ticks. While it is off, it costs one comparison in each stage. */
#ifndef MOTORD_LOOP_LATE_H
#define MOTORD_LOOP_LATE_H

#include "ring.h"
#include "rt.h"

typedef struct {
    int64_t from_ns; /* 0: off */
    int64_t marked_ns;
    late_tick now;
    /* the thread's counters at the end of the previous tick */
    int64_t ready_ns;
    long page_faults;
    long preemptions;
    int cpu;
    int schedstat_fd;
    _Atomic uint64_t lost;
    ring ring;
    late_tick place[LATE_TICKS_MAX];
} late_log;

void late_init(late_log *log, int64_t from_ns);
/* Open the log, in the loop's thread, whose counters it reads. */
void late_open(late_log *log);
void late_close(late_log *log);
void late_begin(late_log *log, int64_t now_ns, int64_t deadline_ns);
void late_mark(late_log *log, uint32_t stage); /* note the end of a stage */
void late_end(late_log *log);
/* Take an entry, in another thread. */
bool late_take(late_log *log, late_tick *out);

#endif
