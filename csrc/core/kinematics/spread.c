/* SPDX-License-Identifier: Apache-2.0
 *
 * spread.c: the uncertainty of the pose. The covariance grows with the distance, with the turn, and
 * with slip: the contradictions between rims, and unknown motion. */
#include "core.h"

#include <math.h>

/* Time constant for a rim's speed that no motion of the base explains, so that the steps of a
 * counter have no effect. As an error of the travel it lasts as long: the spectral density of a
 * first-order Gauss-Markov process is 2 sigma^2 tau (Gelb, Applied Optimal Estimation, 1974,
 * 2.2). */
static const double SLIP_TIME_S = 0.2;

/* Errors of the base's motion: variances and covariances, by the axes of its frame. */
typedef struct {
    double linear2;
    double linear_angular;
    double angular2;
    double lateral2;
    double linear_lateral;
    double lateral_angular;
} errors;

/* Return the larger one; b if a is NaN: the floor holds. */
static double larger(double a, double b)
{
    return a > b ? a : b;
}

void spread_floor(odometry_state *state, const core_config *config)
{
    double *p = state->pose_covariance;
    p[0] = larger(p[0], config->pose_variance_floor_m2);
    p[3] = larger(p[3], config->pose_variance_floor_m2);
    p[5] = larger(p[5], config->heading_variance_floor_rad2);
}

/* Take the contradictions between the rims, for a base with more wheels than axes. */
static void take_slip(spread_state *spread, const core_config *config, const twist_inverse *used,
                      const double *moved_u, double elapsed_s)
{
    double per_s = 1.0 / (SLIP_TIME_S + elapsed_s), sum = 0.0, count = 0.0;
    for (uint32_t j = 0; j < config->joint_count; j++) {
        const wheel_row *row = &config->joint[j].row;
        double explained_m = row->x * moved_u[AXIS_LINEAR] + row->lever_m * moved_u[AXIS_ANGULAR] +
                             row->y * moved_u[AXIS_LATERAL];
        double *residual_m_s = &spread->residual_m_s[j];
        bool counts = used->joints >> j & 1U;
        *residual_m_s =
            counts ? *residual_m_s +
                         (spread->rim_m[j] - explained_m - *residual_m_s * elapsed_s) * per_s
                   : 0.0;
        sum += *residual_m_s * *residual_m_s;
        count += counts ? 1.0 : 0.0;
    }
    spread->slip_m_s = sqrt(sum / count);
}

/* Return the errors of the wheels' travel as errors of the motion. Wheels with the same row share
 * one error: they scrub together. */
static errors errors_of(const spread_state *spread, const core_config *config,
                        const twist_inverse *used, double elapsed_s)
{
    const double *x = used->inverse[AXIS_LINEAR], *turn = used->inverse[AXIS_ANGULAR],
                 *y = used->inverse[AXIS_LATERAL];
    double slip_m2 = 2.0 * SLIP_TIME_S * spread->slip_m_s * spread->slip_m_s * elapsed_s;
    errors found = {0};
    for (uint32_t j = 0; j < config->joint_count; j++) {
        double travel_m2 =
            used->shared * (config->distance_variance_m2_per_m * fabs(spread->rim_m[j]) + slip_m2);
        double x_m2 = x[j] * travel_m2, y_m2 = y[j] * travel_m2;
        found.linear2 += x[j] * x_m2;
        found.linear_angular += turn[j] * x_m2;
        found.angular2 += turn[j] * turn[j] * travel_m2;
        found.lateral2 += y[j] * y_m2;
        found.linear_lateral += x[j] * y_m2;
        found.lateral_angular += turn[j] * y_m2;
    }
    return found;
}

/* Add the errors of the motion to the pose by the Jacobians of the motion, and the scrub of turning
 * to the heading (Siegwart & Nourbakhsh, Autonomous Mobile Robots, 5.2.4). The distance has the
 * direction in the middle of the arc, and so half of the turn's error. */
static void grow_pose(odometry_state *state, const errors *of, double scrub_rad2)
{
    const spread_state *spread = &state->spread;
    double turn_rad = angle_wrap(state->heading_rad - spread->heading_rad);
    direction middle = angle_direction(angle_wrap(spread->heading_rad + 0.5 * turn_rad));
    double *p = state->pose_covariance, s = middle.sine, c = middle.cosine, tt = of->angular2;
    /* the errors in the frame of the pose */
    double xx = of->linear2 * c * c + of->lateral2 * s * s - 2.0 * of->linear_lateral * c * s;
    double xy = (of->linear2 - of->lateral2) * c * s + of->linear_lateral * (c * c - s * s);
    double yy = of->linear2 * s * s + of->lateral2 * c * c + 2.0 * of->linear_lateral * c * s;
    double xt = 0.5 * (of->linear_angular * c - of->lateral_angular * s);
    double yt = 0.5 * (of->linear_angular * s + of->lateral_angular * c);
    /* x and y of the end, by the heading at the start */
    double a = -spread->y_m, b = spread->x_m;
    double hh = p[5] + 0.25 * tt;
    double xh = p[2] + xt, yh = p[4] + yt;
    double xh_end = xh + a * hh, yh_end = yh + b * hh;
    p[0] += a * (xh + xh_end) + xx;
    p[1] += a * yh_end + b * xh + xy;
    p[3] += b * (yh + yh_end) + yy;
    p[2] = xh_end + xt + 0.25 * tt * a;
    p[4] = yh_end + yt + 0.25 * tt * b;
    p[5] += tt + scrub_rad2;
}

/* Error of a wheel's estimated angle, which lasts for about a metre. */
static const double ESTIMATED_RAD = 0.03;
static const double ESTIMATED_FOR_M = 1.0;

/* Return the turn of the base by this error: distance times angle over the lever, summed over such
 * metres as a random walk. */
static double estimated_rad2(const core_config *config, double distance_m)
{
    double worst_rad2 = 0.0;
    for (uint32_t i = 0; i < config->module_count; i++) {
        const wheel_module *module = &config->module[i];
        double lever2_m2 = module->x_m * module->x_m + module->y_m * module->y_m;
        if (module->steering != 0 && lever2_m2 > 0.0 &&
            config->joint[module->steering - 1].position.reference == REFERENCE_ESTIMATED) {
            worst_rad2 = larger(worst_rad2, ESTIMATED_RAD * ESTIMATED_RAD * ESTIMATED_FOR_M *
                                                distance_m / lever2_m2);
        }
    }
    return worst_rad2;
}

void spread_look(odometry_state *state, const core_config *config, int64_t now_ns)
{
    spread_state *spread = &state->spread;
    const twist_inverse *used = &state->used;
    double elapsed_s = spread->stamp_ns > 0 ? (double)(now_ns - spread->stamp_ns) * 1e-9 : 0.0;
    double moved_u[AXES] = {0.0};
    for (int i = 0; i < AXES; i++) {
        for (uint32_t j = 0; j < config->joint_count; j++) {
            moved_u[i] += used->inverse[i][j] * spread->rim_m[j];
        }
    }
    if (elapsed_s > 0.0 && used->shared > 1.0) {
        take_slip(spread, config, used, moved_u, elapsed_s);
    }
    errors found = errors_of(spread, config, used, elapsed_s);
    double distance_m = sqrt(moved_u[AXIS_LINEAR] * moved_u[AXIS_LINEAR] +
                             moved_u[AXIS_LATERAL] * moved_u[AXIS_LATERAL]);
    double scrub_rad2 = config->turn_variance_rad2_per_rad * fabs(moved_u[AXIS_ANGULAR]) +
                        estimated_rad2(config, distance_m);
    if (spread->by_gyro) {
        found.angular2 = spread->gyro_rad2;
        found.linear_angular = found.lateral_angular = scrub_rad2 = 0.0;
    }
    grow_pose(state, &found, scrub_rad2);
    spread_floor(state, config);
    spread->stamp_ns = now_ns;
    spread->heading_rad = state->heading_rad;
    spread->x_m = spread->y_m = spread->gyro_rad2 = 0.0;
    for (uint32_t j = 0; j < JOINTS_MAX; j++) {
        spread->rim_m[j] = 0.0;
    }
}

/* Compute the inverse of all joints. Steered wheels count at their newest angles. */
static void invert_all(const odometry_state *state, const core_config *config, twist_inverse *all)
{
    uint32_t joints = (1U << config->joint_count) - 1U;
    if (config->module_count == 0) {
        kinematics_invert(config, joints, all);
        return;
    }
    double angle_rad[JOINTS_MAX];
    for (int j = 0; j < JOINTS_MAX; j++) {
        angle_rad[j] = isnan(state->angle_rad[j]) ? 0.0 : state->angle_rad[j];
    }
    kinematics_modules(config, angle_rad, joints, all);
}

void odometry_drift(odometry_state *state, const core_config *config,
                    const joint_setpoint *setpoint, double dt_s)
{
    twist_inverse all;
    invert_all(state, config, &all);
    /* as if all wheels had gone as far as the fastest, with all errors added up */
    double farthest_m = 0.0, far_u[AXES] = {0.0};
    for (uint32_t j = 0; j < config->joint_count; j++) {
        farthest_m = larger(farthest_m, fabs(setpoint[j].velocity_rad_s) *
                                            config->joint[j].wheel_radius_m * dt_s);
        for (int i = 0; i < AXES; i++) {
            far_u[i] += fabs(all.inverse[i][j]);
        }
    }
    double distance_m = farthest_m * (far_u[AXIS_LINEAR] + far_u[AXIS_LATERAL]),
           turn_rad = farthest_m * far_u[AXIS_ANGULAR];
    double *p = state->pose_covariance;
    p[0] += distance_m * (2.0 * sqrt(p[0]) + distance_m);
    p[3] += distance_m * (2.0 * sqrt(p[3]) + distance_m);
    p[5] += turn_rad * (2.0 * sqrt(p[5]) + turn_rad);
    /* only the last measured twist is left, as uncertain as it is large */
    double linear = state->linear_m_s * state->linear_m_s,
           lateral = state->lateral_m_s * state->lateral_m_s,
           angular = state->angular_rad_s * state->angular_rad_s;
    state->twist_covariance[0] =
        larger(state->twist_covariance[0], config->twist_variance_floor_m2_s2 + linear);
    state->twist_covariance[2] =
        larger(state->twist_covariance[2], config->twist_variance_floor_rad2_s2 + angular);
    if (lateral != 0.0) {
        state->lateral_covariance[1] =
            larger(state->lateral_covariance[1], config->twist_variance_floor_m2_s2 + lateral);
    }
}
