/* SPDX-License-Identifier: Apache-2.0
 * test_board_text: lines of text, written and read by a template. Each buffer has the length of its
 * content, so that a sanitizer sees an access beyond it. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "board_machine.h"
#include "check.h"

enum { RAW_BYTES = 4 };

static void add(board_text *text, const char *literal, board_part part)
{
    uint32_t before = 0;
    for (uint32_t i = 0; i < text->part_count; i++) {
        before += text->part[i].literal_bytes;
    }
    part.literal_bytes = (uint32_t)strlen(literal);
    memcpy(text->literal + before, literal, part.literal_bytes);
    text->part[text->part_count++] = part;
}

/* ------------------------------------------------------------------------------ writing */
/* Writes one number: 0.001 times the first set-point plus the second one. */
static uint32_t written(board_part part, const char *literal, int64_t one, int64_t other,
                        uint8_t *out)
{
    board_table table = {.setpoint_count = 2};
    uint8_t payload[2 * RAW_BYTES];
    const int64_t raw[2] = {one, other};
    for (uint32_t i = 0; i < 2; i++) {
        table.setpoint[i].place =
            (board_place){.byte = RAW_BYTES * i, .bytes = RAW_BYTES, .is_signed = 1};
        board_put(payload, &table.setpoint[i].place, raw[i]);
    }
    part.number_per_raw[0] = 0.001, part.number_per_raw[1] = 1.0;
    /* a set-point beyond the count */
    table.setpoint[2] = table.setpoint[0], part.number_per_raw[2] = 1e9;
    add(&table.written, literal, part);
    table.written.part[1].literal_bytes = 1; /* a part beyond the count */
    return board_text_write(&table, payload, out);
}

static const struct {
    board_part part;
    int64_t one, other;
    const char *expected;
} WRITTEN[] = {
    {{.form = NUMBER_INTEGER}, 0, 42, "v42"},
    {{.form = NUMBER_INTEGER}, 0, -42, "v-42"},
    {{.form = NUMBER_INTEGER}, 2600, 40, "v43"},
    {{.form = NUMBER_INTEGER}, 2400, 40, "v42"},
    {{.form = NUMBER_INTEGER}, -400, 0, "v0"}, /* no negative zero */
    {{.form = NUMBER_INTEGER, .width = 5}, 0, 42, "v   42"},
    {{.form = NUMBER_INTEGER, .width = 5, .zeros = 1}, 0, -42, "v-0042"},
    {{.form = NUMBER_INTEGER, .sign = '+'}, 0, 42, "v+42"},
    {{.form = NUMBER_INTEGER, .sign = ' ', .zeros = 1, .width = 4}, 0, 42, "v 042"},
    {{.form = NUMBER_FIXED, .precision = 3}, 1500, 2, "v3.500"},
    {{.form = NUMBER_FIXED, .precision = 1}, -1500, 0, "v-1.5"},
    {{.form = NUMBER_FIXED, .precision = 2, .width = 8, .zeros = 1, .sign = '+'},
     250,
     0,
     "v+0000.25"},
    {{.form = NUMBER_FIXED, .precision = 0}, 0, 7, "v7"},
    {{.form = NUMBER_GENERAL, .precision = 4}, 123456, 0, "v123.5"},
    {{.form = NUMBER_GENERAL, .precision = 3}, 0, 123456, "v1.23e+05"},
    {{.form = NUMBER_GENERAL, .precision = 3, .width = 6}, 500, 0, "v   0.5"},
    {{.form = NUMBER_NONE}, 1, 1, "v"},
};

static void a_number_is_written_in_the_form_of_its_part(void)
{
    for (size_t i = 0; i < sizeof WRITTEN / sizeof WRITTEN[0]; i++) {
        uint8_t out[BOARD_TEXT_MAX];
        uint32_t count = written(WRITTEN[i].part, "v", WRITTEN[i].one, WRITTEN[i].other, out);
        CHECK(count == strlen(WRITTEN[i].expected) && memcmp(out, WRITTEN[i].expected, count) == 0);
    }
}

static void parts_follow_one_another_each_after_its_own_text(void)
{
    board_table table = {.setpoint_count = 1};
    table.setpoint[0].place = (board_place){.bytes = RAW_BYTES, .is_signed = 1};
    uint8_t payload[RAW_BYTES], *out = malloc(13);
    board_put(payload, &table.setpoint[0].place, 12);
    add(&table.written, "left ", (board_part){.form = NUMBER_INTEGER, .number_per_raw = {1.0}});
    add(&table.written, ",",
        (board_part){.form = NUMBER_FIXED, .precision = 1, .number_per_raw = {0.1}});
    add(&table.written, "!\n", (board_part){.form = NUMBER_NONE});
    CHECK(board_text_write(&table, payload, out) == 13 && memcmp(out, "left 12,1.2!\n", 13) == 0);
    free(out);
}

static void a_line_is_refused_where_it_does_not_fit(void)
{
    char literal[BOARD_TEXT_MAX];
    uint8_t *out = malloc(BOARD_TEXT_MAX);
    memset(literal, 'x', sizeof literal);
    literal[6] = '\0';
    board_part part = {.form = NUMBER_INTEGER, .width = BOARD_TEXT_MAX - 6};
    CHECK(written(part, literal, 0, 7, out) == BOARD_TEXT_MAX && out[BOARD_TEXT_MAX - 1] == '7' &&
          out[5] == 'x');
    part.width++;
    CHECK(written(part, literal, 0, 7, out) == 0);
    part.width = BOARD_TEXT_MAX;
    CHECK(written(part, "", 0, 7, out) == BOARD_TEXT_MAX && out[BOARD_TEXT_MAX - 1] == '7');
    part.width = 3 * BOARD_TEXT_MAX;
    CHECK(written(part, "", 0, 7, out) == 0);
    free(out);
}

/* ------------------------------------------------------------------------------ reading */
/* Reads a line of "literal NUMBER end". `@` in the line stands for a zero byte. `raw` is the number
 * times 1000, in four signed bytes. */
static uint32_t read_line(const char *literal, const char *end, const char *line, int64_t *raw)
{
    board_text text = {0};
    board_place place = {.byte = 3, .bytes = RAW_BYTES, .is_signed = 1};
    add(&text, literal,
        (board_part){.form = NUMBER_GENERAL, .place = place, .raw_per_number = 1000.0});
    if (end != NULL) {
        add(&text, end, (board_part){.form = NUMBER_NONE});
    }
    text.part[text.part_count].literal_bytes = 1; /* a part beyond the count */
    uint32_t count = (uint32_t)strlen(line), nul = (uint32_t)strcspn(line, "@");
    uint8_t *bytes = malloc(count > 0 ? count : 1), payload[3 + RAW_BYTES] = {0};
    memcpy(bytes, line, count);
    if (nul < count) {
        bytes[nul] = 0;
    }
    uint32_t used = board_text_read(&text, bytes, count, payload);
    free(bytes);
    *raw = board_get(payload, &place);
    return used;
}

static const struct {
    const char *text;
    int64_t raw;
} NUMBERS[] = {
    {"0", 0},
    {"7", 7000},
    {"19", 19000},
    {"+7", 7000},
    {"-7", -7000},
    {"2.5", 2500},
    {"-2.5", -2500},
    {".5", 500},
    {"5.", 5000},
    {"0.0014", 1},
    {"0.0016", 2},
    {"0.0045", 4},
    {"0.0065", 6},
    {"1e2", 100000},
    {"1E2", 100000},
    {"1e+2", 100000},
    {"25e-1", 2500},
    {"2.5e1", 25000},
    {"250e-2", 2500},
    {"1e-9", 0},
    {"1e0", 1000},
    {"3e00001", 30000},
    {"1e-999", 0},
    {"9e18", INT32_MAX},
    {"-9e18", INT32_MIN},
    {"2147483.647", INT32_MAX},
    {"1.25e-1", 125},
    {"90", 90000},
    {"09", 9000},
    {"4e1", 40000},
};

static void numbers_are_read_in_every_usual_form_and_held_within_their_place(void)
{
    int64_t raw;
    for (size_t i = 0; i < sizeof NUMBERS / sizeof NUMBERS[0]; i++) {
        CHECK(read_line("", NULL, NUMBERS[i].text, &raw) == 3 + RAW_BYTES && raw == NUMBERS[i].raw);
    }
}

static void text_that_is_no_number_is_refused(void)
{
    static const char *const BAD[] = {"",    "-",   "+",   ".",    "-.",    "e5",     "x",
                                      "--1", "+-1", "1e",  "1e+",  "1e-",   "1ex",    "1.2.3",
                                      "1 2", "nan", "inf", "0x10", "1e999", "-1e999", "1e400",
                                      "1,5", "1:",  "1/",  "1@",   "@1",    "1@5",    "1\x01"};
    int64_t raw;
    for (size_t i = 0; i < sizeof BAD / sizeof BAD[0]; i++) {
        CHECK(read_line("", NULL, BAD[i], &raw) == 0);
    }
}

/* The value of the exponent is beyond any double; the digits bring the number back into the
 * range. */
static void an_exponent_is_read_up_to_the_range_of_numbers(void)
{
    char line[BOARD_TEXT_MAX + 1] = "0.";
    int64_t raw;
    memset(line + 2, '0', 99);
    strcpy(line + 101, "5e101");
    CHECK(read_line("", NULL, line, &raw) > 0 && raw == 50000);
    strcpy(line + 101, "5e99999999999");
    CHECK(read_line("", NULL, line, &raw) > 0 && raw == INT32_MAX);
}

static const struct {
    const char *literal, *end, *line;
    bool fits;
} LINES[] = {
    {"v=", NULL, "v=5", true},
    {"v=", NULL, "v5", false},
    {"v=", NULL, "w=5", false},
    {"v=", NULL, "v", false},
    {"v=", NULL, "", false},
    {"v=", NULL, "v=", false},
    {"v=", NULL, " \tv=5\r\n", true},
    {"v=", NULL, "v=5 x", false},
    {"v=", NULL, "v =5", false},
    {"a b", NULL, "a b5", true},
    {"a b", NULL, "a  \t b5", true},
    {"a  b", NULL, "a b5", true},
    {"a b", NULL, "ab5", false},
    {"a ", NULL, "a5", false},
    {"a ", NULL, "a 5", true},
    {"a\tb", NULL, "a\vb5", true},
    {"a\nb", NULL, "a\fb5", true},
    {"a\rb", NULL, "a\rb5", true},
    {" a", NULL, "a5", true},
    {" ", NULL, "5", true},
    {"  a b", NULL, "a b5", true},
    {"a b", NULL,
     "a\x0e"
     "b5",
     false},
    {"a b", NULL,
     "a\x08"
     "b5",
     false},
    {"", ";", "5;", true},
    {"", ";", "5", false},
    {"", ";", "5;;", false},
    {"", " m", "5 m", true},
    {"", " m", "5m", false},
    {"", " m ", "5 m", true},
    {"", "\r\n", "5", true},
    {"", " ", "5", true},
    {"", " m s", "5 m s", true},
    {"", " m s", "5 ms", false},
    {"", "m ", "5m \n", true},
    {"", "ex", "5ex", true},
    {"", "e+x", "5e+x", true},
};

static void any_white_space_matches_and_is_optional_at_the_ends(void)
{
    int64_t raw;
    for (size_t i = 0; i < sizeof LINES / sizeof LINES[0]; i++) {
        uint32_t used = read_line(LINES[i].literal, LINES[i].end, LINES[i].line, &raw);
        CHECK(used == (LINES[i].fits ? 3U + RAW_BYTES : 0U));
        CHECK(!LINES[i].fits || raw == 5000);
    }
}

static uint32_t read_text(const board_text *text, const char *line, uint8_t *payload)
{
    return board_text_read(text, (const uint8_t *)line, (uint32_t)strlen(line), payload);
}

static void each_number_goes_to_its_place_and_the_length_ends_with_the_last_place(void)
{
    board_text text = {0};
    const board_place far = {.byte = 6, .bytes = 2}, near = {.byte = 1, .bytes = 1, .is_signed = 1};
    add(&text, "<", (board_part){.form = NUMBER_INTEGER, .place = far, .raw_per_number = 1.0});
    add(&text, " ", (board_part){.form = NUMBER_INTEGER, .place = near, .raw_per_number = -2.0});
    add(&text, ">", (board_part){.form = NUMBER_NONE});
    uint8_t payload[8] = {0};
    CHECK(read_text(&text, "<65536 30>", payload) == 8);
    CHECK(board_get(payload, &far) == 65535 && board_get(payload, &near) == -60);
    CHECK(read_text(&text, "<-1 -99>", payload) == 8);
    CHECK(board_get(payload, &far) == 0 && board_get(payload, &near) == 127);
    text.part[1].place = far, text.part[0].place = near; /* swapped */
    CHECK(read_text(&text, "<-1 -99>", payload) == 8);
    /* the last byte moves from 7 to 3 */
    text.part[1].place = (board_place){.byte = 2, .bytes = 2, .is_signed = 1};
    CHECK(read_text(&text, "<-1 -99>", payload) == 4);
    board_text without = {0};
    add(&without, "ok", (board_part){.form = NUMBER_NONE});
    CHECK(read_text(&without, "ok", payload) == 0); /* a line without numbers */
}

int main(void)
{
    a_number_is_written_in_the_form_of_its_part();
    parts_follow_one_another_each_after_its_own_text();
    a_line_is_refused_where_it_does_not_fit();
    numbers_are_read_in_every_usual_form_and_held_within_their_place();
    text_that_is_no_number_is_refused();
    an_exponent_is_read_up_to_the_range_of_numbers();
    any_white_space_matches_and_is_optional_at_the_ends();
    each_number_goes_to_its_place_and_the_length_ends_with_the_last_place();
    return checks_report("test_board_text");
}
