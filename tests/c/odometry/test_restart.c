/* SPDX-License-Identifier: Apache-2.0
 * A counter that begins at zero again is not motion. */
#include "odometry_base.h"

/* Speeds in counts a step, forward and backward. `at`: count at which both counters restart after
 * `gap` steps without feedback. Returns the travel in counts that the odometry is off. */
static double off_by(int64_t at, int64_t per_step, int gap, bool reports)
{
    base b = begun(32);
    for (int j = 0; j < 2; j++) {
        b.config.joint[j].velocity_max_rad_s = 1000.0; /* nothing bounds it */
        b.config.joint[j].velocity_min_rad_s = -1000.0;
    }
    odometry_init(&b.state, &b.config);
    double reported_rad_s = reports ? (double)per_step * COUNT_RAD / 0.01 : (double)NAN;
    received(&b, STEP_NS, at - 10 * per_step, reported_rad_s);
    for (int step = 0; step < 10; step++) {
        received(&b, STEP_NS, per_step, reported_rad_s);
    }
    CHECK(b.state.joint[0].jumps == 0);
    for (int j = 0; j < 2; j++) {
        b.feedback[j].count = 0;
    }
    received(&b, (1 + gap) * STEP_NS, 0, reported_rad_s);
    CHECK(b.state.joint[0].jumps == 1 && b.state.degraded == 1);
    for (int step = 0; step < 10; step++) {
        received(&b, STEP_NS, per_step, reported_rad_s);
    }
    CHECK(b.state.joint[0].jumps == 1 && b.state.degraded == 0);
    double true_m = (double)((21 + gap) * per_step) * COUNT_RAD * 0.1;
    return fabs(b.state.x_m - true_m) / (COUNT_RAD * 0.1);
}

static void a_restart_in_motion_costs_at_most_the_travel_of_the_gap(void)
{
    const int64_t at[] = {500, 3000, 30000, -500, -3000, -30000};
    for (int i = 0; i < 6; i++) {
        for (int gap = 0; gap <= 20; gap += 5) {
            for (int reports = 0; reports < 2; reports++) {
                for (int64_t per_step = -20; per_step <= 20; per_step += 10) {
                    if (per_step == 0 && reports == 0) {
                        continue; /* nothing shows that it stands */
                    }
                    double gap_s = 0.01 * (1 + gap), turned_rad = 100.0 * gap_s * gap_s;
                    if (4.0 + (double)(2 * llabs(per_step) * (1 + gap)) + turned_rad / COUNT_RAD >=
                        (double)llabs(at[i])) {
                        continue; /* the wheel may have turned there */
                    }
                    double off = off_by(at[i], per_step, gap, reports != 0);
                    CHECK(off <= (double)(llabs(per_step) * (1 + gap)) + 1e-6);
                }
            }
        }
    }
}

/* It turns through zero, forward and backward, and reverses there. */
static void motion_through_zero_is_no_restart(void)
{
    for (int reports = 0; reports < 2; reports++) {
        base b = begun(32);
        int64_t speed = 0;
        for (int step = 0; step < 2000; step++) {
            speed += step / 100 % 4 == 0 || step / 100 % 4 == 3 ? 1 : -1;
            double now_rad_s = (double)speed * COUNT_RAD / 0.01;
            received(&b, STEP_NS, speed, reports ? now_rad_s : (double)NAN);
            CHECK(b.state.joint[0].jumps == 0 && (step == 0 || b.state.degraded == 0));
        }
    }
}

int main(void)
{
    a_restart_in_motion_costs_at_most_the_travel_of_the_gap();
    motion_through_zero_is_no_restart();
    return checks_report("test_restart");
}
