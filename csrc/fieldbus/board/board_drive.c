/* SPDX-License-Identifier: Apache-2.0
 * board_drive.c: what a board is told to be, whether it is there, and when it has to stop. */
#include "board_machine.h"
#include "fresh.h"

static const int64_t STOPPING_NS = 1000 * BOARD_MS;

static bool fresh(const board_machine *m, int64_t now_ns)
{
    return fresh_stamp(now_ns, m->newest.stamp_ns, m->table.setpoint_timeout_ns);
}

static bool is_cyclic(const board_machine *m)
{
    return m->mode == DRIVE_READY || m->mode == DRIVE_ARMED;
}

/* -------------------------------------------------------------------------------------------------- stopping */
void board_hold(board_machine *m, const board_write *write, uint32_t count, int64_t now_ns)
{
    for (uint32_t i = 0; i < count; i++) {
        board_put(m->held, &write[i].place, write[i].raw);
        m->written_ns = now_ns;
    }
}

static void stop_with(board_machine *m, const board_write *write, uint32_t count, int64_t now_ns)
{
    board_hold(m, write, count, now_ns);
    m->stops++;
    m->stop_waits = true;
}

void board_power_off(board_machine *m, int64_t now_ns)
{
    m->stopping = false;
    stop_with(m, m->table.disarm, m->table.disarm_count, now_ns);
}

void board_quick_stop(board_machine *m, int64_t now_ns)
{
    m->stopping = true;
    m->off_by_ns = now_ns + STOPPING_NS;
    stop_with(m, m->table.quick_stop, m->table.quick_stop_count, now_ns);
}

static void demote(board_machine *m, uint32_t why, uint32_t mode)
{
    m->mode = mode;
    m->demoted |= why;
    m->news = true;
}

/* -------------------------------------------------------------------------------------------------- presence */
static void go_quiet(board_machine *m, int64_t now_ns)
{
    m->quiet++;
    demote(m, DEMOTED_QUIET, DRIVE_QUIET);
    board_quick_stop(m, now_ns); /* it may hear us all the same: in every cycle from now on */
    m->stopping = m->back = false;
    m->said_bytes = 0;
}

void board_told(board_machine *m, int64_t now_ns)
{
    m->stop_waits = false;
    m->told_ns = now_ns;
    if (m->order_written) {
        m->order_written = m->has_order = false;
        m->orders_sent++;
        m->news = true;
    }
    if (m->back) {
        m->back = false;
        m->mode = DRIVE_BACK;
        m->news = true;
    }
    if (m->table.answers == 0) { /* the port has taken its bytes: that is all there is to know */
        m->stamp_ns = m->knows_ns = now_ns;
        board_heard(m, now_ns);
    }
}

/* ------------------------------------------------------------------------------------------------- its word */
/* The drive's own words count when it had heard by then what stays in its payload. */
static void believe(board_machine *m, bool kept, int64_t now_ns)
{
    bool resting = m->mode == DRIVE_READY && !m->stopping && now_ns >= m->control.wish.arming_until_ns;
    if (!kept || (m->mode == DRIVE_ARMED && m->enabled == 0)) {
        demote(m, kept ? DEMOTED_DISABLED_ITSELF : DEMOTED_LOST_SETUP, DRIVE_OFF);
        board_power_off(m, now_ns);
    } else if (!resting || m->enabled != 1) {
        m->still_enabled = 0;
    } else {
        m->still_enabled++;
        if (m->still_enabled == m->table.tries) {
            demote(m, DEMOTED_STILL_ENABLED, DRIVE_READY);
        }
        board_power_off(m, now_ns);
    }
}

void board_heard(board_machine *m, int64_t now_ns)
{
    m->heard_ns = now_ns;
    bool kept = board_read(m);
    if (is_cyclic(m)) {
        board_publish(m);
    }
    if (is_cyclic(m) && m->knows_ns >= m->written_ns) {
        believe(m, kept, now_ns);
    }
    if (m->mode == DRIVE_QUIET && !m->back && m->shut == 0) {
        m->back = true;
        board_power_off(m, now_ns);
    }
}

/* --------------------------------------------------------------------------------------------------- guarding */
static void guard_armed(board_machine *m, int64_t now_ns)
{
    bool left_alone = m->table.watchdog_ns > 0 && now_ns - m->told_ns > m->table.watchdog_ns;
    if (!fresh(m, now_ns) || left_alone) {
        demote(m, left_alone ? DEMOTED_LEFT_ALONE : DEMOTED_SETPOINTS_OLD, DRIVE_READY);
        board_quick_stop(m, now_ns);
    } else if (m->newest.enabled == 1) {
        m->was_enabled = true;
    } else if (m->was_enabled || m->enabled_count_armed != m->enabled_count) {
        demote(m, DEMOTED_NOT_ENABLED, DRIVE_READY);
        board_power_off(m, now_ns);
    }
}

void board_guard(board_machine *m, int64_t now_ns)
{
    if (m->mode == DRIVE_ARMED) {
        guard_armed(m, now_ns);
    }
    if (is_cyclic(m) && now_ns - m->heard_ns > m->table.silence_ns) {
        go_quiet(m, now_ns);
    }
    bool rests = m->knows_ns >= m->written_ns && board_at_rest(m);
    if (m->stopping && !m->stop_waits && (rests || now_ns >= m->off_by_ns)) {
        board_power_off(m, now_ns);
    }
}

/* ---------------------------------------------------------------------------------------------------- wishes */
/* A stop that is pending stays so, whatever is requested after it. */
static void set_up(board_machine *m, int64_t now_ns)
{
    m->mode = DRIVE_READY;
    m->epoch++;
    m->demoted = m->still_enabled = 0;
    m->back = false;
    m->heard_ns = now_ns; /* who was set up has just spoken, or cannot */
    board_forget(m);
}

static void arm(board_machine *m, int64_t now_ns)
{
    if (!fresh(m, now_ns) || m->stopping || m->stop_waits || m->control.shut_down != 0) {
        return;
    }
    m->mode = DRIVE_ARMED;
    m->was_enabled = false;
    m->enabled_count_armed = m->enabled_count;
    m->demoted = m->still_enabled = 0;
    m->enabled = 2;
    m->told_ns = now_ns;
}

static void stand_down(board_machine *m, int64_t now_ns)
{
    if (m->mode == DRIVE_ARMED) {
        m->mode = DRIVE_READY;
    }
    if (m->mode != DRIVE_QUIET) {
        board_power_off(m, now_ns);
    }
}

void board_obey_wish(board_machine *m, int64_t now_ns)
{
    const drive_wish *wish = &m->control.wish;
    if (wish->count == m->wish_seen) {
        return;
    }
    bool overtaken = wish->count - m->wish_seen > 1; /* one that was never seen may have been a stop */
    m->wish_seen = wish->count;
    m->news = true;
    if (overtaken && is_cyclic(m)) {
        stand_down(m, now_ns);
    }
    if (wish->mode == DRIVE_OFF) {
        board_power_off(m, now_ns);
        m->mode = DRIVE_OFF;
        m->back = false;
    } else if (wish->mode == DRIVE_READY && (m->mode == DRIVE_OFF || m->mode == DRIVE_BACK)) {
        set_up(m, now_ns);
    } else if (wish->mode == DRIVE_ARMED && m->mode == DRIVE_READY) {
        arm(m, now_ns);
    } else if (wish->mode == DRIVE_STAND_DOWN) {
        stand_down(m, now_ns);
    }
}
