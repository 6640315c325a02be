/* SPDX-License-Identifier: Apache-2.0
 * Two threads command under one lease while the lease changes: the daemon sees the sequence numbers
 * of each lease grow. A thread that holds the lock has the priority of the thread that waits for
 * it. */
#include <errno.h>
#include <poll.h>
#include <pthread.h>
#include <sched.h>
#include <string.h>
#include <sys/socket.h>
#include <unistd.h>

#include "bus.h"
#include "check.h"
#include "rt.h"

enum { COMMANDS = 3000, LEASES = 40 };

static outlet shared;
static int pairs[LEASES][2];
static _Atomic int senders = 2;

/* Sends like the receiver's thread, or like Python. No command is lost while there is a lease. */
static void *commands(void *direct)
{
    command_datagram own = {
        .magic = COMMAND_MAGIC, .version = COMMAND_VERSION, .kind = COMMAND_TWIST};
    for (int n = 0; n < COMMANDS;) {
        int error = direct != NULL
                        ? outlet_send_direct(&shared, &(stamped_twist){.linear_m_s = 1.0}, 1, 1, 1)
                        : outlet_send(&shared, &own, sizeof own, -1);
        CHECK(error == 0 || error == -EAGAIN || error == -ENOTCONN);
        n += error == 0;
        (void)sched_yield();
    }
    senders--;
    return NULL;
}

static int received(int lease, uint64_t *sequence)
{
    command_datagram one;
    int count = 0;
    while (recv(pairs[lease][1], &one, sizeof one, MSG_DONTWAIT) == sizeof one) {
        CHECK(one.token[0] == lease && one.sequence > *sequence);
        *sequence = one.sequence;
        count++;
    }
    return count;
}

/* Returns the priority of this thread in the scheduler: negative if it is a real-time priority, its
 * own or an inherited one. */
static int priority(void)
{
    FILE *file = fopen("/proc/thread-self/stat", "r");
    int found = 0;
    CHECK(file != NULL &&
          fscanf(file,
                 "%*d (%*[^)]) %*c %*d %*d %*d %*d %*d %*u %*u %*u %*u %*u %*u %*u %*d %*d %d",
                 &found) == 1);
    CHECK(fclose(file) == 0);
    return found;
}

static void *waits_for_the_lock(void *of)
{
    (void)outlet_direct(of);
    return NULL;
}

static void a_thread_that_holds_the_lock_of_a_higher_one_has_its_priority(void)
{
    outlet o;
    pthread_t thread;
    pthread_attr_t attr;
    outlet_init(&o);
    CHECK(pthread_attr_init(&attr) == 0 &&
          pthread_attr_setinheritsched(&attr, PTHREAD_EXPLICIT_SCHED) == 0);
    CHECK(pthread_attr_setschedpolicy(&attr, SCHED_FIFO) == 0);
    CHECK(pthread_attr_setschedparam(&attr, &(struct sched_param){.sched_priority = 1}) == 0);
    CHECK(priority() >= 0 && pthread_mutex_lock(&o.lock) == 0);
    int error = pthread_create(&thread, &attr, waits_for_the_lock, &o);
    if (error == EPERM) {
        fprintf(stderr,
                "bus_threads: no right to real-time priorities: the lent one is not tested\n");
    } else {
        CHECK(error == 0);
        for (int tries = 0; priority() >= 0; tries++) {
            CHECK(tries < 10000);
            (void)poll(NULL, 0, 1);
        }
    }
    CHECK(pthread_mutex_unlock(&o.lock) == 0 && priority() >= 0);
    CHECK(error != 0 || pthread_join(thread, NULL) == 0);
    (void)pthread_attr_destroy(&attr);
}

int main(void)
{
    a_thread_that_holds_the_lock_of_a_higher_one_has_its_priority();
    pthread_t thread[2];
    uint8_t token[LEASE_TOKEN_BYTES] = {0};
    int came = 0;
    outlet_init(&shared);
    for (int lease = 0; lease < LEASES; lease++) {
        CHECK(socketpair(AF_UNIX, SOCK_DGRAM, 0, pairs[lease]) == 0);
    }
    CHECK(pthread_create(&thread[0], NULL, commands, NULL) == 0);
    CHECK(pthread_create(&thread[1], NULL, commands, &shared) == 0);
    for (int lease = 0; lease < LEASES; lease++) {
        uint64_t sequence = 0;
        bool last = lease == LEASES - 1;
        token[0] = (uint8_t)lease;
        outlet_hold(&shared, pairs[lease][0], token, 0);
        for (int turn = 0; last ? senders > 0 : turn < 50; turn++) {
            came += received(lease, &sequence);
            (void)sched_yield();
        }
        uint64_t newest = outlet_let_go(&shared);
        came += received(lease, &sequence);
        CHECK(sequence <= newest);
    }
    CHECK(pthread_join(thread[0], NULL) == 0 && pthread_join(thread[1], NULL) == 0);
    CHECK(came == 2 * COMMANDS && outlet_direct(&shared) == COMMANDS);
    return checks_report("bus_threads");
}
