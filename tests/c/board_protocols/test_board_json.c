/* SPDX-License-Identifier: Apache-2.0
 * test_board_json: lines that are JSON objects, read by the names of their members. Each buffer has
 * the length of its content, so that a sanitizer sees an access beyond it. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "board_machine.h"
#include "check.h"

static const board_place LEFT = {.byte = 0, .bytes = 6, .is_signed = 1},
                         RIGHT = {.byte = 6, .bytes = 6, .is_signed = 1};

static board_text text;

static void add(const char *name, board_part part)
{
    uint32_t before = 0;
    for (uint32_t i = 0; i < text.part_count; i++) {
        before += text.part[i].literal_bytes;
    }
    part.literal_bytes = (uint32_t)strlen(name);
    memcpy(text.literal + before, name, part.literal_bytes);
    text.part[text.part_count++] = part;
}

/* Lines are {"T":1001,"L":left,"R":right}; raw values are thousandths. */
static void begin(void)
{
    memset(&text, 0, sizeof text);
    text.json = 1;
    add("T", (board_part){.form = NUMBER_CONSTANT, .raw_per_number = 1001.0});
    add("L", (board_part){.form = NUMBER_FIXED, .place = LEFT, .raw_per_number = 1000.0});
    add("R", (board_part){.form = NUMBER_FIXED, .place = RIGHT, .raw_per_number = 1000.0});
}

static uint32_t read_line(const char *line, int64_t *left, int64_t *right)
{
    uint32_t count = (uint32_t)strlen(line);
    uint8_t *bytes = malloc(count > 0 ? count : 1), payload[12] = {0};
    memcpy(bytes, line, count);
    uint32_t used = board_text_read(&text, bytes, count, payload);
    free(bytes);
    *left = board_get(payload, &LEFT);
    *right = board_get(payload, &RIGHT);
    return used;
}

static void members_are_found_by_name_in_any_order_among_others(void)
{
    static const char *const GOOD[] = {
        "{\"T\":1001,\"L\":0.25,\"R\":-0.5}",
        "{\"R\":-0.5,\"L\":0.25,\"T\":1001}",
        "  { \"T\" : 1001 , \"L\" : 2.5e-1 ,\t\"R\":-5E-1 }\r",
        "{\"T\":1.001e3,\"L\":0.25,\"R\":-0.5,\"v\":1205}",
        "{\"s\":\"}{\\\"L\\\":9,\",\"T\":1001,\"L\":0.25,\"R\":-0.5}",
        "{\"o\":{\"L\":9,\"a\":[1,{\"R\":7}],\"s\":\"]\"},\"T\":1001,\"L\":0.25,\"R\":-0.5,\"n\":"
        "null,\"b\":true,\"e\":[]}",
        "{\"LL\":3,\"\":4,\"T\":1001,\"L\":0.25,\"l\":8,\"R\":-0.5,\"\\u004c\":9}",
    };
    int64_t left, right;
    begin();
    for (size_t i = 0; i < sizeof GOOD / sizeof GOOD[0]; i++) {
        CHECK(read_line(GOOD[i], &left, &right) == 12 && left == 250 && right == -500);
    }
}

static void text_that_is_no_such_object_is_refused(void)
{
    static const char *const BAD[] = {
        "",
        "{",
        "{}",
        "[]",
        "1001",
        "{\"T\":1001,\"L\":0.25,\"R\":-0.5",
        "{\"T\":1001,\"L\":0.25,\"R\":-0.5}}",
        "{\"T\":1001,\"L\":0.25,\"R\":-0.5} x",
        "{\"T\":1001,\"L\":0.25,\"R\":-0.5,}",
        "{\"T\":1001 \"L\":0.25,\"R\":-0.5}",
        "{\"T\":1001,\"L\" 0.25,\"R\":-0.5}",
        "{\"T\":1001,L:0.25,\"R\":-0.5}",
        "{\"T\":1001,\"L\":,\"R\":-0.5}",
        "{\"T\":1001,\"L\":\"0.25\",\"R\":-0.5}",
        "{\"T\":1001,\"L\":null,\"R\":-0.5}",
        "{\"T\":1001,\"L\":NaN,\"R\":-0.5}",
        "{\"T\":1001,\"L\":1e999,\"R\":-0.5}",
        "{\"T\":1001,\"L\":0.25x,\"R\":-0.5}",
        "{\"T\":1001,\"L\":0.25}",            /* R is missing */
        "{\"L\":0.25,\"R\":-0.5}",            /* T is missing */
        "{\"T\":1003,\"L\":0.25,\"R\":-0.5}", /* another type */
        "{\"T\":1001,\"L\":0.25,\"L\":0.5,\"R\":-0.5}",
        "{\"T\":1001,\"L\":0.25,\"R\":-0.5,\"s\":\"}",
        "{\"T\":1001,\"L\":0.25,\"R\":-0.5,\"s\":\"\\",
        "{\"T\":1001,\"L\":0.25,\"R\":-0.5,\"o\":{}",
        "{\"T\":1001,\"L\":0.25,\"R\":-0.5,\"o\":[",
        "{\"T\":1001,\"L\":0.25,\"R\":-0.5,\"o\":[\"",
        "{\"T\":1001,\"L\":0.25,\"R\":-0.5,\"o\":",
        "{\"T\":1001,\"L\":0.25,\"R\":-0.5,\"o\":}",
        "{\"T\":1001,\"L\":0.25,\"R\":-0.5,\"o\"",
        "{\"T\":1001,\"L\":0.25,\"R\":-0.5,\"o\"}",
        "{\"T\":1001,\"L\":0.25,\"R\":-0.5,\"L\":}",
        "{\"T\":1001,\"L\":0.25,\"R\":-0.5,:5}",
        "{\"T\":1001,\"L\":0.25,\"R\":-0.5,\"o",
    };
    int64_t left, right;
    begin();
    for (size_t i = 0; i < sizeof BAD / sizeof BAD[0]; i++) {
        CHECK(read_line(BAD[i], &left, &right) == 0);
    }
}

static void a_zero_byte_does_not_end_the_text(void)
{
    char line[] = "{\"T\":1001,\"o\":@,\"L\":0.25,\"R\":-0.5}";
    uint8_t payload[12] = {0};
    begin();
    *strchr(line, '@') = '\0';
    CHECK(board_text_read(&text, (const uint8_t *)line, sizeof line - 1, payload) == 12 &&
          board_get(payload, &LEFT) == 250);
}

static void an_object_of_constants_alone_reports_nothing(void)
{
    uint8_t payload[12] = {0};
    begin();
    text.part_count = 1;
    CHECK(board_text_read(&text, (const uint8_t *)"{\"T\":1001}", 10, payload) == 0);
}

static void every_beginning_of_a_good_line_is_refused(void)
{
    static const char line[] = "{\"T\":1001,\"o\":{\"a\":[\"\\\"\",2]},\"L\":0.25,\"R\":-0.5}";
    int64_t left, right;
    begin();
    for (size_t count = 0; count < sizeof line - 1; count++) {
        char part[sizeof line] = {0};
        memcpy(part, line, count);
        CHECK(read_line(part, &left, &right) == 0);
    }
    CHECK(read_line(line, &left, &right) == 12);
}

static board_table table_of_text(void)
{
    board_table table = {.dialect = BOARD_TEXT,
                         .answers = 1,
                         .tries = 1,
                         .payload_bytes = 2,
                         .feedback_bytes = 12,
                         .setpoint_count = 1,
                         .period_ns = 1,
                         .silence_ns = 1,
                         .setpoint_timeout_ns = 1,
                         .rest_velocity_rad_s = 0.1,
                         .written = {.part_count = 1},
                         .read = text};
    table.setpoint[0] =
        (board_setpoint){.place = {.byte = 0, .bytes = 2, .is_signed = 1},
                         .scale = {.raw_per_si = 1.0, .raw_min = -1.0, .raw_max = 1.0}};
    table.written.part[0] = (board_part){.form = NUMBER_FIXED, .number_per_raw = {1.0}};
    return table;
}

static bool refused(const board_table *table, const char *field)
{
    char name[FIELD_NAME_BYTES];
    const char *bad = board_table_check(table, name);
    return bad != NULL && strcmp(bad, field) == 0;
}

static void tables_of_names_are_refused_where_they_cannot_be_read(void)
{
    char name[FIELD_NAME_BYTES];
    begin();
    board_table table = table_of_text();
    CHECK(board_table_check(&table, name) == NULL);
    table.read.json = 2;
    CHECK(refused(&table, "read.json"));
    table = table_of_text();
    table.written.json = 1;
    CHECK(refused(&table, "written.json"));
    table = table_of_text();
    table.read.part[1].literal_bytes = 0;
    CHECK(refused(&table, "read.part.literal_bytes"));
    table = table_of_text();
    table.read.literal[1] = '"';
    CHECK(refused(&table, "read.part.literal_bytes"));
    table = table_of_text();
    table.read.literal[2] = '\\';
    CHECK(refused(&table, "read.part.literal_bytes"));
    table = table_of_text();
    table.read.part[2].form = NUMBER_NONE;
    CHECK(refused(&table, "read.part.form"));
    table = table_of_text();
    table.read.part[2].form = NUMBER_CONSTANT + 1;
    CHECK(refused(&table, "read.part.form"));
    table = table_of_text();
    table.read.part[0].raw_per_number = (double)NAN;
    CHECK(refused(&table, "read.part.raw_per_number"));
    table = table_of_text();
    table.read.part[2].place.byte = 7;
    CHECK(refused(&table, "read.place.byte"));
    table = table_of_text();
    table.read.json = 0; /* only JSON has a constant */
    CHECK(refused(&table, "read.part.form"));
}

int main(void)
{
    members_are_found_by_name_in_any_order_among_others();
    text_that_is_no_such_object_is_refused();
    every_beginning_of_a_good_line_is_refused();
    a_zero_byte_does_not_end_the_text();
    an_object_of_constants_alone_reports_nothing();
    tables_of_names_are_refused_where_they_cannot_be_read();
    return checks_report("test_board_json");
}
