/* SPDX-License-Identifier: Apache-2.0
 * test_command_joints: datagrams for joints without a base: positions, velocities, and what of them a joint does not take. */
#include "steered_bases.h"

static const int64_t NOW_NS = 5000000000;
static const uint8_t LETTER = 'a';

static arbiter *begun(const core_config *config)
{
    static arbiter a;
    lease_permissions permissions = {.lease = {{.number = LETTER, .priority = 10, .lifetime_ns = 300 * MS_NS}}};
    memset(permissions.lease[0].token, LETTER, TOKEN_BYTES);
    arbiter_init(&a, config, &config->limits);
    arbiter_grant(&a, &permissions);
    return &a;
}

/* For the head and its belt: pan to 0.5 rad, 2 rad/s of the belt. */
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

static void each_joint_takes_what_it_is_sent_for_it(void)
{
    core_config config = head_and_belt();
    arbiter *a = begun(&config);
    joint_position_datagram joints = datagram_of(1);
    CHECK(submit(a, &joints) == 0);
    joint_command command = commanded(a);
    CHECK(command.named == 3 && command.value_u[0] == 0.5 && command.value_u[1] == 2.0 && command.value_u[2] == 0.0);
    joints = datagram_of(2);
    joints.positions = 5, joints.velocities = 0;
    CHECK(submit(a, &joints) == 0);
    command = commanded(a);
    CHECK(command.named == 5 && command.value_u[0] == 0.5 && command.value_u[1] == 0.0 && command.value_u[2] == -0.3);
}

static void what_a_joint_does_not_take_is_refused(void)
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
    core_config base = good_config(); /* a base has no positions to command */
    base.joint_count = 3;
    a = begun(&base);
    joint_position_datagram joints = datagram_of(1);
    CHECK(submit(a, &joints) == 1 + REFUSED_JOINTS);
}

/* An older datagram gives each joint a velocity: one that takes positions has none but zero. */
static void older_datagrams_move_belts_only(void)
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
    } CASES[] = {{20.0, 80.0, 0},
                 {-20.0, -80.0, 0},
                 {20.1, 0.0, 1 + REFUSED_OUT_OF_RANGE},
                 {-20.1, 0.0, 1 + REFUSED_OUT_OF_RANGE},
                 {0.0, 80.1, 1 + REFUSED_OUT_OF_RANGE},
                 {NAN, 0.0, 1 + REFUSED_NOT_FINITE},
                 {0.0, INFINITY, 1 + REFUSED_NOT_FINITE}};
    core_config config = head_and_belt();
    arbiter *a = begun(&config);
    for (int i = 0; i < COUNT_OF(CASES); i++) {
        joint_position_datagram joints = datagram_of((uint64_t)i + 1);
        joints.position_rad[0] = CASES[i].pan_rad, joints.head.velocity_rad_s[1] = CASES[i].belt_rad_s;
        CHECK(submit(a, &joints) == CASES[i].result);
    }
}

/* Commanded while nothing may move, a motion does not begin when it may. */
static void a_motion_that_was_requested_too_early_is_held(void)
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
        joints.position_rad[0] = 0.0; /* an angle is a motion, also that of 0 */
        CHECK(arbiter_submit(a, &joints, sizeof joints, NOW_NS, false) == 0);
        CHECK((commanded(a).named == 0) == CASES[i].held);
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
    joints = datagram_of(1);
    joints.head.version = COMMAND_VERSION;
    CHECK(submit(a, &joints) == 1 + REFUSED_FORM);
}

int main(void)
{
    each_joint_takes_what_it_is_sent_for_it();
    what_a_joint_does_not_take_is_refused();
    older_datagrams_move_belts_only();
    an_angle_or_a_speed_far_out_of_range_is_refused();
    a_motion_that_was_requested_too_early_is_held();
    a_datagram_has_the_length_of_its_version();
    return checks_report("test_command_joints");
}
