/* SPDX-License-Identifier: Apache-2.0
 * bus.h: the C part of the second process: bus_twist.c decodes messages, bus_outlet.c sends under a
 * lease, bus_receiver.c waits for DDS. The daemon does not contain them. */
#ifndef MOTORD_BUS_H
#define MOTORD_BUS_H

#include <pthread.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "api_bus.h"

static const int64_t OUTLET_ALIVE_NS = INT64_C(2000000000);
/* Numbers of the writers of the receiver's topic, among the senders of a lease. Python gives the
 * numbers below to its own (PLACES of senders.py). A writer keeps its number for OUTLET_KEPT_NS
 * after its newest command. */
enum { OUTLET_SENDERS_FROM = 16, OUTLET_SENDERS = 15 };
static const int64_t OUTLET_KEPT_NS = INT64_C(600000000000);

typedef struct {
    uint64_t writer;
    int64_t newest_ns; /* 0: the place is free */
} outlet_sender;

/* The sender under one lease, for several threads. */
typedef struct {
    pthread_mutex_t lock;
    int fd; /* connected socket; -1: no lease */
    uint8_t token[LEASE_TOKEN_BYTES];
    uint64_t sequence;
    uint64_t direct;
    int64_t alive_ns; /* time when Python was last alive */
    outlet_sender sender[OUTLET_SENDERS];
} outlet;

void outlet_init(outlet *o);
void outlet_hold(outlet *o, int fd, const uint8_t *token, uint64_t sequence);
uint64_t outlet_let_go(outlet *o);
uint64_t outlet_direct(outlet *o);
/* Implements receiver_send. */
int outlet_send(outlet *o, void *datagram, size_t bytes, int64_t seen);
/* Note that Python's event loop runs. */
void outlet_alive(outlet *o, int64_t now_ns);
/* Send a twist of a writer of the receiver's own, counted in `direct` when it was sent. Returns
 * -EHOSTDOWN if Python has stood still for OUTLET_ALIVE_NS: a stop request by ROS 2 would not be
 * handled. The lease then lapses, and the wheels come to rest. */
int outlet_send_direct(outlet *o, const stamped_twist *twist, uint64_t writer, int64_t stamp_ns,
                       int64_t now_ns);

#endif
