/* SPDX-License-Identifier: Apache-2.0
 *
 * api_bus.h: the border of `_motord_bus`, which the second process loads. It passes commands from
 * DDS to the daemon as datagrams, without Python. Like api.h: typedefs, enums, comments and
 * prototypes, no preprocessor line. */

enum { RECEIVERS_MAX = 4, RECEIVED_TWISTS_MAX = 64, TWIST_RAW_MAX = 4096, LEASE_TOKEN_BYTES = 16 };

/* ----------------------------------------------------------- geometry_msgs/TwistStamped */
typedef struct {
    double stamp_s; /* wall time in the message's header */
    double linear_m_s;
    double angular_rad_s;
    double lateral_m_s;
} stamped_twist;

typedef enum {
    TWIST_NOT_ONE = 0, /* no twist: another encoding, too short, or longer than TWIST_RAW_MAX */
    TWIST_STAMP_ZERO = 1,
    TWIST_STAMP_AHEAD = 2, /* more than half a second in the future: the sender's clock is wrong */
    TWIST_REFUSALS = 3
} twist_refusal;

/* Decode CDR with its header, of either byte order. Returns 0, or 1 + TWIST_NOT_ONE. NaN and
 * infinity pass: the loop takes them for zero. */
int twist_parse(const uint8_t *raw, size_t bytes, stamped_twist *out);
/* Compute the age of a message with that wall time: 0 to 3600 s; older ones count as 3600 s.
 * Returns 0, or 1 + twist_refusal. motord/bus/commands/gate.py has the same rule:
 * tests/unit/bus/test_bus_receiver.py compares both. */
int stamp_age(double stamp_s, double wall_s, double *age_s);

/* ----------------------------------------------------------------------------------- receivers
 * Each receiver takes the messages of one DDS reader, in the thread of Cyclone that received them,
 * and sends under one lease: its own commands and Python's go out with the same token and are
 * numbered together. */
typedef struct {
    uint64_t taken; /* commands that the daemon's socket accepted from it */
    uint64_t refused[TWIST_REFUSALS];
    uint64_t unleased; /* lost: there was no lease */
    uint64_t hung;     /* lost: Python's event loop did not run */
    uint64_t full;     /* lost: the socket was full */
    uint64_t broken;   /* lost: the socket did not accept it */
    int64_t taken_ns;  /* CLOCK_MONOTONIC of the newest accepted command */
    int32_t error;     /* DDS error, negative; 0: no error */
    uint32_t running;
} receiver_report;

/* A command that was accepted, and its sender. */
typedef struct {
    uint64_t writer; /* DDS's publication handle */
    int64_t taken_ns;
    double linear_m_s;
    double angular_rad_s;
    double lateral_m_s;
} received_twist;

/* Load the C library of Cyclone DDS from a path. Returns 0 or -ELIBACC: it is missing, or lacks a
 * needed function. */
int receiver_library(const char *path);
/* Claim a free receiver. Returns its number, or -EBUSY. */
int receiver_claim(void);
/* Free a receiver that was stopped, or never started. */
void receiver_release(int number);
/* Start a receiver. `reader` is the DDS entity; `event_fd` is written when commands have come.
 * Returns 0, -errno, or the error of DDS, negative. */
int receiver_start(int number, int32_t reader, int event_fd);
/* Stop a receiver: nothing is accepted after the return. Returns 0, or -ESRCH: it does not run. */
int receiver_stop(int number);
void receiver_read(int number, receiver_report *out);
/* Read the oldest sent commands that were not read yet, at most `room`. Returns their number. A
 * full ring drops new ones. */
int receiver_take_received(int number, received_twist *out, int room);

/* Note that Python's event loop runs: 2 s after this call no command from DDS is sent any more. */
void receiver_alive(int number);
/* Begin a lease: its connected socket, its token, and the number of its newest command. */
void receiver_hold(int number, int fd, const uint8_t *token, uint64_t sequence);
/* End the lease. Returns the number of its newest command. The socket is not used any more. */
uint64_t receiver_let_go(int number);
/* Return the number of commands from DDS that were sent under any lease so far. */
uint64_t receiver_direct(int number);
/* Send a datagram of docs/commands.md, with token and sequence filled in. `seen` >= 0: only if
 * receiver_direct() still returns it. Returns 0, -ENOTCONN: no lease, -ESTALE: `seen` differs,
 * -EAGAIN: full, or -errno. */
int receiver_send(int number, void *datagram, size_t bytes, int64_t seen);
