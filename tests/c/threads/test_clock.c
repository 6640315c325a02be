/* SPDX-License-Identifier: Apache-2.0
 * clock.c on clocks whose readings the test gives. */
#include <time.h>

#include "check.h"
#include "rt.h"

enum { LOOKS_MAX = 8 };

static const int64_t MS = 1000000, S = INT64_C(1000000000);

static struct {
    int64_t now_ns;   /* CLOCK_MONOTONIC */
    int64_t slept_ns; /* lead of CLOCK_BOOTTIME */
    int64_t each_ns;  /* time that passes with each reading of CLOCK_MONOTONIC */
    int each_times;   /* so often */
    int looks;        /* readings of CLOCK_BOOTTIME */
} clocks;

/* Replaces the C library's function. */
int clock_gettime(clockid_t clock, struct timespec *out)
{
    int64_t ns = clocks.now_ns;
    if (clock == CLOCK_BOOTTIME) {
        ns += clocks.slept_ns;
        clocks.looks++;
    } else if (clocks.each_times > 0) {
        clocks.each_times--;
        clocks.now_ns += clocks.each_ns;
    }
    *out = (struct timespec){.tv_sec = ns / S, .tv_nsec = ns % S};
    return 0;
}

static void a_second_has_a_thousand_million_nanoseconds(void)
{
    const int64_t times_ns[] = {0, 1, 999999999, S, S + 1, 86400 * S + 5, INT64_C(4000000000) * S};
    for (size_t i = 0; i < sizeof times_ns / sizeof *times_ns; i++) {
        clocks.now_ns = times_ns[i];
        CHECK(clock_now_ns() == times_ns[i]);
    }
}

static void a_suspend_is_noted_at_the_time_of_the_look_that_finds_it(void)
{
    clocks.now_ns = 1000 * S;
    CHECK(clock_resumed_ns() == 0); /* the first look only learns how far the clocks are apart */
    clocks.now_ns += S;
    clocks.slept_ns += 5 * MS;
    CHECK(clock_resumed_ns() == 0);
    clocks.slept_ns += 1;
    int64_t resumed_ns = clocks.now_ns += S;
    CHECK(clock_resumed_ns() == resumed_ns);
    clocks.now_ns += S;
    CHECK(clock_resumed_ns() == resumed_ns);
    clocks.slept_ns -= 3 * S; /* clocks that come nearer are no suspend */
    CHECK(clock_resumed_ns() == resumed_ns);
    clocks.slept_ns += 3 * S;
    CHECK(clock_resumed_ns() == resumed_ns);
    clocks.slept_ns += 6 * MS;
    resumed_ns = clocks.now_ns += S;
    CHECK(clock_resumed_ns() == resumed_ns);
}

/* Readings that are more than a millisecond apart do not bound the time of the one between. */
static void a_look_during_which_the_thread_was_delayed_is_repeated(void)
{
    int64_t before_ns = clock_resumed_ns();
    clocks.now_ns += S;
    clocks.slept_ns += S;
    clocks.each_ns = MS;
    clocks.each_times = 1;
    clocks.looks = 0;
    int64_t resumed_ns = clocks.now_ns + MS;
    CHECK(clock_resumed_ns() == resumed_ns && resumed_ns > before_ns && clocks.looks == 1);
    clocks.now_ns += S;
    clocks.slept_ns += S;
    clocks.each_ns = MS + 1;
    clocks.each_times = 1000;
    clocks.looks = 0;
    CHECK(clock_resumed_ns() == resumed_ns && clocks.looks == LOOKS_MAX);
    clocks.each_times = 3; /* the look after the third reading is good */
    clocks.looks = 0;
    CHECK(clock_resumed_ns() > resumed_ns && clocks.looks == 3);
    clocks.each_times = 0;
}

static void a_stamp_from_before_a_suspend_is_not_fresh(void)
{
    int64_t stamp_ns = clocks.now_ns += S;
    CHECK(clock_stamp_is_fresh(stamp_ns, S) == 1);
    clocks.now_ns += MS;
    CHECK(clock_stamp_is_fresh(stamp_ns, MS) == 1 && clock_stamp_is_fresh(stamp_ns, MS - 1) == 0);
    clocks.slept_ns += S;
    CHECK(clock_stamp_is_fresh(stamp_ns, S) == 0 && clock_stamp_is_fresh(clocks.now_ns, S) == 1);
    CHECK(stamp_is_fresh(clocks.now_ns, stamp_ns, S) == 1 &&
          stamp_is_fresh(clocks.now_ns, stamp_ns, MS - 1) == 0);
}

int main(void)
{
    a_second_has_a_thousand_million_nanoseconds();
    a_suspend_is_noted_at_the_time_of_the_look_that_finds_it();
    a_look_during_which_the_thread_was_delayed_is_repeated();
    a_stamp_from_before_a_suspend_is_not_fresh();
    return checks_report("clock");
}
