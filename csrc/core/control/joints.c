/* SPDX-License-Identifier: Apache-2.0
 *
 * joints.c: wheel speeds as a twist. A base has no other motion: with any other speeds the wheels
 * would work against each other and slip on the floor. */
#include "rt.h"

#include <math.h>

static const double APART = 0.01; /* allowed difference of a rim's speed from the twist, as a share
                                     of the fastest rim's speed */
static const double APART_M_S = 1e-6; /* and in addition, for rounding */

bool joints_twist(const core_config *base, const double *velocity_rad_s, double *twist_u_s)
{
    if (base->module_count > 0) {
        return false; /* wheel speeds alone do not give the directions of its wheels */
    }
    twist_inverse all;
    double rim_m_s[JOINTS_MAX], fastest_m_s = 0.0, would_rad_s[JOINTS_MAX];
    kinematics_invert(base, (1U << base->joint_count) - 1U, &all);
    for (int i = 0; i < AXES; i++) {
        twist_u_s[i] = 0.0;
    }
    for (uint32_t j = 0; j < base->joint_count; j++) {
        rim_m_s[j] = velocity_rad_s[j] * base->joint[j].wheel_radius_m;
        fastest_m_s = fmax(fastest_m_s, fabs(rim_m_s[j]));
        for (int i = 0; i < AXES; i++) {
            twist_u_s[i] += all.inverse[i][j] * rim_m_s[j];
        }
    }
    kinematics_wheels(base, twist_u_s, would_rad_s);
    for (uint32_t j = 0; j < base->joint_count; j++) {
        double apart_m_s = fabs(rim_m_s[j] - would_rad_s[j] * base->joint[j].wheel_radius_m);
        if (apart_m_s > APART * fastest_m_s + APART_M_S) {
            return false;
        }
    }
    return true;
}
