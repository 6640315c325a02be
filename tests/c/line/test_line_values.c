/* SPDX-License-Identifier: Apache-2.0
 * Set-points in the requests of a serial line, and values in its replies. */
#include <math.h>

#include "line_wire.h"

enum { JOINT = 1 };

static line_machine *const m = &w.machine;
static line_drive *const table = &w.machine.table.drive[JOINT];
static line_drive_state *const drive = &w.machine.drive[JOINT];
static line_joint_state *const joint = &w.machine.joint[JOINT];
static line_setpoint *const setpoint = &w.machine.table.drive[JOINT].cyclic[0].setpoint[0];
static line_exchange *const turn = &w.machine.table.drive[JOINT].cyclic[1];
static line_frame built;
static uint8_t reply[FRAME_BYTES_MAX];

/* Two drives. The second one is armed, and its set-point is `velocity_rad_s`. */
static void begin(double velocity_rad_s)
{
    begin_with(2, 0);
    m->newest = (setpoints){.stamp_ns = w.now_ns, .enabled = 1, .joint_count = JOINTS_MAX};
    m->newest.joint[JOINT].velocity_rad_s = velocity_rad_s;
    drive->state.mode = DRIVE_ARMED;
    memset(reply, 0, sizeof reply);
}

static int64_t sent_raw(void)
{
    return rtu_read(built.request + setpoint->byte, setpoint->form);
}

/* --------------------------------------------------------------- set-points in requests */
static void a_set_point_is_scaled_rounded_and_clamped(void)
{
    static const struct {
        double wanted_rad_s;
        int64_t raw;
    } cases[] = {{1.0, 100},  {-1.0, -100},  {0.026, 3},    {0.0249, 2},
                 {9.99, 999}, {10.02, 1000}, {-1e9, -1000}, {0.001, 0}};
    for (uint32_t i = 0; i < sizeof cases / sizeof cases[0]; i++) {
        begin(cases[i].wanted_rad_s);
        CHECK(line_build(m, JOINT, 0, &built) == (cases[i].raw != 0) && sent_raw() == cases[i].raw);
        CHECK(drive->last_sent[0][0] == cases[i].raw &&
              rtu_is_sealed(built.request, 8, SEAL_CRC16));
        CHECK(memcmp(built.request, table->cyclic[0].frame.request, 4) == 0);
    }
    begin(-2.0);
    setpoint->magnitude = 1, setpoint->raw_min = 0.0;
    CHECK(line_build(m, JOINT, 0, &built) && sent_raw() == 200);
    begin(2.0);
    setpoint->kind = SETPOINT_DUTY;
    CHECK(!line_build(m, JOINT, 0, &built) && sent_raw() == 0);
    m->newest.joint[JOINT].duty = 0.5;
    CHECK(line_build(m, JOINT, 0, &built) && sent_raw() == 50);
}

static void a_request_moves_when_any_of_its_set_points_does(void)
{
    for (uint32_t moving = 0; moving < 4; moving++) {
        begin(0.0);
        table->cyclic[0].frame.request_bytes = 10;
        table->cyclic[0].setpoint[1] = *setpoint;
        table->cyclic[0].setpoint[1].joint = 3, table->cyclic[0].setpoint[1].byte = 6;
        table->cyclic[0].setpoint[2] = *setpoint; /* beyond the count */
        table->cyclic[0].setpoint[2].joint = 4;
        table->cyclic[0].setpoint_count = 2;
        m->newest.joint[4].velocity_rad_s = 9.0;
        m->newest.joint[JOINT].velocity_rad_s = (moving & 1) != 0 ? 1.0 : 0.0;
        m->newest.joint[3].velocity_rad_s = (moving & 2) != 0 ? 2.0 : 0.0;
        CHECK(line_wants_motion(m, JOINT) == (moving != 0));
        CHECK(line_build(m, JOINT, 0, &built) == (moving != 0));
        CHECK(rtu_read(built.request + 4, FORM_I16) == ((moving & 1) != 0 ? 100 : 0));
        CHECK(rtu_read(built.request + 6, FORM_I16) == ((moving & 2) != 0 ? 200 : 0));
        CHECK(!line_differs(m, JOINT));
    }
}

static void only_an_armed_and_enabled_drive_gets_set_points_other_than_zero(void)
{
    static const double NO_NUMBERS[] = {NAN, INFINITY, -INFINITY};
    for (uint32_t mode = DRIVE_OFF; mode <= DRIVE_BACK; mode++) {
        for (uint32_t enabled = 0; enabled <= 2; enabled++) {
            begin(1.0);
            drive->state.mode = mode, m->newest.enabled = enabled;
            bool moves = mode == DRIVE_ARMED && enabled == 1;
            CHECK(line_wanted(m, JOINT, JOINT, SETPOINT_VELOCITY) == (moves ? 1.0 : 0.0));
            CHECK(line_wants_motion(m, JOINT) == moves && line_build(m, JOINT, 0, &built) == moves);
            CHECK(sent_raw() == (moves ? 100 : 0));
        }
    }
    for (uint32_t i = 0; i < 3; i++) {
        begin(NO_NUMBERS[i]);
        CHECK(!line_wants_motion(m, JOINT) && !line_build(m, JOINT, 0, &built) && sent_raw() == 0);
    }
    begin(1.0);
    m->newest.joint_count = 99; /* a count beyond the table */
    const double behind = 1.0;
    memcpy(&m->newest.joint[0] + JOINTS_MAX, &behind, sizeof behind);
    CHECK(line_wanted(m, JOINT, JOINTS_MAX, SETPOINT_VELOCITY) == 0.0);
    m->newest.joint_count = JOINT; /* the core sends no set-point for this joint */
    CHECK(!line_build(m, JOINT, 0, &built) && sent_raw() == 0);
}

static void a_set_point_that_differs_from_the_last_is_found_in_each_exchange(void)
{
    for (uint32_t where = 0; where < 4; where++) {
        begin(1.0);
        table->cyclic[1] = table->cyclic[0];
        table->cyclic[1].setpoint[0].joint = 3;
        table->cyclic[1].setpoint[1] = table->cyclic[1].setpoint[0];
        table->cyclic[1].setpoint[1].joint = 4, table->cyclic[1].setpoint[1].byte = 2;
        table->cyclic[1].setpoint_count = 2;
        CHECK(line_differs(m, JOINT)); /* 1.0 has not been sent yet */
        for (uint32_t i = 0; i < 2; i++) {
            (void)line_build(m, JOINT, i, &built);
        }
        CHECK(!line_differs(m, JOINT) && line_wants_motion(m, JOINT));
        m->newest.joint[JOINT].velocity_rad_s = where == 1 ? 0.0 : 1.0;
        m->newest.joint[3].velocity_rad_s = where == 2 ? -0.5 : 0.0;
        m->newest.joint[4].velocity_rad_s = where == 3 ? 0.5 : 0.0;
        CHECK(line_differs(m, JOINT) == (where != 0) &&
              line_wants_motion(m, JOINT) == (where != 1));
        CHECK(!line_differs(m, 0) && !line_wants_motion(m, 0));
    }
}

static void exchanges_beyond_the_count_are_ignored(void)
{
    begin(0.0);
    table->cyclic[2] = table->cyclic[0]; /* beyond the count */
    table->cyclic[2].setpoint[0].joint = 3;
    m->newest.joint[3].velocity_rad_s = 1.0;
    CHECK(!line_differs(m, JOINT) && !line_wants_motion(m, JOINT));
    table->cyclic_count = 3;
    CHECK(line_differs(m, JOINT) && line_wants_motion(m, JOINT));
}

/* Magnitude and direction are separate requests: both belong to the set-point of the cycle. But a
 * stop does not wait for the next cycle. */
static void a_cycle_with_directions_keeps_its_set_point(void)
{
    begin(2.0);
    drive->frozen = m->newest;
    drive->frozen.joint[JOINT].velocity_rad_s = -1.0;
    CHECK(line_wanted(m, JOINT, JOINT, SETPOINT_VELOCITY) == 2.0);
    table->direction_count = 1;
    table->direction[0].joint = JOINT;
    CHECK(line_wanted(m, JOINT, JOINT, SETPOINT_VELOCITY) == -1.0);
    CHECK(line_direction_wanted(m, JOINT, 0) == DIRECTION_REVERSE);
    table->direction[0].inverted = 1;
    CHECK(line_direction_wanted(m, JOINT, 0) == DIRECTION_FORWARD);
    drive->frozen.joint[JOINT].velocity_rad_s = 1.0;
    CHECK(line_direction_wanted(m, JOINT, 0) == DIRECTION_REVERSE);
    table->direction[0].inverted = 0;
    CHECK(line_direction_wanted(m, JOINT, 0) == DIRECTION_FORWARD);
    drive->frozen.joint[JOINT].velocity_rad_s = 1e-3;
    CHECK(line_direction_wanted(m, JOINT, 0) == DIRECTION_FORWARD);
    drive->frozen.joint[JOINT].velocity_rad_s = 0.0;
    CHECK(line_direction_wanted(m, JOINT, 0) == DIRECTION_REST);
    drive->frozen.joint[JOINT].velocity_rad_s = 1.0, m->newest.joint[JOINT].velocity_rad_s = 0.0;
    CHECK(line_wanted(m, JOINT, JOINT, SETPOINT_VELOCITY) == 0.0 &&
          line_direction_wanted(m, JOINT, 0) == DIRECTION_REST);
}

static void a_drive_at_rest_is_sent_its_idle_request(void)
{
    for (uint32_t against = 0; against < 6; against++) {
        begin(0.0);
        table->idle[0] = frame_of(9, WRITE, 0x77, 1);
        table->idle_count = against == 1 ? 0 : 1;
        drive->state.mode = against == 2 ? DRIVE_UNRESPONSIVE : DRIVE_READY;
        drive->state.stopping = against == 3;
        drive->state.stop = against == 4 ? STOP_POWER_OFF : STOP_NOTHING;
        drive->last_sent[0][0] = 5;
        drive->last_sent[0][EXCHANGE_SETPOINTS_MAX - 1] = 6;
        CHECK(!line_build(m, JOINT, against == 5 ? 1 : 0, &built));
        CHECK((built.request[0] == 9) == (against == 0));
        CHECK(drive->last_sent[0][0] == (against == 5 ? 5 : 0));
        CHECK(drive->last_sent[0][EXCHANGE_SETPOINTS_MAX - 1] == (against == 0 ? 0 : 6));
    }
}

/* -------------------------------------------------------------------- values in replies */
static void add_field(uint32_t place, uint32_t kind, uint32_t byte, uint32_t form)
{
    turn->field[place] =
        (line_field){.joint = JOINT, .kind = kind, .byte = byte, .form = form, .si_per_raw = 0.5};
    turn->field_count = place + 1;
}

static void read_at(int64_t stamp_ns)
{
    line_read(m, JOINT, turn, reply, stamp_ns);
}

static void each_field_goes_to_the_value_that_it_means(void)
{
    begin(0.0);
    static const uint32_t KINDS[] = {FIELD_COUNT, FIELD_VELOCITY, FIELD_CURRENT, FIELD_VOLTAGE,
                                     FIELD_TEMPERATURE};
    for (uint32_t i = 0; i < 5; i++) {
        add_field(i, KINDS[i], 2 * i, FORM_I16);
        rtu_write(reply + 2 * i, FORM_I16, -10 - (int64_t)i);
    }
    turn->field[5] = turn->field[0]; /* beyond the count */
    turn->field[5].byte = 20;
    read_at(77);
    const joint_feedback *feedback = &joint->feedback;
    CHECK(feedback->count == (uint64_t)-10 && feedback->velocity_rad_s == -5.5 &&
          feedback->current_a == -6.0);
    CHECK(feedback->voltage_v == -6.5 && feedback->temperature_c == -7.0);
    CHECK(joint->count_ns == 77 && joint->velocity_ns == 77 && joint->newest_ns == 77);
    CHECK(isnan(m->joint[0].feedback.velocity_rad_s) && m->joint[0].newest_ns == 0);
    add_field(0, FIELD_COUNT, 0, FORM_U16);
    turn->field[0].mask = 0x0FF0;
    rtu_write(reply, FORM_U16, 0x1234);
    read_at(78);
    CHECK(feedback->count == 0x23 && joint->count_ns == 78 && joint->velocity_ns == 77 &&
          joint->newest_ns == 78);
    add_field(0, FIELD_CURRENT, 0, FORM_U16);
    read_at(79);
    CHECK(joint->count_ns == 78 && joint->velocity_ns == 77 && joint->newest_ns == 79);
}

static void a_velocity_without_sign_gets_the_sign_of_the_last_direction_sent(void)
{
    begin(0.0);
    add_field(0, FIELD_VELOCITY, 0, FORM_U16);
    rtu_write(reply, FORM_U16, 8);
    drive->direction_last[0] = drive->direction_last[1] = DIRECTION_REVERSE;
    read_at(1);
    CHECK(joint->feedback.velocity_rad_s == 4.0); /* a field without a direction has its own sign */
    turn->field[0].direction = 1;
    drive->direction_last[1] = DIRECTION_FORWARD;
    read_at(2);
    CHECK(joint->feedback.velocity_rad_s == -4.0);
    turn->field[0].direction = 2;
    read_at(3);
    CHECK(joint->feedback.velocity_rad_s == 4.0);
    drive->direction_last[1] = 0;
    read_at(4);
    CHECK(joint->feedback.velocity_rad_s == 4.0);
}

static void a_fault_word_stops_by_its_harmful_bits_and_is_reported_when_it_changes(void)
{
    begin(0.0);
    add_field(0, FIELD_FAULT, 0, FORM_U16);
    turn->field[0].harmless_bits = 0x4;
    read_at(5);
    CHECK(!m->notify && joint->newest_ns == 5);
    rtu_write(reply, FORM_U16, 0x6);
    read_at(6);
    CHECK(m->notify && joint->fault_word == 0x6 && joint->feedback.drive_faults == 0x2 &&
          m->joint[0].fault_word == 0);
    read_at(7); /* another cause of the notification is kept */
    CHECK(m->notify);
    m->notify = false;
    read_at(7);
    CHECK(!m->notify && joint->feedback.drive_faults == 0x2);
    turn->field[0].is_code = 1, turn->field[0].harmless_codes = 1, turn->field[0].harmless[0] = 6;
    read_at(8);
    CHECK(joint->feedback.drive_faults == 0);
    turn->field[0].harmless_codes = 0;
    read_at(9);
    CHECK(joint->feedback.drive_faults == 6);
}

static void a_mask_shows_whether_it_is_enabled_and_kept_its_set_up(void)
{
    begin(0.0);
    add_field(0, FIELD_ENABLED, 0, FORM_U16);
    add_field(1, FIELD_KEPT, 2, FORM_U16);
    add_field(2, FIELD_KEPT, 4, FORM_U16);
    turn->field[0].equals_mask = 0x0F, turn->field[0].equals = 0x3;
    turn->field[1].equals_mask = turn->field[2].equals_mask = 0xFF;
    turn->field[1].equals = turn->field[2].equals = 9;
    rtu_write(reply, FORM_U16, 0x73), rtu_write(reply + 2, FORM_U16, 0x109),
        rtu_write(reply + 4, FORM_U16, 9);
    read_at(5);
    CHECK(drive->state.enabled == 1 && !drive->lost_setup && joint->newest_ns == 0);
    rtu_write(reply, FORM_U16, 0x72), rtu_write(reply + 2, FORM_U16, 8);
    read_at(6);
    CHECK(drive->state.enabled == 0 && drive->lost_setup); /* the second field does not outweigh the
                                                              first */
    rtu_write(reply + 2, FORM_U16, 9);
    read_at(7);
    CHECK(drive->lost_setup);
}

/* ----------------------------------------------------------------- feedback to the core */
static void feedback_has_the_stamp_of_what_the_core_integrates(void)
{
    for (uint32_t has = 0; has < 8; has++) {
        begin(0.0);
        joint->counts = has & 1, joint->measures = has >> 1 & 1;
        joint->count_ns = 11, joint->velocity_ns = 12, joint->newest_ns = (has & 4) != 0 ? 13 : 0;
        drive->answered_ns = 14;
        drive->state.epoch = 5, drive->state.enabled = 1;
        line_publish(m, JOINT);
        int64_t other_ns = (has & 4) != 0 ? 13 : 14;
        CHECK(joint->feedback.stamp_ns == ((has & 1) != 0 ? 11 : (has & 2) != 0 ? 12 : other_ns));
        CHECK(joint->feedback.epoch == 5 && joint->feedback.enabled == 1 &&
              m->feedback_mask == 1U << JOINT);
        CHECK(m->joint[0].feedback.epoch == 0 && m->joint[0].feedback.enabled == 2);
    }
    begin(0.0);
    /* a count that was never read has no stamp */
    joint->counts = 1, joint->count_ns = 0, drive->answered_ns = 14;
    line_publish(m, JOINT);
    CHECK(joint->feedback.stamp_ns == 0);
    joint->counts = 0, joint->measures = 1, joint->velocity_ns = 0;
    line_publish(m, JOINT);
    CHECK(joint->feedback.stamp_ns == 0);
    drive->joints = 1U << (JOINTS_MAX - 1);
    m->feedback_mask = 1;
    line_publish(m, JOINT);
    CHECK(m->feedback_mask == (1U << (JOINTS_MAX - 1) | 1));
}

static void a_reset_clears_the_feedback_of_all_joints_of_a_drive(void)
{
    begin(0.0);
    drive->joints = 1U << JOINT | 1U << (JOINTS_MAX - 1);
    for (uint32_t j = 0; j < JOINTS_MAX; j++) {
        m->joint[j].feedback = (joint_feedback){.enabled = 1, .stamp_ns = 3, .velocity_rad_s = 4.0};
        m->joint[j].count_ns = m->joint[j].velocity_ns = m->joint[j].newest_ns = 6;
    }
    drive->state.epoch = 7, drive->state.enabled = 1, drive->lost_setup = true;
    line_forget(m, JOINT);
    for (uint32_t j = 0; j < JOINTS_MAX; j++) {
        const line_joint_state *one = &m->joint[j];
        bool ours = (drive->joints >> j & 1) != 0;
        CHECK(one->feedback.enabled == (ours ? 2U : 1U) && one->feedback.epoch == (ours ? 7U : 0U));
        CHECK(one->feedback.stamp_ns == (ours ? 0 : 3) &&
              (isnan(one->feedback.velocity_rad_s) != 0) == ours);
        int64_t stamp_ns = ours ? 0 : 6;
        CHECK(one->count_ns == stamp_ns && one->velocity_ns == stamp_ns &&
              one->newest_ns == stamp_ns);
    }
    CHECK(drive->state.enabled == 2 && !drive->lost_setup);
}

static void it_is_at_rest_when_each_of_its_joints_is_known_to_rest(void)
{
    for (uint32_t j = 0; j < JOINTS_MAX; j++) {
        begin(0.0);
        drive->joints = 1U << j;
        for (uint32_t other = 0; other < JOINTS_MAX; other++) {
            m->joint[other].feedback.velocity_rad_s = 9.0;
        }
        m->joint[j].feedback.velocity_rad_s = -0.09;
        CHECK(line_at_rest(m, JOINT));
        m->joint[j].feedback.velocity_rad_s = -0.1;
        CHECK(!line_at_rest(m, JOINT));
        m->joint[j].feedback.velocity_rad_s = (double)NAN;
        CHECK(!line_at_rest(m, JOINT));
        drive->joints = 0;
        CHECK(line_at_rest(m, JOINT));
    }
}

int main(void)
{
    a_set_point_is_scaled_rounded_and_clamped();
    a_request_moves_when_any_of_its_set_points_does();
    only_an_armed_and_enabled_drive_gets_set_points_other_than_zero();
    a_set_point_that_differs_from_the_last_is_found_in_each_exchange();
    exchanges_beyond_the_count_are_ignored();
    a_cycle_with_directions_keeps_its_set_point();
    a_drive_at_rest_is_sent_its_idle_request();
    each_field_goes_to_the_value_that_it_means();
    a_velocity_without_sign_gets_the_sign_of_the_last_direction_sent();
    a_fault_word_stops_by_its_harmful_bits_and_is_reported_when_it_changes();
    a_mask_shows_whether_it_is_enabled_and_kept_its_set_up();
    feedback_has_the_stamp_of_what_the_core_integrates();
    a_reset_clears_the_feedback_of_all_joints_of_a_drive();
    it_is_at_rest_when_each_of_its_joints_is_known_to_rest();
    return checks_report("test_line_values");
}
