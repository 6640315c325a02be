/* SPDX-License-Identifier: Apache-2.0
 * bus.h: what the second process has of C: bus_twist.c knows messages, bus_outlet.c sends under a lease, bus_receiver.c
 * waits for DDS. Nothing of them is in the daemon. */
#ifndef MOTORD_BUS_H
#define MOTORD_BUS_H

#include <pthread.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "api_bus.h"

/* The sender of one lease, for several threads. */
typedef struct {
    pthread_mutex_t lock;
    int fd;                     /* connected; -1: there is no lease */
    uint8_t token[LEASE_TOKEN_BYTES];
    uint64_t sequence;
    uint64_t direct;
} outlet;

void outlet_init(outlet *o);
void outlet_hold(outlet *o, int fd, const uint8_t *token, uint64_t sequence);
uint64_t outlet_let_go(outlet *o);
uint64_t outlet_direct(outlet *o);
/* As receiver_send. */
int outlet_send(outlet *o, void *datagram, size_t bytes, int64_t seen);
/* A twist of the receiver's own: counted in `direct` when it was sent. */
int outlet_send_direct(outlet *o, const stamped_twist *twist, int64_t stamp_ns);

#endif
