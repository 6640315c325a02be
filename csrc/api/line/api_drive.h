/* SPDX-License-Identifier: Apache-2.0
 * api_drive.h: the state of a drive on any medium: what it may do, why it was disarmed, which stop
 * it has not got yet. The rules for when a drive has to stop are in drive_state.c alone; a medium
 * passes on what it has received and sends the stop. Read by cffi too: lines in asyncio call the
 * same rules. */

/* After a quick stop the power stays on until the wheels are at rest, at most this long. */
enum { DRIVE_STOPPING_NS = 1000000000 };

typedef enum { STOP_NOTHING = 0, STOP_QUICK = 1, STOP_POWER_OFF = 2 } drive_stop;

typedef struct {
    uint32_t mode;             /* drive_mode */
    uint32_t fault_reasons;    /* DRIVE_FAULT_*, since it was set up or armed */
    uint32_t reported_reasons; /* the same, as it was reported */
    uint32_t request_seen;     /* number of the newest request */
    uint32_t enabled;          /* as it reports: 1 yes, 0 no, 2 not known */
    uint32_t epoch;            /* how often it was set up */
    uint32_t still_enabled;    /* how often in a row it reported power without being armed */
    uint32_t stop;             /* pending drive_stop: it goes before all else */
    bool was_enabled;          /* set-points were enabled since it was armed */
    bool sent_motion;          /* set-points that are not zero were sent, and zero not since */
    bool stopping;             /* after a quick stop, until its power goes off */
    bool off_due; /* its own report demands a power-off, which goes out with its cycle */
    bool back;    /* it was unresponsive and answers again: BACK once it has got its power-off */
    int64_t off_by_ns;      /* stopping: power off at that time, at rest or not */
    uint64_t enabled_count; /* of the core's set-points, when it was armed */
} drive_state;

/* The line's input to this step. */
typedef struct {
    int64_t now_ns;
    bool fresh;             /* the core's set-points are */
    bool enabled;           /* they enable the drives */
    bool left_alone;        /* it got nothing for longer than its watchdog's time */
    bool shut_down;         /* the line ends */
    bool position_unknown;  /* it is to be sent a first target, and may not: position_place.h */
    uint64_t enabled_count; /* how often the set-points have become enabled */
} drive_view;

typedef enum {
    REQUEST_NONE = 0,
    REQUEST_SEEN,
    REQUEST_OFF,
    REQUEST_SET_UP,
    REQUEST_ARM,
    REQUEST_STAND_DOWN
} drive_request;

/* The result of a request: the stop goes first. */
typedef struct {
    /* NONE: there is no new one. SEEN: it is not possible now */
    drive_request request;
    drive_stop stop;
    bool overtaken; /* an earlier one was never seen: it may have been a stop */
} drive_answer;

/* The last power-off on a medium that confirms nothing: that a CAN bus took it proves nothing,
 * because the queue also takes frames when the cable is cut. */
typedef struct {
    bool suffices;     /* going out is enough */
    int64_t first_ns;  /* it went out; 0: not yet */
    int64_t newest_ns; /* and again later */
} drive_last_off;

/* A drive that reports whether it is enabled (`enabled` as drive_state has it) is off by its
 * report. Another one is off if a frame of it came between two power-offs: its newest came at
 * `received_ns`. */
bool drive_is_off(const drive_last_off *off, bool reports_enabled, uint32_t enabled,
                  int64_t received_ns);
/* Whether its watchdog has bitten since `last_ns`, when it last got something: it may have stopped
 * by itself. watchdog_ns 0: it has none. */
bool drive_left_alone(int64_t last_ns, int64_t now_ns, int64_t watchdog_ns);
/* Whether set-points that are not zero may go to it. */
bool drive_may_move(const drive_state *drive, bool fresh, bool enabled);
/* It moves, and the newest set-points are zero: zero goes out at once, before its cycle. */
bool drive_has_to_rest(const drive_state *drive, bool wants_motion);
/* Whether new set-points may go out before their cycle; true is counted. In the long run there are
 * no more of them than cycles, and at most EARLY_AT_ONCE in a row: a medium carries at most twice
 * what its cycle needs, however often set-points change. `early_ns` is the medium's: until then
 * they exceed their share. */
enum { EARLY_AT_ONCE = 4 };
bool may_be_early(int64_t *early_ns, int64_t period_ns, int64_t now_ns);
/* Each returns the stop that its medium has to begin. */
drive_stop drive_guard(drive_state *drive, const drive_view *view);
drive_stop drive_quick_stop(drive_state *drive, uint32_t why, int64_t now_ns);
drive_stop drive_power_off(drive_state *drive);
/* Quick stop is over: power off. */
drive_stop drive_end_stopping(drive_state *drive, bool at_rest, int64_t now_ns);
/* It has reported whether it is enabled. `settled`: it is not being armed. DISABLED_ITSELF, or
 * still enabled for so many `tries`. */
drive_stop drive_check_power(drive_state *drive, uint32_t tries, bool settled);
drive_answer drive_obey(drive_state *drive, const mode_request *request, const drive_view *view);
void drive_take_back(drive_state *drive, uint32_t why, uint32_t mode);
/* It has lost its set-up: OFF until it is set up again. */
drive_stop drive_lost_setup(drive_state *drive);
/* It was disarmed for another reason since the last call. */
bool drive_is_changed(drive_state *drive);
/* It does not answer: its state is unknown. Its medium decides what it is still sent. */
void drive_unresponsive(drive_state *drive);
/* It answers again: when it has got its power-off it is BACK. */
drive_stop drive_answers(drive_state *drive);
/* It has got its stop. True: it was unresponsive and is now BACK. */
bool drive_stop_done(drive_state *drive);
