/* SPDX-License-Identifier: Apache-2.0
 * test_board_packets: packets of the hoverboard FOC firmware, byte by byte, and how a receiver
 * finds the next packet in a stream. Each buffer has the length of its content, so that a sanitizer
 * sees an access beyond it. */
#include <stdlib.h>

#include "board_wire.h"

enum { FRAME = HOVERBOARD_FEEDBACK_BYTES, VALUES = HOVERBOARD_VALUE_BYTES };

/* --------------------------------------------------------------------------- hoverboard */
static void build_hoverboard(int64_t left, int64_t right, uint32_t mixed, uint8_t *out)
{
    uint8_t *payload = malloc(HOVERBOARD_SETPOINT_BYTES),
            *packet = malloc(HOVERBOARD_COMMAND_BYTES);
    board_place first = at(0, 2, 1), second = at(2, 2, 1);
    board_put(payload, &first, left);
    board_put(payload, &second, right);
    CHECK(board_hoverboard_build(payload, mixed, packet) == HOVERBOARD_COMMAND_BYTES);
    memcpy(out, packet, HOVERBOARD_COMMAND_BYTES);
    free(payload);
    free(packet);
}

static const struct {
    int left, right;
    uint32_t mixed;
    int first, second; /* words on the wire */
} COMMANDS[] = {
    {0, 0, 0, 0, 0},
    {100, -200, 0, 100, -200},
    {1000, -1000, 0, 1000, -1000},
    {1001, -1001, 0, 1000, -1000},
    {32767, -32768, 0, 1000, -1000},
    {0, 0, 1, 0, 0},
    {100, 100, 1, 0, 100},
    {100, -100, 1, 200, 0},
    {120, 80, 1, 40, 100},
    {-120, -80, 1, -40, -100},
    {3, 0, 1, 3, 1},
    {-3, 0, 1, -3, -1},
    {0, 1, 1, -1, 0},
    {500, -500, 1, 1000, 0},
    {32767, -32768, 1, 1000, 0},
    {-32768, 32767, 1, -1000, 0},
    {32767, 32767, 1, 0, 1000},
};

static void a_command_has_start_word_two_set_points_and_their_exclusive_or(void)
{
    static const uint8_t expected[] = {0xCD, 0xAB, 0x64, 0x00, 0x38, 0xFF, 0x91, 0x54};
    uint8_t out[HOVERBOARD_COMMAND_BYTES];
    build_hoverboard(100, -200, 0, out);
    CHECK(memcmp(out, expected, sizeof expected) == 0);
    for (size_t i = 0; i < sizeof COMMANDS / sizeof COMMANDS[0]; i++) {
        build_hoverboard(COMMANDS[i].left, COMMANDS[i].right, COMMANDS[i].mixed, out);
        board_place first = at(2, 2, 1), second = at(4, 2, 1);
        CHECK(board_get(out, &first) == COMMANDS[i].first &&
              board_get(out, &second) == COMMANDS[i].second);
        for (uint32_t byte = 0; byte < 2; byte++) {
            CHECK((out[byte] ^ out[2 + byte] ^ out[4 + byte] ^ out[6 + byte]) == 0);
        }
    }
}

/* Makes feedback with a check sum. Its bytes count up from `first`. */
static void make_feedback(uint8_t first, uint8_t *out)
{
    out[0] = 0xCD;
    out[1] = 0xAB;
    for (uint32_t i = 0; i < VALUES; i++) {
        out[2 + i] = (uint8_t)(first + i);
    }
    out[16] = out[17] = 0;
    for (uint32_t i = 0; i < 16; i++) {
        out[16 + i % 2] ^= out[i];
    }
}

static hoverboard_tail tail;
static uint8_t values[VALUES];
static uint32_t good, bad;

static void begin_stream(void)
{
    memset(&tail, 0, sizeof tail);
    memset(values, 0, sizeof values);
    good = bad = 0;
}

static void feed(const uint8_t *bytes, uint32_t count)
{
    for (uint32_t i = 0; i < count; i++) {
        uint32_t found = board_hoverboard_take(&tail, bytes[i], values);
        CHECK(found <= HOVERBOARD_BAD && tail.count < FRAME);
        good += found == HOVERBOARD_FEEDBACK;
        bad += found == HOVERBOARD_BAD;
    }
}

static void a_feedback_is_taken_at_its_last_byte(void)
{
    uint8_t frame[FRAME];
    begin_stream();
    make_feedback(1, frame);
    feed(frame, FRAME - 1);
    CHECK(good == 0 && values[0] == 0);
    feed(frame + FRAME - 1, 1);
    CHECK(good == 1 && bad == 0 && values[0] == 1 && values[VALUES - 1] == VALUES &&
          tail.count == 0);
    make_feedback(50, frame);
    feed(frame, FRAME);
    CHECK(good == 2 && bad == 0 && values[0] == 50);
}

static void a_torn_frame_does_not_cost_the_next_one(void)
{
    for (uint32_t kept = 0; kept < FRAME; kept++) {
        uint8_t frame[FRAME];
        begin_stream();
        make_feedback(1, frame);
        feed(frame, FRAME);
        feed(frame, kept); /* its rest is lost */
        make_feedback(100, frame);
        feed(frame, FRAME);
        CHECK(good == 2 && bad == (kept > 0) && values[0] == 100);
        begin_stream();
        feed(frame + kept, FRAME - kept); /* the port was opened within a frame */
        CHECK(good == (kept == 0) && bad == 0);
        feed(frame, FRAME);
        CHECK(good == 1 + (kept == 0) && values[0] == 100);
    }
}

static void every_flipped_bit_is_seen_and_the_next_frame_is_good(void)
{
    for (uint32_t bit = 0; bit < 8 * FRAME; bit++) {
        uint8_t frame[FRAME], spoiled[FRAME];
        begin_stream();
        make_feedback(7, frame);
        feed(frame, FRAME);
        memcpy(spoiled, frame, FRAME);
        spoiled[bit / 8] ^= (uint8_t)(1U << bit % 8);
        values[0] = 99;
        feed(spoiled, FRAME);
        CHECK(good == 1 && values[0] == 99);
        feed(frame, FRAME);
        CHECK(good == 2 && bad == 1 && values[0] == 7);
    }
}

/* The bytes of the values are not near those of the start word, so noise has made the one in this
 * frame, and the next frame is whole. (With a second start word right after the first, the next one
 * would be lost: its start word would be the check sum of the same words in another order.) */
static void a_start_word_among_the_values_is_no_feedback_and_does_not_hide_the_frame_after(void)
{
    for (uint32_t byte = 1; byte + 1 < VALUES; byte++) {
        uint8_t frame[FRAME], next[FRAME];
        make_feedback(1, frame);
        make_feedback(40, next);
        frame[2 + byte] = 0xCD;
        frame[3 + byte] = 0xAB;
        frame[16] = frame[17] = 0;
        for (uint32_t i = 0; i < 16; i++) {
            frame[16 + i % 2] ^= frame[i];
        }
        for (uint32_t lost = 0; lost < 3; lost++) {
            begin_stream();
            feed(frame + lost, FRAME - lost);
            feed(next, FRAME);
            CHECK(good == 1 && bad == 0 && values[0] == 40);
        }
    }
    static const uint8_t starts[] = {0xCD, 0xCD, 0xAB, 0xCD, 0xAB, 0xCD, 0xCD};
    uint8_t frame[FRAME];
    make_feedback(3, frame);
    begin_stream();
    feed(starts, sizeof starts);
    feed(frame, FRAME);
    CHECK(good == 1 && values[0] == 3);
}

/* The second byte of the last value and the first byte of the check sum may be any. */
static void single_bytes_of_the_start_word_may_stand_anywhere(void)
{
    static const uint8_t parts[] = {0xCD, 0xAB};
    for (uint32_t byte = 0; byte < VALUES; byte++) {
        for (uint32_t part = 0; part < 2; part++) {
            uint8_t frame[FRAME] = {0xCD, 0xAB};
            frame[2 + byte] = parts[part];
            for (uint32_t i = 0; i < 16; i++) {
                frame[16 + i % 2] ^= frame[i];
            }
            begin_stream();
            feed(frame, FRAME);
            CHECK(good == 1 && values[byte] == parts[part]);
        }
    }
    uint8_t last[FRAME] = {0xCD, 0xAB};
    last[4] = 0xCD ^ 0xAB, last[15] = 0xCD;
    for (uint32_t i = 0; i < 16; i++) {
        last[16 + i % 2] ^= last[i];
    }
    CHECK(last[16] == 0xAB);
    begin_stream();
    feed(last, FRAME);
    CHECK(good == 1 && values[13] == 0xCD);
}

static void a_wrong_start_word_is_dropped_at_once_whatever_the_check_sum(void)
{
    uint8_t frame[FRAME];
    make_feedback(1, frame);
    for (uint32_t byte = 0; byte < 2; byte++) {
        uint8_t other[FRAME];
        memcpy(other, frame, FRAME);
        other[byte] ^= 1;
        other[16 + byte] ^= 1;
        begin_stream();
        feed(other, FRAME);
        CHECK(good == 0);
    }
    static const uint8_t junk = 1;
    begin_stream();
    feed(frame, FRAME);
    feed(&junk, 1);
    CHECK(good == 1 && bad == 1 && tail.count == 0);
}

/* The second half of a frame and the first half of the next have a good sum, as the words are the
 * same. With a check sum of 0xABCD they also begin with a start word. */
static void halves_of_two_equal_frames_are_no_feedback(void)
{
    uint8_t frame[FRAME];
    make_feedback(0, frame);
    memset(frame + 2, 0, VALUES);
    frame[2] = 5, frame[10] = 5; /* equal words, so that the check sum equals the start word */
    frame[16] = 0xCD, frame[17] = 0xAB;
    begin_stream();
    feed(frame + 16, 2);
    feed(frame, FRAME);
    CHECK(good == 1 && values[0] == 5 && values[8] == 5);
    for (uint32_t i = 0; i < 10; i++) {
        feed(frame, FRAME);
        CHECK(good == 2 + i && values[0] == 5 && values[8] == 5);
    }
    CHECK(bad == 0);
}

static void bytes_outside_of_frames_are_counted_once_until_the_stream_is_found_again(void)
{
    static const uint8_t noise[] = {1, 2, 0xCD, 3, 0xAB, 4, 0xCD, 0xAB};
    uint8_t frame[FRAME];
    make_feedback(3, frame);
    begin_stream();
    feed(noise, 6);
    CHECK(good == 0 && bad == 0); /* not counted before the first good frame */
    feed(frame, FRAME);
    feed(noise, 6);
    feed(noise, sizeof noise);
    CHECK(good == 1 && bad == 1);
    feed(frame, FRAME);
    feed(frame, FRAME);
    CHECK(good == 3 && bad == 1);
}

/* -------------------------------------------------------------------------- the machine */
static board_table hoverboard_table(uint32_t mixed)
{
    board_table table = {.dialect = BOARD_HOVERBOARD,
                         .answers = 1,
                         .tries = 3,
                         .mixed = mixed,
                         .payload_bytes = HOVERBOARD_SETPOINT_BYTES,
                         .feedback_bytes = HOVERBOARD_VALUE_BYTES,
                         .period_ns = 10 * MS,
                         .silence_ns = 150 * MS,
                         .setpoint_timeout_ns = 100 * MS,
                         .rest_velocity_rad_s = 0.05};
    for (uint32_t j = 0; j < MOTORS; j++) {
        table.setpoint[table.setpoint_count++] =
            (board_setpoint){.place = at(2 * j, 2, 1),
                             .scale = {.joint = j,
                                       .raw_per_si = 9.549296585513721,
                                       .raw_min = -1000.0,
                                       .raw_max = 1000.0}};
        table.field[table.field_count++] =
            field_of(j, FIELD_VELOCITY, at(6 - 2 * j, 2, 1), j == 1 ? -0.1047 : 0.1047);
        table.field[table.field_count++] = field_of(j, FIELD_VOLTAGE, at(8, 2, 1), 0.01);
        table.disarm[table.disarm_count++] = (board_write){.place = at(2 * j, 2, 1), .raw = 0};
    }
    return table;
}

static void say(int right_rpm, int left_rpm)
{
    uint8_t frame[FRAME] = {0xCD, 0xAB};
    board_place right = at(6, 2, 1), left = at(8, 2, 1), voltage = at(10, 2, 1);
    board_put(frame, &right, right_rpm);
    board_put(frame, &left, left_rpm);
    board_put(frame, &voltage, 3650);
    for (uint32_t i = 0; i < 16; i++) {
        frame[16 + i % 2] ^= frame[i];
    }
    board_machine_receive(&w.machine, frame, FRAME, w.now_ns);
}

static void go_on_saying(int64_t for_ns, int right_rpm, int left_rpm)
{
    for (int64_t end_ns = w.now_ns + for_ns; w.now_ns < end_ns;) {
        say(right_rpm, left_rpm);
        go_on(10 * MS);
    }
}

static bool sends(int first, int second)
{
    board_place one = at(2, 2, 1), two = at(4, 2, 1);
    return w.sent_bytes == HOVERBOARD_COMMAND_BYTES && board_get(w.sent, &one) == first &&
           board_get(w.sent, &two) == second;
}

static void arm_hoverboard(uint32_t mixed)
{
    begin_with(hoverboard_table(mixed));
    w.velocity_rad_s = 1.0;
    go_on_saying(50 * MS, 0, 0);
    request(DRIVE_READY);
    go_on_saying(50 * MS, 0, 0);
    CHECK(w.machine.state.mode == DRIVE_READY && sends(0, 0));
    request(DRIVE_ARMED);
    go_on_saying(50 * MS, -10, 10);
    CHECK(w.machine.state.mode == DRIVE_ARMED);
}

static void an_armed_hoverboard_follows_its_set_points_and_its_speeds_are_read(void)
{
    w.velocity_rad_s = 1.0;
    arm_hoverboard(0);
    CHECK(sends(10, 10));
    const joint_feedback *left = &w.machine.joint[0].feedback,
                         *right = &w.machine.joint[1].feedback;
    CHECK(fabs(left->velocity_rad_s - 1.047) < 1e-9 && fabs(right->velocity_rad_s - 1.047) < 1e-9);
    CHECK(fabs(left->voltage_v - 36.5) < 1e-9 && left->stamp_ns > w.now_ns - 20 * MS);
    CHECK(w.machine.received == 15 && w.machine.feedback_bytes == HOVERBOARD_VALUE_BYTES);
    arm_hoverboard(1);
    CHECK(sends(0, 10));
}

static void a_hoverboard_that_falls_silent_is_sent_zero_and_disarmed(void)
{
    arm_hoverboard(0);
    uint64_t received = w.machine.received;
    go_on(300 * MS);
    CHECK(w.machine.received == received && w.machine.state.mode == DRIVE_UNRESPONSIVE &&
          sends(0, 0));
    go_on_saying(100 * MS, 0, 0);
    CHECK(w.machine.state.mode != DRIVE_ARMED && sends(0, 0)); /* it has returned, and is not
                                                                  armed */
}

static void frames_with_a_wrong_sum_are_silence(void)
{
    arm_hoverboard(0);
    uint8_t frame[FRAME];
    make_feedback(1, frame);
    frame[17] ^= 0x40;
    for (uint32_t i = 0; i < 30; i++) {
        board_machine_receive(&w.machine, frame, FRAME, w.now_ns);
        go_on(10 * MS);
    }
    CHECK(w.machine.bad_frames == 1 && w.machine.state.mode == DRIVE_UNRESPONSIVE && sends(0, 0));
}

static void tables_of_packets_that_do_not_fit_are_refused(void)
{
    char name[FIELD_NAME_BYTES];
    board_table table = hoverboard_table(1);
    CHECK(board_table_check(&table, name) == NULL);
    table.mixed = 2;
    CHECK(strcmp(board_table_check(&table, name), "mixed") == 0);
    table = hoverboard_table(0);
    table.payload_bytes = 5;
    CHECK(strcmp(board_table_check(&table, name), "payload_bytes") == 0);
    table = hoverboard_table(0);
    table.feedback_bytes = 15;
    CHECK(strcmp(board_table_check(&table, name), "feedback_bytes") == 0);
    table = hoverboard_table(0);
    table.answers = table.field_count = 0;
    CHECK(strcmp(board_table_check(&table, name), "answers") == 0);
    table = hoverboard_table(0);
    table.imu.used = 1;
    CHECK(strcmp(board_table_check(&table, name), "imu.used") == 0);
}

int main(void)
{
    a_command_has_start_word_two_set_points_and_their_exclusive_or();
    a_feedback_is_taken_at_its_last_byte();
    a_torn_frame_does_not_cost_the_next_one();
    every_flipped_bit_is_seen_and_the_next_frame_is_good();
    a_start_word_among_the_values_is_no_feedback_and_does_not_hide_the_frame_after();
    halves_of_two_equal_frames_are_no_feedback();
    single_bytes_of_the_start_word_may_stand_anywhere();
    a_wrong_start_word_is_dropped_at_once_whatever_the_check_sum();
    bytes_outside_of_frames_are_counted_once_until_the_stream_is_found_again();
    an_armed_hoverboard_follows_its_set_points_and_its_speeds_are_read();
    a_hoverboard_that_falls_silent_is_sent_zero_and_disarmed();
    frames_with_a_wrong_sum_are_silence();
    tables_of_packets_that_do_not_fit_are_refused();
    return checks_report("test_board_packets");
}
