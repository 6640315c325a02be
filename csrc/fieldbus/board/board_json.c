/* SPDX-License-Identifier: Apache-2.0
 * board_json.c: lines of text that are JSON objects (RFC 8259), read by the names of their members.
 * Members that no part names are skipped. Names are compared byte by byte, so a name with an escape
 * matches no part. */
#include <string.h>

#include "board_machine.h"

static bool is_at(const board_reader *r, const char *of)
{
    return r->at < r->end && *r->at != 0 && strchr(of, *r->at) != NULL;
}

/* Read a string, from one quotation mark to the other. */
static bool take_string(board_reader *r, const uint8_t **begin, uint32_t *count)
{
    if (!board_take_one(r, "\"")) {
        return false;
    }
    *begin = r->at;
    while (r->at < r->end && *r->at != '"') {
        r->at += *r->at == '\\' && r->at + 1 < r->end ? 2 : 1;
    }
    *count = (uint32_t)(r->at - *begin);
    return board_take_one(r, "\"");
}

/* Skip an object or list to its end. */
static bool skip_nested(board_reader *r)
{
    uint32_t depth = 0;
    do {
        const uint8_t *begin;
        uint32_t count;
        if (is_at(r, "\"")) {
            if (!take_string(r, &begin, &count)) {
                return false;
            }
            continue;
        }
        depth += is_at(r, "{[");
        depth -= is_at(r, "}]");
        r->at++;
    } while (depth > 0 && r->at < r->end);
    return depth == 0;
}

static bool skip_value(board_reader *r)
{
    const uint8_t *begin = r->at;
    uint32_t count;
    if (is_at(r, "\"")) {
        return take_string(r, &begin, &count);
    }
    if (is_at(r, "{[")) {
        return skip_nested(r);
    }
    while (r->at < r->end && !is_at(r, ",}] \t")) {
        r->at++;
    }
    return r->at > begin;
}

/* Return the number of the part; part_count: no part has this name. */
static uint32_t find(const board_text *text, const uint8_t *name, uint32_t count)
{
    const uint8_t *literal = text->literal;
    uint32_t i = 0;
    while (i < text->part_count &&
           (text->part[i].literal_bytes != count || memcmp(literal, name, count) != 0)) {
        literal += text->part[i++].literal_bytes;
    }
    return i;
}

static bool take_member(board_reader *r, const board_text *text, uint32_t *seen, uint8_t *payload,
                        uint32_t *end)
{
    const uint8_t *name;
    uint32_t count;
    double number;
    board_skip_white(r);
    if (!take_string(r, &name, &count)) {
        return false;
    }
    board_skip_white(r);
    if (!board_take_one(r, ":")) {
        return false;
    }
    board_skip_white(r);
    uint32_t i = find(text, name, count);
    if (i == text->part_count) {
        return skip_value(r);
    }
    const board_part *part = &text->part[i];
    if ((*seen >> i & 1) != 0 || !board_take_number(r, &number)) {
        return false;
    }
    *seen |= 1U << i;
    if (part->form == NUMBER_CONSTANT) {
        return number >= part->raw_per_number && number <= part->raw_per_number;
    }
    board_store(part, number, payload, end);
    return true;
}

uint32_t board_json_read(const board_text *text, const uint8_t *line, uint32_t count,
                         uint8_t *payload)
{
    board_reader r = {.at = line, .end = line + count};
    uint32_t seen = 0, end = 0;
    board_skip_white(&r);
    if (!board_take_one(&r, "{")) {
        return 0;
    }
    do {
        if (!take_member(&r, text, &seen, payload, &end)) {
            return 0;
        }
        board_skip_white(&r);
    } while (board_take_one(&r, ","));
    if (!board_take_one(&r, "}")) {
        return 0;
    }
    board_skip_white(&r);
    return r.at == r.end && seen == (1U << text->part_count) - 1 ? end : 0;
}
