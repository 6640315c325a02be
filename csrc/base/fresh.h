/* SPDX-License-Identifier: Apache-2.0
 * fresh.h: when a stamp is fresh. The one rule for set-points on every medium and for the core's
 * heartbeat. */
#ifndef MOTORD_FRESH_H
#define MOTORD_FRESH_H

#include <stdbool.h>
#include <stdint.h>

static const int64_t STAMP_AHEAD_NS = 10000000; /* a stamp may be ahead of now by this: it was
                                                   written meanwhile */

/* The width of fresh_within(): from STAMP_AHEAD_NS ahead of now to the timeout behind it. */
static inline uint64_t fresh_window_ns(int64_t timeout_ns)
{
    return (uint64_t)timeout_ns + (uint64_t)STAMP_AHEAD_NS;
}

/* In wrapping arithmetic: no stamp, however wrong, is undefined behaviour, and none but a fresh
 * one is in the window. */
static inline bool fresh_within(int64_t now_ns, int64_t stamp_ns, uint64_t window_ns)
{
    return stamp_ns > 0 &&
           (uint64_t)now_ns - (uint64_t)stamp_ns + (uint64_t)STAMP_AHEAD_NS <= window_ns;
}

/* CLOCK_MONOTONIC stands still while the computer is suspended: a stamp from before a suspend
 * counts as never. */
static inline int64_t stamp_since(int64_t stamp_ns, int64_t resumed_ns)
{
    return stamp_ns >= resumed_ns ? stamp_ns : 0;
}

/* Not older than the timeout, not from the future. timeout_ns >= 0. */
static inline bool fresh_stamp(int64_t now_ns, int64_t stamp_ns, int64_t timeout_ns)
{
    return fresh_within(now_ns, stamp_ns, fresh_window_ns(timeout_ns));
}

#endif
