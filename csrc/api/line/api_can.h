/* SPDX-License-Identifier: Apache-2.0
 *
 * api_can.h: the part of the border for CAN buses. Read after api_line.h, whose modes, requests and
 * kinds of fields it shares, and like it: typedefs, enums, comments and prototypes, no preprocessor
 * line.
 */

/* ----------------------------------------------------------------------------------- CAN buses
 * One CAN bus under one thread. A table defines the frames of each cycle, the received frames, and
 * the stops of a drive. Python makes it from the drive profiles; it is checked and copied here.
 * Jobs (set up, arm, parameters) stay in Python: their frames go out through a queue, and during a
 * job Python gets the frames of its drive. */
enum {
    CAN_DRIVES_MAX = 8,
    CAN_OUTPUTS_MAX = 4,
    CAN_SETPOINTS_MAX = 4,
    CAN_POLLS_MAX = 8,
    CAN_INPUTS_MAX = 16,
    CAN_MATCHES_MAX = 96,
    CAN_FIELDS_MAX = 8,
    CAN_STOP_MAX = 6,
    CAN_BYTES_MAX = 64,
    CAN_BEGINS_MAX = 64,
    CAN_SYNCS_MAX = 2,
    CAN_SENDINGS_MAX = 256,
    CAN_ORDERS_MAX = 32,
    CAN_RECEIVED_MAX = 256
};

/* A frame on the CAN bus. */
typedef struct {
    uint32_t id;    /* like linux/can.h: bit 31 extended, bit 30 remote, bit 29 error frame */
    uint32_t bytes; /* for a remote frame: the length that it requests */
    uint32_t fd;    /* 1: a frame of CAN FD, its data at the data bit rate */
    uint32_t reserved;
    uint8_t data[CAN_BYTES_MAX];
} can_packet;

/* FLOAT is IEEE 754 binary32. */
typedef enum { CAN_UNSIGNED = 0, CAN_SIGNED = 1, CAN_FLOAT = 2 } can_form;

/* Adjacent bits of a frame. */
typedef struct {
    uint32_t start_bit; /* little-endian: counted from the least significant bit of byte 0 upward;
                           big-endian: counted from the most significant bit of byte 0 on */
    uint32_t length;    /* 1..32; 32 for a float */
    uint32_t big_endian;
    uint32_t form; /* can_form */
} can_place;

/* Place of a joint's set-point in a frame. */
typedef struct {
    can_place place;
    setpoint_scale scale;
    can_place trigger; /* for a POSITION: bit whose rising edge makes the drive take the target. It
                          is set until the drive confirms (FIELD_TAKEN), and never in a frame that
                          moves nothing; length 0: no such bit */
} can_setpoint;

/* A frame of every cycle. Bits without set-points are those of `packet`, or those written last
 * (can_write.output). */
typedef struct {
    can_packet packet;
    uint32_t setpoint_count;
    uint32_t reserved;
    can_setpoint setpoint[CAN_SETPOINTS_MAX];
} can_output;

/* A frame that is written once. If it is also a frame of every cycle, it changes only the bits of
 * `mask` there, for all later cycles, too (the control word of CiA 402). */
typedef struct {
    can_packet packet;
    uint32_t output; /* 1 + number of the output with this frame; 0: no output */
    uint32_t reserved;
    uint8_t mask[CAN_BYTES_MAX];
} can_write;

/* Place of a value in a frame of the drive. */
typedef struct {
    can_place place;
    field_meaning meaning; /* never KEPT; COUNT: si is counts */
    double si_at_zero;     /* value of raw 0 */
} can_field;

/* A frame of the drive that the cycle uses. */
typedef struct {
    int64_t silence_ns; /* time without the frame after which the drive is unresponsive; 0: it may
                           be missing */
    int64_t spacing_ns; /* least time between two measurements: frames that come sooner were held up
                           by the CAN bus and add nothing */
    uint32_t fast;      /* 1: these frames together have the values of all joints */
    uint32_t field_count;
    can_field field[CAN_FIELDS_MAX];
} can_input;

/* How a frame of the drive is recognised. */
typedef struct {
    uint32_t id;    /* identifier, with bit 31 for an extended frame */
    uint32_t bytes; /* least number of bytes */
    uint32_t begins_bytes;
    uint32_t input; /* 1 + number of the input with this frame; 0: only for Python */
    uint8_t begins[CAN_BEGINS_MAX];
    uint8_t begins_mask[CAN_BEGINS_MAX]; /* bits that identify the frame; the others are free */
} can_match;

typedef struct {
    uint32_t tries;           /* 1..: number of consecutive reports of power without being armed
                                 after which this is reported */
    uint32_t slow_every;      /* cycles between two requests that may wait: 1.. */
    uint32_t idle_setpoints;  /* 1: zero is sent in READY, too */
    uint32_t reports_enabled; /* 0: the drive cannot report its power, so it gets its disarm again
                                 at times in READY */
    uint32_t hello; /* 1 + number of the input that alone shows that an unresponsive drive is back;
                       0: all with a silence_ns do */
    uint32_t output_count;
    uint32_t poll_count;  /* requested in each cycle */
    uint32_t slow_count;  /* requested in turn */
    uint32_t probe_count; /* requested of an unresponsive drive */
    uint32_t match_count;
    uint32_t input_count;
    uint32_t quick_stop_count;
    uint32_t disarm_count;
    uint32_t reserved;
    int64_t watchdog_ns; /* time without set-points while armed after which the drive may have
                            stopped; 0: never */
    can_output output[CAN_OUTPUTS_MAX];
    can_packet poll[CAN_POLLS_MAX];
    can_packet slow[CAN_POLLS_MAX];
    can_packet probe[CAN_POLLS_MAX];
    can_match match[CAN_MATCHES_MAX];
    can_input input[CAN_INPUTS_MAX];
    can_write quick_stop[CAN_STOP_MAX];
    can_write disarm[CAN_STOP_MAX];
} can_drive;

typedef struct {
    uint32_t drive_count; /* 1..CAN_DRIVES_MAX */
    uint32_t sync_count;  /* frames for all drives at once, at the end of each cycle */
    can_packet sync[CAN_SYNCS_MAX];
    uint32_t sending_count;
    uint32_t reserved;
    uint32_t sending[CAN_SENDINGS_MAX]; /* each identifier that motord sends, like can_packet.id, in
                                           ascending order: no other node may send it */
    int64_t period_ns;                  /* period of the cycle: > 0 */
    int64_t setpoint_timeout_ns;        /* age of set-points that causes a quick stop */
    double rest_velocity_rad_s;         /* a wheel slower than this is at rest: > 0 */
    can_drive drive[CAN_DRIVES_MAX];
} can_table;

/* Like line_control. */
typedef struct {
    mode_request drive[CAN_DRIVES_MAX];
    uint32_t shut_down;
    uint32_t listen; /* bit n: Python receives the frames of drive n */
} can_control;

/* A frame of a job. It waits while the CAN bus takes nothing, until expires_ns. */
typedef struct {
    can_write write;
    int64_t expires_ns;
    uint32_t drive;
    /* 1: dropped if the drive's `stops` differs, because it was stopped meanwhile */
    uint32_t guarded;
    uint32_t stops;
    uint32_t reserved;
} can_order;

typedef struct {
    can_packet packet;
    int64_t stamp_ns; /* time when the kernel received it */
    uint32_t drive;   /* CAN_DRIVES_MAX: an error frame */
    uint32_t reserved;
} can_received;

typedef struct {
    uint32_t mode;          /* drive_mode */
    uint32_t fault_reasons; /* DRIVE_FAULT_* */
    uint32_t request_seen;
    uint32_t enabled;  /* 1: yes, 0: no, 2: not reported yet */
    uint32_t stopping; /* a quick stop was sent, and the wheels have not been seen at rest since */
    uint32_t sent_motion;  /* 1: the newest set-points are not zero */
    uint32_t missing;      /* 1 + number of the missing input; 0: no input is missing */
    uint32_t stops;        /* number of stops, by C or by a request */
    uint64_t cycles;       /* number of feedbacks made from its frames */
    uint64_t received;     /* frames */
    uint64_t unresponsive; /* number of times that the drive became UNRESPONSIVE */
    int64_t received_ns;
    uint32_t epoch; /* epoch of its feedback */
    uint32_t orders_sent;
    uint32_t orders_dropped; /* number of dropped orders: too late, or guarded and the drive was
                                stopped */
    uint32_t faults;         /* number of times that a joint's fault word became one that stops */
    uint32_t last_fault;     /* the newest such word: a stop may have cleared it in the drive */
    uint32_t last_fault_joint;
    uint32_t may_turn;   /* 1: armed since its newest set-up, also before the line was opened */
    uint32_t stop_waits; /* the CAN bus has not taken all of the newest stop, or the drive has not
                            confirmed its power-off: by its report or, at the end, by any frame if
                            it makes no such report */
} can_drive_report;

typedef struct {
    line_life life;
    uint32_t shut_down;       /* 1: done */
    uint32_t foreign_sending; /* number of the newest foreign identifier in can_table.sending */
    uint64_t cycles;
    uint64_t received; /* frames of the drives */
    uint64_t sent;
    uint64_t tx_full;     /* frames that the CAN bus did not take; the next one is newer */
    uint64_t bad_frames;  /* frames with a drive's identifier and unknown content */
    uint64_t dropped;     /* frames for which Python's queue had no room */
    uint64_t foreign;     /* frames of another node with an identifier that motord sends */
    int64_t cycle_ns;     /* smoothed time between two cycles */
    int64_t setpoints_ns; /* stamp of the newest set-points; 0: no set-points yet */
    uint32_t fault_word[JOINTS_MAX]; /* whole words, by the core's joint number */
    can_drive_report drive[CAN_DRIVES_MAX];
} can_report;

/* State of the drives from before the line was opened; zeros: nothing is known. */
typedef struct {
    uint32_t epoch;        /* epoch of their feedback */
    uint32_t may_turn;     /* bit n: drive n may turn, and gets a stop until it is set up again */
    uint32_t left_running; /* another program left all drives so: each begins with a quick stop,
                              without a set-up before it */
    uint32_t reserved;
} can_before;

typedef struct {
    line_place at; /* CAN_RAW, or SOCK_SEQPACKET that carries struct can_frame and canfd_frame;
                      woken by frames for Python and by changes of a mode */
    can_before before;
} can_config;

/* Check a table. Returns NULL when it is good, else the name of the first bad field. The caller
 * provides name[FIELD_NAME_BYTES]. */
const char *can_table_check(const can_table *table, char *name);

/* Start a line: one thread for each line, in static memory. Returns 0; -EINVAL; -EBUSY; -errno of a
 * step that is indispensable. */
int can_start(uint32_t line, const can_config *config, const can_table *table);
int can_stop(uint32_t line); /* joins; 0 or -ESRCH */
void can_put_control(uint32_t line, const can_control *control);
/* Returns 0; -EAGAIN: full; -EINVAL; -ESRCH: no thread. */
int can_put_order(uint32_t line, const can_order *order);
int can_take_received(uint32_t line, can_received *received); /* 1: a frame; 0: no frame */
int can_read_report(uint32_t line, can_report *report);       /* 0 or -ESRCH: never started */
