/* SPDX-License-Identifier: Apache-2.0
 * test_goal: the twist to which a base ramps: the command within the limits of the base and its
 * wheels, and the reasons. */
#include "steered_bases.h"

static rig r;

static const double LINEAR_MAX_M_S = 0.5, ANGULAR_MAX_RAD_S = 0.8, LATERAL_MAX_M_S = 0.25;

static void limit(core_config *config)
{
    config->limits.linear.velocity_u_s = LINEAR_MAX_M_S;
    config->limits.angular.velocity_u_s = ANGULAR_MAX_RAD_S;
    config->limits.lateral.velocity_u_s = LATERAL_MAX_M_S;
}

/* A base with rollers at 45 degrees, whose wheels are faster than all limits. */
static core_config strafing(void)
{
    core_config config = good_config();
    limit(&config);
    for (int j = 0; j < 4; j++) {
        config.joint[j].row.y = j == 0 || j == 3 ? -1.0 : 1.0;
        config.joint[j].velocity_min_rad_s = -90.0, config.joint[j].velocity_max_rad_s = 90.0;
    }
    return config;
}

/* Returns the goal of a base that was armed in the tick before. */
static const core_goal *goal_of(const core_config *config, double linear_m_s, double angular_rad_s,
                                double lateral_m_s)
{
    ready(&r, config);
    r.input.control.armed = 1;
    CHECK(tick(&r)->armed == 1);
    r.input.command.linear_m_s = linear_m_s;
    r.input.command.angular_rad_s = angular_rad_s;
    r.input.command.lateral_m_s = lateral_m_s;
    tick(&r);
    CHECK(r.shown.armed == 1 && r.state.goal.known != 0 &&
          r.shown.saturation == r.state.goal.saturation);
    CHECK((r.shown.reasons & r.state.goal.reasons) == r.state.goal.reasons);
    return &r.state.goal;
}

typedef struct {
    double command_u_s[AXES], goal_u_s[AXES];
    uint32_t reasons;
} expectation;

static void expect(const core_config *config, const expectation *of)
{
    const core_goal *goal =
        goal_of(config, of->command_u_s[0], of->command_u_s[1], of->command_u_s[2]);
    for (int i = 0; i < AXES; i++) {
        CHECK(close_to(goal->goal_u_s[i], of->goal_u_s[i]));
    }
    CHECK(goal->reasons == of->reasons && goal->saturation == 1.0);
}

static void
the_direction_stays_where_a_base_that_strafes_is_limited_and_its_turn_is_limited_alone(void)
{
    static const uint32_t LINEAR = REASON_LINEAR_VELOCITY, ANGULAR = REASON_ANGULAR_VELOCITY,
                          LATERAL = REASON_LATERAL_VELOCITY;
    const expectation of[] = {
        {{0.4, 0.5, 0.2}, {0.4, 0.5, 0.2}, 0},
        {{-0.4, -0.5, -0.2}, {-0.4, -0.5, -0.2}, 0},
        {{0.5, 0.8, 0.25}, {0.5, 0.8, 0.25}, 0},
        {{1.0, 0.0, 0.0}, {0.5, 0.0, 0.0}, LINEAR},
        {{-1.0, 0.0, 0.0}, {-0.5, 0.0, 0.0}, LINEAR},
        {{0.0, 1.0, 0.0}, {0.0, 0.8, 0.0}, ANGULAR},
        {{0.0, -1.0, 0.0}, {0.0, -0.8, 0.0}, ANGULAR},
        {{0.0, 0.0, 1.0}, {0.0, 0.0, 0.25}, LATERAL},
        {{0.0, 0.0, -1.0}, {0.0, 0.0, -0.25}, LATERAL},
        {{1.0, 0.0, 0.25}, {0.5, 0.0, 0.125}, LINEAR},
        {{1.0, 0.0, 0.1}, {0.5, 0.0, 0.05}, LINEAR},
        {{-1.0, 0.0, 0.1}, {-0.5, 0.0, 0.05}, LINEAR},
        {{0.1, 0.0, 1.0}, {0.025, 0.0, 0.25}, LATERAL},
        {{0.4, 0.0, -1.0}, {0.1, 0.0, -0.25}, LATERAL},
        {{2.0, 0.0, 1.0}, {0.5, 0.0, 0.25}, LINEAR | LATERAL}, /* both are reduced by the same
                                                                  factor */
        {{1.0, 0.0, 2.0}, {0.125, 0.0, 0.25}, LINEAR | LATERAL},
        {{4.0, 0.0, 0.5}, {0.5, 0.0, 0.0625}, LINEAR | LATERAL},
        {{4.0, -2.0, 0.5}, {0.5, -0.8, 0.0625}, LINEAR | ANGULAR | LATERAL},
        {{0.4, 2.0, 0.2}, {0.4, 0.8, 0.2}, ANGULAR},
    };
    core_config config = strafing(), steered = swerve_of_four();
    limit(&steered);
    for (int i = 0; i < COUNT_OF(of); i++) {
        expect(&config, &of[i]);
        expect(&steered, &of[i]);
    }
    config.limits.lateral.velocity_u_s = 0.05;
    expect(&config, &(expectation){{0.4, 0.0, 0.1}, {0.2, 0.0, 0.05}, LATERAL});
    expect(&config, &(expectation){{-0.4, 0.0, -0.1}, {-0.2, 0.0, -0.05}, LATERAL});
}

static void a_base_that_does_not_strafe_drives_on_without_the_lateral_speed(void)
{
    static const double LATERAL_M_S[] = {0.1, 1.0, -0.1, 1e-9, 5.0};
    core_config config = good_config(), steered = bicycle();
    limit(&config);
    limit(&steered);
    for (int i = 0; i < COUNT_OF(LATERAL_M_S); i++) {
        expectation of = {{0.4, 0.3, LATERAL_M_S[i]}, {0.4, 0.3, 0.0}, REASON_LATERAL_IMPOSSIBLE};
        expect(&config, &of);
        expect(&steered, &of);
    }
    expect(&config, &(expectation){{0.4, 0.3, 0.0}, {0.4, 0.3, 0.0}, 0});
    expect(&config, &(expectation){{1.0, 1.0, 1.0},
                                   {0.5, 0.8, 0.0},
                                   REASON_LATERAL_IMPOSSIBLE | REASON_LINEAR_VELOCITY |
                                       REASON_ANGULAR_VELOCITY});
    double most_per_m = tan(0.6) / WHEELBASE_M;
    expect(&steered, &(expectation){{0.2, 4.0, 0.1},
                                    {0.2, 0.2 * most_per_m, 0.0},
                                    REASON_LATERAL_IMPOSSIBLE | REASON_CURVATURE});
}

/* A warm joint halves each limit. */
static void arm_warm(core_config *config)
{
    config->joint[2].derating.range[DERATED_BY_TEMPERATURE] = (derating_range){60.0, 80.0};
    start(&r, config);
    r.input.feedback[2].temperature_c = 70.0;
    ticks(&r, 2);
    r.input.control.armed = 1;
    CHECK(tick(&r)->armed == 1 && close_to(r.shown.derating.factor, 0.5));
}

static void a_derated_base_keeps_its_direction_as_far_as_each_axis_allows(void)
{
    const expectation of[] = {
        {{0.2, 0.3, 0.1}, {0.2, 0.3, 0.1}, 0},
        {{0.25, 0.4, 0.125}, {0.25, 0.4, 0.125}, 0},
        {{0.4, 0.0, 0.0}, {0.25, 0.0, 0.0}, REASON_DERATED},
        {{0.5, 0.5, 0.1}, {0.25, 0.25, 0.05}, REASON_DERATED},
        {{0.3, -0.8, 0.2}, {0.15, -0.4, 0.1}, REASON_DERATED},
        {{0.4, 0.5, -0.25}, {0.2, 0.25, -0.125}, REASON_DERATED},
        {{1.0, 0.1, 0.0}, {0.25, 0.05, 0.0}, REASON_DERATED | REASON_LINEAR_VELOCITY},
    };
    core_config config = strafing();
    for (int i = 0; i < COUNT_OF(of); i++) {
        const double *command_u_s = of[i].command_u_s;
        arm_warm(&config);
        r.input.command.linear_m_s = command_u_s[0];
        r.input.command.angular_rad_s = command_u_s[1];
        r.input.command.lateral_m_s = command_u_s[2];
        tick(&r);
        for (int axis = 0; axis < AXES; axis++) {
            CHECK(close_to(r.state.goal.goal_u_s[axis], of[i].goal_u_s[axis]));
        }
        CHECK(r.state.goal.reasons == of[i].reasons);
    }
}

/* One wheel has half of the speed that it would need, so the whole twist is halved. */
static void the_wheel_slowest_for_its_share_is_named_and_the_first_among_equals(void)
{
    for (uint32_t slow = 0; slow < 4; slow++) {
        for (uint32_t other = slow; other < 4; other++) {
            core_config config = good_config();
            limit(&config);
            config.joint[slow].velocity_max_rad_s = config.joint[other].velocity_max_rad_s = 2.0;
            const core_goal *goal = goal_of(&config, 0.4, 0.0, 0.0);
            CHECK(close_to(goal->saturation, 0.5) && close_to(goal->goal_u_s[AXIS_LINEAR], 0.2));
            CHECK(goal->reasons == REASON_WHEEL_SATURATED &&
                  r.shown.reason.saturated_joint == slow);
        }
    }
    core_config config = good_config();
    /* wheels on the outer side of the curve */
    config.joint[1].velocity_max_rad_s = config.joint[3].velocity_max_rad_s = 2.5;
    const core_goal *goal = goal_of(&config, 0.4, 0.4, 0.0);
    CHECK(close_to(goal->saturation, 0.5) && close_to(goal->goal_u_s[0], 0.2) &&
          close_to(goal->goal_u_s[1], 0.2));
    CHECK(r.shown.reason.saturated_joint == 1);
}

static void wheels_that_are_steered_are_saturated_alike(void)
{
    core_config bases[] = {bicycle(), swerve_of_four()};
    for (uint32_t i = 0; i < 2; i++) {
        uint32_t slow = i == 0 ? 0 : 5;
        bases[i].joint[slow].velocity_max_rad_s = 4.0;
        const core_goal *goal = goal_of(&bases[i], 0.4, 0.0, 0.0);
        CHECK(close_to(goal->saturation, 0.5) && close_to(goal->goal_u_s[AXIS_LINEAR], 0.2));
        CHECK(goal->reasons == REASON_WHEEL_SATURATED && r.shown.reason.saturated_joint == slow);
        goal = goal_of(&bases[i], 0.2, 0.0, 0.0);
        CHECK(goal->saturation == 1.0 && goal->reasons == 0);
    }
}

static void every_reason_of_a_goal_is_reported(void)
{
    core_config config = good_config();
    limit(&config);
    config.joint[1].velocity_max_rad_s = 2.0;
    arm_warm(&config);
    r.input.command.linear_m_s = r.input.command.angular_rad_s = r.input.command.lateral_m_s = 5.0;
    tick(&r);
    CHECK(r.state.goal.reasons ==
          (REASON_LATERAL_IMPOSSIBLE | REASON_LINEAR_VELOCITY | REASON_ANGULAR_VELOCITY |
           REASON_DERATED | REASON_WHEEL_SATURATED));
    r.input.command.angular_rad_s = r.input.command.lateral_m_s = 0.0,
    r.input.command.linear_m_s = 0.1;
    tick(&r);
    CHECK(r.state.goal.reasons == 0 && r.state.goal.saturation == 1.0);
}

/* Ticks without a new command use the goal again. */
static void a_goal_is_computed_once_for_a_command(void)
{
    core_config config = strafing();
    (void)goal_of(&config, 0.4, 0.0, 0.0);
    r.state.goal.goal_u_s[AXIS_LINEAR] = 0.3;
    CHECK(ticks(&r, 1500)->setpoint_linear_m_s == 0.3);
    r.input.command.linear_m_s = 0.2;
    CHECK(ticks(&r, 1500)->setpoint_linear_m_s == 0.2);
}

int main(void)
{
    the_direction_stays_where_a_base_that_strafes_is_limited_and_its_turn_is_limited_alone();
    a_base_that_does_not_strafe_drives_on_without_the_lateral_speed();
    a_derated_base_keeps_its_direction_as_far_as_each_axis_allows();
    the_wheel_slowest_for_its_share_is_named_and_the_first_among_equals();
    wheels_that_are_steered_are_saturated_alike();
    every_reason_of_a_goal_is_reported();
    a_goal_is_computed_once_for_a_command();
    return checks_report("test_goal");
}
