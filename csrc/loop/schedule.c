/* SPDX-License-Identifier: Apache-2.0 */
#include "schedule.h"

#include <math.h>

int64_t schedule_period_ns(double rate_hz)
{
    return (int64_t)llround(1e9 / rate_hz);
}

uint64_t schedule_next(int64_t *deadline_ns, int64_t period_ns, int64_t now_ns)
{
    *deadline_ns += period_ns;
    if (now_ns <= *deadline_ns) {
        return 0;
    }
    int64_t skipped = (now_ns - *deadline_ns - 1) / period_ns + 1;
    *deadline_ns += skipped * period_ns;
    return (uint64_t)skipped;
}
