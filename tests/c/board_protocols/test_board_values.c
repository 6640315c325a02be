/* SPDX-License-Identifier: Apache-2.0
 * test_board_values: the conversion of set-points to a payload, and of a payload to feedback. */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "board_machine.h"
#include "check.h"

static board_place at(uint32_t byte, uint32_t bytes, uint32_t is_signed)
{
    return (board_place){.byte = byte, .bytes = bytes, .is_signed = is_signed};
}

static void a_number_of_each_length_is_read_as_it_was_written(void)
{
    for (uint32_t bytes = 1; bytes <= 6; bytes++) {
        for (uint32_t is_signed = 0; is_signed <= 1; is_signed++) {
            board_place place = at(1, bytes, is_signed);
            const int64_t least = board_raw_min(&place), most = board_raw_max(&place);
            CHECK(most - least == (INT64_C(1) << 8 * bytes) - 1 && (least < 0) == (is_signed == 1));
            const int64_t raw[] = {least,    least + 1,    -1,       0,   1,
                                   most / 2, most / 2 + 1, most - 1, most};
            for (uint32_t i = 0; i < 9; i++) {
                uint8_t data[8];
                memset(data, 0xA5, sizeof data);
                board_put(data, &place, raw[i]);
                CHECK(board_get(data, &place) == (raw[i] < least ? most : raw[i]));
                CHECK(data[0] == 0xA5 && data[1 + bytes] == 0xA5);
            }
        }
    }
}

static board_machine *m;

/* Joints 0 and 1 have 10 and 20 raw per rad/s; the third set-point is beyond the count. */
static void begin(void)
{
    memset(m, 0, sizeof *m);
    m->state.mode = DRIVE_ARMED;
    m->newest = (setpoints){.enabled = 1, .joint_count = 3};
    m->table.setpoint_count = 2;
    for (uint32_t j = 0; j < 3; j++) {
        setpoint_scale scale = {.joint = j,
                                .kind = SETPOINT_VELOCITY,
                                .raw_per_si = 10.0 * (j + 1),
                                .raw_min = -1000,
                                .raw_max = 1000};
        m->table.setpoint[j] = (board_setpoint){.place = at(2 * j, 2, 1), .scale = scale};
        m->newest.joint[j].velocity_rad_s = 7.0;
    }
    m->table.rest_velocity_rad_s = 0.1;
    m->joints = 3;
}

static bool payload_of(double one_rad_s, double other_rad_s, int64_t *one, int64_t *other)
{
    uint8_t payload[BOARD_PAYLOAD_MAX];
    m->newest.joint[0].velocity_rad_s = one_rad_s, m->newest.joint[1].velocity_rad_s = other_rad_s;
    bool motion = board_payload(m, payload);
    *one = board_get(payload, &m->table.setpoint[0].place),
    *other = board_get(payload, &m->table.setpoint[1].place);
    CHECK(payload[4] == 0 && payload[5] == 0 && payload[9] == m->held[9]);
    return motion;
}

static void a_payload_moves_when_any_of_its_set_points_does(void)
{
    int64_t one, other;
    begin();
    m->held[9] = 0x42;
    CHECK(!payload_of(0.0, 0.0, &one, &other) && one == 0 && other == 0);
    CHECK(payload_of(2.0, 0.0, &one, &other) && one == 20 && other == 0);
    CHECK(payload_of(0.0, -2.0, &one, &other) && one == 0 && other == -40);
    CHECK(payload_of(1.0, 1.0, &one, &other) && one == 10 && other == 20);
    CHECK(!payload_of(0.04, -0.02, &one, &other) && one == 0 && other == 0); /* less than one raw
                                                                                unit */
    CHECK(payload_of(1e9, -1e9, &one, &other) && one == 1000 && other == -1000);
    CHECK(!payload_of((double)NAN, (double)INFINITY, &one, &other) && one == 0 && other == 0);
}

static void only_an_armed_and_enabled_drive_gets_set_points_other_than_zero(void)
{
    int64_t one, other;
    for (uint32_t mode = DRIVE_OFF; mode <= DRIVE_UNRESPONSIVE; mode++) {
        for (uint32_t enabled = 0; enabled <= 2; enabled++) {
            begin();
            m->state.mode = mode, m->newest.enabled = enabled;
            bool moves = mode == DRIVE_ARMED && enabled == 1;
            CHECK(payload_of(2.0, 2.0, &one, &other) == moves && (one != 0) == moves &&
                  (other != 0) == moves);
        }
    }
}

static void field(uint32_t number, uint32_t joint, uint32_t kind, uint32_t byte)
{
    m->table.field[number].place = at(byte, 2, 1);
    m->table.field[number].meaning =
        (field_meaning){.joint = joint, .kind = kind, .si_per_raw = 0.5, .counter_bits = 12};
    m->table.field_count = number + 1;
}

static void say(uint32_t byte, int64_t raw)
{
    board_put(m->feedback_payload, &(board_place){.byte = byte, .bytes = 2}, raw);
}

static void each_field_goes_to_the_value_that_it_means(void)
{
    begin();
    field(0, 0, FIELD_COUNT, 0);
    field(1, 1, FIELD_VELOCITY, 2);
    field(2, 1, FIELD_CURRENT, 4);
    field(3, 0, FIELD_VOLTAGE, 6);
    field(4, 0, FIELD_TEMPERATURE, 8);
    field(5, 1, FIELD_COUNT, 10);
    m->table.field[6] = m->table.field[0]; /* beyond the count: joint 0 would read the value after
                                              the last */
    m->table.field[6].place.byte = 12;
    const int64_t raw[] = {0x7123, -8, 6, 48, 50, -1, 77};
    for (uint32_t i = 0; i < 7; i++) {
        say(2 * i, raw[i]);
    }
    CHECK(board_read(m));
    CHECK(m->joint[0].feedback.count == 0x123 && m->joint[1].feedback.count == 0xFFF);
    CHECK(m->joint[1].feedback.velocity_rad_s == -4.0 && m->joint[1].feedback.current_a == 3.0);
    CHECK(m->joint[0].feedback.voltage_v == 24.0 && m->joint[0].feedback.temperature_c == 25.0);
    CHECK(!m->notify && m->state.enabled == 0);
    m->table.field[5].meaning.counter_bits = 63;
    CHECK(board_read(m) && m->joint[1].feedback.count == INT64_MAX);
    m->table.field[5].meaning.counter_bits = 64;
    CHECK(board_read(m) && m->joint[1].feedback.count == UINT64_MAX);
}

static void a_fault_word_stops_by_its_harmful_bits_and_is_reported_when_it_changes(void)
{
    begin();
    field(0, 1, FIELD_FAULT, 0);
    m->table.field[0].meaning.harmless_bits = 0x4;
    CHECK(board_read(m) && !m->notify && m->joint[1].feedback.drive_faults == 0);
    say(0, 0x6);
    CHECK(board_read(m) && m->notify && m->joint[1].fault_word == 0x6 &&
          m->joint[1].feedback.drive_faults == 0x2);
    m->notify = false;
    CHECK(board_read(m) && !m->notify && m->joint[1].feedback.drive_faults == 0x2);
    say(0, 0);
    CHECK(board_read(m) && m->notify && m->joint[1].feedback.drive_faults == 0);
    CHECK(m->joint[0].fault_word == 0 && m->joint[0].feedback.drive_faults == 0);
}

static void a_mask_shows_whether_it_is_enabled_and_kept_its_set_up(void)
{
    begin();
    field(0, 0, FIELD_ENABLED, 0);
    field(1, 0, FIELD_KEPT, 2);
    field(2, 0, FIELD_KEPT, 4);
    m->table.field[0].meaning.equals_mask = 0x0F, m->table.field[0].meaning.equals = 0x3;
    for (uint32_t i = 1; i <= 2; i++) {
        m->table.field[i].meaning.equals_mask = 0xFF, m->table.field[i].meaning.equals = 9;
    }
    say(0, 0x73), say(2, 9), say(4, 9);
    CHECK(board_read(m) && m->state.enabled == 1);
    say(0, 0x72);
    CHECK(board_read(m) && m->state.enabled == 0);
    say(2, 8);
    CHECK(!board_read(m));
    say(2, 0x109), say(4, 8);
    CHECK(!board_read(m));
    say(4, 9);
    CHECK(board_read(m));
}

static void feedback_is_published_for_the_joints_of_the_board(void)
{
    begin();
    m->joints = 1U << 1 | 1U << (JOINTS_MAX - 1);
    m->stamp_ns = 77, m->state.epoch = 5, m->state.enabled = 1;
    board_publish(m);
    CHECK(m->published == 1 && m->feedback_mask == m->joints);
    for (uint32_t j = 0; j < JOINTS_MAX; j++) {
        const joint_feedback *feedback = &m->joint[j].feedback;
        bool ours = (m->joints >> j & 1) != 0;
        CHECK(feedback->stamp_ns == (ours ? 77 : 0) && feedback->epoch == (ours ? 5U : 0U));
        CHECK(feedback->enabled == (ours ? 1U : 0U));
    }
    board_publish(m);
    CHECK(m->published == 2);
    board_forget(m);
    CHECK(isnan(m->joint[0].feedback.velocity_rad_s) &&
          isnan(m->joint[JOINTS_MAX - 1].feedback.velocity_rad_s));
    CHECK(m->state.enabled == 2 && m->joint[1].feedback.enabled == 2 &&
          m->joint[1].feedback.stamp_ns == 0);
}

static void it_is_at_rest_when_each_of_its_joints_is_known_to_rest(void)
{
    for (uint32_t j = 0; j < JOINTS_MAX; j++) {
        begin();
        m->joints = 1U << j;
        for (uint32_t other = 0; other < JOINTS_MAX; other++) {
            m->joint[other].feedback.velocity_rad_s = 9.0;
        }
        m->joint[j].feedback.velocity_rad_s = -0.09;
        CHECK(board_at_rest(m));
        m->joint[j].feedback.velocity_rad_s = -0.1;
        CHECK(!board_at_rest(m));
        m->joint[j].feedback.velocity_rad_s = (double)NAN;
        CHECK(!board_at_rest(m));
        m->joints = 0;
        CHECK(board_at_rest(m));
    }
}

int main(void)
{
    m = malloc(sizeof *m);
    a_number_of_each_length_is_read_as_it_was_written();
    a_payload_moves_when_any_of_its_set_points_does();
    only_an_armed_and_enabled_drive_gets_set_points_other_than_zero();
    each_field_goes_to_the_value_that_it_means();
    a_fault_word_stops_by_its_harmful_bits_and_is_reported_when_it_changes();
    a_mask_shows_whether_it_is_enabled_and_kept_its_set_up();
    feedback_is_published_for_the_joints_of_the_board();
    it_is_at_rest_when_each_of_its_joints_is_known_to_rest();
    free(m);
    return checks_report("test_board_values");
}
