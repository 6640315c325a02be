/* SPDX-License-Identifier: Apache-2.0
 * board_machine.c: what is received from a board, what is sent and when, and how it ends. */
#include "board_machine.h"

#include <errno.h>
#include <string.h>

static const int64_t NS_PER_US = 1000, HELD_UNIT_NS = 100000;
/* Tolerance for a frame that was received before it was sent: beyond it, the number belongs to
 * set-points of an earlier program. */
static const int64_t HELD_TOLERANCE_NS = 2 * BOARD_MS;
/* Time beyond the end's limit for a board that responds to report that it has no power. */
static const int64_t REPORT_EXTRA_NS = 500 * BOARD_MS;
static const board_place RECEIVED_SEQUENCE = {.byte = 6, .bytes = 2},
                         RECEIVED_AGO = {.byte = 8, .bytes = 2};

int board_machine_init(board_machine *m, const board_table *table, uint32_t epoch,
                       uint16_t sequence, int64_t now_ns)
{
    char name[FIELD_NAME_BYTES];
    if (board_table_check(table, name) != NULL) {
        return -EINVAL;
    }
    memset(m, 0, sizeof *m);
    m->table = *table;
    m->state.epoch = epoch;
    m->sequence = sequence;
    m->next = (uint16_t)(sequence + 1);
    m->cycle.due_ns = now_ns;
    memcpy(m->held, table->payload, sizeof m->held);
    /* what turns is braked: its set-up takes the power when it rests */
    board_hold(m, table->quick_stop, table->quick_stop_count, now_ns);
    for (uint32_t i = 0; i < table->setpoint_count; i++) {
        m->joints |= 1U << table->setpoint[i].scale.joint;
    }
    board_forget(m);
    return 0;
}

/* ---------------------------------------------------------------------------- receiving */
/* Note the newest of motord's frames that the board had received, and how long before the feedback.
 * A frame of an earlier program may have a greater number: the board takes none of motord's until
 * they have a greater one. */
static void note_what_it_knows(board_machine *m, int64_t now_ns)
{
    uint16_t sequence = (uint16_t)board_get(m->feedback_payload, &RECEIVED_SEQUENCE);
    uint16_t behind = (uint16_t)(m->sequence - sequence);
    int64_t sent_ns =
        behind < BOARD_SEQUENCES_KEPT ? m->sent_ns[sequence % BOARD_SEQUENCES_KEPT] : 0;
    int64_t trip_ns =
        now_ns - sent_ns - board_get(m->feedback_payload, &RECEIVED_AGO) * HELD_UNIT_NS;
    bool known = sent_ns > 0 && trip_ns >= -HELD_TOLERANCE_NS;
    m->knows_ns = known ? sent_ns : 0;
    if ((int16_t)(uint16_t)(m->next - sequence) <= 0) {
        m->next = (uint16_t)(sequence + 1);
    }
    if (known && m->round_trips != NULL) {
        histogram_add(m->round_trips, trip_ns);
    }
}

static bool take_frame(board_machine *m, int64_t now_ns)
{
    uint8_t raw[BOARD_FRAME_MAX];
    uint32_t count = board_frame_parse(m->tail.bytes, m->tail.count, raw);
    if (count < BOARD_HEAD_BYTES + m->table.feedback_bytes || raw[1] != BOARD_TYPE_FEEDBACK ||
        !board_imu_fits(raw + BOARD_HEAD_BYTES, count - BOARD_HEAD_BYTES)) {
        return false;
    }
    m->feedback_bytes = count - BOARD_HEAD_BYTES;
    memcpy(m->feedback_payload, raw + BOARD_HEAD_BYTES, m->feedback_bytes);
    m->stamp_ns = board_clock_stamp(
        &m->clock, (uint32_t)board_get(raw, &(board_place){.byte = 4, .bytes = 4}), now_ns);
    note_what_it_knows(m, now_ns);
    return true;
}

static bool take_line(board_machine *m, int64_t now_ns)
{
    uint8_t feedback_payload[BOARD_PAYLOAD_MAX] = {0};
    if (board_text_read(&m->table.read, m->tail.bytes, m->tail.count, feedback_payload) == 0) {
        return false;
    }
    m->feedback_bytes = m->table.feedback_bytes;
    memcpy(m->feedback_payload, feedback_payload, sizeof feedback_payload);
    m->stamp_ns = m->knows_ns = now_ns;
    return true;
}

static void take_packet_byte(board_machine *m, uint8_t byte, int64_t now_ns)
{
    uint32_t found = board_hoverboard_take(&m->packet, byte, m->feedback_payload);
    m->bad_frames += found == HOVERBOARD_BAD;
    if (found == HOVERBOARD_FEEDBACK) {
        m->feedback_bytes = HOVERBOARD_VALUE_BYTES;
        m->stamp_ns = m->knows_ns = now_ns;
        m->received++;
        board_received(m, now_ns);
    }
}

static void take_piece(board_machine *m, int64_t now_ns)
{
    bool text = m->table.dialect == BOARD_TEXT;
    if (m->tail.count == 0 || (text && (!m->tail.whole || m->table.answers == 0))) {
        return;
    }
    if (text ? take_line(m, now_ns) : take_frame(m, now_ns)) {
        m->received++;
        board_imu_read(m);
        board_received(m, now_ns);
    } else {
        m->bad_frames++;
    }
}

static bool ends(const board_machine *m, uint8_t byte)
{
    bool line_end = byte == '\n' || byte == '\r' || byte == ';';
    return m->table.dialect == BOARD_TEXT ? line_end : byte == 0;
}

/* Take pieces of the stream. A line of text that is too long is skipped up to its end. A frame that
 * fills the buffer is too long by a byte. */
static void take_pieces(board_machine *m, const uint8_t *bytes, uint32_t count, int64_t now_ns)
{
    board_tail *tail = &m->tail;
    uint32_t room = m->table.dialect == BOARD_TEXT ? BOARD_LINE_MAX : BOARD_FRAME_MAX + 2;
    for (uint32_t i = 0; i < count; i++) {
        if (ends(m, bytes[i])) {
            take_piece(m, now_ns);
            tail->count = 0;
            tail->whole = true;
        } else if (tail->count < room) {
            tail->bytes[tail->count++] = bytes[i];
        } else {
            tail->whole = false;
        }
    }
}

/* Take received bytes. A Sabertooth sends nothing. */
void board_machine_receive(board_machine *m, const uint8_t *bytes, uint32_t count, int64_t now_ns)
{
    if (m->table.dialect <= BOARD_TEXT) {
        take_pieces(m, bytes, count, now_ns);
    }
    for (uint32_t i = 0; m->table.dialect == BOARD_HOVERBOARD && i < count; i++) {
        take_packet_byte(m, bytes[i], now_ns);
    }
}

/* ------------------------------------------------------------------------------ sending */
bool board_machine_order(board_machine *m, const board_order *order)
{
    if (m->has_order) {
        return false;
    }
    m->order = *order;
    m->has_order = true;
    return true;
}

/* Put an order into the payload, once; it is done when a frame with it has gone out. */
static void obey_order(board_machine *m, int64_t now_ns)
{
    const board_order *order = &m->order;
    bool stopped =
        m->state.mode == DRIVE_UNRESPONSIVE || (order->guarded != 0 && order->stops != m->stops);
    if (!m->has_order || m->order_written) {
        return;
    }
    if (stopped || m->end.stage != END_NOT) {
        m->has_order = false;
        m->orders_dropped++;
        m->notify = true;
        return;
    }
    board_hold(m, &order->write, 1, now_ns);
    m->order_written = true;
}

/* Build the packets of all drivers at once: a stop of one stops the others in the same cycle. */
static uint32_t build_sabertooths(const board_table *table, const uint8_t *payload, uint8_t *out)
{
    uint32_t count = 0;
    for (uint32_t i = 0; i < table->unit_count; i++) {
        count += board_sabertooth_build(table->unit[i], payload + SABERTOOTH_SETPOINT_BYTES * i,
                                        out + count);
    }
    return count;
}

static uint32_t build(const board_machine *m, const uint8_t *payload, int64_t now_ns, uint8_t *out)
{
    const board_table *table = &m->table;
    switch (table->dialect) {
    case BOARD_TEXT: return board_text_write(table, payload, out);
    case BOARD_HOVERBOARD: return board_hoverboard_build(payload, table->mixed, out);
    case BOARD_SABERTOOTH: return build_sabertooths(table, payload, out);
    default:
        return board_frame_build(BOARD_TYPE_SETPOINTS, m->next, (uint32_t)(now_ns / NS_PER_US),
                                 payload, table->payload_bytes, out);
    }
}

static void send_payload(board_machine *m, int64_t now_ns)
{
    uint8_t payload[BOARD_PAYLOAD_MAX], out[BOARD_WIRE_MAX];
    bool motion = board_payload(m, payload);
    uint16_t sequence = m->next;
    uint32_t count = build(m, payload, now_ns, out);
    if (count == 0 || !m->send(m->sink, out, count)) {
        m->no_room++;
        return;
    }
    if (sequence != (uint16_t)(m->sequence + 1)) {
        memset(m->sent_ns, 0, sizeof m->sent_ns); /* a new sequence */
    }
    m->sequence = sequence;
    m->next = (uint16_t)(sequence + 1);
    m->sent_ns[sequence % BOARD_SEQUENCES_KEPT] = now_ns;
    m->state.sent_motion = motion;
    memcpy(m->last_sent, payload, m->table.payload_bytes);
    m->sent++;
    board_sent(m, now_ns);
}

static void cycle(board_machine *m, int64_t now_ns)
{
    cycle_clock_begin(&m->cycle, m->table.period_ns, now_ns);
    obey_order(m, now_ns);
    send_payload(m, now_ns);
}

/* ------------------------------------------------------------------------------ the end */
/* The line is silent only when the last frame has had time to leave the port, and the board has
 * reported that it has no power. A board that responds gets more time for that. */
static void shut_down(board_machine *m, int64_t now_ns)
{
    if (end_begins(&m->end, m->control.shut_down != 0, now_ns)) {
        board_note_power(m, now_ns);
        board_begin_stop(m, end_stop(&m->end, &m->state, now_ns), now_ns);
    }
    board_look_for_proof(m);
    bool stopping = m->state.stopping || m->state.stop != STOP_NOTHING || m->off_waits;
    bool speaks =
        m->off_waits && m->off_first_ns > 0 && now_ns - m->received_ns <= m->table.silence_ns;
    if (end_takes_power(&m->end, stopping, now_ns)) {
        board_last_power_off(m, now_ns);
    } else {
        bool leaves = now_ns < m->last_sent_ns + m->table.period_ns;
        m->notify |= end_is_over(&m->end, stopping || leaves, speaks ? REPORT_EXTRA_NS : 0, now_ns);
    }
}

/* ----------------------------------------------------------------------------- the step */
static bool has_to_stop(const board_machine *m)
{
    uint8_t payload[BOARD_PAYLOAD_MAX];
    return m->state.stop != STOP_NOTHING || (m->state.sent_motion && !board_payload(m, payload));
}

static int64_t next_look_ns(const board_machine *m, int64_t now_ns)
{
    bool moving = m->state.sent_motion || m->state.stopping || m->state.mode == DRIVE_ARMED ||
                  m->end.stage != END_NOT;
    int64_t wake_ns = now_ns + (has_to_stop(m) ? LOOK_FULL_NS
                                : moving       ? LOOK_MOVING_NS
                                               : LOOK_RESTING_NS);
    return m->end.stage < END_SILENT ? earlier(wake_ns, m->cycle.due_ns) : wake_ns;
}

void board_machine_kick(board_machine *m, int64_t now_ns)
{
    uint8_t payload[BOARD_PAYLOAD_MAX];
    bool stops = !board_payload(m, payload) && m->state.sent_motion;
    if (m->state.mode == DRIVE_ARMED &&
        memcmp(payload, m->last_sent, m->table.payload_bytes) != 0) {
        cycle_clock_bring_forward(&m->cycle, m->table.period_ns, m->table.gap_ns, stops, now_ns);
    }
}

int64_t board_machine_step(board_machine *m, int64_t now_ns)
{
    board_obey_request(m, now_ns);
    board_guard(m, now_ns);
    shut_down(m, now_ns);
    if (m->end.stage < END_SILENT && now_ns >= m->cycle.due_ns) {
        cycle(m, now_ns);
    } else if (m->end.stage < END_SILENT && has_to_stop(m)) {
        send_payload(m, now_ns); /* a stop does not wait for its cycle */
    }
    return next_look_ns(m, now_ns);
}

void board_machine_report(const board_machine *m, board_report *report)
{
    report->shut_down = m->end.stage == END_SILENT;
    report->mode = m->state.mode;
    report->fault_reasons = m->state.fault_reasons;
    report->request_seen = m->state.request_seen;
    report->enabled = m->state.enabled;
    report->stopping = m->state.stopping;
    report->sent_motion = m->state.sent_motion;
    report->stop_waits = m->state.stop != STOP_NOTHING || m->off_waits;
    report->stops = m->stops;
    report->epoch = m->state.epoch;
    report->orders_sent = m->orders_sent;
    report->orders_dropped = m->orders_dropped;
    report->feedback_bytes = m->feedback_bytes;
    report->cycles = m->cycle.count;
    report->sent = m->sent;
    report->no_room = m->no_room;
    report->bad_frames = m->bad_frames;
    report->received = m->received;
    report->published = m->published;
    report->unresponsive = m->unresponsive;
    report->cycle_ns = m->cycle.took_ns;
    report->setpoints_ns = m->newest.stamp_ns;
    report->received_ns = m->received_ns;
    report->knows_ns = m->knows_ns;
    report->written_ns = m->written_ns;
    for (uint32_t j = 0; j < JOINTS_MAX; j++) {
        report->fault_word[j] = m->joint[j].fault_word;
    }
    memcpy(report->feedback_payload, m->feedback_payload, sizeof report->feedback_payload);
}
