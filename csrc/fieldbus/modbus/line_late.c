/* SPDX-License-Identifier: Apache-2.0
 * line_late.c: replies that come late. A reply does not identify its request, so after a failed
 * request its reply may still come. A drive answers in the order of its requests: the certain
 * answer to a newer request ends the wait for all older ones, and so does a silence of the longest
 * delay of a drive. */
#include <string.h>

#include "line_machine.h"

static const int64_t SUSPICIOUS_NS = 2000 * LINE_MS; /* after a failure */
/* for smaller differences, scheduling hides them */
static const int64_t TOO_SOON_NS = LINE_MS / 2;

/* RFC 6298 with a host's scheduling instead of the clock's granularity. */
static const int64_t DEADLINE_LEAST_NS = 10 * LINE_MS, GRANULARITY_NS = LINE_MS / 2;

static uint32_t smaller(uint32_t a, uint32_t b)
{
    return a < b ? a : b;
}

static line_look look_of(const line_frame *frame)
{
    line_look look = {.reply_bytes = frame->reply_bytes,
                      .reply_seal = frame->reply_seal,
                      .writes = frame->echo_bytes > 0};
    look.repeats = look.writes &&
                   frame->echo_bytes + rtu_seal_bytes(frame->request_seal) >= frame->request_bytes;
    look.head_bytes =
        smaller(look.writes ? frame->echo_bytes : frame->match_bytes, FRAME_MATCH_MAX);
    memcpy(look.head, look.writes ? frame->request : frame->match, look.head_bytes);
    return look;
}

static bool alike(const line_look *a, const line_look *b)
{
    return a->reply_bytes == b->reply_bytes &&
           memcmp(a->head, b->head, smaller(a->head_bytes, b->head_bytes)) == 0;
}

/* Return the turn-around of the reply that has just come; on a pseudo-terminal bytes take no
 * time. */
static int64_t turnaround_of(const line_machine *m, int64_t now_ns)
{
    int64_t took_ns = now_ns - m->end_ns - line_reply_ns(m, &m->transaction.frame);
    return took_ns > 0 ? took_ns : 0;
}

static int64_t late_ns(const line_machine *m, uint32_t number)
{
    int64_t twice_ns = 2 * m->table.drive[number].turnaround_ns;
    return twice_ns > m->table.late_ns ? twice_ns : m->table.late_ns;
}

/* Drop the ones that are older than the one at `first`. */
static void drop_before(line_drive_state *drive, uint32_t first)
{
    drive->owed_count -= first;
    memmove(&drive->owed[0], &drive->owed[first], drive->owed_count * sizeof drive->owed[0]);
}

static void drop_at(line_drive_state *drive, uint32_t place)
{
    drive->owed_count--;
    memmove(&drive->owed[place], &drive->owed[place + 1],
            (drive->owed_count - place) * sizeof drive->owed[0]);
}

static uint32_t place_of(const line_drive_state *drive, const line_look *look)
{
    uint32_t place = 0;
    while (place < drive->owed_count && !alike(&drive->owed[place].look, look)) {
        place++;
    }
    return place;
}

/* Return the end of the waiting time: each unanswered request may make the next reply later. The
 * drive has been free since `from_ns`, or answers nothing that is older. */
static int64_t until_ns(const line_machine *m, uint32_t number, int64_t from_ns)
{
    const line_drive_state *drive = &m->drive[number];
    uint32_t count = 0;
    for (uint32_t i = 0; i < drive->owed_count; i++) {
        count += drive->owed[i].count;
    }
    return from_ns + smaller(count, OWED_MAX) * late_ns(m, number) +
           line_reply_ns(m, &m->transaction.frame);
}

/* Drop the ones that cannot come any more at this time. */
static void forget_old(line_drive_state *drive, int64_t now_ns)
{
    for (uint32_t i = drive->owed_count; i > 0; i--) {
        if (drive->owed[i - 1].until_ns <= now_ns) {
            drop_at(drive, i - 1);
        }
    }
}

void line_owe(line_machine *m, uint32_t number)
{
    line_drive_state *drive = &m->drive[number];
    const line_frame *frame = &m->transaction.frame;
    if (frame->exact != 0 || frame->reply_bytes == 0) {
        return; /* no request at all goes out until the late reply has passed */
    }
    forget_old(drive, m->start_ns);
    line_owed owed = {.look = look_of(frame), .count = 1};
    uint32_t place = place_of(drive, &owed.look);
    if (place < drive->owed_count) {
        owed.count += drive->owed[place].count;
        drop_at(drive, place);
    }
    bool full = drive->owed_count == OWED_MAX;
    if (full) {
        drop_at(drive, 0);
    }
    drive->owed[drive->owed_count++] = owed;
    drive->owed[drive->owed_count - 1].until_ns = until_ns(m, number, m->end_ns);
    if (full) { /* more than can be distinguished: a silence clears them */
        drive->held_until_ns = drive->owed[drive->owed_count - 1].until_ns;
    }
    drive->failed_ns = m->end_ns;
}

/* Whether both replies mean the same: one that repeats all of its request does for two equal
 * requests, as long as no other write may have come between them. */
static bool is_same_reply(const line_drive_state *drive, uint32_t place)
{
    bool same = drive->owed[place].look.repeats;
    for (uint32_t i = place + 1; i < drive->owed_count; i++) {
        same = same && !drive->owed[i].look.writes;
    }
    return same;
}

bool line_may_be_late(const line_machine *m, uint32_t number, const line_frame *frame,
                      int64_t sent_ns)
{
    const line_drive_state *drive = &m->drive[number];
    line_look look = look_of(frame);
    uint32_t place = frame->exact == 0 ? place_of(drive, &look) : drive->owed_count;
    return place < drive->owed_count && drive->owed[place].until_ns > sent_ns &&
           !is_same_reply(drive, place);
}

/* Whether a drive that has just failed now answers in less than half of its shortest time so
 * far. */
static bool too_soon(const line_machine *m, uint32_t number, int64_t sample_ns)
{
    const line_drive_state *drive = &m->drive[number];
    bool suspicious = drive->failed_ns > 0 && m->start_ns - drive->failed_ns < SUSPICIOUS_NS;
    return suspicious && drive->least_ns > 0 && sample_ns < drive->least_ns / 2 - TOO_SOON_NS;
}

/* Whether the stop is proven. It was answered more often than the drive had older answers to give:
 * one of the answers is its own. Without this rule the stop would be sent again and again, every
 * answer would stay doubtful, and no other drive would get a turn. */
static bool is_stop_proven(const line_machine *m, uint32_t number)
{
    const line_drive_state *drive = &m->drive[number];
    line_look look = look_of(&m->transaction.frame); /* it is in owed[], because its answer may be
                                                        late */
    return m->work == WORK_STOP && drive->stop_doubts >= drive->owed[place_of(drive, &look)].count;
}

bool line_is_doubtful(line_machine *m, uint32_t number, int64_t now_ns)
{
    line_drive_state *drive = &m->drive[number];
    const line_frame *frame = &m->transaction.frame;
    if (frame->reply_bytes == 0 || frame->exact != 0 || m->work == WORK_PROBE) {
        return false; /* a probe only needs to show that the drive responds */
    }
    if (too_soon(m, number, turnaround_of(m, now_ns))) {
        drive->least_ns = 0; /* only once: the drive may have become faster */
        return true;
    }
    return line_may_be_late(m, number, frame, m->start_ns) && !is_stop_proven(m, number);
}

void line_settle(line_machine *m, uint32_t number, int64_t now_ns)
{
    line_drive_state *drive = &m->drive[number];
    const line_frame *frame = &m->transaction.frame;
    if (frame->exact != 0 || frame->reply_bytes == 0) {
        return;
    }
    line_look look = look_of(frame);
    forget_old(drive, m->start_ns);
    drop_before(drive, place_of(drive, &look));
    if (drive->owed_count > 0) { /* of two equal requests, this reply perhaps belongs to the older
                                    one */
        line_owed still = drive->owed[0];
        drop_at(drive, 0);
        drive->owed[drive->owed_count++] = still;
        drive->owed[drive->owed_count - 1].until_ns = until_ns(m, number, m->end_ns);
    } else {
        int64_t sample_ns = turnaround_of(m, now_ns) + 1; /* + 1, because 0 means: not known */
        drive->least_ns =
            drive->least_ns == 0 || sample_ns < drive->least_ns ? sample_ns : drive->least_ns;
    }
}

/* Accept a reply as doubtful: the drive responds; nothing more is known. Its cycle begins again
 * after the silence. */
void line_doubt(line_machine *m, uint32_t number, int64_t now_ns)
{
    line_drive_state *drive = &m->drive[number];
    drive->count.exchanges++;
    drive->count.received_ns = now_ns;
    drive->stage = STAGE_IDLE;
    if (m->current == number) {
        m->current = LINE_DRIVES_MAX;
    }
    line_owe(m, number);
    line_owed *newest = &drive->owed[drive->owed_count - 1];
    newest->count -= newest->count > 1; /* one of its replies has come */
    newest->until_ns = until_ns(m, number, now_ns);
    drive->held_until_ns = newest->until_ns;
}

/* ----------------------------------------------------------------------- in the silence */
static bool is_reply(const line_look *look, const uint8_t *bytes)
{
    return memcmp(bytes, look->head, look->head_bytes) == 0 &&
           rtu_is_sealed(bytes, look->reply_bytes, look->reply_seal);
}

/* Whether a late reply of this drive ends with the newest byte. */
static bool take_late(line_machine *m, uint32_t number, int64_t now_ns)
{
    line_drive_state *drive = &m->drive[number];
    for (uint32_t i = 0; i < drive->owed_count; i++) {
        line_owed *owed = &drive->owed[i];
        uint32_t bytes = owed->look.reply_bytes;
        if (bytes > m->stray_bytes || !is_reply(&owed->look, m->stray + m->stray_bytes - bytes)) {
            continue;
        }
        m->noise_bytes -= bytes;
        m->stray_bytes = 0;
        drive->count.late++;
        owed->count--;
        drop_before(drive, owed->count == 0 ? i + 1 : i);
        if (drive->owed_count == 0 && drive->held_until_ns > now_ns) {
            drive->held_until_ns = now_ns;
        }
        return true;
    }
    return false;
}

const uint8_t *line_reply(line_machine *m, const received *found)
{
    const uint8_t *reply = m->transaction.received + found->offset;
    if (m->transaction.frame.reply_seal != SEAL_STUFFED || found->bytes == 0) {
        return reply;
    }
    (void)rtu_unstuff(reply, found->bytes, m->transaction.plain);
    return m->transaction.plain;
}

void line_stray(line_machine *m, const uint8_t *bytes, uint32_t count, int64_t now_ns)
{
    m->noise_bytes += count;
    for (uint32_t i = 0; i < count; i++) {
        if (m->stray_bytes == FRAME_BYTES_MAX) {
            memmove(m->stray, m->stray + 1, --m->stray_bytes);
        }
        m->stray[m->stray_bytes++] = bytes[i];
        for (uint32_t n = 0; n < m->table.drive_count && !take_late(m, n, now_ns); n++) {
        }
    }
}

/* Sort the bytes beside the answer, if there was one. The echo of the request is not noise. */
void line_sort_received(line_machine *m, const received *verdict, int64_t now_ns)
{
    const line_transaction *t = &m->transaction;
    uint32_t request_bytes = t->frame.request_bytes;
    bool copied = m->echo != ECHO_NONE && t->received_bytes >= request_bytes &&
                  memcmp(t->received, t->frame.request, request_bytes) == 0;
    uint32_t from = verdict->echoed || (verdict->bytes == 0 && copied) ? request_bytes : 0;
    uint32_t end = verdict->bytes > 0 ? verdict->offset : t->received_bytes;
    if (end > from) {
        line_stray(m, t->received + from, end - from, now_ns);
    }
    uint32_t after = verdict->offset + verdict->bytes;
    if (verdict->bytes > 0 && t->received_bytes > after) {
        line_stray(m, t->received + after, t->received_bytes - after, now_ns);
    }
}

void line_doubt_echo(line_machine *m)
{
    bool understood = false;
    for (uint32_t i = 0; i < m->table.drive_count; i++) {
        understood |= m->drive[i].failures < m->table.drive[i].tries;
    }
    m->echo = understood ? m->echo : m->table.echo;
}

/* -------------------------------------------------------------------------- turn-around */
static int64_t learned_ns(const line_drive_state *drive)
{
    int64_t spread_ns =
        4 * drive->variation_ns > GRANULARITY_NS ? 4 * drive->variation_ns : GRANULARITY_NS;
    int64_t deadline_ns = drive->smoothed_ns + spread_ns;
    return deadline_ns < DEADLINE_LEAST_NS ? DEADLINE_LEAST_NS : deadline_ns;
}

int64_t line_expected_turnaround_ns(const line_machine *m, uint32_t number)
{
    const line_drive *table = &m->table.drive[number];
    const line_drive_state *drive = &m->drive[number];
    int64_t expected_ns = drive->smoothed_ns > 0 ? learned_ns(drive) : table->turnaround_ns;
    int64_t bound_ns = table->reply_timeout_ns > 0 ? table->reply_timeout_ns : table->turnaround_ns;
    return expected_ns < bound_ns ? expected_ns : bound_ns;
}

void line_learn_turnaround(line_machine *m, uint32_t number, int64_t now_ns)
{
    line_drive_state *drive = &m->drive[number];
    int64_t sample_ns = turnaround_of(m, now_ns);
    if (drive->smoothed_ns == 0) {
        drive->smoothed_ns = sample_ns + 1;
        drive->variation_ns = sample_ns / 2;
    } else {
        int64_t off_ns = drive->smoothed_ns > sample_ns ? drive->smoothed_ns - sample_ns
                                                        : sample_ns - drive->smoothed_ns;
        drive->variation_ns += (off_ns - drive->variation_ns) / 4;
        drive->smoothed_ns += (sample_ns - drive->smoothed_ns) / 8;
    }
    int64_t deadline_ns = learned_ns(drive);
    int64_t bound_ns = m->table.drive[number].turnaround_ns;
    drive->deadline_ns = deadline_ns < bound_ns ? deadline_ns : bound_ns;
    drive->usual_ns = drive->deadline_ns;
}

/* Return the middle of a usual exchange: even if the reply took longer, the value was measured
 * after the request's end, within the drive's shortest turn-around. */
int64_t line_stamp(const line_machine *m, uint32_t number, int64_t now_ns)
{
    int64_t middle_ns = m->start_ns + (now_ns - m->start_ns) / 2;
    int64_t certain_ns = m->end_ns + m->drive[number].least_ns / 2;
    return middle_ns < certain_ns ? middle_ns : certain_ns;
}
