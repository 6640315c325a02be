/* SPDX-License-Identifier: Apache-2.0
 * Commands of the second process: the content of a TwistStamped, its age, and the sequence
 * under which it is sent. */
#include <errno.h>
#include <math.h>
#include <string.h>
#include <sys/socket.h>
#include <unistd.h>

#include "bus.h"
#include "check.h"
#include "rt.h"

enum { LITTLE = 1, BIG = 0, ROOM = TWIST_RAW_MAX + 8 };

static void put(uint8_t *at, uint64_t value, uint32_t bytes, int order)
{
    for (uint32_t i = 0; i < bytes; i++) {
        at[order == LITTLE ? i : bytes - 1 - i] = (uint8_t)(value >> 8 * i);
    }
}

static void put_double(uint8_t *at, double value, int order)
{
    uint64_t bits;
    memcpy(&bits, &value, sizeof bits);
    put(at, bits, sizeof bits, order);
}

/* Encodes a TwistStamped. `frame_bytes`: length of its frame_id with the terminating zero. Returns
 * the length of the whole. */
static size_t encoded(uint8_t *raw, uint32_t frame_bytes, int order, const double *twist)
{
    size_t at = 4 + ((12 + (size_t)frame_bytes + 7) & ~(size_t)7);
    memset(raw, 0, ROOM);
    raw[1] = (uint8_t)order;
    put(raw + 4, (uint64_t)(uint32_t)-2, 4, order);
    put(raw + 8, 500000000, 4, order);
    put(raw + 12, frame_bytes, 4, order);
    for (size_t i = 0; i < 6; i++) {
        put_double(raw + at + 8 * i, twist[i], order);
    }
    return at + 48;
}

static void a_twist_is_read_in_both_byte_orders(void)
{
    static uint8_t raw[ROOM];
    const double twist[6] = {0.25, 0.75, 9.0, 9.0, 9.0, -0.5};
    for (uint32_t frame_bytes = 0; frame_bytes < 40; frame_bytes++) {
        for (int order = BIG; order <= LITTLE; order++) {
            stamped_twist found;
            size_t bytes = encoded(raw, frame_bytes, order, twist);
            CHECK(twist_parse(raw, bytes, &found) == 0);
            CHECK(found.linear_m_s == 0.25 && found.lateral_m_s == 0.75 &&
                  found.angular_rad_s == -0.5);
            CHECK(found.stamp_s == -1.5);
            CHECK(twist_parse(raw, bytes - 1, &found) == 1 + TWIST_NOT_ONE);
        }
    }
}

static void a_twist_that_is_not_finite_is_parsed_and_left_to_the_loop_to_refuse(void)
{
    static uint8_t raw[ROOM];
    const double twist[6] = {(double)NAN, (double)NAN, 0.0, 0.0, 0.0, (double)INFINITY};
    stamped_twist found;
    CHECK(twist_parse(raw, encoded(raw, 1, LITTLE, twist), &found) == 0);
    CHECK(isnan(found.linear_m_s) && isnan(found.lateral_m_s) && isinf(found.angular_rad_s));
}

static void a_twist_of_another_encoding_or_length_is_refused(void)
{
    static uint8_t raw[ROOM];
    const double twist[6] = {0};
    stamped_twist found;
    size_t bytes = encoded(raw, 5, LITTLE, twist);
    CHECK(twist_parse(raw, 0, &found) == 1 + TWIST_NOT_ONE);
    CHECK(twist_parse(raw, 15, &found) == 1 + TWIST_NOT_ONE);
    raw[1] = 7; /* version 2 of the encoding */
    CHECK(twist_parse(raw, bytes, &found) == 1 + TWIST_NOT_ONE);
    CHECK(twist_parse(raw, encoded(raw, 0, LITTLE, twist), &found) == 0);
    raw[1] = 2; /* without a frame_id both byte orders would read it */
    CHECK(twist_parse(raw, bytes, &found) == 1 + TWIST_NOT_ONE);
    bytes = encoded(raw, 5, LITTLE, twist);
    raw[0] = 1;
    CHECK(twist_parse(raw, bytes, &found) == 1 + TWIST_NOT_ONE);
    for (uint64_t frame_bytes = 1000; frame_bytes <= UINT32_MAX;
         frame_bytes = 2 * frame_bytes + 1) {
        bytes = encoded(raw, 5, LITTLE, twist);
        put(raw + 12, frame_bytes, 4, LITTLE);
        CHECK(twist_parse(raw, bytes, &found) == 1 + TWIST_NOT_ONE);
    }
    put(raw + 12, UINT32_MAX, 4, LITTLE);
    CHECK(twist_parse(raw, bytes, &found) == 1 + TWIST_NOT_ONE);
    CHECK(twist_parse(raw, encoded(raw, TWIST_RAW_MAX - 68, LITTLE, twist), &found) == 0);
    CHECK(twist_parse(raw, TWIST_RAW_MAX, &found) == 0);
    CHECK(twist_parse(raw, TWIST_RAW_MAX + 1, &found) == 1 + TWIST_NOT_ONE);
}

static void an_age_is_that_of_the_stamp(void)
{
    double age_s = -1.0;
    CHECK(stamp_age(1e9, 1e9 + 0.25, &age_s) == 0 && age_s == 0.25);
    CHECK(stamp_age(1e9 + 0.5, 1e9, &age_s) == 0 && age_s == 0.0);
    CHECK(stamp_age(1.0, 1e9, &age_s) == 0 && age_s == 3600.0);
    CHECK(stamp_age(-1e9, 1e9, &age_s) == 0 && age_s == 3600.0);
    CHECK(stamp_age(0.0, 1e9, &age_s) == 1 + TWIST_STAMP_ZERO);
    CHECK(stamp_age(-0.0, 1e9, &age_s) == 1 + TWIST_STAMP_ZERO);
    CHECK(stamp_age(1e9, 1e9 + 0.0625, &age_s) == 0 && age_s == 0.0625);
    CHECK(stamp_age(1e9 + 0.5625, 1e9, &age_s) == 1 + TWIST_STAMP_AHEAD);
    CHECK(stamp_age(1e9 + 0.75, 1e9, &age_s) == 1 + TWIST_STAMP_AHEAD);
    CHECK(stamp_age((double)NAN, 1e9, &age_s) == 1 + TWIST_STAMP_AHEAD);
    CHECK(stamp_age((double)INFINITY, 1e9, &age_s) == 1 + TWIST_STAMP_AHEAD);
}

static command_datagram received(int fd)
{
    command_datagram one;
    CHECK(recv(fd, &one, sizeof one, MSG_DONTWAIT) == sizeof one);
    return one;
}

static void a_lease_numbers_all_commands_sent_under_it(void)
{
    outlet o;
    int first[2], second[2];
    const uint8_t a[LEASE_TOKEN_BYTES] = {'a'}, b[LEASE_TOKEN_BYTES] = {'b'};
    const stamped_twist twist = {.linear_m_s = 0.5, .angular_rad_s = -0.25};
    command_datagram own = {
        .magic = COMMAND_MAGIC, .version = COMMAND_VERSION, .kind = COMMAND_RELEASE, .stamp_ns = 5};
    CHECK(socketpair(AF_UNIX, SOCK_DGRAM, 0, first) == 0 &&
          socketpair(AF_UNIX, SOCK_DGRAM, 0, second) == 0);
    memset(&o, 0x55, sizeof o);
    outlet_init(&o);
    CHECK(outlet_send_direct(&o, &twist, 1, 7, 1) == -ENOTCONN &&
          outlet_send(&o, &own, sizeof own, -1) == -ENOTCONN);
    CHECK(outlet_direct(&o) == 0 && outlet_let_go(&o) == 0);
    outlet_hold(&o, first[0], a, 41);
    CHECK(outlet_send_direct(&o, &twist, 1, 7, 1) == 0 && outlet_direct(&o) == 1);
    command_datagram came = received(first[1]);
    CHECK(came.magic == COMMAND_MAGIC && came.version == COMMAND_VERSION &&
          came.kind == (COMMAND_TWIST | OUTLET_SENDERS_FROM << SENDER_SHIFT));
    CHECK(came.sequence == 42 && came.stamp_ns == 7 && came.lifetime_ms == 0 &&
          memcmp(came.token, a, sizeof a) == 0);
    CHECK(came.linear_m_s == 0.5 && came.angular_rad_s == -0.25);
    CHECK(outlet_send(&o, &own, sizeof own, -1) == 0);
    came = received(first[1]);
    CHECK(came.sequence == 43 && came.kind == COMMAND_RELEASE && came.stamp_ns == 5);
    outlet_hold(&o, second[0], b, 0); /* the daemon has returned */
    CHECK(outlet_send_direct(&o, &twist, 1, 8, 1) == 0);
    came = received(second[1]);
    CHECK(came.sequence == 1 && memcmp(came.token, b, sizeof b) == 0);
    CHECK(outlet_let_go(&o) == 1);
    CHECK(outlet_send_direct(&o, &twist, 1, 9, 1) == -ENOTCONN && outlet_direct(&o) == 2);
    CHECK(outlet_send(&o, &own, 63, -1) == -EINVAL);
    for (int i = 0; i < 2; i++) {
        (void)close(first[i]);
        (void)close(second[i]);
    }
}

static void a_sender_that_has_not_seen_the_newest_command_does_not_override_it(void)
{
    outlet o;
    int pair[2];
    const uint8_t token[LEASE_TOKEN_BYTES] = {1};
    const stamped_twist rest = {0};
    joint_datagram wheels = {
        .magic = COMMAND_MAGIC, .version = COMMAND_VERSION, .kind = COMMAND_JOINTS};
    CHECK(socketpair(AF_UNIX, SOCK_DGRAM, 0, pair) == 0);
    outlet_init(&o);
    outlet_hold(&o, pair[0], token, 0);
    CHECK(outlet_send(&o, &wheels, sizeof wheels, 0) == 0);
    CHECK(outlet_send_direct(&o, &rest, 1, 1, 1) == 0);
    CHECK(outlet_send(&o, &wheels, sizeof wheels, 0) == -ESTALE);
    CHECK(outlet_send(&o, &wheels, sizeof wheels, 1) == 0);
    CHECK(outlet_let_go(&o) == 3);
    (void)close(pair[0]);
    (void)close(pair[1]);
}

static void nothing_is_handed_on_while_python_stands_still(void)
{
    outlet o;
    int pair[2];
    const uint8_t token[LEASE_TOKEN_BYTES] = {1};
    const stamped_twist twist = {.linear_m_s = 0.5};
    const int64_t begin_ns = INT64_C(5000000000);
    CHECK(socketpair(AF_UNIX, SOCK_DGRAM, 0, pair) == 0);
    outlet_init(&o);
    outlet_hold(&o, pair[0], token, 0);
    CHECK(outlet_send_direct(&o, &twist, 1, 1, begin_ns) == -EHOSTDOWN); /* not yet reported alive
                                                                          */
    outlet_alive(&o, begin_ns);
    CHECK(outlet_send_direct(&o, &twist, 1, 1, begin_ns + OUTLET_ALIVE_NS) == 0 &&
          received(pair[1]).sequence == 1);
    CHECK(outlet_send_direct(&o, &twist, 1, 1, begin_ns + OUTLET_ALIVE_NS + 1) == -EHOSTDOWN &&
          outlet_direct(&o) == 1);
    outlet_alive(&o, begin_ns + OUTLET_ALIVE_NS + 1);
    CHECK(outlet_send_direct(&o, &twist, 1, 1, begin_ns + OUTLET_ALIVE_NS + 1) == 0 &&
          received(pair[1]).sequence == 2);
    (void)close(pair[0]);
    (void)close(pair[1]);
}

static void each_writer_has_a_number_as_long_as_it_commands(void)
{
    outlet o;
    int pair[2];
    const uint8_t token[LEASE_TOKEN_BYTES] = {1};
    const stamped_twist rest = {0};
    CHECK(socketpair(AF_UNIX, SOCK_DGRAM, 0, pair) == 0);
    outlet_init(&o);
    outlet_hold(&o, pair[0], token, 0);
    static const struct {
        uint64_t writer;
        int64_t now_ns;
        int sender;
    } SENT[] = {
        {100, 1, OUTLET_SENDERS_FROM},     {101, 2, OUTLET_SENDERS_FROM + 1},
        {100, 3, OUTLET_SENDERS_FROM},     {102, 4, OUTLET_SENDERS_FROM + 2},
        {101, 5, OUTLET_SENDERS_FROM + 1},
    };
    outlet_alive(&o, 1);
    for (size_t i = 0; i < sizeof SENT / sizeof SENT[0]; i++) {
        CHECK(outlet_send_direct(&o, &rest, SENT[i].writer, 1, SENT[i].now_ns) == 0);
        CHECK(received(pair[1]).kind >> SENDER_SHIFT == SENT[i].sender);
    }
    for (uint64_t writer = 103; writer < 100 + OUTLET_SENDERS; writer++) {
        CHECK(outlet_send_direct(&o, &rest, writer, 1, 6) == 0);
        CHECK(received(pair[1]).kind >> SENDER_SHIFT == (int)(OUTLET_SENDERS_FROM + writer - 100));
    }
    outlet_alive(&o, 3 + OUTLET_KEPT_NS);
    CHECK(outlet_send_direct(&o, &rest, 200, 1, 2 + OUTLET_KEPT_NS) == 0);
    CHECK(received(pair[1]).kind >> SENDER_SHIFT == SENDER_UNNAMED);
    CHECK(outlet_send_direct(&o, &rest, 200, 1, 3 + OUTLET_KEPT_NS) == 0);
    CHECK(received(pair[1]).kind >> SENDER_SHIFT == OUTLET_SENDERS_FROM);
    (void)close(pair[0]);
    (void)close(pair[1]);
}

static void a_full_socket_is_reported(void)
{
    outlet o;
    int pair[2], error = 0, sent = 0;
    const uint8_t token[LEASE_TOKEN_BYTES] = {1};
    const stamped_twist rest = {0};
    CHECK(socketpair(AF_UNIX, SOCK_DGRAM, 0, pair) == 0);
    outlet_init(&o);
    outlet_hold(&o, pair[0], token, 0);
    for (; error == 0; sent++) {
        error = outlet_send_direct(&o, &rest, 1, 1, 1);
    }
    CHECK(error == -EAGAIN && outlet_direct(&o) == (uint64_t)sent - 1);
    (void)close(pair[1]);
    CHECK(outlet_send_direct(&o, &rest, 1, 1, 1) < 0);
    (void)close(pair[0]);
}

int main(void)
{
    a_twist_is_read_in_both_byte_orders();
    a_twist_that_is_not_finite_is_parsed_and_left_to_the_loop_to_refuse();
    a_twist_of_another_encoding_or_length_is_refused();
    an_age_is_that_of_the_stamp();
    a_lease_numbers_all_commands_sent_under_it();
    a_sender_that_has_not_seen_the_newest_command_does_not_override_it();
    nothing_is_handed_on_while_python_stands_still();
    each_writer_has_a_number_as_long_as_it_commands();
    a_full_socket_is_reported();
    return checks_report("bus_twist");
}
