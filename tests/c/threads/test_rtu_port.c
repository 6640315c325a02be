/* SPDX-License-Identifier: Apache-2.0
 * The thread of a serial line on a port with a direction pin, and on one that takes little, is full
 * or fails. */
#include <errno.h>
#include <linux/gpio.h>
#include <stdarg.h>
#include <sys/ioctl.h>
#include <sys/syscall.h>

#include "line_wire.h"
#include "thread_sides.h"

#ifndef TIOCSER_TEMT
#define TIOCSER_TEMT 0x01
#endif

enum { PIN_FD = 9997, EVENTS_MAX = 4096, REQUEST_BYTES = 8 };
enum { WROTE = 0, PIN_LOW = 1, PIN_HIGH = 2, ASKED_SENT = 3 };

static const int64_t LONG_NS = INT64_C(100000000000), BEFORE_NS = 2000000, AFTER_NS = 3000000;

typedef struct {
    int what;
    uint32_t bytes;
    int64_t from_ns, to_ns; /* the call was made between */
} port_event;

static struct {
    _Atomic uint32_t takes; /* bytes of one write; 0: it is full */
    _Atomic int fails_once, fails;
    _Atomic int pin_fails;       /* errno of the writes of the pin ... */
    _Atomic uint32_t pin_spares; /* ... after so many that succeed */
    _Atomic int unsent_looks;    /* so often the transmitter is not empty yet; < 0: always */
    _Atomic bool no_register;    /* the driver does not report its transmitter */
    _Atomic bool answers;        /* a drive is there, and answers each whole request at once */
    _Atomic int16_t speed;       /* in the newest request that sets it */
    uint8_t first[REQUEST_BYTES];
    _Atomic uint32_t count;
    port_event event[EVENTS_MAX];
} port;

static void note(int what, uint32_t bytes, int64_t from_ns)
{
    uint32_t at = port.count;
    CHECK(at < EVENTS_MAX);
    port.event[at] = (port_event){what, bytes, from_ns, clock_now_ns()};
    port.count = at + 1;
}

static void answer_as_the_drive(const uint8_t *request)
{
    uint8_t reply[REQUEST_BYTES];
    memcpy(reply, request, sizeof reply);
    size_t count = sizeof reply;
    if (request[1] == READ) {
        memcpy(reply, (const uint8_t[]){request[0], READ, 2, 0, 0}, 5);
        count = 7;
        rtu_seal(reply, 7, SEAL_CRC16);
    } else if (request[3] == SPEED) {
        port.speed = (int16_t)rtu_read(request + 4, FORM_I16);
    }
    CHECK(syscall(SYS_write, ends[1], reply, count) == (long)count);
}

static int failed(int error)
{
    errno = error;
    return error != 0 ? -1 : 0;
}

/* Replaces the C library's function, for the port. */
ssize_t write(int fd, const void *bytes, size_t count)
{
    if (fd != ends[0]) {
        return syscall(SYS_write, fd, bytes, count);
    }
    int64_t from_ns = clock_now_ns();
    int error = atomic_exchange(&port.fails_once, 0);
    error = error != 0 ? error : port.fails;
    error = error == 0 && port.takes == 0 ? EAGAIN : error;
    if (error != 0) {
        return failed(error);
    }
    size_t went = count < port.takes ? count : port.takes;
    if (port.count == 0 && went == REQUEST_BYTES) {
        memcpy(port.first, bytes, went);
    }
    note(WROTE, (uint32_t)went, from_ns);
    if (port.answers) {
        CHECK(went == REQUEST_BYTES);
        answer_as_the_drive(bytes);
    }
    return (ssize_t)went;
}

/* Replaces the C library's function: the pin, and the port's transmitter. */
int ioctl(int fd, unsigned long request, ...)
{
    int64_t from_ns = clock_now_ns();
    va_list more;
    va_start(more, request);
    void *argument = va_arg(more, void *);
    va_end(more);
    if (fd == PIN_FD && request == GPIO_V2_LINE_SET_VALUES_IOCTL) {
        const struct gpio_v2_line_values *values = argument;
        CHECK(values->mask == 1);
        if (port.pin_fails != 0 && port.pin_spares == 0) {
            return failed(port.pin_fails);
        }
        port.pin_spares -= port.pin_spares > 0;
        note((values->bits & 1) != 0 ? PIN_HIGH : PIN_LOW, 0, from_ns);
        return 0;
    }
    if (fd == ends[0] && request == TIOCSERGETLSR && !port.no_register) {
        note(ASKED_SENT, 0, from_ns);
        *(int *)argument = port.unsent_looks == 0 ? TIOCSER_TEMT : 0;
        port.unsent_looks -= port.unsent_looks > 0;
        return 0;
    }
    return failed(ENOTTY);
}

static line_report report(void)
{
    line_report out;
    CHECK(line_read_report(0, &out) == 0);
    return out;
}

static uint32_t left_running;

static void begin_thread(int pin_fd, uint32_t active_high)
{
    memset(&port, 0, sizeof port);
    port.takes = FRAME_BYTES_MAX;
    begin_with(1, 0);
    w.table.setpoint_timeout_ns = w.table.drive[0].period_ns = LONG_NS;
    w.table.drive[0].watchdog_ns = 0;
    exchange_init(&shared);
    CHECK(socketpair(AF_UNIX, SOCK_STREAM | SOCK_NONBLOCK, 0, ends) == 0);
    line_config config = {.at = place_of_the_thread(),
                          .de_before_ns = BEFORE_NS,
                          .de_after_ns = AFTER_NS,
                          .de_fd = pin_fd,
                          .de_active_high = active_high,
                          .left_running = left_running};
    CHECK(line_start(LINES_MAX, &config, &w.table) == -EINVAL);
    CHECK(line_start(0, &config, &w.table) == 0);
}

static void end_thread(void)
{
    CHECK(line_stop(0) == 0);
    CHECK(close(ends[0]) == 0 && close(ends[1]) == 0);
}

static line_request one_request(void)
{
    return (line_request){.id = 7,
                          .expires_ns = INT64_MAX,
                          .turnaround_ns = 5 * MS,
                          .drive = LINE_DRIVES_MAX,
                          .frame = frame_of(1, READ, STATUS, 1)};
}

/* Sends a request that no drive answers. */
static void send_one(void)
{
    const line_request request = one_request();
    line_answer answer;
    CHECK(line_put_request(0, &request) == 0);
    WAIT_UNTIL(line_take_answer(0, &answer) != 0 || report().life.running == 0);
}

static uint32_t find(int what, uint32_t from)
{
    while (from < port.count && port.event[from].what != what) {
        from++;
    }
    CHECK(from < port.count);
    return from;
}

static uint32_t count_of(int what)
{
    uint32_t count = 0;
    for (uint32_t i = 0; i < port.count; i++) {
        count += port.event[i].what == what;
    }
    return count;
}

/* ------------------------------------------------------------------------------- the pin */
static void the_pin_turns_before_the_first_bit_and_back_after_the_last(void)
{
    for (uint32_t active_high = 0; active_high < 2; active_high++) {
        const int talk = active_high != 0 ? PIN_HIGH : PIN_LOW;
        const int rest = active_high != 0 ? PIN_LOW : PIN_HIGH;
        begin_thread(PIN_FD, active_high);
        port.unsent_looks = 3;
        send_one();
        uint32_t out = find(talk, 0), wrote = find(WROTE, out), back = find(rest, wrote);
        CHECK(out == 0 && wrote == 1 && port.event[wrote].bytes == REQUEST_BYTES);
        CHECK(port.event[wrote].to_ns - port.event[out].from_ns >= BEFORE_NS);
        /* three looks in vain and a good one, unless the time for them is over */
        uint32_t looks = count_of(ASKED_SENT);
        CHECK(back == wrote + 1 + looks);
        CHECK(looks == 4 || (looks < 4 && port.event[back].to_ns - port.event[wrote].from_ns >=
                                              REQUEST_BYTES * CHARACTER_NS + 2 * MS + AFTER_NS));
        CHECK(port.event[wrote + 1].to_ns - port.event[wrote].from_ns >=
              REQUEST_BYTES * CHARACTER_NS);
        CHECK(port.event[back].to_ns - port.event[back - 1].from_ns >= AFTER_NS);
        CHECK(port.count == back + 1);
        end_thread();
        CHECK(port.event[port.count - 1].what == rest && port.count == back + 2);
    }
}

static void a_transmitter_that_is_never_empty_holds_the_pin_for_a_limited_time(void)
{
    begin_thread(PIN_FD, 1);
    port.unsent_looks = -1;
    send_one();
    uint32_t back = find(PIN_LOW, 0);
    CHECK(port.event[back].to_ns - port.event[find(WROTE, 0)].from_ns >=
          REQUEST_BYTES * CHARACTER_NS + 2 * MS + AFTER_NS);
    end_thread();
}

static void a_port_that_does_not_report_its_transmitter_is_waited_for_by_the_length(void)
{
    begin_thread(PIN_FD, 1);
    port.no_register = true;
    send_one();
    CHECK(count_of(ASKED_SENT) == 0);
    CHECK(port.event[find(PIN_LOW, 0)].to_ns - port.event[find(WROTE, 0)].from_ns >=
          REQUEST_BYTES * CHARACTER_NS + AFTER_NS);
    end_thread();
}

static void without_a_pin_the_port_is_not_asked_and_nothing_waits(void)
{
    begin_thread(-1, 0);
    send_one();
    CHECK(port.count == 1 && port.event[0].what == WROTE);
    end_thread();
    CHECK(port.count == 1);
}

static void a_pin_that_cannot_be_turned_ends_the_thread(void)
{
    for (uint32_t spared = 0; spared < 2; spared++) {
        begin_thread(PIN_FD, 1);
        port.pin_fails = ENXIO;
        port.pin_spares = spared;
        send_one();
        WAIT_UNTIL(report().life.running == 0);
        CHECK(report().life.error == ENXIO);
        CHECK(count_of(WROTE) == spared); /* a transceiver that listens is not sent to */
        end_thread();
    }
}

/* ------------------------------------------------------------------------------ the port */
static void a_request_that_the_port_takes_in_pieces_is_sent_whole(void)
{
    begin_thread(-1, 0);
    port.takes = 3;
    port.fails_once = EINTR;
    send_one();
    CHECK(port.count == 3 && port.event[0].bytes == 3 && port.event[1].bytes == 3 &&
          port.event[2].bytes == 2);
    CHECK(report().life.running != 0);
    port.fails_once = EAGAIN; /* the kernel then shows that it has room */
    send_one();
    CHECK(port.count == 6 && report().life.running != 0);
    port.fails = ENODEV;
    send_one();
    WAIT_UNTIL(report().life.running == 0);
    CHECK(report().life.error == ENODEV);
    end_thread();
}

static void a_port_that_stays_full_counts_as_lost(void)
{
    begin_thread(-1, 0);
    const uint8_t bytes[4096] = {0};
    while (syscall(SYS_write, ends[0], bytes, sizeof bytes) > 0) {
    }
    port.takes = 0;
    send_one();
    WAIT_UNTIL(report().life.running == 0);
    CHECK(report().life.error == EIO);
    end_thread();
}

static void put(double velocity_rad_s)
{
    const uint64_t one = 1;
    setpoints newest = {.stamp_ns = clock_now_ns(), .enabled = 1, .joint_count = 1};
    newest.joint[0].velocity_rad_s = velocity_rad_s;
    CHECK(exchange_put_setpoints(&shared, 0, &newest) == 0);
    CHECK(write(exchange_line_wake(&shared, 0), &one, sizeof one) == sizeof one);
}

static void a_new_command_does_not_wait_for_the_cycle_and_the_thread_sleeps_again(void)
{
    begin_thread(-1, 0);
    port.answers = true;
    line_control control = {.drive[0] = {.count = 1, .mode = DRIVE_READY}};
    WAIT_UNTIL(exchange_line_wake(&shared, 0) >= 0);
    line_put_control(0, &control);
    WAIT_UNTIL(report().drive[0].mode == DRIVE_READY && report().drive[0].cycles > 0);
    put(0.0);
    control.drive[0] = (mode_request){.count = 2, .mode = DRIVE_ARMED};
    line_put_control(0, &control);
    WAIT_UNTIL(report().drive[0].mode == DRIVE_ARMED);
    CHECK(a_thread_is_called("motord-line"));
    uint64_t before = report().life.rounds;
    int64_t begin_ns = clock_now_ns();
    put(1.0);
    WAIT_UNTIL(port.speed == 100);
    put(0.5);
    WAIT_UNTIL(port.speed == 50);
    put(0.0);
    WAIT_UNTIL(port.speed == 0);
    WAIT_UNTIL(report().life.rounds > before + 20);
    /* each round has a cause: a look after some ms, a wake-up, a reply */
    CHECK(report().life.rounds - before <= (uint64_t)((clock_now_ns() - begin_ns) / MS) + 30);
    end_thread();
}

static void a_drive_that_another_program_left_running_gets_a_quick_stop_first(void)
{
    left_running = 1;
    begin_thread(-1, 0);
    left_running = 0;
    WAIT_UNTIL(port.count > 0);
    CHECK(port.first[1] == WRITE && port.first[3] == CONTROL && port.first[5] == QUICK_STOP);
    CHECK(report().drive[0].may_turn == 1);
    end_thread();
}

static void a_bad_table_begins_no_thread_and_a_line_that_does_not_exist_has_no_answer(void)
{
    line_config config = {.at = {.event_fd = -1, .exchange = &shared}, .de_fd = -1};
    line_report out;
    line_answer answer;
    begin_with(1, 0);
    w.table.drive_count = 0;
    CHECK(line_start(1, &config, &w.table) == -EINVAL);
    CHECK(line_stop(LINES_MAX) == -ESRCH && line_read_report(LINES_MAX, &out) == -ESRCH);
    CHECK(line_take_answer(LINES_MAX, &answer) == 0);
}

static void a_request_that_is_not_good_is_refused(void)
{
    begin_thread(-1, 0);
    line_request request = one_request();
    CHECK(line_put_request(1, &request) == -ESRCH);
    CHECK(line_put_request(LINES_MAX, &request) == -ESRCH);
    request.frame.request_bytes = FRAME_BYTES_MAX + 1;
    CHECK(line_put_request(0, &request) == -EINVAL);
    request.frame.request_bytes = 0;
    CHECK(line_put_request(0, &request) == -EINVAL);
    send_one();
    CHECK(port.count == 1);
    end_thread();
    request = one_request();
    CHECK(line_put_request(0, &request) == -ESRCH);
}

int main(void)
{
    the_pin_turns_before_the_first_bit_and_back_after_the_last();
    a_transmitter_that_is_never_empty_holds_the_pin_for_a_limited_time();
    a_port_that_does_not_report_its_transmitter_is_waited_for_by_the_length();
    without_a_pin_the_port_is_not_asked_and_nothing_waits();
    a_pin_that_cannot_be_turned_ends_the_thread();
    a_request_that_the_port_takes_in_pieces_is_sent_whole();
    a_port_that_stays_full_counts_as_lost();
    a_new_command_does_not_wait_for_the_cycle_and_the_thread_sleeps_again();
    a_drive_that_another_program_left_running_gets_a_quick_stop_first();
    a_bad_table_begins_no_thread_and_a_line_that_does_not_exist_has_no_answer();
    a_request_that_is_not_good_is_refused();
    return checks_report("rtu port");
}
