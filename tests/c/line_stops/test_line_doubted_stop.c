/* SPDX-License-Identifier: Apache-2.0
 * test_line_doubted_stop: a stop whose acknowledgements may be answers to older requests, and its
 * effect on other drives. */
#include "line_wire.h"

/* An answer does not name the write that it answers, like those of bus servos. */
static void answer_alike(line_frame *frame)
{
    frame->echo_bytes = 0;
    frame->match_bytes = 2;
    memcpy(frame->match, (const uint8_t[]){1, WRITE}, 2);
}

/* While the stop is repeated, each answer after an unanswered request may belong to that request.
 * Only the answers beyond the number that is owed prove the stop. The neighbour continues in the
 * meantime. */
static void a_stop_with_late_acknowledgements_ends_and_delays_no_neighbour(void)
{
    for (uint32_t i = 0; i < 8; i++) {
        uint32_t owed = i / 2;
        bool after_another = i % 2 != 0; /* the answers to an earlier request prove nothing about
                                            this stop */
        begin_with(2, 0);
        line_drive *table = &w.machine.table.drive[0];
        answer_alike(&table->cyclic[0].frame), answer_alike(&table->quick_stop[0]);
        answer_alike(&table->disarm[0]), answer_alike(&table->disarm[1]);
        arm(0), arm(1);
        for (uint32_t looks = 0; looks < 50 || w.machine.work != WORK_NONE; looks++) {
            go_on();
        }
        w.machine.transaction.frame = table->cyclic[0].frame;
        w.machine.end_ns = w.now_ns;
        for (uint32_t n = 0; n < owed; n++) {
            line_owe(&w.machine, 0);
        }
        if (after_another) {
            line_stop_now(&w.machine, 0, STOP_QUICK);
            while (w.machine.work != WORK_STOP) {
                go_on();
            }
        }
        uint64_t cycles = w.machine.drive[1].count.cycles;
        request(0, DRIVE_STAND_DOWN);
        line_stop_now(&w.machine, 0, STOP_POWER_OFF);
        for (int64_t end_ns = w.now_ns + 1000 * MS; w.now_ns < end_ns;) {
            go_on();
        }
        CHECK(w.machine.drive[0].state.stop == STOP_NOTHING && w.sent_off[0] == 2 * (1 + owed));
        CHECK(w.machine.drive[1].count.cycles > cycles + 30);
    }
}

static void a_neighbour_with_doubtful_answers_does_not_delay_a_stop(void)
{
    begin_with(2, 0);
    line_drive *table = &w.machine.table.drive[0];
    answer_alike(&table->disarm[0]), answer_alike(&table->disarm[1]);
    arm(0), arm(1);
    while (w.machine.work != WORK_NONE) {
        go_on();
    }
    w.machine.transaction.frame = table->disarm[0];
    w.machine.end_ns = w.now_ns;
    for (uint32_t owed = 0; owed < 3; owed++) {
        line_owe(&w.machine, 0);
    }
    for (uint32_t i = 0; i < 2; i++) {
        request(i, DRIVE_STAND_DOWN);
        line_stop_now(&w.machine, i, STOP_POWER_OFF);
    }
    while (w.sent_off[1] < 2) {
        go_on();
    }
    CHECK(w.sent_off[0] == 1);
    for (int64_t end_ns = w.now_ns + 500 * MS; w.now_ns < end_ns;) {
        go_on();
    }
    CHECK(w.machine.drive[0].state.stop == STOP_NOTHING && w.sent_off[0] == 8 &&
          w.sent_off[1] == 2);
}

int main(void)
{
    a_stop_with_late_acknowledgements_ends_and_delays_no_neighbour();
    a_neighbour_with_doubtful_answers_does_not_delay_a_stop();
    return checks_report("line doubted stop");
}
