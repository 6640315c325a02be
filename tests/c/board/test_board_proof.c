/* SPDX-License-Identifier: Apache-2.0
 * When the last power-off of a board's line counts as received, from the board's reports in frames
 * and in text. */
#include "board_wire.h"

/* ---------------------------------------------------------------- before the end begins */
/* A board that is at rest, has received all that was written, and reports no power; `against`: one
 * condition that contradicts, 0: none. Returns whether one power-off suffices. */
static bool suffices(int against, bool reports_it)
{
    begin();
    board_machine *m = &w.machine;
    m->table.field_count -= reports_it ? 0 : 1; /* the last field is its power */
    m->state =
        (drive_state){.mode = against == 1 ? DRIVE_OFF : DRIVE_READY, .stopping = against == 2};
    m->state.stop = against == 3 ? STOP_POWER_OFF : STOP_NOTHING;
    m->state.sent_motion = against == 4;
    m->control.request.arming_until_ns = w.now_ns + (against == 5);
    m->has_order = against == 6;
    m->written_ns = w.now_ns - 5;
    m->knows_ns = m->written_ns - (against == 7);
    m->state.enabled = against >= 8 ? (uint32_t)against - 7 : 0;
    board_note_power(m, w.now_ns);
    return m->off_suffices;
}

static void a_board_is_known_to_have_no_power_unless_a_condition_contradicts(void)
{
    for (int against = 0; against < 10; against++) {
        CHECK(suffices(against, true) == (against == 0));
        /* without its power in the feedback */
        CHECK(suffices(against, false) == (against == 0 || against >= 8));
    }
    (void)suffices(2, true);
    w.machine.table.answers = 0;
    board_note_power(&w.machine, w.now_ns);
    CHECK(w.machine.off_suffices); /* without feedback */
}

/* ------------------------------------------------------------------------------- frames */
static bool line_is_silent(void)
{
    return w.machine.end.stage == END_SILENT;
}

/* Waits until the line is silent; returns the time that it took. */
static int64_t ends_after(void)
{
    int64_t from_ns = w.now_ns;
    while (!line_is_silent()) {
        go_on(MS);
    }
    return w.now_ns - from_ns;
}

static bool is_reported(void)
{
    board_report report;
    board_machine_report(&w.machine, &report);
    return report.stop_waits != 0;
}

/* A board has turned, and its first power-off has just been sent. */
static void goes_out_first(void)
{
    begin();
    arm_and_turn();
    w.machine.control.shut_down = 1;
    while (w.machine.off_first_ns == 0) {
        go_on(MS);
    }
    CHECK(w.machine.end.stage == END_POWER_OFF && w.machine.off_waits);
}

static void the_first_of_its_power_offs_suffices(void)
{
    goes_out_first();
    w.receives_nothing = true;
    CHECK(ends_after() < 40 * MS && !is_reported() && w.peer.enabled == 0);
    CHECK(w.machine.knows_ns == w.machine.off_first_ns &&
          w.machine.last_sent_ns > w.machine.off_first_ns);
}

static void a_board_that_still_has_power_after_its_power_off_is_reported(void)
{
    goes_out_first();
    while (!line_is_silent()) {
        w.peer.enabled = 1; /* its switch is stuck */
        go_on(MS);
    }
    CHECK(w.machine.knows_ns > w.machine.off_first_ns && is_reported());
    CHECK(w.now_ns >= w.machine.end.off_by_ns + 500 * MS);
}

/* --------------------------------------------------------------------------------- text */
static const char *const NO_POWER = "v 0\n", *const HAS_POWER = "v 0.001\n";

/* Both joints have the same number as their velocity. */
static board_table table_with_velocity_only(void)
{
    board_table table = text_table(true);
    table.field[table.field_count++] = field_of(1, FIELD_VELOCITY, at(0, 6, 1), 0.001);
    /* a field beyond the count */
    table.field[table.field_count] = level_of(FIELD_ENABLED, at(0, 6, 1), 1, 1);
    return table;
}

static board_table table_with_power_first(void)
{
    board_table table = table_with_velocity_only();
    table.field[table.field_count++] = table.field[0];
    table.field[0] = level_of(FIELD_ENABLED, at(0, 6, 1), 1, 1);
    return table;
}

/* The board sends a line of text; then the machine sends once. */
static void receives(const char *word)
{
    receive(word);
    go_on(20 * MS);
}

/* A text board has turned, and its first power-off has just been sent. It has reported nothing
 * since. */
static void goes_out_first_to(board_table table)
{
    begin_with(table);
    receives("\n");
    request(DRIVE_READY);
    receives(NO_POWER);
    request(DRIVE_ARMED);
    receives(HAS_POWER);
    CHECK(w.machine.state.mode == DRIVE_ARMED && w.machine.state.sent_motion);
    w.machine.control.shut_down = 1;
    step();
    CHECK(w.machine.end.stage == END_RESTING);
    receive(HAS_POWER);
    while (w.machine.off_first_ns == 0) {
        w.now_ns += MS;
        step();
    }
    CHECK(w.machine.end.stage == END_POWER_OFF && w.machine.off_first_ns == w.now_ns &&
          w.machine.off_waits);
    w.now_ns += MS;
}

static void without_power_in_its_feedback_two_reports_with_a_power_off_between_are_needed(void)
{
    for (int words = 0; words < 3; words++) {
        goes_out_first_to(table_with_velocity_only());
        for (int i = 0; i < words; i++) {
            receives(HAS_POWER); /* the velocity is no evidence of power */
        }
        (void)ends_after();
        CHECK(is_reported() == (words < 2) && (w.now_ns < w.machine.end.off_by_ns) == (words == 2));
    }
}

static void two_reports_in_a_row_may_both_have_been_in_transit(void)
{
    goes_out_first_to(table_with_velocity_only());
    receive(NO_POWER);
    receives(NO_POWER);
    (void)ends_after();
    CHECK(is_reported());
}

static void one_report_of_no_power_suffices(void)
{
    goes_out_first_to(table_with_power_first());
    receives(NO_POWER);
    CHECK(ends_after() < 40 * MS && !is_reported());
}

static void a_board_that_keeps_reporting_power_is_reported(void)
{
    goes_out_first_to(table_with_power_first());
    while (!line_is_silent()) {
        receives(HAS_POWER);
    }
    CHECK(is_reported() && w.now_ns >= w.machine.end.off_by_ns + 500 * MS);
}

/* ----------------------------------------------------------------------------- the rule */
/* In this table, feedback has neither the received sequence nor the power. */
static void two_reports_with_a_power_off_between_prove_it_where_feedback_has_no_power(void)
{
    begin();
    board_machine *m = &w.machine;
    m->table.dialect = BOARD_TEXT;
    m->table.field_count = 0;
    m->off_first_ns = 10, m->off_word_ns = 20;
    for (int again = 0; again < 2; again++) {
        m->off_waits = true;
        m->off_again_ns = again ? 30 : 0;
        m->off_word_ns = again ? 30 : 20;
        board_look_for_proof(m);
        CHECK(m->off_waits);
    }
    m->off_word_ns = 31;
    board_look_for_proof(m);
    CHECK(!m->off_waits);
    m->off_waits = true;
    m->off_first_ns = 0;
    board_look_for_proof(m);
    CHECK(m->off_waits);
    m->off_first_ns = m->off_again_ns = 1, m->off_word_ns = 2; /* only a time of 0 means that
                                                                  nothing was sent */
    board_look_for_proof(m);
    CHECK(!m->off_waits);
}

static void feedback_from_before_the_power_off_proves_nothing(void)
{
    begin_with(table_with_power_first());
    board_machine *m = &w.machine;
    m->state.enabled = 0;
    m->off_waits = true;
    m->off_first_ns = 10;
    board_look_for_proof(m);
    CHECK(m->off_waits);
    m->off_word_ns = 11;
    board_look_for_proof(m);
    CHECK(!m->off_waits);
}

/* The clock begins with the line: its first power-off is sent at 1 ns, and feedback arrives at
 * once. */
static void begins_and_ends_at_the_first_nanosecond(board_table table, const char *word)
{
    begin_with(table);
    w.now_ns = 1;
    restart();
    w.machine.control.shut_down = 1;
    step();
    receive("\n");
    receive(word);
    CHECK(w.machine.off_first_ns == 1 && w.machine.off_word_ns == 1 && w.machine.off_waits);
    go_on(20 * MS);
}

static void the_first_nanosecond_is_a_valid_time(void)
{
    begins_and_ends_at_the_first_nanosecond(table_with_power_first(), NO_POWER);
    (void)ends_after();
    CHECK(!is_reported());
    begins_and_ends_at_the_first_nanosecond(table_with_velocity_only(), NO_POWER);
    go_on(20 * MS);
    receives(NO_POWER);
    (void)ends_after();
    CHECK(!is_reported());
    begins_and_ends_at_the_first_nanosecond(table_with_power_first(), HAS_POWER);
    while (!line_is_silent()) {
        receives(HAS_POWER);
    }
    CHECK(is_reported() && w.now_ns >= END_OFF_NS + 500 * MS);
}

int main(void)
{
    a_board_is_known_to_have_no_power_unless_a_condition_contradicts();
    the_first_of_its_power_offs_suffices();
    a_board_that_still_has_power_after_its_power_off_is_reported();
    without_power_in_its_feedback_two_reports_with_a_power_off_between_are_needed();
    two_reports_in_a_row_may_both_have_been_in_transit();
    one_report_of_no_power_suffices();
    a_board_that_keeps_reporting_power_is_reported();
    two_reports_with_a_power_off_between_prove_it_where_feedback_has_no_power();
    feedback_from_before_the_power_off_proves_nothing();
    the_first_nanosecond_is_a_valid_time();
    return checks_report("board proof");
}
