/* SPDX-License-Identifier: Apache-2.0
 * test_watch_rare: several causes in one tick, a second fault after a first one, and requests in
 * the middle of a move. */
#include "core_rig.h"

static void all_causes_of_one_tick_are_reported(void)
{
    core_config config = good_config();
    rig r;
    start(&r, &config);
    go(&r, 0.4, 0.0);
    prepare(&r);
    r.input.control.estop = r.input.control.fault = 1;
    r.input.control.heartbeat_ns = 0;
    r.input.feedback[0].stamp_ns = 0;
    r.input.feedback[1].drive_faults = 8;
    r.input.feedback[2].enabled = 0;
    core_step(&r.state, &r.input, 0.0, &r.out, &r.shown);
    CHECK(r.shown.faults ==
          (FAULT_ESTOP | FAULT_EXTERNAL | FAULT_HEARTBEAT_LOST | FAULT_FEEDBACK_STALE |
           FAULT_DRIVE | FAULT_DRIVE_DISABLED | FAULT_TIME_STEP));
    CHECK(zero(&r) && r.shown.armed == 0);
}

/* If one cause persists, all latched faults stay. */
static void a_reset_during_an_emergency_stop_clears_nothing(void)
{
    core_config config = good_config();
    rig r;
    start(&r, &config);
    go(&r, 0.4, 0.0);
    r.input.control.estop = r.input.control.fault = 1;
    tick(&r);
    r.input.control.fault = 0;
    r.input.command.linear_m_s = 0.0;
    CHECK(ticks(&r, 5)->at_rest == 1);
    r.input.control.reset_count++;
    CHECK(ticks(&r, 2)->faults == (FAULT_ESTOP | FAULT_EXTERNAL));
    r.input.control.estop = 0;
    r.input.control.fault = 1;
    r.input.control.reset_count++;
    CHECK(ticks(&r, 2)->faults == (FAULT_ESTOP | FAULT_EXTERNAL));
    r.input.control.fault = 0;
    r.input.control.reset_count++;
    CHECK(tick(&r)->faults == 0);
}

/* While the wheels keep turning, the brake has its power for the whole time, exact to 1 ns, also in
 * a second fault. */
static void each_brake_holds_its_power_for_two_seconds(void)
{
    core_config config = good_config();
    config.on_fault = STOP_BRAKE;
    for (int j = 0; j < 4; j++) {
        config.joint[j].counter_bits = 0;
    }
    rig r;
    start(&r, &config);
    for (int fault = 0; fault < 2; fault++) {
        go(&r, 0.3, 0.0);
        r.input.control.fault = 1;
        prepare(&r);
        int64_t zero_ns = r.input.now_ns;
        for (int j = 0; j < 4; j++) {
            r.input.feedback[j].velocity_rad_s = 3.0;
        }
        CHECK(step(&r)->faults == FAULT_EXTERNAL && zero(&r) && r.out.enabled == 1);
        for (int64_t after_ns = 200 * MS_NS; after_ns <= 2000 * MS_NS; after_ns += 200 * MS_NS) {
            r.input.now_ns = zero_ns + after_ns;
            for (int j = 0; j < 4; j++) {
                r.input.feedback[j].stamp_ns = r.input.now_ns;
            }
            CHECK(step(&r)->at_rest == 0 && r.out.enabled == 1);
        }
        r.input.now_ns += 1;
        CHECK(step(&r)->at_rest == 0 && r.out.enabled == 0);
        r.input.control.fault = r.input.control.armed = 0;
        r.input.command.linear_m_s = 0.0;
        ticks(&r, 2);
        r.input.control.reset_count++;
        CHECK(tick(&r)->faults == 0);
    }
}

/* No feedback arrives. The tick in which the last one is too old reports that. */
static void feedback_that_grows_old_is_stale_in_the_tick_in_which_it_is(void)
{
    core_config config = good_config();
    rig r;
    ready(&r, &config);
    int64_t received_ns = r.input.now_ns;
    r.input.now_ns = received_ns + 250 * MS_NS;
    CHECK(step(&r)->joint[2].stale == 0 && r.shown.odometry_degraded == 0);
    r.input.now_ns += 1;
    CHECK(step(&r)->joint[2].stale == 1 && r.shown.odometry_degraded == 1);
}

static void the_pose_is_zero_in_the_tick_of_the_reset_and_the_base_keeps_moving(void)
{
    core_config config = good_config();
    rig r;
    start(&r, &config);
    go(&r, 0.4, 0.0);
    CHECK(r.shown.x_m > 0.1);
    r.stale = true;
    r.input.control.odometry_reset_count = 1;
    r.input.control.reset_count = 3; /* no fault is latched */
    CHECK(tick(&r)->odometry_epoch == 1 && r.shown.x_m == 0.0);
    CHECK(r.shown.setpoint_linear_m_s == 0.4 && r.shown.reasons == 0 && r.shown.faults == 0);
}

static void limits_that_differ_in_one_bit_are_different_limits(void)
{
    core_config config = good_config();
    rig r;
    start(&r, &config);
    r.input.control.limits.linear.velocity_u_s = 0.5;
    go(&r, 0.8, 0.0);
    CHECK(r.shown.setpoint_linear_m_s == 0.5);
    r.input.control.limits.linear.velocity_u_s = nextafter(0.5, 1.0);
    CHECK(ticks(&r, 100)->setpoint_linear_m_s == nextafter(0.5, 1.0));
    r.input.control.limits.linear.velocity_u_s = 0.5;
    CHECK(ticks(&r, 100)->setpoint_linear_m_s == 0.5);
}

/* A drive of no joint of the base, and a wheel whose drive reported "off" before the arming, cause
 * no fault. */
static void a_drive_outside_of_the_base_causes_no_fault(void)
{
    core_config config = good_config();
    rig r;
    ready(&r, &config);
    r.input.control.armed = 1;
    prepare(&r);
    CHECK(step(&r)->armed == 1);
    int64_t armed_ns = r.input.now_ns;
    prepare(&r);
    r.input.feedback[3].enabled = 0;
    r.input.feedback[3].stamp_ns = armed_ns;
    r.input.feedback[4] = (joint_feedback){.stamp_ns = r.input.now_ns, .enabled = 0};
    CHECK(step(&r)->faults == 0 && r.shown.armed == 1);
}

int main(void)
{
    all_causes_of_one_tick_are_reported();
    a_reset_during_an_emergency_stop_clears_nothing();
    each_brake_holds_its_power_for_two_seconds();
    feedback_that_grows_old_is_stale_in_the_tick_in_which_it_is();
    the_pose_is_zero_in_the_tick_of_the_reset_and_the_base_keeps_moving();
    limits_that_differ_in_one_bit_are_different_limits();
    a_drive_outside_of_the_base_causes_no_fault();
    return checks_report("test_watch_rare");
}
