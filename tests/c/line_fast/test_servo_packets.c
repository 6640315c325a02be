/* SPDX-License-Identifier: Apache-2.0
 * Packets of bus servos. Their bytes are from the makers' manuals and SDKs, not from motord. */
#include <string.h>

#include "check.h"
#include "rtu.h"

/* ROBOTIS e-Manual, DYNAMIXEL Protocol 2.0, examples: ping of ID 1 and its status; read of
 * position and its status. */
static const uint8_t PING[] = {0xFF, 0xFF, 0xFD, 0x00, 0x01, 0x03, 0x00, 0x01, 0x19, 0x4E};
static const uint8_t PONG[] = {0xFF, 0xFF, 0xFD, 0x00, 0x01, 0x07, 0x00,
                               0x55, 0x00, 0x06, 0x04, 0x26, 0x65, 0x5D};
static const uint8_t POSITION[] = {0xFF, 0xFF, 0xFD, 0x00, 0x01, 0x08, 0x00, 0x55,
                                   0x00, 0xA6, 0x00, 0x00, 0x00, 0x8C, 0xC0};

static line_frame read_of(uint32_t reply_bytes)
{
    line_frame frame = {.request_bytes = sizeof PING,
                        .reply_bytes = reply_bytes,
                        .match_bytes = 5,
                        .match = {0xFF, 0xFF, 0xFD, 0x00, 0x01},
                        .request_seal = SEAL_STUFFED,
                        .reply_seal = SEAL_STUFFED,
                        .has_exceptions = 1};
    memcpy(frame.request, PING, sizeof PING);
    return frame;
}

static void check_sums_match_the_manual(void)
{
    CHECK(rtu_is_sealed(PING, sizeof PING, SEAL_STUFFED));
    CHECK(rtu_is_sealed(PONG, sizeof PONG, SEAL_STUFFED));
    CHECK(rtu_is_sealed(POSITION, sizeof POSITION, SEAL_STUFFED));
    line_frame frame = read_of(sizeof PONG);
    frame.request[8] = frame.request[9] = 0;
    rtu_finish(&frame);
    CHECK(frame.request_bytes == sizeof PING && memcmp(frame.request, PING, sizeof PING) == 0);
    /* a ping of ID 1 in the Feetech protocol */
    uint8_t ping[] = {0xFF, 0xFF, 0x01, 0x02, 0x01, 0x00};
    rtu_seal(ping, sizeof ping, SEAL_SUM);
    CHECK(ping[5] == 0xFB && rtu_is_sealed(ping, sizeof ping, SEAL_SUM));
    ping[3] ^= 1;
    CHECK(!rtu_is_sealed(ping, sizeof ping, SEAL_SUM));
}

static void the_shortest_packet_with_a_check_sum_has_four_bytes(void)
{
    const uint8_t short_one[] = {0xFF, 0xFF, 0xFF}; /* its last byte is the sum of no bytes */
    CHECK(!rtu_is_sealed(short_one, sizeof short_one, SEAL_SUM));
    const uint8_t shortest[] = {0xFF, 0xFF, 0x01, 0xFE};
    CHECK(rtu_is_sealed(shortest, sizeof shortest, SEAL_SUM));
}

static received found_in(const line_frame *frame, const uint8_t *bytes, uint32_t count)
{
    return rtu_hunt(frame, frame->request, 0, bytes, count);
}

static void a_status_is_found_whole_good_and_of_the_right_servo_only(void)
{
    line_frame frame = read_of(sizeof POSITION);
    uint8_t bytes[64] = {0x00, 0xFF};
    memcpy(bytes + 2, POSITION, sizeof POSITION);
    received found = found_in(&frame, bytes, 2 + sizeof POSITION);
    CHECK(found.kind == RECEIVED_ANSWER && found.offset == 2 && found.bytes == sizeof POSITION);
    for (uint32_t count = 0; count < 2 + sizeof POSITION; count++) {
        CHECK(found_in(&frame, bytes, count).kind == RECEIVED_MORE);
    }
    for (uint32_t bit = 0; bit < 8 * sizeof POSITION; bit++) {
        memcpy(bytes, POSITION, sizeof POSITION);
        bytes[bit / 8] ^= (uint8_t)(1U << bit % 8);
        CHECK(found_in(&frame, bytes, sizeof POSITION).kind == RECEIVED_MORE);
    }
    frame.match[4] = 2;
    CHECK(found_in(&frame, POSITION, sizeof POSITION).kind == RECEIVED_MORE);
    frame = read_of(sizeof POSITION - 1);
    /* the answer to another request */
    CHECK(found_in(&frame, POSITION, sizeof POSITION).kind == RECEIVED_MORE);
}

static void an_error_number_is_a_refusal_and_an_alert_is_not(void)
{
    line_frame status = {.request_bytes = 11,
                         .request_seal = SEAL_STUFFED,
                         .request = {0xFF, 0xFF, 0xFD, 0x00, 0x01, 0x04, 0x00, 0x55, 0x07}};
    line_frame frame = read_of(11);
    rtu_finish(&status);
    received found = found_in(&frame, status.request, status.request_bytes);
    CHECK(found.kind == RECEIVED_REFUSED && found.exception == 7 && found.bytes == 11);
    status.request[8] = 0x80; /* the alert bit for a hardware error: the request was carried out */
    rtu_finish(&status);
    CHECK(found_in(&frame, status.request, status.request_bytes).kind == RECEIVED_ANSWER);
    status.request[8] = 0x87;
    rtu_finish(&status);
    CHECK(found_in(&frame, status.request, status.request_bytes).kind == RECEIVED_REFUSED);
}

/* A status whose four bytes of data contain a head, at which a receiver would begin anew. */
static void stuffing_is_added_and_removed(void)
{
    static const uint8_t data[][4] = {{0xFF, 0xFF, 0xFD, 0x00},
                                      {0xFF, 0xFF, 0xFD, 0xFD},
                                      {0x01, 0xFF, 0xFF, 0xFD},
                                      {0xFD, 0xFF, 0xFF, 0xFF},
                                      {0xFF, 0xFD, 0xFD, 0xFF}};
    static const uint32_t extra[] = {1, 1, 1, 0, 0};
    for (uint32_t i = 0; i < 5; i++) {
        line_frame status = {.request_bytes = 15,
                             .request_seal = SEAL_STUFFED,
                             .request = {0xFF, 0xFF, 0xFD, 0x00, 0x01, 0x08, 0x00, 0x55, 0x00}};
        memcpy(status.request + 9, data[i], 4);
        uint8_t plain[FRAME_BYTES_MAX];
        rtu_finish(&status);
        CHECK(status.request_bytes == 15 + extra[i] && status.request[5] == 8 + extra[i]);
        line_frame frame = read_of(15);
        received found = found_in(&frame, status.request, status.request_bytes);
        CHECK(found.kind == RECEIVED_ANSWER && found.bytes == 15 + extra[i]);
        CHECK(rtu_unstuff(status.request, status.request_bytes, plain) == 15 &&
              memcmp(plain + 9, data[i], 4) == 0);
    }
    uint8_t most[FRAME_BYTES_MAX + 1] = {0}, plain[FRAME_BYTES_MAX];
    CHECK(rtu_unstuff(most, FRAME_BYTES_MAX, plain) == FRAME_BYTES_MAX);
    CHECK(rtu_unstuff(most, FRAME_BYTES_MAX + 1, plain) == 0);
}

/* A head before the length or in the check sum is not stuffed, nor are bytes that differ from a
 * head. */
static void a_head_is_stuffed_between_length_and_check_sum_only(void)
{
    enum { COUNT = 20, NOT_STUFFED = 2 };
    for (uint32_t at = 2; at < COUNT - 1; at++) {
        /* index of the byte that differs from a head; 4: no byte */
        for (uint32_t other = 0; other < 5; other++) {
            uint8_t wire[COUNT] = {0}, plain[FRAME_BYTES_MAX];
            wire[at - 2] = wire[at - 1] = 0xFF, wire[at] = wire[at + 1] = 0xFD;
            if (other < 4) {
                wire[at - 2 + other] ^= 0x40;
            }
            uint32_t taken = at >= 9 && at + 1 < COUNT - NOT_STUFFED && other == 4 ? 1 : 0,
                     next = at + 1 + taken;
            CHECK(rtu_unstuff(wire, COUNT, plain) == COUNT - taken);
            CHECK(memcmp(plain, wire, at + 1) == 0 &&
                  memcmp(plain + at + 1, wire + next, COUNT - next) == 0);
            line_frame frame = {.request_bytes = COUNT, .request_seal = SEAL_STUFFED};
            memcpy(frame.request, wire, COUNT);
            uint32_t put =
                at >= 9 && at < COUNT - NOT_STUFFED && (other == 3 || other == 4) ? 1 : 0;
            rtu_finish(&frame);
            CHECK(frame.request_bytes == COUNT + put && frame.request[5] == COUNT + put - 7 &&
                  frame.request[6] == 0);
            CHECK(rtu_is_sealed(frame.request, COUNT + put, SEAL_STUFFED));
            if (put == 1) {
                CHECK(frame.request[at] == 0xFD && frame.request[at + 1] == 0xFD);
            }
        }
    }
}

static void a_first_byte_is_never_removed_as_stuffing(void)
{
    static const uint8_t WIRE[] = {0xFD, 0xFD, 0x00, 0x00, 0x00};
    uint8_t plain[FRAME_BYTES_MAX];
    CHECK(rtu_unstuff(WIRE, sizeof WIRE, plain) == sizeof WIRE &&
          memcmp(plain, WIRE, sizeof WIRE) == 0);
}

static void the_longest_packet_has_room_for_its_stuffing(void)
{
    line_frame frame = {.request_bytes = FRAME_BYTES_MAX - 1, .request_seal = SEAL_STUFFED};
    memset(frame.request, 0x11, sizeof frame.request);
    rtu_finish(&frame);
    CHECK(frame.request_bytes == FRAME_BYTES_MAX - 1 && frame.request[FRAME_BYTES_MAX - 4] == 0x11);
    CHECK(rtu_is_sealed(frame.request, FRAME_BYTES_MAX - 1, SEAL_STUFFED));
    /* Bytes that do not fit are cut, and the frame stays within its memory. Case: a head at its
     * very end. */
    frame = (line_frame){.request_bytes = FRAME_BYTES_MAX, .request_seal = SEAL_STUFFED};
    frame.request[FRAME_BYTES_MAX - 5] = frame.request[FRAME_BYTES_MAX - 4] = 0xFF,
                                    frame.request[FRAME_BYTES_MAX - 3] = 0xFD;
    rtu_finish(&frame);
    CHECK(frame.request_bytes == FRAME_BYTES_MAX - 1);
    /* case: only heads */
    frame = (line_frame){
        .request_bytes = FRAME_BYTES_MAX, .reply_bytes = 77, .request_seal = SEAL_STUFFED};
    for (uint32_t i = 0; i < FRAME_BYTES_MAX; i++) {
        frame.request[i] = i % 3 == 2 ? 0xFD : 0xFF;
    }
    rtu_finish(&frame);
    CHECK(frame.request_bytes <= FRAME_BYTES_MAX && frame.request_bytes >= FRAME_BYTES_MAX - 1 &&
          frame.reply_bytes == 77);
    CHECK(rtu_is_sealed(frame.request, frame.request_bytes, SEAL_STUFFED));
}

/* A status has at least eleven bytes: shorter packets have no error number. */
static void a_packet_without_an_error_number_is_not_a_status(void)
{
    line_frame frame = read_of(11);
    for (uint32_t bytes = 8; bytes <= 10; bytes++) {
        uint8_t wire[32] = {0xFF, 0xFF, 0xFD, 0x00, 0x01, (uint8_t)(bytes - 7), 0x00, 0x55, 0x07};
        rtu_seal(wire, bytes, SEAL_STUFFED);
        wire[7] = 0x55;
        CHECK(found_in(&frame, wire, sizeof wire).kind == RECEIVED_MORE);
    }
}

static void values_are_low_byte_first_except_in_one_series(void)
{
    static const struct {
        uint32_t form, bytes;
        int64_t raw;
        uint8_t wire[4];
    } cases[] = {{FORM_U16_LE, 2, 0x1234, {0x34, 0x12}},
                 {FORM_I16_LE, 2, -2, {0xFE, 0xFF}},
                 {FORM_U32_LE, 4, 0x12345678, {0x78, 0x56, 0x34, 0x12}},
                 {FORM_I32_LE, 4, -2, {0xFE, 0xFF, 0xFF, 0xFF}},
                 {FORM_M16_LE, 2, 1000, {0xE8, 0x03}},
                 {FORM_M16_LE, 2, -1000, {0xE8, 0x83}},
                 {FORM_M16_LE, 2, -32767, {0xFF, 0xFF}},
                 {FORM_M16_LE, 2, 32767, {0xFF, 0x7F}},
                 {FORM_M16_BIT10, 2, 1000, {0x03, 0xE8}},
                 {FORM_M16_BIT10, 2, -1000, {0x07, 0xE8}},
                 {FORM_M16_BIT10, 2, 0, {0x00, 0x00}},
                 {FORM_M16_BIT10, 2, -1, {0x04, 0x01}},
                 {FORM_M16_BIT10, 2, 1023, {0x03, 0xFF}},
                 {FORM_M16_BIT10, 2, -1023, {0x07, 0xFF}}};
    for (uint32_t i = 0; i < sizeof cases / sizeof cases[0]; i++) {
        uint8_t wire[4] = {0};
        CHECK(rtu_form_bytes(cases[i].form) == cases[i].bytes);
        rtu_write(wire, cases[i].form, cases[i].raw);
        CHECK(memcmp(wire, cases[i].wire, 4) == 0 && rtu_read(wire, cases[i].form) == cases[i].raw);
    }
    const uint8_t minus_zero[2] = {0x00, 0x80};
    CHECK(rtu_read(minus_zero, FORM_M16_LE) == 0);
    const uint8_t minus_zero_high_first[2] = {0x04, 0x00};
    CHECK(rtu_read(minus_zero_high_first, FORM_M16_BIT10) == 0);
    /* bits beyond the form are not zero, so a search for zero does not find them */
    const uint8_t beyond[2] = {0x08, 0x00}, beyond_below[2] = {0x0C, 0x01};
    CHECK(rtu_read(beyond, FORM_M16_BIT10) == 0x800 &&
          rtu_read(beyond_below, FORM_M16_BIT10) == -0x801);
    /* a counter of twelve bits continues below zero: -1 precedes 0 */
    const uint8_t below[2] = {0x01, 0x80};
    CHECK(((uint64_t)rtu_masked(rtu_read(below, FORM_M16_LE), 0xFFF, FORM_M16_LE) & 0xFFF) ==
          0xFFF);
}

static void a_status_is_never_taken_for_an_instruction(void)
{
    /* the read of two bytes and its answer have the same length and the same beginning */
    line_frame frame = {.request_bytes = 8,
                        .reply_bytes = 8,
                        .match_bytes = 4,
                        .match = {0xFF, 0xFF, 0x01, 0x04},
                        .request_seal = SEAL_SUM,
                        .reply_seal = SEAL_SUM,
                        .request = {0xFF, 0xFF, 0x01, 0x04, 0x02, 0x38, 0x02}};
    rtu_finish(&frame);
    CHECK(!rtu_answer_is_request(&frame, frame.request));
    uint8_t both[16];
    memcpy(both, frame.request, 8);
    /* so far it may be an echo */
    CHECK(rtu_find_answer(&frame, frame.request, 2, both, 8).kind == RECEIVED_MORE);
    memcpy(both + 8, (const uint8_t[]){0xFF, 0xFF, 0x01, 0x04, 0x00, 0x12, 0x03}, 7);
    rtu_seal(both + 8, 8, SEAL_SUM);
    received found = rtu_find_answer(&frame, frame.request, 2, both, 16);
    CHECK(found.kind == RECEIVED_ANSWER && found.offset == 8 && found.echoed == 1);
}

int main(void)
{
    check_sums_match_the_manual();
    the_shortest_packet_with_a_check_sum_has_four_bytes();
    a_status_is_found_whole_good_and_of_the_right_servo_only();
    an_error_number_is_a_refusal_and_an_alert_is_not();
    stuffing_is_added_and_removed();
    a_head_is_stuffed_between_length_and_check_sum_only();
    a_first_byte_is_never_removed_as_stuffing();
    the_longest_packet_has_room_for_its_stuffing();
    a_packet_without_an_error_number_is_not_a_status();
    values_are_low_byte_first_except_in_one_series();
    a_status_is_never_taken_for_an_instruction();
    return checks_report("servo packets");
}
