/* SPDX-License-Identifier: Apache-2.0
 * test_spread: pose and covariances of a base with mecanum wheels, compared with a second
 * implementation of the textbook's formulas; the error that steering without a measurement adds;
 * and how uncertain a base becomes whose wheels are silent. */
#include "steered_bases.h"

enum { WHEELS = 4 };

static const double SMOOTHED_S = 0.2; /* SLIP_TIME_S of spread.c, of which the test uses no other
                                         part */
static const double RIM_M[WHEELS] = {0.05, 0.031, 0.02, 0.047};
static const int64_t BEFORE_NS = 1000000000, STEP_NS = 50000000;

static core_config mecanum(void)
{
    core_config config = {.joint_count = WHEELS,
                          .distance_variance_m2_per_m = 1e-4,
                          .turn_variance_rad2_per_rad = 1e-3,
                          .feedback_timeout_s = 0.25};
    for (int j = 0; j < WHEELS; j++) {
        config.joint[j] = (joint_config){.row = {1.0, j % 2 == 0 ? -0.8 : 0.9, j < 2 ? -0.4 : 0.35},
                                         .wheel_radius_m = 0.1,
                                         .velocity_max_rad_s = 30.0,
                                         .rad_per_count = 1e-3,
                                         .counter_bits = 32};
    }
    return config;
}

/* Covariance of the motion in the frame of the base: x, y and turn. */
typedef struct {
    double slip_m_s;
    double turn_rad;
    double of[3][3];
} expected_errors;

static expected_errors expected_of(const odometry_state *s, const core_config *config,
                                   double elapsed_s)
{
    expected_errors e = {0};
    const double *in[3] = {s->used.inverse[AXIS_LINEAR], s->used.inverse[AXIS_LATERAL],
                           s->used.inverse[AXIS_ANGULAR]};
    double moved[3] = {0}, sum = 0.0;
    for (int i = 0; i < 3; i++) {
        for (int j = 0; j < WHEELS; j++) {
            moved[i] += in[i][j] * RIM_M[j];
        }
    }
    for (int j = 0; j < WHEELS && elapsed_s > 0.0; j++) {
        const wheel_row *row = &config->joint[j].row;
        double left_m =
            RIM_M[j] - (row->x * moved[0] + row->y * moved[1] + row->lever_m * moved[2]);
        sum += pow(left_m / (SMOOTHED_S + elapsed_s), 2.0);
    }
    e.slip_m_s = sqrt(sum / WHEELS);
    e.turn_rad = moved[2];
    for (int j = 0; j < WHEELS; j++) {
        double travel_m2 =
            WHEELS / 3.0 *
            (1e-4 * fabs(RIM_M[j]) + 2.0 * SMOOTHED_S * e.slip_m_s * e.slip_m_s * elapsed_s);
        for (int i = 0; i < 9; i++) {
            e.of[i / 3][i % 3] += in[i / 3][j] * in[i % 3][j] * travel_m2;
        }
    }
    return e;
}

static void times(double a[3][3], double b[3][3], double out[3][3])
{
    memset(out, 0, 9 * sizeof(double));
    for (int i = 0; i < 27; i++) {
        out[i / 9][i / 3 % 3] += a[i / 9][i % 3] * b[i % 3][i / 3 % 3];
    }
}

/* Computes A C A'. */
static void carried(double a[3][3], double c[3][3], double out[3][3])
{
    double half[3][3], turned[3][3];
    for (int i = 0; i < 9; i++) {
        turned[i % 3][i / 3] = a[i / 3][i % 3];
    }
    times(a, c, half);
    times(half, turned, out);
}

static bool near(double value, double expected)
{
    return fabs(value - expected) <= 1e-12 * fabs(expected) + 1e-18;
}

/* Siegwart & Nourbakhsh, Autonomous Mobile Robots, 5.2.4: P' = F P F' + G Q G'. */
static void check_pose(const odometry_state *s, const double *p, const expected_errors *e,
                       const double *moved_m, double middle_rad)
{
    double x = moved_m[0], y = moved_m[1], c = cos(middle_rad), sn = sin(middle_rad);
    double f[3][3] = {{1, 0, -y}, {0, 1, x}, {0, 0, 1}},
           g[3][3] = {{c, -sn, -0.5 * y}, {sn, c, 0.5 * x}, {0, 0, 1}};
    double before[3][3] = {{p[0], p[1], p[2]}, {p[1], p[3], p[4]}, {p[2], p[4], p[5]}}, q[3][3],
           first[3][3], second[3][3];
    memcpy(q, e->of, sizeof q);
    carried(f, before, first);
    carried(g, q, second);
    const int at[6][2] = {{0, 0}, {0, 1}, {0, 2}, {1, 1}, {1, 2}, {2, 2}};
    for (int i = 0; i < 6; i++) {
        double scrub = i == 5 ? 1e-3 * fabs(e->turn_rad) : 0.0;
        CHECK(near(s->pose_covariance[i],
                   first[at[i][0]][at[i][1]] + second[at[i][0]][at[i][1]] + scrub));
    }
}

static void a_look_carries_the_wheels_errors_and_their_slip_into_the_pose(void)
{
    static odometry_state s;
    core_config config = mecanum();
    odometry_init(&s, &config);
    CHECK(s.used.strafes && s.used.determined && s.used.shared > 1.0);
    const double p[6] = {3e-3, 2e-4, -1e-4, 4e-3, 3e-4, 5e-3}, moved_m[2] = {0.03, -0.02};
    memcpy(s.pose_covariance, p, sizeof p);
    memcpy(s.spread.rim_m, RIM_M, sizeof RIM_M);
    s.spread.stamp_ns = BEFORE_NS;
    s.spread.heading_rad = 0.4, s.heading_rad = 0.5;
    s.spread.x_m = moved_m[0], s.spread.y_m = moved_m[1];
    expected_errors e = expected_of(&s, &config, 0.05);
    spread_look(&s, &config, BEFORE_NS + STEP_NS);
    CHECK(near(s.spread.slip_m_s, e.slip_m_s) && e.slip_m_s > 1e-3);
    check_pose(&s, p, &e, moved_m, 0.45);
    CHECK(s.spread.stamp_ns == BEFORE_NS + STEP_NS && s.spread.x_m == 0.0 &&
          s.spread.rim_m[0] == 0.0);
}

/* The time of the first look is unknown: it gives no slip. */
static void the_first_look_adds_errors_without_a_time(void)
{
    static odometry_state s;
    core_config config = mecanum();
    odometry_init(&s, &config);
    const double p[6] = {0}, moved_m[2] = {0.03, -0.02};
    memcpy(s.spread.rim_m, RIM_M, sizeof RIM_M);
    s.spread.x_m = moved_m[0], s.spread.y_m = moved_m[1];
    expected_errors e = expected_of(&s, &config, 0.0);
    spread_look(&s, &config, BEFORE_NS);
    CHECK(s.spread.slip_m_s == 0.0);
    check_pose(&s, p, &e, moved_m, 0.0);
}

/* Lynch & Park, Modern Robotics, 2017, 13.4: the exponential of a constant twist. */
static void a_curve_sideways_ends_where_the_textbook_puts_it(void)
{
    static odometry_state s;
    static joint_feedback feedback[JOINTS_MAX];
    const uint32_t stale[JOINTS_MAX] = {0};
    const joint_setpoint setpoint[JOINTS_MAX] = {{0}};
    const double x = 0.02, y = 0.03, turn = 0.4, from = 0.3;
    core_config config = mecanum();
    for (int j = 0; j < WHEELS; j++) {
        config.joint[j].rad_per_count = 1e-7;
    }
    odometry_init(&s, &config);
    for (int step = 1; step <= 2; step++) {
        for (int j = 0; j < WHEELS; j++) {
            const wheel_row *row = &config.joint[j].row;
            double rim_m = row->x * x + row->y * y + row->lever_m * turn;
            feedback[j].stamp_ns = step * STEP_NS;
            feedback[j].count =
                step == 1 ? 0 : (uint64_t)llround(rim_m / config.joint[j].wheel_radius_m * 1e7);
            feedback[j].velocity_rad_s = NAN;
        }
        s.heading_rad = s.spread.heading_rad = from;
        odometry_step(&s, &config, feedback, stale, setpoint);
    }
    double ahead = (sin(turn) * x - (1.0 - cos(turn)) * y) / turn,
           left = ((1.0 - cos(turn)) * x + sin(turn) * y) / turn;
    CHECK(fabs(s.x_m - (cos(from) * ahead - sin(from) * left)) < 1e-7);
    CHECK(fabs(s.y_m - (sin(from) * ahead + cos(from) * left)) < 1e-7);
    CHECK(fabs(s.heading_rad - from - turn) < 1e-7 && fabs(s.turned_rad - turn) < 1e-7);
    CHECK(fabs(s.distance_m - hypot(x, y)) < 1e-7);
    CHECK(fabs(s.linear_m_s - x / 0.05) < 1e-5 && fabs(s.lateral_m_s - y / 0.05) < 1e-5);
    CHECK(fabs(s.angular_rad_s - turn / 0.05) < 1e-5 && s.degraded == 0);
}

/* A wheel that is left out has no error of its own any more. It restarts when it returns. */
static void only_wheels_that_determine_the_motion_count_in_the_slip(void)
{
    static const uint32_t JOINTS[] = {0xB, 0xD, 0x7, 0xE, 0xF};
    static const double LEVER_M[WHEELS] = {-0.4, 0.3, 0.35, -0.2},
                        BEFORE_M_S[WHEELS] = {0.02, -0.03, 0.7, 0.05};
    for (int i = 0; i < COUNT_OF(JOINTS); i++) {
        static odometry_state s;
        core_config config = mecanum();
        for (int j = 0; j < WHEELS; j++) {
            config.joint[j].row = (wheel_row){1.0, 0.0, LEVER_M[j]};
        }
        odometry_init(&s, &config);
        kinematics_invert(&config, JOINTS[i], &s.used);
        memcpy(s.spread.rim_m, RIM_M, sizeof RIM_M);
        memcpy(s.spread.residual_m_s, BEFORE_M_S, sizeof BEFORE_M_S);
        s.spread.stamp_ns = BEFORE_NS;
        double moved_m = 0.0, turn_rad = 0.0, sum = 0.0, count = 0.0;
        for (int j = 0; j < WHEELS; j++) {
            moved_m += s.used.inverse[AXIS_LINEAR][j] * RIM_M[j],
                turn_rad += s.used.inverse[AXIS_ANGULAR][j] * RIM_M[j];
        }
        spread_look(&s, &config, BEFORE_NS + STEP_NS);
        for (int j = 0; j < WHEELS; j++) {
            double left_m = RIM_M[j] - moved_m - LEVER_M[j] * turn_rad - BEFORE_M_S[j] * 0.05;
            double expected_m_s =
                JOINTS[i] >> j & 1U ? BEFORE_M_S[j] + left_m / (SMOOTHED_S + 0.05) : 0.0;
            CHECK(near(s.spread.residual_m_s[j], expected_m_s));
            sum += expected_m_s * expected_m_s, count += JOINTS[i] >> j & 1U;
        }
        CHECK(near(s.spread.slip_m_s, sqrt(sum / count)));
    }
}

/* --- steering joints without a measurement */

/* The variance of the heading after the rims have moved by `rim_m` with these angles. The base has
 * no other errors. */
static double steered_rad2(core_config config, const double *angle_rad, double rim_m)
{
    static odometry_state s;
    config.distance_variance_m2_per_m = config.turn_variance_rad2_per_rad = 0.0;
    config.pose_variance_floor_m2 = config.heading_variance_floor_rad2 = 0.0;
    odometry_init(&s, &config);
    kinematics_modules(&config, angle_rad, (1U << config.joint_count) - 1U, &s.used);
    for (uint32_t j = 0; j < config.joint_count; j++) {
        s.spread.rim_m[j] = rim_m;
    }
    s.spread.stamp_ns = BEFORE_NS;
    spread_look(&s, &config, BEFORE_NS + STEP_NS);
    CHECK(s.used.determined);
    return s.pose_covariance[5];
}

/* The direction may be off by 0.03 rad per metre, which turns the base by the resulting distance
 * over the lever. */
static double beside_rad2(double distance_m, double lever2_m2)
{
    return 0.03 * 0.03 * 1.0 * distance_m / lever2_m2;
}

static void a_wheel_whose_angle_is_estimated_turns_the_base_by_its_error_over_its_lever(void)
{
    const double straight_rad[JOINTS_MAX] = {0.0};
    core_config base = bicycle();
    CHECK(steered_rad2(base, straight_rad, 0.5) == 0.0);
    base.joint[1].position.reference = REFERENCE_ESTIMATED;
    base.module[2].x_m = 0.1, base.module[2].y_m = 0.0; /* beyond the modules of the base */
    CHECK(near(steered_rad2(base, straight_rad, 0.5), beside_rad2(0.5, 0.3 * 0.3)));
    CHECK(near(steered_rad2(base, straight_rad, -0.8), beside_rad2(0.8, 0.3 * 0.3)));
    CHECK(steered_rad2(base, straight_rad, 0.0) == 0.0);
    base.module[0].y_m = -0.15;
    CHECK(near(steered_rad2(base, straight_rad, 0.5), beside_rad2(0.5, 0.3 * 0.3 + 0.15 * 0.15)));
}

static void the_worst_of_several_estimated_wheels_counts(void)
{
    const double straight_rad[JOINTS_MAX] = {0.0, 0.0, -0.3};
    for (uint32_t estimated = 0; estimated < 4; estimated++) {
        for (int farther = 0; farther < 2; farther++) {
            core_config base = swerve();
            base.module[1].x_m = farther ? -0.4 : -0.2;
            double first_m2 = 0.3 * 0.3 + 0.1 * 0.1,
                   second_m2 = farther ? 0.4 * 0.4 + 0.2 * 0.2 : 2.0 * 0.2 * 0.2;
            base.joint[0].position.reference =
                estimated & 1U ? REFERENCE_ESTIMATED : REFERENCE_ABSOLUTE;
            base.joint[2].position.reference =
                estimated & 2U ? REFERENCE_ESTIMATED : REFERENCE_ABSOLUTE;
            double first_rad2 = estimated & 1U ? beside_rad2(0.5, first_m2) : 0.0;
            double second_rad2 = estimated & 2U ? beside_rad2(0.5, second_m2) : 0.0;
            CHECK(near(steered_rad2(base, straight_rad, 0.5), fmax(first_rad2, second_rad2)));
        }
    }
}

static void the_error_of_a_wheel_that_is_estimated_grows_with_the_distance_in_any_direction(void)
{
    core_config base = swerve();
    base.joint[0].position.reference = REFERENCE_ESTIMATED;
    for (int i = -3; i <= 3; i++) {
        double angle_rad[JOINTS_MAX] = {0.5 * i, 0.0, 0.5 * i - 0.3}; /* both wheels point in this
                                                                         direction */
        CHECK(near(steered_rad2(base, angle_rad, 0.4), beside_rad2(0.4, 0.3 * 0.3 + 0.1 * 0.1)));
    }
}

/* A wheel in the middle has no lever. */
static void a_wheel_in_the_middle_that_is_estimated_turns_nothing(void)
{
    const double straight_rad[JOINTS_MAX] = {0.0, 0.0, -0.3};
    core_config base = swerve();
    base.joint[0].position.reference = REFERENCE_ESTIMATED;
    base.module[0].x_m = base.module[0].y_m = 0.0;
    CHECK(steered_rad2(base, straight_rad, 0.5) == 0.0 &&
          steered_rad2(base, straight_rad, 0.0) == 0.0);
}

/* --- wheels without feedback */
static double all_of(const double *inverse)
{
    double sum = 0.0;
    for (int j = 0; j < JOINTS_MAX; j++) {
        sum += fabs(inverse[j]);
    }
    return sum;
}

static void a_blind_base_that_strafes_may_have_gone_ahead_and_sideways(void)
{
    static odometry_state s;
    core_config config = mecanum();
    config.twist_variance_floor_m2_s2 = 1e-3;
    odometry_init(&s, &config);
    s.pose_covariance[0] = 0.04, s.pose_covariance[3] = 0.09, s.pose_covariance[5] = 0.01;
    s.lateral_m_s = -0.3;
    s.lateral_covariance[0] = 0.02, s.lateral_covariance[1] = 0.0, s.lateral_covariance[2] = 0.03;
    const joint_setpoint wheels[JOINTS_MAX] = {
        {.velocity_rad_s = 1.0}, {.velocity_rad_s = -2.0}, {.velocity_rad_s = 1.5}};
    odometry_drift(&s, &config, wheels, 0.1); /* the fastest wheel moves 0.02 m */
    double distance_m =
        0.02 * (all_of(s.used.inverse[AXIS_LINEAR]) + all_of(s.used.inverse[AXIS_LATERAL]));
    CHECK(distance_m > 0.03 && near(s.pose_covariance[0], pow(0.2 + distance_m, 2.0)));
    CHECK(near(s.pose_covariance[3], pow(0.3 + distance_m, 2.0)));
    CHECK(near(s.pose_covariance[5], pow(0.1 + 0.02 * all_of(s.used.inverse[AXIS_ANGULAR]), 2.0)));
    CHECK(s.lateral_covariance[0] == 0.02 && near(s.lateral_covariance[1], 1e-3 + 0.09) &&
          s.lateral_covariance[2] == 0.03);
    s.lateral_covariance[1] = 7.0; /* more uncertain than the new value */
    odometry_drift(&s, &config, wheels, 0.1);
    CHECK(s.lateral_covariance[0] == 0.02 && s.lateral_covariance[1] == 7.0 &&
          s.lateral_covariance[2] == 0.03);
}

/* The base is as uncertain as one wheel of each side makes it: neither is left out. */
static void a_blind_base_that_does_not_strafe_has_no_variance_sideways(void)
{
    static odometry_state s;
    core_config config = mecanum();
    config.joint_count = 2;
    config.twist_variance_floor_m2_s2 = 1e-3;
    config.joint[0].row = (wheel_row){1.0, 0.0, -0.25},
    config.joint[1].row = (wheel_row){1.0, 0.0, 0.25};
    odometry_init(&s, &config);
    odometry_drift(&s, &config, (const joint_setpoint[JOINTS_MAX]){{.velocity_rad_s = 2.0}}, 0.1);
    CHECK(near(s.pose_covariance[0], 0.02 * 0.02) && near(s.pose_covariance[5], 0.08 * 0.08));
    CHECK(s.lateral_covariance[0] == 0.0 && s.lateral_covariance[1] == 0.0 &&
          s.lateral_covariance[2] == 0.0);
}

static double blind_turn_rad(const core_config *config, const double *angle_rad)
{
    static odometry_state s;
    odometry_init(&s, config);
    memcpy(s.angle_rad, angle_rad, sizeof s.angle_rad);
    s.pose_covariance[5] = 0.0;
    joint_setpoint wheels[JOINTS_MAX];
    for (int j = 0; j < JOINTS_MAX; j++) {
        wheels[j] = (joint_setpoint){.velocity_rad_s = config->joint[j].position.used ? 0.0 : -2.0};
    }
    odometry_drift(&s, config, wheels, 0.5); /* 0.05 m */
    return sqrt(s.pose_covariance[5]);
}

static void a_blind_base_with_steered_wheels_may_have_turned_as_they_point(void)
{
    const core_config two = bicycle(), four = swerve_of_four();
    for (int i = -6; i <= 6; i += 3) {
        double angle_rad[JOINTS_MAX] = {NAN, 0.1 * i};
        CHECK(fabs(blind_turn_rad(&two, angle_rad) - 0.05 * tan(0.1 * abs(i)) / WHEELBASE_M) <
              1e-12);
    }
    const double unknown_rad[JOINTS_MAX] = {NAN, NAN}; /* counts as straight ahead */
    CHECK(blind_turn_rad(&two, unknown_rad) == 0.0);
    double spot_rad = atan2(0.3, 0.2), angle_rad[JOINTS_MAX];
    for (int j = 0; j < JOINTS_MAX; j++) {
        angle_rad[j] = j % 2 == 0 ? spot_rad * (j == 0 || j == 6 ? -1.0 : 1.0) : NAN;
    }
    CHECK(fabs(blind_turn_rad(&four, angle_rad) - 0.05 / hypot(0.3, 0.2)) < 1e-12);
}

int main(void)
{
    a_curve_sideways_ends_where_the_textbook_puts_it();
    a_look_carries_the_wheels_errors_and_their_slip_into_the_pose();
    the_first_look_adds_errors_without_a_time();
    only_wheels_that_determine_the_motion_count_in_the_slip();
    a_wheel_whose_angle_is_estimated_turns_the_base_by_its_error_over_its_lever();
    the_worst_of_several_estimated_wheels_counts();
    the_error_of_a_wheel_that_is_estimated_grows_with_the_distance_in_any_direction();
    a_wheel_in_the_middle_that_is_estimated_turns_nothing();
    a_blind_base_that_strafes_may_have_gone_ahead_and_sideways();
    a_blind_base_that_does_not_strafe_has_no_variance_sideways();
    a_blind_base_with_steered_wheels_may_have_turned_as_they_point();
    return checks_report("test_spread");
}
