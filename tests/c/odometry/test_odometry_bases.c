/* SPDX-License-Identifier: Apache-2.0
 * test_odometry_bases: the odometry of bases that strafe or are steered, and the errors that it
 * includes when wheels fall silent or a gyro begins. */
#include "steered_bases.h"

static const int64_t STEP_NS = 10000000;
static const double COUNT_RAD = 1e-5;
static const uint32_t RECEIVED[JOINTS_MAX] = {0};

typedef struct {
    core_config config;
    odometry_state state;
    joint_feedback feedback[JOINTS_MAX];
    joint_setpoint setpoint[JOINTS_MAX];
} base;

static void begin_with(base *b, core_config config)
{
    memset(b, 0, sizeof *b);
    b->config = config;
    odometry_init(&b->state, &b->config);
}

static void comes(base *b, uint32_t j, int64_t after_ns, int64_t counts)
{
    b->feedback[j].stamp_ns += after_ns;
    b->feedback[j].count += (uint64_t)counts;
    b->feedback[j].velocity_rad_s = NAN;
}

static void step_with_stale(base *b, const uint32_t *stale)
{
    odometry_step(&b->state, &b->config, b->feedback, stale, b->setpoint);
}

static void all_come(base *b, int64_t after_ns, const int64_t *counts)
{
    for (uint32_t j = 0; j < b->config.joint_count; j++) {
        comes(b, j, after_ns, counts[j]);
    }
    step_with_stale(b, RECEIVED);
}

static double rim_m(const base *b, uint32_t j, int64_t counts)
{
    return (double)counts * COUNT_RAD * b->config.joint[j].wheel_radius_m;
}

static const int64_t NOTHING_NEW[JOINTS_MAX] = {0};

/* A differential base: even joints are on the left, odd ones on the right. */
static core_config sides(uint32_t wheels)
{
    core_config config = good_config();
    config.joint_count = wheels;
    config.pose_variance_floor_m2 = config.heading_variance_floor_rad2 = 0.0;
    for (uint32_t j = 0; j < wheels; j++) {
        config.joint[j] = rolling();
        config.joint[j].row = (wheel_row){1.0, 0.0, j % 2 == 0 ? -0.25 : 0.25};
    }
    return config;
}

static core_config mecanum(void)
{
    core_config config = sides(4);
    for (uint32_t j = 0; j < 4; j++) {
        config.joint[j].row = (wheel_row){1.0, j % 2 == 0 ? -0.8 : 0.9, j < 2 ? -0.4 : 0.35};
    }
    return config;
}

/* --- start */
static void only_a_joint_whose_angle_is_estimated_begins_at_an_angle(void)
{
    for (uint32_t estimated = 0; estimated < 2; estimated++) {
        base b;
        core_config config = ackermann(WHEELBASE_M);
        config.joint[3].position.reference =
            estimated ? REFERENCE_ESTIMATED : config.joint[2].position.reference;
        config.joint[0].position.reference = REFERENCE_ESTIMATED; /* this joint rolls, so it has no
                                                                     angle */
        begin_with(&b, config);
        for (int j = 0; j < JOINTS_MAX; j++) {
            CHECK(j == 3 && estimated ? b.state.angle_rad[j] == 0.0 : isnan(b.state.angle_rad[j]));
            CHECK(isnan(b.state.arc_rad[j]));
        }
    }
}

static void the_variance_sideways_begins_at_its_floor_where_a_base_strafes(void)
{
    core_config bases[] = {sides(2), bicycle(), mecanum(), swerve()};
    for (int i = 0; i < COUNT_OF(bases); i++) {
        base b;
        bases[i].twist_variance_floor_m2_s2 = 1e-3;
        begin_with(&b, bases[i]);
        const double *lateral = b.state.lateral_covariance;
        CHECK(lateral[0] == 0.0 && lateral[1] == (i < 2 ? 0.0 : 1e-3) && lateral[2] == 0.0);
    }
}

/* --- checks of the errors */
static void same_pose_variance(const odometry_state *a, const odometry_state *b)
{
    for (int i = 0; i < 6; i++) {
        CHECK(fabs(a->pose_covariance[i] - b->pose_covariance[i]) <=
              1e-12 * fabs(b->pose_covariance[i]));
    }
}

/* The common travel so far is checked with the equations of all wheels. */
static void before_a_wheel_is_left_out_the_errors_of_all_are_checked(void)
{
    static const int64_t COUNTS[] = {3000, 5000, 3500, 4000};
    base b;
    begin_with(&b, sides(4));
    all_come(&b, STEP_NS, NOTHING_NEW);
    all_come(&b, SPREAD_EVERY_NS, COUNTS);
    all_come(&b, STEP_NS, COUNTS);
    odometry_state expected = b.state;
    CHECK(expected.spread.rim_m[2] > 0.0);
    spread_look(&expected, &b.config, expected.spread.stamp_ns);
    CHECK(expected.pose_covariance[5] > b.state.pose_covariance[5]);
    for (uint32_t j = 0; j < 4; j++) {
        comes(&b, j, STEP_NS, COUNTS[j]);
    }
    const uint32_t stale[JOINTS_MAX] = {[2] = 1};
    step_with_stale(&b, stale);
    CHECK(b.state.used.joints == 0xB && b.state.degraded == 1);
    same_pose_variance(&b.state, &expected);
    for (uint32_t j = 0; j < 4; j++) {
        CHECK(close_to(b.state.spread.rim_m[j], j == 2 ? 0.0 : rim_m(&b, j, COUNTS[j])));
    }
}

static void all_but(base *b, uint32_t out)
{
    for (uint32_t j = 0; j < b->config.joint_count; j++) {
        if (j != out) {
            comes(b, j, STEP_NS, 0);
        }
    }
}

/* The wheel sends a sample before it falls silent, or some before it counts again: its travel is
 * not completely known. */
static void a_wheel_that_is_left_out_has_no_travel_in_a_look(void)
{
    enum { OUT = 3 };
    core_config bases[] = {sides(4), swerve()};
    for (int i = 0; i < COUNT_OF(bases); i++) {
        base b;
        begin_with(&b, bases[i]);
        all_come(&b, STEP_NS, NOTHING_NEW);
        all_come(&b, STEP_NS, NOTHING_NEW);
        comes(&b, OUT, STEP_NS, 4000);
        step_with_stale(&b, RECEIVED);
        CHECK(close_to(b.state.joint[OUT].pending_rad, 4000 * COUNT_RAD));
        const uint32_t stale[JOINTS_MAX] = {[OUT] = 1};
        all_but(&b, OUT);
        step_with_stale(&b, stale);
        CHECK(b.state.spread.rim_m[OUT] == 0.0 && b.state.joint[OUT].pending_rad == 0.0 &&
              b.state.degraded == 1);
        for (int times = 0; times < 2; times++) {
            comes(&b, OUT, STEP_NS, 3000);
            step_with_stale(&b, RECEIVED);
        }
        CHECK(close_to(b.state.joint[OUT].pending_rad, 3000 * COUNT_RAD));
        all_but(&b, OUT);
        step_with_stale(&b, RECEIVED);
        CHECK(b.state.spread.rim_m[OUT] == 0.0 && b.state.joint[OUT].pending_rad == 0.0 &&
              b.state.degraded == 1);
        CHECK(b.state.distance_m == 0.0);
    }
}

static void gyro_turns(base *b, double yaw_rad)
{
    b->state.gyro.stamp_ns = b->state.gyro.bias_stamp_ns = b->feedback[0].stamp_ns + STEP_NS;
    b->state.gyro.yaw_rad = yaw_rad;
}

/* The motion so far has the errors of the wheels, and this arc is the first one by the gyro. Cases:
 * each number of wheels. */
static void before_the_gyro_takes_over_the_motion_of_the_wheels_is_checked(void)
{
    for (uint32_t wheels = 2; wheels <= JOINTS_MAX; wheels += 2) {
        static const int64_t COUNTS[JOINTS_MAX] = {3000, 5000, 3500, 4000, 3100, 4100, 3200, 4200};
        base b;
        begin_with(&b, sides(wheels));
        b.config.gyro =
            (gyro_config){.used = 1, .timeout_s = 0.05, .turn_variance_rad2_per_rad = 1e-3};
        all_come(&b, STEP_NS, NOTHING_NEW);
        all_come(&b, SPREAD_EVERY_NS, COUNTS);
        gyro_turns(&b, 0.0);
        all_come(&b, STEP_NS, COUNTS); /* from here on the gyro has a reference */
        CHECK(b.state.by_gyro == 0 && b.state.gyro.referenced == 1 &&
              b.state.spread.rim_m[1] > 0.0);
        odometry_state expected = b.state;
        spread_look(&expected, &b.config, expected.spread.stamp_ns);
        CHECK(expected.pose_covariance[5] > b.state.pose_covariance[5]);
        gyro_turns(&b, 0.003);
        all_come(&b, STEP_NS, COUNTS);
        CHECK(b.state.by_gyro == 1 && b.state.spread.by_gyro == 1);
        same_pose_variance(&b.state, &expected);
        for (uint32_t j = 0; j < JOINTS_MAX; j++) {
            CHECK(close_to(b.state.spread.rim_m[j], j < wheels ? rim_m(&b, j, COUNTS[j]) : 0.0));
        }
        CHECK(b.state.spread.gyro_rad2 > 0.0);
    }
}

/* --- wheels that start */
static void one_side_alone_beside_a_starting_wheel_is_reported_degraded(void)
{
    for (uint32_t first = 0; first < 2; first++) {
        base b;
        begin_with(&b, sides(2));
        comes(&b, first, STEP_NS, 0);
        step_with_stale(&b, RECEIVED);
        odometry_reset(&b.state, &b.config);
        comes(&b, first, STEP_NS, 1000);
        comes(&b, 1 - first, 2 * STEP_NS, 0);
        step_with_stale(&b, RECEIVED);
        CHECK(b.state.degraded == 1 && b.state.distance_m == 0.0 &&
              b.state.stamp_ns == 2 * STEP_NS);
        comes(&b, 0, STEP_NS, 1000), comes(&b, 1, STEP_NS, 1000);
        step_with_stale(&b, RECEIVED);
        CHECK(b.state.degraded == 0 && close_to(b.state.distance_m, rim_m(&b, 0, 1000)));
    }
}

/* Each wheel has been seen, but before a reset: the beginning of the first arc is unknown. */
static void a_first_arc_without_a_beginning_moves_the_base_and_measures_no_speed(void)
{
    static const int64_t COUNTS[] = {1000, 3000, 1000, 5000};
    core_config bases[] = {sides(2), mecanum(), ackermann(WHEELBASE_M), swerve()};
    for (int i = 0; i < COUNT_OF(bases); i++) {
        base b;
        bases[i].twist_variance_floor_m2_s2 = 1e-3, bases[i].twist_variance_floor_rad2_s2 = 2e-3;
        begin_with(&b, bases[i]);
        for (uint32_t j = 0; j < b.config.joint_count; j++) {
            comes(&b, j, STEP_NS, 0);
            step_with_stale(&b, RECEIVED);
            odometry_reset(&b.state, &b.config);
        }
        CHECK(b.state.stamp_ns == 0);
        all_come(&b, STEP_NS, COUNTS);
        CHECK(b.state.stamp_ns == 2 * STEP_NS && b.state.distance_m > 0.0 && b.state.degraded == 0);
        CHECK(b.state.linear_m_s == 0.0 && b.state.angular_rad_s == 0.0 &&
              b.state.lateral_m_s == 0.0);
        CHECK(b.state.twist_covariance[0] == 1e-3 && b.state.twist_covariance[2] == 2e-3 &&
              b.state.spread.slip_m_s == 0.0);
    }
}

/* --- a steered base */
static double unexplained_m(const base *b, uint32_t joints, const int64_t *counts)
{
    double rims_m[JOINTS_MAX], twist_u[AXES] = {0.0};
    for (uint32_t j = 0; j < b->config.joint_count; j++) {
        rims_m[j] = joints >> j & 1U ? rim_m(b, j, counts[j]) : 0.0;
        for (int a = 0; a < AXES; a++) {
            twist_u[a] += b->state.used.inverse[a][j] * rims_m[j];
        }
    }
    return kinematics_residual(&b->config, b->state.angle_rad, joints, rims_m, twist_u);
}

/* The smoothing time is SLIP_TIME_S of odometry_modules.c: 0.2 s. */
static void rims_of_steered_wheels_that_do_not_fit_together_are_slip(void)
{
    static const int64_t COUNTS[JOINTS_MAX] = {0, 3000, 0, 5000, 0, 2000, 0, 4500};
    base b;
    begin_with(&b, swerve_of_four());
    all_come(&b, STEP_NS, COUNTS);
    CHECK(b.state.spread.slip_m_s == 0.0);
    double slip_m_s = 0.0;
    for (int step = 1; step <= 6; step++) {
        all_come(&b, step * STEP_NS, COUNTS);
        double elapsed_s = 0.01 * step;
        slip_m_s += (unexplained_m(&b, 0xFF, COUNTS) - slip_m_s * elapsed_s) / (0.2 + elapsed_s);
        CHECK(fabs(b.state.spread.slip_m_s - slip_m_s) < 1e-12 && slip_m_s > 1e-4);
    }
}

/* The newest sample of the last arc was from a wheel that is silent now. */
static void an_arc_without_time_is_no_slip(void)
{
    static const int64_t COUNTS[JOINTS_MAX] = {0, 3000, 0, 5000, 0, 2000, 0, 4500};
    base b;
    begin_with(&b, swerve_of_four());
    all_come(&b, STEP_NS, COUNTS);
    b.feedback[3].stamp_ns += STEP_NS;
    all_come(&b, STEP_NS, COUNTS);
    CHECK(b.state.stamp_ns == 3 * STEP_NS && b.state.spread.slip_m_s > 0.0);
    double slip_m_s = b.state.spread.slip_m_s, distance_m = b.state.distance_m;
    const uint32_t stale[JOINTS_MAX] = {[3] = 1};
    for (uint32_t j = 0; j < 8; j++) {
        comes(&b, j, STEP_NS, COUNTS[j]);
    }
    step_with_stale(&b, stale);
    CHECK(b.state.stamp_ns == 3 * STEP_NS && b.state.distance_m > distance_m && b.state.blind == 0);
    CHECK(unexplained_m(&b, 0xF7, COUNTS) > 1e-6 && b.state.spread.slip_m_s == slip_m_s);
}

int main(void)
{
    only_a_joint_whose_angle_is_estimated_begins_at_an_angle();
    the_variance_sideways_begins_at_its_floor_where_a_base_strafes();
    before_a_wheel_is_left_out_the_errors_of_all_are_checked();
    a_wheel_that_is_left_out_has_no_travel_in_a_look();
    before_the_gyro_takes_over_the_motion_of_the_wheels_is_checked();
    one_side_alone_beside_a_starting_wheel_is_reported_degraded();
    a_first_arc_without_a_beginning_moves_the_base_and_measures_no_speed();
    rims_of_steered_wheels_that_do_not_fit_together_are_slip();
    an_arc_without_time_is_no_slip();
    return checks_report("test_odometry_bases");
}
