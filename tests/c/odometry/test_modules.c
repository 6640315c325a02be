/* SPDX-License-Identifier: Apache-2.0
 * test_modules: the motion of a base from its rims and the angles of its wheels, compared with the
 * equations of the textbook (Siegwart & Nourbakhsh, Autonomous Mobile Robots, 3.2.3). */
#include "steered_bases.h"

/* The equation of one wheel for the twist: `of` are the factors of its axes. */
typedef struct {
    double of[AXES];
    double rim;
} equation;

/* Equations of the known joints: how fast wheels roll, and that they do not slide. A base that does
 * not strafe has no lateral axis. */
static int equations(const core_config *base, const double *angle_rad, uint32_t joints,
                     const double *rim, equation *out)
{
    double y = kinematics_strafes(base) ? 1.0 : 0.0;
    int count = 0;
    for (uint32_t i = 0; i < base->module_count; i++) {
        const wheel_module *at = &base->module[i];
        if (at->steering != 0 && !(joints & 1U << (at->steering - 1))) {
            continue;
        }
        double angle = at->angle_rad + (at->steering != 0 ? angle_rad[at->steering - 1] : 0.0),
               c = cos(angle), s = sin(angle);
        out[count++] = (equation){{-s, at->x_m * c + at->y_m * s, c * y}, 0.0};
        if (at->traction != 0 && joints & 1U << (at->traction - 1)) {
            out[count++] = (equation){{c, at->x_m * s - at->y_m * c, s * y}, rim[at->traction - 1]};
        }
    }
    return count;
}

static double left_over(const equation *one, const double *twist_u)
{
    return one->of[0] * twist_u[0] + one->of[1] * twist_u[1] + one->of[2] * twist_u[2] - one->rim;
}

/* The residuals of least squares are orthogonal to every column. */
static void check_least_squares(const core_config *base, const double *angle_rad, uint32_t joints,
                                const double *rim)
{
    equation one[2 * JOINTS_MAX];
    double twist_u[AXES] = {0.0}, square = 0.0;
    twist_inverse found;
    kinematics_modules(base, angle_rad, joints, &found);
    CHECK(found.determined == 1 && found.joints == 0 && found.shared == 1.0);
    CHECK(found.strafes == (uint32_t)kinematics_strafes(base));
    for (int a = 0; a < AXES; a++) {
        for (uint32_t j = 0; j < JOINTS_MAX; j++) {
            twist_u[a] += found.inverse[a][j] * rim[j];
            CHECK(joints >> j & 1U || found.inverse[a][j] == 0.0);
        }
    }
    int count = equations(base, angle_rad, joints, rim, one);
    for (int a = 0; a < AXES; a++) {
        double sum = 0.0;
        for (int i = 0; i < count; i++) {
            sum += one[i].of[a] * left_over(&one[i], twist_u);
        }
        CHECK(close_to(sum, 0.0));
    }
    /* any other motion has a residual, too */
    twist_u[0] += any(-1.0, 1.0), twist_u[1] += any(-1.0, 1.0), twist_u[2] += any(-1.0, 1.0);
    for (int i = 0; i < count; i++) {
        square += left_over(&one[i], twist_u) * left_over(&one[i], twist_u);
    }
    CHECK(
        close_to(kinematics_residual(base, angle_rad, joints, rim, twist_u), sqrt(square / count)));
}

static void the_motion_is_that_of_least_squares_at_any_angle(void)
{
    core_config bases[] = {bicycle(), tricycle(), ackermann(WHEELBASE_M), ackermann(-WHEELBASE_M),
                           swerve()};
    for (int i = 0; i < COUNT_OF(bases); i++) { /* a module beyond the count does not count */
        bases[i].module[bases[i].module_count] =
            (wheel_module){.x_m = 1.0, .y_m = 0.5, .traction = 1};
    }
    for (int round = 0; round < 500; round++) {
        const core_config *base = &bases[round % COUNT_OF(bases)];
        double angle_rad[JOINTS_MAX], rim[JOINTS_MAX];
        for (int j = 0; j < JOINTS_MAX; j++) {
            angle_rad[j] = any(-0.6, 0.6), rim[j] = any(-1.5, 1.5);
        }
        check_least_squares(base, angle_rad, 255, rim);
    }
}

/* A wheel with an unknown angle gives no equation. One with an unknown rim gives only that it does
 * not slide. */
static void joints_without_feedback_leave_their_equations_out(void)
{
    static const uint32_t ENOUGH[] = {0x7, 0xB, 0xD, 0xE, 0x3, 0x5, 0x6, 0x9, 0xA};
    const core_config base = ackermann(WHEELBASE_M);
    double angle_rad[JOINTS_MAX] = {0.0, 0.0, 0.4, 0.5}, rim[JOINTS_MAX] = {1.0, -0.3};
    for (int i = 0; i < COUNT_OF(ENOUGH); i++) {
        check_least_squares(&base, angle_rad, ENOUGH[i], rim);
    }
    const core_config strafes = swerve();
    double turned_rad[JOINTS_MAX] = {0.4, 0.0, -1.2};
    for (int j = 0; j < JOINTS_MAX; j++) {
        rim[j] = any(-1.0, 1.0);
    }
    check_least_squares(&strafes, turned_rad, 0x7, rim); /* each of the two wheels rolls freely
                                                            once */
    check_least_squares(&strafes, turned_rad, 0xD, rim);
}

static void too_few_joints_determine_nothing(void)
{
    const core_config base = swerve();
    double angle_rad[JOINTS_MAX] = {0.4, 0.0, -1.2};
    twist_inverse found;
    const uint32_t few[] = {0x0, 0x3, 0xC, 0xA, 0x5, 0x4};
    for (int i = 0; i < COUNT_OF(few); i++) {
        memset(&found, 0xff, sizeof found);
        kinematics_modules(&base, angle_rad, few[i], &found);
        CHECK(found.determined == 0 && found.shared == 1.0);
        for (int a = 0; a < AXES; a++) {
            for (int j = 0; j < JOINTS_MAX; j++) {
                CHECK(found.inverse[a][j] == 0.0);
            }
        }
    }
}

/* Two wheels nearly on one line: an error of a rim would become an error of the turn that is a
 * thousand times as large. */
static void a_nearly_degenerate_base_is_not_determined(void)
{
    static const struct {
        double part;
        uint32_t determined;
    } CASES[] = {{3e-6, 1}, {1.1e-6, 1}, {0.9e-6, 0}, {3e-7, 0}};
    for (int i = 0; i < COUNT_OF(CASES); i++) {
        /* levers of 1 and 1 - d: d^2 of 2 (1 + (1 - d)^2) */
        double d = sqrt(4.0 * CASES[i].part);
        core_config base = good_config();
        base.joint_count = 2;
        base.joint[0].row.lever_m = 1.0, base.joint[1].row.lever_m = 1.0 - d;
        twist_inverse found;
        kinematics_invert(&base, 3, &found);
        CHECK(found.determined == CASES[i].determined);
    }
}

/* `shared` is the number of joints per axis: 2 for four wheels and two axes. */
static void wheels_share_the_axes_that_they_determine(void)
{
    core_config base = good_config();
    twist_inverse found;
    kinematics_invert(&base, 0xF, &found);
    CHECK(found.determined == 1 && found.joints == 0xF && found.strafes == 0 &&
          found.shared == 2.0);
    base.joint[4] = base.joint[3]; /* beyond the joints of the base */
    kinematics_invert(&base, 0xFF, &found);
    CHECK(found.determined == 1 && found.shared == 2.0 && found.inverse[0][4] == 0.0 &&
          found.inverse[0][3] > 0.0);
    kinematics_invert(&base, 0x7, &found);
    CHECK(found.determined == 1 && found.joints == 0x7 && found.shared == 1.5 &&
          found.inverse[0][3] == 0.0);
    for (int j = 0; j < 4; j++) {
        base.joint[j].row.y = j % 3 == 0 ? 1.0 : -1.0;
    }
    kinematics_invert(&base, 0xF, &found);
    CHECK(found.determined == 1 && found.strafes == 1 && close_to(found.shared, 4.0 / 3.0));
}

/* The set-points and the check of the configuration use the inverse with straight wheels. */
static void the_inverse_of_a_base_with_modules_assumes_wheels_straight_ahead(void)
{
    const core_config base = swerve();
    twist_inverse straight, found;
    double angle_rad[JOINTS_MAX] = {0.0};
    kinematics_modules(&base, angle_rad, 0xF, &straight);
    kinematics_invert(&base, 0xF, &found);
    CHECK(memcmp(&found, &straight, sizeof found) == 0);
    core_config one = base; /* the rows of its joints do not count */
    one.module_count = 1;
    one.joint[0].row = (wheel_row){1.0, 0.0, 0.25}, one.joint[1].row = (wheel_row){1.0, 0.0, -0.25};
    kinematics_invert(&one, 3, &found);
    CHECK(found.determined == 0 && found.joints == 0 && found.shared == 1.0);
}

/* Also a base with a single module has no such twist. A joint beyond the count neither counts nor
 * hides others. */
static void wheel_speeds_alone_are_a_twist_where_they_fit_together(void)
{
    double twist_u_s[AXES + 1] = {9.0, 9.0, 9.0, 7.0},
                            velocity_rad_s[JOINTS_MAX] = {3.0, 7.0, 3.0, 7.0, 1e6};
    core_config base = good_config();
    base.joint[4] = base.joint[3];
    CHECK(joints_twist(&base, velocity_rad_s, twist_u_s));
    CHECK(close_to(twist_u_s[0], 0.5) && close_to(twist_u_s[1], 0.8) && twist_u_s[2] == 0.0 &&
          twist_u_s[3] == 7.0);
    velocity_rad_s[2] = 4.0;
    CHECK(!joints_twist(&base, velocity_rad_s, twist_u_s));
    velocity_rad_s[2] = 3.0;
    for (uint32_t modules = 0; modules < 3; modules++) {
        base.module_count = modules;
        memset(velocity_rad_s, 0, sizeof velocity_rad_s);
        CHECK(joints_twist(&base, velocity_rad_s, twist_u_s) == (modules == 0));
    }
}

static void a_wheel_turns_as_its_row_of_the_twist(void)
{
    core_config base = good_config();
    const double twist_u_s[AXES] = {0.5, 0.8, 0.3};
    double wheel_rad_s[JOINTS_MAX] = {7.0, 7.0, 7.0, 7.0, 7.0};
    base.joint[2].row.y = 1.0, base.joint[3].wheel_radius_m = 0.2;
    kinematics_wheels(&base, twist_u_s, wheel_rad_s);
    CHECK(close_to(wheel_rad_s[0], 3.0) && close_to(wheel_rad_s[1], 7.0) &&
          close_to(wheel_rad_s[2], 6.0));
    CHECK(close_to(wheel_rad_s[3], 3.5) && wheel_rad_s[4] == 7.0);
}

static void a_base_strafes_where_all_of_its_wheels_are_steered_or_one_rolls_sideways(void)
{
    core_config base = swerve();
    CHECK(kinematics_strafes(&base));
    base.module[1].steering = 0;
    CHECK(!kinematics_strafes(&base));
    base.module[1].steering = 3, base.module[0].steering = 0;
    CHECK(!kinematics_strafes(&base));
    base = good_config();
    CHECK(!kinematics_strafes(&base));
    base.joint[4].row.y = 1.0; /* beyond the joints of the base */
    CHECK(!kinematics_strafes(&base));
    for (int j = 0; j < 4; j++) {
        base.joint[j].row.y = -1.0;
        CHECK(kinematics_strafes(&base));
        base.joint[j].row.y = 0.1;
        CHECK(kinematics_strafes(&base));
        base.joint[j].row.y = 0.0;
    }
    base = bicycle();
    CHECK(!kinematics_strafes(&base));
    base.joint[0].row.y = 1.0; /* rows of a base with modules do not count */
    CHECK(!kinematics_strafes(&base));
    base.module_count = 1, base.module[0].steering = 0;
    CHECK(!kinematics_strafes(&base));
}

int main(void)
{
    the_motion_is_that_of_least_squares_at_any_angle();
    joints_without_feedback_leave_their_equations_out();
    too_few_joints_determine_nothing();
    a_nearly_degenerate_base_is_not_determined();
    wheels_share_the_axes_that_they_determine();
    the_inverse_of_a_base_with_modules_assumes_wheels_straight_ahead();
    wheel_speeds_alone_are_a_twist_where_they_fit_together();
    a_wheel_turns_as_its_row_of_the_twist();
    a_base_strafes_where_all_of_its_wheels_are_steered_or_one_rolls_sideways();
    return checks_report("test_modules");
}
