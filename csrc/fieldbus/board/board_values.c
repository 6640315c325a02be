/* SPDX-License-Identifier: Apache-2.0
 * board_values.c: set-points into a payload, a payload into feedback. */
#include <math.h>
#include <string.h>

#include "board_machine.h"
#include "joint_values.h"

/* ------------------------------------------------------------------------------- places */
int64_t board_get(const uint8_t *data, const board_place *place)
{
    uint64_t raw = 0;
    for (uint32_t i = 0; i < place->bytes; i++) {
        raw |= (uint64_t)data[place->byte + i] << 8 * i;
    }
    bool negative = place->is_signed != 0 && raw >> (8 * place->bytes - 1) != 0;
    return (int64_t)raw - (negative ? INT64_C(1) << 8 * place->bytes : 0);
}

void board_put(uint8_t *data, const board_place *place, int64_t raw)
{
    for (uint32_t i = 0; i < place->bytes; i++) {
        data[place->byte + i] = (uint8_t)((uint64_t)raw >> 8 * i);
    }
}

int64_t board_raw_min(const board_place *place)
{
    return place->is_signed != 0 ? -(INT64_C(1) << (8 * place->bytes - 1)) : 0;
}

int64_t board_raw_max(const board_place *place)
{
    return (INT64_C(1) << (8 * place->bytes - (place->is_signed != 0))) - 1;
}

/* --------------------------------------------------------------------------- set-points */
/* Write the set-points. In this same step, board_guard has taken ARMED back before if they are
 * old. */
bool board_payload(const board_machine *m, uint8_t *payload)
{
    bool motion = false, may_move = drive_may_move(&m->state, true, m->newest.enabled == 1);
    memcpy(payload, m->held, BOARD_PAYLOAD_MAX);
    for (uint32_t i = 0; i < m->table.setpoint_count; i++) {
        const board_setpoint *setpoint = &m->table.setpoint[i];
        int64_t raw = (int64_t)nearbyint(scaled(&m->newest, may_move, &setpoint->scale));
        board_put(payload, &setpoint->place, raw);
        motion |= raw != 0;
    }
    return motion;
}

/* ----------------------------------------------------------------------------- feedback */
static void read_joint(board_machine *m, const board_field *field, int64_t raw)
{
    board_joint *joint = &m->joint[field->meaning.joint];
    joint_feedback *feedback = &joint->feedback;
    if (field->meaning.kind == FIELD_COUNT) {
        feedback->count = (uint64_t)raw & count_mask(field->meaning.counter_bits);
    } else if (!feedback_measured(feedback, field->meaning.kind,
                                  (double)raw * field->meaning.si_per_raw)) {
        m->notify |= joint->fault_word != (uint32_t)raw;
        joint->fault_word = (uint32_t)raw;
        feedback->drive_faults = fault_meant(&field->meaning, (uint32_t)raw);
    }
}

bool board_read(board_machine *m)
{
    bool kept = true;
    for (uint32_t i = 0; i < m->table.field_count; i++) {
        const board_field *field = &m->table.field[i];
        int64_t raw = board_get(m->feedback_payload, &field->place);
        bool equals = ((uint32_t)raw & field->meaning.equals_mask) == field->meaning.equals;
        if (field->meaning.kind == FIELD_ENABLED) {
            m->state.enabled = equals ? 1 : 0;
        } else if (field->meaning.kind == FIELD_KEPT) {
            kept &= equals;
        } else {
            read_joint(m, field, raw);
        }
    }
    return kept;
}

void board_publish(board_machine *m)
{
    m->published++;
    for (uint32_t j = 0; j < JOINTS_MAX; j++) {
        if ((m->joints >> j & 1) != 0) {
            joint_feedback *feedback = &m->joint[j].feedback;
            feedback->stamp_ns = m->stamp_ns;
            feedback->epoch = m->state.epoch;
            feedback->enabled = m->state.enabled;
            m->feedback_mask |= 1U << j;
        }
    }
}

void board_forget(board_machine *m)
{
    for (uint32_t j = 0; j < JOINTS_MAX; j++) {
        m->joint[j].feedback = feedback_unknown();
    }
    m->state.enabled = 2;
}

bool board_at_rest(const board_machine *m)
{
    for (uint32_t j = 0; j < JOINTS_MAX; j++) {
        if ((m->joints >> j & 1) != 0 &&
            !feedback_at_rest(&m->joint[j].feedback, m->table.rest_velocity_rad_s)) {
            return false;
        }
    }
    return true;
}
