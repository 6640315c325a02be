/* SPDX-License-Identifier: Apache-2.0
 * The cycle of bus servos: one request to all of them, and each of them answers. */
#include <math.h>

#include "servo_wire.h"

static const int64_t SERVO_MS = 1000000;
static const line_machine *const m = &s.machine;

static void one_request_carries_all_set_points_and_reads_all(void)
{
    for (uint32_t echo = ECHO_NONE; echo <= ECHO_UNKNOWN; echo++) {
        servos_begin(3, echo);
        servos_arm();
        uint32_t writes = s.sync_writes, reads = s.sync_reads;
        servos_go_on(1.0, 100 * SERVO_MS);
        CHECK(s.goal[0] == 100 && s.goal[1] == 110 && s.goal[2] == 120);
        CHECK(s.sync_writes - writes >= 9 && s.sync_writes - writes <= 12 &&
              s.sync_reads - reads == s.sync_writes - writes);
        CHECK(s.asked_last == 7);
        for (uint32_t i = 0; i < 3; i++) {
            CHECK(fabs(m->joint[i].feedback.velocity_rad_s - (1.0 + 0.1 * i)) < 1e-9 &&
                  m->joint[i].feedback.enabled == 1);
            CHECK(s.now_ns - m->joint[i].feedback.stamp_ns < 15 * SERVO_MS &&
                  m->joint[i].feedback.stamp_ns < s.now_ns);
            CHECK(m->drive[i].count.no_reply == 0 && m->drive[i].count.bad_reply == 0);
        }
        CHECK(m->noise_bytes == 0 && m->echo == (s.echoes ? ECHO_FIRST : ECHO_NONE));
    }
}

static void stamps_of_replies_are_in_their_order(void)
{
    servos_begin(3, ECHO_NONE);
    servos_arm();
    servos_go_on(1.0, 50 * SERVO_MS);
    int64_t last_ns = m->joint[2].feedback.stamp_ns;
    while (m->joint[2].feedback.stamp_ns == last_ns) {
        servos_step(1.0, 1);
    }
    CHECK(m->joint[1].feedback.stamp_ns > m->joint[0].feedback.stamp_ns);
    /* all replies arrived at once */
    CHECK(m->joint[2].feedback.stamp_ns >= m->joint[1].feedback.stamp_ns);
}

static void a_servo_that_is_not_armed_gets_no_set_point(void)
{
    servos_begin(2, ECHO_NONE);
    servo_request(0, DRIVE_READY);
    servo_request(1, DRIVE_READY);
    servos_go_on(1.0, 100 * SERVO_MS);
    CHECK(s.sync_writes == 0 && s.sync_reads > 8 && s.goal[0] == 0);
    s.torque[0] = true;
    servo_request(0, DRIVE_ARMED);
    servos_go_on(1.0, 50 * SERVO_MS);
    CHECK(s.goal[0] == 100 && s.goal[1] == 0 && s.sync_writes > 0);
}

/* Zero comes before the power-off, because that may be lost. */
static void a_servo_that_is_stood_down_gets_zero_at_once(void)
{
    servos_begin(2, ECHO_NONE);
    servos_arm();
    servos_go_on(1.0, 50 * SERVO_MS);
    servo_request(0, DRIVE_STAND_DOWN);
    servos_step(1.0, 1);
    servos_go_on(1.0, 3 * SERVO_MS);
    CHECK(s.goal[0] == 0 && s.goal[1] == 110 && s.torque[0]);
    CHECK(m->drive[0].state.mode == DRIVE_READY && !m->drive[0].state.sent_motion);
}

static void a_silent_servo_does_not_cost_the_answers_of_others(void)
{
    servos_begin(3, ECHO_NONE);
    servos_arm();
    servos_go_on(1.0, 50 * SERVO_MS);
    s.silent = 1U << 1;
    int64_t oldest_ns = 0;
    uint64_t before = m->drive[2].count.cycles;
    for (uint32_t i = 0; i < 2000; i++) {
        servos_step(2.0, 1);
        for (uint32_t n = 0; n < 3; n += 2) {
            CHECK(m->drive[n].state.mode == DRIVE_ARMED && m->drive[n].failures == 0);
            int64_t age_ns = s.now_ns - m->joint[n].feedback.stamp_ns;
            oldest_ns = age_ns > oldest_ns ? age_ns : oldest_ns;
        }
    }
    CHECK(oldest_ns < 50 * SERVO_MS); /* the wait for the silent servo, and one period */
    CHECK(m->drive[2].count.cycles - before > 100);
    CHECK(m->drive[1].state.mode == DRIVE_UNRESPONSIVE && m->drive[1].count.no_reply >= 3);
    CHECK(s.goal[0] == 200 && s.goal[2] == 220);
    CHECK(s.goal[1] == 0); /* it does not answer, but may receive: it gets zero */
    s.silent = 0;
    servos_go_on(2.0, 3000 * SERVO_MS);
    CHECK(m->drive[1].state.mode == DRIVE_BACK && s.goal[1] == 0); /* its set-up releases it */
}

static void a_damaged_reply_is_counted_and_its_servo_keeps_its_set_points(void)
{
    servos_begin(2, ECHO_NONE);
    servos_arm();
    servos_go_on(1.0, 50 * SERVO_MS);
    s.damaged = 1;
    while (m->drive[0].count.bad_reply == 0) {
        servos_step(1.0, 1);
    }
    s.damaged = 0;
    CHECK(m->drive[0].state.mode == DRIVE_ARMED && m->noise_bytes == 8 &&
          m->drive[1].failures == 0);
    CHECK(fabs(m->joint[0].feedback.velocity_rad_s - 1.0) < 1e-9);
    servos_go_on(3.0, 12 * SERVO_MS);
    CHECK(s.goal[0] == 300 && s.goal[1] == 310);
    servos_go_on(3.0, 400 * SERVO_MS);
    CHECK(m->drive[0].state.mode == DRIVE_ARMED && m->drive[0].failures == 0 &&
          m->drive[0].count.bad_reply == 1);
    CHECK(fabs(m->joint[0].feedback.velocity_rad_s - 3.0) < 1e-9);
}

/* A late reply to the last request is a correct reply of this servo. Only its time distinguishes it
 * from the one that is due. */
static void a_late_reply_is_not_taken_for_the_next_request_s(void)
{
    servos_begin(2, ECHO_NONE);
    servos_arm();
    servos_go_on(1.0, 50 * SERVO_MS);
    s.silent = 1;
    while (m->drive[0].failures == 0) {
        servos_step(1.0, 1);
    }
    s.silent = 0;
    int64_t stamp_ns = m->joint[0].feedback.stamp_ns, failed_ns = s.now_ns;
    do {
        servos_step(2.0, 1);
    } while ((s.asked_last & 1) == 0 || s.out.send == NULL);
    servos_step(2.0, 1); /* the reply may be the late one or its own */
    CHECK(m->joint[0].feedback.stamp_ns == stamp_ns && m->drive[0].held_until_ns > s.now_ns);
    while (s.now_ns < failed_ns + 100 * SERVO_MS) {
        servos_step(2.0, 1);
        CHECK(s.goal[0] == 200 || s.goal[0] == 100);
    }
    /* the servo is held: it is not read, and still gets set-points */
    CHECK(s.goal[0] == 200 && (s.asked_last & 1) == 0);
    servos_go_on(2.0, 400 * SERVO_MS);
    CHECK((s.asked_last & 1) != 0 && m->joint[0].feedback.stamp_ns > failed_ns + 100 * SERVO_MS);
    CHECK(m->drive[0].state.mode == DRIVE_ARMED);
}

static void a_foreign_servo_s_reply_is_noise(void)
{
    servos_begin(1, ECHO_NONE);
    servos_arm();
    servos_go_on(1.0, 30 * SERVO_MS);
    s.silent = 1;
    do {
        servos_step(1.0, 1);
    } while (m->work != WORK_GROUP || m->group.waiting != 1);
    int64_t stamp_ns = m->joint[0].feedback.stamp_ns;
    uint8_t foreign[] = {0xFF, 0xFF, 8, 4, 0, 1, 0, 0};
    rtu_seal(foreign, sizeof foreign, SEAL_SUM);
    line_machine_step(&s.machine, m->until_ns - SERVO_MS, foreign, sizeof foreign, &s.out);
    CHECK(m->joint[0].feedback.stamp_ns == stamp_ns && m->work == WORK_GROUP);
    line_machine_step(&s.machine, m->until_ns, foreign, 0, &s.out);
    CHECK(m->noise_bytes == sizeof foreign && m->drive[0].count.bad_reply == 1);
}

static void old_set_points_stop_all_and_zero_is_sent_until_they_rest(void)
{
    servos_begin(2, ECHO_NONE);
    servos_arm();
    servos_go_on(1.0, 50 * SERVO_MS);
    s.machine.newest.stamp_ns = s.now_ns - 200 * SERVO_MS;
    int64_t stale_ns = s.now_ns;
    while (s.torque[0] || s.torque[1]) {
        setpoints stale = s.machine.newest;
        servos_step(1.0, 1);
        s.machine.newest = stale;
        CHECK(s.now_ns - stale_ns < 2000 * SERVO_MS);
        line_machine_step(&s.machine, s.now_ns, s.bytes, s.count, &s.out);
        s.count = 0;
        if (s.out.send != NULL) {
            line_machine_sent(&s.machine, s.now_ns);
            for (uint32_t at = 0; at < s.out.send_bytes;) {
                at += obey_packet(s.out.send + at);
            }
        }
    }
    CHECK(s.goal[0] == 0 && s.goal[1] == 0 && m->drive[0].state.mode != DRIVE_ARMED);
}

static void at_the_end_all_come_to_rest_and_lose_their_torque(void)
{
    servos_begin(3, ECHO_NONE);
    servos_arm();
    servos_go_on(1.0, 50 * SERVO_MS);
    s.silent = 1U << 2;
    s.machine.control.shut_down = 1;
    servos_go_on(1.0, 3000 * SERVO_MS);
    line_report report;
    line_machine_report(m, &report);
    CHECK(report.shut_down == 1);
    for (uint32_t i = 0; i < 3; i++) {
        CHECK(s.goal[i] == 0 && !s.torque[i]);
    }
}

/* In a group one exchange reads all servos, so the last one waits for the ones before it. */
static void a_servo_whose_reply_is_awaited_is_not_left_alone(void)
{
    static const uint32_t WORK[] = {WORK_NONE, WORK_GROUP};
    for (uint32_t i = 0; i < 3 * 8 * 2; i++) {
        uint32_t number = i % 3, waiting = i / 3 % 8, work = WORK[i / 24];
        servos_begin(3, ECHO_NONE);
        servos_arm();
        servos_go_on(1.0, 50 * SERVO_MS);
        line_machine *machine = &s.machine;
        machine->work = work;
        machine->worker = LINE_DRIVES_MAX;
        machine->group.waiting = waiting;
        machine->table.drive[number].watchdog_ns = 100 * SERVO_MS;
        machine->drive[number].answered_ns = s.now_ns - 100 * SERVO_MS - 1;
        machine->newest.stamp_ns = s.now_ns;
        line_guard(machine, number, s.now_ns);
        bool awaited = work == WORK_GROUP && (waiting >> number & 1) != 0;
        CHECK((m->drive[number].state.mode == DRIVE_ARMED) == awaited);
        CHECK(m->drive[number].state.fault_reasons == (awaited ? 0 : DRIVE_FAULT_LEFT_ALONE));
    }
}

static void a_group_waits_for_its_slowest_awaited_servo(void)
{
    static const int64_t DEADLINES_NS[] = {300, 100, 200};
    servos_begin(3, ECHO_NONE);
    for (uint32_t i = 0; i < 4; i++) {
        s.machine.drive[i].deadline_ns = i < 3 ? DEADLINES_NS[i] * SERVO_MS : 900 * SERVO_MS;
    }
    for (uint32_t waiting = 0; waiting < 16; waiting++) {
        int64_t longest_ns = 0;
        for (uint32_t i = 0; i < 3; i++) { /* the table has no fourth servo */
            int64_t wait_ns = line_deadline_ns(m, i);
            CHECK(wait_ns > 0);
            longest_ns = (waiting >> i & 1) != 0 && wait_ns > longest_ns ? wait_ns : longest_ns;
        }
        s.machine.group.waiting = waiting;
        CHECK(line_group_wait_ns(m) == longest_ns);
    }
}

static void begin_ready(uint32_t drives)
{
    servos_begin(drives, ECHO_NONE);
    for (uint32_t i = 0; i < drives; i++) {
        s.machine.drive[i].state.mode = DRIVE_READY;
        s.machine.drive[i].state.enabled = 0;
    }
    s.machine.newest = (setpoints){.stamp_ns = s.now_ns, .enabled = 1, .joint_count = 8};
    for (uint32_t i = 0; i < 8; i++) {
        s.machine.newest.joint[i].velocity_rad_s = 1.0;
    }
}

static void servos_take_turns_in_reporting_whether_they_have_power(void)
{
    line_frame out;
    for (uint32_t round = 0; round < 3 * 8; round++) {
        begin_ready(4);
        line_machine *machine = &s.machine;
        machine->table.drive_count = 3; /* the fourth servo is no member */
        machine->drive[3].state.mode = DRIVE_ARMED;
        for (uint32_t i = 0; i < 3; i++) {
            machine->drive[i].cycle_count = round % 8, machine->drive[i].state.enabled = round / 8;
        }
        CHECK(line_group_begin(machine, s.now_ns, &out));
        for (uint32_t i = 0; i < 3; i++) {
            CHECK(m->drive[i].extra_due == (round / 8 == 2 || (round % 8 + i) % 4 == 0));
            CHECK(m->drive[i].stage == STAGE_IDLE && m->drive[i].cycle_start_ns == s.now_ns);
        }
        CHECK(m->current == LINE_DRIVES_MAX && m->drive[3].cycle_start_ns == 0 &&
              m->group.waiting == 7);
        CHECK(!m->drive[3].state.sent_motion);
    }
    begin_ready(2);
    s.machine.drive[0].state.mode = s.machine.drive[1].state.mode = DRIVE_OFF;
    s.machine.drive[0].cycle_motion = true;
    CHECK(!line_group_begin(&s.machine, s.now_ns, &out) && out.request_bytes == 0 &&
          !m->drive[0].cycle_motion);
}

static void only_a_servo_that_is_due_is_read(void)
{
    line_frame out;
    for (int late = 0; late < 4; late++) {
        begin_ready(2);
        s.machine.drive[0].silent_until_ns = s.now_ns + (late == 1);
        s.machine.drive[0].held_until_ns = s.now_ns + (late == 2);
        s.machine.drive[0].state.mode = late == 3 ? DRIVE_UNRESPONSIVE : DRIVE_READY;
        CHECK(line_group_begin(&s.machine, s.now_ns, &out) &&
              m->group.waiting == (late == 0 ? 3 : 2));
        CHECK(out.reply_bytes == (late == 0 ? 16 : 8));
    }
}

static void a_servo_that_got_motion_counts_as_moving_until_it_gets_zero(void)
{
    line_frame out;
    begin_ready(2);
    line_machine *machine = &s.machine;
    machine->drive[0].state.mode = machine->drive[1].state.mode = DRIVE_ARMED;
    machine->newest.joint[1].velocity_rad_s = 0.0;
    machine->drive[0].cycle_motion = machine->drive[1].cycle_motion =
        machine->drive[1].state.sent_motion = true;
    CHECK(line_group_begin(machine, s.now_ns, &out));
    CHECK(m->drive[0].cycle_motion && m->drive[0].state.sent_motion);
    CHECK(!m->drive[1].cycle_motion && m->drive[1].state.sent_motion); /* the zero may be lost */
    CHECK(out.request[4] == 0x83 && out.request[7] == 7 && out.request[10] == 8);
}

static void a_servo_without_known_position_gets_no_target_and_a_silent_one_gets_zero(void)
{
    line_frame out;
    begin_ready(2);
    line_machine *machine = &s.machine;
    machine->drive[0].state.mode = DRIVE_ARMED;
    machine->table.drive[0].cyclic[0].setpoint[0].kind = SETPOINT_POSITION;
    CHECK(line_group_begin(machine, s.now_ns, &out) && out.request[4] == 0x82);
    for (int may_turn = 0; may_turn < 2; may_turn++) {
        begin_ready(2);
        machine->drive[0].state.mode = DRIVE_UNRESPONSIVE,
        machine->drive[0].may_turn = may_turn == 1;
        CHECK(line_group_begin(machine, s.now_ns, &out) &&
              out.request[4] == (may_turn ? 0x83 : 0x82));
        CHECK(!may_turn || (out.request[7] == 7 && out.request[8] == 0 && out.request[9] == 0));
    }
}

static void the_first_replies_of_a_group_show_whether_the_adapter_receives_itself(void)
{
    for (uint32_t echoes = 0; echoes < 2; echoes++) {
        servos_begin(2, echoes ? ECHO_FIRST : ECHO_NONE);
        servos_arm();
        servos_go_on(1.0, 50 * SERVO_MS);
        do {
            servos_step(1.0, 1);
        } while (m->work != WORK_GROUP);
        s.machine.echo = ECHO_UNKNOWN;
        uint64_t answers = m->answers;
        servos_step(1.0, 1);
        CHECK(m->echo == (echoes ? ECHO_FIRST : ECHO_NONE) && m->answers == answers + 2 &&
              s.out.notify);
    }
}

/* In Dynamixel protocol 2.0 the head is longer, and unit and length are behind it. */
static void a_group_of_stuffed_packets_has_its_units_and_its_length(void)
{
    static const uint8_t WRITE[] = {0xFF, 0xFF, 0xFD, 0, 0xFE, 7, 0, 0x83, GOAL, 0, 2, 0};
    line_frame out;
    begin_ready(2);
    line_machine *machine = &s.machine;
    line_group *group = &machine->table.group;
    memcpy(group->write, WRITE, sizeof WRITE);
    memcpy(group->read, WRITE, sizeof WRITE);
    group->read[7] = 0x82;
    group->write_bytes = group->read_bytes = sizeof WRITE, group->data_byte = 10;
    for (uint32_t i = 0; i < 2; i++) {
        const line_frame frame = {
            .request_seal = SEAL_STUFFED,
            .request_bytes = 14,
            .request = {0xFF, 0xFF, 0xFD, 0, (uint8_t)(21 + i), 7, 0, 3, GOAL, 0}};
        machine->table.drive[i].cyclic[0].frame = machine->table.drive[i].cyclic[1].frame = frame;
        machine->table.drive[i].cyclic[0].setpoint[0].byte = 10;
        machine->drive[i].state.mode = DRIVE_ARMED;
    }
    CHECK(line_group_begin(machine, s.now_ns, &out) && out.request_bytes == 20 + 16);
    CHECK(rtu_read(out.request + 5, FORM_U16_LE) == 7 + 6 &&
          rtu_read(out.request + 20 + 5, FORM_U16_LE) == 7 + 2);
    CHECK(out.request[12] == 21 && out.request[13] == 100 && out.request[14] == 0 &&
          out.request[15] == 22);
    CHECK(out.request[20 + 12] == 21 && out.request[20 + 13] == 22);
    CHECK(out.request[4] == 0xFE && out.request[7] == 0x83 && out.request[20 + 4] == 0xFE &&
          out.request[20 + 7] == 0x82);
    for (uint32_t i = 0; i < 2; i++) {
        machine->table.drive[i].cyclic[1].frame.reply_seal = SEAL_STUFFED;
        machine->table.drive[i].cyclic[1].frame.reply_bytes = 15;
    }
    CHECK(line_group_is_good(&machine->table));
    group->write_bytes = group->read_bytes = 7; /* the length is at the end of the head */
    CHECK(line_group_is_good(&machine->table));
    group->write_bytes = 6;
    CHECK(!line_group_is_good(&machine->table));
}

static void replies_that_come_byte_by_byte_are_the_same_replies(void)
{
    for (uint32_t echo = ECHO_NONE; echo <= ECHO_FIRST; echo++) {
        group_goes_out(3, echo);
        uint8_t bytes[sizeof s.bytes];
        uint32_t count = s.count;
        uint64_t answers = m->answers;
        int64_t ended_ns = m->end_ns, last_ns = 0;
        memcpy(bytes, s.bytes, count);
        s.count = 0;
        for (uint32_t i = 0; i < count; i++) {
            CHECK(m->work == WORK_GROUP && m->end_ns == ended_ns);
            line_machine_step(&s.machine, ended_ns + (int64_t)(i + 1) * SERVO_CHARACTER_NS,
                              bytes + i, 1, &s.out);
        }
        CHECK(m->answers == answers + 3 && m->group.waiting == 0 && m->noise_bytes == 0);
        for (uint32_t i = 0; i < 3; i++) {
            CHECK(m->drive[i].failures == 0 && m->joint[i].feedback.stamp_ns > last_ns);
            last_ns = m->joint[i].feedback.stamp_ns;
        }
    }
}

/* An adapter that receives itself returns its own request first. Other bytes mean that two devices
 * have sent at once. */
static void a_collision_ends_the_exchange_and_silence_does_not(void)
{
    static const uint8_t OTHER[] = {0x55};
    group_goes_out(2, ECHO_FIRST);
    s.count = 0;
    line_machine_step(&s.machine, m->end_ns + 1, OTHER, 0, &s.out);
    CHECK(m->work == WORK_GROUP && m->group.waiting == 3);
    line_machine_step(&s.machine, m->end_ns + 2, OTHER, 1, &s.out);
    CHECK(m->group.waiting == 0 && m->drive[0].failures == 1 && m->drive[1].failures == 1);
}

static void servos_that_answered_continue_in_turn(void)
{
    group_goes_out(3, ECHO_NONE);
    s.machine.group.answered = 7;
    s.machine.drive[1].state.mode = DRIVE_OFF; /* switched off after its answer */
    CHECK(line_group_goes_on(&s.machine) && m->current == 0 && m->drive[0].stage == STAGE_EXTRA);
    CHECK(line_group_goes_on(&s.machine) && m->current == 2 && m->drive[2].stage == STAGE_EXTRA);
    CHECK(!line_group_goes_on(&s.machine) && m->group.answered == 0);
}

int main(void)
{
    servos_that_answered_continue_in_turn();
    replies_that_come_byte_by_byte_are_the_same_replies();
    a_collision_ends_the_exchange_and_silence_does_not();
    a_group_of_stuffed_packets_has_its_units_and_its_length();
    a_group_waits_for_its_slowest_awaited_servo();
    servos_take_turns_in_reporting_whether_they_have_power();
    only_a_servo_that_is_due_is_read();
    a_servo_that_got_motion_counts_as_moving_until_it_gets_zero();
    a_servo_without_known_position_gets_no_target_and_a_silent_one_gets_zero();
    the_first_replies_of_a_group_show_whether_the_adapter_receives_itself();
    stamps_of_replies_are_in_their_order();
    one_request_carries_all_set_points_and_reads_all();
    a_servo_that_is_not_armed_gets_no_set_point();
    a_servo_that_is_stood_down_gets_zero_at_once();
    a_silent_servo_does_not_cost_the_answers_of_others();
    a_damaged_reply_is_counted_and_its_servo_keeps_its_set_points();
    a_late_reply_is_not_taken_for_the_next_request_s();
    a_foreign_servo_s_reply_is_noise();
    old_set_points_stop_all_and_zero_is_sent_until_they_rest();
    at_the_end_all_come_to_rest_and_lose_their_torque();
    a_servo_whose_reply_is_awaited_is_not_left_alone();
    return checks_report("line group");
}
