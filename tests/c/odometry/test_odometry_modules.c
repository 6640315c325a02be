/* SPDX-License-Identifier: Apache-2.0
 * The parts of the odometry that only steered bases have: angles, and arcs between them. */
#include "steered_bases.h"

static void an_angle_is_its_counters_distance_from_zero(void)
{
    core_config config = ackermann(WHEELBASE_M);
    config.joint[2].position.zero_count = 1000, config.joint[2].counter_bits = 12,
    config.joint[2].rad_per_count = -1e-3;
    odometry_state state;
    odometry_init(&state, &config);
    state.joint[2].count = 1200;
    modules_take_angle(&state, &config, 2);
    CHECK(isnan(state.angle_rad[2])); /* no sample has arrived */
    for (uint32_t last = BELIEVED; last <= REFUSED; last++) {
        state.joint[2].last = last, state.joint[2].count = 1200;
        modules_take_angle(&state, &config, 2);
        CHECK(close_to(state.angle_rad[2], -0.2));
        state.joint[2].count = 3000; /* in the shorter direction */
        modules_take_angle(&state, &config, 2);
        CHECK(close_to(state.angle_rad[2], -2.0));
    }
    config.joint[2].position.reference = REFERENCE_ESTIMATED;
    state.joint[2].count = 1100;
    modules_take_angle(&state, &config, 2);
    config.joint[2].position.reference = REFERENCE_HOMED, config.joint[2].position.used = 0;
    modules_take_angle(&state, &config, 2);
    CHECK(close_to(state.angle_rad[2], -2.0));
    config.joint[2].position.used = 1;
    modules_take_angle(&state, &config, 2);
    CHECK(close_to(state.angle_rad[2], -0.1));
}

static void an_arc_has_the_angles_of_its_middle(void)
{
    core_config config = bicycle();
    odometry_state state;
    odometry_init(&state, &config);
    double angle_rad[JOINTS_MAX] = {0.0};
    static const double COUNTS[] = {20000.0, 30000.0, 34000.0}, MIDDLE_RAD[] = {0.2, 0.25, 0.32};
    for (int i = 0; i < COUNT_OF(COUNTS); i++) {
        twist_inverse expected;
        state.joint[0].last = state.joint[1].last = BELIEVED;
        state.joint[1].count = (uint64_t)COUNTS[i];
        modules_look(&state, &config, 3);
        angle_rad[1] = MIDDLE_RAD[i];
        kinematics_modules(&config, angle_rad, 3, &expected);
        CHECK(close_to(state.angle_rad[1], COUNTS[i] * 1e-5));
        modules_end_arc(&state);
        CHECK(close_to(state.arc_rad[1], COUNTS[i] * 1e-5));
        for (int a = 0; a < AXES; a++) {
            CHECK(close_to(state.used.inverse[a][0], expected.inverse[a][0]));
        }
    }
    modules_look(&state, &config, 2); /* the rolling joint is silent */
    CHECK(state.used.determined == 0);
}

/* Swerve base, also with a silent joint. An arc begins where the last one ended, not at the last
 * look. */
static void an_arc_begins_where_the_last_one_ended_also_while_a_joint_is_silent(void)
{
    core_config config = swerve_of_four();
    const joint_setpoint setpoint[JOINTS_MAX] = {0};
    for (int silent = 0; silent < 2; silent++) {
        const uint32_t stale[JOINTS_MAX] = {[7] = (uint32_t)silent};
        joint_feedback feedback[JOINTS_MAX] = {0};
        odometry_state state;
        odometry_init(&state, &config);
        for (int i = 0; i < 3; i++) {
            double before_x_m = state.x_m, before_y_m = state.y_m;
            for (int half = 0; half < 2; half++) { /* the lines do not answer at the same time */
                for (int j = 4 * half; j < 4 * half + 4; j++) {
                    feedback[j].stamp_ns = (i + 1) * 10 * MS_NS;
                    feedback[j].count = j % 2 == 0 ? (uint64_t)(i * 2000) : (uint64_t)(i * 20000);
                    feedback[j].velocity_rad_s = j % 2 == 0 ? 2.0 : 20.0;
                }
                odometry_step(&state, &config, feedback, stale, setpoint);
            }
            double middle_rad = 0.02 * (i - 0.5), moved_m = 0.2 * RADIUS_M;
            CHECK(i == 0 || close_to(state.x_m - before_x_m, moved_m * cos(middle_rad)));
            CHECK(i == 0 || close_to(state.y_m - before_y_m, moved_m * sin(middle_rad)));
        }
        CHECK(state.blind == 0 && state.degraded == (uint32_t)silent);
    }
}

static void the_slip_of_an_arc_is_smoothed(void)
{
    core_config config = ackermann(WHEELBASE_M);
    odometry_state state;
    odometry_init(&state, &config);
    for (int j = 2; j < 4; j++) {
        state.angle_rad[j] = 0.0;
    }
    const double rim_m[JOINTS_MAX] = {0.03, 0.01}, twist_u[AXES] = {0.02, 0.0};
    double left_m = kinematics_residual(&config, state.angle_rad, 15, rim_m, twist_u),
           slip_m_s = 0.05;
    CHECK(left_m > 1e-3);
    state.spread.slip_m_s = slip_m_s;
    modules_slip(&state, &config, 15, rim_m, twist_u, 0.1);
    CHECK(close_to(state.spread.slip_m_s, slip_m_s + (left_m - slip_m_s * 0.1) / 0.3));
}

int main(void)
{
    an_angle_is_its_counters_distance_from_zero();
    an_arc_has_the_angles_of_its_middle();
    an_arc_begins_where_the_last_one_ended_also_while_a_joint_is_silent();
    the_slip_of_an_arc_is_smoothed();
    return checks_report("test_odometry_modules");
}
