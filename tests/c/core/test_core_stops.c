/* SPDX-License-Identifier: Apache-2.0
 * test_core_stops: how a move ends, and when the power goes off. */
#include "core_rig.h"
#include "torque_loop.h"

/* Drives at speed with `config`, then changes the input by `of`. Returns for how many milliseconds
 * set-points are zero before the power goes off; 0: it stays on for five seconds. */
static int power_off_after_ms(const core_config *config, const change *of, bool wheels_stop)
{
    rig r;
    start(&r, config);
    go(&r, 0.3, 0.0);
    int zero_ms = 0;
    for (int ms = 0; ms < 5000; ms++) {
        prepare(&r);
        for (int j = 0; j < 4 && !wheels_stop; j++) {
            r.input.feedback[j].velocity_rad_s = 1.0;
        }
        apply(&r.input, of);
        step(&r);
        CHECK(r.shown.faults == of->expected);
        zero_ms += r.out.enabled && zero(&r);
        if (!r.out.enabled) {
            return zero_ms;
        }
    }
    return 0;
}

static void the_power_goes_off_at_rest_or_when_the_set_points_have_been_zero_for_two_seconds(void)
{
    static const change EXTERNAL = LEVEL_OF(control.fault, 1, FAULT_EXTERNAL),
                        ESTOP = LEVEL_OF(control.estop, 1, FAULT_ESTOP);
    static const change STALE = AGE_OF(feedback[2].stamp_ns, NEVER, FAULT_FEEDBACK_STALE);
    core_config config = good_config();
    for (int j = 0; j < 4; j++) {
        config.joint[j].counter_bits = 0;
    }
    for (int action = STOP_RAMP; action <= STOP_COAST; action++) {
        config.on_estop = config.on_fault = (stop_action)action;
        bool zero_first = action == STOP_RAMP || action == STOP_BRAKE;
        CHECK(power_off_after_ms(&config, &EXTERNAL, false) == (zero_first ? 2001 : 0));
        CHECK(power_off_after_ms(&config, &STALE, true) == (zero_first ? 2001 : 0));
        int soon_ms = power_off_after_ms(&config, &ESTOP, true);
        CHECK(zero_first ? soon_ms >= 0 && soon_ms <= 2 : soon_ms == 0);
    }
    /* a clock that steps back ends the hold, too */
    config.on_fault = STOP_BRAKE;
    rig r;
    start(&r, &config);
    go(&r, 0.3, 0.0);
    r.stale = true;
    r.input.control.fault = 1;
    CHECK(ticks(&r, 3)->enabled == 1);
    r.input.now_ns -= 10 * MS_NS;
    CHECK(tick(&r)->enabled == 0);
}

static void a_fault_of_direction_or_runaway_outranks_the_configured_action(void)
{
    static const struct {
        uint32_t faults;
        stop_action on_estop, on_fault, expected;
    } ACTIONS[] = {
        {FAULT_ESTOP, STOP_BRAKE, STOP_RAMP, STOP_BRAKE},
        {FAULT_EXTERNAL, STOP_BRAKE, STOP_RAMP, STOP_RAMP},
        {FAULT_ESTOP | FAULT_EXTERNAL, STOP_HOLD, STOP_RAMP, STOP_HOLD},
        {FAULT_DIRECTION, STOP_HOLD, STOP_RAMP, STOP_BRAKE},
        {FAULT_DIRECTION, STOP_HOLD, STOP_COAST, STOP_COAST},
        {FAULT_DIRECTION | FAULT_ESTOP, STOP_HOLD, STOP_COAST, STOP_BRAKE},
        {FAULT_RUNAWAY, STOP_HOLD, STOP_RAMP, STOP_COAST},
        {FAULT_RUNAWAY | FAULT_ESTOP, STOP_HOLD, STOP_RAMP, STOP_COAST},
        {FAULT_STALL, STOP_HOLD, STOP_RAMP, STOP_RAMP},
    };
    for (int i = 0; i < COUNT_OF(ACTIONS); i++) {
        rig r;
        core_config config = good_config();
        config.on_estop = ACTIONS[i].on_estop;
        config.on_fault = ACTIONS[i].on_fault;
        start(&r, &config);
        go(&r, 0.4, 0.0);
        r.state.faults = ACTIONS[i].faults;
        r.input.control.estop = ACTIONS[i].faults & FAULT_ESTOP;
        r.input.control.fault = 1;
        tick(&r);
        CHECK(r.shown.armed == 0 && r.out.enabled == (ACTIONS[i].expected != STOP_COAST));
        CHECK(zero(&r) == (ACTIONS[i].expected == STOP_BRAKE || ACTIONS[i].expected == STOP_COAST));
        CHECK(ticks(&r, 4000)->enabled == (ACTIONS[i].expected == STOP_HOLD) && zero(&r));
    }
}

static void a_requested_disarm_ends_a_hold_by_removing_power(void)
{
    static const uint32_t FAULTS[] = {FAULT_EXTERNAL, FAULT_ESTOP, FAULT_STALL};
    for (int i = 0; i < COUNT_OF(FAULTS) * 2; i++) {
        bool before = i % 2 == 0; /* the disarm is requested before the fault; the base still holds
                                     until it rests */
        rig r;
        core_config config = good_config();
        config.on_fault = config.on_estop = STOP_HOLD;
        start(&r, &config);
        go(&r, 0.4, 0.0);
        r.input.control.release = before;
        CHECK(tick(&r)->armed == 1 && r.out.enabled == 1);
        r.state.faults = FAULTS[i / 2];
        r.state.doubted = FAULTS[i / 2] == FAULT_STALL;
        r.input.control.estop = FAULTS[i / 2] == FAULT_ESTOP;
        r.input.control.fault = 1;
        CHECK(tick(&r)->enabled == 1 && !zero(&r));
        r.input.control.release = 1;
        bool trusted = FAULTS[i / 2] != FAULT_STALL;
        CHECK(ticks(&r, 100)->enabled == 1 && !zero(&r));
        CHECK(ticks(&r, 400)->enabled == !trusted && zero(&r));
        /* rest is not seen: the power goes off after two seconds */
        CHECK(ticks(&r, 2000)->enabled == 0 && r.shown.faults != 0);
        r.input.control.release = 0;
        CHECK(ticks(&r, 10)->enabled == 0);
    }
}

static void a_stop_or_a_lost_command_coasts_only_where_configured_and_after_a_command(void)
{
    for (int action = STOP_RAMP; action <= STOP_COAST; action++) {
        rig r;
        core_config config = good_config();
        config.on_timeout = (stop_action)action;
        start(&r, &config);
        tick(&r);
        r.input.control.armed = 1;
        r.mute = true;
        r.input.command.stamp_ns = 0;
        CHECK(ticks(&r, 400)->armed == 1 && r.shown.reasons == REASON_COMMAND_STALE);
        r.mute = false;
        r.input.command.linear_m_s = 0.4;
        CHECK(tick(&r)->setpoint_linear_m_s > 0.0); /* in the tick in which the command arrives */
        CHECK(ticks(&r, 1500)->armed == 1 && fabs(r.shown.setpoint_linear_m_s - 0.4) < 1e-12);
        r.input.control.stop = 1;
        tick(&r);
        CHECK(r.shown.armed == (action != STOP_COAST) && r.out.enabled == r.shown.armed);
        CHECK(zero(&r) == (action == STOP_BRAKE || action == STOP_COAST));
        CHECK(ticks(&r, 1500)->at_rest == 1 && r.shown.armed == (action != STOP_COAST));
        r.input.control.stop = 0;
        CHECK(ticks(&r, 1500)->setpoint_linear_m_s == (action == STOP_COAST ? 0.0 : 0.4));
        r.mute = true;
        CHECK(ticks(&r, 300)->armed == (action != STOP_COAST));
        tick(&r);
        CHECK(r.shown.armed == (action != STOP_COAST) && (r.shown.reasons & REASON_COMMAND_STALE));
        CHECK(zero(&r) == (action == STOP_BRAKE || action == STOP_COAST));
    }
}

static void at_rest_is_slower_than_the_configured_speed_with_set_points_of_zero(void)
{
    core_config config = good_config();
    rig r;
    ready(&r, &config);
    for (int j = 0; j < 4; j++) {
        for (int sign = -1; sign <= 1; sign += 2) {
            prepare(&r);
            r.input.feedback[j].velocity_rad_s = sign * 0.05;
            CHECK(step(&r)->at_rest == 0);
            prepare(&r);
            r.input.feedback[j].velocity_rad_s = sign * nextafter(0.05, 0.0);
            CHECK(step(&r)->at_rest == 1);
        }
    }
    prepare(&r);
    r.input.feedback[3].velocity_rad_s = 1.0;
    step(&r);
    for (int ms = 0; ms < 249; ms++) {
        r.input.now_ns += TICK_NS;
        for (int j = 0; j < 3; j++) {
            r.input.feedback[j].stamp_ns = r.input.now_ns;
        }
        CHECK(step(&r)->at_rest == 0);
    }
    r.input.now_ns += 2 * TICK_NS; /* whether this wheel turns is not seen any more */
    for (int j = 0; j < 3; j++) {
        r.input.feedback[j].stamp_ns = r.input.now_ns;
    }
    CHECK(step(&r)->at_rest == 0 && r.shown.joint[3].stale == 1);
}

static void a_torque_ends_with_its_power_its_feedback_or_its_runaway(void)
{
    core_config config = good_config();
    for (int j = 0; j < 4; j++) {
        config.joint[j].counter_bits = 0;
        config.joint[j].velocity_min_rad_s = -4.0;
        config.joint[j].velocity_max_rad_s = 8.0;
        config.joint[j].speed_loop = torque_loop(1.0, 4.0, 8.0);
    }
    config.joint[1].speed_loop.kind = SPEED_LOOP_NONE;
    config.on_fault = STOP_HOLD;
    for (int sign = -1; sign <= 1; sign += 2) {
        rig r;
        start(&r, &config);
        go(&r, 0.2, 0.0);
        prepare(&r);
        r.input.feedback[0].velocity_rad_s = sign * 12.0; /* one and a half times the limit */
        CHECK(step(&r)->faults == 0 && r.out.joint[0].torque_n_m == -sign * 8.0 &&
              r.out.joint[1].torque_n_m == 0.0);
        prepare(&r);
        r.input.feedback[1].velocity_rad_s = sign * 12.1;
        CHECK(step(&r)->faults == 0);
        prepare(&r);
        r.input.feedback[0].velocity_rad_s = sign * 12.1;
        CHECK(step(&r)->faults == FAULT_OVERSPEED && r.out.joint[0].torque_n_m == 0.0 &&
              r.out.enabled == 1);
        CHECK(r.state.speed_loop[0].integral_u == 0.0 && r.out.joint[2].torque_n_m != 0.0);
        prepare(&r); /* the fault is latched: the wheel is slower again, and gets no torque */
        r.input.feedback[0].velocity_rad_s = -sign;
        CHECK(step(&r)->faults == FAULT_OVERSPEED && r.out.joint[0].torque_n_m == 0.0);
        r.input.command.linear_m_s = 0.0;
        r.input.control.armed = 0;
        ticks(&r, 3000);
        r.input.control.reset_count++;
        ticks(&r, 2);
        CHECK(r.shown.faults == 0 && r.state.speed_loop[0].overspeed == 0 &&
              r.state.speed_loop[2].integral_u == 0.0);
    }
    rig r;
    start(&r, &config);
    go(&r, 0.2, 0.0);
    step_with(&r, &(change)AGE_OF(feedback[2].stamp_ns, 300000000, 0));
    CHECK(r.shown.faults == FAULT_FEEDBACK_STALE && r.out.joint[2].torque_n_m == 0.0);
    CHECK(r.state.speed_loop[2].integral_u == 0.0 && r.out.joint[0].velocity_rad_s > 1.0);
}

/* A single long time step does not make the base stop at once. */
static void a_late_tick_in_a_stop_ramps_by_the_elapsed_time(void)
{
    static const double STEPS_S[] = {0.1, 1.0, 0.0, -0.1};
    core_config config = good_config();
    config.limits.linear.jerk_u_s3 = INFINITY;
    for (int i = 0; i < COUNT_OF(STEPS_S); i++) {
        rig r;
        start(&r, &config);
        go(&r, 0.85, 0.0);
        r.input.control.stop = 1;
        prepare(&r);
        core_step(&r.state, &r.input, STEPS_S[i], &r.out, &r.shown);
        double expected_m_s =
            STEPS_S[i] > 0.0 ? 0.85 - 0.1 * config.limits.linear.deceleration_u_s2 : 0.0;
        CHECK(fabs(r.shown.setpoint_linear_m_s - expected_m_s) < 1e-9);
        for (int j = 0; j < 4; j++) {
            CHECK((r.shown.joint[j].setpoint_rad_s == 0.0) == (expected_m_s == 0.0));
            CHECK(expected_m_s != 0.0 ||
                  (r.shown.joint[j].duty == 0.0 && r.out.joint[j].duty == 0.0));
        }
    }
}

int main(void)
{
    the_power_goes_off_at_rest_or_when_the_set_points_have_been_zero_for_two_seconds();
    a_fault_of_direction_or_runaway_outranks_the_configured_action();
    a_requested_disarm_ends_a_hold_by_removing_power();
    a_stop_or_a_lost_command_coasts_only_where_configured_and_after_a_command();
    at_rest_is_slower_than_the_configured_speed_with_set_points_of_zero();
    a_torque_ends_with_its_power_its_feedback_or_its_runaway();
    a_late_tick_in_a_stop_ramps_by_the_elapsed_time();
    return checks_report("test_core_stops");
}
