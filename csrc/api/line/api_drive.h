/* SPDX-License-Identifier: Apache-2.0
 * api_drive.h: the state of a drive on any medium: whether it may move, why it was disarmed, which
 * stop is still to be sent. drive_state.c alone has the rules for when a drive has to stop; a
 * medium passes on what it received and sends the stop. cffi reads it, too: lines in asyncio call
 * the same rules. */

/* Longest time that the power stays on after a quick stop, until the wheels are at rest. */
enum { DRIVE_STOPPING_NS = 1000000000 };

typedef enum { STOP_NOTHING = 0, STOP_QUICK = 1, STOP_POWER_OFF = 2 } drive_stop;

typedef struct {
    uint32_t mode;             /* drive_mode */
    uint32_t fault_reasons;    /* DRIVE_FAULT_*, since the newest set-up or arming */
    uint32_t reported_reasons; /* the fault_reasons that were reported */
    uint32_t request_seen;     /* number of the newest request */
    uint32_t enabled;          /* the drive's report: 1 yes, 0 no, 2 not known */
    uint32_t epoch;            /* number of set-ups */
    uint32_t still_enabled;    /* number of consecutive reports of power without being armed */
    uint32_t stop;             /* pending drive_stop, which goes before all else */
    bool was_enabled;          /* set-points were enabled since it was armed */
    bool sent_motion;          /* set-points that are not zero were sent, and zero not since */
    bool stopping;             /* after a quick stop, until its power goes off */
    bool off_due; /* the drive's own report demands a power-off, which goes out with its cycle */
    bool back;    /* an unresponsive drive answers again: BACK once it has got its power-off */
    int64_t off_by_ns;      /* while stopping: time of the power-off, at rest or not */
    uint64_t enabled_count; /* count of the core's set-points when the drive was armed */
} drive_state;

/* Input to one step of a drive. */
typedef struct {
    int64_t now_ns;
    bool fresh;             /* the core's set-points are fresh */
    bool enabled;           /* they enable the drives */
    bool left_alone;        /* the drive got nothing for longer than its watchdog's time */
    bool shut_down;         /* the line ends */
    bool position_unknown;  /* the drive needs a first target and may not be sent one:
                               position_place.h */
    uint64_t enabled_count; /* number of times that the set-points became enabled */
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
    /* NONE: no new request. SEEN: a request that is not possible now */
    drive_request request;
    drive_stop stop;
    bool overtaken; /* a previous request was never seen, and may have been a stop */
} drive_answer;

/* The last power-off on a medium that confirms nothing. A CAN bus that takes it proves nothing,
 * because the queue also takes frames when the cable is cut. */
typedef struct {
    bool suffices;     /* sending is enough */
    int64_t first_ns;  /* time when it first went out; 0: not yet */
    int64_t newest_ns; /* time when it last went out */
} drive_last_off;

/* Whether a drive is off. If it reports whether it is enabled (drive_state.enabled), its report
 * decides. Else a frame of it between two power-offs does; its newest came at `received_ns`. */
bool drive_is_off(const drive_last_off *off, bool reports_enabled, uint32_t enabled,
                  int64_t received_ns);
/* Whether a drive's watchdog has expired since `last_ns`, when it last got something: it may have
 * stopped by itself. watchdog_ns 0: no watchdog. */
bool drive_left_alone(int64_t last_ns, int64_t now_ns, int64_t watchdog_ns);
/* Whether set-points that are not zero may go to the drive. */
bool drive_may_move(const drive_state *drive, bool fresh, bool enabled);
/* Whether the drive moves and the newest set-points are zero: zero then goes out at once, before
 * its cycle. */
bool drive_has_to_rest(const drive_state *drive, bool wants_motion);
/* Whether new set-points may go out before their cycle; true is counted. In the long run there are
 * no more of them than cycles, and at most EARLY_AT_ONCE in a row: a medium carries at most twice
 * the frames of its cycles, however often set-points change. The medium keeps `early_ns`: until
 * then they exceed their share. */
enum { EARLY_AT_ONCE = 4 };
bool may_be_early(int64_t *early_ns, int64_t period_ns, int64_t now_ns);
/* Each of these functions returns the stop that the medium has to begin. */
drive_stop drive_guard(drive_state *drive, const drive_view *view);
drive_stop drive_quick_stop(drive_state *drive, uint32_t why, int64_t now_ns);
drive_stop drive_power_off(drive_state *drive);
/* End a quick stop, if it is over, by a power-off. */
drive_stop drive_end_stopping(drive_state *drive, bool at_rest, int64_t now_ns);
/* Check the drive's report on whether it is enabled. `settled`: it is not being armed. Finds
 * DISABLED_ITSELF, or still enabled after so many `tries`. */
drive_stop drive_check_power(drive_state *drive, uint32_t tries, bool settled);
drive_answer drive_obey(drive_state *drive, const mode_request *request, const drive_view *view);
void drive_take_back(drive_state *drive, uint32_t why, uint32_t mode);
/* Note a lost set-up: OFF until it is set up again. */
drive_stop drive_lost_setup(drive_state *drive);
/* Whether the drive was disarmed for another reason since the last call. */
bool drive_is_changed(drive_state *drive);
/* Note that the drive does not answer: its state is unknown. The medium decides what it still
 * sends. */
void drive_unresponsive(drive_state *drive);
/* Note that the drive answers again. `braking`: its probes brake it; it is BACK, and its set-up
 * takes its power when it rests. Else it is BACK when it has got its power-off. */
drive_stop drive_answers(drive_state *drive, bool braking);
/* Note that the drive has got its stop. True: it was unresponsive and is now BACK. */
bool drive_stop_done(drive_state *drive);
