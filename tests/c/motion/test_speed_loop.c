/* SPDX-License-Identifier: Apache-2.0
 * Wheels whose drives take a torque: how the core uses their speed loops, also with hostile
 * numbers. */
#include "check.h"
#include "core.h"
#include "good_config.h"
#include "torque_loop.h"

#include <float.h>
#include <math.h>
#include <string.h>

static const int64_t TICK_NS = 1000000;
static const double HOSTILE[] = {NAN,     INFINITY, -INFINITY, 0.0, -0.0,
                                 DBL_MIN, DBL_MAX,  -DBL_MAX,  1.0, -1.0};
static const double TORQUE_MAX_N_M = 8.0;
enum { HOSTILE_COUNT = sizeof HOSTILE / sizeof HOSTILE[0], WHEELS = 2 };

typedef struct {
    core_state state;
    core_input input;
    setpoints out;
    robot_state shown;
} base;

static core_config two_wheels(void)
{
    core_config config = good_config();
    config.joint_count = WHEELS;
    config.limits.linear = (axis_limits){2.0, 2.0, 2.0, INFINITY};
    for (uint32_t j = 0; j < WHEELS; j++) {
        config.joint[j].counter_bits = 0;
        config.joint[j].speed_loop = torque_loop(1.0, 4.0, TORQUE_MAX_N_M);
    }
    return config;
}

static const robot_state *tick(base *b, double velocity_rad_s)
{
    b->input.now_ns += TICK_NS;
    b->input.control.heartbeat_ns = b->input.command.stamp_ns = b->input.now_ns;
    b->input.command.expires_ns = b->input.now_ns + 1000000000;
    for (uint32_t j = 0; j < WHEELS; j++) {
        b->input.feedback[j] = (joint_feedback){
            .stamp_ns = b->input.now_ns, .velocity_rad_s = velocity_rad_s, .enabled = 1};
    }
    core_step(&b->state, &b->input, 1e-3, &b->out, &b->shown);
    return &b->shown;
}

static void armed(base *b, const core_config *config)
{
    memset(b, 0, sizeof *b);
    b->input.now_ns = 1000000000;
    b->input.control.limits = config->limits;
    CHECK(core_init(&b->state, config) == 0);
    tick(b, 0.0);
    b->input.control.armed = 1;
    CHECK(tick(b, 0.0)->armed == 1);
    b->input.command.linear_m_s = 0.5;
}

static void the_torque_is_finite_and_within_its_limit(void)
{
    const speed_loop_config config = torque_loop(1.0, 4.0, TORQUE_MAX_N_M);
    for (int i = 0; i < HOSTILE_COUNT * HOSTILE_COUNT * HOSTILE_COUNT; i++) {
        speed_loop_state state = {.integral_u = HOSTILE[i % HOSTILE_COUNT],
                                  .begun = (uint32_t)i % 3};
        double torque_n_m = loop_step(&state, &config, HOSTILE[i / HOSTILE_COUNT % HOSTILE_COUNT],
                                      HOSTILE[i / HOSTILE_COUNT / HOSTILE_COUNT],
                                      i % 2 == 0 ? 1e-3 : HOSTILE[i % 7]);
        CHECK(fabs(torque_n_m) <= TORQUE_MAX_N_M);
    }
}

static void a_wheel_that_is_too_slow_is_pushed_until_it_is_disarmed(void)
{
    base b;
    core_config config = two_wheels();
    armed(&b, &config);
    for (int i = 0; i < 500; i++) {
        tick(&b, 1.0);
    }
    CHECK(b.out.joint[0].torque_n_m > 1.0 &&
          b.out.joint[1].torque_n_m == b.out.joint[0].torque_n_m);
    b.input.control.armed = 0;
    tick(&b, 1.0);
    CHECK(b.out.enabled == 0 && b.out.joint[0].torque_n_m == 0.0 &&
          b.state.speed_loop[0].integral_u == 0.0);
}

static void an_impossibly_fast_wheel_loses_its_power(void)
{
    base b;
    core_config config = two_wheels();
    armed(&b, &config);
    tick(&b, 13.0);
    CHECK(b.shown.faults == 0);
    tick(&b, -14.0);
    CHECK(b.state.faults == FAULT_OVERSPEED && b.out.joint[0].torque_n_m == 0.0 &&
          b.out.joint[1].torque_n_m == 0.0);
    for (int i = 0; i < 100; i++) {
        tick(&b, 0.0);
    }
    CHECK(b.out.joint[0].torque_n_m == 0.0);
}

/* The integral is from before the loss: it must not push the wheel when its feedback returns. */
static void a_wheel_without_feedback_loses_its_integral_while_it_holds(void)
{
    base b;
    core_config config = two_wheels();
    config.on_fault = STOP_RAMP;
    armed(&b, &config);
    for (int i = 0; i < 500; i++) {
        tick(&b, 1.0);
    }
    CHECK(b.state.speed_loop[0].integral_u > 0.0);
    while (b.state.stale[0] == 0) {
        b.input.now_ns += TICK_NS;
        b.input.control.heartbeat_ns = b.input.command.stamp_ns = b.input.now_ns;
        b.input.command.expires_ns = b.input.now_ns + 1000000000;
        b.input.feedback[1].stamp_ns = b.input.now_ns; /* the other wheel reports */
        CHECK(b.state.speed_loop[0].integral_u > 0.0);
        core_step(&b.state, &b.input, 1e-3, &b.out, &b.shown);
    }
    CHECK(b.out.enabled == 1);
    CHECK(b.state.speed_loop[0].integral_u == 0.0 && b.out.joint[0].torque_n_m == 0.0);
    CHECK(b.state.speed_loop[1].integral_u != 0.0);
}

static void a_wheel_that_ran_away_loses_its_integral_at_once(void)
{
    base b;
    core_config config = two_wheels();
    armed(&b, &config);
    for (int i = 0; i < 500; i++) {
        tick(&b, 1.0);
    }
    CHECK(b.state.speed_loop[0].integral_u > 0.0);
    tick(&b, -14.0);
    CHECK(b.out.enabled == 1);
    for (uint32_t j = 0; j < WHEELS; j++) {
        CHECK(b.state.speed_loop[j].integral_u == 0.0 && b.out.joint[j].torque_n_m == 0.0);
    }
}

static void a_speed_that_is_not_finite_gives_no_torque(void)
{
    for (int i = 0; i < 3; i++) {
        base b;
        core_config config = two_wheels();
        armed(&b, &config);
        tick(&b, 0.0);
        tick(&b, HOSTILE[i]);
        CHECK(b.out.joint[0].torque_n_m == 0.0);
    }
}

int main(void)
{
    the_torque_is_finite_and_within_its_limit();
    a_wheel_that_is_too_slow_is_pushed_until_it_is_disarmed();
    an_impossibly_fast_wheel_loses_its_power();
    a_wheel_without_feedback_loses_its_integral_while_it_holds();
    a_wheel_that_ran_away_loses_its_integral_at_once();
    a_speed_that_is_not_finite_gives_no_torque();
    return checks_report("test_speed_loop");
}
