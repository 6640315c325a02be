/* SPDX-License-Identifier: Apache-2.0
 * torque_loop.h: a PI speed loop whose output is a torque. */
#ifndef TORQUE_LOOP_H
#define TORQUE_LOOP_H

#include "rt.h"

static inline speed_loop_config torque_loop(double gain_n_m_s_per_rad, double integral_n_m_per_rad,
                                            double most_n_m)
{
    return (speed_loop_config){
        .gains = {.gain_u_s_per_rad = gain_n_m_s_per_rad,
                  .integral_u_per_rad = integral_n_m_per_rad},
        .filter_s = 0.05,
        .correction_max_u = most_n_m,
        .output_min_u = -most_n_m,
        .output_max_u = most_n_m,
        .kind = SPEED_LOOP_TORQUE,
    };
}

/* Makes one step of the loop with its own gains and limits. */
static inline double loop_step(speed_loop_state *state, const speed_loop_config *config,
                               double want_rad_s, double measured_rad_s, double dt_s)
{
    speed_loop_input input = {want_rad_s, measured_rad_s, 0.05, config->output_min_u,
                              config->output_max_u};
    return speed_loop_step(state, config, &config->gains, &input, dt_s);
}

#endif
