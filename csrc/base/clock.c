/* SPDX-License-Identifier: Apache-2.0
 * clock.c: the clock of every stamp, and the detection of suspends of the computer, during which it
 * stands still. */
#include <stdatomic.h>
#include <time.h>

#include "fresh.h"
#include "rt.h"

enum { LOOKS_MAX = 8 };
/* Limit for two readings: farther apart, they do not bound the time between them. */
static const int64_t APART_MAX_NS = 1000000;
/* Least growth of CLOCK_BOOTTIME's lead over CLOCK_MONOTONIC that means a suspend: CLOCK_BOOTTIME
 * continues during one. */
static const int64_t SUSPEND_LEAST_NS = 5000000;

static _Atomic int64_t ahead_ns = INT64_MIN; /* lead of CLOCK_BOOTTIME; INT64_MIN: not known yet */
static _Atomic int64_t resumed_ns;

static int64_t read_ns(clockid_t clock)
{
    struct timespec now;
    (void)clock_gettime(clock, &now);
    return (int64_t)now.tv_sec * INT64_C(1000000000) + now.tv_nsec;
}

int64_t clock_now_ns(void)
{
    return read_ns(CLOCK_MONOTONIC);
}

/* The first thread that looks after a resume records it, before the others can find the clocks in
 * step. A thread that was delayed during its look does not overwrite a later record. */
int64_t clock_resumed_ns(void)
{
    int64_t noted_ns = atomic_load(&resumed_ns);
    for (int i = 0; i < LOOKS_MAX; i++) {
        int64_t before_ns = clock_now_ns(), boot_ns = read_ns(CLOCK_BOOTTIME),
                now_ns = clock_now_ns();
        if (now_ns - before_ns > APART_MAX_NS) {
            continue;
        }
        int64_t known_ns = atomic_load(&ahead_ns), found_ns = boot_ns - before_ns;
        if (known_ns == INT64_MIN) {
            (void)atomic_compare_exchange_strong(&ahead_ns, &known_ns, found_ns);
        } else if (found_ns - known_ns > SUSPEND_LEAST_NS) {
            (void)atomic_compare_exchange_strong(&resumed_ns, &noted_ns, now_ns);
            atomic_store(&ahead_ns, found_ns);
        }
        break;
    }
    return atomic_load(&resumed_ns);
}

int clock_stamp_is_fresh(int64_t stamp_ns, int64_t timeout_ns)
{
    return fresh_stamp(clock_now_ns(), stamp_since(stamp_ns, clock_resumed_ns()), timeout_ns);
}

int stamp_is_fresh(int64_t now_ns, int64_t stamp_ns, int64_t timeout_ns)
{
    return fresh_stamp(now_ns, stamp_ns, timeout_ns);
}
