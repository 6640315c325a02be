/* SPDX-License-Identifier: Apache-2.0
 * Positions on a serial line: 0 is a position like any other, so a drive that must not move gets no
 * target. */
#include "position_wire.h"

static void a_position_is_scaled_from_its_zero_and_held_within_its_range(void)
{
    static const struct {
        double position_rad;
        int16_t raw;
    } cases[] = {{0.0, 2000},    {0.5, 1500}, {-0.5, 2500}, {0.0004, 2000},
                 {0.0006, 1999}, {1.9, 100},  {1.91, 100},  {-2.0, 4000},
                 {-2.1, 4000},   {40.0, 100}, {FAR, 100},   {-FAR, 4000}};
    begin();
    arm_it();
    for (uint32_t i = 0; i < sizeof cases / sizeof cases[0]; i++) {
        go_to(cases[i].position_rad, 1, 50 * MS);
        CHECK(newest_target == cases[i].raw && m->drive[0].state.sent_motion);
    }
}

static void a_drive_that_is_not_armed_gets_no_position(void)
{
    begin();
    go_to(0.5, 1, 100 * MS);
    request(0, DRIVE_READY);
    go_to(0.5, 1, 200 * MS);
    CHECK(targets == 0 && reads > 8 && !m->drive[0].state.sent_motion && !line_wants_motion(m, 0));
}

static void an_unknown_position_is_not_sent_and_the_drive_is_still_read(void)
{
    static const double NO_PLACES[] = {NAN, INFINITY, -INFINITY};
    for (uint32_t i = 0; i < 4; i++) {
        begin();
        arm_it();
        go_to(0.5, 1, 50 * MS);
        CHECK(targets > 0 && line_wants_motion(m, 0) && !line_differs(m, 0));
        uint32_t sent = targets, seen = reads;
        go_to(i < 3 ? NO_PLACES[i] : 0.7, i < 3 ? 1 : 0, 200 * MS);
        CHECK(targets == sent && reads > seen + 8 && m->drive[0].state.mode == DRIVE_ARMED);
        CHECK(!line_wants_motion(m, 0) && !line_differs(m, 0) && !m->drive[0].state.sent_motion);
        go_to(0.7, 1, 50 * MS);
        CHECK(targets > sent && newest_target == 1300);
    }
}

static void a_new_position_does_not_wait_for_its_cycle(void)
{
    begin();
    arm_it();
    go_to(0.5, 1, 50 * MS);
    want(0.6, 1);
    CHECK(line_differs(m, 0));
    want(0.5, 1);
    CHECK(!line_differs(m, 0));
}

static void clearing_enabled_takes_the_power_without_sending_a_position(void)
{
    begin();
    arm_it();
    go_to(0.5, 1, 50 * MS);
    uint32_t sent = targets;
    for (int64_t end_ns = w.now_ns + 200 * MS; w.now_ns < end_ns;) {
        want(0.9, 1);
        m->newest.enabled = 0;
        look();
    }
    CHECK(targets == sent && w.power_offs[0] > 0 && m->drive[0].state.mode == DRIVE_READY);
}

static void old_set_points_stop_it_without_sending_a_position(void)
{
    begin();
    arm_it();
    go_to(0.5, 1, 50 * MS);
    uint32_t sent = targets;
    for (int64_t end_ns = w.now_ns + 300 * MS; w.now_ns < end_ns;) {
        look();
    }
    CHECK(w.quick_stop_ns[0] > 0 && w.power_offs[0] > 0 && targets <= sent + 5);
    sent = targets;
    go_to(0.9, 1, 200 * MS);
    CHECK(targets == sent);
}

/* The probes are the stop and a read: the first set-point exchange with zeros would contain a
 * target. */
static void a_drive_that_does_not_answer_gets_its_stop_and_no_position(void)
{
    begin();
    arm_it();
    go_to(0.5, 1, 50 * MS);
    w.mute = 1;
    go_to(0.6, 1, 500 * MS);
    CHECK(m->drive[0].state.mode == DRIVE_UNRESPONSIVE && w.quick_stop_sent[0] > 0);
    uint32_t sent = targets, seen = reads;
    go_to(0.9, 1, 5000 * MS);
    CHECK(targets == sent && reads > seen);
}

static void whether_its_counter_has_a_reference_is_reported(void)
{
    for (uint32_t mask = 0; mask < 2; mask++) {
        begin();
        w.table.drive[0].cyclic[1].field_count = 3;
        w.table.drive[0].cyclic[1].field[2] = (line_field){.kind = FIELD_REFERENCED,
                                                           .byte = 3,
                                                           .form = FORM_U16,
                                                           .equals_mask = 8 << mask,
                                                           .equals = 8,
                                                           .si_per_raw = 1.0};
        CHECK(line_machine_init(m, &w.table, 0, w.now_ns) == 0);
        CHECK(m->joint[0].feedback.referenced == 2);
        request(0, DRIVE_READY);
        w.place = 9;
        go_to(NAN, 0, 100 * MS);
        CHECK(m->joint[0].feedback.referenced == (mask == 0));
    }
}

/* --------------------------------------------------------------------- the first target */
/* The drive is at 1500, the place of 0.5 rad. 2 rad/s are 2000 counts/s: 200 counts in the time for
 * which a position is fresh. */
static void begin_at_limited_speed(void)
{
    begin();
    setpoint->raw_per_s = 2000.0;
    CHECK(line_machine_init(m, &w.table, 0, w.now_ns) == 0);
}

static void the_first_target_is_its_own_position_and_later_ones_move_from_there(void)
{
    begin_at_limited_speed();
    arm_it();
    w.place = 1490; /* the shaft yields a little */
    go_to(NAN, 0, 50 * MS);
    CHECK(targets == 0);
    while (targets == 0) {
        want(0.45, 1);
        look();
    }
    CHECK(newest_target == 1490);
    int64_t last_ns = w.now_ns;
    int16_t last_target = newest_target;
    while (newest_target != 1000 && w.now_ns < last_ns + 1000 * MS) {
        uint32_t before = targets;
        want(1.0, 1);
        look();
        if (targets != before) {
            CHECK(abs(newest_target - last_target) <=
                  (int)((double)(w.now_ns - last_ns) * 2e-6) + 1);
            last_ns = w.now_ns;
            last_target = newest_target;
        }
    }
    CHECK(newest_target == 1000);
}

static void a_target_that_has_moved_on_since_it_was_sent_does_not_wait_for_its_cycle(void)
{
    begin_at_limited_speed();
    arm_it();
    go_to(0.5, 1, 50 * MS);
    for (uint32_t before = targets; targets == before;) {
        want(1.0, 1);
        look();
    }
    int64_t later_ns = m->now_ns + 5 * MS;
    CHECK(m->drive[0].due_ns > later_ns);
    line_machine_kick(m, later_ns);
    CHECK(m->drive[0].due_ns == later_ns);
}

static void a_first_target_far_from_its_position_takes_the_power(void)
{
    static const struct {
        int16_t place;
        bool goes;
    } cases[] = {{1700, true}, {1301, true}, {1701, false}, {1299, false}, {3900, false}};
    for (uint32_t i = 0; i < sizeof cases / sizeof cases[0]; i++) {
        begin_at_limited_speed();
        w.place = cases[i].place;
        arm_it();
        go_to(0.5, 1, 100 * MS);
        bool armed = m->drive[0].state.mode == DRIVE_ARMED;
        CHECK(armed == cases[i].goes && (targets > 0) == cases[i].goes &&
              (w.power_offs[0] > 0) != cases[i].goes);
        CHECK(((m->drive[0].state.fault_reasons & DRIVE_FAULT_POSITION_UNKNOWN) != 0) !=
              cases[i].goes);
    }
}

static void a_drive_with_a_position_out_of_range_old_or_unknown_is_not_armed(void)
{
    for (uint32_t why = 0; why < 4; why++) {
        begin_at_limited_speed();
        w.place = why == 0 ? 99 : why == 1 ? 4001 : HERE;
        request(0, DRIVE_READY);
        go_to(NAN, 0, 50 * MS);
        if (why == 2) {
            m->joint[0].place.measured_ns -= 300 * MS;
        } else if (why == 3) {
            m->joint[0].place.measured = NAN;
        }
        request(0, DRIVE_ARMED);
        want(NAN, 0);
        w.count = 0;
        line_machine_step(m, w.now_ns, w.bytes, 0, &w.out);
        CHECK(m->drive[0].state.mode == DRIVE_READY);
        CHECK((m->drive[0].state.fault_reasons & DRIVE_FAULT_POSITION_UNKNOWN) != 0);
        CHECK(targets == 0);
    }
}

/* An armed drive whose position is lost before its first target loses its power. Its targets and
 * its position are signed. */
static void a_position_lost_before_the_first_target_takes_the_power(void)
{
    begin_at_limited_speed();
    setpoint->raw_min = -4000.0;
    setpoint->raw_offset = -1000.0;
    w.table.drive[0].cyclic[1].field[1].form = FORM_U16;
    CHECK(line_machine_init(m, &w.table, 0, w.now_ns) == 0);
    w.place = -1000;
    arm_it();
    CHECK(m->joint[0].place.measured == -1000.0 && m->joint[0].feedback.count == 64536);
    w.place = -4001;
    go_to(NAN, 0, 50 * MS);
    CHECK(m->drive[0].state.mode == DRIVE_READY && w.power_offs[0] > 0 && targets == 0);
}

/* After a new arming the first target is the drive's position, not its last target. */
static void each_arming_begins_at_the_position_of_that_moment(void)
{
    begin_at_limited_speed();
    arm_it();
    go_to(0.5, 1, 100 * MS);
    CHECK(newest_target == 1500);
    request(0, DRIVE_STAND_DOWN);
    go_to(NAN, 0, 100 * MS);
    w.place = 3000; /* moved by hand */
    go_to(NAN, 0, 100 * MS);
    request(0, DRIVE_ARMED);
    uint32_t before = targets;
    while (targets == before && m->drive[0].state.mode != DRIVE_OFF) {
        want(-1.1, 1);
        look();
    }
    CHECK(newest_target == 3000);
}

int main(void)
{
    a_position_is_scaled_from_its_zero_and_held_within_its_range();
    a_drive_that_is_not_armed_gets_no_position();
    an_unknown_position_is_not_sent_and_the_drive_is_still_read();
    a_new_position_does_not_wait_for_its_cycle();
    clearing_enabled_takes_the_power_without_sending_a_position();
    old_set_points_stop_it_without_sending_a_position();
    a_drive_that_does_not_answer_gets_its_stop_and_no_position();
    whether_its_counter_has_a_reference_is_reported();
    the_first_target_is_its_own_position_and_later_ones_move_from_there();
    a_first_target_far_from_its_position_takes_the_power();
    a_drive_with_a_position_out_of_range_old_or_unknown_is_not_armed();
    a_position_lost_before_the_first_target_takes_the_power();
    each_arming_begins_at_the_position_of_that_moment();
    a_target_that_has_moved_on_since_it_was_sent_does_not_wait_for_its_cycle();
    return checks_report("line position");
}
