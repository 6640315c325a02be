/* SPDX-License-Identifier: Apache-2.0
 * Derating by temperature, current and voltage: its factor, its smoothing, its effect on the base,
 * and its report on the state page with the time since which it holds. */
#include "core_rig.h"

static const derating_config HOT = {.range = {{60.0, 80.0}, {0.0, 0.0}, {0.0, 0.0}}};

static joint_feedback sample_of(double stamp_s, double temperature_c, double current_a,
                                double voltage_v)
{
    return (joint_feedback){.stamp_ns = (int64_t)(stamp_s * 1e9),
                            .temperature_c = temperature_c,
                            .current_a = current_a,
                            .voltage_v = voltage_v};
}

static bool near(double found, double wanted)
{
    return fabs(found - wanted) < 1e-9;
}

static void the_factor_falls_from_one_to_zero_and_names_its_cause(void)
{
    const derating_config all = {.range = {{60.0, 80.0}, {10.0, 20.0}, {22.0, 20.0}}};
    const struct {
        double temperature_c, current_a, voltage_v, factor;
        uint32_t by;
    } cases[] = {
        {60.0, 10.0, 22.0, 1.0, 9},
        {65.0, 0.0, 24.0, 0.75, DERATED_BY_TEMPERATURE},
        {79.0, 0.0, 24.0, 0.05, DERATED_BY_TEMPERATURE},
        {80.0, 0.0, 24.0, 0.0, DERATED_BY_TEMPERATURE},
        {90.0, 0.0, 24.0, 0.0, DERATED_BY_TEMPERATURE},
        {65.0, -15.0, 24.0, 0.5, DERATED_BY_CURRENT},
        {65.0, 15.0, 20.5, 0.25, DERATED_BY_VOLTAGE},
        {-40.0, 0.0, 21.0, 0.5, DERATED_BY_VOLTAGE},
        {(double)NAN, (double)INFINITY, (double)NAN, 1.0, 9},
    };
    for (size_t i = 0; i < sizeof cases / sizeof cases[0]; i++) {
        derating_state state = {0};
        uint32_t by = 9;
        joint_feedback feedback =
            sample_of(1.0, cases[i].temperature_c, cases[i].current_a, cases[i].voltage_v);
        CHECK(near(derating_factor(&state, &all, &feedback, &by), cases[i].factor) &&
              by == cases[i].by);
    }
    CHECK(derating_used(&all) && derating_used(&HOT) && !derating_used(&(derating_config){0}));
    derating_state state = {0}; /* measures without a range do not derate */
    uint32_t by = 9;
    joint_feedback feedback = sample_of(1.0, 65.0, 1000.0, -5.0);
    CHECK(near(derating_factor(&state, &HOT, &feedback, &by), 0.75) &&
          by == DERATED_BY_TEMPERATURE);
}

static void a_measure_is_smoothed_and_nan_changes_nothing(void)
{
    derating_state state = {0};
    uint32_t by = 0;
    joint_feedback feedback = sample_of(1.0, 60.0, 0.0, 0.0);
    CHECK(derating_factor(&state, &HOT, &feedback, &by) == 1.0);
    feedback = sample_of(1.25, 70.0, 0.0, 0.0);
    CHECK(near(derating_factor(&state, &HOT, &feedback, &by), 1.0 - 0.1) &&
          near(state.measured[0], 62.0));
    CHECK(near(derating_factor(&state, &HOT, &feedback, &by), 0.9)); /* the same sample again */
    feedback = sample_of(1.5, (double)NAN, 0.0, 0.0);
    CHECK(near(derating_factor(&state, &HOT, &feedback, &by), 0.9));
    feedback = sample_of(1.0, 60.0, 0.0, 0.0); /* an older sample */
    CHECK(near(derating_factor(&state, &HOT, &feedback, &by), 0.9));
    const derating_config sagging = {.range = {{0.0, 0.0}, {0.0, 0.0}, {22.0, 20.0}}};
    derating_state never = {0};
    feedback = sample_of(0.0, 0.0, 0.0, 0.0); /* from a drive that has sent nothing: 0 V is not
                                                 measured */
    CHECK(derating_factor(&never, &sagging, &feedback, &by) == 1.0);
    derating_state late = {0};
    feedback = sample_of(1.0, (double)NAN, 0.0, 0.0);
    CHECK(derating_factor(&late, &HOT, &feedback, &by) == 1.0);
    feedback = sample_of(1.1, 70.0, 0.0, 0.0); /* the first valid measure */
    CHECK(near(derating_factor(&late, &HOT, &feedback, &by), 0.5));
}

static void warm(rig *r, uint32_t joint, double temperature_c)
{
    for (uint32_t j = 0; j < r->config.joint_count; j++) {
        r->input.feedback[j].temperature_c = j == joint ? temperature_c : 20.0;
    }
}

static void the_whole_twist_is_scaled_by_the_worst_joint_and_slows_down_by_its_deceleration(void)
{
    rig r;
    core_config config = good_config();
    config.joint[1].derating = config.joint[3].derating = HOT;
    start(&r, &config);
    warm(&r, 3, 20.0);
    go(&r, 0.5, 1.0);
    CHECK(r.shown.derating.since_ns == 0 && !(r.shown.reasons & REASON_DERATED) &&
          near(r.shown.setpoint_linear_m_s, 0.5));
    CHECK(r.shown.derating.factor == 1.0 && r.shown.derating.joint == 0 &&
          r.shown.derating.by == 0);
    warm(&r, 3, 72.0);
    int64_t before_ns = r.input.now_ns;
    double last_m_s = 0.5;
    for (int i = 0; i < 12000; i++) {
        tick(&r);
        CHECK(last_m_s - r.shown.setpoint_linear_m_s <= 1.5e-3 + 1e-9);
        /* the curvature is the same */
        CHECK(near(r.shown.setpoint_angular_rad_s, 2.0 * r.shown.setpoint_linear_m_s));
        last_m_s = r.shown.setpoint_linear_m_s;
    }
    double factor = r.shown.derating.factor;
    CHECK(fabs(factor - 0.4) < 1e-3 && r.shown.derating.joint == 3 &&
          r.shown.derating.by == DERATED_BY_TEMPERATURE);
    CHECK(r.shown.derating.since_ns > before_ns &&
          r.shown.derating.since_ns < before_ns + 9 * (int64_t)1000000000);
    CHECK(r.shown.reasons & REASON_DERATED &&
          fabs(r.shown.setpoint_linear_m_s - factor * 1.0) < 1e-3);
    CHECK(r.shown.reason.since_ns[25] > before_ns &&
          r.shown.reason.since_ns[25] < r.shown.stamp_ns);
    r.input.command.linear_m_s = 0.2; /* below the derated limit: as commanded */
    r.input.command.angular_rad_s = 0.0;
    ticks(&r, 1000);
    CHECK(near(r.shown.setpoint_linear_m_s, 0.2) && !(r.shown.reasons & REASON_DERATED) &&
          r.shown.reason.since_ns[25] == 0);
    warm(&r, 1, 90.0); /* another joint derates from now on, down to 0 */
    r.input.command.linear_m_s = -0.8;
    ticks(&r, 9000);
    CHECK(r.shown.derating.joint == 1 && r.shown.derating.factor == 0.0 &&
          r.shown.setpoint_linear_m_s == 0.0);
    CHECK(r.shown.armed == 1 && r.shown.faults == 0 && (r.shown.reasons & REASON_DERATED));
    warm(&r, 1, 20.0);
    ticks(&r, 9000);
    CHECK(r.shown.derating.since_ns == 0 && near(r.shown.setpoint_linear_m_s, -0.8));
}

static void
a_joint_without_a_range_derates_nothing_and_one_that_sends_nothing_keeps_its_factor(void)
{
    rig r;
    core_config config = good_config();
    config.joint[1].derating = HOT;
    start(&r, &config);
    warm(&r, 0, 200.0);
    go(&r, 0.5, 0.0);
    CHECK(r.shown.derating.since_ns == 0 && near(r.shown.setpoint_linear_m_s, 0.5));
    config = good_config();
    start(&r, &config);
    warm(&r, 1, 200.0);
    go(&r, 0.5, 0.0);
    CHECK(r.state.derates == 0 && r.shown.derating.since_ns == 0);
}

/* The joints are warm from the first sample on, so that smoothing changes nothing. The twist is
 * zero. */
static void begin_warm(rig *r, const core_config *config, double first_c, double second_c)
{
    start(r, config);
    warm(r, 0, first_c);
    r->input.feedback[1].temperature_c = second_c;
    ticks(r, 3);
}

static void the_joint_that_derates_most_is_named_with_its_time_and_the_first_among_equals(void)
{
    static const struct {
        double first_c, second_c, factor;
        uint32_t joint;
    } CASES[] = {{72.0, 20.0, 0.4, 0},
                 {20.0, 72.0, 0.4, 1},
                 {72.0, 72.0, 0.4, 0},
                 {70.0, 72.0, 0.4, 1},
                 {72.0, 70.0, 0.4, 0}};
    core_config config = good_config();
    config.joint[0].derating = config.joint[1].derating = HOT;
    rig r;
    for (size_t i = 0; i < sizeof CASES / sizeof CASES[0]; i++) {
        begin_warm(&r, &config, CASES[i].first_c, CASES[i].second_c);
        CHECK(near(r.shown.derating.factor, CASES[i].factor) &&
              r.shown.derating.joint == CASES[i].joint);
        /* since the first tick, not this one */
        CHECK(r.shown.derating.since_ns == r.input.now_ns - 2 * TICK_NS);
    }
    config.joint[1].derating = (derating_config){0}; /* only the first joint may derate */
    begin_warm(&r, &config, 72.0, 90.0);
    CHECK(near(r.shown.derating.factor, 0.4) && r.shown.derating.joint == 0);
}

static void derating_by_another_joint_or_measure_has_a_new_start_time(void)
{
    core_config config = good_config();
    config.joint[0].derating = config.joint[1].derating = HOT;
    config.joint[0].derating.range[DERATED_BY_CURRENT] = (derating_range){10.0, 20.0};
    rig r;
    begin_warm(&r, &config, 70.0, 20.0);
    CHECK(r.shown.derating.by == DERATED_BY_TEMPERATURE && r.shown.derating.joint == 0);
    r.input.feedback[0].current_a = 1e6; /* so high that it counts in one tick despite the
                                            smoothing */
    tick(&r);
    CHECK(r.shown.derating.by == DERATED_BY_CURRENT && r.shown.derating.joint == 0);
    CHECK(r.shown.derating.since_ns == r.input.now_ns && r.shown.derating.factor == 0.0);
    begin_warm(&r, &config, 70.0, 20.0);
    r.input.feedback[1].temperature_c = 1e6;
    tick(&r);
    CHECK(r.shown.derating.by == DERATED_BY_TEMPERATURE && r.shown.derating.joint == 1);
    CHECK(r.shown.derating.since_ns == r.input.now_ns && r.shown.derating.factor == 0.0);
}

/* The fault of the joint is its old feedback. */
static void old_feedback_of_a_joint_derates_nothing(void)
{
    core_config config = good_config();
    config.joint[0].derating = config.joint[1].derating = HOT;
    rig r;
    begin_warm(&r, &config, 72.0, 70.0);
    for (int ms = 0; ms < 300; ms++) {
        r.stale = true;
        for (int j = 1; j < 4; j++) {
            r.input.feedback[j].stamp_ns = r.input.now_ns + TICK_NS;
        }
        tick(&r);
    }
    CHECK(near(r.shown.derating.factor, 0.5) && r.shown.derating.joint == 1 &&
          r.shown.joint[0].stale == 1);
    ticks(&r, 300);
    CHECK(r.shown.derating.since_ns == 0 && r.shown.derating.factor == 1.0);
}

static void each_reason_has_its_start_time_and_a_saturated_wheel_is_named(void)
{
    rig r;
    core_config config = good_config();
    config.joint[2].velocity_max_rad_s = 3.0;
    start(&r, &config);
    tick(&r);
    CHECK(r.shown.reason.since_ns[16] == r.shown.stamp_ns);
    int64_t first_ns = r.shown.stamp_ns;
    ticks(&r, 10);
    CHECK(r.shown.reason.since_ns[16] == first_ns);
    go(&r, 0.5, 0.0);
    CHECK(r.shown.reasons == REASON_WHEEL_SATURATED && r.shown.reason.saturated_joint == 2);
    CHECK(r.shown.reason.since_ns[8] > first_ns && r.shown.reason.since_ns[16] == 0 &&
          r.shown.reason.since_ns[1] == 0);
    r.input.command.linear_m_s = 0.1;
    ticks(&r, 1000);
    CHECK(r.shown.reasons == 0 && r.shown.reason.since_ns[8] == 0);
}

static void a_range_is_finite_and_falls_in_its_direction(void)
{
    char name[FIELD_NAME_BYTES];
    for (int by = 0; by < DERATINGS; by++) {
        core_config config = good_config();
        config.joint[1].derating.range[by] =
            by == DERATED_BY_VOLTAGE ? (derating_range){20.0, 22.0} : (derating_range){80.0, 60.0};
        CHECK(core_config_check(&config, name) != NULL &&
              strcmp(name, "joint[1].derating.range") == 0);
        config.joint[1].derating.range[by] =
            by == DERATED_BY_VOLTAGE ? (derating_range){22.0, 20.0} : (derating_range){60.0, 80.0};
        CHECK(core_config_check(&config, name) == NULL);
        config.joint[1].derating.range[by].none = (double)NAN;
        CHECK(core_config_check(&config, name) != NULL);
        config.joint[1].derating.range[by] = (derating_range){(double)INFINITY, (double)INFINITY};
        CHECK(core_config_check(&config, name) != NULL);
    }
}

int main(void)
{
    the_factor_falls_from_one_to_zero_and_names_its_cause();
    a_measure_is_smoothed_and_nan_changes_nothing();
    the_whole_twist_is_scaled_by_the_worst_joint_and_slows_down_by_its_deceleration();
    a_joint_without_a_range_derates_nothing_and_one_that_sends_nothing_keeps_its_factor();
    the_joint_that_derates_most_is_named_with_its_time_and_the_first_among_equals();
    derating_by_another_joint_or_measure_has_a_new_start_time();
    old_feedback_of_a_joint_derates_nothing();
    each_reason_has_its_start_time_and_a_saturated_wheel_is_named();
    a_range_is_finite_and_falls_in_its_direction();
    return checks_report("test_derating");
}
