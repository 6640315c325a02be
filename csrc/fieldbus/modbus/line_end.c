/* SPDX-License-Identifier: Apache-2.0
 * line_end.c: a line is shut down: all its drives come to rest, then lose their power, then it is silent. */
#include "line_machine.h"
#include "pace.h"

/* Beyond the end's time: until each drive was sent its whole power-off once. One that is not heard may hear. */
static const int64_t SHUT_UNHEARD_NS = 2500 * LINE_MS;

static void shut_down_begin(line_machine *m, int64_t now_ns)
{
    m->shut = 1;
    m->shut_rest_by_ns = now_ns + SHUT_REST_NS;
    m->shut_by_ns = now_ns + SHUT_NS;
    for (uint32_t i = 0; i < m->table.drive_count; i++) {
        line_drive_state *drive = &m->drive[i];
        if (drive->state.mode == DRIVE_ARMED) {
            drive->state.mode = DRIVE_READY;
            drive->state.stopping = true;
            drive->state.off_by_ns = m->shut_rest_by_ns;
            drive->due_ns = now_ns;
            m->broadcasts = m->table.broadcast_stop_count;
            line_stop_now(m, i, STOP_QUICK);
        }
    }
}

static bool was_sent_its_power_off(const line_machine *m, uint32_t number)
{
    const line_drive_state *drive = &m->drive[number];
    uint32_t all = (1U << m->table.drive[number].disarm_count) - 1;
    return drive->state.stop == STOP_NOTHING ||
           (drive->state.stop == STOP_POWER_OFF && (drive->stop_told | drive->stop_done) == all);
}

static void shut_down_go_on(line_machine *m, int64_t now_ns)
{
    bool stopping = m->broadcasts > 0, told = true;
    for (uint32_t i = 0; i < m->table.drive_count; i++) {
        stopping |= m->drive[i].state.stopping || m->drive[i].state.stop != STOP_NOTHING;
        told = told && was_sent_its_power_off(m, i);
    }
    if (m->shut == 1 && (!stopping || now_ns >= m->shut_rest_by_ns)) {
        m->shut = 2;
        for (uint32_t i = 0; i < m->table.drive_count; i++) {
            m->drive[i].state.stopping = false;
            line_stop_now(m, i, STOP_POWER_OFF);
        }
    } else if (m->shut == 2 && (!stopping || now_ns >= (told ? m->shut_by_ns : m->shut_by_ns + SHUT_UNHEARD_NS))) {
        m->shut = 3;
        m->news = true;
    }
}

void line_shut_down(line_machine *m, int64_t now_ns)
{
    if (m->control.shut_down != 0 && m->shut == 0) {
        shut_down_begin(m, now_ns);
    }
    if (m->shut != 0) {
        shut_down_go_on(m, now_ns);
    }
}
