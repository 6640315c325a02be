/* SPDX-License-Identifier: Apache-2.0
 * test_line_group_bytes: bytes that arrive after a request to all servos: replies, noise between
 * them, too many bytes. */
#include "servo_wire.h"

static const int64_t SERVO_MS = 1000000;
static const line_machine *const m = &s.machine;

/* Appends the reply of servo `number`. Returns the new count of bytes. */
static uint32_t put_reply(uint8_t *bytes, uint32_t count, uint32_t number)
{
    const uint8_t reply[] = {0xFF, 0xFF, (uint8_t)(number + 7), 4, 0, (uint8_t)(10 + number), 0, 0};
    memcpy(bytes + count, reply, sizeof reply);
    rtu_seal(bytes + count, sizeof reply, SEAL_SUM);
    return count + (uint32_t)sizeof reply;
}

static uint32_t put_noise(uint8_t *bytes, uint32_t count, uint32_t more)
{
    memset(bytes + count, 0x55, more);
    return count + more;
}

static void come(const uint8_t *bytes, uint32_t count, int64_t now_ns)
{
    line_machine_step(&s.machine, now_ns, bytes, count, &s.out);
}

static void noise_before_between_and_after_replies_is_counted_and_costs_no_reply(void)
{
    for (uint32_t order = 0; order < 2; order++) {
        group_goes_out(3, ECHO_NONE);
        uint8_t bytes[64];
        uint64_t noise = m->noise_bytes;
        uint32_t count = put_noise(bytes, 0, 3);
        count = put_reply(bytes, count, order == 0 ? 0 : 2);
        count = put_noise(bytes, count, 2);
        count = put_reply(bytes, count, 1);
        count = put_reply(bytes, count, order == 0 ? 2 : 0);
        count = put_noise(bytes, count, 1);
        come(bytes, count, m->end_ns + SERVO_MS);
        CHECK(m->group.waiting == 0 && m->noise_bytes - noise == 6);
        for (uint32_t i = 0; i < 3; i++) {
            CHECK(m->drive[i].failures == 0 &&
                  m->joint[i].feedback.velocity_rad_s == (10 + i) * 0.01);
        }
    }
}

/* The late reply answers an earlier exchange; this one does not read its servo. */
static void a_late_reply_after_a_due_one_is_not_noise(void)
{
    uint8_t bytes[32];
    group_goes_out(2, ECHO_NONE);
    come(bytes, put_reply(bytes, 0, 0), m->end_ns + SERVO_MS / 10);
    int64_t failed_ns = m->until_ns;
    s.machine.drive[1].held_until_ns = failed_ns + 900 * SERVO_MS;
    come(bytes, 0, failed_ns);
    CHECK(m->drive[0].failures == 0 && m->drive[1].count.no_reply == 1 &&
          m->drive[1].count.late == 0);
    for (int64_t now_ns = failed_ns; m->work != WORK_GROUP; now_ns += SERVO_MS) {
        come(bytes, 0, now_ns);
    }
    line_machine_sent(&s.machine, m->now_ns);
    CHECK(m->group.waiting == 1);
    int64_t stamp_ns = m->joint[1].feedback.stamp_ns;
    come(bytes, put_reply(bytes, put_reply(bytes, 0, 0), 1), m->end_ns + SERVO_MS / 10);
    CHECK(m->drive[0].failures == 0 && m->drive[1].count.late == 1 && m->noise_bytes == 0);
    CHECK(m->joint[1].feedback.stamp_ns == stamp_ns);
}

/* The time at which its values were taken is unknown. */
static void a_reply_that_takes_longer_than_usual_is_not_read(void)
{
    for (int64_t longer_ns = 0; longer_ns < 2; longer_ns++) {
        group_goes_out(1, ECHO_NONE);
        s.machine.drive[0].usual_ns = SERVO_MS;
        int64_t stamp_ns = m->joint[0].feedback.stamp_ns;
        uint8_t bytes[32];
        uint32_t count = put_reply(bytes, 0, 0);
        come(bytes, count, m->end_ns + count * SERVO_CHARACTER_NS + SERVO_MS + longer_ns);
        CHECK(m->group.waiting == 0 && m->drive[0].failures == 0);
        CHECK((m->joint[0].feedback.stamp_ns == stamp_ns) == (longer_ns > 0));
        CHECK((m->joint[0].feedback.velocity_rad_s == 0.1) == (longer_ns == 0));
    }
}

/* Each reply takes time on the wire, so the stamps differ by the time of one reply. */
static void replies_that_come_at_once_are_stamped_one_reply_apart(void)
{
    group_goes_out(3, ECHO_NONE);
    for (uint32_t i = 0; i < 3; i++) {
        s.machine.drive[i].usual_ns = 0;
    }
    uint8_t bytes[64];
    uint32_t count = put_reply(bytes, put_reply(bytes, put_reply(bytes, 0, 0), 1), 2);
    int64_t now_ns = m->end_ns + SERVO_MS;
    come(bytes, count, now_ns);
    int64_t apart_ns = m->joint[1].feedback.stamp_ns - m->joint[0].feedback.stamp_ns;
    CHECK(apart_ns == 8 * SERVO_CHARACTER_NS &&
          m->joint[2].feedback.stamp_ns - m->joint[1].feedback.stamp_ns == apart_ns);
    CHECK(m->round_trip_ns == now_ns - m->start_ns && !s.out.notify);
}

static void bytes_beyond_the_buffer_end_the_exchange(void)
{
    static uint8_t bytes[2 * RECEIVED_BYTES_MAX];
    memset(bytes, 0x55, sizeof bytes);
    for (uint32_t first = 0; first <= 100; first += 50) {
        for (uint32_t more = 0; more <= 100; more += 100) {
            group_goes_out(2, ECHO_NONE);
            come(bytes, first, m->end_ns + SERVO_MS / 10);
            CHECK(m->group.waiting == 3);
            come(bytes, RECEIVED_BYTES_MAX - first + more, m->end_ns + SERVO_MS / 5);
            CHECK(m->group.waiting == 0 && m->drive[0].count.bad_reply == 1 &&
                  m->drive[1].count.bad_reply == 1);
            CHECK(m->transaction.received_bytes <= RECEIVED_BYTES_MAX);
        }
    }
    group_goes_out(2, ECHO_NONE);
    come(bytes, RECEIVED_BYTES_MAX - 1, m->end_ns + SERVO_MS / 10);
    CHECK(m->group.waiting == 3 && m->work == WORK_GROUP);
}

/* A request without a reply ends after its time on the wire. */
static void set_points_without_a_reply_take_their_time(void)
{
    group_goes_out(2, ECHO_NONE);
    do {
        s.machine.drive[0].silent_until_ns = s.machine.drive[1].silent_until_ns =
            s.now_ns + 900 * SERVO_MS;
        servos_step(1.0, 1);
    } while (m->work != WORK_GROUP || m->group.waiting != 0);
    come(s.bytes, 0, m->until_ns - 1); /* its bytes are still on the wire */
    CHECK(m->work == WORK_GROUP);
    come(s.bytes, 0, m->until_ns);
    CHECK(m->drive[0].failures == 0 && m->drive[1].failures == 0 && m->round_trip_ns == 0);
}

/* The first replies decide whether the adapter receives itself. Silence decides nothing, and an
 * incomplete exchange gives no round trip. */
static void silence_decides_no_echo_and_measures_no_round_trip(void)
{
    for (uint32_t silent = 1; silent < 4; silent++) {
        group_goes_out(2, ECHO_NONE);
        s.machine.echo = ECHO_UNKNOWN;
        uint8_t bytes[32];
        uint32_t count = silent == 1   ? put_reply(bytes, 0, 1)
                         : silent == 2 ? put_reply(bytes, 0, 0)
                                       : 0;
        come(bytes, count, m->end_ns + SERVO_MS / 10);
        come(bytes, 0, m->until_ns);
        CHECK(m->echo == (silent == 3 ? ECHO_UNKNOWN : ECHO_NONE) && (silent == 3 || s.out.notify));
        CHECK(m->round_trip_ns == 0);
    }
    group_goes_out(1, ECHO_NONE);
    uint8_t bytes[32];
    come(bytes, put_reply(bytes, 0, 0), m->end_ns + SERVO_MS);
    CHECK(m->round_trip_ns == m->end_ns + SERVO_MS - m->start_ns);
}

/* When no drive is understood any more, another adapter may be plugged in. */
static void a_line_on_which_all_reads_fail_decides_its_echo_again(void)
{
    for (uint32_t silent = 1; silent < 3; silent++) {
        group_goes_out(2, ECHO_UNKNOWN);
        CHECK(m->echo == ECHO_NONE);
        s.silent = silent;
        for (int64_t end_ns = s.now_ns + 400 * SERVO_MS; s.now_ns < end_ns;) {
            servos_step(1.0, 1);
            CHECK(m->echo == ECHO_NONE);
        }
    }
    s.silent = 3;
    for (int ms = 0; ms < 2000 && (m->drive[0].failures < 3 || m->drive[1].failures < 3); ms++) {
        CHECK(m->echo == ECHO_NONE);
        servos_go_on(1.0, SERVO_MS);
    }
    CHECK(m->echo == ECHO_UNKNOWN);
}

static void after_an_exchange_the_line_is_silent_for_a_gap(void)
{
    group_goes_out(1, ECHO_NONE);
    s.machine.table.gap_ns = 5 * SERVO_MS; /* longer than the wait so far */
    uint8_t bytes[32];
    int64_t now_ns = m->end_ns + SERVO_MS;
    come(bytes, put_reply(bytes, 0, 0), now_ns);
    CHECK(m->ours_ns == now_ns + 5 * SERVO_MS);
    group_goes_out(1, ECHO_NONE);
    int64_t ours_ns = s.machine.ours_ns = m->end_ns + 900 * SERVO_MS;
    come(bytes, put_reply(bytes, 0, 0), m->end_ns + SERVO_MS);
    CHECK(m->ours_ns == ours_ns);
}

int main(void)
{
    noise_before_between_and_after_replies_is_counted_and_costs_no_reply();
    a_late_reply_after_a_due_one_is_not_noise();
    a_reply_that_takes_longer_than_usual_is_not_read();
    replies_that_come_at_once_are_stamped_one_reply_apart();
    bytes_beyond_the_buffer_end_the_exchange();
    set_points_without_a_reply_take_their_time();
    silence_decides_no_echo_and_measures_no_round_trip();
    a_line_on_which_all_reads_fail_decides_its_echo_again();
    after_an_exchange_the_line_is_silent_for_a_gap();
    return checks_report("test_line_group_bytes");
}
