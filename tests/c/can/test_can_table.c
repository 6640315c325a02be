/* SPDX-License-Identifier: Apache-2.0
 * Which tables of a CAN bus are refused, and which field is named: each number at the end of its
 * range and beyond. */
#include <float.h>

#include "can_wire.h"

static const int64_t LONGEST_NS = INT64_C(100000000000);

static char bad_name[FIELD_NAME_BYTES];

static bool is_good(void)
{
    memset(bad_name, 0, sizeof bad_name);
    return can_table_check(&w.table, bad_name) == NULL;
}

static bool refused(const char *name)
{
    return can_table_check(&w.table, bad_name) == bad_name && strcmp(bad_name, name) == 0;
}

/* Check the table of two drives with one changed number. */
#define GOOD(field, value)                                                                         \
    do {                                                                                           \
        begin_with(2);                                                                             \
        (field) = (value);                                                                         \
        CHECK(is_good());                                                                          \
    } while (0)
#define BAD(field, value, name)                                                                    \
    do {                                                                                           \
        begin_with(2);                                                                             \
        (field) = (value);                                                                         \
        CHECK(refused(name));                                                                      \
    } while (0)

static void the_identifiers_that_motord_sends_ascend(void)
{
    begin_with(1);
    w.table.sending_count = CAN_SENDINGS_MAX;
    for (uint32_t i = 0; i < CAN_SENDINGS_MAX; i++) {
        w.table.sending[i] = 3 * i;
    }
    CHECK(is_good());
    w.table.sending[1] = 1;
    CHECK(is_good());
    w.table.sending[1] = 0;
    CHECK(refused("sending"));
    w.table.sending[1] = 6;
    CHECK(refused("sending"));
}

#define DRIVE w.table.drive[1]

static void the_bus_s_own_numbers(void)
{
    begin_with(2);
    CHECK(is_good());
    BAD(w.table.drive_count, 0, "drive_count");
    BAD(w.table.drive_count, CAN_DRIVES_MAX + 1, "drive_count");
    BAD(w.table.period_ns, 0, "period_ns");
    GOOD(w.table.period_ns, 1);
    GOOD(w.table.period_ns, LONGEST_NS);
    BAD(w.table.period_ns, LONGEST_NS + 1, "period_ns");
    BAD(w.table.setpoint_timeout_ns, 0, "setpoint_timeout_ns");
    GOOD(w.table.setpoint_timeout_ns, 1);
    GOOD(w.table.setpoint_timeout_ns, LONGEST_NS);
    BAD(w.table.setpoint_timeout_ns, LONGEST_NS + 1, "setpoint_timeout_ns");
    GOOD(w.table.rest_velocity_rad_s, 1e-9);
    BAD(w.table.rest_velocity_rad_s, 0.0, "rest_velocity_rad_s");
    BAD(w.table.rest_velocity_rad_s, (double)INFINITY, "rest_velocity_rad_s");
    GOOD(w.table.sync_count, CAN_SYNCS_MAX);
    BAD(w.table.sync_count, CAN_SYNCS_MAX + 1, "sync_count");
    BAD(w.table.sending_count, CAN_SENDINGS_MAX + 1, "sending_count");
    BAD(w.table.sending_count, 2, "sending");
    for (uint32_t i = 0; i < CAN_SYNCS_MAX; i++) {
        begin_with(2);
        w.table.sync_count = CAN_SYNCS_MAX;
        w.table.sync[i].id = 0x800;
        CHECK(refused("packet.id"));
        w.table.sync_count = i; /* entries beyond the count are not checked */
        CHECK(is_good());
    }
}

static void a_full_table_is_checked_from_its_first_to_its_last_drive(void)
{
    begin_with(CAN_DRIVES_MAX);
    CHECK(is_good());
    DRIVE.tries = 0;
    CHECK(refused("drive[1].tries"));
    begin_with(CAN_DRIVES_MAX);
    w.table.drive[0].tries = 0;
    CHECK(refused("drive[0].tries"));
    begin_with(CAN_DRIVES_MAX);
    w.table.drive[CAN_DRIVES_MAX - 1].tries = 0;
    CHECK(refused("drive[7].tries"));
    begin_with(2);
    w.table.drive[2].tries = 0;
    CHECK(is_good());
}

static void the_numbers_of_a_drive(void)
{
    BAD(DRIVE.tries, 0, "drive[1].tries");
    GOOD(DRIVE.tries, 1);
    BAD(DRIVE.slow_every, 0, "drive[1].slow_every");
    GOOD(DRIVE.slow_every, 1);
    BAD(DRIVE.output_count, 0, "drive[1].output_count");
    BAD(DRIVE.output_count, CAN_OUTPUTS_MAX + 1, "drive[1].output_count");
    GOOD(DRIVE.poll_count, CAN_POLLS_MAX);
    BAD(DRIVE.poll_count, CAN_POLLS_MAX + 1, "drive[1].poll_count");
    GOOD(DRIVE.slow_count, CAN_POLLS_MAX);
    BAD(DRIVE.slow_count, CAN_POLLS_MAX + 1, "drive[1].slow_count");
    GOOD(DRIVE.probe_count, CAN_POLLS_MAX);
    BAD(DRIVE.probe_count, CAN_POLLS_MAX + 1, "drive[1].probe_count");
    GOOD(DRIVE.match_count, CAN_MATCHES_MAX);
    BAD(DRIVE.match_count, CAN_MATCHES_MAX + 1, "drive[1].match_count");
    GOOD(DRIVE.input_count, CAN_INPUTS_MAX);
    BAD(DRIVE.input_count, CAN_INPUTS_MAX + 1, "drive[1].input_count");
    GOOD(DRIVE.quick_stop_count, CAN_STOP_MAX);
    BAD(DRIVE.quick_stop_count, CAN_STOP_MAX + 1, "drive[1].quick_stop_count");
    GOOD(DRIVE.disarm_count, CAN_STOP_MAX);
    BAD(DRIVE.disarm_count, CAN_STOP_MAX + 1, "drive[1].disarm_count");
    GOOD(DRIVE.hello, 2);
    BAD(DRIVE.hello, 3, "drive[1].hello");
    GOOD(DRIVE.watchdog_ns, 0);
    BAD(DRIVE.watchdog_ns, -1, "drive[1].watchdog_ns");
}

static void each_frame_to_send_has_a_valid_identifier_and_length(void)
{
    can_packet *const packets[] = {&DRIVE.output[0].packet,
                                   &DRIVE.poll[0],
                                   &DRIVE.slow[0],
                                   &DRIVE.probe[0],
                                   &DRIVE.poll[CAN_POLLS_MAX - 1],
                                   &DRIVE.slow[CAN_POLLS_MAX - 1],
                                   &DRIVE.probe[CAN_POLLS_MAX - 1],
                                   &DRIVE.quick_stop[0].packet,
                                   &DRIVE.quick_stop[1].packet,
                                   &DRIVE.disarm[0].packet,
                                   &DRIVE.disarm[1].packet};
    for (uint32_t i = 0; i < sizeof packets / sizeof packets[0]; i++) {
        can_packet *packet = packets[i];
        begin_with(2);
        DRIVE.quick_stop_count = DRIVE.disarm_count = 2;
        CHECK(is_good());
        packet->id = 0x7FF;
        CHECK(is_good());
        packet->id = 0x800;
        CHECK(refused("drive[1].packet.id"));
        packet->id = CAN_ID_EXTENDED | 0x1FFFFFFF;
        CHECK(is_good());
        packet->id = CAN_ID_EXTENDED | 0x20000000;
        CHECK(refused("drive[1].packet.id"));
        packet->id = CAN_ID_ERROR | 1;
        CHECK(refused("drive[1].packet.id"));
        packet->id = 1;
        packet->bytes = 8;
        CHECK(is_good());
        packet->bytes = 9;
        CHECK(refused("drive[1].packet.bytes"));
        packet->fd = 1;
        packet->bytes = CAN_BYTES_MAX;
        CHECK(is_good());
        packet->bytes = CAN_BYTES_MAX + 1;
        CHECK(refused("drive[1].packet.bytes"));
        packet->bytes = 8;
        packet->fd = 2;
        CHECK(refused("drive[1].packet.fd"));
        packet->fd = 1;
        packet->id = CAN_ID_REMOTE | 1;
        CHECK(refused("drive[1].packet.fd"));
        packet->fd = 0;
        /* a set-point frame is no remote frame */
        CHECK(i == 0 ? refused("drive[1].output.packet.id") : is_good());
    }
    begin_with(2);
    DRIVE.quick_stop[1].packet.id = DRIVE.disarm[1].packet.id = 0x800; /* beyond the count */
    CHECK(is_good());
}

static void places_and_forms_of_numbers_have_their_range(void)
{
    can_place *const places[] = {&DRIVE.output[0].setpoint[0].place,
                                 &DRIVE.input[1].field[0].place};
    for (uint32_t i = 0; i < 2; i++) {
        can_place *place = places[i];
        begin_with(2);
        DRIVE.output[0].packet.bytes = 8;
        DRIVE.output[0].setpoint[0].scale.raw_min = DRIVE.output[0].setpoint[0].scale.raw_max = 0.0;
        *place = (can_place){.start_bit = 32, .length = 32, .form = CAN_FLOAT};
        CHECK(is_good());
        place->length = 31;
        CHECK(refused("drive[1].place.length"));
        place->form = CAN_SIGNED;
        CHECK(is_good());
        place->length = 1;
        CHECK(is_good());
        place->length = 0;
        CHECK(refused("drive[1].place.length"));
        place->start_bit = 0;
        place->length = 33;
        CHECK(refused("drive[1].place.length"));
        place->length = 32;
        place->start_bit = 33;
        CHECK(refused("drive[1].place.start_bit"));
        place->start_bit = UINT32_MAX - 30; /* its end wraps round to 1 */
        CHECK(refused("drive[1].place.start_bit"));
        place->start_bit = 0;
        place->form = CAN_FLOAT + 1;
        CHECK(refused("drive[1].place.form"));
    }
    begin_with(2); /* the last bit of the longest frame */
    DRIVE.output[0].packet.fd = 1;
    DRIVE.output[0].packet.bytes = CAN_BYTES_MAX;
    DRIVE.output[0].setpoint[0].place =
        (can_place){.start_bit = 8 * CAN_BYTES_MAX - 1, .length = 1};
    DRIVE.output[0].setpoint[0].scale.raw_min = 0.0;
    DRIVE.output[0].setpoint[0].scale.raw_max = 1.0;
    CHECK(is_good());
}

static void set_points(void)
{
    BAD(DRIVE.output[0].setpoint_count, 0, "drive[1].setpoint_count");
    BAD(DRIVE.output[0].setpoint_count, CAN_SETPOINTS_MAX + 1, "drive[1].setpoint_count");
    begin_with(2);
    can_output *last = &DRIVE.output[CAN_OUTPUTS_MAX - 1];
    for (uint32_t o = 1; o < CAN_OUTPUTS_MAX; o++) {
        DRIVE.output[o] = DRIVE.output[0];
    }
    DRIVE.output_count = CAN_OUTPUTS_MAX;
    for (uint32_t i = 1; i < CAN_SETPOINTS_MAX; i++) {
        last->setpoint[i] = last->setpoint[0];
    }
    last->setpoint_count = CAN_SETPOINTS_MAX;
    CHECK(is_good());
    setpoint_scale *scale = &last->setpoint[CAN_SETPOINTS_MAX - 1].scale;
    scale->joint = JOINTS_MAX - 1;
    scale->kind = SETPOINT_TORQUE;
    CHECK(is_good());
    scale->joint = JOINTS_MAX;
    CHECK(refused("drive[1].setpoint.joint"));
    scale->joint = 0;
    scale->kind = SETPOINT_POSITION;
    CHECK(refused("drive[1].setpoint.raw_per_s"));
    scale->raw_per_s = 0.01; /* slow, but more than 0 */
    CHECK(is_good());
    scale->kind = SETPOINT_TORQUE;
    CHECK(refused("drive[1].setpoint.raw_per_s"));
    scale->raw_per_s = 0.0;
    scale->kind = SETPOINT_POSITION + 1;
    CHECK(refused("drive[1].setpoint.kind"));
    scale->kind = 0;
    const double bad_factors[] = {0.0, (double)NAN, (double)INFINITY};
    for (uint32_t i = 0; i < 3; i++) {
        scale->raw_per_si = bad_factors[i];
        CHECK(refused("drive[1].setpoint.raw_per_si"));
    }
    scale->raw_per_si = -1.0;
    scale->raw_min = scale->raw_max = 0.0;
    CHECK(is_good());
    scale->raw_min = 1e-9;
    CHECK(refused("drive[1].setpoint.raw_min"));
    scale->raw_min = 0.0;
    scale->raw_max = -1e-9;
    CHECK(refused("drive[1].setpoint.raw_max"));
    scale->raw_max = 0.0;
    scale->raw_min = -(double)INFINITY;
    CHECK(refused("drive[1].setpoint.raw_min"));
    scale->raw_min = 0.0;
    scale->raw_max = (double)NAN;
    CHECK(refused("drive[1].setpoint.raw_max"));
}

static void set_points_fit_their_place(void)
{
    const struct {
        uint32_t form;
        double least, most;
    } forms[] = {{CAN_SIGNED, -32768.0, 32767.0}, {CAN_UNSIGNED, 0.0, 65535.0}};
    for (uint32_t i = 0; i < 2; i++) {
        begin_with(2);
        can_setpoint *setpoint = &DRIVE.output[0].setpoint[0];
        setpoint->place.form = forms[i].form;
        setpoint->scale.raw_min = forms[i].least;
        setpoint->scale.raw_max = forms[i].most;
        CHECK(is_good());
        setpoint->scale.raw_max = nextafter(forms[i].most, 1e9);
        CHECK(refused("drive[1].setpoint.raw_max"));
        setpoint->scale.raw_max = forms[i].most;
        setpoint->scale.raw_min = nextafter(forms[i].least, -1e9);
        CHECK(refused("drive[1].setpoint.raw_min"));
    }
}

static void set_points_of_a_float_fit_its_range(void)
{
    begin_with(2);
    can_setpoint *setpoint = &DRIVE.output[0].setpoint[0];
    DRIVE.output[0].packet.bytes = 8;
    setpoint->place = (can_place){.length = 32, .form = CAN_FLOAT};
    setpoint->scale.raw_max = (double)FLT_MAX;
    setpoint->scale.raw_min = -(double)FLT_MAX;
    CHECK(is_good());
    setpoint->scale.raw_max = 2.0 * (double)FLT_MAX;
    CHECK(refused("drive[1].setpoint.raw_max"));
    setpoint->scale.raw_max = 0.0;
    setpoint->scale.raw_min = -2.0 * (double)FLT_MAX;
    CHECK(refused("drive[1].setpoint.raw_min"));
}

static void writes_belong_to_an_existing_frame(void)
{
    GOOD(DRIVE.disarm[0].output, 1);
    GOOD(DRIVE.disarm[0].output, 0);
    BAD(DRIVE.disarm[0].output, 2, "drive[1].write.output");
    BAD(DRIVE.quick_stop[0].output, 2, "drive[1].write.output");
    can_write write = {.packet = packet_of(1, 8), .output = 2};
    CHECK(can_write_is_good(&write, 2) && !can_write_is_good(&write, 1));
    write.packet.bytes = 9;
    CHECK(!can_write_is_good(&write, 2));
}

static void numbers_of_inputs_have_their_range(void)
{
    GOOD(DRIVE.input[0].silence_ns, 0);
    GOOD(DRIVE.input[0].silence_ns, LONGEST_NS);
    BAD(DRIVE.input[0].silence_ns, LONGEST_NS + 1, "drive[1].silence_ns");
    BAD(DRIVE.input[0].silence_ns, -1, "drive[1].silence_ns");
    GOOD(DRIVE.input[0].spacing_ns, LONGEST_NS);
    BAD(DRIVE.input[0].spacing_ns, LONGEST_NS + 1, "drive[1].spacing_ns");
    BAD(DRIVE.input[0].spacing_ns, -1, "drive[1].spacing_ns");
    BAD(DRIVE.input[0].field_count, CAN_FIELDS_MAX + 1, "drive[1].field_count");
    BAD(DRIVE.input[1].field[1].si_at_zero, (double)NAN, "drive[1].field.si_at_zero");
    BAD(DRIVE.input[1].field[1].meaning.joint, JOINTS_MAX, "drive[1].field.joint");
    GOOD(DRIVE.input[1].field[1].meaning.joint, JOINTS_MAX - 1);
    BAD(DRIVE.input[1].field[1].meaning.kind, FIELD_KEPT, "drive[1].field.kind");
    BAD(DRIVE.input[1].field[1].meaning.kind, FIELD_TAKEN + 1, "drive[1].field.kind");
    BAD(DRIVE.input[1].field[1].meaning.si_per_raw, (double)INFINITY, "drive[1].field.si_per_raw");
    BAD(DRIVE.input[1].field[0].meaning.counter_bits, 0, "drive[1].field.counter_bits");
    GOOD(DRIVE.input[1].field[0].meaning.counter_bits, 1);
    GOOD(DRIVE.input[1].field[0].meaning.counter_bits, 64);
    BAD(DRIVE.input[1].field[0].meaning.counter_bits, 65, "drive[1].field.counter_bits");
    GOOD(DRIVE.input[1].field[1].meaning.counter_bits, 0);
    BAD(DRIVE.input[1].field[1].meaning.counter_bits, 65, "drive[1].field.counter_bits");
    GOOD(DRIVE.input[1].field[1].meaning.harmless_codes, FIELD_HARMLESS_MAX);
    BAD(DRIVE.input[1].field[1].meaning.harmless_codes, FIELD_HARMLESS_MAX + 1,
        "drive[1].field.harmless_codes");
    begin_with(2);
    for (uint32_t i = 1; i < CAN_FIELDS_MAX; i++) {
        DRIVE.input[0].field[i] = DRIVE.input[0].field[0];
    }
    DRIVE.input[0].field_count = CAN_FIELDS_MAX;
    CHECK(is_good());
    DRIVE.input[0].field[CAN_FIELDS_MAX - 1].place.length = 9; /* the frame has only one byte */
    CHECK(refused("drive[1].place.start_bit"));
}

static void matches_of_frames_have_their_range(void)
{
    BAD(DRIVE.match[2].bytes, CAN_BYTES_MAX + 1, "drive[1].match.bytes");
    GOOD(DRIVE.match[2].bytes, CAN_BYTES_MAX);
    GOOD(DRIVE.match[2].begins_bytes, 8);
    BAD(DRIVE.match[2].begins_bytes, 9, "drive[1].match.bytes");
    GOOD(DRIVE.match[2].input, 0);
    BAD(DRIVE.match[2].input, 3, "drive[1].match.input");
    begin_with(2);
    DRIVE.match[2].bytes = DRIVE.match[2].begins_bytes = CAN_BEGINS_MAX;
    CHECK(is_good());
    begin_with(2);
    DRIVE.match[3].input = 3; /* beyond the count */
    CHECK(is_good());
    for (uint32_t i = 3; i < CAN_MATCHES_MAX; i++) {
        DRIVE.match[i].input = 0;
    }
    DRIVE.match_count = CAN_MATCHES_MAX;
    CHECK(is_good());
    DRIVE.match[CAN_MATCHES_MAX - 1].input = 3;
    CHECK(refused("drive[1].match.input"));
}

int main(void)
{
    the_identifiers_that_motord_sends_ascend();
    the_bus_s_own_numbers();
    a_full_table_is_checked_from_its_first_to_its_last_drive();
    the_numbers_of_a_drive();
    each_frame_to_send_has_a_valid_identifier_and_length();
    places_and_forms_of_numbers_have_their_range();
    set_points();
    set_points_fit_their_place();
    set_points_of_a_float_fit_its_range();
    writes_belong_to_an_existing_frame();
    numbers_of_inputs_have_their_range();
    matches_of_frames_have_their_range();
    return checks_report("can table");
}
