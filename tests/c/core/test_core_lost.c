/* SPDX-License-Identifier: Apache-2.0
 * test_core_lost: numbers of the core that are not finite any more, wheels with implausible
 * feedback, and a gyro that learns its zero only at rest. */
#include "steered_bases.h"

static const double LOST[] = {NAN, INFINITY, -INFINITY};

/* Cases: each number of each joint, moving, at rest and without power. */
static void a_set_point_that_is_not_finite_is_noticed_at_once(void)
{
    core_config config = good_config();
    for (int j = 0; j < 4; j++) {
        for (int number = 0; number < 3; number++) {
            for (int when = 0; when < 3; when++) {
                rig r;
                start(&r, &config);
                if (when > 0) {
                    go(&r, 0.4, 0.0);
                }
                joint_setpoint *of = &r.state.wheels.joint[j];
                *(number == 0   ? &of->velocity_rad_s
                  : number == 1 ? &of->duty
                                : &of->torque_n_m) = LOST[(j + number) % 3];
                if (when == 2 && number == 1) {
                    /* on a ramp a new duty replaces the lost one */
                    r.input.command.linear_m_s = 0.3;
                }
                if (when == 2 && number == 0) {
                    continue;
                }
                CHECK(tick(&r)->faults == FAULT_STATE && zero(&r) && r.shown.armed == 0);
                CHECK((r.shown.reasons & (REASON_FAULT | REASON_NOT_ARMED)) ==
                      (REASON_FAULT | REASON_NOT_ARMED));
            }
        }
    }
}

/* Cases: each axis of the twist, during a ramp, while braking, and without power. */
static void a_twist_that_is_not_finite_is_noticed_at_once(void)
{
    core_config bases[] = {good_config(), swerve()};
    for (int j = 0; j < 4; j++) {
        bases[0].joint[j].row.y = j % 3 == 0 ? 1.0 : -1.0;
    }
    for (int i = 0; i < 2 * AXES * COUNT_OF(bases) * 3; i++) {
        core_config *config = &bases[i / AXES / 2 / 3];
        config->on_timeout = STOP_BRAKE;
        rig r;
        start(&r, config);
        if (i / AXES / 2 % 3 > 0) {
            go(&r, 0.2, 0.0);
        }
        r.input.control.stop = i / AXES / 2 % 3 == 2;
        r.input.command.linear_m_s += 0.1;
        limit_state *axis = &r.state.axis[i % AXES];
        *(i / AXES % 2 == 0 ? &axis->velocity_u_s : &axis->acceleration_u_s2) =
            LOST[(i + i / AXES) % 3];
        CHECK(tick(&r)->faults == FAULT_STATE && zero(&r) && r.shown.armed == 0);
    }
}

/* Cases: each part of the command. The other parts do not count either, and steered joints hold
 * their position. */
static void a_command_with_a_part_that_is_not_finite_moves_and_arms_nothing(void)
{
    const core_config bases[] = {good_config(), swerve()};
    for (int i = 0; i < AXES * COUNT_OF(LOST) * COUNT_OF(bases); i++) {
        rig r;
        start(&r, &bases[i % COUNT_OF(bases)]);
        go(&r, 0.4, 0.5);
        twist_command *command = &r.input.command;
        double *part[AXES] = {&command->linear_m_s, &command->angular_rad_s, &command->lateral_m_s};
        *part[i / COUNT_OF(bases) % AXES] = LOST[i / COUNT_OF(bases) / AXES];
        double before_m_s = r.shown.setpoint_linear_m_s;
        uint32_t positioned = r.out.positioned;
        CHECK(tick(&r)->reasons & REASON_COMMAND_NOT_FINITE);
        CHECK(r.shown.wanted_linear_m_s == 0.0 && r.shown.wanted_angular_rad_s == 0.0 &&
              r.shown.lateral.wanted_lateral_m_s == 0.0);
        for (int ms = 0; ms < 1500; ms++) { /* the base neither continues nor reverses */
            CHECK(r.shown.setpoint_linear_m_s >= 0.0 && r.shown.setpoint_linear_m_s <= before_m_s);
            before_m_s = r.shown.setpoint_linear_m_s;
            tick(&r);
        }
        CHECK(r.shown.faults == 0 && zero(&r) && r.out.enabled == 1 &&
              r.out.positioned == positioned);
        r.input.control.armed = 0;
        tick(&r);
        r.input.control.armed = 1;
        CHECK(tick(&r)->armed == 0);
    }
}

static void one_joint_s_feedback_is_enough_to_measure(void)
{
    core_config config = good_config();
    for (int j = 0; j < 4; j++) {
        rig r;
        start(&r, &config);
        ticks(&r, 5);
        r.stale = true;
        r.input.feedback[j].stamp_ns = r.input.now_ns + TICK_NS;
        r.input.feedback[j].current_a = 1.5;
        CHECK(tick(&r)->joint[j].current_a == 1.5);
        r.input.feedback[j].current_a = 2.5; /* a change in a sample that has been taken */
        CHECK(tick(&r)->joint[j].current_a == 1.5);
    }
}

__attribute__((noinline)) static void leave_no_numbers_on_the_stack(void)
{
    volatile unsigned char bytes[16384];
    for (size_t i = 0; i < sizeof bytes; i++) {
        bytes[i] = 0xFF;
    }
}

static void a_tick_begins_with_numbers_of_its_own(void)
{
    core_config config = good_config();
    rig r;
    start(&r, &config);
    go(&r, 0.4, 0.0);
    for (int i = 0; i < 10; i++) {
        r.input.command.linear_m_s += 0.01 * (i % 2);
        prepare(&r);
        leave_no_numbers_on_the_stack();
        CHECK(step(&r)->faults == 0 && r.shown.armed == 1);
    }
}

/* The goal of the command is computed again, too. */
static void after_lost_numbers_no_earlier_results_are_used(void)
{
    core_config config = good_config();
    rig r;
    start(&r, &config);
    go(&r, 0.8, 1.5);
    CHECK(r.shown.saturation < 1.0);
    r.input.control.odometry_reset_count = 1;
    CHECK(tick(&r)->odometry_epoch == 1);
    r.state.goal.goal_u_s[AXIS_LINEAR] = NAN;
    r.state.odometry.x_m = INFINITY;
    CHECK(tick(&r)->faults == FAULT_STATE && zero(&r) && r.shown.saturation == 1.0);
    CHECK(r.shown.odometry_epoch == 2 && r.shown.x_m == 0.0 && r.shown.armed == 0);
    r.mute = true; /* the same command again later */
    r.input.control.armed = 0;
    ticks(&r, 400);
    r.input.control.reset_count++;
    CHECK(tick(&r)->faults == 0);
    r.input.control.armed = 1;
    CHECK(tick(&r)->armed == 1);
    r.mute = false;
    CHECK(ticks(&r, 1500)->faults == 0 && r.shown.setpoint_linear_m_s > 0.3 &&
          r.shown.saturation < 1.0);
}

static const size_t ODOMETRY_NUMBERS[] = {
    offsetof(odometry_state, x_m),
    offsetof(odometry_state, y_m),
    offsetof(odometry_state, heading_rad),
    offsetof(odometry_state, distance_m),
    offsetof(odometry_state, turned_rad),
    offsetof(odometry_state, linear_m_s),
    offsetof(odometry_state, angular_rad_s),
    offsetof(odometry_state, lateral_m_s),
    offsetof(odometry_state, spread.slip_m_s),
    offsetof(odometry_state, gyro.yaw_rad),
    offsetof(odometry_state, gyro.bias_rad_s),
    offsetof(odometry_state, gyro.bias_variance_rad2_s2),
    offsetof(odometry_state, pose_covariance[0]),
    offsetof(odometry_state, pose_covariance[1]),
    offsetof(odometry_state, pose_covariance[2]),
    offsetof(odometry_state, pose_covariance[3]),
    offsetof(odometry_state, pose_covariance[4]),
    offsetof(odometry_state, pose_covariance[5]),
    offsetof(odometry_state, twist_covariance[0]),
    offsetof(odometry_state, twist_covariance[1]),
    offsetof(odometry_state, twist_covariance[2]),
    offsetof(odometry_state, lateral_covariance[0]),
    offsetof(odometry_state, lateral_covariance[1]),
    offsetof(odometry_state, lateral_covariance[2]),
    offsetof(odometry_state, joint[0].position_rad),
    offsetof(odometry_state, joint[3].position_rad),
};

/* In this tick only one wheel has a new sample, so no measurement replaces the lost number. */
static void any_lost_number_of_the_odometry_is_noticed(void)
{
    core_config config = good_config();
    for (int i = 0; i < COUNT_OF(ODOMETRY_NUMBERS) * COUNT_OF(LOST); i++) {
        rig r;
        start(&r, &config);
        ticks(&r, 5);
        r.stale = true;
        r.input.feedback[1].stamp_ns = r.input.now_ns + TICK_NS;
        double *lost = (double *)((char *)&r.state.odometry + ODOMETRY_NUMBERS[i / COUNT_OF(LOST)]);
        *lost = LOST[i % COUNT_OF(LOST)];
        CHECK(tick(&r)->faults == FAULT_STATE && isfinite(*lost) && r.shown.odometry_epoch == 1);
    }
    rig r;
    start(&r, &config);
    ticks(&r, 5);
    r.state.odometry.joint[4].position_rad = NAN; /* beyond the joints of the base */
    CHECK(tick(&r)->faults == 0);
}

static core_config watched(void)
{
    core_config config = good_config();
    for (int j = 0; j < 4; j++) {
        config.joint[j].plausible = (plausible_config){.slow_rad_s = 0.3,
                                                       .setpoint_min_rad_s = 1.0,
                                                       .short_rad_s = 100.0,
                                                       .beyond_rad_s = 5.0,
                                                       .apart_rad_s = 100.0,
                                                       .stall_s = 0.5,
                                                       .runaway_s = 0.5};
    }
    return config;
}

/* Wheel j stands still and ignores its set-points, for `most_ms` or until a fault. Returns the time
 * in ms. */
static int stuck_ms(rig *r, int j, int most_ms)
{
    int ms = 0;
    for (; ms < most_ms && r->shown.faults == 0; ms++) {
        r->position_rad[j] -= r->out.joint[j].velocity_rad_s * 1e-3;
        tick(r);
    }
    return ms;
}

static void the_time_of_a_doubt_restarts_with_the_power(void)
{
    core_config config = watched();
    for (int j = 0; j < 4; j++) {
        rig r;
        start(&r, &config);
        go(&r, 0.3, 0.0);
        int whole_ms = stuck_ms(&r, j, 3000);
        CHECK(r.shown.faults == FAULT_STALL && whole_ms > 500 &&
              r.shown.doubt.joint == (uint32_t)j);
        CHECK((r.shown.reasons & (REASON_FAULT | REASON_NOT_ARMED)) ==
              (REASON_FAULT | REASON_NOT_ARMED));
        start(&r, &config);
        go(&r, 0.3, 0.0);
        CHECK(stuck_ms(&r, j, whole_ms - 5) == whole_ms - 5 && r.shown.faults == 0);
        r.input.control.armed = 0;
        r.input.command.linear_m_s = 0.0;
        ticks(&r, 2);
        for (int i = 0; i < 4; i++) {
            CHECK(r.state.plausible[i].stamp_ns == 0);
        }
        r.input.control.armed = 1;
        CHECK(tick(&r)->armed == 1);
        r.input.command.linear_m_s = 0.3;
        CHECK(stuck_ms(&r, j, 500) == 500 && r.shown.faults == 0);
    }
}

/* A person pushes the base: that is not a fault of its drives. */
static void a_base_without_power_may_be_pushed(void)
{
    core_config config = watched();
    for (int j = 0; j < 4; j++) {
        rig r;
        start(&r, &config);
        for (int ms = 0; ms < 1500; ms++) {
            r.position_rad[j] += 0.010;
            CHECK(tick(&r)->faults == 0 && r.state.plausible[j].stamp_ns == 0);
        }
    }
}

/* In the tick in which a wheel runs away, the power goes off, and all reported set-points are
 * zero. */
static void a_runaway_ends_all_set_points_in_its_tick(void)
{
    core_config config = watched();
    rig r;
    start(&r, &config);
    go(&r, 0.3, 0.0);
    for (int ms = 0; ms < 2000 && r.shown.faults == 0; ms++) {
        r.position_rad[1] += 0.010;
        tick(&r);
    }
    CHECK(r.shown.faults == FAULT_RUNAWAY && r.out.enabled == 0 &&
          r.shown.setpoint_linear_m_s == 0.0);
    for (int j = 0; j < 4; j++) {
        CHECK(r.shown.joint[j].setpoint_rad_s == 0.0 && r.shown.joint[j].duty == 0.0);
    }
    CHECK((r.shown.reasons & (REASON_FAULT | REASON_NOT_ARMED)) ==
          (REASON_FAULT | REASON_NOT_ARMED));
    for (int j = 0; j < 4; j++) {
        CHECK(r.state.plausible[j].stamp_ns == 0);
    }
}

/* Samples come each millisecond, and every fifth is checked. */
static void samples_in_quick_succession_are_checked_together(void)
{
    core_config config = watched();
    rig r;
    start(&r, &config);
    go(&r, 0.3, 0.0);
    int64_t before_ns = r.state.plausible[3].stamp_ns;
    for (int looks = 0; looks < 20;) {
        tick(&r);
        if (r.state.plausible[3].stamp_ns == before_ns) {
            continue;
        }
        CHECK(r.state.plausible[3].stamp_ns - before_ns == 5 * MS_NS);
        before_ns = r.state.plausible[3].stamp_ns;
        looks++;
    }
}

/* A person pushed the base during the suspend: the counters of the wheels measured it, the gyro did
 * not. */
static void a_turn_during_a_suspend_is_that_of_the_wheels(void)
{
    core_config config = good_config();
    config.gyro = good_gyro(0.1);
    for (int sampled = 0; sampled < 3; sampled++) {
        rig r;
        start(&r, &config);
        for (int ms = 0; ms < 2200; ms++) {
            bool suspended = ms == 2100;
            if (suspended) {
                r.input.now_ns += 60 * MS_NS; /* CLOCK_MONOTONIC counts only this part of it */
                for (int j = 0; j < 4; j++) {
                    r.position_rad[j] += j % 2 == 0 ? -0.5 : 0.5;
                }
            }
            if (!suspended || sampled == 0) {
                r.input.imu = (imu_sample){.stamp_ns = r.input.now_ns + TICK_NS,
                                           .angular_rad_s = {0.0, 0.0, 0.01}};
            } else if (sampled == 1) { /* the loop hands on a sample from before the suspend */
                r.input.imu.stamp_ns = 0;
            }
            r.input.suspended = suspended;
            tick(&r);
            CHECK(ms < 1800 || suspended || ms == 2101 || r.shown.imu.heading_by_gyro == 1);
        }
        CHECK(fabs(r.shown.heading_rad - 0.2) < 2e-3 && r.shown.odometry_degraded == 0);
        CHECK(r.shown.imu.refused == (sampled == 1)); /* counted once, however often the loop hands
                                                         it on */
        CHECK(r.shown.imu.state == GYRO_USED && r.shown.imu.still == 0);
    }
    rig r;
    start(&r, &config);
    r.input.suspended = 1;
    CHECK(tick(&r)->imu.state == GYRO_NONE);
}

/* The zero of a gyro is its rate while the base stands still: all wheels report, and none of them
 * turns. */
static void a_gyro_learns_its_zero_only_after_the_base_was_seen_at_rest(void)
{
    core_config config = good_config();
    config.gyro = good_gyro(0.05);
    for (int how = 0; how < 3; how++) {
        rig r;
        start(&r, &config);
        if (how == 1) {
            go(&r, 0.3, 0.0);
        }
        for (int ms = 0; ms < 2000; ms++) {
            r.input.imu = (imu_sample){.stamp_ns = r.input.now_ns + TICK_NS,
                                       .angular_rad_s = {0.0, 0.0, 0.01}};
            if (how == 2) {
                r.input.feedback[3].stamp_ns = 0;
            }
            r.stale = how == 2;
            for (int j = 0; j < 3 && r.stale; j++) {
                r.input.feedback[j].stamp_ns = r.input.now_ns + TICK_NS;
            }
            tick(&r);
            if (ms <= 1) {
                bool seen = ms == 1 && how == 0;
                CHECK(r.state.odometry.gyro.still_since_ns == (seen ? r.input.now_ns : 0));
            }
        }
        CHECK((r.state.odometry.gyro.bias_stamp_ns != 0) == (how == 0));
    }
}

/* Three wheels are silent, and the fourth one alone does not determine the motion. The base may
 * have followed its set-points. */
static void a_base_whose_motion_is_no_longer_measured_grows_uncertain_until_it_rests(void)
{
    core_config config = good_config();
    rig r;
    start(&r, &config);
    go(&r, 0.4, 0.3);
    r.stale = true;
    double before[6], grown_m2 = 0.0;
    for (int ms = 0; ms < 800; ms++) {
        memcpy(before, r.shown.pose_covariance, sizeof before);
        r.input.feedback[0].stamp_ns = r.input.now_ns + TICK_NS;
        tick(&r);
        bool grows =
            r.shown.pose_covariance[0] > before[0] && r.shown.pose_covariance[5] > before[5];
        CHECK(!r.state.odometry.blind || grows == (r.state.wheels.joint[0].velocity_rad_s != 0.0));
        grown_m2 += r.state.odometry.blind ? r.shown.pose_covariance[0] - before[0] : 0.0;
    }
    CHECK(r.state.odometry.blind && zero(&r) && grown_m2 > 1e-4);
}

int main(void)
{
    a_base_whose_motion_is_no_longer_measured_grows_uncertain_until_it_rests();
    a_set_point_that_is_not_finite_is_noticed_at_once();
    a_twist_that_is_not_finite_is_noticed_at_once();
    a_command_with_a_part_that_is_not_finite_moves_and_arms_nothing();
    one_joint_s_feedback_is_enough_to_measure();
    a_tick_begins_with_numbers_of_its_own();
    after_lost_numbers_no_earlier_results_are_used();
    any_lost_number_of_the_odometry_is_noticed();
    the_time_of_a_doubt_restarts_with_the_power();
    a_base_without_power_may_be_pushed();
    a_runaway_ends_all_set_points_in_its_tick();
    samples_in_quick_succession_are_checked_together();
    a_turn_during_a_suspend_is_that_of_the_wheels();
    a_gyro_learns_its_zero_only_after_the_base_was_seen_at_rest();
    return checks_report("test_core_lost");
}
