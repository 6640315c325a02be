/* SPDX-License-Identifier: Apache-2.0
 * line_can.c: the thread of a CAN bus: the socket, the clock, the waiting. The machine decides what
 * is sent and when. */
#include <errno.h>
#include <linux/can.h>
#include <linux/can/raw.h>
#include <string.h>
#include <sys/socket.h>
#include <sys/uio.h>
#include <time.h>
#include <unistd.h>

#include "can_machine.h"
#include "line_thread.h"
#include "line_trace.h"

enum { BATCH = 32, BATCHES_MAX = 32, CONTROL_BYTES = CMSG_SPACE(sizeof(struct timespec)) };

static const int64_t NS_PER_S = 1000000000;
/* Time that frames may wait for the next step: the kernel has stamped them, and a wake-up costs
 * more than many frames. */
static const int64_t FRAMES_WAIT_NS = 2 * 1000000;

/* The parts of a message side by side: after a sleep the caches are cold. */
typedef struct {
    _Alignas(CACHE_LINE_BYTES) struct iovec iov;
    struct canfd_frame frame;
    _Alignas(struct cmsghdr) uint8_t control[CONTROL_BYTES];
} can_letter;

/* Buffers for recvmmsg. */
typedef struct {
    struct mmsghdr message[BATCH];
    can_letter letter[BATCH];
} can_inbox;

typedef struct {
    line_thread life;
    can_machine machine;
    can_control control[MAILBOX_SLOTS];
    can_report report[MAILBOX_SLOTS];
    ring orders, received;
    can_order order_place[CAN_ORDERS_MAX];
    can_received received_place[CAN_RECEIVED_MAX];
    can_inbox inbox;
    int64_t emptied_ns; /* time before the newest look that emptied the socket: frames that are read
                           now came later */
    can_report out;
    uint32_t outputs[CAN_DRIVES_MAX]; /* number of outputs of each drive, for callers that submit
                                         orders; 0: no such drive */
    int send_error;
    bool woken;
} can_thread;

static can_thread threads[LINES_MAX];

static line_thread *life_of(uint32_t line)
{
    return line < LINES_MAX ? &threads[line].life : NULL;
}

/* --------------------------------------------------------------------------- the socket */
/* Send a frame. struct can_frame and struct canfd_frame begin alike (linux/can.h); the written
 * length distinguishes them. */
static bool send_packet(void *sink, const can_packet *packet)
{
    can_thread *t = sink;
    struct canfd_frame frame = {.can_id = packet->id, .len = (uint8_t)packet->bytes};
    frame.flags = packet->fd != 0 ? CANFD_BRS : 0;
    memcpy(frame.data, packet->data, packet->bytes);
    size_t size = packet->fd != 0 ? CANFD_MTU : CAN_MTU;
    ssize_t went;
    do {
        went = send(t->life.at.fd, &frame, size, MSG_DONTWAIT | MSG_NOSIGNAL);
    } while (went < 0 && errno == EINTR);
    if (went == (ssize_t)size) {
        trace_bytes(t->life.line, true, clock_now_ns(), &frame, (uint32_t)size);
        return true;
    }
    if (went < 0 && errno != EAGAIN && errno != ENOBUFS) {
        t->send_error = errno;
    }
    return false;
}

static void prepare_inbox(can_inbox *inbox)
{
    for (uint32_t i = 0; i < BATCH; i++) {
        can_letter *letter = &inbox->letter[i];
        letter->iov = (struct iovec){.iov_base = &letter->frame, .iov_len = sizeof letter->frame};
        inbox->message[i].msg_hdr = (struct msghdr){.msg_iov = &letter->iov,
                                                    .msg_iovlen = 1,
                                                    .msg_control = letter->control,
                                                    .msg_controllen = CONTROL_BYTES};
    }
}

/* Return the time when the kernel received a frame; without a stamp of its own, now. */
static int64_t stamp_of(struct msghdr *message, int64_t emptied_ns, int64_t now_ns, int64_t wall_ns)
{
    for (struct cmsghdr *one = CMSG_FIRSTHDR(message); one != NULL;
         one = CMSG_NXTHDR(message, one)) {
        if (one->cmsg_level == SOL_SOCKET && one->cmsg_type == SCM_TIMESTAMPNS) {
            struct timespec stamp;
            memcpy(&stamp, CMSG_DATA(one), sizeof stamp);
            int64_t age_ns = wall_ns - (stamp.tv_sec * NS_PER_S + stamp.tv_nsec);
            return can_stamp_ns(age_ns, emptied_ns, now_ns);
        }
    }
    return now_ns;
}

static void take_frame(can_thread *t, const struct canfd_frame *frame, size_t size,
                       int64_t stamp_ns, int64_t now_ns)
{
    bool fd = size == CANFD_MTU;
    trace_bytes(t->life.line, false, stamp_ns, frame, (uint32_t)size);
    uint32_t most = fd ? CANFD_MAX_DLEN : CAN_MAX_DLEN;
    if ((size != CAN_MTU && !fd) || frame->len > most) {
        t->machine.bad_frames++;
        return;
    }
    can_received one = {.packet = {.id = frame->can_id, .bytes = frame->len, .fd = fd},
                        .stamp_ns = stamp_ns};
    memcpy(one.packet.data, frame->data, frame->len);
    one.drive = can_machine_receive(&t->machine, &one.packet, stamp_ns, now_ns);
    if (one.drive != CAN_FOR_NOBODY &&
        !ring_put(&t->received, t->received_place, CAN_RECEIVED_MAX, &one, sizeof one)) {
        t->out.dropped++;
    }
}

/* Receive a batch. Returns the number of frames; 0: no frame; -errno: the CAN bus is lost. */
static int receive_batch(can_thread *t)
{
    can_inbox *inbox = &t->inbox;
    struct timespec wall;
    int64_t looked_ns = clock_now_ns();
    int count = recvmmsg(t->life.at.fd, inbox->message, BATCH, MSG_DONTWAIT, NULL);
    if (count < 0) {
        t->emptied_ns = errno == EAGAIN ? looked_ns : t->emptied_ns;
        return errno == EAGAIN || errno == EINTR ? 0 : -errno;
    }
    (void)clock_gettime(CLOCK_REALTIME, &wall);
    int64_t now_ns = clock_now_ns(), wall_ns = wall.tv_sec * NS_PER_S + wall.tv_nsec;
    for (int i = 0; i < count; i++) {
        if (inbox->message[i].msg_len == 0) {
            return -ENODEV; /* the other end of a socket pair is closed */
        }
        int64_t stamp_ns = stamp_of(&inbox->message[i].msg_hdr, t->emptied_ns, now_ns, wall_ns);
        /* the kernel has overwritten these lengths */
        inbox->message[i].msg_hdr.msg_controllen = CONTROL_BYTES;
        if ((inbox->message[i].msg_hdr.msg_flags & MSG_CONFIRM) != 0) {
            /* sent by this socket: linux Documentation/networking/can.rst */
            can_machine_left(&t->machine, inbox->letter[i].frame.can_id);
            continue;
        }
        take_frame(t, &inbox->letter[i].frame, inbox->message[i].msg_len, stamp_ns, now_ns);
    }
    t->emptied_ns = count < BATCH ? looked_ns : t->emptied_ns;
    return count;
}

/* Take all received frames before a drive counts as missing, up to a limit: a flood does not delay
 * the cycle. */
static int receive(can_thread *t)
{
    int count = BATCH;
    for (int i = 0; i < BATCHES_MAX && count == BATCH; i++) {
        count = receive_batch(t);
    }
    return count < 0 ? count : 0;
}

/* Whether the socket was opened to receive its own set-point frames when they have left. Sockets of
 * other kinds cannot. */
static bool receives_own(int fd)
{
    int own = 0;
    socklen_t size = sizeof own;
    return getsockopt(fd, SOL_CAN_RAW, CAN_RAW_RECV_OWN_MSGS, &own, &size) == 0 && own != 0;
}

static int socket_error(const can_thread *t)
{
    int error = 0;
    socklen_t size = sizeof error;
    int failed = getsockopt(t->life.at.fd, SOL_SOCKET, SO_ERROR, &error, &size);
    return failed != 0 ? -errno : -error;
}

/* ------------------------------------------------------------------------ the hand-over */
static void put_report(can_thread *t, bool running, int error)
{
    can_machine_report(&t->machine, &t->out);
    line_thread_put_report(&t->life, &t->out.life, running, error);
}

static void hand_on(can_thread *t, int64_t now_ns)
{
    can_machine *m = &t->machine;
    line_thread_put_feedback(&t->life, m->feedback_mask, m->joint, sizeof m->joint[0]);
    m->feedback_mask = 0;
    bool due = line_thread_report_is_due(&t->life, m->cycle.count > 0, now_ns);
    if (m->notify || due) {
        put_report(t, true, 0);
    }
    if (m->notify) {
        line_thread_notify(&t->life);
    }
    m->notify = false;
}

static void take_orders(can_thread *t)
{
    can_order order;
    while (t->machine.order_count < CAN_WAITING_MAX &&
           ring_take(&t->orders, t->order_place, CAN_ORDERS_MAX, &order, sizeof order)) {
        (void)can_machine_order(&t->machine, &order);
    }
}

/* --------------------------------------------------------------------------- the thread */
/* Wait for frames, a wake or the time. Returns 0; -errno: the CAN bus is lost. */
static int wait_for_wakeup(can_thread *t, int64_t until_ns)
{
    struct pollfd fds[2] = {[1] = {.fd = t->life.at.fd, .events = POLLIN}};
    bool soon = until_ns - clock_now_ns() <= FRAMES_WAIT_NS && t->machine.control.listen == 0;
    int woken = line_thread_wait(&t->life, fds, soon ? 1 : 2, until_ns);
    t->woken = woken > 0;
    if (woken >= 0 && (fds[1].revents & (POLLERR | POLLNVAL)) != 0) {
        return socket_error(t);
    }
    return woken < 0 ? woken : 0;
}

static int go_round(can_thread *t, int64_t *wake_ns)
{
    /* the control comes first: it contains the drives whose frames Python receives */
    line_thread_take_control(&t->life, &t->machine.control);
    int error = receive(t);
    t->machine.enabled_count = line_thread_take_setpoints(&t->life, &t->machine.newest);
    take_orders(t);
    int64_t now_ns = clock_now_ns();
    t->send_error = 0;
    if (t->woken) {
        can_machine_kick(&t->machine, now_ns);
    }
    *wake_ns = can_machine_step(&t->machine, now_ns);
    t->out.life.rounds++;
    hand_on(t, now_ns);
    return error != 0 ? error : -t->send_error;
}

static void *run(void *arg)
{
    can_thread *t = arg;
    int64_t wake_ns = 0;
    int error = 0;
    line_thread_begin(&t->life, "motord-can");
    while (!t->life.stop_requested && error == 0) {
        error = go_round(t, &wake_ns);
        error = error != 0 ? error : wait_for_wakeup(t, wake_ns);
    }
    line_thread_count_page_faults(&t->life, t->machine.cycle.count > 0);
    put_report(t, false, -error);
    line_thread_end(&t->life);
    return NULL;
}

/* ----------------------------------------------------------------------------- its life */
static int prepare(can_thread *t, uint32_t line, const can_config *config, const can_table *table)
{
    const line_slots slots = {t->control, sizeof t->control[0], t->report, sizeof t->report[0]};
    int error = line_thread_prepare(&t->life, line, &config->at, &slots);
    error = error == 0 ? can_machine_init(&t->machine, table, &config->before, send_packet, t,
                                          clock_now_ns())
                       : error;
    if (error != 0) {
        return error;
    }
    if (config->before.left_running != 0) {
        can_take_over(&t->machine, clock_now_ns());
    }
    t->machine.receives_own = receives_own(config->at.fd);
    t->emptied_ns = clock_now_ns();
    for (uint32_t i = 0; i < CAN_DRIVES_MAX; i++) {
        t->outputs[i] = i < table->drive_count ? table->drive[i].output_count : 0;
    }
    memset(&t->orders, 0, sizeof t->orders);
    memset(&t->received, 0, sizeof t->received);
    memset(&t->out, 0, sizeof t->out);
    prepare_inbox(&t->inbox);
    put_report(t, true, 0);
    return 0;
}

int can_start(uint32_t line, const can_config *config, const can_table *table)
{
    int error = line < LINES_MAX ? prepare(&threads[line], line, config, table) : -EINVAL;
    return error == 0 ? line_thread_start(&threads[line].life, run, &threads[line]) : error;
}

int can_stop(uint32_t line)
{
    return line_thread_stop(life_of(line));
}

void can_put_control(uint32_t line, const can_control *control)
{
    line_thread_put_control(life_of(line), control);
}

int can_put_order(uint32_t line, const can_order *order)
{
    if (line >= LINES_MAX || !threads[line].life.running) {
        return -ESRCH;
    }
    can_thread *t = &threads[line];
    bool known = order->drive < CAN_DRIVES_MAX && t->outputs[order->drive] > 0;
    if (!known || !can_write_is_good(&order->write, t->outputs[order->drive])) {
        return -EINVAL;
    }
    return line_thread_hand_over(&t->life, &t->orders, t->order_place, CAN_ORDERS_MAX, order,
                                 sizeof *order);
}

int can_take_received(uint32_t line, can_received *out)
{
    return line < LINES_MAX && ring_take(&threads[line].received, threads[line].received_place,
                                         CAN_RECEIVED_MAX, out, sizeof *out);
}

int can_read_report(uint32_t line, can_report *out)
{
    return line_thread_read_report(life_of(line), out);
}
