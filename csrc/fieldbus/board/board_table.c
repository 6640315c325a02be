/* SPDX-License-Identifier: Apache-2.0
 * board_table.c: checks a board's table. With a good table, no memory outside it is ever read or
 * written. */
#include <math.h>
#include <string.h>

#include "board_machine.h"
#include "finding.h"

static const int64_t PERIOD_MAX_NS = INT64_C(100000000000);
static const double NUMBER_MAX = 1e15; /* every integer up to this is a double */
static const uint32_t WIDTH_MAX = 99;

static void check_place(finding *f, const board_place *place, uint32_t bytes)
{
    need(f, place->bytes >= 1 && place->bytes <= 6, "place.bytes");
    need(f, place->byte < BOARD_PAYLOAD_MAX && place->byte + place->bytes <= bytes, "place.byte");
    need(f, place->is_signed <= 1, "place.is_signed");
}

static void check_setpoint(finding *f, const board_setpoint *setpoint, uint32_t bytes)
{
    const board_place *place = &setpoint->place;
    check_place(f, place, bytes);
    if (!f->bad) {
        check_scale(f, &setpoint->scale, SETPOINT_DUTY, (double)board_raw_min(place),
                    (double)board_raw_max(place));
    }
}

static void check_write(finding *f, const board_write *write, uint32_t bytes)
{
    check_place(f, &write->place, bytes);
    if (!f->bad) {
        need(f,
             write->raw >= board_raw_min(&write->place) &&
                 write->raw <= board_raw_max(&write->place),
             "write.raw");
    }
}

bool board_write_is_good(const board_write *write, uint32_t payload_bytes)
{
    char name[FIELD_NAME_BYTES];
    finding f = {.name = name, .path = "", .bad = false};
    check_write(&f, write, payload_bytes);
    return !f.bad;
}

static void check_field(finding *f, const board_field *field, uint32_t bytes)
{
    check_place(f, &field->place, bytes);
    check_meaning(f, &field->meaning, FIELD_KEPT);
}

/* Check that a part's largest value is still written exactly. */
static void check_written(finding *f, const board_part *part, const board_table *table)
{
    double most = 0.0;
    for (uint32_t i = 0; i < table->setpoint_count; i++) {
        const board_setpoint *setpoint = &table->setpoint[i];
        most +=
            fabs(part->number_per_raw[i]) * fmax(setpoint->scale.raw_max, -setpoint->scale.raw_min);
    }
    need(f, most <= NUMBER_MAX, "part.number_per_raw");
    need(f, part->sign == 0 || part->sign == '+' || part->sign == ' ', "part.sign");
    need(f, part->zeros <= 1, "part.zeros");
    need(f, part->width <= WIDTH_MAX && part->precision <= WIDTH_MAX, "part.width");
}

/* Whether this byte ends a number: no number contains it. */
static bool parts_number(uint8_t byte)
{
    return !((byte >= '0' && byte <= '9') || byte == '.' || byte == 'e' || byte == 'E');
}

static void check_read(finding *f, const board_text *text, uint32_t number, uint32_t literal,
                       uint32_t bytes)
{
    const board_part *part = &text->part[number];
    bool after_number = number > 0 && text->part[number - 1].form != NUMBER_NONE;
    need(f, !after_number || (part->literal_bytes > 0 && parts_number(text->literal[literal])),
         "part.literal_bytes");
    need(f, isfinite(part->raw_per_number), "part.raw_per_number");
    if (part->form != NUMBER_NONE) {
        check_place(f, &part->place, bytes);
    }
}

/* Check the names of members, which have no escapes. */
static void check_json(finding *f, const board_text *text, uint32_t number, uint32_t literal,
                       uint32_t bytes)
{
    const board_part *part = &text->part[number];
    const uint8_t *name = text->literal + literal;
    need(f, part->form != NUMBER_NONE, "part.form");
    need(f,
         part->literal_bytes > 0 && memchr(name, '"', part->literal_bytes) == NULL &&
             memchr(name, '\\', part->literal_bytes) == NULL,
         "part.literal_bytes");
    need(f, isfinite(part->raw_per_number), "part.raw_per_number");
    if (part->form != NUMBER_CONSTANT) {
        check_place(f, &part->place, bytes);
    }
}

static void check_text(finding *f, const board_table *table, const board_text *text)
{
    uint32_t literal = 0;
    need(f, text->part_count <= BOARD_PARTS_MAX, "part_count");
    need(f, text->json == 0 || (text->json == 1 && text == &table->read), "json");
    for (uint32_t i = 0; !f->bad && i < text->part_count; i++) {
        const board_part *part = &text->part[i];
        uint32_t most = text->json != 0 ? NUMBER_CONSTANT : NUMBER_GENERAL;
        need(f, part->form <= most && (part->form != NUMBER_NONE || i + 1 == text->part_count),
             "part.form");
        need(f,
             part->literal_bytes <= BOARD_TEXT_MAX &&
                 literal + part->literal_bytes <= BOARD_TEXT_MAX,
             "part.literal_bytes");
        if (!f->bad && text->json != 0) {
            check_json(f, text, i, literal, table->feedback_bytes);
        } else if (!f->bad && text == &table->read) {
            check_read(f, text, i, literal, table->feedback_bytes);
        } else if (!f->bad) {
            check_written(f, part, table);
        }
        literal += part->literal_bytes;
    }
}

static void check_counts(finding *f, const board_table *table)
{
    need(f, table->dialect <= BOARD_SABERTOOTH, "dialect");
    need(f, table->mixed <= 1, "mixed");
    need(f, table->answers <= 1, "answers");
    need(f, table->answers == 1 || table->field_count == 0, "field_count");
    need(f, table->tries >= 1, "tries");
    need(f, table->payload_bytes >= 1 && table->payload_bytes <= BOARD_PAYLOAD_MAX,
         "payload_bytes");
    need(f, table->feedback_bytes <= BOARD_PAYLOAD_MAX, "feedback_bytes");
    need(f, table->setpoint_count >= 1 && table->setpoint_count <= BOARD_SETPOINTS_MAX,
         "setpoint_count");
    need(f, table->field_count <= BOARD_FIELDS_MAX, "field_count");
    need(f, table->quick_stop_count <= BOARD_WRITES_MAX, "quick_stop_count");
    need(f, table->disarm_count <= BOARD_WRITES_MAX, "disarm_count");
    need(f, table->period_ns > 0 && table->period_ns <= PERIOD_MAX_NS, "period_ns");
    need(f, table->gap_ns >= 0 && table->gap_ns <= PERIOD_MAX_NS, "gap_ns");
    need(f, table->silence_ns > 0 && table->silence_ns <= PERIOD_MAX_NS, "silence_ns");
    need(f, table->setpoint_timeout_ns > 0 && table->setpoint_timeout_ns <= PERIOD_MAX_NS,
         "setpoint_timeout_ns");
    need(f, isfinite(table->rest_velocity_rad_s) && table->rest_velocity_rad_s > 0.0,
         "rest_velocity_rad_s");
    need(f, table->watchdog_ns >= 0, "watchdog_ns");
}

static void check_writes(finding *f, const board_write *write, uint32_t count, uint32_t bytes)
{
    for (uint32_t i = 0; !f->bad && i < count; i++) {
        check_write(f, &write[i], bytes);
    }
}

static void check_imu(finding *f, const board_table *table)
{
    const board_imu *imu = &table->imu;
    need(f, imu->used == 0 || table->dialect <= BOARD_TEXT, "imu.used");
    need(f, imu->axis[0] < 3 && imu->axis[1] < 3 && imu->axis[2] < 3, "imu.axis");
    if (table->dialect == BOARD_TEXT && imu->used != 0) {
        check_place(f, &imu->rate_z, table->feedback_bytes);
    }
}

static void check_sabertooths(finding *f, const board_table *table)
{
    uint32_t least = SABERTOOTH_UNIT_MIN;
    need(f, table->unit_count >= 1 && table->unit_count <= SABERTOOTH_UNITS_MAX, "unit_count");
    for (uint32_t i = 0; !f->bad && i < table->unit_count; i++) {
        need(f, table->unit[i] >= least && table->unit[i] <= SABERTOOTH_UNIT_MAX, "unit");
        least = table->unit[i] + 1U;
    }
    need(f, table->payload_bytes == SABERTOOTH_SETPOINT_BYTES * table->unit_count, "payload_bytes");
    need(f, table->answers == 0, "answers");
}

/* Check the sizes of the packets' contents. */
static void check_packets(finding *f, const board_table *table)
{
    if (table->dialect == BOARD_HOVERBOARD) {
        need(f, table->payload_bytes == HOVERBOARD_SETPOINT_BYTES, "payload_bytes");
        need(f, table->feedback_bytes == HOVERBOARD_VALUE_BYTES, "feedback_bytes");
        need(f, table->answers == 1, "answers");
    } else {
        check_sabertooths(f, table);
    }
}

static void check_texts(finding *f, const board_table *table)
{
    need(f, table->written.part_count >= 1, "written.part_count");
    need(f, (table->read.part_count > 0) == (table->answers == 1), "read.part_count");
    (void)snprintf(f->path, sizeof f->path, "written.");
    check_text(f, table, &table->written);
    (void)snprintf(f->path, sizeof f->path, "read.");
    check_text(f, table, &table->read);
}

const char *board_table_check(const board_table *table, char *name)
{
    finding f = {.name = name, .path = "", .bad = false};
    check_counts(&f, table);
    for (uint32_t i = 0; !f.bad && i < table->setpoint_count; i++) {
        check_setpoint(&f, &table->setpoint[i], table->payload_bytes);
    }
    for (uint32_t i = 0; !f.bad && i < table->field_count; i++) {
        check_field(&f, &table->field[i], table->feedback_bytes);
    }
    if (!f.bad) {
        check_writes(&f, table->quick_stop, table->quick_stop_count, table->payload_bytes);
        check_writes(&f, table->disarm, table->disarm_count, table->payload_bytes);
    }
    check_imu(&f, table);
    if (!f.bad && table->dialect == BOARD_TEXT) {
        check_texts(&f, table);
    } else if (!f.bad && table->dialect > BOARD_TEXT) {
        check_packets(&f, table);
    } else if (!f.bad) {
        /* the numbers of the received set-points, and their age */
        need(&f, table->answers == 1 && table->feedback_bytes >= 10, "feedback_bytes");
    }
    return f.bad ? name : NULL;
}
