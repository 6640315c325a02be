/* SPDX-License-Identifier: Apache-2.0
 * test_independent: single steps of joints without a base, each with its own limits. */
#include "joints_rig.h"

/* --- commands */
static void a_command_counts_where_it_names_a_joint(void)
{
    core_config config = head_and_belt();
    joint_command command = {.value_u = {NAN, INFINITY, -INFINITY, NAN}};
    CHECK(joint_command_finite(&command, &config) && joint_command_zero(&command, &config));
    command.named = 8; /* beyond the joints of the robot */
    CHECK(joint_command_finite(&command, &config) && joint_command_zero(&command, &config));
    for (uint32_t j = 0; j < 3; j++) {
        command.named = 1U << j;
        CHECK(!joint_command_finite(&command, &config) && !joint_command_zero(&command, &config));
        command.value_u[j] = 0.5;
        CHECK(joint_command_finite(&command, &config) && !joint_command_zero(&command, &config));
    }
    static const double SPEEDS_RAD_S[] = {1.0, 0.1, -0.3};
    command.named = 1U << BELT;
    for (int i = 0; i < COUNT_OF(SPEEDS_RAD_S); i++) {
        command.value_u[BELT] = SPEEDS_RAD_S[i];
        CHECK(!joint_command_zero(&command, &config));
    }
    command.value_u[BELT] = 0.0;
    CHECK(joint_command_zero(&command, &config));
    command.named |= 1U << PAN; /* any position is a motion, also 0 */
    command.value_u[PAN] = 0.0;
    CHECK(!joint_command_zero(&command, &config) && joint_command_finite(&command, &config));
}

/* --- velocities */
static void a_belt_ramps_by_its_own_limits(void)
{
    joints_rig r;
    begin(&r);
    command(&r, BELT, -4.0);
    CHECK(step_joints(&r, 1) == REASON_JOINT_ACCELERATION);
    CHECK(close_to(r.velocity_rad_s[BELT], -0.1) &&
          close_to(r.joints.acceleration_rad_s2[BELT], -10.0));
    CHECK(r.velocity_rad_s[PAN] == 0.0 && r.velocity_rad_s[TILT] == 0.0 &&
          r.velocity_rad_s[3] == 9.0);
    CHECK(r.steer.enabled == 1);
    CHECK(step_joints(&r, 38) == REASON_JOINT_ACCELERATION && step_joints(&r, 1) == 0);
    CHECK(step_joints(&r, 1) == 0 && r.velocity_rad_s[BELT] == -4.0 &&
          r.joints.velocity_rad_s[BELT] == -4.0);
    r.command.named = 0; /* not named any more: the belt comes to rest */
    CHECK(step_joints(&r, 1) == REASON_JOINT_ACCELERATION &&
          close_to(r.velocity_rad_s[BELT], -3.84));
    CHECK(step_joints(&r, 30) == 0 && r.velocity_rad_s[BELT] == 0.0);
}

static void a_belt_keeps_its_jerk_but_in_a_fault(void)
{
    for (int urgent = 0; urgent < 2; urgent++) {
        joints_rig r;
        begin(&r);
        r.limits[BELT].jerk_u_s3 = 100.0;
        r.input.urgent = urgent == 1;
        command(&r, BELT, 4.0);
        CHECK(step_joints(&r, 1) == REASON_JOINT_ACCELERATION &&
              close_to(r.velocity_rad_s[BELT], urgent ? 0.1 : 0.01));
        step_joints(&r, 1);
        CHECK(close_to(r.velocity_rad_s[BELT], urgent ? 0.2 : 0.03));
    }
}

static void a_belt_goes_no_faster_than_its_file_and_its_derating_allow(void)
{
    static const struct {
        double wanted_rad_s, factor, expected_rad_s;
        uint32_t reasons;
    } CASES[] = {
        {8.0, 1.0, 8.0, 0},
        {-5.0, 1.0, -5.0, 0},
        {9.0, 1.0, 8.0, REASON_JOINT_VELOCITY},
        {-9.0, 1.0, -5.0, REASON_JOINT_VELOCITY},
        {3.0, 0.5, 3.0, 0},
        {6.0, 0.5, 4.0, REASON_DERATED},
        {-4.0, 0.5, -2.5, REASON_DERATED},
        {9.0, 0.5, 4.0, REASON_DERATED | REASON_JOINT_VELOCITY},
    };
    for (int i = 0; i < COUNT_OF(CASES); i++) {
        joints_rig r;
        begin(&r);
        r.config.joint[BELT].velocity_min_rad_s = -5.0;
        r.input.factor = CASES[i].factor;
        command(&r, BELT, CASES[i].wanted_rad_s);
        CHECK(step_joints(&r, 1) == (CASES[i].reasons | REASON_JOINT_ACCELERATION));
        CHECK(step_joints(&r, 200) == CASES[i].reasons &&
              close_to(r.velocity_rad_s[BELT], CASES[i].expected_rad_s));
    }
}

/* --- positions */
static void a_head_goes_to_its_target_within_its_range(void)
{
    static const struct {
        double wanted_rad, expected_rad;
        uint32_t reasons;
    } CASES[] = {{1.5, 1.5, 0},
                 {-2.0, -2.0, 0},
                 {2.0, 2.0, 0},
                 {3.0, 2.0, REASON_JOINT_POSITION},
                 {-9.0, -2.0, REASON_JOINT_POSITION}};
    for (int i = 0; i < COUNT_OF(CASES); i++) {
        joints_rig r;
        begin(&r);
        command(&r, PAN, CASES[i].wanted_rad);
        CHECK(step_joints(&r, 1) == CASES[i].reasons && r.velocity_rad_s[PAN] == 0.0);
        position_profile expected = {0};
        position_step(&expected, &r.config.joint[PAN].position, CASES[i].expected_rad, DT_S);
        CHECK(angle(&r, PAN) == expected.position_rad &&
              r.steer.profile[PAN].velocity_rad_s == expected.velocity_rad_s);
        r.command.named = 0; /* not named any more: the move continues */
        CHECK(step_joints(&r, 200) == CASES[i].reasons && angle(&r, PAN) == CASES[i].expected_rad);
        CHECK(angle(&r, TILT) == 0.0 && isnan(r.joints.target_rad[TILT]));
    }
}

static void a_target_ends_with_its_lease_and_with_every_command(void)
{
    for (int end = 0; end < 3; end++) {
        joints_rig r;
        begin(&r);
        r.input.owner = 4;
        command(&r, PAN, 1.5);
        step_joints(&r, 20);
        r.command.named = 0;
        r.input.owner = end == 0 ? 5 : 4;
        r.input.command = end == 1 ? NULL : &r.command;
        step_joints(&r, 1);
        CHECK(r.joints.owner == r.input.owner);
        r.input.command = &r.command;
        step_joints(&r, 300);
        CHECK(end == 2 ? angle(&r, PAN) == 1.5 : angle(&r, PAN) > 0.1 && angle(&r, PAN) < 1.0);
        CHECK(r.steer.profile[PAN].velocity_rad_s == 0.0);
    }
}

static void a_derated_head_moves_slower_and_reports_it_while_it_moves(void)
{
    static const double FACTORS[] = {1.0, 0.5, 0.0};
    for (int i = 0; i < COUNT_OF(FACTORS); i++) {
        joints_rig r;
        begin(&r);
        r.input.factor = FACTORS[i];
        CHECK(step_joints(&r, 1) == 0); /* without a target nothing is slowed */
        command(&r, PAN, 1.0);
        CHECK(step_joints(&r, 25) == (FACTORS[i] < 1.0 ? REASON_DERATED : 0U));
        CHECK(close_to(r.steer.profile[PAN].velocity_rad_s, 3.0 * FACTORS[i]));
        r.input.factor = 0.5;
        CHECK(step_joints(&r, 200) == 0 && angle(&r, PAN) == 1.0);
        CHECK(r.config.joint[PAN].position.velocity_rad_s == 3.0);
        command(&r, PAN, -5.0); /* every reason is reported */
        CHECK(step_joints(&r, 1) == (REASON_DERATED | REASON_JOINT_POSITION));
    }
}

static void a_head_waits_until_its_position_is_certain(void)
{
    joints_rig r;
    begin(&r);
    r.config.joint[TILT].position.reference = REFERENCE_ESTIMATED;
    command(&r, TILT, 0.5);
    step_joints(&r, 53); /* 1.6 rad at 3 rad/s */
    CHECK(angle(&r, TILT) == 0.0 && r.steer.unsure_s[PAN] == 0.0);
    step_joints(&r, 200);
    CHECK(angle(&r, TILT) == 0.5);
    r.input.dt_s = 0.0; /* without time there is no step */
    command(&r, TILT, -0.5);
    r.steer.profile[TILT].velocity_rad_s = 0.2;
    step_joints(&r, 1);
    CHECK(angle(&r, TILT) == 0.5 && r.steer.profile[TILT].velocity_rad_s == 0.2);
}

/* A joint that is within its range does not leave it. From beyond the range it returns at its own
 * speed. */
static void a_head_ends_within_its_range(void)
{
    for (int sign = -1; sign <= 1; sign += 2) {
        joints_rig r;
        begin(&r);
        r.steer.profile[PAN] = (position_profile){sign * 1.999, sign * 3.0}; /* too fast to brake
                                                                                before the end */
        command(&r, PAN, sign * 2.0);
        step_joints(&r, 1);
        CHECK(angle(&r, PAN) == sign * 2.0);
        r.steer.profile[PAN] = (position_profile){sign * 2.0, sign * 3.0};
        step_joints(&r, 1);
        CHECK(angle(&r, PAN) == sign * 2.0);
        r.steer.profile[PAN] = (position_profile){sign * 2.5, 0.0};
        step_joints(&r, 1);
        CHECK(close_to(angle(&r, PAN), sign * (2.5 - 0.004)));
    }
}

static void after_a_halt_all_joints_stand_and_have_no_target(void)
{
    joints_rig r;
    begin(&r);
    command(&r, PAN, 1.5), command(&r, BELT, 4.0), command(&r, TILT, 0.5);
    step_joints(&r, 10);
    double pan_rad = angle(&r, PAN);
    r.steer.profile[3].velocity_rad_s = 7.0; /* beyond the joints of the robot */
    independent_halt(&r.joints, &r.steer, &r.config);
    for (int j = 0; j < JOINTS_MAX; j++) {
        CHECK(isnan(r.joints.target_rad[j]) && r.joints.velocity_rad_s[j] == 0.0 &&
              r.joints.acceleration_rad_s2[j] == 0.0);
        CHECK(r.steer.profile[j].velocity_rad_s == (j == 3 ? 7.0 : 0.0));
    }
    r.command.named = 0;
    CHECK(step_joints(&r, 10) == 0 && angle(&r, PAN) == pan_rad && r.velocity_rad_s[BELT] == 0.0);
}

int main(void)
{
    a_command_counts_where_it_names_a_joint();
    a_belt_ramps_by_its_own_limits();
    a_belt_keeps_its_jerk_but_in_a_fault();
    a_belt_goes_no_faster_than_its_file_and_its_derating_allow();
    a_head_goes_to_its_target_within_its_range();
    a_target_ends_with_its_lease_and_with_every_command();
    a_derated_head_moves_slower_and_reports_it_while_it_moves();
    a_head_waits_until_its_position_is_certain();
    a_head_ends_within_its_range();
    after_a_halt_all_joints_stand_and_have_no_target();
    return checks_report("test_independent");
}
