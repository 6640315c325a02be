/* SPDX-License-Identifier: Apache-2.0
 * The known position that a target on a serial line needs: in every target of every exchange, and
 * in the table. */
#include "position_wire.h"

static void a_request_is_sent_only_when_each_of_its_positions_is_known(void)
{
    begin();
    line_exchange *turn = &m->table.drive[0].cyclic[0];
    arm_it();
    want(0.5, 1);
    CHECK(line_sends(m, 0, 0));
    turn->setpoint[1] = turn->setpoint[0];
    turn->setpoint[1].joint = 1; /* the core has no position for this joint */
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

/* Only the position of joint 0 is known. */
static void begin_with_one_known_position(void)
{
    begin();
    m->now_ns = w.now_ns;
    for (uint32_t j = 0; j < 4; j++) {
        m->joint[j].place = (position_place){
            .measured = j == 0 ? HERE : (double)NAN, .sent = NAN, .measured_ns = w.now_ns};
    }
}

static void a_missing_position_is_found_in_every_target_of_every_exchange(void)
{
    begin_with_one_known_position();
    line_drive *drive = &m->table.drive[0];
    add_target(0, 1, 1), add_target(2, 0, 1); /* beyond the count */
    drive->cyclic[2].setpoint_count = 1;
    CHECK(drive->cyclic_count == 2 && !line_place_is_missing(m, 0));
    drive->cyclic[0].setpoint_count = 2;
    CHECK(line_place_is_missing(m, 0));
    add_target(0, 0, 1), add_target(0, 1, 0);
    CHECK(line_place_is_missing(m, 0));
    begin_with_one_known_position();
    add_target(1, 0, 1);
    drive->cyclic[1].setpoint_count = 1;
    CHECK(line_place_is_missing(m, 0));
}

static void all_targets_are_reset_and_nothing_else(void)
{
    begin_with_one_known_position();
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

static bool refused(const char *name)
{
    char bad[FIELD_NAME_BYTES];
    const char *found = line_table_check(&w.table, bad);
    return found != NULL && strcmp(found, name) == 0;
}

static void tables_with_unsafe_positions_are_refused(void)
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
    setpoint->kind = SETPOINT_VELOCITY; /* 0 rad/s would be 2000 raw, not 0 */
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
    w.table.drive[0].direction[0].rest = w.table.drive[0].direction[0].forward =
        w.table.drive[0].direction[0].reverse = w.table.drive[0].cyclic[0].frame;
    CHECK(refused("drive[0].direction_count"));
    begin();
    CHECK(line_table_check(&w.table, (char[FIELD_NAME_BYTES]){0}) == NULL);
}

static bool is_good(void)
{
    char name[FIELD_NAME_BYTES];
    return line_table_check(&w.table, name) == NULL;
}

static void a_position_is_looked_for_in_every_field_of_every_exchange(void)
{
    begin();
    line_drive *drive = &w.table.drive[0];
    const line_exchange writes = drive->cyclic[0], reads_back = drive->cyclic[1];
    drive->cyclic[0] = reads_back, drive->cyclic[1] = writes;
    drive->probe = 1, drive->extra_count = 0;
    CHECK(drive->cyclic_count == 2 && is_good());
    drive->cyclic[2] = writes; /* beyond the count */
    drive->cyclic[2].field_count = 1;
    CHECK(is_good());
    drive->cyclic[1].field_count = 1, drive->cyclic[1].field[0] = reads_back.field[0];
    CHECK(refused("drive[0].field_count"));
    drive->cyclic[1].setpoint[1] = drive->cyclic[1].setpoint[0];
    drive->cyclic[1].setpoint[0].kind = SETPOINT_VELOCITY,
    drive->cyclic[1].setpoint[0].raw_offset = 0.0;
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
    a_request_is_sent_only_when_each_of_its_positions_is_known();
    a_missing_position_is_found_in_every_target_of_every_exchange();
    all_targets_are_reset_and_nothing_else();
    tables_with_unsafe_positions_are_refused();
    a_position_is_looked_for_in_every_field_of_every_exchange();
    return checks_report("line place");
}
