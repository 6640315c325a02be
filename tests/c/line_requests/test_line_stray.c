/* SPDX-License-Identifier: Apache-2.0
 * test_line_stray: bytes that belong to no answer: a late reply, noise, or the echo of the line's
 * own request. */
#include "line_wire.h"

static line_machine *const m = &w.machine;
static line_drive_state *const drive = &w.machine.drive[0];

/* A read of so many bytes, whose reply differs from all others by its length. */
static line_frame read_of(uint8_t unit, uint8_t data_bytes)
{
    line_frame frame = frame_of(unit, READ, STATUS, data_bytes);
    frame.match[2] = data_bytes;
    frame.reply_bytes = 5U + data_bytes;
    return frame;
}

static uint32_t reply_of(uint8_t unit, uint8_t data_bytes, uint8_t *reply)
{
    uint32_t bytes = 5U + data_bytes;
    memset(reply, 0x11, bytes);
    memcpy(reply, (const uint8_t[]){unit, READ, data_bytes}, 3);
    rtu_seal(reply, bytes, SEAL_CRC16);
    return bytes;
}

static void owe(const line_frame *frame)
{
    m->transaction.frame = *frame;
    m->start_ns = m->end_ns = w.now_ns;
    line_owe(m, 0);
}

static void begin_owing(uint32_t replies)
{
    begin_with(2, 0);
    for (uint32_t i = 0; i < replies; i++) {
        line_frame frame = read_of(1, (uint8_t)(2 + i));
        owe(&frame);
    }
}

static bool owes(uint32_t count, uint8_t first)
{
    bool right = drive->owed_count == count;
    for (uint32_t i = 0; right && i < count; i++) {
        right = drive->owed[i].look.head[2] == first + i &&
                drive->owed[i].look.reply_bytes == 5U + first + i;
    }
    return right;
}

static void stray(uint8_t unit, uint8_t data_bytes)
{
    uint8_t reply[16];
    uint32_t bytes = reply_of(unit, data_bytes, reply);
    line_stray(m, reply, bytes, w.now_ns);
}

static void a_late_reply_ends_the_wait_for_it_and_for_all_before_it(void)
{
    for (uint8_t late = 0; late < OWED_MAX; late++) {
        begin_owing(OWED_MAX);
        m->noise_bytes = 3;
        stray(1, (uint8_t)(2 + late));
        CHECK(owes(OWED_MAX - 1U - late, (uint8_t)(3 + late)));
        CHECK(drive->count.late == 1 && m->noise_bytes == 3 && m->stray_bytes == 0);
    }
}

static void a_late_reply_among_equal_ones_ends_a_single_wait(void)
{
    begin_owing(2);
    line_frame second = read_of(1, 3);
    owe(&second);
    CHECK(owes(2, 2) && drive->owed[1].count == 2);
    stray(1, 3);
    CHECK(owes(1, 3) && drive->owed[0].count == 1); /* drives answer in order: the one before is not
                                                       expected any more */
    stray(1, 3);
    CHECK(drive->owed_count == 0 && drive->count.late == 2);
    stray(1, 3); /* no request waits for it */
    CHECK(drive->count.late == 2 && m->noise_bytes == 8 && m->stray_bytes == 8);
}

/* A drive that is held until late replies have arrived is free after the last one. */
static void the_last_late_reply_frees_a_drive_that_is_held(void)
{
    begin_owing(1);
    drive->held_until_ns = w.now_ns + 9 * MS;
    w.now_ns += MS;
    stray(1, 2);
    CHECK(drive->held_until_ns == w.now_ns);
    begin_owing(2);
    int64_t held_until_ns = drive->held_until_ns = w.now_ns + 9 * MS;
    stray(1, 2);
    CHECK(drive->held_until_ns == held_until_ns); /* one more late reply may arrive */
    begin_owing(1);
    held_until_ns = drive->held_until_ns = w.now_ns - 9 * MS;
    stray(1, 2);
    CHECK(drive->held_until_ns == held_until_ns); /* the hold was over long ago */
}

static void a_reply_is_found_in_any_pieces_and_after_noise(void)
{
    uint8_t reply[16];
    begin_owing(1);
    uint32_t bytes = reply_of(1, 2, reply);
    line_stray(m, (const uint8_t[]){9, 8, 7}, 3, w.now_ns);
    for (uint32_t i = 0; i < bytes; i++) {
        CHECK(drive->count.late == 0 && m->stray_bytes == 3 + i);
        line_stray(m, &reply[i], 1, w.now_ns);
    }
    CHECK(drive->count.late == 1 && m->noise_bytes == 3 && m->stray_bytes == 0);
    begin_owing(1);
    reply[4] ^= 1; /* a wrong check sum */
    line_stray(m, reply, bytes, w.now_ns);
    CHECK(drive->count.late == 0 && drive->owed_count == 1 && m->noise_bytes == bytes);
    begin_owing(1);
    stray(2, 2); /* from another drive */
    CHECK(drive->count.late == 0 && drive->owed_count == 1);
}

static void each_drive_has_its_own_late_replies(void)
{
    begin_owing(1);
    line_frame frame = read_of(2, 2);
    m->transaction.frame = frame;
    line_owe(m, 1);
    stray(2, 2);
    CHECK(m->drive[1].count.late == 1 && m->drive[1].owed_count == 0 && drive->owed_count == 1 &&
          drive->count.late == 0);
    m->drive[1] = *drive; /* both drives wait for an equal reply: the first one gets it */
    stray(1, 2);
    CHECK(drive->count.late == 1 && m->drive[1].count.late == 0 && m->drive[1].owed_count == 1 &&
          m->noise_bytes == 0);
    m->drive[2] = m->drive[1]; /* beyond the count of drives */
    m->drive[1].owed_count = 0;
    stray(1, 2);
    CHECK(m->drive[2].count.late == 0);
}

static void noise_is_kept_as_long_as_the_longest_reply(void)
{
    begin_owing(1);
    for (uint32_t i = 0; i < FRAME_BYTES_MAX + 5; i++) {
        line_stray(m, &(uint8_t){(uint8_t)i}, 1, w.now_ns);
    }
    CHECK(m->stray_bytes == FRAME_BYTES_MAX && m->noise_bytes == FRAME_BYTES_MAX + 5);
    CHECK(m->stray[0] == 5 && m->stray[FRAME_BYTES_MAX - 1] == (uint8_t)(FRAME_BYTES_MAX + 4));
    stray(1, 2);
    CHECK(drive->count.late == 1);
}

/* -------------------------------------------------------------- bytes next to an answer */
static uint64_t noise_of(uint32_t echo, const uint8_t *bytes, uint32_t count, received verdict)
{
    begin_with(1, 0);
    m->echo = echo;
    m->transaction.frame = read_of(1, 2);
    m->transaction.received_bytes = count;
    memcpy(m->transaction.received, bytes, count);
    line_sort_received(m, &verdict, w.now_ns);
    return m->noise_bytes;
}

static void bytes_before_and_after_an_answer_are_noise(void)
{
    const line_frame frame = read_of(1, 2);
    uint8_t bytes[40] = {1, 2, 3};
    (void)reply_of(1, 2, bytes + 3);
    received answer = {.kind = RECEIVED_ANSWER, .offset = 3, .bytes = 7};
    CHECK(noise_of(ECHO_NONE, bytes, 10, answer) == 3);
    CHECK(m->stray_bytes == 3 && m->stray[0] == 1 && m->stray[2] == 3);
    CHECK(noise_of(ECHO_NONE, bytes, 12, answer) == 5);
    CHECK(noise_of(ECHO_NONE, bytes, 6,
                   (received){.kind = RECEIVED_ANSWER, .offset = 3, .bytes = 1}) == 5);
    answer.offset = 0;
    CHECK(noise_of(ECHO_NONE, bytes + 3, 7, answer) == 0);
    bytes[10] = 0xAB, bytes[11] = 0xCD;
    CHECK(noise_of(ECHO_NONE, bytes + 3, 9, answer) == 2 && m->stray[0] == 0xAB &&
          m->stray[1] == 0xCD);
    memcpy(bytes, frame.request, 8);
    (void)reply_of(1, 2, bytes + 8);
    answer = (received){.kind = RECEIVED_ANSWER, .offset = 8, .bytes = 7, .echoed = 1};
    CHECK(noise_of(ECHO_FIRST, bytes, 15, answer) == 0);
    memmove(bytes + 10, bytes + 8, 7);
    bytes[8] = 0xEE, bytes[9] = 0xFF, answer.offset = 10;
    CHECK(noise_of(ECHO_FIRST, bytes, 17, answer) == 2 && m->stray[0] == 0xEE);
    answer.echoed = 0; /* without an echo these bytes are noise */
    CHECK(noise_of(ECHO_UNKNOWN, bytes, 17, answer) == 10);
}

static void without_an_answer_all_bytes_but_an_echo_are_noise(void)
{
    const line_frame frame = read_of(1, 2);
    const received none = {.kind = RECEIVED_MORE};
    uint8_t bytes[20];
    memcpy(bytes, frame.request, 8);
    bytes[8] = 9;
    CHECK(noise_of(ECHO_FIRST, bytes, 8, none) == 0 && noise_of(ECHO_UNKNOWN, bytes, 8, none) == 0);
    CHECK(noise_of(ECHO_UNKNOWN, bytes, 9, none) == 1 && m->stray[0] == 9);
    CHECK(noise_of(ECHO_NONE, bytes, 8, none) == 8); /* this line has no echo */
    CHECK(noise_of(ECHO_FIRST, bytes, 7, none) == 7);
    bytes[7] ^= 1;
    CHECK(noise_of(ECHO_FIRST, bytes, 8, none) == 8);
}

int main(void)
{
    a_late_reply_ends_the_wait_for_it_and_for_all_before_it();
    a_late_reply_among_equal_ones_ends_a_single_wait();
    the_last_late_reply_frees_a_drive_that_is_held();
    a_reply_is_found_in_any_pieces_and_after_noise();
    each_drive_has_its_own_late_replies();
    noise_is_kept_as_long_as_the_longest_reply();
    bytes_before_and_after_an_answer_are_noise();
    without_an_answer_all_bytes_but_an_echo_are_noise();
    return checks_report("line stray");
}
