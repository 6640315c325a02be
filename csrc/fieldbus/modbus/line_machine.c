/* SPDX-License-Identifier: Apache-2.0
 * line_machine.c: gives the drives their turns, and evaluates the answers. */
#include "line_machine.h"

#include <string.h>

static const int64_t LOOK_MOVING_NS = 10 * LINE_MS, LOOK_RESTING_NS = 50 * LINE_MS;
/* Longest wait for silence at a drive's turn: after it there is another master, or a broken
 * transceiver. */
static const int64_t NEVER_SILENT_NS = 250 * LINE_MS, FAR_NS = INT64_MAX;

static int64_t later(int64_t a, int64_t b)
{
    return a > b ? a : b;
}

static int64_t earlier(int64_t a, int64_t b)
{
    return a < b ? a : b;
}

/* ------------------------------------------------------------------- sending, receiving */
static void begin(line_machine *m, uint32_t work, uint32_t worker, const line_frame *frame,
                  line_output *out)
{
    m->work = work;
    m->worker = worker;
    m->sent = false;
    m->urgent_by_ns = 0;
    m->transaction.frame = *frame;
    m->transaction.received_bytes = 0;
    out->send = m->transaction.frame.request;
    out->send_bytes = frame->request_bytes;
}

static int64_t wait_for_ns(const line_machine *m)
{
    if (m->work == WORK_REQUEST) {
        return m->transaction.request_turnaround_ns + LINE_HOST_NS;
    }
    if (m->work == WORK_GROUP) {
        return line_group_wait_ns(m);
    }
    if (m->worker >= m->table.drive_count) {
        int64_t longest_ns = 0;
        for (uint32_t i = 0; i < m->table.drive_count; i++) {
            longest_ns = later(longest_ns, m->table.drive[i].turnaround_ns - LINE_HOST_NS);
        }
        return longest_ns;
    }
    const line_drive *table = &m->table.drive[m->worker];
    bool cyclic = m->work == WORK_CYCLE || table->reply_timeout_ns > 0;
    return cyclic ? line_deadline_ns(m, m->worker) : table->turnaround_ns;
}

/* Whether another drive waits for its stop, or the line ends. */
static bool stops_wait(const line_machine *m)
{
    bool waits = m->end.stage != END_NOT;
    for (uint32_t i = 0; i < m->table.drive_count; i++) {
        waits |= m->drive[i].state.stop != STOP_NOTHING && i != m->worker;
    }
    return waits;
}

/* Shorten the wait if another stop waits: no drive's answer is awaited longer than usual then. */
static void shorten_wait(line_machine *m, int64_t now_ns)
{
    if (m->sent && m->worker < m->table.drive_count && stops_wait(m)) {
        int64_t until_ns = m->end_ns + line_expected_turnaround_ns(m, m->worker) +
                           line_reply_ns(m, &m->transaction.frame);
        m->until_ns = earlier(m->until_ns, later(until_ns, now_ns + 1));
    }
}

void line_machine_sent(line_machine *m, int64_t now_ns)
{
    const line_frame *frame = &m->transaction.frame;
    m->sent = true;
    m->start_ns = now_ns;
    m->end_ns = now_ns + (int64_t)((double)frame->request_bytes * m->table.character_ns);
    m->bound_ns = wait_for_ns(m);
    m->until_ns = m->end_ns + m->bound_ns + line_reply_ns(m, frame);
    m->ours_ns = m->free_ns = m->end_ns + m->table.gap_ns;
    m->exchanges++;
    shorten_wait(m, now_ns);
}

static void finish_request(line_machine *m, uint32_t kind, const received *verdict, int64_t now_ns)
{
    const line_frame *frame = &m->transaction.frame;
    line_answer_request(m, m->transaction.request_id, kind, now_ns);
    m->answer.sent_ns = m->start_ns;
    m->answer.stamp_ns = m->start_ns + (now_ns - m->start_ns) / 2;
    m->answer.exception = verdict->exception;
    m->answer.echoed = verdict->echoed;
    if (kind == ANSWER_OK) {
        m->answer.reply_bytes = frame->reply_bytes;
        memcpy(m->answer.reply, line_reply(m, verdict), frame->reply_bytes);
    }
}

static void drive_ended(line_machine *m, uint32_t kind, const received *verdict, int64_t now_ns)
{
    uint32_t worker = m->worker;
    if (kind == ANSWER_OK) {
        line_drive_answered(m, worker, line_reply(m, verdict), now_ns);
        return;
    }
    line_drive_failed(m, worker, kind, verdict->exception, now_ns);
    if (m->transaction.frame.exact != 0) {
        m->ours_ns = later(m->ours_ns, now_ns + m->bound_ns);
        m->free_ns = later(m->free_ns, m->ours_ns);
    }
    /* a request that had to wait goes before a probe, which may take as long */
    m->slot_due_ns = later(m->slot_due_ns, now_ns);
    line_doubt_echo(m);
}

static void end_exchange(line_machine *m, uint32_t kind, const received *verdict, int64_t now_ns)
{
    uint32_t work = m->work;
    line_sort_received(m, verdict, now_ns);
    m->answers += verdict->bytes > 0;
    m->ours_ns = later(m->ours_ns, now_ns + m->table.gap_ns);
    if (kind == ANSWER_OK && m->transaction.frame.reply_bytes > 0) {
        m->round_trip_ns = now_ns - m->start_ns;
        if (m->echo == ECHO_UNKNOWN && m->transaction.frame.echo_bytes == 0) {
            m->echo = verdict->echoed ? ECHO_FIRST : ECHO_NONE;
            m->notify = true;
        }
    }
    if (m->worker < m->table.drive_count && kind == ANSWER_OK &&
        line_is_doubtful(m, m->worker, now_ns)) {
        line_stop_doubted(m, m->worker);
        line_doubt(m, m->worker, now_ns);
        kind = ANSWER_NO_REPLY;
    } else if (m->worker < m->table.drive_count) {
        drive_ended(m, kind, verdict, now_ns);
    }
    if (work == WORK_REQUEST) {
        finish_request(m, kind, verdict, now_ns);
    } else if (work == WORK_BROADCAST) {
        m->broadcasts--;
    }
    m->work = WORK_NONE;
    m->worker = LINE_DRIVES_MAX;
}

/* End without an answer. Late replies, or the echo of the request, count as nothing. */
static void end_in_vain(line_machine *m, const received *verdict, int64_t now_ns)
{
    uint64_t noise_bytes = m->noise_bytes;
    line_sort_received(m, verdict, now_ns);
    m->transaction.received_bytes = 0;
    bool noise = m->noise_bytes != noise_bytes || verdict->kind == RECEIVED_BAD;
    end_exchange(m, noise ? ANSWER_BAD_REPLY : ANSWER_NO_REPLY, verdict, now_ns);
}

/* Whether a read probes the unresponsive drive: an echo must not make it look responsive. */
static bool will_read(const line_machine *m)
{
    if (m->work != WORK_PROBE) {
        return false;
    }
    const line_drive *table = &m->table.drive[m->worker];
    return table->probe > 0 || table->extra_count > 0;
}

/* Evaluate the bytes since the request. While it is unknown whether the adapter echoes, an answer
 * that equals its request is accepted: only reads decide (and set-ups are read back). */
static received listen(line_machine *m, const uint8_t *bytes, uint32_t count)
{
    line_transaction *t = &m->transaction;
    uint32_t room = RECEIVED_BYTES_MAX - t->received_bytes;
    bool full = count >= room;
    memcpy(t->received + t->received_bytes, bytes, full ? room : count);
    t->received_bytes += full ? room : count;
    bool alike = m->echo == ECHO_UNKNOWN && !will_read(m) &&
                 rtu_answer_is_request(&t->frame, t->frame.request);
    received found =
        rtu_find_answer(&t->frame, t->frame.request, alike ? (uint32_t)ECHO_NONE : m->echo,
                        t->received, t->received_bytes);
    if (found.kind == RECEIVED_MORE && full) {
        found.kind = RECEIVED_BAD;
    }
    return found;
}

/* Take bytes. Each one keeps the line busy: the gap counts from the last one. */
static void receive(line_machine *m, int64_t now_ns, const uint8_t *bytes, uint32_t count)
{
    received verdict = {.kind = RECEIVED_MORE};
    bool answers = m->transaction.frame.reply_bytes > 0;
    if (count > 0) {
        m->free_ns = later(m->free_ns, now_ns + m->table.gap_ns);
    }
    if (m->work == WORK_NONE || !m->sent) {
        line_stray(m, bytes, count, now_ns);
        return;
    }
    if (m->work == WORK_GROUP) {
        line_group_step(m, bytes, count, now_ns);
        return;
    }
    if (answers && count > 0) {
        verdict = listen(m, bytes, count);
    } else if (m->echo == ECHO_NONE) {
        line_stray(m, bytes, count, now_ns);
    }
    if (verdict.kind == RECEIVED_ANSWER) {
        end_exchange(m, ANSWER_OK, &verdict, now_ns);
    } else if (verdict.kind == RECEIVED_REFUSED) {
        end_exchange(m, ANSWER_REFUSED, &verdict, now_ns);
    } else if (verdict.kind == RECEIVED_BAD || (now_ns >= m->until_ns && answers)) {
        end_in_vain(m, &verdict, now_ns);
    } else if (now_ns >= m->until_ns) {
        end_exchange(m, ANSWER_OK, &verdict, now_ns);
    }
}

/* --------------------------------------------------------------------------- turns */
/* Return the rank for stops; 0 comes first. Unresponsive drives, and those with doubtful answers,
 * do not keep others waiting, nor each other. */
static uint32_t stop_rank(const line_drive_state *drive)
{
    return drive->stop_doubts + (drive->failures > 0 ? 1 + drive->stop_failures : 0);
}

static uint32_t first_to_stop(const line_machine *m)
{
    uint32_t first = LINE_DRIVES_MAX;
    for (uint32_t i = 0; i < m->table.drive_count; i++) {
        bool waits = m->drive[i].state.stop != STOP_NOTHING;
        if (waits &&
            (first == LINE_DRIVES_MAX || stop_rank(&m->drive[i]) < stop_rank(&m->drive[first]))) {
            first = i;
        }
    }
    return first;
}

static bool take_stop(line_machine *m, line_output *out)
{
    line_frame frame;
    if (m->broadcasts > 0) {
        uint32_t count = m->table.broadcast_stop_count;
        begin(m, WORK_BROADCAST, LINE_DRIVES_MAX, &m->table.broadcast_stop[count - m->broadcasts],
              out);
        return true;
    }
    for (uint32_t number; (number = first_to_stop(m)) < LINE_DRIVES_MAX;) {
        if (line_next_stop(m, number, &frame)) {
            begin(m, WORK_STOP, number, &frame, out);
            return true;
        }
    }
    return false;
}

static bool is_cyclic(const line_machine *m, uint32_t number)
{
    return m->drive[number].state.mode == DRIVE_READY || m->drive[number].state.mode == DRIVE_ARMED;
}

static int64_t due_of(const line_machine *m, uint32_t number)
{
    const line_drive_state *drive = &m->drive[number];
    if (m->table.group.used != 0 && is_cyclic(m, number)) {
        return drive->due_ns; /* set-points go out even while a reply is in doubt */
    }
    return is_cyclic(m, number)
               ? later(drive->due_ns, later(drive->silent_until_ns, drive->held_until_ns))
               : FAR_NS;
}

/* Return the drive with the earliest deadline; among equals the first one. */
static uint32_t most_due(const line_machine *m)
{
    uint32_t best = LINE_DRIVES_MAX;
    for (uint32_t i = 0; i < m->table.drive_count; i++) {
        if (due_of(m, i) != FAR_NS && (best == LINE_DRIVES_MAX || due_of(m, i) < due_of(m, best))) {
            best = i;
        }
    }
    return best;
}

/* Whether the exchange fits before the next one is due, if it takes its longest time. */
static bool fits(const line_machine *m, const line_frame *frame, int64_t turnaround_ns,
                 int64_t now_ns, int64_t next_ns)
{
    double bytes = (double)frame->request_bytes + (double)frame->reply_bytes;
    int64_t takes_ns = (int64_t)(bytes * m->table.character_ns) + turnaround_ns + m->table.gap_ns;
    return next_ns == FAR_NS || now_ns + takes_ns <= next_ns;
}

static void spend_slot(line_machine *m, int64_t now_ns)
{
    m->slot_turn++;
    m->slot_due_ns = later(m->slot_due_ns + m->slot_period_ns, now_ns);
}

/* Begin a request. From now on the queue cannot change or drop it. */
static void begin_request(line_machine *m, uint32_t place, line_output *out)
{
    const line_request *request = &m->request[place];
    m->transaction.request_id = request->id;
    m->transaction.request_turnaround_ns = request->turnaround_ns;
    begin(m, WORK_REQUEST, request->drive, &request->frame, out);
    line_drop_request(m, place);
}

static void begin_probe(line_machine *m, uint32_t number, int64_t now_ns, line_output *out)
{
    line_frame frame;
    line_next_probe(m, number, now_ns, &frame);
    begin(m, WORK_PROBE, number, &frame, out);
}

/* Take the acyclic slot: an urgent request, else requests and probes in turn. `next_ns`: time when
 * the next drive is due. */
static bool take_slot(line_machine *m, int64_t now_ns, int64_t next_ns, line_output *out)
{
    bool mine = m->slot_due_ns <= now_ns && m->slot_due_ns <= next_ns;
    uint32_t unresponsive = line_due_probe(m, false, now_ns);
    uint32_t place = line_pick_request(m, now_ns);
    const line_request *request = place < LINE_REQUESTS_MAX ? &m->request[place] : NULL;
    bool probe_first = unresponsive < LINE_DRIVES_MAX &&
                       (request == NULL || (request->urgent == 0 && m->slot_turn % 2 != 0));
    if (probe_first && mine) {
        begin_probe(m, unresponsive, now_ns, out);
        spend_slot(m, now_ns);
        return true;
    }
    if (request != NULL &&
        (mine || fits(m, &request->frame, request->turnaround_ns, now_ns, next_ns))) {
        begin_request(m, place, out);
        spend_slot(m, now_ns);
        return true;
    }
    return false;
}

static bool take_cycle(line_machine *m, int64_t now_ns, line_output *out)
{
    line_frame frame;
    for (uint32_t tried = 0; tried <= m->table.drive_count; tried++) {
        if (m->current < LINE_DRIVES_MAX || line_group_goes_on(m)) {
            uint32_t number = m->current;
            if (line_next_in_cycle(m, number, now_ns, &frame)) {
                begin(m, WORK_CYCLE, number, &frame, out);
                return true;
            }
            if (take_stop(m, out)) { /* its failure may have started a stop */
                return true;
            }
            if (m->group.answered != 0) {
                continue;
            }
        }
        uint32_t next = most_due(m);
        int64_t next_ns = next < LINE_DRIVES_MAX ? due_of(m, next) : FAR_NS;
        if (take_slot(m, now_ns, next_ns, out)) {
            return true;
        }
        if (next_ns > now_ns) {
            return false;
        }
        if (m->table.group.used == 0) {
            line_cycle_begin(m, next, now_ns);
        } else if (line_group_begin(m, now_ns, &frame)) {
            begin(m, WORK_GROUP, LINE_DRIVES_MAX, &frame, out);
            return true;
        }
    }
    return false;
}

/* ----------------------------------------------------------------------------- the step */
/* Send an urgent frame after the stops, on a line that is never silent. */
static void take_urgent(line_machine *m, int64_t now_ns, line_output *out)
{
    uint32_t place = line_pick_request(m, now_ns);
    uint32_t unresponsive = line_due_probe(m, true, now_ns);
    if (place < LINE_REQUESTS_MAX && m->request[place].urgent != 0) {
        begin_request(m, place, out);
    } else if (unresponsive < LINE_DRIVES_MAX) {
        begin_probe(m, unresponsive, now_ns, out);
    }
}

static void never_silent(line_machine *m, int64_t now_ns)
{
    for (uint32_t i = 0; i < m->table.drive_count; i++) {
        int64_t since_ns = later(due_of(m, i), m->noisy ? m->silent_ns : m->ours_ns);
        if (due_of(m, i) != FAR_NS && now_ns - since_ns >= NEVER_SILENT_NS) {
            line_drive_not_reached(m, i, now_ns);
        }
    }
}

static void decide(line_machine *m, int64_t now_ns, line_output *out)
{
    line_shut_down(m, now_ns);
    if (m->end.stage == END_SILENT) {
        return;
    }
    if (m->work != WORK_NONE) {
        shorten_wait(m, now_ns);
        return;
    }
    bool silent = now_ns >= m->free_ns;
    m->silent_ns = silent ? now_ns : m->silent_ns;
    m->noisy &= !silent;
    if (!silent && !line_ends_patience(m, now_ns)) {
        never_silent(m, now_ns);
        return;
    }
    if (take_stop(m, out)) {
        return;
    }
    if (!silent) {
        take_urgent(m, now_ns, out);
    } else if (m->end.stage < END_POWER_OFF) {
        (void)take_cycle(m, now_ns, out);
    } else {
        line_shut_down(m, now_ns); /* all drives have confirmed their power-off */
    }
}

static int64_t next_look_ns(const line_machine *m, int64_t now_ns)
{
    if (m->work != WORK_NONE) {
        return m->until_ns;
    }
    if (m->end.stage == END_SILENT) {
        return now_ns + LOOK_RESTING_NS;
    }
    int64_t wake_ns = now_ns + (m->end.stage != END_NOT ? LOOK_MOVING_NS : LOOK_RESTING_NS);
    for (uint32_t i = 0; i < m->table.drive_count; i++) {
        const line_drive_state *drive = &m->drive[i];
        if (drive->state.sent_motion || drive->state.mode == DRIVE_ARMED) {
            wake_ns = earlier(wake_ns, now_ns + LOOK_MOVING_NS);
        }
        if (drive->state.mode == DRIVE_UNRESPONSIVE && m->end.stage < END_POWER_OFF) {
            int64_t probe_ns = later(drive->probe_at_ns, drive->silent_until_ns);
            wake_ns = earlier(wake_ns, later(probe_ns, m->slot_due_ns));
        }
        if (drive->state.stop != STOP_NOTHING) {
            wake_ns = m->free_ns; /* stops wait only for the gap, in any mode */
        }
        wake_ns = earlier(wake_ns, due_of(m, i));
    }
    if (m->request_count > 0) {
        wake_ns = earlier(wake_ns, later(m->slot_due_ns, now_ns + LINE_MS / 4));
    }
    wake_ns = later(wake_ns, m->free_ns);
    return m->urgent_by_ns > now_ns ? earlier(wake_ns, m->urgent_by_ns) : wake_ns;
}

void line_machine_step(line_machine *m, int64_t now_ns, const uint8_t *bytes, uint32_t count,
                       line_output *out)
{
    *out = (line_output){.send = NULL};
    m->feedback_mask = 0;
    m->answered = false;
    m->notify = false;
    m->round_trip_ns = 0;
    m->now_ns = now_ns;
    receive(m, now_ns, bytes, count);
    for (uint32_t i = 0; i < m->table.drive_count; i++) {
        line_obey_request(m, i, now_ns);
        line_guard(m, i, now_ns);
    }
    if (!m->answered) {
        line_expire_request(m, now_ns);
    }
    decide(m, now_ns, out);
    out->feedback_mask = m->feedback_mask;
    out->answered = m->answered;
    out->notify = m->notify || m->answered;
    out->wake_ns = out->send != NULL ? now_ns : m->answered ? now_ns : next_look_ns(m, now_ns);
}

void line_machine_kick(line_machine *m, int64_t now_ns)
{
    m->now_ns = now_ns;
    for (uint32_t i = 0; i < m->table.drive_count; i++) {
        line_drive_state *drive = &m->drive[i];
        if (drive->state.mode == DRIVE_ARMED && drive->due_ns > now_ns) {
            setpoints before = drive->frozen;
            drive->frozen = m->newest;
            if (line_differs(m, i)) {
                drive->due_ns = now_ns;
            }
            drive->frozen = before;
        }
    }
}
