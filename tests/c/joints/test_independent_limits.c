/* SPDX-License-Identifier: Apache-2.0
 * test_independent_limits: limits of joints without a base that change at run time, and reasons
 * that name joints. */
#include "joints_rig.h"

static bool same(const axis_limits *limits, axis_limits expected)
{
    return memcmp(limits, &expected, sizeof expected) == 0;
}

static double speed(const joints_rig *r, int j)
{
    return r->steer.profile[j].velocity_rad_s;
}

/* --- which limits are in force */
static void the_limits_at_the_start_are_those_of_the_file(void)
{
    static const double RANGES_RAD_S[][3] = {
        {-9.0, 5.0, 9.0}, {-2.0, 5.0, 5.0}, {-8.0, 8.0, 8.0}, {0.0, 3.0, 3.0}};
    for (int i = 0; i < COUNT_OF(RANGES_RAD_S); i++) {
        core_config config = head_and_belt();
        config.joint[BELT].velocity_min_rad_s = RANGES_RAD_S[i][0];
        config.joint[BELT].velocity_max_rad_s = RANGES_RAD_S[i][1];
        config.joint[BELT].own = (axis_limits){1.0, 10.0, 16.0, 70.0};
        axis_limits limits[JOINTS_MAX] = {[3] = {7.0, 7.0, 7.0, 7.0}};
        independent_own_limits(limits, &config);
        CHECK(same(&limits[PAN], (axis_limits){3.0, 40.0, 40.0, INFINITY}));
        CHECK(same(&limits[BELT], (axis_limits){RANGES_RAD_S[i][2], 10.0, 16.0, 70.0}));
        CHECK(same(&limits[TILT], (axis_limits){3.0, 40.0, 40.0, INFINITY}));
        CHECK(same(&limits[3], (axis_limits){7.0, 7.0, 7.0, 7.0})); /* beyond the joints of the
                                                                       robot */
    }
}

static void set_limits(core_control *control, double velocity_rad_s)
{
    control->joint_limits_count++;
    for (uint32_t j = 0; j < 3; j++) {
        control->joint_limits[j] = (axis_limits){velocity_rad_s, 2.0 + j, 5.0 + j, INFINITY};
    }
}

static bool in_force(const rig *r, double velocity_rad_s)
{
    for (uint32_t j = 0; j < 3; j++) {
        if (!same(&r->state.joint_limits[j],
                  (axis_limits){velocity_rad_s, 2.0 + j, 5.0 + j, INFINITY})) {
            return false;
        }
    }
    return true;
}

static void limits_are_applied_once_for_each_count(void)
{
    core_config config = head_and_belt();
    rig r;
    start(&r, &config);
    core_control *control = &r.input.control;
    set_limits(control, 1.5);
    independent_take_limits(&r.state, control);
    CHECK(in_force(&r, 1.5) && r.state.joint_limits_seen == 1);
    set_limits(control, 0.7);
    control->joint_limits_count--;
    independent_take_limits(&r.state, control);
    CHECK(in_force(&r, 1.5));
    control->joint_limits_count++;
    independent_take_limits(&r.state, control);
    CHECK(in_force(&r, 0.7) && r.state.joint_limits_seen == 2);
    control->joint_limits_count = 0;             /* any other count is a change */
    control->joint_limits[3].velocity_u_s = NAN; /* beyond the joints of the robot */
    control->joint_limits[BELT].velocity_u_s = 0.3;
    independent_take_limits(&r.state, control);
    CHECK(r.state.joint_limits[BELT].velocity_u_s == 0.3 &&
          r.state.joint_limits[3].velocity_u_s == 0.0);
}

static void where_one_limit_is_out_of_range_all_stay_as_they_are(void)
{
    static const double BAD[] = {0.0, -1.0, NAN, INFINITY};
    for (uint32_t at = 0; at < 3 * 4 * COUNT_OF(BAD); at++) {
        uint32_t joint = at % 3, place = at / 3 % 4;
        double bad = BAD[at / 12];
        core_config config = head_and_belt();
        rig r;
        start(&r, &config);
        core_control *control = &r.input.control;
        set_limits(control, 1.5);
        independent_take_limits(&r.state, control);
        set_limits(control, 0.7);
        axis_limits *limits = &control->joint_limits[joint];
        double *const fields[] = {&limits->velocity_u_s, &limits->acceleration_u_s2,
                                  &limits->deceleration_u_s2, &limits->jerk_u_s3};
        *fields[place] = bad;
        independent_take_limits(&r.state, control);
        bool no_jerk_limit = place == 3 && isinf(bad);
        CHECK(in_force(&r, no_jerk_limit ? 0.7 : 1.5));
        *fields[place] = 1.0; /* too late: the limits with this count have been refused */
        independent_take_limits(&r.state, control);
        CHECK(in_force(&r, no_jerk_limit ? 0.7 : 1.5));
    }
}

/* --- joints that take positions */
static void a_head_at_rest_moves_by_its_new_limits(void)
{
    joints_rig r;
    begin(&r);
    command(&r, PAN, 2.0), command(&r, TILT, 0.8);
    r.limits[PAN] = (axis_limits){1.0, 4.0, 4.0, INFINITY};
    step_joints(&r, 1);
    CHECK(close_to(speed(&r, PAN), 0.04) && close_to(speed(&r, TILT), 0.4)); /* each by its own
                                                                                limits */
    CHECK(r.joints.braking_rad_s2[PAN] == 4.0 && r.joints.braking_rad_s2[TILT] == 40.0);
    step_joints(&r, 60);
    CHECK(speed(&r, PAN) == 1.0);
    r.limits[PAN] = (axis_limits){2.0, 8.0, 8.0, INFINITY}; /* raised during the move */
    step_joints(&r, 1);
    CHECK(close_to(speed(&r, PAN), 1.08) && r.joints.braking_rad_s2[PAN] == 8.0);
    step_joints(&r, 300);
    CHECK(angle(&r, PAN) == 2.0 && speed(&r, PAN) == 0.0 && angle(&r, TILT) == 0.8);
    CHECK(r.config.joint[PAN].position.velocity_rad_s == 3.0 &&
          r.config.joint[PAN].position.acceleration_rad_s2 == 40.0);
}

static void a_head_moves_no_faster_than_its_file_allows_with_any_limit(void)
{
    joints_rig r;
    begin(&r);
    r.limits[PAN].velocity_u_s = 30.0;
    command(&r, PAN, 2.0);
    double fastest_rad_s = 0.0;
    for (int i = 0; i < 200; i++) {
        step_joints(&r, 1);
        fastest_rad_s = fmax(fastest_rad_s, speed(&r, PAN));
    }
    CHECK(fastest_rad_s == 3.0 && angle(&r, PAN) == 2.0);
}

static void a_head_gets_down_to_a_lowered_speed_by_deceleration(void)
{
    for (int sign = -1; sign <= 1; sign += 2) {
        joints_rig r;
        begin(&r);
        command(&r, PAN, sign * 2.0);
        step_joints(&r, 20);
        CHECK(close_to(speed(&r, PAN), sign * 3.0));
        r.limits[PAN].velocity_u_s = 1.0;
        step_joints(&r, 1);
        CHECK(close_to(speed(&r, PAN), sign * 2.6));
        step_joints(&r, 5);
        CHECK(speed(&r, PAN) == sign * 1.0);
        step_joints(&r, 300);
        CHECK(angle(&r, PAN) == sign * 2.0);
    }
}

/* A moving joint gets a limit of 0.8 rad/s^2 instead of 40. To brake from 0.2 rad/s it needs 0.025
 * rad, and 0.002 rad in this step; from 0.05 rad/s it needs 0.0020625 rad. Its range is -1 to 2
 * rad. */
static void a_lowered_acceleration_is_taken_as_soon_as_it_is_enough(void)
{
    static const struct {
        double from_rad, velocity_rad_s, target_rad;
        bool enough;
    } CASES[] = {
        /* cases before the goal */
        {0.5, 0.2, 0.5271, true},
        {0.5, 0.2, 0.5269, false},
        {0.5, -0.2, 0.4729, true},
        {0.5, -0.2, 0.4731, false},
        {0.5, 0.05, 0.50207, true},
        {0.5, 0.05, 0.50205, false},
        {0.5, -0.05, 0.49793, true},
        {0.5, -0.05, 0.49795, false},
        {0.5, 2.0, 1.9, false},
        {0.5, 0.2, 0.5, false}, /* passes its goal in this step */
        {0.5, -0.2, 0.5, false},
        /* cases behind the goal, before the end of the range */
        {0.5, 0.2, 0.4, true},
        {0.5, -0.2, 0.6, true},
        {1.9729, 0.2, 1.0, true},
        {1.9731, 0.2, 1.0, false},
        {-0.9729, -0.2, 0.0, true},
        {-0.9731, -0.2, 0.0, false},
        /* cases without a goal */
        {1.9729, 0.2, NAN, true},
        {1.9731, 0.2, NAN, false},
        {-0.9729, -0.2, NAN, true},
        {-0.9731, -0.2, NAN, false},
        {1.9979, 0.05, NAN, true},
        {1.998, 0.05, NAN, false},
        {-0.9979, -0.05, NAN, true},
        {-0.998, -0.05, NAN, false},
        {1.0, 0.2, NAN, true},
        {-0.5, -0.2, NAN, true},
        /* a goal beyond the end of the range counts as the end */
        {1.9729, 0.2, 9.0, true},
        {1.9731, 0.2, 9.0, false},
    };
    for (int i = 0; i < COUNT_OF(CASES); i++) {
        joints_rig r;
        begin(&r);
        r.config.joint[PAN].position.position_min_rad = -1.0;
        step_joints(&r, 1);
        CHECK(r.joints.braking_rad_s2[PAN] == 40.0);
        r.steer.profile[PAN] = (position_profile){CASES[i].from_rad, CASES[i].velocity_rad_s};
        r.limits[PAN] = (axis_limits){3.0, 0.8, 0.8, INFINITY};
        if (!isnan(CASES[i].target_rad)) {
            command(&r, PAN, CASES[i].target_rad);
        }
        step_joints(&r, 1);
        CHECK(r.joints.braking_rad_s2[PAN] == (CASES[i].enough ? 0.8 : 40.0));
        CHECK(fabs(speed(&r, PAN) - CASES[i].velocity_rad_s) <=
              (CASES[i].enough ? 0.008 : 0.4) + 1e-12);
        CHECK(r.joints.braking_rad_s2[TILT] == 40.0);
    }
}

static void a_lowered_acceleration_that_just_suffices_is_applied(void)
{
    joints_rig r;
    begin(&r);
    r.input.dt_s = 0.0078125;
    step_joints(&r, 1);
    r.steer.profile[PAN] = (position_profile){0.0, 0.5};
    r.limits[PAN].acceleration_u_s2 = 0.5;
    command(&r, PAN, 0.25390625); /* 0.5 * 0.5 / (2 * 0.5) + 0.5 * dt: exact in binary */
    step_joints(&r, 1);
    CHECK(r.joints.braking_rad_s2[PAN] == 0.5);
}

static void while_a_head_keeps_its_old_braking_it_gets_no_faster(void)
{
    for (int sign = -1; sign <= 1; sign += 2) {
        joints_rig r;
        begin(&r);
        step_joints(&r, 1);
        r.steer.profile[PAN] = (position_profile){0.0, sign * 0.2};
        r.limits[PAN].acceleration_u_s2 = 0.8;
        command(&r, PAN, sign * 0.0269); /* 40 rad/s^2 would leave time to speed up */
        step_joints(&r, 1);
        CHECK(close_to(speed(&r, PAN), sign * 0.2) && close_to(angle(&r, PAN), sign * 0.002));
        double fastest_rad_s = 0.0;
        for (int i = 0; i < 100; i++) {
            step_joints(&r, 1);
            fastest_rad_s = fmax(fastest_rad_s, fabs(speed(&r, PAN)));
        }
        CHECK(close_to(fastest_rad_s, 0.2) && angle(&r, PAN) == sign * 0.0269);
        CHECK(r.joints.braking_rad_s2[PAN] == 0.8 && speed(&r, PAN) == 0.0);
    }
}

static void a_raised_acceleration_is_taken_at_once(void)
{
    joints_rig r;
    begin(&r);
    r.limits[PAN].acceleration_u_s2 = 0.8;
    step_joints(&r, 1);
    r.steer.profile[PAN] = (position_profile){0.0, 3.0};
    r.limits[PAN].acceleration_u_s2 = 20.0; /* too low for this goal, too */
    command(&r, PAN, 0.1);
    step_joints(&r, 1);
    CHECK(r.joints.braking_rad_s2[PAN] == 20.0 && close_to(speed(&r, PAN), 2.8));
}

/* An unchanged acceleration limits no speed; only the derating does. */
static void an_acceleration_that_stays_bounds_no_speed(void)
{
    joints_rig r;
    begin(&r);
    step_joints(&r, 1);
    r.steer.profile[PAN] = (position_profile){0.0, 1.0};
    r.input.factor = 0.5;
    command(&r, PAN, 0.02); /* derated to 1.5 rad/s, so that only the goal slows it */
    step_joints(&r, 1);
    position_profile expected = {0.0, 1.0};
    position_step(&expected, &r.config.joint[PAN].position, 0.02, DT_S);
    CHECK(speed(&r, PAN) == expected.velocity_rad_s && expected.velocity_rad_s > 0.9);
}

static void a_head_at_rest_takes_a_lowered_acceleration_wherever_it_is(void)
{
    for (int sign = -1; sign <= 1; sign++) {
        joints_rig r;
        begin(&r);
        step_joints(&r, 1);
        r.steer.profile[PAN] = (position_profile){sign * 2.5, 0.0}; /* moved by hand beyond the
                                                                       range */
        r.limits[PAN].acceleration_u_s2 = 0.8;
        step_joints(&r, 1);
        CHECK(r.joints.braking_rad_s2[PAN] == 0.8 && angle(&r, PAN) == sign * 2.5);
        command(&r, PAN, sign == 0 ? 1.0 : 0.0);
        step_joints(&r, 1);
        CHECK(close_to(fabs(speed(&r, PAN)), 0.008));
    }
}

/* Limits are lowered at any time of a move: the joint passes neither its goal nor its range, and
 * ends at the goal. */
static void a_head_whose_limits_are_lowered_in_a_move_does_not_overshoot(void)
{
    static const double TARGETS_RAD[] = {0.2, 1.0, 2.0, -0.3, -2.0};
    for (int i = 0; i < COUNT_OF(TARGETS_RAD); i++) {
        for (int wait = 0; wait < 90; wait += 3) {
            joints_rig r;
            begin(&r);
            double target_rad = TARGETS_RAD[i], sign = target_rad < 0.0 ? -1.0 : 1.0;
            command(&r, PAN, target_rad);
            step_joints(&r, wait);
            r.limits[PAN] = (axis_limits){1.5, 0.5, 0.5, INFINITY};
            for (int n = 0; n < 1000; n++) {
                double before_rad_s = speed(&r, PAN);
                CHECK(step_joints(&r, 1) == 0);
                CHECK(angle(&r, PAN) * sign <= target_rad * sign && speed(&r, PAN) * sign >= 0.0);
                CHECK(fabs(speed(&r, PAN) - before_rad_s) <= 0.4 + 1e-9);
            }
            CHECK(angle(&r, PAN) == target_rad && speed(&r, PAN) == 0.0);
        }
    }
}

/* --- joints that take speeds */
static void a_belt_keeps_limits_that_change_while_it_moves_and_at_rest(void)
{
    for (int sign = -1; sign <= 1; sign += 2) {
        joints_rig r;
        begin(&r);
        r.limits[BELT].acceleration_u_s2 = 5.0;
        command(&r, BELT, sign * 6.0);
        CHECK(step_joints(&r, 1) == REASON_JOINT_ACCELERATION &&
              close_to(r.velocity_rad_s[BELT], sign * 0.05));
        step_joints(&r, 200);
        CHECK(r.velocity_rad_s[BELT] == sign * 6.0);
        r.limits[BELT] = (axis_limits){2.0, 5.0, 4.0, INFINITY};
        CHECK(step_joints(&r, 1) == (REASON_JOINT_VELOCITY | REASON_JOINT_ACCELERATION));
        CHECK(close_to(r.velocity_rad_s[BELT], sign * 5.96));
        CHECK(step_joints(&r, 120) == REASON_JOINT_VELOCITY &&
              r.velocity_rad_s[BELT] == sign * 2.0);
        r.limits[BELT].velocity_u_s = 80.0; /* the limit of the file is lower */
        command(&r, BELT, sign * 50.0);
        CHECK(step_joints(&r, 300) == REASON_JOINT_VELOCITY &&
              r.velocity_rad_s[BELT] == sign * 8.0);
    }
}

static void limits_changed_without_power_hold_from_the_first_motion_on(void)
{
    core_config config = head_and_belt();
    rig r;
    ready(&r, &config);
    set_limits(&r.input.control, 0.5);
    tick(&r);
    r.input.control.armed = 1;
    CHECK(tick(&r)->armed == 1);
    r.input.joints = (joint_command){.named = 7, .value_u = {1.0, 4.0, 0.7}};
    tick(&r);
    for (uint32_t j = 0; j < 3; j++) {
        CHECK(close_to(r.out.joint[j].velocity_rad_s, (2.0 + j) * 1e-3));
    }
    double fastest_rad_s[3] = {0.0};
    for (int i = 0; i < 4000; i++) {
        tick(&r);
        for (uint32_t j = 0; j < 3; j++) {
            fastest_rad_s[j] = fmax(fastest_rad_s[j], r.out.joint[j].velocity_rad_s);
        }
    }
    CHECK(fastest_rad_s[PAN] == 0.5 && fastest_rad_s[BELT] == 0.5 && fastest_rad_s[TILT] == 0.5);
    CHECK(r.out.position_rad[PAN] == 1.0 && r.out.position_rad[TILT] == 0.7 && r.shown.faults == 0);
}

/* --- reasons by joint: even joints are belts, odd ones are heads */
static bool named_are(const joints_rig *r, uint32_t velocity, uint32_t acceleration,
                      uint32_t position)
{
    const reasons_shown *named = &r->named;
    return named->joint_velocity == velocity && named->joint_acceleration == acceleration &&
           named->joint_position == position;
}

static void each_reason_names_the_joints_that_it_comes_from(void)
{
    for (uint32_t j = 0; j < JOINTS_MAX; j++) {
        joints_rig r;
        begin_with(&r, heads_and_belts());
        uint32_t bit = 1U << j;
        bool belt = j % 2 == 0;
        command(&r, j, belt ? 90.0 : 5.0);
        CHECK(step_joints(&r, 1) == (belt ? REASON_JOINT_VELOCITY | REASON_JOINT_ACCELERATION
                                          : (uint32_t)REASON_JOINT_POSITION));
        CHECK(belt ? named_are(&r, bit, bit, 0) : named_are(&r, 0, 0, bit));
        command(&r, j, belt ? 30.0 : 1.0);
        CHECK(step_joints(&r, 1) == (belt ? REASON_JOINT_ACCELERATION : 0U));
        CHECK(named_are(&r, 0, belt ? bit : 0, 0));
        step_joints(&r, 400);
        CHECK(step_joints(&r, 1) == 0 && named_are(&r, 0, 0, 0));
    }
}

static void several_joints_of_one_reason_are_all_named(void)
{
    joints_rig r;
    begin_with(&r, heads_and_belts());
    command(&r, 0, 3.0), command(&r, 2, 90.0), command(&r, 4, -90.0), command(&r, 6, 0.0);
    command(&r, 1, 5.0), command(&r, 3, 1.0), command(&r, 5, -5.0);
    CHECK(step_joints(&r, 1) ==
          (REASON_JOINT_VELOCITY | REASON_JOINT_ACCELERATION | REASON_JOINT_POSITION));
    CHECK(named_are(&r, 0x14, 0x15, 0x22));
    CHECK(step_joints(&r, 1000) == (REASON_JOINT_VELOCITY | REASON_JOINT_POSITION));
    CHECK(named_are(&r, 0x14, 0, 0x22));
    r.input.command = NULL; /* all belts come to rest */
    CHECK(step_joints(&r, 1) == REASON_JOINT_ACCELERATION && named_are(&r, 0, 0x15, 0));
    CHECK(step_joints(&r, 1000) == 0 && named_are(&r, 0, 0, 0));
}

static void names_of_the_tick_before_are_not_kept(void)
{
    joints_rig r;
    begin(&r);
    r.named.joint_velocity = r.named.joint_acceleration = r.named.joint_position = ~0U;
    r.named.duty_clamped = r.named.duty_slew = r.named.saturated_joint = 9; /* names that another
                                                                               part sets */
    CHECK(step_joints(&r, 1) == 0 && named_are(&r, 0, 0, 0));
    CHECK(r.named.duty_clamped == 9 && r.named.duty_slew == 9 && r.named.saturated_joint == 9);
}

int main(void)
{
    the_limits_at_the_start_are_those_of_the_file();
    limits_are_applied_once_for_each_count();
    where_one_limit_is_out_of_range_all_stay_as_they_are();
    a_head_at_rest_moves_by_its_new_limits();
    a_head_moves_no_faster_than_its_file_allows_with_any_limit();
    a_head_gets_down_to_a_lowered_speed_by_deceleration();
    a_lowered_acceleration_is_taken_as_soon_as_it_is_enough();
    a_lowered_acceleration_that_just_suffices_is_applied();
    while_a_head_keeps_its_old_braking_it_gets_no_faster();
    a_raised_acceleration_is_taken_at_once();
    an_acceleration_that_stays_bounds_no_speed();
    a_head_at_rest_takes_a_lowered_acceleration_wherever_it_is();
    a_head_whose_limits_are_lowered_in_a_move_does_not_overshoot();
    a_belt_keeps_limits_that_change_while_it_moves_and_at_rest();
    limits_changed_without_power_hold_from_the_first_motion_on();
    each_reason_names_the_joints_that_it_comes_from();
    several_joints_of_one_reason_are_all_named();
    names_of_the_tick_before_are_not_kept();
    return checks_report("test_independent_limits");
}
