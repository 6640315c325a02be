/* SPDX-License-Identifier: Apache-2.0
 *
 * speed_loop.c: the torque that brings a wheel to a speed. PI, with the integral held where it would only drive the
 * output further beyond its limit (Åström & Hägglund, Advanced PID Control, 2006, 3.5: conditional integration).
 */
#include "rt.h"

#include <math.h>

static double within(double value, double limit)
{
    return fmin(fmax(value, -limit), limit);
}

double speed_loop_step(speed_loop_state *state, const speed_loop_config *config, double want_rad_s, double measured_rad_s,
                       double dt_s)
{
    double error_rad_s = want_rad_s - measured_rad_s;
    if (!isfinite(error_rad_s + state->integral_n_m) || !(dt_s > 0.0)) {
        state->integral_n_m = 0.0;
        return 0.0;
    }
    double limit = config->torque_max_n_m;
    double integral = within(state->integral_n_m + config->integral_n_m_per_rad * error_rad_s * dt_s, limit);
    double wanted = config->gain_n_m_s_per_rad * error_rad_s + integral;
    double torque = within(wanted, limit);
    if (torque == wanted || error_rad_s * wanted < 0.0) {
        state->integral_n_m = integral;
    }
    return torque + 0.0; /* + 0.0: no negative zero */
}
