/* SPDX-License-Identifier: Apache-2.0
 * api_drive.h: what every drive has, whatever its medium: what it may do, why it was taken back,
 * which stop it has not got yet. The rules of when a drive has to stop stand in drive_state.c and
 * nowhere else; a medium says what it knows and sends the stop. Read by cffi too: lines in
 * asyncio call the same rules. */

/* After a quick stop the power stays on until the wheels are at rest, so long at most. */
enum { DRIVE_STOPPING_NS = 1000000000 };

typedef enum { STOP_NOTHING = 0, STOP_QUICK = 1, STOP_POWER_OFF = 2 } drive_stop;

typedef struct {
    uint32_t mode;             /* drive_mode */
    uint32_t fault_reasons;    /* DRIVE_FAULT_*, since it was set up or armed */
    uint32_t reported_reasons; /* the same, as it was reported */
    uint32_t request_seen;     /* number of the newest request */
    uint32_t enabled;          /* as it reports: 1 yes, 0 no, 2 not known */
    uint32_t epoch;            /* how often it was set up */
    uint32_t still_enabled;    /* how often in a row it reported so without being armed */
    uint32_t stop;             /* drive_stop that it has not got yet: it goes before all else */
    bool was_enabled;          /* set-points were enabled since it was armed */
    bool sent_motion;          /* set-points that are not zero were sent, and zero not since */
    bool stopping;             /* after a quick stop, until its power goes off */
    bool off_due; /* its own report demands a power-off, which goes out with its cycle */
    bool back;    /* it was unresponsive and answers again: BACK when it has got its power-off */
    int64_t off_by_ns;      /* stopping: power off then, at rest or not */
    uint64_t enabled_count; /* of the core's set-points, when it was armed */
} drive_state;

/* What its line knows in this step. */
typedef struct {
    int64_t now_ns;
    bool fresh;             /* the core's set-points are */
    bool enabled;           /* they say so */
    bool left_alone;        /* it got nothing for longer than its watchdog waits */
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

/* What becomes of a request: the stop goes first. */
typedef struct {
    /* NONE: there is no new one. SEEN: it requests nothing that can be done */
    drive_request request;
    drive_stop stop;
    bool overtaken; /* one before it was never seen: it may have been a stop */
} drive_answer;

/* The last power-off of a line whose medium confirms nothing: that a CAN bus has taken it says
 * nothing, for a cable may be cut and the queue before it has room. */
typedef struct {
    bool suffices;     /* it has but to go out */
    int64_t first_ns;  /* it went out; 0: not yet */
    int64_t newest_ns; /* and went out again */
} drive_last_off;

/* A drive that reports whether it is enabled (`enabled` as drive_state has it) is off by its
 * report; one that does not, by having spoken between two of them: its newest word came at
 * `received_ns`. */
bool drive_is_off(const drive_last_off *off, bool reports_enabled, uint32_t enabled,
                  int64_t received_ns);
/* It last got something at `last_ns`, and its watchdog has bitten since: it may have stopped by
 * itself. watchdog_ns 0: it has none. */
bool drive_left_alone(int64_t last_ns, int64_t now_ns, int64_t watchdog_ns);
/* Whether set-points that are not zero may go to it. */
bool drive_may_move(const drive_state *drive, bool fresh, bool enabled);
/* It moves, and the newest set-points do not: zero goes out at once, and does not wait for its
 * cycle. */
bool drive_has_to_rest(const drive_state *drive, bool wants_motion);
/* Set-points are to be sent before their cycle, because they are new. True: they may, which is
 * counted. In the long run no more of them than there are cycles, and so many at once: a medium
 * carries at most twice what its cycle needs, however often they change. `early_ns` is the
 * medium's: until then they are more than their share. */
enum { EARLY_AT_ONCE = 4 };
bool may_be_early(int64_t *early_ns, int64_t period_ns, int64_t now_ns);
/* Each returns the stop that its medium has to begin. */
drive_stop drive_guard(drive_state *drive, const drive_view *view);
drive_stop drive_quick_stop(drive_state *drive, uint32_t why, int64_t now_ns);
drive_stop drive_power_off(drive_state *drive);
/* Quick stop is over: power off. */
drive_stop drive_end_stopping(drive_state *drive, bool at_rest, int64_t now_ns);
/* It has reported whether it is enabled. `settled`: no arming goes on. DISABLED_ITSELF, or still
 * enabled for so many `tries`. */
drive_stop drive_check_power(drive_state *drive, uint32_t tries, bool settled);
drive_answer drive_obey(drive_state *drive, const mode_request *request, const drive_view *view);
void drive_take_back(drive_state *drive, uint32_t why, uint32_t mode);
/* It has lost its set-up: OFF until it is set up again. */
drive_stop drive_lost_setup(drive_state *drive);
/* It was taken back for another reason since it was asked last. */
bool drive_is_changed(drive_state *drive);
/* It does not answer: nothing is known of it any more. What it is sent all the same depends on
 * its medium. */
void drive_unresponsive(drive_state *drive);
/* It answers again: when it has got its power-off it is BACK. */
drive_stop drive_answers(drive_state *drive);
/* It has got its stop. True: it was unresponsive, and is BACK. */
bool drive_stop_done(drive_state *drive);
