/* SPDX-License-Identifier: Apache-2.0
 *
 * angle.c: angles, computed only by exactly rounded operations of IEEE 754.
 */
#include "core.h"

static const double HALF_PI = 1.57079632679489661923;
static const double HALF_PI_REST = 6.123233995736766036e-17; /* pi/2 - HALF_PI */

/* Taylor's series; at pi/4 the first term left out is below 1e-18 (sine) and 3e-18 (cosine). */
static double sine_near_zero(double x)
{
    double q = x * x;
    double sum = 1.0 / 355687428096000.0;
    sum = sum * q - 1.0 / 1307674368000.0;
    sum = sum * q + 1.0 / 6227020800.0;
    sum = sum * q - 1.0 / 39916800.0;
    sum = sum * q + 1.0 / 362880.0;
    sum = sum * q - 1.0 / 5040.0;
    sum = sum * q + 1.0 / 120.0;
    sum = sum * q - 1.0 / 6.0;
    return x + x * (sum * q);
}

static double cosine_near_zero(double x)
{
    double q = x * x;
    double sum = 1.0 / 20922789888000.0;
    sum = sum * q - 1.0 / 87178291200.0;
    sum = sum * q + 1.0 / 479001600.0;
    sum = sum * q - 1.0 / 3628800.0;
    sum = sum * q + 1.0 / 40320.0;
    sum = sum * q - 1.0 / 720.0;
    sum = sum * q + 1.0 / 24.0;
    sum = sum * q - 0.5;
    return 1.0 + sum * q;
}

/* Computes the angle within 1e-16, from a rough start: the rest, whose tangent is t, is the series
 * of the arc tangent. The start is within 0.004 rad (Rajan et al., Efficient Approximations for the
 * Arctangent Function, 2006), and the first term left out is below 2e-18. */
double angle_of(double y, double x)
{
    const double quarter = 0.5 * HALF_PI;
    bool steep = fabs(y) > fabs(x);
    if (x == 0.0 && y == 0.0) {
        return 0.0;
    }
    double slope = steep ? x / y : y / x;
    double rough = slope * (quarter + 0.273 * (1.0 - fabs(slope)));
    if (steep) {
        rough = copysign(HALF_PI, y) - rough;
    } else if (x < 0.0) {
        rough += copysign(2.0 * HALF_PI, y);
    }
    direction d = angle_direction(rough);
    double t = (y * d.cosine - x * d.sine) / (x * d.cosine + y * d.sine), q = t * t;
    return angle_wrap(rough + t * (1.0 - q * (1.0 / 3.0 - q * (1.0 / 5.0))));
}

direction angle_direction(double angle_rad)
{
    double turns = angle_rad / HALF_PI;
    int quarter = (int)(turns < 0.0 ? turns - 0.5 : turns + 0.5);
    double rest = (angle_rad - quarter * HALF_PI) - quarter * HALF_PI_REST;
    double s = sine_near_zero(rest);
    double c = cosine_near_zero(rest);
    switch ((unsigned)quarter & 3U) {
    case 0: return (direction){s, c};
    case 1: return (direction){c, -s};
    case 2: return (direction){-s, -c};
    default: return (direction){-c, s};
    }
}
