/* SPDX-License-Identifier: Apache-2.0
 * test_line_exchange: one request on a serial line, exact to the nanosecond: how long the line
 * waits, and the result. */
#include "line_wire.h"

static const int64_t SENT_NS = 8 * CHARACTER_NS, HOST_NS = 20 * MS;

static line_machine *const m = &w.machine;

static line_frame read_frame(uint8_t unit)
{
    return frame_of(unit, READ, STATUS, 1);
}

static line_request line_request_of(uint32_t drive, line_frame frame)
{
    return (line_request){
        .id = 77, .expires_ns = INT64_MAX, .turnaround_ns = 5 * MS, .drive = drive, .frame = frame};
}

static void look(const uint8_t *bytes, uint32_t count)
{
    line_machine_step(m, w.now_ns, bytes, count, &w.out);
}

/* This look sends the request. */
static void send(void)
{
    w.now_ns = m->free_ns > w.now_ns ? m->free_ns : w.now_ns;
    look(NULL, 0);
    CHECK(w.out.send == m->transaction.frame.request &&
          w.out.send_bytes == m->transaction.frame.request_bytes && !m->sent);
    line_machine_sent(m, w.now_ns);
}

static void send_request(uint32_t drive, line_frame frame)
{
    line_request request = line_request_of(drive, frame);
    CHECK(line_machine_request(m, &request));
    send();
    CHECK(m->work == WORK_REQUEST && m->worker == drive);
}

static uint32_t reply_of(const line_frame *frame, uint8_t *reply)
{
    if (frame->echo_bytes > 0) {
        memcpy(reply, frame->request, 8);
        return 8;
    }
    memcpy(reply, (const uint8_t[]){frame->match[0], READ, 2, 0, 9}, 5);
    rtu_seal(reply, 7, SEAL_CRC16);
    return 7;
}

/* Bytes arrive `after_ns` after the last byte of the request. */
static void receive_after(int64_t after_ns, const uint8_t *bytes, uint32_t count)
{
    w.now_ns = m->end_ns + after_ns;
    look(bytes, count);
}

static void answer(void)
{
    uint8_t reply[8];
    uint32_t bytes = reply_of(&m->transaction.frame, reply);
    receive_after(DEVICE_NS + bytes * CHARACTER_NS, reply, bytes);
}

static void fail(void)
{
    w.now_ns = m->until_ns;
    look(NULL, 0);
}

/* ----------------------------------------------------------------- the wait for a reply */
static void the_wait_for_a_reply_includes_the_time_of_the_request_s_bytes(void)
{
    begin_with(2, 0);
    m->urgent_by_ns = 5;
    send_request(0, read_frame(1));
    CHECK(m->urgent_by_ns == 0 && m->sent && m->exchanges == 1 && m->start_ns == w.now_ns &&
          m->end_ns == w.now_ns + SENT_NS);
    CHECK(m->bound_ns == 5 * MS + HOST_NS &&
          m->until_ns == m->end_ns + m->bound_ns + line_reply_ns(m, &m->transaction.frame));
    CHECK(m->ours_ns == m->end_ns + GAP_NS && m->free_ns == m->ours_ns);
    int64_t until_ns = m->until_ns;
    w.now_ns = until_ns - 1;
    look(NULL, 0);
    CHECK(m->work == WORK_REQUEST && !m->answered && w.out.wake_ns == until_ns);
    fail();
    CHECK(m->work == WORK_NONE && m->worker == LINE_DRIVES_MAX && m->answered &&
          m->answer.kind == ANSWER_NO_REPLY);
    line_request next = line_request_of(1, read_frame(2));
    CHECK(line_machine_request(m, &next));
    w.now_ns = m->free_ns;
    look(NULL, 0);
    CHECK(w.out.send != NULL && !m->sent); /* until the thread reports that it was sent */
}

static int64_t bound_of(uint32_t work, uint32_t worker)
{
    m->work = work;
    m->worker = worker;
    m->transaction.frame = read_frame(1);
    line_machine_sent(m, w.now_ns);
    return m->bound_ns;
}

static void each_kind_of_request_has_the_wait_of_its_drive(void)
{
    begin_with(2, 0);
    m->table.drive[0].turnaround_ns = 9 * MS + HOST_NS;
    m->drive[0].deadline_ns = 7 * MS, m->drive[1].deadline_ns = 6 * MS;
    m->table.drive[2].turnaround_ns = 99 * MS; /* beyond the count of drives */
    m->transaction.request_turnaround_ns = 3 * MS;
    CHECK(bound_of(WORK_CYCLE, 0) == 7 * MS && bound_of(WORK_CYCLE, 1) == 6 * MS);
    CHECK(bound_of(WORK_STOP, 0) == 9 * MS + HOST_NS && bound_of(WORK_STOP, 1) == 5 * MS + HOST_NS);
    CHECK(bound_of(WORK_REQUEST, 0) == 3 * MS + HOST_NS);
    /* no drive answers: the slowest one needs time to receive it */
    CHECK(bound_of(WORK_BROADCAST, LINE_DRIVES_MAX) == 9 * MS);
    CHECK(bound_of(WORK_BROADCAST, 2) == 9 * MS);
    m->table.drive[1].turnaround_ns = 11 * MS + HOST_NS;
    CHECK(bound_of(WORK_BROADCAST, LINE_DRIVES_MAX) == 11 * MS);
    m->table.drive[0].reply_timeout_ns = 1;
    CHECK(bound_of(WORK_CYCLE, 0) == 1 && bound_of(WORK_STOP, 0) == 1 &&
          bound_of(WORK_STOP, 1) == 11 * MS + HOST_NS);
    begin_with(LINE_DRIVES_MAX, 0);
    CHECK(bound_of(WORK_BROADCAST, LINE_DRIVES_MAX) == 5 * MS);
}

/* If another drive has to be stopped, the line does not wait as long as a reply may take. */
static void a_wait_is_short_while_another_drive_has_to_be_stopped(void)
{
    for (uint32_t waiting = 0; waiting < 5; waiting++) {
        begin_with(3, 0);
        m->drive[1].smoothed_ns = 12 * MS; /* the usual turn-around is half a ms more */
        send_request(1, read_frame(2));
        int64_t long_ns = m->until_ns,
                short_ns = m->end_ns + 12 * MS + MS / 2 + line_reply_ns(m, &m->transaction.frame);
        CHECK(short_ns < long_ns);
        m->drive[waiting].state.stop = waiting < 3 ? STOP_QUICK : STOP_NOTHING;
        m->drive[3].state.stop = STOP_QUICK; /* beyond the count of drives */
        m->control.shut_down = waiting == 4;
        w.now_ns++;
        look(NULL, 0);
        CHECK(m->until_ns == (waiting == 1 || waiting == 3 ? long_ns : short_ns));
    }
    begin_with(2, 0);
    send_request(1, read_frame(2));
    w.now_ns = m->until_ns - 5;
    m->drive[1].smoothed_ns = 10 * MS;
    m->drive[0].state.stop = STOP_QUICK;
    look(NULL, 0);
    /* the next look ends the wait */
    CHECK(m->until_ns == w.now_ns + 1 && m->work == WORK_REQUEST);
    begin_with(2, 0);
    m->drive[0].state.stop = m->drive[1].state.stop = STOP_POWER_OFF;
    m->until_ns = 77;
    w.now_ns = m->free_ns;
    look(NULL, 0);
    CHECK(w.out.send != NULL && m->work == WORK_STOP);
    look(NULL, 0);
    CHECK(m->until_ns == 77); /* the request has not been sent yet */
}

/* Entries beyond the drives are neither read nor changed. */
static void an_answer_to_a_broadcast_counts(void)
{
    static line_joint_state before[JOINTS_MAX];
    begin_with(LINE_DRIVES_MAX, 0);
    memset(m->joint, 0x7F, sizeof m->joint);
    memcpy(before, m->joint, sizeof before);
    send_request(LINE_DRIVES_MAX, read_frame(9));
    answer();
    CHECK(m->answered && m->answer.kind == ANSWER_OK &&
          memcmp(before, m->joint, sizeof before) == 0);
}

static void a_broadcast_has_its_own_wait(void)
{
    begin_with(LINE_DRIVES_MAX, 0);
    send_request(LINE_DRIVES_MAX, read_frame(9));
    int64_t until_ns = m->until_ns;
    m->drive[0].state.stop = STOP_QUICK;
    w.now_ns++;
    look(NULL, 0);
    CHECK(m->until_ns == until_ns);
    fail();
    CHECK(m->answered && m->answer.kind == ANSWER_NO_REPLY && m->work == WORK_STOP);
}

/* ------------------------------------------------------------------------------ results */
static void only_the_answer_is_handed_on_with_its_time(void)
{
    uint8_t bytes[10] = {0x55, 0x66};
    begin_with(1, 0);
    send_request(0, read_frame(1));
    uint32_t count = reply_of(&m->transaction.frame, bytes + 2);
    int64_t sent_ns = w.now_ns;
    receive_after(3 * MS, bytes, count + 2);
    CHECK(m->answered && m->answer.id == 77 && m->answer.kind == ANSWER_OK &&
          m->answer.sent_ns == sent_ns);
    CHECK(m->answer.done_ns == w.now_ns &&
          m->answer.stamp_ns == sent_ns + (w.now_ns - sent_ns) / 2);
    CHECK(m->answer.reply_bytes == 7 && memcmp(m->answer.reply, bytes + 2, 7) == 0 &&
          m->answer.echoed == 0);
    CHECK(m->answers == 1 && m->noise_bytes == 2 && m->round_trip_ns == w.now_ns - sent_ns);
    CHECK(m->ours_ns == w.now_ns + GAP_NS && m->work == WORK_NONE && m->worker == LINE_DRIVES_MAX);
    CHECK(w.out.answered && w.out.notify && w.out.wake_ns == w.now_ns);
    w.now_ns++;
    look(NULL, 0);
    CHECK(!m->answered && m->round_trip_ns == 0 && !w.out.answered);
}

static void a_refusal_is_handed_on_with_its_number(void)
{
    uint8_t refusal[5] = {1, READ | 0x80, 4};
    rtu_seal(refusal, 5, SEAL_CRC16);
    begin_with(1, 0);
    send_request(0, read_frame(1));
    receive_after(2 * MS, refusal, 5);
    CHECK(m->answered && m->answer.kind == ANSWER_REFUSED && m->answer.exception == 4 &&
          m->answer.reply_bytes == 0);
    CHECK(m->answers == 1 && m->noise_bytes == 0 && m->round_trip_ns == 0);
}

static void bytes_that_are_no_answer_are_counted_once(void)
{
    begin_with(1, 0);
    send_request(0, read_frame(1));
    receive_after(MS, (const uint8_t[]){7, 8, 9}, 3);
    CHECK(!m->answered && m->noise_bytes == 0);
    fail();
    CHECK(m->answered && m->answer.kind == ANSWER_BAD_REPLY && m->noise_bytes == 3 &&
          m->answers == 0);
    CHECK(m->drive[0].count.bad_reply == 1 && m->drive[0].count.no_reply == 0);
    CHECK(m->ours_ns == w.now_ns + GAP_NS);
}

/* The whole answer of a controller that sends no unit may be one byte. After a failure no drive is
 * read until such a late answer must have arrived. */
static void an_answer_may_be_one_byte_long(void)
{
    line_frame frame = read_frame(1);
    frame.exact = 1, frame.reply_bytes = frame.match_bytes = 1, frame.reply_seal = SEAL_NONE,
    frame.match[0] = 0xFF;
    begin_with(1, 0);
    m->echo = ECHO_NONE;
    send_request(0, frame);
    receive_after(MS, (const uint8_t[]){0xFF}, 1);
    CHECK(m->answered && m->answer.kind == ANSWER_OK && m->answers == 1 && m->round_trip_ns > 0);
    send_request(0, frame);
    fail();
    CHECK(m->ours_ns == w.now_ns + m->bound_ns && m->free_ns == m->ours_ns);
    begin_with(1, 0);
    send_request(0, read_frame(1));
    fail();
    CHECK(m->ours_ns == w.now_ns + GAP_NS && m->free_ns < w.now_ns);
}

static void a_broadcast_ends_in_silence(void)
{
    begin_with(LINE_DRIVES_MAX, 0);
    line_frame frame = {.request_bytes = 8,
                        .request_seal = SEAL_CRC16,
                        .request = {0, WRITE, 0, CONTROL, 0, QUICK_STOP}};
    rtu_seal(frame.request, 8, SEAL_CRC16);
    m->table.broadcast_stop_count = 2;
    m->table.broadcast_stop[0] = m->table.broadcast_stop[1] = frame;
    m->table.broadcast_stop[1].request[5] = DISABLE;
    m->broadcasts = 2;
    m->drive[0].state.mode = DRIVE_READY; /* its cycle is due, and waits */
    send();
    m->drive[0].state.mode = DRIVE_OFF;
    CHECK(m->work == WORK_BROADCAST && m->broadcasts == 2 &&
          m->transaction.frame.request[5] == QUICK_STOP);
    fail(); /* no drive answers, and the next one is sent */
    CHECK(w.out.send != NULL && m->work == WORK_BROADCAST && m->broadcasts == 1 &&
          m->transaction.frame.request[5] == DISABLE);
    line_machine_sent(m, w.now_ns);
    fail();
    CHECK(w.out.send == NULL && m->work == WORK_NONE && m->broadcasts == 0 && m->answers == 0 &&
          m->round_trip_ns == 0);
}

/* ----------------------------------------------------------------------------- the echo */
static void the_first_read_finds_out_whether_the_adapter_receives_itself(void)
{
    uint8_t bytes[16];
    for (uint32_t echoes = 0; echoes < 2; echoes++) {
        begin_with(1, ECHO_UNKNOWN);
        send_request(0, frame_of(1, WRITE, CONTROL, 1)); /* its answer equals the request */
        answer();
        CHECK(m->echo == ECHO_UNKNOWN && m->answer.kind == ANSWER_OK);
        send_request(0, read_frame(1));
        memcpy(bytes, m->transaction.frame.request, 8);
        uint32_t from = echoes != 0 ? 0 : 8, count = 8 + reply_of(&m->transaction.frame, bytes + 8);
        m->notify = false;
        receive_after(2 * MS, bytes + from, count - from);
        CHECK(m->echo == (echoes != 0 ? (uint32_t)ECHO_FIRST : (uint32_t)ECHO_NONE) && m->notify);
        CHECK(m->answer.kind == ANSWER_OK && m->answer.echoed == echoes && m->noise_bytes == 0);
        CHECK(memcmp(m->answer.reply, bytes + 8, 7) == 0);
        send_request(0, read_frame(1));
        receive_after(2 * MS, bytes + from, count - from);
        CHECK(!m->notify && m->answer.kind == ANSWER_OK);
    }
}

/* Another adapter may be plugged in, so the line has to find out again whether it receives
 * itself. */
static void when_no_reply_is_understood_the_echo_is_unknown_again(void)
{
    for (uint32_t first = 2; first <= 3; first++) {
        for (uint32_t second = 2; second <= 3; second++) {
            begin_with(2, ECHO_UNKNOWN);
            m->echo = ECHO_FIRST;
            m->drive[0].failures = first, m->drive[1].failures = second - 1;
            m->drive[2].failures = 0; /* there is no third drive */
            m->table.drive[2].tries = 3;
            send_request(1, read_frame(2));
            fail();
            CHECK(m->drive[1].failures == second);
            CHECK(m->echo ==
                  (first == 3 && second == 3 ? (uint32_t)ECHO_UNKNOWN : (uint32_t)ECHO_FIRST));
        }
    }
}

/* The echo of a probe to an unresponsive drive is no answer. */
static void an_echo_does_not_bring_back_an_unresponsive_drive(void)
{
    /* cases of what can be read: an exchange, one extra range, two, nothing */
    for (uint32_t reads = 0; reads < 4; reads++) {
        begin_with(1, ECHO_UNKNOWN);
        line_drive *table = &m->table.drive[0];
        table->probe = reads == 0 ? 1 : 0;
        table->extra_count = reads == 1 || reads == 2 ? reads : 0;
        table->extra[0].frame = table->extra[1].frame = table->cyclic[0].frame;
        m->drive[0].state.mode = DRIVE_UNRESPONSIVE;
        send();
        CHECK(m->work == WORK_PROBE && m->transaction.frame.echo_bytes == 6);
        uint8_t echo[8];
        memcpy(echo, m->transaction.frame.request, 8);
        receive_after(MS, echo, 8);
        CHECK((m->drive[0].state.mode == DRIVE_UNRESPONSIVE && m->work == WORK_PROBE) ==
              (reads < 3));
    }
}

static void continuous_noise_ends_the_wait(void)
{
    /* an answer to a write may be one byte longer than one to a read */
    static uint8_t noise[RECEIVED_BYTES_MAX + 1];
    memset(noise, 0x55, RECEIVED_BYTES_MAX);
    begin_with(1, 0);
    send_request(0, read_frame(1));
    receive_after(MS, noise, RECEIVED_BYTES_MAX - 3);
    CHECK(m->work == WORK_REQUEST);
    receive_after(MS, noise, 2);
    CHECK(m->work == WORK_REQUEST && !m->answered);
    receive_after(MS, noise, 1);
    CHECK(m->answered && m->answer.kind == ANSWER_BAD_REPLY &&
          m->noise_bytes == RECEIVED_BYTES_MAX);
    begin_with(1, 0);
    send_request(0, read_frame(1));
    (void)reply_of(&m->transaction.frame, noise + RECEIVED_BYTES_MAX - 7);
    receive_after(MS, noise, RECEIVED_BYTES_MAX); /* the answer just fits */
    CHECK(m->answered && m->answer.kind == ANSWER_OK && m->noise_bytes == RECEIVED_BYTES_MAX - 7);
}

static void bytes_during_a_broadcast_are_noise_except_an_echo(void)
{
    for (uint32_t echo = ECHO_NONE; echo <= ECHO_UNKNOWN; echo++) {
        line_frame frame = frame_of(0, WRITE, CONTROL, QUICK_STOP);
        frame.reply_bytes = frame.echo_bytes = 0, frame.reply_seal = SEAL_NONE;
        begin_with(1, echo);
        send_request(0, frame);
        receive_after(MS, frame.request, 8);
        CHECK(m->work == WORK_REQUEST && m->noise_bytes == (echo == ECHO_NONE ? 8 : 0));
        w.now_ns = m->until_ns - 1;
        look(NULL, 0);
        CHECK(m->work == WORK_REQUEST);
        w.now_ns++;
        look(NULL, 0);
        CHECK(m->answered && m->answer.kind == ANSWER_OK && m->answer.reply_bytes == 0 &&
              m->round_trip_ns == 0);
    }
}

static void unrequested_bytes_keep_the_line_busy(void)
{
    begin_with(1, 0);
    w.now_ns += 100 * MS;
    look((const uint8_t[]){1, 2}, 2);
    CHECK(m->noise_bytes == 2 && m->free_ns == w.now_ns + GAP_NS);
    int64_t free_ns = m->free_ns;
    w.now_ns++;
    look(NULL, 0);
    CHECK(m->free_ns == free_ns);
}

int main(void)
{
    the_wait_for_a_reply_includes_the_time_of_the_request_s_bytes();
    each_kind_of_request_has_the_wait_of_its_drive();
    a_wait_is_short_while_another_drive_has_to_be_stopped();
    a_broadcast_has_its_own_wait();
    an_answer_to_a_broadcast_counts();
    only_the_answer_is_handed_on_with_its_time();
    a_refusal_is_handed_on_with_its_number();
    bytes_that_are_no_answer_are_counted_once();
    an_answer_may_be_one_byte_long();
    a_broadcast_ends_in_silence();
    the_first_read_finds_out_whether_the_adapter_receives_itself();
    when_no_reply_is_understood_the_echo_is_unknown_again();
    an_echo_does_not_bring_back_an_unresponsive_drive();
    continuous_noise_ends_the_wait();
    bytes_during_a_broadcast_are_noise_except_an_echo();
    unrequested_bytes_keep_the_line_busy();
    return checks_report("line exchange");
}
