/* SPDX-License-Identifier: Apache-2.0
 *
 * saturate.c: one factor for all wheels, so that a wheel at its limit slows the robot and does not
 * bend its path. */
#include "wheel.h"

double saturate_factor(const double *want_rad_s, const joint_config *joint, uint32_t count)
{
    double factor = 1.0;
    for (uint32_t j = 0; j < count; j++) {
        if (!wheel_within(&joint[j], want_rad_s[j])) {
            factor = fmin(factor, wheel_share(&joint[j], want_rad_s[j]));
        }
    }
    return factor;
}
