/* SPDX-License-Identifier: Apache-2.0
 * line_fast.c: the fast sync read of Dynamixel protocol 2.0. All servos answer in one packet, each
 * with a block of its own: error, unit, data, and the check sum of the packet so far. The first one
 * sends the head, with the length of the whole, so nothing is stuffed. A missing servo ends the
 * packet for those after it: then plain sync reads follow, which cost one head for each servo, and
 * work without it. Source: ROBOTIS e-Manual, DYNAMIXEL Protocol 2.0, fast sync read; dynamixel-sdk
 * 4.1, protocol2_packet_handler.py and group_sync_read.py. */
#include <string.h>

#include "line_machine.h"

enum {
    UNIT_BYTE = 4, /* position in a packet */
    LENGTH_BYTE = 5,
    INSTRUCTION_BYTE = 7,
    HEAD_BYTES = 8,
    STATUS = 0x55,
    STATUS_DATA_BYTE = 9, /* position in a servo's own status, whose size includes its check sum */
    STATUS_BYTES = 11,
    BLOCK_UNIT_BYTE = 1, /* position in a block */
    BLOCK_DATA_BYTE = 2,
    BLOCK_BYTES = 4, /* without data */
    ALL_UNITS = 0xFE,
    FAST_SYNC_READ = 0x8A,
    ERROR_NUMBER = 0x7F,
    READ_TURN = 1, /* cyclic[1] */
    PAUSE_LEAST = 16,
    PAUSE_MOST = 4096
};

static const line_frame *alone_of(const line_machine *m, uint32_t number)
{
    return &m->table.drive[number].cyclic[READ_TURN].frame;
}

/* Return the number of bytes that are read, which is the same for all servos. */
static uint32_t data_bytes(const line_machine *m)
{
    return alone_of(m, 0)->reply_bytes - STATUS_BYTES;
}

/* Return a packet's bytes up to the end of so many blocks. */
static uint32_t end_of(const line_machine *m, uint32_t blocks)
{
    return HEAD_BYTES + blocks * (BLOCK_BYTES + data_bytes(m));
}

bool line_fast_is_good(const line_table *table)
{
    const line_frame *first = &table->drive[0].cyclic[READ_TURN].frame;
    bool good =
        table->group.fast == 0 || (table->group.fast == 1 && first->reply_seal == SEAL_STUFFED);
    for (uint32_t i = 0; i < table->drive_count && table->group.fast != 0; i++) {
        const line_frame *frame = &table->drive[i].cyclic[READ_TURN].frame;
        good =
            good && frame->reply_bytes == first->reply_bytes && frame->reply_bytes >= STATUS_BYTES;
    }
    return good;
}

/* ------------------------------------------------------------------------------ sending */
bool line_fast_begins(const line_machine *m)
{
    return m->table.group.fast == 1 && m->plain_cycles == 0;
}

uint32_t line_fast_request(line_machine *m, line_frame *packet)
{
    packet->request[INSTRUCTION_BYTE] = FAST_SYNC_READ;
    return end_of(m, m->group.asked_count);
}

/* ---------------------------------------------------------------------------- receiving */
/* Return the beginning of the packet; received_bytes: it has not come yet. */
static uint32_t begin_of(const line_machine *m, uint32_t from, uint32_t whole)
{
    const line_transaction *t = &m->transaction;
    uint32_t length = whole - INSTRUCTION_BYTE;
    const uint8_t head[HEAD_BYTES] = {
        0xFF, 0xFF, 0xFD, 0, ALL_UNITS, (uint8_t)length, (uint8_t)(length >> 8), STATUS};
    for (uint32_t at = from; at + HEAD_BYTES <= t->received_bytes; at++) {
        if (memcmp(t->received + at, head, HEAD_BYTES) == 0) {
            return at;
        }
    }
    return t->received_bytes;
}

/* Take a block as if the servo had sent its own status. */
static void take_block(line_machine *m, uint32_t place, uint32_t at, int64_t now_ns)
{
    line_transaction *t = &m->transaction;
    uint32_t number = m->group.asked[place], count = data_bytes(m), end = end_of(m, place + 1);
    const uint8_t *block = t->received + at + end - BLOCK_BYTES - count;
    received found = {.kind = RECEIVED_ANSWER, .exception = block[0] & ERROR_NUMBER};
    memcpy(t->plain, t->received + at, HEAD_BYTES);
    t->plain[UNIT_BYTE] = block[BLOCK_UNIT_BYTE];
    t->plain[HEAD_BYTES] = block[0];
    memcpy(t->plain + STATUS_DATA_BYTE, block + BLOCK_DATA_BYTE, count);
    /* the head comes from the first servo */
    uint32_t first = place == 0 ? 0 : end - BLOCK_BYTES - count;
    m->group.taken[m->group.taken_count++] =
        (group_reply){.offset = at + first, .bytes = end - first};
    m->answers++;
    /* its last byte came as late as in a status of its own */
    m->group.answered_ns =
        (int64_t)((double)end * m->table.character_ns) - line_reply_ns(m, alone_of(m, number));
    line_group_end_member(m, number, found.exception == 0 ? ANSWER_OK : ANSWER_REFUSED, &found,
                          now_ns);
}

void line_fast_look(line_machine *m, uint32_t from, int64_t now_ns)
{
    const line_transaction *t = &m->transaction;
    uint32_t whole = end_of(m, m->group.asked_count);
    uint32_t at = begin_of(m, from, whole), came = t->received_bytes - at;
    /* the last check sum covers all blocks; the dynamixel-sdk checks no other */
    bool good = came >= whole && rtu_is_sealed(t->received + at, whole, SEAL_STUFFED);
    for (uint32_t i = 0; i < m->group.asked_count && end_of(m, i + 1) <= came; i++) {
        uint32_t number = m->group.asked[i], end = end_of(m, i + 1);
        bool waits = (m->group.waiting >> number & 1) != 0;
        uint8_t unit = t->received[at + end - BLOCK_BYTES - data_bytes(m) + BLOCK_UNIT_BYTE];
        bool sealed = good || rtu_is_sealed(t->received + at, end, SEAL_STUFFED);
        if (waits && sealed && unit == alone_of(m, number)->request[UNIT_BYTE]) {
            take_block(m, i, at, now_ns);
        }
    }
}

/* End a read. Servos without this instruction never answer it: it is tried less and less often. */
void line_fast_end(line_machine *m, bool all)
{
    if (m->table.group.fast == 0 || m->group.asked_count == 0) {
        return;
    }
    if (m->group.fast) {
        uint32_t longer = m->fast_pause == 0           ? PAUSE_LEAST
                          : m->fast_pause < PAUSE_MOST ? 2 * m->fast_pause
                                                       : PAUSE_MOST;
        m->fast_pause = m->plain_cycles = all ? 0 : longer;
    } else {
        m->plain_cycles = all ? m->plain_cycles - 1 : m->fast_pause;
    }
}
