/* SPDX-License-Identifier: Apache-2.0
 * can_machine.h: the inside of a CAN line. Frames and time in, frames out: no clock, no file
 * descriptor, so the same inputs give the same outputs.
 *
 * can_table.c    checks of a table
 * can_values.c   set-points into frames, frames into feedback
 * can_drive.c    one drive: its cycle, its stops, its silence
 * can_machine.c  the line: what it receives, what it sends and when, and its end
 */
#ifndef MOTORD_CAN_MACHINE_H
#define MOTORD_CAN_MACHINE_H

#include "drive_state.h"
#include "ending.h"
#include "pace.h"
#include "position_place.h"
#include "rt.h"

static const int64_t CAN_MS = 1000000, CAN_PROBE_FIRST_NS = 100 * CAN_MS;
static const uint32_t CAN_ID_EXTENDED = 0x80000000U, CAN_ID_REMOTE = 0x40000000U,
                      CAN_ID_ERROR = 0x20000000U;

enum { CAN_WAITING_MAX = 8, CAN_FOR_NOBODY = CAN_DRIVES_MAX + 1 };

/* Hands a frame to the CAN bus. Returns false if the bus takes none now. */
typedef bool (*can_sender)(void *sink, const can_packet *packet);

/* Frames that go before all others. */
typedef struct {
    drive_state state;
    uint32_t joints; /* bit n: joint n of the core */
    uint32_t stops;
    uint32_t orders_sent;
    uint32_t orders_dropped;
    uint32_t faults; /* like can_drive_report, and the next two */
    uint32_t last_fault;
    uint32_t last_fault_joint;
    uint32_t missing;
    uint32_t stop_place;
    drive_last_off last_off;
    bool off_waits;       /* the drive, which reports its power, has not confirmed its power-off */
    int64_t off_ns;       /* time when that last went out */
    int64_t order_ns;     /* time when the newest order went out */
    int64_t power_ns;     /* time of the newest report of the drive's power */
    bool may_turn;        /* armed since its newest set-up, before the line was opened or after */
    int64_t last_sent_ns; /* time when set-points last went out */
    int64_t unresponsive_since_ns;
    int64_t probe_at_ns;
    int64_t probe_pause_ns;
    uint32_t fast;                       /* bit n: input n of the table is fast, ... */
    uint32_t powers;                     /* ... contains the drive's power, ... */
    uint32_t known;                      /* ... has come since the drive was set up */
    int64_t silence_ns[CAN_INPUTS_MAX];  /* copy of the table's, in one place: read in each round */
    int64_t received_ns[CAN_INPUTS_MAX]; /* 0: never */
    int64_t sample_ns[CAN_INPUTS_MAX];   /* stamp of the values in use; 0: no values since the drive
                                            was set up */
    uint8_t held[CAN_OUTPUTS_MAX][CAN_BYTES_MAX];
    uint8_t last_sent[CAN_OUTPUTS_MAX][CAN_BYTES_MAX]; /* newest content of each set-point frame */
    uint64_t cycles;
    uint64_t slow_cycles; /* since the drive was set up */
    uint64_t received;
    uint64_t unresponsive;
    int64_t newest_ns; /* time of the newest frame of any kind */
} can_drive_state;

typedef struct {
    joint_feedback feedback;
    int64_t count_ns; /* stamps of the newest value of each kind; 0: no value */
    int64_t velocity_ns;
    int64_t newest_ns;
    bool no_number;       /* the position is not finite, so there is no feedback */
    uint32_t taken;       /* 1: the drive has taken its target; next it needs a trigger of 0 */
    position_place place; /* position in the numbers of the drive's frames */
    uint32_t fault_word;
} can_joint_state;

/* An identifier and its match in the table. */
typedef struct {
    uint32_t id;
    uint16_t drive;
    uint16_t match;
} can_route;

typedef struct {
    can_table table;
    /* sorted by identifier; those of one identifier in the table's order */
    can_route route[CAN_DRIVES_MAX * CAN_MATCHES_MAX];
    uint32_t route_count;
    can_drive_state drive[CAN_DRIVES_MAX];
    can_joint_state joint[JOINTS_MAX];
    setpoints newest;       /* the core's */
    uint64_t enabled_count; /* number of times that they became enabled */
    can_control control;
    can_order order[CAN_WAITING_MAX];
    uint32_t order_count;
    int64_t now_ns;         /* time of this step */
    uint32_t feedback_mask; /* joints whose feedback is new since it was taken */
    bool receives_own;      /* the CAN bus reports when a set-point frame of motord's has left */
    bool clogged;           /* the CAN bus has taken nothing for a whole cycle */
    bool motion_stays; /* in this step only zero goes out, because motion would wait for a dead CAN
                          bus */
    int64_t motion_since_ns; /* time when set-points that are not zero went out, if nothing was seen
                                to leave since; 0: none */
    line_ending end;
    bool notify; /* there is new data for Python */
    cycle_clock cycle;
    bool early; /* the set-points do not wait for the next cycle */
    uint64_t received;
    uint64_t sent;
    uint64_t tx_full;
    uint64_t bad_frames;
    uint64_t foreign; /* like can_report, and the next one */
    uint32_t foreign_sending;
    can_sender send;
    void *sink;
} can_machine;

/* Set a machine up: every drive OFF; one that may turn gets a stop until it responds. Returns 0 or
 * -EINVAL. */
int can_machine_init(can_machine *m, const can_table *table, const can_before *before,
                     can_sender send, void *sink, int64_t now_ns);
/* Take over drives that another program left running: each is READY and has a quick stop to get, as
 * if it had been armed here. */
void can_take_over(can_machine *m, int64_t now_ns);
/* Take a frame. Sends nothing. Returns its receiver: the number of the drive, CAN_DRIVES_MAX for an
 * error frame, or CAN_FOR_NOBODY. */
uint32_t can_machine_receive(can_machine *m, const can_packet *packet, int64_t stamp_ns,
                             int64_t now_ns);
/* Note that a frame of motord's with this identifier has left. */
void can_machine_left(can_machine *m, uint32_t id);
/* Queue an order. Returns false if there is no room. */
bool can_machine_order(can_machine *m, const can_order *order);
/* Note that the loop has woken the line: set-points that differ from the last ones do not wait for
 * their cycle. */
void can_machine_kick(can_machine *m, int64_t now_ns);
/* Send what is due. Returns the time of the next step, if nothing comes before. */
int64_t can_machine_step(can_machine *m, int64_t now_ns);
void can_machine_report(const can_machine *m, can_report *report);

/* -------------------------------------------------------------------------- can_table.c */
bool can_write_is_good(const can_write *write, uint32_t output_count);

/* ------------------------------------------------------------------------- can_values.c */
/* Return the CLOCK_MONOTONIC time when a frame came, from its age by its wall-clock stamp. That
 * clock may be set while the frame is in transit: no frame is from the future, and none is older
 * than the look that found the socket empty. */
int64_t can_stamp_ns(int64_t age_ns, int64_t emptied_ns, int64_t now_ns);
int64_t can_get(const uint8_t *data, const can_place *place);
void can_put(uint8_t *data, const can_place *place, int64_t raw);
/* Whether the frame of a cycle goes out: an unknown position holds it back. */
bool can_sends(const can_machine *m, uint32_t drive, uint32_t output);
/* Build the frame of a cycle with the newest set-points, zeros, or the drive's position. True: one
 * of them moves the drive. */
bool can_build(const can_machine *m, uint32_t drive, uint32_t output, can_packet *out);
/* Make lasting writes to a frame of positions go out with the newest target only. */
void can_hold_positions(can_machine *m, uint32_t drive, uint32_t output);
bool can_wants_motion(const can_machine *m, uint32_t drive);
/* Note that the frame has left: the next targets begin at its targets. */
void can_note_positions(can_machine *m, uint32_t drive, uint32_t output);
/* Whether the drive has to begin at its own position, which is unknown. */
bool can_place_is_missing(const can_machine *m, uint32_t drive);
/* Note that the drive is not armed: its first target is still to be sent. */
void can_begin_positions(can_machine *m, uint32_t drive);
void can_read(can_machine *m, uint32_t drive, const can_input *input, const uint8_t *data,
              int64_t stamp_ns);
void can_publish(can_machine *m, uint32_t drive);
/* Drop the drive's values, whose state is unknown, and begin a new epoch. */
void can_forget(can_machine *m, uint32_t drive);
bool can_at_rest(const can_machine *m, uint32_t drive);

/* -------------------------------------------------------------------------- can_drive.c */
bool can_send(can_machine *m, const can_packet *packet);
/* Send SYNC: all drives act now on their frames. */
void can_sync(can_machine *m);
bool can_write_out(can_machine *m, uint32_t drive, const can_write *write);
void can_hold_nothing(can_machine *m, uint32_t drive);
void can_obey_request(can_machine *m, uint32_t drive, int64_t now_ns);
void can_guard(can_machine *m, uint32_t drive, int64_t now_ns);
/* Compare the newest report of the drive's power with the expected state. */
void can_check_power(can_machine *m, uint32_t drive, int64_t now_ns);
/* Compare it with a power-off that the drive has not confirmed: it gets the power-off again. */
void can_confirm_off(can_machine *m, uint32_t drive, int64_t now_ns);
/* Begin the stop that the rules of drive_state.h have decided. */
void can_begin_stop(can_machine *m, uint32_t drive, drive_stop stop);
void can_stop_now(can_machine *m, uint32_t drive, uint32_t kind);
void can_send_stop(can_machine *m, uint32_t drive);
/* Note, when the line's end begins, whether the drive has reported no power. */
void can_note_power(can_machine *m, uint32_t drive, int64_t now_ns);
/* Whether the drive has confirmed its last power-off by its report, or, if it cannot report, by
 * responding. Else it gets the power-off again. */
bool can_is_off(const can_machine *m, uint32_t drive);
void can_send_setpoints(can_machine *m, uint32_t drive, int64_t now_ns);
/* Whether the drive's set-point frames would differ from the last ones. */
bool can_differs(const can_machine *m, uint32_t drive);
void can_cycle(can_machine *m, uint32_t drive, int64_t now_ns);

#endif
