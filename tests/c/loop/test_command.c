/* SPDX-License-Identifier: Apache-2.0
 * Every line of arbiter.c and ingress.c. */
#include <math.h>
#include <string.h>
#include <sys/epoll.h>
#include <sys/socket.h>
#include <unistd.h>

#include "check.h"
#include "ingress.h"

static const int64_t MS = 1000000, START_NS = 5000000000, LIFE_NS = 300000000;

static lease_permission grant_of(uint8_t letter, uint32_t priority)
{
    lease_permission grant = {.number = letter, .priority = priority, .lifetime_ns = LIFE_NS};
    memset(grant.token, letter, TOKEN_BYTES);
    return grant;
}

static command_datagram command_of(uint8_t letter, uint64_t sequence, int64_t stamp_ns,
                                   double linear_m_s)
{
    command_datagram command = {.magic = COMMAND_MAGIC,
                                .version = COMMAND_VERSION,
                                .kind = COMMAND_TWIST,
                                .sequence = sequence,
                                .stamp_ns = stamp_ns,
                                .linear_m_s = linear_m_s};
    memset(command.token, letter, TOKEN_BYTES);
    return command;
}

static int say(arbiter *a, command_datagram command, int64_t now_ns, bool may_move)
{
    return arbiter_submit(a, &command, sizeof command, now_ns, may_move);
}

static double speed_m_s(arbiter *a, int64_t now_ns, bool may_move)
{
    twist_command out;
    arbiter_command(a, now_ns, may_move, &out);
    return now_ns < out.expires_ns ? out.linear_m_s : 0.0;
}

static void two_sources(arbiter *a)
{
    lease_permissions permissions = {
        .lease = {grant_of('a', 10), grant_of('b', 20), grant_of('c', 20)}};
    arbiter_init(a, NULL, NULL);
    arbiter_grant(a, &permissions);
}

static void the_highest_priority_commands_and_the_first_among_equals(void)
{
    static arbiter a;
    two_sources(&a);
    CHECK(speed_m_s(&a, START_NS, true) == 0.0 && a.report.commander == 0);
    CHECK(say(&a, command_of('a', 1, START_NS, 0.1), START_NS, true) == 0);
    CHECK(speed_m_s(&a, START_NS, true) == 0.1);
    CHECK(say(&a, command_of('c', 1, START_NS, 0.3), START_NS, true) == 0);
    CHECK(say(&a, command_of('b', 1, START_NS, 0.2), START_NS, true) == 0);
    CHECK(speed_m_s(&a, START_NS, true) == 0.3 && a.report.commander == 'c');
    command_datagram release = {
        .magic = COMMAND_MAGIC, .version = COMMAND_VERSION, .kind = COMMAND_RELEASE};
    memset(release.token, 'c', TOKEN_BYTES);
    CHECK(say(&a, release, START_NS, true) == 0);
    CHECK(speed_m_s(&a, START_NS, true) == 0.2);
    CHECK(speed_m_s(&a, START_NS + LIFE_NS - 1, true) == 0.2);
    CHECK(speed_m_s(&a, START_NS + LIFE_NS, true) == 0.0 && a.report.commander == 0);
}

static void a_source_that_requests_motion_through_a_stop_is_held_until_it_requests_zero(void)
{
    static arbiter a;
    two_sources(&a);
    CHECK(say(&a, command_of('a', 1, START_NS, 0.1), START_NS, true) == 0);
    CHECK(speed_m_s(&a, START_NS, false) == 0.0);
    CHECK(speed_m_s(&a, START_NS, true) == 0.0);
    CHECK(say(&a, command_of('a', 2, START_NS, NAN), START_NS, true) == 1 + REFUSED_NOT_FINITE);
    CHECK(say(&a, command_of('a', 3, START_NS, 0.1), START_NS, true) == 0);
    CHECK(speed_m_s(&a, START_NS, true) == 0.0);
    CHECK(say(&a, command_of('a', 4, START_NS, 0.0), START_NS, true) == 0);
    CHECK(say(&a, command_of('a', 5, START_NS, 0.1), START_NS, true) == 0);
    CHECK(speed_m_s(&a, START_NS, true) == 0.1);
    CHECK(say(&a, command_of('a', 6, START_NS, -INFINITY), START_NS, true) ==
          1 + REFUSED_NOT_FINITE);
    CHECK(speed_m_s(&a, START_NS, true) == 0.0 && a.report.commander == 'a');
    CHECK(say(&a, command_of('a', 7, START_NS, 0.1), START_NS, false) == 0);
    int64_t later_ns = START_NS + LIFE_NS; /* no silence ends the hold */
    CHECK(say(&a, command_of('a', 8, later_ns, 0.1), later_ns, true) == 0 &&
          speed_m_s(&a, later_ns, true) == 0.0);
}

static void a_lease_that_is_no_longer_granted_has_ended(void)
{
    static arbiter a;
    two_sources(&a);
    CHECK(say(&a, command_of('b', 1, START_NS, 0.1), START_NS, true) == 0);
    lease_permissions permissions = {.lease = {grant_of('d', 1), grant_of('b', 30)}};
    arbiter_grant(&a, &permissions); /* b has another place in the list, and continues */
    CHECK(speed_m_s(&a, START_NS, true) == 0.1 && a.report.lease[1].priority == 30);
    permissions.lease[1] = (lease_permission){.number = 0};
    arbiter_grant(&a, &permissions);
    CHECK(speed_m_s(&a, START_NS, true) == 0.0 && a.report.commander == 0);
    CHECK(say(&a, command_of('b', 2, START_NS, 0.1), START_NS, true) == 1 + REFUSED_TOKEN);
    CHECK(say(&a, command_of(0, 2, START_NS, 0.1), START_NS, true) == 1 + REFUSED_TOKEN);
}

static void too_frequent_motion_is_refused_and_a_stop_never(void)
{
    static arbiter a;
    lease_permissions permissions = {.lease = {grant_of('a', 10)}};
    permissions.lease[0].interval_least_ns = 10 * MS;
    arbiter_init(&a, NULL, NULL);
    arbiter_grant(&a, &permissions);
    uint64_t sequence = 1, taken = 0;
    while (say(&a, command_of('a', sequence++, START_NS, 0.1), START_NS, true) == 0) {
        CHECK(++taken < 100);
    }
    CHECK(taken == 5 && a.report.refused[REFUSED_RATE] == 1); /* four may come early */
    CHECK(say(&a, command_of('a', sequence++, START_NS, 0.0), START_NS, true) == 0 &&
          speed_m_s(&a, START_NS, true) == 0.0);
    CHECK(say(&a, command_of('a', sequence++, START_NS, 0.1), START_NS, true) == 1 + REFUSED_RATE);
    int64_t later_ns = START_NS + 11 * MS;
    CHECK(say(&a, command_of('a', sequence++, later_ns, 0.1), later_ns, true) == 0);
    CHECK(say(&a, command_of('a', sequence++, later_ns, 0.1), later_ns, true) == 1 + REFUSED_RATE);
}

static void each_refusal_is_counted_by_its_kind(void)
{
    static arbiter a;
    two_sources(&a);
    command_datagram good = command_of('a', 7, START_NS, 0.1), bad = good;
    CHECK(arbiter_submit(&a, &good, sizeof good - 1, START_NS, true) == 1 + REFUSED_FORM);
    bad.kind = 3;
    CHECK(say(&a, bad, START_NS, true) == 1 + REFUSED_FORM);
    bad = good;
    bad.lifetime_ms = 301;
    CHECK(say(&a, bad, START_NS, true) == 1 + REFUSED_LIFETIME);
    bad.lifetime_ms = 20;
    CHECK(say(&a, bad, START_NS + 20 * MS, true) == 1 + REFUSED_AGE);
    CHECK(say(&a, command_of('a', 7, START_NS + 11 * MS, 0.1), START_NS, true) == 1 + REFUSED_AGE);
    CHECK(say(&a, good, START_NS, true) == 0 &&
          say(&a, good, START_NS, true) == 1 + REFUSED_SEQUENCE);
    const uint64_t refused[REFUSAL_KINDS] = {2, 0, 1, 2, 1, 0};
    CHECK(memcmp(a.report.refused, refused, sizeof refused) == 0 && a.report.accepted == 1);
}

static int listen_to(int epoll_fd, int fd)
{
    struct epoll_event wanted = {.events = EPOLLIN, .data.fd = fd};
    return epoll_ctl(epoll_fd, EPOLL_CTL_ADD, fd, &wanted);
}

static void a_wake_up_takes_a_bounded_number_of_datagrams(void)
{
    static arbiter a;
    int ends[2], others[2];
    CHECK(socketpair(AF_UNIX, SOCK_DGRAM | SOCK_NONBLOCK, 0, ends) == 0);
    CHECK(socketpair(AF_UNIX, SOCK_DGRAM | SOCK_NONBLOCK, 0, others) == 0);
    ingress in = {.epoll_fd = epoll_create1(0)}, none = {.epoll_fd = -1};
    CHECK(listen_to(in.epoll_fd, ends[0]) == 0 && listen_to(in.epoll_fd, others[0]) == 0);
    two_sources(&a);
    CHECK(!ingress_wait(&none, clock_now_ns() + MS) && ingress_take(&none, &a, true) == 0);
    CHECK(!ingress_wait(&in, clock_now_ns() + MS) && !ingress_wait(&in, 0));
    CHECK(ingress_take(&in, &a, true) == 0);
    uint64_t sent = 0;
    command_datagram command = command_of('a', 1, clock_now_ns(), 0.1);
    while (sent < 40 && send(ends[1], &command, sizeof command, 0) > 0) {
        command.sequence = ++sent + 1;
    }
    command_datagram other = command_of('b', 1, clock_now_ns(), 0.2);
    CHECK(send(others[1], &other, sizeof other, 0) > 0);
    sent++;
    CHECK(ingress_wait(&in, clock_now_ns() + 10000 * MS));
    uint64_t taken = 0, now = 0;
    while ((now = ingress_take(&in, &a, true)) > 0) {
        /* eight of the source that floods, and the command of the other one */
        CHECK(now <= 9 && (taken > 0 || now == 9));
        taken += now;
    }
    CHECK(taken == sent && sent > 1);
    uint8_t long_one[JOINT_COMMAND_BYTES + 8] = {0};
    CHECK(send(ends[1], long_one, sizeof long_one, 0) > 0 && ingress_take(&in, &a, true) == 1);
    CHECK(a.report.refused[REFUSED_FORM] == 1);
    CHECK(close(ends[0]) == 0 && close(ends[1]) == 0 && close(others[0]) == 0 &&
          close(others[1]) == 0);
    CHECK(close(in.epoll_fd) == 0);
}

static joint_datagram joints_of(uint64_t sequence, double left_rad_s, double right_rad_s,
                                double other_right_rad_s)
{
    joint_datagram joints = {.magic = COMMAND_MAGIC,
                             .version = COMMAND_VERSION,
                             .kind = COMMAND_JOINTS,
                             .sequence = sequence,
                             .stamp_ns = START_NS,
                             .joint_count = 3,
                             .velocity_rad_s = {left_rad_s, right_rad_s, other_right_rad_s}};
    memset(joints.token, 'a', TOKEN_BYTES);
    return joints;
}

static int report_joints(arbiter *a, joint_datagram joints)
{
    return arbiter_submit(a, &joints, sizeof joints, START_NS, true);
}

#define LIMITS {.linear.velocity_u_s = 1.0, .angular.velocity_u_s = 2.0}

static void more_than_ten_times_the_limit_is_refused_and_commands_zero(void)
{
    static arbiter a;
    static const core_config base = {.limits = LIMITS};
    base_limits now = {.linear.velocity_u_s = 0.1, .angular.velocity_u_s = 0.1};
    lease_permissions permissions = {.lease = {grant_of('a', 10)}};
    arbiter_init(&a, &base, &now);
    arbiter_grant(&a, &permissions);
    /* the limit of the robot file counts, too */
    CHECK(say(&a, command_of('a', 1, START_NS, -10.0), START_NS, true) == 0);
    CHECK(speed_m_s(&a, START_NS, true) == -10.0);
    CHECK(say(&a, command_of('a', 2, START_NS, 10.001), START_NS, true) ==
          1 + REFUSED_OUT_OF_RANGE);
    CHECK(speed_m_s(&a, START_NS, true) == 0.0 && a.report.commander == 'a');
    command_datagram turn = command_of('a', 3, START_NS, 0.5);
    turn.angular_rad_s = -1e308;
    CHECK(say(&a, turn, START_NS, true) == 1 + REFUSED_OUT_OF_RANGE &&
          speed_m_s(&a, START_NS, true) == 0.0);
    turn.sequence = 30, turn.angular_rad_s = 20.0; /* ten times the limit is still accepted */
    CHECK(say(&a, turn, START_NS, true) == 0);
    now.linear.velocity_u_s = 2.0;
    CHECK(say(&a, command_of('a', 40, START_NS, 20.0), START_NS, true) == 0);
    CHECK(say(&a, command_of('a', 50, START_NS, 1e308), START_NS, false) ==
          1 + REFUSED_OUT_OF_RANGE);
    CHECK(speed_m_s(&a, START_NS, true) == 0.0 && a.report.refused[REFUSED_OUT_OF_RANGE] == 3);
}

static void wheel_speeds_that_form_no_twist_are_refused(void)
{
    static arbiter a;
    static const core_config base = {.joint_count = 3,
                                     .limits = LIMITS,
                                     .joint = {{.row = {1.0, 0.0, -0.25}, .wheel_radius_m = 0.1},
                                               {.row = {1.0, 0.0, 0.25}, .wheel_radius_m = 0.1},
                                               {.row = {1.0, 0.0, 0.25}, .wheel_radius_m = 0.2}}};
    lease_permissions permissions = {.lease = {grant_of('a', 10)}};
    twist_command out;
    arbiter_init(&a, &base, NULL);
    arbiter_grant(&a, &permissions);
    CHECK(report_joints(&a, joints_of(1, 1.0, 2.0, 1.0)) == 0);
    arbiter_command(&a, START_NS, true, &out);
    CHECK(fabs(out.linear_m_s - 0.15) < 1e-12 && fabs(out.angular_rad_s - 0.2) < 1e-12);
    CHECK(say(&a, command_of('a', 2, START_NS, 0.5), START_NS, true) == 0); /* the newest counts,
                                                                               whatever its kind */
    arbiter_command(&a, START_NS, true, &out);
    CHECK(out.linear_m_s == 0.5 && out.angular_rad_s == 0.0);
    CHECK(report_joints(&a, joints_of(3, 1.0, 2.0, 2.0)) == 1 + REFUSED_JOINTS);
    CHECK(speed_m_s(&a, START_NS, true) == 0.0 && a.report.commander == 'a');
    CHECK(report_joints(&a, joints_of(4, 1.0, NAN, 1.0)) == 1 + REFUSED_NOT_FINITE);
    CHECK(report_joints(&a, joints_of(5, -1e300, 2e300, 1e300)) == 1 + REFUSED_OUT_OF_RANGE);
    CHECK(speed_m_s(&a, START_NS, true) == 0.0);
    joint_datagram few = joints_of(6, 1.0, 2.0, 1.0);
    few.joint_count = 2;
    few.velocity_rad_s[0] = NAN;
    CHECK(report_joints(&a, few) == 1 + REFUSED_JOINTS);
    few.kind = COMMAND_TWIST;
    CHECK(report_joints(&a, few) == 1 + REFUSED_FORM);
    few.version = 3;
    CHECK(report_joints(&a, few) == 1 + REFUSED_FORM);
    a.base = NULL;
    CHECK(report_joints(&a, joints_of(7, 1.0, 2.0, 1.0)) == 1 + REFUSED_JOINTS);
}

/* Wheels are left, right, left and right, with a radius of 0.1 m, the last one of 0.2 m. */
static bool twist_of(double first, double second, double third, double fourth, double *twist_u_s)
{
    static const core_config base = {.joint_count = 4,
                                     .joint = {{.row = {1.0, 0.0, -0.25}, .wheel_radius_m = 0.1},
                                               {.row = {1.0, 0.0, 0.25}, .wheel_radius_m = 0.1},
                                               {.row = {1.0, 0.0, -0.25}, .wheel_radius_m = 0.1},
                                               {.row = {1.0, 0.0, 0.25}, .wheel_radius_m = 0.2}}};
    const double velocity_rad_s[JOINTS_MAX] = {first, second, third, fourth, 1e9};
    return joints_twist(&base, velocity_rad_s, twist_u_s);
}

static bool goes(double first, double second, double third, double fourth)
{
    double twist_u_s[AXES];
    return twist_of(first, second, third, fourth, twist_u_s);
}

static void wheels_of_a_side_agree_within_a_hundredth_of_the_fastest_wheel(void)
{
    double twist_u_s[AXES];
    CHECK(twist_of(2.0, 6.0, 2.0, 3.0, twist_u_s) && twist_u_s[AXIS_LATERAL] == 0.0);
    CHECK(fabs(twist_u_s[AXIS_LINEAR] - 0.4) < 1e-12 &&
          fabs(twist_u_s[AXIS_ANGULAR] - 0.8) < 1e-12);
    CHECK(twist_of(0.0, 0.0, 0.0, 0.0, twist_u_s) && twist_u_s[AXIS_LINEAR] == 0.0 &&
          twist_u_s[AXIS_ANGULAR] == 0.0);
    /* cases: each wheel is a little more or less than a hundredth off the mean of its side */
    CHECK(goes(10.095, 0.0, 9.905, 0.0) && !goes(10.105, 0.0, 9.895, 0.0));
    CHECK(goes(0.0, 10.095, 0.0, 4.9525) && !goes(0.0, 10.105, 0.0, 4.9475));
    CHECK(goes(-9.905, 0.0, -10.095, 0.0) && !goes(-9.895, 0.0, -10.105, 0.0));
    CHECK(goes(0.095, -10.0, -0.095, -5.0) && !goes(0.105, -10.0, -0.105, -5.0));
    CHECK(goes(-10.0, 0.095, -10.0, -0.0475) && !goes(-10.0, 0.105, -10.0, -0.0525));
    /* also if only the first of three wheels is off */
    static const core_config uneven = {.joint_count = 4,
                                       .joint = {{.row = {1.0, 0.0, -0.25}, .wheel_radius_m = 0.1},
                                                 {.row = {1.0, 0.0, -0.25}, .wheel_radius_m = 0.1},
                                                 {.row = {1.0, 0.0, -0.25}, .wheel_radius_m = 0.1},
                                                 {.row = {1.0, 0.0, 0.25}, .wheel_radius_m = 0.1}}};
    CHECK(!joints_twist(&uneven, (const double[]){10.12, 9.94, 9.94, 0.0}, twist_u_s));
    CHECK(joints_twist(&uneven, (const double[]){10.08, 9.96, 9.96, 0.0}, twist_u_s));
    /* nearly at rest, by a millionth of a metre per second */
    CHECK(goes(9e-6, 0.0, -9e-6, 0.0) && !goes(11e-6, 0.0, -11e-6, 0.0));
}

/* Two bases: a car, which is steered by one joint in front, and a base with two sides, which turns
 * on the spot. */
static void turns_on_the_spot_that_the_steering_cannot_do_are_counted(void)
{
    static arbiter a;
    static core_config base = {.joint_count = 2,
                               .limits = LIMITS,
                               .joint = {{.row = {1.0, 0.0, -0.25}, .wheel_radius_m = 0.1},
                                         {.row = {1.0, 0.0, 0.25}, .wheel_radius_m = 0.1}}};
    lease_permissions permissions = {.lease = {grant_of('a', 10)}};
    arbiter_init(&a, &base, NULL);
    arbiter_grant(&a, &permissions);
    command_datagram command = command_of('a', 1, START_NS, 0.0);
    command.angular_rad_s = 0.1;
    CHECK(say(&a, command, START_NS, true) == 0 && a.report.on_spot == 0);
    base.module_count = 2;
    base.module[0] = (wheel_module){.x_m = 0.3, .steering = 2};
    base.module[1] = (wheel_module){.traction = 1};
    base.joint[1].position =
        (position_config){.used = 1, .position_min_rad = -0.5, .position_max_rad = 0.5};
    command.sequence = 2;
    CHECK(say(&a, command, START_NS, true) == 0 && a.report.on_spot == 1);
    command.sequence = 3;
    command.linear_m_s = 0.1;
    CHECK(say(&a, command, START_NS, true) == 0 && a.report.on_spot == 1 && a.report.sideways == 0);
    command.sequence = 4;
    /* counts as a sideways command instead */
    command.linear_m_s = 0.0, command.lateral_m_s = 0.1;
    CHECK(say(&a, command, START_NS, true) == 0 && a.report.on_spot == 1 && a.report.sideways == 1);
    CHECK(say(&a, command_of('a', 5, START_NS, 0.0), START_NS, true) == 0);
    CHECK(a.report.on_spot == 1 && a.report.sideways == 1);
}

/* Version 1 ends before the lateral speed, which is then zero. A base that cannot strafe follows
 * the rest, and the command is counted. */
static void a_command_of_either_version_is_followed(void)
{
    static arbiter a;
    static const core_config two_sides = {
        .joint_count = 2,
        .limits = LIMITS,
        .joint = {{.row = {1.0, 0.0, -0.25}, .wheel_radius_m = 0.1},
                  {.row = {1.0, 0.0, 0.25}, .wheel_radius_m = 0.1}}};
    lease_permissions permissions = {.lease = {grant_of('a', 10)}};
    twist_command out;
    arbiter_init(&a, &two_sides, NULL);
    arbiter_grant(&a, &permissions);
    command_datagram command = command_of('a', 1, START_NS, 0.1);
    command.lateral_m_s = 30.0; /* also beyond ten times any limit */
    CHECK(say(&a, command, START_NS, true) == 0 && a.report.sideways == 1);
    arbiter_command(&a, START_NS, true, &out);
    CHECK(out.linear_m_s == 0.1 && out.lateral_m_s == 30.0);
    command.version = COMMAND_VERSION_PLANE;
    command.sequence = 2;
    CHECK(arbiter_submit(&a, &command, COMMAND_BYTES, START_NS, true) == 1 + REFUSED_FORM);
    CHECK(arbiter_submit(&a, &command, COMMAND_BYTES_PLANE, START_NS, true) == 0 &&
          a.report.sideways == 1);
    arbiter_command(&a, START_NS, true, &out);
    CHECK(out.linear_m_s == 0.1 && out.lateral_m_s == 0.0);
    command.version = COMMAND_VERSION;
    command.sequence = 3;
    CHECK(arbiter_submit(&a, &command, COMMAND_BYTES_PLANE, START_NS, true) == 1 + REFUSED_FORM);
    command.lateral_m_s = NAN;
    CHECK(say(&a, command, START_NS, true) == 1 + REFUSED_NOT_FINITE);
    arbiter_command(&a, START_NS, true, &out);
    CHECK(out.linear_m_s == 0.0 && out.lateral_m_s == 0.0);
}

int main(void)
{
    turns_on_the_spot_that_the_steering_cannot_do_are_counted();
    a_command_of_either_version_is_followed();
    the_highest_priority_commands_and_the_first_among_equals();
    a_source_that_requests_motion_through_a_stop_is_held_until_it_requests_zero();
    a_lease_that_is_no_longer_granted_has_ended();
    too_frequent_motion_is_refused_and_a_stop_never();
    each_refusal_is_counted_by_its_kind();
    a_wake_up_takes_a_bounded_number_of_datagrams();
    more_than_ten_times_the_limit_is_refused_and_commands_zero();
    wheel_speeds_that_form_no_twist_are_refused();
    wheels_of_a_side_agree_within_a_hundredth_of_the_fastest_wheel();
    return checks_report("command");
}
