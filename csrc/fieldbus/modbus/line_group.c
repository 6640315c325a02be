/* SPDX-License-Identifier: Apache-2.0
 * line_group.c: the cycle of bus servos. One request carries the set-points of all and reads all,
 * and each servo answers for itself. A servo that does not answer costs the others only the wait.
 * Nothing acknowledges a sync write: the next cycle, which comes in any case, repeats it, and stops
 * go to each drive alone. */
#include <string.h>

#include "line_machine.h"

enum { READ_TURN = 1 }; /* cyclic[1] */

/* Positions of unit and length (Feetech protocol 0; Dynamixel protocol 2.0). */
typedef struct {
    uint32_t unit;
    uint32_t length;
    uint32_t length_form;
} packet_form;

static packet_form form_of(uint32_t seal)
{
    return seal == SEAL_STUFFED ? (packet_form){.unit = 4, .length = 5, .length_form = FORM_U16_LE}
                                : (packet_form){.unit = 2, .length = 3, .length_form = FORM_U8};
}

static bool is_member(const line_machine *m, uint32_t number)
{
    return drive_is_cycled(&m->drive[number].state);
}

/* ------------------------------------------------------------------------------ sending */
/* Whether a drive gets set-points. One that rests without power needs none; one that does not
 * answer, and may turn, gets zero. */
static bool gets_setpoints(const line_machine *m, uint32_t number)
{
    const drive_state *state = &m->drive[number].state;
    if (!line_sends(m, number, 0)) {
        return false;
    }
    if (state->mode == DRIVE_UNRESPONSIVE) {
        return m->drive[number].may_turn;
    }
    bool rests = !state->stopping && !state->sent_motion && state->enabled != 1;
    return state->mode == DRIVE_ARMED || (state->mode == DRIVE_READY && !rests);
}

static bool is_asked(const line_machine *m, uint32_t number, int64_t now_ns)
{
    const line_drive_state *drive = &m->drive[number];
    return is_member(m, number) && drive->silent_until_ns <= now_ns &&
           drive->held_until_ns <= now_ns;
}

static void append(line_frame *to, const uint8_t *bytes, uint32_t count)
{
    memcpy(to->request + to->request_bytes, bytes, count);
    to->request_bytes += count;
}

static line_frame packet_of(const line_machine *m, const uint8_t *head, uint32_t count)
{
    line_frame packet = {.request_seal = m->table.drive[0].cyclic[0].frame.request_seal};
    append(&packet, head, count);
    return packet;
}

/* Set the packet's length, now that all drives are in it, and its seal. */
static void finish(line_frame *packet, uint32_t head_bytes)
{
    packet_form form = form_of(packet->request_seal);
    int64_t length = rtu_read(packet->request + form.length, form.length_form);
    rtu_write(packet->request + form.length, form.length_form,
              length + packet->request_bytes - head_bytes);
    packet->request_bytes += rtu_seal_bytes(packet->request_seal);
    rtu_finish(packet);
}

static void write_all(line_machine *m, line_frame *out)
{
    const line_group *group = &m->table.group;
    line_frame packet = packet_of(m, group->write, group->write_bytes);
    uint32_t unit = form_of(packet.request_seal).unit;
    for (uint32_t i = 0; i < m->table.drive_count; i++) {
        line_drive_state *drive = &m->drive[i];
        line_frame alone;
        drive->cycle_motion = false;
        if (!gets_setpoints(m, i)) {
            continue;
        }
        drive->cycle_motion = line_fill(m, i, 0, &alone);
        drive->state.sent_motion |= drive->cycle_motion;
        append(&packet, alone.request + unit, 1);
        uint32_t end = alone.request_bytes - rtu_seal_bytes(packet.request_seal);
        append(&packet, alone.request + group->data_byte, end - group->data_byte);
    }
    if (packet.request_bytes > group->write_bytes) {
        finish(&packet, group->write_bytes);
        append(out, packet.request, packet.request_bytes);
    }
}

static void read_all(line_machine *m, int64_t now_ns, line_frame *out)
{
    const line_group *group = &m->table.group;
    line_frame packet = packet_of(m, group->read, group->read_bytes);
    uint32_t unit = form_of(packet.request_seal).unit;
    for (uint32_t i = 0; i < m->table.drive_count; i++) {
        if (is_asked(m, i, now_ns)) {
            const line_frame *alone = &m->table.drive[i].cyclic[READ_TURN].frame;
            append(&packet, alone->request + unit, 1);
            out->reply_bytes += alone->reply_bytes;
            m->group.waiting |= 1U << i;
            m->group.asked[m->group.asked_count++] = (uint8_t)i;
        }
    }
    if (m->group.waiting != 0) {
        out->reply_bytes = m->group.fast ? line_fast_request(m, &packet) : out->reply_bytes;
        finish(&packet, group->read_bytes);
        append(out, packet.request, packet.request_bytes);
    }
}

/* Begin the drives' cycles. Their power is read at different times, so that their extra exchanges
 * do not come all at once. */
static void begin_members(line_machine *m, int64_t now_ns)
{
    for (uint32_t i = 0; i < m->table.drive_count; i++) {
        line_drive_state *drive = &m->drive[i];
        if (is_member(m, i)) {
            line_cycle_begin(m, i, now_ns);
            drive->stage = STAGE_IDLE;
            drive->extra_due = line_power_first(m, i) ||
                               (drive->cycle_count + i) % m->table.drive[i].extra_every == 0;
        }
    }
    m->current = LINE_DRIVES_MAX;
}

bool line_group_begin(line_machine *m, int64_t now_ns, line_frame *out)
{
    memset(&m->group, 0, sizeof m->group);
    *out = (line_frame){.request_bytes = 0};
    m->group.fast = line_fast_begins(m);
    begin_members(m, now_ns);
    write_all(m, out);
    read_all(m, now_ns, out);
    return out->request_bytes > 0;
}

int64_t line_group_wait_ns(const line_machine *m)
{
    int64_t longest_ns = 0;
    for (uint32_t i = 0; i < m->table.drive_count; i++) {
        int64_t wait_ns = line_deadline_ns(m, i);
        bool waits = (m->group.waiting >> i & 1) != 0;
        longest_ns = waits && wait_ns > longest_ns ? wait_ns : longest_ns;
    }
    return longest_ns;
}

/* ---------------------------------------------------------------------------- receiving */
/* Return the place where replies may begin: after the echo of the request, if there is one. */
static uint32_t first_byte(const line_machine *m)
{
    const line_transaction *t = &m->transaction;
    uint32_t sent = t->frame.request_bytes,
             same = t->received_bytes < sent ? t->received_bytes : sent;
    return m->echo != ECHO_NONE && memcmp(t->received, t->frame.request, same) == 0 ? sent : 0;
}

/* Count the exchange, for this time, as one of this drive, with its own request and its wait for
 * the wire. */
void line_group_end_member(line_machine *m, uint32_t number, uint32_t kind, const received *found,
                           int64_t now_ns)
{
    line_frame all = m->transaction.frame;
    int64_t end_ns = m->end_ns;
    m->transaction.frame = m->table.drive[number].cyclic[READ_TURN].frame;
    m->transaction.frame.exact = m->group.fast; /* a late packet of all does not look like a servo's
                                                   own answer */
    m->group.waiting &= ~(1U << number);
    if (kind != ANSWER_OK) {
        line_drive_failed(m, number, kind, found->exception, now_ns);
    } else if (line_is_doubtful(m, number, now_ns)) {
        line_doubt(m, number, now_ns);
    } else {
        m->end_ns += m->group.answered_ns;
        line_drive_answered(m, number, m->group.fast ? m->transaction.plain : line_reply(m, found),
                            now_ns);
    }
    m->group.answered_ns += kind == ANSWER_OK ? line_reply_ns(m, &m->transaction.frame) : 0;
    m->transaction.frame = all;
    m->end_ns = end_ns;
}

static void look_for(line_machine *m, uint32_t number, uint32_t from, int64_t now_ns)
{
    const line_transaction *t = &m->transaction;
    const line_frame *alone = &m->table.drive[number].cyclic[READ_TURN].frame;
    received found = rtu_hunt(alone, alone->request, from, t->received, t->received_bytes);
    if (found.kind == RECEIVED_MORE) {
        return;
    }
    m->answers++;
    m->group.taken[m->group.taken_count++] =
        (group_reply){.offset = found.offset, .bytes = found.bytes};
    line_group_end_member(m, number, found.kind == RECEIVED_ANSWER ? ANSWER_OK : ANSWER_REFUSED,
                          &found, now_ns);
}

/* Take bytes. True: the exchange has ended. */
static bool is_over(line_machine *m, const uint8_t *bytes, uint32_t count, int64_t now_ns)
{
    line_transaction *t = &m->transaction;
    uint32_t room = RECEIVED_BYTES_MAX - t->received_bytes;
    bool full = count >= room;
    memcpy(t->received + t->received_bytes, bytes, full ? room : count);
    t->received_bytes += full ? room : count;
    uint32_t from = first_byte(m);
    bool collided = m->echo == ECHO_FIRST && from == 0 && t->received_bytes > 0;
    if (m->group.fast && !collided) {
        line_fast_look(m, from, now_ns);
    }
    for (uint32_t i = 0; i < m->table.drive_count && !collided && !m->group.fast; i++) {
        if ((m->group.waiting >> i & 1) != 0) {
            look_for(m, i, from, now_ns);
        }
    }
    bool answered = m->group.waiting == 0 && t->frame.reply_bytes > 0;
    return answered || full || collided || now_ns >= m->until_ns;
}

/* Return the next place where a reply begins, or where the bytes end; *skip is the length of a
 * reply that begins here. */
static uint32_t next_taken(const line_machine *m, uint32_t at, uint32_t *skip)
{
    uint32_t next = m->transaction.received_bytes;
    *skip = 0;
    for (uint32_t i = 0; i < m->group.taken_count; i++) {
        const group_reply *reply = &m->group.taken[i];
        *skip = reply->offset == at ? reply->bytes : *skip;
        next = reply->offset > at && reply->offset < next ? reply->offset : next;
    }
    return next;
}

/* Sort the bytes that belong to no reply. True: they do not belong to a late one either. */
static bool sort_rest(line_machine *m, int64_t now_ns)
{
    uint64_t noise_bytes = m->noise_bytes;
    for (uint32_t at = first_byte(m), skip; at < m->transaction.received_bytes;) {
        uint32_t next = next_taken(m, at, &skip);
        if (skip == 0) {
            line_stray(m, m->transaction.received + at, next - at, now_ns);
        }
        at = skip > 0 ? at + skip : next;
    }
    return m->noise_bytes != noise_bytes;
}

static void end_all(line_machine *m, int64_t now_ns)
{
    const received nothing = {.kind = RECEIVED_MORE};
    bool all = m->group.waiting == 0;
    bool noise = sort_rest(m, now_ns);
    line_fast_end(m, all);
    if (m->echo == ECHO_UNKNOWN && m->group.taken_count > 0) {
        m->echo = first_byte(m) > 0 ? ECHO_FIRST : ECHO_NONE;
        m->notify = true;
    }
    for (uint32_t i = 0; i < m->table.drive_count; i++) {
        if ((m->group.waiting >> i & 1) != 0) {
            line_group_end_member(m, i, noise ? ANSWER_BAD_REPLY : ANSWER_NO_REPLY, &nothing,
                                  now_ns);
        }
    }
    if (!all) {
        line_doubt_echo(m);
    } else if (m->group.taken_count > 0) {
        m->round_trip_ns = now_ns - m->start_ns;
    }
}

void line_group_step(line_machine *m, const uint8_t *bytes, uint32_t count, int64_t now_ns)
{
    if (is_over(m, bytes, count, now_ns)) {
        end_all(m, now_ns);
        int64_t silent_ns = now_ns + m->table.gap_ns;
        m->ours_ns = m->ours_ns > silent_ns ? m->ours_ns : silent_ns;
        m->work = WORK_NONE;
    }
}

/* --------------------------------------------------------------------------- afterwards */
bool line_group_goes_on(line_machine *m)
{
    while (m->group.answered != 0) {
        uint32_t number = (uint32_t)__builtin_ctz(m->group.answered);
        m->group.answered &= m->group.answered - 1;
        if (is_member(m, number)) {
            m->current = number;
            m->drive[number].stage = STAGE_EXTRA;
            return true;
        }
    }
    return false;
}

void line_group_answered(line_machine *m, uint32_t number, const uint8_t *reply, int64_t stamp_ns)
{
    line_drive_state *drive = &m->drive[number];
    if (stamp_ns > 0) {
        line_read(m, number, &m->table.drive[number].cyclic[READ_TURN], reply, stamp_ns);
    }
    /* the drive has answered the read right after its set-point */
    drive->state.sent_motion = drive->cycle_motion;
    m->group.answered |= 1U << number;
    line_publish(m, number);
}

/* -------------------------------------------------------------------------------- table */
static uint32_t on_the_wire(uint32_t bytes, uint32_t seal)
{
    return seal == SEAL_STUFFED ? bytes + bytes / 3 : bytes;
}

static bool is_member_good(const line_drive *drive, const line_frame *first,
                           const line_group *group)
{
    const line_frame *write = &drive->cyclic[0].frame, *read = &drive->cyclic[1].frame;
    bool turns = drive->cyclic_count == 2 && drive->cyclic[0].setpoint_count > 0 &&
                 drive->cyclic[1].setpoint_count == 0;
    bool seals = write->request_seal == first->request_seal &&
                 read->request_seal == first->request_seal &&
                 read->reply_seal == first->request_seal;
    bool places = write->request_bytes == first->request_bytes && read->reply_bytes > 0 &&
                  group->data_byte + rtu_seal_bytes(first->request_seal) < write->request_bytes;
    for (uint32_t i = 0; i < drive->cyclic[0].setpoint_count; i++) {
        places = places && drive->cyclic[0].setpoint[i].byte >= group->data_byte;
    }
    return turns && seals && places && drive->direction_count == 0 && drive->idle_count == 0;
}

bool line_group_is_good(const line_table *table)
{
    const line_group *group = &table->group;
    const line_frame *first = &table->drive[0].cyclic[0].frame;
    uint32_t seal = first->request_seal, head = form_of(seal).length + 2;
    bool good = group->used == 1 && (seal == SEAL_SUM || seal == SEAL_STUFFED);
    good = good && group->write_bytes >= head && group->write_bytes <= GROUP_HEAD_MAX;
    good = good && group->read_bytes >= head && group->read_bytes <= GROUP_HEAD_MAX;
    uint32_t sent = group->write_bytes + group->read_bytes + 2 * rtu_seal_bytes(seal), comes = 0;
    for (uint32_t i = 0; good && i < table->drive_count; i++) {
        const line_drive *drive = &table->drive[i];
        good = is_member_good(drive, first, group);
        sent += 2 + (first->request_bytes - group->data_byte);
        comes += drive->cyclic[1].frame.reply_bytes;
    }
    sent = on_the_wire(sent, seal);
    good = good && line_fast_is_good(table);
    return good && sent <= FRAME_BYTES_MAX && sent + on_the_wire(comes, seal) <= RECEIVED_BYTES_MAX;
}
