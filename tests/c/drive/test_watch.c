/* SPDX-License-Identifier: Apache-2.0
 * test_watch: when the base may move, and how a move ends. Each row of a table is one changed field
 * of the input and its effect. */
#include "core_rig.h"

static const change ARMING[] = {
    LEVEL_OF(reserved, 0, 1),
    NUMBER_OF(command.linear_m_s, 1e-9, 0),
    NUMBER_OF(command.linear_m_s, -1e-9, 0),
    NUMBER_OF(command.linear_m_s, 0.99e-9, 1),
    NUMBER_OF(command.angular_rad_s, 1e-9, 0),
    NUMBER_OF(command.angular_rad_s, -0.99e-9, 1),
    NUMBER_OF(command.linear_m_s, NAN, 0),
    NUMBER_OF(command.angular_rad_s, INFINITY, 0),
    AGE_OF(control.heartbeat_ns, 500000000, 1),
    AGE_OF(control.heartbeat_ns, 500000001, 0),
    AGE_OF(control.heartbeat_ns, -10000000, 1),
    AGE_OF(control.heartbeat_ns, -10000001, 0),
    AGE_OF(control.heartbeat_ns, NEVER, 0),
    AGE_OF(feedback[3].stamp_ns, 250000000, 1),
    AGE_OF(feedback[3].stamp_ns, 250000001, 0),
    AGE_OF(feedback[0].stamp_ns, -10000000, 1),
    AGE_OF(feedback[0].stamp_ns, -10000001, 0),
    AGE_OF(feedback[1].stamp_ns, NEVER, 0),
    LEVEL_OF(feedback[3].drive_faults, 1, 0),
    LEVEL_OF(feedback[0].drive_faults, 0x80000000, 0),
    LEVEL_OF(feedback[2].enabled, 0, 1),
    LEVEL_OF(control.stop, 1, 0),
    LEVEL_OF(control.estop, 1, 0),
    LEVEL_OF(control.fault, 1, 0),
    LEVEL_OF(control.armed, 0, 0),
    LEVEL_OF(suspended, 1, 0),
};

static void arming_needs_everything_in_the_tick_of_the_edge(void)
{
    core_config config = good_config();
    for (int i = 0; i < COUNT_OF(ARMING); i++) {
        rig r;
        ready(&r, &config);
        r.input.control.armed = 1;
        step_with(&r, &ARMING[i]);
        CHECK(r.shown.armed == ARMING[i].expected && r.shown.enabled == r.shown.armed &&
              r.out.enabled == r.shown.armed);
        CHECK(((r.shown.reasons & REASON_NOT_ARMED) != 0) == !r.shown.armed && zero(&r));
        /* faults of drives and heartbeat are latched only if the base is armed */
        uint32_t latched = (r.input.control.estop ? (uint32_t)FAULT_ESTOP : 0) |
                           (r.input.control.fault ? (uint32_t)FAULT_EXTERNAL : 0) |
                           (r.input.suspended ? (uint32_t)FAULT_SUSPENDED : 0);
        CHECK(r.shown.faults == latched);
        if (r.shown.armed || !r.input.control.armed) {
            continue;
        }
        /* when everything is good again, the base is not armed before another edge */
        r.input.control.stop = r.input.control.estop = r.input.control.fault = r.input.suspended =
            0;
        r.input.command.linear_m_s = r.input.command.angular_rad_s = 0.0;
        for (int j = 0; j < 4; j++) {
            r.input.feedback[j].drive_faults = 0;
        }
        r.input.control.reset_count++;
        prepare(&r);
        CHECK(step(&r)->armed == 0 && r.shown.faults == 0);
        prepare(&r);
        r.input.control.armed = 0;
        CHECK(step(&r)->armed == 0);
        prepare(&r);
        r.input.control.armed = 1;
        CHECK(step(&r)->armed == 1);
    }
}

/* A command that is too old cannot move the base, so it does not prevent arming. */
static void a_stale_command_arms_and_moves_nothing(void)
{
    static const change STALE[] = {
        AGE_OF(command.stamp_ns, 300000000, 0), AGE_OF(command.stamp_ns, 300000001, 1),
        AGE_OF(command.stamp_ns, -10000000, 0), AGE_OF(command.stamp_ns, -10000001, 1),
        AGE_OF(command.stamp_ns, NEVER, 1),     AGE_OF(command.expires_ns, 0, 0),
        AGE_OF(command.expires_ns, 1, 1),
    };
    core_config config = good_config();
    for (int i = 0; i < COUNT_OF(STALE); i++) {
        rig r;
        ready(&r, &config);
        r.input.control.armed = 1;
        r.input.command.linear_m_s = 0.5;
        step_with(&r, &STALE[i]);
        CHECK(r.shown.armed == STALE[i].expected);
        CHECK(((r.shown.reasons & REASON_COMMAND_STALE) != 0) == STALE[i].expected);
        CHECK(r.shown.wanted_linear_m_s == (STALE[i].expected ? 0.0 : 0.5));
        for (int times = 0; times < 50; times++) {
            CHECK(step_with(&r, &STALE[i])->setpoint_linear_m_s == 0.0 && zero(&r));
        }
    }
}

static const change FAULTS_WHILE_ARMED[] = {
    LEVEL_OF(reserved, 0, 0),
    LEVEL_OF(control.estop, 1, FAULT_ESTOP),
    LEVEL_OF(control.fault, 1, FAULT_EXTERNAL),
    LEVEL_OF(suspended, 1, FAULT_SUSPENDED),
    AGE_OF(control.heartbeat_ns, 500000000, 0),
    AGE_OF(control.heartbeat_ns, 500000001, FAULT_HEARTBEAT_LOST),
    AGE_OF(control.heartbeat_ns, -10000001, FAULT_HEARTBEAT_LOST),
    AGE_OF(feedback[3].stamp_ns, 250000000, 0),
    AGE_OF(feedback[3].stamp_ns, 250000001, FAULT_FEEDBACK_STALE),
    AGE_OF(feedback[0].stamp_ns, -10000000, 0),
    AGE_OF(feedback[0].stamp_ns, -10000001, FAULT_FEEDBACK_STALE),
    AGE_OF(feedback[1].stamp_ns, NEVER, FAULT_FEEDBACK_STALE),
    LEVEL_OF(feedback[2].drive_faults, 4, FAULT_DRIVE),
    LEVEL_OF(feedback[0].enabled, 0, FAULT_DRIVE_DISABLED),
    LEVEL_OF(feedback[3].enabled, 0, FAULT_DRIVE_DISABLED),
    LEVEL_OF(feedback[3].enabled, 2, 0),
};

static void each_cause_latches_its_fault_at_once_in_motion_or_during_a_stop(void)
{
    for (int action = STOP_RAMP; action <= STOP_COAST; action++) {
        for (int stopped = 0; stopped < 2; stopped++) {
            for (int i = 0; i < COUNT_OF(FAULTS_WHILE_ARMED); i++) {
                rig r;
                core_config config = good_config();
                config.on_fault = config.on_estop = (stop_action)action;
                start(&r, &config);
                go(&r, 0.4, 0.1);
                r.input.control.stop = (uint32_t)stopped;
                uint32_t expected = FAULTS_WHILE_ARMED[i].expected;
                double before_m_s = r.shown.setpoint_linear_m_s;
                step_with(&r, &FAULTS_WHILE_ARMED[i]);
                CHECK(r.shown.faults == expected && r.shown.armed == (expected == 0));
                CHECK(((r.shown.reasons & REASON_FAULT) != 0) == (expected != 0));
                CHECK(((r.shown.reasons & REASON_STOP_REQUESTED) != 0) == stopped);
                CHECK(r.out.enabled == (expected == 0 || action != STOP_COAST) &&
                      r.out.enabled == r.shown.enabled);
                if (expected == 0) {
                    continue;
                }
                bool at_once =
                    action >= STOP_COAST || action == STOP_BRAKE || expected == FAULT_SUSPENDED;
                CHECK(zero(&r) == at_once);
                for (int j = 0; j < 4; j++) {
                    CHECK(r.shown.joint[j].setpoint_rad_s == r.out.joint[j].velocity_rad_s &&
                          r.shown.joint[j].duty == r.out.joint[j].duty);
                }
                /* without a jerk limit: the full deceleration in the first tick */
                CHECK(at_once || fabs(before_m_s - r.shown.setpoint_linear_m_s - 1.5e-3) < 1e-9);
            }
        }
    }
}

static void a_suspend_and_a_bad_time_step_are_reported_without_their_consequences(void)
{
    static const double BAD_S[] = {0.0, -1e-3, NAN, INFINITY, -INFINITY};
    core_config config = good_config();
    rig r;
    start(&r, &config);
    go(&r, 0.4, 0.1);
    prepare(&r);
    r.input.suspended = r.input.control.fault = r.input.control.estop = 1;
    r.input.control.heartbeat_ns = r.input.feedback[0].stamp_ns = 0;
    CHECK(step(&r)->faults == (FAULT_SUSPENDED | FAULT_ESTOP) && zero(&r));
    for (int i = 0; i < 5; i++) {
        start(&r, &config);
        go(&r, 0.4, 0.1);
        prepare(&r);
        core_step(&r.state, &r.input, BAD_S[i], &r.out, &r.shown);
        CHECK(r.shown.faults == FAULT_TIME_STEP && r.shown.dt_s == 0.0 && zero(&r) &&
              r.shown.armed == 0);
    }
    /* after a pause the ramp continues by 0.1 s */
    config.limits.linear = (axis_limits){10.0, 1.0, 1.5, INFINITY};
    start(&r, &config);
    tick(&r);
    r.input.control.armed = 1;
    tick(&r);
    prepare(&r);
    r.input.command.linear_m_s = 0.5;
    core_step(&r.state, &r.input, 0.2, &r.out, &r.shown);
    CHECK(fabs(r.shown.setpoint_linear_m_s - 0.1) < 1e-12 && r.shown.dt_s == 0.2 &&
          r.shown.faults == 0);
    prepare(&r);
    core_step(&r.state, &r.input, 0.05, &r.out, &r.shown);
    CHECK(fabs(r.shown.setpoint_linear_m_s - 0.15) < 1e-12);
}

/* Feedback from before the arming does not show that the drive lost its power later. */
static void a_drive_that_is_off_counts_only_after_the_base_is_armed(void)
{
    core_config config = good_config();
    rig r;
    ready(&r, &config);
    r.input.control.armed = 1;
    r.input.feedback[1].enabled = 0;
    prepare(&r);
    CHECK(step(&r)->armed == 1);
    int64_t armed_ns = r.input.now_ns;
    prepare(&r);
    r.input.feedback[1].stamp_ns = armed_ns;
    CHECK(step(&r)->faults == 0 && r.shown.armed == 1);
    prepare(&r);
    r.input.feedback[1].stamp_ns = armed_ns + 1;
    CHECK(step(&r)->faults == FAULT_DRIVE_DISABLED);
}

static void feedback_is_counted_as_received_with_its_time(void)
{
    core_config config = good_config();
    rig r;
    start(&r, &config);
    CHECK(r.state.stale[0] == 0);
    prepare(&r);
    r.input.feedback[0].stamp_ns = 0;
    r.input.feedback[1].stamp_ns = r.input.now_ns + MS_NS;
    r.input.feedback[2].stamp_ns = r.input.now_ns - 7 * MS_NS;
    r.input.feedback[3].stamp_ns = r.input.now_ns - 251 * MS_NS;
    step(&r);
    CHECK(isinf(r.shown.joint[0].feedback_age_s) && r.shown.joint[0].stale == 1 &&
          r.shown.joint[0].enabled == 2);
    CHECK(isnan(r.shown.joint[0].voltage_v) && isnan(r.shown.joint[0].current_a) &&
          isnan(r.shown.joint[0].temperature_c));
    CHECK(r.shown.joint[1].feedback_age_s == 0.0 && r.shown.joint[1].stale == 0 &&
          r.shown.joint[1].enabled == 1);
    CHECK(fabs(r.shown.joint[2].feedback_age_s - 0.007) < 1e-12 && r.shown.joint[2].stale == 0);
    CHECK(fabs(r.shown.joint[3].feedback_age_s - 0.251) < 1e-12 && r.shown.joint[3].stale == 1);
    CHECK(r.shown.joint[1].voltage_v == 0.0 && r.shown.odometry_degraded == 1);
    prepare(&r);
    step(&r);
    for (int j = 0; j < 4; j++) {
        CHECK(r.shown.joint[j].stale == 0 && r.shown.joint[j].feedback_age_s == 0.0);
    }
    prepare(&r);
    r.input.command.stamp_ns = r.input.now_ns - 40 * MS_NS;
    CHECK(fabs(step(&r)->command_age_s - 0.04) < 1e-12);
    r.input.command.stamp_ns = r.input.now_ns + MS_NS;
    CHECK(step(&r)->command_age_s == 0.0);
    r.input.command.stamp_ns = 0;
    CHECK(isinf(step(&r)->command_age_s));
}

static const change RESETS[] = {
    LEVEL_OF(reserved, 0, 1),
    LEVEL_OF(control.estop, 1, 0),
    LEVEL_OF(control.fault, 1, 0),
    LEVEL_OF(feedback[0].drive_faults, 1, 0),
    AGE_OF(feedback[2].stamp_ns, 250000001, 0),
    AGE_OF(control.heartbeat_ns, NEVER, 1),
    NUMBER_OF(command.linear_m_s, 0.1, 0),
    NUMBER_OF(command.angular_rad_s, -0.1, 0),
    NUMBER_OF(command.linear_m_s, NAN, 0),
    LEVEL_OF(control.stop, 1, 1),
    LEVEL_OF(feedback[0].enabled, 0, 1),
};

static void a_reset_clears_faults_when_every_cause_is_gone_and_never_arms(void)
{
    core_config config = good_config();
    for (int i = 0; i < COUNT_OF(RESETS); i++) {
        rig r;
        start(&r, &config);
        go(&r, 0.2, 0.0);
        r.input.control.estop = 1;
        tick(&r);
        r.input.control.estop = 0;
        r.input.command.linear_m_s = 0.0;
        CHECK(ticks(&r, 5)->faults == FAULT_ESTOP && r.shown.at_rest == 1);
        r.input.control.reset_count++;
        step_with(&r, &RESETS[i]);
        CHECK((r.shown.faults == 0) == RESETS[i].expected && r.shown.armed == 0 && zero(&r));
        prepare(&r);
        CHECK(step(&r)->armed == 0 && r.out.enabled == 0);
    }
    rig r;
    start(&r, &config);
    go(&r, 0.4, 0.0);
    r.input.control.fault = 1;
    tick(&r);
    r.input.control.fault = 0;
    r.input.command.linear_m_s = 0.0;
    r.input.control.reset_count++;
    /* the base is still on its ramp */
    CHECK(tick(&r)->faults == FAULT_EXTERNAL && r.shown.setpoint_linear_m_s > 0.3);
    ticks(&r, 1000);
    CHECK(r.shown.faults == FAULT_EXTERNAL && r.shown.at_rest == 1); /* each count is one request */
    prepare(&r);
    r.input.feedback[1].velocity_rad_s = 0.05;
    CHECK(step(&r)->at_rest == 0);
    r.input.control.reset_count++;
    CHECK(tick(&r)->faults == FAULT_EXTERNAL && r.shown.at_rest == 1); /* a wheel was turning in the
                                                                          last tick */
    r.input.control.reset_count++;
    CHECK(tick(&r)->faults == 0);
}

static void limits_replace_each_other_as_a_group_or_not_at_all(void)
{
    core_config config = good_config();
    rig r;
    start(&r, &config);
    go(&r, 0.6, 0.0);
    CHECK(r.shown.setpoint_linear_m_s == 0.6 && (r.shown.reasons & REASON_LINEAR_VELOCITY) == 0);
    r.input.command.linear_m_s = 0.3;
    CHECK(ticks(&r, 1000)->setpoint_linear_m_s == 0.3);
    r.input.command.angular_rad_s = 0.2;
    CHECK(ticks(&r, 1000)->setpoint_angular_rad_s == 0.2);
    r.input.command.linear_m_s = 0.6, r.input.command.angular_rad_s = 0.0;
    CHECK(ticks(&r, 1000)->setpoint_linear_m_s == 0.6);
    r.input.control.limits.linear.velocity_u_s = 0.2;
    CHECK(ticks(&r, 1000)->setpoint_linear_m_s == 0.2 &&
          (r.shown.reasons & REASON_LINEAR_VELOCITY));
    r.input.control.limits.linear.velocity_u_s = 0.5;
    r.input.control.limits.angular.jerk_u_s3 = NAN;
    CHECK(ticks(&r, 1000)->setpoint_linear_m_s == 0.2 && r.shown.faults == 0);
    r.input.control.limits.angular.jerk_u_s3 = 30.0;
    CHECK(ticks(&r, 1000)->setpoint_linear_m_s == 0.5);
    r.input.control.limits.angular.velocity_u_s = 0.3;
    r.input.command.angular_rad_s = -0.4;
    CHECK(ticks(&r, 1000)->setpoint_angular_rad_s == -0.3 &&
          (r.shown.reasons & REASON_ANGULAR_VELOCITY));
    CHECK(r.shown.wanted_angular_rad_s == -0.4 && r.shown.wanted_linear_m_s == 0.6 &&
          r.shown.saturation == 1.0);
}

static void in_a_curve_each_wheel_has_its_own_speed_and_duty(void)
{
    core_config config = good_config();
    rig r;
    ready(&r, &config);
    CHECK(r.shown.saturation == 1.0);
    for (int clamped = 0; clamped < 2; clamped++) {
        config.joint[0].pwm.duty_max = clamped ? 0.2 : 1.0;
        start(&r, &config);
        go(&r, 0.4, 0.1);
        CHECK(r.shown.reasons == (clamped ? (uint32_t)REASON_DUTY_CLAMPED : 0) &&
              r.shown.saturation == 1.0);
        for (int j = 0; j < 4; j++) {
            double speed_rad_s = (0.4 + (j % 2 == 0 ? -0.1 : 0.1) * 0.25) / 0.1;
            double duty = clamped && j == 0 ? 0.2 : 0.05 + speed_rad_s * 0.95 / 12.5;
            CHECK(fabs(r.out.joint[j].velocity_rad_s - speed_rad_s) < 1e-9 &&
                  fabs(r.out.joint[j].duty - duty) < 1e-9);
            CHECK(r.shown.joint[j].setpoint_rad_s == r.out.joint[j].velocity_rad_s);
            CHECK(r.shown.joint[j].duty == r.out.joint[j].duty);
        }
    }
}

int main(void)
{
    in_a_curve_each_wheel_has_its_own_speed_and_duty();
    arming_needs_everything_in_the_tick_of_the_edge();
    a_stale_command_arms_and_moves_nothing();
    each_cause_latches_its_fault_at_once_in_motion_or_during_a_stop();
    a_suspend_and_a_bad_time_step_are_reported_without_their_consequences();
    a_drive_that_is_off_counts_only_after_the_base_is_armed();
    feedback_is_counted_as_received_with_its_time();
    a_reset_clears_faults_when_every_cause_is_gone_and_never_arms();
    limits_replace_each_other_as_a_group_or_not_at_all();
    return checks_report("test_watch");
}
