/* SPDX-License-Identifier: Apache-2.0
 * Leases in detail: tokens, the age that a command may have, which source is held beyond the end of
 * its lease, and the report. */
#include <math.h>
#include <string.h>

#include "check.h"
#include "rt.h"

static const int64_t MS = 1000000, LIFE_NS = 300000000;

typedef struct {
    arbiter arbiter;
    lease_permissions permissions;
    int64_t now_ns;
    bool may_move;
} bench;

static bench b;

/* Leases are numbered from 1, like those of the daemon. */
static void begin(void)
{
    memset(&b, 0, sizeof b);
    b.now_ns = 5000 * MS;
    b.may_move = true;
    for (uint32_t i = 0; i < 3; i++) {
        lease_permission *grant = &b.permissions.lease[i];
        *grant = (lease_permission){.number = i + 1, .priority = 10, .lifetime_ns = LIFE_NS};
        memset(grant->token, 0x41, TOKEN_BYTES);
        grant->token[TOKEN_BYTES - 1] = (uint8_t)i;
    }
    arbiter_init(&b.arbiter, NULL, NULL);
    arbiter_grant(&b.arbiter, &b.permissions);
}

static command_datagram command_of(uint32_t lease, uint64_t sequence, double linear_m_s)
{
    command_datagram command = {.magic = COMMAND_MAGIC,
                                .version = COMMAND_VERSION,
                                .kind = COMMAND_TWIST,
                                .sequence = sequence,
                                .stamp_ns = b.now_ns,
                                .linear_m_s = linear_m_s};
    memcpy(command.token, b.permissions.lease[lease].token, TOKEN_BYTES);
    return command;
}

static int submit(command_datagram command)
{
    return arbiter_submit(&b.arbiter, &command, sizeof command, b.now_ns, b.may_move);
}

static int say(uint32_t lease, uint64_t sequence, double linear_m_s)
{
    return submit(command_of(lease, sequence, linear_m_s));
}

static twist_command obeyed(void)
{
    twist_command out;
    arbiter_command(&b.arbiter, b.now_ns, b.may_move, &out);
    return out;
}

static const lease_state *lease_of(uint32_t lease)
{
    return &b.arbiter.report.lease[lease];
}

static void each_byte_of_a_token_counts(void)
{
    begin();
    for (uint32_t i = 0; i < TOKEN_BYTES; i++) {
        command_datagram command = command_of(0, i + 1, 0.1);
        CHECK(submit(command) == 0);
        command.sequence = 100;
        command.token[i] ^= 0x80;
        CHECK(submit(command) == 1 + REFUSED_TOKEN);
    }
}

static void a_datagram_of_another_program_or_version_is_refused(void)
{
    begin();
    command_datagram command = command_of(0, 1, 0.1);
    command.magic++;
    CHECK(submit(command) == 1 + REFUSED_FORM);
    command.magic--;
    command.version++;
    CHECK(submit(command) == 1 + REFUSED_FORM);
    command.version--;
    CHECK(submit(command) == 0);
}

static void a_stamp_is_required_and_may_be_ten_milliseconds_ahead(void)
{
    begin();
    b.now_ns = 2;
    command_datagram command = command_of(0, 1, 0.1);
    command.stamp_ns = 0;
    CHECK(submit(command) == 1 + REFUSED_AGE);
    command.stamp_ns = 1;
    CHECK(submit(command) == 0);
    command.sequence++;
    command.stamp_ns = b.now_ns + 10 * MS + 1;
    CHECK(submit(command) == 1 + REFUSED_AGE);
    command.stamp_ns--;
    CHECK(submit(command) == 0);
}

static void an_expired_command_is_refused(void)
{
    begin();
    command_datagram command = command_of(0, 1, 0.1);
    b.now_ns += LIFE_NS;
    CHECK(submit(command) == 1 + REFUSED_AGE);
    b.now_ns--;
    CHECK(submit(command) == 0 && obeyed().linear_m_s == 0.1);
    CHECK(obeyed().expires_ns == b.now_ns + 1); /* a late arrival does not prolong its life */
}

static void a_command_may_last_as_long_as_its_lease_allows(void)
{
    begin();
    command_datagram command = command_of(0, 1, 0.1);
    command.lifetime_ms = 300;
    CHECK(submit(command) == 0 && obeyed().expires_ns == b.now_ns + LIFE_NS);
    command.sequence++;
    command.lifetime_ms = 20;
    CHECK(submit(command) == 0 && obeyed().expires_ns == b.now_ns + 20 * MS);
    command.sequence++;
    command.lifetime_ms = 19;
    CHECK(submit(command) == 1 + REFUSED_LIFETIME);
}

static void the_first_sequence_may_be_any_and_none_comes_twice(void)
{
    begin();
    CHECK(say(0, 1, 0.1) == 0);
    CHECK(say(0, 1, 0.2) == 1 + REFUSED_SEQUENCE);
    CHECK(say(1, UINT64_C(1) << 63 | 5, 0.1) == 0);
    CHECK(say(1, UINT64_C(1) << 63 | 5, 0.1) == 1 + REFUSED_SEQUENCE);
}

/* 0 is never a valid sequence number. */
static void a_sequence_continues_past_the_end_of_its_64_bits(void)
{
    begin();
    CHECK(say(0, 100, 0.1) == 0 && say(0, (UINT64_C(1) << 63) + 101, 0.1) == 1 + REFUSED_SEQUENCE);
    CHECK(say(0, UINT64_C(1) << 63, 0.1) == 0 && say(0, UINT64_MAX, 0.1) == 0);
    CHECK(say(0, 0, 0.9) == 1 + REFUSED_SEQUENCE &&
          say(0, UINT64_C(7) << 61, 0.9) == 1 + REFUSED_SEQUENCE);
    CHECK(obeyed().linear_m_s == 0.1);
    CHECK(say(0, 5, 0.2) == 0 && say(0, UINT64_MAX, 0.1) == 1 + REFUSED_SEQUENCE &&
          obeyed().linear_m_s == 0.2);
}

static void a_lease_continues_when_others_come_and_go(void)
{
    begin();
    CHECK(say(0, 1, 0.1) == 0 && obeyed().linear_m_s == 0.1);
    lease_permissions other = {.lease = {[5] = b.permissions.lease[0]}};
    arbiter_grant(&b.arbiter, &other);
    CHECK(obeyed().linear_m_s == 0.1 && b.arbiter.report.commander == 1 &&
          lease_of(5)->sequence == 1);
}

static void among_equals_the_first_lease_commands_and_a_higher_priority_in_any_place(void)
{
    begin();
    CHECK(say(0, 1, 0.1) == 0 && say(1, 1, 0.2) == 0);
    CHECK(obeyed().linear_m_s == 0.1);
    begin();
    CHECK(say(1, 1, 0.2) == 0 && say(0, 1, 0.1) == 0);
    CHECK(obeyed().linear_m_s == 0.2);
    begin();
    b.permissions.lease[0].priority = 20;
    arbiter_grant(&b.arbiter, &b.permissions);
    /* the lower priority was first, and is later in the list */
    CHECK(say(1, 1, 0.2) == 0 && say(0, 1, 0.1) == 0);
    CHECK(obeyed().linear_m_s == 0.1);
    begin();
    CHECK(say(0, 1, 0.1) == 0);
    b.now_ns += LIFE_NS / 2;
    CHECK(say(1, 1, 0.2) == 0 && obeyed().linear_m_s == 0.1);
    b.now_ns += LIFE_NS / 2; /* the first lease has lapsed, and returns after the other */
    CHECK(obeyed().linear_m_s == 0.2 && say(0, 2, 0.1) == 0 && obeyed().linear_m_s == 0.2);
}

static void a_followed_command_carries_its_sequence_and_keeps_its_stamp(void)
{
    begin();
    CHECK(say(0, 7, 0.1) == 0);
    twist_command out = obeyed();
    CHECK(out.stamp_ns == b.now_ns && out.sequence == 7 && lease_of(0)->stamp_ns == b.now_ns);
    int64_t stamp_ns = b.now_ns;
    b.now_ns += LIFE_NS;
    out = obeyed();
    CHECK(out.stamp_ns == stamp_ns && out.expires_ns == 0 && out.linear_m_s == 0.0 &&
          b.arbiter.report.commander == 0);
}

static void a_release_ends_a_lease_s_command_at_once_and_is_accepted(void)
{
    begin();
    b.now_ns = 0;
    command_datagram command = command_of(0, 1, 0.1);
    command.stamp_ns = 1;
    CHECK(submit(command) == 0 && obeyed().linear_m_s == 0.1 && b.arbiter.report.accepted == 1);
    command.kind = COMMAND_RELEASE;
    CHECK(submit(command) == 0 && obeyed().linear_m_s == 0.0 && b.arbiter.report.accepted == 2);
    CHECK(b.arbiter.report.commander == 0);
}

static void the_report_has_whether_motion_is_allowed(void)
{
    begin();
    (void)obeyed();
    CHECK(b.arbiter.report.may_move == 1);
    b.may_move = false;
    (void)obeyed();
    CHECK(b.arbiter.report.may_move == 0);
}

static void the_interval_between_commands_is_smoothed_over_eight(void)
{
    begin();
    b.now_ns = 1;
    CHECK(say(0, 1, 0.1) == 0 && lease_of(0)->interval_ns == 0 && lease_of(0)->taken_ns == 1);
    b.now_ns += 1;
    CHECK(say(0, 2, 0.1) == 0 && lease_of(0)->interval_ns == 1);
    b.now_ns += 9;
    CHECK(say(0, 3, 0.1) == 0 && lease_of(0)->interval_ns == 2);
    b.now_ns += 802;
    CHECK(say(0, 4, 0.1) == 0 && lease_of(0)->interval_ns == 102 &&
          lease_of(0)->taken_ns == b.now_ns);
    b.now_ns += 22;
    CHECK(say(0, 5, 0.1) == 0 && lease_of(0)->interval_ns == 92);
}

static void any_rate_but_zero_is_a_limit(void)
{
    begin();
    b.permissions.lease[0].interval_least_ns = 1;
    arbiter_grant(&b.arbiter, &b.permissions);
    for (uint64_t sequence = 1; sequence <= 5; sequence++) {
        CHECK(say(0, sequence, 0.1) == 0 && say(1, sequence, 0.1) == 0);
    }
    CHECK(say(0, 6, 0.1) == 1 + REFUSED_RATE && say(1, 6, 0.1) == 0);
}

/* Bring the robot to rest for a while, and let sources move it again. */
static void stop_and_go(void)
{
    b.may_move = false;
    (void)obeyed();
    b.now_ns += LIFE_NS;
    (void)obeyed();
    b.may_move = true;
    (void)obeyed();
}

/* Commands that come less often than they live, and one gap in a stream of them: the same rule. */
static void a_source_that_was_silent_during_a_stop_is_held(void)
{
    static const int64_t PAUSES_NS[] = {310000000, 340000000, 900000000, 3600000000000};
    for (uint32_t i = 0; i < 4; i++) {
        begin();
        CHECK(say(0, 1, 0.1) == 0 && obeyed().linear_m_s == 0.1);
        b.now_ns += PAUSES_NS[i]; /* it has lapsed when the stop comes */
        stop_and_go();
        CHECK(lease_of(0)->held == 1 && lease_of(0)->held_ns <= b.now_ns);
        for (uint64_t sequence = 2; sequence < 6; sequence++) {
            CHECK(say(0, sequence, 0.1) == 0 && obeyed().linear_m_s == 0.0);
            b.now_ns += PAUSES_NS[i];
        }
        CHECK(say(0, 6, 0.0) == 0 && lease_of(0)->held == 0);
        b.now_ns += PAUSES_NS[i];
        CHECK(say(0, 7, 0.1) == 0 && obeyed().linear_m_s == 0.1);
    }
}

static void a_source_that_was_silent_while_the_robot_was_armed_is_held(void)
{
    begin();
    b.may_move = false;
    CHECK(say(0, 1, 0.1) == 0 && obeyed().linear_m_s == 0.0);
    b.now_ns += 2 * LIFE_NS;
    (void)obeyed();
    b.may_move = true;
    b.now_ns += LIFE_NS;
    CHECK(say(0, 2, 0.1) == 0 && obeyed().linear_m_s == 0.0 && lease_of(0)->held == 1);
}

static void a_source_that_had_ended_its_request_before_the_stop_is_not_held(void)
{
    for (uint32_t released = 0; released < 2; released++) {
        begin();
        CHECK(say(0, 1, 0.1) == 0);
        command_datagram end = command_of(0, 2, 0.0);
        end.kind = released != 0 ? COMMAND_RELEASE : COMMAND_TWIST;
        CHECK(submit(end) == 0);
        stop_and_go();
        CHECK(lease_of(0)->held == 0);
        CHECK(say(0, 3, 0.1) == 0 && obeyed().linear_m_s == 0.1);
    }
}

static void a_command_that_is_no_number_ends_neither_a_request_nor_a_hold(void)
{
    begin();
    CHECK(say(0, 1, 0.1) == 0 && say(0, 2, NAN) == 1 + REFUSED_NOT_FINITE);
    CHECK(obeyed().linear_m_s == 0.0);
    stop_and_go();
    CHECK(say(0, 3, NAN) == 1 + REFUSED_NOT_FINITE && lease_of(0)->held == 1);
    CHECK(say(0, 4, 0.1) == 0 && obeyed().linear_m_s == 0.0);
}

static void giving_the_command_back_ends_a_hold(void)
{
    begin();
    CHECK(say(0, 1, 0.1) == 0);
    stop_and_go();
    command_datagram release = command_of(0, 2, 0.0);
    release.kind = COMMAND_RELEASE;
    CHECK(lease_of(0)->held == 1 && submit(release) == 0 && lease_of(0)->held == 0);
    CHECK(say(0, 3, 0.1) == 0 && obeyed().linear_m_s == 0.1);
}

static void a_person_lets_all_that_are_held_go_on(void)
{
    begin();
    CHECK(say(0, 1, 0.1) == 0 && say(1, 1, 0.2) == 0);
    stop_and_go();
    CHECK(say(0, 2, 0.1) == 0 && obeyed().linear_m_s == 0.0);
    b.permissions.releases++;
    b.may_move = false; /* a stop that comes at the same time counts */
    arbiter_grant(&b.arbiter, &b.permissions);
    CHECK(lease_of(0)->held == 0 && lease_of(1)->held == 0);
    b.may_move = true;
    CHECK(obeyed().linear_m_s == 0.1);
    stop_and_go();
    arbiter_grant(&b.arbiter, &b.permissions); /* the same number of releases: no new one */
    CHECK(say(0, 3, 0.1) == 0 && obeyed().linear_m_s == 0.0);
}

static void a_lease_that_the_owner_s_hold_passes_to_is_held_until_it_requests_zero(void)
{
    int64_t held_ns = 4000 * MS;
    begin();
    b.permissions.lease[0].barred_ns = held_ns;
    arbiter_grant(&b.arbiter, &b.permissions);
    CHECK(lease_of(0)->held == 1 && lease_of(0)->held_ns == held_ns && lease_of(1)->held == 0);
    CHECK(say(0, 1, 0.1) == 0 && obeyed().linear_m_s == 0.0 && lease_of(0)->held_ns == held_ns);
    b.now_ns += 100 * LIFE_NS;
    CHECK(say(0, 2, 0.1) == 0 && obeyed().linear_m_s == 0.0);
    CHECK(say(0, 3, 0.0) == 0 && say(0, 4, 0.1) == 0 && obeyed().linear_m_s == 0.1);
    arbiter_grant(&b.arbiter, &b.permissions); /* the same hold counts once */
    CHECK(obeyed().linear_m_s == 0.1);
    b.permissions.lease[0].barred_ns = held_ns + 1;
    arbiter_grant(&b.arbiter, &b.permissions);
    CHECK(obeyed().linear_m_s == 0.0);
    b.permissions.lease[0].barred_ns = held_ns + 2;
    b.permissions.releases++; /* the hold is the later of the two */
    arbiter_grant(&b.arbiter, &b.permissions);
    CHECK(obeyed().linear_m_s == 0.0);
}

static void arming_lets_a_source_go_on_that_has_been_silent_for_five_seconds(void)
{
    static const int64_t SILENT_MS[] = {400, 4999, 5000, 60000};
    for (uint32_t i = 0; i < 4; i++) {
        begin();
        b.permissions.lease[1].barred_ns = b.now_ns; /* it has never sent anything */
        arbiter_grant(&b.arbiter, &b.permissions);
        CHECK(say(0, 1, 0.1) == 0);
        b.may_move = false;
        (void)obeyed();
        b.now_ns += SILENT_MS[i] * MS;
        (void)obeyed();
        arbiter_arm(&b.arbiter, b.now_ns);
        b.may_move = true;
        double expected_m_s = i < 2 ? 0.0 : 0.1;
        CHECK(lease_of(0)->held == (i < 2) && lease_of(1)->held == (i < 2));
        CHECK(say(0, 2, 0.1) == 0 && obeyed().linear_m_s == expected_m_s);
    }
}

static void a_place_without_a_lease_is_not_held(void)
{
    begin();
    b.permissions.lease[7].barred_ns = 1;
    arbiter_grant(&b.arbiter, &b.permissions);
    CHECK(lease_of(7)->held == 0);
}

static void commands_that_lapse_one_after_the_other_are_counted(void)
{
    begin();
    for (uint32_t i = 0; i < 4; i++) {
        CHECK(say(0, 1 + i, 0.1) == 0 && lease_of(0)->lapses == i);
        b.now_ns += LIFE_NS + 40 * MS;
    }
    CHECK(lease_of(0)->interval_ns == LIFE_NS + 40 * MS);
    CHECK(say(0, 5, 0.0) == 0 && lease_of(0)->lapses == 4);
    b.now_ns += 100 * LIFE_NS; /* the pause after a request that has ended */
    CHECK(say(0, 6, 0.1) == 0 && lease_of(0)->lapses == 0 && lease_of(0)->interval_ns == 0);
    b.now_ns += LIFE_NS + MS;
    CHECK(say(0, 7, 0.1) == 0 && lease_of(0)->lapses == 1);
    b.now_ns += LIFE_NS - 1;
    CHECK(say(0, 8, 0.1) == 0 && lease_of(0)->lapses == 0);
}

/* After a suspend of the computer, commands that were stamped before it count as never sent. */
static void after_a_suspend_no_command_is_alive(void)
{
    begin();
    for (uint32_t lease = 0; lease < 3; lease++) {
        CHECK(say(lease, 1, 0.1) == 0);
    }
    for (uint32_t lease = 0; lease < 3; lease++) {
        CHECK(b.arbiter.report.lease[lease].expires_ns > b.now_ns);
    }
    command_datagram before = command_of(0, 2, 0.1);
    b.now_ns += MS;
    arbiter_resume(&b.arbiter, b.now_ns);
    for (uint32_t lease = 0; lease < LEASES_MAX; lease++) {
        CHECK(b.arbiter.report.lease[lease].expires_ns == 0);
    }
    CHECK(submit(before) != 0);
    CHECK(say(0, 3, 0.1) == 0); /* stamped at the end of the suspend */
}

static void motion_along_any_axis_holds_a_source_that_requests_it_before_arming(void)
{
    for (uint32_t axes = 0; axes < 8; axes++) {
        begin();
        b.may_move = false;
        command_datagram command = command_of(0, 1, (axes & 1U) != 0 ? 0.1 : 0.0);
        command.angular_rad_s = (axes & 2U) != 0 ? 0.1 : 0.0;
        command.lateral_m_s = (axes & 4U) != 0 ? -0.1 : 0.0;
        CHECK(submit(command) == 0);
        b.may_move = true;
        twist_command out = obeyed();
        CHECK(lease_of(0)->held == (axes != 0));
        CHECK(out.linear_m_s == 0.0 && out.angular_rad_s == 0.0 && out.lateral_m_s == 0.0);
    }
}

static void a_lateral_speed_far_beyond_its_limit_is_refused(void)
{
    static const double SPEEDS_M_S[] = {5.0, 5.001, -5.0, -5.001, 0.0};
    core_config swerve = {.module_count = 2, .module = {{.steering = 1}, {.steering = 1}}};
    swerve.limits.lateral.velocity_u_s = 0.5;
    for (uint32_t i = 0; i < 5; i++) {
        begin();
        arbiter_init(&b.arbiter, &swerve, NULL);
        arbiter_grant(&b.arbiter, &b.permissions);
        command_datagram command = command_of(0, 1, 0.0);
        command.lateral_m_s = SPEEDS_M_S[i];
        CHECK(submit(command) == (i % 2 == 1 ? 1 + REFUSED_OUT_OF_RANGE : 0));
        CHECK(obeyed().lateral_m_s == (i % 2 == 1 ? 0.0 : SPEEDS_M_S[i]));
    }
}

int main(void)
{
    a_lateral_speed_far_beyond_its_limit_is_refused();
    motion_along_any_axis_holds_a_source_that_requests_it_before_arming();
    each_byte_of_a_token_counts();
    a_datagram_of_another_program_or_version_is_refused();
    a_stamp_is_required_and_may_be_ten_milliseconds_ahead();
    an_expired_command_is_refused();
    a_command_may_last_as_long_as_its_lease_allows();
    the_first_sequence_may_be_any_and_none_comes_twice();
    a_sequence_continues_past_the_end_of_its_64_bits();
    a_lease_continues_when_others_come_and_go();
    among_equals_the_first_lease_commands_and_a_higher_priority_in_any_place();
    a_followed_command_carries_its_sequence_and_keeps_its_stamp();
    a_release_ends_a_lease_s_command_at_once_and_is_accepted();
    the_report_has_whether_motion_is_allowed();
    the_interval_between_commands_is_smoothed_over_eight();
    any_rate_but_zero_is_a_limit();
    a_source_that_was_silent_during_a_stop_is_held();
    a_source_that_was_silent_while_the_robot_was_armed_is_held();
    a_source_that_had_ended_its_request_before_the_stop_is_not_held();
    a_command_that_is_no_number_ends_neither_a_request_nor_a_hold();
    giving_the_command_back_ends_a_hold();
    a_person_lets_all_that_are_held_go_on();
    a_lease_that_the_owner_s_hold_passes_to_is_held_until_it_requests_zero();
    arming_lets_a_source_go_on_that_has_been_silent_for_five_seconds();
    a_place_without_a_lease_is_not_held();
    commands_that_lapse_one_after_the_other_are_counted();
    after_a_suspend_no_command_is_alive();
    return checks_report("arbiter");
}
