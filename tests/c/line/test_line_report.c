/* SPDX-License-Identifier: Apache-2.0
 * The report of a serial line and of each drive: each field has its own value. */
#include "line_wire.h"

static line_report report;

static void look(void)
{
    memset(&report, 0xEE, sizeof report);
    line_machine_report(&w.machine, &report);
}

static void a_line_reports_what_it_counts(void)
{
    begin_with(1, 0);
    w.machine.echo = 2;
    w.machine.exchanges = 11, w.machine.answers = 12, w.machine.noise_bytes = 13;
    w.machine.newest.stamp_ns = 14;
    for (uint32_t j = 0; j < JOINTS_MAX; j++) {
        w.machine.joint[j].fault_word = 100 + j;
    }
    look();
    CHECK(report.echo == 2 && report.shut_down == 0 && report.exchanges == 11 &&
          report.answers == 12);
    CHECK(report.noise_bytes == 13 && report.setpoints_ns == 14);
    for (uint32_t j = 0; j < JOINTS_MAX; j++) {
        CHECK(report.fault_word[j] == 100 + j);
    }
    for (uint32_t stage = END_NOT; stage <= END_SILENT; stage++) {
        w.machine.end.stage = stage;
        look();
        CHECK(report.shut_down == (stage == END_SILENT));
    }
}

static void fill(line_drive_state *drive, uint32_t n)
{
    drive->count = (drive_report){
        .cycles = n + 20, .exchanges = n + 21, .unresponsive = n + 22, .received_ns = n + 23};
    drive->state = (drive_state){
        .mode = n + 1, .fault_reasons = n + 2, .request_seen = n + 3, .enabled = n + 4};
    drive->state.stopping = n == 0, drive->state.sent_motion = n != 0;
    drive->may_turn = n == 0;
    drive->failures = n + 5, drive->last_failure = n + 6, drive->last_exception = n + 7;
    drive->smoothed_ns = n + 8, drive->deadline_ns = n + 9, drive->cycle_ns = n + 10;
}

static void each_drive_is_reported_separately(void)
{
    begin_with(LINE_DRIVES_MAX, 0);
    for (uint32_t n = 0; n < LINE_DRIVES_MAX; n++) {
        fill(&w.machine.drive[n], n);
    }
    look();
    for (uint32_t n = 0; n < LINE_DRIVES_MAX; n++) {
        const drive_report *to = &report.drive[n];
        CHECK(to->mode == n + 1 && to->fault_reasons == n + 2 && to->request_seen == n + 3 &&
              to->enabled == n + 4);
        CHECK(to->stopping == (n == 0) && to->sent_motion == (n != 0) && to->may_turn == (n == 0));
        CHECK(to->failures == n + 5 && to->last_failure == n + 6 && to->last_exception == n + 7);
        CHECK(to->turnaround_ns == n + 8 && to->deadline_ns == n + 9 && to->cycle_ns == n + 10);
        CHECK(to->cycles == n + 20 && to->exchanges == n + 21 && to->unresponsive == n + 22 &&
              to->received_ns == n + 23);
    }
    w.machine.table.drive[1].reply_timeout_ns = 200 * MS; /* set in the robot file, so it is the one
                                                             in use */
    look();
    CHECK(report.drive[0].deadline_ns == 9 && report.drive[1].deadline_ns == 200 * MS);
}

static void a_stop_is_pending_until_it_is_confirmed_also_after_a_refusal(void)
{
    for (int what = 0; what < 3; what++) {
        begin_with(1, 0);
        w.machine.drive[0].state.stop = what == 1 ? STOP_POWER_OFF : STOP_NOTHING;
        w.machine.drive[0].stop_refused = what == 2;
        look();
        CHECK(report.drive[0].stop_waits == (what != 0));
    }
}

int main(void)
{
    a_line_reports_what_it_counts();
    each_drive_is_reported_separately();
    a_stop_is_pending_until_it_is_confirmed_also_after_a_refusal();
    return checks_report("line report");
}
