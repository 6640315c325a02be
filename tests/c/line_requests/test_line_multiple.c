/* SPDX-License-Identifier: Apache-2.0
 * Function 16 is acknowledged without its values: a late acknowledgement proves nothing about
 * another value. */
#include "line_wire.h"

enum { MULTIPLE = 16, ARM = 8 };

static line_frame multiple(uint8_t address, uint8_t value)
{
    line_frame frame = {.request_bytes = 11,
                        .reply_bytes = 8,
                        .echo_bytes = 6,
                        .request_seal = SEAL_CRC16,
                        .reply_seal = SEAL_CRC16,
                        .has_exceptions = 1,
                        .request = {1, MULTIPLE, 0, address, 0, 1, 2, 0, value}};
    rtu_seal(frame.request, 11, SEAL_CRC16);
    return frame;
}

/* Looks until the next request is sent. */
static void send_next(void)
{
    line_machine *m = &w.machine;
    line_machine_step(m, w.now_ns, NULL, 0, &w.out);
    for (uint32_t i = 0; i < 50 && w.out.send == NULL; i++) {
        w.now_ns = w.out.wake_ns > w.now_ns ? w.out.wake_ns : w.now_ns + MS;
        line_machine_step(m, w.now_ns, NULL, 0, &w.out);
    }
    CHECK(w.out.send != NULL);
    line_machine_sent(m, w.now_ns);
}

/* Sends a request that gets no reply in time. */
static void request_without_reply(const line_frame *frame)
{
    line_request one = {
        .id = 1, .expires_ns = w.now_ns + 1000 * MS, .turnaround_ns = 5 * MS, .frame = *frame};
    CHECK(line_machine_request(&w.machine, &one));
    send_next();
    CHECK(memcmp(w.out.send, frame->request, frame->request_bytes) == 0);
    w.now_ns = w.machine.until_ns;
    line_machine_step(&w.machine, w.now_ns, NULL, 0, &w.out);
}

static void acknowledge(uint8_t address)
{
    uint8_t reply[8] = {1, MULTIPLE, 0, address, 0, 1};
    rtu_seal(reply, 8, SEAL_CRC16);
    w.now_ns = w.machine.end_ns + 3 * MS;
    line_machine_step(&w.machine, w.now_ns, reply, 8, &w.out);
}

static void begin_multiple(void)
{
    begin_with(1, 0);
    w.table.drive[0].disarm[0] = multiple(CONTROL, DISABLE);
    w.table.drive[0].disarm_count = 1;
    CHECK(line_machine_init(&w.machine, &w.table, 0, w.now_ns) == 0);
}

static void a_late_acknowledgement_of_one_value_is_not_taken_for_that_of_another(void)
{
    begin_multiple();
    line_frame armed = multiple(CONTROL, ARM);
    request_without_reply(&armed);
    line_begin_stop(&w.machine, 0, drive_power_off(&w.machine.drive[0].state), w.now_ns);
    send_next(); /* sent, and lost */
    acknowledge(CONTROL);
    CHECK(w.machine.drive[0].state.stop == STOP_POWER_OFF && w.machine.drive[0].stop_done == 0);
    send_next(); /* the second acknowledgement is the stop's own */
    acknowledge(CONTROL);
    line_machine_step(&w.machine, w.out.wake_ns, NULL, 0, &w.out);
    CHECK(w.machine.drive[0].state.stop == STOP_NOTHING);
}

/* The acknowledgement of another register has other bytes. */
static void an_acknowledgement_of_another_register_is_certain(void)
{
    begin_multiple();
    line_frame other = multiple(RELEASE, ARM);
    request_without_reply(&other);
    line_begin_stop(&w.machine, 0, drive_power_off(&w.machine.drive[0].state), w.now_ns);
    send_next();
    acknowledge(CONTROL);
    line_machine_step(&w.machine, w.out.wake_ns, NULL, 0, &w.out);
    CHECK(w.machine.drive[0].state.stop == STOP_NOTHING);
}

/* The echo of function 6 contains the value. But between two equal writes a third one may have
 * changed the register. */
static void equal_echoes_are_interchangeable_without_a_write_between_them(void)
{
    for (int between = 0; between < 2; between++) {
        begin_multiple();
        line_frame single = frame_of(1, WRITE, CONTROL, DISABLE), several = multiple(CONTROL, ARM);
        request_without_reply(&single);
        if (between) {
            request_without_reply(&several);
        }
        CHECK(line_may_be_late(&w.machine, 0, &single, w.now_ns) == (between != 0));
    }
}

int main(void)
{
    a_late_acknowledgement_of_one_value_is_not_taken_for_that_of_another();
    an_acknowledgement_of_another_register_is_certain();
    equal_echoes_are_interchangeable_without_a_write_between_them();
    return checks_report("line multiple");
}
