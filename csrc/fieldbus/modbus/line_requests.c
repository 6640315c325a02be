/* SPDX-License-Identifier: Apache-2.0
 * line_requests.c: requests from outside the cycle that wait for the wire. The request on the wire
 * has left this queue. */
#include <string.h>

#include "line_machine.h"

bool line_machine_request(line_machine *m, const line_request *request)
{
    if (m->request_count == LINE_REQUESTS_MAX) {
        return false;
    }
    uint32_t place = m->request_count;
    if (request->urgent != 0) {
        for (place = 0; place < m->request_count && m->request[place].urgent != 0; place++) {
        }
        memmove(&m->request[place + 1], &m->request[place],
                (m->request_count - place) * sizeof m->request[0]);
    }
    m->request[place] = *request;
    m->request_count++;
    return true;
}

void line_drop_request(line_machine *m, uint32_t place)
{
    m->request_count--;
    memmove(&m->request[place], &m->request[place + 1],
            (m->request_count - place) * sizeof m->request[0]);
}

void line_answer_request(line_machine *m, uint64_t id, uint32_t kind, int64_t now_ns)
{
    m->answer = (line_answer){.id = id, .kind = kind, .done_ns = now_ns, .stamp_ns = now_ns};
    m->answered = true;
}

/* Drop an expired request, one in each step: the thread takes answers one by one. */
void line_expire_request(line_machine *m, int64_t now_ns)
{
    for (uint32_t i = 0; i < m->request_count && !m->answered; i++) {
        if (m->request[i].expires_ns <= now_ns || m->end.stage != END_NOT) {
            line_answer_request(m, m->request[i].id, ANSWER_EXPIRED, now_ns);
            line_drop_request(m, i);
        }
    }
}

static bool may_be_sent(const line_machine *m, const line_request *request, int64_t now_ns)
{
    if (request->drive >= m->table.drive_count) {
        return true;
    }
    const line_drive_state *drive = &m->drive[request->drive];
    bool in_doubt = drive->held_until_ns > now_ns ||
                    line_may_be_late(m, request->drive, &request->frame, now_ns);
    return drive->silent_until_ns <= now_ns && (request->urgent != 0 || !in_doubt);
}

uint32_t line_pick_request(const line_machine *m, int64_t now_ns)
{
    uint32_t place = 0;
    while (place < m->request_count && !may_be_sent(m, &m->request[place], now_ns)) {
        place++;
    }
    return place < m->request_count ? place : LINE_REQUESTS_MAX;
}
