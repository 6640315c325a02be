/* SPDX-License-Identifier: Apache-2.0
 * The effect of one dead drive on the others: their rate, and the age of their samples. The wire is
 * in virtual time. */
#include "line_wire.h"

enum { DRIVES = 4, DEAD = 3 };

static const int64_t S = 1000000000;

/* Figures of a stretch of time: the cycles of the slowest drive, and the longest time between two
 * of its samples. Dead drives do not count. */
typedef struct {
    uint64_t cycles;
    int64_t age_ns;
} figures;

static figures run_for(int64_t length_ns, uint32_t counted)
{
    figures found = {.cycles = UINT64_MAX, .age_ns = 0};
    uint64_t before[DRIVES];
    int64_t newest_ns[DRIVES];
    int64_t end_ns = w.now_ns + length_ns;
    for (uint32_t i = 0; i < counted; i++) {
        before[i] = w.machine.drive[i].count.cycles;
        newest_ns[i] = w.machine.joint[i].feedback.stamp_ns;
    }
    while (w.now_ns < end_ns) {
        int64_t looked_ns = w.now_ns;
        go_on();
        for (uint32_t i = 0; i < counted; i++) {
            int64_t age_ns = looked_ns - newest_ns[i];
            found.age_ns = age_ns > found.age_ns ? age_ns : found.age_ns;
            if ((w.out.feedback_mask >> i & 1) != 0) {
                newest_ns[i] = w.machine.joint[i].feedback.stamp_ns;
            }
        }
    }
    for (uint32_t i = 0; i < counted; i++) {
        uint64_t cycles = w.machine.drive[i].count.cycles - before[i];
        found.cycles = cycles < found.cycles ? cycles : found.cycles;
    }
    return found;
}

static void begin_four(int64_t period_ns)
{
    begin_with(DRIVES, 0);
    for (uint32_t i = 0; i < DRIVES; i++) {
        w.machine.table.drive[i].period_ns = period_ns;
    }
    w.machine.slot_period_ns = period_ns;
    for (uint32_t i = 0; i < DRIVES; i++) {
        arm(i);
    }
    (void)run_for(S, DRIVES);
}

/* Compares the figures `now` with `healthy`, which are those of four seconds. */
static void judge(const char *when, int64_t period_ns, figures healthy, figures now,
                  uint64_t seconds)
{
    double rate = (double)(now.cycles * 4) / (double)(healthy.cycles * seconds);
    int64_t two_cycles_ns = 2 * 4 * S / (int64_t)healthy.cycles;
    printf("  asked every %3.0f ms, %s: %.1f %% of the rate, oldest sample %.1f ms of %.1f\n",
           (double)period_ns / 1e6, when, 100.0 * rate, (double)now.age_ns / 1e6,
           (double)two_cycles_ns / 1e6);
    CHECK(rate >= 0.9);
    CHECK(now.age_ns <= two_cycles_ns);
}

static void the_others_keep_nine_tenths_of_their_rate_and_samples_of_two_cycles(int64_t period_ns)
{
    begin_four(period_ns);
    figures healthy = run_for(4 * S, DRIVES);
    CHECK(healthy.cycles > 0);
    w.dead = 1U << DEAD;
    judge("the second in which it dies", period_ns, healthy, run_for(S, DEAD), 1);
    CHECK(w.machine.drive[DEAD].state.mode == DRIVE_UNRESPONSIVE);
    judge("four seconds after", period_ns, healthy, run_for(4 * S, DEAD), 4);
    w.dead = 0;
    judge("the four in which it comes back", period_ns, healthy, run_for(4 * S, DEAD), 4);
    CHECK(w.machine.drive[DEAD].state.mode == DRIVE_BACK);
}

int main(void)
{
    /* more cycles than the wire can carry */
    the_others_keep_nine_tenths_of_their_rate_and_samples_of_two_cycles(1 * MS);
    the_others_keep_nine_tenths_of_their_rate_and_samples_of_two_cycles(50 * MS);
    the_others_keep_nine_tenths_of_their_rate_and_samples_of_two_cycles(100 * MS);
    return checks_report("line rates");
}
