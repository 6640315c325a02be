/* SPDX-License-Identifier: Apache-2.0
 * Lines of controllers whose answers contain no unit and which hold a speed of zero: packets of a
 * RoboClaw. */
#include "line_wire.h"

enum { UNIT = 0x80, SPEEDS = 37, DUTIES = 34, STATE_OF = 90 };

static uint8_t sent[16];
static uint32_t sent_bytes;
static int64_t sent_ns;

static line_frame sent_by(uint8_t unit, uint8_t command)
{
    line_frame frame = {.request_bytes = 6,
                        .reply_bytes = 1,
                        .match_bytes = 1,
                        .match = {0xFF},
                        .request_seal = SEAL_XMODEM,
                        .exact = 1,
                        .request = {unit, command}};
    rtu_seal(frame.request, 6, SEAL_XMODEM);
    return frame;
}

static line_frame asked_by(uint8_t unit)
{
    return (line_frame){.request_bytes = 2,
                        .reply_bytes = 4,
                        .reply_seal = SEAL_WITH_REQUEST,
                        .exact = 1,
                        .request = {unit, STATE_OF}};
}

static void begin_packets(uint32_t drives)
{
    begin_with(drives, 0);
    for (uint32_t i = 0; i < drives; i++) {
        line_drive *drive = &w.table.drive[i];
        uint8_t unit = (uint8_t)(UNIT + i);
        drive->cyclic[0].frame = sent_by(unit, SPEEDS);
        drive->cyclic[0].setpoint[0].byte = 2;
        drive->cyclic[1].frame = asked_by(unit);
        drive->cyclic[1].field[0].byte = 0;
        drive->quick_stop[0] = sent_by(unit, SPEEDS);
        drive->disarm_count = 1;
        drive->disarm[0] = drive->idle[0] = sent_by(unit, DUTIES);
        drive->idle_count = 1;
    }
    CHECK(line_machine_init(&w.machine, &w.table, 0, w.now_ns) == 0);
}

/* Makes one look. `answers`: whether a request gets its answer. `speed`: what the wheels report. */
static void look(bool answers, int16_t speed)
{
    uint32_t enabled = w.machine.newest.enabled;
    w.machine.newest =
        (setpoints){.stamp_ns = w.now_ns, .enabled = enabled, .joint_count = w.table.drive_count};
    w.machine.newest.joint[0].velocity_rad_s = 1.0;
    line_machine_step(&w.machine, w.now_ns, w.bytes, w.count, &w.out);
    w.count = 0;
    if (w.out.send == NULL) {
        w.now_ns = w.out.wake_ns;
        return;
    }
    sent_bytes = w.out.send_bytes;
    sent_ns = w.now_ns;
    memcpy(sent, w.out.send, sent_bytes);
    line_machine_sent(&w.machine, w.now_ns);
    w.now_ns = w.machine.until_ns;
    if (answers) {
        uint8_t whole[4] = {sent[0], sent[1], (uint8_t)((uint16_t)speed >> 8), (uint8_t)speed};
        rtu_write(w.bytes + 2, FORM_U16, rtu_xmodem(0, whole, 4));
        memcpy(w.bytes, whole + 2, 2);
        w.count = sent_bytes == 2 ? 4 : 1;
        w.bytes[0] = sent_bytes == 2 ? w.bytes[0] : 0xFF;
        w.now_ns = w.machine.end_ns + DEVICE_NS;
    }
}

static void look_until_sent(uint8_t command)
{
    sent_bytes = 0;
    for (uint32_t i = 0; i < 100 && !(sent_bytes == 6 && sent[1] == command); i++) {
        look(true, 300);
    }
    CHECK(sent_bytes == 6 && sent[1] == command);
}

static void zero_goes_only_to_motors_that_are_armed_or_coming_to_rest(void)
{
    begin_packets(1);
    w.machine.newest.enabled = 1;
    request(0, DRIVE_READY);
    for (uint32_t i = 0; i < 50; i++) {
        look(true, 0);
        CHECK(sent_bytes <= 2 ||
              (sent_bytes == 6 && sent[1] == DUTIES && rtu_read(sent + 2, FORM_I16) == 0));
    }
    request(0, DRIVE_ARMED);
    look_until_sent(SPEEDS);
    CHECK(rtu_read(sent + 2, FORM_I16) == 100);
    w.machine.control.shut_down = 1;
    look_until_sent(SPEEDS);
    for (uint32_t i = 0; i < 10; i++) {
        /* the drive turns: it is held at zero */
        CHECK(sent_bytes == 2 || (sent[1] == SPEEDS && rtu_read(sent + 2, FORM_I16) == 0));
        look(true, 300);
    }
    look_until_sent(DUTIES);
}

static void a_late_answer_belongs_to_no_request(void)
{
    begin_packets(2);
    request(0, DRIVE_READY);
    request(1, DRIVE_READY);
    for (uint32_t i = 0; i < 20; i++) {
        look(true, 0);
    }
    uint8_t asked = 0xFF;
    while (sent_bytes != 6 || asked == 0xFF) {
        look(false, 0);
        asked = sent[0];
    }
    int64_t failed_ns = w.now_ns, bound_ns = w.machine.bound_ns;
    w.bytes[0] = 0xFF; /* arrives after the time of its request, before another drive is read */
    line_machine_step(&w.machine, w.now_ns, w.bytes, 0, &w.out);
    CHECK(w.out.send == NULL && w.machine.work == WORK_NONE);
    line_machine_step(&w.machine, failed_ns + bound_ns / 2, w.bytes, 1, &w.out);
    CHECK(w.out.send == NULL && w.machine.noise_bytes == 1);
    w.now_ns = failed_ns + bound_ns / 2;
    sent_ns = 0;
    while (sent_ns == 0) {
        look(true, 0);
    }
    CHECK(sent_ns >= failed_ns + bound_ns);
}

static void indistinguishable_packets_are_refused(void)
{
    char name[FIELD_NAME_BYTES];
    begin_packets(1);
    line_frame *frame = &w.table.drive[0].idle[0];
    frame->match_bytes = 0;
    CHECK(line_table_check(&w.table, name) != NULL);
    frame->match_bytes = 1;
    frame->reply_bytes = 2;
    CHECK(line_table_check(&w.table, name) != NULL);
    frame->reply_bytes = 1;
    frame->request_seal = SEAL_WITH_REQUEST;
    CHECK(line_table_check(&w.table, name) != NULL);
    frame->request_seal = SEAL_XMODEM;
    CHECK(line_table_check(&w.table, name) == NULL);
    w.table.drive[0].idle_count = 2;
    CHECK(line_table_check(&w.table, name) != NULL);
    w.table.drive[0].idle_count = 1;
    w.table.drive[0].cyclic[1].frame.exact = 0;
    CHECK(line_table_check(&w.table, name) != NULL);
}

static void a_range_that_does_not_fit_the_register_is_refused(void)
{
    static const struct {
        uint32_t form;
        double least, most;
    } forms[] = {{FORM_U8, 0.0, 255.0},
                 {FORM_I8, -128.0, 127.0},
                 {FORM_U16, 0.0, 65535.0},
                 {FORM_I16, -32768.0, 32767.0}};
    char name[FIELD_NAME_BYTES];
    begin_with(1, 0);
    line_setpoint *setpoint = &w.table.drive[0].cyclic[0].setpoint[0];
    for (uint32_t i = 0; i < 4; i++) {
        setpoint->form = forms[i].form;
        setpoint->raw_min = forms[i].least;
        setpoint->raw_max = forms[i].most;
        CHECK(line_table_check(&w.table, name) == NULL);
        setpoint->raw_max = forms[i].most + 1.0;
        CHECK(line_table_check(&w.table, name) != NULL && strstr(name, "setpoint.raw_max") != NULL);
        setpoint->raw_max = forms[i].most;
        setpoint->raw_min = forms[i].least - 1.0;
        CHECK(line_table_check(&w.table, name) != NULL && strstr(name, "setpoint.raw_min") != NULL);
    }
}

int main(void)
{
    a_range_that_does_not_fit_the_register_is_refused();
    zero_goes_only_to_motors_that_are_armed_or_coming_to_rest();
    a_late_answer_belongs_to_no_request();
    indistinguishable_packets_are_refused();
    return checks_report("line packets");
}
