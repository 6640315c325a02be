/* SPDX-License-Identifier: Apache-2.0
 * test_line_probes: which state a drive of a line loses when it becomes unresponsive, and how
 * long urgent requests wait for silence. */
#include "line_wire.h"

static void a_drive_that_becomes_unresponsive_has_no_last_set_points(void)
{
    for (uint32_t how = 0; how < 4; how++) {
        begin_with(2, 0);
        line_drive_state *drive = &w.machine.drive[0];
        drive->state.mode = how == 3 ? DRIVE_UNRESPONSIVE : DRIVE_ARMED;
        drive->may_turn = how != 1;
        drive->state.stop = STOP_POWER_OFF;
        drive->state.stopping = drive->state.back = true;
        drive->stage = STAGE_READ, drive->probe_place = 2, drive->probe_pause_ns = 7,
        drive->probe_at_ns = 1;
        for (uint32_t direction = 0; direction < DRIVE_DIRECTIONS_MAX; direction++) {
            drive->direction_sent[direction] = DIRECTION_FORWARD;
        }
        w.machine.current = how == 1 ? 1 : 0;
        w.machine.end.stage = how == 2 ? 2 : how == 1 ? 1 : 0;
        line_becomes_unresponsive(&w.machine, 0, w.now_ns);
        CHECK(drive->state.mode == DRIVE_UNRESPONSIVE &&
              (drive->state.fault_reasons & DRIVE_FAULT_UNRESPONSIVE) != 0 &&
              drive->count.unresponsive == (how != 3));
        CHECK(drive->state.stop == (how == 2 ? STOP_POWER_OFF : STOP_NOTHING) &&
              !drive->state.stopping && !drive->state.back);
        CHECK(drive->stage == STAGE_IDLE && drive->probe_place == 0 &&
              drive->probe_pause_ns == 100 * MS);
        /* a quick stop, a set-point of zero and a probe; or only the probe */
        CHECK(drive->probe_at_ns == w.now_ns && drive->probes_at_once == (how == 1 ? 1 : 3));
        for (uint32_t direction = 0; direction < DRIVE_DIRECTIONS_MAX; direction++) {
            CHECK(drive->direction_sent[direction] == DIRECTION_UNKNOWN);
        }
        CHECK(w.machine.current == (how == 1 ? 1 : (uint32_t)LINE_DRIVES_MAX));
    }
}

static void probes_of_a_drive_that_may_turn_stop_it_in_each_round(void)
{
    begin_with(2, 0);
    line_drive_state *drive = &w.machine.drive[0];
    drive->may_turn = true;
    line_becomes_unresponsive(&w.machine, 0, w.now_ns);
    int64_t pause_ns = 100 * MS;
    for (uint32_t round = 0; round < 4; round++) {
        for (uint32_t i = 0; i < 3; i++) {
            line_frame frame;
            w.now_ns += MS;
            line_next_probe(&w.machine, 0, w.now_ns, &frame);
            bool at_once = round == 0 && i < 2;
            CHECK(i == 0   ? frame.request[3] == CONTROL && frame.request[5] == QUICK_STOP
                  : i == 1 ? frame.request[1] == WRITE && frame.request[3] == SPEED &&
                                 frame.request[5] == 0
                           : frame.request[1] == READ && frame.request[3] == STATUS);
            CHECK(drive->probe_at_ns == (at_once ? w.now_ns : w.now_ns + pause_ns));
            CHECK(drive->probe_place == (i + 1) % 3);
            pause_ns = at_once ? pause_ns : 2 * pause_ns < 2000 * MS ? 2 * pause_ns : 2000 * MS;
            CHECK(drive->probe_pause_ns == pause_ns);
        }
    }
}

static void probes_of_a_drive_that_braked_take_its_power_off_once_it_is_not_enabled(void)
{
    begin_with(2, 0);
    line_machine *m = &w.machine;
    line_drive_state *drive = &m->drive[0];
    drive->may_turn = true;
    line_becomes_unresponsive(m, 0, w.now_ns);
    line_frame frame;
    for (uint32_t i = 0; i < 3; i++) {
        line_next_probe(m, 0, w.now_ns, &frame);
    }
    w.now_ns += DRIVE_STOPPING_NS;
    drive->probe_at_ns = w.now_ns + 1; /* the next round is not due yet */
    m->newest.enabled = 1, m->newest.stamp_ns = w.now_ns;
    CHECK(line_due_probe(m, true, w.now_ns) == LINE_DRIVES_MAX); /* it holds */
    m->newest.enabled = 0, w.now_ns--;
    CHECK(line_due_probe(m, true, w.now_ns) == LINE_DRIVES_MAX); /* it still brakes */
    w.now_ns++;
    for (uint32_t round = 0; round < 2; round++) {
        for (uint32_t i = 0; i < m->table.drive[0].disarm_count; i++) {
            CHECK(round > 0 || line_due_probe(m, true, w.now_ns) == 0);
            line_next_probe(m, 0, w.now_ns, &frame);
            CHECK(memcmp(&frame, &m->table.drive[0].disarm[i], sizeof frame) == 0);
        }
        line_next_probe(m, 0, w.now_ns, &frame);
        CHECK(frame.request[1] == READ && drive->probe_at_ns > w.now_ns);
    }
    line_becomes_unresponsive(m, 0, w.now_ns);
    line_next_probe(m, 0, w.now_ns, &frame);
    CHECK(frame.request[3] == CONTROL && frame.request[5] == QUICK_STOP);
}

static void the_exchange_that_reads_goes_before_the_extra_ranges(void)
{
    begin_with(1, 0);
    w.machine.table.drive[0].probe = 1;
    w.machine.table.drive[0].extra_count = 1;
    w.machine.table.drive[0].extra[0].frame = frame_of(1, READ, STATUS, 1);
    line_becomes_unresponsive(&w.machine, 0, w.now_ns);
    line_frame frame;
    line_next_probe(&w.machine, 0, w.now_ns, &frame);
    CHECK(frame.request[1] == WRITE && frame.request[3] == SPEED);
}

static void the_first_unresponsive_drive_that_is_due_is_probed(void)
{
    begin_with(3, 0);
    line_machine *m = &w.machine;
    m->drive[3].state.mode = DRIVE_UNRESPONSIVE; /* beyond the count of drives */
    m->drive[3].may_turn = true;
    CHECK(line_due_probe(m, false, w.now_ns) == LINE_DRIVES_MAX);
    for (uint32_t i = 1; i < 3; i++) {
        m->drive[i].state.mode = DRIVE_UNRESPONSIVE;
        m->drive[i].probe_at_ns = m->drive[i].silent_until_ns = w.now_ns;
        m->drive[i].braked_ns = INT64_MAX;
    }
    CHECK(line_due_probe(m, false, w.now_ns) == 1 &&
          line_due_probe(m, true, w.now_ns) == LINE_DRIVES_MAX);
    m->drive[2].may_turn = true;
    CHECK(line_due_probe(m, false, w.now_ns) == 1 && line_due_probe(m, true, w.now_ns) == 2);
    m->drive[2].probe_at_ns++;
    CHECK(line_due_probe(m, true, w.now_ns) == LINE_DRIVES_MAX);
    m->drive[2].probe_at_ns--, m->drive[2].silent_until_ns++;
    CHECK(line_due_probe(m, true, w.now_ns) == LINE_DRIVES_MAX);
    m->drive[1].may_turn = true;
    CHECK(line_due_probe(m, true, w.now_ns) == 1);
}

/* Cases: each kind of urgent work, and others. */
static void urgent_requests_wait_twenty_milliseconds_for_silence_and_others_without_limit(void)
{
    for (uint32_t what = 0; what < 6; what++) {
        begin_with(2, 0);
        line_machine *m = &w.machine;

        m->ours_ns = w.now_ns + 3 * MS;
        m->broadcasts = what == 1;
        m->drive[2].state.stop = STOP_QUICK; /* beyond the count of drives */
        m->drive[1].state.stop = what == 2 ? STOP_QUICK : STOP_NOTHING;
        m->drive[1].state.mode = what >= 3 ? DRIVE_UNRESPONSIVE : DRIVE_OFF;
        m->drive[1].may_turn = what == 3 || what == 4;
        m->end.stage = what == 4;
        bool urgent = what >= 1 && what <= 3;
        m->urgent_by_ns = 0;
        m->noisy = false;
        CHECK(!line_ends_patience(m, w.now_ns) && !m->noisy);
        CHECK(m->urgent_by_ns == (urgent ? w.now_ns + 23 * MS : 0));
        CHECK(!line_ends_patience(m, w.now_ns + 23 * MS - 1));
        CHECK(line_ends_patience(m, w.now_ns + 23 * MS) == urgent && m->noisy == urgent);
    }
    begin_with(1, 0);
    w.machine.broadcasts = 1;
    w.machine.ours_ns = w.now_ns; /* the wait begins after the gap */
    CHECK(!line_ends_patience(&w.machine, w.now_ns) &&
          w.machine.urgent_by_ns == w.now_ns + GAP_NS + 20 * MS);
    w.machine.urgent_by_ns = 0;
    w.machine.noisy = true; /* the last wait for silence was in vain */
    w.machine.ours_ns = w.now_ns + 3 * MS;
    CHECK(!line_ends_patience(&w.machine, w.now_ns) && w.machine.urgent_by_ns == w.now_ns + 3 * MS);
    w.machine.broadcasts = 0;
    CHECK(!line_ends_patience(&w.machine, w.now_ns + 9 * MS) && w.machine.urgent_by_ns == 0);
}

int main(void)
{
    a_drive_that_becomes_unresponsive_has_no_last_set_points();
    probes_of_a_drive_that_may_turn_stop_it_in_each_round();
    probes_of_a_drive_that_braked_take_its_power_off_once_it_is_not_enabled();
    the_exchange_that_reads_goes_before_the_extra_ranges();
    the_first_unresponsive_drive_that_is_due_is_probed();
    urgent_requests_wait_twenty_milliseconds_for_silence_and_others_without_limit();
    return checks_report("line probes");
}
