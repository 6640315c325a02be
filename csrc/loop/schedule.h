/* SPDX-License-Identifier: Apache-2.0
 * schedule.h: the arithmetic of absolute deadlines, without a clock. */
#ifndef MOTORD_SCHEDULE_H
#define MOTORD_SCHEDULE_H

#include <stdint.h>

/* Return the period, rounded to whole nanoseconds. rate_hz > 0. */
int64_t schedule_period_ns(double rate_hz);

/* Move the deadline to the first one of its grid that is not before now_ns. Returns the number of
 * skipped ones: a late tick is counted, never made good by a burst. period_ns > 0. */
uint64_t schedule_next(int64_t *deadline_ns, int64_t period_ns, int64_t now_ns);

#endif
