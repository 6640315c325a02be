/* SPDX-License-Identifier: Apache-2.0
 * test_core_following: joints that take positions and do not follow their set-points. */
#include "steered_bases.h"

static rig r;

static core_config watched(core_config config)
{
    for (uint32_t j = 0; j < config.joint_count; j++) {
        if (config.joint[j].position.used) {
            config.joint[j].position.following_rad = 0.1,
            config.joint[j].position.following_s = 0.4;
        }
    }
    return config;
}

/* Joint j stays at its position for `most_ms`, or until that is a fault. */
static void stuck(uint32_t j, double at_rad, int most_ms)
{
    for (int ms = 0; ms < most_ms && r.shown.faults == 0; ms++) {
        r.position_rad[j] = at_rad - r.out.joint[j].velocity_rad_s * 1e-3;
        tick(&r);
    }
}

/* The set-point still moves, slowly, in the tick of the fault. */
static void a_stuck_joint_is_a_fault_with_its_wanted_and_measured_angle(void)
{
    core_config config = watched(head_and_belt());
    config.joint[2].position.velocity_rad_s = 0.5;
    ready(&r, &config);
    r.input.control.armed = 1;
    CHECK(tick(&r)->armed == 1);
    r.input.joints = (joint_command){.named = 4, .value_u = {[2] = 0.8}};
    stuck(2, 0.0, 3000);
    CHECK(r.shown.faults == FAULT_FOLLOWING_ERROR && r.shown.armed == 0 && r.out.enabled == 1);
    CHECK((r.shown.reasons & (REASON_FAULT | REASON_NOT_ARMED)) ==
          (REASON_FAULT | REASON_NOT_ARMED));
    CHECK(r.shown.doubt.joint == 2 && r.shown.doubt.setpoint_rad_s == 0.5);
    CHECK(r.shown.doubt.measured_rad_s == r.state.odometry.joint[2].velocity_rad_s);
}

static void the_first_of_several_stuck_joints_is_named(void)
{
    core_config config = watched(head_and_belt());
    ready(&r, &config);
    r.input.control.armed = 1;
    CHECK(tick(&r)->armed == 1);
    r.input.joints = (joint_command){.named = 5, .value_u = {[0] = 0.7, [2] = 0.7}};
    for (int ms = 0; ms < 3000 && r.shown.faults == 0; ms++) {
        r.position_rad[0] = -r.out.joint[0].velocity_rad_s * 1e-3;
        r.position_rad[2] = -r.out.joint[2].velocity_rad_s * 1e-3;
        tick(&r);
    }
    CHECK(r.shown.faults == FAULT_FOLLOWING_ERROR && r.shown.doubt.joint == 0);
    CHECK(r.shown.doubt.fault == FAULT_FOLLOWING_ERROR && ticks(&r, 500)->doubt.joint == 0);
}

/* A person turns the joint, faster than its drive can. */
static void turned_by_hand(int milliseconds)
{
    for (int ms = 0; ms < milliseconds; ms++) {
        r.position_rad[0] += ms % 2 == 0 ? 0.3 : -0.3;
        CHECK(tick(&r)->faults == 0);
    }
}

/* There is no fault without power, nor when the joint gets its power again. The robot has no other
 * joint. */
static void a_joint_without_power_may_be_turned_by_hand(void)
{
    core_config config = watched(head_and_belt());
    config.joint_count = 1;
    ready(&r, &config);
    turned_by_hand(1000);
    r.input.control.armed = 1;
    CHECK(tick(&r)->armed == 1);
    r.input.joints = (joint_command){.named = 1, .value_u = {0.9}};
    stuck(0, r.position_rad[0], 500);
    CHECK(r.shown.faults == 0 && r.state.steer.following[0].since_ns != 0); /* nearly a fault */
    r.input.joints.named = 0;
    r.input.control.armed = 0;
    turned_by_hand(1000);
    CHECK(r.state.steer.following[0].since_ns == 0);
    r.input.control.armed = 1;
    turned_by_hand(300);
    CHECK(r.shown.armed == 1);
}

/* The joint turns at a fifteenth of the speed of its set-point. */
static void a_joint_that_is_only_slow_follows(void)
{
    core_config config = watched(bicycle());
    ready(&r, &config);
    r.input.control.armed = 1;
    CHECK(tick(&r)->armed == 1);
    double at_rad = r.position_rad[1];
    for (int ms = 0; ms < 20000; ms++) {
        r.input.command.linear_m_s = 0.5;
        r.input.command.angular_rad_s = ms / 8000 % 2 == 0 ? 0.7 : -0.7;
        double most_rad = 0.2e-3, off_rad = r.out.position_rad[1] - at_rad;
        at_rad += fmax(-most_rad, fmin(most_rad, off_rad));
        r.position_rad[1] = at_rad - r.out.joint[1].velocity_rad_s * 1e-3;
        CHECK(tick(&r)->faults == 0);
    }
}

/* The position of the joint is unknown, which is another fault, and the only one. */
static void a_joint_whose_feedback_is_lost_is_not_stuck(void)
{
    static const stop_action ACTIONS[] = {STOP_RAMP, STOP_BRAKE, STOP_HOLD};
    for (int i = 0; i < COUNT_OF(ACTIONS); i++) {
        core_config config = watched(head_and_belt());
        config.on_fault = ACTIONS[i];
        config.joint[0].position.acceleration_rad_s2 = 4.0;
        ready(&r, &config);
        r.input.control.armed = 1;
        CHECK(tick(&r)->armed == 1);
        r.input.joints = (joint_command){.named = 1, .value_u = {2.0}};
        ticks(&r, 300);
        r.stale = true;
        CHECK(ticks(&r, 260)->faults == FAULT_FEEDBACK_STALE);
        double apart_rad = r.state.steer.profile[0].position_rad - r.state.odometry.angle_rad[0];
        CHECK(apart_rad > 0.3);
        CHECK(ticks(&r, 1500)->faults == FAULT_FEEDBACK_STALE);
    }
}

/* Cases: a joint with and without measurement, in both directions. */
static void a_joint_that_follows_may_be_anywhere(void)
{
    for (uint32_t i = 0; i < 4; i++) {
        core_config config = watched(head_and_belt());
        config.joint[0].position.reference =
            i < 2 ? REFERENCE_ESTIMATED : config.joint[0].position.reference;
        ready(&r, &config);
        r.input.control.armed = 1;
        CHECK(tick(&r)->armed == 1);
        r.input.joints = (joint_command){.named = 1, .value_u = {i % 2 == 0 ? 1.5 : -1.5}};
        CHECK(ticks(&r, 4000)->faults == 0 && r.out.position_rad[0] == r.input.joints.value_u[0]);
        CHECK(fabs(r.shown.joint[0].position_rad - r.out.position_rad[0]) < 1e-4);
    }
}

int main(void)
{
    a_joint_that_follows_may_be_anywhere();
    a_stuck_joint_is_a_fault_with_its_wanted_and_measured_angle();
    the_first_of_several_stuck_joints_is_named();
    a_joint_without_power_may_be_turned_by_hand();
    a_joint_that_is_only_slow_follows();
    a_joint_whose_feedback_is_lost_is_not_stuck();
    return checks_report("test_core_following");
}
