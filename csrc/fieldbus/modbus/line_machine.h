/* SPDX-License-Identifier: Apache-2.0
 * line_machine.h: the inside of a serial line. Bytes and time in, bytes and the time of the next
 * look out: no clock, no file descriptor, so the same inputs give the same outputs.
 *
 * line_table.c         checks of a table
 * line_begin.c         before the first step
 * line_values.c        set-points into requests, replies into feedback
 * line_drive.c         one drive: its cycle, its failures, its stops
 * line_late.c          replies that come late, and the turn-around of a drive
 * line_unresponsive.c  a drive that does not answer, a line that is never silent
 * line_end.c           the end of a line
 * line_requests.c      requests from outside the cycle
 * line_group.c         one cycle for all drives of the line
 * line_fast.c          one packet with the answers of all
 * line_report.c        the line's report
 * line_machine.c       the line: turns of the drives, and their answers
 */
#ifndef MOTORD_LINE_MACHINE_H
#define MOTORD_LINE_MACHINE_H

#include "drive_state.h"
#include "ending.h"
#include "position_place.h"
#include "rtu.h"

static const int64_t LINE_MS = 1000000;
/* Allowance from the reply's last byte on the wire to its reading: USB frames, receive buffers, a
 * busy machine. */
static const int64_t LINE_HOST_NS = 20 * LINE_MS;

enum { RECEIVED_BYTES_MAX = 2 * FRAME_BYTES_MAX + 64, OWED_MAX = 4 };

/* The features that distinguish one reply from another. */
typedef struct {
    uint32_t reply_bytes;
    uint32_t reply_seal;
    uint32_t head_bytes;
    bool writes;  /* the reply repeats the beginning of its request, ... */
    bool repeats; /* ... or all of it, with the value */
    uint8_t head[FRAME_MATCH_MAX];
} line_look;

/* Equal-looking replies to failed requests, which may still come. */
typedef struct {
    line_look look;
    uint32_t count;
    int64_t until_ns;
} line_owed;

typedef enum { ECHO_NONE = 0, ECHO_FIRST = 1, ECHO_UNKNOWN = 2 } line_echo;

/* One request in progress, and the bytes since it was sent. */
typedef struct {
    line_frame frame;    /* the request as it goes out */
    uint64_t request_id; /* WORK_REQUEST: the caller's id, and the bound of its drive's
                            turn-around */
    int64_t request_turnaround_ns;
    uint32_t received_bytes;
    uint8_t received[RECEIVED_BYTES_MAX];
    uint8_t plain[FRAME_BYTES_MAX]; /* the newest reply without its stuffing */
} line_transaction;

/* Purpose of the exchange in progress. */
typedef enum {
    WORK_NONE = 0,
    WORK_CYCLE,
    WORK_DIRECTION,
    WORK_STOP,
    WORK_BROADCAST,
    WORK_REQUEST,
    WORK_PROBE,
    WORK_GROUP
} line_work;

typedef enum {
    DIRECTION_UNKNOWN = 0,
    DIRECTION_REST = 1,
    DIRECTION_FORWARD = 2,
    DIRECTION_REVERSE = 3
} line_direction_sent;

/* Stage of a drive in its cycle. */
typedef enum {
    STAGE_IDLE = 0,
    STAGE_REST,
    STAGE_SETPOINTS,
    STAGE_DIRECTIONS,
    STAGE_READ,
    STAGE_EXTRA
} line_stage;

/* Position of a drive's reply among the received bytes. */
typedef struct {
    uint32_t offset;
    uint32_t bytes;
} group_reply;

/* The exchange with all drives at once. */
typedef struct {
    uint32_t waiting;     /* bit n: drive n has not answered yet */
    uint32_t answered;    /* bit n: drive n has answered, and continues with its extra exchange */
    uint32_t taken_count; /* replies that were found */
    group_reply taken[LINE_DRIVES_MAX];
    int64_t answered_ns; /* time on the wire of the previous replies */
    bool fast;           /* all answer in one packet */
    uint32_t asked_count;
    uint8_t asked[LINE_DRIVES_MAX]; /* the drives, in the order of their answers */
} group_state;

typedef struct {
    drive_state state;
    uint32_t failures; /* number of failures in a row */
    uint32_t last_failure;
    uint32_t last_exception;
    uint32_t joints; /* bit n: joint n of the core */
    uint32_t stage;  /* line_stage */
    uint32_t place;  /* within the stage */
    uint32_t extra_next;
    uint32_t stop_place; /* the frame that is sent next, or was sent last */
    uint32_t stop_done;  /* bit n: frame n was acknowledged, or is refused permanently */
    uint32_t stop_sent;  /* bit n: frame n was sent at the end, and not answered; the last bit: the
                            read of its power */
    uint32_t stop_failures;
    uint32_t stop_doubts; /* answers to the frame that may have been answers to older requests */
    /* frames of the newest stop count as done although the drive refuses them */
    bool stop_refused;
    uint32_t probe_place;
    uint32_t probes_at_once;
    bool probes_power_off; /* its probes take the power off; before, they brake */
    uint32_t direction_sent[DRIVE_DIRECTIONS_MAX];
    uint32_t enabled_before; /* state.enabled at the beginning of its cycle */
    /* FORWARD or REVERSE, the newest of the two; 0: none yet */
    uint32_t direction_last[DRIVE_DIRECTIONS_MAX];
    bool lost_setup;
    bool may_turn; /* armed since its newest set-up, before the port was opened or after */
    bool cycle_motion;
    bool extra_due;
    int64_t arming_until_ns;
    int64_t due_ns;
    int64_t silent_until_ns; /* end of the time in which a late answer may come: no request before
                                it */
    int64_t held_until_ns;   /* after a doubtful reply: silence until then, except for stops and
                                urgent requests */
    int64_t failed_ns;       /* time of the newest request that it did not answer in time; 0:
                                none */
    int64_t least_ns;        /* shortest certain turn-around; 0: not known */
    uint32_t owed_count;
    line_owed owed[OWED_MAX]; /* in the order of their newest requests */
    int64_t probe_at_ns;
    int64_t probe_pause_ns;
    int64_t braked_ns;   /* an unresponsive drive: from here on it may lose its power */
    int64_t answered_ns; /* time when the newest answered request had been sent */
    int64_t smoothed_ns; /* RFC 6298: SRTT, RTTVAR, RTO of the turn-around */
    int64_t variation_ns;
    int64_t usual_ns;    /* longest usual turn-around; 0: not known */
    int64_t deadline_ns; /* the same, but longer after failures */
    int64_t cycle_start_ns;
    int64_t cycle_ns;
    uint64_t cycle_count; /* number of cycles since the drive was set up */
    setpoints frozen;     /* set-points of this cycle, if directions are sent one by one */
    int64_t last_sent[DRIVE_CYCLIC_MAX][EXCHANGE_SETPOINTS_MAX];
    drive_report count; /* only its counters are used */
} line_drive_state;

typedef struct {
    joint_feedback feedback;
    position_place place;
    int64_t count_ns; /* stamps of the newest value of each kind */
    int64_t velocity_ns;
    int64_t newest_ns;
    uint32_t counts;     /* 1: there is a COUNT field */
    uint32_t measures;   /* 1: there is a VELOCITY field */
    uint32_t place_form; /* 1: its targets have a sign, so its position is read with a sign */
    uint32_t fault_word;
} line_joint_state;

typedef struct line_machine {
    line_table table;
    line_drive_state drive[LINE_DRIVES_MAX];
    line_joint_state joint[JOINTS_MAX];
    setpoints newest;       /* the core's */
    uint64_t enabled_count; /* number of times that they became enabled */
    int64_t now_ns;         /* time of this step */
    line_control control;
    line_request request[LINE_REQUESTS_MAX]; /* the waiting ones; urgent ones first */
    uint32_t request_count;
    uint32_t echo;   /* line_echo */
    uint32_t work;   /* line_work in progress; NONE: the line is free */
    uint32_t worker; /* drive of that work; LINE_DRIVES_MAX: no drive */
    bool sent;       /* the request has left */
    bool notify;     /* there is new data for Python */
    bool notified_shut;
    uint32_t broadcasts; /* frames of broadcast_stop that are still to be sent */
    uint32_t current;    /* drive in the middle of its cycle; LINE_DRIVES_MAX: no drive */
    line_ending end;
    int64_t ours_ns;      /* earliest time of the next request if nothing else sends on the line */
    int64_t free_ns;      /* the same after the newest received byte */
    int64_t silent_ns;    /* time when the line was last seen silent */
    bool noisy;           /* the urgent frame has gone out since then, without silence */
    int64_t urgent_by_ns; /* time when an urgent request goes out, silence or not; 0: none waits */
    int64_t start_ns;     /* start of the request in progress */
    int64_t end_ns;       /* time of its last byte */
    int64_t until_ns;     /* deadline of the answer */
    int64_t bound_ns;     /* waiting time for the turn-around */
    int64_t slot_due_ns;  /* time of the acyclic slot's turn */
    int64_t slot_period_ns;
    uint32_t slot_turn;
    uint32_t feedback_mask;
    uint64_t exchanges;
    uint64_t answers; /* good replies and refusals */
    uint64_t noise_bytes;
    uint32_t stray_bytes;
    uint8_t stray[FRAME_BYTES_MAX]; /* the newest bytes that belong to no answer */
    int64_t round_trip_ns;          /* duration of the exchange that ended in this step; 0: none
                                       ended */
    line_transaction transaction;
    group_state group;
    uint32_t plain_cycles; /* number of complete plain reads until the next fast sync read */
    uint32_t fast_pause;   /* the same, after the last failure of a fast one */
    line_answer answer;
    bool answered;
} line_machine;

/* Return the time that a cyclic request waits for the first byte of its reply. */
static inline int64_t line_deadline_ns(const line_machine *m, uint32_t number)
{
    int64_t fixed_ns = m->table.drive[number].reply_timeout_ns;
    return fixed_ns > 0 ? fixed_ns : m->drive[number].deadline_ns;
}

/* Work for the thread after a step. */
typedef struct {
    const uint8_t *send; /* write these bytes now, then call line_machine_sent; NULL: nothing */
    uint32_t send_bytes;
    uint32_t feedback_mask; /* joints whose machine->joint[].feedback is new */
    bool answered;          /* machine->answer is new */
    bool notify;
    int64_t wake_ns; /* time of the next step, if no bytes, requests or wake come before */
} line_output;

/* Set a machine up (line_begin.c): every drive OFF; one that `may_turn` gets a stop before all
 * else. Returns 0 or -EINVAL. */
int line_machine_init(line_machine *m, const line_table *table, uint32_t may_turn, int64_t now_ns);
/* Take over drives that another program left running: each is READY and has a quick stop to get, as
 * if it had been armed here. */
void line_take_over(line_machine *m, int64_t now_ns);
/* Queue a request. Returns false if there is no room. */
bool line_machine_request(line_machine *m, const line_request *request);
/* Note new set-points of the core: a drive whose set-points change is due at once. */
void line_machine_kick(line_machine *m, int64_t now_ns);
void line_machine_step(line_machine *m, int64_t now_ns, const uint8_t *bytes, uint32_t count,
                       line_output *out);
void line_machine_sent(line_machine *m, int64_t now_ns);
void line_machine_report(const line_machine *m, line_report *report);

/* ------------------------------------------------------------------------- line_table.c */
/* Whether a request can be sent and its answer recognised, without a read beyond its own bytes. */
bool line_frame_is_good(const line_frame *frame);

/* ---------------------------------------------------------------------- line_requests.c */
void line_drop_request(line_machine *m, uint32_t place);
void line_answer_request(line_machine *m, uint64_t id, uint32_t kind, int64_t now_ns);
void line_expire_request(line_machine *m, int64_t now_ns);
/* Return the place of the first request that may be sent now; LINE_REQUESTS_MAX: no request. */
uint32_t line_pick_request(const line_machine *m, int64_t now_ns);

/* ------------------------------------------------------------------------ line_values.c */
/* Whether the exchange goes out: an unknown position, or that of a joint that may not move, holds
 * it back. */
bool line_sends(const line_machine *m, uint32_t drive, uint32_t turn);
/* Build the request of an exchange with the newest set-points, sealed. True: one of them is not
 * zero, or is a position. */
bool line_build(line_machine *m, uint32_t drive, uint32_t turn, line_frame *out);
/* Do the same without the check sum. */
bool line_fill(line_machine *m, uint32_t drive, uint32_t turn, line_frame *out);
/* Take the values of a good reply. */
void line_read(line_machine *m, uint32_t drive, const line_exchange *turn, const uint8_t *reply,
               int64_t stamp_ns);
/* Return the direction of the newest set-points: REST, FORWARD, REVERSE. */
uint32_t line_direction_wanted(const line_machine *m, uint32_t drive, uint32_t direction);
/* Return the set-point that may go to the drive now: the joint's, or 0 unless armed, fresh and
 * enabled. */
double line_wanted(const line_machine *m, uint32_t drive, uint32_t joint, uint32_t kind);
bool line_wants_motion(const line_machine *m, uint32_t drive);
/* Whether a joint of the drive has to begin at its own position, which is unknown. */
bool line_place_is_missing(const line_machine *m, uint32_t drive);
/* Note that the drive is not armed: its first targets are still to be sent. */
void line_begin_positions(line_machine *m, uint32_t drive);
/* Whether the drive would now get other set-points than the last ones. */
bool line_differs(line_machine *m, uint32_t drive);
/* Drop the drive's values, which are not known any more. */
void line_forget(line_machine *m, uint32_t drive);
void line_publish(line_machine *m, uint32_t drive);
/* Whether all wheels of the drive are seen at rest. */
bool line_at_rest(const line_machine *m, uint32_t drive);

/* ------------------------------------------------------------------------- line_drive.c */
bool line_fresh(const line_machine *m, int64_t now_ns);
void line_obey_request(line_machine *m, uint32_t drive, int64_t now_ns);
/* Do what the set-points, the watchdog and the drive's own reports demand. */
void line_guard(line_machine *m, uint32_t drive, int64_t now_ns);
/* Begin the stop that the rules of drive_state.h have decided. */
void line_begin_stop(line_machine *m, uint32_t drive, drive_stop stop, int64_t now_ns);
void line_stop_now(line_machine *m, uint32_t drive, uint32_t kind);
/* Stop a drive that was armed before the port was opened. */
void line_stop_before_setup(line_machine *m, uint32_t drive, int64_t now_ns);
/* Put the next frame of the drive's cycle into the transaction. False: the cycle is over. */
bool line_next_in_cycle(line_machine *m, uint32_t drive, int64_t now_ns, line_frame *out);
bool line_next_stop(line_machine *m, uint32_t drive, line_frame *out);
/* Note that the answer may belong to an older request. */
void line_stop_doubted(line_machine *m, uint32_t drive);
void line_cycle_begin(line_machine *m, uint32_t drive, int64_t now_ns);
/* End the exchange for a drive, with an answer or a failure. */
void line_drive_answered(line_machine *m, uint32_t drive, const uint8_t *reply, int64_t now_ns);
void line_drive_failed(line_machine *m, uint32_t drive, uint32_t failure, uint32_t exception,
                       int64_t now_ns);
/* Count a failure: at its turn the line was not silent for too long. */
void line_drive_not_reached(line_machine *m, uint32_t drive, int64_t now_ns);
int64_t line_reply_ns(const line_machine *m, const line_frame *frame);

/* -------------------------------------------------------------------------- line_late.c */
/* Note that the request in progress has failed: its reply may still come. */
void line_owe(line_machine *m, uint32_t drive);
/* Whether a reply to this request, sent then, could belong to an older one, and mean something
 * else. */
bool line_may_be_late(const line_machine *m, uint32_t drive, const line_frame *frame,
                      int64_t sent_ns);
/* The same for the reply that has just come, also because it came sooner than the drive can
 * answer. */
bool line_is_doubtful(line_machine *m, uint32_t drive, int64_t now_ns);
/* Accept the reply that has just come as certain, or as doubtful. */
void line_settle(line_machine *m, uint32_t drive, int64_t now_ns);
void line_doubt(line_machine *m, uint32_t drive, int64_t now_ns);
/* Doubt the echo, when no drive is understood: the adapter may not echo any more. */
void line_doubt_echo(line_machine *m);
/* Return the bytes of a found reply, as its frame numbers them. */
const uint8_t *line_reply(line_machine *m, const received *found);
/* Take bytes that belong to no answer: noise, or a late reply. */
void line_stray(line_machine *m, const uint8_t *bytes, uint32_t count, int64_t now_ns);
void line_sort_received(line_machine *m, const received *verdict, int64_t now_ns);
void line_learn_turnaround(line_machine *m, uint32_t drive, int64_t now_ns);
/* Return the turn-around by measurements, else by the profile; never longer than the wait for
 * replies. */
int64_t line_expected_turnaround_ns(const line_machine *m, uint32_t drive);
/* Return the time when the values of the reply that has just come were measured. */
int64_t line_stamp(const line_machine *m, uint32_t drive, int64_t now_ns);

/* ------------------------------------------------------------------ line_unresponsive.c */
void line_becomes_unresponsive(line_machine *m, uint32_t drive, int64_t now_ns);
void line_next_probe(line_machine *m, uint32_t drive, int64_t now_ns, line_frame *out);
/* Return an exchange of the cycle; the extra ones follow after the cyclic ones. */
const line_exchange *line_exchange_at(const line_drive *table, uint32_t place);
/* Return the place of the exchange that probes the drive. */
uint32_t line_probe_place(const line_drive *table);
/* Build the request of an exchange for a drive that is not armed. */
void line_build_read(line_machine *m, uint32_t drive, uint32_t place, line_frame *out);
/* Return the first unresponsive drive that may be probed now, among those that may turn or all;
 * LINE_DRIVES_MAX: no drive. */
uint32_t line_due_probe(const line_machine *m, bool may_turn, int64_t now_ns);
/* Whether an urgent frame still goes out on a line that is not silent. */
bool line_ends_patience(line_machine *m, int64_t now_ns);

/* ------------------------------------------------------------------------- line_group.c */
bool line_group_is_good(const line_table *table);
/* Build the cycle's one request. False: there is nothing to send. */
bool line_group_begin(line_machine *m, int64_t now_ns, line_frame *out);
/* Return the waiting time for the replies to the request in progress. */
int64_t line_group_wait_ns(const line_machine *m);
/* Do a step, when bytes have come or the time is over. */
void line_group_step(line_machine *m, const uint8_t *bytes, uint32_t count, int64_t now_ns);
/* Make the next drive that has answered `current`: it continues its cycle. False: there is no such
 * drive. */
bool line_group_goes_on(line_machine *m);
void line_group_answered(line_machine *m, uint32_t drive, const uint8_t *reply, int64_t stamp_ns);
/* End a drive's part in the exchange of all, with an answer or without. Its answer in a packet of
 * all is in transaction.plain. */
void line_group_end_member(line_machine *m, uint32_t drive, uint32_t kind, const received *found,
                           int64_t now_ns);

/* -------------------------------------------------------------------------- line_fast.c */
bool line_fast_is_good(const line_table *table);
/* Whether the next read of all is a fast one. */
bool line_fast_begins(const line_machine *m);
/* Turn a sync read of group.asked[] into a fast one. Returns the bytes of its one answer. */
uint32_t line_fast_request(line_machine *m, line_frame *packet);
/* Take the received part of the answer, which begins there. */
void line_fast_look(line_machine *m, uint32_t from, int64_t now_ns);
/* End a read of all; `all`: each drive has answered. */
void line_fast_end(line_machine *m, bool all);

/* --------------------------------------------------------------------------- line_end.c */
void line_shut_down(line_machine *m, int64_t now_ns);
/* Whether the first extra exchange goes out in every cycle: it reads the drive's power, which is
 * not known. */
bool line_power_first(const line_machine *m, uint32_t drive);
/* Whether the last power-off has frames that the drive does not acknowledge: then the read after
 * them decides. */
bool line_reads_power(const line_machine *m, uint32_t drive);
/* Build that read. line_is_off evaluates it: true if the drive has no power, or cannot report
 * it. */
void line_build_power_read(line_machine *m, uint32_t drive, line_frame *out);
bool line_is_off(line_machine *m, uint32_t drive, const uint8_t *reply, int64_t stamp_ns);

#endif
