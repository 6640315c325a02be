/* SPDX-License-Identifier: Apache-2.0 */
#include "ingress.h"

#include <poll.h>
#include <sys/epoll.h>
#include <sys/socket.h>
#include <time.h>

enum { DATAGRAMS_A_SOCKET = 8 };

static const int64_t NS_PER_S = 1000000000;

bool ingress_wait(const ingress *in, int64_t until_ns)
{
    struct pollfd any = {.fd = in->epoll_fd, .events = POLLIN};   /* epoll_wait itself counts in milliseconds */
    for (int64_t left_ns = until_ns - clock_now_ns(); left_ns > 0; left_ns = until_ns - clock_now_ns()) {
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
        uint8_t datagram[JOINT_COMMAND_BYTES + 1];   /* one more shows what is too long */
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
        taken += take_from(ready[i].data.fd, a, may_move);
    }
    return taken;
}
