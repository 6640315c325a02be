/* SPDX-License-Identifier: Apache-2.0
 * line_unresponsive.c: the frames for a drive that does not answer, and how often it is polled; how
 * long a stop waits on a line that is never silent. */
#include <string.h>

#include "line_machine.h"

/* Time that a stop waits beyond its gap: a stop that may collide is better than one that is never
 * sent. */
static const int64_t URGENT_NOISE_NS = 20 * LINE_MS;
static const int64_t PROBE_FIRST_NS = 100 * LINE_MS, PROBE_LAST_NS = 2000 * LINE_MS;

/* Return the number of exchanges for a drive that is not armed; if the first one has a position,
 * 0. */
static uint32_t zero_exchanges(const line_machine *m, uint32_t number)
{
    const line_drive *table = &m->table.drive[number];
    uint32_t count = 0;
    while (count < table->cyclic_count && table->cyclic[count].setpoint_count > 0 &&
           line_sends(m, number, count)) {
        count++;
    }
    return count;
}

/* Return the number of frames that stop a drive that may turn: it may receive although its answers
 * do not arrive, and reads feed its watchdog. */
static uint32_t stop_probes(const line_machine *m, uint32_t number)
{
    const line_drive *table = &m->table.drive[number];
    if (!m->drive[number].may_turn) {
        return 0;
    }
    return m->drive[number].probes_power_off ? table->disarm_count
                                             : table->quick_stop_count + zero_exchanges(m, number);
}

/* Return whether the power-off of an unresponsive drive is due and not sent yet: it had the time to
 * brake, and the core does not enable the drives any more (a disarm, or a fault that does not
 * hold). */
static bool power_off_is_due(const line_machine *m, uint32_t number, int64_t now_ns)
{
    const line_drive_state *drive = &m->drive[number];
    bool enabled = line_fresh(m, now_ns) && m->newest.enabled == 1;
    return drive->may_turn && !drive->probes_power_off && now_ns >= drive->braked_ns && !enabled;
}

void line_becomes_unresponsive(line_machine *m, uint32_t number, int64_t now_ns)
{
    line_drive_state *drive = &m->drive[number];
    if (drive->state.mode != DRIVE_UNRESPONSIVE) {
        drive->count.unresponsive++;
    }
    drive_unresponsive(&drive->state);
    if (m->end.stage < END_POWER_OFF) {
        drive->state.stop = STOP_NOTHING; /* probes stop the drive; at the line's end there are
                                             none, so it keeps its pending stop */
    }
    drive->stage = STAGE_IDLE;
    drive->probe_place = 0;
    drive->probes_power_off = false;
    drive->braked_ns = now_ns + DRIVE_STOPPING_NS;
    drive->probes_at_once = stop_probes(m, number) + 1;
    drive->probe_pause_ns = PROBE_FIRST_NS;
    drive->probe_at_ns = now_ns;
    memset(drive->direction_sent, 0, sizeof drive->direction_sent);
    if (m->current == number) {
        m->current = LINE_DRIVES_MAX;
    }
}

const line_exchange *line_exchange_at(const line_drive *table, uint32_t place)
{
    return place < table->cyclic_count ? &table->cyclic[place]
                                       : &table->extra[place - table->cyclic_count];
}

/* Return the exchange that probes. The first one of the cycle may hold a position: it is used only
 * if there is no other. */
uint32_t line_probe_place(const line_drive *table)
{
    if (table->probe > 0) {
        return table->probe - 1;
    }
    return table->extra_count > 0 ? table->cyclic_count : 0;
}

void line_build_read(line_machine *m, uint32_t number, uint32_t place, line_frame *out)
{
    const line_drive *table = &m->table.drive[number];
    if (place < table->cyclic_count) {
        (void)line_build(m, number, place, out); /* with zeros, because the drive is not armed */
    } else {
        *out = line_exchange_at(table, place)->frame;
    }
}

void line_next_probe(line_machine *m, uint32_t number, int64_t now_ns, line_frame *out)
{
    line_drive_state *drive = &m->drive[number];
    const line_drive *table = &m->table.drive[number];
    if (power_off_is_due(m, number, now_ns)) {
        drive->probes_power_off = true;
        drive->probe_place = 0;
        drive->probes_at_once = table->disarm_count + 1;
        drive->probe_pause_ns = PROBE_FIRST_NS;
    }
    uint32_t stops = stop_probes(m, number);
    uint32_t place = drive->probe_place;
    if (place < stops && drive->probes_power_off) {
        *out = table->disarm[place];
    } else if (place < stops && place < table->quick_stop_count) {
        *out = table->quick_stop[place];
    } else if (place < stops) {
        (void)line_build(m, number, place - table->quick_stop_count, out);
    } else {
        line_build_read(m, number, line_probe_place(table), out);
    }
    drive->probe_place = (place + 1) % (stops + 1);
    if (drive->probes_at_once > 1) {
        drive->probes_at_once--;
        drive->probe_at_ns = now_ns;
        return;
    }
    drive->probe_at_ns = now_ns + drive->probe_pause_ns;
    drive->probe_pause_ns =
        2 * drive->probe_pause_ns < PROBE_LAST_NS ? 2 * drive->probe_pause_ns : PROBE_LAST_NS;
}

uint32_t line_due_probe(const line_machine *m, bool may_turn, int64_t now_ns)
{
    for (uint32_t i = 0; i < m->table.drive_count; i++) {
        const line_drive_state *drive = &m->drive[i];
        bool due = drive->state.mode == DRIVE_UNRESPONSIVE && drive->silent_until_ns <= now_ns &&
                   (drive->probe_at_ns <= now_ns || power_off_is_due(m, i, now_ns));
        if (due && (drive->may_turn || !may_turn)) {
            return i;
        }
    }
    return LINE_DRIVES_MAX;
}

/* ---------------------------------------------------------- a line that is never silent */
static bool is_urgent(const line_machine *m, int64_t now_ns)
{
    uint32_t place = line_pick_request(m, now_ns);
    bool urgent = m->broadcasts > 0 || (place < LINE_REQUESTS_MAX && m->request[place].urgent != 0);
    for (uint32_t i = 0; i < m->table.drive_count; i++) {
        urgent |= m->drive[i].state.stop != STOP_NOTHING;
    }
    return urgent || (m->end.stage == END_NOT && line_due_probe(m, true, now_ns) < LINE_DRIVES_MAX);
}

bool line_ends_patience(line_machine *m, int64_t now_ns)
{
    if (!is_urgent(m, now_ns)) {
        m->urgent_by_ns = 0;
    } else if (m->urgent_by_ns == 0) {
        int64_t silent_ns = now_ns + m->table.gap_ns; /* at the earliest */
        int64_t patience_ns = (m->ours_ns > silent_ns ? m->ours_ns : silent_ns) + URGENT_NOISE_NS;
        m->urgent_by_ns = m->noisy ? m->ours_ns : patience_ns;
    }
    bool ends = m->urgent_by_ns != 0 && now_ns >= m->urgent_by_ns;
    m->noisy |= ends;
    return ends;
}
