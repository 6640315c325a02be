/* SPDX-License-Identifier: Apache-2.0
 *
 * saturate.c: one factor for all wheels, so that a wheel at its limit slows the robot and does not bend its path.
 */
#include "core.h"

#include <math.h>

double saturate_factor(const double *want_rad_s, const joint_config *joint, uint32_t count)
{
    double factor = 1.0;
    for (uint32_t j = 0; j < count; j++) {
        double want = fabs(want_rad_s[j]);
        double limit = want_rad_s[j] < 0.0 ? -joint[j].velocity_min_rad_s : joint[j].velocity_max_rad_s;
        if (want <= limit)
            continue;
        /* not (want > limit): NaN, on either side, is no reason to move */
        if (!(want > limit) || isinf(want))
            return 0.0;
        double share = fabs(limit / want);
        if (want * share > limit) /* the quotient was rounded up */
            share = nextafter(share, 0.0);
        if (share < factor)
            factor = share;
    }
    return factor;
}
