/* SPDX-License-Identifier: Apache-2.0
 * bus_receiver.c: hands the commands of a DDS reader to the daemon, in the thread of Cyclone that
 * received them. It never needs Python, which reads a report and a ring.
 *
 * The C library is the one that the Cyclone DDS binding has loaded. The package does not contain
 * its headers. The used part is declared here, as in dds/dds.h and dds/ddsi/ddsi_serdata.h of
 * version 11. */
#include "bus.h"

#include <dlfcn.h>
#include <errno.h>
#include <stdatomic.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

#include "ring.h"
#include "rt.h"

enum { TAKEN_AT_ONCE = 8 };

static const uint32_t ANY_STATE = 0x7f; /* DDS_ANY_STATE */

struct ddsi_serdata;
struct dds_listener;

typedef struct {
    uint32_t sample_state;
    uint32_t view_state;
    uint32_t instance_state;
    bool valid_data;
    int64_t source_timestamp;
    uint64_t instance_handle;
    uint64_t publication_handle;
    uint32_t disposed_generation_count;
    uint32_t no_writers_generation_count;
    uint32_t sample_rank;
    uint32_t generation_rank;
    uint32_t absolute_generation_rank;
} dds_sample_info;

static struct {
    struct dds_listener *(*create_listener)(void *arg);
    void (*lset_data_available)(struct dds_listener *listener,
                                void (*call)(int32_t reader, void *arg));
    int32_t (*set_listener)(int32_t reader, const struct dds_listener *listener);
    void (*delete_listener)(struct dds_listener *listener);
    int32_t (*takecdr)(int32_t reader, struct ddsi_serdata **data, uint32_t count,
                       dds_sample_info *info, uint32_t mask);
    uint32_t (*serdata_size)(const struct ddsi_serdata *data);
    void (*serdata_to_ser)(const struct ddsi_serdata *data, size_t offset, size_t bytes, void *to);
    void (*serdata_unref)(struct ddsi_serdata *data);
} dds;

typedef struct {
    outlet out;
    ring received;
    received_twist received_place[RECEIVED_TWISTS_MAX];
    uint8_t raw[TWIST_RAW_MAX];
    int32_t reader;
    int event_fd;
    bool running;
    _Atomic bool claimed;
    _Atomic int32_t error;
    _Atomic uint64_t taken;
    _Atomic uint64_t refused[TWIST_REFUSALS];
    _Atomic uint64_t unleased, hung, full, broken;
    _Atomic int64_t taken_ns;
} receiver;

static receiver receivers[RECEIVERS_MAX];

/* -------------------------------------------------------------------------- the library */
int receiver_library(const char *path)
{
    void *library = dlopen(path, RTLD_NOW | RTLD_LOCAL);
    if (library == NULL) {
        return -ELIBACC;
    }
    const struct {
        void *place;
        const char *name;
    } wanted[] = {
        {&dds.create_listener, "dds_create_listener"},
        {&dds.lset_data_available, "dds_lset_data_available"},
        {&dds.set_listener, "dds_set_listener"},
        {&dds.delete_listener, "dds_delete_listener"},
        {&dds.takecdr, "dds_takecdr"},
        {&dds.serdata_size, "ddsi_serdata_size"},
        {&dds.serdata_to_ser, "ddsi_serdata_to_ser"},
        {&dds.serdata_unref, "ddsi_serdata_unref"},
    };
    for (size_t i = 0; i < sizeof wanted / sizeof wanted[0]; i++) {
        void *found = dlsym(library, wanted[i].name);
        if (found == NULL) {
            return -ELIBACC;
        }
        /* ISO C does not convert an object pointer to a function pointer */
        memcpy(wanted[i].place, &found, sizeof found);
    }
    return 0;
}

/* ------------------------------------------------------------------ in Cyclone's thread */
static double wall_s(void)
{
    struct timespec now;
    (void)clock_gettime(CLOCK_REALTIME, &now);
    return (double)now.tv_sec + (double)now.tv_nsec * 1e-9;
}

static void count_lost(receiver *r, int error)
{
    if (error == -ENOTCONN) {
        r->unleased++;
    } else if (error == -EHOSTDOWN) {
        r->hung++;
    } else if (error == -EAGAIN) {
        r->full++;
    } else {
        r->broken++;
    }
}

/* CLOCK_MONOTONIC is read first: if the thread stands still between both readings, the command gets
 * older, never newer. */
static void take_twist(receiver *r, const uint8_t *raw, size_t bytes, uint64_t writer)
{
    stamped_twist twist;
    double age_s = 0.0;
    int64_t now_ns = clock_now_ns();
    int refusal = twist_parse(raw, bytes, &twist);
    refusal = refusal != 0 ? refusal : stamp_age(twist.stamp_s, wall_s(), &age_s);
    if (refusal != 0) {
        r->refused[refusal - 1]++;
        return;
    }
    int error =
        outlet_send_direct(&r->out, &twist, writer, now_ns - (int64_t)(age_s * 1e9), now_ns);
    if (error != 0) {
        count_lost(r, error);
        return;
    }
    received_twist received = {.writer = writer,
                               .taken_ns = now_ns,
                               .linear_m_s = twist.linear_m_s,
                               .angular_rad_s = twist.angular_rad_s,
                               .lateral_m_s = twist.lateral_m_s};
    (void)ring_put(&r->received, r->received_place, RECEIVED_TWISTS_MAX, &received,
                   sizeof received);
    r->taken_ns = now_ns;
    r->taken++;
}

static void take_sample(receiver *r, const struct ddsi_serdata *data, uint64_t writer)
{
    uint32_t bytes = dds.serdata_size(data);
    if (bytes > sizeof r->raw) {
        r->refused[TWIST_NOT_ONE]++;
        return;
    }
    dds.serdata_to_ser(data, 0, bytes, r->raw);
    take_twist(r, r->raw, bytes, writer);
}

static void notify(const receiver *r)
{
    const uint64_t one = 1;
    if (write(r->event_fd, &one, sizeof one) < 0) {
        return; /* full: it was notified before */
    }
}

/* Cyclone calls this for one thread at a time. */
static void take_all(int32_t reader, void *arg)
{
    receiver *r = arg;
    struct ddsi_serdata *data[TAKEN_AT_ONCE];
    dds_sample_info info[TAKEN_AT_ONCE];
    int32_t count = TAKEN_AT_ONCE;
    while (count == TAKEN_AT_ONCE) {
        count = dds.takecdr(reader, data, TAKEN_AT_ONCE, info, ANY_STATE);
        for (int32_t i = 0; i < count; i++) {
            if (info[i].valid_data) {
                take_sample(r, data[i], info[i].publication_handle);
            }
            dds.serdata_unref(data[i]);
        }
        if (count < 0) {
            r->error = count;
        }
        if (count != 0) {
            notify(r);
        }
    }
}

/* ----------------------------------------------------------------------------- its life */
static receiver *numbered(int number)
{
    bool claimed = number >= 0 && number < RECEIVERS_MAX && receivers[number].claimed;
    return claimed ? &receivers[number] : NULL;
}

int receiver_claim(void)
{
    for (int number = 0; number < RECEIVERS_MAX; number++) {
        bool free_now = false;
        if (atomic_compare_exchange_strong(&receivers[number].claimed, &free_now, true)) {
            receiver *r = &receivers[number];
            outlet_init(&r->out);
            memset(&r->received, 0, sizeof r->received);
            r->taken = r->unleased = r->hung = r->full = r->broken = 0;
            for (uint32_t kind = 0; kind < TWIST_REFUSALS; kind++) {
                r->refused[kind] = 0;
            }
            return number;
        }
    }
    return -EBUSY;
}

void receiver_release(int number)
{
    receiver *r = numbered(number);
    if (r != NULL && !r->running) {
        r->claimed = false;
    }
}

static int32_t listen(receiver *r)
{
    struct dds_listener *listener = dds.create_listener(r);
    if (listener == NULL) {
        return -ENOMEM;
    }
    dds.lset_data_available(listener, take_all);
    int32_t error = dds.set_listener(r->reader, listener); /* set_listener makes a copy */
    dds.delete_listener(listener);
    return error;
}

int receiver_start(int number, int32_t reader, int event_fd)
{
    receiver *r = numbered(number);
    if (r == NULL || dds.serdata_unref == NULL) {
        return -EINVAL;
    }
    if (r->running) {
        return -EBUSY;
    }
    r->reader = reader;
    r->event_fd = event_fd;
    r->error = 0;
    int32_t error = listen(r);
    r->running = error == 0;
    return error;
}

int receiver_stop(int number)
{
    receiver *r = numbered(number);
    if (r == NULL || !r->running) {
        return -ESRCH;
    }
    (void)dds.set_listener(r->reader, NULL); /* set_listener waits for a call in progress */
    r->running = false;
    return 0;
}

void receiver_read(int number, receiver_report *out)
{
    const receiver *r = numbered(number);
    *out = (receiver_report){.running = 0};
    if (r != NULL) {
        *out = (receiver_report){.running = r->running && r->error == 0,
                                 .error = r->error,
                                 .taken = r->taken,
                                 .taken_ns = r->taken_ns,
                                 .unleased = r->unleased,
                                 .hung = r->hung,
                                 .full = r->full,
                                 .broken = r->broken};
        for (uint32_t kind = 0; kind < TWIST_REFUSALS; kind++) {
            out->refused[kind] = r->refused[kind];
        }
    }
}

int receiver_take_received(int number, received_twist *out, int room)
{
    receiver *r = numbered(number);
    int count = 0;
    while (
        r != NULL && count < room &&
        ring_take(&r->received, r->received_place, RECEIVED_TWISTS_MAX, &out[count], sizeof *out)) {
        count++;
    }
    return count;
}

/* ---------------------------------------------------------------------------- its lease */
void receiver_alive(int number)
{
    receiver *r = numbered(number);
    if (r != NULL) {
        outlet_alive(&r->out, clock_now_ns());
    }
}

void receiver_hold(int number, int fd, const uint8_t *token, uint64_t sequence)
{
    receiver *r = numbered(number);
    if (r != NULL) {
        outlet_hold(&r->out, fd, token, sequence);
    }
}

uint64_t receiver_let_go(int number)
{
    receiver *r = numbered(number);
    return r != NULL ? outlet_let_go(&r->out) : 0;
}

uint64_t receiver_direct(int number)
{
    receiver *r = numbered(number);
    return r != NULL ? outlet_direct(&r->out) : 0;
}

int receiver_send(int number, void *datagram, size_t bytes, int64_t seen)
{
    receiver *r = numbered(number);
    return r != NULL ? outlet_send(&r->out, datagram, bytes, seen) : -ENOTCONN;
}
