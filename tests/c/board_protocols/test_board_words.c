/* SPDX-License-Identifier: Apache-2.0
 * Feedback of a board, in frames and in text, in any pieces, with a sensor and with noise. */
#include "board_wire.h"

/* ---------------------------------------------------------------------------- frames in */
static void feedback_is_counts_and_si_in_the_board_s_time(void)
{
    begin();
    arm_and_turn();
    w.velocity_rad_s = 2.0;
    w.health.faults = 4; /* a warning: harmless to the core, but it switches the reference board
                            off */
    go_on(40 * MS);
    const joint_feedback *feedback = &w.machine.joint[1].feedback;
    CHECK(feedback->voltage_v == 24.0 && isnan(feedback->current_a) && feedback->drive_faults == 0);
    CHECK(w.machine.joint[0].fault_word == 4 && feedback->epoch == 1);
    CHECK(feedback->stamp_ns > w.now_ns - 60 * MS && feedback->stamp_ns <= w.now_ns);
    CHECK((w.machine.feedback_mask & 3) == 3);
}

/* A stream that is cut anywhere leads to the same machine. */
static void the_stream_may_come_in_any_pieces(void)
{
    static uint8_t stream[4096];
    uint32_t count = 0, state = 1;
    motord_board board;
    motord_board_init(&board, MOTORS, 0);
    for (uint32_t i = 0; i < 60; i++) {
        count += (uint32_t)motord_board_feedback(&board, 200000 * i, w.measured, &w.health,
                                                 stream + count);
        stream[count] = (uint8_t)i;
        count += i % 7 == 3;
    }
    begin();
    board_machine_receive(&w.machine, stream, count, w.now_ns);
    board_report whole, pieces;
    memset(&whole, 0, sizeof whole);
    memset(&pieces, 0, sizeof pieces);
    board_machine_report(&w.machine, &whole);
    CHECK(whole.received == 59 && whole.bad_frames > 5);
    for (uint32_t round = 0; round < 200; round++) {
        begin();
        for (uint32_t at_byte = 0; at_byte < count;) {
            state = state * 1664525 + 1013904223;
            uint32_t size = 1 + (state >> 16) % (1 + round);
            size = size < count - at_byte ? size : count - at_byte;
            board_machine_receive(&w.machine, stream + at_byte, size, w.now_ns);
            at_byte += size;
        }
        board_machine_report(&w.machine, &pieces);
        CHECK(memcmp(&whole, &pieces, sizeof whole) == 0);
    }
}

static void noise_is_counted_and_changes_nothing(void)
{
    begin();
    arm_and_turn();
    uint8_t noise[600];
    memset(noise, 0x55, sizeof noise);
    noise[sizeof noise - 1] = 0;
    board_machine_receive(&w.machine, noise, sizeof noise, w.now_ns);
    CHECK(w.machine.bad_frames == 1);
    uint8_t frame[BOARD_WIRE_MAX], payload[BOARD_PAYLOAD_MAX] = {0};
    /* a frame to a board, which a board does not send */
    uint32_t count = board_frame_build(BOARD_TYPE_SETPOINTS, 1, 2, payload, 36, frame);
    board_machine_receive(&w.machine, frame, count, w.now_ns);
    count = board_frame_build(BOARD_TYPE_FEEDBACK, 1, 2, payload, 35, frame); /* too short */
    board_machine_receive(&w.machine, frame, count, w.now_ns);
    CHECK(w.machine.bad_frames == 3 && w.machine.state.mode == DRIVE_ARMED);
    go_on(50 * MS);
    CHECK(w.machine.bad_frames == 3 && w.machine.state.mode == DRIVE_ARMED);
}

static uint64_t received_of(uint32_t payload_bytes, const char *behind)
{
    static uint8_t payload[BOARD_PAYLOAD_MAX];
    uint8_t frame[BOARD_WIRE_MAX];
    memset(payload, 0x55, sizeof payload);
    payload[STATUS] = 0;
    uint32_t count = board_frame_build(BOARD_TYPE_FEEDBACK, 1, 2, payload, payload_bytes, frame);
    memcpy(frame + count - 1, behind, strlen(behind) + 1);
    uint64_t before = w.machine.received;
    board_machine_receive(&w.machine, frame, count + (uint32_t)strlen(behind), w.now_ns);
    return w.machine.received - before;
}

static void the_longest_frame_is_read_and_one_with_a_byte_more_is_not(void)
{
    begin();
    CHECK(received_of(BOARD_PAYLOAD_MAX, "") == 1 && w.machine.bad_frames == 0);
    CHECK(received_of(BOARD_PAYLOAD_MAX, "x") == 0 && received_of(BOARD_PAYLOAD_MAX, "xx") == 0);
    CHECK(w.machine.bad_frames == 2);
    CHECK(received_of(BOARD_PAYLOAD_MAX, "") == 1);
}

static void feedback_from_before_a_write_was_received_is_ignored(void)
{
    begin();
    arm();
    /* restarted and not enabled: from long ago */
    uint8_t frame[BOARD_WIRE_MAX], payload[BOARD_PAYLOAD_MAX] = {0};
    payload[STATUS] = STATUS_RESTARTED;
    board_place received = at(6, 2, 0);
    board_put(payload, &received, w.machine.sequence + 1000);
    uint32_t count = board_frame_build(BOARD_TYPE_FEEDBACK, 1, 2, payload, 36, frame);
    board_machine_receive(&w.machine, frame, count, w.now_ns);
    CHECK(w.machine.state.mode == DRIVE_ARMED);
    board_place ago = at(8, 2, 0);
    board_put(payload, &received, w.machine.sequence);
    board_put(payload, &ago, 60000); /* received six seconds ago, by an earlier program: before it
                                        was sent */
    count = board_frame_build(BOARD_TYPE_FEEDBACK, 1, 2, payload, 36, frame);
    board_machine_receive(&w.machine, frame, count, w.now_ns);
    CHECK(w.machine.state.mode == DRIVE_ARMED);
    board_put(payload, &ago, 0);
    count = board_frame_build(BOARD_TYPE_FEEDBACK, 1, 2, payload, 36, frame);
    board_machine_receive(&w.machine, frame, count, w.now_ns);
    CHECK(w.machine.state.mode == DRIVE_OFF &&
          (w.machine.state.fault_reasons & DRIVE_FAULT_LOST_SETUP) != 0);
}

/* --------------------------------------------------------------------------------- text */
static bool newest_line_is(const char *line)
{
    return w.sent_bytes == strlen(line) && memcmp(w.sent, line, w.sent_bytes) == 0;
}

static void a_text_board_without_feedback_is_present_while_its_port_takes_bytes(void)
{
    begin_with(text_table(false));
    go_on(50 * MS);
    CHECK(newest_line_is("0,0\n") && w.machine.received_ns > 0);
    request(DRIVE_READY);
    request(DRIVE_ARMED);
    go_on(50 * MS);
    CHECK(w.machine.state.mode == DRIVE_ARMED && newest_line_is("255,255\n"));
    CHECK(w.machine.feedback_mask == 3 && isnan(w.machine.joint[0].feedback.velocity_rad_s));
    CHECK(w.machine.joint[1].feedback.stamp_ns == w.machine.last_sent_ns &&
          w.machine.received == 0);
    w.full = true;
    go_on(200 * MS);
    CHECK(w.machine.state.mode == DRIVE_UNRESPONSIVE);
    w.full = false;
    go_on(60 * MS);
    CHECK(w.machine.state.mode == DRIVE_BACK && newest_line_is("0,0\n"));
}

static void half_a_line_is_not_read_and_an_endless_one_is_dropped(void)
{
    begin_with(text_table(true));
    request(DRIVE_READY);
    receive("v 9\nv 1.5\r\n"); /* the first line may be the end of another */
    CHECK(w.machine.joint[0].feedback.velocity_rad_s == 1.5 && w.machine.received == 1 &&
          w.machine.bad_frames == 0);
    for (uint32_t i = 0; i < 100; i++) {
        receive("v 123456");
    }
    receive("\nv 2;hello;v 1e999\n");
    CHECK(w.machine.joint[0].feedback.velocity_rad_s == 2.0 && w.machine.received == 2 &&
          w.machine.bad_frames == 2);
    go_on(200 * MS);
    CHECK(w.machine.state.mode == DRIVE_UNRESPONSIVE);
}

static void receive_padded(uint32_t line_bytes)
{
    char line[BOARD_LINE_MAX + 8];
    memset(line, '0', sizeof line);
    line[0] = 'v', line[1] = ' ', line[line_bytes - 1] = '7', line[line_bytes] = 0;
    receive(line);
    receive("\n");
}

static void the_longest_line_is_read_and_one_with_a_byte_more_is_not(void)
{
    begin_with(text_table(true));
    receive("\n");
    receive_padded(BOARD_LINE_MAX);
    CHECK(w.machine.received == 1 && w.machine.joint[0].feedback.velocity_rad_s == 7.0);
    receive_padded(BOARD_LINE_MAX + 1);
    CHECK(w.machine.received == 1 && w.machine.bad_frames == 0);
    receive_padded(BOARD_LINE_MAX);
    CHECK(w.machine.received == 2);
}

static void a_line_has_its_own_time_and_no_values_of_older_lines(void)
{
    board_table table = text_table(true);
    table.feedback_bytes = 8;
    table.read.part[0].place = at(2, 6, 1); /* no line fills the first two bytes */
    table.field[0].place = at(2, 6, 1);
    table.field[table.field_count++] = field_of(1, FIELD_FAULT, at(0, 2, 0), 1.0);
    begin_with(table);
    memset(w.machine.feedback_payload, 0xFF, sizeof w.machine.feedback_payload);
    w.now_ns += 3 * MS;
    receive("\nv 1.5\n");
    CHECK(w.machine.stamp_ns == w.now_ns && w.machine.knows_ns == w.now_ns);
    CHECK(w.machine.joint[1].fault_word == 0 && w.machine.joint[0].feedback.velocity_rad_s == 1.5);
    board_report report;
    board_machine_report(&w.machine, &report);
    CHECK(report.feedback_bytes == 8 && report.feedback_payload[0] == 0);
}

static void a_line_that_cannot_be_written_is_not_sent(void)
{
    begin_with(text_table(false));
    /* the line is too long together with the other number */
    w.machine.table.written.part[1].width = BOARD_TEXT_MAX;
    go_on(50 * MS);
    CHECK(w.sent_count == 0 && w.machine.sent == 0 && w.machine.no_room >= 2);
}

/* --------------------------------------------------------------------------- its sensor */
static bool is_near(double is, double wanted)
{
    return fabs(is - wanted) < 1e-9;
}

/* The sensor's y axis points up and its z axis forward, so x points left: docs/imu.md. */
static board_imu mounted(void)
{
    return (board_imu){.used = 1, .epoch = 3, .axis = {2, 0, 1}, .backward = {0, 0, 1}};
}

static int64_t sensor_flags = 1;

static bool report_with_sensor(uint32_t size)
{
    uint8_t frame[BOARD_WIRE_MAX], payload[BOARD_PAYLOAD_MAX] = {16, MOTORS};
    const int64_t raw[] = {1000000, -2000000, INT32_MIN, 9807, -1000, INT16_MIN, sensor_flags};
    uint32_t byte = 36;
    for (uint32_t i = 0; i < 7; i++) {
        board_place place = at(byte, i < 3 ? 4 : 2, i < 6);
        board_put(payload, &place, raw[i]);
        byte += place.bytes;
    }
    uint64_t before = w.machine.received;
    uint32_t count = board_frame_build(BOARD_TYPE_FEEDBACK, 1, 2, payload, size, frame);
    board_machine_receive(&w.machine, frame, count, w.now_ns);
    return w.machine.received > before;
}

static void samples_of_a_sensor_are_in_the_base_s_axes(void)
{
    board_table table = frames_table();
    table.imu = mounted();
    begin_with(table);
    CHECK(report_with_sensor(56) && w.machine.imu_is_new);
    const imu_sample *imu = &w.machine.imu;
    CHECK(isnan(imu->angular_rad_s[0]) && is_near(imu->angular_rad_s[1], 1.0) &&
          is_near(imu->angular_rad_s[2], 2.0));
    CHECK(isnan(imu->acceleration_m_s2[0]) && is_near(imu->acceleration_m_s2[1], 9.807));
    CHECK(is_near(imu->acceleration_m_s2[2], 1.0) && imu->saturated == 1 && imu->epoch == 3);
    CHECK(imu->stamp_ns == w.machine.stamp_ns);
    sensor_flags = 0;
    CHECK(report_with_sensor(56) && imu->saturated == 0);
    sensor_flags = 1;
    /* it announces a sensor, and ends before the sample */
    CHECK(!report_with_sensor(55) && w.machine.bad_frames == 1);
    table.imu.used = 0;
    begin_with(table);
    CHECK(report_with_sensor(56) && !w.machine.imu_is_new);
    table.imu.axis[1] = 3;
    char name[FIELD_NAME_BYTES];
    CHECK(board_table_check(&table, name) != NULL);
}

static void the_rate_of_a_text_is_about_z(void)
{
    board_table table = text_table(true);
    table.imu = mounted();
    table.imu.axis[2] = 2;
    table.imu.rate_z = at(0, 6, 1); /* the number in the line, in 1e-6 rad/s here: times 1000 */
    begin_with(table);
    receive("\nv 500\n");
    CHECK(w.machine.imu_is_new && is_near(w.machine.imu.angular_rad_s[2], -0.5) &&
          isnan(w.machine.imu.angular_rad_s[1]));
    CHECK(w.machine.imu.saturated == 0);
    table.imu.rate_z.byte = 1;
    char name[FIELD_NAME_BYTES];
    CHECK(board_table_check(&table, name) != NULL);
}

int main(void)
{
    feedback_is_counts_and_si_in_the_board_s_time();
    the_stream_may_come_in_any_pieces();
    noise_is_counted_and_changes_nothing();
    the_longest_frame_is_read_and_one_with_a_byte_more_is_not();
    feedback_from_before_a_write_was_received_is_ignored();
    a_text_board_without_feedback_is_present_while_its_port_takes_bytes();
    half_a_line_is_not_read_and_an_endless_one_is_dropped();
    the_longest_line_is_read_and_one_with_a_byte_more_is_not();
    a_line_has_its_own_time_and_no_values_of_older_lines();
    a_line_that_cannot_be_written_is_not_sent();
    samples_of_a_sensor_are_in_the_base_s_axes();
    the_rate_of_a_text_is_about_z();
    return checks_report("board words");
}
