/* SPDX-License-Identifier: Apache-2.0
 * Which tables of a serial line are refused, and which field is named: each number at the end of
 * its range and beyond. */
#include <math.h>

#include "line_wire.h"

static const int64_t LONGEST_NS = INT64_C(100000000000);
static const double INFINITE = (double)INFINITY, NO_NUMBER = (double)NAN;

static char bad_name[FIELD_NAME_BYTES];
static line_table t, good;
static line_drive *const d = &t.drive[0];
static line_frame *const write_frame = &t.drive[0].cyclic[0].frame, *const read_frame =
                                                                        &t.drive[0].cyclic[1].frame;
static line_setpoint *const setpoint = &t.drive[0].cyclic[0].setpoint[0];
static line_field *const field = &t.drive[0].cyclic[1].field[0];

static bool is_good(void)
{
    return line_table_check(&t, bad_name) == NULL;
}

static bool refused(const char *name)
{
    return line_table_check(&t, bad_name) == bad_name && strcmp(bad_name, name) == 0;
}

#define GOOD(field, value)                                                                         \
    do {                                                                                           \
        t = good;                                                                                  \
        (field) = (value);                                                                         \
        CHECK(is_good());                                                                          \
    } while (0)
#define BAD(field, value, name)                                                                    \
    do {                                                                                           \
        t = good;                                                                                  \
        (field) = (value);                                                                         \
        CHECK(refused(name));                                                                      \
    } while (0)

static void the_numbers_of_a_line(void)
{
    GOOD(t.drive_count, 1);
    BAD(t.drive_count, 0, "drive_count");
    BAD(t.drive_count, LINE_DRIVES_MAX + 1, "drive_count");
    GOOD(t.echo, 2);
    BAD(t.echo, 3, "echo");
    GOOD(t.character_ns, 1e-3);
    BAD(t.character_ns, 0.0, "character_ns");
    GOOD(t.character_ns, 1e8);
    BAD(t.character_ns, 1e8 + 1.0, "character_ns");
    BAD(t.character_ns, NO_NUMBER, "character_ns");
    GOOD(t.gap_ns, 0);
    BAD(t.gap_ns, -1, "gap_ns");
    GOOD(t.gap_ns, LONGEST_NS);
    BAD(t.gap_ns, LONGEST_NS + 1, "gap_ns");
    GOOD(t.setpoint_timeout_ns, 1);
    BAD(t.setpoint_timeout_ns, 0, "setpoint_timeout_ns");
    GOOD(t.setpoint_timeout_ns, LONGEST_NS);
    BAD(t.setpoint_timeout_ns, LONGEST_NS + 1, "setpoint_timeout_ns");
    GOOD(t.rest_velocity_rad_s, 1e-9);
    BAD(t.rest_velocity_rad_s, 0.0, "rest_velocity_rad_s");
    BAD(t.rest_velocity_rad_s, INFINITE, "rest_velocity_rad_s");
    BAD(t.broadcast_stop_count, DRIVE_STOP_MAX + 1, "broadcast_stop_count");
}

static void the_numbers_of_a_drive(void)
{
    GOOD(d->tries, 1);
    BAD(d->tries, 0, "drive[0].tries");
    GOOD(d->extra_every, 1);
    BAD(d->extra_every, 0, "drive[0].extra_every");
    GOOD(d->watchdog_ns, 0);
    BAD(d->watchdog_ns, -1, "drive[0].watchdog_ns");
    GOOD(d->reply_timeout_ns, 0);
    BAD(d->reply_timeout_ns, -1, "drive[0].reply_timeout_ns");
    const struct {
        int64_t *time_ns;
        const char *name;
    } times[] = {{&d->period_ns, "drive[0].period_ns"},
                 {&d->turnaround_ns, "drive[0].turnaround_ns"},
                 {&d->reply_timeout_ns, "drive[0].reply_timeout_ns"}};
    for (uint32_t i = 0; i < 3; i++) {
        GOOD(*times[i].time_ns, 1);
        GOOD(*times[i].time_ns, LONGEST_NS);
        BAD(*times[i].time_ns, LONGEST_NS + 1, times[i].name);
    }
    BAD(d->period_ns, 0, "drive[0].period_ns");
    BAD(d->turnaround_ns, 0, "drive[0].turnaround_ns");
    BAD(d->cyclic_count, 0, "drive[0].cyclic_count");
    BAD(d->cyclic_count, DRIVE_CYCLIC_MAX + 1, "drive[0].cyclic_count");
    BAD(d->extra_count, DRIVE_EXTRA_MAX + 1, "drive[0].extra_count");
    BAD(d->direction_count, DRIVE_DIRECTIONS_MAX + 1, "drive[0].direction_count");
    BAD(d->quick_stop_count, DRIVE_STOP_MAX + 1, "drive[0].quick_stop_count");
    BAD(d->disarm_count, DRIVE_STOP_MAX + 1, "drive[0].disarm_count");
    GOOD(d->probe, d->cyclic_count);
    BAD(d->probe, d->cyclic_count + 1, "drive[0].probe");
    BAD(d->idle_count, 2, "drive[0].idle_count");
    t = good;
    d->cyclic_count = d->idle_count = 1, d->probe = 0;
    d->idle[0] = d->cyclic[0].frame;
    CHECK(is_good());
}

static void a_request_and_its_reply(void)
{
    const char *const request = "drive[0].request_bytes";
    BAD(write_frame->request_seal, SEAL_WITH_REQUEST, "drive[0].request_seal");
    GOOD(write_frame->request_seal, SEAL_XMODEM);
    /* this seal is for replies that name no request */
    BAD(read_frame->reply_seal, SEAL_WITH_REQUEST, "drive[0].reply_seal");
    BAD(read_frame->reply_seal, SEAL_WITH_REQUEST + 1, "drive[0].reply_seal");
    GOOD(read_frame->reply_seal, SEAL_CRC8);
    BAD(read_frame->request_bytes, 2, request); /* only its check sum */
    GOOD(read_frame->request_bytes, 3);
    GOOD(read_frame->request_bytes, FRAME_BYTES_MAX);
    BAD(read_frame->request_bytes, FRAME_BYTES_MAX + 1, request);
    GOOD(read_frame->reply_bytes, FRAME_BYTES_MAX);
    BAD(read_frame->reply_bytes, FRAME_BYTES_MAX + 1, "drive[0].reply_bytes");
    t = good;
    read_frame->reply_bytes = 20, read_frame->match_bytes = FRAME_MATCH_MAX;
    CHECK(is_good());
    read_frame->match_bytes = FRAME_MATCH_MAX + 1;
    CHECK(refused("drive[0].match_bytes"));
    GOOD(write_frame->echo_bytes, write_frame->request_bytes);
    t = good;
    write_frame->reply_bytes = 20, write_frame->echo_bytes = write_frame->request_bytes + 1;
    CHECK(refused("drive[0].echo_bytes"));
}

/* Otherwise any reply, or noise, would count as the answer. */
static void a_reply_names_its_request_and_has_a_check_sum(void)
{
    const char *const match = "drive[0].match";
    BAD(read_frame->match_bytes, 0, match);
    GOOD(read_frame->match_bytes, 1);
    GOOD(read_frame->match_bytes, read_frame->reply_bytes);
    BAD(read_frame->match_bytes, read_frame->reply_bytes + 1, match);
    GOOD(write_frame->echo_bytes, 1);
    BAD(write_frame->echo_bytes, 0, match);
    BAD(read_frame->reply_seal, SEAL_NONE, "drive[0].reply_seal");
    t = good;
    read_frame->reply_bytes = 2, read_frame->match_bytes = 1, d->cyclic[1].field_count = 0;
    CHECK(refused("drive[0].reply_seal")); /* only a check sum */
    read_frame->reply_bytes = 3;
    CHECK(is_good());
    read_frame->reply_bytes = 1;
    CHECK(refused("drive[0].reply_seal"));
    read_frame->reply_bytes = 0, read_frame->match_bytes = 0, read_frame->reply_seal = SEAL_NONE;
    CHECK(is_good()); /* no reply is expected */
    CHECK(line_frame_is_good(read_frame));
    read_frame->request_bytes = 0;
    CHECK(!line_frame_is_good(read_frame));
}

static void a_reply_that_names_no_request_is_matched_by_check_sum_or_as_a_whole(void)
{
    const char *const match = "drive[0].match";
    t = good;
    d->cyclic[1].field_count = 0;
    *read_frame = (line_frame){
        .exact = 1, .request_bytes = 2, .reply_bytes = 3, .reply_seal = SEAL_WITH_REQUEST};
    CHECK(is_good()); /* its check sum covers the request, too */
    read_frame->request_bytes = 1;
    CHECK(refused(match));
    read_frame->request_bytes = 2, read_frame->reply_bytes = 2;
    CHECK(refused(match));
    *read_frame =
        (line_frame){.exact = 1, .request_bytes = 2, .reply_bytes = 3, .reply_seal = SEAL_CRC16};
    CHECK(refused(match));
    *read_frame = (line_frame){.exact = 1, .request_bytes = 1, .reply_bytes = 1, .match_bytes = 1};
    CHECK(is_good()); /* each of its bytes is known */
    read_frame->reply_bytes = 2;
    CHECK(refused(match));
    read_frame->reply_bytes = read_frame->match_bytes = 0;
    CHECK(refused(match));
    read_frame->reply_bytes = read_frame->match_bytes = 1, read_frame->echo_bytes = 1;
    CHECK(refused(match));
    read_frame->echo_bytes = 0, read_frame->request_bytes = 3, read_frame->reply_seal = SEAL_CRC8;
    CHECK(refused(match));
    t = good;
    /* only a servo's reply has the same seal as its request */
    write_frame->request_seal = write_frame->reply_seal = SEAL_XMODEM;
    CHECK(refused("drive[0].reply_seal"));
}

static void a_set_point_lies_in_its_request(void)
{
    GOOD(setpoint->joint, JOINTS_MAX - 1);
    BAD(setpoint->joint, JOINTS_MAX, "drive[0].setpoint.joint");
    GOOD(setpoint->kind, SETPOINT_DUTY);
    BAD(setpoint->kind, SETPOINT_DUTY + 1, "drive[0].setpoint.kind");
    BAD(setpoint->form, FORM_I32_LE + 1, "drive[0].setpoint.form");
    BAD(setpoint->form, FORM_M16_LE + 1, "drive[0].setpoint.form");
    BAD(setpoint->form, FORM_M16_BIT10 + 1, "drive[0].setpoint.form");
    GOOD(setpoint->byte, 0);
    BAD(setpoint->byte, 5, "drive[0].setpoint.byte"); /* its last byte would be in the check sum */
    BAD(setpoint->byte, UINT32_MAX, "drive[0].setpoint.byte");
    t = good;
    setpoint->form = FORM_I32_LE, setpoint->byte = 2;
    CHECK(is_good());
    t = good;
    setpoint->form = FORM_M16_LE, setpoint->raw_min = -32767.0;
    CHECK(is_good());
    setpoint->raw_min = -32767.5; /* a magnitude of 15 bits cannot be -32768 */
    CHECK(refused("drive[0].setpoint.raw_min"));
    t = good;
    setpoint->form = FORM_M16_BIT10, setpoint->raw_min = -1023.0, setpoint->raw_max = 1023.0;
    CHECK(is_good());
    setpoint->raw_max = 1023.5; /* 1024 is the sign bit: the motor would stop instead of turning */
    CHECK(refused("drive[0].setpoint.raw_max"));
    setpoint->raw_max = 1023.0, setpoint->raw_min = -1023.5;
    CHECK(refused("drive[0].setpoint.raw_min"));
    t = good;
    setpoint->form = FORM_I32_LOW_FIRST, setpoint->byte = 2;
    CHECK(is_good());
    setpoint->byte = 3;
    CHECK(refused("drive[0].setpoint.byte"));
    GOOD(setpoint->raw_per_si, -1e-9);
    BAD(setpoint->raw_per_si, 0.0, "drive[0].setpoint.raw_per_si");
    BAD(setpoint->raw_per_si, INFINITE, "drive[0].setpoint.raw_per_si");
    GOOD(setpoint->raw_min, 0.0);
    BAD(setpoint->raw_min, 1e-3, "drive[0].setpoint.raw_min"); /* its range has no zero for rest */
    BAD(setpoint->raw_min, NO_NUMBER, "drive[0].setpoint.raw_min");
    GOOD(setpoint->raw_max, 0.0);
    BAD(setpoint->raw_max, -1e-3, "drive[0].setpoint.raw_max");
    BAD(setpoint->raw_max, NO_NUMBER, "drive[0].setpoint.raw_max");
    BAD(d->cyclic[0].setpoint_count, EXCHANGE_SETPOINTS_MAX + 1, "drive[0].setpoint_count");
}

static void a_field_lies_in_its_reply(void)
{
    GOOD(field->joint, JOINTS_MAX - 1);
    BAD(field->joint, JOINTS_MAX, "drive[0].field.joint");
    GOOD(field->kind, FIELD_KEPT);
    BAD(field->kind, FIELD_REFERENCED + 1, "drive[0].field.kind");
    GOOD(field->byte, 5);
    BAD(field->byte, 6, "drive[0].field.byte");
    BAD(field->byte, UINT32_MAX, "drive[0].field.byte");
    t = good;
    field->form = FORM_I32_LOW_FIRST;
    CHECK(is_good());
    field->form = FORM_I32_LE + 1;
    CHECK(refused("drive[0].field.form"));
    GOOD(field->direction, DRIVE_DIRECTIONS_MAX);
    BAD(field->direction, DRIVE_DIRECTIONS_MAX + 1, "drive[0].field.direction");
    GOOD(field->harmless_codes, FIELD_HARMLESS_MAX);
    BAD(field->harmless_codes, FIELD_HARMLESS_MAX + 1, "drive[0].field.harmless_codes");
    GOOD(field->si_per_raw, 0.0);
    BAD(field->si_per_raw, NO_NUMBER, "drive[0].field.si_per_raw");
    BAD(d->cyclic[1].field_count, EXCHANGE_FIELDS_MAX + 1, "drive[0].field_count");
}

static void set_direction(line_drive *drive, uint32_t place)
{
    drive->direction[place] =
        (line_direction){.rest = frame_of(1, WRITE, CONTROL, DIRECTION_REST),
                         .forward = frame_of(1, WRITE, CONTROL, DIRECTION_FORWARD),
                         .reverse = frame_of(1, WRITE, CONTROL, DIRECTION_REVERSE)};
}

static void fill_lists(void)
{
    t = good;
    for (uint32_t i = 2; i < DRIVE_CYCLIC_MAX; i++) {
        d->cyclic[i] = d->cyclic[1];
    }
    for (uint32_t i = 0; i < DRIVE_EXTRA_MAX; i++) {
        d->extra[i] = d->cyclic[1];
    }
    for (uint32_t i = 0; i < DRIVE_DIRECTIONS_MAX; i++) {
        set_direction(d, i);
    }
    for (uint32_t i = 0; i < DRIVE_STOP_MAX; i++) {
        d->quick_stop[i] = d->disarm[i] = d->disarm[0];
        t.broadcast_stop[i] = (line_frame){.request_bytes = 8, .request_seal = SEAL_CRC16};
    }
    for (uint32_t i = 1; i < EXCHANGE_SETPOINTS_MAX; i++) {
        d->cyclic[0].setpoint[i] = d->cyclic[0].setpoint[0];
    }
    for (uint32_t i = 1; i < EXCHANGE_FIELDS_MAX; i++) {
        d->cyclic[1].field[i] = d->cyclic[1].field[0];
    }
    for (uint32_t i = 1; i < LINE_DRIVES_MAX; i++) {
        t.drive[i] = drive_of(i);
    }
    d->idle[0] = d->cyclic[0].frame;
    t.drive_count = LINE_DRIVES_MAX;
    d->cyclic_count = DRIVE_CYCLIC_MAX, d->extra_count = DRIVE_EXTRA_MAX,
    d->direction_count = DRIVE_DIRECTIONS_MAX;
    d->quick_stop_count = d->disarm_count = t.broadcast_stop_count = DRIVE_STOP_MAX;
    d->cyclic[0].setpoint_count = EXCHANGE_SETPOINTS_MAX,
    d->cyclic[1].field_count = EXCHANGE_FIELDS_MAX;
    d->idle_count = 1;
}

static void full_lists_are_checked_to_their_last_entry(void)
{
    line_direction *const last_direction = &d->direction[DRIVE_DIRECTIONS_MAX - 1];
    const struct {
        uint32_t *number;
        const char *name;
    } last[] = {
        {&d->cyclic[DRIVE_CYCLIC_MAX - 1].frame.request_bytes, "drive[0].request_bytes"},
        {&d->cyclic[0].setpoint[EXCHANGE_SETPOINTS_MAX - 1].joint, "drive[0].setpoint.joint"},
        {&d->cyclic[1].field[EXCHANGE_FIELDS_MAX - 1].joint, "drive[0].field.joint"},
        {&d->extra[DRIVE_EXTRA_MAX - 1].frame.request_bytes, "drive[0].request_bytes"},
        {&d->direction[0].joint, "drive[0].direction.joint"},
        {&last_direction->joint, "drive[0].direction.joint"},
        {&last_direction->kind, "drive[0].direction.joint"},
        {&last_direction->rest.request_bytes, "drive[0].request_bytes"},
        {&last_direction->forward.request_bytes, "drive[0].request_bytes"},
        {&last_direction->reverse.request_bytes, "drive[0].request_bytes"},
        {&d->quick_stop[0].request_bytes, "drive[0].request_bytes"},
        {&d->disarm[0].request_bytes, "drive[0].request_bytes"},
        {&d->quick_stop[DRIVE_STOP_MAX - 1].request_bytes, "drive[0].request_bytes"},
        {&d->disarm[DRIVE_STOP_MAX - 1].request_bytes, "drive[0].request_bytes"},
        {&d->idle[0].request_bytes, "drive[0].request_bytes"},
        {&t.broadcast_stop[0].request_bytes, "broadcast_stop[0].request_bytes"},
        {&t.broadcast_stop[DRIVE_STOP_MAX - 1].request_bytes, "broadcast_stop[5].request_bytes"},
        {&t.drive[LINE_DRIVES_MAX - 1].tries, "drive[7].tries"}};
    fill_lists();
    CHECK(is_good());
    for (uint32_t i = 0; i < sizeof last / sizeof last[0]; i++) {
        fill_lists();
        *last[i].number = strstr(last[i].name, "joint") != NULL ? 99 : 0;
        CHECK(refused(last[i].name));
    }
    fill_lists();
    last_direction->joint = JOINTS_MAX;
    CHECK(refused("drive[0].direction.joint"));
    last_direction->joint = JOINTS_MAX - 1, last_direction->kind = SETPOINT_DUTY;
    CHECK(is_good());
    last_direction->kind = SETPOINT_DUTY + 1;
    CHECK(refused("drive[0].direction.joint"));
}

static void entries_beyond_the_count_are_not_checked(void)
{
    fill_lists();
    const line_table full = t;
    t = good;
    memcpy(&d->extra, &full.drive[0].extra, sizeof d->extra);
    d->cyclic[2].frame.request_bytes = d->extra[0].frame.request_bytes =
        d->quick_stop[1].request_bytes = 999;
    d->disarm[2].request_bytes = d->idle[0].request_bytes = d->direction[0].rest.request_bytes =
        999;
    d->direction[0].joint = t.broadcast_stop[0].request_bytes = 999;
    t.drive[2].tries = 0;
    CHECK(is_good());
}

static void stop_and_idle_packets_have_their_form(void)
{
    fill_lists();
    t.broadcast_stop[0] = frame_of(0, WRITE, CONTROL, DISABLE); /* all drives would answer at
                                                                   once */
    CHECK(refused("broadcast_stop[0].reply_bytes"));
    fill_lists();
    d->extra[0].setpoint_count = 1;
    d->extra[0].setpoint[0] = *setpoint;
    CHECK(refused("drive[0].extra.setpoint_count"));
    fill_lists();
    d->idle[0].reply_bytes = 9;
    CHECK(refused("drive[0].idle.reply_bytes"));
}

static void the_first_error_is_named(void)
{
    t = good;
    d->tries = 0, d->probe = 99, setpoint->joint = 99;
    CHECK(refused("drive[0].tries"));
    t = good;
    setpoint->joint = 99, setpoint->raw_max = 1e9, d->disarm[0].request_bytes = 0;
    CHECK(refused("drive[0].setpoint.joint"));
}

/* A packet needs its head, length and check sum. Stuffing adds one byte to three. A reply has a
 * status, too. */
static void a_servo_s_packet_has_room_for_its_head(void)
{
    const struct {
        uint32_t seal, request_min, request_max, reply_min;
    } KINDS[] = {{SEAL_SUM, 6, FRAME_BYTES_MAX, 6},
                 {SEAL_STUFFED, 10, 3 * FRAME_BYTES_MAX / 4 - 2, 11}};
    for (uint32_t i = 0; i < 2; i++) {
        line_frame packet = {.request_seal = KINDS[i].seal, .request_bytes = KINDS[i].request_min};
        CHECK(line_frame_is_good(&packet)); /* without a reply */
        packet.request_bytes = KINDS[i].request_max;
        CHECK(line_frame_is_good(&packet));
        packet.request_bytes = KINDS[i].request_min - 1;
        CHECK(!line_frame_is_good(&packet));
        packet.request_bytes = KINDS[i].request_max + 1;
        CHECK(!line_frame_is_good(&packet));
        packet = (line_frame){.request_seal = KINDS[i].seal,
                              .request_bytes = 20,
                              .reply_seal = KINDS[i].seal,
                              .match_bytes = 5};
        packet.reply_bytes = KINDS[i].reply_min;
        CHECK(line_frame_is_good(&packet));
        packet.reply_bytes = KINDS[i].reply_min - 1;
        CHECK(!line_frame_is_good(&packet));
        packet.reply_bytes = KINDS[i].reply_min;
        packet.match_bytes = 4; /* stuffed replies need five bytes: head and unit */
        CHECK(line_frame_is_good(&packet) == (KINDS[i].seal == SEAL_SUM));
        packet.match_bytes = 5, packet.echo_bytes = 1;
        CHECK(!line_frame_is_good(&packet));
        packet.echo_bytes = 0, packet.exact = 1;
        CHECK(!line_frame_is_good(&packet));
        packet = (line_frame){
            .request_seal = KINDS[i].seal, .request_bytes = 20, .reply_seal = KINDS[i].seal};
        CHECK(line_frame_is_good(&packet)); /* without a reply */
    }
}

int main(void)
{
    a_servo_s_packet_has_room_for_its_head();
    begin_with(2, 0);
    good = w.table;
    the_numbers_of_a_line();
    the_numbers_of_a_drive();
    a_request_and_its_reply();
    a_reply_names_its_request_and_has_a_check_sum();
    a_reply_that_names_no_request_is_matched_by_check_sum_or_as_a_whole();
    a_set_point_lies_in_its_request();
    a_field_lies_in_its_reply();
    full_lists_are_checked_to_their_last_entry();
    entries_beyond_the_count_are_not_checked();
    stop_and_idle_packets_have_their_form();
    the_first_error_is_named();
    return checks_report("test_line_table");
}
