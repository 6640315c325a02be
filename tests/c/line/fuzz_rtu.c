/* SPDX-License-Identifier: Apache-2.0
 * fuzz_rtu.c: for any received bytes, an answer that is found is valid: it begins correctly, it is
 * complete, and its check sum, computed by another algorithm, is right. A good answer after any
 * garbage is found. */
#include "check.h"
#include "rtu.h"

#include <string.h>

#define FUZZ_NAME "fuzz_rtu"
enum { FUZZ_MAX = 160 };

static bool sealed(const uint8_t *frame, uint32_t count, uint32_t seal)
{
    uint32_t crc = seal == SEAL_CRC16 ? 0xFFFF : 0;
    uint32_t covered = count - (seal == SEAL_CRC16 ? 2 : 1);
    for (uint32_t i = 0; i < covered; i++) {
        crc ^= frame[i];
        for (int bit = 0; bit < 8; bit++) {
            crc = (crc & 1) != 0 ? crc >> 1 ^ (seal == SEAL_CRC16 ? 0xA001U : 0x8CU) : crc >> 1;
        }
    }
    return seal == SEAL_CRC16 ? frame[covered] == (crc & 0xFF) && frame[covered + 1] == crc >> 8
                              : frame[covered] == crc;
}

static line_frame frame_of(const uint8_t *data)
{
    line_frame frame = {.request_seal = data[0] & 1 ? SEAL_CRC16 : SEAL_CRC8,
                        .has_exceptions = data[0] >> 1 & 1};
    frame.reply_seal = frame.request_seal;
    frame.request_bytes = 4 + data[1] % 16;
    frame.reply_bytes = data[0] & 4 ? frame.request_bytes : 4U + data[2] % 24;
    frame.echo_bytes =
        data[0] & 8 ? 1 + data[3] % (frame.request_bytes < frame.reply_bytes ? frame.request_bytes
                                                                             : frame.reply_bytes)
                    : 0;
    frame.match_bytes = 1 + data[3] % 3;
    memcpy(frame.match, data + 4, FRAME_MATCH_MAX);
    memcpy(frame.request, data + 12, frame.request_bytes);
    rtu_seal(frame.request, frame.request_bytes, frame.request_seal);
    return frame;
}

static void judge(const line_frame *frame, uint32_t echo, const uint8_t *bytes, uint32_t count,
                  received found)
{
    if (found.kind == RECEIVED_ANSWER) {
        const uint8_t *at = bytes + found.offset;
        CHECK(found.offset + frame->reply_bytes <= count);
        CHECK(memcmp(at, frame->echo_bytes > 0 ? frame->request : frame->match,
                     frame->echo_bytes > 0 ? frame->echo_bytes : frame->match_bytes) == 0);
        CHECK(sealed(at, frame->reply_bytes, frame->reply_seal));
    } else if (found.kind == RECEIVED_REFUSED) {
        const uint8_t *at = bytes + found.offset;
        CHECK(frame->has_exceptions && found.offset + 5 <= count);
        CHECK(at[0] == frame->request[0] && at[1] == (frame->request[1] | 0x80) &&
              at[2] == found.exception);
        CHECK(sealed(at, 5, SEAL_CRC16));
    }
    if (echo == 1 && found.kind != RECEIVED_BAD) {
        uint32_t same = count < frame->request_bytes ? count : frame->request_bytes;
        CHECK(memcmp(bytes, frame->request, same) == 0);
        CHECK(found.kind == RECEIVED_MORE || found.offset >= frame->request_bytes);
    }
    CHECK(found.kind != RECEIVED_BAD || echo == 1);
}

static void once(const uint8_t *given, size_t size)
{
    uint8_t data[FUZZ_MAX] = {0}, bytes[FUZZ_MAX + 64];
    memcpy(data, given, size);
    line_frame frame = frame_of(data);
    uint32_t echo = data[30] % 3, count = 0, garbage = data[31] % 40;
    if (data[32] & 1) {
        memcpy(bytes, frame.request, frame.request_bytes);
        count = frame.request_bytes;
    }
    memcpy(bytes + count, data + 40, garbage);
    count += garbage;
    uint32_t begin = count;
    if (data[32] & 2) {
        memcpy(bytes + count, data + 80, frame.reply_bytes);
        memcpy(bytes + count, frame.echo_bytes > 0 ? frame.request : frame.match,
               frame.echo_bytes > 0 ? frame.echo_bytes : frame.match_bytes);
        rtu_seal(bytes + count, frame.reply_bytes, frame.reply_seal);
        bool whole = frame.reply_bytes >
                     rtu_seal_bytes(frame.reply_seal) +
                         (frame.echo_bytes > 0 ? frame.echo_bytes : frame.match_bytes) - 1;
        count += frame.reply_bytes;
        received found = rtu_find_answer(&frame, frame.request, 0, bytes, count);
        CHECK(!whole || (found.kind != RECEIVED_MORE && found.offset <= begin));
    }
    for (uint32_t received_bytes = 0; received_bytes <= count; received_bytes += 1 + data[33] % 7) {
        judge(&frame, echo, bytes, received_bytes,
              rtu_find_answer(&frame, frame.request, echo, bytes, received_bytes));
    }
    /* at the very end of its memory: the sanitizer sees a read beyond it */
    static uint8_t room[FUZZ_MAX + 64];
    uint8_t *last = room + sizeof room - count;
    memcpy(last, bytes, count);
    judge(&frame, echo, last, count, rtu_find_answer(&frame, frame.request, echo, last, count));
    uint32_t form = data[34] % 8;
    int64_t raw = rtu_read(data + 35, form);
    uint8_t back[4];
    rtu_write(back, form, raw);
    CHECK(memcmp(back, data + 35, rtu_form_bytes(form)) == 0);
}

#include "fuzz.h"
