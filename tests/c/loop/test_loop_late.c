/* SPDX-License-Identifier: Apache-2.0
 * The log of late ticks. The clock is the real one, so the checks are lower bounds. */
#include <string.h>
#include <sys/mman.h>
#include <unistd.h>

#include "check.h"
#include "loop_late.h"

static late_log log_now;

/* Makes a tick that begins now, `after_ns` after its deadline. */
static late_tick one_tick(int64_t after_ns)
{
    int64_t now_ns = clock_now_ns();
    late_begin(&log_now, now_ns, now_ns - after_ns);
    for (uint32_t stage = STAGE_INPUT; stage < TICK_STAGES; stage++) {
        late_mark(&log_now, stage);
    }
    late_end(&log_now);
    return log_now.now;
}

static void a_disabled_log_keeps_nothing_and_reads_no_clock(void)
{
    late_init(&log_now, 0);
    late_open(&log_now);
    late_tick tick = one_tick(1000000000);
    late_tick out;
    CHECK(tick.deadline_ns == 0 && log_now.marked_ns == 0 && log_now.schedstat_fd == -1);
    CHECK(!late_take(&log_now, &out) && log_now.lost == 0);
    late_close(&log_now);
}

static void only_ticks_that_are_late_are_kept_in_order(void)
{
    late_tick out;
    late_init(&log_now, 3600 * INT64_C(1000000000));
    late_open(&log_now);
    (void)one_tick(0);
    CHECK(!late_take(&log_now, &out));
    late_tick first = one_tick(4000 * INT64_C(1000000000)),
              second = one_tick(5000 * INT64_C(1000000000));
    CHECK(late_take(&log_now, &out) && out.deadline_ns == first.deadline_ns);
    CHECK(out.stage_ns[STAGE_WAKE] == 4000 * INT64_C(1000000000) && out.cpu >= 0);
    CHECK(late_take(&log_now, &out) && out.deadline_ns == second.deadline_ns);
    CHECK(!late_take(&log_now, &out));
    late_close(&log_now);
}

static void a_stage_holds_the_time_since_the_one_before(void)
{
    late_tick out;
    late_init(&log_now, 1);
    late_open(&log_now);
    int64_t begin_ns = clock_now_ns();
    late_begin(&log_now, begin_ns, begin_ns);
    late_mark(&log_now, STAGE_INPUT);
    (void)usleep(20000);
    late_mark(&log_now, STAGE_CORE);
    late_mark(&log_now, STAGE_OUTPUT);
    late_mark(&log_now, STAGE_NOTIFY);
    late_end(&log_now);
    CHECK(late_take(&log_now, &out));
    CHECK(out.stage_ns[STAGE_CORE] >= 20000000);
    int64_t sum_ns = 0;
    for (uint32_t stage = 0; stage < TICK_STAGES; stage++) {
        sum_ns += out.stage_ns[stage];
    }
    CHECK(sum_ns == log_now.marked_ns - begin_ns);
    late_close(&log_now);
}

static void page_faults_are_those_of_the_tick(void)
{
    enum { PAGES = 64, PAGE = 4096 };
    late_tick out;
    late_init(&log_now, 1);
    late_open(&log_now);
    int64_t begin_ns = clock_now_ns();
    late_begin(&log_now, begin_ns, begin_ns);
    char *fresh =
        mmap(NULL, PAGES * PAGE, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);
    CHECK(fresh != MAP_FAILED);
    (void)madvise(fresh, PAGES * PAGE, MADV_NOHUGEPAGE);
    for (size_t page = 0; page < PAGES; page++) {
        ((volatile char *)fresh)[page * PAGE] = 1;
    }
    late_mark(&log_now, STAGE_NOTIFY);
    late_end(&log_now);
    CHECK(late_take(&log_now, &out) && out.page_faults >= PAGES);
    CHECK(munmap(fresh, PAGES * PAGE) == 0);
    late_close(&log_now);
}

static void a_tick_that_does_not_fit_is_counted(void)
{
    late_init(&log_now, 1);
    late_open(&log_now);
    for (uint32_t i = 0; i < LATE_TICKS_MAX + 3; i++) {
        (void)one_tick(1000);
    }
    CHECK(log_now.lost == 3);
    late_close(&log_now);
}

static void the_wait_is_unknown_where_the_kernel_does_not_count_it(void)
{
    late_init(&log_now, 1);
    late_open(&log_now);
    late_close(&log_now);
    late_tick tick = one_tick(1000);
    CHECK(tick.ready_ns == -1);
}

int main(void)
{
    a_disabled_log_keeps_nothing_and_reads_no_clock();
    only_ticks_that_are_late_are_kept_in_order();
    a_stage_holds_the_time_since_the_one_before();
    page_faults_are_those_of_the_tick();
    a_tick_that_does_not_fit_is_counted();
    the_wait_is_unknown_where_the_kernel_does_not_count_it();
    return checks_report("late log");
}
