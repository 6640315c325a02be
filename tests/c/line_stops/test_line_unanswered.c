/* SPDX-License-Identifier: Apache-2.0
 * The end of a line whose drives do not acknowledge their power-off: a later read has to confirm
 * it. */
#include "line_wire.h"

static const int64_t END_NS = 480 * 1000000;

enum { FIRST = 1 << 0, LAST = 1 << 1, OTHER_STATUS = 0x21, EXTRA = 0x50 };

static void leave_unanswered(line_frame *frame)
{
    frame->reply_bytes = frame->echo_bytes = frame->has_exceptions = 0;
    frame->reply_seal = SEAL_NONE;
}

static line_field power_field(uint32_t joint)
{
    return (line_field){.joint = joint,
                        .kind = FIELD_ENABLED,
                        .byte = 3,
                        .form = FORM_U16,
                        .equals_mask = 0xffff,
                        .equals = 200,
                        .si_per_raw = 1.0};
}

/* Drives whose status reports their power if `reports` is set. `frames`: frames of their power-off
 * that they do not acknowledge. */
static void begin_frames(uint32_t drives, bool reports, uint32_t frames)
{
    begin_with(drives, 0);
    w.unacknowledged = frames;
    for (uint32_t i = 0; i < drives; i++) {
        line_drive *table = &w.table.drive[i];
        for (uint32_t f = 0; f < table->disarm_count; f++) {
            if ((frames >> f & 1) != 0) {
                leave_unanswered(&table->disarm[f]);
            }
        }
        table->cyclic[1].field[1] = power_field(i);
        table->cyclic[1].field_count = reports ? 2 : 1;
    }
    CHECK(line_machine_init(&w.machine, &w.table, 0, w.now_ns) == 0);
}

static void begin_unanswered(uint32_t drives, bool reports)
{
    begin_frames(drives, reports, FIRST | LAST);
}

static void turn(void)
{
    for (uint32_t i = 0; i < w.table.drive_count; i++) {
        arm(i);
        w.turning |= 1U << i;
    }
    for (uint32_t i = 0; i < 200; i++) {
        go_on();
    }
    CHECK(w.machine.drive[0].state.mode == DRIVE_ARMED);
}

static line_report ends(int64_t cut_until_ns)
{
    line_report report;
    w.machine.control.shut_down = 1;
    for (uint32_t i = 0; i < 5000 && w.machine.end.stage != END_SILENT; i++) {
        w.dead = w.now_ns < cut_until_ns ? 1 : 0;
        go_on();
    }
    CHECK(w.machine.end.stage == END_SILENT);
    line_machine_report(&w.machine, &report);
    return report;
}

static void a_drive_that_reports_no_power_ends_the_line_after_one_power_off(void)
{
    begin_unanswered(2, true);
    turn();
    uint32_t before[2] = {w.sent_off[0], w.sent_off[1]};
    line_report report = ends(0);
    for (uint32_t i = 0; i < 2; i++) {
        CHECK(report.drive[i].stop_waits == 0 &&
              w.sent_off[i] == before[i] + w.table.drive[i].disarm_count);
    }
    CHECK(w.turning == 0);
}

static void
a_drive_that_receives_nothing_for_a_while_gets_its_power_off_until_it_reports_no_power(void)
{
    begin_unanswered(1, true);
    turn();
    int64_t begun_ns = w.now_ns;
    line_report report = ends(begun_ns + 150 * MS);
    CHECK(w.turning == 0 && report.drive[0].stop_waits == 0);
    CHECK(w.now_ns >= begun_ns + 150 * MS && w.now_ns < begun_ns + END_NS);
}

static void a_drive_that_never_reports_no_power_is_named_in_the_end(void)
{
    begin_unanswered(2, true);
    turn();
    int64_t begun_ns = w.now_ns;
    line_report report = ends(INT64_MAX);
    CHECK(report.drive[0].stop_waits == 1 && report.drive[1].stop_waits == 0 && w.turning == 1);
    CHECK(w.now_ns >= begun_ns + END_NS && w.now_ns < begun_ns + END_NS + 50 * MS);
    CHECK(w.sent_off[0] > 3 * w.table.drive[0].disarm_count);
}

/* The drive receives requests, but does not carry them out. */
static void a_drive_that_reports_power_at_the_end_is_named(void)
{
    begin_unanswered(1, true);
    turn();
    w.keeps_power = true;
    line_report report = ends(0);
    CHECK(report.drive[0].stop_waits == 1 && w.turning == 1);
}

/* Without reported power, an answer to any read is the only evidence. */
static void a_drive_that_cannot_report_its_power_has_to_answer_a_read(void)
{
    for (int cut = 0; cut < 2; cut++) {
        begin_unanswered(1, false);
        turn();
        line_report report = ends(cut ? INT64_MAX : 0);
        CHECK(report.drive[0].stop_waits == (uint32_t)cut && w.turning == (uint32_t)cut);
    }
}

static void an_unacknowledged_frame_of_a_power_off_suffices_when_a_read_confirms_it(void)
{
    for (uint32_t frame = 0; frame < 2; frame++) {
        begin_frames(1, true, 1U << frame);
        turn();
        line_report report = ends(w.now_ns + 150 * MS);
        CHECK(w.turning == 0 && report.drive[0].stop_waits == 0);
    }
}

/* Looks until the end sends a frame that is not a power-off; returns it. */
static const uint8_t *next_read(void)
{
    for (uint32_t looks = 0; looks < 200; looks++) {
        go_on();
        const uint8_t *request = w.machine.transaction.frame.request;
        if (w.out.send != NULL && w.machine.work == WORK_STOP && request[3] != CONTROL &&
            request[3] != RELEASE) {
            return request;
        }
    }
    CHECK(false);
    return w.bytes;
}

/* Cases: each frame of the power-off, also the one before an acknowledged one. */
static void while_it_reports_power_it_gets_each_unanswered_frame_again(void)
{
    for (uint32_t frame = 0; frame < 2; frame++) {
        begin_frames(1, true, 1U << frame);
        turn();
        w.keeps_power = true;
        w.machine.control.shut_down = 1;
        (void)next_read();
        go_on();
        CHECK(w.turning == 1);
        w.keeps_power = false;
        line_report report = ends(0);
        CHECK(w.turning == 0 && report.drive[0].stop_waits == 0);
    }
}

static void while_the_line_runs_an_unanswered_power_off_is_sent_once(void)
{
    begin_unanswered(1, true);
    turn();
    uint32_t before = w.sent_off[0];
    request(0, DRIVE_OFF);
    for (int64_t end_ns = w.now_ns + 500 * MS; w.now_ns < end_ns;) {
        go_on();
    }
    CHECK(w.machine.drive[0].state.stop == STOP_NOTHING &&
          w.sent_off[0] == before + w.table.drive[0].disarm_count);
}

static void reports_from_before_another_power_off_do_not_count(void)
{
    line_report report;
    begin_unanswered(1, true);
    turn();
    w.keeps_power = true;
    w.machine.control.shut_down = 1;
    (void)next_read();
    go_on();
    line_machine_report(&w.machine, &report);
    CHECK(report.drive[0].enabled == 1);
    (void)next_read();
    line_machine_report(&w.machine, &report);
    CHECK(report.drive[0].enabled == 2);
}

/* The drive refuses the read twice, then reports power, and so on: only refusals in a row count. */
static void a_read_that_is_refused_at_times_is_repeated(void)
{
    begin_unanswered(1, true);
    w.turning = 1;
    w.machine.control.shut_down = 1;
    for (uint32_t reads = 1; reads <= 6; reads++) {
        w.keeps_power = reads < 6;
        w.refused = reads % 3 != 0 ? STATUS : 0;
        (void)next_read();
    }
    line_report report = ends(0);
    CHECK(w.refusals == 4 && w.turning == 0 && report.drive[0].stop_waits == 0);
}

/* Sets up a read, a write, a read and two extra reads, each of its own register. `place`: index, in
 * this order, of the one that reports power; 5: no such one. */
static void begin_reads(uint32_t place, uint32_t probe, uint32_t extra_count)
{
    begin_unanswered(1, false);
    line_drive *table = &w.table.drive[0];
    line_exchange write = table->cyclic[0], read = table->cyclic[1];
    line_exchange *turns[] = {&table->cyclic[0], &table->cyclic[1], &table->cyclic[2],
                              &table->extra[0], &table->extra[1]};
    const uint8_t registers[] = {STATUS, SPEED, OTHER_STATUS, EXTRA, EXTRA + 1};
    for (uint32_t i = 0; i < 5; i++) {
        *turns[i] = registers[i] == SPEED ? write : read;
        turns[i]->frame = frame_of(1, registers[i] == SPEED ? WRITE : READ, registers[i],
                                   registers[i] == SPEED ? 77 : 1);
        if (i == place) {
            turns[i]->field[0] = power_field(0);
        }
    }
    table->cyclic_count = 3;
    table->extra_count = extra_count;
    table->probe = probe;
    CHECK(line_machine_init(&w.machine, &w.table, 0, w.now_ns) == 0);
    w.turning = 1;
    w.machine.control.shut_down = 1;
}

static void the_first_read_with_power_is_used_or_else_the_probe(void)
{
    const struct {
        uint32_t place, probe, extra_count, reads;
    } cases[] = {{0, 3, 2, STATUS},    {2, 1, 2, OTHER_STATUS}, {3, 1, 2, EXTRA},
                 {4, 1, 2, EXTRA + 1}, {4, 3, 1, OTHER_STATUS}, {5, 3, 2, OTHER_STATUS},
                 {5, 1, 2, STATUS},    {5, 2, 2, SPEED},        {5, 0, 2, EXTRA},
                 {5, 0, 0, STATUS}};
    for (uint32_t i = 0; i < sizeof cases / sizeof cases[0]; i++) {
        for (int keeps = 0; keeps < 2; keeps++) {
            begin_reads(cases[i].place, cases[i].probe, cases[i].extra_count);
            w.keeps_power = keeps != 0;
            bool says = cases[i].reads != SPEED && i < 4;
            const uint8_t *request = next_read();
            CHECK(request[3] == cases[i].reads &&
                  request[1] == (cases[i].reads == SPEED ? WRITE : READ));
            line_report report = ends(0);
            CHECK(report.drive[0].stop_waits == (says && keeps) && w.motion_sent == 0);
        }
    }
}

/* A target cannot serve as a probe, because the position of the joint is unknown. */
static void no_position_is_sent_to_probe_a_drive(void)
{
    begin_reads(5, 0, 1);
    line_drive *table = &w.table.drive[0];
    table->cyclic[0] = table->cyclic[1];
    table->cyclic[0].setpoint[0].kind = SETPOINT_POSITION;
    table->cyclic[0].setpoint[0].raw_per_s = 1000.0;
    table->cyclic_count = 1;
    CHECK(line_machine_init(&w.machine, &w.table, 0, w.now_ns) == 0);
    w.machine.control.shut_down = 1;
    CHECK(next_read()[3] == EXTRA);
    CHECK(ends(0).drive[0].stop_waits == 0 && w.motion_sent == 0);
}

int main(void)
{
    an_unacknowledged_frame_of_a_power_off_suffices_when_a_read_confirms_it();
    while_it_reports_power_it_gets_each_unanswered_frame_again();
    while_the_line_runs_an_unanswered_power_off_is_sent_once();
    reports_from_before_another_power_off_do_not_count();
    a_read_that_is_refused_at_times_is_repeated();
    the_first_read_with_power_is_used_or_else_the_probe();
    no_position_is_sent_to_probe_a_drive();
    a_drive_that_reports_no_power_ends_the_line_after_one_power_off();
    a_drive_that_receives_nothing_for_a_while_gets_its_power_off_until_it_reports_no_power();
    a_drive_that_never_reports_no_power_is_named_in_the_end();
    a_drive_that_reports_power_at_the_end_is_named();
    a_drive_that_cannot_report_its_power_has_to_answer_a_read();
    return checks_report("line unanswered");
}
