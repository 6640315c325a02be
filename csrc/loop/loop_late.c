/* SPDX-License-Identifier: Apache-2.0
 * loop_late.c: counters of the loop's thread, read at the end of every tick while the log is on. */
#include "loop_late.h"

#include <fcntl.h>
#include <sched.h>
#include <stdlib.h>
#include <string.h>
#include <sys/resource.h>
#include <unistd.h>

enum { SCHEDSTAT_BYTES = 64 };

void late_init(late_log *log, int64_t from_ns)
{
    memset(log, 0, sizeof *log);
    log->from_ns = from_ns;
    log->schedstat_fd = -1;
}

/* Return the second number of /proc/thread-self/schedstat: ns in which the thread waited for a CPU
 * (Documentation/scheduler/sched-stats.rst of the kernel). -1: there is no such file. */
static int64_t read_ready_ns(const late_log *log)
{
    char text[SCHEDSTAT_BYTES];
    ssize_t bytes = log->schedstat_fd < 0 ? -1 : pread(log->schedstat_fd, text, sizeof text - 1, 0);
    if (bytes <= 0) {
        return -1;
    }
    text[bytes] = '\0';
    char *second = NULL;
    (void)strtoll(text, &second, 10);
    return strtoll(second, NULL, 10);
}

/* Read the growth of the counters since the last call. */
static void read_counters(late_log *log)
{
    late_tick *now = &log->now;
    struct rusage usage;
    memset(&usage, 0, sizeof usage);
    (void)getrusage(RUSAGE_THREAD, &usage);
    long page_faults = usage.ru_minflt + usage.ru_majflt;
    now->page_faults = (uint32_t)(page_faults - log->page_faults);
    now->preemptions = (uint32_t)(usage.ru_nivcsw - log->preemptions);
    log->page_faults = page_faults;
    log->preemptions = usage.ru_nivcsw;
    int64_t ready_ns = read_ready_ns(log);
    now->ready_ns = ready_ns < 0 ? -1 : ready_ns - log->ready_ns;
    log->ready_ns = ready_ns;
    now->cpu_before = log->cpu;
    log->cpu = sched_getcpu();
    now->cpu = log->cpu;
}

void late_open(late_log *log)
{
    if (log->from_ns != 0) {
        log->schedstat_fd = open("/proc/thread-self/schedstat", O_RDONLY | O_CLOEXEC);
        read_counters(log);
    }
}

void late_close(late_log *log)
{
    if (log->schedstat_fd >= 0) {
        (void)close(log->schedstat_fd);
        log->schedstat_fd = -1;
    }
}

void late_begin(late_log *log, int64_t now_ns, int64_t deadline_ns)
{
    if (log->from_ns != 0) {
        log->now =
            (late_tick){.deadline_ns = deadline_ns, .stage_ns[STAGE_WAKE] = now_ns - deadline_ns};
        log->marked_ns = now_ns;
    }
}

void late_mark(late_log *log, uint32_t stage)
{
    if (log->from_ns != 0) {
        int64_t now_ns = clock_now_ns();
        log->now.stage_ns[stage] = now_ns - log->marked_ns;
        log->marked_ns = now_ns;
    }
}

void late_end(late_log *log)
{
    if (log->from_ns == 0) {
        return;
    }
    read_counters(log);
    bool late = log->marked_ns - log->now.deadline_ns >= log->from_ns;
    if (late && !ring_put(&log->ring, log->place, LATE_TICKS_MAX, &log->now, sizeof log->now)) {
        log->lost++;
    }
}

bool late_take(late_log *log, late_tick *out)
{
    return ring_take(&log->ring, log->place, LATE_TICKS_MAX, out, sizeof *out);
}
