/* SPDX-License-Identifier: Apache-2.0 */
#include "ingress.h"

#include <poll.h>
#include <string.h>
#include <sys/epoll.h>
#include <sys/socket.h>
#include <time.h>

enum { DATAGRAMS_A_SOCKET = 8, STOPS_A_TICK = 64 };

static const int64_t NS_PER_S = 1000000000;

bool ingress_wait(const ingress *in, int64_t until_ns)
{
    /* the timeout of epoll_wait itself is in milliseconds */
    struct pollfd any = {.fd = in->epoll_fd, .events = POLLIN};
    for (int64_t left_ns = until_ns - clock_now_ns(); left_ns > 0;
         left_ns = until_ns - clock_now_ns()) {
        struct timespec left = {.tv_sec = left_ns / NS_PER_S, .tv_nsec = left_ns % NS_PER_S};
        if (ppoll(&any, 1, &left, NULL) > 0) {
            return true;
        }
    }
    return false;
}

static uint32_t take_from(int fd, arbiter *a, bool may_move)
{
    uint32_t taken = 0;
    while (taken < DATAGRAMS_A_SOCKET) {
        uint8_t datagram[JOINT_POSITION_BYTES + 1]; /* one more byte shows a datagram that is too
                                                       long */
        ssize_t bytes = recv(fd, datagram, sizeof datagram, MSG_DONTWAIT);
        if (bytes < 0) {
            break;
        }
        (void)arbiter_submit(a, datagram, (size_t)bytes, clock_now_ns(), may_move);
        taken++;
    }
    return taken;
}

uint32_t ingress_take(const ingress *in, arbiter *a, bool may_move)
{
    struct epoll_event ready[COMMAND_SOCKETS];
    int count = in->epoll_fd < 0 ? 0 : epoll_wait(in->epoll_fd, ready, COMMAND_SOCKETS, 0);
    uint32_t taken = 0;
    for (int i = 0; i < count; i++) {
        if (ready[i].data.fd != in->stop_fd) {
            taken += take_from(ready[i].data.fd, a, may_move);
        }
    }
    return taken;
}

/* Receive a stop request. Owner, group and mode of the socket's file decide which programs may
 * send; the kernel checks them for each datagram. The credentials only name the sender. There is
 * room for them alone: the kernel drops descriptors in a message. */
static ssize_t receive(int fd, void *datagram, size_t bytes, int32_t *pid)
{
    union {
        char bytes[CMSG_SPACE(sizeof(struct ucred))];
        struct cmsghdr aligned;
    } control;
    struct iovec place = {.iov_base = datagram, .iov_len = bytes};
    struct msghdr message = {.msg_iov = &place,
                             .msg_iovlen = 1,
                             .msg_control = control.bytes,
                             .msg_controllen = sizeof control.bytes};
    ssize_t received = recvmsg(fd, &message, MSG_DONTWAIT);
    const struct cmsghdr *first = received >= 0 ? CMSG_FIRSTHDR(&message) : NULL;
    *pid = 0;
    if (first != NULL && first->cmsg_level == SOL_SOCKET && first->cmsg_type == SCM_CREDENTIALS) {
        struct ucred sender;
        memcpy(&sender, CMSG_DATA(first), sizeof sender);
        *pid = sender.pid;
    }
    return received;
}

uint32_t ingress_take_stops(const ingress *in, stop_requests *stops)
{
    uint32_t taken = 0;
    while (in->stop_fd >= 0 && taken < STOPS_A_TICK) {
        stop_request request;
        uint8_t datagram[STOP_REQUEST_BYTES + 1] = {0}; /* one more byte shows a datagram that is
                                                           too long */
        int32_t pid;
        ssize_t bytes = receive(in->stop_fd, datagram, sizeof datagram, &pid);
        if (bytes < 0) {
            break;
        }
        memcpy(&request, datagram, sizeof request);
        bool good = bytes == STOP_REQUEST_BYTES && request.magic == STOP_REQUEST_MAGIC &&
                    request.version == STOP_REQUEST_VERSION && request.kind < STOP_REQUEST_KINDS;
        if (good) {
            stops->pid = pid;
            stops->count[request.kind]++;
        } else {
            stops->refused++;
        }
        taken++;
    }
    return taken;
}
