/* SPDX-License-Identifier: Apache-2.0
 * line_begin.c: prepares a line before its first step: the joints of each drive, and the drives
 * that get a stop first. */
#include <errno.h>
#include <string.h>

#include "line_machine.h"

static void note_joint(line_machine *m, uint32_t number, uint32_t joint)
{
    m->drive[number].joints |= 1U << joint;
}

static void note_joints(line_machine *m, uint32_t number, const line_exchange *turn)
{
    for (uint32_t i = 0; i < turn->setpoint_count; i++) {
        note_joint(m, number, turn->setpoint[i].joint);
        m->joint[turn->setpoint[i].joint].place_form = turn->setpoint[i].form & 1;
    }
    for (uint32_t i = 0; i < turn->field_count; i++) {
        const line_field *field = &turn->field[i];
        if (field->kind < FIELD_ENABLED) {
            note_joint(m, number, field->joint);
            m->joint[field->joint].counts |= field->kind == FIELD_COUNT;
            m->joint[field->joint].measures |= field->kind == FIELD_VELOCITY;
        }
    }
}

static void init_drive(line_machine *m, uint32_t number, int64_t now_ns)
{
    line_drive *table = &m->table.drive[number];
    line_drive_state *drive = &m->drive[number];
    table->turnaround_ns += LINE_HOST_NS;
    drive->deadline_ns = table->turnaround_ns;
    drive->due_ns = now_ns;
    for (uint32_t i = 0; i < table->cyclic_count; i++) {
        note_joints(m, number, &table->cyclic[i]);
    }
    for (uint32_t i = 0; i < table->extra_count; i++) {
        note_joints(m, number, &table->extra[i]);
    }
    m->slot_period_ns = table->period_ns < m->slot_period_ns ? table->period_ns : m->slot_period_ns;
    line_forget(m, number);
}

int line_machine_init(line_machine *m, const line_table *table, uint32_t may_turn, int64_t now_ns)
{
    char name[FIELD_NAME_BYTES];
    if (line_table_check(table, name) != NULL) {
        return -EINVAL;
    }
    memset(m, 0, sizeof *m);
    m->table = *table;
    m->echo = table->echo;
    m->worker = m->current = LINE_DRIVES_MAX;
    m->slot_period_ns = INT64_MAX;
    m->slot_due_ns = now_ns;
    m->ours_ns = m->free_ns = now_ns + table->gap_ns;
    for (uint32_t i = 0; i < table->drive_count; i++) {
        init_drive(m, i, now_ns);
        if ((may_turn >> i & 1) != 0) {
            line_stop_before_setup(m, i, now_ns);
        }
    }
    return 0;
}

void line_take_over(line_machine *m, int64_t now_ns)
{
    for (uint32_t i = 0; i < m->table.drive_count; i++) {
        m->drive[i].may_turn = true;
        line_begin_stop(m, i, drive_quick_stop(&m->drive[i].state, 0, now_ns), now_ns);
    }
}
