/* SPDX-License-Identifier: Apache-2.0
 * line_values.c: set-points into requests, replies into feedback. */
#include <math.h>
#include <string.h>

#include "fault_word.h"
#include "joint_values.h"
#include "line_machine.h"

static const setpoints *source(const line_machine *m, uint32_t drive)
{
    /* if magnitude and direction go out one by one, both have to belong to the same set-point */
    return m->table.drive[drive].direction_count > 0 ? &m->drive[drive].frozen : &m->newest;
}

/* In this same step, line_guard has taken ARMED back before if the set-points are old. */
static bool may_move(const line_machine *m, uint32_t drive)
{
    return drive_may_move(&m->drive[drive].state, true, m->newest.enabled == 1);
}

static bool takes_position(const line_setpoint *setpoint)
{
    return setpoint->kind == SETPOINT_POSITION;
}

static position_range range_of(const line_machine *m, uint32_t drive, const line_setpoint *setpoint)
{
    int64_t period_ns = m->table.drive[drive].period_ns;
    return (position_range){.least = setpoint->raw_min,
                            .most = setpoint->raw_max,
                            .per_s = setpoint->raw_per_s,
                            .window_ns = place_window_ns(m->table.setpoint_timeout_ns, period_ns)};
}

/* Return the requested target in the numbers of its request; NaN: no target, or the joint may not
 * move. */
static double target_wanted(const line_machine *m, uint32_t drive, const line_setpoint *setpoint)
{
    double wanted_rad = may_move(m, drive)
                            ? setpoint_of(&m->newest, setpoint->joint, SETPOINT_POSITION)
                            : (double)NAN;
    return wanted_rad * setpoint->raw_per_si + setpoint->raw_offset;
}

/* Return the target that goes out; NaN: no target. */
static double target_of(const line_machine *m, uint32_t drive, const line_setpoint *setpoint)
{
    const position_range range = range_of(m, drive, setpoint);
    return place_next(&m->joint[setpoint->joint].place, &range, target_wanted(m, drive, setpoint),
                      m->now_ns);
}

bool line_sends(const line_machine *m, uint32_t drive, uint32_t turn)
{
    const line_exchange *from = &m->table.drive[drive].cyclic[turn];
    bool sends = true;
    for (uint32_t i = 0; i < from->setpoint_count; i++) {
        sends &=
            !takes_position(&from->setpoint[i]) || !isnan(target_of(m, drive, &from->setpoint[i]));
    }
    return sends;
}

bool line_place_is_missing(const line_machine *m, uint32_t drive)
{
    const line_drive *table = &m->table.drive[drive];
    bool missing = false;
    for (uint32_t e = 0; e < table->cyclic_count; e++) {
        for (uint32_t i = 0; i < table->cyclic[e].setpoint_count; i++) {
            const line_setpoint *setpoint = &table->cyclic[e].setpoint[i];
            const position_range range = range_of(m, drive, setpoint);
            missing |= takes_position(setpoint) &&
                       place_is_missing(&m->joint[setpoint->joint].place, &range,
                                        target_wanted(m, drive, setpoint), m->now_ns);
        }
    }
    return missing;
}

void line_begin_positions(line_machine *m, uint32_t drive)
{
    const line_drive *table = &m->table.drive[drive];
    for (uint32_t e = 0; e < table->cyclic_count; e++) {
        for (uint32_t i = 0; i < table->cyclic[e].setpoint_count; i++) {
            if (takes_position(&table->cyclic[e].setpoint[i])) {
                m->joint[table->cyclic[e].setpoint[i].joint].place.sent = NAN;
            }
        }
    }
}

double line_wanted(const line_machine *m, uint32_t drive, uint32_t joint, uint32_t kind)
{
    if (!may_move(m, drive)) {
        return 0.0;
    }
    double now = setpoint_of(&m->newest, joint, kind);
    double then = setpoint_of(source(m, drive), joint, kind);
    return now == 0.0 ? 0.0 : then;
}

static int64_t raw_of(const line_machine *m, uint32_t drive, const line_setpoint *setpoint)
{
    if (takes_position(setpoint)) {
        return (int64_t)nearbyint(target_of(m, drive, setpoint));
    }
    double raw = line_wanted(m, drive, setpoint->joint, setpoint->kind) * setpoint->raw_per_si;
    if (setpoint->magnitude != 0) {
        raw = fabs(raw);
    }
    return (int64_t)nearbyint(within_span(raw, setpoint->raw_min, setpoint->raw_max));
}

/* Whether the drive is idle: neither armed nor coming to rest, so it cannot turn unnoticed. */
static bool is_idle(const line_machine *m, uint32_t drive)
{
    const line_drive_state *state = &m->drive[drive];
    return state->state.mode == DRIVE_READY && !state->state.stopping &&
           state->state.stop == STOP_NOTHING;
}

/* Note the target that is sent: the next one begins there. */
static void note_position(line_machine *m, uint32_t drive, const line_setpoint *setpoint)
{
    if (takes_position(setpoint)) {
        position_place *place = &m->joint[setpoint->joint].place;
        place->sent = target_of(m, drive, setpoint);
        place->sent_ns = m->now_ns;
    }
}

bool line_fill(line_machine *m, uint32_t drive, uint32_t turn, line_frame *out)
{
    const line_exchange *from = &m->table.drive[drive].cyclic[turn];
    bool motion = false;
    *out = from->frame;
    for (uint32_t i = 0; i < from->setpoint_count; i++) {
        const line_setpoint *setpoint = &from->setpoint[i];
        int64_t raw = raw_of(m, drive, setpoint);
        note_position(m, drive, setpoint);
        rtu_write(out->request + setpoint->byte, setpoint->form, raw);
        m->drive[drive].last_sent[turn][i] = raw;
        motion |= raw != 0 || takes_position(setpoint);
    }
    return motion;
}

bool line_build(line_machine *m, uint32_t drive, uint32_t turn, line_frame *out)
{
    if (turn == 0 && m->table.drive[drive].idle_count > 0 && is_idle(m, drive)) {
        memset(m->drive[drive].last_sent[0], 0, sizeof m->drive[drive].last_sent[0]);
        *out = m->table.drive[drive].idle[0];
        return false;
    }
    bool motion = line_fill(m, drive, turn, out);
    rtu_finish(out);
    return motion;
}

bool line_differs(line_machine *m, uint32_t drive)
{
    const line_drive *table = &m->table.drive[drive];
    for (uint32_t e = 0; e < table->cyclic_count; e++) {
        for (uint32_t i = 0; i < table->cyclic[e].setpoint_count && line_sends(m, drive, e); i++) {
            if (raw_of(m, drive, &table->cyclic[e].setpoint[i]) !=
                m->drive[drive].last_sent[e][i]) {
                return true;
            }
        }
    }
    return false;
}

bool line_wants_motion(const line_machine *m, uint32_t drive)
{
    const line_drive *table = &m->table.drive[drive];
    for (uint32_t e = 0; e < table->cyclic_count; e++) {
        for (uint32_t i = 0; i < table->cyclic[e].setpoint_count; i++) {
            const line_setpoint *setpoint = &table->cyclic[e].setpoint[i];
            bool goes = takes_position(setpoint)
                            ? line_sends(m, drive, e)
                            : line_wanted(m, drive, setpoint->joint, setpoint->kind) != 0.0;
            if (goes) {
                return true;
            }
        }
    }
    return false;
}

uint32_t line_direction_wanted(const line_machine *m, uint32_t drive, uint32_t direction)
{
    const line_direction *which = &m->table.drive[drive].direction[direction];
    double wanted = line_wanted(m, drive, which->joint, which->kind);
    if (wanted == 0.0) {
        return DIRECTION_REST;
    }
    return (wanted > 0.0) != (which->inverted != 0) ? DIRECTION_FORWARD : DIRECTION_REVERSE;
}

static void read_fault(line_machine *m, const line_field *field, uint32_t word)
{
    line_joint_state *joint = &m->joint[field->joint];
    m->notify |= joint->fault_word != word;
    joint->fault_word = word;
    joint->feedback.drive_faults = fault_that_stops(word, field->is_code != 0, field->harmless_bits,
                                                    field->harmless, field->harmless_codes);
}

static double signed_velocity(const line_drive_state *drive, const line_field *field,
                              double velocity)
{
    bool reverse =
        field->direction > 0 && drive->direction_last[field->direction - 1] == DIRECTION_REVERSE;
    return reverse ? -velocity : velocity;
}

static void read_field(line_machine *m, uint32_t number, const line_field *field,
                       const uint8_t *reply, int64_t stamp_ns)
{
    line_drive_state *drive = &m->drive[number];
    line_joint_state *joint = &m->joint[field->joint];
    int64_t whole = rtu_read(reply + field->byte, field->form);
    int64_t raw = rtu_masked(whole, field->mask, field->form);
    double si = (double)raw * field->si_per_raw;
    bool equal = ((uint32_t)whole & field->equals_mask) == field->equals;
    if (field->kind < FIELD_ENABLED || field->kind == FIELD_REFERENCED) {
        joint->newest_ns = stamp_ns;
    }
    switch (field->kind) {
    case FIELD_COUNT:
        joint->feedback.count = (uint64_t)raw;
        joint->place.measured =
            (double)rtu_read(reply + field->byte, field->form | joint->place_form);
        joint->place.measured_ns = joint->count_ns = stamp_ns;
        break;
    case FIELD_FAULT: read_fault(m, field, (uint32_t)raw); break;
    case FIELD_ENABLED: drive->state.enabled = equal ? 1 : 0; break;
    case FIELD_REFERENCED: joint->feedback.referenced = equal ? 1 : 0; break;
    case FIELD_KEPT: drive->lost_setup |= !equal; break;
    case FIELD_VELOCITY:
        joint->feedback.velocity_rad_s = signed_velocity(drive, field, si);
        joint->velocity_ns = stamp_ns;
        break;
    default: (void)feedback_measured(&joint->feedback, field->kind, si); break;
    }
}

void line_read(line_machine *m, uint32_t drive, const line_exchange *turn, const uint8_t *reply,
               int64_t stamp_ns)
{
    for (uint32_t i = 0; i < turn->field_count; i++) {
        read_field(m, drive, &turn->field[i], reply, stamp_ns);
    }
}

static bool has_joint(const line_machine *m, uint32_t drive, uint32_t joint)
{
    return (m->drive[drive].joints >> joint & 1) != 0;
}

void line_forget(line_machine *m, uint32_t drive)
{
    for (uint32_t j = 0; j < JOINTS_MAX; j++) {
        if (has_joint(m, drive, j)) {
            line_joint_state *joint = &m->joint[j];
            joint->feedback = feedback_unknown();
            joint->place = (position_place){.measured = NAN, .sent = NAN};
            joint->feedback.epoch = m->drive[drive].state.epoch;
            joint->count_ns = joint->velocity_ns = joint->newest_ns = 0;
        }
    }
    m->drive[drive].state.enabled = 2;
    m->drive[drive].lost_setup = false;
}

void line_publish(line_machine *m, uint32_t drive)
{
    for (uint32_t j = 0; j < JOINTS_MAX; j++) {
        if (!has_joint(m, drive, j)) {
            continue;
        }
        line_joint_state *joint = &m->joint[j];
        joint->feedback.stamp_ns = joint->counts     ? joint->count_ns
                                   : joint->measures ? joint->velocity_ns
                                                     : joint->newest_ns;
        bool only_acknowledges = !joint->counts && !joint->measures && joint->newest_ns == 0;
        /* a value that was never read has no stamp, whatever else was answered */
        if (only_acknowledges) {
            joint->feedback.stamp_ns = m->drive[drive].answered_ns;
        }
        joint->feedback.epoch = m->drive[drive].state.epoch;
        joint->feedback.enabled = m->drive[drive].state.enabled;
        m->feedback_mask |= 1U << j;
    }
}

bool line_at_rest(const line_machine *m, uint32_t drive)
{
    for (uint32_t j = 0; j < JOINTS_MAX; j++) {
        if (has_joint(m, drive, j) &&
            !feedback_at_rest(&m->joint[j].feedback, m->table.rest_velocity_rad_s)) {
            return false;
        }
    }
    return true;
}
