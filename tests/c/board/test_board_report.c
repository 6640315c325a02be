/* SPDX-License-Identifier: Apache-2.0
 * The report of a board's line: each field has its own value. */
#include "board_wire.h"

int main(void)
{
    board_report report;
    begin();
    board_machine *m = &w.machine;
    m->state = (drive_state){.mode = 1,
                             .fault_reasons = 2,
                             .request_seen = 3,
                             .enabled = 4,
                             .epoch = 5,
                             .stopping = true};
    m->stops = 6, m->orders_sent = 7, m->orders_dropped = 8, m->feedback_bytes = 9;
    m->cycle.count = 10, m->sent = 11, m->no_room = 12, m->bad_frames = 13, m->received = 14,
    m->published = 15, m->unresponsive = 16;
    m->cycle.took_ns = 17, m->newest.stamp_ns = 18, m->received_ns = 19, m->knows_ns = 20,
    m->written_ns = 21;
    for (uint32_t j = 0; j < JOINTS_MAX; j++) {
        m->joint[j].fault_word = 100 + j;
    }
    for (uint32_t i = 0; i < sizeof m->feedback_payload; i++) {
        m->feedback_payload[i] = (uint8_t)(i + 1);
    }
    for (uint32_t stage = END_NOT; stage <= END_SILENT; stage++) {
        m->end.stage = stage;
        m->state.stop = stage == END_POWER_OFF ? STOP_QUICK : STOP_NOTHING;
        m->state.sent_motion = stage == END_RESTING;
        memset(&report, 0xEE, sizeof report);
        board_machine_report(m, &report);
        CHECK(report.shut_down == (stage == END_SILENT) &&
              report.stop_waits == (stage == END_POWER_OFF));
        CHECK(report.sent_motion == (stage == END_RESTING));
    }
    CHECK(report.mode == 1 && report.fault_reasons == 2 && report.request_seen == 3 &&
          report.enabled == 4 && report.epoch == 5);
    CHECK(report.stopping == 1 && report.stops == 6 && report.orders_sent == 7 &&
          report.orders_dropped == 8);
    CHECK(report.feedback_bytes == 9 && report.cycles == 10 && report.sent == 11 &&
          report.no_room == 12);
    CHECK(report.bad_frames == 13 && report.received == 14 && report.published == 15 &&
          report.unresponsive == 16);
    CHECK(report.cycle_ns == 17 && report.setpoints_ns == 18 && report.received_ns == 19 &&
          report.knows_ns == 20);
    CHECK(report.written_ns == 21 && memcmp(report.feedback_payload, m->feedback_payload,
                                            sizeof report.feedback_payload) == 0);
    for (uint32_t j = 0; j < JOINTS_MAX; j++) {
        CHECK(report.fault_word[j] == 100 + j);
    }
    return checks_report("board report");
}
