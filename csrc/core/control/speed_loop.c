/* SPDX-License-Identifier: Apache-2.0
 *
 * speed_loop.c: the torque or duty that brings a wheel to a speed: feed-forward and PID.
 *
 * Feed-forward is the steady state of a motor with friction and inertia (Lynch & Park, Modern
 * Robotics, 2017, 8.9.1). The derivative is that of the measured speed, through a first-order
 * filter, so that no set-point makes it jump. The integral is held where it would only drive the
 * output further beyond a limit: conditional integration (Åström & Hägglund, Advanced PID Control,
 * 2006, 3.3 and 3.5). A loop that begins, or whose gains change, continues from the previous
 * output: the integral takes the difference (the same, 3.6). */
#include "rt.h"

#include <float.h>
#include <math.h>

static const double LOSES_INTEGRAL_S = 0.5; /* without an integral gain, the rest of a change decays
                                               in this time */
static const double MOST_GAIN = 1e9;

static double within(double value, double low, double high)
{
    return fmin(fmax(value, low), high);
}

static double feed_forward(const speed_loop_state *state, const speed_loop_gains *gains,
                           double want_rad_s, double dt_s)
{
    if (want_rad_s == 0.0) {
        return 0.0; /* also if it was set to zero at once: then the drive brakes by itself */
    }
    double rises_rad_s2 = state->begun != 0 ? (want_rad_s - state->want_rad_s) / dt_s : 0.0;
    return copysign(gains->static_u, want_rad_s) + gains->viscous_u_s_per_rad * want_rad_s +
           gains->acceleration_u_s2_per_rad * rises_rad_s2;
}

/* Reset the loop to no output. `begun`: the next step is an ordinary one. */
static double rest(speed_loop_state *state, double measured_rad_s, uint32_t begun)
{
    *state = (speed_loop_state){
        .slow_rad_s = measured_rad_s, .begun = begun, .overspeed = state->overspeed};
    return 0.0;
}

/* Whether the output goes to zero at rest. A duty does, so it does not warm a motor that stands. A
 * torque may have to hold a robot on a slope; it does where friction alone holds the robot. */
static bool lets_go(const speed_loop_state *state, const speed_loop_config *config,
                    const speed_loop_gains *gains, const speed_loop_input *input)
{
    if (input->want_rad_s != 0.0 || !(fabs(input->measured_rad_s) < input->rest_rad_s)) {
        return false;
    }
    return config->kind == SPEED_LOOP_DUTY || fabs(state->integral_u) < gains->static_u;
}

double speed_loop_step(speed_loop_state *state, const speed_loop_config *config,
                       const speed_loop_gains *gains, const speed_loop_input *input, double dt_s)
{
    double want_rad_s = input->want_rad_s, error_rad_s = want_rad_s - input->measured_rad_s;
    if (!isfinite(error_rad_s + state->integral_u + state->slow_rad_s) ||
        !(dt_s > 0.0 && dt_s <= DBL_MAX)) {
        return rest(state, 0.0, 0);
    }
    if (lets_go(state, config, gains, input)) {
        return rest(state, input->measured_rad_s, 1);
    }
    double most = config->correction_max_u;
    double slow_rad_s = state->begun != 0 ? state->slow_rad_s : input->measured_rad_s;
    double slope_rad_s2 = (input->measured_rad_s - slow_rad_s) / (config->filter_s + dt_s);
    double feed = feed_forward(state, gains, want_rad_s, dt_s);
    double fast =
        gains->gain_u_s_per_rad * error_rad_s - gains->derivative_u_s2_per_rad * slope_rad_s2;
    if (state->begun == 0) {
        state->integral_u = within(state->output_u - feed - fast, -most, most);
    }
    double integral =
        within(state->integral_u + gains->integral_u_per_rad * error_rad_s * dt_s, -most, most);
    if (gains->integral_u_per_rad == 0.0) {
        integral = state->integral_u * fmax(1.0 - dt_s / LOSES_INTEGRAL_S, 0.0);
    }
    double wanted = feed + (fast + integral);
    if (!isfinite(wanted)) {
        return rest(state, 0.0, 0);
    }
    double output =
        within(feed + within(fast + integral, -most, most), input->low_u, input->high_u);
    if (output == wanted || error_rad_s * (wanted - output) < 0.0 ||
        gains->integral_u_per_rad == 0.0) {
        state->integral_u = integral;
    }
    state->slow_rad_s = slow_rad_s + slope_rad_s2 * dt_s;
    state->want_rad_s = want_rad_s;
    state->begun = 1;
    return state->output_u = output + 0.0; /* + 0.0: no negative zero */
}

bool speed_loop_gains_good(const speed_loop_gains *gains)
{
    const double each[] = {
        gains->gain_u_s_per_rad, gains->integral_u_per_rad,  gains->derivative_u_s2_per_rad,
        gains->static_u,         gains->viscous_u_s_per_rad, gains->acceleration_u_s2_per_rad,
    };
    for (unsigned i = 0; i < sizeof each / sizeof each[0]; i++) {
        if (!(each[i] >= 0.0 && each[i] <= MOST_GAIN)) {
            return false;
        }
    }
    return true;
}
