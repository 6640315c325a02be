/* SPDX-License-Identifier: Apache-2.0
 * board_text.c: lines of text by templates, docs/mcu/line-ascii.md. Numbers are written with the
 * decimal point of the "C" locale, which the board's thread has, and are read without a locale. */
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "board_machine.h"

static const int32_t EXPONENT_MAX = 400; /* a longer number does not fit a double */

/* ------------------------------------------------------------------------------ writing */
/* Write printf's format of a part: sign, zeros and form; width and precision are arguments. */
static void format_of(const board_part *part, char *out)
{
    *out++ = '%';
    if (part->sign != 0) {
        *out++ = (char)part->sign;
    }
    if (part->zeros != 0) {
        *out++ = '0';
    }
    const char *rest = part->form == NUMBER_INTEGER ? "*.0f"
                       : part->form == NUMBER_FIXED ? "*.*f"
                                                    : "*.*g";
    (void)strcpy(out, rest);
}

static double number_of(const board_table *table, const board_part *part, const uint8_t *payload)
{
    double number = 0.0;
    for (uint32_t i = 0; i < table->setpoint_count; i++) {
        number += (double)board_get(payload, &table->setpoint[i].place) * part->number_per_raw[i];
    }
    return (part->form == NUMBER_INTEGER ? nearbyint(number) : number) + 0.0; /* -0 + 0 is +0 */
}

static int write_number(const board_table *table, const board_part *part, const uint8_t *payload,
                        char *out, size_t room)
{
    char format[8];
    double number = number_of(table, part, payload);
    format_of(part, format);
    if (part->form == NUMBER_INTEGER) {
        return snprintf(out, room, format, (int)part->width, number);
    }
    return snprintf(out, room, format, (int)part->width, (int)part->precision, number);
}

uint32_t board_text_write(const board_table *table, const uint8_t *payload, uint8_t *out)
{
    const board_text *text = &table->written;
    const uint8_t *literal = text->literal;
    char number[BOARD_TEXT_MAX + 1];
    uint32_t count = 0;
    for (uint32_t i = 0; i < text->part_count; i++) {
        const board_part *part = &text->part[i];
        int size = part->form == NUMBER_NONE
                       ? 0
                       : write_number(table, part, payload, number, sizeof number);
        if (size < 0 || count + part->literal_bytes + (uint32_t)size > BOARD_TEXT_MAX) {
            return 0;
        }
        memcpy(out + count, literal, part->literal_bytes);
        memcpy(out + count + part->literal_bytes, number, (size_t)size);
        literal += part->literal_bytes;
        count += part->literal_bytes + (uint32_t)size;
    }
    return count;
}

/* ------------------------------------------------------------------------------ reading */
static bool is_white(uint8_t byte)
{
    return byte == ' ' || (byte >= '\t' && byte <= '\r');
}

static bool is_digit(const board_reader *r)
{
    return r->at < r->end && *r->at >= '0' && *r->at <= '9';
}

bool board_take_one(board_reader *r, const char *of)
{
    bool found = r->at < r->end && *r->at != 0 && strchr(of, *r->at) != NULL;
    r->at += found;
    return found;
}

void board_skip_white(board_reader *r)
{
    while (r->at < r->end && is_white(*r->at)) {
        r->at++;
    }
}

/* Append digits to a number. Returns their count. */
static int32_t take_digits(board_reader *r, double *number)
{
    int32_t count = 0;
    for (; is_digit(r); r->at++) {
        *number = *number * 10.0 + (*r->at - '0');
        count++;
    }
    return count;
}

/* Take an exponent. An `e` without digits after it does not belong to the number. */
static int32_t take_exponent(board_reader *r)
{
    board_reader ahead = *r;
    double number = 0.0;
    if (!board_take_one(&ahead, "eE")) {
        return 0;
    }
    bool negative = ahead.at < ahead.end && *ahead.at == '-';
    (void)board_take_one(&ahead, "+-");
    if (take_digits(&ahead, &number) == 0) {
        return 0;
    }
    *r = ahead;
    int32_t exponent = (int32_t)fmin(number, (double)EXPONENT_MAX);
    return negative ? -exponent : exponent;
}

bool board_take_number(board_reader *r, double *out)
{
    double number = 0.0;
    bool negative = r->at < r->end && *r->at == '-';
    (void)board_take_one(r, "+-");
    int32_t before = take_digits(r, &number), after = 0;
    if (board_take_one(r, ".")) {
        after = take_digits(r, &number);
    }
    if (before + after == 0) {
        return false;
    }
    int32_t exponent = take_exponent(r) - after;
    number = exponent < 0 ? number / pow(10.0, -exponent) : number * pow(10.0, exponent);
    *out = negative ? -number : number;
    return isfinite(*out);
}

/* Take a literal. Any white space matches any other; at both ends of the text it is optional. */
static bool take_literal(board_reader *r, const uint8_t *literal, uint32_t count, bool first,
                         bool last)
{
    uint32_t i = 0;
    while (i < count) {
        if (!is_white(literal[i])) {
            if (r->at == r->end || *r->at != literal[i]) {
                return false;
            }
            r->at++;
            i++;
            continue;
        }
        bool at_front = first && i == 0;
        while (i < count && is_white(literal[i])) {
            i++;
        }
        if (!at_front && !(last && i == count) && (r->at == r->end || !is_white(*r->at))) {
            return false;
        }
        board_skip_white(r);
    }
    return true;
}

void board_store(const board_part *part, double number, uint8_t *payload, uint32_t *end)
{
    double least = (double)board_raw_min(&part->place), most = (double)board_raw_max(&part->place);
    uint32_t behind = part->place.byte + part->place.bytes;
    board_put(payload, &part->place,
              (int64_t)nearbyint(fmin(fmax(number * part->raw_per_number, least), most)));
    *end = behind > *end ? behind : *end;
}

uint32_t board_text_read(const board_text *text, const uint8_t *line, uint32_t count,
                         uint8_t *payload)
{
    if (text->json != 0) {
        return board_json_read(text, line, count, payload);
    }
    const uint8_t *literal = text->literal;
    board_reader r = {.at = line, .end = line + count};
    uint32_t end = 0;
    board_skip_white(&r);
    for (uint32_t i = 0; i < text->part_count; i++) {
        const board_part *part = &text->part[i];
        double number;
        if (!take_literal(&r, literal, part->literal_bytes, i == 0, part->form == NUMBER_NONE)) {
            return 0;
        }
        literal += part->literal_bytes;
        if (part->form == NUMBER_NONE) {
            continue;
        }
        if (!board_take_number(&r, &number)) {
            return 0;
        }
        board_store(part, number, payload, &end);
    }
    board_skip_white(&r);
    return r.at == r.end ? end : 0;
}
