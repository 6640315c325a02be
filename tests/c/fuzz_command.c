/* SPDX-License-Identifier: Apache-2.0
 * fuzz_command.c: whatever comes as a datagram, the core gets numbers, of a lease that lives; and without the token
 * no source commands. */
#include "check.h"
#include "rt.h"

#include <math.h>
#include <string.h>

#define FUZZ_NAME "fuzz_command"
enum { FUZZ_MAX = 256 };

static const int64_t NOW_NS = 5000000000;

static const core_config BASE = {.joint_count = 4,
                                 .limits = {.linear.velocity_u_s = 1e6, .angular.velocity_u_s = 1e6},
                                 .joint = {{.row = {1.0, 0.0, -0.25}, .wheel_radius_m = 0.1},
                                           {.row = {1.0, 0.0, 0.25}, .wheel_radius_m = 0.1},
                                           {.row = {1.0, 0.0, -0.25}, .wheel_radius_m = 0.2},
                                           {.row = {1.0, 0.0, 0.25}, .wheel_radius_m = 0.2}}};

static void granted(arbiter *a)
{
    lease_permissions permissions = {.lease = {{.number = 1, .priority = 10, .lifetime_ns = 300000000}}};
    memset(permissions.lease[0].token, 'a', TOKEN_BYTES);
    arbiter_init(a, &BASE, NULL);
    arbiter_grant(a, &permissions);
}

/* By the first bytes: as it is, or with more and more of what makes it a command. */
static size_t shaped(uint8_t *bytes, size_t size)
{
    joint_datagram head;
    memcpy(&head, bytes, sizeof head);
    uint8_t how = bytes[8];
    head.magic = how & 1 ? COMMAND_MAGIC : head.magic;
    bool positions = (how & 128) != 0;
    head.version = how & 1 ? (positions ? COMMAND_VERSION_POSITIONS : COMMAND_VERSION) : head.version;
    head.kind = how & 2 ? (uint16_t)(1 + how % 3) : head.kind;
    head.stamp_ns = how & 4 ? NOW_NS : head.stamp_ns;
    head.lifetime_ms = how & 8 ? 0 : head.lifetime_ms;
    head.joint_count = how & 16 ? BASE.joint_count : head.joint_count;
    if (how & 32) {
        memset(head.token, 'a', TOKEN_BYTES);
    }
    memcpy(bytes, &head, sizeof head);
    size_t of_joints = positions ? (size_t)JOINT_POSITION_BYTES : (size_t)JOINT_COMMAND_BYTES;
    return how & 64 ? (head.kind == COMMAND_JOINTS ? of_joints : (size_t)COMMAND_BYTES) : size;
}

static void once(const uint8_t *data, size_t size)
{
    static arbiter a;
    static uint8_t room[FUZZ_MAX];
    uint8_t bytes[FUZZ_MAX];
    memcpy(bytes, data, FUZZ_MAX);
    size_t length = shaped(bytes, size);
    uint8_t *last = room + sizeof room - length; /* a look beyond the last byte is seen by the sanitizer */
    memcpy(last, bytes, length);
    bool right = length >= 24 && memcmp(bytes + 8, "aaaaaaaaaaaaaaaa", TOKEN_BYTES) == 0;
    twist_command out;
    granted(&a);
    int code = arbiter_submit(&a, last, length, NOW_NS, true);
    arbiter_command(&a, NOW_NS, true, &out);
    CHECK(code >= 0 && code <= REFUSAL_KINDS);
    CHECK(isfinite(out.linear_m_s) && isfinite(out.angular_rad_s));
    CHECK(right || (code != 0 && a.report.commander == 0));
    CHECK(code == 0 || (out.linear_m_s == 0.0 && out.angular_rad_s == 0.0));
    CHECK(out.expires_ns <= NOW_NS + 300000000 + 10000000);
    /* a second time it is a duplicate, and the robot goes on */
    (void)arbiter_submit(&a, last, length, NOW_NS, true);
    arbiter_command(&a, NOW_NS, true, &out);
    CHECK(isfinite(out.linear_m_s) && isfinite(out.angular_rad_s));
}

#include "fuzz.h"
