/* SPDX-License-Identifier: Apache-2.0
 * The end of a CAN line: a power-off that the bus has taken may not have reached the drive. */
#include "can_wire.h"

static const int64_t END_NS = 480 * 1000000, REPORT_END_NS = 980 * 1000000;
static int64_t begun_ns;

/* Shuts the line down and waits until it is silent. The drives send their state each 10 ms, but not
 * before `cut_until_ns`. `obeys_ns`: time in which a drive loses its power after a power-off. */
static can_report ends(int64_t cut_until_ns, int64_t obeys_ns)
{
    can_report report;
    int64_t off_ns = 0;
    begun_ns = w.now_ns;
    w.machine.control.shut_down = 1;
    forget_sent();
    uint32_t looked = 0;
    while (w.machine.end.stage != END_SILENT) {
        CHECK(w.now_ns < begun_ns + 5000 * MS);
        w.silent = w.now_ns < cut_until_ns;
        go_on(MS);
        for (; looked < w.sent_count; looked++) {
            bool off = w.sent[looked].id == SPEED && w.sent[looked].data[0] == DISABLE && !w.silent;
            off_ns = off && off_ns == 0 ? w.now_ns + obeys_ns : off_ns;
        }
        w.powered &= off_ns == 0 || w.now_ns < off_ns;
        w.reported_rad_s = w.powered ? w.reported_rad_s : 0.0;
    }
    can_machine_report(&w.machine, &report);
    return report;
}

static void turn(void)
{
    arm_and_go();
    w.reported_rad_s = 1.0;
    go_on(30 * MS);
}

static uint32_t power_offs(void)
{
    uint32_t count = 0;
    for (uint32_t i = 0; i < w.sent_count; i++) {
        count += w.sent[i].id == SPEED && w.sent[i].data[0] == DISABLE;
    }
    return count;
}

/* The drives are set up and at rest, and report that they have no power. */
static void rest_without_power(void)
{
    arm(0);
    w.powered = false;
    request(0, DRIVE_STAND_DOWN);
    go_on(50 * MS);
}

/* Begins the end and returns whether the line is silent after one step without feedback. */
static bool ends_at_once(void)
{
    begun_ns = w.now_ns;
    w.silent = true;
    w.machine.control.shut_down = 1;
    forget_sent();
    step();
    CHECK(power_offs() == 1);
    return w.machine.end.stage == END_SILENT;
}

static void order_something(void)
{
    can_order order = {.drive = 0, .expires_ns = INT64_MAX, .write = w.table.drive[0].disarm[0]};
    CHECK(can_machine_order(&w.machine, &order));
    step();
    CHECK(state_of(0)->orders_sent == 1);
}

/* Any of the drive's frames may report the power. */
static void a_drive_seen_without_power_gets_one_power_off_and_the_end_does_not_wait_for_it(void)
{
    for (int second = 0; second < 2; second++) {
        begin_with(1);
        if (second) {
            can_input says = table_of(0)->input[0];
            table_of(0)->input[0] = table_of(0)->input[1];
            table_of(0)->input[1] = says;
            table_of(0)->match[0].input = 2;
            table_of(0)->match[1].input = 1;
            restart();
        }
        rest_without_power();
        CHECK(ends_at_once() && state_of(0)->state.stop == STOP_NOTHING);
    }
}

static void the_end_waits_for_a_drive_that_is_being_armed_but_not_when_its_arming_is_over(void)
{
    for (int64_t left_ns = 0; left_ns < 2; left_ns++) {
        begin_with(1);
        rest_without_power();
        w.machine.control.drive[0].arming_until_ns = w.now_ns + left_ns;
        CHECK(ends_at_once() == (left_ns == 0));
    }
}

static void a_drive_that_was_not_set_up_has_to_report_no_power_after_its_power_off(void)
{
    begin_with(1);
    go_on(50 * MS);
    CHECK(state_of(0)->state.mode == DRIVE_OFF && state_of(0)->state.enabled == 0);
    CHECK(!ends_at_once());
    go_on(100 * MS);
    CHECK(w.machine.end.stage == END_POWER_OFF && power_offs() > 1);
    w.silent = false;
    go_on(12 * MS);
    CHECK(w.machine.end.stage == END_SILENT);
}

/* An order has just changed the power: earlier reports prove nothing. */
static void a_drive_that_got_an_order_since_has_to_report_no_power_again(void)
{
    for (int speaks = 0; speaks < 2; speaks++) {
        begin_with(1);
        rest_without_power();
        order_something();
        can_report report = ends(speaks ? 0 : INT64_MAX, 0);
        CHECK(report.drive[0].stop_waits == !speaks && w.now_ns > begun_ns);
    }
}

static void a_report_that_is_not_newer_than_the_order_does_not_suffice(void)
{
    for (int moves = 0; moves < 2; moves++) {
        begin_with(1);
        rest_without_power();
        report_state(0, 1);
        order_something();
        w.now_ns += 10 * MS;
        if (moves) {
            report_motion(0, 1.0F, 0.0F);
        }
        CHECK(!ends_at_once());
    }
    begin_with(1);
    rest_without_power();
    order_something();
    w.now_ns += MS;
    report_state(0, 1);
    CHECK(ends_at_once());
}

static void a_power_off_makes_older_reports_of_power_void(void)
{
    for (uint8_t had = 0; had < 2; had++) {
        begin_with(1);
        go_on(50 * MS);
        report_state(0, had ? 8 : 1);
        CHECK(state_of(0)->state.enabled == had && !ends_at_once());
        can_report report;
        can_machine_report(&w.machine, &report);
        CHECK(report.drive[0].enabled == 2 && report.drive[0].stop_waits == 1);
    }
}

static void a_turning_drive_gets_its_power_off_until_it_reports_no_power(void)
{
    begin_with(1);
    turn();
    can_report report = ends(0, 0);
    CHECK(report.drive[0].stop_waits == 0 && !w.powered && w.now_ns < begun_ns + END_NS);
    begin_with(1);
    turn();
    report = ends(0, 300 * MS); /* the drive needs time, but it sends: the end waits for it */
    CHECK(report.drive[0].stop_waits == 0 && !w.powered && power_offs() > 5 &&
          w.now_ns > begun_ns + END_NS);
}

static void a_drive_that_is_cut_off_for_a_while_gets_its_power_off_when_it_is_back(void)
{
    for (int before = 0; before < 2; before++) {
        begin_with(1);
        turn();
        if (before) {
            become_unresponsive();
        }
        can_report report = ends(w.now_ns + 250 * MS, 0);
        CHECK(report.drive[0].stop_waits == 0 && !w.powered && w.now_ns >= begun_ns + 250 * MS &&
              w.now_ns < begun_ns + END_NS);
    }
}

static void a_drive_that_is_cut_off_or_keeps_its_power_is_reported(void)
{
    for (int before = 0; before < 2; before++) {
        begin_with(1);
        turn();
        if (before) {
            become_unresponsive();
        }
        can_report report = ends(INT64_MAX, 0);
        CHECK(report.drive[0].stop_waits == 1 && w.powered && power_offs() > 10 &&
              power_offs() < 60);
        CHECK(w.now_ns >= begun_ns + END_NS && w.now_ns < begun_ns + END_NS + 20 * MS);
    }
    begin_with(1);
    turn();
    can_report report = ends(0, INT64_MAX / 2);
    /* MS: the pause between two looks */
    CHECK(report.drive[0].stop_waits == 1 && w.now_ns == begun_ns + REPORT_END_NS + MS);
}

/* The second drive cannot report its power: one power-off is enough for it. */
static void the_end_waits_for_a_drive_that_keeps_its_power_whatever_the_others_do(void)
{
    begin_with(2);
    table_of(1)->reports_enabled = 0;
    table_of(1)->input[0].field_count = 0;
    restart();
    turn();
    can_report report = ends(0, INT64_MAX / 2);
    CHECK(report.drive[0].stop_waits == 1 && report.drive[1].stop_waits == 0);
    CHECK(w.now_ns == begun_ns + REPORT_END_NS + MS);
}

static void asyncio_is_notified_of_the_end_even_when_one_drive_is_off_at_once(void)
{
    begin_with(2);
    rest_without_power();
    w.machine.notify = false;
    CHECK(!ends_at_once()); /* the second drive was never set up */
    CHECK(state_of(0)->state.stop == STOP_NOTHING && state_of(1)->state.stop == STOP_POWER_OFF &&
          w.machine.notify);
}

/* The power-off has two frames. The bus does not take the second one at first. */
static void a_power_off_is_repeated_10_ms_after_its_last_frame_was_sent(void)
{
    begin_with(1);
    table_of(0)->disarm_count = 2;
    table_of(0)->disarm[1] = (can_write){.packet = packet_of(CONTROL, 1)};
    restart();
    w.silent = true;
    w.not_taken = CONTROL;
    CHECK(!ends_at_once());
    go_on(15 * MS);
    CHECK(power_offs() == 1 && count_sent(CONTROL) == 0);
    w.not_taken = 0;
    int64_t taken_ns = w.now_ns;
    go_on(25 * MS);
    CHECK(w.sent_count == 6 && power_offs() == 3);
    for (uint32_t i = 1; i < w.sent_count; i++) {
        CHECK(w.sent[i].id == (i % 2 ? CONTROL : SPEED) &&
              w.sent_ns[i] == taken_ns + i / 2 * 10 * MS);
    }
}

static void begin_without_power_in_feedback(void)
{
    begin_with(1);
    w.table.drive[0].reports_enabled = 0;
    w.table.drive[0].input[0].field_count = 0;
    restart();
    turn();
}

static void a_drive_that_cannot_report_its_power_has_to_be_present(void)
{
    begin_with(1);
    w.table.drive[0].reports_enabled = 0;
    w.table.drive[0].input[0].field_count = 0;
    restart();
    rest_without_power();
    CHECK(ends_at_once());
    begin_without_power_in_feedback();
    can_report report = ends(0, 0);
    CHECK(report.drive[0].stop_waits == 0);
    begin_without_power_in_feedback();
    become_unresponsive();
    report = ends(w.now_ns + 100 * MS, 0);
    CHECK(report.drive[0].stop_waits == 0 && !w.powered);
    begin_without_power_in_feedback();
    become_unresponsive();
    report = ends(INT64_MAX, 0);
    CHECK(report.drive[0].stop_waits == 1 && w.now_ns >= begun_ns + END_NS);
}

/* After each power-off the line sends the poll, and the SYNC, on which drives act and send. */
static void frames_that_a_drive_does_not_send_by_itself_are_requested(void)
{
    for (uint32_t hello = 0; hello < 2; hello++) {
        begin_with(1);
        w.table.drive[0].poll_count = w.table.drive[0].probe_count = w.table.sync_count = 1;
        w.table.drive[0].poll[0] = packet_of(0x601, 0);
        w.table.drive[0].probe[0] = packet_of(0x602, 0);
        w.table.sync[0] = packet_of(0x80, 0);
        w.table.drive[0].hello = hello;
        restart();
        turn();
        become_unresponsive();
        (void)ends(INT64_MAX, 0);
        uint32_t count = power_offs();
        CHECK(count > 10 && count_sent(0x601) == count &&
              count_sent(0x602) == (hello ? 0 : count) && count_sent(0x80) == count);
    }
}

int main(void)
{
    a_drive_seen_without_power_gets_one_power_off_and_the_end_does_not_wait_for_it();
    the_end_waits_for_a_drive_that_is_being_armed_but_not_when_its_arming_is_over();
    a_drive_that_was_not_set_up_has_to_report_no_power_after_its_power_off();
    a_drive_that_got_an_order_since_has_to_report_no_power_again();
    a_report_that_is_not_newer_than_the_order_does_not_suffice();
    a_power_off_makes_older_reports_of_power_void();
    a_turning_drive_gets_its_power_off_until_it_reports_no_power();
    a_drive_that_is_cut_off_for_a_while_gets_its_power_off_when_it_is_back();
    a_drive_that_is_cut_off_or_keeps_its_power_is_reported();
    the_end_waits_for_a_drive_that_keeps_its_power_whatever_the_others_do();
    asyncio_is_notified_of_the_end_even_when_one_drive_is_off_at_once();
    a_power_off_is_repeated_10_ms_after_its_last_frame_was_sent();
    a_drive_that_cannot_report_its_power_has_to_be_present();
    frames_that_a_drive_does_not_send_by_itself_are_requested();
    return checks_report("CAN end");
}
