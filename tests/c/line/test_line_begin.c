/* SPDX-License-Identifier: Apache-2.0
 * A serial line before its first step: no old state is left, each drive has its joints, and drives
 * that may turn are stopped. */
#include <errno.h>

#include "line_wire.h"

/* added to the time that a drive may take, because the computer may be late */
static const int64_t HOST_NS = 20 * 1000000;

static line_table table_of(uint32_t drives)
{
    line_table table = {.drive_count = drives,
                        .echo = 1,
                        .character_ns = 1000.0,
                        .gap_ns = GAP_NS,
                        .setpoint_timeout_ns = 100 * MS,
                        .rest_velocity_rad_s = 0.1};
    for (uint32_t i = 0; i < drives; i++) {
        table.drive[i] = drive_of(i);
    }
    return table;
}

static void init(const line_table *table, uint32_t may_turn)
{
    memset(&w.machine, 0xEE, sizeof w.machine);
    CHECK(line_machine_init(&w.machine, table, may_turn, 7000 * MS) == 0);
}

static void a_line_begins_without_any_old_state(void)
{
    line_table table = table_of(2);
    table.drive[0].period_ns = 30 * MS, table.drive[1].period_ns = 10 * MS;
    init(&table, 0);
    line_machine *m = &w.machine;
    CHECK(m->echo == 1 && m->worker == LINE_DRIVES_MAX && m->current == LINE_DRIVES_MAX);
    CHECK(m->slot_due_ns == 7000 * MS && m->slot_period_ns == 10 * MS);
    CHECK(m->ours_ns == 7000 * MS + GAP_NS && m->free_ns == 7000 * MS + GAP_NS);
    CHECK(m->exchanges == 0 && m->noise_bytes == 0 && m->end.stage == END_NOT &&
          m->broadcasts == 0);
    for (uint32_t i = 0; i < 2; i++) {
        const line_drive_state *drive = &m->drive[i];
        CHECK(drive->state.mode == DRIVE_OFF && drive->state.enabled == 2 &&
              drive->state.stop == STOP_NOTHING);
        CHECK(drive->due_ns == 7000 * MS && drive->deadline_ns == m->table.drive[i].turnaround_ns &&
              !drive->may_turn);
        CHECK(m->table.drive[i].turnaround_ns > table.drive[i].turnaround_ns);
        CHECK(m->table.drive[i].turnaround_ns <= table.drive[i].turnaround_ns + HOST_NS);
    }
    table.drive[1].period_ns = 50 * MS;
    init(&table, 0);
    CHECK(w.machine.slot_period_ns == 30 * MS);
}

static void a_wrong_table_begins_nothing(void)
{
    line_table table = table_of(1);
    table.gap_ns = -1;
    CHECK(line_machine_init(&w.machine, &table, 0, 7000 * MS) == -EINVAL);
}

static void each_drive_that_may_turn_is_stopped_and_no_other(void)
{
    for (uint32_t may_turn = 0; may_turn < 8; may_turn++) {
        line_table table = table_of(2);
        init(&table, may_turn);
        for (uint32_t i = 0; i < 3; i++) {
            bool last_sent = i < 2 && (may_turn >> i & 1) != 0;
            CHECK(w.machine.drive[i].may_turn == last_sent);
            CHECK(w.machine.drive[i].state.stop == (last_sent ? STOP_QUICK : STOP_NOTHING));
        }
    }
}

static line_field field(uint32_t joint, uint32_t kind)
{
    return (line_field){
        .joint = joint, .kind = kind, .byte = 3, .form = FORM_I16, .si_per_raw = 0.01};
}

/* Each exchange contributes the joints of its set-points and measured fields. A status bit of the
 * drive belongs to no joint. */
static void each_drive_has_the_joints_of_its_exchanges(void)
{
    line_table table = table_of(1);
    line_drive *drive = &table.drive[0];
    drive->cyclic[0].setpoint_count = 2;
    drive->cyclic[0].setpoint[0].joint = 1;
    drive->cyclic[0].setpoint[1] = drive->cyclic[0].setpoint[0];
    drive->cyclic[0].setpoint[1].joint = 2;
    drive->cyclic[1].field_count = 2;
    drive->cyclic[1].field[0] = field(3, FIELD_VELOCITY);
    drive->cyclic[1].field[1] = field(4, FIELD_COUNT);
    drive->extra_count = 2;
    drive->extra[0] = drive->cyclic[1];
    drive->extra[0].field[0] = field(4, FIELD_VELOCITY);
    drive->extra[0].field[1] = field(5, FIELD_COUNT);
    drive->extra[1] = drive->extra[0];
    drive->extra[1].field_count = 3;
    drive->extra[1].field[0] = field(6, FIELD_VOLTAGE);
    drive->extra[1].field[2] = field(3, FIELD_COUNT);
    drive->extra[1].field[1] = field(7, FIELD_ENABLED);
    drive->extra[1].field[1].equals_mask = 1;
    init(&table, 0);
    const line_joint_state *joint = w.machine.joint;
    CHECK(w.machine.drive[0].joints == 0x7E);
    for (uint32_t j = 0; j < JOINTS_MAX; j++) {
        CHECK(joint[j].measures == (j == 3 || j == 4) && joint[j].counts == (j >= 3 && j <= 5));
    }
}

/* Entries after the last one of each list do not belong to the drive. */
static void entries_after_the_end_of_a_list_are_ignored(void)
{
    line_table table = table_of(1);
    line_drive *drive = &table.drive[0];
    drive->cyclic[0].setpoint[1].joint = 2;
    drive->cyclic[1].field[1] = field(3, FIELD_VELOCITY);
    drive->cyclic[2] = drive->cyclic[1];
    drive->cyclic[2].field[0] = field(4, FIELD_VELOCITY);
    drive->extra[0] = drive->cyclic[1];
    drive->extra[0].field[0] = field(5, FIELD_VELOCITY);
    table.drive[1] = drive_of(6);
    init(&table, 0);
    CHECK(w.machine.drive[0].joints == 1 && w.machine.drive[1].joints == 0 &&
          w.machine.slot_period_ns == 20 * MS);
    CHECK(w.machine.drive[1].due_ns == 0);
}

/* The form of the targets decides whether a position is signed. Unsigned, the upper half of its
 * range is not negative. */
static void a_position_is_signed_where_its_targets_are(void)
{
    for (uint32_t has_sign = 0; has_sign < 2; has_sign++) {
        begin_with(1, 0);
        line_drive *drive = &w.table.drive[0];
        drive->cyclic[0].setpoint[0] = (line_setpoint){.kind = SETPOINT_POSITION,
                                                       .byte = 4,
                                                       .form = has_sign != 0 ? FORM_I16 : FORM_U16,
                                                       .raw_per_si = 1000.0,
                                                       .raw_max = 30000.0,
                                                       .raw_per_s = 1000.0};
        drive->cyclic[1].field[0] =
            (line_field){.kind = FIELD_COUNT, .byte = 3, .form = FORM_U16, .si_per_raw = 1.0};
        CHECK(line_machine_init(&w.machine, &w.table, 0, w.now_ns) == 0);
        w.place = -1536;
        request(0, DRIVE_READY);
        for (int64_t end_ns = w.now_ns + 50 * MS; w.now_ns < end_ns;) {
            go_on();
        }
        CHECK(w.machine.joint[0].place.measured == (has_sign != 0 ? -1536.0 : 64000.0));
    }
}

int main(void)
{
    a_position_is_signed_where_its_targets_are();
    a_line_begins_without_any_old_state();
    a_wrong_table_begins_nothing();
    each_drive_that_may_turn_is_stopped_and_no_other();
    each_drive_has_the_joints_of_its_exchanges();
    entries_after_the_end_of_a_list_are_ignored();
    return checks_report("line begin");
}
