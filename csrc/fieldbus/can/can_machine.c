/* SPDX-License-Identifier: Apache-2.0
 * can_machine.c: the line: what it receives, what it sends and when, and how it ends. */
#include "can_machine.h"

#include <errno.h>
#include <string.h>

/* Least waiting time: adapters on USB take milliseconds to report that a frame has left. */
static const int64_t LEAVES_WITHIN_NS = 5 * CAN_MS;
/* Time beyond the end's limit for a drive that responds to report that it has no power. */
static const int64_t REPORT_EXTRA_NS = 500 * CAN_MS;

/* ---------------------------------------------------------------------------- beginning */
static bool has_power(const can_input *input)
{
    for (uint32_t i = 0; i < input->field_count; i++) {
        if (input->field[i].meaning.kind == FIELD_ENABLED) {
            return true;
        }
    }
    return false;
}

static void init_inputs(can_drive_state *drive, const can_drive *table)
{
    for (uint32_t i = 0; i < table->input_count; i++) {
        drive->fast |= (uint32_t)(table->input[i].fast != 0) << i;
        drive->powers |= (uint32_t)has_power(&table->input[i]) << i;
        drive->silence_ns[i] = table->input[i].silence_ns;
    }
}

static void add_route(can_machine *m, uint32_t drive, uint32_t match)
{
    const can_route one = {.id = m->table.drive[drive].match[match].id,
                           .drive = (uint16_t)drive,
                           .match = (uint16_t)match};
    uint32_t at = m->route_count++;
    for (; at > 0 && m->route[at - 1].id > one.id; at--) {
        m->route[at] = m->route[at - 1];
    }
    m->route[at] = one;
}

static void init_drive(can_machine *m, uint32_t number, const can_before *before, int64_t now_ns)
{
    can_drive_state *drive = &m->drive[number];
    const can_drive *table = &m->table.drive[number];
    drive->state.epoch = before->epoch;
    drive->may_turn = (before->may_turn >> number & 1) != 0;
    drive->unresponsive_since_ns = drive->probe_at_ns = now_ns;
    drive->probe_pause_ns = CAN_PROBE_FIRST_NS;
    drive->state.enabled = 2;
    for (uint32_t o = 0; o < table->output_count; o++) {
        for (uint32_t i = 0; i < table->output[o].setpoint_count; i++) {
            drive->joints |= 1U << table->output[o].setpoint[i].scale.joint;
        }
    }
    init_inputs(drive, table);
    for (uint32_t i = 0; i < table->match_count; i++) {
        add_route(m, number, i);
    }
    can_hold_nothing(m, number);
    can_forget(m, number);
}

int can_machine_init(can_machine *m, const can_table *table, const can_before *before,
                     can_sender send, void *sink, int64_t now_ns)
{
    char name[FIELD_NAME_BYTES];
    if (can_table_check(table, name) != NULL) {
        return -EINVAL;
    }
    memset(m, 0, sizeof *m);
    m->table = *table;
    m->send = send;
    m->sink = sink;
    m->cycle.due_ns = now_ns;
    for (uint32_t i = 0; i < table->drive_count; i++) {
        init_drive(m, i, before, now_ns);
    }
    return 0;
}

/* ---------------------------------------------------------------------------- receiving */
static bool matches(const can_match *match, const can_packet *packet)
{
    bool alike = packet->bytes >= match->bytes;
    for (uint32_t i = 0; alike && i < match->begins_bytes; i++) {
        alike = ((packet->data[i] ^ match->begins[i]) & match->begins_mask[i]) == 0;
    }
    return alike;
}

static void take_input(can_machine *m, uint32_t number, uint32_t place, const can_packet *packet,
                       int64_t stamp_ns, int64_t now_ns)
{
    can_drive_state *drive = &m->drive[number];
    const can_input *input = &m->table.drive[number].input[place];
    drive->received_ns[place] = stamp_ns;
    if (drive->sample_ns[place] > 0 && stamp_ns < drive->sample_ns[place] + input->spacing_ns) {
        return;
    }
    drive->sample_ns[place] = stamp_ns;
    drive->known |= 1U << place;
    drive->power_ns = (drive->powers >> place & 1) != 0 ? now_ns : drive->power_ns;
    can_read(m, number, input, packet->data, stamp_ns);
    can_confirm_off(m, number, now_ns);
    bool cyclic = drive->state.mode == DRIVE_READY || drive->state.mode == DRIVE_ARMED;
    if (cyclic && (drive->fast >> place & 1) != 0) {
        can_publish(m, number);
        if ((drive->powers >> place & 1) != 0) {
            can_check_power(m, number, now_ns);
        }
    }
}

/* Return the first match of the identifier. */
static uint32_t first_route(const can_machine *m, uint32_t id)
{
    uint32_t low = 0, high = m->route_count;
    while (low < high) {
        uint32_t middle = (low + high) / 2;
        if (m->route[middle].id < id) {
            low = middle + 1;
        } else {
            high = middle;
        }
    }
    return low;
}

static uint32_t take_match(can_machine *m, uint32_t number, const can_match *match,
                           const can_packet *packet, int64_t stamp_ns, int64_t now_ns)
{
    m->received++;
    m->drive[number].received++;
    m->drive[number].newest_ns = stamp_ns;
    if (match->input > 0) {
        take_input(m, number, match->input - 1, packet, stamp_ns, now_ns);
    }
    bool listening = (m->control.listen >> number & 1) != 0;
    m->notify |= listening;
    return listening ? number : (uint32_t)CAN_FOR_NOBODY;
}

/* Note a frame of no drive. Another node that sends what motord sends can move the drives. */
static void take_other(can_machine *m, uint32_t id)
{
    uint32_t low = 0, high = m->table.sending_count;
    while (low < high) {
        uint32_t middle = (low + high) / 2;
        if (m->table.sending[middle] < id) {
            low = middle + 1;
        } else {
            high = middle;
        }
    }
    if (low < m->table.sending_count && m->table.sending[low] == id) {
        m->foreign++;
        m->foreign_sending = low;
    }
}

uint32_t can_machine_receive(can_machine *m, const can_packet *packet, int64_t stamp_ns,
                             int64_t now_ns)
{
    if ((packet->id & CAN_ID_ERROR) != 0) {
        m->notify = true;
        return CAN_DRIVES_MAX;
    }
    bool known = false;
    uint32_t i = first_route(m, packet->id); /* a remote frame has another identifier */
    for (; i < m->route_count && m->route[i].id == packet->id; i++) {
        uint32_t drive = m->route[i].drive;
        const can_match *match = &m->table.drive[drive].match[m->route[i].match];
        if (matches(match, packet)) {
            return take_match(m, drive, match, packet, stamp_ns, now_ns);
        }
        known = true;
    }
    m->bad_frames += known;
    if (!known) {
        take_other(m, packet->id);
    }
    return CAN_FOR_NOBODY;
}

static bool carries_setpoints(const can_machine *m, uint32_t id)
{
    bool found = false;
    for (uint32_t i = 0; i < m->table.drive_count; i++) {
        for (uint32_t o = 0; o < m->table.drive[i].output_count; o++) {
            found |= m->table.drive[i].output[o].packet.id == id;
        }
    }
    return found;
}

void can_machine_left(can_machine *m, uint32_t id)
{
    if (carries_setpoints(m, id)) {
        m->motion_since_ns = 0;
    }
}

/* ------------------------------------------------------------------------------- orders */
bool can_machine_order(can_machine *m, const can_order *order)
{
    if (m->order_count == CAN_WAITING_MAX) {
        return false;
    }
    m->order[m->order_count++] = *order;
    return true;
}

/* Send the orders in sequence. Those that the CAN bus does not take wait. */
static void send_orders(can_machine *m, int64_t now_ns)
{
    uint32_t done = 0;
    for (; done < m->order_count; done++) {
        const can_order *order = &m->order[done];
        bool stopped = order->guarded != 0 && order->stops != m->drive[order->drive].stops;
        bool late = order->expires_ns <= now_ns || m->end.stage != END_NOT;
        /* the drive would move once it has power */
        bool astray = order->guarded != 0 && can_place_is_missing(m, order->drive);
        if (stopped || late || astray) {
            m->drive[order->drive].orders_dropped++;
        } else if (can_write_out(m, order->drive, &order->write)) {
            m->drive[order->drive].orders_sent++;
            m->drive[order->drive].order_ns = now_ns;
        } else {
            break;
        }
    }
    m->notify |= done > 0;
    m->order_count -= done;
    memmove(m->order, m->order + done, m->order_count * sizeof m->order[0]);
}

/* ------------------------------------------------------------------------------ the end */
static void shut_down(can_machine *m, int64_t now_ns)
{
    bool stopping = false, reports = false;
    if (end_begins(&m->end, m->control.shut_down != 0, now_ns)) {
        for (uint32_t i = 0; i < m->table.drive_count; i++) {
            can_note_power(m, i, now_ns);
            can_begin_stop(m, i, end_stop(&m->end, &m->drive[i].state, now_ns));
        }
    }
    for (uint32_t i = 0; i < m->table.drive_count; i++) {
        const can_drive_state *drive = &m->drive[i];
        stopping |= drive->state.stopping || drive->state.stop != STOP_NOTHING;
        reports |= drive->state.stop != STOP_NOTHING && drive->last_off.first_ns != 0 &&
                   drive->missing == 0;
    }
    if (end_takes_power(&m->end, stopping, now_ns)) {
        for (uint32_t i = 0; i < m->table.drive_count; i++) {
            can_begin_stop(m, i, drive_power_off(&m->drive[i].state));
        }
    } else {
        m->notify |= end_is_over(&m->end, stopping, reports ? REPORT_EXTRA_NS : 0, now_ns);
    }
}

/* ----------------------------------------------------------------------------- the step */
static void send_stops(can_machine *m, int64_t now_ns)
{
    for (uint32_t i = 0; i < m->table.drive_count; i++) {
        can_drive_state *drive = &m->drive[i];
        if (drive->state.stop != STOP_NOTHING) {
            can_send_stop(m, i);
        }
        if (drive_has_to_rest(&drive->state, can_wants_motion(m, i))) {
            can_send_setpoints(m, i, now_ns); /* a stop does not wait for its cycle */
        }
    }
}

/* Limit the motion that waits in the kernel's queue, with zero behind it. While a cable is pulled,
 * the queue fills. It goes out when the cable is plugged in again, whether motord runs or not. */
static void look_at_queue(can_machine *m, int64_t now_ns)
{
    int64_t limit_ns =
        m->table.period_ns > LEAVES_WITHIN_NS ? m->table.period_ns : LEAVES_WITHIN_NS;
    bool waits = m->motion_since_ns != 0 && now_ns - m->motion_since_ns > limit_ns;
    m->motion_stays = m->receives_own && (m->clogged || waits);
}

static void cycle(can_machine *m, int64_t now_ns)
{
    m->tx_full += m->motion_stays;
    uint64_t sent = m->sent, refused = m->tx_full;
    cycle_clock_begin(&m->cycle, m->table.period_ns, now_ns);
    for (uint32_t i = 0; i < m->table.drive_count; i++) {
        can_cycle(m, i, now_ns);
    }
    can_sync(m);
    m->clogged |= m->sent == sent && m->tx_full > refused;
}

static int64_t next_look_ns(const can_machine *m, int64_t now_ns)
{
    int64_t wake_ns = now_ns + (m->end.stage == END_NOT ? LOOK_RESTING_NS : LOOK_MOVING_NS);
    for (uint32_t i = 0; i < m->table.drive_count; i++) {
        const can_drive_state *drive = &m->drive[i];
        if (drive->state.sent_motion || drive->state.stopping || drive->state.mode == DRIVE_ARMED) {
            wake_ns = earlier(wake_ns, now_ns + LOOK_MOVING_NS);
        }
        if (drive->state.stop != STOP_NOTHING) {
            wake_ns = earlier(wake_ns, now_ns + LOOK_FULL_NS);
        }
    }
    if (m->order_count > 0) {
        wake_ns = earlier(wake_ns, now_ns + LOOK_FULL_NS);
    }
    return m->end.stage < END_POWER_OFF ? earlier(wake_ns, m->cycle.due_ns) : wake_ns;
}

/* Send the set-points of all armed drives, as in a cycle, without requests: a drive that lagged
 * behind the others would turn the robot. */
static void send_early(can_machine *m, int64_t now_ns)
{
    for (uint32_t i = 0; i < m->table.drive_count; i++) {
        if (m->drive[i].state.mode == DRIVE_ARMED) {
            can_send_setpoints(m, i, now_ns);
        }
    }
    can_sync(m);
}

void can_machine_kick(can_machine *m, int64_t now_ns)
{
    bool differs = false;
    m->now_ns = now_ns;
    for (uint32_t i = 0; i < m->table.drive_count; i++) {
        differs |= m->drive[i].state.mode == DRIVE_ARMED && can_differs(m, i);
    }
    /* while a cable is pulled, this would queue more motion for later */
    bool queued = m->receives_own && m->motion_since_ns != 0;
    int64_t *early_ns = &m->cycle.early_ns;
    m->early = differs && !queued && m->cycle.due_ns > now_ns &&
               may_be_early(early_ns, m->table.period_ns, now_ns);
}

int64_t can_machine_step(can_machine *m, int64_t now_ns)
{
    m->now_ns = now_ns;
    look_at_queue(m, now_ns);
    for (uint32_t i = 0; i < m->table.drive_count; i++) {
        can_obey_request(m, i, now_ns);
        can_guard(m, i, now_ns);
    }
    shut_down(m, now_ns);
    if (m->end.stage < END_SILENT) {
        send_stops(m, now_ns);
        send_orders(m, now_ns);
    }
    if (m->end.stage < END_POWER_OFF && now_ns >= m->cycle.due_ns) {
        cycle(m, now_ns);
    } else if (m->end.stage == END_NOT && m->early) {
        send_early(m, now_ns);
    }
    m->early = false;
    shut_down(m, now_ns); /* all drives have confirmed their power-off */
    return next_look_ns(m, now_ns);
}

void can_machine_report(const can_machine *m, can_report *report)
{
    report->shut_down = m->end.stage == END_SILENT;
    report->cycles = m->cycle.count;
    report->received = m->received;
    report->sent = m->sent;
    report->tx_full = m->tx_full;
    report->bad_frames = m->bad_frames;
    report->foreign = m->foreign;
    report->foreign_sending = m->foreign_sending;
    report->cycle_ns = m->cycle.took_ns;
    report->setpoints_ns = m->newest.stamp_ns;
    for (uint32_t j = 0; j < JOINTS_MAX; j++) {
        report->fault_word[j] = m->joint[j].fault_word;
    }
    for (uint32_t i = 0; i < CAN_DRIVES_MAX; i++) {
        const can_drive_state *drive = &m->drive[i];
        report->drive[i] = (can_drive_report){
            .mode = drive->state.mode,
            .fault_reasons = drive->state.fault_reasons,
            .request_seen = drive->state.request_seen,
            .enabled = drive->state.enabled,
            .stopping = drive->state.stopping,
            .sent_motion = drive->state.sent_motion,
            .missing = drive->missing,
            .stops = drive->stops,
            .cycles = drive->cycles,
            .received = drive->received,
            .unresponsive = drive->unresponsive,
            .received_ns = drive->newest_ns,
            .epoch = drive->state.epoch,
            .may_turn = drive->may_turn,
            .stop_waits = drive->state.stop != STOP_NOTHING || drive->off_waits,
            .orders_sent = drive->orders_sent,
            .orders_dropped = drive->orders_dropped,
            .faults = drive->faults,
            .last_fault = drive->last_fault,
            .last_fault_joint = drive->last_fault_joint,
        };
    }
}
