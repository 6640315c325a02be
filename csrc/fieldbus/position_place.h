/* SPDX-License-Identifier: Apache-2.0
 * position_place.h: the target that may be sent to a joint that takes positions. The same rule
 * holds on all media, in the numbers of the drive. The first target after arming is the position
 * that the drive measures; from there it moves no faster than the joint. */
#ifndef MOTORD_POSITION_PLACE_H
#define MOTORD_POSITION_PLACE_H

#include <math.h>
#include <stdbool.h>

#include "fresh.h"

typedef struct {
    double measured; /* NaN: not known */
    double sent;     /* newest target since arming; NaN: no target */
    int64_t measured_ns;
    int64_t sent_ns;
} position_place;

/* Limits of a target, from the table. */
typedef struct {
    double least;
    double most;
    double per_s;
    int64_t window_ns; /* age up to which a measured position is valid; a target catches up no more
                          than this */
} position_range;

enum { PLACE_CYCLES = 3 }; /* cycles that may pass between two measurements, if they are slow */

static inline int64_t place_window_ns(int64_t timeout_ns, int64_t period_ns)
{
    int64_t cycles_ns = PLACE_CYCLES * period_ns;
    return timeout_ns > cycles_ns ? timeout_ns : cycles_ns;
}

static inline bool place_is_known(const position_place *place, const position_range *range,
                                  int64_t now_ns)
{
    return place->measured >= range->least && place->measured <= range->most &&
           fresh_stamp(now_ns, place->measured_ns, range->window_ns);
}

/* Return the distance that the joint covers in that time, the window at most. */
static inline double place_step(const position_range *range, int64_t elapsed_ns)
{
    int64_t counted_ns = elapsed_ns < range->window_ns ? elapsed_ns : range->window_ns;
    return counted_ns > 0 ? range->per_s * (double)counted_ns * 1e-9 : 0.0;
}

/* Return the target to send for a requested one; NaN: no target may be sent. A first target far
 * from the drive's position means different counts: a wrong zero, or a counter that has wrapped. */
static inline double place_next(const position_place *place, const position_range *range,
                                double wanted, int64_t now_ns)
{
    if (isnan(wanted)) {
        return NAN;
    }
    double within = fmin(fmax(wanted, range->least), range->most);
    if (isnan(place->sent)) {
        bool begins = place_is_known(place, range, now_ns) &&
                      fabs(within - place->measured) <= place_step(range, INT64_MAX);
        return begins ? place->measured : (double)NAN;
    }
    double step = place_step(range, now_ns - place->sent_ns);
    return fmin(fmax(within, place->sent - step), place->sent + step);
}

/* Whether the joint may get no power, or must lose it. `wanted` NaN: no target yet. */
static inline bool place_is_missing(const position_place *place, const position_range *range,
                                    double wanted, int64_t now_ns)
{
    bool begins = isnan(wanted) ? place_is_known(place, range, now_ns)
                                : !isnan(place_next(place, range, wanted, now_ns));
    return isnan(place->sent) && !begins;
}

#endif
