/* SPDX-License-Identifier: Apache-2.0
 * line_asks.c: requests from outside the cycle: their queue, their end. */
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

void line_answer_ask(line_machine *m, const line_ask *ask, uint32_t kind, int64_t now_ns)
{
    m->answer = (line_answer){.id = ask->id, .kind = kind, .done_ns = now_ns, .stamp_ns = now_ns};
    m->answered = true;
}

/* One a step: the thread takes them one by one. */
void line_expire_ask(line_machine *m, int64_t now_ns)
{
    for (uint32_t i = 0; i < m->ask_count && !m->answered; i++) {
        bool under_way = m->work == WORK_ASK && i == 0;
        if (!under_way && (m->ask[i].expires_ns <= now_ns || m->shut != 0)) {
            line_answer_ask(m, &m->ask[i], ANSWER_EXPIRED, now_ns);
            line_drop_ask(m, i);
        }
    }
}

bool line_pick_ask(line_machine *m, int64_t now_ns)
{
    for (uint32_t i = 0; i < m->ask_count; i++) {
        line_ask ask = m->ask[i];
        if (ask.drive >= m->table.drive_count || m->drive[ask.drive].quiet_until_ns <= now_ns) {
            memmove(&m->ask[1], &m->ask[0], i * sizeof m->ask[0]);
            m->ask[0] = ask;
            return true;
        }
    }
    return false;
}
