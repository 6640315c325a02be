/* SPDX-License-Identifier: Apache-2.0
 * board_packets.c: packets that boards of other makers take and send.
 *
 * The hoverboard FOC firmware (EFeru/hoverboard-firmware-hack-FOC, Src/util.c and Src/main.c):
 * words of 16 bits, low byte first; a start word, and the exclusive or of all words before it at
 * the end. The Sabertooth's packet serial (Dimension Engineering, Sabertooth 2x12 and 2x25
 * user's guides, mode 4): address, command, value, and the low seven bits of their sum. */
#include <string.h>

#include "board_machine.h"

/* --------------------------------------------------------------------------- hoverboard */
enum { START_WORD = 0xABCD, WORD_BYTES = 2 };

static const board_place LEFT = {.byte = 0, .bytes = 2, .is_signed = 1},
                         RIGHT = {.byte = 2, .bytes = 2, .is_signed = 1};

static uint16_t word_at(const uint8_t *bytes, uint32_t byte)
{
    return (uint16_t)(bytes[byte] | bytes[byte + 1] << 8);
}

static void put_word(uint8_t *bytes, uint32_t byte, int64_t word)
{
    board_put(bytes, &(board_place){.byte = byte, .bytes = WORD_BYTES}, word);
}

static uint16_t sum_of(const uint8_t *bytes, uint32_t count)
{
    uint16_t sum = 0;
    for (uint32_t byte = 0; byte < count; byte += WORD_BYTES) {
        sum ^= word_at(bytes, byte);
    }
    return sum;
}

static int64_t held(int64_t value, int64_t most)
{
    return value > most ? most : value < -most ? -most : value;
}

/* Build a command. The firmware's mixer has its default coefficients (1 and 0.5): left = speed +
 * steer / 2, right = speed - steer / 2. */
uint32_t board_hoverboard_build(const uint8_t *payload, uint32_t mixed, uint8_t *out)
{
    int64_t left = board_get(payload, &LEFT), right = board_get(payload, &RIGHT);
    put_word(out, 0, START_WORD);
    put_word(out, 2, held(mixed != 0 ? left - right : left, HOVERBOARD_SETPOINT_MAX));
    put_word(out, 4, held(mixed != 0 ? (left + right) / 2 : right, HOVERBOARD_SETPOINT_MAX));
    put_word(out, 6, sum_of(out, 6));
    return HOVERBOARD_COMMAND_BYTES;
}

static bool may_begin(const hoverboard_tail *tail)
{
    const uint8_t first = START_WORD & 0xFF, second = START_WORD >> 8;
    return tail->count == 0 ||
           (tail->bytes[0] == first && (tail->count == 1 || tail->bytes[1] == second));
}

/* Whether the values contain the start word. The end of a frame and the beginning of an equal one
 * have a good sum, too: it is the sum of the same words. But they contain the start word, and no
 * value comes near it: a set-point is 1000 at most, and speeds, voltages and temperatures are
 * small. */
static bool has_start_within(const uint8_t *values)
{
    for (uint32_t i = 0; i + 1 < HOVERBOARD_VALUE_BYTES; i++) {
        if (values[i] == (START_WORD & 0xFF) && values[i + 1] == START_WORD >> 8) {
            return true;
        }
    }
    return false;
}

static bool is_feedback(const hoverboard_tail *tail)
{
    const uint32_t body = HOVERBOARD_FEEDBACK_BYTES - WORD_BYTES;
    return tail->count == HOVERBOARD_FEEDBACK_BYTES &&
           sum_of(tail->bytes, body) == word_at(tail->bytes, body) &&
           !has_start_within(tail->bytes + WORD_BYTES);
}

/* Take a byte. Bytes that begin no good frame are dropped one by one: a frame may begin among
 * them. */
uint32_t board_hoverboard_take(hoverboard_tail *tail, uint8_t byte, uint8_t *values)
{
    tail->bytes[tail->count++] = byte;
    if (is_feedback(tail)) {
        memcpy(values, tail->bytes + WORD_BYTES, HOVERBOARD_VALUE_BYTES);
        tail->count = 0;
        tail->synced = 1;
        return HOVERBOARD_FEEDBACK;
    }
    bool dropped = tail->count == HOVERBOARD_FEEDBACK_BYTES;
    if (dropped) {
        memmove(tail->bytes, tail->bytes + 1, --tail->count);
    }
    while (!may_begin(tail)) {
        memmove(tail->bytes, tail->bytes + 1, --tail->count);
        dropped = true;
    }
    bool lost = dropped && tail->synced != 0;
    tail->synced = dropped ? 0 : tail->synced;
    return lost ? HOVERBOARD_BAD : HOVERBOARD_NOTHING;
}

/* --------------------------------------------------------------------------- Sabertooth */
enum {
    FORWARD_1 = 0,
    BACKWARD_1 = 1,
    FORWARD_2 = 4,
    BACKWARD_2 = 5,
    SERIAL_TIMEOUT = 14,
    SEVEN_BITS = 0x7F
};

static uint32_t put_packet(uint32_t unit, uint32_t command, int64_t value, uint8_t *out)
{
    out[0] = (uint8_t)unit;
    out[1] = (uint8_t)command;
    out[2] = (uint8_t)value;
    out[3] = (uint8_t)((out[0] + out[1] + out[2]) & SEVEN_BITS);
    return SABERTOOTH_PACKET_BYTES;
}

static uint32_t put_motor(uint32_t unit, uint32_t forward, uint32_t backward, int64_t value,
                          uint8_t *out)
{
    int64_t inside = held(value, SEVEN_BITS);
    return put_packet(unit, inside < 0 ? backward : forward, inside < 0 ? -inside : inside, out);
}

/* Build the packets. The time-out is lost with the driver's power, which nothing would show: so it
 * goes out with every set-point. */
uint32_t board_sabertooth_build(uint32_t unit, const uint8_t *payload, uint8_t *out)
{
    const board_place first = {.byte = 1, .bytes = 1, .is_signed = 1},
                      second = {.byte = 2, .bytes = 1, .is_signed = 1};
    uint32_t count =
        payload[0] != 0 ? put_packet(unit, SERIAL_TIMEOUT, held(payload[0], SEVEN_BITS), out) : 0;
    count += put_motor(unit, FORWARD_1, BACKWARD_1, board_get(payload, &first), out + count);
    return count + put_motor(unit, FORWARD_2, BACKWARD_2, board_get(payload, &second), out + count);
}
