/* SPDX-License-Identifier: Apache-2.0
 * The core as a whole: drives with turns, faults and stops with each action, and hostile numbers
 * everywhere. */
#include "core_rig.h"

#include <float.h>
#include <math.h>
#include <string.h>

static const double HOSTILE[] = {NAN,    INFINITY, -INFINITY, 0.0,      -0.0, -1.0,
                                 5e-324, DBL_MIN,  DBL_MAX,   -DBL_MAX, 1.0,  1e-9};
enum { HOSTILE_COUNT = sizeof HOSTILE / sizeof HOSTILE[0] };

static void a_ramp_arrives_and_comes_back_through_zero(void)
{
    base_limits limits = {{1.0, 1.0, 1.5, 8.0}, {2.0, 3.0, 4.0, 30.0}, {1.0, 1.0, 1.5, 8.0}};
    limit_state axis[AXES] = {0};
    uint32_t seen = 0;
    for (int i = 0; i < 3000; i++) {
        seen |= ramp_step(axis, AXES, &limits, NULL, (const double[AXES]){1.0, 0.2}, 1e-3, false);
    }
    CHECK(axis[AXIS_LINEAR].velocity_u_s == 1.0 && axis[AXIS_ANGULAR].velocity_u_s == 0.2);
    for (int i = 0; i < 5000; i++) {
        seen |=
            ramp_step(axis, AXES, &limits, NULL, (const double[AXES]){-0.5, 0.2}, 1e-3, i % 2 == 0);
    }
    CHECK(axis[AXIS_LINEAR].velocity_u_s == -0.5 && axis[AXIS_ANGULAR].velocity_u_s == 0.2);
    CHECK(seen == (REASON_LINEAR_ACCELERATION | REASON_LINEAR_DECELERATION | REASON_LINEAR_JERK));
    for (int i = 0; i < 5000; i++) {
        seen |= ramp_step(axis, AXES, &limits, NULL, (const double[AXES]){-0.5, -2.0}, 1e-3,
                          i % 2 == 0);
    }
    CHECK(axis[AXIS_ANGULAR].velocity_u_s == -2.0);
    CHECK(seen & REASON_ANGULAR_ACCELERATION && seen & REASON_ANGULAR_DECELERATION &&
          seen & REASON_ANGULAR_JERK);
    limits.linear = (axis_limits){1.0, NAN, NAN, INFINITY};
    CHECK(ramp_step(axis, AXES, &limits, NULL, (const double[AXES]){1.0, 0.0}, 1e-3, false) == 0);
    CHECK(axis[AXIS_LINEAR].velocity_u_s == 0.0 && axis[AXIS_ANGULAR].velocity_u_s == 0.0);
    /* a step that ends one rounding before the goal must not pass it */
    double bound = nextafter((1.018640261644444 - 0.008365300070369949) / 1e-3, 0.0);
    limits.linear = (axis_limits){2.0, bound, bound, INFINITY};
    axis[AXIS_LINEAR] = (limit_state){1.018640261644444, 0.0};
    ramp_step(axis, AXES, &limits, NULL, (const double[AXES]){0.008365300070369949, 0.0}, 1e-3,
              false);
    CHECK(axis[AXIS_LINEAR].velocity_u_s >= 0.008365300070369949);
}

static void no_nan_or_infinity_leaves_the_small_functions(void)
{
    for (int a = 0; a < HOSTILE_COUNT; a++) {
        for (int b = 0; b < HOSTILE_COUNT; b++) {
            for (int c = 0; c < HOSTILE_COUNT; c++) {
                axis_limits hostile = {HOSTILE[b], HOSTILE[c], HOSTILE[b], HOSTILE[c]},
                            good = {1.0, 1.0, 1.5, 8.0};
                base_limits limits = {hostile, a % 2 == 0 ? hostile : good, hostile};
                limit_state axis[AXES] = {{HOSTILE[c], HOSTILE[a]}, {HOSTILE[b], HOSTILE[b]}};
                ramp_step(axis, AXES, &limits, NULL, (const double[AXES]){HOSTILE[a], HOSTILE[c]},
                          HOSTILE[b], b % 2 == 0);
                for (int i = 0; i < AXES; i++) {
                    CHECK(isfinite(axis[i].velocity_u_s) && isfinite(axis[i].acceleration_u_s2));
                }
                pwm_config pwm = {0.1, -0.5, 1.0, 10.0, 5.0};
                double duty = pwm_step(&pwm, HOSTILE[a], HOSTILE[b], HOSTILE[c]).duty;
                CHECK(duty >= -0.5 && duty <= 1.0);
                joint_config joint = {.velocity_min_rad_s = HOSTILE[a],
                                      .velocity_max_rad_s = HOSTILE[b]};
                double factor = saturate_factor(&HOSTILE[c], &joint, 1);
                CHECK(factor >= 0.0 && factor <= 1.0);
            }
        }
    }
}

static void counters_wrap_in_both_directions(void)
{
    static const uint32_t BITS[] = {8, 16, 24, 32, 64};
    for (int i = 0; i < 5; i++) {
        CHECK(counter_difference(2, UINT64_MAX - 2, BITS[i]) == 5);
        CHECK(counter_difference(UINT64_MAX - 2, 2, BITS[i]) == -5);
    }
    CHECK(counter_difference(1, 0, 0) == 0);
    CHECK(counter_difference(1, 0, 65) == 0);
    CHECK(counter_difference(1ULL << 63, 0, 64) == INT64_MIN);
}

static void a_drive_with_turns_and_saturation_keeps_its_covariance(void)
{
    rig r;
    core_config config = good_config();
    start(&r, &config);
    go(&r, 0.8, 1.5);
    CHECK(r.shown.saturation < 1.0 && (r.shown.reasons & REASON_WHEEL_SATURATED));
    CHECK(fabs(r.shown.setpoint_angular_rad_s / r.shown.setpoint_linear_m_s - 1.5 / 0.8) < 1e-9);
    CHECK(r.shown.turned_rad > 1.0 && r.shown.pose_covariance[5] > 1e-6);
    /* the turn could ramp faster than the speed, but waits for it: the wheels are at their limit */
    r.input.command.linear_m_s = 0.88;
    r.input.command.angular_rad_s = 0.0;
    ticks(&r, 2000);
    r.input.control.limits.linear.deceleration_u_s2 = 0.1;
    r.input.command.linear_m_s = 0.3;
    r.input.command.angular_rad_s = 2.0;
    for (int i = 0; i < 2000; i++) {
        CHECK(fabs(tick(&r)->joint[1].setpoint_rad_s) <= 9.0);
    }
    r.input.control.limits = config.limits;
    r.input.command.linear_m_s = 5.0;
    r.input.command.angular_rad_s = -5.0;
    CHECK(ticks(&r, 2000)->reasons & REASON_LINEAR_VELOCITY);
    r.input.command.linear_m_s = -0.5;
    r.input.command.angular_rad_s = 1.0;
    ticks(&r, 2000);
    r.input.control.limits.linear.velocity_u_s = 0.1;
    r.input.control.odometry_reset_count = 1;
    CHECK(ticks(&r, 1000)->setpoint_linear_m_s == -0.1 && r.shown.odometry_epoch == 1);
    r.input.command.linear_m_s = NAN;
    CHECK(tick(&r)->reasons & REASON_COMMAND_NOT_FINITE);
    r.input.control.armed = 0;
    tick(&r);
    CHECK(zero(&r) && r.out.enabled == 0);
}

static void every_fault_ends_at_rest_under_every_action(void)
{
    for (int action = STOP_RAMP; action <= STOP_COAST; action++) {
        for (int cause = 0; cause < 7; cause++) {
            rig r;
            core_config config = good_config();
            config.on_fault = config.on_estop = config.on_timeout = (stop_action)action;
            start(&r, &config);
            go(&r, 0.4, 0.1);
            switch (cause) {
            case 0: r.input.control.estop = 1; break;
            case 1: r.input.control.fault = 1; break;
            case 2:
                r.stale = true;
                ticks(&r, 260);
                break;
            case 3: r.input.feedback[1].drive_faults = 1; break;
            case 4: r.input.feedback[1].enabled = 0; break;
            case 5: core_step(&r.state, &r.input, NAN, &r.out, &r.shown); break;
            default:
                r.input.now_ns += 600 * TICK_NS;
                core_step(&r.state, &r.input, 1e-3, &r.out, &r.shown);
                break;
            }
            CHECK(ticks(&r, 4000)->faults != 0 && r.shown.armed == 0);
            CHECK(zero(&r) && r.out.enabled == (action == STOP_HOLD));
            r.input.control.armed = 0; /* a hold continues without arming */
            CHECK(ticks(&r, 10)->enabled == (action == STOP_HOLD) && zero(&r));
            r.input.control.reset_count++;
            CHECK(tick(&r)->faults != 0);
            r.stale = false;
            r.input.control.estop = r.input.control.fault = r.input.feedback[1].drive_faults = 0;
            r.input.command.linear_m_s = r.input.command.angular_rad_s = 0.0;
            tick(&r);
            r.input.control.reset_count++;
            CHECK(tick(&r)->faults == 0 && r.out.enabled == 0);
        }
    }
}

static void a_stop_and_a_lost_command_rest_under_every_action(void)
{
    for (int action = STOP_RAMP; action <= STOP_COAST; action++) {
        for (int stop = 0; stop < 2; stop++) {
            rig r;
            core_config config = good_config();
            config.on_timeout = (stop_action)action;
            start(&r, &config);
            go(&r, 0.4, 0.0);
            r.input.control.stop = (uint32_t)stop;
            r.mute = !stop;
            CHECK(ticks(&r, 1500)->faults == 0 && r.shown.armed == (action != STOP_COAST));
            CHECK(zero(&r) && r.shown.at_rest == 1);
            r.input.control.stop = 0;
            r.mute = false; /* stop and lost command are not latched, but a base that coasted is
                               disarmed */
            CHECK(ticks(&r, 1500)->setpoint_linear_m_s == (action == STOP_COAST ? 0.0 : 0.4));
        }
    }
}

static void odometry_copes_with_silence_jumps_and_missing_counters(void)
{
    rig r;
    core_config config = good_config();
    config.joint[2].counter_bits = 0;
    start(&r, &config);
    go(&r, 0.5, 0.0);
    CHECK(r.shown.odometry_degraded == 1);
    r.stale = true;
    for (int i = 0; i < 4; i++) {
        r.input.feedback[i].velocity_rad_s = NAN;
    }
    r.input.feedback[0].count += 20000;
    r.input.feedback[0].stamp_ns = r.input.now_ns + TICK_NS;
    CHECK(tick(&r)->joint[0].jumps == 1);
    r.input.feedback[0].epoch++;
    r.input.feedback[0].velocity_rad_s = 1e6;
    for (int j = 0; j < 4; j++) {
        r.input.feedback[j].stamp_ns = r.input.now_ns + TICK_NS;
    }
    CHECK(tick(&r)->joint[0].jumps == 1);
    double before_m2 = r.shown.pose_covariance[0];
    CHECK(ticks(&r, 400)->pose_covariance[0] > before_m2);
    r.input.feedback[1].stamp_ns = r.input.feedback[3].stamp_ns = r.input.now_ns;
    r.input.feedback[0].stamp_ns = r.input.now_ns;
    CHECK(tick(&r)->odometry_degraded == 1 && r.shown.joint[2].stale == 1);
    r.input.now_ns += 20000 * TICK_NS;
    r.stale = false;
    CHECK(ticks(&r, 3)->joint[0].jumps == 1);
}

static void a_doubted_wheel_ends_the_run(void)
{
    for (int faster = 0; faster < 2; faster++) {
        rig r;
        core_config config = good_config();
        config.joint[2].plausible =
            (plausible_config){.slow_rad_s = 0.3, .setpoint_min_rad_s = 1.0, .beyond_rad_s = 5.0};
        *(faster ? &config.joint[2].plausible.runaway_s : &config.joint[2].plausible.stall_s) = 0.5;
        config.joint[2].plausible.short_rad_s = 100.0;
        start(&r, &config);
        go(&r, 0.3, 0.0);
        for (int ms = 0; ms < 2000 && r.shown.faults == 0; ms++) {
            r.position_rad[2] += faster ? 0.010 : -r.out.joint[2].velocity_rad_s * 1e-3;
            tick(&r);
        }
        CHECK(r.shown.faults == (faster ? FAULT_RUNAWAY : FAULT_STALL) && r.shown.armed == 0);
        CHECK(r.shown.doubt.joint == 2 && r.shown.doubt.fault == r.shown.faults &&
              r.out.enabled == !faster);
        CHECK(!faster || zero(&r));
        r.input.command.linear_m_s = 0.0;
        r.input.control.armed = 0;
        CHECK(ticks(&r, 4000)->enabled == 0 && zero(&r));
        r.input.control.reset_count++;
        CHECK(tick(&r)->faults == 0 && r.shown.doubt.fault == 0 && r.shown.doubt.since_ns == 0);
    }
}

static void check_numbers(const robot_state *shown)
{
    const double numbers[] = {shown->dt_s,
                              shown->wanted_linear_m_s,
                              shown->wanted_angular_rad_s,
                              shown->setpoint_linear_m_s,
                              shown->setpoint_angular_rad_s,
                              shown->saturation,
                              shown->x_m,
                              shown->y_m,
                              shown->heading_rad,
                              shown->distance_m,
                              shown->turned_rad};
    for (int i = 0; i < COUNT_OF(numbers); i++) {
        CHECK(isfinite(numbers[i]));
    }
    CHECK(!isinf(shown->linear_m_s) && !isinf(shown->angular_rad_s)); /* NaN: not measured */
    for (int i = 0; i < 6; i++) {
        CHECK(isfinite(shown->pose_covariance[i]));
        CHECK(isfinite(shown->twist_covariance[i % 3]) == isfinite(shown->linear_m_s));
    }
    for (int j = 0; j < 4; j++) {
        const joint_state *joint = &shown->joint[j];
        CHECK((joint->stale || isfinite(joint->position_rad)) && isfinite(joint->duty) &&
              fabs(joint->setpoint_rad_s) <= 9.0);
    }
}

static void hostile_input_never_moves_an_unarmed_base(void)
{
    rig r;
    core_config config = good_config();
    start(&r, &config);
    uint64_t noise = 88172645463325252U;
    for (int round = 0; round < 20000; round++) {
        unsigned char *bytes = (unsigned char *)&r.input;
        for (size_t i = 0; i + 8 <= sizeof r.input; i += 8) {
            noise ^= noise << 13, noise ^= noise >> 7, noise ^= noise << 17;
            memcpy(bytes + i,
                   noise % 5 == 0 ? (const void *)&HOSTILE[noise % HOSTILE_COUNT]
                                  : (const void *)&noise,
                   8);
        }
        core_step(&r.state, &r.input, HOSTILE[round % HOSTILE_COUNT], &r.out, &r.shown);
        CHECK(r.shown.armed || r.shown.enabled || zero(&r));
        check_numbers(&r.shown);
    }
}

/* The gyro reports a turn while the wheels rest: a person carries the base. */
static void a_gyro_turns_the_pose(void)
{
    core_config config = good_config();
    rig r;
    config.gyro = good_gyro(0.05);
    start(&r, &config);
    for (int i = 0; i < 4000; i++) {
        r.input.imu = (imu_sample){.stamp_ns = r.input.now_ns,
                                   .angular_rad_s = {NAN, INFINITY, i < 2000 ? 0.0 : 0.5},
                                   .acceleration_m_s2 = {0.0, 0.0, 9.8}};
        tick(&r);
        CHECK(isfinite(r.shown.heading_rad) && isnan(r.shown.imu.angular_rad_s[1]));
    }
    CHECK(r.shown.imu.heading_by_gyro == 1 && fabs(r.shown.heading_rad - 1.0) < 0.01);
}

int main(void)
{
    a_gyro_turns_the_pose();
    a_ramp_arrives_and_comes_back_through_zero();
    no_nan_or_infinity_leaves_the_small_functions();
    counters_wrap_in_both_directions();
    a_drive_with_turns_and_saturation_keeps_its_covariance();
    every_fault_ends_at_rest_under_every_action();
    a_stop_and_a_lost_command_rest_under_every_action();
    odometry_copes_with_silence_jumps_and_missing_counters();
    a_doubted_wheel_ends_the_run();
    hostile_input_never_moves_an_unarmed_base();
    return checks_report("test_core");
}
