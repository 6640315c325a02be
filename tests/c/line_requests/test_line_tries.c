/* SPDX-License-Identifier: Apache-2.0
 * How often and how long a line tries: reads in turn, deadlines that increase after failures, and
 * stops that a drive refuses. */
#include "line_wire.h"

enum { EXTRA = 0x40, EXTRAS = 3, SENT_MAX = 64 };

static uint8_t sent_address[SENT_MAX];
static uint32_t sent_count;

/* Makes so many looks, and notes the registers that were read in `sent_address`. */
static void look(uint32_t times)
{
    for (uint32_t i = 0; i < times; i++) {
        go_on();
        if (w.out.send != NULL && w.out.send[1] == READ && w.out.send[3] != STATUS) {
            CHECK(sent_count < SENT_MAX);
            sent_address[sent_count++] = w.out.send[3];
        }
    }
}

/* Three extra ranges are read. The first one may report whether the drive is enabled. */
static void begin_with_extras(uint32_t reports_enabled)
{
    begin_with(1, 0);
    sent_count = 0;
    line_drive *drive = &w.table.drive[0];
    drive->extra_count = EXTRAS;
    drive->extra_every = 1;
    for (uint8_t i = 0; i < EXTRAS; i++) {
        drive->extra[i].frame = frame_of(1, READ, (uint8_t)(EXTRA + i), 1);
    }
    drive->extra[0].field_count = reports_enabled;
    drive->extra[0].field[0] = (line_field){.kind = FIELD_ENABLED,
                                            .byte = 3,
                                            .form = FORM_U16,
                                            .equals_mask = 0xFFFF,
                                            .equals = 1,
                                            .si_per_raw = 1.0};
    CHECK(line_machine_init(&w.machine, &w.table, 0, w.now_ns) == 0);
}

static void slow_values_are_read_by_turns(void)
{
    begin_with_extras(1);
    request(0, DRIVE_READY);
    while (sent_count < 9) {
        look(1);
    }
    for (uint32_t i = 0; i < 9; i++) {
        CHECK(sent_address[i] == EXTRA + i % EXTRAS);
    }
    request(0, DRIVE_OFF);
    look(4);
    sent_count = 0;
    request(0, DRIVE_READY); /* a new set-up restarts the turns */
    while (sent_count < 2) {
        look(1);
    }
    CHECK(sent_address[0] == EXTRA && sent_address[1] == EXTRA + 1);
}

static void slow_values_of_a_drive_that_never_reports_its_power_are_read_by_turns(void)
{
    begin_with_extras(0);
    request(0, DRIVE_READY);
    while (sent_count < 6) {
        look(1);
    }
    for (uint32_t i = 0; i < 6; i++) {
        CHECK(sent_address[i] == EXTRA + i % EXTRAS);
    }
}

/* ----------------------------------------------------------------------------- back-off */
static void fail_once(void)
{
    uint64_t before = w.machine.drive[0].count.no_reply;
    while (w.machine.drive[0].count.no_reply == before) {
        go_on();
    }
}

static void a_deadline_doubles_with_each_missing_reply_up_to_the_drive_s_bound(void)
{
    begin_with(1, 0);
    w.table.drive[0].turnaround_ns = 100 * MS;
    w.table.drive[0].tries = 9;
    CHECK(line_machine_init(&w.machine, &w.table, 0, w.now_ns) == 0);
    arm(0);
    for (uint32_t i = 0; i < 40; i++) {
        go_on();
    }
    CHECK(w.machine.drive[0].deadline_ns == 10 * MS); /* the drive answers within half a
                                                         millisecond */
    w.mute = 1;
    const int64_t bound_ns = w.machine.table.drive[0].turnaround_ns;
    const int64_t deadlines_ns[] = {20 * MS, 40 * MS, 80 * MS, bound_ns, bound_ns};
    for (uint32_t i = 0; i < 5; i++) {
        fail_once();
        CHECK(w.machine.drive[0].deadline_ns == deadlines_ns[i]);
    }
    w.mute = 0;
    for (uint32_t i = 0; i < 20; i++) {
        go_on();
    }
    CHECK(w.machine.drive[0].deadline_ns == 10 * MS && w.machine.drive[0].failures == 0);
}

/* A reply may arrive as late as the bound of the drive allows, and must not be taken as that of the
 * next request. */
static void after_a_missing_reply_the_line_pauses_for_the_drive_s_whole_bound(void)
{
    begin_with(1, 0);
    w.table.drive[0].turnaround_ns = 60 * MS;
    w.table.drive[0].tries = 9;
    CHECK(line_machine_init(&w.machine, &w.table, 0, w.now_ns) == 0);
    arm(0);
    for (uint32_t i = 0; i < 40; i++) {
        go_on();
    }
    w.mute = 1;
    go_on();
    while (w.out.send == NULL) {
        go_on();
    }
    int64_t end_ns = w.machine.end_ns;
    fail_once();
    w.mute = 0;
    do {
        go_on();
    } while (w.out.send == NULL);
    CHECK(w.machine.start_ns >= end_ns + 60 * MS);
}

/* ------------------------------------------------------------------------ refused stops */
static void shut_down_until(uint32_t shut)
{
    w.machine.control.shut_down = 1;
    for (int64_t limit_ns = w.now_ns + 2000 * MS; w.machine.end.stage != shut;) {
        CHECK(w.now_ns < limit_ns);
        go_on();
    }
}

static void
a_frame_of_a_stop_that_is_refused_is_sent_as_often_as_the_drive_s_tries_and_the_next_one_then(void)
{
    begin_with(1, 0);
    /* both frames go to the register that the drive refuses */
    w.table.drive[0].disarm[1] = frame_of(1, WRITE, CONTROL, 0);
    CHECK(line_machine_init(&w.machine, &w.table, 0, w.now_ns) == 0);
    w.refused = CONTROL;
    shut_down_until(3);
    CHECK(w.machine.drive[0].state.stop == STOP_NOTHING && w.refusals == 6);
    begin_with(1, 0);
    w.refused = CONTROL; /* the second frame is received, and failures are counted from zero */
    shut_down_until(3);
    CHECK(w.machine.drive[0].state.stop == STOP_NOTHING && w.released[0] == 1 && w.refusals == 4);
}

static void a_new_stop_starts_with_all_of_its_tries(void)
{
    begin_with(1, 0);
    arm(0);
    for (uint32_t i = 0; i < 10; i++) {
        go_on();
    }
    w.dead = 1;
    shut_down_until(2); /* no quick stop was answered */
    w.dead = 0;
    w.refused = CONTROL;
    w.refusals = 0;
    shut_down_until(3);
    CHECK(w.refusals >= 3 && w.released[0] >= 1);
}

/* Two drives. After so many failures the first one refuses a register. After three refusals,
 * `unanswered` frames get no reply. */
static void run_refusing(uint32_t failures, uint32_t unanswered)
{
    begin_with(2, 0);
    arm(0);
    arm(1);
    for (uint32_t i = 0; i < 60; i++) {
        go_on();
    }
    w.refused = CONTROL;
    w.machine.drive[0].failures = failures;
    request(0, DRIVE_STAND_DOWN);
    request(0, DRIVE_OFF);
    go_on();
    for (uint32_t lost = 0; w.machine.drive[0].state.stop != STOP_NOTHING;
         lost += w.mute && w.out.send != NULL) {
        /* a frame after the refused one */
        w.mute = w.refusals == 3 && lost < unanswered;
        go_on();
    }
}

static void
a_drive_that_refuses_one_frame_of_its_power_off_gets_the_others_while_the_line_runs(void)
{
    for (uint32_t failures = 0; failures < 3; failures++) {
        run_refusing(failures, 0);
        CHECK(w.refusals == 3 && w.released[0] == 1 && w.machine.drive[0].count.unresponsive == 0);
    }
    run_refusing(0, 2); /* a refusal is an answer: the frame after it has all of its tries */
    CHECK(w.refusals == 3 && w.released[0] == 3 && w.machine.drive[0].count.unresponsive == 0);
}

int main(void)
{
    a_drive_that_refuses_one_frame_of_its_power_off_gets_the_others_while_the_line_runs();
    slow_values_are_read_by_turns();
    slow_values_of_a_drive_that_never_reports_its_power_are_read_by_turns();
    a_deadline_doubles_with_each_missing_reply_up_to_the_drive_s_bound();
    after_a_missing_reply_the_line_pauses_for_the_drive_s_whole_bound();
    a_frame_of_a_stop_that_is_refused_is_sent_as_often_as_the_drive_s_tries_and_the_next_one_then();
    a_new_stop_starts_with_all_of_its_tries();
    return checks_report("line tries");
}
