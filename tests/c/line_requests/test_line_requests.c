/* SPDX-License-Identifier: Apache-2.0
 * Requests from outside the cycle, on a wire in virtual time: which one is sent, in which order,
 * and which reply it gets. */
#include "line_wire.h"

enum { READ_ID = 100, STOP_ID = 200 };

static line_request request_of(uint64_t id, uint32_t drive, bool urgent)
{
    uint8_t unit = (uint8_t)(drive + 1);
    return (line_request){.id = id,
                          .expires_ns = w.now_ns + 1000 * MS,
                          .turnaround_ns = 5 * MS,
                          .drive = drive,
                          .urgent = urgent,
                          .frame = urgent ? frame_of(unit, WRITE, CONTROL, DISABLE)
                                          : frame_of(unit, READ, STATUS, 1)};
}

static void put(line_request request)
{
    CHECK(line_machine_request(&w.machine, &request));
}

/* Makes steps without set-points until a request is answered; returns false if none is within a
 * second. */
static bool step_until_answered(void)
{
    int64_t limit_ns = w.now_ns + 1000 * MS;
    do {
        go_on();
    } while (!w.machine.answered && w.now_ns < limit_ns);
    return w.machine.answered;
}

static bool is_sent(uint8_t unit, uint8_t function, uint8_t address)
{
    const uint8_t *request = w.machine.transaction.frame.request;
    return w.out.send != NULL && request[0] == unit && request[1] == function &&
           request[3] == address;
}

static void an_urgent_request_does_not_interrupt_the_one_on_the_wire(void)
{
    begin_with(2, 0);
    put(request_of(READ_ID, 0, false));
    while (!is_sent(1, READ, STATUS)) {
        go_on();
    }
    put(request_of(STOP_ID, 1, true)); /* while the read is on the wire */
    CHECK(step_until_answered());
    CHECK(w.machine.answer.id == READ_ID && w.machine.answer.kind == ANSWER_OK);
    CHECK(w.machine.answer.reply_bytes == 7 && w.machine.answer.reply[0] == 1);
    CHECK(w.power_offs[1] == 0);
    CHECK(step_until_answered());
    CHECK(w.machine.answer.id == STOP_ID && w.machine.answer.kind == ANSWER_OK);
    CHECK(w.machine.answer.reply_bytes == 8 && w.machine.answer.reply[0] == 2);
    CHECK(w.power_offs[1] == 1);
}

static void the_request_on_the_wire_does_not_expire_behind_an_urgent_one(void)
{
    begin_with(2, 0);
    line_request read = request_of(READ_ID, 0, false);
    read.expires_ns = w.now_ns + 4 * MS;
    put(read);
    while (!is_sent(1, READ, STATUS)) {
        go_on();
    }
    put(request_of(STOP_ID, 1, true));
    /* before its reply arrives */
    line_machine_step(&w.machine, read.expires_ns + MS, w.bytes, 0, &w.out);
    CHECK(!w.machine.answered && w.machine.work == WORK_REQUEST);
    w.now_ns = read.expires_ns + MS;
    CHECK(step_until_answered());
    CHECK(w.machine.answer.id == READ_ID && w.machine.answer.kind == ANSWER_OK);
    CHECK(step_until_answered());
    CHECK(w.machine.answer.id == STOP_ID && w.power_offs[1] == 1);
}

static void a_request_that_waits_too_long_is_not_sent(void)
{
    begin_with(1, 0);
    line_request stop = request_of(STOP_ID, 0, true);
    stop.expires_ns = w.now_ns;
    put(stop);
    CHECK(step_until_answered());
    CHECK(w.machine.answer.id == STOP_ID && w.machine.answer.kind == ANSWER_EXPIRED &&
          w.power_offs[0] == 0);
}

static void urgent_requests_overtake_waiting_ones_and_keep_their_own_order(void)
{
    begin_with(3, 0);
    put(request_of(READ_ID, 0, false));
    put(request_of(READ_ID + 1, 1, false));
    put(request_of(STOP_ID, 1, true));
    put(request_of(STOP_ID + 1, 2, true));
    static const uint64_t order[] = {STOP_ID, STOP_ID + 1, READ_ID, READ_ID + 1};
    for (uint32_t i = 0; i < 4; i++) {
        CHECK(step_until_answered());
        CHECK(w.machine.answer.id == order[i] && w.machine.answer.kind == ANSWER_OK);
    }
}

/* Beside full cycles, each drive has a read, which is repeated as soon as it is answered: the wire
 * is never free. */
static void continuous_reads_do_not_keep_an_urgent_request_from_being_sent(void)
{
    begin_with(3, 0);
    for (uint32_t i = 0; i < 3; i++) {
        w.machine.table.drive[i].period_ns = MS;
        arm(i);
        put(request_of(READ_ID + i, i, false));
    }
    w.machine.slot_period_ns = MS;
    for (uint32_t answers = 0; answers < 200; answers++) {
        CHECK(step_until_answered());
        if (w.machine.answer.id >= STOP_ID) {
            CHECK(w.machine.answer.id == STOP_ID && w.machine.answer.kind == ANSWER_OK &&
                  answers <= 101);
            return;
        }
        put(request_of(w.machine.answer.id, (uint32_t)(w.machine.answer.id - READ_ID), false));
        if (answers == 100) {
            put(request_of(STOP_ID, 2, true));
        }
    }
    CHECK(false);
}

static void the_request_on_the_wire_is_still_answered_when_the_line_is_shut_down(void)
{
    begin_with(1, 0);
    put(request_of(READ_ID, 0, false));
    while (!is_sent(1, READ, STATUS)) {
        go_on();
    }
    put(request_of(STOP_ID, 0, true));
    w.machine.control.shut_down = 1;
    CHECK(step_until_answered());
    CHECK(w.machine.answer.id == READ_ID && w.machine.answer.kind == ANSWER_OK);
    CHECK(step_until_answered());
    /* the end sends its own power-off */
    CHECK(w.machine.answer.id == STOP_ID && w.machine.answer.kind == ANSWER_EXPIRED);
    while (w.machine.end.stage != END_SILENT) {
        go_on();
    }
    CHECK(w.power_offs[0] == 2);
}

int main(void)
{
    an_urgent_request_does_not_interrupt_the_one_on_the_wire();
    the_request_on_the_wire_does_not_expire_behind_an_urgent_one();
    a_request_that_waits_too_long_is_not_sent();
    urgent_requests_overtake_waiting_ones_and_keep_their_own_order();
    continuous_reads_do_not_keep_an_urgent_request_from_being_sent();
    the_request_on_the_wire_is_still_answered_when_the_line_is_shut_down();
    return checks_report("line requests");
}
