/* SPDX-License-Identifier: Apache-2.0
 * ingress.h: commands and stop requests from datagram sockets, and the loop's wait for them. */
#ifndef MOTORD_INGRESS_H
#define MOTORD_INGRESS_H

#include <stdatomic.h>

#include "rt.h"

typedef struct {
    int epoll_fd; /* of datagram sockets, epoll(7); -1: no sockets */
    int stop_fd;  /* -1: none */
} ingress;

typedef struct {
    _Atomic uint64_t count[STOP_REQUEST_KINDS];
    _Atomic uint64_t acknowledged[STOP_REQUEST_KINDS];
    _Atomic uint64_t refused;
    _Atomic int32_t pid;
} stop_requests;

/* Waits until the time, or until a datagram is there: true. */
bool ingress_wait(const ingress *in, int64_t until_ns);
/* Judges waiting datagrams, a bounded number from each socket, so that no source blocks another;
 * returns how many there were. */
uint32_t ingress_take(const ingress *in, arbiter *a, bool may_move);
/* Counts waiting stop requests, a bounded number, too; returns how many there were. */
uint32_t ingress_take_stops(const ingress *in, stop_requests *stops);

#endif
