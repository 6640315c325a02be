/* SPDX-License-Identifier: Apache-2.0
 * test_spread: pose and covariances of a base with mecanum wheels by the formulas of the textbook, written out anew. */
#include <math.h>
#include <string.h>

#include "check.h"
#include "core.h"

enum { WHEELS = 4 };

static const double SMOOTHED_S = 0.2; /* SLIP_TIME_S of spread.c, of which nothing else is taken from there */
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

/* Covariance of the motion, in the frame of the base: x, y, turn. */
typedef struct {
    double slip_m_s;
    double turn_rad;
    double of[3][3];
} expected_errors;

static expected_errors expected_of(const odometry_state *s, const core_config *config, double elapsed_s)
{
    expected_errors e = {0};
    const double *in[3] = {s->used.inverse[AXIS_LINEAR], s->used.inverse[AXIS_LATERAL], s->used.inverse[AXIS_ANGULAR]};
    double moved[3] = {0}, sum = 0.0;
    for (int i = 0; i < 3; i++) {
        for (int j = 0; j < WHEELS; j++) {
            moved[i] += in[i][j] * RIM_M[j];
        }
    }
    for (int j = 0; j < WHEELS && elapsed_s > 0.0; j++) {
        const wheel_row *row = &config->joint[j].row;
        double left_m = RIM_M[j] - (row->x * moved[0] + row->y * moved[1] + row->lever_m * moved[2]);
        sum += pow(left_m / (SMOOTHED_S + elapsed_s), 2.0);
    }
    e.slip_m_s = sqrt(sum / WHEELS);
    e.turn_rad = moved[2];
    for (int j = 0; j < WHEELS; j++) {
        double travel_m2 = WHEELS / 3.0 * (1e-4 * fabs(RIM_M[j]) + 2.0 * SMOOTHED_S * e.slip_m_s * e.slip_m_s * elapsed_s);
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

/* A C A' */
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
static void check_pose(const odometry_state *s, const double *p, const expected_errors *e, const double *moved_m,
                       double middle_rad)
{
    double x = moved_m[0], y = moved_m[1], c = cos(middle_rad), sn = sin(middle_rad);
    double f[3][3] = {{1, 0, -y}, {0, 1, x}, {0, 0, 1}}, g[3][3] = {{c, -sn, -0.5 * y}, {sn, c, 0.5 * x}, {0, 0, 1}};
    double before[3][3] = {{p[0], p[1], p[2]}, {p[1], p[3], p[4]}, {p[2], p[4], p[5]}}, q[3][3], first[3][3], second[3][3];
    memcpy(q, e->of, sizeof q);
    carried(f, before, first);
    carried(g, q, second);
    const int at[6][2] = {{0, 0}, {0, 1}, {0, 2}, {1, 1}, {1, 2}, {2, 2}};
    for (int i = 0; i < 6; i++) {
        double scrub = i == 5 ? 1e-3 * fabs(e->turn_rad) : 0.0;
        CHECK(near(s->pose_covariance[i], first[at[i][0]][at[i][1]] + second[at[i][0]][at[i][1]] + scrub));
    }
}

static void a_look_carries_the_wheels_errors_and_their_slip_into_pose_and_twist(void)
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
    CHECK(near(s.spread.linear2_m2_s, e.of[0][0] / 0.05) && near(s.spread.lateral2_m2_s, e.of[1][1] / 0.05));
    CHECK(near(s.spread.angular2_rad2_s, (e.of[2][2] + 1e-3 * fabs(e.turn_rad)) / 0.05));
    CHECK(near(s.spread.linear_lateral_m2_s, e.of[0][1] / 0.05));
    CHECK(near(s.spread.linear_angular_m_rad_s, e.of[0][2] / 0.05));
    CHECK(near(s.spread.lateral_angular_m_rad_s, e.of[1][2] / 0.05));
    CHECK(s.spread.stamp_ns == BEFORE_NS + STEP_NS && s.spread.x_m == 0.0 && s.spread.rim_m[0] == 0.0);
}

/* How long it took is not known: no slip, and no rate. */
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
    CHECK(s.spread.slip_m_s == 0.0 && s.spread.linear2_m2_s == 0.0 && s.spread.angular2_rad2_s == 0.0);
    check_pose(&s, p, &e, moved_m, 0.0);
}

/* Lynch & Park, Modern Robotics, 2017, 13.4: the exponential of a constant twist. */
static void a_curve_sideways_ends_where_the_textbook_says(void)
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
            feedback[j].count = step == 1 ? 0 : (uint64_t)llround(rim_m / config.joint[j].wheel_radius_m * 1e7);
            feedback[j].velocity_rad_s = NAN;
        }
        s.heading_rad = s.spread.heading_rad = from;
        odometry_step(&s, &config, feedback, stale, setpoint);
    }
    double ahead = (sin(turn) * x - (1.0 - cos(turn)) * y) / turn, left = ((1.0 - cos(turn)) * x + sin(turn) * y) / turn;
    CHECK(fabs(s.x_m - (cos(from) * ahead - sin(from) * left)) < 1e-7);
    CHECK(fabs(s.y_m - (sin(from) * ahead + cos(from) * left)) < 1e-7);
    CHECK(fabs(s.heading_rad - from - turn) < 1e-7 && fabs(s.turned_rad - turn) < 1e-7);
    CHECK(fabs(s.distance_m - hypot(x, y)) < 1e-7);
    CHECK(fabs(s.linear_m_s - x / 0.05) < 1e-5 && fabs(s.lateral_m_s - y / 0.05) < 1e-5);
    CHECK(fabs(s.angular_rad_s - turn / 0.05) < 1e-5 && s.degraded == 0);
}

int main(void)
{
    a_curve_sideways_ends_where_the_textbook_says();
    a_look_carries_the_wheels_errors_and_their_slip_into_pose_and_twist();
    the_first_look_adds_errors_without_a_time();
    return checks_report("test_spread");
}
