/* SPDX-License-Identifier: Apache-2.0
 * test_line_group_table: which tables of bus servos are refused, because one request cannot carry
 * them or their answers cannot be received. */
#include "servo_wire.h"

static void an_invalid_group_is_refused(void)
{
    char name[FIELD_NAME_BYTES];
    servos_begin(2, ECHO_NONE);
    CHECK(line_table_check(&s.table, name) == NULL);
    line_table good = s.table;
#define REFUSED(change)                                                                            \
    s.table = good;                                                                                \
    change;                                                                                        \
    CHECK(!line_group_is_good(&s.table) && line_table_check(&s.table, name) != NULL)
    REFUSED(s.table.group.used = 2);
    REFUSED(s.table.group.write_bytes = GROUP_HEAD_MAX + 1);
    REFUSED(s.table.group.read_bytes = GROUP_HEAD_MAX + 1);
    REFUSED(s.table.group.write_bytes = 4);
    REFUSED(s.table.group.read_bytes = 4);
    REFUSED(s.table.group.data_byte = 8);
    REFUSED(s.table.group.data_byte = 7); /* the set-point would not be part of the data */
    REFUSED(s.table.drive[1].cyclic_count = 1);
    REFUSED(s.table.drive[1].cyclic[0].setpoint_count = 0);
    REFUSED(s.table.drive[1].cyclic[0].setpoint[1] = (line_setpoint){.byte = 5};
            s.table.drive[1].cyclic[0].setpoint_count = 2);
    REFUSED(s.table.drive[1].cyclic[1].frame.reply_bytes = 0);
    REFUSED(s.table.drive[1].direction_count = 1);
    REFUSED(s.table.drive[1].cyclic[1].setpoint[0] = s.table.drive[1].cyclic[0].setpoint[0];
            s.table.drive[1].cyclic[1].setpoint_count = 1);
    REFUSED(s.table.drive[1].cyclic[0].frame.request_bytes = 8);
    REFUSED(s.table.drive[0].cyclic[0].frame.request_seal = SEAL_CRC8);
    REFUSED(s.table.drive[1].cyclic[0].frame.request_seal = SEAL_STUFFED);
    REFUSED(s.table.drive[1].cyclic[1].frame.request_seal = SEAL_STUFFED);
    REFUSED(s.table.drive[1].cyclic[1].frame.reply_seal = SEAL_STUFFED);
    REFUSED(s.table.drive[1].idle[0] = s.table.drive[1].cyclic[0].frame;
            s.table.drive[1].idle_count = 1);
    s.table = good;
    s.table.group.used = 0;
    s.table.group.write_bytes = 0;
    CHECK(line_table_check(&s.table, name) == NULL);
}

static void seal_all(uint32_t seal)
{
    for (uint32_t i = 0; i < s.table.drive_count; i++) {
        line_exchange *turn = s.table.drive[i].cyclic;
        turn[0].frame.request_seal = turn[1].frame.request_seal = turn[1].frame.reply_seal = seal;
    }
}

static void only_packets_of_servos_make_a_group(void)
{
    servos_begin(2, ECHO_NONE);
    for (uint32_t seal = SEAL_NONE; seal <= SEAL_STUFFED; seal++) {
        seal_all(seal);
        CHECK(line_group_is_good(&s.table) == (seal == SEAL_SUM || seal == SEAL_STUFFED));
    }
}

/* The set-points end before the check sum. */
static void a_group_has_room_for_its_set_points(void)
{
    servos_begin(2, ECHO_NONE);
    uint32_t request_bytes = s.table.drive[0].cyclic[0].frame.request_bytes;
    s.table.group.data_byte = request_bytes - 2;
    for (uint32_t i = 0; i < 2; i++) {
        s.table.drive[i].cyclic[0].setpoint[0].byte = request_bytes - 1;
    }
    CHECK(line_group_is_good(&s.table)); /* one byte of data */
    s.table.group.data_byte++;
    CHECK(!line_group_is_good(&s.table)); /* this byte belongs to the check sum */
}

/* Stuffing adds at most one byte to three. */
static void all_that_is_sent_to_a_group_fits_into_one_request(void)
{
    static const uint32_t SEALS[] = {SEAL_SUM, SEAL_STUFFED},
                          MOST[] = {FRAME_BYTES_MAX, 3 * FRAME_BYTES_MAX / 4};
    for (uint32_t kind = 0; kind < 2; kind++) {
        servos_begin(2, ECHO_NONE);
        seal_all(SEALS[kind]);
        line_group *group = &s.table.group;
        for (uint32_t size = 0; size < 100 * 10 * 10; size++) {
            group->write_bytes = 7 + size / 10 % 10;
            group->read_bytes = 7 + size % 10;
            uint32_t request_bytes = 20 + size / 100, each = 2 + request_bytes - group->data_byte;
            s.table.drive[0].cyclic[0].frame.request_bytes =
                s.table.drive[1].cyclic[0].frame.request_bytes = request_bytes;
            uint32_t sent =
                group->write_bytes + group->read_bytes + 2 * rtu_seal_bytes(SEALS[kind]) + 2 * each;
            CHECK(line_group_is_good(&s.table) == (sent <= MOST[kind]));
        }
    }
}

/* The received bytes include a copy of the request, which some adapters return. */
static void all_that_a_group_answers_can_be_received(void)
{
    static const uint32_t SEALS[] = {SEAL_SUM, SEAL_STUFFED},
                          MOST[] = {RECEIVED_BYTES_MAX - 31, 3 * (RECEIVED_BYTES_MAX - 44) / 4};
    for (uint32_t kind = 0; kind < 2; kind++) {
        servos_begin(3, ECHO_NONE);
        seal_all(SEALS[kind]);
        for (uint32_t longest = 0; longest < 3 * FRAME_BYTES_MAX; longest++) {
            uint32_t comes = 0;
            for (uint32_t i = 0; i < 3; i++) {
                uint32_t bytes = i == longest % 3 ? 1 + longest / 3 : 140 + 10 * i;
                s.table.drive[i].cyclic[1].frame.reply_bytes = bytes;
                comes += bytes;
            }
            CHECK(line_group_is_good(&s.table) == (comes <= MOST[kind]));
        }
    }
}

int main(void)
{
    an_invalid_group_is_refused();
    only_packets_of_servos_make_a_group();
    a_group_has_room_for_its_set_points();
    all_that_is_sent_to_a_group_fits_into_one_request();
    all_that_a_group_answers_can_be_received();
    return checks_report("line group table");
}
