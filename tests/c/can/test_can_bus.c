/* SPDX-License-Identifier: Apache-2.0
 * A CAN bus as a whole: which frames count, a bus with full tables, its cycle, and its end. */
#include <errno.h>

#include "can_wire.h"

enum { SYNC = 0x80, OFF_WORD = 0x700 };

/* ------------------------------------------------------------------- the drive of a frame */
static void a_frame_with_a_foreign_identifier_belongs_to_no_drive_even_when_its_bytes_match(void)
{
    begin_with(2);
    w.machine.control.listen = 3;
    const uint8_t all[8] = {8, 0, 0, 0, 0, 0, 0, 0};
    const uint32_t ours[] = {STATE, STATE + 1, MOTION, MOTION + 1, ANSWER, ANSWER + 1};
    for (uint32_t i = 0; i < 6; i++) {
        const uint32_t foreign[] = {ours[i] - 2, ours[i] + 2, ours[i] | CAN_ID_EXTENDED,
                                    ours[i] | CAN_ID_REMOTE};
        for (uint32_t k = 0; k < 4; k++) {
            CHECK(say(foreign[k], all, 8) == CAN_FOR_NOBODY);
        }
    }
    CHECK(say(0, all, 8) == CAN_FOR_NOBODY && say(0x7FF, all, 8) == CAN_FOR_NOBODY);
    CHECK(w.machine.received == 0 && state_of(0)->received == 0 &&
          state_of(0)->received_ns[0] == 0);
    CHECK(state_of(1)->state.enabled == 2 && w.machine.bad_frames == 0);
    CHECK(say(STATE, all, 8) == 0 && say(STATE + 1, all, 8) == 1 && w.machine.received == 2);
}

static void identifiers_may_be_in_any_order_and_frames_of_one_are_distinguished_by_their_bytes(void)
{
    begin_with(1);
    can_drive *drive = table_of(0);
    const can_match state = drive->match[0];
    drive->match_count = 6;
    drive->match[0] = drive->match[2]; /* the highest identifier first, the lowest last */
    drive->match[2] = (can_match){
        .id = ANSWER, .bytes = 8, .begins_bytes = 1, .begins = {0x44}, .begins_mask = {0xFF}};
    drive->match[3] = (can_match){.id = ANSWER,
                                  .bytes = 8,
                                  .begins_bytes = 1,
                                  .begins = {0x45},
                                  .begins_mask = {0xFF},
                                  .input = 1};
    drive->match[4] = (can_match){.id = ANSWER, .bytes = 8}; /* all other frames of that
                                                                identifier */
    drive->match[5] = state;
    drive->input[0].field[0].place.start_bit = 0;
    restart();
    w.machine.control.listen = 1;
    const uint8_t powered[8] = {8}, answers[3][8] = {{0x43}, {0x44}, {0x45}};
    CHECK(say(STATE, powered, 1) == 0 && state_of(0)->received_ns[0] == w.now_ns);
    w.now_ns += MS;
    for (uint32_t i = 0; i < 2; i++) {
        CHECK(say(ANSWER, answers[i], 8) == 0 && state_of(0)->received_ns[0] == w.now_ns - MS);
    }
    CHECK(say(ANSWER, answers[2], 8) == 0 && state_of(0)->received_ns[0] == w.now_ns);
    w.now_ns += MS;
    CHECK(say(ANSWER, powered, 8) == 0 && state_of(0)->received_ns[0] == w.now_ns - MS &&
          w.machine.bad_frames == 0);
}

static void the_first_frames_count_even_one_nanosecond_after_boot(void)
{
    begin_with(1);
    w.now_ns = 1;
    restart();
    report_motion(0, 1.0F, 0.0F);
    CHECK(state_of(0)->sample_ns[1] == 1);
    w.now_ns = 2;
    report_motion(0, 2.0F, 0.0F); /* too soon after the last frame to count */
    CHECK(state_of(0)->sample_ns[1] == 1 && w.machine.joint[0].feedback.count == 1000);
    w.now_ns = 1 + 5 * MS;
    report_motion(0, 3.0F, 0.0F);
    CHECK(state_of(0)->sample_ns[1] == w.now_ns && w.machine.joint[0].feedback.count == 3000);
}

static void the_core_gets_feedback_of_a_drive_that_is_set_up_and_by_its_fast_frames_alone(void)
{
    begin_with(2);
    go_on(50 * MS);
    CHECK(w.machine.feedback_mask == 0 && state_of(0)->cycles == 0); /* both drives send, and are
                                                                        off */
    table_of(0)->match_count = 4;
    table_of(0)->match[3] = (can_match){.id = ANSWER + 0x20, .bytes = 1, .input = 3};
    table_of(0)->input_count = 3;
    table_of(0)->input[2] =
        (can_input){.field_count = 1,
                    .field[0] = {.place = {.length = 8},
                                 .meaning = {.kind = FIELD_TEMPERATURE, .si_per_raw = 1.0}}};
    restart();
    go_on(20 * MS);
    request(0, DRIVE_READY);
    go_on(50 * MS);
    uint64_t cycles = state_of(0)->cycles;
    CHECK(cycles >= 4 && w.machine.feedback_mask == 1);
    w.machine.feedback_mask = 0;
    const uint8_t warm = 40;
    (void)say(ANSWER + 0x20, &warm, 1);
    CHECK(w.machine.joint[0].feedback.temperature_c == 40.0);
    CHECK(state_of(0)->cycles == cycles && w.machine.feedback_mask == 0);
}

static void only_a_frame_that_reports_power_contradicts_the_mode_of_a_drive(void)
{
    begin_with(1);
    /* the second input reports the power now, not the first */
    const can_input state = table_of(0)->input[0];
    table_of(0)->input[0] = table_of(0)->input[1];
    table_of(0)->input[1] = state;
    table_of(0)->match[0].input = 2;
    table_of(0)->match[1].input = 1;
    restart();
    go_on(20 * MS);
    request(0, DRIVE_READY);
    w.silent = true;
    report_motion(0, 1.0F, 0.0F);
    report_state(0, 8);
    CHECK(state_of(0)->state.still_enabled == 1);
    for (uint32_t i = 0; i < 10; i++) {
        w.now_ns += 6 * MS;
        report_motion(0, 1.0F, 0.0F);
    }
    CHECK(state_of(0)->state.still_enabled == 1 && state_of(0)->state.fault_reasons == 0);
    report_state(0, 8);
    CHECK(state_of(0)->state.still_enabled == 2);
}

/* ------------------------------------------------------------------------ the beginning */
static void a_bad_table_is_refused_and_every_drive_begins_unknown(void)
{
    begin_with(2);
    can_report report = {0};
    can_machine_report(&w.machine, &report);
    for (uint32_t i = 0; i < 2; i++) {
        CHECK(report.drive[i].mode == DRIVE_OFF && report.drive[i].enabled == 2 &&
              report.drive[i].stop_waits == 0);
    }
    w.table.period_ns = 0;
    CHECK(can_machine_init(&w.machine, &w.table, &(can_before){0}, take, &w, w.now_ns) == -EINVAL);
}

static void a_drive_that_may_turn_after_a_reopening_is_stopped_less_and_less_often(void)
{
    begin_with(3);
    w.silent = true;
    can_before before = {.may_turn = 1U << 2};
    CHECK(can_machine_init(&w.machine, &w.table, &before, take, &w, w.now_ns) == 0);
    int64_t opened_ns = w.now_ns;
    go_on(650 * MS);
    CHECK(count_sent(SPEED) == 0 && count_sent(SPEED + 1) == 0);
    int64_t stops_ns[3] = {0};
    uint32_t stops = 0;
    for (uint32_t i = 0; i < w.sent_count; i++) {
        if (w.sent[i].data[0] == QUICK_STOP && stops < 3 &&
            (stops == 0 || w.sent_ns[i] > stops_ns[stops - 1])) {
            stops_ns[stops++] = w.sent_ns[i];
        }
    }
    CHECK(stops == 3 && stops_ns[0] == opened_ns && stops_ns[1] == opened_ns + 100 * MS);
    CHECK(stops_ns[2] == opened_ns + 300 * MS);
}

static void the_cycles_keep_the_grid_that_began_with_the_bus(void)
{
    begin_with(1);
    w.now_ns += 3 * MS; /* the thread begins late */
    step();
    CHECK(w.machine.cycle.count == 1 && w.wake_ns == 1010 * MS);
}

/* -------------------------------------------------------------------------- full tables */
static void fill_drive(uint32_t n)
{
    can_drive *drive = table_of(n);
    drive->output_count = CAN_OUTPUTS_MAX;
    for (uint32_t o = 0; o < CAN_OUTPUTS_MAX; o++) {
        drive->output[o] = (can_output){.packet = packet_of(SPEED + n + 8 * o, 8),
                                        .setpoint_count = CAN_SETPOINTS_MAX};
        for (uint32_t i = 0; i < CAN_SETPOINTS_MAX; i++) {
            drive->output[o].setpoint[i] = (can_setpoint){
                .place = {.start_bit = 16 * i, .length = 16, .form = CAN_SIGNED},
                .scale = {.joint = n, .raw_per_si = 100.0, .raw_min = -1000.0, .raw_max = 1000.0}};
        }
    }
    const can_match motion = drive->match[1];
    const can_field power = drive->input[0].field[0];
    drive->input_count = CAN_INPUTS_MAX;
    drive->match_count = CAN_MATCHES_MAX;
    for (uint32_t i = 0; i < CAN_MATCHES_MAX; i++) {
        drive->match[i] = (can_match){.id = 0x10000 + 128 * n + i, .bytes = 1};
    }
    for (uint32_t i = 0; i < CAN_INPUTS_MAX; i++) {
        drive->input[i] = i == 1 ? drive->input[1] : (can_input){0};
    }
    can_input *last = &drive->input[CAN_INPUTS_MAX - 1];
    *last = (can_input){.silence_ns = 300 * MS, .fast = 1, .field_count = CAN_FIELDS_MAX};
    for (uint32_t i = 0; i + 1 < CAN_FIELDS_MAX; i++) {
        last->field[i] =
            (can_field){.place = {.length = 8},
                        .meaning = {.kind = FIELD_TEMPERATURE, .joint = n, .si_per_raw = 1.0}};
    }
    last->field[CAN_FIELDS_MAX - 1] = power;
    drive->match[CAN_MATCHES_MAX - 2] = motion;
    drive->match[CAN_MATCHES_MAX - 1] =
        (can_match){.id = STATE + n, .bytes = 1, .input = CAN_INPUTS_MAX, .begins_bytes = 0};
    drive->match[0] =
        (can_match){.id = ANSWER + n, .bytes = CAN_BYTES_MAX, .begins_bytes = CAN_BEGINS_MAX};
    memset(drive->match[0].begins_mask, 0xFF, CAN_BEGINS_MAX);
    drive->poll_count = drive->slow_count = drive->probe_count = CAN_POLLS_MAX;
    for (uint32_t i = 0; i < CAN_POLLS_MAX; i++) {
        drive->poll[i] = drive->slow[i] = drive->probe[i] = packet_of(0x600 + 8 * n + i, 0);
    }
    drive->quick_stop_count = drive->disarm_count = CAN_STOP_MAX;
    for (uint32_t i = 0; i < CAN_STOP_MAX; i++) {
        drive->quick_stop[i] = (can_write){.packet = packet_of(CONTROL + 8 * n + i, 1)};
        drive->disarm[i] = (can_write){.packet = packet_of(OFF_WORD + 8 * n + i, 1)};
    }
}

/* The last entry of each list counts. The sanitizers check that nothing beyond it is touched. */
static void a_full_table_is_driven_to_its_last_entry(void)
{
    begin_with(CAN_DRIVES_MAX);
    for (uint32_t n = 0; n < CAN_DRIVES_MAX; n++) {
        fill_drive(n);
    }
    w.table.period_ns = 50 * MS;
    w.table.sync_count = CAN_SYNCS_MAX;
    for (uint32_t i = 0; i < CAN_SYNCS_MAX; i++) {
        w.table.sync[i] = packet_of(SYNC + i, 0);
    }
    restart();
    const uint32_t last = CAN_DRIVES_MAX - 1;
    uint8_t answer[CAN_BYTES_MAX] = {0};
    w.machine.control.listen = 1U << last;
    CHECK(say(ANSWER + last, answer, CAN_BYTES_MAX) == last);
    answer[CAN_BYTES_MAX - 1] = 1;
    CHECK(say(ANSWER + last, answer, CAN_BYTES_MAX) == CAN_FOR_NOBODY && w.machine.bad_frames == 1);
    CHECK(say(CAN_ID_EXTENDED | 0x1FFFFFFF, answer, 8) == CAN_FOR_NOBODY);
    for (uint32_t n = 0; n < CAN_DRIVES_MAX; n++) {
        arm(n);
        w.powered = n == last;
    }
    for (uint32_t n = 0; n < CAN_DRIVES_MAX; n++) {
        /* the other drives report that they have no power */
        CHECK(state_of(n)->state.mode == (n == last ? DRIVE_ARMED : DRIVE_OFF));
    }
    w.powered = true;
    forget_sent();
    go_on(60 * MS);
    for (uint32_t i = 0; i < CAN_SYNCS_MAX; i++) {
        CHECK(count_sent(SYNC + i) >= 1);
    }
    uint32_t asked = 0x600 + 8 * last;
    CHECK(count_sent(asked + CAN_POLLS_MAX - 1) >= 1 && count_sent(asked) >= 1);
    const can_packet *moving = newest_of(last + 8 * (CAN_OUTPUTS_MAX - 1));
    CHECK(can_get(moving->data, &(can_place){.start_bit = 48, .length = 16, .form = CAN_SIGNED}) ==
          100);
    CHECK(state_of(last)->state.enabled == 1 &&
          w.machine.joint[last].feedback.temperature_c == 8.0);
    w.machine.control.shut_down = 1;
    forget_sent();
    step();
    w.powered = false;
    go_on(400 * MS);
    CHECK(count_sent(CONTROL + 8 * last + CAN_STOP_MAX - 1) == 1 &&
          w.machine.end.stage == END_SILENT);
    for (uint32_t n = 0; n < CAN_DRIVES_MAX; n++) {
        CHECK(count_sent(OFF_WORD + 8 * n + CAN_STOP_MAX - 1) >= 1);
    }
}

/* The entry after the last drive looks like a drive that moves and stops. It is neither read nor
 * changed. */
static void a_line_has_eight_drives_at_most(void)
{
    begin_with(CAN_DRIVES_MAX);
    w.velocity_rad_s = 0.0;
    step();
    uint8_t behind[sizeof w.machine.joint];
    for (int stop = STOP_NOTHING; stop <= STOP_POWER_OFF; stop++) {
        can_drive_state mover = {.state.mode = DRIVE_ARMED,
                                 .state.stop = (uint32_t)stop,
                                 .state.sent_motion = true,
                                 .state.stopping = true,
                                 .may_turn = true,
                                 .missing = 1,
                                 .probe_at_ns = w.now_ns,
                                 .unresponsive_since_ns = w.now_ns};
        size_t bytes = sizeof mover < sizeof behind ? sizeof mover : sizeof behind;
        memcpy(w.machine.joint, &mover, bytes);
        memcpy(behind, w.machine.joint, sizeof behind);
        uint32_t sent = w.sent_count;
        w.now_ns += 10 * MS;
        w.machine.cycle.due_ns = w.now_ns + 100 * MS;
        step();
        CHECK(w.wake_ns == w.now_ns + 20 * MS && w.sent_count == sent);
        w.machine.cycle.due_ns = w.now_ns;
        step();
        CHECK(memcmp(behind, w.machine.joint, sizeof behind) == 0);
    }
    w.machine.control.shut_down = 1;
    step();
    for (uint32_t n = 0; n < CAN_DRIVES_MAX; n++) {
        report_state(n, 1);
    }
    w.now_ns = w.wake_ns;
    step();
    CHECK(w.machine.end.stage == END_SILENT && memcmp(behind, w.machine.joint, sizeof behind) == 0);
}

/* -------------------------------------------------------------------------------- cycle */
static void two_syncs_end_each_cycle(void)
{
    begin_with(1);
    w.table.sync_count = 2;
    w.table.sync[0] = packet_of(SYNC, 0);
    w.table.sync[1] = packet_of(SYNC + 1, 0);
    restart();
    go_on(95 * MS);
    CHECK(count_sent(SYNC) == 10 && count_sent(SYNC + 1) == 10);
}

static void begin_with_turning_drive(void)
{
    begin_with(1);
    table_of(0)->idle_setpoints = 0;
    w.table.setpoint_timeout_ns = 1000 * MS;
    restart();
    w.machine.receives_own = true;
}

static void an_idle_bus_is_given_motion_at_once(void)
{
    begin_with_turning_drive();
    arm(0);
    go_on(11 * MS);
    CHECK(w.sent_count >= 1 && w.sent[0].id == SPEED && speed_in(&w.sent[0]) == 100);
}

static void a_bus_that_took_nothing_since_motion_left_it_is_given_zero_first(void)
{
    begin_with_turning_drive();
    arm(0);
    go_on(11 * MS);
    CHECK(speed_in(newest_of(0)) == 100);
    can_machine_left(&w.machine, SPEED); /* all frames have left the kernel's queue */
    w.full = true;
    go_on(35 * MS);
    CHECK(w.machine.clogged && w.machine.motion_since_ns == 0);
    w.full = false;
    forget_sent();
    go_on(6 * MS);
    CHECK(w.sent_count >= 1 && speed_in(&w.sent[0]) == 0 && !w.machine.clogged);
    go_on(10 * MS);
    CHECK(speed_in(newest_of(0)) == 100);
}

static void each_cycle_whose_motion_does_not_leave_is_counted_as_not_taken(void)
{
    begin_with_turning_drive();
    arm(0);
    go_on(11 * MS);
    uint64_t before = w.machine.tx_full;
    go_on(100 * MS); /* no frame is reported to have left */
    CHECK(w.machine.tx_full > before && w.machine.tx_full <= before + 10);
}

static void motion_may_wait_for_five_milliseconds_where_a_cycle_is_shorter(void)
{
    begin_with_turning_drive();
    w.machine.table.period_ns = MS;
    arm(0);
    step();
    int64_t sent_at_ns = w.machine.motion_since_ns;
    CHECK(sent_at_ns > 0);
    while (w.now_ns < sent_at_ns + 5 * MS) {
        w.now_ns += MS;
        step();
        CHECK(!w.machine.motion_stays);
    }
    w.now_ns++;
    step();
    CHECK(w.machine.motion_stays);
}

/* ---------------------------------------------------------------------------------- end */
static void cycles_continue_until_the_end_takes_the_power(void)
{
    begin_with(1);
    w.table.period_ns = 2 * MS;
    table_of(0)->disarm[0] = (can_write){.packet = packet_of(OFF_WORD, 1)};
    restart();
    arm(0);
    w.reported_rad_s = 1.0;
    go_on(50 * MS);
    int64_t asked_ns = w.now_ns;
    w.machine.control.shut_down = 1;
    w.not_taken = OFF_WORD;
    forget_sent();
    go_on(349 * MS);
    CHECK(w.machine.end.stage == END_RESTING && count_sent(SPEED) >= 170);
    go_on(asked_ns + 350 * MS - w.now_ns);
    step();
    CHECK(w.machine.end.stage == END_POWER_OFF);
    forget_sent();
    w.machine.notify = false;
    go_on(asked_ns + 480 * MS - w.now_ns);
    /* no set-point gives the drive power again */
    CHECK(w.machine.end.stage == END_POWER_OFF && w.sent_count == 0 && !w.machine.notify);
    step();
    CHECK(w.machine.end.stage == END_SILENT && w.machine.notify);
}

static void the_end_sends_each_drive_its_power_off_once_and_is_over_with_the_last(void)
{
    begin_with(2);
    for (uint32_t i = 0; i < 2; i++) {
        table_of(i)->disarm[0] = (can_write){.packet = packet_of(OFF_WORD + i, 1)};
    }
    restart();
    arm(0);
    w.reported_rad_s = 1.0;
    go_on(50 * MS);
    w.machine.control.shut_down = 1;
    w.full = true; /* the bus does not even take the quick stop */
    go_on(360 * MS);
    CHECK(w.machine.end.stage == END_POWER_OFF);
    w.full = false;
    forget_sent();
    step();
    CHECK(w.machine.end.stage == END_POWER_OFF && count_sent(OFF_WORD) == 1 &&
          count_sent(OFF_WORD + 1) == 1);
    report_state(0, 1);
    report_state(1, 1);
    step();
    CHECK(w.machine.end.stage == END_SILENT && count_sent(OFF_WORD) == 1 &&
          count_sent(OFF_WORD + 1) == 1);
    CHECK(!state_of(0)->state.stopping && !state_of(1)->state.stopping);
}

static void the_report_has_fault_words_and_pending_stops(void)
{
    begin_with(2);
    table_of(1)->input[0].field_count = 2;
    table_of(1)->input[0].field[1] =
        (can_field){.place = {.length = 8},
                    .meaning = {.joint = JOINTS_MAX - 1, .kind = FIELD_FAULT, .si_per_raw = 1.0}};
    restart();
    arm(0);
    report_state(1, 5);
    w.machine.joint[0].fault_word = 3;
    w.full = true;
    request(0, DRIVE_OFF);
    can_report report = {0};
    can_machine_report(&w.machine, &report);
    CHECK(report.fault_word[JOINTS_MAX - 1] == 5 && report.fault_word[0] == 3 &&
          report.fault_word[1] == 0);
    CHECK(report.drive[0].stop_waits == 1 && report.drive[1].stop_waits == 0);
}

int main(void)
{
    a_frame_with_a_foreign_identifier_belongs_to_no_drive_even_when_its_bytes_match();
    identifiers_may_be_in_any_order_and_frames_of_one_are_distinguished_by_their_bytes();
    the_first_frames_count_even_one_nanosecond_after_boot();
    the_core_gets_feedback_of_a_drive_that_is_set_up_and_by_its_fast_frames_alone();
    only_a_frame_that_reports_power_contradicts_the_mode_of_a_drive();
    a_bad_table_is_refused_and_every_drive_begins_unknown();
    a_drive_that_may_turn_after_a_reopening_is_stopped_less_and_less_often();
    the_cycles_keep_the_grid_that_began_with_the_bus();
    a_full_table_is_driven_to_its_last_entry();
    a_line_has_eight_drives_at_most();
    two_syncs_end_each_cycle();
    an_idle_bus_is_given_motion_at_once();
    a_bus_that_took_nothing_since_motion_left_it_is_given_zero_first();
    each_cycle_whose_motion_does_not_leave_is_counted_as_not_taken();
    motion_may_wait_for_five_milliseconds_where_a_cycle_is_shorter();
    cycles_continue_until_the_end_takes_the_power();
    the_end_sends_each_drive_its_power_off_once_and_is_over_with_the_last();
    the_report_has_fault_words_and_pending_stops();
    return checks_report("can bus");
}
