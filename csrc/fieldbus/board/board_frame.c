/* SPDX-License-Identifier: Apache-2.0
 * board_frame.c: frames of docs/mcu-frame.md: head, payload, check sum, stuffed between zeros. */
#include <string.h>

#include "board_machine.h"

enum { VERSION = 1, CRC_BYTES = 2 };

/* Return the CRC-16/IBM-3740: polynomial 0x1021, not reflected, start 0xFFFF. */
static uint16_t crc16(const uint8_t *data, uint32_t count)
{
    uint32_t crc = 0xFFFF;
    for (uint32_t i = 0; i < count; i++) {
        crc ^= (uint32_t)data[i] << 8;
        for (uint32_t bit = 0; bit < 8; bit++) {
            crc = (crc & 0x8000) != 0 ? crc << 1 ^ 0x1021 : crc << 1;
        }
    }
    return (uint16_t)crc;
}

/* Stuff less than 254 bytes (consistent overhead byte stuffing: Cheshire & Baker, 1999): one byte
 * more. */
static uint32_t stuff(const uint8_t *data, uint32_t count, uint8_t *out)
{
    uint32_t code = 0, at = 1;
    for (uint32_t i = 0; i < count; i++) {
        if (data[i] == 0) {
            out[code] = (uint8_t)(at - code);
            code = at++;
        } else {
            out[at++] = data[i];
        }
    }
    out[code] = (uint8_t)(at - code);
    return at;
}

/* Undo the stuffing. Returns 0 if the data are not stuffed, or longer than a frame. */
static uint32_t unstuff(const uint8_t *data, uint32_t count, uint8_t *out)
{
    uint32_t from = 0, to = 0;
    while (from < count) {
        uint32_t code = data[from];
        bool fits = code > 0 && code <= count - from && to + code - 1 <= BOARD_FRAME_MAX;
        if (!fits || memchr(data + from, 0, code) != NULL) {
            return 0;
        }
        memcpy(out + to, data + from + 1, code - 1);
        to += code - 1;
        from += code;
        if (from < count && to == BOARD_FRAME_MAX) {
            return 0;
        }
        if (from < count) {
            out[to++] = 0;
        }
    }
    return to;
}

uint32_t board_frame_build(uint32_t type, uint32_t sequence, uint32_t time_us,
                           const uint8_t *payload, uint32_t payload_bytes, uint8_t *out)
{
    uint8_t raw[BOARD_FRAME_MAX];
    if (payload_bytes > BOARD_PAYLOAD_MAX) {
        return 0;
    }
    raw[0] = VERSION;
    raw[1] = (uint8_t)type;
    board_put(raw, &(board_place){.byte = 2, .bytes = 2}, sequence & 0xFFFF);
    board_put(raw, &(board_place){.byte = 4, .bytes = 4}, time_us);
    memcpy(raw + BOARD_HEAD_BYTES, payload, payload_bytes);
    uint32_t count = BOARD_HEAD_BYTES + payload_bytes;
    board_put(raw, &(board_place){.byte = count, .bytes = CRC_BYTES}, crc16(raw, count));
    out[0] = 0; /* ends noise that came before */
    uint32_t stuffed = stuff(raw, count + CRC_BYTES, out + 1);
    out[1 + stuffed] = 0;
    return stuffed + 2;
}

uint32_t board_frame_parse(const uint8_t *stuffed, uint32_t count, uint8_t *out)
{
    uint32_t raw = unstuff(stuffed, count, out);
    if (raw < BOARD_HEAD_BYTES + CRC_BYTES || out[0] != VERSION) {
        return 0;
    }
    uint32_t body = raw - CRC_BYTES;
    uint16_t stated = (uint16_t)board_get(out, &(board_place){.byte = body, .bytes = CRC_BYTES});
    return stated == crc16(out, body) ? body : 0;
}
