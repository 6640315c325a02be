/* SPDX-License-Identifier: Apache-2.0
 * The loop wakes the line of a board: new set-points do not wait for their cycle. */
#include "board_wire.h"

/* The loop wakes the line with new set-points. */
static void kick(double velocity_rad_s)
{
    uint32_t before = w.sent_count;
    bool due = w.now_ns >= w.machine.cycle.due_ns;
    w.velocity_rad_s = velocity_rad_s;
    w.machine.newest =
        (setpoints){.stamp_ns = w.now_ns, .enabled = w.enabled, .joint_count = JOINTS_MAX};
    for (uint32_t j = 0; j < JOINTS_MAX; j++) {
        w.machine.newest.joint[j] = (joint_setpoint){
            .velocity_rad_s = velocity_rad_s, .duty = velocity_rad_s, .torque_n_m = velocity_rad_s};
    }
    board_machine_kick(&w.machine, w.now_ns);
    CHECK(w.sent_count == before && (!due || w.now_ns >= w.machine.cycle.due_ns));
}

static void a_new_set_point_is_sent_at_once_but_not_before_the_gap(void)
{
    board_table table = frames_table();
    table.period_ns = 20 * MS;
    table.gap_ns = 3 * MS;
    begin_with(table);
    arm_and_turn();
    go_on(200 * MS);
    w.now_ns = w.machine.cycle.due_ns;
    step();
    uint32_t before = w.sent_count;
    w.now_ns += 10 * MS;
    kick(1.0); /* the set-point is the same */
    step();
    CHECK(w.sent_count == before);
    kick(2.0);
    step();
    CHECK(w.sent_count == before + 1 && last_sent(TARGET, 4, 1) == 2000);
    CHECK(w.machine.cycle.due_ns == w.now_ns + 20 * MS); /* the cycle restarts here */
    w.now_ns += MS;
    kick(3.0);
    step();
    /* within the gap after the last frame */
    CHECK(w.sent_count == before + 1 && w.wake_ns == w.now_ns + 2 * MS);
    w.now_ns = w.wake_ns;
    step();
    CHECK(w.sent_count == before + 2 && last_sent(TARGET, 4, 1) == 3000);
}

static void set_points_that_change_all_the_time_double_the_frames_at_most(void)
{
    begin();
    arm_and_turn();
    uint32_t before = w.sent_count;
    for (int32_t i = 0; i < 1000; i++) {
        kick(1.0 + 0.001 * i);
        step();
        speak();
        w.now_ns += MS;
    }
    CHECK(w.sent_count - before >= 140 && w.sent_count - before <= 2 * 100 + EARLY_AT_ONCE + 1);
}

static void a_stop_is_sent_at_once_however_many_frames_came_before(void)
{
    begin();
    arm_and_turn();
    for (int32_t i = 0; i < 300; i++) {
        kick(1.0 + 0.001 * i);
        step();
        speak();
        w.now_ns += MS;
    }
    while (w.machine.cycle.due_ns <= w.now_ns + MS) { /* until the next cycle is not due soon */
        w.now_ns = w.machine.cycle.due_ns;
        step();
        w.now_ns += MS;
    }
    uint32_t before = w.sent_count;
    w.machine.cycle.early_ns = w.now_ns + 10 * w.machine.table.period_ns;
    kick(2.0);
    step();
    CHECK(w.sent_count == before);
    kick(0.0);
    step();
    CHECK(w.sent_count == before + 1 && last_sent(TARGET, 4, 1) == 0);
    kick(1.0);
    step();
    CHECK(w.sent_count == before + 1);
}

static void a_kick_sends_nothing_to_a_board_that_is_not_armed(void)
{
    begin();
    set_up();
    int64_t due_ns = w.machine.cycle.due_ns;
    kick(2.0);
    CHECK(w.machine.cycle.due_ns == due_ns && w.moving_count == 0);
}

int main(void)
{
    a_new_set_point_is_sent_at_once_but_not_before_the_gap();
    set_points_that_change_all_the_time_double_the_frames_at_most();
    a_stop_is_sent_at_once_however_many_frames_came_before();
    a_kick_sends_nothing_to_a_board_that_is_not_armed();
    return checks_report("board_kick");
}
