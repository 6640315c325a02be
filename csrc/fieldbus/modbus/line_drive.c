/* SPDX-License-Identifier: Apache-2.0
 * line_drive.c: one drive of a line: what it is sent, whether it responds, and when it has to
 * stop. */
#include <string.h>

#include "line_machine.h"
#include "fresh.h"

bool line_fresh(const line_machine *m, int64_t now_ns)
{
    return fresh_stamp(now_ns, m->newest.stamp_ns, m->table.setpoint_timeout_ns);
}

int64_t line_reply_ns(const line_machine *m, const line_frame *frame)
{
    return (int64_t)((double)frame->reply_bytes * m->table.character_ns);
}

/* ----------------------------------------------------------------------------- stopping */
void line_stop_now(line_machine *m, uint32_t number, uint32_t kind)
{
    line_drive_state *drive = &m->drive[number];
    drive->state.stop = kind;
    drive->stop_place = drive->stop_done = drive->stop_sent = 0;
    drive->stop_failures = drive->stop_doubts = 0;
    drive->stop_refused = false;
    drive->stage = STAGE_IDLE;
    memset(drive->direction_sent, 0, sizeof drive->direction_sent);
    if (m->current == number) {
        m->current = LINE_DRIVES_MAX;
    }
}

/* Begin the stop that the rules have decided. */
void line_begin_stop(line_machine *m, uint32_t number, drive_stop stop, int64_t now_ns)
{
    m->notify |= drive_is_changed(&m->drive[number].state);
    if (stop == STOP_QUICK) {
        m->drive[number].due_ns = now_ns;
        m->broadcasts = m->table.broadcast_stop_count;
    }
    if (stop != STOP_NOTHING) {
        line_stop_now(m, number, stop);
    }
}

void line_stop_before_setup(line_machine *m, uint32_t number, int64_t now_ns)
{
    line_drive_state *drive = &m->drive[number];
    drive->may_turn = true;
    line_begin_stop(m, number, drive_quick_stop(&drive->state, 0, now_ns), now_ns);
    drive->state.mode = DRIVE_OFF;
}

static drive_view view_of(const line_machine *m, uint32_t number, int64_t now_ns)
{
    const line_drive_state *drive = &m->drive[number];
    int64_t watchdog_ns = m->table.drive[number].watchdog_ns;
    bool asked = m->work == WORK_GROUP && (m->group.waiting >> number & 1) != 0;
    bool busy = asked || (m->work != WORK_NONE && m->worker == number);
    return (drive_view){.now_ns = now_ns,
                        .fresh = line_fresh(m, now_ns),
                        .enabled = m->newest.enabled == 1,
                        .left_alone =
                            !busy && drive_left_alone(drive->answered_ns, now_ns, watchdog_ns),
                        .shut_down = m->control.shut_down != 0,
                        .position_unknown = line_place_is_missing(m, number),
                        .enabled_count = m->enabled_count};
}

void line_guard(line_machine *m, uint32_t number, int64_t now_ns)
{
    line_drive_state *drive = &m->drive[number];
    if (drive->state.mode != DRIVE_ARMED) {
        line_begin_positions(m, number);
    }
    drive_view view = view_of(m, number, now_ns);
    line_begin_stop(m, number, drive_guard(&drive->state, &view), now_ns);
    if (drive_has_to_rest(&drive->state, line_wants_motion(m, number)) && drive->due_ns > now_ns) {
        drive->due_ns = now_ns; /* a stop does not wait for its turn */
    }
    line_begin_stop(m, number, drive_end_stopping(&drive->state, false, now_ns), now_ns);
}

/* ----------------------------------------------------------------------------- requests */
static void set_up(line_machine *m, uint32_t number, int64_t now_ns)
{
    line_drive_state *drive = &m->drive[number];
    bool stops = drive->state.stop != STOP_NOTHING || drive->state.stopping;
    drive->failures = 0;
    drive->may_turn &= stops;
    drive->state.sent_motion &= stops;
    drive->cycle_count = 0;
    drive->extra_next = 0;
    drive->due_ns = now_ns;
    drive->answered_ns = now_ns;
    drive->cycle_start_ns = 0;
    memset(drive->direction_sent, 0, sizeof drive->direction_sent);
    line_forget(m, number);
}

void line_obey_request(line_machine *m, uint32_t number, int64_t now_ns)
{
    line_drive_state *drive = &m->drive[number];
    const mode_request *request = &m->control.drive[number];
    drive_view view = view_of(m, number, now_ns);
    drive->arming_until_ns = request->arming_until_ns;
    drive_answer answer = drive_obey(&drive->state, request, &view);
    m->notify |= answer.request != REQUEST_NONE;
    line_begin_stop(m, number, answer.stop, now_ns);
    if (answer.request == REQUEST_OFF) {
        drive->stage = STAGE_IDLE;
        m->current = m->current == number ? LINE_DRIVES_MAX : m->current;
    } else if (answer.request == REQUEST_SET_UP) {
        set_up(m, number, now_ns);
    } else if (answer.request == REQUEST_ARM) {
        drive->may_turn = true;
        drive->enabled_before = 2; /* a report from before the arming is no loss of power */
        memset(drive->last_sent, 0, sizeof drive->last_sent);
    } else if (answer.request == REQUEST_STAND_DOWN) {
        drive->due_ns = now_ns;
    }
}

/* ------------------------------------------------------------------------- what to send */
static const line_frame *stop_frames(const line_machine *m, uint32_t number, uint32_t *count)
{
    const line_drive *table = &m->table.drive[number];
    bool quick = m->drive[number].state.stop == STOP_QUICK;
    *count = quick ? table->quick_stop_count : table->disarm_count;
    return quick ? table->quick_stop : table->disarm;
}

bool line_next_stop(line_machine *m, uint32_t number, line_frame *out)
{
    line_drive_state *drive = &m->drive[number];
    uint32_t count;
    const line_frame *frame = stop_frames(m, number, &count);
    uint32_t places = count + line_reads_power(m, number);
    for (uint32_t i = 0; i < places; i++) {
        uint32_t place = (drive->stop_place + i) % places;
        if ((drive->stop_done >> place & 1) == 0) {
            drive->stop_doubts = place == drive->stop_place ? drive->stop_doubts : 0;
            drive->stop_place = place;
            if (place == count) {
                line_build_power_read(m, number, out);
            } else {
                *out = frame[place];
            }
            return true;
        }
    }
    m->notify |= drive_stop_done(&drive->state);
    return false;
}

static const line_frame *direction_frame(const line_machine *m, uint32_t number, uint32_t direction,
                                         uint32_t last_sent)
{
    const line_direction *from = &m->table.drive[number].direction[direction];
    return last_sent == DIRECTION_REST      ? &from->rest
           : last_sent == DIRECTION_FORWARD ? &from->forward
                                            : &from->reverse;
}

/* Get the next direction. In REST: rest, if the direction changes. In DIRECTIONS: the new
 * direction. */
static bool next_direction(line_machine *m, uint32_t number, line_frame *out)
{
    line_drive_state *drive = &m->drive[number];
    const line_drive *table = &m->table.drive[number];
    if (drive->state.stopping) {
        return false; /* rest would release the brake: it comes with the power-off */
    }
    for (; drive->place < table->direction_count; drive->place++) {
        uint32_t wanted = line_direction_wanted(m, number, drive->place);
        uint32_t last_sent = drive->direction_sent[drive->place];
        bool resting = drive->stage == STAGE_REST;
        if (wanted == last_sent ||
            (resting && (wanted == DIRECTION_REST || last_sent == DIRECTION_REST))) {
            continue;
        }
        wanted = resting ? DIRECTION_REST : wanted;
        drive->direction_sent[drive->place] = DIRECTION_UNKNOWN; /* until it is acknowledged */
        *out = *direction_frame(m, number, drive->place, wanted);
        return true;
    }
    return false;
}

static bool next_exchange(line_machine *m, uint32_t number, line_frame *out)
{
    line_drive_state *drive = &m->drive[number];
    const line_drive *table = &m->table.drive[number];
    bool writing = drive->stage == STAGE_SETPOINTS;
    for (; drive->place < table->cyclic_count; drive->place++) {
        if ((table->cyclic[drive->place].setpoint_count > 0) == writing &&
            line_sends(m, number, drive->place)) {
            bool motion = line_build(m, number, drive->place, out);
            drive->cycle_motion |= motion;
            drive->state.sent_motion |= motion;
            return true;
        }
    }
    if (writing) {
        drive->state.sent_motion = drive->cycle_motion; /* all frames are acknowledged */
    }
    return false;
}

static bool next_extra(line_machine *m, uint32_t number, line_frame *out)
{
    line_drive_state *drive = &m->drive[number];
    const line_drive *table = &m->table.drive[number];
    if (drive->place > 0 || table->extra_count == 0 || !drive->extra_due) {
        return false;
    }
    *out = table->extra[drive->extra_next].frame;
    return true;
}

void line_cycle_begin(line_machine *m, uint32_t number, int64_t now_ns)
{
    line_drive_state *drive = &m->drive[number];
    const line_drive *table = &m->table.drive[number];
    m->current = number;
    drive->stage = STAGE_REST;
    drive->place = 0;
    drive->cycle_motion = false;
    drive->frozen = m->newest;
    drive->enabled_before = drive->state.enabled;
    drive->extra_due = drive->cycle_count % table->extra_every == 0;
    if (line_power_first(m, number)) {
        drive->extra_due = true;
        drive->extra_next = 0;
    }
    int64_t period_ns = table->period_ns;
    drive->due_ns = drive->due_ns + period_ns > now_ns ? drive->due_ns + period_ns : now_ns;
    if (drive->cycle_start_ns > 0) {
        int64_t took_ns = now_ns - drive->cycle_start_ns;
        drive->cycle_ns += drive->cycle_ns == 0 ? took_ns : (took_ns - drive->cycle_ns) / 8;
    }
    drive->cycle_start_ns = now_ns;
}

static void end_cycle(line_machine *m, uint32_t number)
{
    line_drive_state *drive = &m->drive[number];
    const line_drive *table = &m->table.drive[number];
    m->current = LINE_DRIVES_MAX;
    drive->stage = STAGE_IDLE;
    drive->cycle_count++;
    drive->count.cycles++;
    if (drive->lost_setup) {
        line_begin_stop(m, number, drive_lost_setup(&drive->state), drive->cycle_start_ns);
    }
    line_publish(m, number);
    line_begin_stop(
        m, number,
        drive_end_stopping(&drive->state, line_at_rest(m, number), drive->cycle_start_ns),
        drive->cycle_start_ns);
    /* The power-off may clear the fault because of which it disabled itself. A cycle reads faults
     * before power, so this is judged at the end of the next cycle, even if it has power again by
     * then. */
    if (drive->state.mode == DRIVE_ARMED && drive->enabled_before == 0) {
        drive->state.enabled = 0;
    } else if (drive->state.mode == DRIVE_ARMED && drive->state.enabled == 0) {
        return;
    }
    bool settled = drive->cycle_start_ns >= drive->arming_until_ns;
    line_begin_stop(m, number, drive_check_power(&drive->state, table->tries, settled),
                    drive->cycle_start_ns);
}

bool line_next_in_cycle(line_machine *m, uint32_t number, int64_t now_ns, line_frame *out)
{
    line_drive_state *drive = &m->drive[number];
    (void)now_ns;
    while (drive->stage != STAGE_IDLE) {
        bool found = drive->stage == STAGE_REST || drive->stage == STAGE_DIRECTIONS
                         ? next_direction(m, number, out)
                     : drive->stage == STAGE_EXTRA ? next_extra(m, number, out)
                                                   : next_exchange(m, number, out);
        if (found) {
            return true;
        }
        if (drive->stage == STAGE_EXTRA) {
            end_cycle(m, number);
            return false;
        }
        drive->stage++;
        drive->place = 0;
    }
    return false;
}

/* ----------------------------------------------------------------------------- outcomes */
static void direction_acknowledged(line_drive_state *drive, const line_machine *m, uint32_t number)
{
    uint32_t wanted = drive->stage == STAGE_REST ? (uint32_t)DIRECTION_REST
                                                 : line_direction_wanted(m, number, drive->place);
    const line_frame *sent = direction_frame(m, number, drive->place, wanted);
    if (memcmp(sent->request, m->transaction.frame.request, sent->request_bytes) != 0) {
        wanted = DIRECTION_UNKNOWN; /* the set-point has changed during the sending */
    }
    drive->direction_sent[drive->place] = wanted;
    if (wanted == DIRECTION_FORWARD || wanted == DIRECTION_REVERSE) {
        drive->direction_last[drive->place] = wanted;
    }
    drive->place++;
}

static bool reads_on(const line_drive *table, uint32_t place)
{
    for (; place < table->cyclic_count; place++) {
        if (table->cyclic[place].field_count > 0) {
            return true;
        }
    }
    return false;
}

/* `stamp_ns` 0: the time of the values is unknown. */
static void read_reply(line_machine *m, uint32_t number, const line_exchange *turn,
                       const uint8_t *reply, int64_t stamp_ns)
{
    if (stamp_ns > 0) {
        line_read(m, number, turn, reply, stamp_ns);
    }
}

static void cycle_answered(line_machine *m, uint32_t number, const uint8_t *reply, int64_t stamp_ns)
{
    line_drive_state *drive = &m->drive[number];
    const line_drive *table = &m->table.drive[number];
    if (m->current != number) {
        return; /* the drive was stopped while this was in transit */
    }
    if (drive->stage == STAGE_REST || drive->stage == STAGE_DIRECTIONS) {
        direction_acknowledged(drive, m, number);
    } else if (drive->stage == STAGE_EXTRA) {
        read_reply(m, number, &table->extra[drive->extra_next], reply, stamp_ns);
        drive->extra_next = (drive->extra_next + 1) % table->extra_count;
        drive->place = 1;
    } else {
        read_reply(m, number, &table->cyclic[drive->place], reply, stamp_ns);
        drive->place++;
        if (!reads_on(table, drive->place)) {
            line_publish(m, number); /* the core need not wait until the line is free again */
        }
    }
}

/* Whether the frame in progress belongs to the newest stop: an older one proves nothing about
 * it. */
static bool is_of_newest_stop(const line_machine *m, uint32_t number)
{
    const line_frame *sent = &m->transaction.frame;
    uint32_t count;
    const line_frame *frame = stop_frames(m, number, &count);
    uint32_t place = m->drive[number].stop_place;
    if (place == count && line_reads_power(m, number)) {
        return true; /* the frames before it have gone out */
    }
    return place < count && sent->request_bytes == frame[place].request_bytes &&
           memcmp(sent->request, frame[place].request, sent->request_bytes) == 0;
}

void line_stop_doubted(line_machine *m, uint32_t number)
{
    m->drive[number].stop_doubts += m->work == WORK_STOP && is_of_newest_stop(m, number);
}

static void stop_frame_done(line_machine *m, uint32_t number)
{
    line_drive_state *drive = &m->drive[number];
    drive->stop_failures = 0;
    if (is_of_newest_stop(m, number)) {
        drive->stop_done |= 1U << drive->stop_place;
    }
}

static void stop_frame_answered(line_machine *m, uint32_t number, const uint8_t *reply,
                                int64_t now_ns)
{
    line_drive_state *drive = &m->drive[number];
    bool reads = line_reads_power(m, number) && is_of_newest_stop(m, number);
    /* the frame has left; whether it was received is unknown */
    if (reads && m->transaction.frame.reply_bytes == 0) {
        drive->state.enabled = 2;
        drive->stop_sent |= 1U << drive->stop_place++;
    } else if (reads && drive->stop_place == m->table.drive[number].disarm_count) {
        drive->stop_failures = 0;
        drive->stop_done = line_is_off(m, number, reply, now_ns) ? ~0U : drive->stop_done;
        drive->stop_place++;
    } else {
        stop_frame_done(m, number);
    }
}

/* At the end everything is sent, even without answers: a silent drive may still receive. */
static void stop_frame_failed(line_machine *m, uint32_t number, uint32_t failure)
{
    line_drive_state *drive = &m->drive[number];
    drive->stop_failures++;
    if (failure == ANSWER_REFUSED && drive->stop_failures >= m->table.drive[number].tries) {
        drive->stop_refused |= is_of_newest_stop(m, number);
        stop_frame_done(m, number); /* the drive responds and refuses: the next frame may work */
        drive->failures = 0;
    } else if (m->end.stage != END_NOT && is_of_newest_stop(m, number)) {
        drive->stop_sent |= 1U << drive->stop_place++;
    }
}

void line_drive_answered(line_machine *m, uint32_t number, const uint8_t *reply, int64_t now_ns)
{
    line_drive_state *drive = &m->drive[number];
    int64_t watchdog_ns = m->table.drive[number].watchdog_ns;
    line_settle(m, number, now_ns);
    int64_t took_ns = now_ns - m->end_ns - line_reply_ns(m, &m->transaction.frame);
    int64_t stamp_ns =
        drive->usual_ns == 0 || took_ns <= drive->usual_ns ? line_stamp(m, number, now_ns) : 0;
    if (drive->state.mode == DRIVE_ARMED &&
        drive_left_alone(drive->answered_ns, m->end_ns, watchdog_ns)) {
        line_begin_stop(m, number, drive_quick_stop(&drive->state, DRIVE_FAULT_LEFT_ALONE, now_ns),
                        now_ns);
    }
    /* else the answer may belong to a request that counted as failed: then the drive is late, not
     * well */
    if (drive->owed_count == 0) {
        drive->failures = 0;
    }
    drive->answered_ns = m->end_ns;
    drive->count.exchanges++;
    drive->count.received_ns = now_ns;
    if (m->transaction.frame.reply_bytes > 0) {
        line_learn_turnaround(m, number, now_ns);
    }
    if (m->work == WORK_CYCLE) {
        cycle_answered(m, number, reply, stamp_ns);
    } else if (m->work == WORK_GROUP) {
        line_group_answered(m, number, reply, stamp_ns);
    } else if (m->work == WORK_STOP) {
        stop_frame_answered(m, number, reply, now_ns);
    } else if (m->work == WORK_PROBE) {
        bool brakes = drive->may_turn && !drive->probes_power_off;
        m->notify = true;
        line_begin_stop(m, number, drive_answers(&drive->state, brakes), now_ns);
    }
}

static void count_failure(line_drive_state *drive, uint32_t failure, uint32_t exception)
{
    drive->failures++;
    drive->last_failure = failure;
    drive->last_exception = exception;
    drive->count.no_reply += failure == ANSWER_NO_REPLY;
    drive->count.bad_reply += failure == ANSWER_BAD_REPLY || failure == ANSWER_NEVER_SILENT;
    drive->count.refused += failure == ANSWER_REFUSED;
}

void line_drive_failed(line_machine *m, uint32_t number, uint32_t failure, uint32_t exception,
                       int64_t now_ns)
{
    line_drive_state *drive = &m->drive[number];
    const line_drive *table = &m->table.drive[number];
    count_failure(drive, failure, exception);
    drive->count.exchanges++;
    if (failure != ANSWER_REFUSED) {
        int64_t doubled_ns = 2 * drive->deadline_ns;
        drive->deadline_ns = doubled_ns < table->turnaround_ns ? doubled_ns : table->turnaround_ns;
        drive->silent_until_ns =
            m->end_ns + table->turnaround_ns + line_reply_ns(m, &m->transaction.frame);
        line_owe(m, number);
    }
    drive->stage = STAGE_IDLE;
    if (m->current == number) {
        m->current = LINE_DRIVES_MAX;
    }
    if (m->work == WORK_STOP) {
        stop_frame_failed(m, number, failure);
    }
    bool counts = drive->state.mode == DRIVE_READY || drive->state.mode == DRIVE_ARMED ||
                  drive->state.stop != STOP_NOTHING;
    /* a drive that refuses responds: send it the rest of its stop */
    counts &= m->work != WORK_STOP || failure != ANSWER_REFUSED;
    if (counts && drive->failures >= table->tries) {
        line_becomes_unresponsive(m, number, now_ns);
    }
}

void line_drive_not_reached(line_machine *m, uint32_t number, int64_t now_ns)
{
    line_drive_state *drive = &m->drive[number];
    count_failure(drive, ANSWER_NEVER_SILENT, 0);
    drive->due_ns = now_ns;
    if (drive->failures >= m->table.drive[number].tries) {
        line_becomes_unresponsive(m, number, now_ns);
    }
}
