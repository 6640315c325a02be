/* SPDX-License-Identifier: Apache-2.0
 * How a line ends whose drives do not acknowledge their power-off: it counts when a read behind it says so. */
#include "line_wire.h"

static const int64_t END_NS = 480 * 1000000;

/* Drives whose status says whether they have power; `reports` false: it says nothing of it. */
static void begin_unanswered(uint32_t drives, bool reports)
{
    begin_with(drives, 0);
    w.powered_by_turning = true;
    for (uint32_t i = 0; i < drives; i++) {
        line_drive *table = &w.table.drive[i];
        for (uint32_t f = 0; f < table->disarm_count; f++) {
            table->disarm[f].reply_bytes = table->disarm[f].echo_bytes = table->disarm[f].has_exceptions = 0;
            table->disarm[f].reply_seal = SEAL_NONE;
        }
        table->cyclic[1].field[1] = (line_field){.joint = i,
                                                 .kind = FIELD_ENABLED,
                                                 .byte = 3,
                                                 .form = FORM_U16,
                                                 .equals_mask = 0xffff,
                                                 .equals = 200,
                                                 .si_per_raw = 1.0};
        table->cyclic[1].field_count = reports ? 2 : 1;
    }
    CHECK(line_machine_init(&w.machine, &w.table, 0, w.now_ns) == 0);
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

static void a_drive_that_says_it_has_no_power_ends_the_line_after_one_power_off(void)
{
    begin_unanswered(2, true);
    turn();
    uint32_t before[2] = {w.sent_off[0], w.sent_off[1]};
    line_report report = ends(0);
    for (uint32_t i = 0; i < 2; i++) {
        CHECK(report.drive[i].stop_waits == 0 && w.sent_off[i] == before[i] + w.table.drive[i].disarm_count);
    }
    CHECK(w.turning == 0);
}

static void one_that_receives_nothing_for_a_while_gets_it_again_until_it_says_so(void)
{
    begin_unanswered(1, true);
    turn();
    int64_t begun_ns = w.now_ns;
    line_report report = ends(begun_ns + 150 * MS);
    CHECK(w.turning == 0 && report.drive[0].stop_waits == 0);
    CHECK(w.now_ns >= begun_ns + 150 * MS && w.now_ns < begun_ns + END_NS);
}

static void one_that_never_says_so_is_reported_at_the_end_of_the_time(void)
{
    begin_unanswered(2, true);
    turn();
    int64_t begun_ns = w.now_ns;
    line_report report = ends(INT64_MAX);
    CHECK(report.drive[0].stop_waits == 1 && report.drive[1].stop_waits == 0 && w.turning == 1);
    CHECK(w.now_ns >= begun_ns + END_NS && w.now_ns < begun_ns + END_NS + 50 * MS);
    CHECK(w.sent_off[0] > 3 * w.table.drive[0].disarm_count);
}

/* It takes what it is sent, and does not do it. */
static void one_that_says_it_still_has_power_is_reported(void)
{
    begin_unanswered(1, true);
    turn();
    w.keeps_power = true;
    line_report report = ends(0);
    CHECK(report.drive[0].stop_waits == 1 && w.turning == 1);
}

/* Its answer to any read is all that there is to know. */
static void one_that_cannot_say_it_has_to_answer_a_read(void)
{
    for (int cut = 0; cut < 2; cut++) {
        begin_unanswered(1, false);
        turn();
        line_report report = ends(cut ? INT64_MAX : 0);
        CHECK(report.drive[0].stop_waits == (uint32_t)cut && w.turning == (uint32_t)cut);
    }
}

int main(void)
{
    a_drive_that_says_it_has_no_power_ends_the_line_after_one_power_off();
    one_that_receives_nothing_for_a_while_gets_it_again_until_it_says_so();
    one_that_never_says_so_is_reported_at_the_end_of_the_time();
    one_that_says_it_still_has_power_is_reported();
    one_that_cannot_say_it_has_to_answer_a_read();
    return checks_report("line unanswered");
}
