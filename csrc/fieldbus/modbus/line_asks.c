/* SPDX-License-Identifier: Apache-2.0
 * line_asks.c: requests from outside the cycle that wait for the wire. The one on the wire has left this queue. */
#include <string.h>

#include "line_machine.h"

bool line_machine_ask(line_machine *m, const line_ask *ask)
{
    if (m->ask_count == LINE_ASKS_MAX) {
        return false;
    }
    uint32_t place = m->ask_count;
    if (ask->urgent != 0) {
        for (place = 0; place < m->ask_count && m->ask[place].urgent != 0; place++) {
        }
        memmove(&m->ask[place + 1], &m->ask[place], (m->ask_count - place) * sizeof m->ask[0]);
    }
    m->ask[place] = *ask;
    m->ask_count++;
    return true;
}

void line_drop_ask(line_machine *m, uint32_t place)
{
    m->ask_count--;
    memmove(&m->ask[place], &m->ask[place + 1], (m->ask_count - place) * sizeof m->ask[0]);
}

void line_answer_ask(line_machine *m, uint64_t id, uint32_t kind, int64_t now_ns)
{
    m->answer = (line_answer){.id = id, .kind = kind, .done_ns = now_ns, .stamp_ns = now_ns};
    m->answered = true;
}

/* One a step: the thread takes them one by one. */
void line_expire_ask(line_machine *m, int64_t now_ns)
{
    for (uint32_t i = 0; i < m->ask_count && !m->answered; i++) {
        if (m->ask[i].expires_ns <= now_ns || m->end.stage != END_NOT) {
            line_answer_ask(m, m->ask[i].id, ANSWER_EXPIRED, now_ns);
            line_drop_ask(m, i);
        }
    }
}

static bool may_be_sent(const line_machine *m, const line_ask *ask, int64_t now_ns)
{
    if (ask->drive >= m->table.drive_count) {
        return true;
    }
    const line_drive_state *drive = &m->drive[ask->drive];
    bool in_doubt = drive->held_until_ns > now_ns || line_may_be_late(m, ask->drive, &ask->frame, now_ns);
    return drive->silent_until_ns <= now_ns && (ask->urgent != 0 || !in_doubt);
}

uint32_t line_pick_ask(const line_machine *m, int64_t now_ns)
{
    uint32_t place = 0;
    while (place < m->ask_count && !may_be_sent(m, &m->ask[place], now_ns)) {
        place++;
    }
    return place < m->ask_count ? place : LINE_ASKS_MAX;
}
