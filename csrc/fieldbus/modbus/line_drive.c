/* SPDX-License-Identifier: Apache-2.0
 * line_drive.c: one drive of a line: what it is told and asked, whether it is there, and when it has to stop. */
#include <string.h>

#include "line_machine.h"
#include "fresh.h"

static const int64_t STOPPING_NS = 1000 * LINE_MS;

bool line_fresh(const line_machine *m, int64_t now_ns)
{
    return fresh_stamp(now_ns, m->newest.stamp_ns, m->table.setpoint_timeout_ns);
}

int64_t line_reply_ns(const line_machine *m, const line_frame *frame)
{
    return (int64_t)((double)frame->reply_bytes * m->table.character_ns);
}

/* -------------------------------------------------------------------------------------------------- stopping */
void line_stop_now(line_machine *m, uint32_t number, uint32_t kind)
{
    line_drive_state *drive = &m->drive[number];
    drive->stop = kind;
    drive->stop_place = drive->stop_done = drive->stop_told = 0;
    drive->stop_failures = 0;
    drive->stop_refused = false;
    drive->stage = STAGE_IDLE;
    memset(drive->way_told, 0, sizeof drive->way_told);
    if (m->current == number) {
        m->current = LINE_DRIVES_MAX;
    }
}

void line_demote(line_machine *m, uint32_t number, uint32_t why, uint32_t mode)
{
    line_drive_state *drive = &m->drive[number];
    drive->mode = mode;
    drive->demoted |= why;
    drive->enabled = 2;
    m->news = true;
}

static void quick_stop(line_machine *m, uint32_t number, uint32_t why, int64_t now_ns)
{
    line_drive_state *drive = &m->drive[number];
    line_demote(m, number, why, DRIVE_READY);
    drive->stopping = true;
    drive->off_by_ns = now_ns + STOPPING_NS;
    drive->due_ns = now_ns;
    m->broadcasts = m->table.broadcast_stop_count;
    line_stop_now(m, number, STOP_QUICK);
}

void line_stop_unheard(line_machine *m, uint32_t number, int64_t now_ns)
{
    m->drive[number].may_turn = true;
    quick_stop(m, number, 0, now_ns);
    m->drive[number].mode = DRIVE_OFF;
}

static void power_off(line_machine *m, uint32_t number)
{
    m->drive[number].stopping = false;
    line_stop_now(m, number, STOP_POWER_OFF);
}

static void guard_armed(line_machine *m, uint32_t number, int64_t now_ns)
{
    line_drive_state *drive = &m->drive[number];
    int64_t watchdog_ns = m->table.drive[number].watchdog_ns;
    bool busy = m->work != WORK_NONE && m->worker == number;
    if (!line_fresh(m, now_ns)) {
        quick_stop(m, number, DEMOTED_SETPOINTS_OLD, now_ns);
    } else if (watchdog_ns > 0 && !busy && now_ns - drive->answered_ns > watchdog_ns) {
        quick_stop(m, number, DEMOTED_LEFT_ALONE, now_ns);
    } else if (m->newest.enabled == 1) {
        drive->was_enabled = true;
    } else if (drive->was_enabled || drive->enabled_count != m->enabled_count) {
        line_demote(m, number, DEMOTED_NOT_ENABLED, DRIVE_READY);
        power_off(m, number);
    }
}

void line_guard(line_machine *m, uint32_t number, int64_t now_ns)
{
    line_drive_state *drive = &m->drive[number];
    if (drive->mode == DRIVE_ARMED) {
        guard_armed(m, number, now_ns);
    }
    if (drive->told_motion && !line_wants_motion(m, number) && drive->due_ns > now_ns) {
        drive->due_ns = now_ns; /* a stop does not wait for its turn */
    }
    if (drive->stopping && drive->stop == STOP_NOTHING && now_ns >= drive->off_by_ns) {
        power_off(m, number);
    }
}

/* ---------------------------------------------------------------------------------------------------- wishes */
/* A stop that is pending stays so, whatever is requested after it. */
static void set_up(line_machine *m, uint32_t number, int64_t now_ns)
{
    line_drive_state *drive = &m->drive[number];
    bool stops = drive->stop != STOP_NOTHING || drive->stopping;
    drive->mode = DRIVE_READY;
    drive->epoch++;
    drive->demoted = drive->failures = drive->still_enabled = 0;
    drive->may_turn &= stops;
    drive->told_motion &= stops;
    drive->back = false;
    drive->cycle_count = 0;
    drive->extra_next = 0;
    drive->due_ns = now_ns;
    drive->answered_ns = now_ns;
    drive->cycle_start_ns = 0;
    memset(drive->way_told, 0, sizeof drive->way_told);
    line_forget(m, number);
}

static void arm(line_machine *m, uint32_t number, int64_t now_ns)
{
    line_drive_state *drive = &m->drive[number];
    if (!line_fresh(m, now_ns) || drive->stopping || drive->stop != STOP_NOTHING || m->control.shut_down != 0) {
        return;
    }
    drive->mode = DRIVE_ARMED;
    drive->may_turn = true;
    drive->was_enabled = false;
    drive->enabled_count = m->enabled_count;
    drive->demoted = 0;
    drive->still_enabled = 0;
    drive->enabled = 2;
    memset(drive->told, 0, sizeof drive->told);
}

void line_obey_wish(line_machine *m, uint32_t number, int64_t now_ns)
{
    line_drive_state *drive = &m->drive[number];
    const drive_wish *wish = &m->control.drive[number];
    drive->arming_until_ns = wish->arming_until_ns;
    if (wish->count == drive->wish_seen) {
        return;
    }
    bool overtaken = wish->count - drive->wish_seen > 1; /* one that was never seen may have been a stop */
    drive->wish_seen = wish->count;
    m->news = true;
    if ((overtaken || wish->mode == DRIVE_OFF) && (drive->mode == DRIVE_ARMED || drive->stopping || drive->told_motion)) {
        power_off(m, number);
    }
    if (overtaken && drive->mode == DRIVE_ARMED) {
        drive->mode = DRIVE_READY;
        drive->enabled = 2;
    }
    if (wish->mode == DRIVE_OFF) {
        drive->mode = DRIVE_OFF;
        drive->back = false;
        drive->stage = STAGE_IDLE;
        m->current = m->current == number ? LINE_DRIVES_MAX : m->current;
    } else if (wish->mode == DRIVE_READY && (drive->mode == DRIVE_OFF || drive->mode == DRIVE_BACK)) {
        set_up(m, number, now_ns);
    } else if (wish->mode == DRIVE_ARMED && drive->mode == DRIVE_READY) {
        arm(m, number, now_ns);
    } else if (wish->mode == DRIVE_STAND_DOWN && drive->mode == DRIVE_ARMED) {
        drive->mode = DRIVE_READY;
        drive->enabled = 2;
        drive->due_ns = now_ns;
    }
}

/* ----------------------------------------------------------------------------------------------- what to send */
static const line_frame *stop_frames(const line_machine *m, uint32_t number, uint32_t *count)
{
    const line_drive *table = &m->table.drive[number];
    bool quick = m->drive[number].stop == STOP_QUICK;
    *count = quick ? table->quick_stop_count : table->disarm_count;
    return quick ? table->quick_stop : table->disarm;
}

bool line_next_stop(line_machine *m, uint32_t number, line_frame *out)
{
    line_drive_state *drive = &m->drive[number];
    uint32_t count;
    const line_frame *frame = stop_frames(m, number, &count);
    for (uint32_t i = 0; i < count; i++) {
        uint32_t place = (drive->stop_place + i) % count;
        if ((drive->stop_done >> place & 1) == 0) {
            drive->stop_place = place;
            *out = frame[place];
            return true;
        }
    }
    drive->stop = STOP_NOTHING;
    drive->enabled = 2;
    if (drive->back) {
        drive->back = false;
        drive->mode = DRIVE_BACK;
        m->news = true;
    }
    return false;
}

static const line_frame *way_frame(const line_machine *m, uint32_t number, uint32_t way, uint32_t told)
{
    const line_way *from = &m->table.drive[number].way[way];
    return told == WAY_REST ? &from->rest : told == WAY_FORWARD ? &from->forward : &from->reverse;
}

/* In REST: rest where another way than the told one comes. In WAYS: the way itself. */
static bool next_way(line_machine *m, uint32_t number, line_frame *out)
{
    line_drive_state *drive = &m->drive[number];
    const line_drive *table = &m->table.drive[number];
    if (drive->stopping) {
        return false; /* rest would take its brake off: it comes with the power-off */
    }
    for (; drive->place < table->way_count; drive->place++) {
        uint32_t wanted = line_way_wanted(m, number, drive->place);
        uint32_t told = drive->way_told[drive->place];
        bool resting = drive->stage == STAGE_REST;
        if (wanted == told || (resting && (wanted == WAY_REST || told == WAY_REST))) {
            continue;
        }
        wanted = resting ? WAY_REST : wanted;
        drive->way_told[drive->place] = WAY_UNKNOWN; /* until it is acknowledged */
        *out = *way_frame(m, number, drive->place, wanted);
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
        if ((table->cyclic[drive->place].setpoint_count > 0) == writing) {
            bool motion = line_build(m, number, drive->place, out);
            drive->cycle_motion |= motion;
            drive->told_motion |= motion;
            return true;
        }
    }
    if (writing) {
        drive->told_motion = drive->cycle_motion; /* all acknowledged */
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
    drive->extra_due = drive->cycle_count % table->extra_every == 0;
    if (drive->enabled == 2 && table->extra_count > 0) {
        drive->extra_due = true; /* whether it is enabled comes first of all: it is in the first range */
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
    line_publish(m, number);
    if (drive->lost_setup) {
        line_demote(m, number, DEMOTED_LOST_SETUP, DRIVE_OFF);
        power_off(m, number);
    } else if (drive->mode == DRIVE_ARMED && drive->enabled == 0) {
        line_demote(m, number, DEMOTED_DISABLED_ITSELF, DRIVE_OFF);
        power_off(m, number);
    } else if (drive->stopping && line_at_rest(m, number)) {
        power_off(m, number);
    }
    bool armed_by_nobody = drive->mode == DRIVE_READY && drive->enabled == 1 && !drive->stopping && drive->stop == STOP_NOTHING &&
                           drive->cycle_start_ns >= drive->arming_until_ns;
    drive->still_enabled = armed_by_nobody ? drive->still_enabled + 1 : drive->enabled == 0 ? 0 : drive->still_enabled;
    if (armed_by_nobody) {
        if (drive->still_enabled == table->tries) {
            drive->demoted |= DEMOTED_STILL_ENABLED;
            m->news = true;
        }
        power_off(m, number);
    }
}

bool line_next_in_cycle(line_machine *m, uint32_t number, int64_t now_ns, line_frame *out)
{
    line_drive_state *drive = &m->drive[number];
    (void)now_ns;
    while (drive->stage != STAGE_IDLE) {
        bool found = drive->stage == STAGE_REST || drive->stage == STAGE_WAYS ? next_way(m, number, out)
                     : drive->stage == STAGE_EXTRA                            ? next_extra(m, number, out)
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

/* --------------------------------------------------------------------------------------------------- outcomes */
static void way_acknowledged(line_drive_state *drive, const line_machine *m, uint32_t number)
{
    uint32_t wanted = drive->stage == STAGE_REST ? (uint32_t)WAY_REST : line_way_wanted(m, number, drive->place);
    const line_frame *sent = way_frame(m, number, drive->place, wanted);
    if (memcmp(sent->request, m->transaction.frame.request, sent->request_bytes) != 0) {
        wanted = WAY_UNKNOWN; /* the wish has changed while it was on its way */
    }
    drive->way_told[drive->place] = wanted;
    if (wanted == WAY_FORWARD || wanted == WAY_REVERSE) {
        drive->way_last[drive->place] = wanted;
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

/* `stamp_ns` 0: when the values were taken is not known. */
static void read_reply(line_machine *m, uint32_t number, const line_exchange *turn, const uint8_t *reply, int64_t stamp_ns)
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
        return; /* it was stopped while this was on its way */
    }
    if (drive->stage == STAGE_REST || drive->stage == STAGE_WAYS) {
        way_acknowledged(drive, m, number);
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

/* The one under way may be of an older stop: that says nothing of the newest one. */
static bool is_of_newest_stop(const line_machine *m, uint32_t number)
{
    const line_frame *sent = &m->transaction.frame;
    uint32_t count;
    const line_frame *frame = stop_frames(m, number, &count);
    uint32_t place = m->drive[number].stop_place;
    return place < count && sent->request_bytes == frame[place].request_bytes &&
           memcmp(sent->request, frame[place].request, sent->request_bytes) == 0;
}

static void stop_frame_done(line_machine *m, uint32_t number)
{
    line_drive_state *drive = &m->drive[number];
    drive->stop_failures = 0;
    if (is_of_newest_stop(m, number)) {
        drive->stop_done |= 1U << drive->stop_place;
    }
}

/* At the end all is told, whatever the drive does not answer: it may hear us though we do not hear it. */
static void stop_frame_failed(line_machine *m, uint32_t number, uint32_t failure)
{
    line_drive_state *drive = &m->drive[number];
    drive->stop_failures++;
    if (failure == ANSWER_REFUSED && drive->stop_failures >= m->table.drive[number].tries) {
        drive->stop_refused |= is_of_newest_stop(m, number);
        stop_frame_done(m, number); /* it is there and will not: the next frame may do */
    } else if (m->shut != 0 && is_of_newest_stop(m, number)) {
        drive->stop_told |= 1U << drive->stop_place++;
    }
}

void line_drive_answered(line_machine *m, uint32_t number, const uint8_t *reply, int64_t now_ns)
{
    line_drive_state *drive = &m->drive[number];
    int64_t watchdog_ns = m->table.drive[number].watchdog_ns;
    line_settle(m, number, now_ns);
    int64_t took_ns = now_ns - m->end_ns - line_reply_ns(m, &m->transaction.frame);
    int64_t stamp_ns = drive->usual_ns == 0 || took_ns <= drive->usual_ns ? line_stamp(m, number, now_ns) : 0;
    if (drive->mode == DRIVE_ARMED && watchdog_ns > 0 && m->end_ns - drive->answered_ns > watchdog_ns) {
        quick_stop(m, number, DEMOTED_LEFT_ALONE, now_ns);
    }
    if (drive->owed_count == 0) { /* else it may be the answer to one that counted as failed: it is late, not well */
        drive->failures = 0;
    }
    drive->answered_ns = m->end_ns;
    drive->count.exchanges++;
    drive->count.heard_ns = now_ns;
    if (m->transaction.frame.reply_bytes > 0) {
        line_learn_turnaround(m, number, now_ns);
    }
    if (m->work == WORK_CYCLE) {
        cycle_answered(m, number, reply, stamp_ns);
    } else if (m->work == WORK_STOP) {
        stop_frame_done(m, number);
    } else if (m->work == WORK_PROBE) {
        drive->back = true;
        line_stop_now(m, number, STOP_POWER_OFF);
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

void line_drive_failed(line_machine *m, uint32_t number, uint32_t failure, uint32_t exception, int64_t now_ns)
{
    line_drive_state *drive = &m->drive[number];
    const line_drive *table = &m->table.drive[number];
    count_failure(drive, failure, exception);
    drive->count.exchanges++;
    if (failure != ANSWER_REFUSED) {
        int64_t doubled_ns = 2 * drive->deadline_ns;
        drive->deadline_ns = doubled_ns < table->turnaround_ns ? doubled_ns : table->turnaround_ns;
        drive->quiet_until_ns = m->end_ns + table->turnaround_ns + line_reply_ns(m, &m->transaction.frame);
        line_owe(m, number);
    }
    drive->stage = STAGE_IDLE;
    if (m->current == number) {
        m->current = LINE_DRIVES_MAX;
    }
    if (m->work == WORK_STOP) {
        stop_frame_failed(m, number, failure);
    }
    bool counts = drive->mode == DRIVE_READY || drive->mode == DRIVE_ARMED || drive->stop != STOP_NOTHING;
    if (counts && drive->failures >= table->tries) {
        line_go_quiet(m, number, now_ns);
    }
}

void line_drive_not_reached(line_machine *m, uint32_t number, int64_t now_ns)
{
    line_drive_state *drive = &m->drive[number];
    count_failure(drive, ANSWER_NEVER_SILENT, 0);
    drive->due_ns = now_ns;
    if (drive->failures >= m->table.drive[number].tries) {
        line_go_quiet(m, number, now_ns);
    }
}
