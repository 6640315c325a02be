/* SPDX-License-Identifier: Apache-2.0
 *
 * api_line.h: the part of the border for serial lines. Read after api.h, and like it: typedefs,
 * enums, comments and prototypes, no preprocessor line. */

/* -------------------------------------------------------------------------------- serial lines
 * One shared medium (an RS485 pair) under one thread. A table defines the frames for each drive:
 * Python builds it from the drive profiles, C checks and copies it, and from then on the line runs
 * from static memory, whatever Python does. Everything that waits for a person or may fail with a
 * message (open, configure, arm, parameters) stays in Python: it goes through the same line as
 * requests, at most one in each cycle. */
enum {
    LINE_DRIVES_MAX = 8,
    DRIVE_CYCLIC_MAX = 8,
    DRIVE_EXTRA_MAX = 8,
    DRIVE_STOP_MAX = 6,
    DRIVE_DIRECTIONS_MAX = 4,
    EXCHANGE_SETPOINTS_MAX = 8,
    EXCHANGE_FIELDS_MAX = 24,
    FIELD_HARMLESS_MAX = 8,
    FRAME_BYTES_MAX = 256,
    FRAME_MATCH_MAX = 8,
    GROUP_HEAD_MAX = 16,
    LINE_REQUESTS_MAX = 8
};

/* The check at the end of a frame. */
typedef enum {
    SEAL_NONE = 0,
    /* Modbus over Serial Line V1.02, 2.5.1.2: last two bytes, low one first */
    SEAL_CRC16 = 1,
    /* CRC-8/MAXIM (reflected 0x31): last byte */
    SEAL_CRC8 = 2,
    /* CRC-16/XMODEM (0x1021, not reflected, start 0): last two bytes, high one first */
    SEAL_XMODEM = 3,
    /* of a reply: SEAL_XMODEM over the request's first two bytes and the reply (RoboClaw packet
     * serial) */
    SEAL_WITH_REQUEST = 4,
    /* the inverted sum of all bytes after the first two: last byte (Feetech servos, protocol 0) */
    SEAL_SUM = 5,
    /* Dynamixel protocol 2.0: CRC-16 (0x8005, not reflected, start 0): last two bytes, low one
     * first. On the wire, another FD follows each FF FF FD inside a packet; the length counts it,
     * byte numbers do not */
    SEAL_STUFFED = 6
} frame_seal;

/* A request, and how its answer is recognised. */
typedef struct {
    uint32_t request_bytes; /* whole, with its checksum: 1..FRAME_BYTES_MAX */
    uint32_t reply_bytes;   /* whole; 0: no drive answers, and the turn-around passes in silence */
    uint32_t echo_bytes;    /* number of bytes of the request with which the reply begins */
    uint32_t match_bytes;   /* if echo_bytes is 0: number of bytes of match[] with which it
                               begins */
    uint32_t request_seal;  /* frame_seal; computed anew when set-points are filled in */
    uint32_t reply_seal;
    uint32_t has_exceptions; /* 1: five bytes with the function's top bit set are a refusal
                                (Modbus); in STUFFED replies an error number is a refusal */
    uint32_t exact; /* 1: the reply does not identify its request: it must be all that comes, and
                       after a failure no request goes out until a late reply has passed */
    uint8_t match[FRAME_MATCH_MAX];
    uint8_t request[FRAME_BYTES_MAX];
} line_frame;

typedef enum {
    FORM_U8 = 0,
    FORM_I8 = 1,
    FORM_U16 = 2,
    FORM_I16 = 3, /* high byte first */
    FORM_U32 = 4,
    FORM_I32 = 5, /* high word first */
    FORM_U32_LOW_FIRST = 6,
    FORM_I32_LOW_FIRST = 7, /* low word first, its high byte first */
    FORM_U16_LE = 8,
    FORM_I16_LE = 9,
    FORM_U32_LE = 10,
    FORM_I32_LE = 11,   /* low byte first */
    FORM_M16_LE = 13,   /* low byte first: the top bit is the sign, the others are the magnitude */
    FORM_M16_BIT10 = 15 /* high byte first: bit 10 is the sign, those below are the magnitude */
} wire_form;

typedef enum {
    SETPOINT_VELOCITY = 0,
    SETPOINT_DUTY = 1,
    SETPOINT_TORQUE = 2,  /* CAN only */
    SETPOINT_POSITION = 3 /* 0 is an angle, not rest: see setpoint_position() in joint_values.h */
} setpoint_kind;

/* Place of a joint's set-point in a request: raw = nearest(clamp(si raw_per_si + raw_offset,
 * raw_min, raw_max)). si is 0 if not armed, not fresh, not enabled, NaN or infinite. For a
 * POSITION, 0 is a place like any other: then its exchange is not sent. */
typedef struct {
    uint32_t joint;     /* place in setpoints.joint */
    uint32_t kind;      /* setpoint_kind */
    uint32_t byte;      /* position in the request */
    uint32_t form;      /* wire_form */
    uint32_t magnitude; /* 1: without a sign; a line_direction sets the direction */
    uint32_t reserved;
    double raw_per_si; /* sign, gear, scale: not 0 */
    double raw_offset; /* for a POSITION: raw value of 0; for other kinds 0 */
    double raw_min; /* <= 0; for a magnitude the least value that the drive takes: 0; for a POSITION
                       any */
    double raw_max;
    double raw_per_s; /* for a POSITION: greatest speed of its target, > 0; for other kinds 0 */
} line_setpoint;

typedef enum {
    FIELD_COUNT = 0, /* position counter, raw */
    FIELD_VELOCITY = 1,
    FIELD_CURRENT = 2,
    FIELD_VOLTAGE = 3,
    FIELD_TEMPERATURE = 4, /* si = raw si_per_raw */
    FIELD_FAULT = 5,       /* the drive's fault word, raw */
    FIELD_ENABLED = 6,     /* (raw & equals_mask) == equals: enabled, for all joints of the drive */
    FIELD_KEPT = 7,        /* (raw & equals_mask) == equals, else the drive has lost its set-up */
    FIELD_REFERENCED = 8,  /* (raw & equals_mask) == equals: the joint's counter has a reference */
    FIELD_TAKEN = 9        /* CAN only: (raw & equals_mask) == equals: the drive has taken the
                              joint's target, and waits for the end of can_setpoint.trigger */
} field_kind;

/* For CAN buses and boards: the number that commands a joint, like line_setpoint. A POSITION that
 * must not be sent is left out with its frame; in frames that go out nevertheless it keeps its last
 * value. */
typedef struct {
    uint32_t joint;    /* index in setpoints.joint */
    uint32_t kind;     /* setpoint_kind */
    double raw_per_si; /* sign, gear, scale: not 0 */
    double raw_offset; /* for a POSITION: raw value of 0; for other kinds 0 */
    double raw_min;    /* <= 0; for a POSITION any */
    double raw_max;    /* >= 0; for a POSITION not below raw_min */
    double raw_per_s;  /* for a POSITION: greatest speed of its target, > 0; for other kinds 0 */
} setpoint_scale;

/* For CAN buses and boards: the meaning of a received number. */
typedef struct {
    uint32_t joint;       /* index in the core's arrays; unused for ENABLED and KEPT */
    uint32_t kind;        /* field_kind */
    uint32_t equals_mask; /* ENABLED, KEPT: (raw & equals_mask) == equals */
    uint32_t equals;
    uint32_t counter_bits;   /* COUNT: 1..64 */
    uint32_t is_code;        /* FAULT: 1: the word is a number, 0: bits */
    uint32_t harmless_bits;  /* FAULT: bits that are only warnings */
    uint32_t harmless_codes; /* FAULT, a number: number of entries in harmless[] that are only
                                warnings */
    uint32_t harmless[FIELD_HARMLESS_MAX];
    double si_per_raw;
} field_meaning;

/* Place of a value in a reply. */
typedef struct {
    uint32_t joint; /* index in the core's arrays; unused for ENABLED and KEPT */
    uint32_t kind;  /* field_kind */
    uint32_t byte;  /* position in the reply */
    uint32_t form;  /* wire_form */
    uint32_t mask;  /* adjacent bits that hold the value; 0: all of them */
    uint32_t equals_mask;
    uint32_t equals;
    uint32_t direction;      /* VELOCITY without sign: 1 + number of the direction whose newest
                                reverse negates it; 0: none */
    double si_per_raw;       /* sign, gear, scale */
    uint32_t harmless_bits;  /* FAULT: bits that are only warnings */
    uint32_t harmless_codes; /* FAULT: > 0: the word is a number, and so many entries of harmless[]
                                are only warnings */
    uint32_t is_code;        /* FAULT: 1: the word is a number, 0: bits */
    uint32_t harmless[FIELD_HARMLESS_MAX];
    uint32_t reserved;
} line_field;

typedef struct {
    line_frame frame;
    uint32_t setpoint_count;
    uint32_t field_count;
    line_setpoint setpoint[EXCHANGE_SETPOINTS_MAX];
    line_field field[EXCHANGE_FIELDS_MAX];
} line_exchange;

/* For set-points without sign: the frames that set the direction. Rest is sent before the first
 * magnitude of a new direction, and the direction after it: so no magnitude acts in the wrong
 * direction, even if a frame is lost. */
typedef struct {
    uint32_t joint;
    uint32_t kind; /* setpoint_kind whose sign is sent */
    uint32_t inverted;
    uint32_t reserved;
    line_frame rest;
    line_frame forward;
    line_frame reverse;
} line_direction;

typedef struct {
    uint32_t tries;        /* failures in a row after which the drive is unresponsive: 1.. */
    uint32_t extra_every;  /* cycles between two extra exchanges: 1.. */
    int64_t period_ns;     /* wanted time between two cycles: > 0 */
    int64_t turnaround_ns; /* longest time from the request's last byte to the reply's first byte,
                              from the profile */
    int64_t reply_timeout_ns; /* fixed deadline; 0: by the measured turn-around (RFC 6298), within
                                 the bound */
    int64_t watchdog_ns;      /* silence after which the drive stops by itself; 0: never */
    uint32_t cyclic_count;
    uint32_t extra_count; /* number of exchanges of which one is made every extra_every cycles; that
                             of ENABLED is the first */
    uint32_t direction_count;
    uint32_t quick_stop_count;
    uint32_t disarm_count;
    uint32_t idle_count; /* 1: idle[0] goes out instead of cyclic[0] while the drive is neither
                            armed nor stopping; 0: no such frame */
    uint32_t reserved;
    uint32_t probe; /* 1 + number of the cyclic exchange that polls whether an unresponsive drive is
                       back; 0: extra[0], or the first cyclic one, with zeros, if there is no
                       other */
    line_exchange cyclic[DRIVE_CYCLIC_MAX]; /* in their order: set-points first */
    line_exchange extra[DRIVE_EXTRA_MAX];
    line_direction direction[DRIVE_DIRECTIONS_MAX];
    line_frame quick_stop[DRIVE_STOP_MAX];
    line_frame disarm[DRIVE_STOP_MAX];
    line_frame idle[1];
} line_drive;

/* For bus servos. A cycle is one request for all drives, a sync write with the set-points and a
 * sync read in one piece; each drive answers the read for itself. Each drive has two cyclic
 * exchanges: the write to it alone, and the read from it; both requests begin and end alike on all
 * drives except for their unit. */
typedef struct {
    uint32_t used; /* 0: each drive has its own exchanges */
    /* start of the written data in cyclic[0]; they end before its check sum */
    uint32_t data_byte;
    uint32_t write_bytes; /* bytes of write[], without check sum and data */
    uint32_t read_bytes;
    uint32_t fast; /* 1: a fast sync read, which all answer in one packet, while no drive fails
                      (Dynamixel); 0: never */
    uint32_t reserved;
    uint8_t write[GROUP_HEAD_MAX]; /* with the length for no drives */
    uint8_t read[GROUP_HEAD_MAX];
} line_group;

typedef struct {
    uint32_t drive_count; /* 1..LINE_DRIVES_MAX */
    uint32_t echo; /* 0: no echo; 1: every request comes back first; 2: the first read shows it */
    double character_ns; /* one byte on the wire, with start, parity and stop bits */
    int64_t gap_ns;      /* silence before a request */
    int64_t late_ns; /* time after a request in which its reply may come late, by the medium; twice
                        the turn-around of its drive at least */
    int64_t setpoint_timeout_ns;   /* age of set-points that causes a quick stop */
    double rest_velocity_rad_s;    /* a wheel slower than this is at rest: > 0 */
    uint32_t broadcast_stop_count; /* frames that stop all drives at once, before each one's own; 0:
                                      no such frames */
    uint32_t reserved;
    line_group group;
    line_frame broadcast_stop[DRIVE_STOP_MAX];
    line_drive drive[LINE_DRIVES_MAX];
} line_table;

/* OFF           not set up: nothing cyclic is sent to the drive
 * READY         cyclic, every set-point zero
 * ARMED         cyclic, with the core's set-points while they are fresh and enabled
 * UNRESPONSIVE  the drive did not answer `tries` times: probed with back-off, and sent a stop if it
 *               may turn
 * BACK          an unresponsive drive has answered, and was sent its power-off: like OFF, until
 *               Python has set it up */
typedef enum {
    DRIVE_OFF = 0,
    DRIVE_READY = 1,
    DRIVE_ARMED = 2,
    DRIVE_UNRESPONSIVE = 3,
    DRIVE_BACK = 4,
    DRIVE_STAND_DOWN = 5 /* only as a request: from ARMED to READY, else nothing */
} drive_mode;

/* Why the line itself disarmed a drive; OR of all reasons since the newest request took effect. */
enum {
    DRIVE_FAULT_SETPOINTS_OLD = 1 << 0,   /* quick stop, then off at rest */
    DRIVE_FAULT_NOT_ENABLED = 1 << 1,     /* the core disabled the drive: power off */
    DRIVE_FAULT_LEFT_ALONE = 1 << 2,      /* no request for longer than its watchdog's time: the
                                             drive has stopped by itself */
    DRIVE_FAULT_LOST_SETUP = 1 << 3,      /* a KEPT field differs: OFF */
    DRIVE_FAULT_DISABLED_ITSELF = 1 << 4, /* armed, but the drive reports that it is not enabled:
                                             OFF */
    DRIVE_FAULT_UNRESPONSIVE = 1 << 5,
    DRIVE_FAULT_STILL_ENABLED = 1 << 6,   /* not armed, but the drive reports that it is enabled: it
                                             gets a disarm, and is held at zero */
    DRIVE_FAULT_POSITION_UNKNOWN = 1 << 7 /* the position of a drive that takes positions is
                                             unknown, or far from its first target: power off */
};

/* Python's request for a drive. It takes effect once for each new count: a drive that the line has
 * disarmed stays disarmed until the next one. */
typedef struct {
    uint32_t count;
    uint32_t mode;           /* DRIVE_OFF: not from UNRESPONSIVE, where probes still stop it;
                                DRIVE_READY: has been set up, from OFF or BACK only;
                                DRIVE_ARMED: from READY only; DRIVE_STAND_DOWN. A request that
                                is not possible is only noted as seen */
    int64_t arming_until_ns; /* READY: until this time the drive may report that it is enabled,
                                because Python arms it; 0: never */
} mode_request;

typedef struct {
    mode_request drive[LINE_DRIVES_MAX];
    /* level: quick stop of all armed drives, then power off of all, then silence */
    uint32_t shut_down;
    uint32_t reserved;
} line_control;

/* One exchange outside the cycle. It is sent once, or not at all after expires_ns. */
typedef struct {
    uint64_t id; /* chosen by the caller */
    int64_t expires_ns;
    int64_t turnaround_ns;
    uint32_t drive;  /* the drive for which failures count; LINE_DRIVES_MAX: no drive */
    uint32_t urgent; /* 1: before the other requests */
    line_frame frame;
} line_request;

typedef enum {
    ANSWER_OK = 0,
    ANSWER_NO_REPLY = 1,
    ANSWER_BAD_REPLY = 2,
    ANSWER_REFUSED = 3,     /* REFUSED: see exception */
    ANSWER_EXPIRED = 4,     /* not sent */
    ANSWER_PORT = 5,        /* the port is gone */
    ANSWER_NEVER_SILENT = 6 /* at a drive's turn, other bytes kept the line busy */
} answer_kind;

typedef struct {
    uint64_t id;
    int64_t sent_ns;  /* first byte of the request */
    int64_t stamp_ns; /* middle of the exchange */
    int64_t done_ns;
    uint32_t kind; /* answer_kind */
    uint32_t exception;
    uint32_t reply_bytes;
    uint32_t echoed; /* 1: the request came back before the reply */
    uint8_t reply[FRAME_BYTES_MAX];
} line_answer;

typedef struct {
    uint32_t mode;          /* drive_mode */
    uint32_t fault_reasons; /* DRIVE_FAULT_* */
    uint32_t request_seen;  /* count of the last request that took effect */
    uint32_t enabled;       /* 1: yes, 0: no, 2: not reported since the newest request */
    uint32_t stopping; /* a quick stop was sent, and the wheels have not been seen at rest since */
    uint32_t sent_motion;  /* 1: it was sent set-points that are not zero, and has not acknowledged
                              zero since */
    uint32_t failures;     /* number of failures in a row */
    uint32_t last_failure; /* answer_kind */
    uint32_t last_exception;
    uint32_t may_turn;   /* 1: armed since its newest set-up, also before the port was opened */
    uint32_t stop_waits; /* the drive has not acknowledged all of its newest stop */
    uint32_t reserved;
    uint64_t cycles; /* number of complete cycles */
    uint64_t exchanges;
    uint64_t no_reply;
    uint64_t bad_reply;
    uint64_t refused;
    uint64_t late;         /* number of replies that came too late; their content was not used */
    uint64_t unresponsive; /* number of times that the drive became UNRESPONSIVE */
    int64_t received_ns;   /* last good reply */
    int64_t turnaround_ns; /* smoothed */
    int64_t deadline_ns;   /* present deadline, from the request's last byte to the reply's first
                              byte */
    int64_t cycle_ns;      /* smoothed time between two cycles */
} drive_report;

/* The beginning of every line's report, on any medium. */
typedef struct {
    uint32_t running; /* 0: the thread has ended, see error */
    int32_t error;    /* errno of the medium; 0: none */
    int32_t policy;   /* SCHED_FIFO (1) or SCHED_OTHER (0), as set by the kernel */
    int32_t scheduler_errno;
    uint64_t rounds;      /* grows while the thread works, at least twenty times a second */
    uint64_t page_faults; /* page faults of the thread since its first cycle */
} line_life;

typedef struct {
    line_life life;
    uint32_t echo;      /* as found: 0: no, 1: yes, 2: not known yet */
    uint32_t shut_down; /* 1: done */
    uint64_t exchanges;
    uint64_t answers;     /* good replies and refusals */
    uint64_t noise_bytes; /* bytes that were no frame: no answer, no late reply, no echo */
    int64_t setpoints_ns; /* stamp of the newest set-points; 0: no set-points yet */
    uint32_t fault_word[JOINTS_MAX]; /* whole words, by the core's joint number */
    drive_report drive[LINE_DRIVES_MAX];
} line_report;

/* Descriptors and scheduling of a line's thread. The caller keeps the descriptors. */
typedef struct {
    int32_t fd;       /* the medium: open, set up, not blocking */
    int32_t event_fd; /* eventfd, written on each change for asyncio and at the thread's end; -1: no
                         eventfd */
    int32_t priority; /* SCHED_FIFO 1..99; 0: SCHED_OTHER on request */
    uint32_t reserved;
    uint64_t cpu_mask;  /* bit n: CPU n; 0: no affinity */
    exchange *exchange; /* NULL: the loop's */
} line_place;

typedef struct {
    line_place at;        /* woken by answers and by changes of a drive's mode */
    int64_t de_before_ns; /* time from the edge to the first bit */
    int64_t de_after_ns;  /* time from the last bit to the edge back */
    int32_t de_fd;        /* GPIO line request (v2) that turns the transceiver; -1: none */
    uint32_t de_active_high;
    uint32_t may_turn; /* bit n: drive n may turn since before the port was opened, and gets a stop
                          first */
    uint32_t left_running; /* another program left all drives so: each begins with a quick stop,
                              without a set-up before it */
} line_config;

/* Check a table. Returns NULL when it is good, else the name of the first bad field. The caller
 * provides name[FIELD_NAME_BYTES]. */
const char *line_table_check(const line_table *table, char *name);

/* Start a line: one thread for each line, in static memory. Returns 0; -EINVAL; -EBUSY; -errno of a
 * step that is indispensable. */
int line_start(uint32_t line, const line_config *config, const line_table *table);
int line_stop(uint32_t line); /* joins; 0 or -ESRCH */
void line_put_control(uint32_t line, const line_control *control);
/* Returns 0; -EAGAIN: full; -ESRCH: no thread. */
int line_put_request(uint32_t line, const line_request *request);
int line_take_answer(uint32_t line, line_answer *answer); /* 1: an answer; 0: no answer */
int line_read_report(uint32_t line, line_report *report); /* 0 or -ESRCH: never started */
int line_histogram_read(uint32_t line, histogram *out);   /* round trips */
