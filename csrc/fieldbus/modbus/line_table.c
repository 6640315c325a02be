/* SPDX-License-Identifier: Apache-2.0
 * line_table.c: checks a line's table. With a good table, no memory outside it is ever read or
 * written. */
#include <math.h>
#include <string.h>

#include "finding.h"
#include "line_machine.h"

static const int64_t PERIOD_MAX_NS = INT64_C(100000000000);

/* Check the packet's head, length and check sum, the room for stuffing, and that its status differs
 * from all others. */
static void check_packet(finding *f, const line_frame *frame)
{
    bool stuffed = frame->request_seal == SEAL_STUFFED;
    uint32_t least = stuffed ? 10 : 6, status = stuffed ? 11 : 6;
    need(f,
         frame->request_bytes >= least &&
             frame->request_bytes <= (stuffed ? 3 * FRAME_BYTES_MAX / 4 - 2 : FRAME_BYTES_MAX),
         "request_bytes");
    need(f, frame->reply_bytes == 0 || frame->reply_bytes >= status, "reply_bytes");
    need(f, frame->reply_bytes == 0 || frame->reply_seal != SEAL_STUFFED || frame->match_bytes >= 5,
         "match");
    need(f, frame->echo_bytes == 0 && frame->exact == 0, "match");
}

static void check_frame(finding *f, const line_frame *frame)
{
    uint32_t sum = rtu_seal_bytes(frame->request_seal);
    bool servo = frame->request_seal == SEAL_SUM || frame->request_seal == SEAL_STUFFED;
    need(f, frame->request_seal <= SEAL_XMODEM || servo, "request_seal");
    need(f,
         frame->reply_seal <= SEAL_CRC8 ||
             (frame->reply_seal == SEAL_WITH_REQUEST && frame->exact != 0) ||
             (servo && frame->reply_seal == frame->request_seal),
         "reply_seal");
    need(f, frame->request_bytes > sum && frame->request_bytes <= FRAME_BYTES_MAX, "request_bytes");
    if (servo) {
        check_packet(f, frame);
    }
    need(f, frame->reply_bytes <= FRAME_BYTES_MAX, "reply_bytes");
    need(f, frame->match_bytes <= FRAME_MATCH_MAX, "match_bytes");
    need(f, frame->echo_bytes <= frame->request_bytes, "echo_bytes");
    if (frame->exact != 0) {
        bool sealed = frame->reply_seal == SEAL_WITH_REQUEST && frame->request_bytes >= 2 &&
                      frame->reply_bytes > 2;
        bool known = frame->match_bytes > 0 && frame->match_bytes == frame->reply_bytes &&
                     frame->echo_bytes == 0;
        need(f, sealed || (known && frame->reply_seal == SEAL_NONE), "match");
    } else if (frame->reply_bytes > 0) {
        /* without a beginning that identifies the drive, and a check sum, any bytes would be an
         * answer */
        uint32_t known = frame->echo_bytes > 0 ? frame->echo_bytes : frame->match_bytes;
        need(f, known > 0 && known <= frame->reply_bytes, "match");
        need(f,
             frame->reply_seal != SEAL_NONE &&
                 frame->reply_bytes > rtu_seal_bytes(frame->reply_seal),
             "reply_seal");
    }
}

bool line_frame_is_good(const line_frame *frame)
{
    char name[FIELD_NAME_BYTES];
    finding f = {.name = name, .path = "", .bad = false};
    check_frame(&f, frame);
    return !f.bad;
}

static bool is_form(uint32_t form)
{
    return form <= FORM_I32_LE || rtu_sign_of(form) != 0;
}

/* Check that all numbers fit the form: another one would go out as a wrong number, even with the
 * opposite sign. */
static void check_range(finding *f, const line_setpoint *setpoint)
{
    bool form_has_sign = (setpoint->form & 1) != 0;
    double span = ldexp(1.0, (int)(8 * rtu_form_bytes(setpoint->form))),
           sign = (double)rtu_sign_of(setpoint->form);
    double least = form_has_sign ? -span / 2.0 : 0.0,
           most = form_has_sign ? span / 2.0 - 1.0 : span - 1.0;
    if (sign > 0.0) { /* -0 is no separate number, so the magnitude has one less */
        least = 1.0 - sign, most = sign - 1.0;
    }
    check_span(f, setpoint->kind, setpoint->raw_offset, setpoint->raw_min, setpoint->raw_max,
               setpoint->raw_per_s);
    need(f, setpoint->raw_min >= least, "setpoint.raw_min");
    need(f, setpoint->raw_max <= most, "setpoint.raw_max");
}

static void check_setpoint(finding *f, const line_setpoint *setpoint, const line_frame *frame)
{
    uint32_t end = setpoint->byte + rtu_form_bytes(setpoint->form);
    need(f, setpoint->joint < JOINTS_MAX, "setpoint.joint");
    need(f, setpoint->kind <= SETPOINT_POSITION && setpoint->kind != SETPOINT_TORQUE,
         "setpoint.kind");
    need(f, setpoint->kind != SETPOINT_POSITION || setpoint->magnitude == 0, "setpoint.magnitude");
    need(f, is_form(setpoint->form), "setpoint.form");
    need(f,
         setpoint->byte < FRAME_BYTES_MAX &&
             end <= frame->request_bytes - rtu_seal_bytes(frame->request_seal),
         "setpoint.byte");
    need(f, isfinite(setpoint->raw_per_si) && setpoint->raw_per_si != 0.0, "setpoint.raw_per_si");
    if (!f->bad) {
        check_range(f, setpoint);
    }
}

static void check_field(finding *f, const line_field *field, const line_frame *frame)
{
    need(f, field->joint < JOINTS_MAX, "field.joint");
    need(f, field->kind <= FIELD_REFERENCED, "field.kind");
    need(f, is_form(field->form), "field.form");
    need(f,
         field->byte < FRAME_BYTES_MAX &&
             field->byte + rtu_form_bytes(field->form) <= frame->reply_bytes,
         "field.byte");
    need(f, field->direction <= DRIVE_DIRECTIONS_MAX, "field.direction");
    need(f, field->harmless_codes <= FIELD_HARMLESS_MAX, "field.harmless_codes");
    need(f, isfinite(field->si_per_raw), "field.si_per_raw");
}

static void check_exchange(finding *f, const line_exchange *turn)
{
    check_frame(f, &turn->frame);
    need(f, turn->setpoint_count <= EXCHANGE_SETPOINTS_MAX, "setpoint_count");
    need(f, turn->field_count <= EXCHANGE_FIELDS_MAX, "field_count");
    for (uint32_t i = 0; i < turn->setpoint_count && !f->bad; i++) {
        check_setpoint(f, &turn->setpoint[i], &turn->frame);
    }
    for (uint32_t i = 0; i < turn->field_count && !f->bad; i++) {
        check_field(f, &turn->field[i], &turn->frame);
    }
}

static bool has_position(const line_exchange *turn)
{
    for (uint32_t i = 0; i < turn->setpoint_count; i++) {
        if (turn->setpoint[i].kind == SETPOINT_POSITION) {
            return true;
        }
    }
    return false;
}

/* Check positions. A frame with one is not sent while the drive may not move: nothing else may
 * depend on it. */
static void check_positions(finding *f, const line_drive *drive)
{
    for (uint32_t i = 0; !f->bad && i < drive->cyclic_count; i++) {
        if (has_position(&drive->cyclic[i])) {
            need(f, drive->cyclic[i].field_count == 0, "field_count");
            need(f, drive->probe != i + 1 && (drive->probe > 0 || drive->extra_count > 0), "probe");
            need(f, drive->direction_count == 0, "direction_count");
            need(f, drive->idle_count == 0, "idle_count");
        }
    }
}

static void check_counts(finding *f, const line_drive *drive)
{
    need(f, drive->tries >= 1, "tries");
    need(f, drive->extra_every >= 1, "extra_every");
    need(f, drive->period_ns > 0 && drive->period_ns <= PERIOD_MAX_NS, "period_ns");
    need(f, drive->turnaround_ns > 0 && drive->turnaround_ns <= PERIOD_MAX_NS, "turnaround_ns");
    need(f, drive->reply_timeout_ns >= 0 && drive->reply_timeout_ns <= PERIOD_MAX_NS,
         "reply_timeout_ns");
    need(f, drive->watchdog_ns >= 0, "watchdog_ns");
    need(f, drive->cyclic_count >= 1 && drive->cyclic_count <= DRIVE_CYCLIC_MAX, "cyclic_count");
    need(f, drive->extra_count <= DRIVE_EXTRA_MAX, "extra_count");
    need(f, drive->direction_count <= DRIVE_DIRECTIONS_MAX, "direction_count");
    need(f, drive->quick_stop_count <= DRIVE_STOP_MAX, "quick_stop_count");
    need(f, drive->disarm_count <= DRIVE_STOP_MAX, "disarm_count");
    need(f, drive->probe <= drive->cyclic_count, "probe");
    need(f, drive->idle_count <= 1 && drive->idle_count <= drive->cyclic_count, "idle_count");
}

static void check_drive(finding *f, const line_drive *drive)
{
    check_counts(f, drive);
    for (uint32_t i = 0; !f->bad && i < drive->cyclic_count; i++) {
        check_exchange(f, &drive->cyclic[i]);
    }
    for (uint32_t i = 0; !f->bad && i < drive->extra_count; i++) {
        check_exchange(f, &drive->extra[i]);
        need(f, drive->extra[i].setpoint_count == 0, "extra.setpoint_count");
    }
    for (uint32_t i = 0; !f->bad && i < drive->direction_count; i++) {
        need(f, drive->direction[i].joint < JOINTS_MAX && drive->direction[i].kind <= SETPOINT_DUTY,
             "direction.joint");
        check_frame(f, &drive->direction[i].rest);
        check_frame(f, &drive->direction[i].forward);
        check_frame(f, &drive->direction[i].reverse);
    }
    for (uint32_t i = 0; !f->bad && i < drive->quick_stop_count; i++) {
        check_frame(f, &drive->quick_stop[i]);
    }
    for (uint32_t i = 0; !f->bad && i < drive->disarm_count; i++) {
        check_frame(f, &drive->disarm[i]);
    }
    if (!f->bad && drive->idle_count > 0) {
        check_frame(f, &drive->idle[0]);
        need(f, drive->idle[0].reply_bytes == drive->cyclic[0].frame.reply_bytes,
             "idle.reply_bytes");
    }
    check_positions(f, drive);
}

const char *line_table_check(const line_table *table, char *name)
{
    finding f = {.name = name, .path = "", .bad = false};
    need(&f, table->drive_count >= 1 && table->drive_count <= LINE_DRIVES_MAX, "drive_count");
    need(&f, table->echo <= 2, "echo");
    need(&f,
         isfinite(table->character_ns) && table->character_ns > 0.0 && table->character_ns <= 1e8,
         "character_ns");
    need(&f, table->gap_ns >= 0 && table->gap_ns <= PERIOD_MAX_NS, "gap_ns");
    need(&f, table->late_ns >= 0 && table->late_ns <= PERIOD_MAX_NS, "late_ns");
    need(&f, table->setpoint_timeout_ns > 0 && table->setpoint_timeout_ns <= PERIOD_MAX_NS,
         "setpoint_timeout_ns");
    need(&f, isfinite(table->rest_velocity_rad_s) && table->rest_velocity_rad_s > 0.0,
         "rest_velocity_rad_s");
    need(&f, table->broadcast_stop_count <= DRIVE_STOP_MAX, "broadcast_stop_count");
    for (uint32_t i = 0; !f.bad && i < table->broadcast_stop_count; i++) {
        (void)snprintf(f.path, sizeof f.path, "broadcast_stop[%u].", i);
        check_frame(&f, &table->broadcast_stop[i]);
        need(&f, table->broadcast_stop[i].reply_bytes == 0, "reply_bytes");
    }
    for (uint32_t i = 0; !f.bad && i < table->drive_count; i++) {
        (void)snprintf(f.path, sizeof f.path, "drive[%u].", i);
        check_drive(&f, &table->drive[i]);
    }
    need(&f, f.bad || table->group.used == 0 || line_group_is_good(table), "group");
    return f.bad ? name : NULL;
}
