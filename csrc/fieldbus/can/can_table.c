/* SPDX-License-Identifier: Apache-2.0
 * can_table.c: checks a CAN line's table. With a good table, no memory outside it is ever read or
 * written. */
#include <float.h>
#include <math.h>

#include "can_machine.h"
#include "finding.h"

static const int64_t PERIOD_MAX_NS = INT64_C(100000000000);
static const uint32_t CLASSIC_BYTES_MAX = 8;

static void check_packet(finding *f, const can_packet *packet)
{
    uint32_t number = packet->id & ~(CAN_ID_EXTENDED | CAN_ID_REMOTE);
    bool extended = (packet->id & CAN_ID_EXTENDED) != 0, remote = (packet->id & CAN_ID_REMOTE) != 0;
    need(f, number < (extended ? 1U << 29 : 1U << 11), "packet.id");
    need(f, packet->fd <= 1 && !(remote && packet->fd != 0), "packet.fd");
    need(f, packet->bytes <= (packet->fd != 0 ? (uint32_t)CAN_BYTES_MAX : CLASSIC_BYTES_MAX),
         "packet.bytes");
}

static void check_place(finding *f, const can_place *place, uint32_t bytes)
{
    need(f, place->form <= CAN_FLOAT, "place.form");
    need(f, place->length >= 1 && place->length <= 32, "place.length");
    need(f, place->form != CAN_FLOAT || place->length == 32, "place.length");
    need(f, place->start_bit < 8 * CAN_BYTES_MAX && place->start_bit + place->length <= 8 * bytes,
         "place.start_bit");
}

/* Check that all numbers fit the place: another one would go out as a wrong number, even with the
 * opposite sign. */
static void check_setpoint(finding *f, const can_setpoint *setpoint, uint32_t bytes)
{
    const can_place *place = &setpoint->place;
    check_place(f, place, bytes);
    if (!f->bad) {
        double span = ldexp(1.0, (int)place->length);
        double least = place->form == CAN_SIGNED ? -span / 2.0 : 0.0;
        double most = place->form == CAN_SIGNED ? span / 2.0 - 1.0 : span - 1.0;
        bool is_float = place->form == CAN_FLOAT;
        check_scale(f, &setpoint->scale, SETPOINT_POSITION, is_float ? -(double)FLT_MAX : least,
                    is_float ? (double)FLT_MAX : most);
    }
    if (!f->bad && setpoint->trigger.length > 0) {
        check_place(f, &setpoint->trigger, bytes);
        need(f, setpoint->trigger.length == 1 && setpoint->scale.kind == SETPOINT_POSITION,
             "trigger.length");
    }
}

static void check_output(finding *f, const can_output *output)
{
    check_packet(f, &output->packet);
    need(f, (output->packet.id & CAN_ID_REMOTE) == 0, "output.packet.id");
    need(f, output->setpoint_count >= 1 && output->setpoint_count <= CAN_SETPOINTS_MAX,
         "setpoint_count");
    for (uint32_t i = 0; !f->bad && i < output->setpoint_count; i++) {
        check_setpoint(f, &output->setpoint[i], output->packet.bytes);
    }
}

static void check_write(finding *f, const can_write *write, uint32_t output_count)
{
    check_packet(f, &write->packet);
    need(f, write->output <= output_count, "write.output");
}

bool can_write_is_good(const can_write *write, uint32_t output_count)
{
    char name[FIELD_NAME_BYTES];
    finding f = {.name = name, .path = "", .bad = false};
    check_write(&f, write, output_count);
    return !f.bad;
}

static void check_field(finding *f, const can_field *field, uint32_t bytes)
{
    check_place(f, &field->place, bytes);
    check_meaning(f, &field->meaning, FIELD_TAKEN);
    need(f, field->meaning.kind != FIELD_KEPT, "field.kind");
    need(f, isfinite(field->si_at_zero), "field.si_at_zero");
}

static void check_input(finding *f, const can_input *input, uint32_t bytes)
{
    need(f, input->silence_ns >= 0 && input->silence_ns <= PERIOD_MAX_NS, "silence_ns");
    need(f, input->spacing_ns >= 0 && input->spacing_ns <= PERIOD_MAX_NS, "spacing_ns");
    need(f, input->field_count <= CAN_FIELDS_MAX, "field_count");
    for (uint32_t i = 0; !f->bad && i < input->field_count; i++) {
        check_field(f, &input->field[i], bytes);
    }
}

/* Check that an input frame is at least as long as the values that are read in it. */
static void check_matches(finding *f, const can_drive *drive)
{
    for (uint32_t i = 0; !f->bad && i < drive->match_count; i++) {
        const can_match *match = &drive->match[i];
        need(f, match->bytes <= CAN_BYTES_MAX && match->begins_bytes <= match->bytes,
             "match.bytes");
        need(f, match->begins_bytes <= CAN_BEGINS_MAX, "match.begins_bytes");
        need(f, match->input <= drive->input_count, "match.input");
        if (!f->bad && match->input > 0) {
            check_input(f, &drive->input[match->input - 1], match->bytes);
        }
    }
}

static void check_counts(finding *f, const can_drive *drive)
{
    need(f, drive->tries >= 1, "tries");
    need(f, drive->slow_every >= 1, "slow_every");
    need(f, drive->output_count >= 1 && drive->output_count <= CAN_OUTPUTS_MAX, "output_count");
    need(f, drive->poll_count <= CAN_POLLS_MAX, "poll_count");
    need(f, drive->slow_count <= CAN_POLLS_MAX, "slow_count");
    need(f, drive->probe_count <= CAN_POLLS_MAX, "probe_count");
    need(f, drive->match_count <= CAN_MATCHES_MAX, "match_count");
    need(f, drive->input_count <= CAN_INPUTS_MAX, "input_count");
    need(f, drive->quick_stop_count <= CAN_STOP_MAX, "quick_stop_count");
    need(f, drive->disarm_count <= CAN_STOP_MAX, "disarm_count");
    need(f, drive->hello <= drive->input_count, "hello");
    need(f, drive->watchdog_ns >= 0, "watchdog_ns");
}

static void check_drive(finding *f, const can_drive *drive)
{
    check_counts(f, drive);
    for (uint32_t i = 0; !f->bad && i < drive->output_count; i++) {
        check_output(f, &drive->output[i]);
    }
    for (uint32_t i = 0; !f->bad && i < CAN_POLLS_MAX; i++) {
        check_packet(f, &drive->poll[i]);
        check_packet(f, &drive->slow[i]);
        check_packet(f, &drive->probe[i]);
    }
    for (uint32_t i = 0; !f->bad && i < drive->quick_stop_count; i++) {
        check_write(f, &drive->quick_stop[i], drive->output_count);
    }
    for (uint32_t i = 0; !f->bad && i < drive->disarm_count; i++) {
        check_write(f, &drive->disarm[i], drive->output_count);
    }
    if (!f->bad) {
        check_matches(f, drive);
    }
}

const char *can_table_check(const can_table *table, char *name)
{
    finding f = {.name = name, .path = "", .bad = false};
    need(&f, table->drive_count >= 1 && table->drive_count <= CAN_DRIVES_MAX, "drive_count");
    need(&f, table->period_ns > 0 && table->period_ns <= PERIOD_MAX_NS, "period_ns");
    need(&f, table->setpoint_timeout_ns > 0 && table->setpoint_timeout_ns <= PERIOD_MAX_NS,
         "setpoint_timeout_ns");
    need(&f, isfinite(table->rest_velocity_rad_s) && table->rest_velocity_rad_s > 0.0,
         "rest_velocity_rad_s");
    need(&f, table->sync_count <= CAN_SYNCS_MAX, "sync_count");
    for (uint32_t i = 0; !f.bad && i < table->sync_count; i++) {
        check_packet(&f, &table->sync[i]);
    }
    need(&f, table->sending_count <= CAN_SENDINGS_MAX, "sending_count");
    for (uint32_t i = 1; !f.bad && i < table->sending_count; i++) {
        need(&f, table->sending[i - 1] < table->sending[i], "sending");
    }
    for (uint32_t i = 0; !f.bad && i < table->drive_count; i++) {
        (void)snprintf(f.path, sizeof f.path, "drive[%u].", i);
        check_drive(&f, &table->drive[i]);
    }
    return f.bad ? name : NULL;
}
