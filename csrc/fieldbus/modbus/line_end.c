/* SPDX-License-Identifier: Apache-2.0
 * line_end.c: the end of a line: all its drives come to rest, then lose their power, then the line
 * is silent. */
#include "line_machine.h"

/* Time beyond the end's limit to send each drive its whole power-off once. A silent drive may still
 * receive. */
static const int64_t POWER_OFF_EXTRA_NS = 2500 * LINE_MS;

static bool was_sent_its_power_off(const line_machine *m, uint32_t number)
{
    const line_drive_state *drive = &m->drive[number];
    uint32_t all = (1U << m->table.drive[number].disarm_count) - 1;
    return drive->state.stop == STOP_NOTHING ||
           (drive->state.stop == STOP_POWER_OFF &&
            ((drive->stop_sent | drive->stop_done) & all) == all);
}

/* ------------------------------------------------ a power-off that nothing acknowledges */
bool line_reads_power(const line_machine *m, uint32_t number)
{
    const line_drive *table = &m->table.drive[number];
    bool unanswered = false;
    for (uint32_t i = 0; i < table->disarm_count; i++) {
        unanswered |= table->disarm[i].reply_bytes == 0;
    }
    return unanswered && m->end.stage == END_POWER_OFF &&
           m->drive[number].state.stop == STOP_POWER_OFF;
}

static bool reports_power(const line_exchange *turn)
{
    for (uint32_t i = 0; i < turn->field_count; i++) {
        if (turn->field[i].kind == FIELD_ENABLED) {
            return true;
        }
    }
    return false;
}

bool line_power_first(const line_machine *m, uint32_t number)
{
    const line_drive *table = &m->table.drive[number];
    return m->drive[number].state.enabled == 2 && table->extra_count > 0 &&
           reports_power(&table->extra[0]);
}

/* Return the first exchange that reads the drive's power; without one, the exchange that probes it:
 * then only its reception can be known. */
static uint32_t power_read(const line_drive *table)
{
    for (uint32_t i = 0; i < table->cyclic_count + table->extra_count; i++) {
        if (reports_power(line_exchange_at(table, i))) {
            return i;
        }
    }
    return line_probe_place(table);
}

void line_build_power_read(line_machine *m, uint32_t number, line_frame *out)
{
    line_build_read(m, number, power_read(&m->table.drive[number]), out);
}

bool line_is_off(line_machine *m, uint32_t number, const uint8_t *reply, int64_t stamp_ns)
{
    const line_drive *table = &m->table.drive[number];
    const line_exchange *turn = line_exchange_at(table, power_read(table));
    line_read(m, number, turn, reply, stamp_ns);
    return !reports_power(turn) || m->drive[number].state.enabled == 0;
}

/* ------------------------------------------------------------------------------ the end */

void line_shut_down(line_machine *m, int64_t now_ns)
{
    bool stopping = false, sent = true;
    if (end_begins(&m->end, m->control.shut_down != 0, now_ns)) {
        for (uint32_t i = 0; i < m->table.drive_count; i++) {
            line_begin_stop(m, i, end_stop(&m->end, &m->drive[i].state, now_ns), now_ns);
        }
    }
    for (uint32_t i = 0; i < m->table.drive_count; i++) {
        stopping |= m->drive[i].state.stopping || m->drive[i].state.stop != STOP_NOTHING;
        sent = sent && was_sent_its_power_off(m, i);
    }
    stopping |= m->broadcasts > 0;
    if (end_takes_power(&m->end, stopping, now_ns)) {
        for (uint32_t i = 0; i < m->table.drive_count; i++) {
            line_begin_stop(m, i, drive_power_off(&m->drive[i].state), now_ns);
        }
    } else {
        m->notify |= end_is_over(&m->end, stopping, sent ? 0 : POWER_OFF_EXTRA_NS, now_ns);
    }
}
