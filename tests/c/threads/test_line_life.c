/* SPDX-License-Identifier: Apache-2.0
 * line_thread.c, called without a thread: what a wait and a read return in each case, and what is
 * refused. */
#include <errno.h>
#include <fcntl.h>
#include <string.h>
#include <sys/eventfd.h>
#include <sys/socket.h>
#include <sys/syscall.h>
#include <unistd.h>

#include "check.h"
#include "line_thread.h"

enum { PLACES = 2 };

static struct {
    int wait_fails, create_fails, eventfd_fails;
    struct timespec left; /* of the newest wait */
} kernel;

/* These replace the C library's functions. */
int ppoll(struct pollfd *fds, nfds_t count, const struct timespec *left, const sigset_t *mask)
{
    CHECK(mask == NULL);
    kernel.left = *left;
    errno = kernel.wait_fails;
    if (errno != 0) {
        for (nfds_t i = 0; i < count; i++) {
            fds[i].revents = POLLIN | POLLERR; /* undefined after a failure */
        }
        return -1;
    }
    return poll(fds, count, 0);
}

int pthread_attr_init(pthread_attr_t *attr)
{
    memset(attr, 0, sizeof *attr);
    return kernel.create_fails;
}

int eventfd(unsigned count, int flags)
{
    errno = kernel.eventfd_fails;
    return errno == 0 ? (int)syscall(SYS_eventfd2, count, flags) : -1;
}

typedef struct {
    line_life life;
    uint64_t number;
} own_report;

static exchange shared;
static uint64_t controls[MAILBOX_SLOTS];
static own_report reports[MAILBOX_SLOTS];
static const line_slots SLOTS = {controls, sizeof controls[0], reports, sizeof reports[0]};

static void prepared(line_thread *t, int fd)
{
    memset(t, 0, sizeof *t);
    const line_place at = {.fd = fd, .event_fd = -1, .exchange = &shared};
    CHECK(line_thread_prepare(t, 0, &at, &SLOTS) == 0);
}

static void *runs(void *arg)
{
    return arg;
}

/* ---------------------------------------------------------------------------- its beginning */
static void a_place_that_is_not_good_is_refused(void)
{
    line_thread t = {0};
    const line_place good = {.event_fd = -1, .exchange = &shared};
    line_place at = good;
    CHECK(line_thread_prepare(NULL, 0, &good, &SLOTS) == -EINVAL);
    at.fd = -1;
    CHECK(line_thread_prepare(&t, 0, &at, &SLOTS) == -EINVAL);
    at = good;
    at.priority = -1;
    CHECK(line_thread_prepare(&t, 0, &at, &SLOTS) == -EINVAL);
    at.priority = 100;
    CHECK(line_thread_prepare(&t, 0, &at, &SLOTS) == -EINVAL);
    kernel.eventfd_fails = EMFILE;
    CHECK(line_thread_prepare(&t, 0, &good, &SLOTS) == -EMFILE && !t.made);
    kernel.eventfd_fails = 0;
    at.priority = 99;
    CHECK(line_thread_prepare(&t, 0, &at, &SLOTS) == 0 && t.made);
    int wake_fd = t.wake_fd;
    CHECK(line_thread_prepare(&t, 0, &good, &SLOTS) == 0 && t.wake_fd == wake_fd);
    t.joinable = true;
    CHECK(line_thread_prepare(&t, 0, &good, &SLOTS) == -EBUSY);
}

static void a_thread_that_cannot_be_created_does_not_run(void)
{
    line_thread t;
    prepared(&t, 0);
    kernel.create_fails = ENOMEM;
    CHECK(line_thread_start(&t, runs, NULL) == -ENOMEM && !t.running && !t.joinable);
    CHECK(exchange_line_wake(&shared, 0) < 0 && line_thread_stop(&t) == -ESRCH);
    kernel.create_fails = 0;
}

static void of_a_line_that_never_began_nothing_is_known(void)
{
    line_thread t = {0};
    own_report report;
    histogram trips;
    uint64_t control = 1;
    CHECK(line_thread_stop(NULL) == -ESRCH && line_thread_stop(&t) == -ESRCH);
    CHECK(line_thread_read_report(NULL, &report) == -ESRCH);
    CHECK(line_thread_read_report(&t, &report) == -ESRCH);
    CHECK(line_thread_read_round_trips(NULL, &trips) == -EINVAL);
    CHECK(line_thread_read_round_trips(&t, &trips) == 0 && trips.samples == 0);
    line_thread_put_control(NULL, &control);
    line_thread_put_control(&t, &control);
}

/* ---------------------------------------------------------------------------- its exchange */
static void a_report_begins_with_the_life_of_the_thread(void)
{
    line_thread t;
    own_report out = {.number = 7}, in;
    prepared(&t, 0);
    t.grant.policy = 1;
    t.grant.scheduler_errno = EPERM;
    t.page_faults = 3;
    line_thread_put_report(&t, &out.life, true, EIO);
    CHECK(line_thread_read_report(&t, &in) == 0 && in.number == 7 && in.life.running == 1 &&
          in.life.error == EIO && in.life.policy == 1 && in.life.scheduler_errno == EPERM &&
          in.life.page_faults == 3);
    line_thread_put_report(&t, &out.life, false, 0);
    CHECK(line_thread_read_report(&t, &in) == 0 && in.life.running == 0 && in.life.error == 0);
}

static void a_full_queue_refuses_and_an_entry_wakes(void)
{
    line_thread t;
    ring to = {0};
    uint64_t places[PLACES], wakes = 0;
    const uint64_t value = 5;
    prepared(&t, 0);
    for (int i = 0; i < PLACES; i++) {
        CHECK(line_thread_hand_over(&t, &to, places, PLACES, &value, sizeof value) == 0);
    }
    CHECK(line_thread_hand_over(&t, &to, places, PLACES, &value, sizeof value) == -EAGAIN);
    CHECK(read(t.wake_fd, &wakes, sizeof wakes) == sizeof wakes && wakes == PLACES);
    line_thread_put_control(&t, &value);
    uint64_t control = 0;
    line_thread_take_control(&t, &control);
    CHECK(control == value && read(t.wake_fd, &wakes, sizeof wakes) == sizeof wakes);
}

static void a_reader_that_was_woken_and_has_not_looked_delays_nothing(void)
{
    line_thread t;
    prepared(&t, 0);
    line_thread_notify(&t); /* nothing to wake */
    t.at.event_fd = eventfd(0, EFD_NONBLOCK);
    const uint64_t most = UINT64_MAX - 1;
    CHECK(write(t.at.event_fd, &most, sizeof most) == sizeof most);
    line_thread_notify(&t);
    uint64_t wakes = 0;
    CHECK(read(t.at.event_fd, &wakes, sizeof wakes) == sizeof wakes && wakes == most);
    t.running = true;
    line_thread_end(&t);
    CHECK(!t.running && read(t.at.event_fd, &wakes, sizeof wakes) == sizeof wakes && wakes == 1);
    CHECK(close(t.at.event_fd) == 0);
}

static void a_report_is_due_each_forty_milliseconds(void)
{
    line_thread t;
    prepared(&t, 0);
    const int64_t ms = 1000000, now_ns = 1000 * ms;
    CHECK(line_thread_report_is_due(&t, false, now_ns));
    CHECK(!line_thread_report_is_due(&t, false, now_ns + 40 * ms - 1));
    CHECK(line_thread_report_is_due(&t, true, now_ns + 40 * ms));
    CHECK(!line_thread_report_is_due(&t, true, now_ns + 80 * ms - 1));
}

/* -------------------------------------------------------------------------- wait and read */
static void a_wait_ends_by_a_wake_or_by_its_time(void)
{
    line_thread t;
    struct pollfd fds[1];
    const uint64_t control = 1;
    prepared(&t, 0);
    CHECK(line_thread_wait(&t, fds, 1, 0) == 0);
    CHECK(kernel.left.tv_sec == 0 && kernel.left.tv_nsec == 0); /* never less than nothing */
    int64_t now_ns = clock_now_ns();
    CHECK(line_thread_wait(&t, fds, 1, now_ns + INT64_C(3500000000)) == 0);
    CHECK(kernel.left.tv_sec <= 3 && kernel.left.tv_nsec < 1000000000 && kernel.left.tv_sec >= 0);
    CHECK(kernel.left.tv_sec < 3 || kernel.left.tv_nsec <= 500000000);
    line_thread_put_control(&t, &control);
    CHECK(line_thread_wait(&t, fds, 1, 0) == 1);
    CHECK(line_thread_wait(&t, fds, 1, 0) == 0); /* once */
}

static void an_interrupted_wait_shows_nothing_and_a_failed_one_is_an_error(void)
{
    line_thread t;
    struct pollfd fds[2] = {[1] = {.fd = 0, .events = POLLIN}};
    prepared(&t, 0);
    kernel.wait_fails = EINTR;
    CHECK(line_thread_wait(&t, fds, 2, 0) == 0 && fds[0].revents == 0 && fds[1].revents == 0);
    kernel.wait_fails = ENOMEM;
    CHECK(line_thread_wait(&t, fds, 2, 0) == -ENOMEM && fds[1].revents == 0);
    kernel.wait_fails = 0;
}

static void a_port_is_lost_by_an_error_by_its_end_and_by_a_failed_read(void)
{
    int ends[2];
    uint8_t bytes[8];
    line_thread t;
    CHECK(socketpair(AF_UNIX, SOCK_STREAM | SOCK_NONBLOCK, 0, ends) == 0);
    prepared(&t, ends[0]);
    CHECK(line_thread_read_port(&t, 0, bytes, sizeof bytes) == 0);
    CHECK(line_thread_read_port(&t, POLLIN, bytes, sizeof bytes) == 0); /* nothing came */
    CHECK(write(ends[1], "abc", 3) == 3);
    CHECK(line_thread_read_port(&t, 0, bytes, sizeof bytes) == 0); /* poll shows none */
    CHECK(line_thread_read_port(&t, POLLIN | POLLERR, bytes, sizeof bytes) == -EIO);
    CHECK(line_thread_read_port(&t, POLLNVAL, bytes, sizeof bytes) == -EIO);
    CHECK(line_thread_read_port(&t, POLLIN, bytes, 2) == 2 && memcmp(bytes, "ab", 2) == 0);
    CHECK(line_thread_read_port(&t, POLLIN | POLLHUP, bytes, sizeof bytes) == 1);
    CHECK(close(ends[1]) == 0);
    CHECK(line_thread_read_port(&t, POLLIN | POLLHUP, bytes, sizeof bytes) == -EIO);
    CHECK(close(ends[0]) == 0);
    CHECK(line_thread_read_port(&t, POLLHUP, bytes, sizeof bytes) == -EBADF);
}

int main(void)
{
    exchange_init(&shared);
    a_place_that_is_not_good_is_refused();
    a_thread_that_cannot_be_created_does_not_run();
    of_a_line_that_never_began_nothing_is_known();
    a_report_begins_with_the_life_of_the_thread();
    a_full_queue_refuses_and_an_entry_wakes();
    a_reader_that_was_woken_and_has_not_looked_delays_nothing();
    a_report_is_due_each_forty_milliseconds();
    a_wait_ends_by_a_wake_or_by_its_time();
    an_interrupted_wait_shows_nothing_and_a_failed_one_is_an_error();
    a_port_is_lost_by_an_error_by_its_end_and_by_a_failed_read();
    return checks_report("line life");
}
