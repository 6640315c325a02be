/* SPDX-License-Identifier: Apache-2.0
 * The speed loop with its exact numbers: feed-forward, derivative, limits, and changes without a
 * step of the output. */
#include "check.h"
#include "torque_loop.h"

#include <math.h>

static const double DT_S = 0.01;

static speed_loop_config duty_loop(void)
{
    return (speed_loop_config){
        .gains = {.gain_u_s_per_rad = 0.02,
                  .integral_u_per_rad = 0.1,
                  .static_u = 0.05,
                  .viscous_u_s_per_rad = 0.04},
        .filter_s = 0.03,
        .correction_max_u = 0.25,
        .output_min_u = -1.0,
        .output_max_u = 1.0,
        .kind = SPEED_LOOP_DUTY,
    };
}

static bool near(double found, double wanted)
{
    return fabs(found - wanted) < 1e-12;
}

static void feed_forward_is_friction_in_the_direction_of_the_set_point_and_inertia(void)
{
    speed_loop_config config = duty_loop();
    config.gains.gain_u_s_per_rad = config.gains.integral_u_per_rad = 0.0;
    for (double sign = -1.0; sign <= 1.0; sign += 2.0) {
        speed_loop_state state = {.begun = 1};
        double rising = sign * (0.05 + 0.04 * 2.0 + 0.001 * 2.0 / DT_S),
               steady = sign * (0.05 + 0.04 * 2.0);
        config.gains.acceleration_u_s2_per_rad = 0.001;
        CHECK(near(loop_step(&state, &config, sign * 2.0, 0.0, DT_S), rising));
        CHECK(near(loop_step(&state, &config, sign * 2.0, 0.0, DT_S), steady));
        CHECK(near(loop_step(&state, &config, sign * 1.0, 1.0, DT_S),
                   sign * (0.05 + 0.04 - 0.001 / DT_S)));
        CHECK(loop_step(&state, &config, 0.0, 1.0, DT_S) == 0.0); /* at once, without a kick of the
                                                                     derivative */
    }
}

static void the_derivative_is_of_the_filtered_measure_alone(void)
{
    speed_loop_config config = torque_loop(0.0, 0.0, 80.0);
    config.gains.derivative_u_s2_per_rad = 0.5;
    config.filter_s = 0.03;
    speed_loop_state state = {.begun = 1};
    CHECK(loop_step(&state, &config, 5.0, 0.0, DT_S) == 0.0); /* a new set-point has no effect */
    CHECK(near(loop_step(&state, &config, 5.0, 1.0, DT_S), -0.5 * 1.0 / 0.04));
    CHECK(near(state.slow_rad_s, 0.25));
    CHECK(near(loop_step(&state, &config, 5.0, 1.0, DT_S), -0.5 * 0.75 / 0.04));
    speed_loop_state first = {0}; /* nor has a loop that begins at a turning wheel */
    CHECK(loop_step(&first, &config, 5.0, 3.0, DT_S) == 0.0 && near(first.slow_rad_s, 3.0));
}

static void the_loop_differs_from_its_feed_forward_by_a_bounded_amount(void)
{
    speed_loop_config config = duty_loop();
    for (double sign = -1.0; sign <= 1.0; sign += 2.0) {
        speed_loop_state state = {.begun = 1};
        for (int i = 0; i < 1000; i++) {
            loop_step(&state, &config, sign * 5.0, 0.0, DT_S);
        }
        CHECK(near(state.output_u, sign * (0.05 + 0.2 + 0.25)) && fabs(state.integral_u) <= 0.25);
        for (int i = 0; i < 1000; i++) {
            loop_step(&state, &config, sign * 5.0, sign * 20.0, DT_S);
        }
        CHECK(near(state.output_u, sign * (0.05 + 0.2 - 0.25)));
    }
}

static void the_part_that_an_output_limit_cuts_off_is_not_integrated(void)
{
    speed_loop_config config = duty_loop();
    config.output_min_u = 0.0; /* an output that cannot reverse */
    config.output_max_u = 0.3;
    speed_loop_state state = {.begun = 1};
    for (int i = 0; i < 1000; i++) {
        CHECK(loop_step(&state, &config, 5.0, 0.0, DT_S) <= 0.3);
    }
    CHECK(state.output_u == 0.3 && near(state.integral_u, 0.0));
    for (int i = 0; i < 1000; i++) {
        CHECK(loop_step(&state, &config, 4.0, 6.0, DT_S) >= 0.0);
    }
    double held = state.integral_u;
    CHECK(state.output_u < 0.003 && held < -0.16 && held > -0.18);
    /* the output returns at once */
    CHECK(loop_step(&state, &config, 5.0, 4.9, DT_S) > 0.0 && state.integral_u > held);
}

static void the_cut_off_part_holds_the_integral_and_not_the_output(void)
{
    speed_loop_config config = duty_loop();
    /* forward, and far too fast: the correction is at its limit */
    speed_loop_state state = {.begun = 1};
    for (int i = 0; i < 10; i++) {
        CHECK(near(loop_step(&state, &config, 8.0, 28.0, DT_S), 0.37 - 0.25) &&
              state.integral_u == 0.0);
    }
    config.output_max_u = 0.3;
    state = (speed_loop_state){.begun = 1}; /* the feed-forward alone exceeds the limit, and the
                                               wheel is too fast */
    CHECK(loop_step(&state, &config, 10.0, 11.0, DT_S) == 0.3 && near(state.integral_u, -0.001));
    /* an integral that fades does so also while the output is limited */
    config.gains.integral_u_per_rad = 0.0;
    state = (speed_loop_state){.begun = 1, .integral_u = 0.2};
    CHECK(loop_step(&state, &config, 10.0, 1.0, DT_S) == 0.3 && near(state.integral_u, 0.196));
    speed_loop_config none = torque_loop(1.0, 4.0, 0.0);
    state = (speed_loop_state){.begun = 1};
    CHECK(!signbit(loop_step(&state, &none, -1.0, 0.0, DT_S)));
}

static void a_change_of_gains_continues_from_the_last_output(void)
{
    speed_loop_config config = duty_loop();
    speed_loop_state state = {.begun = 1};
    for (int i = 0; i < 20; i++) {
        loop_step(&state, &config, 5.0, 4.0, DT_S);
    }
    double before = state.output_u;
    config.gains = (speed_loop_gains){0.05, 0.2, 0.01, 0.02, 0.05, 0.0};
    state.begun = 0;
    CHECK(near(loop_step(&state, &config, 5.0, 4.0, DT_S), before + 0.2 * 1.0 * DT_S));
    before = state.output_u;
    config.gains.integral_u_per_rad = 0.0; /* without it the integral fades, not in one step */
    state.begun = 0;
    CHECK(fabs(loop_step(&state, &config, 5.0, 4.0, DT_S) - before) < 0.01);
    for (int i = 0; i < 1000; i++) {
        loop_step(&state, &config, 5.0, 4.0, DT_S);
    }
    CHECK(fabs(state.output_u - (0.02 + 0.05 * 5.0 + 0.05 * 1.0)) < 1e-6);
    CHECK(near(loop_step(&state, &config, 5.0, 4.0, 10.0), 0.02 + 0.05 * 5.0 + 0.05 * 1.0) &&
          state.integral_u == 0.0);
}

static void a_loop_that_starts_at_a_turning_wheel_starts_without_output(void)
{
    speed_loop_config config = torque_loop(1.0, 4.0, 8.0);
    speed_loop_state state = {0};
    CHECK(near(loop_step(&state, &config, 0.0, 3.0, DT_S), -4.0 * 3.0 * DT_S));
    /* the earlier set-points are unknown */
    config.gains.acceleration_u_s2_per_rad = 0.5;
    speed_loop_state rising = {.output_u = 0.5};
    loop_step(&rising, &config, 2.0, 1.0, DT_S);
    CHECK(near(rising.integral_u, 0.5 - 1.0 + 4.0 * 1.0 * DT_S));
    speed_loop_state fast = {0}; /* the integral is limited, too */
    CHECK(near(loop_step(&fast, &config, 0.0, 10.0, DT_S), -2.4) && near(fast.integral_u, 7.6));
}

static void at_rest_a_duty_is_zero_and_a_torque_where_friction_holds_the_wheel(void)
{
    speed_loop_config duty = duty_loop(), torque = torque_loop(1.0, 4.0, 8.0);
    speed_loop_state state = {.begun = 1, .integral_u = 0.2, .output_u = 0.2};
    /* not slower than the speed of rest */
    CHECK(loop_step(&state, &duty, 0.0, 0.05, DT_S) < 0.2 && state.integral_u != 0.0);
    CHECK(loop_step(&state, &duty, 1e-9, 0.0, DT_S) != 0.0);
    CHECK(loop_step(&state, &duty, 0.0, -0.049, DT_S) == 0.0 && state.integral_u == 0.0 &&
          state.output_u == 0.0);
    state.integral_u = 0.2;
    CHECK(loop_step(&state, &torque, 0.0, 0.0, DT_S) == 0.2); /* holds the wheel on a slope */
    torque.gains.static_u = 0.2;
    CHECK(loop_step(&state, &torque, 0.0, 0.0, DT_S) == 0.2);
    torque.gains.static_u = 0.21;
    CHECK(loop_step(&state, &torque, 0.0, 0.0, DT_S) == 0.0 && state.integral_u == 0.0 &&
          state.begun == 1);
}

static void gains_are_finite_and_not_negative(void)
{
    const double bad[] = {-1e-9, 1.1e9, (double)NAN, (double)INFINITY};
    for (int field = 0; field < 6; field++) {
        for (int i = 0; i < 4; i++) {
            double each[6] = {0.0, 1e9, 0.0, 0.0, 0.0, 0.0};
            each[field] = bad[i];
            speed_loop_gains gains = {each[0], each[1], each[2], each[3], each[4], each[5]};
            CHECK(!speed_loop_gains_good(&gains));
        }
    }
    CHECK(speed_loop_gains_good(&(speed_loop_gains){0.0, 1e9, 1.0, 0.0, 1.0, 1.0}));
}

static void overflowing_numbers_give_no_output(void)
{
    speed_loop_config config = torque_loop(1e9, 1e9, 1e9);
    config.gains.derivative_u_s2_per_rad = 1e9;
    speed_loop_state state = {.begun = 1};
    CHECK(loop_step(&state, &config, 1e308, 0.0, DT_S) == 0.0 && state.integral_u == 0.0 &&
          state.begun == 0);
    state = (speed_loop_state){.begun = 1};
    CHECK(loop_step(&state, &config, (double)NAN, 0.0, DT_S) == 0.0 && state.begun == 0);
    state = (speed_loop_state){.begun = 1};
    CHECK(loop_step(&state, &config, 0.0, 1.0, 0.0) == 0.0 && state.begun == 0);
    state = (speed_loop_state){.begun = 1, .slow_rad_s = (double)NAN};
    CHECK(loop_step(&state, &config, 1.0, 0.0, DT_S) == 0.0 && state.slow_rad_s == 0.0);
    state = (speed_loop_state){.begun = 1, .overspeed = 1};
    CHECK(loop_step(&state, &config, 1.0, 0.0, (double)INFINITY) == 0.0 && state.overspeed == 1);
}

int main(void)
{
    feed_forward_is_friction_in_the_direction_of_the_set_point_and_inertia();
    the_derivative_is_of_the_filtered_measure_alone();
    the_loop_differs_from_its_feed_forward_by_a_bounded_amount();
    the_part_that_an_output_limit_cuts_off_is_not_integrated();
    the_cut_off_part_holds_the_integral_and_not_the_output();
    a_change_of_gains_continues_from_the_last_output();
    a_loop_that_starts_at_a_turning_wheel_starts_without_output();
    at_rest_a_duty_is_zero_and_a_torque_where_friction_holds_the_wheel();
    gains_are_finite_and_not_negative();
    overflowing_numbers_give_no_output();
    return checks_report("test_speed_loop_pid");
}
