/* SPDX-License-Identifier: Apache-2.0
 * A drive with two wheels on a CAN bus: set-points in one frame, and how its reports are read. */
#include "can_wire.h"

enum { SECOND = 0x410, HEALTH = 0x510, POWERS = 0x520, HARMLESS = 4 };

static can_field field_of(uint32_t joint, uint32_t kind, uint32_t start_bit, uint32_t length)
{
    return (can_field){
        .place = {.start_bit = start_bit, .length = length, .form = CAN_SIGNED},
        .meaning = {.joint = joint, .kind = kind, .counter_bits = 16, .si_per_raw = 1.0}};
}

static void add_input(uint32_t id, uint32_t fast, const can_field *field, uint32_t count)
{
    can_drive *drive = table_of(0);
    can_input *input = &drive->input[drive->input_count++];
    *input = (can_input){.fast = fast, .field_count = count};
    memcpy(input->field, field, count * sizeof *field);
    drive->match[drive->match_count++] =
        (can_match){.id = id, .bytes = 8, .input = drive->input_count};
}

/* Wheel 0 reports its motion in the usual frame. Count and speed of wheel 1 are not 0 for raw 0.
 * Both wheels report health and power periodically. */
static void begin_with_two_wheels(void)
{
    begin_with(1);
    can_output *output = &table_of(0)->output[0];
    output->packet.bytes = 6;
    output->setpoint_count = 2;
    output->setpoint[1] = output->setpoint[0];
    output->setpoint[1].place.start_bit = 32;
    output->setpoint[1].scale.joint = 1;
    can_field second[2] = {field_of(1, FIELD_COUNT, 0, 16), field_of(1, FIELD_VELOCITY, 16, 16)};
    second[0].si_at_zero = 5.0;
    second[1].si_at_zero = -1.0;
    add_input(SECOND, 1, second, 2);
    const can_field powers[3] = {field_of(1, FIELD_CURRENT, 0, 8), field_of(1, FIELD_VOLTAGE, 8, 8),
                                 field_of(1, FIELD_TEMPERATURE, 16, 8)};
    add_input(POWERS, 0, powers, 3);
    can_field fault = field_of(1, FIELD_FAULT, 0, 32);
    fault.meaning.harmless_bits = HARMLESS;
    add_input(HEALTH, 0, &fault, 1);
    restart();
}

static void report_second(int16_t count, int16_t speed)
{
    const int16_t both[4] = {count, speed};
    (void)say(SECOND, both, sizeof both);
}

static void report_health(uint32_t word)
{
    const uint32_t words[2] = {word};
    (void)say(HEALTH, words, sizeof words);
}

static void want(double first_rad_s, double second_rad_s)
{
    w.enabled = 2;
    w.machine.newest =
        (setpoints){.stamp_ns = w.now_ns,
                    .enabled = 1,
                    .joint_count = 2,
                    .joint = {{.velocity_rad_s = first_rad_s}, {.velocity_rad_s = second_rad_s}}};
}

static int16_t second_speed(void)
{
    return (int16_t)can_get(newest_of(0)->data,
                            &(can_place){.start_bit = 32, .length = 16, .form = CAN_SIGNED});
}

static const joint_feedback *feedback_of(uint32_t joint)
{
    return &w.machine.joint[joint].feedback;
}

/* --------------------------------------------------------------------------- set-points */
static void both_wheels_are_sent_in_one_frame(void)
{
    begin_with_two_wheels();
    arm(0);
    want(1.0, 0.0);
    go_on(15 * MS);
    CHECK(speed_in(newest_of(0)) == 100 && second_speed() == 0 && state_of(0)->state.sent_motion);
    want(0.0, -2.0);
    forget_sent();
    go_on(90 * MS);
    CHECK(speed_in(newest_of(0)) == 0 && second_speed() == -200 && state_of(0)->state.sent_motion);
    /* while one wheel turns, the zero of the other one causes no stop frames between cycles */
    CHECK(w.sent_count >= 8 && w.sent_count <= 10);
    want(0.0, 0.0);
    step();
    CHECK(second_speed() == 0 && !state_of(0)->state.sent_motion);
}

static void a_drive_is_at_rest_when_both_of_its_wheels_rest(void)
{
    begin_with_two_wheels();
    arm(0);
    report_second(0, 11);
    go_on(30 * MS);
    w.enabled = 2;
    go_on(150 * MS);
    CHECK(first_sent_ns(0, QUICK_STOP) > 0 && state_of(0)->state.stopping &&
          first_sent_ns(0, DISABLE) == 0);
    report_second(0, 1); /* 0 rad/s */
    step();
    CHECK(!state_of(0)->state.stopping);
    step();
    CHECK(newest_of(0)->data[0] == DISABLE);
}

static void each_kind_of_set_point_is_sent_with_its_own_scale(void)
{
    const uint32_t kinds[] = {SETPOINT_VELOCITY, SETPOINT_DUTY, SETPOINT_TORQUE};
    for (uint32_t i = 0; i < 3; i++) {
        begin_with_two_wheels();
        table_of(0)->output[0].setpoint[0].scale.kind = kinds[i];
        restart();
        arm(0);
        want(0.0, 0.0);
        w.machine.newest.joint[0] =
            (joint_setpoint){.velocity_rad_s = 1.0, .duty = 2.0, .torque_n_m = 3.0};
        go_on(15 * MS);
        CHECK(speed_in(newest_of(0)) == 100 * (int16_t)(i + 1));
    }
}

/* ----------------------------------------------------------------------------- feedback */
static void numbers_without_their_top_bit_are_positive(void)
{
    const uint8_t data[2] = {0x00, 0x40};
    CHECK(can_get(data, &(can_place){.length = 16, .form = CAN_SIGNED}) == 0x4000);
    CHECK(can_get(data, &(can_place){.length = 15, .form = CAN_SIGNED}) == -0x4000);
}

static void the_value_at_raw_zero_is_added(void)
{
    begin_with_two_wheels();
    report_second(10, 3);
    CHECK(feedback_of(1)->count == 15 && feedback_of(1)->velocity_rad_s == 2.0);
    report_second(-7, 0);
    CHECK(feedback_of(1)->count == 0xFFFE && feedback_of(1)->velocity_rad_s == -1.0);
    const int8_t powers[8] = {-3, 24, 40};
    (void)say(POWERS, powers, sizeof powers);
    CHECK(feedback_of(1)->current_a == -3.0 && feedback_of(1)->voltage_v == 24.0 &&
          feedback_of(1)->temperature_c == 40.0);
}

static void feedback_has_the_time_of_its_count_else_of_its_speed_else_of_its_newest_frame(void)
{
    begin_with_two_wheels();
    table_of(0)->input[1].field_count = 1; /* wheel 0: the count alone; its speed is in HEALTH */
    table_of(0)->input[2].field[0].meaning.kind = FIELD_CURRENT; /* wheel 1: no count */
    table_of(0)->input[4].field[0] = field_of(0, FIELD_VELOCITY, 0, 32);
    restart();
    request(0, DRIVE_READY);
    int64_t count_ns = w.now_ns;
    report_motion(0, 1.0F, 0.0F);
    w.now_ns += MS;
    int64_t speed_ns = w.now_ns;
    report_second(0, 0);
    w.now_ns += MS;
    report_health(0);
    const uint8_t powers[8] = {0};
    (void)say(POWERS, powers, sizeof powers);
    report_state(0, 8); /* the last fast frame: now both wheels are known */
    CHECK(w.machine.feedback_mask == 3 && state_of(0)->cycles == 1);
    CHECK(feedback_of(0)->stamp_ns == count_ns && feedback_of(1)->stamp_ns == speed_ns);
    CHECK(feedback_of(0)->enabled == 1 && feedback_of(1)->enabled == 1);
    table_of(0)->input[2].field[1].meaning.kind = FIELD_VOLTAGE; /* wheel 1: no speed either */
    restart();
    request(0, DRIVE_READY);
    report_motion(0, 1.0F, 0.0F);
    report_second(0, 0);
    w.now_ns += MS;
    (void)say(POWERS, powers, sizeof powers);
    int64_t powers_ns = w.now_ns;
    w.now_ns += MS;
    report_state(0, 8);
    /* the report of power is no value of the wheel */
    CHECK(feedback_of(1)->stamp_ns == powers_ns);
}

static void frames_right_after_the_set_up_count_and_power_is_unknown_before(void)
{
    begin_with_two_wheels();
    report_state(0, 8);
    report_motion(0, 1.0F, 0.0F);
    report_second(0, 1);
    request(0, DRIVE_READY);
    CHECK(state_of(0)->state.enabled == 2);
    w.machine.feedback_mask = 0;
    w.now_ns += MS; /* sooner than the minimum spacing of wheel 0's frames */
    report_motion(0, 2.0F, 0.0F);
    report_second(0, 1);
    CHECK(w.machine.feedback_mask == 0);
    report_state(0, 1);
    CHECK(w.machine.feedback_mask == 3 && feedback_of(0)->count == 2000);
}

static void a_fault_word_is_a_change_once_and_stops_unless_it_is_a_warning(void)
{
    begin_with_two_wheels();
    w.machine.notify = false;
    report_health(0);
    CHECK(!w.machine.notify && state_of(0)->faults == 0);
    report_health(HARMLESS);
    CHECK(w.machine.notify && feedback_of(1)->drive_faults == 0 &&
          w.machine.joint[1].fault_word == HARMLESS);
    CHECK(state_of(0)->faults == 0);
    w.machine.notify = false;
    report_health(HARMLESS | 1);
    CHECK(w.machine.notify && feedback_of(1)->drive_faults == 1 &&
          feedback_of(0)->drive_faults == 0);
    CHECK(state_of(0)->faults == 1 && state_of(0)->last_fault == (HARMLESS | 1) &&
          state_of(0)->last_fault_joint == 1);
    w.machine.notify = false;
    report_health(HARMLESS | 1);
    CHECK(!w.machine.notify && state_of(0)->faults == 1);
    w.machine.notify = true; /* set for another reason */
    report_health(HARMLESS | 1);
    CHECK(w.machine.notify);
    report_health(0);
    CHECK(feedback_of(1)->drive_faults == 0 && state_of(0)->faults == 1 &&
          state_of(0)->last_fault == (HARMLESS | 1));
    can_report report = {0};
    can_machine_report(&w.machine, &report);
    CHECK(report.drive[0].faults == 1 && report.drive[0].last_fault_joint == 1 &&
          report.fault_word[1] == 0);
}

static void a_fault_that_is_a_number_stops_unless_it_is_listed(void)
{
    begin_with_two_wheels();
    field_meaning *meaning = &table_of(0)->input[4].field[0].meaning;
    meaning->is_code = 1;
    meaning->harmless_codes = 2;
    meaning->harmless[0] = 7;
    meaning->harmless[1] = 9;
    meaning->harmless[2] = 11; /* beyond the count of two */
    restart();
    const uint32_t words[] = {7, 9, 11, 5, 0}, stop[] = {0, 0, 11, 5, 0};
    for (uint32_t i = 0; i < 5; i++) {
        report_health(words[i]);
        CHECK(feedback_of(1)->drive_faults == stop[i]);
    }
}

static void a_joint_without_set_points_stands_still(void)
{
    begin_with_two_wheels();
    arm(0);
    want(1.0, 1.0);
    w.machine.newest.joint_count = 1;
    go_on(15 * MS);
    CHECK(speed_in(newest_of(0)) == 100 && second_speed() == 0);
}

static void each_kind_of_set_point_is_sent_to_its_own_wheel(void)
{
    begin_with_two_wheels();
    table_of(0)->output[0].setpoint[0].scale.kind = SETPOINT_TORQUE;
    table_of(0)->output[0].setpoint[1].scale.kind = SETPOINT_DUTY;
    restart();
    arm(0);
    want(0.0, 0.0);
    w.machine.newest.joint[0] = w.machine.newest.joint[1] =
        (joint_setpoint){.velocity_rad_s = 1.0, .duty = 0.5, .torque_n_m = -3.0};
    go_on(15 * MS);
    CHECK(speed_in(newest_of(0)) == -300 && second_speed() == 50);
}

static void a_range_that_does_not_fit_the_place_is_refused(void)
{
    char name[FIELD_NAME_BYTES];
    begin_with(1);
    can_setpoint *setpoint = &w.table.drive[0].output[0].setpoint[0];
    setpoint->place.length = 12;
    for (uint32_t form = CAN_UNSIGNED; form <= CAN_SIGNED; form++) {
        double least = form == CAN_SIGNED ? -2048.0 : 0.0,
               most = form == CAN_SIGNED ? 2047.0 : 4095.0;
        setpoint->place.form = form;
        setpoint->scale.raw_min = least;
        setpoint->scale.raw_max = most;
        CHECK(can_table_check(&w.table, name) == NULL);
        setpoint->scale.raw_max = most + 1.0;
        CHECK(can_table_check(&w.table, name) != NULL && strstr(name, "setpoint.raw_max") != NULL);
        setpoint->scale.raw_max = most;
        setpoint->scale.raw_min = least - 1.0;
        CHECK(can_table_check(&w.table, name) != NULL && strstr(name, "setpoint.raw_min") != NULL);
    }
}

static void a_set_point_beyond_the_count_does_not_move(void)
{
    begin_with(1);
    w.machine.drive[0].state.mode = DRIVE_ARMED;
    can_output *output = &w.machine.table.drive[0].output[0];
    output->setpoint[1] = output->setpoint[0]; /* a second set-point, beyond the count of one */
    output->setpoint[1].scale.joint = 3;
    w.machine.newest = (setpoints){.stamp_ns = w.now_ns, .enabled = 1, .joint_count = JOINTS_MAX};
    w.machine.newest.joint[3].velocity_rad_s = 1.0;
    CHECK(!can_wants_motion(&w.machine, 0));
    output->setpoint_count = 2;
    CHECK(can_wants_motion(&w.machine, 0));
}

static void a_field_beyond_the_count_does_not_report_power(void)
{
    begin_with(1);
    w.table.drive[0].input[1].field[2] = w.table.drive[0].input[0].field[0]; /* one too many */
    restart();
    CHECK(w.machine.drive[0].powers == 1);
    w.table.drive[0].input[1].field_count = 3;
    restart();
    CHECK(w.machine.drive[0].powers == 3);
}

static void a_count_of_two_to_the_power_of_62_is_refused_as_a_position(void)
{
    begin_with(1);
    table_of(0)->input[1].spacing_ns = 0;
    table_of(0)->input[1].field[0].meaning.si_per_raw = 1.0;
    table_of(0)->input[1].field[0].meaning.counter_bits = 64;
    restart();
    report_motion(0, 4611686018427387904.0F, 0.0F);
    CHECK(w.machine.joint[0].no_number && w.machine.joint[0].feedback.count == 0);
    report_motion(0, 4611685743549480960.0F, 0.0F);
    CHECK(!w.machine.joint[0].no_number &&
          w.machine.joint[0].feedback.count == UINT64_C(4611685743549480960));
}

static void a_frame_came_between_the_look_that_found_nothing_and_now(void)
{
    const int64_t now_ns = 100 * MS, emptied_ns = 90 * MS;
    CHECK(can_stamp_ns(3 * MS, emptied_ns, now_ns) == 97 * MS);
    CHECK(can_stamp_ns(10 * MS - 1, emptied_ns, now_ns) == emptied_ns + 1);
    CHECK(can_stamp_ns(1, emptied_ns, now_ns) == now_ns - 1);
    const int64_t old_ns[] = {10 * MS, 10 * MS + 1, 150 * MS, INT64_MAX};
    const int64_t future_ns[] = {0, -1, -20 * MS, INT64_MIN};
    for (int i = 0; i < 4; i++) {
        CHECK(can_stamp_ns(old_ns[i], emptied_ns, now_ns) == emptied_ns);
        CHECK(can_stamp_ns(future_ns[i], emptied_ns, now_ns) == now_ns);
    }
}

int main(void)
{
    a_frame_came_between_the_look_that_found_nothing_and_now();
    a_range_that_does_not_fit_the_place_is_refused();
    both_wheels_are_sent_in_one_frame();
    a_drive_is_at_rest_when_both_of_its_wheels_rest();
    each_kind_of_set_point_is_sent_with_its_own_scale();
    numbers_without_their_top_bit_are_positive();
    the_value_at_raw_zero_is_added();
    feedback_has_the_time_of_its_count_else_of_its_speed_else_of_its_newest_frame();
    frames_right_after_the_set_up_count_and_power_is_unknown_before();
    a_fault_word_is_a_change_once_and_stops_unless_it_is_a_warning();
    a_fault_that_is_a_number_stops_unless_it_is_listed();
    a_joint_without_set_points_stands_still();
    each_kind_of_set_point_is_sent_to_its_own_wheel();
    a_set_point_beyond_the_count_does_not_move();
    a_field_beyond_the_count_does_not_report_power();
    a_count_of_two_to_the_power_of_62_is_refused_as_a_position();
    return checks_report("can values");
}
