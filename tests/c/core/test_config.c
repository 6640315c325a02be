/* SPDX-License-Identifier: Apache-2.0
 * test_config: which configurations are refused, and which field is named: numbers out of their
 * range, wheels that do not determine a motion, bases with modules, joints without a base. */
#include "steered_bases.h"

#include <errno.h>

static bool is_good(const core_config *config)
{
    char name[FIELD_NAME_BYTES];
    return core_config_check(config, name) == NULL;
}

static bool refused(const core_config *config, const char *by)
{
    static core_state state;
    char name[FIELD_NAME_BYTES];
    return core_config_check(config, name) == name && strcmp(name, by) == 0 &&
           core_init(&state, config) == -EINVAL;
}

/* Check a base in which one field has another value. */
#define REFUSED(base, field, value, by)                                                            \
    do {                                                                                           \
        core_config changed = base;                                                                \
        changed.field = value;                                                                     \
        CHECK(refused(&changed, by));                                                              \
    } while (0)
#define GOOD(base, field, value)                                                                   \
    do {                                                                                           \
        core_config changed = base;                                                                \
        changed.field = value;                                                                     \
        CHECK(is_good(&changed));                                                                  \
    } while (0)

static void is_between(core_config *config, double *value, double low, double high, const char *by)
{
    const double middle = *value;
    *value = low;
    CHECK(is_good(config));
    *value = high;
    CHECK(is_good(config));
    *value = nextafter(low, -(double)INFINITY);
    CHECK(refused(config, by));
    if (isfinite(high)) {
        *value = nextafter(high, (double)INFINITY);
        CHECK(refused(config, by));
    }
    *value = NAN;
    CHECK(refused(config, by));
    *value = middle;
}

#define IN(field, low, high) {#field, offsetof(core_config, field), low, high}

static void every_number_has_its_range(void)
{
    const double least = 1e-12, most = 1e9, endless = INFINITY;
    const struct {
        const char *name;
        size_t at;
        double low, high;
    } RANGES[] = {
        IN(command_timeout_s, least, most),
        IN(feedback_timeout_s, least, most),
        IN(heartbeat_timeout_s, least, most),
        IN(rest_velocity_rad_s, least, most),
        IN(distance_variance_m2_per_m, least, most),
        IN(turn_variance_rad2_per_rad, least, most),
        IN(pose_variance_floor_m2, least, most),
        IN(heading_variance_floor_rad2, least, most),
        IN(twist_variance_floor_m2_s2, least, most),
        IN(twist_variance_floor_rad2_s2, least, most),
        IN(limits.linear.velocity_u_s, least, most),
        IN(limits.linear.acceleration_u_s2, least, most),
        IN(limits.linear.deceleration_u_s2, least, most),
        IN(limits.linear.jerk_u_s3, least, endless),
        IN(limits.angular.velocity_u_s, least, most),
        IN(limits.angular.acceleration_u_s2, least, most),
        IN(limits.angular.deceleration_u_s2, least, most),
        IN(limits.angular.jerk_u_s3, least, endless),
        IN(limits.lateral.velocity_u_s, least, most),
        IN(limits.lateral.acceleration_u_s2, least, most),
        IN(limits.lateral.deceleration_u_s2, least, most),
        IN(limits.lateral.jerk_u_s3, least, endless),
        IN(gyro.timeout_s, least, most),
        IN(gyro.bias_max_rad_s, least, most),
        IN(gyro.still_variance_rad2_s2, least, most),
        IN(gyro.heading_variance_rad2_per_s, least, most),
        IN(gyro.turn_variance_rad2_per_rad, least, most),
        IN(joint[1].row.x, -2.0, 2.0),
        IN(joint[1].row.y, -2.0, 2.0),
        IN(joint[1].row.lever_m, -most, most),
        IN(joint[1].wheel_radius_m, least, most),
        IN(joint[1].velocity_min_rad_s, -most, 0.0),
        IN(joint[1].velocity_max_rad_s, least, most),
        IN(joint[1].rad_per_count, least, most),
        IN(joint[1].pwm.dead_band, 0.0, 1.0),
        IN(joint[1].pwm.duty_min, -1.0, 0.0),
        IN(joint[1].pwm.duty_max, 0.0, 1.0),
        IN(joint[1].pwm.slew_per_s, least, endless),
        IN(joint[1].pwm.full_duty_rad_s, least, most),
        IN(joint[1].speed_loop.gains.gain_u_s_per_rad, 0.0, most),
        IN(joint[1].speed_loop.gains.integral_u_per_rad, 0.0, most),
        IN(joint[1].speed_loop.gains.derivative_u_s2_per_rad, 0.0, most),
        IN(joint[1].speed_loop.gains.static_u, 0.0, most),
        IN(joint[1].speed_loop.gains.viscous_u_s_per_rad, 0.0, most),
        IN(joint[1].speed_loop.gains.acceleration_u_s2_per_rad, 0.0, most),
        IN(joint[1].speed_loop.filter_s, 0.0, most),
        IN(joint[1].speed_loop.correction_max_u, 0.0, most),
        IN(joint[1].speed_loop.output_min_u, -most, 0.0),
        IN(joint[1].speed_loop.output_max_u, 0.0, most),
        IN(joint[1].plausible.setpoint_min_rad_s, 0.0, most),
        IN(joint[1].plausible.slow_rad_s, 0.0, most),
        IN(joint[1].plausible.short_rad_s, 0.0, most),
        IN(joint[1].plausible.beyond_rad_s, 0.0, most),
        IN(joint[1].plausible.apart_rad_s, 0.0, most),
        IN(joint[1].plausible.progress_rad_s, 0.0, most),
        IN(joint[1].plausible.direction_s, 0.0, most),
        IN(joint[1].plausible.stall_s, 0.0, most),
        IN(joint[1].plausible.following_s, 0.0, most),
        IN(joint[1].plausible.runaway_s, 0.0, most),
        IN(joint[1].plausible.apart_s, 0.0, most),
    };
    core_config base = good_config();
    base.gyro = good_gyro(0.05);
    for (int i = 0; i < COUNT_OF(RANGES); i++) {
        is_between(&base, (double *)((char *)&base + RANGES[i].at), RANGES[i].low, RANGES[i].high,
                   RANGES[i].name);
    }
    GOOD(good_config(), joint[1].rad_per_count, -1e-12);
    GOOD(good_config(), joint[1].rad_per_count, -1e9);
    GOOD(good_config(), gyro.timeout_s, NAN); /* without a gyro its numbers do not count */
}

static void limits_checked_alone_are_named_by_axis_and_field(void)
{
    base_limits limits = good_config().limits;
    char name[FIELD_NAME_BYTES] = "";
    CHECK(base_limits_check(&limits, name) == NULL);
    limits.angular.jerk_u_s3 = 0.0;
    CHECK(base_limits_check(&limits, name) == name && strcmp(name, "angular.jerk_u_s3") == 0);
}

static void an_action_or_a_line_out_of_range_is_refused(void)
{
    REFUSED(good_config(), on_timeout, (stop_action)4, "on_timeout");
    REFUSED(good_config(), on_fault, (stop_action)4, "on_fault");
    REFUSED(good_config(), on_estop, (stop_action)4, "on_estop");
    REFUSED(good_config(), joint[0].line, LINES_MAX, "joint[0].line");
    GOOD(good_config(), joint[0].line, LINES_MAX - 1);
}

static void counters_have_the_widths_of_real_drives(void)
{
    const uint64_t widths =
        1ULL << 0 | 1ULL << 8 | 1ULL << 12 | 1ULL << 15 | 1ULL << 16 | 1ULL << 24 | 1ULL << 32;
    core_config config = good_config();
    for (uint32_t bits = 0; bits <= 66; bits++) {
        config.joint[0].counter_bits = bits;
        bool good = bits == 64 || (bits < 64 && (widths >> bits & 1) != 0);
        CHECK(good ? is_good(&config) : refused(&config, "joint[0].counter_bits"));
    }
    GOOD(good_config(), joint[0].counter_mantissa_bits, 53);
    REFUSED(good_config(), joint[0].counter_mantissa_bits, 54, "joint[0].counter_mantissa_bits");
    config.joint[0].counter_bits = 0;
    config.joint[0].rad_per_count = 0.0; /* without a counter its scale does not count */
    CHECK(is_good(&config));
}

static void a_base_has_two_to_eight_wheels_and_they_are_not_all_on_one_side(void)
{
    core_config config = good_config();
    for (uint32_t j = 4; j < JOINTS_MAX; j++) {
        config.joint[j] = config.joint[j - 4];
    }
    for (uint32_t joints = 0; joints <= JOINTS_MAX + 1; joints++) {
        config.joint_count = joints;
        CHECK(joints >= 2 && joints <= JOINTS_MAX ? is_good(&config)
                                                  : refused(&config, "joint_count"));
    }
    for (int side = -1; side <= 1; side++) {
        config = good_config();
        for (uint32_t j = 0; j < 4; j++) {
            config.joint[j].row.lever_m = 0.25 * side;
        }
        CHECK(refused(&config, "joint.row"));
        /* three wheels on one side, one on the other */
        config.joint[3].row.lever_m = side > 0 ? -0.25 : 0.25;
        CHECK(is_good(&config));
    }
}

static void every_kind_of_base_is_good(void)
{
    const core_config bases[] = {
        bicycle(), tricycle(),     ackermann(WHEELBASE_M), ackermann(-WHEELBASE_M),
        swerve(),  head_and_belt()};
    for (int i = 0; i < COUNT_OF(bases); i++) {
        CHECK(is_good(&bases[i]));
    }
}

static void numbers_of_joints_that_take_positions_have_their_range(void)
{
    core_config base = bicycle();
    position_config *own = &base.joint[1].position;
    is_between(&base, &own->position_min_rad, -1e9, 0.0, "joint[1].position.position_min_rad");
    is_between(&base, &own->position_max_rad, 0.0, 1e9, "joint[1].position.position_max_rad");
    is_between(&base, &own->velocity_rad_s, 1e-12, 1e9, "joint[1].position.velocity_rad_s");
    is_between(&base, &own->acceleration_rad_s2, 1e-12, 1e9,
               "joint[1].position.acceleration_rad_s2");
    is_between(&base, &own->following_rad, 0.0, 1e9, "joint[1].position.following_rad");
    is_between(&base, &own->following_s, 0.0, 1e9, "joint[1].position.following_s");
    own->position_min_rad = own->position_max_rad = 0.0;
    CHECK(refused(&base, "joint[1].position.position_max_rad"));
    REFUSED(bicycle(), joint[1].position.used, 2, "joint[1].position.used");
    REFUSED(bicycle(), joint[1].position.reference, 3, "joint[1].position.reference");
    GOOD(bicycle(), joint[1].position.reference, REFERENCE_HOMED);
    GOOD(bicycle(), joint[1].position.reference, REFERENCE_ESTIMATED);
    REFUSED(bicycle(), joint[1].line, LINES_MAX, "joint[1].line");
    GOOD(bicycle(), joint[1].line, LINES_MAX - 1);
}

static void an_angle_that_is_measured_needs_a_counter(void)
{
    core_config base = bicycle();
    base.joint[1].counter_bits = 0;
    CHECK(refused(&base, "joint[1].counter_bits"));
    base.joint[1].position.reference = REFERENCE_HOMED;
    CHECK(refused(&base, "joint[1].counter_bits"));
    base.joint[1].position.reference = REFERENCE_ESTIMATED;
    CHECK(is_good(&base));
}

static void positions_of_modules_have_their_range(void)
{
    REFUSED(bicycle(), module[1].x_m, nextafter(1e9, INFINITY), "module[1].x_m");
    REFUSED(bicycle(), module[0].x_m, nextafter(-1e9, -INFINITY), "module[0].x_m");
    REFUSED(bicycle(), module[0].x_m, NAN, "module[0].x_m");
    REFUSED(bicycle(), module[0].y_m, nextafter(1e9, INFINITY), "module[0].y_m");
    REFUSED(bicycle(), module[0].y_m, nextafter(-1e9, -INFINITY), "module[0].y_m");
    REFUSED(bicycle(), module[0].angle_rad, nextafter(7.0, INFINITY), "module[0].angle_rad");
    REFUSED(bicycle(), module[0].angle_rad, nextafter(-7.0, -INFINITY), "module[0].angle_rad");
    GOOD(bicycle(), module[0].angle_rad, 7.0);
    GOOD(bicycle(), module[0].angle_rad, -7.0);
}

static void a_joint_has_one_module_and_one_role_in_it(void)
{
    REFUSED(bicycle(), module[0].steering, 3, "module[0].steering");
    REFUSED(bicycle(), module[1].traction, 3, "module[1].traction");
    REFUSED(bicycle(), module[0].steering, 1, "module[0].steering"); /* the joint takes
                                                                        velocities */
    REFUSED(bicycle(), module[1].traction, 2, "module[1].traction"); /* the joint takes positions */
    REFUSED(bicycle(), module[0].traction, 1, "module[1].traction"); /* the joint is in another
                                                                        module */
    REFUSED(ackermann(WHEELBASE_M), module[1].steering, 3, "module[1].steering");
    REFUSED(ackermann(WHEELBASE_M), module[3].traction, 1, "module[3].traction");
    REFUSED(bicycle(), module[1].traction, 0, "joint[0]: no module");
    REFUSED(good_config(), joint[3], turning_within(0.5), "joint[3]: no module");
    core_config base = bicycle();
    base.joint_count = 3, base.joint[2] = rolling();
    CHECK(refused(&base, "joint[2]: no module"));
}

static void a_range_of_derating_ends_after_its_beginning(void)
{
    for (int by = DERATED_BY_TEMPERATURE; by <= DERATED_BY_VOLTAGE; by++) {
        core_config base = good_config();
        derating_range *range = &base.joint[1].derating.range[by];
        bool falls = by == DERATED_BY_VOLTAGE; /* a low voltage derates, and a high temperature or
                                                  current */
        *range = (derating_range){.full = falls ? 5.0 : 4.0, .none = falls ? 4.0 : 5.0};
        CHECK(is_good(&base));
        *range = (derating_range){.full = 4.0, .none = 4.0};
        CHECK(is_good(&base));
        *range = (derating_range){.full = falls ? 4.0 : 5.0, .none = falls ? 5.0 : 4.0};
        CHECK(refused(&base, "joint[1].derating.range"));
    }
}

static void a_speed_loop_has_a_known_kind(void)
{
    GOOD(good_config(), joint[2].speed_loop.kind, SPEED_LOOP_DUTY);
    REFUSED(good_config(), joint[2].speed_loop.kind, SPEED_LOOP_DUTY + 1,
            "joint[2].speed_loop.kind");
}

/* If all wheels are steered, each has to point in every direction. */
static void a_swerve_base_needs_half_a_turn_of_each_wheel(void)
{
    for (uint32_t j = 0; j <= 2; j += 2) {
        core_config base = swerve();
        const char *by = j == 0 ? "module[0].steering" : "module[1].steering";
        base.joint[j].position.position_min_rad = 0.0,
        base.joint[j].position.position_max_rad = 3.1415;
        CHECK(is_good(&base));
        base.joint[j].position.position_max_rad = nextafter(3.1415, 0.0);
        CHECK(refused(&base, by));
        base.joint[j].position.position_min_rad = -0.5; /* only the width of the range counts */
        CHECK(is_good(&base));
    }
}

/* A car turns about the axle of its fixed wheels. */
static void fixed_wheels_stand_on_the_axle_and_steered_ones_do_not(void)
{
    REFUSED(bicycle(), module[0].x_m, 0.0, "module[0].x_m");
    GOOD(bicycle(), module[0].x_m, 0.1);
    GOOD(bicycle(), module[0].x_m, 1.0);
    REFUSED(bicycle(), module[1].x_m, 2e-9, "module[1].x_m");
    REFUSED(bicycle(), module[1].x_m, -2e-9, "module[1].x_m");
    GOOD(bicycle(), module[1].x_m, 0.9e-9);
    REFUSED(bicycle(), module[1].angle_rad, 2e-9, "module[1].angle_rad");
    REFUSED(bicycle(), module[1].angle_rad, 1.0, "module[1].angle_rad");
    REFUSED(bicycle(), module[1].angle_rad, 0.1, "module[1].angle_rad");
    GOOD(bicycle(), module[1].angle_rad, 0.9e-9);
    core_config base = empty_base(2, 2, 0, 0); /* no wheel is steered */
    base.joint[0] = base.joint[1] = rolling();
    base.module[0] = (wheel_module){.y_m = 0.1, .traction = 1},
    base.module[1] = (wheel_module){.y_m = -0.1, .traction = 2};
    CHECK(refused(&base, "module_count"));
}

static void modules_that_do_not_determine_the_motion_are_refused(void)
{
    core_config base = swerve();
    base.joint_count = 2, base.module_count = 1;
    CHECK(refused(&base, "module"));
    REFUSED(swerve(), module_count, JOINTS_MAX + 1, "module_count");
    base = bicycle();
    base.module_count = JOINTS_MAX; /* free wheels beside the axle */
    for (int i = 2; i < JOINTS_MAX; i++) {
        base.module[i] = (wheel_module){.y_m = 0.1 * i};
    }
    CHECK(is_good(&base));
}

static void joints_without_a_base_need_no_second_joint_and_no_position(void)
{
    REFUSED(head_and_belt(), independent, 2, "independent");
    REFUSED(bicycle(), independent, 1, "independent");
    GOOD(head_and_belt(), joint_count, 1);
    REFUSED(head_and_belt(), joint_count, 0, "joint_count");
    REFUSED(bicycle(), joint_count, 1, "joint_count");
    REFUSED(head_and_belt(), gyro.used, 1, "gyro.used");
    REFUSED(bicycle(), gyro.used, 2, "gyro.used");
    core_config joints = head_and_belt();
    is_between(&joints, &joints.joint[1].own.acceleration_u_s2, 1e-12, 1e9,
               "joint[1].own.acceleration_u_s2");
    is_between(&joints, &joints.joint[1].own.deceleration_u_s2, 1e-12, 1e9,
               "joint[1].own.deceleration_u_s2");
    is_between(&joints, &joints.joint[1].own.jerk_u_s3, 1e-12, INFINITY, "joint[1].own.jerk_u_s3");
    joints.joint[0].own = (axis_limits){.jerk_u_s3 = 0.0}; /* the joint takes positions: its
                                                              velocity limits do not count */
    CHECK(is_good(&joints));
    core_config base = bicycle();
    base.joint[0].own = (axis_limits){.jerk_u_s3 = 0.0};
    CHECK(is_good(&base));
}

int main(void)
{
    every_number_has_its_range();
    limits_checked_alone_are_named_by_axis_and_field();
    an_action_or_a_line_out_of_range_is_refused();
    counters_have_the_widths_of_real_drives();
    a_base_has_two_to_eight_wheels_and_they_are_not_all_on_one_side();
    every_kind_of_base_is_good();
    numbers_of_joints_that_take_positions_have_their_range();
    an_angle_that_is_measured_needs_a_counter();
    positions_of_modules_have_their_range();
    a_joint_has_one_module_and_one_role_in_it();
    a_range_of_derating_ends_after_its_beginning();
    a_speed_loop_has_a_known_kind();
    a_swerve_base_needs_half_a_turn_of_each_wheel();
    fixed_wheels_stand_on_the_axle_and_steered_ones_do_not();
    modules_that_do_not_determine_the_motion_are_refused();
    joints_without_a_base_need_no_second_joint_and_no_position();
    return checks_report("test_config");
}
