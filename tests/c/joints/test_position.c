/* SPDX-License-Identifier: Apache-2.0
 * test_position: single steps of a joint to an angle, compared with the result of a search; whole
 * motions; and the check of the following error. */
#include "steered_bases.h"

static const double DT_S = 0.01;

static position_config fast(double velocity_rad_s, double acceleration_rad_s2)
{
    position_config own = turning_within(3.0).position;
    own.velocity_rad_s = velocity_rad_s, own.acceleration_rad_s2 = acceleration_rad_s2;
    return own;
}

static position_profile stepped(position_profile profile, const position_config *own,
                                double goal_rad, double dt_s)
{
    position_step(&profile, own, goal_rad, dt_s);
    return profile;
}

/* The largest speed of a step after which the braking distance is no longer than the rest of the
 * path. */
static double largest_that_brakes(double left_rad, double acceleration_rad_s2)
{
    double low = 0.0, high = 2.0 * left_rad / DT_S;
    for (int i = 0; i < 100; i++) {
        double middle = 0.5 * (low + high);
        bool brakes = middle * middle / (2.0 * acceleration_rad_s2) <= left_rad - middle * DT_S;
        *(brakes ? &low : &high) = middle;
    }
    return low;
}

static void a_joint_brakes_as_late_as_possible(void)
{
    for (int round = 0; round < 2000; round++) {
        position_config own = fast(1e3, any(2.0, 50.0));
        double left_rad = any(0.001, 2.0), from_rad = any(-1.0, 1.0),
               sign = round % 2 == 0 ? 1.0 : -1.0;
        double fastest_rad_s = largest_that_brakes(left_rad, own.acceleration_rad_s2);
        position_profile profile = {from_rad, sign * fastest_rad_s};
        profile = stepped(profile, &own, from_rad + sign * left_rad, DT_S);
        CHECK(fabs(profile.velocity_rad_s - sign * fastest_rad_s) <= 1e-9 * fastest_rad_s);
        CHECK(close_to(profile.position_rad, from_rad + sign * fastest_rad_s * DT_S));
    }
}

/* A time step as of an early, a regular or a late tick. */
static double any_time_s(void)
{
    double choice = any(0.0, 1.0);
    return choice < 0.3 ? any(1e-6, 1e-3) : choice < 0.9 ? 1e-3 : any(1e-3, 0.1);
}

static void a_goal_is_not_passed_for_any_length_of_its_steps(void)
{
    for (int round = 0; round < 2000; round++) {
        position_config own = fast(any(0.2, 10.0), any(2.0, 50.0));
        double v = own.velocity_rad_s, a = own.acceleration_rad_s2, goal_rad = any(-3.0, 3.0),
               distance_rad = fabs(goal_rad);
        position_profile profile = {0.0, 0.0};
        int steps = 0;
        for (;
             (profile.position_rad != goal_rad || profile.velocity_rad_s != 0.0) && steps < 100000;
             steps++) {
            position_profile before = profile;
            double dt_s = any_time_s();
            position_step(&profile, &own, goal_rad, dt_s);
            CHECK(fabs(profile.velocity_rad_s) <= v &&
                  fabs(profile.velocity_rad_s - before.velocity_rad_s) <= a * dt_s + 1e-12);
            CHECK(close_to(profile.position_rad,
                           before.position_rad + profile.velocity_rad_s * dt_s));
            CHECK(fabs(profile.position_rad) <= distance_rad + 1e-12 &&
                  profile.position_rad * goal_rad >= 0.0);
        }
        CHECK(steps < 100000);
    }
}

/* Goals change and end during the move. Each is within the range, and so is the braking
 * distance. */
static void a_range_is_not_left_for_any_length_of_its_steps(void)
{
    for (int round = 0; round < 200; round++) {
        position_config own = fast(any(0.2, 10.0), any(2.0, 50.0));
        position_profile profile = {any(-3.0, 3.0), 0.0};
        double goal_rad = 3.0;
        for (int i = 0; i < 5000; i++) {
            if (any(0.0, 1.0) < 0.01) {
                goal_rad =
                    any(0.0, 1.0) < 0.2 ? (double)NAN : fmin(fmax(any(-6.0, 6.0), -3.0), 3.0);
            }
            position_step(&profile, &own, goal_rad, any_time_s());
            CHECK(fabs(profile.position_rad) <= 3.0 + 1e-12);
        }
    }
}

static void a_motion_takes_the_shortest_time_and_ends_exactly_at_its_goal(void)
{
    for (int round = 0; round < 300; round++) {
        position_config own = fast(any(0.2, 3.0), any(2.0, 50.0));
        double v = own.velocity_rad_s, a = own.acceleration_rad_s2, goal_rad = any(-3.0, 3.0),
               distance_rad = fabs(goal_rad);
        position_profile profile = {0.0, 0.0};
        int steps = 0;
        for (; (profile.position_rad != goal_rad || profile.velocity_rad_s != 0.0) && steps < 5000;
             steps++) {
            position_profile before = profile;
            position_step(&profile, &own, goal_rad, DT_S);
            CHECK(fabs(profile.velocity_rad_s) <= v &&
                  fabs(profile.velocity_rad_s - before.velocity_rad_s) <= a * DT_S + 1e-12);
            CHECK(close_to(profile.position_rad,
                           before.position_rad + profile.velocity_rad_s * DT_S));
            CHECK(fabs(profile.position_rad) <= distance_rad &&
                  profile.position_rad * goal_rad >= 0.0);
        }
        double shortest_s =
            distance_rad * a > v * v ? distance_rad / v + v / a : 2.0 * sqrt(distance_rad / a);
        /* the last distance, which is less than a dt^2, takes some more steps */
        double last_s = (5.0 + 0.5 * log(1.0 + v / (a * DT_S))) * DT_S;
        CHECK(steps * DT_S >= shortest_s - DT_S && steps * DT_S <= shortest_s + last_s);
    }
}

static void single_steps_have_the_expected_numbers(void)
{
    static const struct {
        double from_rad, from_rad_s, goal_rad, to_rad, to_rad_s;
    } CASES[] = {
        /* limits of 2 rad/s and 10 rad/s2: a step changes the speed by 0.1 rad/s */
        {0.0, 0.0, 1.0, 0.001, 0.1},
        {0.0, 0.0, -1.0, -0.001, -0.1},
        {0.0, 0.0, 0.1, 0.001, 0.1},
        {0.0, 2.0, 1.0, 0.02, 2.0},
        {0.0, 1.95, 1.0, 0.02, 2.0},
        {0.0, 3.0, 1.0, 0.029, 2.9}, /* it is above its limit */
        {0.5, 0.0, 0.5, 0.5, 0.0},
        {0.5, 0.05, 0.5, 0.5, 0.0},
        {0.5, -0.1, 0.5, 0.5, 0.0},
        /* v dt + v^2 / 2 a = 0.0005 */
        {0.0, 0.0, 0.0005, 0.0004142135623730951, 0.04142135623730951},
        {0.0, 0.0, 1e-20, 1e-20, 1e-18}, /* nearer than rounding */
        {0.0, 1.0, 0.001, 0.009, 0.9},   /* too near to brake: it passes the goal */
        {0.0, 0.3, 0.0015, 0.002, 0.2},
        {0.0, -1.0, 1.0, -0.009, -0.9}, /* moves away from the goal: it brakes first */
        {0.0, 1.0, NAN, 0.009, 0.9},    /* without a goal: it brakes */
        {0.0, 0.05, NAN, 0.0, 0.0},
        {0.0, -1.0, INFINITY, -0.009, -0.9},
        {0.0, 1.0, INFINITY, 0.009, 0.9},
        {0.0, 0.0, INFINITY, 0.0, 0.0},
        {0.0, 0.0, -INFINITY, 0.0, 0.0},
        /* a joint with NaN or infinity stops */
        {0.3, NAN, 1.0, 0.3, 0.0},
        {0.3, INFINITY, 1.0, 0.3, 0.0},
    };
    position_config own = fast(2.0, 10.0);
    for (int i = 0; i < COUNT_OF(CASES); i++) {
        position_profile profile = {CASES[i].from_rad, CASES[i].from_rad_s};
        profile = stepped(profile, &own, CASES[i].goal_rad, DT_S);
        CHECK(fabs(profile.position_rad - CASES[i].to_rad) < 1e-12 &&
              fabs(profile.velocity_rad_s - CASES[i].to_rad_s) < 1e-12);
    }
    CHECK(stepped((position_profile){0.0, 0.0}, &own, 1e-20, DT_S).position_rad == 1e-20);
    CHECK(isnan(stepped((position_profile){NAN, 1.0}, &own, 0.0, DT_S).position_rad));
    CHECK(stepped((position_profile){NAN, 1.0}, &own, 0.0, DT_S).velocity_rad_s == 0.0);
    /* at the goal, but too fast to stop in one step: it overshoots and returns */
    position_profile passes = stepped((position_profile){0.0, 1.0}, &own, 0.009, DT_S);
    CHECK(passes.velocity_rad_s > 0.89);
}

static void a_goal_is_reached_exactly_despite_rounding(void)
{
    static const struct {
        double from_rad, goal_rad, dt_s;
    } CASES[] = {{0.0, 7e-15, 23.95}, {0.0, -1e-13, 10.02}, {0.0, 2e-16, 6.83}, {-0.52, 0.09, 4e7}};
    position_config own = fast(100.0, 100.0);
    for (int i = 0; i < COUNT_OF(CASES); i++) {
        double from_rad = CASES[i].from_rad, goal_rad = CASES[i].goal_rad, dt_s = CASES[i].dt_s;
        position_profile profile = stepped((position_profile){from_rad, 0.0}, &own, goal_rad, dt_s);
        CHECK(from_rad + profile.velocity_rad_s * dt_s != goal_rad);
        CHECK(profile.position_rad == goal_rad);
    }
}

static void a_time_step_that_is_not_positive_and_finite_moves_nothing(void)
{
    static const double TIMES_S[] = {0.0, -0.01, NAN, INFINITY, 2e9};
    position_config own = fast(2.0, 10.0);
    for (int i = 0; i < COUNT_OF(TIMES_S); i++) {
        position_profile profile = stepped((position_profile){0.3, 1.0}, &own, 1.0, TIMES_S[i]);
        CHECK(profile.position_rad == 0.3 && profile.velocity_rad_s == 0.0);
    }
    /* the longest valid step */
    position_profile profile = stepped((position_profile){0.0, 0.0}, &own, 1e9, 1e9);
    CHECK(profile.position_rad > 0.999e9 && profile.position_rad < 1e9 &&
          close_to(profile.velocity_rad_s, 1.0));
}

/* --- following error */
static const int64_t FIRST_NS = 5000000000;

static void a_joint_follows_while_it_is_near_or_comes_nearer(void)
{
    position_config own = fast(2.0, 10.0);
    own.following_rad = 0.2, own.following_s = 0.5;
    position_following following = {0, 0.0};
    CHECK(position_follows(&following, &own, 0.2, 0.0, FIRST_NS) && following.since_ns == 0);
    /* a set-point of 1 rad/s allows a lag of 0.25 s more */
    CHECK(position_follows(&following, &own, 0.445, 1.0, FIRST_NS) && following.since_ns == 0);
    CHECK(position_follows(&following, &own, 0.445, -1.0, FIRST_NS) && following.since_ns == 0);
    CHECK(position_follows(&following, &own, NAN, 0.0, FIRST_NS) && following.since_ns == 0);
    CHECK(position_follows(&following, &own, 0.46, 1.0, FIRST_NS) &&
          following.since_ns == FIRST_NS);
    CHECK(following.nearest_rad == 0.46);
    /* nearer, but by less than a tenth of what is allowed */
    CHECK(position_follows(&following, &own, 0.441, 0.0, FIRST_NS + 400 * MS_NS) &&
          following.since_ns == FIRST_NS);
    CHECK(position_follows(&following, &own, 0.43, 0.0, FIRST_NS + 450 * MS_NS));
    CHECK(following.since_ns == FIRST_NS + 450 * MS_NS && following.nearest_rad == 0.43);
    CHECK(position_follows(&following, &own, 0.43, 0.0, FIRST_NS + 949 * MS_NS));
    CHECK(!position_follows(&following, &own, 0.43, 0.0, FIRST_NS + 950 * MS_NS));
    CHECK(!position_follows(&following, &own, 0.43, 0.0, FIRST_NS + 2000 * MS_NS));
    CHECK(!position_follows(&following, &own, 0.6, 0.0, FIRST_NS + 2000 * MS_NS));
    CHECK(position_follows(&following, &own, 0.1, 0.0, FIRST_NS + 2001 * MS_NS) &&
          following.since_ns == 0);
    CHECK(position_follows(&following, &own, 0.6, 0.0, FIRST_NS + 2002 * MS_NS) &&
          following.nearest_rad == 0.6);
}

static void without_a_time_nothing_is_checked(void)
{
    static const double TIMES_S[] = {0.0, NAN, -1.0};
    for (int i = 0; i < COUNT_OF(TIMES_S); i++) {
        position_config own = fast(2.0, 10.0);
        own.following_rad = 0.2, own.following_s = TIMES_S[i];
        position_following following = {FIRST_NS - 10000 * MS_NS, 0.5};
        CHECK(position_follows(&following, &own, 9.0, 0.0, FIRST_NS) && following.since_ns == 0);
    }
    static const double SHORT_S[] = {0.05, 0.1, 1.0};
    for (int i = 0; i < COUNT_OF(SHORT_S); i++) {
        position_config own = fast(2.0, 10.0);
        own.following_rad = 0.2, own.following_s = SHORT_S[i];
        position_following following = {FIRST_NS, 0.5};
        CHECK(!position_follows(&following, &own, 0.5, 0.0, FIRST_NS + 1001 * MS_NS));
    }
}

int main(void)
{
    a_joint_brakes_as_late_as_possible();
    a_goal_is_not_passed_for_any_length_of_its_steps();
    a_range_is_not_left_for_any_length_of_its_steps();
    a_motion_takes_the_shortest_time_and_ends_exactly_at_its_goal();
    single_steps_have_the_expected_numbers();
    a_goal_is_reached_exactly_despite_rounding();
    a_time_step_that_is_not_positive_and_finite_moves_nothing();
    a_joint_follows_while_it_is_near_or_comes_nearer();
    without_a_time_nothing_is_checked();
    return checks_report("test_position");
}
