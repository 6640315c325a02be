/* SPDX-License-Identifier: Apache-2.0
 * test_bridge_steps: the levels of a bridge's pins, step by step and exact to the nanosecond, and
 * each bound of its configuration. */
#include <errno.h>
#include <float.h>
#include <math.h>
#include <stdint.h>

#include "check.h"
#include "rt.h"

static const int64_t MS = 1000000, START_NS = 5000000000;

/* Two motors. Each mode has its own level and its own share of the duty. */
static bridge_config two_motors(void)
{
    bridge_config config = {
        .outputs_fd = 0,
        .inputs_fd = -1,
        .event_fd = -1,
        .period_ns = 1,
        .setpoint_timeout_ns = 100 * MS,
        .stopping_ns = 300 * MS,
        .joint_count = 2,
        .output_count = 2,
        .joint = {{.sign = 1.0, .rest_mode = BRIDGE_BRAKE},
                  {.index = 1, .sign = -1.0, .rest_mode = BRIDGE_COAST}},
    };
    for (uint32_t i = 0; i < 2; i++) {
        config.output[i] = (bridge_pin){.joint = i,
                                        .fd = -1,
                                        .bit = i,
                                        .base = {0.1, 0.2, 0.3, 0.4},
                                        .slope = {0.05, 0.15, 0.25, 0.35}};
    }
    return config;
}

typedef struct {
    bridge_config config;
    bridge_state state;
    bridge_control control;
    setpoints newest;
    int64_t now_ns, age_ns;
    double level[PWM_OUTPUTS_MAX];
} bench;

static bench begun(void)
{
    bench b = {.config = two_motors(),
               .now_ns = START_NS,
               .newest = {.enabled = 1,
                          .joint_count = 2,
                          .joint = {{.duty = 0.5}, {.duty = 0.5}, {.duty = 0.7}}}};
    return b;
}

static const double *steps_on(bench *b, int64_t after_ns)
{
    b->now_ns += after_ns;
    b->newest.stamp_ns = b->now_ns - b->age_ns;
    for (int i = 0; i < PWM_OUTPUTS_MAX; i++) {
        b->level[i] = 77.0;
    }
    bridge_step(&b->state, &b->config, &b->control, &b->newest, b->now_ns, b->level);
    for (uint32_t i = b->config.output_count; i < PWM_OUTPUTS_MAX; i++) {
        CHECK(b->level[i] == 77.0);
    }
    return b->level;
}

static const double *requests(bench *b, uint32_t request)
{
    b->control.mode = request;
    b->control.number++;
    return steps_on(b, MS);
}

static bool is(double value, double expected)
{
    return fabs(value - expected) < 1e-12;
}

static void each_mode_has_its_level(void)
{
    bench b = begun();
    steps_on(&b, 0);
    CHECK(b.level[0] == 0.1 && b.level[1] == 0.1); /* without power */
    requests(&b, PWM_ARMED);
    CHECK(is(b.level[0], 0.3 + 0.25 * 0.5) && is(b.level[1], 0.4 + 0.35 * 0.5));
    b.newest.joint[0].duty = 0.05, b.newest.joint[1].duty = -0.05;
    steps_on(&b, MS);
    CHECK(is(b.level[0], 0.3 + 0.25 * 0.05) && is(b.level[1], 0.3 + 0.25 * 0.05));
    b.newest.joint[0].duty = b.newest.joint[1].duty = 0.0;
    steps_on(&b, MS);
    CHECK(b.level[0] == 0.2 && b.level[1] == 0.1); /* each joint has its own mode at rest */
    for (int direction = -1; direction <= 1; direction += 2) {
        for (int i = 0; i < 4; i++) {
            b.newest.joint[0].duty = direction * (const double[]){1.0, 1.05, 1.5, 40.0}[i];
            CHECK(is(steps_on(&b, MS)[0], direction > 0 ? 0.3 + 0.25 : 0.4 + 0.35));
        }
    }
    requests(&b, PWM_STOP);
    CHECK(b.level[0] == 0.2 && b.level[1] == 0.2);
    CHECK(steps_on(&b, 300 * MS - 1)[1] == 0.2 && steps_on(&b, 1)[1] == 0.1 &&
          !b.state.drive.stopping);
    requests(&b, PWM_ARMED);
    CHECK(b.state.drive.mode == DRIVE_ARMED);
    requests(&b, PWM_OFF);
    CHECK(b.level[0] == 0.1 && b.level[1] == 0.1 && !b.state.drive.stopping);
}

static void a_joint_without_set_points_rests(void)
{
    bench b = begun();
    b.config.joint[1].index = 2;
    requests(&b, PWM_ARMED);
    CHECK(is(b.level[0], 0.3 + 0.25 * 0.5) && b.level[1] == 0.1);
}

/* A servo on pin 0: its level is 0.5 in the middle, and 0.25 or 0.75 at the ends. */
static bench servo(void)
{
    bench b = begun();
    b.config.joint[0].full_rad = 0.8;
    const double base[4] = {0.0, 0.5, 0.5, 0.5}, slope[4] = {0.0, 0.0, 0.25, -0.25};
    for (int mode = 0; mode < 4; mode++) {
        b.config.output[0].base[mode] = base[mode], b.config.output[0].slope[mode] = slope[mode];
    }
    b.newest.positioned = 1;
    return b;
}

static void a_servo_gets_the_pulses_of_its_newest_position(void)
{
    bench b = servo();
    b.newest.position_rad[0] = 0.4;
    /* without power there are no pulses */
    CHECK(bridge_config_check(&b.config) == 0 && steps_on(&b, 0)[0] == 0.0);
    CHECK(is(requests(&b, PWM_ARMED)[0], 0.5 + 0.125));
    const double at_rad[] = {0.0, -0.2, -0.8, -0.84, -1.2, -7.0, 0.8, 0.84, 1.2, 7.0};
    const double levels[] = {0.5, 0.4375, 0.25, 0.25, 0.25, 0.25, 0.75, 0.75, 0.75, 0.75};
    for (int i = 0; i < 10; i++) {
        b.newest.position_rad[0] = at_rad[i];
        CHECK(is(steps_on(&b, MS)[0], levels[i]));
    }
    b.config.joint[0].sign = -1.0;
    CHECK(is(steps_on(&b, MS)[0], 0.25));
}

static void a_servo_may_have_any_range_and_zero_is_its_middle(void)
{
    const double full_rad[] = {0.1, 0.8, 1.0, 2.0, 1000.0};
    for (int i = 0; i < 5; i++) {
        bench b = servo();
        b.config.joint[0].full_rad = full_rad[i];
        /* a position of 0 has the levels of forward */
        b.config.output[0].base[BRIDGE_REVERSE] = 0.4;
        b.newest.position_rad[0] = 0.5 * full_rad[i];
        CHECK(bridge_config_check(&b.config) == 0 && is(requests(&b, PWM_ARMED)[0], 0.5 + 0.125));
        b.newest.position_rad[0] = 0.0;
        CHECK(is(steps_on(&b, MS)[0], 0.5));
        b.newest.position_rad[0] = -0.5 * full_rad[i];
        CHECK(is(steps_on(&b, MS)[0], 0.4 - 0.125));
    }
}

/* Servos in both places of the table, for joints in another order. */
static void each_servo_has_a_position_of_its_own(void)
{
    bench b = servo();
    b.config.output[1] = b.config.output[0];
    b.config.output[1].joint = 1, b.config.output[1].bit = 1;
    b.config.joint[0].index = 2;
    b.config.joint[1] =
        (bridge_joint){.index = 1, .sign = 1.0, .full_rad = 0.4, .rest_mode = BRIDGE_COAST};
    b.newest.joint_count = 3, b.newest.positioned = 6;
    b.newest.position_rad[0] = 7.0, b.newest.position_rad[1] = 0.2, b.newest.position_rad[2] = -0.4;
    requests(&b, PWM_ARMED);
    CHECK(is(b.level[0], 0.375) && is(b.level[1], 0.625));
    b.newest.position_rad[1] = -0.1, b.newest.position_rad[2] = 0.2;
    b.newest.positioned = 2;
    steps_on(&b, MS);
    CHECK(is(b.level[0], 0.375) && is(b.level[1], 0.4375));
    b.newest.positioned = 4;
    b.newest.position_rad[1] = 0.4;
    steps_on(&b, MS);
    CHECK(is(b.level[0], 0.5625) && is(b.level[1], 0.4375));
    /* a servo without any position so far gets no pulses */
    for (uint32_t known = 0; known < 4; known++) {
        bench c = b;
        c.state = (bridge_state){0}, c.control = (bridge_control){0};
        c.newest.positioned = (known & 1U ? 4U : 0U) | (known & 2U ? 2U : 0U);
        requests(&c, PWM_ARMED);
        CHECK((c.level[0] != 0.0) == ((known & 1U) != 0) &&
              (c.level[1] != 0.0) == ((known & 2U) != 0));
    }
}

static void the_full_number_of_servos_have_a_position_each(void)
{
    bench b = servo();
    b.config.joint_count = b.newest.joint_count = JOINTS_MAX;
    b.newest.positioned = (1U << JOINTS_MAX) - 1U;
    b.config.output[0].pumps = 1; /* would be read for a joint beyond the last */
    for (uint32_t j = 0; j < JOINTS_MAX; j++) {
        b.config.joint[j] =
            (bridge_joint){.index = j, .sign = 1.0, .full_rad = 0.8, .rest_mode = BRIDGE_COAST};
        b.newest.position_rad[j] = 0.1 * j;
    }
    CHECK(bridge_config_check(&b.config) == 0);
    requests(&b, PWM_ARMED);
    CHECK(b.state.holds == b.newest.positioned);
    for (uint32_t j = 0; j < JOINTS_MAX; j++) {
        CHECK(is(b.state.held_duty[j], 0.125 * j));
    }
}

static void a_servo_without_a_position_holds_the_one_before(void)
{
    bench b = servo();
    b.newest.positioned = 0;
    CHECK(requests(&b, PWM_ARMED)[0] == 0.0); /* no position so far: no pulses */
    b.newest.positioned = 1, b.newest.position_rad[0] = -0.4;
    CHECK(is(steps_on(&b, MS)[0], 0.375));
    const double nonsense[] = {NAN, INFINITY, -INFINITY};
    for (int i = 0; i < 3; i++) {
        b.newest.position_rad[0] = nonsense[i];
        CHECK(is(steps_on(&b, MS)[0], 0.375));
    }
    b.newest.position_rad[0] = 0.8, b.newest.positioned = 0;
    CHECK(is(steps_on(&b, MS)[0], 0.375));
    b.newest.positioned = 1, b.newest.joint_count = 0;
    CHECK(is(steps_on(&b, MS)[0], 0.375));
}

static void a_servo_that_stops_holds_its_position_and_then_gets_no_pulses(void)
{
    /* the servo stops by a request, by old set-points, or when it is no longer enabled */
    for (int how = 0; how < 3; how++) {
        bench b = servo();
        b.newest.position_rad[0] = 0.4;
        requests(&b, PWM_ARMED);
        b.newest.position_rad[0] = -0.8;
        b.newest.enabled = how != 2;
        b.age_ns = how == 1 ? 200 * MS : 0;
        double level = how == 0 ? requests(&b, PWM_STOP)[0] : steps_on(&b, 50 * MS)[0];
        CHECK(how == 2 ? level == 0.0 || is(level, 0.625) : is(level, 0.625));
        CHECK(!b.state.drive.stopping || is(steps_on(&b, 50 * MS)[0], 0.625));
        CHECK(steps_on(&b, 400 * MS)[0] == 0.0 && steps_on(&b, MS)[0] == 0.0);
        b.age_ns = 0, b.newest.enabled = 1, b.newest.positioned = 0;
        CHECK(requests(&b, PWM_ARMED)[0] == 0.0); /* the position before does not count */
    }
    bench b = servo();
    requests(&b, PWM_ARMED);
    CHECK(requests(&b, PWM_OFF)[0] == 0.0);
}

static void each_fault_reason_stays_until_the_next_arming(void)
{
    bench b = begun();
    requests(&b, PWM_ARMED);
    steps_on(&b, 100 * MS); /* set-points are fresh for so long */
    CHECK(b.state.drive.mode == DRIVE_ARMED && b.state.drive.fault_reasons == 0);
    steps_on(&b, 100 * MS + 1);
    CHECK(b.state.drive.fault_reasons == DRIVE_FAULT_LEFT_ALONE && b.level[0] == 0.2);
    b.age_ns = 100 * MS + 1;
    requests(&b, PWM_ARMED);
    CHECK(b.state.drive.mode == DRIVE_READY &&
          b.state.drive.fault_reasons == (DRIVE_FAULT_LEFT_ALONE | DRIVE_FAULT_SETPOINTS_OLD));
    CHECK(b.state.drive.stopping && b.level[0] == 0.2);
    b.age_ns = 100 * MS;
    requests(&b, PWM_OFF);
    CHECK(!b.state.drive.stopping && b.level[0] == 0.1);
    requests(&b, PWM_ARMED);
    CHECK(b.state.drive.mode == DRIVE_ARMED && b.state.drive.fault_reasons == 0);
    b.age_ns = 100 * MS + 1;
    steps_on(&b, MS);
    CHECK(b.state.drive.fault_reasons == DRIVE_FAULT_SETPOINTS_OLD && b.state.drive.stopping &&
          b.state.brake_until_ns == b.now_ns + 300 * MS);
    b.age_ns = 0;
    b.control.number++;
    requests(&b, PWM_ARMED); /* a request was missed: it may have been a stop */
    CHECK(b.state.drive.mode == DRIVE_READY && !b.state.drive.stopping && b.level[0] == 0.1);
}

static void a_braking_bridge_ignores_requests_except_power_off(void)
{
    bench b = begun();
    requests(&b, PWM_ARMED);
    requests(&b, PWM_STOP);
    int64_t until_ns = b.now_ns + 300 * MS;
    CHECK(b.state.drive.stopping && b.state.brake_until_ns == until_ns);
    requests(&b, PWM_ARMED);
    CHECK(b.state.drive.mode == DRIVE_READY && b.state.drive.stopping && b.level[0] == 0.2 &&
          b.level[1] == 0.2);
    requests(&b, PWM_STOP); /* as at the end of the line */
    CHECK(b.state.drive.stopping && b.state.brake_until_ns == until_ns && b.level[0] == 0.2);
    CHECK(b.state.drive.fault_reasons == 0);
    requests(&b, PWM_OFF);
    CHECK(!b.state.drive.stopping && b.level[0] == 0.1 && b.level[1] == 0.1);
    requests(&b, PWM_STOP);
    CHECK(!b.state.drive.stopping && b.level[0] == 0.1); /* a bridge without power does not brake */
    requests(&b, PWM_ARMED);
    CHECK(b.state.drive.mode == DRIVE_ARMED);
}

/* The core may enable the bridge later. When it has done so, even between two looks, and ends it,
 * the bridge loses its power. */
static void a_bridge_that_is_no_longer_enabled_has_no_power(void)
{
    bench b = begun();
    b.state.enabled_count = 5;
    b.newest.enabled = 0;
    requests(&b, PWM_ARMED);
    CHECK(b.state.drive.mode == DRIVE_ARMED && b.level[0] == 0.2 && b.level[1] == 0.1);
    steps_on(&b, MS);
    CHECK(b.state.drive.mode == DRIVE_ARMED);
    b.state.enabled_count = 6;
    steps_on(&b, MS);
    CHECK(b.state.drive.fault_reasons == DRIVE_FAULT_NOT_ENABLED && b.level[0] == 0.1 &&
          !b.state.drive.stopping);
    requests(&b, PWM_ARMED);
    b.newest.enabled = 1;
    steps_on(&b, MS);
    CHECK(b.state.drive.mode == DRIVE_ARMED && is(b.level[0], 0.3 + 0.25 * 0.5));
    b.newest.enabled = 0;
    steps_on(&b, MS);
    CHECK(b.state.drive.fault_reasons == DRIVE_FAULT_NOT_ENABLED &&
          b.state.drive.mode == DRIVE_READY);
}

static void a_level_is_rounded_to_whole_nanoseconds_of_the_period(void)
{
    bridge_pin pin = {.period_ns = 1000};
    CHECK(bridge_duty_ns(&pin, 0.05) == 50 && bridge_duty_ns(&pin, 0.00145) == 1 &&
          bridge_duty_ns(&pin, 0.00155) == 2);
    CHECK(bridge_duty_ns(&pin, 0.0) == 0 && bridge_duty_ns(&pin, 1.0) == 1000 &&
          bridge_duty_ns(&pin, 1.05) == 1000);
    pin.period_ns = (UINT64_C(1) << 53) + 3; /* the nearest double is larger */
    CHECK(bridge_duty_ns(&pin, 1.0) == pin.period_ns);
    pin.period_ns = 1000;
    pin.inverted = 1;
    CHECK(bridge_duty_ns(&pin, 0.0) == 1000 && bridge_duty_ns(&pin, 1.0) == 0 &&
          bridge_duty_ns(&pin, INFINITY) == 0);
}

#define ALLOWED(field, value) expects(0, &config, (config = two_motors(), config.field = value, 0))
#define REFUSED(field, value)                                                                      \
    expects(-EINVAL, &config, (config = two_motors(), config.field = value, 0))

static void expects(int verdict, const bridge_config *config, int changed)
{
    CHECK(changed == 0 && bridge_config_check(config) == verdict);
}

static void each_number_of_a_config_has_its_range(void)
{
    bridge_config config = two_motors();
    CHECK(bridge_config_check(&config) == 0);
    REFUSED(joint[0].full_rad, -1.0);
    REFUSED(joint[1].full_rad, (double)NAN);
    ALLOWED(joint[1].full_rad, 1000.0);
    REFUSED(joint[1].full_rad, nextafter(1000.0, 2000.0));
    REFUSED(joint_count, 0);
    REFUSED(joint_count, JOINTS_MAX + 1);
    REFUSED(output_count, 0);
    REFUSED(output_count, PWM_OUTPUTS_MAX + 1);
    REFUSED(period_ns, 0);
    REFUSED(setpoint_timeout_ns, 0);
    ALLOWED(setpoint_timeout_ns, 1);
    ALLOWED(stopping_ns, 0);
    REFUSED(stopping_ns, -1);
    ALLOWED(priority, 99);
    REFUSED(priority, 100);
    REFUSED(priority, -1);
    REFUSED(outputs_fd, -1);
    for (uint32_t i = 0; i < 2; i++) {
        ALLOWED(joint[i].index, JOINTS_MAX - 1);
        REFUSED(joint[i].index, JOINTS_MAX);
        REFUSED(joint[i].sign, 0.0);
        REFUSED(joint[i].sign, 2.0);
        REFUSED(joint[i].sign, -2.0);
        REFUSED(joint[i].sign, (double)NAN);
        ALLOWED(joint[i].rest_mode, BRIDGE_BRAKE);
        ALLOWED(joint[i].rest_mode, BRIDGE_COAST);
        REFUSED(joint[i].rest_mode, BRIDGE_FORWARD);
        REFUSED(joint[i].encoder.kind, 99);
        REFUSED(output[i].joint, 2);
        ALLOWED(output[i].bit, 63);
        REFUSED(output[i].bit, 64);
        ALLOWED(output[i].pumps, 1);
        REFUSED(output[i].fd, 0); /* the file of a channel needs a period */
        for (uint32_t mode = 0; mode < BRIDGE_MODES; mode++) {
            ALLOWED(output[i].base[mode], 0.0);
            REFUSED(output[i].base[mode], -1e-9);
            REFUSED(output[i].base[mode], 1.0 + DBL_EPSILON);
            REFUSED(output[i].base[mode], (double)NAN);
            REFUSED(output[i].slope[mode], 1.0);
            REFUSED(output[i].slope[mode], -0.5);
            REFUSED(output[i].slope[mode], (double)NAN);
            config = two_motors();
            config.output[i].base[mode] = 1.0, config.output[i].slope[mode] = -1.0;
            CHECK(bridge_config_check(&config) == 0);
            config.output[i].base[mode] = 0.0, config.output[i].slope[mode] = 1.0;
            CHECK(bridge_config_check(&config) == 0);
            config.output[i].base[mode] = 1.05, config.output[i].slope[mode] = -0.5;
            CHECK(bridge_config_check(&config) == -EINVAL);
            config.output[i].base[mode] = 1.5, config.output[i].slope[mode] = -1.0;
            CHECK(bridge_config_check(&config) == -EINVAL);
            config.output[i].base[mode] = -0.5, config.output[i].slope[mode] = 1.0;
            CHECK(bridge_config_check(&config) == -EINVAL);
        }
        config = two_motors();
        config.output[i].fd = 0, config.output[i].period_ns = 1, config.outputs_fd = i == 0 ? 0 : 7;
        CHECK(bridge_config_check(&config) == 0);
        config.output[i].period_ns = INT64_MAX / 2;
        CHECK(bridge_config_check(&config) == 0);
        config.output[i].period_ns++;
        CHECK(bridge_config_check(&config) == -EINVAL);
        config.output[i].period_ns = 1, config.output[i].pumps = 1;
        CHECK(bridge_config_check(&config) == -EINVAL);
    }
    for (uint32_t i = 0; i < JOINTS_MAX; i++) {
        config.joint[i] = two_motors().joint[0];
    }
    for (uint32_t i = 0; i < PWM_OUTPUTS_MAX; i++) {
        config.output[i] = two_motors().output[0];
    }
    config.joint_count = JOINTS_MAX, config.output_count = PWM_OUTPUTS_MAX;
    CHECK(bridge_config_check(&config) == 0);
    config.output[PWM_OUTPUTS_MAX - 1].joint = JOINTS_MAX;
    CHECK(bridge_config_check(&config) == -EINVAL);
}

int main(void)
{
    each_mode_has_its_level();
    a_joint_without_set_points_rests();
    a_servo_gets_the_pulses_of_its_newest_position();
    a_servo_may_have_any_range_and_zero_is_its_middle();
    each_servo_has_a_position_of_its_own();
    the_full_number_of_servos_have_a_position_each();
    a_servo_without_a_position_holds_the_one_before();
    a_servo_that_stops_holds_its_position_and_then_gets_no_pulses();
    each_fault_reason_stays_until_the_next_arming();
    a_braking_bridge_ignores_requests_except_power_off();
    a_bridge_that_is_no_longer_enabled_has_no_power();
    a_level_is_rounded_to_whole_nanoseconds_of_the_period();
    each_number_of_a_config_has_its_range();
    return checks_report("test_bridge_steps");
}
