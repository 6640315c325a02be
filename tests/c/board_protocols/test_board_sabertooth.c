/* SPDX-License-Identifier: Apache-2.0
 * test_board_sabertooth: packets of one Sabertooth and of several on a wire, byte by byte. Each
 * buffer has the length of its content, so that a sanitizer sees an access beyond it. */
#include <stdlib.h>

#include "board_wire.h"

static uint32_t build_sabertooth(uint32_t unit, uint32_t timeout, int one, int other, uint8_t *out)
{
    uint8_t *payload = malloc(SABERTOOTH_SETPOINT_BYTES),
            *packets = malloc(3 * SABERTOOTH_PACKET_BYTES);
    payload[0] = (uint8_t)timeout;
    payload[1] = (uint8_t)one;
    payload[2] = (uint8_t)other;
    uint32_t count = board_sabertooth_build(unit, payload, packets);
    memcpy(out, packets, count);
    free(payload);
    free(packets);
    return count;
}

static void each_motor_has_a_packet_with_its_direction_and_the_sum_of_seven_bits(void)
{
    /* the first packet is the example of the user's guide */
    static const uint8_t forward[] = {130, 0, 64, 66, 130, 4, 127, 5};
    static const uint8_t backward[] = {135, 1, 1, 9, 135, 5, 127, 11};
    uint8_t out[3 * SABERTOOTH_PACKET_BYTES];
    CHECK(build_sabertooth(130, 0, 64, 127, out) == sizeof forward &&
          memcmp(out, forward, sizeof forward) == 0);
    CHECK(build_sabertooth(135, 0, -1, -127, out) == sizeof backward &&
          memcmp(out, backward, sizeof backward) == 0);
    CHECK(build_sabertooth(135, 0, -1, -128, out) == sizeof backward &&
          memcmp(out, backward, sizeof backward) == 0);
}

static void the_time_out_is_sent_with_every_set_point(void)
{
    static const uint8_t still[] = {128, 14, 3, 17, 128, 0, 0, 0, 128, 4, 0, 4};
    uint8_t out[3 * SABERTOOTH_PACKET_BYTES];
    CHECK(build_sabertooth(128, 3, 0, 0, out) == sizeof still &&
          memcmp(out, still, sizeof still) == 0);
    CHECK(build_sabertooth(128, 127, 0, 0, out) == sizeof still && out[2] == 127);
    /* values stay below 128: a higher byte is an address */
    CHECK(build_sabertooth(128, 128, 0, 0, out) == sizeof still && out[2] == 127);
    CHECK(build_sabertooth(128, 255, 5, 5, out) == sizeof still && out[2] == 127);
}

static void only_an_address_byte_is_above_127(void)
{
    for (uint32_t value = 0; value < 256; value++) {
        uint8_t out[3 * SABERTOOTH_PACKET_BYTES];
        uint32_t count = build_sabertooth(131, value, (int)value, 255 - (int)value, out);
        for (uint32_t i = 0; i < count; i++) {
            CHECK(i % SABERTOOTH_PACKET_BYTES == 0 ? out[i] == 131 : out[i] < 128);
        }
    }
}

/* -------------------------------------------------------------------------- the machine */
static board_table sabertooth_table(void)
{
    board_table table = {.dialect = BOARD_SABERTOOTH,
                         .tries = 3,
                         .unit_count = 1,
                         .unit = {128},
                         .payload = {3},
                         .payload_bytes = SABERTOOTH_SETPOINT_BYTES,
                         .period_ns = 10 * MS,
                         .silence_ns = 150 * MS,
                         .setpoint_timeout_ns = 100 * MS,
                         .rest_velocity_rad_s = 0.05};
    for (uint32_t j = 0; j < MOTORS; j++) {
        table.setpoint[table.setpoint_count++] = (board_setpoint){
            .place = at(1 + j, 1, 1),
            .scale = {.joint = j, .raw_per_si = 10.0, .raw_min = -127.0, .raw_max = 127.0}};
    }
    return table;
}

static void a_sabertooth_counts_as_present_while_its_port_takes_bytes(void)
{
    static const uint8_t still[] = {128, 14, 3, 17, 128, 0, 0, 0, 128, 4, 0, 4};
    static const uint8_t turning[] = {128, 14, 3, 17, 128, 0, 10, 10, 128, 4, 10, 14};
    begin_with(sabertooth_table());
    request(DRIVE_READY);
    go_on(50 * MS);
    CHECK(w.sent_bytes == sizeof still && memcmp(w.sent, still, sizeof still) == 0);
    request(DRIVE_ARMED);
    go_on(50 * MS);
    CHECK(w.sent_bytes == sizeof turning && memcmp(w.sent, turning, sizeof turning) == 0);
    /* a copy of what was sent is no feedback */
    board_machine_receive(&w.machine, turning, sizeof turning, w.now_ns);
    CHECK(w.machine.bad_frames == 0 && w.machine.feedback_bytes == 0);
    w.enabled = 2; /* no set-points come any more */
    go_on(300 * MS);
    CHECK(w.machine.state.mode != DRIVE_ARMED && memcmp(w.sent, still, sizeof still) == 0);
}

/* Joint 0 is motor 2 of unit 129, joint 1 is motor 1 of unit 130. */
static board_table two_sabertooths(void)
{
    board_table table = sabertooth_table();
    table.unit_count = 2;
    table.unit[0] = 129, table.unit[1] = 130;
    table.payload_bytes = 2 * SABERTOOTH_SETPOINT_BYTES;
    table.payload[3] = 5;
    table.setpoint[0].place = at(2, 1, 1), table.setpoint[1].place = at(4, 1, 1);
    return table;
}

static board_table eight_sabertooths(void)
{
    board_table table = sabertooth_table();
    table.unit_count = SABERTOOTH_UNITS_MAX;
    table.payload_bytes = SABERTOOTH_UNITS_MAX * SABERTOOTH_SETPOINT_BYTES;
    for (uint32_t i = 0; i < SABERTOOTH_UNITS_MAX; i++) {
        table.unit[i] = (uint8_t)(SABERTOOTH_UNIT_MIN + i);
        table.payload[SABERTOOTH_SETPOINT_BYTES * i] = 3;
    }
    return table;
}

static void sabertooths_on_one_wire_are_driven_and_stopped_in_one_cycle(void)
{
    static const uint8_t still[] = {129, 14, 3, 18, 129, 0, 0, 1, 129, 4, 0, 5,
                                    130, 14, 5, 21, 130, 0, 0, 2, 130, 4, 0, 6};
    static const uint8_t turning[] = {129, 14, 3, 18, 129, 0, 0,  1,  129, 4, 10, 15,
                                      130, 14, 5, 21, 130, 0, 10, 12, 130, 4, 0,  6};
    begin_with(two_sabertooths());
    request(DRIVE_READY);
    go_on(50 * MS);
    CHECK(w.sent_bytes == sizeof still && memcmp(w.sent, still, sizeof still) == 0);
    request(DRIVE_ARMED);
    go_on(50 * MS);
    CHECK(w.sent_bytes == sizeof turning && memcmp(w.sent, turning, sizeof turning) == 0);
    request(DRIVE_STAND_DOWN);
    go_on(50 * MS);
    CHECK(w.sent_bytes == sizeof still && memcmp(w.sent, still, sizeof still) == 0);
    begin_with(eight_sabertooths());
    request(DRIVE_READY);
    go_on(50 * MS);
    CHECK(w.sent_bytes == 96 && w.sent[0] == 128 && w.sent[95] == (135 + 4) % 128);
}

static void tables_of_packets_that_do_not_fit_are_refused(void)
{
    char name[FIELD_NAME_BYTES];
    board_table table = sabertooth_table();
    CHECK(board_table_check(&table, name) == NULL);
    table.unit[0] = 127;
    CHECK(strcmp(board_table_check(&table, name), "unit") == 0);
    table.unit[0] = 136;
    CHECK(strcmp(board_table_check(&table, name), "unit") == 0);
    table.unit[0] = 135;
    CHECK(board_table_check(&table, name) == NULL);
    table.unit_count = 0;
    CHECK(strcmp(board_table_check(&table, name), "unit_count") == 0);
    table.unit_count = 9;
    CHECK(strcmp(board_table_check(&table, name), "unit_count") == 0);
    table = two_sabertooths();
    CHECK(board_table_check(&table, name) == NULL);
    table.unit[0] = 130; /* both units are the same */
    CHECK(strcmp(board_table_check(&table, name), "unit") == 0);
    table.unit[0] = 131;
    CHECK(strcmp(board_table_check(&table, name), "unit") == 0);
    table = eight_sabertooths();
    CHECK(board_table_check(&table, name) == NULL);
    table.payload_bytes = 3;
    CHECK(strcmp(board_table_check(&table, name), "payload_bytes") == 0);
    table = sabertooth_table();
    table.payload_bytes = 4;
    CHECK(strcmp(board_table_check(&table, name), "payload_bytes") == 0);
    table = sabertooth_table();
    table.answers = 1;
    CHECK(strcmp(board_table_check(&table, name), "answers") == 0);
}

int main(void)
{
    each_motor_has_a_packet_with_its_direction_and_the_sum_of_seven_bits();
    the_time_out_is_sent_with_every_set_point();
    only_an_address_byte_is_above_127();
    a_sabertooth_counts_as_present_while_its_port_takes_bytes();
    sabertooths_on_one_wire_are_driven_and_stopped_in_one_cycle();
    tables_of_packets_that_do_not_fit_are_refused();
    return checks_report("test_board_sabertooth");
}
