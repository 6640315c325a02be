/* SPDX-License-Identifier: Apache-2.0
 *
 * api_board.h: the part of the border that boards on a stream need. Read after api_line.h, whose
 * modes, requests and kinds of fields it shares, and like it: typedefs, enums, comments and
 * prototypes, no preprocessor line.
 */

/* -------------------------------------------------------------------------- boards on a stream
 * One board alone on a serial port, or Sabertooths that count as one; one thread. It is sent its
 * payload in every cycle, set-points among it, and sends its own by itself. Both are bytes with
 * numbers at their places, low byte first: as they are in frames (docs/mcu-frame.md), or as text
 * (docs/mcu/line-ascii.md), whose numbers are written to and read from such places. */
enum {
    BOARD_PAYLOAD_MAX = 190, /* a frame of 200 bytes without its head and check sum */
    BOARD_SETPOINTS_MAX = 8,
    BOARD_FIELDS_MAX = 72,
    BOARD_WRITES_MAX = 16,
    BOARD_TEXT_MAX = 256, /* bytes of a line of text that is sent, or of a template */
    BOARD_LINE_MAX = 512, /* bytes of a line of text that is read */
    BOARD_PARTS_MAX = 26,
    BOARD_ORDERS_MAX = 16
};

typedef enum {
    BOARD_FRAMES = 0,
    BOARD_TEXT = 1,
    BOARD_HOVERBOARD = 2,
    BOARD_SABERTOOTH = 3
} board_dialect;

enum {
    HOVERBOARD_COMMAND_BYTES = 8,
    HOVERBOARD_FEEDBACK_BYTES = 18,
    HOVERBOARD_SETPOINT_BYTES = 4, /* payload: left, right, 16 bits with sign, low byte first */
    /* feedback payload: what stands between start word and check sum */
    HOVERBOARD_VALUE_BYTES = 14,
    HOVERBOARD_SETPOINT_MAX = 1000,
    SABERTOOTH_PACKET_BYTES = 4,
    SABERTOOTH_SETPOINT_BYTES = 3, /* of each driver in the payload: serial time-out, motor 1, motor
                                      2; motors with sign */
    SABERTOOTH_UNIT_MIN = 128,
    SABERTOOTH_UNIT_MAX = 135,
    SABERTOOTH_UNITS_MAX = 8
};

/* A number in a payload. */
typedef struct {
    uint32_t byte;
    uint32_t bytes; /* 1..6 */
    uint32_t is_signed;
    uint32_t reserved;
} board_place;

/* Where a payload holds what a joint is to do. */
typedef struct {
    board_place place;
    setpoint_scale scale;
} board_setpoint;

/* What stays in the payload from now on. */
typedef struct {
    board_place place;
    int64_t raw;
} board_write;

/* A place in the board's feedback. */
typedef struct {
    board_place place;
    field_meaning meaning;
} board_field;

typedef enum {
    NUMBER_NONE = 0,
    NUMBER_INTEGER = 1,
    NUMBER_FIXED = 2,
    NUMBER_GENERAL = 3,
    NUMBER_CONSTANT = 4 /* read, JSON: must be raw_per_number; it goes nowhere */
} board_number_form;

/* A piece of a template: so many bytes of it as they are, then a number. */
typedef struct {
    uint32_t literal_bytes;
    uint32_t form; /* board_number_form: printf's d, f, g; NONE: no number, only in the last part */
    uint32_t sign; /* 0; '+' or ' ': before numbers that are not negative */
    uint32_t zeros; /* 1: filled up with zeros */
    uint32_t width;
    uint32_t precision;
    board_place place; /* read: where raw = nearest(number raw_per_number) goes, held within it */
    double raw_per_number;
    double number_per_raw[BOARD_SETPOINTS_MAX]; /* written: the sum over the set-points of raw ×
                                                   this */
} board_part;

typedef struct {
    uint32_t part_count; /* 0: no such text */
    uint32_t json; /* read: 1: an object; a part's literal is the name of a member, in any order,
                      others are skipped */
    board_part part[BOARD_PARTS_MAX];
    uint8_t literal[BOARD_TEXT_MAX]; /* of all parts, one after the other; white space fits any
                                        other */
} board_text;

/* An inertial sensor on the board, the robot's [imu]. Its place in frames is in
 * docs/mcu-frame.md; a text has its rate about z, in units of 1e-6 rad/s. */
typedef struct {
    uint32_t used;        /* 0: there is none, the rest is not looked at */
    uint32_t epoch;       /* of its samples */
    uint32_t axis[3];     /* of the base's x, y, z: the sensor's 0, 1, 2 that lies along it */
    uint32_t backward[3]; /* 1: the opposite direction */
    board_place rate_z;   /* TEXT */
} board_imu;

typedef struct {
    uint32_t dialect; /* board_dialect */
    /* 0: it sends nothing, and counts as present while the port takes its bytes */
    uint32_t answers;
    uint32_t tries; /* reported after so many times enabled without being armed: 1.. */
    uint32_t payload_bytes;
    uint32_t feedback_bytes; /* of its own payload, at least; TEXT: all of it */
    uint32_t setpoint_count;
    uint32_t field_count;
    uint32_t quick_stop_count;
    uint32_t disarm_count;
    uint32_t mixed;      /* HOVERBOARD: 1: the firmware mixes steer and speed; 0: left and right
                            (TANK_STEERING) */
    uint32_t unit_count; /* SABERTOOTH: drivers on the wire, which move and stop as one drive */
    uint8_t unit[SABERTOOTH_UNITS_MAX]; /* their addresses, each above the one before */
    uint32_t reserved;
    int64_t period_ns; /* of the cycle: > 0 */
    int64_t gap_ns; /* from a frame's beginning to the next one's, at least: a wire that carries one
                       at a time */
    int64_t silence_ns;          /* unresponsive after so long without feedback: > 0 */
    int64_t setpoint_timeout_ns; /* set-points older than this: quick stop */
    double rest_velocity_rad_s;  /* a wheel slower than this is at rest: > 0 */
    int64_t watchdog_ns; /* without set-points for so long while armed: it has stopped; 0: never */
    uint8_t payload[BOARD_PAYLOAD_MAX]; /* before anything is written to it */
    board_setpoint setpoint[BOARD_SETPOINTS_MAX];
    board_field field[BOARD_FIELDS_MAX];
    board_write quick_stop[BOARD_WRITES_MAX];
    board_write disarm[BOARD_WRITES_MAX];
    board_text written;
    board_text read;
    board_imu imu;
} board_table;

/* As line_control, of the one drive. */
typedef struct {
    mode_request request;
    uint32_t shut_down;
    uint32_t reserved;
} board_control;

/* A write of a job. It goes out with a cycle of its own, so that the board sees each. */
typedef struct {
    board_write write;
    uint32_t guarded; /* 1: dropped if `stops` differs: the board was stopped meanwhile */
    uint32_t stops;
} board_order;

typedef struct {
    line_life life;
    uint32_t shut_down;     /* 1: done */
    uint32_t mode;          /* drive_mode */
    uint32_t fault_reasons; /* DRIVE_FAULT_* */
    uint32_t request_seen;
    uint32_t enabled;  /* 1, 0, 2: not reported */
    uint32_t stopping; /* a quick stop was sent, and the wheels have not been seen at rest since */
    uint32_t sent_motion;    /* its newest set-points are not zero */
    uint32_t stops;          /* stops that were sent to it, by C or by a request */
    uint32_t epoch;          /* of its feedback */
    uint32_t orders_sent;    /* they have gone out */
    uint32_t orders_dropped; /* guarded, and it was stopped; or it is unresponsive */
    /* of feedback_payload[]; 0: nothing since it was unresponsive, or ever */
    uint32_t feedback_bytes;
    uint32_t stop_waits; /* the port has not taken its newest stop; at the end: the board has not
                            confirmed it */
    uint32_t reserved;
    uint64_t cycles;
    uint64_t sent;
    uint64_t no_room;    /* frames that the port did not take: the next one is newer */
    uint64_t bad_frames; /* pieces of the stream that were no feedback */
    uint64_t received;
    uint64_t published;    /* feedback that the core was given since the start */
    uint64_t unresponsive; /* how often it became UNRESPONSIVE */
    int64_t cycle_ns;      /* smoothed time between two cycles */
    int64_t setpoints_ns;  /* stamp of the newest set-points; 0: none came */
    int64_t received_ns;   /* its newest feedback came */
    int64_t knows_ns;      /* when the newest frame that it had received was sent; TEXT has no such
                              number: received_ns */
    int64_t written_ns;    /* what stays in its payload was changed last */
    uint32_t fault_word[JOINTS_MAX];             /* whole, by the core's joint number */
    uint8_t feedback_payload[BOARD_PAYLOAD_MAX]; /* the newest */
} board_report;

typedef struct {
    line_place at;         /* woken by changes of the mode and of orders that were sent */
    uint32_t epoch;        /* of the feedback before this start; 0: there was none */
    uint32_t left_running; /* another program left the board so: it begins with a quick stop, with
                              no set-up before it */
} board_config;

/* NULL when good; else the name of the first bad field. Static storage of the caller:
 * name[FIELD_NAME_BYTES]. */
const char *board_table_check(const board_table *table, char *name);

/* One thread a board, in static memory. 0; -EINVAL; -EBUSY; -errno of what cannot be done
 * without. */
int board_start(uint32_t line, const board_config *config, const board_table *table);
int board_stop(uint32_t line); /* joins; 0 or -ESRCH */
void board_put_control(uint32_t line, const board_control *control);
/* 0; -EAGAIN: full; -EINVAL; -ESRCH: no thread */
int board_put_order(uint32_t line, const board_order *order);
int board_read_report(uint32_t line, board_report *report); /* 0 or -ESRCH: never started */
/* from set-points to the feedback that acknowledged them */
int board_histogram_read(uint32_t line, histogram *out);

/* The pure parts, for tests against the same in Python. */
enum { BOARD_FRAME_MAX = 200, BOARD_WIRE_MAX = 258, BOARD_CLOCK_SAMPLES = 32 };

typedef struct {
    uint32_t samples; /* taken so far, or BOARD_CLOCK_SAMPLES */
    uint32_t next;
    uint32_t last_us;
    uint32_t reserved;
    int64_t board_ns;
    int64_t given_ns; /* the newest stamp, and the board's time for it */
    int64_t given_board_ns;
    int64_t offset_ns[BOARD_CLOCK_SAMPLES];
} board_clock;

/* When a frame with the board's time was made, CLOCK_MONOTONIC. Zeroed: a new board. */
int64_t board_clock_stamp(board_clock *clock, uint32_t time_us, int64_t came_ns);

/* A frame between zeros as it goes out: bytes of out[BOARD_WIRE_MAX]; 0: the payload is too
 * long. */
uint32_t board_frame_build(uint32_t type, uint32_t sequence, uint32_t time_us,
                           const uint8_t *payload, uint32_t payload_bytes, uint8_t *out);
/* The frame between two zeros, into out[BOARD_FRAME_MAX]: head and payload; 0: no frame. */
uint32_t board_frame_parse(const uint8_t *stuffed, uint32_t count, uint8_t *out);

typedef struct {
    uint32_t count;
    uint32_t synced; /* 1: the newest byte that was taken ended a frame, or is part of one */
    uint8_t bytes[HOVERBOARD_FEEDBACK_BYTES];
} hoverboard_tail;

typedef enum {
    HOVERBOARD_NOTHING = 0,
    HOVERBOARD_FEEDBACK = 1,
    HOVERBOARD_BAD = 2
} hoverboard_found;

/* The command with the set-points of a payload, into out[HOVERBOARD_COMMAND_BYTES]; its bytes. */
uint32_t board_hoverboard_build(const uint8_t *payload, uint32_t mixed, uint8_t *out);
/* One more byte of the stream. hoverboard_found; FEEDBACK: values[HOVERBOARD_VALUE_BYTES]; BAD:
 * bytes were dropped. */
uint32_t board_hoverboard_take(hoverboard_tail *tail, uint8_t byte, uint8_t *values);
/* The packets with the set-points of one driver, into out[3 * SABERTOOTH_PACKET_BYTES]; their
 * bytes. */
uint32_t board_sabertooth_build(uint32_t unit, const uint8_t *payload, uint8_t *out);

/* The line of text with the set-points of a payload: bytes of out[BOARD_TEXT_MAX]; 0: it is too
 * long. */
uint32_t board_text_write(const board_table *table, const uint8_t *payload, uint8_t *out);
/* A line without its end into the places of feedback_payload[]; 0: the text does not match. */
uint32_t board_text_read(const board_text *text, const uint8_t *line, uint32_t count,
                         uint8_t *payload);
