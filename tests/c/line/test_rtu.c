/* SPDX-License-Identifier: Apache-2.0
 * Every line and every bound of rtu.c: check sums of the standards, numbers on the wire, and which
 * bytes are an answer. */
#include <string.h>

#include "check.h"
#include "rtu.h"

enum { ROOM = 300 };

/* V1.02 of the serial line guide, 6.2.2: the CRC of 02 07 is the number 0x1241, sent as 41 12. */
static void check_sums_match_the_standards(void)
{
    const uint8_t read_holding[] = {0x01, 0x03, 0x00, 0x00, 0x00, 0x0A}, digits[] = "123456789",
                  two[] = {0x02, 0x07};
    CHECK(rtu_crc16(two, 2) == 0x1241);
    CHECK(rtu_crc16(read_holding, 6) == 0xCDC5);
    CHECK(rtu_crc16(digits, 9) == 0x4B37);
    CHECK(rtu_crc16(digits, 0) == 0xFFFF);
    CHECK(rtu_crc8(digits, 9) == 0xA1);
    CHECK(rtu_xmodem(0, digits, 9) == 0x31C3 && rtu_xmodem(0, digits, 0) == 0);
    CHECK(rtu_xmodem(rtu_xmodem(0, digits, 4), digits + 4, 5) == 0x31C3);
    CHECK(rtu_crc8(digits, 0) == 0);
    for (uint32_t value = 0; value < 256; value++) {
        const uint8_t one = (uint8_t)value;
        uint32_t wide = 0xFFFF ^ value, narrow = value;
        for (int bit = 0; bit < 8; bit++) {
            wide = (wide & 1) != 0 ? wide >> 1 ^ 0xA001 : wide >> 1;
            narrow = (narrow & 1) != 0 ? narrow >> 1 ^ 0x8C : narrow >> 1;
        }
        CHECK(rtu_crc16(&one, 1) == wide && rtu_crc8(&one, 1) == narrow);
    }
}

static void a_check_sum_is_valid_and_any_flipped_bit_makes_it_wrong(void)
{
    static const uint32_t bytes_of[] = {0, 2, 1};
    for (uint32_t seal = SEAL_NONE; seal <= SEAL_CRC8; seal++) {
        uint8_t frame[8] = {0x01, 0x06, 0x20, 0x88, 0xFF, 0xC4, 0x55, 0xAA};
        CHECK(rtu_seal_bytes(seal) == bytes_of[seal]);
        rtu_seal(frame, 8, seal);
        CHECK(rtu_is_sealed(frame, 8, seal));
        for (uint32_t bit = 0; bit < 64; bit++) {
            frame[bit / 8] ^= (uint8_t)(1 << bit % 8);
            CHECK(rtu_is_sealed(frame, 8, seal) == (seal == SEAL_NONE));
            frame[bit / 8] ^= (uint8_t)(1 << bit % 8);
        }
    }
    uint8_t kept[8] = {1, 2, 3, 4, 5, 6, 7, 8};
    rtu_seal(kept, 8, SEAL_NONE);
    CHECK(kept[6] == 7 && kept[7] == 8);
    rtu_seal(kept, 8, SEAL_CRC8);
    CHECK(kept[6] == 7);
    uint8_t known[8] = {0x01, 0x03, 0x00, 0x00, 0x00, 0x0A, 0, 0};
    rtu_seal(known, 8, SEAL_CRC16);
    CHECK(known[6] == 0xC5 && known[7] == 0xCD);
}

static void numbers_are_encoded_in_their_form(void)
{
    static const uint8_t wire[4] = {0x81, 0x02, 0xF3, 0x04};
    static const int64_t read[] = {0x81,       -0x7F,       0x8102,     -0x7EFE,
                                   0x8102F304, -0x7EFD0CFC, 0xF3048102, -0x0CFB7EFE};
    static const uint32_t size[] = {1, 1, 2, 2, 4, 4, 4, 4};
    for (uint32_t form = FORM_U8; form <= FORM_I32_LOW_FIRST; form++) {
        uint8_t back[5] = {0x99, 0x99, 0x99, 0x99, 0x99};
        CHECK(rtu_form_bytes(form) == size[form]);
        CHECK(rtu_read(wire, form) == read[form]);
        rtu_write(back, form, read[form]);
        CHECK(memcmp(back, wire, size[form]) == 0 && back[size[form]] == 0x99);
    }
}

static void a_mask_takes_its_bits_with_their_sign(void)
{
    CHECK(rtu_masked(-5, 0, FORM_I16) == -5);
    CHECK(rtu_masked(0x1E19, 0xFF00, FORM_U16) == 0x1E);
    CHECK(rtu_masked(0xFF19, 0xFF00, FORM_I16) == -1);
    CHECK(rtu_masked(0x7F19, 0xFF00, FORM_I16) == 0x7F);
    CHECK(rtu_masked(0x1980, 0x00FF, FORM_I16) == -128);
    CHECK(rtu_masked(0x1980, 0x00FF, FORM_U16) == 128);
    CHECK(rtu_masked(-1, 0x80000000, FORM_U32) == 1);
    CHECK(rtu_masked(-1, 0x80000000, FORM_I32) == -1);
    CHECK(rtu_masked(-1, 0xFFFFFFFF, FORM_I32) == -1);
    CHECK(rtu_masked(0xF0, 0x10, FORM_U8) == 1);
}

/* Function 03: reads two registers of unit 1. */
static line_frame reading(void)
{
    line_frame frame = {.request_bytes = 8,
                        .reply_bytes = 9,
                        .match_bytes = 3,
                        .request_seal = SEAL_CRC16,
                        .reply_seal = SEAL_CRC16,
                        .has_exceptions = 1,
                        .match = {1, 3, 4},
                        .request = {1, 3, 0, 16, 0, 2}};
    rtu_seal(frame.request, 8, SEAL_CRC16);
    return frame;
}

/* Function 06: the reply equals the request. */
static line_frame writing(void)
{
    line_frame frame = {.request_bytes = 8,
                        .reply_bytes = 8,
                        .echo_bytes = 6,
                        .request_seal = SEAL_CRC16,
                        .reply_seal = SEAL_CRC16,
                        .has_exceptions = 1,
                        .request = {1, 6, 0, 16, 0, 2}};
    rtu_seal(frame.request, 8, SEAL_CRC16);
    return frame;
}

static uint32_t put(uint8_t *to, uint32_t at, const uint8_t *bytes, uint32_t count)
{
    memcpy(to + at, bytes, count);
    return at + count;
}

static const uint8_t *good_reply(void)
{
    static uint8_t reply[9] = {1, 3, 4, 0x12, 0x34, 0x56, 0x78};
    rtu_seal(reply, 9, SEAL_CRC16);
    return reply;
}

static received find(const line_frame *frame, uint32_t echo, const uint8_t *bytes, uint32_t count)
{
    return rtu_find_answer(frame, frame->request, echo, bytes, count);
}

static bool is(received found, received_kind kind, uint32_t offset, uint32_t echoed)
{
    return found.kind == kind &&
           (kind == RECEIVED_MORE || kind == RECEIVED_BAD || found.offset == offset) &&
           (kind != RECEIVED_ANSWER || found.echoed == echoed);
}

static void an_answer_is_found_when_its_last_byte_has_come(void)
{
    line_frame frame = reading();
    for (uint32_t count = 1; count < 9; count++) {
        CHECK(is(find(&frame, 0, good_reply(), count), RECEIVED_MORE, 0, 0));
    }
    CHECK(is(find(&frame, 0, good_reply(), 9), RECEIVED_ANSWER, 0, 0));
}

static void garbage_before_and_after_an_answer_is_skipped(void)
{
    line_frame frame = reading();
    for (uint32_t before = 0; before < 20; before++) {
        uint8_t bytes[ROOM];
        memset(bytes, 0x01, sizeof bytes);
        uint32_t count = put(bytes, before, good_reply(), 9);
        CHECK(is(find(&frame, 0, bytes, count - 1), RECEIVED_MORE, 0, 0));
        CHECK(is(find(&frame, 0, bytes, count), RECEIVED_ANSWER, before, 0));
        CHECK(is(find(&frame, 0, bytes, count + 3), RECEIVED_ANSWER, before, 0));
    }
}

static void bytes_that_are_not_the_answer_are_refused(void)
{
    line_frame frame = reading();
    uint8_t reply[9];
    for (uint32_t bit = 0; bit < 72; bit++) { /* flips each bit in turn */
        memcpy(reply, good_reply(), 9);
        reply[bit / 8] ^= (uint8_t)(1 << bit % 8);
        CHECK(is(find(&frame, 0, reply, 9), RECEIVED_MORE, 0, 0));
    }
    static const uint8_t others[][3] = {{2, 3, 4}, {1, 4, 4}, {1, 3, 2}, {0, 3, 4}};
    for (uint32_t n = 0; n < 4; n++) { /* correctly sealed, but of another unit, function or
                                          length */
        memcpy(reply, good_reply(), 9);
        memcpy(reply, others[n], 3);
        rtu_seal(reply, 9, SEAL_CRC16);
        CHECK(is(find(&frame, 0, reply, 9), RECEIVED_MORE, 0, 0));
    }
}

static void a_write_is_answered_by_its_own_first_bytes(void)
{
    line_frame frame = writing();
    uint8_t other[8];
    CHECK(rtu_answer_is_request(&frame, frame.request));
    CHECK(is(find(&frame, 0, frame.request, 8), RECEIVED_ANSWER, 0, 0));
    for (uint32_t at = 0; at < 6; at++) {
        memcpy(other, frame.request, 8);
        other[at] ^= 0x10;
        rtu_seal(other, 8, SEAL_CRC16);
        CHECK(is(find(&frame, 0, other, 8), RECEIVED_MORE, 0, 0));
    }
    line_frame many = writing(); /* function 16: the reply is shorter than the request */
    many.request[1] = 16;
    many.request_bytes = 13;
    rtu_seal(many.request, 13, SEAL_CRC16);
    CHECK(!rtu_answer_is_request(&many, many.request));
    line_frame read = reading();
    read.reply_bytes = 8;
    CHECK(!rtu_answer_is_request(&read, read.request));
}

static void a_refusal_is_reported_with_its_code(void)
{
    line_frame frame = reading();
    uint8_t refusal[8] = {0x55, 1, 0x83, 2, 0, 0};
    rtu_seal(refusal + 1, 5, SEAL_CRC16);
    for (uint32_t count = 1; count < 6; count++) {
        CHECK(is(find(&frame, 0, refusal, count), RECEIVED_MORE, 0, 0));
    }
    received found = find(&frame, 0, refusal, 6);
    CHECK(is(found, RECEIVED_REFUSED, 1, 0) && found.exception == 2);
    CHECK(is(find(&frame, 0, refusal + 1, 5), RECEIVED_REFUSED, 0, 0));
    frame.has_exceptions = 0;
    CHECK(is(find(&frame, 0, refusal, 6), RECEIVED_MORE, 0, 0));
    frame.has_exceptions = 1;
    for (uint32_t at = 1; at < 6; at++) { /* another unit, function or code without a new seal */
        uint8_t wrong[8];
        memcpy(wrong, refusal, 8);
        wrong[at] ^= 0x01;
        CHECK(is(find(&frame, 0, wrong, 6), RECEIVED_MORE, 0, 0));
        if (at < 3) {
            rtu_seal(wrong + 1, 5, SEAL_CRC16);
            CHECK(is(find(&frame, 0, wrong, 6), RECEIVED_MORE, 0, 0));
        }
    }
    uint8_t plain[5] = {1, 3, 2}; /* a function without its top bit is no exception */
    rtu_seal(plain, 5, SEAL_CRC16);
    CHECK(is(find(&frame, 0, plain, 5), RECEIVED_MORE, 0, 0));
}

static void an_adapter_that_receives_itself_brings_the_request_first(void)
{
    line_frame frame = reading();
    uint8_t bytes[ROOM];
    uint32_t count = put(bytes, 0, frame.request, 8);
    for (uint32_t n = 1; n <= 8; n++) {
        CHECK(is(find(&frame, 1, bytes, n), RECEIVED_MORE, 0, 0));
    }
    count = put(bytes, count, good_reply(), 9);
    CHECK(is(find(&frame, 1, bytes, count - 1), RECEIVED_MORE, 0, 0));
    CHECK(is(find(&frame, 1, bytes, count), RECEIVED_ANSWER, 8, 1));
    CHECK(is(find(&frame, 0, bytes, count), RECEIVED_ANSWER, 8, 1));
    CHECK(is(find(&frame, 2, bytes, count), RECEIVED_ANSWER, 8, 1));
    for (uint32_t at = 0; at < 8; at++) { /* two devices have sent at once */
        uint8_t collided[ROOM];
        memcpy(collided, bytes, count);
        collided[at] ^= 0x80;
        CHECK(is(find(&frame, 1, collided, at), RECEIVED_MORE, 0, 0));
        CHECK(is(find(&frame, 1, collided, at + 1), RECEIVED_BAD, 0, 0));
        CHECK(is(find(&frame, 1, collided, count), RECEIVED_BAD, 0, 0));
    }
    CHECK(is(find(&frame, 1, good_reply(), 9), RECEIVED_BAD, 0, 0));
    CHECK(is(find(&frame, 2, good_reply(), 9), RECEIVED_ANSWER, 0, 0));
}

static void an_echo_of_a_write_does_not_count_as_its_answer(void)
{
    line_frame frame = writing();
    uint8_t bytes[ROOM];
    uint32_t count = put(bytes, 0, frame.request, 8);
    CHECK(is(find(&frame, 1, bytes, count), RECEIVED_MORE, 0, 0));
    CHECK(is(find(&frame, 2, bytes, count), RECEIVED_MORE, 0, 0));
    count = put(bytes, count, frame.request, 8);
    CHECK(is(find(&frame, 1, bytes, count - 1), RECEIVED_MORE, 0, 0));
    CHECK(is(find(&frame, 1, bytes, count), RECEIVED_ANSWER, 8, 1));
    CHECK(is(find(&frame, 2, bytes, count), RECEIVED_ANSWER, 8, 1));
    CHECK(is(find(&frame, 0, bytes, count), RECEIVED_ANSWER, 0, 0));
    uint8_t refusal[5] = {1, 0x86, 4};
    rtu_seal(refusal, 5, SEAL_CRC16);
    count = put(bytes, 8, refusal, 5);
    received found = find(&frame, 1, bytes, count);
    CHECK(is(found, RECEIVED_REFUSED, 8, 1) && found.exception == 4);
    CHECK(is(find(&frame, 2, refusal, 5), RECEIVED_REFUSED, 0, 0));
}

static void an_answer_may_repeat_only_one_byte(void)
{
    line_frame frame = writing();
    frame.echo_bytes = 1;
    frame.match_bytes = 1;
    frame.match[0] = 9;
    uint8_t reply[8] = {1, 99};
    rtu_seal(reply, 8, SEAL_CRC16);
    CHECK(is(find(&frame, 0, reply, 8), RECEIVED_ANSWER, 0, 0));
    reply[0] = 9;
    rtu_seal(reply, 8, SEAL_CRC16);
    CHECK(is(find(&frame, 0, reply, 8), RECEIVED_MORE, 0, 0));
}

/* The request and one more byte can look like a sealed reply. On a line with echo that is no
 * reply. */
static void no_answer_begins_within_the_echo(void)
{
    line_frame frame = reading();
    uint8_t bytes[9];
    for (uint32_t value = 0; value < 0x10000; value++) {
        frame.request[2] = 4; /* equal to the byte count of the reply */
        frame.request[4] = (uint8_t)(value >> 8);
        frame.request[5] = (uint8_t)value;
        rtu_seal(frame.request, 8, SEAL_CRC16);
        memcpy(bytes, frame.request, 8);
        uint16_t crc = rtu_crc16(bytes, 7);
        bytes[8] = (uint8_t)(crc >> 8);
        if ((crc & 0xFF) == bytes[7]) {
            CHECK(is(find(&frame, 0, bytes, 9), RECEIVED_ANSWER, 0, 0));
            CHECK(is(find(&frame, 1, bytes, 9), RECEIVED_MORE, 0, 0));
            CHECK(is(find(&frame, 2, bytes, 9), RECEIVED_MORE, 0, 0));
            return;
        }
    }
    CHECK(false);
}

static void without_received_bytes_nothing_is_reported(void)
{
    line_frame frame = reading();
    for (uint32_t echo = 0; echo <= 2; echo++) {
        CHECK(is(find(&frame, echo, good_reply(), 0), RECEIVED_MORE, 0, 0));
    }
}

static void short_frames_of_other_protocols_have_a_check_sum_of_one_byte(void)
{
    line_frame frame = {.request_bytes = 10,
                        .reply_bytes = 10,
                        .match_bytes = 1,
                        .request_seal = SEAL_CRC8,
                        .reply_seal = SEAL_CRC8,
                        .match = {1},
                        .request = {1, 0x64, 0, 50}};
    rtu_seal(frame.request, 10, SEAL_CRC8);
    uint8_t reply[10] = {1, 2, 0, 3, 0, 49, 0x12, 0x34, 0};
    rtu_seal(reply, 10, SEAL_CRC8);
    CHECK(is(find(&frame, 0, reply, 9), RECEIVED_MORE, 0, 0));
    CHECK(is(find(&frame, 0, reply, 10), RECEIVED_ANSWER, 0, 0));
    reply[9] ^= 1;
    CHECK(is(find(&frame, 0, reply, 10), RECEIVED_MORE, 0, 0));
}

/* RoboClaw packet serial: the check sum of an answer to a read covers the request, too. The answer
 * to a write is the byte 0xFF. */
static void an_answer_that_names_no_request_is_all_bytes_received(void)
{
    line_frame asked = {.request_bytes = 2,
                        .reply_bytes = 4,
                        .reply_seal = SEAL_WITH_REQUEST,
                        .exact = 1,
                        .request = {0x80, 24}};
    uint8_t reply[5] = {0x00, 0xF0, 0, 0, 0xFF}, sealed[4] = {0x80, 24, 0x00, 0xF0};
    rtu_write(reply + 2, FORM_U16, rtu_xmodem(0, sealed, 4));
    CHECK(is(find(&asked, 0, reply, 3), RECEIVED_MORE, 0, 0));
    CHECK(is(find(&asked, 0, reply, 4), RECEIVED_ANSWER, 0, 0));
    CHECK(find(&asked, 2, reply, 5).kind == RECEIVED_BAD);
    asked.request[0] = 0x81; /* the request to another unit */
    CHECK(find(&asked, 0, reply, 4).kind == RECEIVED_BAD && find(&asked, 0, reply, 4).bytes == 0);
    line_frame last_sent = {.request_bytes = 8,
                            .reply_bytes = 1,
                            .match_bytes = 1,
                            .match = {0xFF},
                            .request_seal = SEAL_XMODEM,
                            .exact = 1,
                            .request = {0x80, 34}};
    rtu_seal(last_sent.request, 8, SEAL_XMODEM);
    CHECK(rtu_seal_bytes(SEAL_XMODEM) == 2 &&
          rtu_read(last_sent.request + 6, FORM_U16) == rtu_xmodem(0, last_sent.request, 6));
    CHECK(is(find(&last_sent, 0, reply + 4, 1), RECEIVED_ANSWER, 0, 0));
    CHECK(find(&last_sent, 0, reply + 3, 1).kind == RECEIVED_BAD &&
          find(&last_sent, 0, reply + 3, 2).kind == RECEIVED_BAD);
    CHECK(is(find(&last_sent, 0, reply, 0), RECEIVED_MORE, 0, 0));
}

int main(void)
{
    check_sums_match_the_standards();
    a_check_sum_is_valid_and_any_flipped_bit_makes_it_wrong();
    numbers_are_encoded_in_their_form();
    a_mask_takes_its_bits_with_their_sign();
    an_answer_is_found_when_its_last_byte_has_come();
    garbage_before_and_after_an_answer_is_skipped();
    bytes_that_are_not_the_answer_are_refused();
    a_write_is_answered_by_its_own_first_bytes();
    a_refusal_is_reported_with_its_code();
    an_adapter_that_receives_itself_brings_the_request_first();
    an_echo_of_a_write_does_not_count_as_its_answer();
    an_answer_may_repeat_only_one_byte();
    no_answer_begins_within_the_echo();
    without_received_bytes_nothing_is_reported();
    short_frames_of_other_protocols_have_a_check_sum_of_one_byte();
    an_answer_that_names_no_request_is_all_bytes_received();
    return checks_report("rtu");
}
