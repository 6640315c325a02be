/* SPDX-License-Identifier: Apache-2.0
 * The queue of requests from outside the cycle: its order, its end, requests that expire, and which
 * request is next. */
#include "line_wire.h"

static void put(uint64_t id, uint32_t drive, uint32_t urgent, int64_t expires_ns)
{
    CHECK(line_machine_request(
        &w.machine,
        &(line_request){.id = id, .drive = drive, .urgent = urgent, .expires_ns = expires_ns}));
}

static void holds(const uint64_t *ids, uint32_t count)
{
    CHECK(w.machine.request_count == count);
    for (uint32_t i = 0; i < count; i++) {
        CHECK(w.machine.request[i].id == ids[i]);
    }
}

static void urgent_requests_come_before_others_and_each_kind_keeps_its_order(void)
{
    begin_with(2, 0);
    const uint64_t urgent_after_ordinary[] = {10, 11, 1, 2, 3};
    put(1, 0, 0, INT64_MAX);
    put(2, 0, 0, INT64_MAX);
    put(10, 0, 1, INT64_MAX);
    put(3, 0, 0, INT64_MAX);
    put(11, 0, 1, INT64_MAX);
    holds(urgent_after_ordinary, 5);
    while (w.machine.request_count > 0) {
        line_drop_request(&w.machine, 0);
    }
    put(12, 0, 1, INT64_MAX); /* earlier urgent requests do not count any more */
    put(13, 0, 1, INT64_MAX);
    holds((const uint64_t[]){12, 13}, 2);
}

static void a_full_queue_refuses_the_next_request_and_changes_nothing_else(void)
{
    begin_with(2, 0);
    for (uint32_t i = 0; i + 1 < LINE_REQUESTS_MAX; i++) {
        put(i, 0, i < LINE_REQUESTS_MAX / 2, INT64_MAX);
    }
    static line_machine wanted;
    wanted = w.machine;
    const line_request urgent = {.id = 99, .urgent = 1, .expires_ns = INT64_MAX};
    for (uint32_t i = LINE_REQUESTS_MAX - 1; i > LINE_REQUESTS_MAX / 2; i--) {
        wanted.request[i] = wanted.request[i - 1];
    }
    wanted.request[LINE_REQUESTS_MAX / 2] = urgent;
    wanted.request_count = LINE_REQUESTS_MAX;
    CHECK(line_machine_request(&w.machine, &urgent) &&
          memcmp(&w.machine, &wanted, sizeof wanted) == 0);
    CHECK(!line_machine_request(&w.machine, &urgent) &&
          memcmp(&w.machine, &wanted, sizeof wanted) == 0);
    wanted.request_count--; /* the last but one is dropped, and the last one moves up */
    wanted.request[LINE_REQUESTS_MAX - 2] = wanted.request[LINE_REQUESTS_MAX - 1];
    line_drop_request(&w.machine, LINE_REQUESTS_MAX - 2);
    CHECK(memcmp(&w.machine, &wanted, sizeof wanted) == 0);
}

static void expired_requests_are_answered_one_at_a_time_from_any_place(void)
{
    begin_with(2, 0);
    put(1, 0, 0, w.now_ns + 1);
    put(2, 0, 0, w.now_ns);
    put(3, 0, 0, w.now_ns - 1);
    line_expire_request(&w.machine, w.now_ns);
    CHECK(w.machine.answered && w.machine.answer.id == 2 &&
          w.machine.answer.kind == ANSWER_EXPIRED);
    line_expire_request(&w.machine, w.now_ns);
    holds((const uint64_t[]){1, 3}, 2);
    w.machine.answered = false;
    line_expire_request(&w.machine, w.now_ns);
    CHECK(w.machine.answer.id == 3);
    holds((const uint64_t[]){1}, 1);
}

static void a_request_to_a_pausing_drive_yields_to_the_next_one(void)
{
    begin_with(2, 0);
    put(1, 0, 0, INT64_MAX);
    put(2, 1, 0, INT64_MAX);
    w.machine.drive[0].silent_until_ns = w.now_ns + 1;
    CHECK(line_pick_request(&w.machine, w.now_ns) == 1);
    CHECK(line_pick_request(&w.machine, w.now_ns + 1) == 0);
    w.machine.drive[1].silent_until_ns = w.now_ns + 1;
    CHECK(line_pick_request(&w.machine, w.now_ns) == LINE_REQUESTS_MAX);
    put(3, 2, 0, INT64_MAX); /* to a drive beyond the table: waits for no drive */
    CHECK(line_pick_request(&w.machine, w.now_ns) == 2);
    begin_with(1, 0);
    put(1, 0, 0, INT64_MAX);
    w.machine.drive[0].held_until_ns = w.now_ns; /* the hold is over */
    CHECK(line_pick_request(&w.machine, w.now_ns) == 0);
    w.machine.drive[0].held_until_ns = w.now_ns + 1;
    for (uint64_t id = 2; id <= LINE_REQUESTS_MAX; id++) {
        put(id, 0, 0, INT64_MAX);
    }
    /* the queue is full, and each request has to wait */
    CHECK(line_pick_request(&w.machine, w.now_ns) == LINE_REQUESTS_MAX);
}

int main(void)
{
    urgent_requests_come_before_others_and_each_kind_keeps_its_order();
    a_full_queue_refuses_the_next_request_and_changes_nothing_else();
    expired_requests_are_answered_one_at_a_time_from_any_place();
    a_request_to_a_pausing_drive_yields_to_the_next_one();
    return checks_report("line queue");
}
