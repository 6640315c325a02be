/* SPDX-License-Identifier: Apache-2.0
 * ingress.h: commands and stop requests from datagram sockets, and the loop's wait for them. */
#ifndef MOTORD_INGRESS_H
#define MOTORD_INGRESS_H

#include <stdatomic.h>

#include "rt.h"

typedef struct {
    int epoll_fd; /* an epoll(7) of datagram sockets; -1: no sockets */
    int stop_fd;  /* -1: no socket */
} ingress;

typedef struct {
    _Atomic uint64_t count[STOP_REQUEST_KINDS];
    _Atomic uint64_t acknowledged[STOP_REQUEST_KINDS];
    _Atomic uint64_t refused;
    _Atomic int32_t pid;
} stop_requests;

/* Wait until the time, or until a datagram has come. True: it has. */
bool ingress_wait(const ingress *in, int64_t until_ns);
/* Take waiting datagrams, a limited number from each socket, so that no source blocks another.
 * Returns their number. */
uint32_t ingress_take(const ingress *in, arbiter *a, bool may_move);
/* Count waiting stop requests, a limited number, too. Returns their number. */
uint32_t ingress_take_stops(const ingress *in, stop_requests *stops);

#endif
