/* SPDX-License-Identifier: Apache-2.0
 * loop.c: the loop's life. The only file of csrc/ with globals: one loop in a process, in static
 * memory. */
#include <errno.h>
#include <fcntl.h>
#include <semaphore.h>
#include <sys/mman.h>
#include <time.h>
#include <unistd.h>

#include "loop.h"
#include "schedule.h"

enum life { LIFE_STOPPED, LIFE_STARTING, LIFE_RUNNING, LIFE_STOPPING };

static loop_work work;
static core_state rehearsal;
static loop_grant grant;
static loop_config config;
static pthread_t thread;
static sem_t ticking; /* posted after the first tick */
static int dma_latency_fd = -1;
static _Atomic int life = LIFE_STOPPED;
static _Atomic bool stop_requested;
static pthread_once_t exchange_made = PTHREAD_ONCE_INIT;

static const int64_t NS_PER_S = 1000000000;

static void sleep_until(int64_t deadline_ns)
{
    struct timespec until = {.tv_sec = deadline_ns / NS_PER_S, .tv_nsec = deadline_ns % NS_PER_S};
    while (clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &until, NULL) == EINTR) {
    }
}

/* Wait for the deadline. A command takes effect at once, but only one between two ticks: a flood of
 * commands costs no more. */
static void wait_until(int64_t deadline_ns)
{
    bool listening = work.ingress.epoll_fd >= 0;
    if (listening && !ingress_wait(&work.ingress, deadline_ns)) {
        /* the tick is due; a sleep until a past time would still cost a wake-up */
        return;
    }
    if (listening) {
        loop_extra_tick(&work, clock_now_ns());
    }
    if (clock_now_ns() < deadline_ns) {
        sleep_until(deadline_ns);
    }
}

static void *run(void *unused)
{
    (void)unused;
    loop_thread_prepare(&config, &grant);
    loop_rehearse(&work, &rehearsal);
    late_open(&work.late);
    int64_t deadline_ns = clock_now_ns();
    while (!stop_requested) {
        loop_tick(&work, clock_now_ns(), deadline_ns);
        if (work.ticks == 1) {
            (void)sem_post(&ticking);
        }
        work.overruns += schedule_next(&deadline_ns, work.period_ns, clock_now_ns());
        wait_until(deadline_ns);
    }
    late_close(&work.late);
    loop_rest(&work, clock_now_ns());
    return NULL;
}

static bool is_good(const loop_config *loop)
{
    return loop->rate_hz >= 10 && loop->rate_hz <= 20000 && loop->priority >= 0 &&
           loop->priority <= 99 && loop->page_fd >= -1 && loop->journal_fd >= -1 &&
           loop->event_fd >= -1 && loop->command_fd >= -1 && loop->stop_fd >= -1 &&
           loop->late_from_ns >= 0 && guard_config_check(&loop->guard) == 0;
}

/* Map a file. It gets its full size first: a hole in a full file system would be a SIGBUS in the
 * thread. */
static int map_file(int fd, size_t bytes, void **memory, int (*init)(void *))
{
    *memory = NULL;
    if (fd < 0) {
        return 0;
    }
    int error = posix_fallocate(fd, 0, (off_t)bytes);
    if (error != 0) {
        return -error;
    }
    void *mapped = mmap(NULL, bytes, PROT_READ | PROT_WRITE, MAP_SHARED | MAP_POPULATE, fd, 0);
    if (mapped == MAP_FAILED) {
        return -errno;
    }
    *memory = mapped;
    return init(mapped);
}

static void unmap_file(void **memory, size_t bytes)
{
    if (*memory != NULL) {
        (void)munmap(*memory, bytes);
        *memory = NULL;
    }
}

static void hold_machine(void)
{
    grant.memory_lock_errno = 0;
    grant.dma_latency_errno = 0;
    if (config.lock_memory) {
        loop_memory_lock(&grant);
    }
    if (config.hold_dma_latency) {
        dma_latency_fd = loop_dma_latency_hold(&grant);
    }
}

static void release_machine(void)
{
    if (dma_latency_fd >= 0) {
        (void)close(dma_latency_fd);
        dma_latency_fd = -1;
    }
    if (config.lock_memory && grant.memory_lock_errno == 0) {
        (void)munlockall();
    }
    unmap_file(&work.shared_page, PAGE_BYTES);
    unmap_file(&work.journal, journal_bytes());
    (void)sem_destroy(&ticking);
}

static int start(const loop_config *loop, const core_config *core)
{
    if (!is_good(loop)) {
        return -EINVAL;
    }
    int error = loop_work_init(&work, loop, core);
    if (error != 0) {
        return error;
    }
    config = *loop;
    stop_requested = false;
    if (sem_init(&ticking, 0, 0) != 0) {
        return -errno;
    }
    error = map_file(loop->page_fd, PAGE_BYTES, &work.shared_page, page_init);
    if (error == 0) {
        error = map_file(loop->journal_fd, journal_bytes(), &work.journal, journal_init);
    }
    hold_machine();
    if (error == 0) {
        error = loop_thread_create(&thread, &config, &grant, run, NULL);
    }
    if (error != 0) {
        release_machine();
        return error;
    }
    while (sem_wait(&ticking) != 0) { /* after a signal, wait again: it does not delay the first
                                         tick */
    }
    return 0;
}

int loop_start(const loop_config *loop, const core_config *core)
{
    (void)loop_exchange();
    int stopped = LIFE_STOPPED;
    if (!atomic_compare_exchange_strong(&life, &stopped, LIFE_STARTING)) {
        return -EBUSY;
    }
    int error = start(loop, core);
    life = error == 0 ? LIFE_RUNNING : LIFE_STOPPED;
    return error;
}

int loop_stop(void)
{
    int running = LIFE_RUNNING;
    if (!atomic_compare_exchange_strong(&life, &running, LIFE_STOPPING)) {
        return -ESRCH;
    }
    stop_requested = true;
    int error = pthread_join(thread, NULL);
    release_machine();
    life = LIFE_STOPPED;
    return -error;
}

static void make_exchange(void)
{
    exchange_init(&work.exchange);
}

exchange *loop_exchange(void)
{
    (void)pthread_once(&exchange_made, make_exchange);
    return &work.exchange;
}

void loop_status_read(loop_status *out)
{
    *out = (loop_status){
        .running = life == LIFE_RUNNING,
        .policy = grant.policy,
        .priority = grant.priority,
        .scheduler_errno = grant.scheduler_errno,
        .affinity_errno = grant.affinity_errno,
        .memory_lock_errno = grant.memory_lock_errno,
        .dma_latency_errno = grant.dma_latency_errno,
        .ticks = work.ticks,
        .overruns = work.overruns,
        .page_faults = work.page_faults,
        .tick_stamp_ns = work.tick_stamp_ns,
        .estop_input = work.guard.estop_input,
        .watchdog_well = work.guard.watchdog_well,
        .watchdog_edges = work.guard.watchdog_edges,
        .watchdog_errno = work.guard.watchdog_errno,
        .late_lost = work.late.lost,
    };
}

void loop_stop_requests(stop_request_report *out)
{
    *out = (stop_request_report){.refused = work.stops.refused, .pid = work.stops.pid};
    for (uint32_t kind = 0; kind < STOP_REQUEST_KINDS; kind++) {
        out->count[kind] = work.stops.count[kind];
    }
}

void loop_acknowledge_stops(const uint64_t *count)
{
    for (uint32_t kind = 0; kind < STOP_REQUEST_KINDS; kind++) {
        work.stops.acknowledged[kind] = count[kind];
    }
}

int loop_histogram_read(uint32_t kind, histogram *out)
{
    if (kind >= HISTOGRAM_KINDS) {
        return -EINVAL;
    }
    histogram_copy(out, &work.histogram[kind]);
    return 0;
}

int loop_histogram_clear(void)
{
    if (life != LIFE_RUNNING) {
        return -ESRCH;
    }
    work.clear_histograms = true;
    return 0;
}

int loop_late_take(late_tick *out)
{
    return late_take(&work.late, out) ? 1 : 0;
}

int loop_state_read(robot_state *out)
{
    return page_read(work.page, out);
}
