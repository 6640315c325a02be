/* SPDX-License-Identifier: Apache-2.0
 * pace.h: the clock of cycles for a medium that serves all drives in one cycle, and the time until
 * the next step. */
#ifndef MOTORD_PACE_H
#define MOTORD_PACE_H

#include <stdbool.h>
#include <stdint.h>

#include "rt.h"

static const int64_t LOOK_RESTING_NS = 20 * 1000000, LOOK_MOVING_NS = 5 * 1000000,
                     LOOK_FULL_NS = 1000000;

typedef struct {
    int64_t due_ns;   /* time of the next cycle */
    int64_t start_ns; /* time of the newest cycle; 0: no cycle yet */
    int64_t took_ns;  /* smoothed time between two cycles */
    int64_t early_ns; /* for may_be_early */
    uint64_t count;
} cycle_clock;

static inline int64_t earlier(int64_t a, int64_t b)
{
    return a < b ? a : b;
}

static inline int64_t later(int64_t a, int64_t b)
{
    return a > b ? a : b;
}

/* Make the next cycle due now, but not before the gap after the newest one. A stop is never too
 * early: each follows a motion, which is counted. */
static inline void cycle_clock_bring_forward(cycle_clock *c, int64_t period_ns, int64_t gap_ns,
                                             bool stops, int64_t now_ns)
{
    int64_t soon_ns = c->start_ns > 0 ? later(now_ns, c->start_ns + gap_ns) : now_ns;
    if (soon_ns < c->due_ns && (stops || may_be_early(&c->early_ns, period_ns, now_ns))) {
        c->due_ns = soon_ns;
    }
}

/* Begin a cycle. A late cycle is not caught up. */
static inline void cycle_clock_begin(cycle_clock *c, int64_t period_ns, int64_t now_ns)
{
    c->count++;
    if (c->start_ns > 0) {
        int64_t took_ns = now_ns - c->start_ns;
        c->took_ns += c->took_ns == 0 ? took_ns : (took_ns - c->took_ns) / 8;
    }
    c->start_ns = now_ns;
    c->due_ns += period_ns;
    if (c->due_ns <= now_ns) {
        c->due_ns = now_ns + period_ns;
    }
}

#endif
