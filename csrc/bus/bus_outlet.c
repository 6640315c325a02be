/* SPDX-License-Identifier: Apache-2.0
 * bus_outlet.c: sends under a lease, from several threads. The daemon accepts only growing numbers,
 * so a number is taken and sent under one lock; a new lease comes between two commands. */
#include "bus.h"

#include <errno.h>
#include <string.h>
#include <sys/socket.h>

#include "rt.h"

/* The lock inherits priority: while the receiver waits for it, the Python thread that holds it runs
 * at the receiver's priority. On a kernel without such locks it is an ordinary one. */
void outlet_init(outlet *o)
{
    pthread_mutexattr_t lends;
    *o = (outlet){.fd = -1};
    (void)pthread_mutexattr_init(&lends);
    (void)pthread_mutexattr_setprotocol(&lends, PTHREAD_PRIO_INHERIT);
    (void)pthread_mutex_init(&o->lock, &lends);
    (void)pthread_mutexattr_destroy(&lends);
}

void outlet_hold(outlet *o, int fd, const uint8_t *token, uint64_t sequence)
{
    (void)pthread_mutex_lock(&o->lock);
    o->fd = fd;
    memcpy(o->token, token, sizeof o->token);
    o->sequence = sequence;
    (void)pthread_mutex_unlock(&o->lock);
}

uint64_t outlet_let_go(outlet *o)
{
    (void)pthread_mutex_lock(&o->lock);
    o->fd = -1;
    uint64_t sequence = o->sequence;
    (void)pthread_mutex_unlock(&o->lock);
    return sequence;
}

uint64_t outlet_direct(outlet *o)
{
    (void)pthread_mutex_lock(&o->lock);
    uint64_t direct = o->direct;
    (void)pthread_mutex_unlock(&o->lock);
    return direct;
}

/* The caller holds the lock. A twist and a command of wheels have the same head. */
static int send_numbered(outlet *o, void *datagram, size_t bytes)
{
    uint64_t sequence = ++o->sequence;
    memcpy((uint8_t *)datagram + offsetof(command_datagram, token), o->token, sizeof o->token);
    memcpy((uint8_t *)datagram + offsetof(command_datagram, sequence), &sequence, sizeof sequence);
    return send(o->fd, datagram, bytes, MSG_DONTWAIT | MSG_NOSIGNAL) < 0 ? -errno : 0;
}

int outlet_send(outlet *o, void *datagram, size_t bytes, int64_t seen)
{
    if (bytes != COMMAND_BYTES && bytes != JOINT_COMMAND_BYTES && bytes != JOINT_POSITION_BYTES) {
        return -EINVAL;
    }
    (void)pthread_mutex_lock(&o->lock);
    bool overtaken = seen >= 0 && (uint64_t)seen != o->direct;
    int error = o->fd < 0 ? -ENOTCONN : overtaken ? -ESTALE : send_numbered(o, datagram, bytes);
    (void)pthread_mutex_unlock(&o->lock);
    return error;
}

void outlet_alive(outlet *o, int64_t now_ns)
{
    (void)pthread_mutex_lock(&o->lock);
    o->alive_ns = now_ns;
    (void)pthread_mutex_unlock(&o->lock);
}

/* Return the number of a writer among the senders of the lease. More writers than there are numbers
 * count as those that cannot be distinguished. The caller holds the lock. */
static uint32_t sender_of(outlet *o, uint64_t writer, int64_t now_ns)
{
    uint32_t place = 0;
    for (uint32_t i = 0; i < OUTLET_SENDERS; i++) {
        if (o->sender[i].newest_ns != 0 && o->sender[i].writer == writer) {
            o->sender[i].newest_ns = now_ns;
            return OUTLET_SENDERS_FROM + i;
        }
        place = o->sender[i].newest_ns < o->sender[place].newest_ns ? i : place;
    }
    outlet_sender *oldest = &o->sender[place];
    if (oldest->newest_ns != 0 && now_ns - oldest->newest_ns < OUTLET_KEPT_NS) {
        return SENDER_UNNAMED;
    }
    *oldest = (outlet_sender){.writer = writer, .newest_ns = now_ns};
    return OUTLET_SENDERS_FROM + place;
}

int outlet_send_direct(outlet *o, const stamped_twist *twist, uint64_t writer, int64_t stamp_ns,
                       int64_t now_ns)
{
    command_datagram datagram = {
        .magic = COMMAND_MAGIC,
        .version = COMMAND_VERSION,
        .kind = COMMAND_TWIST,
        .stamp_ns = stamp_ns,
        .linear_m_s = twist->linear_m_s,
        .lateral_m_s = twist->lateral_m_s,
        .angular_rad_s = twist->angular_rad_s,
    };
    (void)pthread_mutex_lock(&o->lock);
    datagram.kind |= (uint16_t)(sender_of(o, writer, now_ns) << SENDER_SHIFT);
    bool hangs = now_ns - o->alive_ns > OUTLET_ALIVE_NS;
    int error = o->fd < 0 ? -ENOTCONN
                : hangs   ? -EHOSTDOWN
                          : send_numbered(o, &datagram, sizeof datagram);
    o->direct += error == 0;
    (void)pthread_mutex_unlock(&o->lock);
    return error;
}
