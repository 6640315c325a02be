/* SPDX-License-Identifier: Apache-2.0
 *
 * kinematics.c: wheel speeds of a twist, differential and skid drive.
 */
#include "wheel.h"

void kinematics_wheels(const core_config *config, double linear_m_s, double angular_rad_s, double *wheel_rad_s)
{
    double turn_m_s = angular_rad_s * config->track_m * 0.5;
    for (uint32_t j = 0; j < config->joint_count; j++) {
        wheel_rad_s[j] = wheel_speed(&config->joint[j], linear_m_s, turn_m_s);
    }
}
