/* SPDX-License-Identifier: Apache-2.0 */
#include "rtu.h"

#include <string.h>

enum { EXCEPTION_BYTES = 5, EXCEPTION_BIT = 0x80, BYTE_BITS = 8 };
/* Bytes of Dynamixel protocol 2.0: head, instruction, error number. */
enum {
    LENGTH_BYTE = 5,
    INSTRUCTION_BYTE = 7,
    ERROR_BYTE = 8,
    STATUS_BYTES_MIN = 11,
    STATUS = 0x55,
    ERROR_NUMBER = 0x7F
};

/* Tables for a nibble at a time: 16 entries stay in one cache line. */
static const uint16_t CRC16_NIBBLE[16] = {
    0x0000, 0xCC01, 0xD801, 0x1400, 0xF001, 0x3C00, 0x2800, 0xE401,
    0xA001, 0x6C00, 0x7800, 0xB401, 0x5000, 0x9C01, 0x8801, 0x4400,
};
static const uint8_t CRC8_NIBBLE[16] = {
    0x00, 0x9D, 0x23, 0xBE, 0x46, 0xDB, 0x65, 0xF8, 0x8C, 0x11, 0xAF, 0x32, 0xCA, 0x57, 0xE9, 0x74,
};

uint16_t rtu_crc16(const uint8_t *bytes, uint32_t count)
{
    uint32_t crc = 0xFFFF;
    for (uint32_t n = 0; n < count; n++) {
        crc ^= bytes[n];
        crc = crc >> 4 ^ CRC16_NIBBLE[crc & 15];
        crc = crc >> 4 ^ CRC16_NIBBLE[crc & 15];
    }
    return (uint16_t)crc;
}

uint8_t rtu_crc8(const uint8_t *bytes, uint32_t count)
{
    uint32_t crc = 0;
    for (uint32_t n = 0; n < count; n++) {
        crc ^= bytes[n];
        crc = crc >> 4 ^ CRC8_NIBBLE[crc & 15];
        crc = crc >> 4 ^ CRC8_NIBBLE[crc & 15];
    }
    return (uint8_t)crc;
}

static uint16_t crc_high_first(uint32_t polynomial, uint16_t start, const uint8_t *bytes,
                               uint32_t count)
{
    uint32_t crc = start;
    for (uint32_t n = 0; n < count; n++) {
        crc ^= (uint32_t)bytes[n] << BYTE_BITS;
        for (uint32_t bit = 0; bit < BYTE_BITS; bit++) {
            crc = (crc & 0x8000) != 0 ? crc << 1 ^ polynomial : crc << 1;
        }
    }
    return (uint16_t)crc;
}

uint16_t rtu_xmodem(uint16_t start, const uint8_t *bytes, uint32_t count)
{
    return crc_high_first(0x1021, start, bytes, count);
}

uint16_t rtu_crc16_high_first(const uint8_t *bytes, uint32_t count)
{
    return crc_high_first(0x8005, 0, bytes, count);
}

static uint8_t inverted_sum(const uint8_t *bytes, uint32_t count)
{
    uint32_t sum = 0;
    for (uint32_t n = 0; n < count; n++) {
        sum += bytes[n];
    }
    return (uint8_t)~sum;
}

uint32_t rtu_seal_bytes(uint32_t seal)
{
    return seal == SEAL_NONE ? 0 : seal == SEAL_CRC8 || seal == SEAL_SUM ? 1 : 2;
}

void rtu_seal(uint8_t *frame, uint32_t count, uint32_t seal)
{
    if (seal == SEAL_CRC16) {
        uint16_t crc = rtu_crc16(frame, count - 2);
        frame[count - 2] = (uint8_t)(crc & 0xFF);
        frame[count - 1] = (uint8_t)(crc >> BYTE_BITS);
    } else if (seal == SEAL_CRC8) {
        frame[count - 1] = rtu_crc8(frame, count - 1);
    } else if (seal == SEAL_XMODEM) {
        rtu_write(frame + count - 2, FORM_U16, rtu_xmodem(0, frame, count - 2));
    } else if (seal == SEAL_SUM) {
        frame[count - 1] = inverted_sum(frame + 2, count - 3);
    } else if (seal == SEAL_STUFFED) {
        rtu_write(frame + count - 2, FORM_U16_LE, rtu_crc16_high_first(frame, count - 2));
    }
}

bool rtu_is_sealed(const uint8_t *frame, uint32_t count, uint32_t seal)
{
    if (seal == SEAL_CRC16) {
        uint32_t crc = rtu_crc16(frame, count - 2);
        return crc == ((uint32_t)frame[count - 2] | (uint32_t)frame[count - 1] << BYTE_BITS);
    }
    if (seal == SEAL_SUM) {
        return count > 3 && frame[count - 1] == inverted_sum(frame + 2, count - 3);
    }
    if (seal == SEAL_STUFFED) {
        return rtu_read(frame + count - 2, FORM_U16_LE) == rtu_crc16_high_first(frame, count - 2);
    }
    return seal != SEAL_CRC8 || frame[count - 1] == rtu_crc8(frame, count - 1);
}

uint32_t rtu_sign_of(uint32_t form)
{
    return form == FORM_M16_LE ? UINT32_C(1) << 15 : form == FORM_M16_BIT10 ? UINT32_C(1) << 10 : 0;
}

uint32_t rtu_form_bytes(uint32_t form)
{
    bool two =
        form <= FORM_I16 || form == FORM_U16_LE || form == FORM_I16_LE || rtu_sign_of(form) != 0;
    return form <= FORM_I8 ? 1 : two ? 2 : 4;
}

static bool is_signed(uint32_t form)
{
    return (form & 1) != 0;
}

static int64_t with_sign(uint64_t raw, uint32_t bits)
{
    uint64_t top = UINT64_C(1) << (bits - 1);
    return (int64_t)(raw ^ top) - (int64_t)top;
}

/* Return the place of the n-th byte, counted from the highest one. */
static uint32_t place(uint32_t form, uint32_t n)
{
    bool high_first = form < FORM_U32_LOW_FIRST || form == FORM_M16_BIT10;
    return high_first ? n : form >= FORM_U16_LE ? rtu_form_bytes(form) - 1 - n : n ^ 2;
}

int64_t rtu_read(const uint8_t *bytes, uint32_t form)
{
    uint32_t count = rtu_form_bytes(form);
    uint64_t raw = 0;
    for (uint32_t n = 0; n < count; n++) {
        raw = raw << BYTE_BITS | bytes[place(form, n)];
    }
    uint64_t sign = rtu_sign_of(form);
    if (sign != 0) {
        return (raw & sign) != 0 ? -(int64_t)(raw & ~sign) : (int64_t)raw;
    }
    return is_signed(form) ? with_sign(raw, count * BYTE_BITS) : (int64_t)raw;
}

void rtu_write(uint8_t *bytes, uint32_t form, int64_t raw)
{
    uint64_t sign = rtu_sign_of(form);
    uint64_t left = sign != 0 && raw < 0 ? (uint64_t)-raw | sign : (uint64_t)raw;
    for (uint32_t n = rtu_form_bytes(form); n > 0; n--) {
        bytes[place(form, n - 1)] = (uint8_t)(left & 0xFF);
        left >>= BYTE_BITS;
    }
}

int64_t rtu_masked(int64_t raw, uint32_t mask, uint32_t form)
{
    if (mask == 0) {
        return raw;
    }
    uint64_t value = ((uint64_t)raw & mask) >> __builtin_ctz(mask);
    return is_signed(form) ? with_sign(value, (uint32_t)__builtin_popcount(mask)) : (int64_t)value;
}

static bool begins_as_answer(const line_frame *frame, const uint8_t *request, const uint8_t *bytes)
{
    return frame->echo_bytes > 0 ? memcmp(bytes, request, frame->echo_bytes) == 0
                                 : memcmp(bytes, frame->match, frame->match_bytes) == 0;
}

static bool is_answer(const line_frame *frame, const uint8_t *request, const uint8_t *bytes)
{
    if (frame->reply_seal == SEAL_WITH_REQUEST) {
        uint32_t count = frame->reply_bytes - 2;
        return rtu_read(bytes + count, FORM_U16) ==
               rtu_xmodem(rtu_xmodem(0, request, 2), bytes, count);
    }
    return begins_as_answer(frame, request, bytes) &&
           rtu_is_sealed(bytes, frame->reply_bytes, frame->reply_seal);
}

static bool is_exception(const line_frame *frame, const uint8_t *request, const uint8_t *bytes)
{
    return frame->has_exceptions != 0 && frame->reply_seal != SEAL_STUFFED &&
           bytes[0] == request[0] && bytes[1] == (request[1] | EXCEPTION_BIT) &&
           rtu_is_sealed(bytes, EXCEPTION_BYTES, SEAL_CRC16);
}

bool rtu_answer_is_request(const line_frame *frame, const uint8_t *request)
{
    /* a status never looks like an instruction */
    bool differs = frame->reply_seal == SEAL_SUM || frame->reply_seal == SEAL_STUFFED;
    return !differs && frame->reply_bytes == frame->request_bytes &&
           is_answer(frame, request, request);
}

/* Find whether a status packet with this head is here, whole and good; MORE: it is not. */
static received status_at(const line_frame *frame, uint32_t at, const uint8_t *bytes, uint32_t left)
{
    received found = {.kind = RECEIVED_MORE};
    if (left < STATUS_BYTES_MIN || memcmp(bytes, frame->match, frame->match_bytes) != 0 ||
        bytes[INSTRUCTION_BYTE] != STATUS) {
        return found;
    }
    uint8_t plain[FRAME_BYTES_MAX];
    uint32_t whole = (uint32_t)rtu_read(bytes + LENGTH_BYTE, FORM_U16_LE) + INSTRUCTION_BYTE;
    if (whole < STATUS_BYTES_MIN || whole > left || !rtu_is_sealed(bytes, whole, SEAL_STUFFED)) {
        return found;
    }
    uint32_t error = bytes[ERROR_BYTE] & ERROR_NUMBER;
    if (error != 0 && frame->has_exceptions != 0) {
        return (received){
            .kind = RECEIVED_REFUSED, .offset = at, .bytes = whole, .exception = error};
    }
    bool good = error == 0 && rtu_unstuff(bytes, whole, plain) == frame->reply_bytes;
    return good ? (received){.kind = RECEIVED_ANSWER, .offset = at, .bytes = whole} : found;
}

received rtu_hunt(const line_frame *frame, const uint8_t *request, uint32_t from,
                  const uint8_t *bytes, uint32_t count)
{
    for (uint32_t at = from; at < count; at++) {
        uint32_t left = count - at;
        if (frame->reply_seal == SEAL_STUFFED) {
            received status = status_at(frame, at, bytes + at, left);
            if (status.kind != RECEIVED_MORE) {
                return status;
            }
            continue;
        }
        if (left >= frame->reply_bytes && is_answer(frame, request, bytes + at)) {
            return (received){.kind = RECEIVED_ANSWER, .offset = at, .bytes = frame->reply_bytes};
        }
        if (left >= EXCEPTION_BYTES && is_exception(frame, request, bytes + at)) {
            return (received){.kind = RECEIVED_REFUSED,
                              .offset = at,
                              .bytes = EXCEPTION_BYTES,
                              .exception = bytes[at + 2]};
        }
    }
    return (received){.kind = RECEIVED_MORE};
}

/* Whether the bytes would look like a head: after FF FF FD between the length and the check sum,
 * one more FD follows (ROBOTIS e-Manual, DYNAMIXEL Protocol 2.0, packet process). */
static bool is_like_a_head(const uint8_t *bytes, uint32_t at)
{
    return at >= INSTRUCTION_BYTE + 2 && bytes[at] == 0xFD && bytes[at - 1] == 0xFF &&
           bytes[at - 2] == 0xFF;
}

uint32_t rtu_unstuff(const uint8_t *wire, uint32_t count, uint8_t *out)
{
    uint32_t to = 0;
    for (uint32_t at = 0; at < count; at++) {
        if (to == FRAME_BYTES_MAX) {
            return 0;
        }
        bool extra = at + 2 < count && at > 0 && wire[at] == 0xFD && is_like_a_head(wire, at - 1);
        if (!extra) {
            out[to++] = wire[at];
        }
    }
    return to;
}

void rtu_finish(line_frame *frame)
{
    if (frame->request_seal == SEAL_STUFFED) {
        uint8_t plain[FRAME_BYTES_MAX];
        uint32_t body = frame->request_bytes - 2, to = 0;
        memcpy(plain, frame->request, body);
        for (uint32_t at = 0; at < body && to < FRAME_BYTES_MAX - 3; at++) {
            frame->request[to++] = plain[at];
            if (is_like_a_head(plain, at)) {
                frame->request[to++] = 0xFD;
            }
        }
        frame->request_bytes = to + 2;
        rtu_write(frame->request + LENGTH_BYTE, FORM_U16_LE,
                  frame->request_bytes - INSTRUCTION_BYTE);
    }
    rtu_seal(frame->request, frame->request_bytes, frame->request_seal);
}

/* Find a reply that does not identify its request: it must be all that came. */
static received whole(const line_frame *frame, const uint8_t *request, const uint8_t *bytes,
                      uint32_t count)
{
    if (count < frame->reply_bytes) {
        return (received){.kind = RECEIVED_MORE};
    }
    bool good = count == frame->reply_bytes && is_answer(frame, request, bytes);
    return (received){.kind = good ? RECEIVED_ANSWER : RECEIVED_BAD, .bytes = good ? count : 0};
}

received rtu_find_answer(const line_frame *frame, const uint8_t *request, uint32_t echo,
                         const uint8_t *bytes, uint32_t count)
{
    if (frame->exact != 0) {
        return whole(frame, request, bytes, count);
    }
    uint32_t sent = frame->request_bytes;
    uint32_t same = count < sent ? count : sent;
    bool comes_back = memcmp(bytes, request, same) == 0;
    if (echo == 1 && !comes_back) {
        return (received){.kind = RECEIVED_BAD};
    }
    /* if it is unknown whether there is an echo, bytes that equal the request are an answer only
     * when they come twice */
    bool passes = echo != 0 && comes_back;
    received found = rtu_hunt(frame, request, passes ? sent : 0, bytes, count);
    found.echoed = comes_back && found.offset >= sent;
    return found;
}
