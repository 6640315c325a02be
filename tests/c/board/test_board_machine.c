/* SPDX-License-Identifier: Apache-2.0
 * test_board_machine: which frames a board reports as received, and which of its frames a line
 * remembers. */
#include <stdlib.h>

#include "board_wire.h"

enum { REPORTED_BYTES = 36, HELD_UNIT_US = 100 };

static histogram trips;

/* Feedback that the board makes at `time_us`: the number of the frame that it received last, and
 * how many 0.1 ms ago. */
static void receive_that(uint16_t sequence, uint16_t ago, uint32_t time_us)
{
    uint8_t payload[REPORTED_BYTES] = {0}, frame[BOARD_WIRE_MAX];
    payload[10] = 1; /* a fault word follows */
    board_put(payload, &(board_place){.byte = 6, .bytes = 2}, sequence);
    board_put(payload, &(board_place){.byte = 8, .bytes = 2}, ago);
    uint32_t count =
        board_frame_build(BOARD_TYPE_FEEDBACK, 1, time_us, payload, REPORTED_BYTES, frame);
    uint64_t before = w.machine.received;
    board_machine_receive(&w.machine, frame, count, w.now_ns);
    CHECK(w.machine.received == before + 1);
}

static int64_t knows_after(uint16_t sequence, uint16_t ago)
{
    receive_that(sequence, ago, (uint32_t)(w.now_ns / 1000));
    return w.machine.knows_ns;
}

/* Sends a frame in the next cycle. Returns its time. */
static int64_t send_one(void)
{
    w.now_ns = w.machine.cycle.due_ns;
    uint64_t before = w.machine.sent;
    step();
    CHECK(w.machine.sent == before + 1 &&
          w.machine.sent_ns[w.machine.sequence % BOARD_SEQUENCES_KEPT] == w.now_ns);
    return w.now_ns;
}

static void begin_again(void)
{
    begin();
    histogram_clear(&trips);
    w.machine.round_trips = &trips;
}

static void a_machine_begins_with_its_arguments_and_nothing_else(void)
{
    board_machine *m = malloc(sizeof *m), *untouched = malloc(sizeof *m);
    memset(m, 0xA5, sizeof *m);
    memcpy(untouched, m, sizeof *m);
    board_table table = frames_table();
    table.tries = 0;
    CHECK(board_machine_init(m, &table, 7, 0xFFFF, 55) == -22); /* EINVAL */
    CHECK(memcmp(m, untouched, sizeof *m) == 0);
    table = frames_table();
    table.setpoint[table.setpoint_count] = table.setpoint[0];
    table.setpoint[table.setpoint_count].scale.joint = 5; /* a set-point beyond the count */
    CHECK(board_machine_init(m, &table, 7, 0xFFFF, 55) == 0);
    CHECK(m->state.epoch == 7 && m->sequence == 0xFFFF && m->next == 0 && m->cycle.due_ns == 55 &&
          m->joints == 3);
    CHECK(m->state.mode == DRIVE_OFF && m->state.enabled == 2 && m->sent == 0 && m->received == 0 &&
          m->end.stage == END_NOT);
    CHECK(m->state.sent_motion == 0 && m->tail.count == 0 && m->clock.samples == 0 &&
          !m->has_order && m->sent_ns[3] == 0);
    CHECK(isnan(m->joint[0].feedback.velocity_rad_s) &&
          isnan(m->joint[JOINTS_MAX - 1].feedback.velocity_rad_s));
    CHECK(memcmp(m->held + 1, table.payload + 1, BOARD_PAYLOAD_MAX - 1) == 0);
    free(untouched);
    free(m);
}

static void a_received_frame_is_identified_by_its_time_of_sending(void)
{
    begin_again();
    int64_t first_ns = send_one(), second_ns = send_one();
    uint16_t newest = w.machine.sequence;
    w.now_ns += 3 * MS;
    CHECK(knows_after(newest, 0) == second_ns && trips.samples == 1 && trips.max_ns == 3 * MS);
    CHECK(knows_after((uint16_t)(newest - 1), 30) == first_ns && trips.samples == 2 &&
          trips.max_ns == 10 * MS);
    /* a frame that was never sent */
    CHECK(knows_after((uint16_t)(newest - 2), 0) == 0 && trips.samples == 2);
    w.machine.sent_ns[(uint16_t)(newest - 2) % BOARD_SEQUENCES_KEPT] = 1;
    CHECK(knows_after((uint16_t)(newest - 2), 0) == 1 && trips.samples == 3);
}

/* The clocks differ a little. A frame received long before it was sent is from an earlier
 * program. */
static void a_frame_received_before_it_was_sent_is_another_frame(void)
{
    begin_again();
    int64_t sent_ns = send_one();
    uint16_t newest = w.machine.sequence;
    w.now_ns = sent_ns + MS;
    CHECK(knows_after(newest, 30) == sent_ns);
    CHECK(knows_after(newest, 31) == 0);
    w.now_ns--;
    CHECK(knows_after(newest, 30) == 0);
    w.now_ns = sent_ns + 65535 * HELD_UNIT_US * INT64_C(1000) - 2 * MS;
    CHECK(knows_after(newest, 65535) == sent_ns && trips.max_ns == 0);
    w.now_ns--;
    CHECK(knows_after(newest, 65535) == 0);
}

static void a_frame_is_remembered_until_enough_newer_ones_are_sent(void)
{
    begin_again();
    (void)send_one();
    uint16_t first = w.machine.sequence;
    int64_t second_ns = send_one();
    for (uint32_t i = 2; i <= BOARD_SEQUENCES_KEPT; i++) {
        (void)send_one();
    }
    CHECK(w.machine.sequence == (uint16_t)(first + BOARD_SEQUENCES_KEPT));
    CHECK(knows_after((uint16_t)(first + 1), 0) == second_ns);
    CHECK(knows_after(first, 0) == 0); /* a newer frame has its place */
}

/* A board refuses frames that are older than the newest it received, from any program. */
static void a_line_continues_after_the_sequence_that_the_board_has_received(void)
{
    begin_again();
    int64_t sent_ns = send_one();
    uint16_t newest = w.machine.sequence;
    CHECK(knows_after(newest, 0) == sent_ns && w.machine.next == (uint16_t)(newest + 1));
    CHECK(knows_after((uint16_t)(newest + 1), 0) == 0 && w.machine.next == (uint16_t)(newest + 2));
    (void)send_one();
    CHECK(w.machine.sequence == (uint16_t)(newest + 2) && w.machine.next == (uint16_t)(newest + 3));
    CHECK(knows_after(newest, 0) == 0); /* its sequence has ended */
    CHECK(knows_after((uint16_t)(newest + 1), 0) == 0);
    /* a sequence behind the next one */
    CHECK(knows_after((uint16_t)(newest + 40000), 0) == 0 &&
          w.machine.next == (uint16_t)(newest + 3));
}

static void feedback_has_the_board_s_time(void)
{
    static const uint32_t TIMES_US[] = {0, 0x00FFFF00, 0x01020304, 0xFFFFFF00};
    for (uint32_t i = 0; i < 4; i++) {
        begin_again();
        receive_that(0, 0, TIMES_US[i]);
        int64_t first_ns = w.machine.stamp_ns;
        CHECK(first_ns == w.now_ns);
        w.now_ns += 25 * MS;
        receive_that(0, 0, TIMES_US[i] + 20000);
        CHECK(w.machine.stamp_ns == first_ns + 20 * MS);
    }
}

static void a_frame_carries_the_host_s_time_and_refused_frames_are_counted(void)
{
    uint8_t raw[BOARD_FRAME_MAX];
    begin_again();
    w.machine.cycle.due_ns += 123456;
    (void)send_one();
    CHECK(board_frame_parse(w.sent + 1, w.sent_bytes - 2, raw) > 0);
    CHECK(board_get(raw, &(board_place){.byte = 4, .bytes = 4}) == (uint32_t)(w.now_ns / 1000));
    w.full = true;
    for (uint64_t n = 1; n <= 3; n++) {
        uint16_t sequence = w.machine.sequence;
        w.now_ns = w.machine.cycle.due_ns;
        step();
        CHECK(w.machine.no_room == n && w.machine.sent == 1 && w.machine.sequence == sequence);
    }
}

static void an_order_to_a_board_that_was_stopped_is_dropped_and_asyncio_notified(void)
{
    begin_again();
    board_order one = {.write = {.place = at(CONTROL, 1, 0), .raw = 1},
                       .guarded = 1,
                       .stops = w.machine.stops + 1};
    CHECK(board_machine_order(&w.machine, &one) && !board_machine_order(&w.machine, &one));
    w.machine.notify = false;
    (void)send_one();
    CHECK(!w.machine.has_order && w.machine.orders_dropped == 1 && w.machine.notify);
}

/* A board that may move is checked often: between two cycles its set-points may become old, or
 * its wheels come to rest. */
static void a_board_that_may_move_is_checked_more_often_than_one_at_rest(void)
{
    board_table table = frames_table();
    table.period_ns = 100 * MS;
    for (uint32_t moving = 0; moving < 5; moving++) {
        begin_with(table);
        w.enabled = 2; /* the test sets the set-points */
        (void)send_one();
        w.now_ns += MS;
        w.machine.state.mode = DRIVE_READY;
        w.machine.received_ns = w.machine.last_sent_ns = w.now_ns;
        w.machine.newest = (setpoints){.stamp_ns = w.now_ns, .enabled = 1, .joint_count = 2};
        w.machine.state.was_enabled = true;
        w.machine.state.mode = moving == 1 || moving == 2 ? DRIVE_ARMED : DRIVE_READY;
        w.machine.newest.joint[0].velocity_rad_s = moving == 2 ? 1.0 : 0.0;
        w.machine.state.sent_motion = moving == 2;
        w.machine.state.stopping = moving == 3;
        w.machine.state.off_by_ns = w.now_ns + 1000 * MS;
        w.machine.joint[0].feedback.velocity_rad_s = w.machine.joint[1].feedback.velocity_rad_s =
            5.0;
        w.machine.end.stage = moving == 4 ? END_SILENT : END_NOT;
        step();
        CHECK(w.wake_ns == w.now_ns + (moving == 0 ? LOOK_RESTING_NS : LOOK_MOVING_NS));
    }
}

int main(void)
{
    a_machine_begins_with_its_arguments_and_nothing_else();
    a_received_frame_is_identified_by_its_time_of_sending();
    a_frame_received_before_it_was_sent_is_another_frame();
    a_frame_is_remembered_until_enough_newer_ones_are_sent();
    a_line_continues_after_the_sequence_that_the_board_has_received();
    feedback_has_the_board_s_time();
    a_frame_carries_the_host_s_time_and_refused_frames_are_counted();
    an_order_to_a_board_that_was_stopped_is_dropped_and_asyncio_notified();
    a_board_that_may_move_is_checked_more_often_than_one_at_rest();
    return checks_report("test_board_machine");
}
