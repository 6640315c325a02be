/* SPDX-License-Identifier: Apache-2.0
 * line_board.c: the thread of a board's line: the port, the clock, the waiting. The machine decides
 * what is sent and when. */
#include <errno.h>
#include <locale.h>
#include <string.h>
#include <sys/ioctl.h>
#include <unistd.h>

#include "board_machine.h"
#include "line_thread.h"
#include "line_trace.h"

enum { READ_BYTES = 1024, FRAMES_WAITING_MAX = 2 };

typedef struct {
    line_thread life;
    board_machine machine;
    board_control control[MAILBOX_SLOTS];
    board_report report[MAILBOX_SLOTS];
    ring orders;
    board_order order_place[BOARD_ORDERS_MAX];
    board_report out;
    uint32_t payload_bytes; /* for callers that submit orders */
    uint32_t rest_bytes;
    bool woken;
    uint8_t rest[BOARD_WIRE_MAX]; /* the rest of a frame whose beginning the port has taken */
    int send_error;
    uint64_t received_reported;
} board_thread;

static board_thread threads[LINES_MAX];

static line_thread *life_of(uint32_t line)
{
    return line < LINES_MAX ? &threads[line].life : NULL;
}

/* ----------------------------------------------------------------------------- the port */
/* Write bytes. Returns the number that the port took, 0 if it takes none now. */
static uint32_t write_some(board_thread *t, const uint8_t *bytes, uint32_t count)
{
    ssize_t went;
    do {
        went = write(t->life.at.fd, bytes, count);
    } while (went < 0 && errno == EINTR);
    if (went < 0 && errno != EAGAIN) {
        t->send_error = errno;
    }
    if (went <= 0) {
        return 0;
    }
    trace_bytes(t->life.line, true, clock_now_ns(), bytes, (uint32_t)went);
    return (uint32_t)went;
}

static bool flush_rest(board_thread *t)
{
    if (t->rest_bytes > 0) {
        uint32_t went = write_some(t, t->rest, t->rest_bytes);
        t->rest_bytes -= went;
        memmove(t->rest, t->rest + went, t->rest_bytes);
    }
    return t->rest_bytes == 0;
}

/* Send bytes, but not behind older frames that still wait: they would come late. */
static bool send_bytes(void *sink, const uint8_t *bytes, uint32_t count)
{
    board_thread *t = sink;
    int waiting = 0;
    if (!flush_rest(t) || (ioctl(t->life.at.fd, TIOCOUTQ, &waiting) == 0 &&
                           waiting > (int)(FRAMES_WAITING_MAX * count))) {
        return false;
    }
    uint32_t went = write_some(t, bytes, count);
    if (went == 0) {
        return false;
    }
    t->rest_bytes = count - went;
    memcpy(t->rest, bytes + went, t->rest_bytes);
    return true;
}

/* ------------------------------------------------------------------------ the hand-over */
static void put_report(board_thread *t, bool running, int error)
{
    board_machine_report(&t->machine, &t->out);
    line_thread_put_report(&t->life, &t->out.life, running, error);
}

static void hand_on(board_thread *t, int64_t now_ns)
{
    board_machine *m = &t->machine;
    line_thread_put_feedback(&t->life, m->feedback_mask, m->joint, sizeof m->joint[0]);
    m->feedback_mask = 0;
    if (m->imu_is_new) {
        exchange_put_imu(t->life.at.exchange, &m->imu);
    }
    m->imu_is_new = false;
    bool due = line_thread_report_is_due(&t->life, m->cycle.count > 0, now_ns);
    if (m->notify || due || m->received != t->received_reported) {
        t->received_reported = m->received;
        put_report(t, true, 0);
    }
    if (m->notify) {
        line_thread_notify(&t->life);
    }
    m->notify = false;
}

static void take_order(board_thread *t)
{
    board_order order;
    if (!t->machine.has_order &&
        ring_take(&t->orders, t->order_place, BOARD_ORDERS_MAX, &order, sizeof order)) {
        (void)board_machine_order(&t->machine, &order);
    }
}

/* --------------------------------------------------------------------------- the thread */
/* Wait for bytes, a wake or the time. Returns the number of bytes or -errno. */
static int wait_for_wakeup(board_thread *t, int64_t until_ns, uint8_t *bytes, uint32_t room)
{
    struct pollfd fds[2] = {[1] = {.fd = t->life.at.fd, .events = POLLIN}};
    int woken = line_thread_wait(&t->life, fds, 2, until_ns);
    t->woken = woken > 0;
    return woken < 0 ? woken : line_thread_read_port(&t->life, fds[1].revents, bytes, room);
}

static int go_round(board_thread *t, const uint8_t *bytes, uint32_t count, int64_t *wake_ns)
{
    int64_t now_ns = clock_now_ns();
    line_thread_take_control(&t->life, &t->machine.control);
    board_machine_receive(&t->machine, bytes, count, now_ns);
    t->machine.enabled_count = line_thread_take_setpoints(&t->life, &t->machine.newest);
    take_order(t);
    if (t->woken) {
        board_machine_kick(&t->machine, now_ns);
    }
    t->send_error = 0;
    *wake_ns = board_machine_step(&t->machine, now_ns);
    t->out.life.rounds++;
    hand_on(t, now_ns);
    return -t->send_error;
}

static void *run(void *arg)
{
    board_thread *t = arg;
    uint8_t bytes[READ_BYTES] = {0};
    int64_t wake_ns = 0;
    int count = 0, error = 0;
    line_thread_begin(&t->life, "motord-board");
    /* text uses a decimal point, in any locale of the process */
    (void)uselocale(newlocale(LC_ALL_MASK, "C", (locale_t)0));
    while (!t->life.stop_requested && error == 0) {
        error = go_round(t, bytes, (uint32_t)count, &wake_ns);
        count = error == 0 ? wait_for_wakeup(t, wake_ns, bytes, sizeof bytes) : 0;
        error = count < 0 ? count : error;
    }
    line_thread_count_page_faults(&t->life, t->machine.cycle.count > 0);
    put_report(t, false, -error);
    line_thread_end(&t->life);
    return NULL;
}

/* ----------------------------------------------------------------------------- its life */
/* Prepare a start. The sequence continues: the board takes no older one. */
static int prepare(board_thread *t, uint32_t line, const board_config *config,
                   const board_table *table)
{
    const line_slots slots = {t->control, sizeof t->control[0], t->report, sizeof t->report[0]};
    int error = line_thread_prepare(&t->life, line, &config->at, &slots);
    error = error == 0 ? board_machine_init(&t->machine, table, config->epoch, t->machine.sequence,
                                            clock_now_ns())
                       : error;
    if (error != 0) {
        return error;
    }
    if (config->left_running != 0) {
        board_take_over(&t->machine, clock_now_ns());
    }
    t->machine.send = send_bytes;
    t->machine.sink = t;
    t->machine.round_trips = &t->life.round_trips;
    t->payload_bytes = table->payload_bytes;
    t->rest_bytes = 0;
    t->received_reported = 0;
    memset(&t->orders, 0, sizeof t->orders);
    memset(&t->out, 0, sizeof t->out);
    put_report(t, true, 0);
    return 0;
}

int board_start(uint32_t line, const board_config *config, const board_table *table)
{
    int error = line < LINES_MAX ? prepare(&threads[line], line, config, table) : -EINVAL;
    return error == 0 ? line_thread_start(&threads[line].life, run, &threads[line]) : error;
}

int board_stop(uint32_t line)
{
    return line_thread_stop(life_of(line));
}

void board_put_control(uint32_t line, const board_control *control)
{
    line_thread_put_control(life_of(line), control);
}

int board_put_order(uint32_t line, const board_order *order)
{
    if (line >= LINES_MAX || !threads[line].life.running) {
        return -ESRCH;
    }
    board_thread *t = &threads[line];
    if (!board_write_is_good(&order->write, t->payload_bytes)) {
        return -EINVAL;
    }
    return line_thread_hand_over(&t->life, &t->orders, t->order_place, BOARD_ORDERS_MAX, order,
                                 sizeof *order);
}

int board_read_report(uint32_t line, board_report *out)
{
    return line_thread_read_report(life_of(line), out);
}

int board_histogram_read(uint32_t line, histogram *out)
{
    return line_thread_read_round_trips(life_of(line), out);
}
