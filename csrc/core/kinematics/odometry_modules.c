/* SPDX-License-Identifier: Apache-2.0
 *
 * odometry_modules.c: the odometry of a base with modules, beside that of others: its wheels'
 * angles, and an inverse that changes with them. */
#include "core.h"

#include <math.h>
#include <string.h>

/* Time constant of the slip, as in spread.c for other bases. */
static const double SLIP_TIME_S = 0.2;

void modules_take_angle(odometry_state *state, const core_config *config, uint32_t j)
{
    const joint_config *joint = &config->joint[j];
    if (joint->position.used && joint->position.reference != REFERENCE_ESTIMATED &&
        state->joint[j].last != NONE) {
        int64_t counts = counter_difference(state->joint[j].count, joint->position.zero_count,
                                            joint->counter_bits);
        state->angle_rad[j] = (double)counts * joint->rad_per_count;
    }
}

void modules_look(odometry_state *state, const core_config *config, uint32_t joints)
{
    double middle_rad[JOINTS_MAX] = {0};
    for (uint32_t j = 0; j < config->joint_count; j++) {
        modules_take_angle(state, config, j);
        double begin_rad = isnan(state->arc_rad[j]) ? state->angle_rad[j] : state->arc_rad[j];
        middle_rad[j] = 0.5 * (begin_rad + state->angle_rad[j]);
    }
    kinematics_modules(config, middle_rad, joints, &state->used);
}

void modules_end_arc(odometry_state *state)
{
    memcpy(state->arc_rad, state->angle_rad, sizeof state->arc_rad);
}

void modules_slip(odometry_state *state, const core_config *config, uint32_t joints,
                  const double *rim_m, const double *twist_u, double elapsed_s)
{
    double left_m = kinematics_residual(config, state->angle_rad, joints, rim_m, twist_u);
    state->spread.slip_m_s +=
        (left_m - state->spread.slip_m_s * elapsed_s) / (SLIP_TIME_S + elapsed_s);
}
