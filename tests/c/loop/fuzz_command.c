/* SPDX-License-Identifier: Apache-2.0
 * fuzz_command.c: for any datagram, the core gets finite numbers of a lease that is alive. Without
 * the token no source commands. */
#include "check.h"
#include "rt.h"

#include <math.h>
#include <string.h>

#define FUZZ_NAME "fuzz_command"
enum { FUZZ_MAX = 256 };

static const int64_t NOW_NS = 5000000000;

static const core_config BASE = {
    .joint_count = 4,
    .limits = {.linear.velocity_u_s = 1e6, .angular.velocity_u_s = 1e6},
    .joint = {{.row = {1.0, 0.0, -0.25}, .wheel_radius_m = 0.1},
              {.row = {1.0, 0.0, 0.25}, .wheel_radius_m = 0.1},
              {.row = {1.0, 0.0, -0.25}, .wheel_radius_m = 0.2},
              {.row = {1.0, 0.0, 0.25}, .wheel_radius_m = 0.2}}};

/* A robot without a base: two joints that take positions, and one that takes velocities. */
static const core_config HEAD = {
    .joint_count = 3,
    .independent = 1,
    .joint = {{.position = {.used = 1, .position_min_rad = -2.0, .position_max_rad = 1.0}},
              {.velocity_min_rad_s = -8.0, .velocity_max_rad_s = 8.0},
              {.position = {.used = 1, .position_min_rad = -1000.0, .position_max_rad = 1000.0}}},
};

static void granted(arbiter *a, const core_config *robot)
{
    lease_permissions permissions = {
        .lease = {{.number = 1, .priority = 10, .lifetime_ns = 300000000}}};
    memset(permissions.lease[0].token, 'a', TOKEN_BYTES);
    arbiter_init(a, robot, NULL);
    arbiter_grant(a, &permissions);
}

/* Shapes the bytes, by some of them: they stay as they are, or get more and more parts of a valid
 * command. Returns the length. */
static size_t shaped(uint8_t *bytes, size_t size, const core_config *robot)
{
    joint_position_datagram whole;
    memcpy(&whole, bytes, sizeof whole);
    joint_datagram head = whole.head;
    uint8_t how = bytes[8];
    if (bytes[10] & 1) { /* each joint gets the kind of command that it takes */
        whole.velocities &= robot == &HEAD ? 2 : 15;
        whole.positions &= robot == &HEAD ? 5 : 0;
    }
    head.magic = how & 1 ? COMMAND_MAGIC : head.magic;
    bool positions = (how & 128) != 0;
    head.version =
        how & 1 ? (positions ? COMMAND_VERSION_POSITIONS : COMMAND_VERSION) : head.version;
    head.kind = how & 2 ? (uint16_t)(1 + bytes[11] % 3) : head.kind;
    head.stamp_ns = how & 4 ? NOW_NS : head.stamp_ns;
    head.lifetime_ms = how & 8 ? 0 : head.lifetime_ms;
    head.joint_count = how & 16 ? robot->joint_count : head.joint_count;
    if (how & 32) {
        memset(head.token, 'a', TOKEN_BYTES);
    }
    whole.head = head;
    memcpy(bytes, &whole, sizeof whole);
    size_t of_joints = positions ? (size_t)JOINT_POSITION_BYTES : (size_t)JOINT_COMMAND_BYTES;
    return how & 64 ? (head.kind == COMMAND_JOINTS ? of_joints : (size_t)COMMAND_BYTES) : size;
}

/* Joints without a base get only commands that they can carry out, and no part of a datagram that
 * is refused. */
static void check_joints(const arbiter *a, const core_config *robot, int code)
{
    joint_command joints;
    arbiter_joints(a, &joints);
    CHECK(joints.named >> robot->joint_count == 0 && (code == 0 || joints.named == 0));
    CHECK(joints.named == 0 || robot->independent == 1);
    for (uint32_t j = 0; j < robot->joint_count; j++) {
        const joint_config *joint = &robot->joint[j];
        double range_rad =
            fmax(joint->position.position_max_rad, -joint->position.position_min_rad);
        double most_u = joint->position.used ? range_rad : joint->velocity_max_rad_s;
        CHECK(!(joints.named >> j & 1U) || fabs(joints.value_u[j]) <= 10.0 * most_u);
    }
}

static void once(const uint8_t *data, size_t size)
{
    static arbiter a;
    static uint8_t room[FUZZ_MAX];
    uint8_t bytes[FUZZ_MAX];
    memcpy(bytes, data, FUZZ_MAX);
    const core_config *robot = bytes[9] & 1 ? &HEAD : &BASE; /* before `shaped` writes a token */
    size_t length = shaped(bytes, size, robot);
    /* at the very end: the sanitizer sees a read beyond it */
    uint8_t *last = room + sizeof room - length;
    memcpy(last, bytes, length);
    bool right = length >= 24 && memcmp(bytes + 8, "aaaaaaaaaaaaaaaa", TOKEN_BYTES) == 0;
    twist_command out;
    granted(&a, robot);
    int code = arbiter_submit(&a, last, length, NOW_NS, true);
    arbiter_command(&a, NOW_NS, true, &out);
    CHECK(code >= 0 && code <= REFUSAL_KINDS);
    CHECK(isfinite(out.linear_m_s) && isfinite(out.angular_rad_s));
    CHECK(right || (code != 0 && a.report.commander == 0));
    CHECK(code == 0 || (out.linear_m_s == 0.0 && out.angular_rad_s == 0.0));
    CHECK(out.expires_ns <= NOW_NS + 300000000 + 10000000);
    check_joints(&a, robot, code);
    /* the same datagram again is a duplicate, and the robot continues */
    (void)arbiter_submit(&a, last, length, NOW_NS, true);
    arbiter_command(&a, NOW_NS, true, &out);
    CHECK(isfinite(out.linear_m_s) && isfinite(out.angular_rad_s));
}

#include "fuzz.h"
