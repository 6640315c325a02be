/* SPDX-License-Identifier: Apache-2.0
 * test_limit_ease: how large one step may be if the next ones have to be smaller, compared with the
 * result of a search. */
#include <math.h>

#include "check.h"
#include "core.h"

static const double DT_S = 0.01, FAST_U_S2 = 1e6;

static uint64_t noise = 88172645463325252U;

static double any(double least, double most)
{
    noise ^= noise << 13, noise ^= noise >> 7, noise ^= noise << 17;
    return least + (most - least) * (double)(noise % 100001) * 1e-5;
}

/* Whether an acceleration that decreases by `step` in each step ends within `gap`. */
static bool eases(double first, double gap, double step, double unused)
{
    (void)unused;
    double used = 0.0;
    for (double now = first; now > 0.0; now -= step) {
        used += now;
    }
    return used <= gap;
}

/* Whether the acceleration is at most `after` in the step that passes `gap`. */
static bool turns_gently(double first, double gap, double step, double after)
{
    double used = 0.0;
    for (double now = first; now > after; now -= step) {
        used += now;
        if (used > gap) {
            return false;
        }
    }
    return true;
}

/* The largest first value for which `holds` is true; it is true for all smaller ones. */
static double largest(bool (*holds)(double, double, double, double), double gap, double step,
                      double after)
{
    double low = 0.0, high = 2.0 * gap + 2.0 * after;
    for (int i = 0; i < 200; i++) {
        double middle = 0.5 * (low + high);
        *(holds(middle, gap, step, after) ? &low : &high) = middle;
    }
    return low;
}

static double step_of(double from, double goal, double gains, double jerk, uint32_t expected)
{
    base_limits limits = {.linear = {1e6, gains, FAST_U_S2, jerk},
                          .angular = {1.0, 1.0, 1.0, INFINITY}};
    double sense = goal > from ? 1.0 : -1.0;
    /* already fast: the jerk limit does not matter */
    limit_state axis[AXES] = {{from, sense * FAST_U_S2}};
    uint32_t reason =
        ramp_step(axis, AXES, &limits, NULL, (const double[AXES]){goal, 0.0}, DT_S, false);
    CHECK(reason == expected);
    CHECK(fabs(axis[0].velocity_u_s - from - axis[0].acceleration_u_s2 * DT_S) < 1e-9);
    return sense * axis[0].acceleration_u_s2;
}

static bool same(double value, double expected)
{
    return fabs(value - expected) <= 1e-9 * expected;
}

static void a_speed_is_eased_before_its_goal_as_late_as_possible(void)
{
    for (int round = 0; round < 2000; round++) {
        double from = any(0.1, 1.0), change = any(0.01, 2.0), jerk = any(2.0, 50.0);
        double gap = change / DT_S, step = jerk * DT_S;
        double expected = largest(eases, gap, step, 0.0);
        CHECK(same(step_of(from, from + change, FAST_U_S2, jerk, REASON_LINEAR_JERK), expected));
        CHECK(same(step_of(-from, -from - change, FAST_U_S2, jerk, REASON_LINEAR_JERK), expected));
    }
}

static void a_speed_is_eased_before_it_changes_its_sign_as_late_as_possible(void)
{
    int eased = 0;
    for (int round = 0; round < 4000; round++) {
        double gains = any(0.2, 4.0), jerk = any(2.0, 400.0),
               gap = gains * any(0.1, round % 2 == 0 ? 3.0 : 60.0);
        double from = gap * DT_S, step = jerk * DT_S;
        double expected = largest(turns_gently, gap, step, gains);
        CHECK(same(step_of(from, -1000.0, gains, jerk, REASON_LINEAR_ACCELERATION), expected));
        CHECK(same(step_of(-from, 1000.0, gains, jerk, REASON_LINEAR_ACCELERATION), expected));
        eased += expected > gains * (1.0 + 1e-6);
    }
    CHECK(eased > 1000);
}

int main(void)
{
    a_speed_is_eased_before_its_goal_as_late_as_possible();
    a_speed_is_eased_before_it_changes_its_sign_as_late_as_possible();
    return checks_report("test_limit_ease");
}
