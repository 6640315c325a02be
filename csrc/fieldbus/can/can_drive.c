/* SPDX-License-Identifier: Apache-2.0
 * can_drive.c: one drive of a CAN line: what it is sent, whether it responds, when it has to
 * stop. */
#include <string.h>

#include "can_machine.h"
#include "fresh.h"

static const int64_t PROBE_LAST_NS = 2000 * CAN_MS;
/* at the end: interval at which a power-off is repeated */
static const int64_t OFF_AGAIN_NS = 10 * CAN_MS;
static const int64_t HELLO_GOOD_FOR_NS = 5000 * CAN_MS; /* time for the set-up */

/* ------------------------------------------------------------------------------ sending */
bool can_send(can_machine *m, const can_packet *packet)
{
    bool went = m->send(m->sink, packet);
    m->sent += went;
    m->tx_full += !went;
    m->clogged &= !went;
    return went;
}

void can_sync(can_machine *m)
{
    for (uint32_t i = 0; i < m->table.sync_count; i++) {
        (void)can_send(m, &m->table.sync[i]);
    }
}

bool can_write_out(can_machine *m, uint32_t drive, const can_write *write)
{
    can_packet packet = write->packet;
    if (write->output > 0) {
        uint8_t *held = m->drive[drive].held[write->output - 1];
        can_hold_positions(m, drive, write->output - 1);
        for (uint32_t i = 0; i < CAN_BYTES_MAX; i++) {
            held[i] = (uint8_t)((held[i] & ~write->mask[i]) | (packet.data[i] & write->mask[i]));
        }
        memcpy(packet.data, held, CAN_BYTES_MAX);
    }
    return can_send(m, &packet);
}

void can_hold_nothing(can_machine *m, uint32_t drive)
{
    for (uint32_t o = 0; o < CAN_OUTPUTS_MAX; o++) {
        memcpy(m->drive[drive].held[o], m->table.drive[drive].output[o].packet.data, CAN_BYTES_MAX);
    }
}

static bool write_all(can_machine *m, uint32_t number, const can_write *write, uint32_t count)
{
    bool all = true;
    for (uint32_t i = 0; i < count; i++) {
        all &= can_write_out(m, number, &write[i]);
    }
    return all;
}

static void send_all(can_machine *m, const can_packet *poll, uint32_t count)
{
    for (uint32_t i = 0; i < count; i++) {
        (void)can_send(m, &poll[i]);
    }
}

static void send_setpoints(can_machine *m, uint32_t number, int64_t now_ns)
{
    can_drive_state *drive = &m->drive[number];
    bool motion = false, all = true, held_back = false;
    for (uint32_t o = 0; o < m->table.drive[number].output_count; o++) {
        can_packet packet;
        if (!can_sends(m, number, o)) {
            held_back = true;
            continue;
        }
        can_hold_positions(m, number, o);
        bool moves = can_build(m, number, o, &packet);
        motion |= moves;
        drive->state.sent_motion |= moves;
        bool went = can_send(m, &packet);
        all &= went;
        if (went) {
            can_note_positions(m, number, o);
            memcpy(drive->last_sent[o], packet.data, packet.bytes);
        }
        if (moves && went && m->motion_since_ns == 0) {
            m->motion_since_ns = now_ns;
        }
    }
    if (all) {
        drive->state.sent_motion = motion;
        drive->last_sent_ns = held_back ? drive->last_sent_ns : now_ns;
    }
}

bool can_differs(const can_machine *m, uint32_t number)
{
    for (uint32_t o = 0; o < m->table.drive[number].output_count; o++) {
        can_packet packet;
        if (!can_sends(m, number, o)) {
            continue;
        }
        (void)can_build(m, number, o, &packet);
        if (memcmp(m->drive[number].last_sent[o], packet.data, packet.bytes) != 0) {
            return true;
        }
    }
    return false;
}

void can_send_setpoints(can_machine *m, uint32_t number, int64_t now_ns)
{
    const can_drive_state *drive = &m->drive[number];
    /* the drive has power, so zero does not switch it on */
    bool moves = drive->state.sent_motion && drive->state.stop == STOP_NOTHING;
    if (drive->state.mode == DRIVE_ARMED || drive->state.stopping || moves ||
        m->table.drive[number].idle_setpoints != 0) {
        send_setpoints(m, number, now_ns);
    }
}

/* ----------------------------------------------------------------------------- stopping */
void can_stop_now(can_machine *m, uint32_t number, uint32_t kind)
{
    can_drive_state *drive = &m->drive[number];
    drive->state.stop = kind;
    drive->stop_place = 0;
    drive->stops++;
    m->notify = true;
}

/* Begin the stop that the rules have decided. */
void can_begin_stop(can_machine *m, uint32_t number, drive_stop stop)
{
    if (stop != STOP_NOTHING) {
        can_stop_now(m, number, stop);
    }
}

static bool send_stop(can_machine *m, uint32_t number, bool quick)
{
    can_drive_state *drive = &m->drive[number];
    const can_drive *table = &m->table.drive[number];
    const can_write *write = quick ? table->quick_stop : table->disarm;
    uint32_t count = quick ? table->quick_stop_count : table->disarm_count;
    for (; drive->stop_place < count; drive->stop_place++) {
        if (!can_write_out(m, number, &write[drive->stop_place])) {
            return false; /* the rest is sent in the next step */
        }
    }
    if (!quick && table->idle_setpoints == 0) {
        drive->state.sent_motion = false; /* set-points would switch the drive on again */
    }
    return true;
}

/* --------------------------------------------------------- the last power-off of a line */
void can_note_power(can_machine *m, uint32_t number, int64_t now_ns)
{
    can_drive_state *drive = &m->drive[number];
    bool rests = drive->state.mode == DRIVE_READY && !drive->state.stopping &&
                 drive->state.stop == STOP_NOTHING;
    bool settled =
        now_ns >= m->control.drive[number].arming_until_ns && drive->power_ns > drive->order_ns;
    drive->last_off.suffices = rests && settled && !drive->state.sent_motion &&
                               drive->missing == 0 && drive->state.enabled == 0;
}

bool can_is_off(const can_machine *m, uint32_t number)
{
    const can_drive_state *drive = &m->drive[number];
    bool reports = m->table.drive[number].reports_enabled != 0;
    return drive->stop_place == 0 &&
           drive_is_off(&drive->last_off, reports, drive->state.enabled, drive->newest_ns);
}

/* Send the last power-off, and request the frames that do not come by themselves. A stop that the
 * CAN bus took only in part stays due: its rest goes out in the next step. */
static void send_last_power_off(can_machine *m, uint32_t number)
{
    can_drive_state *drive = &m->drive[number];
    const can_drive *table = &m->table.drive[number];
    bool due =
        drive->last_off.newest_ns == 0 || m->now_ns >= drive->last_off.newest_ns + OFF_AGAIN_NS;
    if (due && !can_is_off(m, number) && send_stop(m, number, false)) {
        if (drive->last_off.first_ns == 0) {
            drive->last_off.first_ns = m->now_ns;
            drive->last_off.suffices |= table->reports_enabled == 0 && drive->missing == 0;
            drive->state.enabled = 2;
        }
        drive->last_off.newest_ns = m->now_ns;
        drive->stop_place = 0;
        if (!can_is_off(m, number)) {
            can_sync(m);
            send_all(m, table->poll, table->poll_count);
            send_all(m, table->probe, table->hello == 0 ? table->probe_count : 0);
        }
    }
    if (can_is_off(m, number)) {
        drive->off_waits = false;
        m->notify |= drive_stop_done(&drive->state);
    }
}

void can_send_stop(can_machine *m, uint32_t number)
{
    can_drive_state *drive = &m->drive[number];
    bool quick = drive->state.stop == STOP_QUICK;
    if (m->end.stage == END_POWER_OFF) {
        send_last_power_off(m, number);
    } else if (send_stop(m, number, quick)) {
        drive->off_waits = !quick && m->table.drive[number].reports_enabled != 0;
        drive->off_ns = m->now_ns;
        m->notify |= drive_stop_done(&drive->state);
    }
}

/* That the bus took a power-off proves nothing: the drive's report does. In the modes without a
 * cycle nothing else sends it again. */
static bool waits_for_confirmation(const can_machine *m, uint32_t number)
{
    const can_drive_state *drive = &m->drive[number];
    return drive->off_waits && m->end.stage == END_NOT && drive->missing == 0 &&
           (drive->state.mode == DRIVE_OFF || drive->state.mode == DRIVE_BACK);
}

void can_confirm_off(can_machine *m, uint32_t number, int64_t now_ns)
{
    can_drive_state *drive = &m->drive[number];
    drive->off_waits = drive->off_waits && drive->state.enabled != 0;
    if (waits_for_confirmation(m, number) && drive->state.enabled == 1 &&
        drive->state.stop == STOP_NOTHING && now_ns >= drive->off_ns + OFF_AGAIN_NS) {
        drive->state.stop = drive_power_off(&drive->state); /* the same stop: not one more */
        drive->stop_place = 0;
    }
}

void can_check_power(can_machine *m, uint32_t number, int64_t now_ns)
{
    can_drive_state *drive = &m->drive[number];
    bool settled = now_ns >= m->control.drive[number].arming_until_ns;
    drive_stop stop = drive_check_power(&drive->state, m->table.drive[number].tries, settled);
    m->notify |= drive_is_changed(&drive->state);
    if (stop != STOP_NOTHING && drive->state.mode == DRIVE_OFF) {
        can_hold_nothing(m, number);
        can_begin_stop(m, number, stop);
    } else if (stop != STOP_NOTHING) {
        drive->state.off_due = true;
    }
}

/* ----------------------------------------------------------------------------- presence */
static void look_for(can_machine *m, uint32_t number, int64_t now_ns)
{
    can_drive_state *drive = &m->drive[number];
    const can_drive *table = &m->table.drive[number];
    drive->missing = 0;
    if (table->hello > 0 && drive->state.mode != DRIVE_READY && drive->state.mode != DRIVE_ARMED) {
        int64_t received_ns = drive->received_ns[table->hello - 1];
        drive->missing =
            received_ns > 0 && now_ns - received_ns < HELLO_GOOD_FOR_NS ? 0 : table->hello;
        return;
    }
    for (uint32_t i = 0; i < table->input_count && drive->missing == 0; i++) {
        int64_t silence_ns = drive->silence_ns[i];
        if (silence_ns > 0 &&
            (drive->received_ns[i] == 0 || now_ns - drive->received_ns[i] > silence_ns)) {
            drive->missing = i + 1;
        }
    }
}

static void becomes_unresponsive(can_machine *m, uint32_t number, int64_t now_ns)
{
    can_drive_state *drive = &m->drive[number];
    drive->unresponsive++;
    drive_unresponsive(&drive->state);
    drive->off_waits = false; /* probes send it */
    m->notify = true;
    can_hold_nothing(m, number);
    if (m->end.stage == END_NOT) {
        drive->state.stop = STOP_NOTHING; /* its probes stop the drive */
    }
    drive->stops++;
    drive->unresponsive_since_ns = drive->probe_at_ns = now_ns;
    drive->probe_pause_ns = CAN_PROBE_FIRST_NS;
    if (m->table.drive[number].hello > 0) {
        drive->received_ns[m->table.drive[number].hello - 1] = 0;
    }
}

/* Return whether the probes of a silent drive brake it; later they take its power. */
static bool probes_brake(const can_drive_state *drive, int64_t now_ns)
{
    return drive->may_turn && now_ns <= drive->unresponsive_since_ns + DRIVE_STOPPING_NS;
}

/* Probe a silent drive. It may still receive: if it may turn, it gets a stop. */
static void probe(can_machine *m, uint32_t number, int64_t now_ns)
{
    can_drive_state *drive = &m->drive[number];
    const can_drive *table = &m->table.drive[number];
    if (now_ns < drive->probe_at_ns || drive->state.back) {
        return;
    }
    bool all_sent = true;
    if (probes_brake(drive, now_ns)) {
        all_sent = write_all(m, number, table->quick_stop, table->quick_stop_count);
        send_setpoints(m, number, now_ns);
        all_sent = all_sent && !drive->state.sent_motion;
    } else if (drive->may_turn) {
        all_sent = write_all(m, number, table->disarm, table->disarm_count);
    }
    send_all(m, table->probe, table->probe_count);
    if (all_sent) { /* else the stop goes out again in the next cycle */
        drive->probe_at_ns = now_ns + drive->probe_pause_ns;
        drive->probe_pause_ns =
            2 * drive->probe_pause_ns < PROBE_LAST_NS ? 2 * drive->probe_pause_ns : PROBE_LAST_NS;
    }
}

/* ----------------------------------------------------------------------------- guarding */
static drive_view view_of(const can_machine *m, uint32_t number, int64_t now_ns)
{
    int64_t watchdog_ns = m->table.drive[number].watchdog_ns;
    return (drive_view){
        .now_ns = now_ns,
        .fresh = fresh_stamp(now_ns, m->newest.stamp_ns, m->table.setpoint_timeout_ns),
        .enabled = m->newest.enabled == 1,
        .left_alone = drive_left_alone(m->drive[number].last_sent_ns, now_ns, watchdog_ns),
        .shut_down = m->control.shut_down != 0,
        .position_unknown = can_place_is_missing(m, number),
        .enabled_count = m->enabled_count};
}

void can_guard(can_machine *m, uint32_t number, int64_t now_ns)
{
    can_drive_state *drive = &m->drive[number];
    if (drive->state.mode != DRIVE_ARMED) {
        can_begin_positions(m, number);
    }
    drive_view view = view_of(m, number, now_ns);
    can_begin_stop(m, number, drive_guard(&drive->state, &view));
    look_for(m, number, now_ns);
    bool there = drive->missing == 0;
    if (!there && (drive->state.mode == DRIVE_READY || drive->state.mode == DRIVE_ARMED)) {
        becomes_unresponsive(m, number, now_ns);
    } else if (there && drive->state.mode == DRIVE_UNRESPONSIVE && !drive->state.back &&
               m->end.stage == END_NOT) {
        m->notify = true;
        can_begin_stop(m, number, drive_answers(&drive->state, probes_brake(drive, now_ns)));
    }
    if (drive->state.stopping) {
        can_begin_stop(m, number,
                       drive_end_stopping(&drive->state, can_at_rest(m, number), now_ns));
    }
}

/* ----------------------------------------------------------------------------- requests */
/* Give the frames their full time to come, counted from now. */
static void begin_listening(can_drive_state *drive, int64_t now_ns)
{
    drive->last_sent_ns = now_ns;
    for (uint32_t i = 0; i < CAN_INPUTS_MAX; i++) {
        drive->received_ns[i] = now_ns;
    }
}

static void set_up(can_machine *m, uint32_t number, int64_t now_ns)
{
    can_drive_state *drive = &m->drive[number];
    bool stops = drive->state.stop != STOP_NOTHING || drive->state.stopping;
    drive->may_turn &= stops;
    drive->state.sent_motion &= stops; /* zero would switch on a drive that has no power */
    drive->slow_cycles = 0;
    drive->off_waits = false;
    can_forget(m, number);
    begin_listening(drive, now_ns);
}

void can_take_over(can_machine *m, int64_t now_ns)
{
    for (uint32_t i = 0; i < m->table.drive_count; i++) {
        can_drive_state *drive = &m->drive[i];
        drive->may_turn = true;
        begin_listening(drive, now_ns);
        can_begin_stop(m, i, drive_quick_stop(&drive->state, 0, now_ns));
    }
}

void can_obey_request(can_machine *m, uint32_t number, int64_t now_ns)
{
    can_drive_state *drive = &m->drive[number];
    drive_view view = view_of(m, number, now_ns);
    const mode_request *request = &m->control.drive[number];
    drive_answer answer = drive_obey(&drive->state, request, &view);
    bool is_new = answer.request != REQUEST_NONE;
    m->notify |= is_new;
    can_begin_stop(m, number, answer.stop);
    drive->stops += answer.overtaken;
    /* also for a drive that is being armed */
    drive->stops += is_new && request->mode == DRIVE_STAND_DOWN;
    if (answer.request == REQUEST_SET_UP) {
        set_up(m, number, now_ns);
    } else if (answer.request == REQUEST_ARM) {
        drive->may_turn = true;
        drive->off_waits = false;
        drive->last_sent_ns = now_ns;
    }
}

/* ---------------------------------------------------------------------------- its cycle */
/* Send requests that may wait. A drive that cannot report its power gets its power-off again: the
 * first one may have been lost. */
static void now_and_then(can_machine *m, uint32_t number, int64_t now_ns)
{
    can_drive_state *drive = &m->drive[number];
    const can_drive *table = &m->table.drive[number];
    uint64_t turn = drive->slow_cycles / table->slow_every;
    if (table->slow_count > 0) {
        (void)can_send(m, &table->slow[turn % table->slow_count]);
    }
    bool resting = drive->state.mode == DRIVE_READY && !drive->state.stopping &&
                   drive->state.stop == STOP_NOTHING;
    if (table->reports_enabled == 0 && resting &&
        now_ns >= m->control.drive[number].arming_until_ns) {
        (void)write_all(m, number, table->disarm, table->disarm_count);
    }
}

void can_cycle(can_machine *m, uint32_t number, int64_t now_ns)
{
    can_drive_state *drive = &m->drive[number];
    const can_drive *table = &m->table.drive[number];
    /* the drive is probed because Python waits for it */
    bool absent = drive->state.mode == DRIVE_OFF && drive->may_turn && drive->missing != 0;
    if (drive->state.mode == DRIVE_UNRESPONSIVE || absent) {
        probe(m, number, now_ns);
        return;
    }
    if (waits_for_confirmation(m, number)) {
        send_all(m, table->poll, table->poll_count);
    }
    if (drive->state.mode != DRIVE_READY && drive->state.mode != DRIVE_ARMED) {
        return;
    }
    if (drive->state.off_due) {
        drive->state.off_due = false;
        can_begin_stop(m, number, drive_power_off(&drive->state));
        can_send_stop(m, number);
    }
    can_send_setpoints(m, number, now_ns);
    send_all(m, table->poll, table->poll_count);
    if (drive->slow_cycles % table->slow_every == 0) {
        now_and_then(m, number, now_ns);
    }
    drive->slow_cycles++;
}
