/* SPDX-License-Identifier: Apache-2.0
 * test_line_turns: which drive of a serial line has its turn, and when the next look is. */
#include "line_wire.h"

static const int64_t RESTING_NS = 50 * MS, MOVING_NS = 10 * MS;

static line_machine *const m = &w.machine;

/* The line is silent. Each drive is ready, and its cycle is due after `due_in_ns`. */
static void begin_ready(uint32_t drives, int64_t due_in_ns)
{
    begin_with(drives, 0);
    w.now_ns = m->free_ns + 100 * MS;
    m->newest = (setpoints){.stamp_ns = w.now_ns, .enabled = 1, .joint_count = JOINTS_MAX};
    for (uint32_t i = 0; i < LINE_DRIVES_MAX; i++) {
        m->drive[i].state.mode = DRIVE_READY;
        m->drive[i].due_ns = w.now_ns + due_in_ns;
        m->drive[i].answered_ns = w.now_ns;
    }
    m->slot_due_ns = w.now_ns + 1000 * MS;
}

static void look(void)
{
    line_machine_step(m, w.now_ns, NULL, 0, &w.out);
}

static void put(uint64_t id, uint32_t drive, uint32_t urgent)
{
    line_request request = {.id = id,
                            .expires_ns = INT64_MAX,
                            .turnaround_ns = 5 * MS,
                            .drive = drive,
                            .urgent = urgent};
    request.frame = frame_of((uint8_t)(drive + 1), READ, STATUS, 1);
    CHECK(line_machine_request(m, &request));
}

/* Whether a request of this kind of work is sent to this drive. */
static bool is_sent(uint32_t work, uint32_t drive)
{
    return w.out.send != NULL && m->work == work && m->worker == drive && w.out.wake_ns == w.now_ns;
}

/* Drops the request in transit. */
static void forget_request(void)
{
    m->work = WORK_NONE;
    m->worker = LINE_DRIVES_MAX;
}

/* -------------------------------------------------------------------------------- stops */
static void drives_that_answer_are_stopped_first_and_then_the_least_tried(void)
{
    static const struct {
        uint32_t failures[3], stop_failures[3], first;
    } cases[] = {{{0, 0, 0}, {0, 0, 0}, 0}, {{1, 0, 0}, {0, 0, 0}, 1}, {{1, 2, 0}, {0, 0, 5}, 2},
                 {{1, 1, 1}, {2, 1, 1}, 1}, {{5, 1, 1}, {0, 0, 0}, 0}, {{1, 1, 1}, {1, 1, 0}, 2}};
    for (uint32_t i = 0; i < sizeof cases / sizeof cases[0]; i++) {
        begin_ready(3, RESTING_NS);
        m->drive[3].state.stop = STOP_POWER_OFF; /* there is no fourth drive */
        m->drive[3].failures = 0;
        for (uint32_t n = 0; n < 3; n++) {
            m->drive[n].state.stop = STOP_POWER_OFF;
            m->drive[n].failures = cases[i].failures[n];
            m->drive[n].stop_failures = cases[i].stop_failures[n];
        }
        look();
        CHECK(is_sent(WORK_STOP, cases[i].first));
    }
    begin_ready(3, RESTING_NS);
    m->drive[3].state.stop = STOP_POWER_OFF;
    look();
    CHECK(w.out.send == NULL);
}

/* ------------------------------------------------------------------------------- cycles */
static void the_drive_that_is_due_first_has_its_turn(void)
{
    for (uint32_t first = 0; first < 3; first++) {
        begin_ready(3, -MS);
        m->drive[first].due_ns = w.now_ns - 2 * MS;
        m->drive[3].due_ns = w.now_ns - 9 * MS; /* there is no fourth drive */
        look();
        CHECK(is_sent(WORK_CYCLE, first));
    }
    begin_ready(3, 0);
    look();
    CHECK(is_sent(WORK_CYCLE, 0)); /* the first of several that are due */
    begin_ready(2, 0);
    m->drive[0].held_until_ns = w.now_ns + 1, m->drive[1].silent_until_ns = w.now_ns + 2;
    look();
    CHECK(w.out.send == NULL && w.out.wake_ns == w.now_ns + 1);
    w.now_ns++;
    look();
    CHECK(is_sent(WORK_CYCLE, 0));
}

/* ----------------------------------------------------- the slot for requests and probes */
static void a_request_goes_between_two_cycles_where_it_fits(void)
{
    int64_t takes_ns = 15 * CHARACTER_NS + 5 * MS + GAP_NS;
    for (int64_t short_ns = 0; short_ns < 2; short_ns++) {
        begin_ready(1, takes_ns - short_ns);
        put(7, LINE_DRIVES_MAX, 0);
        look();
        CHECK(short_ns == 0 ? is_sent(WORK_REQUEST, LINE_DRIVES_MAX) : w.out.send == NULL);
        /* the next look is for the drive, whose cycle comes first */
        CHECK(short_ns == 0 || w.out.wake_ns == w.now_ns + takes_ns - 1);
    }
    begin_ready(1, 0);
    m->drive[0].state.mode = DRIVE_OFF; /* no cycle of a drive is due */
    put(7, LINE_DRIVES_MAX, 0);
    look();
    CHECK(is_sent(WORK_REQUEST, LINE_DRIVES_MAX));
}

static void the_slot_has_its_own_turn_like_a_drive(void)
{
    begin_ready(1, 1);
    put(7, LINE_DRIVES_MAX, 0);
    m->slot_due_ns = w.now_ns;
    look();
    CHECK(is_sent(WORK_REQUEST, LINE_DRIVES_MAX) && m->slot_turn == 1 &&
          m->slot_due_ns == w.now_ns + 20 * MS);
    begin_ready(1, 0);
    put(7, LINE_DRIVES_MAX, 0);
    m->slot_due_ns = w.now_ns; /* both are due: the slot precedes, once in its period */
    look();
    CHECK(is_sent(WORK_REQUEST, LINE_DRIVES_MAX));
    begin_ready(1, -1);
    put(7, LINE_DRIVES_MAX, 0);
    m->slot_due_ns = w.now_ns;
    look();
    CHECK(is_sent(WORK_CYCLE, 0) && m->slot_turn == 0);
    begin_ready(1, MS);
    put(7, LINE_DRIVES_MAX, 0);
    m->slot_due_ns = w.now_ns - 500 * MS; /* missed slots are not made up for */
    look();
    CHECK(is_sent(WORK_REQUEST, LINE_DRIVES_MAX) && m->slot_due_ns == w.now_ns);
}

static void requests_and_probes_take_turns_but_for_urgent_ones(void)
{
    begin_ready(2, 1000 * MS);
    m->drive[1].state.mode = DRIVE_UNRESPONSIVE;
    for (uint32_t turn = 0; turn < 6; turn++) {
        put(7, LINE_DRIVES_MAX, 0);
        m->drive[1].probe_at_ns = 0;
        m->slot_due_ns = w.now_ns;
        look();
        CHECK(turn % 2 == 0 ? is_sent(WORK_REQUEST, LINE_DRIVES_MAX) : is_sent(WORK_PROBE, 1));
        CHECK(m->slot_turn == turn + 1 && m->slot_due_ns == w.now_ns + 20 * MS);
        forget_request();
    }
    put(8, LINE_DRIVES_MAX, 1);
    /* the urgent request precedes, and then the probe has its turn */
    for (uint32_t turn = 6; turn < 8; turn++) {
        m->drive[1].probe_at_ns = 0;
        m->slot_due_ns = w.now_ns;
        m->slot_turn = 7;
        look();
        CHECK(turn == 6 ? is_sent(WORK_REQUEST, LINE_DRIVES_MAX) && m->transaction.request_id == 8
                        : is_sent(WORK_PROBE, 1));
        forget_request();
    }
    m->request_count = 0;
    for (uint32_t turn = 0; turn < 2; turn++) {
        m->drive[1].probe_at_ns = 0;
        m->slot_due_ns = w.now_ns;
        look();
        CHECK(is_sent(WORK_PROBE, 1)); /* no request needs the slot */
        forget_request();
    }
}

/* ------------------------------------------------------------ a line that is not silent */
static void a_turn_that_noise_delays_for_a_quarter_of_a_second_is_a_failure(void)
{
    for (int64_t early_ns = 1; early_ns >= 0; early_ns--) {
        begin_ready(2, 0);
        m->drive[1].state.mode = DRIVE_OFF;
        m->drive[2].due_ns = 0; /* there is no third drive */
        m->ours_ns = w.now_ns + 3 * MS;
        w.now_ns += 3 * MS + 250 * MS - early_ns;
        m->newest.stamp_ns = w.now_ns;
        m->free_ns = w.now_ns + MS;
        look();
        CHECK(w.out.send == NULL && m->drive[0].failures == (early_ns == 0) &&
              m->drive[1].failures == 0);
        CHECK(m->drive[2].failures == 0);
    }
}

static void the_time_of_the_last_silence_is_kept(void)
{
    begin_ready(1, RESTING_NS);
    look();
    CHECK(m->silent_ns == w.now_ns);
    int64_t silent_ns = w.now_ns;
    w.now_ns += MS;
    m->free_ns = w.now_ns + MS;
    look();
    CHECK(m->silent_ns == silent_ns);
}

/* A drive that may turn gets its stop also on a noisy line. The others wait for silence. */
static void only_a_drive_that_may_turn_is_probed_on_a_noisy_line(void)
{
    for (uint32_t may_turn = 0; may_turn < 2; may_turn++) {
        begin_ready(2, RESTING_NS);
        m->drive[0].state.mode = m->drive[1].state.mode = DRIVE_UNRESPONSIVE;
        m->drive[1].may_turn = true;
        m->drive[0].may_turn = may_turn != 0;
        m->drive[0].probe_at_ns = m->drive[1].probe_at_ns = 0;
        m->ours_ns = 0, m->free_ns = INT64_MAX;
        look();
        CHECK(w.out.send == NULL && m->urgent_by_ns == w.now_ns + GAP_NS + 20 * MS &&
              w.out.wake_ns == m->urgent_by_ns);
        w.now_ns = m->urgent_by_ns;
        look();
        CHECK(is_sent(WORK_PROBE, may_turn != 0 ? 0 : 1));
    }
}

/* ---------------------------------------------------------------- time of the next look */
static void begin_resting(void)
{
    begin_ready(2, 0);
    m->drive[0].state.mode = m->drive[1].state.mode = DRIVE_OFF;
}

static int64_t next_look_in(void)
{
    look();
    CHECK(w.out.send == NULL);
    return w.out.wake_ns - w.now_ns;
}

static void drives_at_rest_are_checked_seldom_and_those_that_may_move_often(void)
{
    begin_resting();
    m->drive[2].state.sent_motion = true; /* there is no third drive */
    CHECK(next_look_in() == RESTING_NS);
    begin_resting();
    m->drive[1].state.sent_motion = true;
    CHECK(next_look_in() == MOVING_NS);
    begin_ready(1, 40 * MS);
    CHECK(next_look_in() == 40 * MS); /* the look for its next cycle */
    begin_ready(1, 40 * MS);
    m->drive[0].state.mode = DRIVE_ARMED;
    m->drive[0].state.was_enabled = true;
    CHECK(next_look_in() == MOVING_NS);
    begin_ready(1, 3 * MS);
    m->drive[0].state.mode = DRIVE_ARMED;
    m->drive[0].state.was_enabled = true;
    CHECK(next_look_in() == 3 * MS);
    begin_resting();
    m->end = (line_ending){
        .stage = END_RESTING, .rest_by_ns = w.now_ns + 900 * MS, .off_by_ns = w.now_ns + 900 * MS};
    m->drive[0].state.stopping = true, m->drive[0].state.off_by_ns = w.now_ns + 900 * MS;
    CHECK(next_look_in() == MOVING_NS && m->end.stage == END_RESTING);
    begin_resting();
    m->end.stage = END_SILENT;
    m->drive[0].state.sent_motion = true;
    CHECK(next_look_in() == RESTING_NS);
}

static void a_probe_waits_for_its_time_for_late_replies_and_for_the_slot(void)
{
    for (uint32_t latest = 0; latest < 3; latest++) {
        begin_resting();
        m->drive[1].state.mode = DRIVE_UNRESPONSIVE;
        m->drive[1].probe_at_ns = w.now_ns + (latest == 0 ? 9 : 2) * MS;
        m->drive[1].silent_until_ns = w.now_ns + (latest == 1 ? 9 : 3) * MS;
        m->slot_due_ns = w.now_ns + (latest == 2 ? 9 : 4) * MS;
        CHECK(next_look_in() == 9 * MS);
    }
    begin_resting(); /* the end has no probes */
    m->drive[1].state.mode = DRIVE_UNRESPONSIVE;
    m->drive[1].probe_at_ns = w.now_ns + 2 * MS;
    m->drive[0].state.stopping = true, m->drive[0].state.off_by_ns = w.now_ns + 900 * MS;
    m->end = (line_ending){.stage = END_POWER_OFF, .off_by_ns = w.now_ns + 900 * MS};
    m->slot_due_ns = w.now_ns;
    CHECK(next_look_in() == MOVING_NS && m->end.stage == END_POWER_OFF);
}

static void a_waiting_request_is_checked_with_the_slot(void)
{
    for (int64_t slot_in_us = 100; slot_in_us <= 700; slot_in_us += 600) {
        begin_ready(1, MS);
        put(7, LINE_DRIVES_MAX, 0);
        m->slot_due_ns = w.now_ns + slot_in_us * 1000;
        CHECK(next_look_in() == (slot_in_us < 250 ? MS / 4 : slot_in_us * 1000));
    }
}

static void a_stop_waits_for_the_gap_alone(void)
{
    begin_ready(1, 30 * MS);
    m->drive[0].state.stop = STOP_POWER_OFF;
    m->ours_ns = m->free_ns = w.now_ns + MS;
    CHECK(next_look_in() == MS && m->urgent_by_ns > w.now_ns + MS);
    w.now_ns += MS;
    look();
    CHECK(is_sent(WORK_STOP, 0));
}

/* ---------------------------------------------------------------------------- each step */
static void a_step_reports_only_its_own_results(void)
{
    begin_ready(2, RESTING_NS);
    m->feedback_mask = 6, m->notify = m->answered = true, m->round_trip_ns = 5;
    look();
    CHECK(w.out.feedback_mask == 0 && m->feedback_mask == 0 && !m->notify && !m->answered &&
          m->round_trip_ns == 0);
    CHECK(!w.out.notify && !w.out.answered);
    m->control.drive[2].count++; /* there is no third drive */
    m->control.drive[2].mode = DRIVE_OFF;
    look();
    CHECK(!w.out.notify && m->drive[2].state.mode == DRIVE_READY);
    m->control.drive[1].count++;
    m->control.drive[1].mode = DRIVE_OFF;
    look();
    CHECK(w.out.notify && !w.out.answered && m->drive[1].state.mode == DRIVE_OFF);
    put(7, 0, 0);
    m->request[0].expires_ns = w.now_ns;
    look();
    CHECK(w.out.notify && w.out.answered && m->answer.kind == ANSWER_EXPIRED &&
          w.out.wake_ns == w.now_ns);
    look();
    CHECK(!w.out.notify && !w.out.answered);
}

/* ------------------------------------------------------------------------------- a kick */
static void a_new_set_point_makes_its_own_drives_due(void)
{
    for (uint32_t against = 0; against < 5; against++) {
        begin_ready(2, 30 * MS);
        int64_t due_ns = m->drive[1].due_ns;
        m->drive[0].state.mode = m->drive[1].state.mode = m->drive[2].state.mode = DRIVE_ARMED;
        m->newest.joint[1].velocity_rad_s = against == 1 ? 0.0 : 1.0;
        m->newest.joint[2].velocity_rad_s = 1.0;
        m->table.drive[2] = drive_of(2); /* there is no third drive */
        m->drive[1].state.mode = against == 2 ? DRIVE_READY : DRIVE_ARMED;
        m->drive[1].due_ns = against == 3 ? w.now_ns - MS : due_ns;
        /* the set-point of the running cycle is kept */
        m->table.drive[1].direction_count = against == 4 ? 1 : 0;
        m->drive[1].frozen.joint[1].velocity_rad_s = -7.0;
        line_machine_kick(m, w.now_ns);
        int64_t expected_ns = against == 0 || against == 4 ? w.now_ns
                              : against == 3               ? w.now_ns - MS
                                                           : due_ns;
        CHECK(m->drive[1].due_ns == expected_ns && m->drive[0].due_ns == due_ns &&
              m->drive[2].due_ns == due_ns);
        CHECK(m->drive[1].frozen.joint[1].velocity_rad_s == -7.0);
    }
    begin_ready(1, 30 * MS);
    m->drive[0].state.mode = DRIVE_ARMED;
    m->newest.joint[0].velocity_rad_s = 1.0;
    line_machine_kick(m, w.now_ns);
    CHECK(m->drive[0].due_ns == w.now_ns);
}

int main(void)
{
    drives_that_answer_are_stopped_first_and_then_the_least_tried();
    the_drive_that_is_due_first_has_its_turn();
    a_request_goes_between_two_cycles_where_it_fits();
    the_slot_has_its_own_turn_like_a_drive();
    requests_and_probes_take_turns_but_for_urgent_ones();
    a_turn_that_noise_delays_for_a_quarter_of_a_second_is_a_failure();
    the_time_of_the_last_silence_is_kept();
    only_a_drive_that_may_turn_is_probed_on_a_noisy_line();
    drives_at_rest_are_checked_seldom_and_those_that_may_move_often();
    a_probe_waits_for_its_time_for_late_replies_and_for_the_slot();
    a_waiting_request_is_checked_with_the_slot();
    a_stop_waits_for_the_gap_alone();
    a_step_reports_only_its_own_results();
    a_new_set_point_makes_its_own_drives_due();
    return checks_report("line turns");
}
