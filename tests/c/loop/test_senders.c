/* SPDX-License-Identifier: Apache-2.0
 * Several senders under one lease: a zero of one of them does not let another go on. */
#include <string.h>

#include "check.h"
#include "rt.h"

static const int64_t MS = 1000000, LIFE_NS = 300000000, SILENT_NS = SOURCE_SILENT_S * 1000000000LL;
enum { ONE = 1, OTHER = 2 };

static struct {
    arbiter arbiter;
    lease_permissions permissions;
    int64_t now_ns;
    uint64_t sequence;
    bool may_move;
} b;

static void begin(void)
{
    memset(&b, 0, sizeof b);
    b.now_ns = 2 * SILENT_NS;
    b.may_move = true;
    b.permissions.lease[0] = (lease_permission){.number = 1, .lifetime_ns = LIFE_NS};
    arbiter_init(&b.arbiter, NULL, NULL);
    arbiter_grant(&b.arbiter, &b.permissions);
}

static int send_kind(uint32_t sender, double linear_m_s, uint32_t kind)
{
    command_datagram command = {.magic = COMMAND_MAGIC,
                                .version = COMMAND_VERSION,
                                .kind = (uint16_t)(kind | sender << SENDER_SHIFT),
                                .sequence = ++b.sequence,
                                .stamp_ns = b.now_ns,
                                .linear_m_s = linear_m_s};
    return arbiter_submit(&b.arbiter, &command, sizeof command, b.now_ns, b.may_move);
}

static double obeyed_m_s(void)
{
    twist_command out;
    arbiter_command(&b.arbiter, b.now_ns, b.may_move, &out);
    return out.linear_m_s;
}

/* Send a command and return the speed that the robot gets then. */
static double after(uint32_t sender, double linear_m_s)
{
    CHECK(send_kind(sender, linear_m_s, COMMAND_TWIST) == 0);
    return obeyed_m_s();
}

static void stop_and_go(void)
{
    b.may_move = false;
    (void)obeyed_m_s();
    b.may_move = true;
    (void)obeyed_m_s();
}

static const lease_state *lease(void)
{
    return &b.arbiter.report.lease[0];
}

static void a_zero_of_one_sender_does_not_let_another_go_on(void)
{
    begin();
    CHECK(after(ONE, 0.1) == 0.1 && after(OTHER, 0.2) == 0.2);
    stop_and_go();
    CHECK(lease()->held == 1 && lease()->senders_held == 2);
    CHECK(after(ONE, 0.0) == 0.0 && lease()->senders_held == 1 && lease()->held == 0);
    CHECK(after(OTHER, 0.2) == 0.0 && lease()->held == 1);
    CHECK(after(ONE, 0.1) == 0.1);
    CHECK(after(OTHER, 0.2) == 0.1); /* a held command does not take the robot from the other */
    CHECK(after(ONE, 0.0) == 0.0 && after(OTHER, 0.2) == 0.0);
    CHECK(after(OTHER, 0.0) == 0.0 && after(OTHER, 0.2) == 0.2 && lease()->senders_held == 0);
}

static void a_zero_of_one_sender_before_a_stop_leaves_the_request_of_another_open(void)
{
    begin();
    CHECK(after(OTHER, 0.2) == 0.2 && after(ONE, 0.1) == 0.1);
    CHECK(after(ONE, 0.0) == 0.0 && lease()->open == 1);
    stop_and_go();
    b.now_ns += 340 * MS;
    CHECK(after(OTHER, 0.2) == 0.0 && after(ONE, 0.1) == 0.1);
}

static void giving_the_command_back_ends_the_request_of_its_sender_alone(void)
{
    begin();
    CHECK(after(OTHER, 0.2) == 0.2 && after(ONE, 0.1) == 0.1);
    CHECK(send_kind(ONE, 0.0, COMMAND_RELEASE) == 0);
    stop_and_go();
    CHECK(after(OTHER, 0.2) == 0.0 && after(ONE, 0.1) == 0.1);
}

static void a_sender_that_comes_while_another_is_held_is_held_until_it_sends_zero(void)
{
    begin();
    CHECK(after(ONE, 0.1) == 0.1);
    stop_and_go();
    b.now_ns += 60 * SILENT_NS;
    CHECK(after(OTHER, 0.2) == 0.0 && lease()->senders_held == 2);
    CHECK(after(OTHER, 0.0) == 0.0 && after(OTHER, 0.2) == 0.2);
}

static void the_first_sender_counts_as_any_other(void)
{
    begin();
    CHECK(after(0, 0.1) == 0.1);
    stop_and_go();
    CHECK(after(ONE, 0.2) == 0.0 && lease()->senders_held == 2);
}

static void a_lease_shows_since_when_the_first_of_its_senders_is_held(void)
{
    begin();
    CHECK(after(ONE, 0.0) == 0.0 && after(OTHER, 0.0) == 0.0);
    b.may_move = false;
    int64_t first_ns = b.now_ns;
    CHECK(after(OTHER, 0.2) == 0.0);
    b.now_ns += MS;
    CHECK(after(ONE, 0.1) == 0.0 && lease()->held_ns == first_ns);
}

static void a_hold_that_the_lease_inherits_counts_for_each_sender(void)
{
    begin();
    b.permissions.lease[0].barred_ns = b.now_ns;
    arbiter_grant(&b.arbiter, &b.permissions);
    CHECK(lease()->held == 1 && lease()->senders_held == 1);
    CHECK(after(ONE, 0.1) == 0.0 && after(OTHER, 0.2) == 0.0);
    CHECK(after(ONE, 0.0) == 0.0 && after(OTHER, 0.2) == 0.0 && after(ONE, 0.1) == 0.1);
}

static void arming_lets_each_sender_go_on_that_has_been_silent_for_five_seconds(void)
{
    begin();
    CHECK(after(ONE, 0.1) == 0.1 && after(OTHER, 0.2) == 0.2);
    b.may_move = false;
    (void)obeyed_m_s();
    b.now_ns += SILENT_NS - 1;
    CHECK(after(OTHER, 0.2) == 0.0);
    b.now_ns += 1;
    arbiter_arm(&b.arbiter, b.now_ns);
    b.may_move = true;
    CHECK(after(OTHER, 0.2) == 0.0 && after(ONE, 0.1) == 0.1);
}

static void a_person_lets_every_sender_go_on(void)
{
    begin();
    CHECK(after(ONE, 0.1) == 0.1 && after(OTHER, 0.2) == 0.2);
    stop_and_go();
    b.permissions.releases++;
    arbiter_grant(&b.arbiter, &b.permissions);
    CHECK(lease()->senders_held == 0 && after(ONE, 0.1) == 0.1 && after(OTHER, 0.2) == 0.2);
}

/* Two may be behind them: the zero may be of the one and the motion of the other. */
static void senders_without_a_name_go_on_after_a_zero_and_five_seconds_without_motion(void)
{
    begin();
    CHECK(after(SENDER_UNNAMED, 0.1) == 0.1);
    stop_and_go();
    b.now_ns += 60 * SILENT_NS;
    CHECK(after(SENDER_UNNAMED, 0.1) == 0.0); /* silence alone is no zero */
    CHECK(after(SENDER_UNNAMED, 0.0) == 0.0 && lease()->senders_held == 1);
    b.now_ns += SILENT_NS - 1;
    CHECK(after(SENDER_UNNAMED, 0.1) == 0.0);
    CHECK(after(SENDER_UNNAMED, 0.0) == 0.0);
    b.now_ns += SILENT_NS;
    CHECK(after(SENDER_UNNAMED, 0.1) == 0.1 && lease()->senders_held == 0);
}

static void a_zero_after_five_seconds_ends_the_request_of_senders_without_a_name(void)
{
    begin();
    CHECK(after(SENDER_UNNAMED, 0.1) == 0.1 && after(SENDER_UNNAMED, 0.0) == 0.0);
    CHECK(lease()->open == 1);
    b.now_ns += SILENT_NS;
    CHECK(after(SENDER_UNNAMED, 0.0) == 0.0 && lease()->open == 0);
    stop_and_go();
    CHECK(lease()->senders_held == 0 && after(SENDER_UNNAMED, 0.1) == 0.1);
}

static void a_hold_that_is_inherited_lasts_five_seconds_for_senders_without_a_name(void)
{
    begin();
    b.permissions.lease[0].barred_ns = b.now_ns;
    arbiter_grant(&b.arbiter, &b.permissions);
    CHECK(after(SENDER_UNNAMED, 0.0) == 0.0 && after(SENDER_UNNAMED, 0.1) == 0.0);
    CHECK(after(SENDER_UNNAMED, 0.0) == 0.0);
    b.now_ns += SILENT_NS;
    CHECK(after(SENDER_UNNAMED, 0.1) == 0.1);
}

static void a_pause_after_a_zero_is_not_a_lapse(void)
{
    begin();
    CHECK(after(SENDER_UNNAMED, 0.1) == 0.1 && after(SENDER_UNNAMED, 0.0) == 0.0);
    b.now_ns += 2 * LIFE_NS;
    CHECK(after(SENDER_UNNAMED, 0.1) == 0.1 && lease()->lapses == 0);
}

static void a_sender_beyond_the_last_number_is_refused(void)
{
    begin();
    CHECK(send_kind(SENDERS_MAX, 0.1, COMMAND_TWIST) == 1 + REFUSED_FORM);
    CHECK(send_kind(SENDERS_MAX - 1, 0.1, COMMAND_TWIST) == 0);
}

int main(void)
{
    a_zero_of_one_sender_does_not_let_another_go_on();
    a_zero_of_one_sender_before_a_stop_leaves_the_request_of_another_open();
    giving_the_command_back_ends_the_request_of_its_sender_alone();
    a_sender_that_comes_while_another_is_held_is_held_until_it_sends_zero();
    the_first_sender_counts_as_any_other();
    a_lease_shows_since_when_the_first_of_its_senders_is_held();
    a_hold_that_the_lease_inherits_counts_for_each_sender();
    arming_lets_each_sender_go_on_that_has_been_silent_for_five_seconds();
    a_person_lets_every_sender_go_on();
    senders_without_a_name_go_on_after_a_zero_and_five_seconds_without_motion();
    a_zero_after_five_seconds_ends_the_request_of_senders_without_a_name();
    a_hold_that_is_inherited_lasts_five_seconds_for_senders_without_a_name();
    a_pause_after_a_zero_is_not_a_lapse();
    a_sender_beyond_the_last_number_is_refused();
    return checks_report("senders");
}
