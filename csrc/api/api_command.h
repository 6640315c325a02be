/* SPDX-License-Identifier: Apache-2.0
 *
 * api_command.h: the part of the border through which commands come in. Read after api.h, and like
 * it: typedefs, enums, comments and prototypes, no preprocessor line. */

/* ------------------------------------------------------------------------------------ commands
 * The loop's thread decides which source commands, by the same rules for every source: a command is
 * a datagram under a lease. Python starts and ends leases; which of them is in command, and whether
 * it may move anything, is decided here. */
enum { LEASES_MAX = 16, TOKEN_BYTES = 16, COMMAND_MAGIC = 0x434D544D };
enum { COMMAND_VERSION = 2, COMMAND_VERSION_PLANE = 1, COMMAND_VERSION_POSITIONS = 3 };
enum { POSITIONS_CLAMP = 0x40000000 };
enum {
    COMMAND_BYTES = 72,
    COMMAND_BYTES_PLANE = 64,
    JOINT_COMMAND_BYTES = 112,
    JOINT_POSITION_BYTES = 184
};

typedef enum { COMMAND_TWIST = 1, COMMAND_RELEASE = 2, COMMAND_JOINTS = 3 } command_kind;

/* Several senders may share a lease, for example the clients of one server. Their commands name
 * them in the upper byte of `kind`. 0: the lease has one sender. SENDER_UNNAMED: one of several
 * that the program cannot distinguish. */
enum { SENDER_SHIFT = 8, SENDER_UNNAMED = 31, SENDERS_MAX = 32 };

/* A source that has been silent for so long requests nothing any more: no lease lives longer. */
enum { SOURCE_SILENT_S = 5 };

/* One datagram, little-endian like the machine; see docs/commands.md. COMMAND_VERSION_PLANE ends
 * before lateral_m_s, which is 0. */
typedef struct {
    uint32_t magic;             /* COMMAND_MAGIC: "MTMC" */
    uint16_t version;           /* COMMAND_VERSION, or COMMAND_VERSION_PLANE */
    uint16_t kind;              /* command_kind, and the sender << SENDER_SHIFT */
    uint8_t token[TOKEN_BYTES]; /* token of the lease */
    uint64_t sequence;          /* greater than the previous one, modulo 2^64; never 0 */
    int64_t stamp_ns;           /* CLOCK_MONOTONIC when the command was given */
    uint32_t lifetime_ms;       /* 0: that of the lease; a longer one is refused */
    uint32_t reserved;
    double linear_m_s;
    double angular_rad_s;
    double lateral_m_s;
} command_datagram;

/* COMMAND_JOINTS: the same head in either version, and a velocity for each wheel. */
typedef struct {
    uint32_t magic;
    uint16_t version;
    uint16_t kind;
    uint8_t token[TOKEN_BYTES];
    uint64_t sequence;
    int64_t stamp_ns;
    uint32_t lifetime_ms;
    uint32_t joint_count;              /* the robot's */
    double velocity_rad_s[JOINTS_MAX]; /* in the order of the robot file; those beyond joint_count
                                          are ignored */
} joint_datagram;

/* COMMAND_JOINTS in COMMAND_VERSION_POSITIONS: the same, and angles of joints that take positions.
 * A robot with a base accepts no angles; without a base, each joint uses the kind of value that it
 * takes. */
typedef struct {
    joint_datagram head;
    double position_rad[JOINTS_MAX];
    uint32_t velocities; /* bit n: velocity_rad_s[n] is used; else joint n comes to rest */
    uint32_t positions;  /* bit n: position_rad[n] is used; else joint n continues to the position
                            that this lease gave it. POSITIONS_CLAMP: a position beyond the range of
                            its joint means the end of the range */
} joint_position_datagram;

typedef struct {
    uint8_t token[TOKEN_BYTES];
    uint32_t number;           /* grows with each lease of the daemon, from 1; 0: no lease */
    uint32_t priority;         /* the lease with the highest priority commands; among equals the
                                  first */
    int64_t lifetime_ns;       /* longest lifetime of a command under it */
    int64_t interval_least_ns; /* commands that come more often are refused, except zero; 0: no
                                  limit */
    int64_t barred_ns; /* another lease of the owner was held at this time, and has ended: this
                          lease is held from then on, too. Only a later time counts; 0: never */
} lease_permission;

typedef struct {
    lease_permission lease[LEASES_MAX];
    uint64_t releases; /* grows when a person lets all held leases go on */
} lease_permissions;

typedef enum {
    REFUSED_FORM = 0, /* wrong length, magic, version or kind */
    REFUSED_TOKEN = 1,
    REFUSED_SEQUENCE = 2, /* 0, or not greater than the last one */
    REFUSED_AGE = 3,      /* stamp from the future, or older than its lifetime */
    REFUSED_LIFETIME = 4,
    REFUSED_NOT_FINITE = 5, /* not finite: the lease then commands zero */
    REFUSED_JOINTS = 6, /* wrong number of joints, or a command that these joints cannot carry out:
                           the lease then commands zero */
    REFUSED_RATE = 7,   /* more often than the lease allows; the previous command stays in force */
    REFUSED_OUT_OF_RANGE = 8, /* a speed of more than ten times its limit, or a position beyond its
                                 range: the lease then commands zero */
    REFUSAL_KINDS = 9
} command_refusal;

/* The state of a lease. */
typedef struct {
    uint32_t number; /* 0: no lease */
    uint32_t held;   /* its command counts as zero until its sender requests zero, gives the command
                        back, or a person lets it go on; silence alone does not end it */
    uint32_t fresh;  /* a command under it is valid */
    uint32_t priority;
    uint64_t since;    /* order in which the leases became active; among equals the lowest
                          commands */
    uint64_t sequence; /* number of the newest command; 0: no command yet */
    int64_t stamp_ns;
    int64_t expires_ns;
    int64_t taken_ns;    /* time when it came */
    int64_t interval_ns; /* smoothed time between commands; 0: fewer than two have come */
    int64_t due_ns;      /* earliest time of the next command, at the allowed rate */
    int64_t barred_ns;   /* newest barred_ns of its permission that `held` includes; 0: none */
    int64_t held_ns;     /* when the first of its senders that are held was held */
    double linear_m_s;   /* the requested motion */
    double angular_rad_s;
    double lateral_m_s;
    joint_command joints;
    uint32_t wants_motion; /* whether its newest command requests anything but zero */
    uint32_t open;   /* a sender requested motion, and neither zero nor its end since, however long
                        ago */
    uint32_t lapses; /* commands in a row that came after the one before had lapsed unended */
    uint32_t senders_held; /* number of its senders that are held, silent ones included */
} lease_state;

/* A sender under a lease. */
typedef struct {
    int64_t taken_ns;  /* when its newest command came; 0: none has */
    int64_t motion_ns; /* when it requested motion for the last time; 0: never */
    int64_t held_ns;   /* when it was held; 0: it is not held */
    uint32_t open;     /* as that of lease_state */
    uint32_t zero;     /* whether its newest command was zero, or gave the command back */
} sender_state;

typedef struct {
    sender_state sender[SENDERS_MAX];
    uint32_t newest; /* sender of the lease's newest command */
    uint32_t reserved;
} lease_senders;

typedef struct {
    uint32_t commander; /* number of the lease in command; 0: no lease */
    uint32_t may_move;  /* whether a source that requests motion now is not held */
    uint64_t accepted;
    uint64_t refused[REFUSAL_KINDS];
    uint64_t sideways; /* accepted, but without their lateral part: this base cannot move
                          sideways */
    uint64_t on_spot;  /* the same for a turn on the spot */
    lease_state lease[LEASES_MAX];
} command_report;

typedef struct {
    lease_permissions permissions;
    const core_config *base; /* configuration of the commanded joints; NULL: commands of joints are
                                refused */
    /* limits in force now, beside those of `base`; NULL: those of `base` alone */
    const base_limits *limits;
    uint64_t comers;       /* leases that have become active so far */
    int64_t last_stamp_ns; /* stamp of the previous command */
    int64_t resumed_ns;    /* commands from before this time are refused; 0: the computer was never
                              suspended */
    lease_senders senders[LEASES_MAX];
    command_report report;
} arbiter;

/* Set an arbiter up. `base` and `limits` may be NULL; else they must exist as long as the arbiter
 * is used. */
void arbiter_init(arbiter *a, const core_config *base, const base_limits *limits);
/* Start the leases that are new, and end those that are missing; the others continue. */
void arbiter_grant(arbiter *a, const lease_permissions *permissions);
/* Take a command. Returns 0, or 1 + command_refusal. */
int arbiter_submit(arbiter *a, const void *datagram, size_t bytes, int64_t now_ns, bool may_move);
/* The robot was armed: let the senders go on that have been silent for SOURCE_SILENT_S or more. */
void arbiter_arm(arbiter *a, int64_t now_ns);
/* Drop the commands from before a suspend of the computer. */
void arbiter_resume(arbiter *a, int64_t resumed_ns);
/* Decide once a tick, after new commands were submitted, which lease commands, and what. */
void arbiter_command(arbiter *a, int64_t now_ns, bool may_move, twist_command *out);
/* Return, after arbiter_command(), the joint command of that lease, for a robot without a base. */
void arbiter_joints(const arbiter *a, joint_command *out);

/* Return the twist of wheel speeds, twist_u_s[AXES]. False: there is no such twist, because the
 * wheels turn against each other. A speed that is not finite makes the twist not finite. */
bool joints_twist(const core_config *base, const double *velocity_rad_s, double *twist_u_s);

/* Mailboxes of the exchange, like those of api_loop.h. */
/* asyncio → loop */
void exchange_put_permissions(exchange *x, const lease_permissions *permissions);
int exchange_take_permissions(exchange *x, lease_permissions *out);
void exchange_put_commands(exchange *x, const command_report *report); /* loop → asyncio */
int exchange_take_commands(exchange *x, command_report *out);

/* ------------------------------------------------------------------------------- stop requests
 * Datagrams on a separate socket, which the loop reads itself; see docs/commands.md. They can only
 * stop motion. Each is in force from the tick that reads it until asyncio has acknowledged it. */
enum {
    STOP_REQUEST_MAGIC = 0x5153544D,
    STOP_REQUEST_VERSION = 1,
    STOP_REQUEST_BYTES = 8,
    STOP_REQUEST_KINDS = 3
};
typedef enum {
    STOP_REQUEST_STOP = 0, /* come to rest, stay armed */
    STOP_REQUEST_ESTOP = 1,
    STOP_REQUEST_DISARM = 2 /* come to rest, then disarm */
} stop_request_kind;

typedef struct {
    uint32_t magic;   /* STOP_REQUEST_MAGIC: "MTSQ" */
    uint16_t version; /* STOP_REQUEST_VERSION */
    uint16_t kind;    /* stop_request_kind */
} stop_request;

typedef struct {
    uint64_t count[STOP_REQUEST_KINDS]; /* received since the loop started */
    uint64_t refused;                   /* another length, magic, version or kind */
    int32_t pid;                        /* sender of the newest; 0: not known */
    uint32_t reserved;
} stop_request_report;

/* Any thread. Acknowledge up to these counts, after exchange_put_control with levels that hold what
 * was requested. */
void loop_stop_requests(stop_request_report *out);
void loop_acknowledge_stops(const uint64_t *count); /* STOP_REQUEST_KINDS of them */
