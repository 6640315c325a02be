/* SPDX-License-Identifier: Apache-2.0
 * A drive of a serial line that does not answer: which frames it is sent, when, and how it
 * returns. */
#include "line_wire.h"

enum { EXTRA = 0x40, SENT_MAX = 256 };

typedef struct {
    int64_t at_ns;
    uint8_t function, address, high, low;
} sent_frame;

static sent_frame sent[SENT_MAX];
static uint32_t sent_count;

static void look(void)
{
    go_on();
    if (w.out.send != NULL) {
        CHECK(sent_count < SENT_MAX);
        sent[sent_count++] = (sent_frame){w.machine.start_ns, w.out.send[1], w.out.send[3],
                                          w.out.send[4], w.out.send[5]};
    }
}

static void look_for(int64_t for_ns)
{
    for (int64_t end_ns = w.now_ns + for_ns; w.now_ns < end_ns;) {
        look();
    }
}

static void restart(void)
{
    CHECK(line_machine_init(&w.machine, &w.table, 0, w.now_ns) == 0);
}

/* The drive becomes silent. `sent` keeps what it is sent since it is unresponsive. */
static void become_unresponsive(void)
{
    w.dead = 1;
    while (w.machine.drive[0].state.mode != DRIVE_UNRESPONSIVE) {
        sent_count = 0;
        look(); /* the look that finds the drive unresponsive sends the first frame */
    }
}

static void be_ready_and_become_unresponsive(void)
{
    request(0, DRIVE_READY);
    for (uint32_t i = 0; i < 20; i++) {
        go_on();
    }
    become_unresponsive();
}

static void become_unresponsive_while_it_may_turn(void)
{
    arm(0);
    for (uint32_t i = 0; i < 20; i++) {
        go_on();
    }
    become_unresponsive();
}

static bool is_quick_stop(const sent_frame *frame)
{
    return frame->function == WRITE && frame->address == CONTROL && frame->low == QUICK_STOP;
}

static bool is_zero(const sent_frame *frame)
{
    return frame->function == WRITE && frame->address == SPEED && frame->high == 0 &&
           frame->low == 0;
}

static void a_drive_that_may_turn_gets_a_quick_stop_and_zero_between_the_probes(void)
{
    begin_with(1, 0);
    become_unresponsive_while_it_may_turn();
    look_for(20000 * MS);
    CHECK(sent_count >= 12);
    for (uint32_t i = 0; i + 2 < sent_count; i += 3) {
        CHECK(is_quick_stop(&sent[i]) && is_zero(&sent[i + 1]));
        CHECK(sent[i + 2].function == READ && sent[i + 2].address == STATUS);
    }
    CHECK(w.machine.drive[0].count.unresponsive == 1 &&
          w.machine.drive[0].state.fault_reasons == DRIVE_FAULT_UNRESPONSIVE);
}

static void the_first_round_comes_at_once_and_the_pauses_double_up_to_two_seconds(void)
{
    begin_with(1, 0);
    become_unresponsive_while_it_may_turn();
    look_for(12000 * MS);
    const int64_t pauses_ms[] = {0, 0, 100, 200, 400, 800, 1600, 2000, 2000};
    CHECK(sent_count >= 10);
    for (uint32_t i = 0; i < 9; i++) {
        int64_t pause_ns = sent[i + 1].at_ns - sent[i].at_ns;
        int64_t reply_ns = w.machine.drive[0].deadline_ns + 40 * MS;
        CHECK(pause_ns >= pauses_ms[i] * MS &&
              pause_ns <= (pauses_ms[i] > 0 ? pauses_ms[i] * MS : reply_ns) + MS / 2);
    }
}

static void a_drive_that_does_not_turn_is_only_probed(void)
{
    begin_with(1, 0);
    be_ready_and_become_unresponsive();
    look_for(5000 * MS);
    CHECK(sent_count >= 4);
    for (uint32_t i = 0; i < sent_count; i++) {
        CHECK(sent[i].function == READ && sent[i].address == STATUS);
    }
}

static void without_a_probe_its_first_extra_range_is_read_or_else_zero_is_sent(void)
{
    for (uint32_t extras = 0; extras <= 1; extras++) {
        begin_with(1, 0);
        w.table.drive[0].probe = 0;
        w.table.drive[0].extra_count = extras;
        w.table.drive[0].extra[0].frame = frame_of(1, READ, EXTRA, 1);
        restart();
        be_ready_and_become_unresponsive();
        look_for(1000 * MS);
        CHECK(sent_count >= 3);
        for (uint32_t i = 0; i < sent_count; i++) {
            CHECK(extras == 1 ? sent[i].function == READ && sent[i].address == EXTRA
                              : is_zero(&sent[i]));
        }
    }
}

static void the_probe_may_be_the_first_of_the_cycle(void)
{
    begin_with(1, 0);
    w.table.drive[0].probe = 1;
    restart();
    be_ready_and_become_unresponsive();
    look_for(1000 * MS);
    CHECK(sent_count >= 3 && is_zero(&sent[0]) && is_zero(&sent[1]) && is_zero(&sent[2]));
}

/* A drive that answers again gets its power-off, and may be set up only after it. Its next silence
 * begins with a quick stop again. */
static void a_drive_that_answers_gets_its_power_off_and_is_back(void)
{
    begin_with(1, 0);
    for (uint64_t times = 1; times <= 2; times++) {
        w.dead = 0;
        become_unresponsive_while_it_may_turn();
        look_for(450 * MS); /* so that a round is interrupted in its middle */
        CHECK(is_quick_stop(&sent[0]) && is_zero(&sent[1]) &&
              w.machine.drive[0].count.unresponsive == times);
        CHECK(sent[1].at_ns - sent[0].at_ns < 90 * MS && sent[2].at_ns - sent[1].at_ns < 90 * MS);
        CHECK(sent[3].at_ns - sent[2].at_ns >= 100 * MS &&
              sent[3].at_ns - sent[2].at_ns < 101 * MS);
        w.dead = 0;
        w.power_offs[0] = 0;
        while (w.machine.drive[0].state.mode != DRIVE_BACK) {
            go_on();
        }
        /* it still brakes: its set-up takes its power */
        CHECK(w.power_offs[0] == 0 && w.machine.drive[0].state.stop == STOP_NOTHING);
        CHECK(!w.machine.drive[0].state.stopping && !w.machine.drive[0].state.back);
    }
}

static void a_drive_that_falls_silent_ends_its_running_stop(void)
{
    begin_with(1, 0);
    arm(0);
    w.turning = 1;
    for (uint32_t i = 0; i < 20; i++) {
        go_on();
    }
    w.machine.newest.stamp_ns = 0;
    /* old set-points: the drive comes to rest */
    line_machine_step(&w.machine, w.now_ns, w.bytes, 0, &w.out);
    CHECK(w.machine.drive[0].state.stopping);
    become_unresponsive();
    CHECK(!w.machine.drive[0].state.stopping && w.machine.drive[0].state.stop == STOP_NOTHING);
}

/* The drive's next cycle and its next round of probes start at the beginning. */
static void a_drive_that_falls_silent_in_its_cycle_restarts_and_delays_no_other(void)
{
    begin_with(2, 0);
    line_drive_state *drive = &w.machine.drive[0];
    for (uint32_t current = 0; current < 2; current++) {
        drive->stage = STAGE_EXTRA;
        drive->probe_place = 2;
        drive->state.back = true;
        memset(drive->direction_sent, 1, sizeof drive->direction_sent);
        w.machine.current = current;
        line_becomes_unresponsive(&w.machine, 0, w.now_ns);
        CHECK(drive->state.mode == DRIVE_UNRESPONSIVE && drive->stage == STAGE_IDLE &&
              drive->probe_place == 0 && !drive->state.back);
        CHECK(w.machine.current == (current == 0 ? (uint32_t)LINE_DRIVES_MAX : 1));
        for (uint32_t direction = 0; direction < DRIVE_DIRECTIONS_MAX; direction++) {
            CHECK(drive->direction_sent[direction] == DIRECTION_UNKNOWN);
        }
    }
}

static void a_request_of_off_does_not_end_the_stops_of_an_unresponsive_drive(void)
{
    begin_with(1, 0);
    become_unresponsive_while_it_may_turn();
    request(0, DRIVE_OFF);
    w.not_enabled = true;
    look_for(3000 * MS);
    CHECK(w.machine.drive[0].state.mode == DRIVE_UNRESPONSIVE && w.sent_off[0] > 0);
    w.dead = 0;
    look_for(3000 * MS);
    CHECK(w.machine.drive[0].state.mode == DRIVE_BACK && w.power_offs[0] > 0);
}

/* A round has one quick stop, the exchanges with set-points that begin the cycle, and the probe. */
static void the_first_round_is_as_long_as_what_stops_the_drive(void)
{
    for (uint32_t writes = 0; writes <= 2; writes++) {
        begin_with(1, 0);
        line_drive *table = &w.machine.table.drive[0];
        table->cyclic[0].setpoint_count = writes > 0;
        table->cyclic[1].setpoint_count = 1;
        /* an entry beyond the count does not count */
        table->cyclic_count = writes == 2 ? 2 : 1;
        w.machine.drive[0].may_turn = true;
        line_becomes_unresponsive(&w.machine, 0, w.now_ns);
        CHECK(w.machine.drive[0].probes_at_once == 1 + writes + 1);
    }
}

int main(void)
{
    a_drive_that_may_turn_gets_a_quick_stop_and_zero_between_the_probes();
    the_first_round_comes_at_once_and_the_pauses_double_up_to_two_seconds();
    a_drive_that_does_not_turn_is_only_probed();
    without_a_probe_its_first_extra_range_is_read_or_else_zero_is_sent();
    the_probe_may_be_the_first_of_the_cycle();
    a_drive_that_answers_gets_its_power_off_and_is_back();
    a_drive_that_falls_silent_ends_its_running_stop();
    a_drive_that_falls_silent_in_its_cycle_restarts_and_delays_no_other();
    a_request_of_off_does_not_end_the_stops_of_an_unresponsive_drive();
    the_first_round_is_as_long_as_what_stops_the_drive();
    return checks_report("line unresponsive");
}
