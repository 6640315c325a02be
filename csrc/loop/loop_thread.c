/* SPDX-License-Identifier: Apache-2.0
 * loop_thread.c: settings of a real-time thread that the kernel has to grant. A refusal is
 * recorded, not fatal: the loop runs without them. */
#include <errno.h>
#include <fcntl.h>
#include <link.h>
#include <linux/capability.h>
#include <math.h>
#include <sched.h>
#include <signal.h>
#include <sys/mman.h>
#include <sys/prctl.h>
#include <sys/resource.h>
#include <sys/syscall.h>
#include <time.h>
#include <unistd.h>

#include "loop.h"

#if defined(__x86_64__)
#include <xmmintrin.h>
#endif

enum { CODE_PAGE_BYTES = 4096 }; /* smallest possible page */

/* Numbers near rest decay into denormals, which make a tick on x86 4.6 times as long; a robot does
 * not need 1e-308 m/s. */
static void flush_denormals_to_zero(void)
{
#if defined(__x86_64__)
    /* Intel SDM vol. 1, 10.2.3 */
    const unsigned int flush_to_zero = 1U << 15, denormals_are_zero = 1U << 6;
    _mm_setcsr(_mm_getcsr() | flush_to_zero | denormals_are_zero);
#elif defined(__aarch64__)
    uint64_t fpcr;
    __asm__ volatile("mrs %0, fpcr" : "=r"(fpcr));
    __asm__ volatile("msr fpcr, %0" : : "r"(fpcr | (UINT64_C(1) << 24))); /* FZ, Arm ARM C5.2.8 */
#endif
}

static void prefault_stack(void)
{
    volatile uint8_t stack[LOOP_STACK_PREFAULT_BYTES];
    for (size_t i = 0; i < sizeof stack; i += 1024) {
        stack[i] = 1;
    }
}

static int set_affinity(uint64_t cpu_mask)
{
    cpu_set_t set;
    CPU_ZERO(&set);
    for (size_t cpu = 0; cpu < 64; cpu++) {
        if (cpu_mask >> cpu & 1) {
            CPU_SET(cpu, &set);
        }
    }
    return pthread_setaffinity_np(pthread_self(), sizeof set, &set);
}

static uintptr_t segment_at(const struct dl_phdr_info *object, uint16_t i)
{
    return object->dlpi_addr + object->dlpi_phdr[i].p_vaddr;
}

static bool is_loaded_at(const struct dl_phdr_info *object, uintptr_t place)
{
    for (uint16_t i = 0; i < object->dlpi_phnum; i++) {
        uintptr_t begin = segment_at(object, i);
        if (object->dlpi_phdr[i].p_type == PT_LOAD && place >= begin &&
            place < begin + object->dlpi_phdr[i].p_memsz) {
            return true;
        }
    }
    return false;
}

/* Read each read-only page of this library, so that code that first runs hours later is in memory.
 * All of it is read, even the gaps that the address sanitizer watches. Source:
 * dl_iterate_phdr(3). */
__attribute__((no_sanitize("address"))) static int prefault_code(struct dl_phdr_info *object,
                                                                 size_t size, void *data)
{
    (void)size;
    (void)data;
    if (!is_loaded_at(object, (uintptr_t)&prefault_code)) {
        return 0;
    }
    for (uint16_t i = 0; i < object->dlpi_phnum; i++) {
        const ElfW(Phdr) *segment = &object->dlpi_phdr[i];
        bool is_read = segment->p_type == PT_LOAD && (segment->p_flags & PF_W) == 0;
        for (size_t at = 0; is_read && at < segment->p_memsz; at += CODE_PAGE_BYTES) {
            (void)*(const volatile uint8_t *)(segment_at(object, i) + at);
        }
    }
    return 1;
}

void loop_thread_prepare(const loop_config *loop, loop_grant *grant)
{
    (void)pthread_setname_np(pthread_self(), "motord-loop");
    /* with the default slack, SCHED_OTHER would wake up to 50 us late */
    (void)prctl(PR_SET_TIMERSLACK, 1UL, 0UL, 0UL, 0UL);
    grant->affinity_errno = loop->cpu_mask == 0 ? 0 : set_affinity(loop->cpu_mask);
    flush_denormals_to_zero();
    prefault_stack();
    (void)dl_iterate_phdr(prefault_code, NULL);
}

static int create_with_policy(pthread_t *thread, int policy, int priority, void *(*run)(void *),
                              void *arg)
{
    struct sched_param param = {.sched_priority = priority};
    pthread_attr_t attr;
    int error = pthread_attr_init(&attr);
    if (error != 0) {
        return error;
    }
    error = pthread_attr_setstacksize(&attr, LOOP_STACK_BYTES);
    if (error == 0) {
        error = pthread_attr_setinheritsched(&attr, PTHREAD_EXPLICIT_SCHED);
    }
    if (error == 0) {
        error = pthread_attr_setschedpolicy(&attr, policy);
    }
    if (error == 0) {
        error = pthread_attr_setschedparam(&attr, &param);
    }
    if (error == 0) {
        error = pthread_create(thread, &attr, run, arg);
    }
    (void)pthread_attr_destroy(&attr);
    return error;
}

int loop_thread_create(pthread_t *thread, const loop_config *loop, loop_grant *grant,
                       void *(*run)(void *), void *arg)
{
    sigset_t all, before;
    sigfillset(&all);
    /* the thread inherits the mask: asyncio handles signals */
    int error = pthread_sigmask(SIG_SETMASK, &all, &before);
    if (error != 0) {
        return -error;
    }
    grant->policy = loop->priority > 0 ? SCHED_FIFO : SCHED_OTHER;
    grant->priority = loop->priority;
    grant->scheduler_errno = 0;
    error = create_with_policy(thread, grant->policy, loop->priority, run, arg);
    if (error == EPERM && loop->priority > 0) {
        grant->policy = SCHED_OTHER;
        grant->priority = 0;
        grant->scheduler_errno = error;
        error = create_with_policy(thread, SCHED_OTHER, 0, run, arg);
    }
    (void)pthread_sigmask(SIG_SETMASK, &before, NULL);
    return -error;
}

static bool may_lock_without_limit(void)
{
    struct rlimit limit;
    struct __user_cap_header_struct header = {.version = _LINUX_CAPABILITY_VERSION_3};
    struct __user_cap_data_struct data[_LINUX_CAPABILITY_U32S_3] = {{0, 0, 0}};
    if (getrlimit(RLIMIT_MEMLOCK, &limit) == 0 && limit.rlim_cur == RLIM_INFINITY) {
        return true;
    }
    return syscall(SYS_capget, &header, data) == 0 &&
           (data[0].effective & (1U << CAP_IPC_LOCK)) != 0;
}

/* Lock a library that the threads in C call. Returns another value than 0 on failure. Source:
 * mlock(2): it brings all pages of the range in. */
static int lock_library(struct dl_phdr_info *object, size_t size, void *data)
{
    const uintptr_t used[] = {(uintptr_t)&lock_library, (uintptr_t)&clock_nanosleep,
                              (uintptr_t)&exp};
    (void)size;
    (void)data;
    bool is_used = false;
    for (size_t i = 0; i < sizeof used / sizeof used[0]; i++) {
        is_used = is_used || is_loaded_at(object, used[i]);
    }
    int failed = 0;
    for (uint16_t i = 0; is_used && i < object->dlpi_phnum; i++) {
        if (object->dlpi_phdr[i].p_type == PT_LOAD) {
            uintptr_t begin = segment_at(object, i);
            uintptr_t page = begin & ~(uintptr_t)(CODE_PAGE_BYTES - 1);
            failed |= mlock((const void *)page, object->dlpi_phdr[i].p_memsz + (begin - page));
        }
    }
    return failed;
}

/* Lock the memory. With a limit, MCL_FUTURE would succeed now, and later refuse memory to Python
 * while the robot drives. */
void loop_memory_lock(loop_grant *grant)
{
    if (!may_lock_without_limit()) {
        grant->memory_lock_errno = ENOMEM;
        return;
    }
    /* Locks the memory that the threads in C use: static memory and code of this library, libc and
     * libm. All other memory is Python's and stays present once touched. Threads in C touch their
     * stacks before their work. */
    bool locked = mlockall(MCL_CURRENT | MCL_FUTURE | MCL_ONFAULT) == 0 &&
                  dl_iterate_phdr(lock_library, NULL) == 0;
    grant->memory_lock_errno = locked ? 0 : errno;
}

/* Prevent deep sleep of the CPU: a 32-bit number of microseconds, in force while the file is open
 * (Documentation/power/pm_qos_interface.rst of the kernel). */
int loop_dma_latency_hold(loop_grant *grant)
{
    const int32_t latency_us = 0;
    int fd = open("/dev/cpu_dma_latency", O_WRONLY | O_CLOEXEC);
    if (fd >= 0 && write(fd, &latency_us, sizeof latency_us) == (ssize_t)sizeof latency_us) {
        grant->dma_latency_errno = 0;
        return fd;
    }
    grant->dma_latency_errno = errno;
    if (fd >= 0) {
        (void)close(fd);
    }
    return -1;
}
