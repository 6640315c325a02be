/* SPDX-License-Identifier: Apache-2.0
 * Other nodes of a CAN bus that send what only motord may send. */
#include "can_wire.h"

static void begin_with_sendings(void)
{
    begin_with(2);
    w.table.sending_count = 3;
    w.table.sending[0] = SPEED;
    w.table.sending[1] = SPEED + 1;
    w.table.sending[2] = STATE | CAN_ID_REMOTE;
    restart();
}

static can_report report_of_all(void)
{
    can_report report = {0};
    can_machine_report(&w.machine, &report);
    return report;
}

static void a_frame_of_another_node_with_an_identifier_of_motord_s_is_counted_and_named(void)
{
    begin_with_sendings();
    uint8_t data[4] = {0};
    CHECK(report_of_all().foreign == 0);
    CHECK(say(SPEED + 1, data, sizeof data) == CAN_FOR_NOBODY);
    CHECK(report_of_all().foreign == 1 && report_of_all().foreign_sending == 1);
    (void)say(SPEED, data, sizeof data);
    CHECK(report_of_all().foreign == 2 && report_of_all().foreign_sending == 0);
    (void)say(STATE | CAN_ID_REMOTE, data, 0);
    CHECK(report_of_all().foreign == 3 && report_of_all().foreign_sending == 2);
}

static void frames_of_the_drives_and_of_strangers_are_not_counted_as_motord_s(void)
{
    begin_with_sendings();
    uint8_t data[8] = {0};
    report_state(0, 1);
    (void)say(STATE, data, 0); /* too short for the drive's frame */
    (void)say(SPEED - 1, data, sizeof data);
    (void)say(SPEED + 2, data, sizeof data);
    (void)say(SPEED | CAN_ID_EXTENDED, data, sizeof data);
    (void)say(SPEED | CAN_ID_REMOTE, data, 0);
    (void)say(CAN_ID_ERROR | SPEED, data, sizeof data);
    CHECK(report_of_all().foreign == 0);
}

static void only_a_set_point_frame_that_left_shows_that_motion_has_left(void)
{
    begin_with_sendings();
    w.machine.receives_own = true;
    arm(0);
    go_on(11 * MS);
    CHECK(w.machine.motion_since_ns > 0);
    can_machine_left(&w.machine, CONTROL);
    CHECK(w.machine.motion_since_ns > 0);
    can_machine_left(&w.machine, SPEED + 1);
    CHECK(w.machine.motion_since_ns == 0);
}

int main(void)
{
    a_frame_of_another_node_with_an_identifier_of_motord_s_is_counted_and_named();
    frames_of_the_drives_and_of_strangers_are_not_counted_as_motord_s();
    only_a_set_point_frame_that_left_shows_that_motion_has_left();
    return checks_report("can foreign");
}
