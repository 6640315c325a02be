/* SPDX-License-Identifier: Apache-2.0
 * Which tables of a board are refused, and which field is named: each number at the end of its
 * range and beyond. */
#include "board_wire.h"

static const int64_t LONGEST_NS = INT64_C(100000000000);

static char bad_name[FIELD_NAME_BYTES];
static board_table t;

static bool is_good(void)
{
    return board_table_check(&t, bad_name) == NULL;
}

static bool refused(const char *name)
{
    return board_table_check(&t, bad_name) == bad_name && strcmp(bad_name, name) == 0;
}

#define GOOD(field, value)                                                                         \
    do {                                                                                           \
        t = frames_table();                                                                        \
        (field) = (value);                                                                         \
        CHECK(is_good());                                                                          \
    } while (0)
#define BAD(field, value, name)                                                                    \
    do {                                                                                           \
        t = frames_table();                                                                        \
        (field) = (value);                                                                         \
        CHECK(refused(name));                                                                      \
    } while (0)

static void the_numbers_of_a_board(void)
{
    t = frames_table();
    CHECK(is_good());
    BAD(t.dialect, BOARD_SABERTOOTH + 1, "dialect");
    BAD(t.answers, 2, "answers");
    BAD(t.answers, 0, "field_count");
    BAD(t.tries, 0, "tries");
    GOOD(t.tries, 1);
    BAD(t.payload_bytes, 0, "payload_bytes");
    GOOD(t.payload_bytes, BOARD_PAYLOAD_MAX);
    BAD(t.payload_bytes, BOARD_PAYLOAD_MAX + 1, "payload_bytes");
    GOOD(t.feedback_bytes, BOARD_PAYLOAD_MAX);
    BAD(t.feedback_bytes, BOARD_PAYLOAD_MAX + 1, "feedback_bytes");
    BAD(t.setpoint_count, 0, "setpoint_count");
    GOOD(t.setpoint_count, 1);
    BAD(t.setpoint_count, BOARD_SETPOINTS_MAX + 1, "setpoint_count");
    BAD(t.field_count, BOARD_FIELDS_MAX + 1, "field_count");
    BAD(t.quick_stop_count, BOARD_WRITES_MAX + 1, "quick_stop_count");
    BAD(t.disarm_count, BOARD_WRITES_MAX + 1, "disarm_count");
    GOOD(t.watchdog_ns, 0);
    BAD(t.watchdog_ns, -1, "watchdog_ns");
    GOOD(t.rest_velocity_rad_s, 1e-9);
    BAD(t.rest_velocity_rad_s, 0.0, "rest_velocity_rad_s");
    BAD(t.rest_velocity_rad_s, -0.1, "rest_velocity_rad_s");
    BAD(t.rest_velocity_rad_s, (double)INFINITY, "rest_velocity_rad_s");
    BAD(t.rest_velocity_rad_s, (double)NAN, "rest_velocity_rad_s");
    t = frames_table(); /* the shortest valid payload */
    t.payload_bytes = t.setpoint_count = 1;
    t.quick_stop_count = t.disarm_count = 0;
    t.setpoint[0].place = at(0, 1, 1);
    t.setpoint[0].scale.raw_min = -100.0, t.setpoint[0].scale.raw_max = 100.0;
    CHECK(is_good());
}

static void its_times(void)
{
    const struct {
        int64_t *time_ns;
        const char *name;
    } times[] = {{&t.period_ns, "period_ns"},
                 {&t.silence_ns, "silence_ns"},
                 {&t.setpoint_timeout_ns, "setpoint_timeout_ns"}};
    for (uint32_t i = 0; i < 3; i++) {
        BAD(*times[i].time_ns, 0, times[i].name);
        GOOD(*times[i].time_ns, 1);
        GOOD(*times[i].time_ns, LONGEST_NS);
        BAD(*times[i].time_ns, LONGEST_NS + 1, times[i].name);
    }
    GOOD(t.gap_ns, 0);
    BAD(t.gap_ns, -1, "gap_ns");
    GOOD(t.gap_ns, LONGEST_NS);
    BAD(t.gap_ns, LONGEST_NS + 1, "gap_ns");
}

static void full_lists_are_checked_to_their_last_entry(void)
{
    t = frames_table();
    for (uint32_t i = t.setpoint_count; i < BOARD_SETPOINTS_MAX; i++) {
        t.setpoint[i] = t.setpoint[0];
    }
    for (uint32_t i = t.field_count; i < BOARD_FIELDS_MAX; i++) {
        t.field[i] = t.field[0];
    }
    for (uint32_t i = 1; i < BOARD_WRITES_MAX; i++) {
        t.quick_stop[i] = t.disarm[i] = t.disarm[0];
    }
    t.setpoint_count = BOARD_SETPOINTS_MAX;
    t.field_count = BOARD_FIELDS_MAX;
    t.quick_stop_count = t.disarm_count = BOARD_WRITES_MAX;
    CHECK(is_good());
    const board_table full = t;
    board_place *const last[] = {&t.setpoint[0].place,   &t.setpoint[BOARD_SETPOINTS_MAX - 1].place,
                                 &t.field[0].place,      &t.field[BOARD_FIELDS_MAX - 1].place,
                                 &t.quick_stop[0].place, &t.quick_stop[BOARD_WRITES_MAX - 1].place,
                                 &t.disarm[0].place,     &t.disarm[BOARD_WRITES_MAX - 1].place};
    for (uint32_t i = 0; i < 8; i++) {
        t = full;
        last[i]->bytes = 0;
        CHECK(refused("place.bytes"));
    }
    t = frames_table(); /* entries beyond the count are not checked */
    t.setpoint[t.setpoint_count] = t.setpoint[0];
    t.setpoint[t.setpoint_count].scale.kind = 99;
    t.quick_stop[1].place.bytes = t.disarm[1].place.bytes = t.field[t.field_count].place.bytes = 7;
    CHECK(is_good());
}

static void places_of_numbers_have_their_range(void)
{
    board_place *place = &t.field[1].place;
    t = frames_table();
    for (uint32_t bytes = 0; bytes <= 7; bytes++) {
        *place = at(0, bytes, 1);
        CHECK(bytes >= 1 && bytes <= 6 ? is_good() : refused("place.bytes"));
    }
    *place = at(t.feedback_bytes - 2, 2, 0);
    CHECK(is_good());
    place->byte++;
    CHECK(refused("place.byte"));
    place->byte = UINT32_MAX; /* its end wraps round */
    CHECK(refused("place.byte"));
    *place = at(0, 2, 2);
    CHECK(refused("place.is_signed"));
    t.feedback_bytes = BOARD_PAYLOAD_MAX;
    *place = at(BOARD_PAYLOAD_MAX - 1, 1, 0);
    CHECK(is_good());
    BAD(t.setpoint[0].place, at(t.payload_bytes - 1, 2, 0), "place.byte");
    BAD(t.disarm[0].place, at(t.payload_bytes, 1, 0), "place.byte");
}

static void set_points_and_writes_fit_their_place(void)
{
    t = frames_table();
    setpoint_scale *scale = &t.setpoint[0].scale;
    t.setpoint[0].place = at(0, 2, 1);
    scale->raw_min = -32768.0;
    scale->raw_max = 32767.0;
    CHECK(is_good());
    scale->raw_max = 32768.0;
    CHECK(refused("setpoint.raw_max"));
    scale->raw_max = 0.0;
    scale->raw_min = -32769.0;
    CHECK(refused("setpoint.raw_min"));
    scale->raw_min = 0.0;
    scale->kind = SETPOINT_DUTY;
    CHECK(is_good());
    scale->kind = SETPOINT_DUTY + 1;
    CHECK(refused("setpoint.kind"));
    const struct {
        uint32_t is_signed;
        int64_t least, most;
    } places[] = {{0, 0, 255}, {1, -128, 127}};
    for (uint32_t i = 0; i < 2; i++) {
        board_write write = {.place = at(17, 1, places[i].is_signed), .raw = places[i].least};
        CHECK(board_write_is_good(&write, 18) && !board_write_is_good(&write, 17));
        write.raw = places[i].most;
        CHECK(board_write_is_good(&write, 18));
        write.raw = places[i].most + 1;
        CHECK(!board_write_is_good(&write, 18));
        t = frames_table();
        t.disarm[0] = write;
        CHECK(refused("write.raw"));
        write.raw = places[i].least - 1;
        CHECK(!board_write_is_good(&write, 18));
    }
    BAD(t.field[0].meaning.kind, FIELD_KEPT + 1, "field.kind");
    BAD(t.field[0].meaning.si_per_raw, (double)NAN, "field.si_per_raw");
}

static void feedback_has_room_for_the_received_sequence_and_its_time(void)
{
    t = frames_table();
    t.field_count = 0;
    t.feedback_bytes = 10;
    CHECK(is_good());
    t.feedback_bytes = 9;
    CHECK(refused("feedback_bytes"));
    t.feedback_bytes = 10;
    t.answers = 0;
    CHECK(refused("feedback_bytes"));
}

static void the_axes_of_a_sensor(void)
{
    for (uint32_t axis = 0; axis < 3; axis++) {
        GOOD(t.imu.axis[axis], 2);
        BAD(t.imu.axis[axis], 3, "imu.axis");
    }
    t = frames_table();
    t.imu.used = 1; /* frames have a fixed place for the rate */
    CHECK(is_good());
}

/* The board is sent "m %d,%+.2f\n", and reports "a %d b %f". */
static void begin_text(void)
{
    t = frames_table();
    t.dialect = BOARD_TEXT;
    t.written = (board_text){.part_count = 2, .literal = "m ,"};
    t.written.part[0] =
        (board_part){.literal_bytes = 2, .form = NUMBER_INTEGER, .number_per_raw = {1.0}};
    t.written.part[1] = (board_part){.literal_bytes = 1,
                                     .form = NUMBER_FIXED,
                                     .sign = '+',
                                     .precision = 2,
                                     .number_per_raw = {0.0, 0.5}};
    t.read = (board_text){.part_count = 2, .literal = "a  b "};
    t.read.part[0] = (board_part){
        .literal_bytes = 2, .form = NUMBER_INTEGER, .place = at(0, 4, 1), .raw_per_number = 1.0};
    t.read.part[1] = (board_part){
        .literal_bytes = 3, .form = NUMBER_FIXED, .place = at(4, 4, 1), .raw_per_number = 1.0};
}

#define TEXT_GOOD(field, value)                                                                    \
    do {                                                                                           \
        begin_text();                                                                              \
        (field) = (value);                                                                         \
        CHECK(is_good());                                                                          \
    } while (0)
#define TEXT_BAD(field, value, name)                                                               \
    do {                                                                                           \
        begin_text();                                                                              \
        (field) = (value);                                                                         \
        CHECK(refused(name));                                                                      \
    } while (0)

static void template_parts_have_known_forms(void)
{
    begin_text();
    CHECK(is_good());
    TEXT_BAD(t.written.part_count, 0, "written.part_count");
    TEXT_BAD(t.read.part_count, 0, "read.part_count");
    begin_text();
    t.answers = t.field_count = 0;
    CHECK(refused("read.part_count"));
    t.read.part_count = 0;
    CHECK(is_good());
    TEXT_BAD(t.written.part_count, BOARD_PARTS_MAX + 1, "written.part_count");
    TEXT_GOOD(t.read.part_count, 1);
    begin_text();
    for (uint32_t i = t.written.part_count; i < BOARD_PARTS_MAX; i++) {
        t.written.part[i] = (board_part){.form = NUMBER_INTEGER};
    }
    t.written.part_count = BOARD_PARTS_MAX;
    CHECK(is_good());
    TEXT_BAD(t.read.part_count, BOARD_PARTS_MAX + 1, "read.part_count");
    TEXT_GOOD(t.written.part[1].form, NUMBER_GENERAL);
    TEXT_BAD(t.written.part[1].form, NUMBER_GENERAL + 1, "written.part.form");
    TEXT_GOOD(t.written.part[1].form, NUMBER_NONE);
    /* only the last part may have no number */
    TEXT_BAD(t.written.part[0].form, NUMBER_NONE, "written.part.form");
    TEXT_GOOD(t.read.part[1].form, NUMBER_NONE);
    TEXT_BAD(t.read.part[0].form, NUMBER_NONE, "read.part.form");
    TEXT_GOOD(t.written.part[1].literal_bytes, BOARD_TEXT_MAX - 2);
    TEXT_BAD(t.written.part[1].literal_bytes, BOARD_TEXT_MAX - 1, "written.part.literal_bytes");
    TEXT_BAD(t.written.part[1].literal_bytes, UINT32_MAX - 1, "written.part.literal_bytes");
    TEXT_GOOD(t.written.part[0].literal_bytes, BOARD_TEXT_MAX - 1);
    begin_text();
    t.written.part_count = 1;
    t.written.part[0].literal_bytes = BOARD_TEXT_MAX;
    CHECK(is_good());
}

static void numbers_are_written_exactly_and_in_a_width_that_fits(void)
{
    TEXT_GOOD(t.written.part[1].sign, ' ');
    TEXT_GOOD(t.written.part[1].sign, 0);
    TEXT_BAD(t.written.part[1].sign, '-', "written.part.sign");
    TEXT_BAD(t.written.part[1].sign, 1, "written.part.sign");
    TEXT_GOOD(t.written.part[1].zeros, 1);
    TEXT_BAD(t.written.part[1].zeros, 2, "written.part.zeros");
    TEXT_GOOD(t.written.part[1].width, 99);
    TEXT_BAD(t.written.part[1].width, 100, "written.part.width");
    TEXT_GOOD(t.written.part[1].precision, 99);
    TEXT_BAD(t.written.part[1].precision, 100, "written.part.width");
    /* 1e6 raw times 1e9 is 1e15: a double represents all integers up to there */
    TEXT_GOOD(t.written.part[0].number_per_raw[0], 1e9);
    TEXT_GOOD(t.written.part[0].number_per_raw[0], -1e9);
    TEXT_BAD(t.written.part[0].number_per_raw[0], 1.000001e9, "written.part.number_per_raw");
    TEXT_BAD(t.written.part[0].number_per_raw[0], -1.000001e9, "written.part.number_per_raw");
    TEXT_BAD(t.written.part[0].number_per_raw[0], (double)NAN, "written.part.number_per_raw");
    begin_text();
    /* too large only together */
    t.written.part[0].number_per_raw[0] = t.written.part[0].number_per_raw[1] = 0.6e9;
    CHECK(refused("written.part.number_per_raw"));
    begin_text();
    t.written.part[0].number_per_raw[0] = 1e9;
    t.setpoint[0].scale.raw_min = -2e6; /* the end of the range that is farther from zero counts */
    CHECK(refused("written.part.number_per_raw"));
    begin_text();
    t.written.part[0].number_per_raw[0] = 1e9;
    t.setpoint[0].scale.raw_max = 2e6;
    CHECK(refused("written.part.number_per_raw"));
    begin_text(); /* a set-point beyond the count */
    t.setpoint[t.setpoint_count] = t.setpoint[0];
    t.written.part[0].number_per_raw[t.setpoint_count] = 1e300;
    CHECK(is_good());
}

static void the_text_after_a_number_cannot_continue_the_number(void)
{
    const char goes_on[] = "0159.eE", ends[] = "/:,x+- ";
    for (uint32_t i = 0; goes_on[i] != '\0'; i++) {
        TEXT_BAD(t.read.literal[2], (uint8_t)goes_on[i], "read.part.literal_bytes");
        TEXT_GOOD(t.read.literal[2], (uint8_t)ends[i]);
        /* any text may stand before the first number */
        TEXT_GOOD(t.read.literal[0], (uint8_t)goes_on[i]);
        TEXT_GOOD(t.written.literal[2], (uint8_t)goes_on[i]);
    }
    TEXT_BAD(t.read.part[1].literal_bytes, 0, "read.part.literal_bytes");
    TEXT_GOOD(t.read.part[0].literal_bytes, 0);
    begin_text();
    /* no text separates it from the number before it */
    t.read.part[1] = (board_part){.form = NUMBER_NONE};
    CHECK(refused("read.part.literal_bytes"));
    TEXT_BAD(t.read.part[0].raw_per_number, (double)INFINITY, "read.part.raw_per_number");
    TEXT_BAD(t.read.part[1].place.byte, 33, "read.place.byte");
    begin_text();
    t.read.part[1].form = NUMBER_NONE; /* a part without a number has no place */
    t.read.part[1].place.byte = 33;
    CHECK(is_good());
}

static void a_text_with_a_sensor_has_a_place_for_its_rate(void)
{
    begin_text();
    t.imu.used = 1;
    t.imu.rate_z = at(32, 4, 1);
    CHECK(is_good());
    t.imu.rate_z.byte = 33;
    CHECK(refused("place.byte"));
    t.imu.used = 0;
    CHECK(is_good());
}

int main(void)
{
    the_numbers_of_a_board();
    its_times();
    full_lists_are_checked_to_their_last_entry();
    places_of_numbers_have_their_range();
    set_points_and_writes_fit_their_place();
    feedback_has_room_for_the_received_sequence_and_its_time();
    the_axes_of_a_sensor();
    template_parts_have_known_forms();
    numbers_are_written_exactly_and_in_a_width_that_fits();
    the_text_after_a_number_cannot_continue_the_number();
    a_text_with_a_sensor_has_a_place_for_its_rate();
    return checks_report("board table");
}
