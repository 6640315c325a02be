/* SPDX-License-Identifier: Apache-2.0
 *
 * kinematics.c: wheel speeds of a twist, and the twist of wheel speeds, for every base without steering.
 *
 * More wheels than the twist has axes are a system of equations that is over-determined: the twist is that of least squares,
 * (A' A)^-1 A' (Golub & Van Loan, Matrix Computations, 5.3), and what remains is slip.
 */
#include "wheel.h"

/* The determinant of A' A, as a part of the product of its diagonal (Hadamard's inequality: at most 1). What is less hangs on a
 * thread: an error of a wheel would be one of the base a thousand times as large. */
static const double DETERMINED_LEAST = 1e-6;

void kinematics_wheels(const core_config *config, const double *twist_u_s, double *wheel_rad_s)
{
    for (uint32_t j = 0; j < config->joint_count; j++) {
        wheel_rad_s[j] = wheel_speed(&config->joint[j], twist_u_s);
    }
}

bool kinematics_strafes(const core_config *config)
{
    bool strafes = false;
    for (uint32_t j = 0; j < config->joint_count; j++) {
        strafes |= config->joint[j].row.y != 0.0;
    }
    return strafes;
}

/* The symmetric matrix A' A of x, turn, y; a base that does not strafe has a one in place of y. */
static void normal_matrix(const core_config *config, uint32_t joints, bool strafes, double m[AXES][AXES])
{
    for (int i = 0; i < AXES * AXES; i++) {
        m[i / AXES][i % AXES] = 0.0;
    }
    m[AXIS_LATERAL][AXIS_LATERAL] = strafes ? 0.0 : 1.0;
    for (uint32_t j = 0; j < config->joint_count; j++) {
        const wheel_row *row = &config->joint[j].row;
        const double of[AXES] = {row->x, row->lever_m, row->y};
        for (int i = 0; i < AXES * AXES && (joints >> j & 1U); i++) {
            m[i / AXES][i % AXES] += of[i / AXES] * of[i % AXES];
        }
    }
}

/* The minor of the element in row i and column k, with its sign: indices go round, so the sign is always plus. */
static double cofactor(double m[AXES][AXES], int i, int k)
{
    int i1 = (i + 1) % AXES, i2 = (i + 2) % AXES, k1 = (k + 1) % AXES, k2 = (k + 2) % AXES;
    return m[i1][k1] * m[i2][k2] - m[i1][k2] * m[i2][k1];
}

void kinematics_invert(const core_config *config, uint32_t joints, twist_inverse *out)
{
    double m[AXES][AXES], determinant = 0.0, count = 0.0;
    *out = (twist_inverse){.joints = joints, .strafes = kinematics_strafes(config)};
    normal_matrix(config, joints, out->strafes != 0, m);
    for (int k = 0; k < AXES; k++) {
        determinant += m[0][k] * cofactor(m, 0, k);
    }
    if (!(determinant > DETERMINED_LEAST * m[0][0] * m[1][1] * m[2][2])) {
        return;
    }
    for (uint32_t j = 0; j < config->joint_count; j++) {
        const wheel_row *row = &config->joint[j].row;
        const double of[AXES] = {row->x, row->lever_m, row->y};
        for (int i = 0; i < AXES * AXES && (joints >> j & 1U); i++) {
            out->inverse[i / AXES][j] += cofactor(m, i / AXES, i % AXES) * of[i % AXES] / determinant;
        }
        count += joints >> j & 1U;
    }
    out->shared = count / (out->strafes ? 3.0 : 2.0);
    out->determined = 1;
}
