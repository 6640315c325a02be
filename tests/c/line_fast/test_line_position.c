/* SPDX-License-Identifier: Apache-2.0
 * Positions on a serial line: 0 is a place like any other, so what must not move is sent nothing. */
#include <math.h>
#include <stdlib.h>

#include "line_wire.h"

static const double FAR = 1e300;
enum { HERE = 1500 };
static line_machine *const m = &w.machine;
static line_setpoint *const setpoint = &w.table.drive[0].cyclic[0].setpoint[0];
static uint32_t targets, reads;
static int16_t newest_target;

/* One drive that goes to positions: 1000 counts for a rad, 2000 where the angle is 0. */
static void begin(void)
{
    begin_with(1, 0);
    *setpoint = (line_setpoint){.kind = SETPOINT_POSITION,
                                .byte = 4,
                                .form = FORM_I16,
                                .raw_per_si = -1000.0,
                                .raw_offset = 2000.0,
                                .raw_min = 100.0,
                                .raw_max = 4000.0,
                                .raw_per_s = 1e6};
    line_exchange *reads_it = &w.table.drive[0].cyclic[1];
    reads_it->field[1] = reads_it->field[0];
    reads_it->field[1].kind = FIELD_COUNT;
    reads_it->field[0].si_per_raw = 1e-6; /* it rests */
    reads_it->field_count = 2;
    w.place = HERE;
    CHECK(line_machine_init(m, &w.table, 0, w.now_ns) == 0);
    targets = reads = 0;
}

static void want(double position_rad, uint32_t positioned)
{
    m->newest = (setpoints){.stamp_ns = w.now_ns, .enabled = 1, .joint_count = 1};
    m->newest.joint[0] = (joint_setpoint){.velocity_rad_s = 1.0};
    m->newest.position_rad[0] = position_rad;
    m->newest.positioned = positioned != 0;
}

static void look(void)
{
    line_machine_step(m, w.now_ns, w.bytes, w.count, &w.out);
    w.count = 0;
    if (w.out.send == NULL) {
        w.now_ns = w.out.wake_ns;
        return;
    }
    line_machine_sent(m, w.now_ns);
    reads += w.out.send[1] == READ;
    if (w.out.send[1] == WRITE && w.out.send[3] == SPEED) {
        targets++;
        newest_target = (int16_t)rtu_read(w.out.send + 4, FORM_I16);
    }
    answer_on_the_wire(w.out.send);
    w.now_ns = w.count == 0 ? m->until_ns : w.now_ns;
}

static void go_to(double position_rad, uint32_t positioned, int64_t for_ns)
{
    for (int64_t end_ns = w.now_ns + for_ns; w.now_ns < end_ns;) {
        want(position_rad, positioned);
        look();
    }
}

static void arm_it(void)
{
    request(0, DRIVE_READY);
    go_to(NAN, 0, 50 * MS);
    request(0, DRIVE_ARMED);
    want(NAN, 0);
    look();
    CHECK(m->drive[0].state.mode == DRIVE_ARMED);
}

static void a_position_is_scaled_from_its_zero_and_held_within_its_range(void)
{
    static const struct {
        double position_rad;
        int16_t raw;
    } cases[] = {{0.0, 2000}, {0.5, 1500},  {-0.5, 2500}, {0.0004, 2000}, {0.0006, 1999}, {1.9, 100},
                 {1.91, 100}, {-2.0, 4000}, {-2.1, 4000}, {40.0, 100},    {FAR, 100},     {-FAR, 4000}};
    begin();
    arm_it();
    for (uint32_t i = 0; i < sizeof cases / sizeof cases[0]; i++) {
        go_to(cases[i].position_rad, 1, 50 * MS);
        CHECK(newest_target == cases[i].raw && m->drive[0].state.sent_motion);
    }
}

static void what_is_not_armed_is_sent_no_position(void)
{
    begin();
    go_to(0.5, 1, 100 * MS);
    request(0, DRIVE_READY);
    go_to(0.5, 1, 200 * MS);
    CHECK(targets == 0 && reads > 8 && !m->drive[0].state.sent_motion && !line_wants_motion(m, 0));
}

static void a_position_that_is_not_known_is_not_sent_and_the_drive_goes_on_being_read(void)
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

static void the_core_takes_enabled_back_and_the_power_goes_off_without_a_position(void)
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

static void old_set_points_stop_it_without_a_position(void)
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

/* Its probes are its stop and a question: the first set-point exchange "with zeros" would be a place to go to. */
static void one_that_does_not_answer_is_sent_its_stop_and_no_position(void)
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
        w.table.drive[0].cyclic[1].field[2] = (line_field){
            .kind = FIELD_REFERENCED, .byte = 3, .form = FORM_U16, .equals_mask = 8 << mask, .equals = 8, .si_per_raw = 1.0};
        CHECK(line_machine_init(m, &w.table, 0, w.now_ns) == 0);
        CHECK(m->joint[0].feedback.referenced == 2);
        request(0, DRIVE_READY);
        w.place = 9;
        go_to(NAN, 0, 100 * MS);
        CHECK(m->joint[0].feedback.referenced == (mask == 0));
    }
}

/* ------------------------------------------------------------------------------------------ where it begins */
/* It is at 1500: a target of 0.5 rad. 2 rad/s are 2000 counts/s, 200 in the time that a place counts. */
static void begin_at_limited_speed(void)
{
    begin();
    setpoint->raw_per_s = 2000.0;
    CHECK(line_machine_init(m, &w.table, 0, w.now_ns) == 0);
}

static void the_first_target_is_the_place_where_it_is_and_later_ones_move_from_there(void)
{
    begin_at_limited_speed();
    arm_it();
    w.place = 1490; /* it yields a little */
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
            CHECK(abs(newest_target - last_target) <= (int)((double)(w.now_ns - last_ns) * 2e-6) + 1);
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

static void a_first_target_far_from_its_place_takes_the_power(void)
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
        CHECK(armed == cases[i].goes && (targets > 0) == cases[i].goes && (w.power_offs[0] > 0) != cases[i].goes);
        CHECK(((m->drive[0].state.fault_reasons & DRIVE_FAULT_POSITION_UNKNOWN) != 0) != cases[i].goes);
    }
}

static void what_is_beyond_its_range_old_or_unknown_is_not_armed(void)
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

/* Armed, and before its first target its place is lost: no power. Its targets are signed, and so is its place. */
static void a_place_that_is_lost_before_the_first_target_takes_the_power(void)
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

/* Armed anew it begins where it is now, wherever it was sent before. */
static void each_arming_begins_where_it_is_then(void)
{
    begin_at_limited_speed();
    arm_it();
    go_to(0.5, 1, 100 * MS);
    CHECK(newest_target == 1500);
    request(0, DRIVE_STAND_DOWN);
    go_to(NAN, 0, 100 * MS);
    w.place = 3000; /* by hand */
    go_to(NAN, 0, 100 * MS);
    request(0, DRIVE_ARMED);
    uint32_t before = targets;
    while (targets == before && m->drive[0].state.mode != DRIVE_OFF) {
        want(-1.1, 1);
        look();
    }
    CHECK(newest_target == 3000);
}

static bool refused(const char *name)
{
    char bad[FIELD_NAME_BYTES];
    const char *found = line_table_check(&w.table, bad);
    return found != NULL && strcmp(found, name) == 0;
}

static void tables_by_which_a_position_could_go_astray_are_refused(void)
{
    begin();
    setpoint->raw_offset = NAN;
    CHECK(refused("drive[0].setpoint.raw_offset"));
    begin();
    setpoint->raw_min = 4001.0;
    CHECK(refused("drive[0].setpoint.raw_min"));
    begin();
    setpoint->raw_max = 32768.0;
    CHECK(refused("drive[0].setpoint.raw_max"));
    begin();
    setpoint->raw_min = -32769.0;
    CHECK(refused("drive[0].setpoint.raw_min"));
    begin();
    setpoint->magnitude = 1;
    CHECK(refused("drive[0].setpoint.magnitude"));
    begin();
    setpoint->kind = SETPOINT_TORQUE;
    CHECK(refused("drive[0].setpoint.kind"));
    begin();
    setpoint->kind = SETPOINT_POSITION + 1;
    CHECK(refused("drive[0].setpoint.kind"));
    static const double NO_SPEEDS[] = {0.0, -1.0, (double)INFINITY, (double)NAN};
    for (uint32_t i = 0; i < 4; i++) {
        begin();
        setpoint->raw_per_s = NO_SPEEDS[i];
        CHECK(refused("drive[0].setpoint.raw_per_s"));
    }
    begin();
    setpoint->kind = SETPOINT_VELOCITY; /* rest would be at 2000 */
    CHECK(refused("drive[0].setpoint.raw_offset"));
    begin();
    w.table.drive[0].probe = 1;
    CHECK(refused("drive[0].probe"));
    begin();
    w.table.drive[0].probe = 0;
    CHECK(refused("drive[0].probe"));
    begin();
    w.table.drive[0].cyclic[0].field_count = 1;
    w.table.drive[0].cyclic[0].field[0] = w.table.drive[0].cyclic[1].field[0];
    CHECK(refused("drive[0].field_count"));
    begin();
    w.table.drive[0].idle_count = 1;
    w.table.drive[0].idle[0] = w.table.drive[0].cyclic[0].frame;
    CHECK(refused("drive[0].idle_count"));
    begin();
    w.table.drive[0].direction_count = 1;
    w.table.drive[0].direction[0].rest = w.table.drive[0].direction[0].forward = w.table.drive[0].direction[0].reverse =
        w.table.drive[0].cyclic[0].frame;
    CHECK(refused("drive[0].direction_count"));
    begin();
    CHECK(line_table_check(&w.table, (char[FIELD_NAME_BYTES]){0}) == NULL);
}

static void a_request_is_sent_only_when_each_of_its_places_is_known(void)
{
    begin();
    line_exchange *turn = &m->table.drive[0].cyclic[0];
    arm_it();
    want(0.5, 1);
    CHECK(line_sends(m, 0, 0));
    turn->setpoint[1] = turn->setpoint[0];
    turn->setpoint[1].joint = 1; /* the core has no place for it */
    CHECK(line_sends(m, 0, 0));
    turn->setpoint_count = 2;
    CHECK(!line_sends(m, 0, 0));
}

static void add_target(uint32_t turn, uint32_t n, uint32_t joint)
{
    line_setpoint *added = &m->table.drive[0].cyclic[turn].setpoint[n];
    *added = *setpoint;
    added->joint = joint;
}

/* Only joint 0 is where its first target may begin. */
static void begin_with_one_place(void)
{
    begin();
    m->now_ns = w.now_ns;
    for (uint32_t j = 0; j < 4; j++) {
        m->joint[j].place = (position_place){.measured = j == 0 ? HERE : (double)NAN, .sent = NAN, .measured_ns = w.now_ns};
    }
}

static void a_place_that_is_missing_is_looked_for_in_every_target_of_every_exchange(void)
{
    begin_with_one_place();
    line_drive *drive = &m->table.drive[0];
    add_target(0, 1, 1), add_target(2, 0, 1); /* which the table does not have */
    drive->cyclic[2].setpoint_count = 1;
    CHECK(drive->cyclic_count == 2 && !line_place_is_missing(m, 0));
    drive->cyclic[0].setpoint_count = 2;
    CHECK(line_place_is_missing(m, 0));
    add_target(0, 0, 1), add_target(0, 1, 0);
    CHECK(line_place_is_missing(m, 0));
    begin_with_one_place();
    add_target(1, 0, 1);
    drive->cyclic[1].setpoint_count = 1;
    CHECK(line_place_is_missing(m, 0));
}

static void all_targets_begin_anew_and_no_others(void)
{
    begin_with_one_place();
    line_drive *drive = &m->table.drive[0];
    add_target(0, 1, 1), add_target(1, 0, 2), add_target(1, 1, 3), add_target(2, 0, 3);
    drive->cyclic[0].setpoint_count = 2;
    drive->cyclic[1].setpoint_count = drive->cyclic[2].setpoint_count = 1;
    for (uint32_t j = 0; j < 4; j++) {
        m->joint[j].place.sent = HERE;
    }
    line_begin_positions(m, 0);
    for (uint32_t j = 0; j < 4; j++) {
        CHECK(!isnan(m->joint[j].place.sent) == (j == 3));
    }
}

static bool is_good(void)
{
    char name[FIELD_NAME_BYTES];
    return line_table_check(&w.table, name) == NULL;
}

static void a_position_is_looked_for_in_every_place_of_every_exchange(void)
{
    begin();
    line_drive *drive = &w.table.drive[0];
    const line_exchange writes = drive->cyclic[0], reads_back = drive->cyclic[1];
    drive->cyclic[0] = reads_back, drive->cyclic[1] = writes;
    drive->probe = 1, drive->extra_count = 0;
    CHECK(drive->cyclic_count == 2 && is_good());
    drive->cyclic[2] = writes; /* which the table does not have */
    drive->cyclic[2].field_count = 1;
    CHECK(is_good());
    drive->cyclic[1].field_count = 1, drive->cyclic[1].field[0] = reads_back.field[0];
    CHECK(refused("drive[0].field_count"));
    drive->cyclic[1].setpoint[1] = drive->cyclic[1].setpoint[0];
    drive->cyclic[1].setpoint[0].kind = SETPOINT_VELOCITY, drive->cyclic[1].setpoint[0].raw_offset = 0.0;
    drive->cyclic[1].setpoint[0].raw_min = -100.0, drive->cyclic[1].setpoint[0].raw_per_s = 0.0;
    CHECK(is_good());
    drive->cyclic[1].setpoint_count = 2;
    CHECK(refused("drive[0].field_count"));
    begin();
    drive->probe = 0, drive->extra_count = 1;
    drive->extra[0] = reads_back;
    CHECK(is_good());
}

int main(void)
{
    a_position_is_looked_for_in_every_place_of_every_exchange();
    a_request_is_sent_only_when_each_of_its_places_is_known();
    a_place_that_is_missing_is_looked_for_in_every_target_of_every_exchange();
    all_targets_begin_anew_and_no_others();
    a_position_is_scaled_from_its_zero_and_held_within_its_range();
    what_is_not_armed_is_sent_no_position();
    a_position_that_is_not_known_is_not_sent_and_the_drive_goes_on_being_read();
    a_new_position_does_not_wait_for_its_cycle();
    the_core_takes_enabled_back_and_the_power_goes_off_without_a_position();
    old_set_points_stop_it_without_a_position();
    one_that_does_not_answer_is_sent_its_stop_and_no_position();
    whether_its_counter_has_a_reference_is_reported();
    the_first_target_is_the_place_where_it_is_and_later_ones_move_from_there();
    a_first_target_far_from_its_place_takes_the_power();
    what_is_beyond_its_range_old_or_unknown_is_not_armed();
    a_place_that_is_lost_before_the_first_target_takes_the_power();
    each_arming_begins_where_it_is_then();
    a_target_that_has_moved_on_since_it_was_sent_does_not_wait_for_its_cycle();
    tables_by_which_a_position_could_go_astray_are_refused();
    return checks_report("line position");
}
