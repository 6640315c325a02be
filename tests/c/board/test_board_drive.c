/* SPDX-License-Identifier: Apache-2.0
 * The times of a board's drive at their bounds: the last good nanosecond and the first bad one. */
#include "board_wire.h"

static board_machine *m = &w.machine;

/* A board that is READY: everything about it is known, and nothing is to be sent. */
static void begin_ready(void)
{
    begin();
    m->state.mode = DRIVE_READY;
    m->received_ns = m->last_sent_ns = m->written_ns = m->knows_ns = w.now_ns;
    m->newest = (setpoints){.stamp_ns = w.now_ns, .enabled = 1};
    m->notify = false;
}

static void begin_armed(void)
{
    begin_ready();
    m->state.mode = DRIVE_ARMED;
    m->state.was_enabled = true;
}

static void a_board_is_unresponsive_after_its_silence_and_not_before(void)
{
    for (int late = 0; late < 2; late++) {
        begin_ready();
        m->received_ns = w.now_ns - w.table.silence_ns - late;
        uint32_t stops = m->stops;
        board_guard(m, w.now_ns);
        CHECK(m->state.mode == (late ? DRIVE_UNRESPONSIVE : DRIVE_READY) &&
              m->unresponsive == (uint64_t)late && m->notify == (late == 1));
        CHECK(m->stops == stops + (uint32_t)late &&
              m->state.fault_reasons == (late ? DRIVE_FAULT_UNRESPONSIVE : 0U));
        CHECK(m->state.stop == (late ? STOP_QUICK : STOP_NOTHING) && !m->state.stopping);
    }
}

static void a_board_is_left_alone_after_its_watchdog_and_not_before(void)
{
    for (int late = 0; late < 2; late++) {
        begin_armed();
        m->last_sent_ns = w.now_ns - w.table.watchdog_ns - late;
        board_guard(m, w.now_ns);
        CHECK(m->state.mode == (late ? DRIVE_READY : DRIVE_ARMED) &&
              m->state.fault_reasons == (late ? DRIVE_FAULT_LEFT_ALONE : 0U));
        CHECK(m->state.stopping == (late == 1) && m->notify == (late == 1));
    }
    for (int64_t watchdog_ns = 0; watchdog_ns < 2; watchdog_ns++) { /* 0: the board has no
                                                                       watchdog */
        begin_armed();
        m->table.watchdog_ns = watchdog_ns;
        m->last_sent_ns = w.now_ns - 2;
        board_guard(m, w.now_ns);
        CHECK(m->state.mode == (watchdog_ns ? DRIVE_READY : DRIVE_ARMED));
    }
}

static void feedback_from_after_the_stop_puts_it_at_rest(void)
{
    for (int before = 0; before < 2; before++) {
        begin_ready();
        m->state.stopping = true;
        m->state.off_by_ns = INT64_MAX;
        for (uint32_t j = 0; j < MOTORS; j++) {
            m->joint[j].feedback.velocity_rad_s = 0.0;
        }
        m->knows_ns = m->written_ns - before;
        bool rests = board_at_rest(m);
        board_guard(m, w.now_ns);
        CHECK(rests && m->state.stopping == (before == 1) &&
              m->state.stop == (before ? STOP_NOTHING : STOP_POWER_OFF));
    }
}

/* The board reports this status and watchdog, after it has received the newest payload. */
static void reports(uint32_t status, int64_t watchdog_ms)
{
    memset(m->feedback_payload, 0, sizeof m->feedback_payload);
    m->feedback_bytes = w.table.feedback_bytes;
    board_place place = at(STATUS, 1, 0);
    board_put(m->feedback_payload, &place, status);
    place = at(WATCHDOG, 2, 0);
    board_put(m->feedback_payload, &place, watchdog_ms);
    board_received(m, w.now_ns);
}

static void feedback_counts_when_the_board_has_received_the_last_write(void)
{
    for (int before = 0; before < 2; before++) {
        begin_armed();
        m->knows_ns = m->written_ns - before;
        reports(STATUS_RESTARTED, WATCHDOG_MS);
        CHECK(m->state.mode == (before ? DRIVE_ARMED : DRIVE_OFF) &&
              m->state.fault_reasons == (before ? 0U : DRIVE_FAULT_LOST_SETUP));
        CHECK(m->state.stop == (before ? STOP_NOTHING : STOP_POWER_OFF));
    }
}

static void unrequested_power_is_taken_as_soon_as_no_arming_is_running(void)
{
    for (int early = 0; early < 2; early++) {
        begin_ready();
        m->control.request.arming_until_ns = w.now_ns + early;
        reports(STATUS_ENABLED, WATCHDOG_MS);
        CHECK(m->state.stop == (early ? STOP_NOTHING : STOP_POWER_OFF) &&
              m->state.still_enabled == (early ? 0U : 1U));
    }
}

static void arming_restarts_its_watchdog(void)
{
    begin_ready();
    m->last_sent_ns = 1;
    m->control.request = (mode_request){.count = 1, .mode = DRIVE_ARMED};
    board_obey_request(m, w.now_ns);
    CHECK(m->state.mode == DRIVE_ARMED && m->last_sent_ns == w.now_ns);
    board_guard(m, w.now_ns);
    CHECK(m->state.mode == DRIVE_ARMED);
}

static void an_order_counts_when_it_has_been_sent(void)
{
    begin_ready();
    m->has_order = m->order_written = true;
    m->orders_sent = 7;
    board_sent(m, w.now_ns);
    CHECK(m->orders_sent == 8 && m->notify && !m->has_order && !m->order_written);
}

static void a_board_that_another_program_left_running_is_braked_before_it_loses_its_power(void)
{
    board_table table = frames_table();
    /* without set-up, the board has nothing to lose */
    for (uint32_t i = table.field_count; i-- > 0;) {
        if (table.field[i].meaning.kind == FIELD_KEPT) {
            table.field[i] = table.field[--table.field_count];
        }
    }
    begin_with(table);
    w.stuck = true;
    w.measured[0].velocity_mrad_s = 3000;
    w.peer.enabled = 1;
    board_take_over(m, w.now_ns);
    CHECK(m->state.mode == DRIVE_READY && m->state.stopping && m->state.stop == STOP_QUICK &&
          m->received_ns == w.now_ns);
    CHECK(m->state.fault_reasons == 0);
    go_on(500 * MS);
    CHECK(w.peer.braking == 1 && w.peer.enabled == 0 && m->state.mode == DRIVE_READY &&
          w.moving_count == 0);
    w.stuck = false;
    go_on(60 * MS);
    CHECK(w.peer.braking == 0 && !m->state.stopping && m->state.mode == DRIVE_READY);
}

int main(void)
{
    a_board_that_another_program_left_running_is_braked_before_it_loses_its_power();
    a_board_is_unresponsive_after_its_silence_and_not_before();
    a_board_is_left_alone_after_its_watchdog_and_not_before();
    feedback_from_after_the_stop_puts_it_at_rest();
    feedback_counts_when_the_board_has_received_the_last_write();
    unrequested_power_is_taken_as_soon_as_no_arming_is_running();
    arming_restarts_its_watchdog();
    an_order_counts_when_it_has_been_sent();
    return checks_report("board drive");
}
