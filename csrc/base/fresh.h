/* SPDX-License-Identifier: Apache-2.0
 * fresh.h: when a stamp is fresh: the same rule for set-points on every medium and for the core's
 * heartbeat. */
#ifndef MOTORD_FRESH_H
#define MOTORD_FRESH_H

#include <stdbool.h>
#include <stdint.h>

static const int64_t STAMP_AHEAD_NS = 10000000; /* a stamp may be this far in the future: it may be
                                                   written after the clock was read */

/* Return the width of fresh_within(): from STAMP_AHEAD_NS in the future to the timeout in the
 * past. */
static inline uint64_t fresh_window_ns(int64_t timeout_ns)
{
    return (uint64_t)timeout_ns + (uint64_t)STAMP_AHEAD_NS;
}

/* Whether a stamp is in the window, by wrapping arithmetic: no stamp, however wrong, is undefined
 * behaviour, and only a fresh one is in the window. */
static inline bool fresh_within(int64_t now_ns, int64_t stamp_ns, uint64_t window_ns)
{
    return stamp_ns > 0 &&
           (uint64_t)now_ns - (uint64_t)stamp_ns + (uint64_t)STAMP_AHEAD_NS <= window_ns;
}

/* Return 0 (never) for a stamp from before a suspend: CLOCK_MONOTONIC stands still while the
 * computer is suspended. */
static inline int64_t stamp_since(int64_t stamp_ns, int64_t resumed_ns)
{
    return stamp_ns >= resumed_ns ? stamp_ns : 0;
}

/* Whether a stamp is neither older than the timeout nor from the future. timeout_ns >= 0. */
static inline bool fresh_stamp(int64_t now_ns, int64_t stamp_ns, int64_t timeout_ns)
{
    return fresh_within(now_ns, stamp_ns, fresh_window_ns(timeout_ns));
}

#endif
