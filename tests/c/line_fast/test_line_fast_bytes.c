/* SPDX-License-Identifier: Apache-2.0
 * The bytes of a fast sync read: in pieces, next to noise, and which check sums count. */
#include "fast_wire.h"

static void a_packet_with_a_two_byte_length_has_the_answers_of_all_servos(void)
{
    enum { MANY = 100, WHOLE = HEAD + SERVOS * (MANY + 4) };
    begin_armed(ECHO_NONE);
    for (uint32_t i = 0; i < SERVOS; i++) {
        s.machine.table.drive[i].cyclic[1].frame.reply_bytes = 11 + MANY;
    }
    for (uint32_t fast = s.fast; s.fast == fast;) {
        look(1.0);
    }
    CHECK(m->work == WORK_GROUP && m->transaction.frame.reply_bytes == WHOLE);
    uint8_t bytes[WHOLE] = {0xFF, 0xFF, 0xFD, 0, ALL, 0x39, 0x01, 0x55};
    for (uint32_t i = 0; i < SERVOS; i++) {
        s.machine.drive[i].smoothed_ns = 0;
        uint8_t *block = bytes + HEAD + i * (MANY + 4);
        block[1] = (uint8_t)(i + 1);
        rtu_write(block + 2, FORM_I32_LE, 700 + i);
        rtu_seal(bytes, HEAD + (i + 1) * (MANY + 4), SEAL_STUFFED);
    }
    line_machine_step(&s.machine, m->end_ns + DELAY_NS + WHOLE * CHARACTER_NS, bytes, WHOLE,
                      &s.out);
    CHECK(m->group.waiting == 0 && m->noise_bytes == 0);
    for (uint32_t i = 0; i < SERVOS; i++) {
        CHECK(measures(i, 7.0 + 0.01 * i) && m->drive[i].failures == 0);
        /* the whole packet arrived at once */
        int64_t behind_ns = (SERVOS - 1 - i) * (MANY + 4) * CHARACTER_NS;
        CHECK(m->drive[i].smoothed_ns == DELAY_NS + behind_ns + 1);
    }
}

static void a_packet_of_all_is_read_as_the_status_of_each_and_other_bytes_are_noise(void)
{
    enum { BEFORE = 3, BEHIND = 2, WHOLE = HEAD + SERVOS * BLOCK };
    begin_armed(ECHO_NONE);
    s.alert = true;
    for (uint32_t fast = s.fast; s.fast == fast;) {
        look(1.0);
    }
    uint8_t bytes[BEFORE + WHOLE + BEHIND];
    memset(bytes, 0x55, sizeof bytes);
    memcpy(bytes + BEFORE, s.bytes, WHOLE);
    CHECK(s.count == WHOLE);
    memset(s.machine.transaction.plain, 0, sizeof s.machine.transaction.plain);
    uint64_t answers = m->answers;
    line_machine_step(&s.machine, s.now_ns, bytes, sizeof bytes, &s.out);
    CHECK(m->answers == answers + SERVOS && m->noise_bytes == BEFORE + BEHIND);
    const uint8_t last[] = {0xFF, 0xFF, 0xFD, 0, SERVOS}, *plain = m->transaction.plain;
    CHECK(memcmp(plain, last, sizeof last) == 0 && plain[7] == 0x55 && plain[HEAD] == 0x80);
}

static void look_until_all_answer_in_one_packet(void)
{
    for (uint32_t fast = s.fast; s.fast == fast;) {
        look(1.0);
    }
    CHECK(s.count == HEAD + SERVOS * BLOCK);
}

/* The packet arrives after `noise` bytes of noise. */
static void receive_after_noise(uint32_t noise, const uint8_t *packet_of_all, uint32_t count)
{
    uint8_t bytes[FRAME_BYTES_MAX];
    memset(bytes, 0x55, noise);
    memcpy(bytes + noise, packet_of_all, count);
    s.count = 0;
    line_machine_step(&s.machine, s.now_ns, bytes, noise + count, &s.out);
}

static void the_last_check_sum_covers_all_blocks(void)
{
    for (uint32_t noise = 0; noise < 3; noise++) {
        begin_armed(ECHO_NONE);
        look_until_all_answer_in_one_packet();
        for (uint32_t i = 0; i < SERVOS; i++) {
            rtu_write(s.bytes + HEAD + i * BLOCK + 2, FORM_I32_LE, 700 + i);
        }
        rtu_seal(s.bytes, HEAD + SERVOS * BLOCK, SEAL_STUFFED);
        CHECK(!rtu_is_sealed(s.bytes, HEAD + BLOCK, SEAL_STUFFED));
        receive_after_noise(noise, s.bytes, HEAD + SERVOS * BLOCK);
        CHECK(m->group.waiting == 0 && m->noise_bytes == noise);
        for (uint32_t i = 0; i < SERVOS; i++) {
            CHECK(measures(i, 7.0 + 0.01 * i) && m->drive[i].count.bad_reply == 0);
        }
    }
}

static void each_block_is_an_answer_even_when_the_packet_comes_byte_by_byte(void)
{
    begin_armed(ECHO_NONE);
    look_until_all_answer_in_one_packet();
    uint64_t answers = m->answers;
    for (uint32_t n = 0; n < HEAD + SERVOS * BLOCK; n++) {
        line_machine_step(&s.machine, s.now_ns, s.bytes + n, 1, &s.out);
    }
    s.count = 0;
    CHECK(m->group.waiting == 0 && m->answers == answers + SERVOS &&
          m->group.taken_count == SERVOS);
}

static void a_block_after_the_last_one_is_no_answer(void)
{
    begin_armed(ECHO_NONE);
    look_until_all_answer_in_one_packet();
    uint8_t bytes[HEAD + (SERVOS + 1) * BLOCK] = {0};
    memcpy(bytes, s.bytes, s.count);
    bytes[HEAD + 1] = 9; /* of another servo */
    bytes[HEAD + SERVOS * BLOCK + 1] = 1;
    for (uint32_t i = 0; i <= SERVOS; i++) {
        rtu_seal(bytes, HEAD + (i + 1) * BLOCK, SEAL_STUFFED);
    }
    receive_after_noise(0, bytes, sizeof bytes);
    CHECK(m->group.waiting == 1);
}

static void the_rest_of_an_older_packet_is_no_answer(void)
{
    enum { NOISE = 2 * BLOCK };
    begin_armed(ECHO_NONE);
    look_until_all_answer_in_one_packet();
    receive_after_noise(NOISE, s.bytes, HEAD + SERVOS * BLOCK);
    CHECK(m->group.waiting == 0);
    look_until_all_answer_in_one_packet();
    receive_after_noise(NOISE, s.bytes, HEAD + 2 * BLOCK);
    CHECK(m->group.waiting == 1U << 2);
}

int main(void)
{
    a_packet_with_a_two_byte_length_has_the_answers_of_all_servos();
    a_packet_of_all_is_read_as_the_status_of_each_and_other_bytes_are_noise();
    the_last_check_sum_covers_all_blocks();
    each_block_is_an_answer_even_when_the_packet_comes_byte_by_byte();
    a_block_after_the_last_one_is_no_answer();
    the_rest_of_an_older_packet_is_no_answer();
    return checks_report("line fast bytes");
}
