/* SPDX-License-Identifier: Apache-2.0
 * test_core_rest: the robot is at rest only when that was seen. What is not seen is unknown, and no
 * last value stands for it. */
#include "core_rig.h"

/* Do one tick in which joint j has sent nothing for `age_ns`; the others stand still. */
static const rest_shown *tick_without(rig *r, uint32_t j, int64_t age_ns)
{
    prepare(r);
    r->input.feedback[j].stamp_ns = age_ns == NEVER ? 0 : r->input.now_ns - age_ns;
    return &step(r)->rest;
}

static void a_joint_that_is_not_seen_leaves_the_rest_unknown_and_since_when(void)
{
    core_config config = good_config();
    for (uint32_t j = 0; j < 4; j++) {
        rig r;
        ready(&r, &config);
        CHECK(r.shown.rest.rest == REST_AT_REST && r.shown.at_rest == 1);
        CHECK(tick_without(&r, j, 250 * MS_NS)->rest == REST_AT_REST);
        CHECK(tick_without(&r, j, 251 * MS_NS)->rest == REST_UNKNOWN && r.shown.at_rest == 0);
        int64_t since_ns = r.input.now_ns;
        for (int i = 0; i < 5; i++) {
            CHECK(tick_without(&r, j, NEVER)->rest_unknown_since_ns[j] == since_ns);
            CHECK(r.shown.rest.rest_unknown_since_ns[(j + 1) % 4] == 0);
        }
        ticks(&r, 3);
        CHECK(r.shown.rest.rest == REST_AT_REST && r.shown.rest.rest_unknown_since_ns[j] == 0);
    }
}

static void before_the_first_feedback_nothing_is_known(void)
{
    core_config config = good_config();
    rig r;
    start(&r, &config);
    r.stale = true;
    CHECK(tick(&r)->rest.rest == REST_UNKNOWN && r.shown.at_rest == 0);
    for (uint32_t j = 0; j < JOINTS_MAX; j++) {
        CHECK((r.shown.rest.rest_unknown_since_ns[j] != 0) == (j < 4));
    }
    CHECK(isnan(r.shown.linear_m_s) && isnan(r.shown.angular_rad_s));
}

static void a_wheel_that_is_seen_to_turn_outranks_one_that_is_not_seen(void)
{
    core_config config = good_config();
    rig r;
    ready(&r, &config);
    prepare(&r);
    r.input.feedback[0].stamp_ns = 0;
    r.input.feedback[1].velocity_rad_s = 1.0;
    CHECK(step(&r)->rest.rest == REST_TURNING && r.shown.rest.rest_unknown_since_ns[0] != 0);
    CHECK(tick_without(&r, 0, NEVER)->rest == REST_UNKNOWN);
}

static void a_number_that_is_missing_is_unknown_where_the_joint_measures(void)
{
    core_config config = good_config();
    for (int j = 0; j < 4; j++) {
        config.joint[j].counter_bits = 0;
    }
    config.joint[2].unmeasured = 1;
    rig r;
    ready(&r, &config);
    CHECK(r.shown.rest.rest_unmeasured == 1U << 2);
    for (int j = 0; j < 4; j++) {
        prepare(&r);
        r.input.feedback[j].velocity_rad_s = NAN;
        CHECK(step(&r)->rest.rest == (j == 2 ? REST_AT_REST : REST_UNKNOWN));
        tick(&r);
    }
    r.input.control.armed = 1; /* the set-point of what is not measured counts */
    tick(&r);
    r.input.command.linear_m_s = 0.3;
    CHECK(ticks(&r, 3)->rest.rest == REST_TURNING);
}

static void feedback_that_is_not_trusted_shows_no_rest_until_the_reset(void)
{
    core_config config = good_config();
    for (int j = 0; j < 4; j++) {
        config.joint[j].plausible = finds_a_stall();
    }
    rig r;
    start(&r, &config);
    go(&r, 0.3, 0.0);
    for (int ms = 0; ms < 3000 && r.shown.faults == 0; ms++) {
        r.position_rad[1] -= r.out.joint[1].velocity_rad_s * 1e-3; /* shows a wheel that stands */
        tick(&r);
        r.input.feedback[1].velocity_rad_s = 0.0;
    }
    CHECK(r.shown.faults == FAULT_STALL);
    r.input.command.linear_m_s = 0.0;
    ticks(&r, 3000);
    CHECK(zero(&r) && r.out.enabled == 0 && r.shown.rest.rest == REST_UNKNOWN);
    CHECK(r.shown.rest.rest_unknown_since_ns[1] != 0 && r.shown.rest.rest_unknown_since_ns[0] == 0);
    r.input.control.armed = 0;
    r.input.control.reset_count++;
    CHECK(tick(&r)->faults == 0 && r.shown.rest.rest == REST_AT_REST);
}

static void no_last_value_stands_for_what_is_not_measured_any_more(void)
{
    core_config config = good_config();
    rig r;
    start(&r, &config);
    go(&r, 0.3, 0.2);
    for (uint32_t j = 0; j < 4; j++) {
        r.input.feedback[j].current_a = r.input.feedback[j].voltage_v = 24.0;
        r.input.feedback[j].temperature_c = 30.0;
    }
    tick(&r);
    CHECK(r.shown.joint[0].current_a == 24.0 && r.shown.linear_m_s > 0.2);
    r.stale = true;
    ticks(&r, 260);
    for (uint32_t j = 0; j < 4; j++) {
        const joint_state *joint = &r.shown.joint[j];
        CHECK(joint->stale == 1 && joint->enabled == 2 && joint->feedback_age_s > 0.25);
        CHECK(isnan(joint->position_rad) && isnan(joint->velocity_rad_s));
        CHECK(isnan(joint->current_a) && isnan(joint->voltage_v) && isnan(joint->temperature_c));
    }
    CHECK(isnan(r.shown.linear_m_s) && isnan(r.shown.angular_rad_s) &&
          isnan(r.shown.lateral.lateral_m_s) && isnan(r.shown.lateral.slip_m_s));
    CHECK(isfinite(r.shown.x_m) && isfinite(r.shown.heading_rad));
    r.stale = false;
    ticks(&r, 5);
    CHECK(isfinite(r.shown.linear_m_s) && isfinite(r.shown.joint[3].position_rad) &&
          r.shown.joint[0].voltage_v == 24.0);
}

static void power_that_is_to_go_off_does_not_wait_for_a_rest_that_nobody_sees(void)
{
    core_config config = good_config();
    rig r;
    ready(&r, &config);
    CHECK(core_may_power_off(&r.state, r.input.now_ns));
    go(&r, 0.3, 0.0);
    CHECK(!core_may_power_off(&r.state, r.input.now_ns));
    r.input.command.linear_m_s = 0.0;
    for (int j = 0; j < 4; j++) {
        r.state.config.joint[j].counter_bits = 0;
    }
    int ms = 0;
    for (; ms < 5000 && !core_may_power_off(&r.state, r.input.now_ns); ms++) {
        prepare(&r);
        r.input.feedback[3].velocity_rad_s = 1.0;
        step(&r);
    }
    CHECK(ms > 2000 && ms < 3000 && r.shown.rest.rest == REST_TURNING && r.shown.armed == 1);
}

int main(void)
{
    a_joint_that_is_not_seen_leaves_the_rest_unknown_and_since_when();
    before_the_first_feedback_nothing_is_known();
    a_wheel_that_is_seen_to_turn_outranks_one_that_is_not_seen();
    a_number_that_is_missing_is_unknown_where_the_joint_measures();
    feedback_that_is_not_trusted_shows_no_rest_until_the_reset();
    no_last_value_stands_for_what_is_not_measured_any_more();
    power_that_is_to_go_off_does_not_wait_for_a_rest_that_nobody_sees();
    return checks_report("test_core_rest");
}
