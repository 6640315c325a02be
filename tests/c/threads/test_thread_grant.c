/* SPDX-License-Identifier: Apache-2.0
 * loop_thread.c on a kernel that grants or refuses locked memory, a scheduler and a CPU that stays
 * awake. */
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <linux/capability.h>
#include <math.h>
#include <sched.h>
#include <signal.h>
#include <stdarg.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/prctl.h>
#include <sys/resource.h>
#include <sys/syscall.h>
#include <time.h>
#include <unistd.h>

#include "check.h"
#include "loop.h"

enum { LOCKS_MAX = 64, PRIORITY = 40 };

static struct {
    bool unlimited, capable, refuses_policy;
    int lock_all_fails, lock_fails, open_fails;
    int lock_fails_times;
    int flags; /* of mlockall; 0: not called */
    uintptr_t begin[LOCKS_MAX], end[LOCKS_MAX];
    int locks;
    int policy, attempts; /* of threads that are created */
    int latency_fd;
} kernel;

/* These replace the C library's functions. */
int getrlimit(__rlimit_resource_t resource, struct rlimit *limit)
{
    if (resource != RLIMIT_MEMLOCK) { /* a sanitizer's */
        return prlimit(0, resource, NULL, limit);
    }
    rlim_t bytes = kernel.unlimited ? RLIM_INFINITY : 8 << 20;
    *limit = (struct rlimit){bytes, RLIM_INFINITY};
    return 0;
}

long syscall(long number, ...)
{
    CHECK(number == SYS_capget);
    va_list more;
    va_start(more, number);
    (void)va_arg(more, struct __user_cap_header_struct *);
    struct __user_cap_data_struct *data = va_arg(more, struct __user_cap_data_struct *);
    va_end(more);
    data[0].effective = kernel.capable ? 1U << CAP_IPC_LOCK : ~(1U << CAP_IPC_LOCK);
    return 0;
}

int mlockall(int flags)
{
    errno = kernel.lock_all_fails;
    kernel.flags = flags;
    return errno == 0 ? 0 : -1;
}

int mlock(const void *begin, size_t bytes)
{
    CHECK(kernel.locks < LOCKS_MAX && (uintptr_t)begin % 4096 == 0);
    kernel.begin[kernel.locks] = (uintptr_t)begin;
    kernel.end[kernel.locks++] = (uintptr_t)begin + bytes;
    if (kernel.lock_fails == 0 || kernel.locks > kernel.lock_fails_times) {
        return 0;
    }
    errno = kernel.lock_fails;
    return -1;
}

int open(const char *path, int flags, ...)
{
    if (strcmp(path, "/dev/cpu_dma_latency") != 0) { /* gcov's files */
        va_list more;
        va_start(more, flags);
        mode_t mode = (flags & O_CREAT) != 0 ? va_arg(more, mode_t) : 0;
        va_end(more);
        return openat(AT_FDCWD, path, flags, mode);
    }
    CHECK((flags & O_ACCMODE) == O_WRONLY && (flags & O_CLOEXEC) != 0);
    errno = kernel.open_fails;
    return errno == 0 ? dup(kernel.latency_fd) : -1;
}

int pthread_attr_setschedpolicy(pthread_attr_t *attr, int policy)
{
    kernel.attempts++;
    kernel.policy = policy;
    if (policy != SCHED_OTHER && kernel.refuses_policy) {
        return EPERM;
    }
    int (*set)(pthread_attr_t *, int) = NULL;
    *(void **)&set = dlsym(RTLD_NEXT, "pthread_attr_setschedpolicy");
    return set(attr, policy);
}

static bool is_locked(const void *place)
{
    bool locked = false;
    for (int i = 0; i < kernel.locks; i++) {
        locked |= (uintptr_t)place >= kernel.begin[i] && (uintptr_t)place < kernel.end[i];
    }
    return locked;
}

/* With mutants loop_thread.c is a library of its own. */
static bool is_of_another_library(const void *place)
{
    Dl_info own, other;
    CHECK(dladdr((const void *)(uintptr_t)&loop_memory_lock, &own) != 0 &&
          dladdr(place, &other) != 0);
    return own.dli_fbase != other.dli_fbase;
}

static loop_grant lock_memory(void)
{
    loop_grant grant = {.memory_lock_errno = -1};
    kernel.flags = kernel.locks = 0;
    loop_memory_lock(&grant);
    return grant;
}

/* ------------------------------------------------------------------------------- memory */
static void memory_is_locked_where_the_limit_or_a_capability_allows_all_of_it(void)
{
    for (int by = 1; by < 4; by++) {
        kernel.unlimited = (by & 1) != 0;
        kernel.capable = (by & 2) != 0;
        CHECK(lock_memory().memory_lock_errno == 0);
        CHECK(kernel.flags == (MCL_CURRENT | MCL_FUTURE | MCL_ONFAULT));
        CHECK(is_locked((const void *)(uintptr_t)&loop_memory_lock));
        CHECK(is_locked(loop_exchange()) || is_of_another_library(loop_exchange()));
        CHECK(is_locked(dlsym(RTLD_DEFAULT, "clock_nanosleep")) &&
              is_locked(dlsym(RTLD_DEFAULT, "exp")));
    }
}

static void with_a_limit_nothing_is_locked(void)
{
    kernel.unlimited = kernel.capable = false;
    CHECK(lock_memory().memory_lock_errno == ENOMEM && kernel.flags == 0 && kernel.locks == 0);
}

static void a_refusal_to_lock_is_recorded(void)
{
    kernel.unlimited = true;
    kernel.lock_all_fails = EPERM;
    CHECK(lock_memory().memory_lock_errno == EPERM && kernel.locks == 0);
    kernel.lock_all_fails = 0;
    kernel.lock_fails = EAGAIN;
    for (kernel.lock_fails_times = 1; kernel.lock_fails_times < 4; kernel.lock_fails_times++) {
        CHECK(lock_memory().memory_lock_errno == EAGAIN && kernel.locks > 0);
    }
    kernel.lock_fails = 0;
}

/* ---------------------------------------------------------------------- a CPU that stays awake */
static void the_latency_of_zero_is_held_by_an_open_file(void)
{
    loop_grant grant = {.dma_latency_errno = -1};
    int32_t latency_us = -1;
    kernel.latency_fd = memfd_create("latency", 0);
    int fd = loop_dma_latency_hold(&grant);
    CHECK(fd >= 0 && fd != kernel.latency_fd && grant.dma_latency_errno == 0);
    CHECK(lseek(fd, 0, SEEK_END) == 4 && pread(fd, &latency_us, 4, 0) == 4 && latency_us == 0);
    CHECK(close(fd) == 0 && close(kernel.latency_fd) == 0);
    kernel.open_fails = EACCES;
    CHECK(loop_dma_latency_hold(&grant) == -1 && grant.dma_latency_errno == EACCES);
    kernel.open_fails = 0;
    int ends[2];
    CHECK(pipe(ends) == 0);
    kernel.latency_fd = ends[0]; /* cannot be written */
    CHECK(loop_dma_latency_hold(&grant) == -1 && grant.dma_latency_errno == EBADF);
    int next = dup(ends[0]);
    CHECK(next == fd || next > ends[1]); /* it was closed again */
    CHECK(close(next) == 0 && close(ends[0]) == 0 && close(ends[1]) == 0);
}

/* ------------------------------------------------------------------------------- the thread */
typedef struct {
    loop_config loop;
    loop_grant grant;
    sigset_t blocked;
    cpu_set_t cpus;
    char name[16];
    long slack_ns;
    size_t stack_bytes;
    int policy, priority; /* in force */
    double tiny;          /* half of the smallest normal number */
} thread_view;

static volatile double half = 0.5;

static void *looks_around(void *arg)
{
    thread_view *seen = arg;
    pthread_attr_t attr;
    loop_thread_prepare(&seen->loop, &seen->grant);
    CHECK(pthread_sigmask(SIG_SETMASK, NULL, &seen->blocked) == 0);
    CHECK(pthread_getaffinity_np(pthread_self(), sizeof seen->cpus, &seen->cpus) == 0);
    CHECK(pthread_getname_np(pthread_self(), seen->name, sizeof seen->name) == 0);
    struct sched_param param;
    CHECK(pthread_getschedparam(pthread_self(), &seen->policy, &param) == 0);
    seen->priority = param.sched_priority;
    seen->slack_ns = prctl(PR_GET_TIMERSLACK, 0UL, 0UL, 0UL, 0UL);
    CHECK(pthread_getattr_np(pthread_self(), &attr) == 0 &&
          pthread_attr_getstacksize(&attr, &seen->stack_bytes) == 0);
    CHECK(pthread_attr_destroy(&attr) == 0);
    volatile double smallest_normal = 0x1p-1022;
    seen->tiny = smallest_normal * half;
    return NULL;
}

static thread_view view_of_a_thread(loop_config loop)
{
    thread_view seen = {.loop = loop, .grant = {.affinity_errno = -1}};
    pthread_t thread;
    sigset_t before, after;
    CHECK(pthread_sigmask(SIG_SETMASK, NULL, &before) == 0);
    CHECK(loop_thread_create(&thread, &loop, &seen.grant, looks_around, &seen) == 0);
    CHECK(pthread_join(thread, NULL) == 0);
    CHECK(pthread_sigmask(SIG_SETMASK, NULL, &after) == 0);
    CHECK(sigismember(&before, SIGTERM) == sigismember(&after, SIGTERM));
    return seen;
}

static void a_thread_has_no_signals_its_cpus_and_no_slack(void)
{
    cpu_set_t all;
    CHECK(sched_getaffinity(0, sizeof all, &all) == 0);
    size_t cpu = 0;
    while (!CPU_ISSET(cpu, &all)) {
        cpu++;
    }
    thread_view seen = view_of_a_thread((loop_config){.cpu_mask = UINT64_C(1) << cpu});
    CHECK(sigismember(&seen.blocked, SIGTERM) == 1 && sigismember(&seen.blocked, SIGINT) == 1);
    CHECK(CPU_COUNT(&seen.cpus) == 1 && CPU_ISSET(cpu, &seen.cpus));
    CHECK(seen.grant.affinity_errno == 0 && seen.slack_ns == 1);
    CHECK(strcmp(seen.name, "motord-loop") == 0 && seen.stack_bytes >= LOOP_STACK_BYTES);
    CHECK(seen.tiny == 0.0 && 0x1p-1022 * half > 0.0);
    seen = view_of_a_thread((loop_config){0});
    CHECK(CPU_EQUAL(&seen.cpus, &all) && seen.grant.affinity_errno == 0);
}

static void a_refused_scheduler_is_recorded_and_the_thread_runs_without(void)
{
    kernel.refuses_policy = true;
    kernel.attempts = 0;
    thread_view seen = view_of_a_thread((loop_config){.priority = PRIORITY});
    CHECK(kernel.attempts == 2 && kernel.policy == SCHED_OTHER && seen.policy == SCHED_OTHER);
    CHECK(seen.grant.policy == SCHED_OTHER && seen.grant.priority == 0 &&
          seen.grant.scheduler_errno == EPERM);
    kernel.refuses_policy = false;
    seen = view_of_a_thread((loop_config){.priority = PRIORITY}); /* as this kernel has it */
    bool granted = seen.grant.policy == SCHED_FIFO;
    CHECK(seen.policy == seen.grant.policy && seen.priority == (granted ? PRIORITY : 0));
    CHECK(seen.grant.priority == seen.priority &&
          seen.grant.scheduler_errno == (granted ? 0 : EPERM));
    kernel.attempts = 0;
    seen = view_of_a_thread((loop_config){0});
    CHECK(seen.grant.policy == SCHED_OTHER && seen.policy == SCHED_OTHER &&
          seen.grant.scheduler_errno == 0 && kernel.attempts == 1);
}

int main(void)
{
    memory_is_locked_where_the_limit_or_a_capability_allows_all_of_it();
    with_a_limit_nothing_is_locked();
    a_refusal_to_lock_is_recorded();
    the_latency_of_zero_is_held_by_an_open_file();
    a_thread_has_no_signals_its_cpus_and_no_slack();
    a_refused_scheduler_is_recorded_and_the_thread_runs_without();
    return checks_report("thread grant");
}
