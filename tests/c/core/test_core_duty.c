/* SPDX-License-Identifier: Apache-2.0
 * Speed loops in the core for drives that take a duty: they replace the open-loop map, their gains
 * change while the robot moves, and the map returns when the feedback cannot be trusted. */
#include "core_rig.h"

#include <string.h>

static const double FULL_RAD_S = 20.0, DEAD_BAND = 0.1;

static core_config with_loops(speed_loop_gains gains)
{
    core_config config = good_config();
    for (uint32_t j = 0; j < config.joint_count; j++) {
        config.joint[j].counter_bits = 0;
        config.joint[j].pwm = (pwm_config){DEAD_BAND, -1.0, 0.9, INFINITY, FULL_RAD_S};
        gains.static_u = DEAD_BAND;
        gains.viscous_u_s_per_rad = (1.0 - DEAD_BAND) / FULL_RAD_S;
        config.joint[j].speed_loop = (speed_loop_config){
            .gains = gains,
            .filter_s = 0.05,
            .correction_max_u = 0.3,
            .output_min_u = -1.0,
            .output_max_u = 0.9,
            .kind = SPEED_LOOP_DUTY,
        };
    }
    return config;
}

static const speed_loop_gains PI = {.gain_u_s_per_rad = 0.02, .integral_u_per_rad = 0.1};

/* Makes a tick in which each wheel turns by `part` of its set-point. */
static const robot_state *turned(rig *r, double part)
{
    prepare(r);
    for (uint32_t j = 0; j < r->config.joint_count; j++) {
        r->input.feedback[j].velocity_rad_s = part * r->out.joint[j].velocity_rad_s;
    }
    return step(r);
}

static void put_gains(rig *r, speed_loop_gains gains)
{
    r->input.control.gains_count++;
    for (uint32_t j = 0; j < r->config.joint_count; j++) {
        gains.static_u = DEAD_BAND;
        gains.viscous_u_s_per_rad = (1.0 - DEAD_BAND) / FULL_RAD_S;
        r->input.control.gains[j] = gains;
    }
}

static double open_loop(const rig *r, uint32_t j)
{
    return pwm_step(&r->config.joint[j].pwm, 0.0, r->out.joint[j].velocity_rad_s, 1e-3).duty;
}

static void without_gains_a_duty_is_that_of_the_map_bit_for_bit(void)
{
    core_config plain = with_loops((speed_loop_gains){0}), none = plain;
    for (uint32_t j = 0; j < none.joint_count; j++) {
        none.joint[j].speed_loop = (speed_loop_config){0};
    }
    rig a, b;
    start(&a, &plain);
    start(&b, &none);
    go(&a, 0.4, 0.5);
    go(&b, 0.4, 0.5);
    for (int i = 0; i < 200; i++) {
        turned(&a, 0.5);
        turned(&b, 0.5);
        CHECK(memcmp(&a.out, &b.out, sizeof a.out) == 0 &&
              memcmp(&a.shown, &b.shown, sizeof a.shown) == 0);
    }
    CHECK(a.state.loops == 0 && a.out.joint[0].duty != 0.0);
}

static void a_slow_wheel_gets_more_duty_and_the_page_shows_it(void)
{
    rig r;
    core_config config = with_loops(PI);
    config.joint[1].speed_loop.kind = SPEED_LOOP_NONE;
    start(&r, &config);
    go(&r, 0.4, 0.0);
    for (int i = 0; i < 100; i++) {
        turned(&r, 0.5);
    }
    double error_rad_s = 2.0, more = 0.02 * error_rad_s + 0.1 * error_rad_s * 0.1;
    CHECK(fabs(r.out.joint[0].duty - (open_loop(&r, 0) + more)) < 1e-3 &&
          r.shown.joint[0].duty == r.out.joint[0].duty);
    CHECK(r.shown.speed_loop[0].output_u == r.out.joint[0].duty);
    CHECK(r.shown.speed_loop[0].integral_u == r.state.speed_loop[0].integral_u &&
          r.state.speed_loop[0].integral_u > 0.01);
    CHECK(r.out.joint[1].duty == open_loop(&r, 1) && r.shown.speed_loop[1].output_u == 0.0);
    CHECK(r.out.joint[0].torque_n_m == 0.0);
}

static void at_rest_and_without_power_a_duty_is_zero(void)
{
    rig r;
    core_config config = with_loops(PI);
    start(&r, &config);
    go(&r, 0.4, 0.0);
    for (int i = 0; i < 300; i++) {
        turned(&r, 0.5);
    }
    r.input.command.linear_m_s = 0.0;
    for (int i = 0; i < 1000; i++) {
        turned(&r, 1.0);
    }
    CHECK(r.shown.at_rest == 1 && zero(&r) && r.state.speed_loop[0].integral_u == 0.0);
    r.input.command.linear_m_s = 0.4;
    for (int i = 0; i < 300; i++) {
        turned(&r, 0.5);
    }
    r.input.control.armed = 0;
    turned(&r, 1.0);
    CHECK(r.out.enabled == 0 && zero(&r));
    CHECK(r.state.speed_loop[0].integral_u == 0.0 && r.shown.joint[0].duty == 0.0 &&
          r.shown.speed_loop[0].output_u == 0.0);
}

static void a_wheel_without_feedback_or_with_nan_gets_the_duty_of_the_map(void)
{
    rig r;
    core_config config = with_loops(PI);
    start(&r, &config);
    go(&r, 0.4, 0.0);
    for (int i = 0; i < 100; i++) {
        turned(&r, 0.5);
    }
    prepare(&r);
    r.input.feedback[1].velocity_rad_s = (double)NAN;
    step(&r);
    CHECK(r.out.joint[1].duty == open_loop(&r, 1) && r.state.speed_loop[1].integral_u == 0.0);
    CHECK(r.out.joint[0].duty > open_loop(&r, 0));
    step_with(&r, &(change)AGE_OF(feedback[2].stamp_ns, 300000000, 0));
    CHECK(r.shown.faults == FAULT_FEEDBACK_STALE && r.out.joint[2].velocity_rad_s > 3.0);
    CHECK(r.out.joint[2].duty == open_loop(&r, 2) && r.state.speed_loop[2].integral_u == 0.0);
}

static void an_impossibly_fast_wheel_gets_no_duty_and_one_without_gains_is_not_checked(void)
{
    rig r;
    core_config config = with_loops(PI);
    config.joint[1].speed_loop.gains = (speed_loop_gains){0};
    config.on_fault = STOP_RAMP;
    start(&r, &config);
    go(&r, 0.4, 0.0);
    prepare(&r);
    r.input.feedback[1].velocity_rad_s = 14.0;
    CHECK(step(&r)->faults == 0);
    prepare(&r);
    r.input.feedback[0].velocity_rad_s = -14.0;
    CHECK(step(&r)->faults == FAULT_OVERSPEED && r.out.enabled == 1 && r.out.joint[0].duty == 0.0);
    CHECK(r.out.joint[2].duty != 0.0);
    CHECK(r.out.joint[1].duty == open_loop(&r, 1) && r.out.joint[1].duty != 0.0); /* of the map */
    turned(&r, 1.0);
    CHECK(r.out.joint[0].duty == 0.0);
}

static void a_duty_rises_by_its_slew_and_falls_at_once(void)
{
    rig r;
    speed_loop_gains strong = {.gain_u_s_per_rad = 0.1};
    core_config config = with_loops(strong);
    for (uint32_t j = 0; j < config.joint_count; j++) {
        config.joint[j].pwm.slew_per_s = 2.0;
        config.joint[j].speed_loop.correction_max_u = 0.6;
    }
    start(&r, &config);
    go(&r, 0.4, 0.0);
    double before = r.out.joint[0].duty;
    turned(&r, 0.5); /* needs 0.2 more duty */
    CHECK(fabs(r.out.joint[0].duty - before - 0.002) < 1e-12);
    turned(&r, 1.5);
    CHECK(r.out.joint[0].duty < before - 0.1);
    turned(&r, 3.2); /* reverses: begins at the edge of the dead band */
    CHECK(fabs(r.out.joint[0].duty + DEAD_BAND + 0.002) < 1e-12);
    start(&r, &config);
    go(&r, -0.4, 0.0);
    before = r.out.joint[0].duty;
    turned(&r, 0.5);
    CHECK(before < -0.2 && fabs(r.out.joint[0].duty - before + 0.002) < 1e-12);
}

static void gains_change_while_the_robot_moves_without_a_step_and_wrong_ones_change_nothing(void)
{
    rig r;
    core_config config = with_loops((speed_loop_gains){0});
    start(&r, &config);
    go(&r, 0.4, 0.0);
    turned(&r, 0.8);
    double before = r.out.joint[0].duty;
    put_gains(&r, PI);
    turned(&r, 0.8);
    CHECK(r.state.loops == 0xF && fabs(r.out.joint[0].duty - before) < 1e-3);
    for (int i = 0; i < 300; i++) {
        turned(&r, 0.8);
    }
    CHECK(r.out.joint[0].duty > before + 0.01);
    before = r.out.joint[0].duty;
    put_gains(&r, (speed_loop_gains){.gain_u_s_per_rad = 0.08, .integral_u_per_rad = 0.3});
    turned(&r, 0.8);
    CHECK(fabs(r.out.joint[0].duty - before) < 1e-3 && r.state.gains[0].gain_u_s_per_rad == 0.08);
    before = r.out.joint[0].duty;
    put_gains(&r, PI);
    r.input.control.gains[3].integral_u_per_rad = (double)NAN;
    turned(&r, 0.8);
    CHECK(r.state.gains[0].gain_u_s_per_rad == 0.08 && fabs(r.out.joint[0].duty - before) < 1e-3);
    put_gains(&r, (speed_loop_gains){0});
    turned(&r, 0.8);
    CHECK(fabs(r.out.joint[0].duty - before) < 2e-3); /* the integral fades, not all at once */
    for (int i = 0; i < 6000; i++) {
        turned(&r, 0.8);
    }
    CHECK(r.state.loops == 0 && r.out.joint[0].duty == open_loop(&r, 0) &&
          r.shown.joint[0].duty == r.out.joint[0].duty);
    CHECK(r.shown.speed_loop[0].output_u == 0.0 && r.shown.speed_loop[0].integral_u == 0.0);
}

static void each_gain_alone_makes_a_loop(void)
{
    const speed_loop_gains alone[] = {
        {.gain_u_s_per_rad = 0.01},
        {.integral_u_per_rad = 0.01},
        {.derivative_u_s2_per_rad = 0.01},
        {.acceleration_u_s2_per_rad = 0.01},
    };
    for (size_t i = 0; i < sizeof alone / sizeof alone[0]; i++) {
        rig r;
        core_config config = with_loops(alone[i]);
        start(&r, &config);
        CHECK(r.state.loops == 0xF);
    }
}

static void only_changed_gains_keep_the_output_and_missing_joints_do_not_count(void)
{
    rig r;
    core_config config = with_loops(PI);
    start(&r, &config);
    go(&r, 0.4, 0.0);
    for (int i = 0; i < 200; i++) {
        turned(&r, 0.8);
    }
    double before[4];
    for (int j = 0; j < 4; j++) {
        before[j] = r.out.joint[j].duty;
    }
    put_gains(&r, PI);
    r.input.control.gains[0].gain_u_s_per_rad = 0.05;
    r.input.control.gains[4] = (speed_loop_gains){.gain_u_s_per_rad = (double)NAN, .static_u = 1.0};
    turned(&r, 0.5); /* the error grows by 1.2 rad/s in the same tick */
    CHECK(r.state.gains[0].gain_u_s_per_rad == 0.05 && r.state.gains[4].static_u == 0.0);
    CHECK(fabs(r.out.joint[0].duty - before[0]) < 1e-3);
    for (int j = 1; j < 4; j++) {
        CHECK(fabs(r.out.joint[j].duty - before[j] - 0.02 * 1.2) < 1e-3);
    }
    put_gains(&r, (speed_loop_gains){.gain_u_s_per_rad = 0.09});
    for (int j = 0; j < 4; j++) {
        before[j] = r.out.joint[j].duty;
    }
    turned(&r, 0.5);
    for (int j = 0; j < 4; j++) {
        CHECK(fabs(r.out.joint[j].duty - before[j]) < 1e-3);
    }
    put_gains(&r, PI);
    r.input.control.gains[0].static_u = -1.0; /* the first set of gains is checked, too */
    turned(&r, 0.5);
    CHECK(r.state.gains[1].gain_u_s_per_rad == 0.09);
}

static void a_loop_without_gains_ends_when_its_integral_is_gone(void)
{
    rig r;
    core_config config = with_loops(PI);
    start(&r, &config);
    go(&r, 0.4, 0.0);
    put_gains(&r, (speed_loop_gains){0});
    turned(&r, 1.0);
    r.state.speed_loop[0].integral_u = 1.1e-4;
    r.state.speed_loop[1].integral_u = -0.9e-4;
    r.state.loops = 0xF;
    turned(&r, 1.0);
    CHECK((r.state.loops & 3U) == 1);
}

static void gains_alone_move_nothing(void)
{
    rig r;
    core_config config = with_loops((speed_loop_gains){0});
    ready(&r, &config);
    put_gains(&r, PI);
    turned(&r, 1.0);
    CHECK(zero(&r) && r.out.enabled == 0);
    r.input.control.armed = 1;
    for (int i = 0; i < 100; i++) {
        turned(&r, 1.0);
        CHECK(zero(&r));
    }
    CHECK(r.out.enabled == 1);
}

/* The first gains count with any value of `gains_count`. */
static void gains_set_before_the_first_tick_count(void)
{
    static const uint32_t COUNTS[] = {1, 2, 7};
    for (int i = 0; i < COUNT_OF(COUNTS); i++) {
        rig r;
        core_config config = with_loops((speed_loop_gains){0});
        start(&r, &config);
        put_gains(&r, PI);
        r.input.control.gains_count = COUNTS[i];
        turned(&r, 1.0);
        CHECK(r.state.loops == 0xF && r.state.gains[3].gain_u_s_per_rad == PI.gain_u_s_per_rad);
    }
}

/* The count may equal the initial one or be the largest number. */
static void a_loop_keeps_running_whatever_the_count_of_its_gains(void)
{
    static const uint32_t COUNTS[] = {UINT32_MAX, 5,         UINT32_MAX,     7,          0,
                                      1,          INT32_MAX, INT32_MAX + 1U, UINT32_MAX, 0};
    for (uint32_t loops_at_first = 0; loops_at_first < 2; loops_at_first++) {
        rig r;
        core_config config = with_loops(loops_at_first != 0 ? PI : (speed_loop_gains){0});
        start(&r, &config);
        go(&r, 0.4, 0.0);
        for (int i = 0; i < COUNT_OF(COUNTS); i++) {
            speed_loop_gains gains = PI;
            gains.gain_u_s_per_rad += 1e-3 * i;
            put_gains(&r, gains);
            r.input.control.gains_count = COUNTS[i];
            turned(&r, 0.9);
            CHECK(r.state.gains[0].gain_u_s_per_rad == gains.gain_u_s_per_rad);
            for (int ms = 0; ms < 5; ms++) {
                double before_u = r.out.joint[0].duty;
                turned(&r, 0.9);
                CHECK(r.out.joint[0].duty > before_u);
            }
        }
    }
}

static void a_state_that_is_not_finite_gives_no_duty_in_any_loop(void)
{
    rig r;
    core_config config = with_loops(PI);
    start(&r, &config);
    go(&r, 0.4, 0.0);
    turned(&r, 0.5);
    CHECK(r.shown.speed_loop[1].output_u != 0.0);
    r.state.wheels.joint[0].torque_n_m = (double)NAN;
    prepare(&r);
    step(&r);
    CHECK(r.shown.faults == FAULT_STATE && zero(&r) && r.shown.speed_loop[1].output_u == 0.0);
    CHECK(r.state.speed_loop[1].integral_u == 0.0);
}

int main(void)
{
    without_gains_a_duty_is_that_of_the_map_bit_for_bit();
    a_slow_wheel_gets_more_duty_and_the_page_shows_it();
    at_rest_and_without_power_a_duty_is_zero();
    a_wheel_without_feedback_or_with_nan_gets_the_duty_of_the_map();
    an_impossibly_fast_wheel_gets_no_duty_and_one_without_gains_is_not_checked();
    a_duty_rises_by_its_slew_and_falls_at_once();
    gains_change_while_the_robot_moves_without_a_step_and_wrong_ones_change_nothing();
    each_gain_alone_makes_a_loop();
    only_changed_gains_keep_the_output_and_missing_joints_do_not_count();
    a_loop_without_gains_ends_when_its_integral_is_gone();
    gains_alone_move_nothing();
    gains_set_before_the_first_tick_count();
    a_loop_keeps_running_whatever_the_count_of_its_gains();
    a_state_that_is_not_finite_gives_no_duty_in_any_loop();
    return checks_report("test_core_duty");
}
