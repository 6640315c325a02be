/* SPDX-License-Identifier: Apache-2.0
 *
 * joints.c: wheel speeds as the twist that they are. A base with wheels on two sides has no other motion: what its
 * wheels cannot do together they would do against each other and the floor.
 */
#include "rt.h"

#include <math.h>

static const double APART = 0.01;     /* wheels of a side may differ by this share of the faster side's speed */
static const double APART_M_S = 1e-6; /* and by this, for rounding */

/* 0 left, 1 right */
static uint32_t side_of(const joint_config *joint)
{
    return joint->side > 0.0;
}

/* The inverse of wheel.h: v = (right + left) / 2, w = (right - left) / b. */
bool joints_twist(const core_config *base, const double *velocity_rad_s, double *linear_m_s, double *angular_rad_s)
{
    double speed_m_s[2] = {0}, wheels[2] = {0};
    for (uint32_t j = 0; j < base->joint_count; j++) {
        uint32_t side = side_of(&base->joint[j]);
        speed_m_s[side] += velocity_rad_s[j] * base->joint[j].wheel_radius_m;
        wheels[side]++;
    }
    speed_m_s[0] /= wheels[0];
    speed_m_s[1] /= wheels[1];
    *linear_m_s = (speed_m_s[1] + speed_m_s[0]) * 0.5;
    *angular_rad_s = (speed_m_s[1] - speed_m_s[0]) / base->track_m;
    double apart_m_s = APART * fmax(fabs(speed_m_s[0]), fabs(speed_m_s[1])) + APART_M_S;
    for (uint32_t j = 0; j < base->joint_count; j++) {
        double wheel_m_s = velocity_rad_s[j] * base->joint[j].wheel_radius_m;
        if (fabs(wheel_m_s - speed_m_s[side_of(&base->joint[j])]) > apart_m_s) {
            return false;
        }
    }
    return true;
}
