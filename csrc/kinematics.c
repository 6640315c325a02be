/* SPDX-License-Identifier: Apache-2.0
 *
 * kinematics.c: wheel speeds of a twist, differential and skid drive.
 * Siegwart & Nourbakhsh, Autonomous Mobile Robots, 3.2.3: each side rolls at v -+ w b / 2.
 */
#include "core.h"

void kinematics_wheels(const core_config *config, double linear_m_s, double angular_rad_s, double *wheel_rad_s)
{
    double turn_m_s = angular_rad_s * config->track_m * 0.5;
    for (uint32_t j = 0; j < config->joint_count; j++)
        wheel_rad_s[j] = (linear_m_s + config->joint[j].side * turn_m_s) / config->joint[j].wheel_radius_m;
}
