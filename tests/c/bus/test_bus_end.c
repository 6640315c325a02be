/* SPDX-License-Identifier: Apache-2.0
 * An input of ROS 2 ends while commands arrive, with lease and listener ending in either order:
 * after that it sends and notifies nothing. This program replaces the library Cyclone DDS:
 * receiver_library finds its functions here. */
#include <errno.h>
#include <poll.h>
#include <pthread.h>
#include <sched.h>
#include <string.h>
#include <sys/eventfd.h>
#include <sys/socket.h>
#include <time.h>
#include <unistd.h>

#include "bus.h"
#include "check.h"
#include "rt.h"

enum { ROUNDS = 300, READER = 7, TWIST_BYTES = 4 + 16 + 48, LATER = 20 };

typedef struct dds_listener {
    void *arg;
    void (*call)(int32_t reader, void *arg);
} dds_listener;

typedef struct ddsi_serdata {
    uint8_t raw[TWIST_BYTES];
} ddsi_serdata;

typedef struct {
    uint32_t states[3];
    bool valid_data;
    int64_t source_timestamp;
    uint64_t instance_handle, publication_handle;
    uint32_t counts[5];
} sample_info;

static pthread_mutex_t lock = PTHREAD_MUTEX_INITIALIZER;
static pthread_cond_t changed = PTHREAD_COND_INITIALIZER;
static dds_listener current; /* the listener of the reader */
static int calling;
static ddsi_serdata twist;
static _Atomic int held;
static _Atomic uint64_t deliveries;
static _Atomic bool over;

/* ------------------------------------------- the functions of the DDS library that motord calls */
dds_listener *dds_create_listener(void *arg);
void dds_lset_data_available(dds_listener *listener, void (*call)(int32_t reader, void *arg));
int32_t dds_set_listener(int32_t reader, const dds_listener *listener);
void dds_delete_listener(dds_listener *listener);
int32_t dds_takecdr(int32_t reader, ddsi_serdata **data, uint32_t count, sample_info *info,
                    uint32_t mask);
uint32_t ddsi_serdata_size(const ddsi_serdata *data);
void ddsi_serdata_to_ser(const ddsi_serdata *data, size_t offset, size_t bytes, void *to);
void ddsi_serdata_unref(ddsi_serdata *data);

dds_listener *dds_create_listener(void *arg)
{
    static dds_listener made;
    made = (dds_listener){.arg = arg};
    return &made;
}

void dds_lset_data_available(dds_listener *listener, void (*call)(int32_t reader, void *arg))
{
    listener->call = call;
}

/* Like dds_entity.c: waits for a running call. */
int32_t dds_set_listener(int32_t reader, const dds_listener *listener)
{
    CHECK(reader == READER && pthread_mutex_lock(&lock) == 0);
    while (calling > 0) {
        CHECK(pthread_cond_wait(&changed, &lock) == 0);
    }
    current = listener != NULL ? *listener : (dds_listener){.arg = NULL};
    CHECK(pthread_mutex_unlock(&lock) == 0);
    return 0;
}

void dds_delete_listener(dds_listener *listener)
{
    *listener = (dds_listener){.arg = NULL};
}

/* Gives two samples at a time, so that a call ends. */
int32_t dds_takecdr(int32_t reader, ddsi_serdata **data, uint32_t count, sample_info *info,
                    uint32_t mask)
{
    CHECK(reader == READER && count > 2 && mask != 0);
    for (int i = 0; i < 2; i++) {
        held++;
        data[i] = &twist;
        info[i] = (sample_info){.valid_data = true, .publication_handle = 1};
    }
    return 2;
}

uint32_t ddsi_serdata_size(const ddsi_serdata *data)
{
    return sizeof data->raw;
}

void ddsi_serdata_to_ser(const ddsi_serdata *data, size_t offset, size_t bytes, void *to)
{
    memcpy(to, data->raw + offset, bytes);
}

void ddsi_serdata_unref(ddsi_serdata *data)
{
    CHECK(data == &twist);
    held--;
}

/* Like dds_reader.c: a call that waits uses the listener that is set when it runs. */
static void *receives(void *unused)
{
    (void)unused;
    while (!over) {
        CHECK(pthread_mutex_lock(&lock) == 0);
        calling++;
        dds_listener now = current;
        CHECK(pthread_mutex_unlock(&lock) == 0);
        if (now.call != NULL) {
            now.call(READER, now.arg);
        }
        CHECK(pthread_mutex_lock(&lock) == 0);
        calling--;
        CHECK(pthread_cond_broadcast(&changed) == 0 && pthread_mutex_unlock(&lock) == 0);
        deliveries++;
        (void)sched_yield();
    }
    return NULL;
}

/* ------------------------------------------------------------------------------------- the test */
/* A twist in plain CDR, little-endian, without a frame: 0.5 m/s, stamped now. */
static void stamp_twist(void)
{
    const double linear_m_s = 0.5;
    const uint32_t now_s = (uint32_t)time(NULL);
    twist.raw[1] = 1;
    memcpy(twist.raw + 4, &now_s, sizeof now_s);
    memcpy(twist.raw + 4 + 16, &linear_m_s, sizeof linear_m_s);
}

static int received(int fd)
{
    command_datagram one;
    int count = 0;
    while (recv(fd, &one, sizeof one, MSG_DONTWAIT) == sizeof one) {
        count++;
    }
    return count;
}

static void later(void)
{
    for (uint64_t until = deliveries + LATER; deliveries < until;) {
        (void)sched_yield();
    }
}

static void one_ends(int round)
{
    const uint8_t token[LEASE_TOKEN_BYTES] = {1};
    int lease[2], event_fd = eventfd(0, EFD_NONBLOCK);
    int number = receiver_claim();
    CHECK(number >= 0 && event_fd >= 0 && socketpair(AF_UNIX, SOCK_DGRAM, 0, lease) == 0);
    receiver_alive(number);
    receiver_hold(number, lease[0], token, 0);
    CHECK(receiver_start(number, READER, event_fd) == 0);
    received_twist newest = {.writer = 0};
    while (receiver_take_received(number, &newest, 1) == 0) {
        (void)received(lease[1]);
    }
    CHECK(newest.linear_m_s == 0.5);
    if (round % 2 == 0) { /* the lease ends first: what arrives then is not sent as a command */
        (void)receiver_let_go(number);
        (void)received(lease[1]);
        later();
        CHECK(received(lease[1]) == 0);
    }
    CHECK(receiver_stop(number) == 0);
    CHECK(close(event_fd) == 0);
    int other_fd = eventfd(0, EFD_NONBLOCK); /* another file of the process may have the same number
                                                now */
    CHECK(other_fd == event_fd);
    (void)received(lease[1]);
    later();
    eventfd_t notified;
    CHECK(received(lease[1]) == 0 && eventfd_read(other_fd, &notified) != 0 && errno == EAGAIN);
    (void)receiver_let_go(number);
    receiver_release(number);
    CHECK(close(other_fd) == 0 && close(lease[0]) == 0 && close(lease[1]) == 0);
}

int main(void)
{
    pthread_t thread;
    stamp_twist();
    CHECK(receiver_library("") == 0); /* the library is this program itself */
    CHECK(pthread_create(&thread, NULL, receives, NULL) == 0);
    for (int round = 0; round < ROUNDS; round++) {
        one_ends(round);
    }
    over = true;
    CHECK(pthread_join(thread, NULL) == 0 && held == 0);
    return checks_report("bus_end");
}
