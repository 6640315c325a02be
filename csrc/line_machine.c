/* SPDX-License-Identifier: Apache-2.0
 * line_machine.c: whose turn it is, and what came of it. */
#include "line_machine.h"

#include <errno.h>
#include <string.h>

static const int64_t LOOK_MOVING_NS = 10 * LINE_MS, LOOK_RESTING_NS = 50 * LINE_MS;
/* Between the reply's last byte on the wire and our hearing of it: USB frames, receive buffers, a busy machine. */
static const int64_t HOST_NS = 20 * LINE_MS;
static const int64_t FAR_NS = INT64_MAX;

static int64_t later(int64_t a, int64_t b)
{
    return a > b ? a : b;
}

static int64_t earlier(int64_t a, int64_t b)
{
    return a < b ? a : b;
}

/* --------------------------------------------------------------------------------------------------- beginning */
static void note_joint(line_machine *m, uint32_t number, uint32_t joint)
{
    m->drive[number].joints |= 1U << joint;
}

static void note_joints(line_machine *m, uint32_t number, const line_exchange *turn)
{
    for (uint32_t i = 0; i < turn->setpoint_count; i++) {
        note_joint(m, number, turn->setpoint[i].joint);
    }
    for (uint32_t i = 0; i < turn->field_count; i++) {
        const line_field *field = &turn->field[i];
        if (field->kind < FIELD_ENABLED) {
            note_joint(m, number, field->joint);
            m->joint[field->joint].counts |= field->kind == FIELD_COUNT;
            m->joint[field->joint].measures |= field->kind == FIELD_VELOCITY;
        }
    }
}

static void init_drive(line_machine *m, uint32_t number, int64_t now_ns)
{
    line_drive *table = &m->table.drive[number];
    line_drive_state *drive = &m->drive[number];
    table->turnaround_ns += HOST_NS;
    drive->deadline_ns = table->turnaround_ns;
    drive->due_ns = now_ns;
    drive->enabled = 2;
    for (uint32_t i = 0; i < table->cyclic_count; i++) {
        note_joints(m, number, &table->cyclic[i]);
    }
    for (uint32_t i = 0; i < table->extra_count; i++) {
        note_joints(m, number, &table->extra[i]);
    }
    m->slot_period_ns = earlier(m->slot_period_ns, table->period_ns);
    line_forget(m, number);
}

int line_machine_init(line_machine *m, const line_table *table, uint32_t may_turn, int64_t now_ns)
{
    char name[FIELD_NAME_BYTES];
    if (line_table_check(table, name) != NULL) {
        return -EINVAL;
    }
    memset(m, 0, sizeof *m);
    m->table = *table;
    m->echo = table->echo;
    m->worker = m->current = LINE_DRIVES_MAX;
    m->slot_period_ns = FAR_NS;
    m->slot_due_ns = now_ns;
    m->free_ns = now_ns + table->gap_ns;
    for (uint32_t i = 0; i < table->drive_count; i++) {
        init_drive(m, i, now_ns);
        if ((may_turn >> i & 1) != 0) {
            line_stop_unheard(m, i, now_ns);
        }
    }
    return 0;
}

/* ---------------------------------------------------------------------------------------------- sending, hearing */
static void begin(line_machine *m, uint32_t work, uint32_t worker, const line_frame *frame, line_output *out)
{
    m->work = work;
    m->worker = worker;
    m->sent = false;
    m->transaction.frame = *frame;
    m->transaction.heard_bytes = 0;
    out->send = m->transaction.frame.request;
    out->send_bytes = frame->request_bytes;
}

static int64_t wait_for_ns(const line_machine *m)
{
    if (m->work == WORK_ASK) {
        return m->ask[0].turnaround_ns + HOST_NS;
    }
    if (m->worker >= m->table.drive_count) {
        int64_t longest_ns = 0;
        for (uint32_t i = 0; i < m->table.drive_count; i++) {
            longest_ns = later(longest_ns, m->table.drive[i].turnaround_ns - HOST_NS);
        }
        return longest_ns;
    }
    const line_drive *table = &m->table.drive[m->worker];
    if (table->reply_timeout_ns > 0) {
        return table->reply_timeout_ns;
    }
    return m->work == WORK_CYCLE ? m->drive[m->worker].deadline_ns : table->turnaround_ns;
}

void line_machine_sent(line_machine *m, int64_t now_ns)
{
    const line_frame *frame = &m->transaction.frame;
    m->sent = true;
    m->start_ns = now_ns;
    m->end_ns = now_ns + (int64_t)((double)frame->request_bytes * m->table.character_ns);
    m->bound_ns = wait_for_ns(m);
    m->until_ns = m->end_ns + m->bound_ns + line_reply_ns(m, frame);
    m->free_ns = m->end_ns + m->table.gap_ns;
    m->exchanges++;
}

static void finish_ask(line_machine *m, uint32_t kind, const heard *verdict, int64_t now_ns)
{
    const line_frame *frame = &m->transaction.frame;
    line_answer_ask(m, &m->ask[0], kind, now_ns);
    m->answer.sent_ns = m->start_ns;
    m->answer.stamp_ns = m->start_ns + (now_ns - m->start_ns) / 2;
    m->answer.exception = verdict->exception;
    m->answer.echoed = verdict->echoed;
    if (kind == ANSWER_OK) {
        m->answer.reply_bytes = frame->reply_bytes;
        memcpy(m->answer.reply, m->transaction.heard + verdict->offset, frame->reply_bytes);
    }
    line_drop_ask(m, 0);
}

/* Nobody is understood: an adapter that was found to hear itself may not do so any more. */
static void doubt_echo(line_machine *m)
{
    bool understood = false;
    for (uint32_t i = 0; i < m->table.drive_count; i++) {
        understood |= m->drive[i].failures < m->table.drive[i].tries;
    }
    m->echo = understood ? m->echo : m->table.echo;
}

static void end_exchange(line_machine *m, uint32_t kind, const heard *verdict, int64_t now_ns)
{
    uint32_t work = m->work, worker = m->worker;
    const uint8_t *reply = m->transaction.heard + verdict->offset;
    if (kind == ANSWER_OK && m->transaction.frame.reply_bytes > 0) {
        m->round_trip_ns = now_ns - m->start_ns;
        m->noise_bytes += m->transaction.heard_bytes - m->transaction.frame.reply_bytes -
                          (verdict->echoed ? m->transaction.frame.request_bytes : 0);
        if (m->echo == ECHO_UNKNOWN && m->transaction.frame.echo_bytes == 0) {
            m->echo = verdict->echoed ? ECHO_FIRST : ECHO_NONE;
            m->news = true;
        }
    } else {
        m->noise_bytes += m->transaction.heard_bytes;
    }
    if (worker < m->table.drive_count && kind == ANSWER_OK) {
        line_drive_answered(m, worker, reply, now_ns);
    } else if (worker < m->table.drive_count) {
        line_drive_failed(m, worker, kind, verdict->exception, now_ns);
        m->free_ns = m->transaction.frame.exact != 0 ? later(m->free_ns, now_ns + m->bound_ns) : m->free_ns;
        m->slot_due_ns = later(m->slot_due_ns, now_ns);   /* who had to wait goes before a probe, which may take as long */
        doubt_echo(m);
    }
    if (work == WORK_ASK) {
        finish_ask(m, kind, verdict, now_ns);
    } else if (work == WORK_BROADCAST) {
        m->broadcasts--;
    }
    m->work = WORK_NONE;
    m->worker = LINE_DRIVES_MAX;
}

/* A quiet drive that can be read: an echo shall not make it seem to be back. */
static bool will_read(const line_machine *m)
{
    if (m->work != WORK_PROBE) {
        return false;
    }
    const line_drive *table = &m->table.drive[m->worker];
    return table->probe > 0 || table->extra_count > 0;
}

/* What the bytes since the request say. Where it is not known whether the adapter hears itself, an answer that looks
 * like its request is taken: only what is read decides (and set-ups are read back). */
static heard listen(line_machine *m, const uint8_t *bytes, uint32_t count)
{
    line_transaction *t = &m->transaction;
    uint32_t room = HEARD_BYTES_MAX - t->heard_bytes;
    bool full = count >= room;
    memcpy(t->heard + t->heard_bytes, bytes, full ? room : count);
    t->heard_bytes += full ? room : count;
    bool alike = m->echo == ECHO_UNKNOWN && !will_read(m) && rtu_answer_is_request(&t->frame, t->frame.request);
    heard found = rtu_find_answer(&t->frame, t->frame.request, alike ? (uint32_t)ECHO_NONE : m->echo, t->heard,
                                  t->heard_bytes);
    if (found.kind == HEARD_MORE && full) {
        found.kind = HEARD_BAD;
    }
    return found;
}

/* Whatever comes keeps the line busy: the gap counts from the last byte. */
static void hear(line_machine *m, int64_t now_ns, const uint8_t *bytes, uint32_t count)
{
    heard verdict = {.kind = HEARD_MORE};
    bool answers = m->transaction.frame.reply_bytes > 0;
    if (count > 0) {
        m->free_ns = later(m->free_ns, now_ns + m->table.gap_ns);
    }
    if (m->work == WORK_NONE || !m->sent) {
        m->noise_bytes += count;
        return;
    }
    if (answers && count > 0) {
        verdict = listen(m, bytes, count);
    } else {
        m->noise_bytes += count;   /* the echo of a broadcast */
    }
    if (verdict.kind == HEARD_ANSWER) {
        end_exchange(m, ANSWER_OK, &verdict, now_ns);
    } else if (verdict.kind == HEARD_REFUSED) {
        end_exchange(m, ANSWER_REFUSED, &verdict, now_ns);
    } else if (verdict.kind == HEARD_BAD || (now_ns >= m->until_ns && m->transaction.heard_bytes > 0)) {
        end_exchange(m, ANSWER_BAD_REPLY, &verdict, now_ns);
    } else if (now_ns >= m->until_ns) {
        end_exchange(m, answers ? ANSWER_NO_REPLY : ANSWER_OK, &verdict, now_ns);
    }
}

/* ------------------------------------------------------------------------------------------------- whose turn */
/* Quiet ones do not keep the others waiting, nor one of them the next: 0 comes first. */
static uint32_t stop_rank(const line_drive_state *drive)
{
    return drive->failures > 0 ? 1 + drive->stop_failures : 0;
}

static uint32_t first_to_stop(const line_machine *m)
{
    uint32_t first = LINE_DRIVES_MAX;
    for (uint32_t i = 0; i < m->table.drive_count; i++) {
        bool waits = m->drive[i].stop != STOP_NOTHING;
        if (waits && (first == LINE_DRIVES_MAX || stop_rank(&m->drive[i]) < stop_rank(&m->drive[first]))) {
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
        begin(m, WORK_BROADCAST, LINE_DRIVES_MAX, &m->table.broadcast_stop[count - m->broadcasts], out);
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
    return m->drive[number].mode == DRIVE_READY || m->drive[number].mode == DRIVE_ARMED;
}

static int64_t due_of(const line_machine *m, uint32_t number)
{
    return is_cyclic(m, number) ? later(m->drive[number].due_ns, m->drive[number].quiet_until_ns) : FAR_NS;
}

/* Earliest deadline first; among equals the first one. */
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

static uint32_t due_probe(const line_machine *m, int64_t now_ns)
{
    for (uint32_t i = 0; i < m->table.drive_count; i++) {
        const line_drive_state *drive = &m->drive[i];
        if (drive->mode == DRIVE_QUIET && drive->probe_at_ns <= now_ns && drive->quiet_until_ns <= now_ns) {
            return i;
        }
    }
    return LINE_DRIVES_MAX;
}

/* What fits before the next one is due; at the worst it takes this long. */
static bool fits(const line_machine *m, const line_frame *frame, int64_t turnaround_ns, int64_t now_ns, int64_t next_ns)
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

/* The acyclic slot: an urgent ask, else asks and probes by turns. `next_ns`: when the next drive is due. */
static bool take_slot(line_machine *m, int64_t now_ns, int64_t next_ns, line_output *out)
{
    line_frame frame;
    bool mine = m->slot_due_ns <= now_ns && m->slot_due_ns <= next_ns;
    uint32_t quiet = due_probe(m, now_ns);
    bool asked = line_pick_ask(m, now_ns);
    bool probe_first = quiet < LINE_DRIVES_MAX && (!asked || (m->ask[0].urgent == 0 && m->slot_turn % 2 != 0));
    if (probe_first && mine) {
        line_next_probe(m, quiet, now_ns, &frame);
        begin(m, WORK_PROBE, quiet, &frame, out);
        spend_slot(m, now_ns);
        return true;
    }
    if (asked && (mine || fits(m, &m->ask[0].frame, m->ask[0].turnaround_ns, now_ns, next_ns))) {
        begin(m, WORK_ASK, m->ask[0].drive, &m->ask[0].frame, out);
        spend_slot(m, now_ns);
        return true;
    }
    return false;
}

static bool take_cycle(line_machine *m, int64_t now_ns, line_output *out)
{
    line_frame frame;
    for (uint32_t tried = 0; tried <= m->table.drive_count; tried++) {
        if (m->current < LINE_DRIVES_MAX) {
            uint32_t number = m->current;
            if (line_next_in_cycle(m, number, now_ns, &frame)) {
                begin(m, WORK_CYCLE, number, &frame, out);
                return true;
            }
            if (take_stop(m, out)) {   /* its end may have told to stop */
                return true;
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
        line_cycle_begin(m, next, now_ns);
    }
    return false;
}

/* ------------------------------------------------------------------------------------------------------ the step */
static void decide(line_machine *m, int64_t now_ns, line_output *out)
{
    line_shut_down(m, now_ns);
    if (m->shut == 3 || m->work != WORK_NONE || now_ns < m->free_ns || take_stop(m, out)) {
        return;
    }
    if (m->shut < 2) {
        (void)take_cycle(m, now_ns, out);
    } else {
        line_shut_down(m, now_ns);   /* all are told: that was it */
    }
}

static int64_t next_look_ns(const line_machine *m, int64_t now_ns)
{
    if (m->work != WORK_NONE) {
        return m->until_ns;
    }
    if (m->shut == 3) {
        return now_ns + LOOK_RESTING_NS;
    }
    int64_t wake_ns = now_ns + (m->shut != 0 ? LOOK_MOVING_NS : LOOK_RESTING_NS);
    for (uint32_t i = 0; i < m->table.drive_count; i++) {
        const line_drive_state *drive = &m->drive[i];
        if (drive->told_motion || drive->mode == DRIVE_ARMED) {
            wake_ns = earlier(wake_ns, now_ns + LOOK_MOVING_NS);
        }
        if (drive->mode == DRIVE_QUIET && m->shut < 2) {
            int64_t probe_ns = later(drive->probe_at_ns, drive->quiet_until_ns);
            wake_ns = earlier(wake_ns, later(probe_ns, m->slot_due_ns));
        }
        if (drive->stop != STOP_NOTHING) {
            wake_ns = m->free_ns;   /* stops wait for the gap alone, whatever the mode */
        }
        wake_ns = earlier(wake_ns, due_of(m, i));
    }
    if (m->ask_count > 0) {
        wake_ns = earlier(wake_ns, later(m->slot_due_ns, now_ns + LINE_MS / 4));
    }
    return later(wake_ns, m->free_ns);
}

void line_machine_step(line_machine *m, int64_t now_ns, const uint8_t *bytes, uint32_t count, line_output *out)
{
    *out = (line_output){.send = NULL};
    m->feedback_mask = 0;
    m->answered = false;
    m->news = false;
    m->round_trip_ns = 0;
    hear(m, now_ns, bytes, count);
    for (uint32_t i = 0; i < m->table.drive_count; i++) {
        line_obey_wish(m, i, now_ns);
        line_guard(m, i, now_ns);
    }
    if (!m->answered) {
        line_expire_ask(m, now_ns);
    }
    decide(m, now_ns, out);
    out->feedback_mask = m->feedback_mask;
    out->answered = m->answered;
    out->news = m->news || m->answered;
    out->wake_ns = out->send != NULL ? now_ns : m->answered ? now_ns : next_look_ns(m, now_ns);
}

void line_machine_kick(line_machine *m, int64_t now_ns)
{
    for (uint32_t i = 0; i < m->table.drive_count; i++) {
        line_drive_state *drive = &m->drive[i];
        if (drive->mode == DRIVE_ARMED && drive->due_ns > now_ns) {
            setpoints before = drive->frozen;
            drive->frozen = m->newest;
            if (line_differs(m, i)) {
                drive->due_ns = now_ns;
            }
            drive->frozen = before;
        }
    }
}

void line_machine_report(const line_machine *m, line_report *report)
{
    report->echo = m->echo;
    report->shut_down = m->shut == 3;
    report->exchanges = m->exchanges;
    report->noise_bytes = m->noise_bytes;
    report->setpoints_ns = m->newest.stamp_ns;
    for (uint32_t j = 0; j < JOINTS_MAX; j++) {
        report->fault_word[j] = m->joint[j].fault_word;
    }
    for (uint32_t i = 0; i < LINE_DRIVES_MAX; i++) {
        const line_drive_state *drive = &m->drive[i];
        drive_report *to = &report->drive[i];
        *to = drive->count;
        to->mode = drive->mode;
        to->demoted = drive->demoted;
        to->wish_seen = drive->wish_seen;
        to->enabled = drive->enabled;
        to->stopping = drive->stopping;
        to->told_motion = drive->told_motion;
        to->may_turn = drive->may_turn;
        to->stop_waits = drive->stop != STOP_NOTHING;
        to->failures = drive->failures;
        to->last_failure = drive->last_failure;
        to->last_exception = drive->last_exception;
        to->turnaround_ns = drive->smoothed_ns;
        to->deadline_ns = drive->deadline_ns;
        to->cycle_ns = drive->cycle_ns;
    }
}
