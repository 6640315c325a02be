/* SPDX-License-Identifier: Apache-2.0
 * can_values.c: set-points into frames, frames into feedback. */
#include <math.h>
#include <string.h>

#include "can_machine.h"
#include "joint_values.h"

static const double COUNT_MAX = 4611686018427387904.0; /* 2^62: the position of any counter is
                                                          smaller */

int64_t can_stamp_ns(int64_t age_ns, int64_t emptied_ns, int64_t now_ns)
{
    return age_ns <= 0 ? now_ns : age_ns < now_ns - emptied_ns ? now_ns - age_ns : emptied_ns;
}

/* --------------------------------------------------------------------------------- bits */
static uint32_t bit_shift(const can_place *place, uint32_t bit)
{
    return place->big_endian != 0 ? 7 - bit % 8 : bit % 8;
}

/* Return the place of bit n of the number, n = 0 the least significant, counted like start_bit. */
static uint32_t bit_at(const can_place *place, uint32_t n)
{
    return place->start_bit + (place->big_endian != 0 ? place->length - 1 - n : n);
}

int64_t can_get(const uint8_t *data, const can_place *place)
{
    uint64_t raw = 0;
    for (uint32_t n = 0; n < place->length; n++) {
        uint32_t bit = bit_at(place, n);
        raw |= (uint64_t)(data[bit / 8] >> bit_shift(place, bit) & 1) << n;
    }
    bool negative = place->form == CAN_SIGNED && (raw >> (place->length - 1) & 1) != 0;
    return (int64_t)(negative ? raw - (UINT64_C(1) << place->length) : raw);
}

void can_put(uint8_t *data, const can_place *place, int64_t raw)
{
    for (uint32_t n = 0; n < place->length; n++) {
        uint32_t bit = bit_at(place, n);
        uint8_t mask = (uint8_t)(1U << bit_shift(place, bit));
        data[bit / 8] =
            ((uint64_t)raw >> n & 1) != 0 ? data[bit / 8] | mask : data[bit / 8] & (uint8_t)~mask;
    }
}

static double number_of(const can_place *place, int64_t raw)
{
    if (place->form != CAN_FLOAT) {
        return (double)raw;
    }
    uint32_t pattern = (uint32_t)raw;
    float number;
    memcpy(&number, &pattern, sizeof number);
    return (double)number;
}

/* --------------------------------------------------------------------------- set-points */
/* In this same step, can_guard has taken ARMED back before if the set-points are old. */
static bool may_move(const can_machine *m, uint32_t drive)
{
    return drive_may_move(&m->drive[drive].state, true, m->newest.enabled == 1) && !m->motion_stays;
}

static position_range range_of(const can_machine *m, const can_setpoint *setpoint)
{
    const setpoint_scale *scale = &setpoint->scale;
    return (position_range){.least = scale->raw_min,
                            .most = scale->raw_max,
                            .per_s = scale->raw_per_s,
                            .window_ns =
                                place_window_ns(m->table.setpoint_timeout_ns, m->table.period_ns)};
}

/* Return the drive's own position, if it responds and has no power: then it does not move, and
 * still gets set-points. NaN: nothing is sent. */
static double position_kept(const can_machine *m, uint32_t drive, const can_setpoint *setpoint)
{
    const drive_state *state = &m->drive[drive].state;
    const position_place *place = &m->joint[setpoint->scale.joint].place;
    const position_range range = range_of(m, setpoint);
    bool rests = state->mode == DRIVE_READY && state->enabled != 1;
    return rests && place_is_known(place, &range, m->now_ns) ? place->measured : (double)NAN;
}

static bool takes_position(const can_setpoint *setpoint)
{
    return setpoint->scale.kind == SETPOINT_POSITION;
}

/* Return the requested target in the numbers of its frame; NaN: no target. */
static double target_wanted(const can_machine *m, const can_setpoint *setpoint)
{
    double wanted_rad = setpoint_of(&m->newest, setpoint->scale.joint, SETPOINT_POSITION);
    return wanted_rad * setpoint->scale.raw_per_si + setpoint->scale.raw_offset;
}

/* Return the target that goes out; NaN: no target. */
static double target_of(const can_machine *m, uint32_t drive, const can_setpoint *setpoint)
{
    const position_range range = range_of(m, setpoint);
    double wanted = may_move(m, drive) ? target_wanted(m, setpoint) : (double)NAN;
    return place_next(&m->joint[setpoint->scale.joint].place, &range, wanted, m->now_ns);
}

static double number_to_send(const can_machine *m, uint32_t drive, const can_setpoint *setpoint)
{
    if (!takes_position(setpoint)) {
        return scaled(&m->newest, may_move(m, drive), &setpoint->scale);
    }
    double target = target_of(m, drive, setpoint);
    return isnan(target) ? position_kept(m, drive, setpoint) : target;
}

bool can_sends(const can_machine *m, uint32_t drive, uint32_t output)
{
    const can_output *from = &m->table.drive[drive].output[output];
    bool sends = true;
    for (uint32_t i = 0; i < from->setpoint_count; i++) {
        sends &= !isnan(number_to_send(m, drive, &from->setpoint[i]));
    }
    return sends;
}

static int64_t raw_of(const can_machine *m, uint32_t drive, const can_setpoint *setpoint)
{
    double raw = number_to_send(m, drive, setpoint);
    if (setpoint->place.form != CAN_FLOAT) {
        return (int64_t)nearbyint(raw);
    }
    float number = (float)raw + 0.0F; /* -0 + 0 is +0: rest is all zeros */
    uint32_t pattern;
    memcpy(&pattern, &number, sizeof pattern);
    return pattern;
}

/* Whether a set-point moves the drive. Any position that is sent does, whatever its number. */
static bool moves(const can_machine *m, uint32_t drive, const can_setpoint *setpoint)
{
    return takes_position(setpoint) ? !isnan(target_of(m, drive, setpoint))
                                    : raw_of(m, drive, setpoint) != 0;
}

/* Set the trigger, by a handshake that uses only the drive's memory: what the CAN bus loses is sent
 * again with the next cycle. */
static void put_trigger(const can_machine *m, uint32_t drive, const can_setpoint *setpoint,
                        uint8_t *data)
{
    bool waits = m->joint[setpoint->scale.joint].taken == 0;
    /* with a length of 0 this writes nothing */
    can_put(data, &setpoint->trigger, waits && moves(m, drive, setpoint) ? 1 : 0);
}

bool can_build(const can_machine *m, uint32_t drive, uint32_t output, can_packet *out)
{
    const can_output *from = &m->table.drive[drive].output[output];
    bool motion = false;
    *out = from->packet;
    memcpy(out->data, m->drive[drive].held[output], sizeof out->data);
    for (uint32_t i = 0; i < from->setpoint_count; i++) {
        int64_t raw = raw_of(m, drive, &from->setpoint[i]);
        can_put(out->data, &from->setpoint[i].place, raw);
        put_trigger(m, drive, &from->setpoint[i], out->data);
        motion |= moves(m, drive, &from->setpoint[i]);
    }
    return motion;
}

void can_hold_positions(can_machine *m, uint32_t drive, uint32_t output)
{
    const can_output *from = &m->table.drive[drive].output[output];
    for (uint32_t i = 0; i < from->setpoint_count; i++) {
        const can_setpoint *setpoint = &from->setpoint[i];
        if (takes_position(setpoint) && !isnan(number_to_send(m, drive, setpoint))) {
            can_put(m->drive[drive].held[output], &setpoint->place, raw_of(m, drive, setpoint));
        }
    }
}

void can_note_positions(can_machine *m, uint32_t drive, uint32_t output)
{
    const can_output *from = &m->table.drive[drive].output[output];
    for (uint32_t i = 0; i < from->setpoint_count; i++) {
        double target = takes_position(&from->setpoint[i]) ? target_of(m, drive, &from->setpoint[i])
                                                           : (double)NAN;
        if (!isnan(target)) {
            position_place *place = &m->joint[from->setpoint[i].scale.joint].place;
            place->sent = target;
            place->sent_ns = m->now_ns;
        }
    }
}

bool can_place_is_missing(const can_machine *m, uint32_t drive)
{
    const can_drive *table = &m->table.drive[drive];
    bool missing = false;
    for (uint32_t o = 0; o < table->output_count; o++) {
        for (uint32_t i = 0; i < table->output[o].setpoint_count; i++) {
            const can_setpoint *setpoint = &table->output[o].setpoint[i];
            const position_range range = range_of(m, setpoint);
            double wanted = may_move(m, drive) ? target_wanted(m, setpoint) : (double)NAN;
            missing |=
                takes_position(setpoint) &&
                place_is_missing(&m->joint[setpoint->scale.joint].place, &range, wanted, m->now_ns);
        }
    }
    return missing;
}

void can_begin_positions(can_machine *m, uint32_t drive)
{
    const can_drive *table = &m->table.drive[drive];
    for (uint32_t o = 0; o < table->output_count; o++) {
        for (uint32_t i = 0; i < table->output[o].setpoint_count; i++) {
            if (takes_position(&table->output[o].setpoint[i])) {
                m->joint[table->output[o].setpoint[i].scale.joint].place.sent = NAN;
            }
        }
    }
}

bool can_wants_motion(const can_machine *m, uint32_t drive)
{
    const can_drive *table = &m->table.drive[drive];
    for (uint32_t o = 0; o < table->output_count; o++) {
        for (uint32_t i = 0; i < table->output[o].setpoint_count; i++) {
            if (moves(m, drive, &table->output[o].setpoint[i])) {
                return true;
            }
        }
    }
    return false;
}

/* ----------------------------------------------------------------------------- feedback */
static void read_count(can_joint_state *joint, const can_field *field, double number,
                       int64_t stamp_ns)
{
    double count = number * field->meaning.si_per_raw + field->si_at_zero;
    joint->no_number = !(fabs(count) < COUNT_MAX);
    joint->place.measured = joint->no_number ? (double)NAN : number;
    joint->place.measured_ns = stamp_ns;
    if (!joint->no_number) {
        joint->feedback.count =
            (uint64_t)(int64_t)nearbyint(count) & count_mask(field->meaning.counter_bits);
        joint->count_ns = stamp_ns;
    }
}

static void read_fault(can_machine *m, uint32_t number, const can_field *field, uint32_t word)
{
    can_joint_state *joint = &m->joint[field->meaning.joint];
    can_drive_state *drive = &m->drive[number];
    bool other = joint->fault_word != word;
    joint->fault_word = word;
    joint->feedback.drive_faults = fault_meant(&field->meaning, word);
    m->notify |= other;
    if (other && joint->feedback.drive_faults != 0) {
        drive->faults++;
        drive->last_fault = word;
        drive->last_fault_joint = field->meaning.joint;
    }
}

static uint32_t *condition_of(can_machine *m, uint32_t number, const field_meaning *meaning)
{
    can_joint_state *joint = &m->joint[meaning->joint];
    switch (meaning->kind) {
    case FIELD_ENABLED: return &m->drive[number].state.enabled;
    case FIELD_TAKEN: return &joint->taken;
    default: return &joint->feedback.referenced;
    }
}

static void read_field(can_machine *m, uint32_t number, const can_field *field, const uint8_t *data,
                       int64_t stamp_ns)
{
    can_joint_state *joint = &m->joint[field->meaning.joint];
    int64_t raw = can_get(data, &field->place);
    double si = number_of(&field->place, raw) * field->meaning.si_per_raw + field->si_at_zero;
    si = isfinite(si) ? si : (double)NAN;
    joint->newest_ns = field->meaning.kind < FIELD_ENABLED ? stamp_ns : joint->newest_ns;
    if (feedback_measured(&joint->feedback, field->meaning.kind, si)) {
        joint->velocity_ns = field->meaning.kind == FIELD_VELOCITY ? stamp_ns : joint->velocity_ns;
    } else if (field->meaning.kind == FIELD_COUNT) {
        read_count(joint, field, number_of(&field->place, raw), stamp_ns);
    } else if (field->meaning.kind == FIELD_FAULT) {
        read_fault(m, number, field, (uint32_t)raw);
    } else {
        uint32_t equal =
            ((uint32_t)raw & field->meaning.equals_mask) == field->meaning.equals ? 1 : 0;
        *condition_of(m, number, &field->meaning) = equal;
    }
}

void can_read(can_machine *m, uint32_t drive, const can_input *input, const uint8_t *data,
              int64_t stamp_ns)
{
    for (uint32_t i = 0; i < input->field_count; i++) {
        read_field(m, drive, &input->field[i], data, stamp_ns);
    }
}

static bool has_joint(const can_machine *m, uint32_t drive, uint32_t joint)
{
    return (m->drive[drive].joints >> joint & 1) != 0;
}

void can_publish(can_machine *m, uint32_t drive)
{
    const can_drive_state *state = &m->drive[drive];
    if ((state->fast & ~state->known) != 0) {
        return;
    }
    m->drive[drive].cycles++;
    for (uint32_t j = 0; j < JOINTS_MAX; j++) {
        can_joint_state *joint = &m->joint[j];
        if (!has_joint(m, drive, j) || joint->no_number) {
            continue; /* the sample gets old, and the core notices that */
        }
        joint->feedback.stamp_ns = joint->count_ns > 0      ? joint->count_ns
                                   : joint->velocity_ns > 0 ? joint->velocity_ns
                                                            : joint->newest_ns;
        joint->feedback.epoch = m->drive[drive].state.epoch;
        joint->feedback.enabled = m->drive[drive].state.enabled;
        m->feedback_mask |= 1U << j;
    }
}

void can_forget(can_machine *m, uint32_t drive)
{
    for (uint32_t j = 0; j < JOINTS_MAX; j++) {
        if (has_joint(m, drive, j)) {
            m->joint[j] = (can_joint_state){.fault_word = m->joint[j].fault_word,
                                            .feedback = feedback_unknown(),
                                            .place = {.measured = NAN, .sent = NAN}};
        }
    }
    memset(m->drive[drive].sample_ns, 0, sizeof m->drive[drive].sample_ns);
    m->drive[drive].known = 0;
    m->drive[drive].state.enabled = 2;
}

bool can_at_rest(const can_machine *m, uint32_t drive)
{
    for (uint32_t j = 0; j < JOINTS_MAX; j++) {
        if (has_joint(m, drive, j) &&
            !feedback_at_rest(&m->joint[j].feedback, m->table.rest_velocity_rad_s)) {
            return false;
        }
    }
    return true;
}
