/* SPDX-License-Identifier: Apache-2.0
 *
 * api_bus.h: the border of `_motord_bus`, which the second process loads: commands from DDS to the
 * daemon's datagrams, without Python. Like api.h: typedefs, enums, comments and prototypes, no
 * preprocessor line.
 */

enum { RECEIVERS_MAX = 4, RECEIVED_TWISTS_MAX = 64, TWIST_RAW_MAX = 4096, LEASE_TOKEN_BYTES = 16 };

/* ----------------------------------------------------------- geometry_msgs/TwistStamped */
typedef struct {
    double stamp_s; /* wall time of its header */
    double linear_m_s;
    double angular_rad_s;
    double lateral_m_s;
} stamped_twist;

typedef enum {
    TWIST_NOT_ONE = 0, /* another encoding, too short, or longer than TWIST_RAW_MAX */
    TWIST_STAMP_ZERO = 1,
    TWIST_STAMP_AHEAD = 2, /* by more than half a second: the sender's clock is wrong */
    TWIST_REFUSALS = 3
} twist_refusal;

/* CDR with its header, of either byte order. 0, or 1 + TWIST_NOT_ONE. NaN and infinity pass: the
 * loop takes them for zero. */
int twist_parse(const uint8_t *raw, size_t bytes, stamped_twist *out);
/* Age of what was given at that wall time: 0 to 3600 s, whatever is older is as old. 0, or 1 +
 * twist_refusal. The rule of motord/bus/commands/gate.py, once more:
 * tests/unit/bus/test_bus_receiver.py holds the two together. */
int stamp_age(double stamp_s, double wall_s, double *age_s);

/* ----------------------------------------------------------------------------------- receivers
 * Each takes what one DDS reader receives, in the thread of Cyclone that received it, and is the
 * sender of one lease: its own commands and Python's go out under the same token, numbered by
 * it. */
typedef struct {
    uint64_t taken; /* commands that the daemon's socket took from it */
    uint64_t refused[TWIST_REFUSALS];
    uint64_t unleased; /* lost: there was no lease */
    uint64_t hung;     /* lost: Python's event loop stood still */
    uint64_t full;     /* lost: the socket was full */
    uint64_t broken;   /* lost: the socket did not take it */
    int64_t taken_ns;  /* when the newest was, CLOCK_MONOTONIC */
    int32_t error;     /* of DDS, negative; 0: none */
    uint32_t running;
} receiver_report;

/* The sender of a command that was taken. */
typedef struct {
    uint64_t writer; /* DDS's publication handle */
    int64_t taken_ns;
    double linear_m_s;
    double angular_rad_s;
    double lateral_m_s;
} received_twist;

/* The C library of Cyclone DDS, by path. 0 or -ELIBACC: not there, or without a function that is
 * needed. */
int receiver_library(const char *path);
/* Number of a receiver that is free, or -EBUSY. */
int receiver_claim(void);
/* Frees a receiver that was stopped, or never started. */
void receiver_release(int number);
/* `reader`: the DDS entity. `event_fd`: written when commands have come. 0, -errno, or the error of
 * DDS, negative. */
int receiver_start(int number, int32_t reader, int event_fd);
/* After its return nothing is taken any more. 0, -ESRCH: it does not run. */
int receiver_stop(int number);
void receiver_read(int number, receiver_report *out);
/* The oldest commands that were sent and not read yet, at most `room`. Returns how many. A full
 * ring drops new ones. */
int receiver_take_received(int number, received_twist *out, int room);

/* Python's event loop is alive: without this call for 2 s no command is sent from DDS. */
void receiver_alive(int number);
/* A lease: its connected socket, its token, and the number of its newest command. */
void receiver_hold(int number, int fd, const uint8_t *token, uint64_t sequence);
/* Ends the lease; returns the number of its newest command. The socket is not used any more. */
uint64_t receiver_let_go(int number);
/* Commands from DDS that were sent under any lease so far. */
uint64_t receiver_direct(int number);
/* A datagram of docs/commands.md; its token and its sequence are filled in. `seen` >= 0: only if
 * receiver_direct() is that still. 0, -ENOTCONN: no lease, -ESTALE: no, -EAGAIN: full, -errno. */
int receiver_send(int number, void *datagram, size_t bytes, int64_t seen);
