/* SPDX-License-Identifier: Apache-2.0
 * The fast sync read of Dynamixels: all answer in one packet, and plain sync reads follow while one of them fails. */
#include <math.h>
#include <string.h>

#include "check.h"
#include "line_machine.h"

enum { SERVOS = 3, GOAL = 104, PRESENT = 128, TORQUE = 64, DATA = 4, HEAD = 8, BLOCK = DATA + 4, ALL = 0xFE };
static const int64_t MS = 1000000, CHARACTER_NS = 10000, DELAY_NS = 50000;

static struct {
    line_table table;
    line_machine machine;
    line_output out;
    int64_t now_ns;
    uint32_t silent;         /* bit n: it does not answer, and ends the packet of all */
    uint32_t errors;         /* bit n: it refuses */
    uint32_t swapped;        /* 1: the second and the third one answer in the wrong order */
    bool alert, echoes, old; /* old: they do not know the instruction */
    uint32_t cut, flip;      /* of the packet of all: 0, or so many bytes come only; 1 + the byte that has a wrong bit */
    int32_t goal[SERVOS];
    bool torque[SERVOS];
    uint32_t fast, plain, asked;
    uint8_t bytes[RECEIVED_BYTES_MAX];
    uint32_t count;
} s;
static const line_machine *const m = &s.machine;

static line_frame packet(uint32_t unit, uint32_t code, const uint8_t *parameters, uint32_t count, uint32_t data)
{
    uint32_t length = count + 3;
    line_frame frame = {.request_bytes = 10 + count,
                        .reply_bytes = 11 + data,
                        .match_bytes = 5,
                        .match = {0xFF, 0xFF, 0xFD, 0, (uint8_t)unit},
                        .request_seal = SEAL_STUFFED,
                        .reply_seal = SEAL_STUFFED,
                        .has_exceptions = 1,
                        .request = {0xFF, 0xFF, 0xFD, 0, (uint8_t)unit, (uint8_t)length, 0, (uint8_t)code}};
    memcpy(frame.request + HEAD, parameters, count);
    rtu_finish(&frame);
    return frame;
}

static line_drive servo(uint32_t joint)
{
    uint32_t unit = joint + 1;
    const uint8_t goal[] = {GOAL, 0, 0, 0, 0, 0}, read[] = {PRESENT, 0, DATA, 0}, torque[] = {TORQUE, 0, 1, 0};
    const uint8_t off[] = {TORQUE, 0, 0};
    line_drive drive = {.tries = 3,
                        .extra_every = 50,
                        .period_ns = 10 * MS,
                        .turnaround_ns = MS,
                        .cyclic_count = 2,
                        .extra_count = 1,
                        .quick_stop_count = 1,
                        .disarm_count = 1,
                        .probe = 2};
    drive.cyclic[0].frame = packet(unit, 3, goal, sizeof goal, 0);
    drive.cyclic[0].setpoint_count = 1;
    drive.cyclic[0].setpoint[0] = (line_setpoint){
        .joint = joint, .byte = 10, .form = FORM_I32_LE, .raw_per_si = 100.0, .raw_min = -3000.0, .raw_max = 3000.0};
    drive.cyclic[1].frame = packet(unit, 2, read, sizeof read, DATA);
    drive.cyclic[1].field_count = 1;
    drive.cyclic[1].field[0] =
        (line_field){.joint = joint, .kind = FIELD_VELOCITY, .byte = 9, .form = FORM_I32_LE, .si_per_raw = 0.01};
    drive.extra[0].frame = packet(unit, 2, torque, sizeof torque, 1);
    drive.extra[0].field_count = 1;
    drive.extra[0].field[0] =
        (line_field){.joint = joint, .kind = FIELD_ENABLED, .byte = 9, .equals_mask = 1, .equals = 1, .si_per_raw = 1.0};
    drive.quick_stop[0] = packet(unit, 3, goal, sizeof goal, 0);
    drive.disarm[0] = packet(unit, 3, off, sizeof off, 0);
    return drive;
}

static line_table table_of(uint32_t echo)
{
    line_table table = {.drive_count = SERVOS,
                        .echo = echo,
                        .character_ns = (double)CHARACTER_NS,
                        .gap_ns = 10000,
                        .setpoint_timeout_ns = 100 * MS,
                        .rest_velocity_rad_s = 0.1,
                        .group = {.used = 1,
                                  .fast = 1,
                                  .data_byte = 10,
                                  .write_bytes = 12,
                                  .read_bytes = 12,
                                  .write = {0xFF, 0xFF, 0xFD, 0, ALL, 7, 0, 0x83, GOAL, 0, DATA, 0},
                                  .read = {0xFF, 0xFF, 0xFD, 0, ALL, 7, 0, 0x82, PRESENT, 0, DATA, 0}}};
    for (uint32_t i = 0; i < SERVOS; i++) {
        table.drive[i] = servo(i);
    }
    return table;
}

/* ------------------------------------------------------------------------------------------------ their answers */
static void status(uint32_t number, const uint8_t *data, uint32_t count)
{
    if ((s.silent >> number & 1) != 0) {
        return;
    }
    line_frame reply = {.request_bytes = 11 + count,
                        .request_seal = SEAL_STUFFED,
                        .request = {0xFF, 0xFF, 0xFD, 0, (uint8_t)(number + 1), (uint8_t)(4 + count), 0, 0x55}};
    reply.request[HEAD] = (s.errors >> number & 1) != 0 ? 7 : 0;
    if (count > 0) {
        memcpy(reply.request + 9, data, count);
    }
    rtu_finish(&reply);
    memcpy(s.bytes + s.count, reply.request, reply.request_bytes);
    s.count += reply.request_bytes;
    s.now_ns += DELAY_NS + reply.request_bytes * CHARACTER_NS;
}

static void answer_together(const uint8_t *units, uint32_t count)
{
    uint8_t *to = s.bytes + s.count;
    uint32_t length = HEAD - 7 + count * BLOCK, at = HEAD;
    const uint8_t head[HEAD] = {0xFF, 0xFF, 0xFD, 0, ALL, (uint8_t)length, (uint8_t)(length >> 8), 0x55};
    memcpy(to, head, HEAD);
    for (uint32_t i = 0; i < count; i++) {
        uint32_t number = units[s.swapped != 0 && i > 0 ? count - i : i] - 1U;
        if ((s.silent >> number & 1) != 0) {
            break;
        }
        to[at] = (uint8_t)(((s.errors >> number & 1) != 0 ? 7 : 0) | (s.alert ? 0x80 : 0));
        to[at + 1] = (uint8_t)(number + 1);
        rtu_write(to + at + 2, FORM_I32_LE, s.goal[number]);
        at += BLOCK;
        rtu_seal(to, at, SEAL_STUFFED);
    }
    uint32_t came = at == HEAD || s.old ? 0 : s.cut > 0 && s.cut < at ? s.cut : at;
    if (s.flip > 0 && s.flip <= came) {
        to[s.flip - 1] ^= 0x10;
    }
    s.count += came;
    s.now_ns += came > 0 ? DELAY_NS + came * CHARACTER_NS : 0;
}

static uint32_t obey(const uint8_t *wire)
{
    uint8_t plain[FRAME_BYTES_MAX];
    uint32_t bytes = (uint32_t)rtu_read(wire + 5, FORM_U16_LE) + 7, unit = wire[4];
    CHECK(rtu_is_sealed(wire, bytes, SEAL_STUFFED));
    uint32_t end = rtu_unstuff(wire, bytes, plain) - 2;
    if (plain[7] == 0x83) {
        for (uint32_t at = 12; at < end; at += 1 + DATA) {
            s.goal[plain[at] - 1] = (int32_t)rtu_read(plain + at + 1, FORM_I32_LE);
        }
    } else if (plain[7] == 0x82 || plain[7] == 0x8A) {
        s.asked = 0;
        for (uint32_t at = 12; at < end; at++) {
            s.asked |= 1U << (plain[at] - 1);
        }
        if (plain[7] == 0x8A) {
            s.fast++;
            answer_together(plain + 12, end - 12);
            return bytes;
        }
        s.plain++;
        for (uint32_t at = 12; at < end; at++) {
            uint8_t velocity[DATA];
            rtu_write(velocity, FORM_I32_LE, s.goal[plain[at] - 1]);
            status(plain[at] - 1U, velocity, DATA);
        }
    } else if (plain[7] == 2) {
        const uint8_t value[DATA] = {s.torque[unit - 1]};
        status(unit - 1, value, plain[10]);
    } else if (plain[7] == 3) {
        s.torque[unit - 1] = plain[8] == TORQUE ? plain[10] != 0 : s.torque[unit - 1];
        s.goal[unit - 1] = plain[8] == GOAL ? (int32_t)rtu_read(plain + 10, FORM_I32_LE) : s.goal[unit - 1];
        status(unit - 1, NULL, 0);
    }
    return bytes;
}

/* -------------------------------------------------------------------------------------------------- the machine */
static void look(double velocity_rad_s)
{
    s.machine.newest = (setpoints){.stamp_ns = s.now_ns, .enabled = 1, .joint_count = SERVOS};
    for (uint32_t i = 0; i < SERVOS; i++) {
        s.machine.newest.joint[i].velocity_rad_s = velocity_rad_s + 0.1 * i;
    }
    line_machine_step(&s.machine, s.now_ns, s.bytes, s.count, &s.out);
    s.count = 0;
    if (s.out.send == NULL) {
        s.now_ns = s.out.wake_ns > s.now_ns ? s.out.wake_ns : s.now_ns + 1;
        return;
    }
    line_machine_sent(&s.machine, s.now_ns);
    s.now_ns += s.out.send_bytes * CHARACTER_NS;
    if (s.echoes) {
        memcpy(s.bytes, s.out.send, s.out.send_bytes);
        s.count = s.out.send_bytes;
    }
    uint32_t copied = s.count;
    for (uint32_t at = 0; at < s.out.send_bytes;) {
        at += obey(s.out.send + at);
    }
    s.now_ns = s.count == copied ? m->until_ns : s.now_ns;
}

static void go_on(double velocity_rad_s, int64_t for_ns)
{
    for (int64_t end_ns = s.now_ns + for_ns; s.now_ns < end_ns;) {
        look(velocity_rad_s);
    }
}

static void request_all(uint32_t mode)
{
    for (uint32_t i = 0; i < SERVOS; i++) {
        s.machine.control.drive[i].count++;
        s.machine.control.drive[i].mode = mode;
    }
}

static void begin_armed(uint32_t echo)
{
    memset(&s, 0, sizeof s);
    s.now_ns = 1000 * MS;
    s.echoes = echo == ECHO_FIRST;
    s.table = table_of(echo);
    CHECK(line_machine_init(&s.machine, &s.table, 0, s.now_ns) == 0);
    request_all(DRIVE_READY);
    go_on(0.0, 50 * MS);
    memset(s.torque, 1, sizeof s.torque);
    request_all(DRIVE_ARMED);
    go_on(1.0, 50 * MS);
    for (uint32_t i = 0; i < SERVOS; i++) {
        CHECK(m->drive[i].state.mode == DRIVE_ARMED);
    }
}

static bool measures(uint32_t number, double velocity_rad_s)
{
    return fabs(m->joint[number].feedback.velocity_rad_s - velocity_rad_s) < 1e-9;
}

static void one_packet_answers_for_all(void)
{
    for (uint32_t echo = ECHO_NONE; echo <= ECHO_UNKNOWN; echo++) {
        begin_armed(echo);
        uint32_t fast = s.fast;
        go_on(-2.0, 100 * MS);
        CHECK(s.fast - fast >= 9 && s.plain == 0 && s.asked == 7 && m->noise_bytes == 0);
        for (uint32_t i = 0; i < SERVOS; i++) {
            CHECK(measures(i, -2.0 + 0.1 * i) && m->drive[i].count.no_reply == 0 && m->drive[i].count.bad_reply == 0);
            CHECK(s.now_ns - m->joint[i].feedback.stamp_ns < 15 * MS && m->joint[i].feedback.stamp_ns < s.now_ns);
            CHECK(m->drive[i].smoothed_ns < 2 * MS && m->joint[i].feedback.enabled == 1);
        }
    }
}

/* Its block is the end of the packet: those behind it lose one answer, and those before it none. */
static void plain_reads_follow_while_a_servo_is_missing(void)
{
    for (uint32_t missing = 0; missing < SERVOS; missing++) {
        begin_armed(ECHO_NONE);
        uint64_t before = m->drive[0].count.no_reply + m->drive[0].count.bad_reply;
        s.silent = 1U << missing;
        uint32_t fast = s.fast;
        go_on(2.0, 150 * MS);
        CHECK(s.fast - fast == 1 && s.plain > 5);
        CHECK(m->drive[missing].state.mode == DRIVE_UNRESPONSIVE && s.goal[missing] == 0);
        for (uint32_t i = 0; i < SERVOS; i++) {
            uint64_t lost = m->drive[i].count.no_reply + m->drive[i].count.bad_reply;
            CHECK(i == missing || (m->drive[i].state.mode == DRIVE_ARMED && m->drive[i].failures == 0));
            CHECK(i == missing || (measures(i, 2.0 + 0.1 * i) && lost == (i > missing ? 1U : 0U)));
        }
        CHECK(before == 0);
        go_on(2.0, 400 * MS); /* it is not asked any more */
        CHECK(s.fast - fast > 10 && m->drive[(missing + 1) % SERVOS].state.mode == DRIVE_ARMED);
    }
}

static void a_packet_that_is_cut_or_damaged_anywhere_says_nothing_wrong(void)
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
            bool before = at < whole ? HEAD + (i + 1) * BLOCK <= at : HEAD + (i + 1) * BLOCK <= at - whole;
            CHECK((lost == 0) == before);
        }
        go_on(1.0, 300 * MS);
        plain = s.plain;
        go_on(1.0, 100 * MS);
        CHECK(s.plain == plain); /* fast again */
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
    CHECK(m->drive[0].count.bad_reply == 0 && m->drive[1].count.bad_reply == 1 && m->drive[2].count.bad_reply == 1);
    go_on(1.0, 50 * MS);
    CHECK(measures(1, 1.1) && measures(2, 1.2));
}

static void a_refusal_is_that_of_its_servo_and_an_alert_is_none(void)
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

/* Of an older firmware. */
static void servos_that_do_not_know_it_are_asked_so_less_and_less_often(void)
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

static void a_table_is_refused_where_its_servos_cannot_answer_in_one_packet(void)
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
}

int main(void)
{
    one_packet_answers_for_all();
    plain_reads_follow_while_a_servo_is_missing();
    a_packet_that_is_cut_or_damaged_anywhere_says_nothing_wrong();
    a_block_of_another_servo_is_not_taken();
    a_refusal_is_that_of_its_servo_and_an_alert_is_none();
    servos_that_do_not_know_it_are_asked_so_less_and_less_often();
    a_table_is_refused_where_its_servos_cannot_answer_in_one_packet();
    return checks_report("line fast");
}
