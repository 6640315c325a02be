/* SPDX-License-Identifier: Apache-2.0
 * test_board_frame: frames of docs/mcu-frame.md, built and parsed, and input that is not a frame.
 * Each buffer has the length of its content, so that a sanitizer sees an access beyond it. */
#include <stdlib.h>
#include <string.h>

#include "board_machine.h"
#include "check.h"

enum { CRC_BYTES = 2, TYPE = 0x81 };

/* CRC-16/IBM-3740 in the catalogue of reveng.sourceforge.io, whose check value is 0x29B1. */
static uint16_t crc_of(const uint8_t *data, uint32_t count)
{
    uint16_t crc = 0xFFFF;
    for (uint32_t bit = 0; bit < 8 * count; bit++) {
        bool one = (data[bit / 8] >> (7 - bit % 8) & 1) != (crc >> 15);
        crc = (uint16_t)(crc << 1 ^ (one ? 0x1021 : 0));
    }
    return crc;
}

static void seal(uint8_t *raw, uint32_t body)
{
    uint16_t crc = crc_of(raw, body);
    raw[body] = (uint8_t)crc, raw[body + 1] = (uint8_t)(crc >> 8);
}

/* Stuffs a frame of any length: one block for each stretch without a zero. */
static uint32_t stuffed_of(const uint8_t *raw, uint32_t count, uint8_t *out)
{
    uint32_t at = 0, begin = 0;
    for (uint32_t i = 0; i <= count; i++) {
        if (i == count || raw[i] == 0) {
            out[at++] = (uint8_t)(i - begin + 1);
            memcpy(out + at, raw + begin, i - begin);
            at += i - begin;
            begin = i + 1;
        }
    }
    return at;
}

static uint32_t parsed(const uint8_t *stuffed, uint32_t count, uint8_t *raw)
{
    uint8_t *in = malloc(count > 0 ? count : 1), *out = calloc(1, BOARD_FRAME_MAX);
    memcpy(in, stuffed, count);
    uint32_t body = board_frame_parse(in, count, out);
    if (raw != NULL) {
        memcpy(raw, out, BOARD_FRAME_MAX);
    }
    free(in);
    free(out);
    return body;
}

static uint32_t read_back(const uint8_t *raw, uint32_t count)
{
    uint8_t stuffed[2 * 256];
    return parsed(stuffed, stuffed_of(raw, count, stuffed), NULL);
}

/* Makes a frame without a zero in head, payload and check sum. */
static uint32_t without_zeros(uint8_t *raw, uint32_t count)
{
    memset(raw, 0x55, count);
    raw[0] = 1;
    do {
        raw[1]++;
        seal(raw, count - CRC_BYTES);
    } while (memchr(raw, 0, count) != NULL);
    return count;
}

static void a_built_frame_is_head_payload_and_check_sum_between_zeros(void)
{
    const uint8_t payload[] = {7, 0, 9};
    uint8_t wire[BOARD_WIRE_MAX], raw[BOARD_FRAME_MAX];
    uint32_t count = board_frame_build(TYPE, 0xA1234, 0x89ABCDEF, payload, sizeof payload, wire);
    const uint8_t expected[] = {1, TYPE, 0x34, 0x12, 0xEF, 0xCD, 0xAB, 0x89, 7, 0, 9};
    CHECK(wire[0] == 0 && wire[count - 1] == 0 && memchr(wire + 1, 0, count - 2) == NULL);
    CHECK(parsed(wire + 1, count - 2, raw) == sizeof expected);
    CHECK(memcmp(raw, expected, sizeof expected) == 0);
    uint16_t crc = (uint16_t)(raw[sizeof expected] | raw[sizeof expected + 1] << 8);
    CHECK(crc == crc_of(expected, sizeof expected));
    CHECK(crc_of((const uint8_t *)"123456789", 9) == 0x29B1);
}

static void a_payload_is_at_most_as_long_as_a_frame_has_room_for(void)
{
    uint8_t payload[BOARD_PAYLOAD_MAX + 1], wire[BOARD_WIRE_MAX], raw[BOARD_FRAME_MAX];
    for (uint32_t i = 0; i < sizeof payload; i++) {
        payload[i] = (uint8_t)(i % 5);
    }
    uint32_t count = board_frame_build(TYPE, 1, 1, payload, BOARD_PAYLOAD_MAX, wire);
    CHECK(count > 0 && parsed(wire + 1, count - 2, raw) == BOARD_FRAME_MAX - CRC_BYTES);
    CHECK(memcmp(raw + BOARD_HEAD_BYTES, payload, BOARD_PAYLOAD_MAX) == 0);
    CHECK(board_frame_build(TYPE, 1, 1, payload, BOARD_PAYLOAD_MAX + 1, wire) == 0);
    count = board_frame_build(TYPE, 1, 1, payload, 0, wire);
    CHECK(parsed(wire + 1, count - 2, NULL) == BOARD_HEAD_BYTES);
}

static void a_truncated_or_damaged_frame_is_refused(void)
{
    uint8_t raw[BOARD_FRAME_MAX], stuffed[2 * 256];
    uint32_t count = without_zeros(raw, 40);
    raw[20] = 0; /* the zero makes two blocks of it */
    seal(raw, 38);
    uint32_t all = stuffed_of(raw, count, stuffed);
    CHECK(parsed(stuffed, all, NULL) == 38);
    for (uint32_t bytes = 0; bytes < all; bytes++) {
        CHECK(parsed(stuffed, bytes, NULL) == 0);
    }
    for (uint32_t at = 0; at < all; at++) {
        uint8_t kept = stuffed[at];
        stuffed[at] = 0;
        CHECK(parsed(stuffed, all, NULL) == 0);
        stuffed[at] = (uint8_t)(kept ^ 0x10);
        CHECK(parsed(stuffed, all, NULL) == 0);
        stuffed[at] = kept;
    }
}

/* Also a frame with a correct check sum is refused: a zero ends a frame. */
static void a_zero_within_a_block_ends_the_frame(void)
{
    uint8_t raw[BOARD_FRAME_MAX], stuffed[256];
    uint32_t count = without_zeros(raw, 40);
    raw[20] = 0;
    seal(raw, 38);
    stuffed[0] = (uint8_t)(count + 1);
    memcpy(stuffed + 1, raw, count);
    CHECK(parsed(stuffed, count + 1, NULL) == 0);
}

static void a_frame_that_is_too_long_is_refused(void)
{
    uint8_t raw[256];
    CHECK(read_back(raw, without_zeros(raw, BOARD_FRAME_MAX)) == BOARD_FRAME_MAX - CRC_BYTES);
    for (uint32_t count = BOARD_FRAME_MAX + 1; count < 250; count++) {
        CHECK(read_back(raw, without_zeros(raw, count)) == 0);
        for (uint32_t zero = BOARD_FRAME_MAX - 2; zero < count - CRC_BYTES; zero++) {
            raw[zero] = 0;
            seal(raw, count - CRC_BYTES);
            CHECK(read_back(raw, count) == 0);
            raw[zero] = 0x55;
        }
    }
}

static void a_frame_without_a_whole_head_or_of_another_version_is_refused(void)
{
    uint8_t raw[BOARD_FRAME_MAX];
    for (uint32_t count = 5; count < BOARD_HEAD_BYTES + CRC_BYTES; count++) {
        CHECK(read_back(raw, without_zeros(raw, count)) == 0);
    }
    uint32_t count = without_zeros(raw, BOARD_HEAD_BYTES + CRC_BYTES);
    CHECK(read_back(raw, count) == BOARD_HEAD_BYTES);
    raw[0] = 2;
    seal(raw, BOARD_HEAD_BYTES);
    CHECK(read_back(raw, count) == 0);
}

int main(void)
{
    a_built_frame_is_head_payload_and_check_sum_between_zeros();
    a_payload_is_at_most_as_long_as_a_frame_has_room_for();
    a_truncated_or_damaged_frame_is_refused();
    a_zero_within_a_block_ends_the_frame();
    a_frame_that_is_too_long_is_refused();
    a_frame_without_a_whole_head_or_of_another_version_is_refused();
    return checks_report("test_board_frame");
}
