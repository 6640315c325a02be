/* SPDX-License-Identifier: Apache-2.0
 * board_machine.h: the inside of a board's line. Bytes and time in, bytes out: no clock, no file
 * descriptor, so the same inputs give the same outputs.
 *
 * board_table.c    checks of a table
 * board_frame.c    frames: stuffing, check sum, head
 * board_text.c     lines of text by templates
 * board_json.c     lines of text that are JSON objects
 * board_packets.c  packets of the hoverboard FOC firmware and of the Sabertooth
 * board_clock.c    stamps of this machine's clock from the board's clock
 * board_imu.c      samples of an inertial sensor on the board
 * board_values.c   set-points into a payload, a payload into feedback
 * board_drive.c    what the board is sent, whether it responds, when it has to stop
 * board_machine.c  what it sends, what is sent to it and when, and its end
 */
#ifndef MOTORD_BOARD_MACHINE_H
#define MOTORD_BOARD_MACHINE_H

#include "drive_state.h"
#include "ending.h"
#include "pace.h"
#include "rt.h"

static const int64_t BOARD_MS = 1000000;

enum {
    BOARD_HEAD_BYTES = 8,
    BOARD_SEQUENCES_KEPT = 256,
    BOARD_TYPE_SETPOINTS = 0x01,
    BOARD_TYPE_FEEDBACK = 0x81
};

/* Hands bytes to the port, all or none. Returns false if the port takes none now. */
typedef bool (*board_sender)(void *sink, const uint8_t *bytes, uint32_t count);

typedef struct {
    joint_feedback feedback;
    uint32_t fault_word;
} board_joint;

/* The piece of the stream that has not ended yet. */
typedef struct {
    uint32_t count;
    bool whole; /* text: the beginning of the line was received */
    uint8_t bytes[BOARD_LINE_MAX];
} board_tail;

/* The unread part of a line of text. */
typedef struct {
    const uint8_t *at, *end;
} board_reader;

typedef struct {
    board_table table;
    board_control control;
    setpoints newest;       /* the core's */
    uint64_t enabled_count; /* number of times that they became enabled */
    board_joint joint[JOINTS_MAX];
    board_tail tail;
    hoverboard_tail packet;
    board_clock clock;
    board_order order;
    bool has_order;
    drive_state state;
    bool order_written; /* the order is in the payload and has not gone out yet */
    uint32_t joints;    /* bit n: joint n of the core */
    uint32_t stops;
    uint32_t orders_sent;
    uint32_t orders_dropped;
    line_ending end;
    bool off_suffices;      /* state when the end began: the last power-off only has to go out */
    bool off_waits;         /* the board has not confirmed that power-off */
    int64_t off_first_ns;   /* time when it went out; 0: not yet */
    int64_t off_word_ns;    /* time of feedback after it; 0: none yet */
    int64_t off_again_ns;   /* time when it went out again after that feedback; 0: not yet */
    uint32_t feedback_mask; /* joints whose feedback is new since it was taken */
    imu_sample imu;         /* the newest sample */
    bool imu_is_new;        /* the sample is new since it was taken */
    uint8_t last_sent[BOARD_PAYLOAD_MAX]; /* the newest payload that went out */
    bool notify;                          /* there is new data for Python */
    uint8_t held[BOARD_PAYLOAD_MAX];
    uint8_t feedback_payload[BOARD_PAYLOAD_MAX];
    uint32_t feedback_bytes;
    uint16_t sequence;
    uint16_t next; /* next sequence: newer than any that the board has received from this or an
                      earlier program */
    int64_t sent_ns[BOARD_SEQUENCES_KEPT];
    int64_t written_ns;
    int64_t last_sent_ns; /* time when a frame last went out */
    int64_t received_ns;  /* 0: never */
    int64_t knows_ns;
    int64_t stamp_ns; /* stamp of the newest feedback */
    cycle_clock cycle;
    uint64_t sent;
    uint64_t no_room;
    uint64_t bad_frames;
    uint64_t received;
    uint64_t published;
    uint64_t unresponsive;
    board_sender send;
    void *sink;
    histogram *round_trips; /* NULL: not kept */
} board_machine;

/* Set a machine up: OFF; `epoch` and `sequence` are those of the last start. Returns 0 or
 * -EINVAL. */
int board_machine_init(board_machine *m, const board_table *table, uint32_t epoch,
                       uint16_t sequence, int64_t now_ns);
/* Take over a board that another program left running: it is READY and has a quick stop to get, as
 * if it had been armed here. */
void board_take_over(board_machine *m, int64_t now_ns);
/* Take received bytes. Sends nothing. */
void board_machine_receive(board_machine *m, const uint8_t *bytes, uint32_t count, int64_t now_ns);
/* Queue an order. Returns false if the previous one has not gone out. */
bool board_machine_order(board_machine *m, const board_order *order);
/* Note that the loop has woken the line: set-points that differ from the last ones do not wait for
 * their cycle. */
void board_machine_kick(board_machine *m, int64_t now_ns);
/* Send what is due. Returns the time of the next step, if nothing comes before. */
int64_t board_machine_step(board_machine *m, int64_t now_ns);
void board_machine_report(const board_machine *m, board_report *report);

/* ------------------------------------------------------------------------ board_table.c */
bool board_write_is_good(const board_write *write, uint32_t payload_bytes);

/* ----------------------------------------------------------------------- board_values.c */
int64_t board_get(const uint8_t *data, const board_place *place);
void board_put(uint8_t *data, const board_place *place, int64_t raw);
int64_t board_raw_min(const board_place *place);
int64_t board_raw_max(const board_place *place);
/* Write the set-points of the next frame. True: one of them is not zero. */
bool board_payload(const board_machine *m, uint8_t *payload);
/* Read the fields of the newest feedback. True: all KEPT fields have the values of the set-up. */
bool board_read(board_machine *m);
void board_publish(board_machine *m);
void board_forget(board_machine *m);
bool board_at_rest(const board_machine *m);

/* ------------------------------------------------------------------------- board_text.c */
void board_skip_white(board_reader *r);
bool board_take_one(board_reader *r, const char *of);
bool board_take_number(board_reader *r, double *out);
/* Write a number to its part's place. `end`: end of the last place so far. */
void board_store(const board_part *part, double number, uint8_t *payload, uint32_t *end);

/* ------------------------------------------------------------------------- board_json.c */
/* Like board_text_read, for a line that is a JSON object. */
uint32_t board_json_read(const board_text *text, const uint8_t *line, uint32_t count,
                         uint8_t *payload);

/* -------------------------------------------------------------------------- board_imu.c */
/* Whether a payload is long enough for the inertial sensor that it announces. */
bool board_imu_fits(const uint8_t *payload, uint32_t feedback_bytes);
/* Take a sample from the newest feedback, if it has one and the sensor is used. */
void board_imu_read(board_machine *m);

/* ------------------------------------------------------------------------ board_drive.c */
void board_hold(board_machine *m, const board_write *write, uint32_t count, int64_t now_ns);
void board_power_off(board_machine *m, int64_t now_ns);
/* Note, when the line's end begins, whether the board has reported no power. */
void board_note_power(board_machine *m, int64_t now_ns);
/* Begin the last power-off, which goes out until board_look_for_proof finds that the board has
 * received it. */
void board_last_power_off(board_machine *m, int64_t now_ns);
void board_look_for_proof(board_machine *m);
/* Begin the stop that the rules of drive_state.h have decided. */
void board_begin_stop(board_machine *m, drive_stop stop, int64_t now_ns);
void board_obey_request(board_machine *m, int64_t now_ns);
void board_guard(board_machine *m, int64_t now_ns);
/* Note good feedback. */
void board_received(board_machine *m, int64_t now_ns);
/* Note that the last frame has gone out. */
void board_sent(board_machine *m, int64_t now_ns);

#endif
