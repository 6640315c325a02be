/* SPDX-License-Identifier: Apache-2.0
 * line_end.c: a line is shut down: all its drives come to rest, then lose their power, then it is silent. */
#include "line_machine.h"

/* Beyond the end's time: until each drive was sent its whole power-off once. A silent one may still receive. */
static const int64_t POWER_OFF_EXTRA_NS = 2500 * LINE_MS;

static bool was_sent_its_power_off(const line_machine *m, uint32_t number)
{
    const line_drive_state *drive = &m->drive[number];
    uint32_t all = (1U << m->table.drive[number].disarm_count) - 1;
    return drive->state.stop == STOP_NOTHING ||
           (drive->state.stop == STOP_POWER_OFF && (drive->stop_sent | drive->stop_done) == all);
}

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
