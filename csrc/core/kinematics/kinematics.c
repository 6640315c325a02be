/* SPDX-License-Identifier: Apache-2.0
 *
 * kinematics.c: wheel speeds of a twist, and the twist of wheel speeds, for every base.
 *
 * If there are more wheels than axes of the twist, the system of equations is over-determined: the
 * twist is that of least squares, (A' A)^-1 A' (Golub & Van Loan, Matrix Computations, 5.3), and
 * the rest is slip. */
#include "core.h"
#include "wheel.h"

/* Least determinant of A' A, as a part of the product of its diagonal (Hadamard's inequality: at
 * most 1). Below this the system is ill-conditioned: the error of a wheel would become a thousand
 * times as large. */
static const double DETERMINED_LEAST = 1e-6;

void kinematics_wheels(const core_config *config, const double *twist_u_s, double *wheel_rad_s)
{
    for (uint32_t j = 0; j < config->joint_count; j++) {
        wheel_rad_s[j] = wheel_speed(&config->joint[j], twist_u_s);
    }
}

/* A base with modules can move sideways if all of them are steered. */
bool kinematics_strafes(const core_config *config)
{
    bool strafes = config->module_count > 0;
    for (uint32_t i = 0; i < config->module_count; i++) {
        strafes &= config->module[i].steering != 0;
    }
    if (config->module_count > 0) {
        return strafes;
    }
    for (uint32_t j = 0; j < config->joint_count; j++) {
        strafes |= config->joint[j].row.y != 0.0;
    }
    return strafes;
}

/* Begin the symmetric matrix A' A of x, turn, y; if the base does not strafe, it has a one in place
 * of y. */
static void normal_begin(double m[AXES][AXES], bool strafes)
{
    for (int i = 0; i < AXES * AXES; i++) {
        m[i / AXES][i % AXES] = 0.0;
    }
    m[AXIS_LATERAL][AXIS_LATERAL] = strafes ? 0.0 : 1.0;
}

static void normal_add(double m[AXES][AXES], const wheel_row *row)
{
    const double of[AXES] = {row->x, row->lever_m, row->y};
    for (int i = 0; i < AXES * AXES; i++) {
        m[i / AXES][i % AXES] += of[i / AXES] * of[i % AXES];
    }
}

/* Return the minor of the element in row i and column k, with its sign: the indices are cyclic, so
 * the sign is always plus. */
static double cofactor(double m[AXES][AXES], int i, int k)
{
    int i1 = (i + 1) % AXES, i2 = (i + 2) % AXES, k1 = (k + 1) % AXES, k2 = (k + 2) % AXES;
    return m[i1][k1] * m[i2][k2] - m[i1][k2] * m[i2][k1];
}

/* Return the determinant; 0: the motion is not determined. */
static double normal_determinant(double m[AXES][AXES])
{
    double determinant = 0.0;
    for (int k = 0; k < AXES; k++) {
        determinant += m[0][k] * cofactor(m, 0, k);
    }
    return determinant > DETERMINED_LEAST * m[0][0] * m[1][1] * m[2][2] ? determinant : 0.0;
}

/* Compute column j of (A' A)^-1 A'. */
static void invert_row(double m[AXES][AXES], double determinant, const wheel_row *row,
                       twist_inverse *out, uint32_t j)
{
    const double of[AXES] = {row->x, row->lever_m, row->y};
    for (int i = 0; i < AXES * AXES; i++) {
        out->inverse[i / AXES][j] += cofactor(m, i / AXES, i % AXES) * of[i % AXES] / determinant;
    }
}

void kinematics_invert(const core_config *config, uint32_t joints, twist_inverse *out)
{
    double m[AXES][AXES], count = 0.0;
    if (config->module_count > 0) {
        const double straight_rad[JOINTS_MAX] = {0.0};
        kinematics_modules(config, straight_rad, joints, out);
        return;
    }
    *out = (twist_inverse){.joints = joints, .strafes = kinematics_strafes(config)};
    normal_begin(m, out->strafes != 0);
    for (uint32_t j = 0; j < config->joint_count; j++) {
        if (joints >> j & 1U) {
            normal_add(m, &config->joint[j].row);
            count += 1.0;
        }
    }
    double determinant = normal_determinant(m);
    if (determinant == 0.0) {
        return;
    }
    for (uint32_t j = 0; j < config->joint_count; j++) {
        if (joints >> j & 1U) {
            invert_row(m, determinant, &config->joint[j].row, out, j);
        }
    }
    out->shared = count / (out->strafes ? 3.0 : 2.0);
    out->determined = 1;
}

/* ------------------------------------------------------------------------- with modules */
typedef struct {
    wheel_row rolls;  /* row for the rim's speed */
    wheel_row slides; /* row for the speed across it */
} module_rows;

/* Whether the wheel's angle is known. */
static bool points(const wheel_module *module, uint32_t joints)
{
    return module->steering == 0 || joints >> (module->steering - 1) & 1U;
}

/* Whether the wheel's angle and speed are known. */
static bool is_driven(const wheel_module *module, uint32_t joints)
{
    return points(module, joints) && module->traction != 0 && joints >> (module->traction - 1) & 1U;
}

static module_rows rows_of(const wheel_module *module, const double *angle_rad, bool strafes)
{
    direction d = angle_direction(angle_wrap(module_angle(module, angle_rad)));
    double c = d.cosine, s = d.sine, y = strafes ? 1.0 : 0.0;
    return (module_rows){{c, s * y, module->x_m * s - module->y_m * c},
                         {-s, c * y, module->x_m * c + module->y_m * s}};
}

void kinematics_modules(const core_config *config, const double *angle_rad, uint32_t joints,
                        twist_inverse *out)
{
    double m[AXES][AXES];
    /* never the same as before, because the angles change */
    *out = (twist_inverse){.strafes = kinematics_strafes(config), .shared = 1.0};
    normal_begin(m, out->strafes != 0);
    for (uint32_t i = 0; i < config->module_count; i++) {
        const wheel_module *module = &config->module[i];
        module_rows rows = rows_of(module, angle_rad, out->strafes != 0);
        if (points(module, joints)) {
            normal_add(m, &rows.slides);
        }
        if (is_driven(module, joints)) {
            normal_add(m, &rows.rolls);
        }
    }
    double determinant = normal_determinant(m);
    if (determinant == 0.0) {
        return;
    }
    for (uint32_t i = 0; i < config->module_count; i++) {
        const wheel_module *module = &config->module[i];
        if (is_driven(module, joints)) {
            module_rows rows = rows_of(module, angle_rad, out->strafes != 0);
            invert_row(m, determinant, &rows.rolls, out, module->traction - 1);
        }
    }
    out->determined = 1;
}

static double along(const wheel_row *row, const double *twist_u)
{
    return row->x * twist_u[AXIS_LINEAR] + row->lever_m * twist_u[AXIS_ANGULAR] +
           row->y * twist_u[AXIS_LATERAL];
}

double kinematics_residual(const core_config *config, const double *angle_rad, uint32_t joints,
                           const double *rim, const double *twist_u)
{
    bool strafes = kinematics_strafes(config);
    double sum = 0.0, count = 0.0;
    for (uint32_t i = 0; i < config->module_count; i++) {
        const wheel_module *module = &config->module[i];
        if (!points(module, joints)) {
            continue;
        }
        module_rows rows = rows_of(module, angle_rad, strafes);
        double slides = along(&rows.slides, twist_u);
        double rolls = is_driven(module, joints)
                           ? along(&rows.rolls, twist_u) - rim[module->traction - 1]
                           : 0.0;
        sum += slides * slides + rolls * rolls;
        count += is_driven(module, joints) ? 2.0 : 1.0;
    }
    return sqrt(sum / count);
}
