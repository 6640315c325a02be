/* SPDX-License-Identifier: Apache-2.0
 * core.h: declarations that the pure files share and Python does not see. */
#ifndef MOTORD_CORE_H
#define MOTORD_CORE_H

#include "rt.h"

#include <math.h>

#pragma GCC visibility push(hidden)

/* Return a measured value; NaN if no sensor measures it (infinity). */
static inline double measured(double value)
{
    return value + (value - value);
}

/* Return the angle in -pi..pi. */
static inline double angle_wrap(double angle_rad)
{
    const double pi = 3.14159265358979323846;
    return fabs(angle_rad) <= pi ? angle_rad : remainder(angle_rad, 2.0 * pi);
}
/* Sine and cosine of an angle in -pi..pi, within 1e-15. They have the same bits on every machine,
 * which a replay needs and the C library does not promise (it picks fused multiply-add where the
 * CPU has it). */
typedef struct {
    double sine;
    double cosine;
} direction;

direction angle_direction(double angle_rad);
/* Return the angle of (x, y) from x, in -pi..pi, as exact; 0 for (0, 0). */
double angle_of(double y, double x);

/* Return the rolling direction of a module's wheel, from x, at these angles of the joints. */
static inline double module_angle(const wheel_module *module, const double *angle_rad)
{
    return module->angle_rad + (module->steering != 0 ? angle_rad[module->steering - 1] : 0.0);
}

/* ramp_step(), which also returns the joint whose duty slew bound it: its bit in `slewing`, which
 * else stays unchanged. */
uint32_t ramp_joint_step(limit_state *axis, uint32_t axes, const base_limits *limits,
                         const core_config *slewed, const double *goal_u_s, double dt_s,
                         bool urgent, uint32_t *slewing);

/* Whether a joint's newest sample is to be checked now. Faster ones are taken together. Checks that
 * have not begun have a stamp of 0, and are due. */
static inline bool plausible_due(const plausible_state *state, const joint_odometry *joint)
{
    const int64_t least_ns = 5000000;
    return joint->stamp_ns - state->stamp_ns >= least_ns;
}
/* Check a sample that is due. false: a check failed, with the reason in `why`. `reported_rad_s` is
 * the drive's own measured value. */
bool plausible(plausible_state *state, const plausible_config *config, const joint_odometry *joint,
               double reported_rad_s, double setpoint_rad_s, feedback_doubt *why);

/* Whether these limits of a joint are valid. Its jerk may be infinite. */
bool joint_limits_good(const axis_limits *limits);

/* joint_odometry.last */
enum { NONE = 0, BELIEVED = 1, REFUSED = 2 };

/* Update the angle of a joint that takes positions. */
void modules_take_angle(odometry_state *state, const core_config *config, uint32_t j);
/* Do the same for all joints, and compute the inverse for these joints from the angles in the
 * middle of the arc that ends now. */
void modules_look(odometry_state *state, const core_config *config, uint32_t joints);
/* Begin the next arc at the angles that are known now. */
void modules_end_arc(odometry_state *state);
/* Compute the slip: the part of an arc that no motion of the base explains. */
void modules_slip(odometry_state *state, const core_config *config, uint32_t joints,
                  const double *rim_m, const double *twist_u, double elapsed_s);

/* Whether all numbers of the odometry are finite. */
static inline bool odometry_finite(const odometry_state *state, uint32_t joint_count)
{
    const double *p = state->pose_covariance, *q = state->twist_covariance,
                 *r = state->lateral_covariance;
    /* a sum with an infinity or a NaN in it is one itself */
    double sum = state->x_m + state->y_m + state->heading_rad + state->distance_m +
                 state->turned_rad + state->linear_m_s + state->angular_rad_s + state->lateral_m_s +
                 state->spread.slip_m_s + r[0] + r[1] + r[2] + p[0] + p[1] + p[2] + p[3] + p[4] +
                 p[5] + q[0] + q[1] + q[2] + state->gyro.yaw_rad + state->gyro.bias_rad_s +
                 state->gyro.bias_variance_rad2_s2;
    const speed_state *speed = &state->speed;
    for (int i = 0; i < AXES; i++) {
        sum += speed->travel_u[i] + speed->travel2_u2_s2[i] + speed->drives2_u2_s2[i];
    }
    for (uint32_t j = 0; j < joint_count; j++) {
        /* pending_rad is a part of the position */
        sum += state->joint[j].position_rad + state->joint[j].left_out_rad;
    }
    return isfinite(sum);
}

/* Add the motion since the last look to the pose's covariance. The look ends at `now_ns`. */
static const int64_t SPREAD_EVERY_NS = 50000000;
void spread_look(odometry_state *state, const core_config *config, int64_t now_ns);
void spread_floor(odometry_state *state, const core_config *config);

/* Return the least angle of the wheel that its counter shows where it stands. */
double counter_step_rad(const joint_odometry *joint, const joint_config *config);
/* Measure the twist, moved_u[AXES] after the last call, by the wheels alone. Returns false if it is
 * not known yet. */
bool speed_take(odometry_state *state, const core_config *config, const joint_feedback *feedback,
                const double *moved_u);
/* Begin anew, because a part of the travel is unknown: at this stamp or, if that is 0, at the next
 * call of speed_take(). */
void speed_begin(speed_state *speed, int64_t stamp_ns);

/* Let the variance grow as if the motion by the set-points were unknown, when the wheels that send
 * feedback do not determine the motion. */
void odometry_drift(odometry_state *state, const core_config *config,
                    const joint_setpoint *setpoint, double dt_s);

#pragma GCC visibility pop

#endif
