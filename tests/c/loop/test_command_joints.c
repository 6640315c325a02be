/* SPDX-License-Identifier: Apache-2.0
 * test_command_joints: datagrams for joints without a base: positions, velocities, and those that a
 * joint does not take. */
#include "steered_bases.h"

#include <float.h>

static const int64_t NOW_NS = 5000000000;
static const uint8_t LETTER = 'a';

static arbiter *begun_at(const core_config *config, uint32_t place)
{
    static arbiter a;
    lease_permissions permissions;
    memset(&permissions, 0, sizeof permissions);
    permissions.lease[place] =
        (lease_permission){.number = 1, .priority = 10, .lifetime_ns = 300 * MS_NS};
    memset(permissions.lease[place].token, LETTER, TOKEN_BYTES);
    arbiter_init(&a, config, &config->limits);
    arbiter_grant(&a, &permissions);
    return &a;
}

static arbiter *begun(const core_config *config)
{
    return begun_at(config, 3);
}

/* A command for the head and its belt: pan to 0.5 rad, belt at 2 rad/s. */
static joint_position_datagram datagram_of(uint64_t sequence)
{
    joint_position_datagram joints = {.head = {.magic = COMMAND_MAGIC,
                                               .version = COMMAND_VERSION_POSITIONS,
                                               .kind = COMMAND_JOINTS,
                                               .sequence = sequence,
                                               .stamp_ns = NOW_NS,
                                               .joint_count = 3,
                                               .velocity_rad_s = {0.0, 2.0, 0.0}},
                                      .position_rad = {0.5, 0.0, -0.3},
                                      .velocities = 2,
                                      .positions = 1};
    memset(joints.head.token, LETTER, TOKEN_BYTES);
    return joints;
}

static int submit(arbiter *a, const joint_position_datagram *joints)
{
    return arbiter_submit(a, joints, sizeof *joints, NOW_NS, true);
}

static joint_command commanded(arbiter *a)
{
    twist_command twist;
    joint_command joints;
    arbiter_command(a, NOW_NS, true, &twist);
    CHECK(twist.linear_m_s == 0.0 && twist.angular_rad_s == 0.0 && twist.lateral_m_s == 0.0);
    arbiter_joints(a, &joints);
    return joints;
}

static void each_joint_takes_its_own_part_of_a_command(void)
{
    core_config config = head_and_belt();
    arbiter *a = begun(&config);
    joint_position_datagram joints = datagram_of(1);
    CHECK(submit(a, &joints) == 0);
    joint_command command = commanded(a);
    CHECK(command.named == 3 && command.value_u[0] == 0.5 && command.value_u[1] == 2.0 &&
          command.value_u[2] == 0.0);
    joints = datagram_of(2);
    joints.positions = 5, joints.velocities = 0;
    CHECK(submit(a, &joints) == 0);
    command = commanded(a);
    CHECK(command.named == 5 && command.value_u[0] == 0.5 && command.value_u[1] == 0.0 &&
          command.value_u[2] == -0.3);
}

static void joints_are_commanded_under_any_lease(void)
{
    core_config config = head_and_belt();
    for (uint32_t place = 0; place < LEASES_MAX; place++) {
        arbiter *a = begun_at(&config, place);
        joint_position_datagram joints = datagram_of(1);
        CHECK(submit(a, &joints) == 0 && commanded(a).named == 3);
    }
}

static void a_kind_of_command_that_a_joint_does_not_take_is_refused(void)
{
    static const struct {
        uint32_t velocities, positions;
        int result;
    } CASES[] = {{2, 5, 0},
                 {0, 0, 0},
                 {1, 0, 1 + REFUSED_JOINTS},
                 {4, 0, 1 + REFUSED_JOINTS},
                 {0, 2, 1 + REFUSED_JOINTS},
                 {8, 0, 1 + REFUSED_JOINTS},
                 {0, 8, 1 + REFUSED_JOINTS},
                 {3, 1, 1 + REFUSED_JOINTS}};
    core_config config = head_and_belt();
    arbiter *a = begun(&config);
    for (int i = 0; i < COUNT_OF(CASES); i++) {
        joint_position_datagram joints = datagram_of((uint64_t)i + 1);
        joints.velocities = CASES[i].velocities, joints.positions = CASES[i].positions;
        CHECK(submit(a, &joints) == CASES[i].result);
    }
    core_config base = good_config(); /* joints of a base take no positions */
    base.joint_count = 3;
    a = begun(&base);
    joint_position_datagram joints = datagram_of(1);
    CHECK(submit(a, &joints) == 1 + REFUSED_JOINTS);
}

static void a_twist_other_than_zero_is_refused_without_a_base(void)
{
    core_config config = head_and_belt();
    for (uint32_t axes = 0; axes < 8; axes++) {
        arbiter *a = begun(&config);
        command_datagram twist = {
            .magic = COMMAND_MAGIC, .version = COMMAND_VERSION, .kind = COMMAND_TWIST};
        twist.sequence = 1, twist.stamp_ns = NOW_NS;
        twist.linear_m_s = axes & 1U ? 0.1 : 0.0;
        twist.angular_rad_s = axes & 2U ? 0.1 : 0.0;
        twist.lateral_m_s = axes & 4U ? 0.1 : 0.0;
        memset(twist.token, LETTER, TOKEN_BYTES);
        CHECK(arbiter_submit(a, &twist, sizeof twist, NOW_NS, true) ==
              (axes == 0 ? 0 : 1 + REFUSED_JOINTS));
        CHECK(commanded(a).named == 0);
    }
}

static void the_full_number_of_joints_is_commanded(void)
{
    core_config config = heads_and_belts();
    arbiter *a = begun(&config);
    joint_position_datagram joints = datagram_of(1);
    joints.head.joint_count = JOINTS_MAX;
    for (uint32_t j = 0; j < JOINTS_MAX; j++) {
        joints.head.velocity_rad_s[j] = j % 2 == 0 ? 2.0 + j : 0.0;
        joints.position_rad[j] = 0.1 * (1 + j);
    }
    joints.velocities = 0x55, joints.positions = 0xAA;
    CHECK(submit(a, &joints) == 0);
    joint_command command = commanded(a);
    CHECK(command.named == 0xFF);
    for (uint32_t j = 0; j < JOINTS_MAX; j++) {
        CHECK(command.value_u[j] ==
              (j % 2 == 0 ? joints.head.velocity_rad_s[j] : joints.position_rad[j]));
    }
    joints.head.version = COMMAND_VERSION, joints.head.sequence = 2;
    CHECK(arbiter_submit(a, &joints.head, sizeof joints.head, NOW_NS, true) == 0);
    command = commanded(a);
    CHECK(command.named == 0x55 && command.value_u[6] == 8.0 && command.value_u[7] == 0.0);
    joints.head.joint_count = JOINTS_MAX + 1, joints.head.sequence = 3; /* beyond the table */
    CHECK(arbiter_submit(a, &joints.head, sizeof joints.head, NOW_NS, true) == 1 + REFUSED_JOINTS);
    command = commanded(a);
    CHECK(command.named == 0 && command.value_u[0] == 0.0);
}

/* A base with four wheels: left, right, left and right. */
static void unnamed_wheels_of_a_base_come_to_rest(void)
{
    static const struct {
        uint32_t velocities, positions;
        double linear_m_s, angular_rad_s;
        int result;
    } CASES[] = {{0xF, 0, 0.15, 0.2, 0},
                 {0xA, 0, 0.1, 0.4, 0},
                 {0x5, 0, 0.05, -0.2, 0},
                 {0, 0, 0.0, 0.0, 0},
                 {0xF, 1, 0.0, 0.0, 1 + REFUSED_JOINTS},
                 {0x1F, 0, 0.0, 0.0, 1 + REFUSED_JOINTS},
                 {0x2F, 0, 0.0, 0.0, 1 + REFUSED_JOINTS}};
    core_config base = good_config();
    for (int i = 0; i < COUNT_OF(CASES); i++) {
        arbiter *a = begun(&base);
        joint_position_datagram joints = datagram_of(1);
        joints.head.joint_count = 4;
        for (uint32_t j = 0; j < JOINTS_MAX; j++) {
            joints.head.velocity_rad_s[j] = j % 2 == 0 ? 1.0 : 2.0;
        }
        joints.velocities = CASES[i].velocities, joints.positions = CASES[i].positions;
        CHECK(submit(a, &joints) == CASES[i].result);
        twist_command twist;
        arbiter_command(a, NOW_NS, true, &twist);
        CHECK(close_to(twist.linear_m_s, CASES[i].linear_m_s) &&
              close_to(twist.angular_rad_s, CASES[i].angular_rad_s));
    }
}

/* Each speed is finite, but their twist is not, or it is far out of range. */
static void speeds_that_are_not_finite_are_refused_and_the_base_comes_to_rest(void)
{
    static const double MOST = DBL_MAX;
    static const double SPEEDS_RAD_S[][4] = {{-MOST, MOST, -MOST, MOST}, {MOST, MOST, MOST, MOST},
                                             {MOST, -MOST, MOST, -MOST}, {-MOST, 0.0, -MOST, 0.0},
                                             {0.0, MOST, 0.0, MOST},     {MOST, MOST, -MOST, -MOST},
                                             {0.0, 0.0, 0.0, MOST},      {MOST, 1.0, MOST, 1.0}};
    /* the levers are 0.25 m long: the sums are finite for some radii only */
    static const double RADII_M[] = {0.1, 10.0};
    for (int i = 0; i < COUNT_OF(SPEEDS_RAD_S) * COUNT_OF(RADII_M); i++) {
        core_config base = good_config();
        for (int j = 0; j < 4; j++) {
            base.joint[j].wheel_radius_m = RADII_M[i % 2];
        }
        arbiter *a = begun(&base);
        joint_position_datagram joints = datagram_of(1);
        joints.head.joint_count = 4, joints.velocities = 0xF, joints.positions = 0;
        joints.head.velocity_rad_s[0] = joints.head.velocity_rad_s[1] = 0.5;
        joints.head.velocity_rad_s[2] = joints.head.velocity_rad_s[3] = 0.5;
        CHECK(submit(a, &joints) == 0);
        rig r;
        start(&r, &base);
        twist_command twist;
        arbiter_command(a, NOW_NS, true, &twist);
        go(&r, twist.linear_m_s, twist.angular_rad_s);
        CHECK(!zero(&r));
        memcpy(joints.head.velocity_rad_s, SPEEDS_RAD_S[i / 2], sizeof SPEEDS_RAD_S[0]);
        joints.head.sequence = 2;
        int result = submit(a, &joints);
        CHECK(result == 1 + REFUSED_NOT_FINITE || result == 1 + REFUSED_JOINTS ||
              result == 1 + REFUSED_OUT_OF_RANGE);
        CHECK(a->report.refused[result - 1] == 1 && a->report.lease[3].wants_motion == 0);
        arbiter_command(a, NOW_NS, true, &r.input.command);
        CHECK(r.input.command.sequence == 2 && r.input.command.linear_m_s == 0.0);
        CHECK(r.input.command.angular_rad_s == 0.0 && r.input.command.lateral_m_s == 0.0);
        CHECK(ticks(&r, 3000)->faults == 0 && zero(&r) && r.shown.at_rest == 1);
    }
}

/* The rollers are at 45 degrees: the wheels on one diagonal turn against those on the other. */
static void wheel_speeds_that_strafe_are_a_lateral_speed(void)
{
    core_config base = good_config();
    joint_position_datagram joints = datagram_of(1);
    joints.head.joint_count = 4, joints.velocities = 0xF, joints.positions = 0;
    for (uint32_t j = 0; j < 4; j++) {
        base.joint[j].row.y = j == 0 || j == 3 ? -1.0 : 1.0;
        joints.head.velocity_rad_s[j] = base.joint[j].row.y;
    }
    arbiter *a = begun(&base);
    CHECK(submit(a, &joints) == 0);
    twist_command twist;
    arbiter_command(a, NOW_NS, true, &twist);
    CHECK(close_to(twist.lateral_m_s, 0.1) && close_to(twist.linear_m_s, 0.0) &&
          close_to(twist.angular_rad_s, 0.0));
}

static void without_a_lease_in_command_no_joint_is_named(void)
{
    core_config config = head_and_belt();
    arbiter *a = begun(&config);
    joint_command command = commanded(a);
    CHECK(command.named == 0 && command.value_u[0] == 0.0);
    joint_position_datagram joints = datagram_of(1);
    CHECK(submit(a, &joints) == 0 && commanded(a).named == 3);
    joints.head.kind = COMMAND_RELEASE, joints.head.version = COMMAND_VERSION;
    CHECK(arbiter_submit(a, &joints, COMMAND_BYTES, NOW_NS, true) == 0 && a->report.accepted == 2);
    command = commanded(a);
    CHECK(command.named == 0 && command.value_u[0] == 0.0 && command.value_u[1] == 0.0);
}

/* An older datagram gives each joint a velocity. For a joint that takes positions, it may only be
 * zero. */
static void datagrams_of_the_older_version_move_only_joints_with_velocity(void)
{
    static const double PANS_RAD_S[] = {0.0, 1.0, 0.1};
    core_config config = head_and_belt();
    arbiter *a = begun(&config);
    for (int i = 0; i < COUNT_OF(PANS_RAD_S); i++) {
        joint_position_datagram joints = datagram_of((uint64_t)i + 1);
        joints.head.version = COMMAND_VERSION, joints.head.velocity_rad_s[0] = PANS_RAD_S[i];
        int result = arbiter_submit(a, &joints.head, sizeof joints.head, NOW_NS, true);
        CHECK(result == (i == 0 ? 0 : 1 + REFUSED_JOINTS));
        joint_command command = commanded(a);
        CHECK(command.value_u[1] == (i == 0 ? 2.0 : 0.0) && command.named == (i == 0 ? 2U : 0U));
    }
}

static void an_angle_or_a_speed_far_out_of_range_is_refused(void)
{
    static const struct {
        double pan_rad, belt_rad_s;
        int result;
    } CASES[] = {{2.0, 80.0, 0},
                 {-2.0, -80.0, 0},
                 {2.0199, 0.0, 0}, /* rounded, perhaps */
                 {-2.0199, 0.0, 0},
                 {2.0201, 0.0, 1 + REFUSED_OUT_OF_RANGE},
                 {-2.0201, 0.0, 1 + REFUSED_OUT_OF_RANGE},
                 {10.0, 0.0, 1 + REFUSED_OUT_OF_RANGE}, /* degrees */
                 {0.0, 80.1, 1 + REFUSED_OUT_OF_RANGE},
                 {NAN, 0.0, 1 + REFUSED_NOT_FINITE},
                 {0.0, INFINITY, 1 + REFUSED_NOT_FINITE}};
    core_config config = head_and_belt();
    arbiter *a = begun(&config);
    for (int i = 0; i < COUNT_OF(CASES); i++) {
        joint_position_datagram joints = datagram_of((uint64_t)i + 1);
        joints.position_rad[0] = CASES[i].pan_rad,
        joints.head.velocity_rad_s[1] = CASES[i].belt_rad_s;
        CHECK(submit(a, &joints) == CASES[i].result);
    }
}

/* A speed in either direction is compared with the end that is farther from zero, an angle with the
 * end on its side. */
static void an_angle_is_compared_with_its_range_and_a_speed_with_the_farther_end(void)
{
    static const double ENDS[][2] = {{-0.5, 2.0}, {-2.0, 0.5}};
    core_config config = head_and_belt();
    for (int i = 0; i < COUNT_OF(ENDS); i++) {
        config.joint[0].position.position_min_rad = config.joint[1].velocity_min_rad_s = ENDS[i][0];
        config.joint[0].position.position_max_rad = config.joint[1].velocity_max_rad_s = ENDS[i][1];
        for (int sign = -1; sign <= 1; sign += 2) {
            arbiter *a = begun(&config);
            joint_position_datagram joints = datagram_of(1);
            double end_rad = sign < 0 ? ENDS[i][0] : ENDS[i][1];
            joints.position_rad[0] = end_rad, joints.head.velocity_rad_s[1] = sign * 20.0;
            CHECK(submit(a, &joints) == 0);
            joints.head.sequence = 2, joints.position_rad[0] = end_rad + sign * 0.1;
            CHECK(submit(a, &joints) == 1 + REFUSED_OUT_OF_RANGE);
            CHECK(commanded(a).named == 0);
            joints.head.sequence = 3, joints.position_rad[0] = 0.0,
            joints.head.velocity_rad_s[1] = sign * 20.1;
            CHECK(submit(a, &joints) == 1 + REFUSED_OUT_OF_RANGE);
        }
    }
}

static void a_position_beyond_its_range_means_the_end_only_where_the_source_asks_for_it(void)
{
    core_config config = head_and_belt();
    arbiter *a = begun(&config);
    joint_position_datagram joints = datagram_of(1);
    joints.position_rad[0] = 1e6, joints.positions |= POSITIONS_CLAMP;
    CHECK(submit(a, &joints) == 0 && commanded(a).value_u[0] == 1e6 && commanded(a).named == 3);
    joints.head.sequence = 2, joints.head.velocity_rad_s[1] = 80.1; /* a speed is a speed */
    CHECK(submit(a, &joints) == 1 + REFUSED_OUT_OF_RANGE);
    joints.head.sequence = 3, joints.head.velocity_rad_s[1] = 0.0, joints.position_rad[0] = NAN;
    CHECK(submit(a, &joints) == 1 + REFUSED_NOT_FINITE);
    joints.head.sequence = 4, joints.positions = POSITIONS_CLAMP;
    CHECK(submit(a, &joints) == 0 && commanded(a).named == 2);
    core_config base = good_config(); /* joints of a base take no positions */
    base.joint_count = 3;
    a = begun(&base);
    joints = datagram_of(1), joints.positions = POSITIONS_CLAMP, joints.velocities = 0;
    CHECK(submit(a, &joints) == 0);
}

/* A joint that is not named has no position, wherever its range lies. */
static void the_range_of_a_joint_that_is_not_named_does_not_count(void)
{
    core_config config = head_and_belt();
    config.joint[2].position.position_min_rad = 1.0;
    config.joint[2].position.position_max_rad = 2.0;
    arbiter *a = begun(&config);
    joint_position_datagram joints = datagram_of(1);
    CHECK(submit(a, &joints) == 0 && commanded(a).named == 3);
}

/* A motion that is commanded while nothing may move does not begin later, when it may. */
static void motion_that_was_requested_too_early_is_held(void)
{
    static const struct {
        uint32_t velocities, positions;
        double belt_rad_s;
        bool held;
    } CASES[] = {{2, 0, 1.0, true}, {2, 0, 0.1, true}, {0, 1, 0.0, true},
                 {0, 4, 0.0, true}, {2, 1, 0.0, true}, {2, 0, 0.0, false}};
    core_config config = head_and_belt();
    for (int i = 0; i < COUNT_OF(CASES); i++) {
        arbiter *a = begun(&config);
        joint_position_datagram joints = datagram_of(1);
        joints.velocities = CASES[i].velocities, joints.positions = CASES[i].positions;
        joints.head.velocity_rad_s[1] = CASES[i].belt_rad_s;
        joints.position_rad[0] = 0.0; /* any position is a motion, also 0 */
        CHECK(arbiter_submit(a, &joints, sizeof joints, NOW_NS, false) == 0);
        CHECK((commanded(a).named == 0) == CASES[i].held);
        joints.head.sequence = 2; /* also while the commands continue */
        CHECK(submit(a, &joints) == 0 && (commanded(a).named == 0) == CASES[i].held);
        joints.head.sequence = 3, joints.velocities = joints.positions = 0; /* until a command
                                                                               requests no motion */
        CHECK(submit(a, &joints) == 0);
        joints.head.sequence = 4, joints.velocities = CASES[i].velocities,
        joints.positions = CASES[i].positions;
        CHECK(submit(a, &joints) == 0 &&
              commanded(a).named == (CASES[i].velocities | CASES[i].positions));
    }
}

static void a_datagram_has_the_length_of_its_version(void)
{
    core_config config = head_and_belt();
    arbiter *a = begun(&config);
    joint_position_datagram joints = datagram_of(1);
    CHECK(arbiter_submit(a, &joints, sizeof joints.head, NOW_NS, true) == 1 + REFUSED_FORM);
    joints.head.kind = COMMAND_TWIST;
    CHECK(submit(a, &joints) == 1 + REFUSED_FORM);
    joints.head.kind = COMMAND_RELEASE;
    CHECK(submit(a, &joints) == 1 + REFUSED_FORM);
    joints = datagram_of(1);
    joints.head.version = COMMAND_VERSION;
    CHECK(submit(a, &joints) == 1 + REFUSED_FORM);
    for (uint16_t version = 0; version <= 5; version++) {
        bool known = version == COMMAND_VERSION || version == COMMAND_VERSION_PLANE;
        joints = datagram_of((uint64_t)version + 1);
        joints.head.version = version, joints.head.velocity_rad_s[0] = 0.0;
        CHECK(arbiter_submit(a, &joints, sizeof joints.head, NOW_NS, true) ==
              (known ? 0 : 1 + REFUSED_FORM));
    }
}

int main(void)
{
    each_joint_takes_its_own_part_of_a_command();
    joints_are_commanded_under_any_lease();
    a_kind_of_command_that_a_joint_does_not_take_is_refused();
    a_twist_other_than_zero_is_refused_without_a_base();
    the_full_number_of_joints_is_commanded();
    unnamed_wheels_of_a_base_come_to_rest();
    speeds_that_are_not_finite_are_refused_and_the_base_comes_to_rest();
    wheel_speeds_that_strafe_are_a_lateral_speed();
    without_a_lease_in_command_no_joint_is_named();
    datagrams_of_the_older_version_move_only_joints_with_velocity();
    an_angle_or_a_speed_far_out_of_range_is_refused();
    an_angle_is_compared_with_its_range_and_a_speed_with_the_farther_end();
    a_position_beyond_its_range_means_the_end_only_where_the_source_asks_for_it();
    the_range_of_a_joint_that_is_not_named_does_not_count();
    motion_that_was_requested_too_early_is_held();
    a_datagram_has_the_length_of_its_version();
    return checks_report("test_command_joints");
}
