/* SPDX-License-Identifier: Apache-2.0
 * test_steer: which curves a steered base reaches, in which direction its wheels point, and how
 * fast they roll. */
#include "steer.h"
#include "steered_bases.h"

/* Changes the range of joint 1, which steers. */
static core_config with_range(core_config base, double least_rad, double most_rad)
{
    position_config *range = &base.joint[1].position;
    range->position_min_rad = least_rad, range->position_max_rad = most_rad;
    return base;
}

static steer_state begun(const core_config *base)
{
    steer_state steer;
    steer_init(&steer, base);
    return steer;
}

/* --- reach */
static void a_wheel_in_front_or_behind_reaches_the_curves_of_its_circle(void)
{
    static const double WHEELBASES_M[] = {0.05, 0.1, 0.3, 1.0, -0.05, -0.1, -0.3, -1.0};
    for (int i = 0; i < COUNT_OF(WHEELBASES_M); i++) {
        double x_m = WHEELBASES_M[i];
        core_config base = with_range(bicycle(), -0.3, 0.6);
        base.module[0].x_m = x_m;
        steer_state steer = begun(&base);
        CHECK(close_to(steer.curvature_min_per_m, x_m > 0.0 ? tan(-0.3) / x_m : tan(0.6) / x_m));
        CHECK(close_to(steer.curvature_max_per_m, x_m > 0.0 ? tan(0.6) / x_m : tan(-0.3) / x_m));
        CHECK(steer.turns_on_spot == 0 && isinf(steer.misaligned_rad) && !kinematics_spins(&base));
        base = with_range(base, -0.1, 1.0);
        steer = begun(&base);
        CHECK(close_to(steer.curvature_min_per_m, x_m > 0.0 ? tan(-0.1) / x_m : tan(1.0) / x_m));
        CHECK(close_to(steer.curvature_max_per_m, x_m > 0.0 ? tan(1.0) / x_m : tan(-0.1) / x_m));
        /* a wheel turned across cannot be driven on the spot: the limit is 80 degrees */
        base = with_range(base, -1.6, 1.6);
        steer = begun(&base);
        CHECK(close_to(steer.curvature_max_per_m, 5.67 / fabs(x_m)) &&
              close_to(steer.curvature_min_per_m, -5.67 / fabs(x_m)));
        CHECK(steer.turns_on_spot == 0 && !kinematics_spins(&base));
    }
}

static void a_wheel_beside_the_middle_reaches_other_curves_to_each_side(void)
{
    core_config base = with_range(bicycle(), -0.6, 0.6);
    base.module[0].y_m = 0.2;
    steer_state steer = begun(&base);
    CHECK(close_to(steer.curvature_max_per_m, sin(0.6) / (0.3 * cos(0.6) + 0.2 * sin(0.6))));
    CHECK(close_to(steer.curvature_min_per_m, -sin(0.6) / (0.3 * cos(0.6) - 0.2 * sin(0.6))));
    base.module[0].angle_rad = 0.1; /* an angle of 0 of its joint is not straight ahead */
    steer = begun(&base);
    CHECK(close_to(steer.curvature_max_per_m, sin(0.7) / (0.3 * cos(0.7) + 0.2 * sin(0.7))));
    CHECK(close_to(steer.curvature_min_per_m, -sin(0.5) / (0.3 * cos(0.5) - 0.2 * sin(0.5))));
    base.module[0].angle_rad = 0.0;
    base = with_range(base, -0.6, 0.0); /* it steers to the right only */
    steer = begun(&base);
    CHECK(steer.curvature_max_per_m == 0.0 && steer.curvature_min_per_m < -1.0);
}

/* A wheel that can turn beyond its direction on the spot reaches every curve to that side. */
static void a_wheel_far_beside_the_middle_reaches_the_spot_to_one_side(void)
{
    static const struct {
        double x_m, y_m, range_rad;
    } CASES[] = {{0.3, 0.5, 0.6}, {0.05, 1.0, 0.06}};
    for (int i = 0; i < COUNT_OF(CASES) * 2; i++) {
        double x_m = CASES[i / 2].x_m, y_m = CASES[i / 2].y_m, range_rad = CASES[i / 2].range_rad;
        double other_per_m = sin(range_rad) / (x_m * cos(range_rad) + y_m * sin(range_rad));
        core_config base = with_range(bicycle(), -range_rad, range_rad);
        base.module[0].x_m = x_m, base.module[0].y_m = i % 2 == 0 ? y_m : -y_m;
        steer_state steer = begun(&base);
        CHECK(close_to(steer.curvature_max_per_m, i % 2 == 0 ? other_per_m : 5.67 / x_m));
        CHECK(close_to(steer.curvature_min_per_m, i % 2 == 0 ? -5.67 / x_m : -other_per_m));
    }
}

static void straight_ahead_is_in_reach_also_where_its_wheel_cannot_point_there(void)
{
    core_config base = with_range(bicycle(), -0.3, 0.3);
    base.module[0].angle_rad = 0.5;
    steer_state steer = begun(&base);
    CHECK(steer.curvature_min_per_m == 0.0 && close_to(steer.curvature_max_per_m, tan(0.8) / 0.3));
    base.module[0].angle_rad = -0.5;
    steer = begun(&base);
    CHECK(steer.curvature_max_per_m == 0.0 && close_to(steer.curvature_min_per_m, -tan(0.8) / 0.3));
}

static void the_wheel_with_the_least_reach_counts(void)
{
    for (int tight = 2; tight <= 3; tight++) {
        core_config base = ackermann(WHEELBASE_M);
        base.joint[tight].position.position_min_rad = -0.2,
        base.joint[tight].position.position_max_rad = 0.25;
        double y_m = base.module[tight - 2].y_m;
        steer_state steer = begun(&base);
        CHECK(close_to(steer.curvature_max_per_m, sin(0.25) / (0.3 * cos(0.25) + y_m * sin(0.25))));
        CHECK(close_to(steer.curvature_min_per_m, -sin(0.2) / (0.3 * cos(0.2) - y_m * sin(0.2))));
    }
}

static void a_wheel_that_turns_across_turns_the_base_on_the_spot_where_something_rolls_it(void)
{
    static const double WHEELBASES_M[] = {0.1, 0.3, 1.0, -0.3};
    const double quarter_rad = 1.5707963267948966;
    static const struct {
        double short_least_rad, short_most_rad;
        uint32_t turns;
    } CASES[] = {{-0.03, -0.03, 1},   {0.57, -0.03, 0}, {-0.03, 0.57, 0}, {0.0, 0.0, 1},
                 {0.5e-6, 0.5e-6, 1}, {2e-6, 2e-6, 0},  {2e-6, 0.0, 0},   {0.0, 2e-6, 0}};
    for (int i = 0; i < COUNT_OF(WHEELBASES_M) * COUNT_OF(CASES); i++) {
        double least_rad = -quarter_rad + CASES[i % COUNT_OF(CASES)].short_least_rad;
        double most_rad = quarter_rad - CASES[i % COUNT_OF(CASES)].short_most_rad;
        uint32_t turns = CASES[i % COUNT_OF(CASES)].turns;
        core_config base = with_range(tricycle(), least_rad, most_rad);
        base.module[0].x_m = WHEELBASES_M[i / COUNT_OF(CASES)];
        base.module[1].y_m = base.module[2].y_m = 0.0;
        steer_state steer = begun(&base);
        CHECK(steer.turns_on_spot == turns && kinematics_spins(&base) == (turns == 1));
        CHECK(!turns || (isinf(steer.curvature_min_per_m) && isinf(steer.curvature_max_per_m)));
        CHECK(steer.curvature_min_per_m < -1e-3 && steer.curvature_max_per_m > 1e-3);
    }
    core_config base = tricycle();
    base.module[0].x_m = 0.0; /* in the middle it turns nothing */
    CHECK(begun(&base).turns_on_spot == 0);
    base = tricycle(); /* with swapped joints */
    base.joint[0] = tricycle().joint[1], base.joint[1] = rolling();
    base.module[0].steering = 1, base.module[0].traction = 2;
    CHECK(begun(&base).turns_on_spot == 1);
}

static void a_fixed_wheel_that_is_driven_beside_the_middle_turns_it_too(void)
{
    static const double PLACES_M[] = {0.1, -0.1, 0.5, 1.0};
    for (int i = 0; i < COUNT_OF(PLACES_M); i++) {
        core_config base = with_range(bicycle(), -1.6, 1.6);
        CHECK(begun(&base).turns_on_spot == 0);
        base.module[1].y_m = PLACES_M[i];
        CHECK(begun(&base).turns_on_spot == 1);
        base.module[1].traction = 0;
        CHECK(begun(&base).turns_on_spot == 0);
    }
}

static void other_bases_turn_on_the_spot(void)
{
    core_config base = swerve();
    steer_state steer = begun(&base);
    CHECK(steer.turns_on_spot == 1 && isinf(steer.curvature_max_per_m) &&
          isinf(steer.curvature_min_per_m));
    CHECK(steer.curvature_max_per_m > 0.0 && steer.curvature_min_per_m < 0.0 &&
          kinematics_spins(&base));
    base = good_config();
    CHECK(kinematics_spins(&base));
    base.module_count = 1; /* a single fixed wheel */
    base.module[0] = (wheel_module){.traction = 1};
    CHECK(!kinematics_spins(&base));
}

/* The pace is so high that the profile lags by 0.04 rad, and at most 0.8 of the joint's speed. */
static void the_slowest_steering_joint_sets_the_pace(void)
{
    for (int slow = 0; slow <= 2; slow += 2) {
        core_config base = swerve();
        position_config *own = &base.joint[slow].position;
        CHECK(close_to(begun(&base).pace_rad_s, sqrt(2.0 * 40.0 * 0.04)));
        own->acceleration_rad_s2 = 10.0;
        CHECK(close_to(begun(&base).pace_rad_s, sqrt(2.0 * 10.0 * 0.04)));
        own->acceleration_rad_s2 = 40.0, own->velocity_rad_s = 1.5;
        CHECK(close_to(begun(&base).pace_rad_s, 0.8 * 1.5));
    }
}

/* --- goals within reach */
static void a_goal_is_brought_to_what_the_steering_and_the_limits_allow(void)
{
    static const struct {
        double linear_m_s, angular_rad_s;
        uint32_t spins;
        double goal_m_s, goal_rad_s;
        uint32_t reasons;
    } CASES[] = {
        {0.5, 0.4, 0, 0.5, 0.4, 0},
        {0.0, 0.0, 0, 0.0, 0.0, 0},
        {0.0, 1.0, 0, 0.0, 0.0, REASON_TURN_IMPOSSIBLE},
        {0.0, 0.1, 0, 0.0, 0.0, REASON_TURN_IMPOSSIBLE},
        {0.0, -0.5, 0, 0.0, 0.0, REASON_TURN_IMPOSSIBLE},
        {0.0, 1.0, 1, 0.0, 1.0, 0},
        {0.0, -5.0, 1, 0.0, -2.0, REASON_ANGULAR_VELOCITY},
        /* curvatures are limited to -1.5 and 1 */
        {0.5, 0.6, 0, 0.5, 0.5, REASON_CURVATURE},
        {0.5, -0.9, 0, 0.5, -0.75, REASON_CURVATURE},
        {-0.5, 0.9, 0, -0.5, 0.75, REASON_CURVATURE},
        {-0.5, -0.6, 0, -0.5, -0.5, REASON_CURVATURE},
        {0.1, 0.2, 0, 0.1, 0.1, REASON_CURVATURE},
        {1.0, 1.2, 0, 1.0, 1.0, REASON_CURVATURE},
        {1.0, 0.3, 0, 1.0, 0.3, 0},
        {0.1, 0.03, 0, 0.1, 0.03, 0},
        /* limits are 1 m/s and 2 rad/s: both are reduced by the same factor */
        {2.0, 1.0, 0, 1.0, 0.5, REASON_LINEAR_VELOCITY},
        {-4.0, 1.0, 0, -1.0, 0.25, REASON_LINEAR_VELOCITY},
        {2.0, 9.0, 0, 1.0, 1.0, REASON_LINEAR_VELOCITY | REASON_CURVATURE},
        {0.5, 0.5, 1, 0.5, 0.5, 0},
    };
    base_limits limits = good_config().limits;
    for (int i = 0; i < COUNT_OF(CASES); i++) {
        steer_state steer = {.curvature_min_per_m = -1.5,
                             .curvature_max_per_m = 1.0,
                             .turns_on_spot = CASES[i].spins,
                             .pace_rad_s = 1.0};
        double wanted[AXES] = {CASES[i].linear_m_s, CASES[i].angular_rad_s},
               goal[AXES] = {7.0, 7.0};
        CHECK(steer_within_reach(&steer, &limits, wanted, goal) == CASES[i].reasons);
        CHECK(close_to(goal[0], CASES[i].goal_m_s) && close_to(goal[1], CASES[i].goal_rad_s));
    }
    /* the limit of the turn is tighter: 0.5 m/s in a circle of 0.1 m */
    steer_state steer = {.curvature_min_per_m = -10.0, .curvature_max_per_m = 10.0};
    double goal[AXES];
    CHECK(steer_within_reach(&steer, &limits, (const double[AXES]){0.5, 5.0}, goal) ==
          REASON_ANGULAR_VELOCITY);
    CHECK(close_to(goal[0], 0.2) && goal[1] == 2.0);
    CHECK(steer_within_reach(&steer, &limits, (const double[AXES]){-2.0, 10.0}, goal) ==
          (REASON_LINEAR_VELOCITY | REASON_ANGULAR_VELOCITY));
    CHECK(close_to(goal[0], -0.4) && goal[1] == 2.0);
    CHECK(steer_within_reach(&steer, &limits, (const double[AXES]){1.0, 2.0}, goal) == 0 &&
          goal[0] == 1.0 && goal[1] == 2.0);
    CHECK(steer_within_reach(&steer, &limits, (const double[AXES]){4.0, 8.0}, goal) ==
          REASON_LINEAR_VELOCITY);
}

/* --- directions */
static void a_wheel_points_along_its_motion_or_against_it_whichever_is_nearer(void)
{
    static const struct {
        double rolls_to_rad, zero_rad, least_rad, most_rad, near_rad, aim_rad;
        bool reached;
    } CASES[] = {
        {0.5, 0.0, -3.2, 3.2, 0.0, 0.5, true},
        {0.5, 0.3, -3.2, 3.2, 0.0, 0.2, true},
        {2.0, 0.0, -3.2, 3.2, 0.0, 2.0 - M_PI, true},
        {2.0, 0.0, -3.2, 3.2, 2.0, 2.0, true},
        {0.5, 0.0, -3.2, 3.2, 3.0, 0.5, true}, /* the nearer one, half a turn further, is out of
                                                  range */
        {0.5, 0.0, -3.2, 3.2, -2.0, 0.5 - M_PI, true},
        {0.5, 0.0, -3.2, 3.2, 20.0, 0.5, true},
        {0.5, 0.0, -3.2, 3.2, -20.0, 0.5 - M_PI, true},
        {-1.0, 0.0, -0.2, 4.0, 0.0, M_PI - 1.0, true},
        {1.0, 0.0, -4.0, 0.2, 0.0, 1.0 - M_PI, true},
        {0.6 + 0.5e-6, 0.0, -0.6, 0.6, 0.0, 0.6, true},
        {-0.6 - 0.5e-6, 0.0, -0.6, 0.6, 0.0, -0.6, true},
        {0.6 + 5e-6, 0.0, -0.6, 0.6, 0.0, 0.6, false},
        {-0.6 - 5e-6, 0.0, -0.6, 0.6, 0.0, -0.6, false},
        {0.9, 0.0, -0.6, 0.6, 0.0, 0.6, false},
        {-0.9, 0.0, -0.6, 0.6, 0.0, -0.6, false},
        {1.5, 0.0, -0.6, 0.6, 0.0, 0.6, false},
        {1.6, 0.0, -0.6, 0.6, 0.0, -0.6, false}, /* for driving backward this end is nearer */
        {3.0, 0.0, -0.6, 0.6, 0.0, 3.0 - M_PI, true},
        {0.5, 0.0, -0.2, 0.3, 0.0, 0.3, false},
        {-0.5, 0.0, -0.2, 0.3, 0.0, -0.2, false},
    };
    for (int i = 0; i < COUNT_OF(CASES); i++) {
        core_config base = with_range(bicycle(), CASES[i].least_rad, CASES[i].most_rad);
        base.module[0].angle_rad = CASES[i].zero_rad;
        base.joint[1].position.velocity_rad_s = 1e3,
        base.joint[1].position.acceleration_rad_s2 = 1e6;
        steer_state steer = begun(&base);
        steer.profile[1].position_rad = CASES[i].near_rad;
        double motion[AXES] = {cos(CASES[i].rolls_to_rad),
                               sin(CASES[i].rolls_to_rad) / WHEELBASE_M},
               goal[AXES];
        double angle_rad[JOINTS_MAX] = {0.0, -30.0}, rate_max_s;
        memcpy(goal, motion, sizeof goal);
        CHECK(steer_goal(&steer, &base, (const limit_state[AXES]){{0}}, angle_rad, goal,
                         &rate_max_s) == REASON_STEERING);
        CHECK(CASES[i].reached ? close_to(steer.misaligned_rad - 30.0, CASES[i].aim_rad)
                               : isinf(steer.misaligned_rad));
        for (int step = 0; step < 1000; step++) {
            steer_joints(&steer, &base, motion, goal, 1e-3);
        }
        /* wheels with a longer move choose another aim during it */
        if (fabs(CASES[i].near_rad - CASES[i].aim_rad) < M_PI) {
            CHECK(close_to(steer.profile[1].position_rad, CASES[i].aim_rad));
        }
    }
}

static void a_wheel_rolls_by_the_speed_of_the_floor_along_it(void)
{
    core_config base = swerve();
    base.joint[3].wheel_radius_m = 0.1;
    double twist[AXES] = {0.4, 0.7, -0.2}, angle_rad[JOINTS_MAX] = {0.5, 9.0, 7.0, 9.0},
           wheel_rad_s[JOINTS_MAX];
    for (int j = 0; j < JOINTS_MAX; j++) {
        wheel_rad_s[j] = 5.0;
    }
    steer_wheels(&base, twist, angle_rad, wheel_rad_s);
    CHECK(wheel_rad_s[0] == 0.0 && wheel_rad_s[2] == 0.0 && wheel_rad_s[4] == 5.0);
    CHECK(close_to(wheel_rad_s[1],
                   ((0.4 - 0.1 * 0.7) * cos(0.5) + (-0.2 + 0.3 * 0.7) * sin(0.5)) / 0.05));
    CHECK(close_to(wheel_rad_s[3],
                   ((0.4 + 0.2 * 0.7) * cos(7.3) + (-0.2 - 0.2 * 0.7) * sin(7.3)) / 0.1));
    angle_rad[0] = -3.0;
    steer_wheels(&base, (const double[AXES]){0.0}, angle_rad, wheel_rad_s);
    CHECK(wheel_rad_s[1] == 0.0 && !signbit(wheel_rad_s[1]));
    base = tricycle(); /* fixed wheels that roll freely have no joints */
    steer_wheels(&base, twist, angle_rad, wheel_rad_s);
    CHECK(wheel_rad_s[1] == 0.0);
}

static void pointing_as_they_should_wheels_roll_as_fast_as_the_floor(void)
{
    core_config base = swerve();
    steer_state steer = begun(&base);
    double twist[AXES] = {-0.4, 0.7, 0.2}, wheel_rad_s[JOINTS_MAX];
    double first_m_s = hypot(-0.4 - 0.1 * 0.7, 0.2 + 0.3 * 0.7),
           second_m_s = hypot(-0.4 + 0.2 * 0.7, 0.2 - 0.2 * 0.7);
    steer_speeds(&steer, &base, twist, wheel_rad_s);
    CHECK(close_to(wheel_rad_s[1], -first_m_s / 0.05) &&
          close_to(wheel_rad_s[3], -second_m_s / 0.05));
    steer.profile[0].position_rad = 2.4; /* now the nearer direction is forward */
    steer_speeds(&steer, &base, twist, wheel_rad_s);
    CHECK(close_to(wheel_rad_s[1], first_m_s / 0.05) &&
          close_to(wheel_rad_s[3], -second_m_s / 0.05));
    steer.profile[0].position_rad = 0.0, steer.profile[2].position_rad = 2.6;
    steer_speeds(&steer, &base, twist, wheel_rad_s);
    CHECK(close_to(wheel_rad_s[1], -first_m_s / 0.05) &&
          close_to(wheel_rad_s[3], second_m_s / 0.05));
    base = bicycle();
    steer = begun(&base);
    steer_speeds(&steer, &base, (const double[AXES]){0.4, 0.3}, wheel_rad_s);
    CHECK(close_to(wheel_rad_s[0], 8.0) && wheel_rad_s[1] == 0.0);
    base = tricycle();
    steer = begun(&base);
    steer_speeds(&steer, &base, (const double[AXES]){0.4, 1.0}, wheel_rad_s);
    CHECK(close_to(wheel_rad_s[0], hypot(0.4, 0.3) / 0.05));
}

int main(void)
{
    a_wheel_in_front_or_behind_reaches_the_curves_of_its_circle();
    a_wheel_beside_the_middle_reaches_other_curves_to_each_side();
    a_wheel_far_beside_the_middle_reaches_the_spot_to_one_side();
    straight_ahead_is_in_reach_also_where_its_wheel_cannot_point_there();
    the_wheel_with_the_least_reach_counts();
    a_wheel_that_turns_across_turns_the_base_on_the_spot_where_something_rolls_it();
    a_fixed_wheel_that_is_driven_beside_the_middle_turns_it_too();
    other_bases_turn_on_the_spot();
    the_slowest_steering_joint_sets_the_pace();
    a_goal_is_brought_to_what_the_steering_and_the_limits_allow();
    a_wheel_points_along_its_motion_or_against_it_whichever_is_nearer();
    a_wheel_rolls_by_the_speed_of_the_floor_along_it();
    pointing_as_they_should_wheels_roll_as_fast_as_the_floor();
    return checks_report("test_steer");
}
