/* SPDX-License-Identifier: Apache-2.0
 * board_drive.c: the mode of a board, whether it responds, and when it has to stop. */
#include "board_machine.h"
#include "fresh.h"

/* ----------------------------------------------------------------------------- stopping */
void board_hold(board_machine *m, const board_write *write, uint32_t count, int64_t now_ns)
{
    for (uint32_t i = 0; i < count; i++) {
        board_put(m->held, &write[i].place, write[i].raw);
        m->written_ns = now_ns;
    }
}

/* Put the writes of the stop that the rules have decided into the payload. */
void board_begin_stop(board_machine *m, drive_stop stop, int64_t now_ns)
{
    m->notify |= drive_is_changed(&m->state);
    if (stop == STOP_NOTHING) {
        return;
    }
    bool quick = stop == STOP_QUICK;
    board_hold(m, quick ? m->table.quick_stop : m->table.disarm,
               quick ? m->table.quick_stop_count : m->table.disarm_count, now_ns);
    m->stops++;
    m->state.stop = stop;
}

void board_power_off(board_machine *m, int64_t now_ns)
{
    board_begin_stop(m, drive_power_off(&m->state), now_ns);
}

void board_take_over(board_machine *m, int64_t now_ns)
{
    m->received_ns = now_ns;
    board_begin_stop(m, drive_quick_stop(&m->state, 0, now_ns), now_ns);
}

/* --------------------------------------------------------- the last power-off of a line */
static bool reports_power(const board_machine *m)
{
    for (uint32_t i = 0; i < m->table.field_count; i++) {
        if (m->table.field[i].meaning.kind == FIELD_ENABLED) {
            return true;
        }
    }
    return false;
}

void board_note_power(board_machine *m, int64_t now_ns)
{
    bool rests = m->state.mode == DRIVE_READY && !m->state.stopping &&
                 m->state.stop == STOP_NOTHING && !m->state.sent_motion;
    bool settled = now_ns >= m->control.request.arming_until_ns && !m->has_order &&
                   m->knows_ns >= m->written_ns;
    m->off_suffices =
        m->table.answers == 0 || (rests && settled && (!reports_power(m) || m->state.enabled == 0));
}

void board_last_power_off(board_machine *m, int64_t now_ns)
{
    board_power_off(m, now_ns);
    m->off_waits = !m->off_suffices;
}

/* Note that the last power-off goes out, in every cycle of the end. */
static void note_last_power_off(board_machine *m, int64_t now_ns)
{
    if (m->end.stage != END_POWER_OFF) {
        return;
    }
    m->off_first_ns = m->off_first_ns == 0 ? now_ns : m->off_first_ns;
    m->off_again_ns = m->off_again_ns == 0 && m->off_word_ns > 0 ? now_ns : m->off_again_ns;
}

/* Check whether the board has received the last power-off. Frames show which of motord's frames the
 * board has received. Other feedback does not, and may have been in transit before a wire was cut:
 * two are needed, with the power-off between them. */
void board_look_for_proof(board_machine *m)
{
    bool frames = m->table.dialect == BOARD_FRAMES, reports = reports_power(m);
    bool between = m->off_again_ns > 0 && m->off_word_ns > m->off_again_ns;
    bool knows = m->off_first_ns > 0 && (frames    ? m->knows_ns >= m->off_first_ns
                                         : reports ? m->off_word_ns > 0
                                                   : between);
    m->off_waits &= !knows || (reports && m->state.enabled != 0);
}

/* ----------------------------------------------------------------------------- presence */
static void becomes_unresponsive(board_machine *m, int64_t now_ns)
{
    m->unresponsive++;
    /* the board may still receive: the stop goes out in every cycle from now on */
    board_begin_stop(m, drive_quick_stop(&m->state, 0, now_ns), now_ns);
    drive_unresponsive(&m->state);
    m->feedback_bytes = 0;
}

void board_sent(board_machine *m, int64_t now_ns)
{
    bool stopped = m->state.stop != STOP_NOTHING;
    m->last_sent_ns = now_ns;
    if (m->order_written) {
        m->order_written = m->has_order = false;
        m->orders_sent++;
        m->notify = true;
    }
    if (stopped) {
        m->notify |= drive_stop_done(&m->state);
    }
    note_last_power_off(m, now_ns);
    if (m->table.answers == 0) { /* the port has taken the bytes: nothing more can be known */
        m->stamp_ns = m->knows_ns = now_ns;
        board_received(m, now_ns);
    }
}

/* ----------------------------------------------------------------------------- its word */
/* Evaluate the drive's report, made after the drive had received the payload's writes. */
static void believe(board_machine *m, bool kept, int64_t now_ns)
{
    bool settled = now_ns >= m->control.request.arming_until_ns;
    if (!kept) {
        board_begin_stop(m, drive_lost_setup(&m->state), now_ns);
    }
    board_begin_stop(m, drive_check_power(&m->state, m->table.tries, settled), now_ns);
}

void board_received(board_machine *m, int64_t now_ns)
{
    m->received_ns = now_ns;
    bool kept = board_read(m);
    m->off_word_ns = m->off_first_ns > 0 ? now_ns : 0;
    bool cycled = drive_is_cycled(&m->state);
    if (cycled && m->knows_ns >= m->written_ns) {
        believe(m, kept, now_ns);
    }
    if (cycled) {
        board_publish(m); /* with the epoch that a lost set-up begins */
    }
    if (m->state.mode == DRIVE_UNRESPONSIVE && !m->state.back && m->end.stage == END_NOT) {
        m->notify = true; /* the quick stop is in its payload */
        board_begin_stop(m, drive_answers(&m->state, true), now_ns);
    }
}

/* ----------------------------------------------------------------------------- guarding */
static drive_view view_of(const board_machine *m, int64_t now_ns)
{
    return (drive_view){
        .now_ns = now_ns,
        .fresh = fresh_stamp(now_ns, m->newest.stamp_ns, m->table.setpoint_timeout_ns),
        .enabled = m->newest.enabled == 1,
        .left_alone = drive_left_alone(m->last_sent_ns, now_ns, m->table.watchdog_ns),
        .shut_down = m->control.shut_down != 0,
        .enabled_count = m->enabled_count};
}

void board_guard(board_machine *m, int64_t now_ns)
{
    drive_view view = view_of(m, now_ns);
    board_begin_stop(m, drive_guard(&m->state, &view), now_ns);
    if (drive_is_cycled(&m->state) && now_ns - m->received_ns > m->table.silence_ns) {
        becomes_unresponsive(m, now_ns);
    }
    bool rests = m->knows_ns >= m->written_ns && board_at_rest(m);
    board_begin_stop(m, drive_end_stopping(&m->state, rests, now_ns), now_ns);
}

/* ----------------------------------------------------------------------------- requests */
/* Obey a request. A board follows the values that stay in its payload, so it is switched off in any
 * state. */
void board_obey_request(board_machine *m, int64_t now_ns)
{
    drive_view view = view_of(m, now_ns);
    const mode_request *request = &m->control.request;
    drive_answer answer = drive_obey(&m->state, request, &view);
    bool is_new = answer.request != REQUEST_NONE;
    m->notify |= is_new;
    board_begin_stop(m, answer.stop, now_ns);
    bool stands_down =
        is_new && request->mode == DRIVE_STAND_DOWN && m->state.mode != DRIVE_UNRESPONSIVE;
    if (answer.request == REQUEST_OFF || stands_down) {
        board_power_off(m, now_ns);
    } else if (answer.request == REQUEST_SET_UP) {
        m->received_ns = now_ns; /* a board that was set up has just reported, or cannot report */
        board_forget(m);
    } else if (answer.request == REQUEST_ARM) {
        m->last_sent_ns = now_ns;
    }
}
