/* SPDX-License-Identifier: Apache-2.0 */
#include "ingress.h"

#include <errno.h>
#include <poll.h>
#include <sys/socket.h>
#include <time.h>

enum { DATAGRAMS_A_SOCKET = 16 };

static const int64_t NS_PER_S = 1000000000;

bool ingress_wait(const ingress *in, int64_t until_ns)
{
    struct pollfd fds[COMMAND_SOCKETS];
    for (uint32_t i = 0; i < COMMAND_SOCKETS; i++) {
        fds[i] = (struct pollfd){.fd = in->fd[i], .events = POLLIN};   /* poll passes over a descriptor of -1 */
    }
    for (int64_t left_ns = until_ns - clock_now_ns(); left_ns > 0; left_ns = until_ns - clock_now_ns()) {
        struct timespec left = {.tv_sec = left_ns / NS_PER_S, .tv_nsec = left_ns % NS_PER_S};
        if (ppoll(fds, COMMAND_SOCKETS, &left, NULL) > 0) {
            return true;
        }
    }
    return false;
}

uint32_t ingress_take(const ingress *in, arbiter *a, bool may_move)
{
    uint32_t taken = 0;
    for (uint32_t i = 0; i < COMMAND_SOCKETS; i++) {
        for (uint32_t n = 0; in->fd[i] >= 0 && n < DATAGRAMS_A_SOCKET; n++) {
            uint8_t datagram[JOINT_COMMAND_BYTES + 1];   /* one more shows what is too long */
            ssize_t bytes = recv(in->fd[i], datagram, sizeof datagram, MSG_DONTWAIT);
            if (bytes < 0) {
                break;
            }
            (void)arbiter_submit(a, datagram, (size_t)bytes, clock_now_ns(), may_move);
            taken++;
        }
    }
    return taken;
}
