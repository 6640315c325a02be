/* SPDX-License-Identifier: Apache-2.0
 *
 * api_board.h: the part of the border for boards on a stream. Read after api_line.h, whose modes,
 * requests and kinds of fields it shares, and like it: typedefs, enums, comments and prototypes, no
 * preprocessor line.
 */

/* -------------------------------------------------------------------------- boards on a stream
 * One board alone on a serial port, or Sabertooths that count as one; one thread. The line sends
 * its payload, with the set-points in it, in every cycle; the board sends its own without a
 * request. Both are bytes with numbers at their places, low byte first. In frames they go as they
 * are (docs/mcu-frame.md); in text (docs/mcu/line-ascii.md) the numbers are written from such
 * places and read into them. */
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
    /* feedback payload: the bytes between start word and check sum */
    HOVERBOARD_VALUE_BYTES = 14,
    HOVERBOARD_SETPOINT_MAX = 1000,
    SABERTOOTH_PACKET_BYTES = 4,
    SABERTOOTH_SETPOINT_BYTES = 3, /* for each driver in the payload: serial time-out, motor 1,
                                      motor 2; motors with sign */
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

/* Place of a joint's set-point in a payload. */
typedef struct {
    board_place place;
    setpoint_scale scale;
} board_setpoint;

/* A value that stays in the payload once written. */
typedef struct {
    board_place place;
    int64_t raw;
} board_write;

/* Place of a value in the board's feedback. */
typedef struct {
    board_place place;
    field_meaning meaning;
} board_field;

typedef enum {
    NUMBER_NONE = 0,
    NUMBER_INTEGER = 1,
    NUMBER_FIXED = 2,
    NUMBER_GENERAL = 3,
    NUMBER_CONSTANT = 4 /* read, JSON: the member must equal raw_per_number, and is not stored */
} board_number_form;

/* A piece of a template: literal_bytes of its literal, then a number. */
typedef struct {
    uint32_t literal_bytes;
    uint32_t form;  /* board_number_form of printf's d, f, g; NONE: no number, only in the last
                       part */
    uint32_t sign;  /* 0; '+' or ' ': put before numbers that are not negative */
    uint32_t zeros; /* 1: filled up with zeros */
    uint32_t width;
    uint32_t precision;
    board_place place; /* read: place for raw = nearest(number raw_per_number), limited to its
                          range */
    double raw_per_number;
    double number_per_raw[BOARD_SETPOINTS_MAX]; /* written: the number is the sum over the
                                                   set-points of raw × this */
} board_part;

typedef struct {
    uint32_t part_count; /* 0: no such text */
    uint32_t json;       /* read: 1: a JSON object; a part's literal is the name of a member, in any
                            order; others are skipped */
    board_part part[BOARD_PARTS_MAX];
    uint8_t literal[BOARD_TEXT_MAX]; /* of all parts, one after the other; any white space matches
                                        any other */
} board_text;

/* An inertial sensor on the board, the robot's [imu]. docs/mcu-frame.md has its place in frames; a
 * text has its rate about z, in units of 1e-6 rad/s. */
typedef struct {
    uint32_t used;        /* 0: no sensor, and the rest is unused */
    uint32_t epoch;       /* epoch of its samples */
    uint32_t axis[3];     /* for the base's x, y, z: the sensor's axis along it, 0, 1 or 2 */
    uint32_t backward[3]; /* 1: the opposite direction */
    board_place rate_z;   /* TEXT */
} board_imu;

typedef struct {
    uint32_t dialect; /* board_dialect */
    /* 0: the board sends nothing, and counts as present while the port takes its bytes */
    uint32_t answers;
    uint32_t tries; /* 1..: number of consecutive reports of power without being armed after which
                       this is reported */
    uint32_t payload_bytes;
    uint32_t feedback_bytes; /* least bytes of the board's payload; TEXT: all of it */
    uint32_t setpoint_count;
    uint32_t field_count;
    uint32_t quick_stop_count;
    uint32_t disarm_count;
    uint32_t mixed;      /* HOVERBOARD: 1: the firmware mixes steer and speed; 0: left and right
                            (TANK_STEERING) */
    uint32_t unit_count; /* SABERTOOTH: drivers on the wire, which move and stop as one drive */
    uint8_t unit[SABERTOOTH_UNITS_MAX]; /* addresses of the drivers, in rising order */
    uint32_t reserved;
    int64_t period_ns;  /* period of the cycle: > 0 */
    int64_t gap_ns;     /* least time from the beginning of a frame to that of the next: the wire
                           carries one at a time */
    int64_t silence_ns; /* time without feedback after which the board is unresponsive: >
                           0 */
    int64_t setpoint_timeout_ns; /* age of set-points that causes a quick stop */
    double rest_velocity_rad_s;  /* a wheel slower than this is at rest: > 0 */
    int64_t watchdog_ns; /* time without set-points while armed after which the board has stopped;
                            0: never */
    uint8_t payload[BOARD_PAYLOAD_MAX]; /* initial content, before anything is written to it */
    board_setpoint setpoint[BOARD_SETPOINTS_MAX];
    board_field field[BOARD_FIELDS_MAX];
    board_write quick_stop[BOARD_WRITES_MAX];
    board_write disarm[BOARD_WRITES_MAX];
    board_text written;
    board_text read;
    board_imu imu;
} board_table;

/* Like line_control, for the one drive. */
typedef struct {
    mode_request request;
    uint32_t shut_down;
    uint32_t reserved;
} board_control;

/* A write of a job. It goes out with its own cycle, so that the board sees each one. */
typedef struct {
    board_write write;
    uint32_t guarded; /* 1: dropped if `stops` differs, because the board was stopped meanwhile */
    uint32_t stops;
} board_order;

typedef struct {
    line_life life;
    uint32_t shut_down;     /* 1: done */
    uint32_t mode;          /* drive_mode */
    uint32_t fault_reasons; /* DRIVE_FAULT_* */
    uint32_t request_seen;
    uint32_t enabled;  /* 1: yes, 0: no, 2: not reported */
    uint32_t stopping; /* a quick stop was sent, and the wheels have not been seen at rest since */
    uint32_t sent_motion;    /* 1: the newest set-points are not zero */
    uint32_t stops;          /* number of stops that were sent to the board, by C or by a request */
    uint32_t epoch;          /* epoch of its feedback */
    uint32_t orders_sent;    /* number of orders that went out */
    uint32_t orders_dropped; /* number of dropped ones: guarded and the board was stopped, or it is
                                unresponsive */
    /* number of bytes in feedback_payload[]; 0: no feedback since it was unresponsive, or ever */
    uint32_t feedback_bytes;
    uint32_t stop_waits; /* the port has not taken the newest stop; at the end: the board has not
                            confirmed it */
    uint32_t reserved;
    uint64_t cycles;
    uint64_t sent;
    uint64_t no_room;    /* frames that the port did not take; the next one is newer */
    uint64_t bad_frames; /* pieces of the stream that were no feedback */
    uint64_t received;
    uint64_t published;    /* number of feedbacks handed to the core since the start */
    uint64_t unresponsive; /* number of times that the board became UNRESPONSIVE */
    int64_t cycle_ns;      /* smoothed time between two cycles */
    int64_t setpoints_ns;  /* stamp of the newest set-points; 0: no set-points yet */
    int64_t received_ns;   /* time of the newest feedback */
    int64_t knows_ns;      /* time when the newest frame that the board had received was sent; TEXT
                              has no such number: received_ns */
    int64_t written_ns;    /* time of the newest change of lasting values in the payload */
    uint32_t fault_word[JOINTS_MAX];             /* whole words, by the core's joint number */
    uint8_t feedback_payload[BOARD_PAYLOAD_MAX]; /* the newest feedback */
} board_report;

typedef struct {
    line_place at;         /* woken by changes of the mode and by orders that were sent */
    uint32_t epoch;        /* epoch of the feedback before this start; 0: none */
    uint32_t left_running; /* another program left the board so: the line begins with a quick stop,
                              without a set-up before it */
} board_config;

/* Check a table. Returns NULL when it is good, else the name of the first bad field. The caller
 * provides name[FIELD_NAME_BYTES]. */
const char *board_table_check(const board_table *table, char *name);

/* Start a board's line: one thread for each board, in static memory. Returns 0; -EINVAL; -EBUSY;
 * -errno of a step that is indispensable. */
int board_start(uint32_t line, const board_config *config, const board_table *table);
int board_stop(uint32_t line); /* joins; 0 or -ESRCH */
void board_put_control(uint32_t line, const board_control *control);
/* Returns 0; -EAGAIN: full; -EINVAL; -ESRCH: no thread. */
int board_put_order(uint32_t line, const board_order *order);
int board_read_report(uint32_t line, board_report *report); /* 0 or -ESRCH: never started */
/* Times from set-points to the feedback that acknowledged them. */
int board_histogram_read(uint32_t line, histogram *out);

/* The pure parts, for comparisons with the same in Python in tests. */
enum { BOARD_FRAME_MAX = 200, BOARD_WIRE_MAX = 258, BOARD_CLOCK_SAMPLES = 32 };

typedef struct {
    uint32_t samples; /* taken so far, or BOARD_CLOCK_SAMPLES */
    uint32_t next;
    uint32_t last_us;
    uint32_t reserved;
    int64_t board_ns;
    int64_t given_ns; /* the newest returned stamp, and the board's time of it */
    int64_t given_board_ns;
    int64_t offset_ns[BOARD_CLOCK_SAMPLES];
} board_clock;

/* Return the CLOCK_MONOTONIC time when a frame with the board's time was made. Zero the clock for a
 * new board. */
int64_t board_clock_stamp(board_clock *clock, uint32_t time_us, int64_t came_ns);

/* Build a frame between zeros. Returns its bytes in out[BOARD_WIRE_MAX]; 0: the payload is too
 * long. */
uint32_t board_frame_build(uint32_t type, uint32_t sequence, uint32_t time_us,
                           const uint8_t *payload, uint32_t payload_bytes, uint8_t *out);
/* Read the frame between two zeros into out[BOARD_FRAME_MAX]. Returns the bytes of head and
 * payload; 0: no frame. */
uint32_t board_frame_parse(const uint8_t *stuffed, uint32_t count, uint8_t *out);

typedef struct {
    uint32_t count;
    uint32_t synced; /* 1: the newest byte ended a frame, or is part of one */
    uint8_t bytes[HOVERBOARD_FEEDBACK_BYTES];
} hoverboard_tail;

typedef enum {
    HOVERBOARD_NOTHING = 0,
    HOVERBOARD_FEEDBACK = 1,
    HOVERBOARD_BAD = 2
} hoverboard_found;

/* Build the command with the set-points of a payload. Returns its bytes in
 * out[HOVERBOARD_COMMAND_BYTES]. */
uint32_t board_hoverboard_build(const uint8_t *payload, uint32_t mixed, uint8_t *out);
/* Take one more byte of the stream. Returns hoverboard_found; FEEDBACK:
 * values[HOVERBOARD_VALUE_BYTES] is filled; BAD: bytes were dropped. */
uint32_t board_hoverboard_take(hoverboard_tail *tail, uint8_t byte, uint8_t *values);
/* Build the packets with the set-points of one driver. Returns their bytes in out[3 *
 * SABERTOOTH_PACKET_BYTES]. */
uint32_t board_sabertooth_build(uint32_t unit, const uint8_t *payload, uint8_t *out);

/* Write the line of text with the set-points of a payload. Returns its bytes in
 * out[BOARD_TEXT_MAX]; 0: it is too long. */
uint32_t board_text_write(const board_table *table, const uint8_t *payload, uint8_t *out);
/* Read a line without its end into the places of feedback_payload[]. Returns 0 if the text does not
 * match. */
uint32_t board_text_read(const board_text *text, const uint8_t *line, uint32_t count,
                         uint8_t *payload);
