/* SPDX-License-Identifier: Apache-2.0
 * The loop wakes the line of a CAN bus: new set-points do not wait for their cycle. */
#include "can_wire.h"

/* The loop wakes the line. The first joint has another set-point than the others. */
static void kick_apart(double first_rad_s, double velocity_rad_s)
{
    w.velocity_rad_s = velocity_rad_s;
    w.machine.newest =
        (setpoints){.stamp_ns = w.now_ns, .enabled = w.enabled, .joint_count = JOINTS_MAX};
    for (uint32_t j = 0; j < JOINTS_MAX; j++) {
        double wanted_rad_s = j == 0 ? first_rad_s : velocity_rad_s;
        w.machine.newest.joint[j] = (joint_setpoint){
            .velocity_rad_s = wanted_rad_s, .duty = wanted_rad_s, .torque_n_m = wanted_rad_s};
    }
    can_machine_kick(&w.machine, w.now_ns);
}

static void kick(double velocity_rad_s)
{
    kick_apart(velocity_rad_s, velocity_rad_s);
}

static void a_new_set_point_is_sent_at_once_to_all_armed_drives(void)
{
    begin_with(2);
    arm(0);
    arm(1);
    go_on(100 * MS);
    w.now_ns = w.machine.cycle.due_ns;
    step();
    w.now_ns += MS;
    int64_t due_ns = w.machine.cycle.due_ns;
    forget_sent();
    kick(1.0); /* the set-point is the same */
    step();
    CHECK(w.sent_count == 0);
    kick(2.0);
    CHECK(w.sent_count == 0);
    step();
    CHECK(w.sent_count == 2 && speed_in(newest_of(0)) == 200 && speed_in(newest_of(1)) == 200);
    CHECK(w.machine.cycle.due_ns == due_ns);
    step(); /* sent only once */
    CHECK(w.sent_count == 2);
}

static void one_new_set_point_sends_those_of_all_drives_at_once(void)
{
    begin_with(2);
    arm(0);
    arm(1);
    go_on(100 * MS);
    w.machine.table.sync_count = 1;
    w.machine.table.sync[0] = packet_of(0x80, 0);
    w.now_ns = w.machine.cycle.due_ns;
    step();
    w.now_ns += MS;
    forget_sent();
    kick_apart(2.0, 1.0); /* the set-point of the second joint is the same */
    (void)can_machine_step(&w.machine, w.now_ns);
    CHECK(w.sent_count == 3 && speed_in(newest_of(0)) == 200 && speed_in(newest_of(1)) == 100);
    CHECK(count_sent(0x80) == 1 && w.sent[2].id == 0x80);
    forget_sent();
    w.now_ns += MS;
    kick_apart(2.0, 3.0); /* the set-point of the first joint is the same */
    (void)can_machine_step(&w.machine, w.now_ns);
    CHECK(w.sent_count == 3 && speed_in(newest_of(0)) == 200 && speed_in(newest_of(1)) == 300);
}

static void a_kick_when_the_cycle_is_due_counts_as_the_cycle(void)
{
    begin_with(1);
    arm(0);
    go_on(100 * MS);
    w.now_ns = w.machine.cycle.due_ns;
    step();
    forget_sent();
    w.now_ns = w.machine.cycle.due_ns;
    kick(2.0);
    step();
    CHECK(count_sent(SPEED) == 1 && speed_in(newest_of(0)) == 200);
    step();
    CHECK(count_sent(SPEED) == 1);
}

static void set_points_that_change_all_the_time_double_the_frames_at_most(void)
{
    begin_with(1);
    arm(0);
    go_on(100 * MS);
    forget_sent();
    for (int32_t i = 0; i < 500; i++) {
        kick(1.0 + 0.01 * i);
        report_motion(0, 1.0F, 1.0F);
        report_state(0, 8);
        step();
        w.now_ns += MS;
    }
    CHECK(count_sent(SPEED) >= 80 && count_sent(SPEED) <= 2 * 50 + EARLY_AT_ONCE + 1);
}

static void a_stop_is_sent_at_once_however_many_frames_came_before(void)
{
    begin_with(1);
    arm(0);
    go_on(100 * MS);
    w.now_ns = w.machine.cycle.due_ns;
    step();
    w.now_ns += MS;
    forget_sent();
    w.machine.cycle.early_ns = w.now_ns + 10 * w.machine.table.period_ns;
    kick(2.0);
    step();
    CHECK(w.sent_count == 0);
    kick(0.0);
    step();
    CHECK(w.sent_count == 1 && speed_in(newest_of(0)) == 0);
    kick(1.0);
    step();
    CHECK(w.sent_count == 1);
}

static void motion_that_has_not_left_the_queue_is_not_followed_by_early_motion(void)
{
    begin_with(1);
    arm(0);
    go_on(100 * MS);
    w.machine.receives_own = true;
    can_machine_left(&w.machine, SPEED);
    w.now_ns = w.machine.cycle.due_ns;
    step(); /* the cable is unplugged: the motion frame stays in the queue */
    forget_sent();
    w.now_ns += MS;
    kick(2.0);
    step();
    CHECK(w.sent_count == 0);
    can_machine_left(&w.machine, SPEED);
    kick(3.0);
    step();
    CHECK(w.sent_count == 1 && speed_in(newest_of(0)) == 300);
}

static void a_kick_sends_nothing_to_a_drive_that_is_not_armed(void)
{
    begin_with(1);
    request(0, DRIVE_READY);
    w.now_ns = w.machine.cycle.due_ns;
    step();
    w.now_ns += MS;
    forget_sent();
    kick(2.0);
    step();
    CHECK(w.sent_count == 0);
}

static void a_kick_ignores_drives_outside_of_the_table(void)
{
    begin_with(1);
    arm(0);
    go_on(100 * MS);
    w.now_ns = w.machine.cycle.due_ns;
    step();
    w.now_ns += MS;
    forget_sent();
    w.machine.drive[1] = w.machine.drive[0]; /* beyond the only drive of the table */
    w.machine.table.drive[1] = can_drive_of(1);
    kick_apart(1.0, 2.0);
    step();
    CHECK(w.sent_count == 0);
    kick_apart(3.0, 2.0);
    (void)can_machine_step(&w.machine, w.now_ns);
    CHECK(w.sent_count == 1 && speed_in(newest_of(0)) == 300);
}

static void four_frames_may_be_sent_at_once_and_then_one_a_cycle(void)
{
    begin_with(1);
    arm(0);
    go_on(100 * MS);
    w.now_ns = w.machine.cycle.due_ns;
    step();
    w.now_ns += MS;
    w.machine.cycle.early_ns = 0;
    forget_sent();
    for (uint32_t i = 1; i <= 6; i++) {
        kick(1.0 + i);
        (void)can_machine_step(&w.machine, w.now_ns);
        CHECK(w.sent_count == (i < 4 ? i : 4));
    }
    for (int64_t early_ns = 0; early_ns < 2; early_ns++) {
        forget_sent();
        w.machine.cycle.early_ns = w.now_ns + 3 * w.machine.table.period_ns + early_ns;
        kick(20.0 + (double)early_ns);
        (void)can_machine_step(&w.machine, w.now_ns);
        CHECK(w.sent_count == (early_ns == 0));
    }
}

int main(void)
{
    a_new_set_point_is_sent_at_once_to_all_armed_drives();
    one_new_set_point_sends_those_of_all_drives_at_once();
    a_kick_when_the_cycle_is_due_counts_as_the_cycle();
    set_points_that_change_all_the_time_double_the_frames_at_most();
    a_stop_is_sent_at_once_however_many_frames_came_before();
    motion_that_has_not_left_the_queue_is_not_followed_by_early_motion();
    a_kick_sends_nothing_to_a_drive_that_is_not_armed();
    a_kick_ignores_drives_outside_of_the_table();
    four_frames_may_be_sent_at_once_and_then_one_a_cycle();
    return checks_report("can_kick");
}
