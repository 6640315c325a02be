/* SPDX-License-Identifier: Apache-2.0
 * The fast sync read of Dynamixels: all answer in one packet. Plain sync reads follow while one
 * servo fails. */
#include "fast_wire.h"

static void one_packet_has_the_answers_of_all_servos(void)
{
    for (uint32_t echo = ECHO_NONE; echo <= ECHO_UNKNOWN; echo++) {
        begin_armed(echo);
        uint32_t fast = s.fast;
        go_on(-2.0, 100 * MS);
        CHECK(s.fast - fast >= 9 && s.plain == 0 && s.asked == 7 && m->noise_bytes == 0);
        for (uint32_t i = 0; i < SERVOS; i++) {
            CHECK(measures(i, -2.0 + 0.1 * i) && m->drive[i].count.no_reply == 0 &&
                  m->drive[i].count.bad_reply == 0);
            CHECK(s.now_ns - m->joint[i].feedback.stamp_ns < 15 * MS &&
                  m->joint[i].feedback.stamp_ns < s.now_ns);
            CHECK(m->drive[i].smoothed_ns < 2 * MS && m->joint[i].feedback.enabled == 1);
        }
    }
}

/* A missing block ends the packet: servos after it lose one answer, and servos before it lose no
 * answer. */
static void plain_reads_follow_while_a_servo_is_missing(void)
{
    for (uint32_t missing = 0; missing < SERVOS; missing++) {
        begin_armed(ECHO_NONE);
        uint64_t before = m->drive[0].count.no_reply + m->drive[0].count.bad_reply;
        s.silent = 1U << missing;
        uint32_t fast = s.fast;
        go_on(2.0, 150 * MS);
        CHECK(s.fast - fast == 1 && s.plain > 5 && m->noise_bytes == 0);
        CHECK(m->drive[missing].state.mode == DRIVE_UNRESPONSIVE && s.goal[missing] == 0);
        for (uint32_t i = 0; i < SERVOS; i++) {
            uint64_t lost = m->drive[i].count.no_reply + m->drive[i].count.bad_reply;
            CHECK(i == missing ||
                  (m->drive[i].state.mode == DRIVE_ARMED && m->drive[i].failures == 0));
            CHECK(i == missing || (measures(i, 2.0 + 0.1 * i) && lost == (i > missing ? 1U : 0U)));
        }
        CHECK(before == 0);
        go_on(2.0, 400 * MS); /* the servo is no longer read */
        CHECK(s.fast - fast > 10 && m->drive[(missing + 1) % SERVOS].state.mode == DRIVE_ARMED);
    }
}

static void a_truncated_or_damaged_packet_gives_no_wrong_values(void)
{
    const uint32_t whole = HEAD + SERVOS * BLOCK;
    for (uint32_t at = 1; at < 2 * whole; at++) {
        begin_armed(ECHO_NONE);
        go_on(1.0, 20 * MS);
        s.cut = at < whole ? at : 0;
        s.flip = at < whole ? 0 : at - whole + 1;
        for (uint32_t fast = s.fast; s.fast == fast;) {
            look(1.0);
        }
        look(1.0);
        for (uint32_t n = 0; n < 400 && m->work == WORK_GROUP; n++) {
            look(1.0);
        }
        s.cut = s.flip = 0;
        uint32_t plain = s.plain;
        go_on(1.0, 30 * MS);
        CHECK(s.plain > plain);
        for (uint32_t i = 0; i < SERVOS; i++) {
            uint64_t lost = m->drive[i].count.no_reply + m->drive[i].count.bad_reply;
            CHECK(measures(i, 1.0 + 0.1 * i) && m->drive[i].state.mode == DRIVE_ARMED && lost <= 1);
            bool before =
                at < whole ? HEAD + (i + 1) * BLOCK <= at : HEAD + (i + 1) * BLOCK <= at - whole;
            CHECK((lost == 0) == before);
        }
        go_on(1.0, 300 * MS);
        plain = s.plain;
        go_on(1.0, 100 * MS);
        CHECK(s.plain == plain); /* fast reads again */
    }
}

static void a_block_of_another_servo_is_not_taken(void)
{
    begin_armed(ECHO_NONE);
    go_on(1.0, 20 * MS);
    s.swapped = 1;
    for (uint32_t fast = s.fast; s.fast == fast;) {
        look(1.0);
    }
    s.swapped = 0;
    go_on(1.0, 15 * MS);
    CHECK(m->drive[0].count.bad_reply == 0 && m->drive[1].count.bad_reply == 1 &&
          m->drive[2].count.bad_reply == 1);
    go_on(1.0, 50 * MS);
    CHECK(measures(1, 1.1) && measures(2, 1.2));
}

static void a_refusal_counts_for_its_servo_and_an_alert_is_no_refusal(void)
{
    begin_armed(ECHO_NONE);
    s.errors = 1U << 1;
    s.alert = true;
    for (uint32_t fast = s.fast; s.fast == fast;) {
        look(1.0);
    }
    look(1.0);
    s.errors = 0;
    CHECK(m->drive[1].count.refused == 1 && m->drive[1].last_exception == 7);
    CHECK(m->drive[0].count.refused == 0 && m->drive[2].count.refused == 0);
    go_on(1.5, 100 * MS);
    CHECK(s.plain == 0 && measures(0, 1.5) && measures(1, 1.6) && measures(2, 1.7));
}

/* A late packet that answers the fast read before, which was given up. */
static void a_late_packet_of_all_answers_no_plain_read(void)
{
    const uint8_t units[SERVOS] = {1, 2, 3};
    begin_armed(ECHO_NONE);
    s.old = true;
    for (uint32_t plain = s.plain; s.plain == plain;) {
        look(1.0);
    }
    s.old = false;
    s.count = 0;
    for (uint32_t i = 0; i < SERVOS; i++) {
        s.goal[i] = 5000;
    }
    answer_together(units, SERVOS);
    for (uint32_t looks = 0; looks == 0 || m->work == WORK_GROUP; looks++) {
        CHECK(m->work == WORK_GROUP && looks < 3);
        line_machine_step(&s.machine, looks == 0 ? m->until_ns - 1 : m->until_ns, s.bytes, s.count,
                          &s.out);
        s.count = 0;
    }
    CHECK(m->noise_bytes == HEAD + SERVOS * BLOCK);
    for (uint32_t i = 0; i < SERVOS; i++) {
        CHECK(!measures(i, 50.0) && m->drive[i].count.bad_reply == 1);
    }
}

/* Older firmware has no fast reads. */
static void servos_without_fast_reads_get_them_less_and_less_often(void)
{
    begin_armed(ECHO_NONE);
    s.old = true;
    uint32_t fast = s.fast;
    go_on(1.0, 1000 * MS);
    uint32_t first = s.fast - fast;
    go_on(1.0, 4000 * MS);
    CHECK(first >= 2 && first <= 4 && s.fast - fast - first <= 3);
    for (uint32_t i = 0; i < SERVOS; i++) {
        CHECK(m->drive[i].state.mode == DRIVE_ARMED && measures(i, 1.0 + 0.1 * i));
    }
}

static void each_failed_fast_read_doubles_the_pause_up_to_its_bound_and_a_complete_one_ends_it(void)
{
    line_machine machine = {.table.group.fast = 1, .group = {.fast = true, .asked_count = 1}};
    for (uint32_t round = 0; round < 2; round++) {
        for (uint32_t pause = 16; pause <= 2 * 4096; pause *= 2) {
            line_fast_end(&machine, false);
            CHECK(machine.plain_cycles == (pause < 4096 ? pause : 4096));
        }
        line_fast_end(&machine, true);
        CHECK(machine.plain_cycles == 0 && line_fast_begins(&machine));
    }
}

static void only_complete_plain_reads_count_towards_the_next_fast_one(void)
{
    line_machine machine = {.table.group.fast = 1, .group = {.fast = true, .asked_count = 1}};
    line_fast_end(&machine, false);
    machine.group.fast = false;
    for (uint32_t left = 15; left > 4; left--) {
        line_fast_end(&machine, true);
        CHECK(machine.plain_cycles == left);
    }
    machine.group.asked_count = 0; /* no servo was read */
    line_fast_end(&machine, true);
    line_fast_end(&machine, false);
    CHECK(machine.plain_cycles == 5);
    machine.group.asked_count = 1;
    line_fast_end(&machine, false);
    CHECK(machine.plain_cycles == 16 && !line_fast_begins(&machine));
}

static void a_line_without_fast_reads_counts_no_plain_reads(void)
{
    line_machine machine = {.group.asked_count = 1};
    line_fast_end(&machine, true);
    line_fast_end(&machine, false);
    CHECK(machine.plain_cycles == 0 && machine.fast_pause == 0 && !line_fast_begins(&machine));
}

static void one_servo_alone_answers_with_one_block(void)
{
    line_machine machine = {.table = table_of(ECHO_NONE), .group.asked_count = 1};
    machine.table.drive_count = 1;
    memset(&machine.table.drive[1], 0, sizeof machine.table.drive[1]);
    line_frame packet = {.request_bytes = 0};
    CHECK(line_fast_request(&machine, &packet) == HEAD + BLOCK && packet.request[7] == 0x8A);
}

static void a_table_whose_servos_cannot_answer_in_one_packet_is_refused(void)
{
    char name[FIELD_NAME_BYTES];
    line_table table = table_of(ECHO_NONE);
    CHECK(line_table_check(&table, name) == NULL);
    table.group.fast = 2;
    CHECK(line_table_check(&table, name) != NULL);
    table = table_of(ECHO_NONE);
    table.drive[2].cyclic[1].frame.reply_bytes++;
    CHECK(line_table_check(&table, name) != NULL);
    table.group.fast = 0;
    CHECK(line_table_check(&table, name) == NULL);
    table = table_of(ECHO_NONE);
    for (uint32_t i = 0; i < SERVOS; i++) { /* replies without data */
        table.drive[i].cyclic[1].frame.reply_bytes = 11;
    }
    CHECK(line_fast_is_good(&table));
    line_table one = table;
    one.drive_count = 1;
    one.drive[0].cyclic[1].frame.reply_bytes = 10; /* shorter than a status */
    CHECK(!line_fast_is_good(&one));
    table.drive[0].cyclic[1].frame.reply_seal = SEAL_SUM;
    CHECK(!line_fast_is_good(&table));
    table.group.fast = 0;
    CHECK(line_fast_is_good(&table));
}

int main(void)
{
    one_packet_has_the_answers_of_all_servos();
    plain_reads_follow_while_a_servo_is_missing();
    a_truncated_or_damaged_packet_gives_no_wrong_values();
    a_block_of_another_servo_is_not_taken();
    a_refusal_counts_for_its_servo_and_an_alert_is_no_refusal();
    a_late_packet_of_all_answers_no_plain_read();
    each_failed_fast_read_doubles_the_pause_up_to_its_bound_and_a_complete_one_ends_it();
    only_complete_plain_reads_count_towards_the_next_fast_one();
    a_line_without_fast_reads_counts_no_plain_reads();
    one_servo_alone_answers_with_one_block();
    servos_without_fast_reads_get_them_less_and_less_often();
    a_table_whose_servos_cannot_answer_in_one_packet_is_refused();
    return checks_report("line fast");
}
