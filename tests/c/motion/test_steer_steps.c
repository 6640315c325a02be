/* SPDX-License-Identifier: Apache-2.0
 * test_steer_steps: the steered wheels in a tick: the base waits for them, and they follow its
 * motion. */
#include "steer.h"
#include "steered_bases.h"

static const double DT_S = 0.01;

static steer_state begun(const core_config *base)
{
    steer_state steer;
    steer_init(&steer, base);
    return steer;
}

/* The part of a goal that is left when the base moves by `from_u_s` with these wheel angles. */
typedef struct {
    double goal_u_s[AXES];
    double rate_max_s;
    uint32_t reasons;
} slowed;

static slowed slow_down(steer_state *steer, const core_config *base, const double *from_u_s,
                        const double *goal_u_s, const double *angle_rad)
{
    limit_state axis[AXES];
    slowed left;
    memcpy(left.goal_u_s, goal_u_s, sizeof left.goal_u_s);
    for (int i = 0; i < AXES; i++) {
        axis[i] = (limit_state){from_u_s[i], 0.5};
    }
    left.rate_max_s = 7.0;
    steer->misaligned_rad = 7.0;
    left.reasons = steer_goal(steer, base, axis, angle_rad, left.goal_u_s, &left.rate_max_s);
    return left;
}

static const double STANDS[AXES] = {0.0};

/* --- unknown angles */
static void a_joint_whose_angle_is_not_known_is_reported_while_it_sends_feedback(void)
{
    static const struct {
        uint32_t used, reference, referenced, stale;
        double angle_rad;
        bool unknown;
    } CASES[] = {
        {1, REFERENCE_ABSOLUTE, 2, 0, 0.1, false}, {1, REFERENCE_ABSOLUTE, 0, 0, 0.1, false},
        {1, REFERENCE_ABSOLUTE, 2, 0, NAN, true},  {1, REFERENCE_ABSOLUTE, 2, 1, NAN, false},
        {1, REFERENCE_HOMED, 1, 0, 0.1, false},    {1, REFERENCE_HOMED, 0, 0, 0.1, true},
        {1, REFERENCE_HOMED, 2, 0, 0.1, true},     {1, REFERENCE_HOMED, 1, 0, NAN, true},
        {1, REFERENCE_HOMED, 0, 1, 0.1, false},    {1, REFERENCE_ESTIMATED, 0, 0, NAN, false},
        {0, REFERENCE_ABSOLUTE, 2, 0, NAN, false},
    };
    for (int i = 0; i < COUNT_OF(CASES); i++) {
        core_config base = ackermann(WHEELBASE_M);
        joint_feedback feedback[JOINTS_MAX];
        uint32_t stale[JOINTS_MAX] = {0};
        double angle_rad[JOINTS_MAX] = {0.0};
        for (int j = 0; j < JOINTS_MAX; j++) {
            feedback[j].referenced = 1;
        }
        CHECK(steer_unknown(&base, feedback, stale, angle_rad) == 0);
        base.joint[2].position.used = CASES[i].used,
        base.joint[2].position.reference = CASES[i].reference;
        feedback[2].referenced = CASES[i].referenced, stale[2] = CASES[i].stale,
        angle_rad[2] = CASES[i].angle_rad;
        CHECK(steer_unknown(&base, feedback, stale, angle_rad) == (CASES[i].unknown ? 4U : 0U));
    }
    core_config base = ackermann(WHEELBASE_M);
    CHECK(steer_unknown(&base, (const joint_feedback[JOINTS_MAX]){{0}},
                        (const uint32_t[JOINTS_MAX]){0},
                        (const double[JOINTS_MAX]){0.0, 0.0, NAN, NAN}) == 0xC);
    base = swerve();
    base.joint[4] = turning_within(1.0); /* beyond the joints of the base */
    CHECK(steer_unknown(&base, (const joint_feedback[JOINTS_MAX]){{0}},
                        (const uint32_t[JOINTS_MAX]){0},
                        (const double[JOINTS_MAX]){NAN, NAN, NAN, NAN, NAN}) == 0x5);
}

/* --- before the ramp */
static void at_rest_without_a_goal_nothing_waits(void)
{
    core_config base = bicycle();
    steer_state steer = begun(&base);
    slowed left = slow_down(&steer, &base, STANDS, STANDS, (const double[JOINTS_MAX]){0.0, NAN});
    CHECK(left.reasons == 0 && isinf(left.rate_max_s) && steer.misaligned_rad == 0.0);
}

static void a_base_slows_down_while_a_wheel_points_in_another_direction(void)
{
    static const struct {
        double off_rad, share;
    } CASES[] = {{0.0, 1.0},  {0.04, 1.0},  {-0.04, 1.0}, {0.06, 0.95}, {-0.06, 0.95},
                 {0.15, 0.5}, {0.24, 0.05}, {0.26, 0.0},  {-2.0, 0.0},  {NAN, 0.0}};
    for (int i = 0; i < COUNT_OF(CASES) * 2; i++) {
        core_config base = bicycle();
        steer_state steer = begun(&base);
        double off_rad = CASES[i / 2].off_rad, share = CASES[i / 2].share,
               angle_rad[JOINTS_MAX] = {0.0, 0.2 + off_rad};
        const double there[AXES] = {0.5, 0.5 * tan(0.2) / WHEELBASE_M}, straight[AXES] = {0.4, 0.0};
        bool moves = i % 2 == 1; /* the goal counts at rest, else the motion */
        slowed left =
            slow_down(&steer, &base, moves ? there : STANDS, moves ? straight : there, angle_rad);
        const double *goal = moves ? straight : there;
        CHECK(isnan(off_rad) ? isinf(steer.misaligned_rad)
                             : close_to(steer.misaligned_rad, fabs(off_rad)));
        CHECK(left.reasons == (share < 1.0 ? REASON_STEERING : 0U));
        CHECK(close_to(left.goal_u_s[0], share * goal[0]) &&
              close_to(left.goal_u_s[1], share * goal[1]));
        CHECK(share < 1.0 || left.goal_u_s[0] == goal[0]);
        /* at rest no direction changes */
        CHECK(isinf(left.rate_max_s) == (!moves || share == 0.0));
    }
}

/* The wheel that is farthest from its direction counts. A wheel whose angle is uncertain counts as
 * farther than any. */
static void the_worst_wheel_counts(void)
{
    core_config base = swerve();
    steer_state steer = begun(&base);
    const double goal[AXES] = {0.4, 0.0, 0.0};
    slowed left =
        slow_down(&steer, &base, STANDS, goal, (const double[JOINTS_MAX]){0.1, 0.0, -0.25});
    CHECK(close_to(steer.misaligned_rad, 0.1) && close_to(left.goal_u_s[0], 0.3));
    slow_down(&steer, &base, STANDS, goal, (const double[JOINTS_MAX]){0.1, 0.0, -0.1});
    CHECK(close_to(steer.misaligned_rad, 0.2));
    for (int j = 0; j <= 2; j += 2) {
        static const double UNSURE_S[] = {0.05, 0.5, 1.0};
        for (int i = 0; i < COUNT_OF(UNSURE_S); i++) {
            steer.unsure_s[j] = UNSURE_S[i];
            left =
                slow_down(&steer, &base, STANDS, goal, (const double[JOINTS_MAX]){0.0, 0.0, -0.3});
            CHECK(isinf(steer.misaligned_rad) && left.goal_u_s[0] == 0.0 &&
                  left.reasons == REASON_STEERING);
        }
        steer.unsure_s[j] = 0.0;
    }
}

/* In a turn about a wheel, that wheel may point anywhere. Below a millionth of the fastest wheel's
 * speed it counts as standing. */
static void a_wheel_that_stands_points_anywhere(void)
{
    core_config base = swerve();
    double apart_m = hypot(0.5, 0.3);
    for (int about = 0; about <= 1; about++) {
        for (int i = 0; i < 2; i++) {
            double part = i == 0 ? 0.5e-6 : 2e-6;
            const wheel_module *at = &base.module[about];
            const double goal[AXES] = {0.01 * (at->y_m + part * apart_m), 0.01,
                                       -0.01 * at->x_m}; /* this wheel rolls straight, if at all */
            double angle_rad[JOINTS_MAX];
            steer_state steer = begun(&base);
            for (int k = 0; k < 2; k++) {
                angle_rad[2 * k] = -base.module[k].angle_rad;
            }
            double x_m = base.module[1 - about].x_m - at->x_m,
                   y_m = base.module[1 - about].y_m - at->y_m;
            angle_rad[2 * (1 - about)] += atan(x_m / -y_m); /* the other one rolls about it */
            steer.profile[2 * (1 - about)].position_rad = angle_rad[2 * (1 - about)];
            angle_rad[2 * about] += 0.7;
            slow_down(&steer, &base, STANDS, goal, angle_rad);
            CHECK(fabs(steer.misaligned_rad - (i == 0 ? 0.0 : 0.7)) < 1e-5);
            /* the wheel is steered only if it moves */
            steer_joints(&steer, &base, goal, STANDS, DT_S);
            CHECK((steer.profile[2 * about].position_rad == 0.0) ==
                  (i == 0 || at->angle_rad == 0.0));
        }
    }
}

static void before_a_goal_that_turns_a_wheel_around_the_base_comes_to_rest(void)
{
    core_config car = bicycle(), three = tricycle(), free = swerve();
    car.joint[1] = turning_within(3.2);
    const struct {
        const core_config *base;
        double from[AXES], goal[AXES];
        bool turns;
    } CASES[] = {
        {&car, {0.5, 0.0}, {-0.5, 0.0}, true},
        {&car, {-0.5, 0.0}, {0.1, 0.0}, true},
        {&car, {0.2, 0.0}, {0.25, 0.0}, false},
        {&car, {-0.2, 0.0}, {-0.25, 0.0}, false},
        {&car, {1.0, 6.0}, {1.0, -6.0}, false}, /* the front wheel turns from side to side without a
                                                   stop */
        {&car, {0.5, 6.0}, {0.2, -6.0}, false},
        {&car, {0.1, 3.0}, {0.1, -3.0}, false},
        {&car, {0.5, 0.5}, {0.0, -1.0}, true}, /* without speed, the wheel would have to reverse */
        {&car, {0.5, 0.0}, {0.0, 1.0}, false},
        {&car, {0.0, 1.0}, {0.0, -1.0}, true},
        {&car, {0.0, 1.0}, {0.0, 0.2}, false},
        {&three, {0.0, 1.0}, {1.0, 0.5}, false}, /* a fixed wheel reverses, which it may */
        {&free, {1.0, 0.0, 0.0}, {0.0, 0.0, 1.0}, false},
        {&free, {1.0, 0.0, 0.0}, {-0.01, 0.0, 1.0}, true},
        {&free, {1.0, 0.0, 0.0}, {0.01, 0.0, 1.0}, false},
        {&free, {0.0, 0.0, 1.0}, {1.0, 0.0, -0.01}, true},
        {&free, {0.0, 0.0, 1.0}, {1.0, 0.0, 0.01}, false},
        {&free, {0.5, 0.0, 0.0}, {0.0, 1.0, 0.05}, true},   /* the left wheel would reverse */
        {&free, {0.5, 0.0, 0.0}, {0.0, -1.0, -0.05}, true}, /* the right wheel would reverse */
        {&free, {1.0, 0.0, 0.0}, {0.5, 1.0, 0.0}, false},
    };
    for (int i = 0; i < COUNT_OF(CASES); i++) {
        const core_config *base = CASES[i].base;
        steer_state steer = begun(base);
        double angle_rad[JOINTS_MAX] = {0.0};
        for (uint32_t k = 0; k < base->module_count; k++) {
            const wheel_module *at = &base->module[k];
            double x = CASES[i].from[0] - at->y_m * CASES[i].from[1],
                   y = CASES[i].from[2] + at->x_m * CASES[i].from[1];
            if (at->steering != 0) { /* points as the motion requires */
                angle_rad[at->steering - 1] = steer.profile[at->steering - 1].position_rad =
                    atan2(y, x) - at->angle_rad;
            }
        }
        slowed left = slow_down(&steer, base, CASES[i].from, CASES[i].goal, angle_rad);
        bool rests = left.goal_u_s[0] == 0.0 && left.goal_u_s[1] == 0.0 && left.goal_u_s[2] == 0.0;
        CHECK(rests == CASES[i].turns);
        CHECK(left.reasons == (rests ? REASON_STEERING : 0U) && (!rests || isinf(left.rate_max_s)));
    }
}

/* The direction of a wheel changes by v x dv / |v|^2. */
static void the_ramp_is_paced_by_the_wheel_whose_direction_changes_fastest(void)
{
    static const struct {
        double from[AXES], goal[AXES], rate_part;
    } CASES[] = {
        {{0.5, 0.0, 0.0}, {0.5, 0.0, 1.0}, 0.5},
        {{0.5, 0.0, 0.0}, {0.5, 0.0, -1.0}, 0.5},
        {{0.5, 0.0, 0.0}, {2.0, 0.0, 0.25}, 2.0},
        {{0.3, 0.0, 0.4}, {0.4, 0.0, 0.3}, 0.25 / 0.07},
        {{0.5, 0.0, 0.0}, {0.9, 0.0, 0.0}, INFINITY},
        {{1.0, 0.0, 0.0}, {2.0, 0.0, 1e-6}, INFINITY}, /* below the rounding */
        {{1.0, 0.0, 0.0}, {2.0, 0.0, 4e-6}, 1.0 / 4e-6},
        {{0.5, 0.0, 0.0}, {0.5, 0.5, 0.0}, 0.25 / 0.075}, /* the wheel at x = 0.3 */
        {{0.5, 0.0, 0.0}, {0.5, 0.5, 0.16}, 0.25 / 0.155},
        {{0.5, 0.0, 0.0}, {0.5, 0.5, -0.1}, 0.25 / 0.1}, /* the wheel at x = -0.2 */
    };
    core_config base = swerve();
    for (int i = 0; i < COUNT_OF(CASES); i++) {
        steer_state steer = begun(&base);
        double direction_rad = atan2(CASES[i].from[2], CASES[i].from[0]);
        double angle_rad[JOINTS_MAX] = {direction_rad, 0.0,
                                        direction_rad - base.module[1].angle_rad};
        slowed left = slow_down(&steer, &base, CASES[i].from, CASES[i].goal, angle_rad);
        CHECK(left.reasons == 0 && steer.misaligned_rad < 1e-9);
        CHECK(isinf(CASES[i].rate_part)
                  ? isinf(left.rate_max_s)
                  : fabs(left.rate_max_s / (steer.pace_rad_s * CASES[i].rate_part) - 1.0) < 1e-9);
    }
}

static void a_step_that_is_faster_is_shortened_and_stays_straight(void)
{
    const limit_state from[AXES] = {{0.1, 0.0}, {0.2, 0.0}, {-0.3, 0.0}};
    const limit_state half[AXES] = {{0.6, 50.0}, {1.2, 100.0}, {-0.8, -50.0}};
    const double goal[AXES] = {1.1, 2.2, -1.3};
    limit_state axis[AXES];
    memcpy(axis, half, sizeof axis);
    CHECK(steer_pace(from, axis, goal, 10.0, DT_S) == REASON_STEERING);
    for (int i = 0; i < AXES; i++) {
        CHECK(close_to(axis[i].velocity_u_s,
                       from[i].velocity_u_s + 0.1 * (goal[i] - from[i].velocity_u_s)));
        CHECK(close_to(axis[i].acceleration_u_s2, 10.0 * (goal[i] - from[i].velocity_u_s)));
    }
    for (int a = 0; a < AXES; a++) { /* also with a single axis */
        limit_state alone[AXES] = {{0.0, 0.0}}, still[AXES] = {{0.0, 0.0}};
        double goal_u_s[AXES] = {0.0};
        alone[a].velocity_u_s = 0.5, goal_u_s[a] = 1.0;
        CHECK(steer_pace(still, alone, goal_u_s, 10.0, DT_S) == REASON_STEERING &&
              close_to(alone[a].velocity_u_s, 0.1));
    }
    static const double FAST_ENOUGH_S[] = {51.0, 1000.0, INFINITY};
    for (int i = 0; i < COUNT_OF(FAST_ENOUGH_S); i++) {
        memcpy(axis, half, sizeof axis);
        CHECK(steer_pace(from, axis, goal, FAST_ENOUGH_S[i], DT_S) == 0 &&
              memcmp(axis, half, sizeof axis) == 0);
    }
    /* exactly as fast as allowed, and a base at rest */
    const limit_state quarter[AXES] = {{0.25, 1.0}, {0.0, 0.0}, {-0.25, -1.0}},
                      rest[AXES] = {{0.0, 0.0}};
    memcpy(axis, quarter, sizeof axis);
    CHECK(steer_pace(rest, axis, (const double[AXES]){1.0, 0.0, -1.0}, 1.0, 0.25) == 0);
    CHECK(memcmp(axis, quarter, sizeof axis) == 0);
    memcpy(axis, rest, sizeof axis);
    CHECK(steer_pace(rest, axis, STANDS, INFINITY, DT_S) == 0 &&
          memcmp(axis, rest, sizeof axis) == 0);
}

/* --- after the ramp */
static position_profile stepped(position_profile profile, const core_config *base, uint32_t j,
                                double goal_rad)
{
    position_step(&profile, &base->joint[j].position, goal_rad, DT_S);
    return profile;
}

static bool same(position_profile profile, position_profile expected)
{
    return close_to(profile.position_rad, expected.position_rad) &&
           close_to(profile.velocity_rad_s, expected.velocity_rad_s);
}

static void wheels_follow_the_motion_at_rest_the_goal_and_hold_without_either(void)
{
    static const double ONE[][AXES] = {{1.0, 0.0, 0.0}, {0.1, 0.0, 0.0}, {0.0, 1.0, 0.0},
                                       {0.0, 0.1, 0.0}, {0.0, 0.0, 1.0}, {0.0, 0.0, 0.1}};
    core_config base = swerve();
    const double other[AXES] = {-0.3, -0.4, 0.6};
    for (int i = 0; i < COUNT_OF(ONE); i++) {
        for (int j = 0; j <= 2; j += 2) {
            const wheel_module *at = &base.module[j / 2];
            double aim_rad =
                atan2(ONE[i][2] + at->x_m * ONE[i][1], ONE[i][0] - at->y_m * ONE[i][1]) -
                at->angle_rad;
            aim_rad -= rint(aim_rad / M_PI) * M_PI;
            if (fabs(fabs(aim_rad) - 0.5 * M_PI) < 1e-6) {
                continue; /* both directions are equally near */
            }
            steer_state steer = begun(&base);
            steer_joints(&steer, &base, ONE[i], other, DT_S);
            CHECK(same(steer.profile[j],
                       stepped((position_profile){0}, &base, (uint32_t)j, aim_rad)) &&
                  steer.enabled == 1);
            steer = begun(&base);
            steer_joints(&steer, &base, STANDS, ONE[i], DT_S);
            CHECK(same(steer.profile[j],
                       stepped((position_profile){0}, &base, (uint32_t)j, aim_rad)));
        }
    }
    steer_state steer = begun(&base);
    steer.profile[0] = steer.profile[2] = (position_profile){0.4, 1.0};
    steer_joints(&steer, &base, STANDS, STANDS, DT_S);
    for (int j = 0; j <= 2; j += 2) {
        CHECK(
            same(steer.profile[j], stepped((position_profile){0.4, 1.0}, &base, (uint32_t)j, NAN)));
    }
    CHECK(steer.profile[1].position_rad == 0.0 && steer.profile[3].position_rad == 0.0);
    steer.profile[0] = (position_profile){0.4, 1.0};
    steer_joints(&steer, &base, ONE[0], ONE[0], 0.0); /* without time there is no step */
    CHECK(steer.profile[0].position_rad == 0.4 && steer.profile[0].velocity_rad_s == 1.0);
}

/* A joint without a measurement may be anywhere when it gets its power. It counts as certain after
 * the time of its longest move. */
static void a_joint_without_measurement_is_certain_after_its_longest_move(void)
{
    core_config base = bicycle();
    base.joint[1].position.reference = REFERENCE_ESTIMATED;
    base.joint[1].position.position_min_rad = -0.3;
    const double motion[AXES] = {0.4, 0.4};
    steer_state steer = begun(&base);
    for (int again = 0; again < 2; again++) {
        int steps = 0;
        do {
            steer_joints(&steer, &base, motion, motion, DT_S);
            CHECK(close_to(steer.unsure_s[1], fmax(0.3 - ++steps * DT_S, 0.0)) || steps > 30);
        } while (steer.profile[1].velocity_rad_s == 0.0 && steps < 100);
        CHECK(steps == 31 || steps == 32);
        steer_released(&steer, &base, (const double[JOINTS_MAX]){0.0, 0.1});
        CHECK(steer.profile[1].velocity_rad_s == 0.0);
    }
    base.joint[1].position.reference = REFERENCE_HOMED;
    steer = begun(&base);
    CHECK(steer_sure(&steer, &base, 1, DT_S));
    steer.unsure_s[1] = 0.05;
    CHECK(!steer_sure(&steer, &base, 1, 0.0) && steer.unsure_s[1] == 0.05);
    CHECK(!steer_sure(&steer, &base, 1, 1.0) && steer.unsure_s[1] == 0.0);
    CHECK(steer_sure(&steer, &base, 1, 1.0) && steer.unsure_s[1] == 0.0);
}

static void without_power_a_joint_is_where_it_is(void)
{
    core_config base = ackermann(WHEELBASE_M);
    base.joint[3].position.reference = REFERENCE_ESTIMATED;
    for (int known = 0; known < 2; known++) {
        steer_state steer = begun(&base);
        for (int j = 0; j < 4; j++) {
            steer.profile[j] = (position_profile){0.4, 1.0};
        }
        steer.enabled = 1, steer.misaligned_rad = 0.3;
        steer_released(&steer, &base,
                       (const double[JOINTS_MAX]){0.1, 0.1, known ? 0.1 : (double)NAN, 0.1});
        CHECK(steer.profile[2].position_rad == (known ? 0.1 : 0.4) &&
              steer.profile[2].velocity_rad_s == 0.0);
        CHECK(steer.profile[3].position_rad == 0.4 && steer.profile[3].velocity_rad_s == 0.0);
        CHECK(steer.profile[0].position_rad == 0.4 && steer.profile[0].velocity_rad_s == 1.0);
        CHECK(steer.enabled == 0 && steer.misaligned_rad == 0.0);
    }
    base = swerve();                     /* also for the first joint */
    base.joint[4] = turning_within(1.0); /* beyond the joints */
    steer_state steer = begun(&base);
    steer_released(&steer, &base, (const double[JOINTS_MAX]){0.5, 0.1, 0.6, 0.1, 0.7});
    CHECK(steer.profile[0].position_rad == 0.5 && steer.profile[2].position_rad == 0.6);
    CHECK(steer.profile[1].position_rad == 0.0 && steer.profile[4].position_rad == 0.0);
}

static void set_points_of_joints_that_take_positions_are_those_of_their_profiles(void)
{
    static const double SPEEDS_RAD_S[] = {0.0, 0.1, 1.0, -0.3};
    core_config base = ackermann(WHEELBASE_M);
    base.joint[3].position.reference = REFERENCE_ESTIMATED;
    base.joint[4] = turning_within(1.0); /* beyond the joints of the base */
    for (int i = 0; i < COUNT_OF(SPEEDS_RAD_S) * 2; i++) {
        steer_state steer = begun(&base);
        joint_setpoint joint[JOINTS_MAX];
        double angle_rad[JOINTS_MAX] = {0.1, 0.1, 0.1, 0.1}, speed_rad_s = SPEEDS_RAD_S[i / 2];
        int moves = 2 + i % 2;
        for (int j = 0; j < JOINTS_MAX; j++) {
            joint[j] = (joint_setpoint){5.0, 0.5, 0.25};
        }
        steer.profile[2].position_rad = 0.2, steer.profile[3].position_rad = 0.3;
        steer.profile[0].velocity_rad_s = 9.0; /* this joint takes no positions */
        steer.profile[moves].velocity_rad_s = speed_rad_s;
        CHECK(steer_setpoints(&steer, &base, joint, angle_rad) == (speed_rad_s != 0.0));
        CHECK(joint[moves].velocity_rad_s == speed_rad_s && joint[5 - moves].velocity_rad_s == 0.0);
        for (int j = 2; j < 4; j++) {
            CHECK(joint[j].duty == 0.0 && joint[j].torque_n_m == 0.0);
        }
        CHECK(joint[0].velocity_rad_s == 5.0 && joint[1].torque_n_m == 0.25 &&
              joint[4].duty == 0.5);
        CHECK(angle_rad[0] == 0.1 && angle_rad[2] == 0.1 && angle_rad[3] == 0.3);
    }
}

static void known_positions_count_while_there_is_power(void)
{
    core_config base = ackermann(WHEELBASE_M);
    steer_state steer = begun(&base);
    double position_rad[JOINTS_MAX] = {[4] = 9.0};
    base.joint[4] = turning_within(1.0); /* beyond the joints of the base */
    for (int j = 0; j < 4; j++) {
        steer.profile[j].position_rad = 0.1 + j, position_rad[j] = 9.0;
    }
    CHECK(steer_positions(&steer, &base, false, position_rad) == 0);
    for (int j = 0; j < 4; j++) {
        CHECK(position_rad[j] == 0.0);
    }
    CHECK(steer_positions(&steer, &base, true, position_rad) == 0xC);
    CHECK(position_rad[0] == 0.0 && position_rad[1] == 0.0 && position_rad[2] == 2.1 &&
          position_rad[3] == 3.1);
    CHECK(position_rad[4] == 9.0);
    steer.unknown = 1U << 3;
    CHECK(steer_positions(&steer, &base, true, position_rad) == 0x4 && position_rad[3] == 0.0);
    steer.unknown = 0, steer.profile[2].position_rad = NAN;
    CHECK(steer_positions(&steer, &base, true, position_rad) == 0x8 && position_rad[2] == 0.0);
}

int main(void)
{
    a_joint_whose_angle_is_not_known_is_reported_while_it_sends_feedback();
    at_rest_without_a_goal_nothing_waits();
    a_base_slows_down_while_a_wheel_points_in_another_direction();
    the_worst_wheel_counts();
    a_wheel_that_stands_points_anywhere();
    before_a_goal_that_turns_a_wheel_around_the_base_comes_to_rest();
    the_ramp_is_paced_by_the_wheel_whose_direction_changes_fastest();
    a_step_that_is_faster_is_shortened_and_stays_straight();
    wheels_follow_the_motion_at_rest_the_goal_and_hold_without_either();
    a_joint_without_measurement_is_certain_after_its_longest_move();
    without_power_a_joint_is_where_it_is();
    set_points_of_joints_that_take_positions_are_those_of_their_profiles();
    known_positions_count_while_there_is_power();
    return checks_report("test_steer_steps");
}
