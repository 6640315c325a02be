/* SPDX-License-Identifier: Apache-2.0
 * Stops on a line where a drive is missing, on a wire in virtual time: which drive is sent a stop,
 * when, and which answers count. */
#include "line_wire.h"

static int64_t shut_down(void)
{
    int64_t asked_ns = w.now_ns;
    w.machine.control.shut_down = 1;
    int64_t last_ns = asked_ns;
    while (w.machine.end.stage != END_SILENT && w.now_ns < asked_ns + 2000 * MS) {
        last_ns = w.now_ns;
        go_on();
    }
    CHECK(w.machine.end.stage == END_SILENT);
    return last_ns - asked_ns;
}

static void power_offs_of_several_drives_are_one_gap_apart(void)
{
    begin_with(4, 0);
    CHECK(shut_down() < 100 * MS);
    for (uint32_t i = 0; i < 4; i++) {
        CHECK(w.power_offs[i] == 2);
    }
}

/* Drives that are ready have their cycles until the power goes off. After its power-off a drive
 * gets no more frames. */
static void once_the_power_goes_off_nothing_else_is_sent(void)
{
    begin_with(2, 0);
    arm(0);
    request(1, DRIVE_READY);
    for (int64_t end_ns = w.now_ns + 100 * MS; w.now_ns < end_ns;) {
        go_on();
    }
    w.machine.control.shut_down = 1;
    uint32_t frames = 0, power_offs = 0;
    for (int64_t limit_ns = w.now_ns + 2000 * MS;
         w.machine.end.stage != END_SILENT && w.now_ns < limit_ns;) {
        uint32_t before = w.sent_off[0] + w.sent_off[1];
        go_on();
        if (w.machine.end.stage == END_POWER_OFF) {
            frames += w.out.send != NULL;
            power_offs += w.sent_off[0] + w.sent_off[1] - before;
        }
    }
    CHECK(w.machine.end.stage == END_SILENT && power_offs == 4 && frames == power_offs);
}

static void missing_drives_do_not_keep_the_power_of_the_others_on(void)
{
    begin_with(4, 0);
    w.dead = 3;
    arm(2);
    arm(3);
    CHECK(shut_down() <= 500 * MS);
    CHECK(w.power_offs[2] >= 2 && w.power_offs[3] >= 2);
}

/* Cases of what is in transit when the end comes: the third failure of a cycle, a probe, or
 * nothing. */
static void a_missing_drive_gets_its_power_off_at_the_end_whatever_was_in_transit(void)
{
    for (uint32_t steps = 0; steps < 60; steps++) {
        begin_with(1, 0);
        arm(0);
        w.dead = 1;
        for (uint32_t i = 0; i < steps; i++) {
            go_on();
        }
        w.sent_off[0] = 0;
        CHECK(shut_down() <= 520 * MS);
        CHECK(w.sent_off[0] > 0);
    }
}

/* The quick stop and the first power-off are lost, as in a cut of 150 ms. */
static void a_drive_missing_for_a_moment_gets_its_power_off_until_it_answers(void)
{
    for (int64_t cut_ms = 0; cut_ms < 400; cut_ms += 10) {
        begin_with(1, 0);
        arm(0);
        w.dead = 1;
        int64_t asked_ns = w.now_ns;
        w.machine.control.shut_down = 1;
        while (w.now_ns < asked_ns + cut_ms * MS) {
            go_on();
        }
        CHECK(w.machine.end.stage != END_SILENT);
        w.dead = 0;
        (void)shut_down();
        CHECK(w.power_offs[0] >= 2);
        CHECK(w.machine.drive[0].state.stop == STOP_NOTHING);
    }
}

static void a_drive_missing_until_the_end_is_reported(void)
{
    begin_with(1, 0);
    arm(0);
    w.dead = 1;
    CHECK(shut_down() <= 520 * MS);
    line_report report = {.shut_down = 0};
    line_machine_report(&w.machine, &report);
    CHECK(report.drive[0].stop_waits == 1);
    CHECK(w.sent_off[0] > 4);
}

static void a_missing_drive_that_comes_back_is_switched_off_beside_one_that_does_not(void)
{
    begin_with(2, 0);
    arm(0);
    arm(1);
    w.dead = 3;
    int64_t asked_ns = w.now_ns;
    w.machine.control.shut_down = 1;
    while (w.now_ns < asked_ns + 250 * MS) {
        go_on();
    }
    w.dead = 1;
    (void)shut_down();
    CHECK(w.power_offs[1] >= 2 && w.machine.drive[1].state.stop == STOP_NOTHING);
    CHECK(w.machine.drive[0].state.stop != STOP_NOTHING);
}

static void a_missing_drive_does_not_keep_the_others_from_being_seen_at_rest(void)
{
    begin_with(2, 0);
    arm(0);
    arm(1);
    w.turning = 2;
    w.dead = 1;
    int64_t asked_ns = w.now_ns;
    w.machine.control.shut_down = 1;
    while (w.now_ns < asked_ns + 200 * MS) {
        go_on();
    }
    CHECK(w.quick_stop_ns[1] > 0 && w.power_off_ns[1] == 0);
    w.turning = 0;
    (void)shut_down();
    CHECK(w.power_off_ns[1] > asked_ns + 200 * MS && w.power_off_ns[1] < asked_ns + 300 * MS);
}

static void a_drive_whose_replies_are_lost_gets_every_frame_at_the_end(void)
{
    begin_with(2, 0);
    arm(0);
    arm(1);
    w.mute = 1;
    CHECK(shut_down() <= 520 * MS);
    CHECK(w.quick_stop_ns[0] > 0);
    CHECK(w.released[0] > 0 && w.power_offs[0] > w.released[0]);
    CHECK(w.released[1] > 0 && w.machine.drive[1].state.stop == STOP_NOTHING);
}

static void the_answer_to_an_older_stop_does_not_stand_for_a_newer_one(void)
{
    begin_with(1, 0);
    arm(0);
    w.machine.control.shut_down = 1;
    while (w.machine.work != WORK_STOP) {
        go_on();
    }
    CHECK(w.quick_stop_ns[0] > 0 && w.power_offs[0] == 0);
    request(0, DRIVE_OFF);
    line_machine_step(&w.machine, w.now_ns, w.bytes, 0, &w.out); /* the answer arrives later */
    CHECK(w.machine.drive[0].state.stop == STOP_POWER_OFF);
    (void)shut_down();
    CHECK(w.power_offs[0] == 4 && w.released[0] == 2); /* two for the request, and two for the
                                                          end */
}

static void open_again(uint32_t may_turn)
{
    CHECK(line_machine_init(&w.machine, &w.table, may_turn, w.now_ns) == 0);
    memset(w.quick_stop_ns, 0, sizeof w.quick_stop_ns);
    memset(w.sent_off, 0, sizeof w.sent_off);
}

static void a_drive_that_was_armed_is_stopped_when_the_port_is_opened_again(void)
{
    begin_with(2, 0);
    arm(0);
    open_again(1);
    int64_t opened_ns = w.now_ns;
    while (w.now_ns < opened_ns + 1200 * MS) {
        go_on();
    }
    CHECK(w.quick_stop_ns[0] > 0 && w.quick_stop_ns[0] < opened_ns + 50 * MS);
    CHECK(w.sent_off[0] > 0);
    CHECK(w.quick_stop_ns[1] == 0 && w.sent_off[1] == 0);
    CHECK(w.machine.drive[0].state.mode == DRIVE_OFF); /* Python sets it up */
}

static void a_drive_silent_after_a_reopening_gets_its_stop_repeatedly(void)
{
    begin_with(1, 0);
    arm(0);
    w.dead = 1;
    open_again(1);
    int64_t opened_ns = w.now_ns;
    while (w.now_ns < opened_ns + 1200 * MS) {
        go_on();
    }
    CHECK(w.machine.drive[0].state.mode == DRIVE_UNRESPONSIVE);
    CHECK(w.machine.drive[0].may_turn);
    CHECK(w.quick_stop_sent[0] > 4);
}

static void drives_that_another_program_left_running_stop_before_they_lose_their_power(void)
{
    begin_with(2, 0);
    line_take_over(&w.machine, w.now_ns);
    CHECK(w.machine.drive[0].state.fault_reasons == 0 &&
          w.machine.drive[1].state.fault_reasons == 0);
    /* the table has no third drive */
    CHECK(!w.machine.drive[2].may_turn && !w.machine.drive[2].state.stopping);
    w.turning = 1;
    int64_t began_ns = w.now_ns;
    while (w.now_ns < began_ns + 500 * MS) {
        go_on();
        CHECK(!w.machine.drive[0].state.sent_motion && !w.machine.drive[1].state.sent_motion);
    }
    for (uint32_t i = 0; i < 2; i++) {
        CHECK(w.quick_stop_ns[i] > 0 && w.quick_stop_ns[i] < began_ns + 50 * MS &&
              w.machine.drive[i].may_turn);
        CHECK(w.machine.drive[i].state.mode == DRIVE_READY);
    }
    CHECK(w.machine.drive[0].state.stopping && w.power_offs[0] == 0);
    CHECK(!w.machine.drive[1].state.stopping && w.power_off_ns[1] > w.quick_stop_ns[1]);
    w.turning = 0;
    while (w.now_ns < began_ns + 600 * MS) {
        go_on();
    }
    CHECK(w.power_off_ns[0] > began_ns + 500 * MS && w.power_offs[0] == 2);
}

static void a_drive_left_running_that_does_not_answer_is_stopped_repeatedly(void)
{
    begin_with(1, 0);
    w.dead = 1;
    line_take_over(&w.machine, w.now_ns);
    int64_t began_ns = w.now_ns;
    while (w.now_ns < began_ns + 1200 * MS) {
        go_on();
    }
    CHECK(w.machine.drive[0].state.mode == DRIVE_UNRESPONSIVE && w.quick_stop_sent[0] > 4);
}

static void a_wheel_that_turns_is_stopped_before_it_loses_its_power(void)
{
    begin_with(2, 0);
    arm(0);
    w.turning = 1;
    while (w.machine.drive[0].count.cycles < 3) {
        go_on();
    }
    int64_t asked_ns = w.now_ns;
    w.machine.control.shut_down = 1;
    while (w.now_ns < asked_ns + 100 * MS) {
        go_on();
    }
    CHECK(w.quick_stop_ns[0] > asked_ns && w.quick_stop_ns[0] < asked_ns + 20 * MS);
    CHECK(w.quick_stop_ns[1] == 0);
    CHECK(w.power_off_ns[0] == 0 && w.power_off_ns[1] == 0);
    w.turning = 0;
    (void)shut_down();
    CHECK(w.power_off_ns[0] > asked_ns + 100 * MS && w.power_off_ns[0] < asked_ns + 150 * MS);
    CHECK(w.power_offs[1] == 2);
}

static void a_wheel_that_does_not_stop_loses_its_power_in_time(void)
{
    begin_with(1, 0);
    arm(0);
    w.turning = 1;
    int64_t asked_ns = w.now_ns;
    (void)shut_down();
    CHECK(w.power_off_ns[0] >= asked_ns + 350 * MS && w.power_off_ns[0] < asked_ns + 400 * MS);
}

static void the_echo_of_a_stop_does_not_bring_a_dead_drive_back(void)
{
    begin_with(1, 2);
    request(0, DRIVE_READY);
    while (w.machine.drive[0].count.cycles < 3) {
        go_on();
    }
    CHECK(w.machine.echo == 1);
    request(0, DRIVE_ARMED);
    go_on();
    CHECK(w.machine.drive[0].state.mode == DRIVE_ARMED);
    w.dead = 1;
    int64_t died_ns = w.now_ns;
    while (w.now_ns < died_ns + 5000 * MS) {
        go_on();
        CHECK(w.machine.drive[0].state.mode != DRIVE_BACK);
    }
    CHECK(w.machine.drive[0].state.mode == DRIVE_UNRESPONSIVE);
    w.dead = 0;
    while (w.machine.drive[0].state.mode == DRIVE_UNRESPONSIVE && w.now_ns < died_ns + 20000 * MS) {
        go_on();
    }
    CHECK(w.machine.drive[0].state.mode == DRIVE_BACK && w.quick_stop_sent[0] >= 2);
}

static void a_drive_switched_off_before_it_has_received_zero_loses_its_power(void)
{
    begin_with(1, 0);
    arm(0);
    while (!w.machine.drive[0].state.sent_motion) {
        go_on();
    }
    w.dead = 1;
    request(0, DRIVE_STAND_DOWN);
    go_on();
    CHECK(w.machine.drive[0].state.mode == DRIVE_READY && w.machine.drive[0].state.sent_motion);
    request(0, DRIVE_OFF);
    for (uint32_t i = 0; i < 50; i++) {
        go_on();
    }
    CHECK(w.sent_off[0] > 0);
}

/* The drive turns and has received no stop yet; a frame of its cycle is in transit. */
static void begin_turning(void)
{
    begin_with(1, 0);
    arm(0);
    while (!w.machine.drive[0].state.sent_motion || w.machine.work != WORK_CYCLE) {
        go_on();
    }
}

static void look_without_bytes(void)
{
    line_machine_step(&w.machine, w.now_ns, w.bytes, 0, &w.out);
}

static void a_pending_power_off_outlives_a_new_set_up(void)
{
    for (uint32_t seen = 0; seen < 2; seen++) {
        begin_turning();
        request(0, DRIVE_OFF);
        if (seen != 0) {
            look_without_bytes(); /* otherwise the line sees only the READY that follows */
        }
        request(0, DRIVE_READY);
        look_without_bytes();
        CHECK(w.machine.drive[0].may_turn);
        for (uint32_t i = 0; i < 20; i++) {
            go_on();
        }
        CHECK(w.power_offs[0] == 2 && w.released[0] == 1);
        CHECK(w.machine.drive[0].state.mode == DRIVE_READY || seen == 0);
    }
}

static void a_drive_with_a_pending_power_off_is_not_armed(void)
{
    begin_turning();
    request(0, DRIVE_STAND_DOWN);
    request(0, DRIVE_ARMED); /* the line has not seen the stop itself */
    look_without_bytes();
    CHECK(w.machine.drive[0].state.mode == DRIVE_READY &&
          w.machine.drive[0].state.stop == STOP_POWER_OFF);
    for (uint32_t i = 0; i < 20; i++) {
        go_on();
    }
    CHECK(w.power_offs[0] == 2 && w.machine.drive[0].state.mode == DRIVE_READY);
}

static void a_drive_that_comes_to_rest_loses_its_power_despite_a_new_set_up(void)
{
    begin_with(1, 0);
    arm(0);
    open_again(1);
    w.turning = 1;
    request(0, DRIVE_READY); /* while the quick stop waits to be sent */
    int64_t opened_ns = w.now_ns;
    while (w.now_ns < opened_ns + 300 * MS) {
        go_on();
    }
    CHECK(w.quick_stop_ns[0] > opened_ns && w.power_offs[0] == 0);
    CHECK(w.machine.drive[0].state.mode == DRIVE_READY && w.machine.drive[0].state.stopping);
    w.turning = 0;
    while (w.now_ns < opened_ns + 400 * MS) {
        go_on();
    }
    CHECK(w.power_offs[0] == 2);
}

/* Cases: whatever is in transit when the stop comes, also an exchange with the missing drive. */
static void a_slow_reply_does_not_delay_the_stops_of_others(void)
{
    for (uint32_t steps = 0; steps < 40; steps++) {
        begin_with(3, 0);
        for (uint32_t i = 0; i < 3; i++) {
            w.table.drive[i].reply_timeout_ns = 200 * MS;
        }
        CHECK(line_machine_init(&w.machine, &w.table, 0, w.now_ns) == 0);
        for (uint32_t i = 0; i < 3; i++) {
            arm(i);
        }
        while (w.machine.drive[2].count.cycles < 3) {
            go_on();
        }
        w.dead = 1;
        for (uint32_t i = 0; i < steps; i++) {
            go_on();
        }
        int64_t asked_ns = w.now_ns;
        w.machine.control.shut_down = 1;
        while (w.now_ns < asked_ns + 100 * MS) {
            go_on();
        }
        CHECK(w.quick_stop_ns[1] > 0 && w.quick_stop_ns[1] - asked_ns < 60 * MS);
        CHECK(w.quick_stop_ns[2] > 0 && w.quick_stop_ns[2] - asked_ns < 60 * MS);
        CHECK(w.quick_stop_sent[0] > 0);
    }
}

int main(void)
{
    once_the_power_goes_off_nothing_else_is_sent();
    a_slow_reply_does_not_delay_the_stops_of_others();
    a_pending_power_off_outlives_a_new_set_up();
    a_drive_with_a_pending_power_off_is_not_armed();
    a_drive_that_comes_to_rest_loses_its_power_despite_a_new_set_up();
    a_drive_that_was_armed_is_stopped_when_the_port_is_opened_again();
    a_drive_silent_after_a_reopening_gets_its_stop_repeatedly();
    a_drive_switched_off_before_it_has_received_zero_loses_its_power();
    power_offs_of_several_drives_are_one_gap_apart();
    missing_drives_do_not_keep_the_power_of_the_others_on();
    a_missing_drive_gets_its_power_off_at_the_end_whatever_was_in_transit();
    a_drive_missing_for_a_moment_gets_its_power_off_until_it_answers();
    a_drive_missing_until_the_end_is_reported();
    a_missing_drive_that_comes_back_is_switched_off_beside_one_that_does_not();
    a_missing_drive_does_not_keep_the_others_from_being_seen_at_rest();
    a_drive_whose_replies_are_lost_gets_every_frame_at_the_end();
    the_answer_to_an_older_stop_does_not_stand_for_a_newer_one();
    drives_that_another_program_left_running_stop_before_they_lose_their_power();
    a_drive_left_running_that_does_not_answer_is_stopped_repeatedly();
    a_wheel_that_turns_is_stopped_before_it_loses_its_power();
    a_wheel_that_does_not_stop_loses_its_power_in_time();
    the_echo_of_a_stop_does_not_bring_a_dead_drive_back();
    return checks_report("line stops");
}
