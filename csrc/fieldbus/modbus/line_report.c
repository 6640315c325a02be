/* SPDX-License-Identifier: Apache-2.0
 * line_report.c: the line's report. */
#include "line_machine.h"

void line_machine_report(const line_machine *m, line_report *report)
{
    report->echo = m->echo;
    report->shut_down = m->end.stage == END_SILENT;
    report->exchanges = m->exchanges;
    report->answers = m->answers;
    report->noise_bytes = m->noise_bytes;
    report->setpoints_ns = m->newest.stamp_ns;
    for (uint32_t j = 0; j < JOINTS_MAX; j++) {
        report->fault_word[j] = m->joint[j].fault_word;
    }
    for (uint32_t i = 0; i < LINE_DRIVES_MAX; i++) {
        const line_drive_state *drive = &m->drive[i];
        drive_report *to = &report->drive[i];
        *to = drive->count;
        to->mode = drive->state.mode;
        to->fault_reasons = drive->state.fault_reasons;
        to->request_seen = drive->state.request_seen;
        to->enabled = drive->state.enabled;
        to->stopping = drive->state.stopping;
        to->sent_motion = drive->state.sent_motion;
        to->may_turn = drive->may_turn;
        to->stop_waits = drive->state.stop != STOP_NOTHING || drive->stop_refused;
        to->failures = drive->failures;
        to->last_failure = drive->last_failure;
        to->last_exception = drive->last_exception;
        to->turnaround_ns = drive->smoothed_ns;
        to->deadline_ns = line_deadline_ns(m, i);
        to->cycle_ns = drive->cycle_ns;
    }
}
