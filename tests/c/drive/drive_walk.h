/* SPDX-License-Identifier: Apache-2.0
 * drive_walk.h: compares the mode of a drive after every event in every mode with
 * drive_walk_table.h, for the machines of all media. */
#ifndef MOTORD_TESTS_DRIVE_WALK_H
#define MOTORD_TESTS_DRIVE_WALK_H

#include "check.h"
#include "drive_state.h"

typedef enum {
    FROM_OFF,
    FROM_READY,
    FROM_ARMED,
    FROM_STOPPING,
    FROM_UNRESPONSIVE,
    FROM_BACK,
    FROM_COUNT
} walk_from;
typedef enum { ON_RS485, ON_CAN, ON_BOARD, ON_BRIDGE, ON_ASYNCIO, ON_ASYNCIO_CAN } walk_kind;
enum { FROM_ANY = -1, ANY = -1 };

#define LEADS_TO(event, ...) event,
#define SENDS_POWER_OFF(...)
#define CANNOT_OCCUR(...)
#define DIFFERS(...)
typedef enum {
#include "drive_walk_table.h"
    EVENT_COUNT
} walk_event;

/* Functions that cause each event on one medium, for a drive whose wheel keeps turning. The core's
 * set-points are fresh, enabled, and not zero. An event that cannot occur on the medium is NULL. */
typedef struct {
    walk_kind kind;
    void (*begin)(void); /* leads to OFF; on a medium without set-up to READY */
    void (*set_up)(void);
    void (*arm)(void); /* arms a READY drive; in other modes only sends the request */
    void (*request)(uint32_t mode);
    void (*old)(void);
    void (*not_enabled)(void);
    void (*silent)(void);
    void (*answers)(void);
    void (*disabled)(void); /* the drive reports that it has lost its power */
    void (*lost_setup)(void);
    void (*still_enabled)(void); /* the drive reports that it has kept its power */
    void (*end)(void);
    void (*go_on)(int64_t for_ns);
    const drive_state *(*state)(void);
    uint64_t (*motion)(void);     /* frames with a set-point that is not zero, so far */
    uint64_t (*power_offs)(void); /* power-offs sent to the drive, so far */
} walk_medium;

#undef LEADS_TO
#define LEADS_TO(event, off, ready, armed, stopping, unresponsive, back)                           \
    {DRIVE_##off,      DRIVE_##ready,        DRIVE_##armed,                                        \
     DRIVE_##stopping, DRIVE_##unresponsive, DRIVE_##back},
static const uint32_t WALK_LEADS_TO[EVENT_COUNT][FROM_COUNT] = {
#include "drive_walk_table.h"
};
#undef LEADS_TO
#undef SENDS_POWER_OFF
#define LEADS_TO(...)
#define SENDS_POWER_OFF(event, from) [event][FROM_##from] = true,
static const bool WALK_SENDS_POWER_OFF[EVENT_COUNT][FROM_COUNT] = {
#include "drive_walk_table.h"
};
#undef SENDS_POWER_OFF
#undef CANNOT_OCCUR
#define SENDS_POWER_OFF(...)
#define CANNOT_OCCUR(medium, event, from, why) {ON_##medium, event, FROM_##from, why},
typedef struct {
    walk_kind kind;
    int event, from;
    const char *why;
} walk_gap;
static const walk_gap WALK_GAPS[] = {
#include "drive_walk_table.h"
};
static const int64_t WALK_SETTLES_NS = 450 * 1000000LL, WALK_WATCHED_NS = 150 * 1000000LL;

static inline void walk_to(const walk_medium *medium, walk_from from)
{
    medium->begin();
    if (from != FROM_OFF) {
        medium->set_up();
    }
    if (from == FROM_ARMED || from == FROM_STOPPING) {
        medium->arm();
        medium->go_on(60 * 1000000LL);
        CHECK(medium->state()->mode == DRIVE_ARMED && medium->motion() > 0);
    }
    if (from == FROM_STOPPING) {
        medium->old();
        medium->go_on(150 * 1000000LL);
        CHECK(medium->state()->mode == DRIVE_READY && medium->state()->stopping);
    } else if (from == FROM_UNRESPONSIVE || from == FROM_BACK) {
        medium->silent();
        medium->go_on(WALK_SETTLES_NS);
        CHECK(medium->state()->mode == DRIVE_UNRESPONSIVE);
    }
    if (from == FROM_BACK) {
        medium->answers();
        medium->go_on(WALK_SETTLES_NS);
        CHECK(medium->state()->mode == DRIVE_BACK);
    }
}

static inline void walk_happens(const walk_medium *medium, walk_event event)
{
    switch (event) {
    case SETPOINTS_OLD: medium->old(); break;
    case SETPOINTS_NOT_ENABLED: medium->not_enabled(); break;
    case REQUESTED_OFF: medium->request(DRIVE_OFF); break;
    case REQUESTED_READY: medium->request(DRIVE_READY); break;
    case REQUESTED_ARMED: medium->arm(); break;
    case REQUESTED_STAND_DOWN: medium->request(DRIVE_STAND_DOWN); break;
    case FALLS_SILENT: medium->silent(); break;
    case ANSWERS_AGAIN: medium->answers(); break;
    case DISABLED_ITSELF: medium->disabled(); break;
    case LOST_SETUP: medium->lost_setup(); break;
    case STILL_ENABLED: medium->still_enabled(); break;
    default: medium->end(); break;
    }
}

static inline bool walk_cannot_occur(walk_kind kind, int event, int from)
{
    for (size_t i = 0; i < sizeof WALK_GAPS / sizeof WALK_GAPS[0]; i++) {
        const walk_gap *gap = &WALK_GAPS[i];
        if (gap->kind == kind && (gap->event == ANY || gap->event == event) &&
            (gap->from == FROM_ANY || gap->from == from)) {
            return true;
        }
    }
    return false;
}

/* Walks through all events from all modes. Only an ARMED drive is sent motion. `cells`: number of
 * pairs of event and mode that can occur. */
static inline int walk_all(const walk_medium *medium, uint32_t cells, const char *name)
{
    uint32_t walked = 0;
    for (uint32_t from = 0; from < FROM_COUNT; from++) {
        for (uint32_t event = 0; event < EVENT_COUNT; event++) {
            if (walk_cannot_occur(medium->kind, (int)event, (int)from)) {
                continue;
            }
            walked++;
            walk_to(medium, (walk_from)from);
            uint64_t motion = medium->motion(), power_offs = medium->power_offs();
            walk_happens(medium, (walk_event)event);
            medium->go_on(WALK_SETTLES_NS);
            uint32_t mode = WALK_LEADS_TO[event][from];
            if (medium->state()->mode != mode) {
                fprintf(stderr, "%s: from %u by event %u: mode %u, not %u\n", name, from, event,
                        medium->state()->mode, mode);
            }
            CHECK(medium->state()->mode == mode);
            if (WALK_SENDS_POWER_OFF[event][from] && medium->power_offs() == power_offs) {
                fprintf(stderr, "%s: from %u by event %u: no power-off\n", name, from, event);
            }
            CHECK(medium->power_offs() > power_offs || !WALK_SENDS_POWER_OFF[event][from]);
            CHECK(medium->motion() == motion || from == FROM_ARMED || mode == DRIVE_ARMED);
            motion = medium->motion();
            medium->go_on(WALK_WATCHED_NS);
            CHECK((medium->motion() > motion) == (mode == DRIVE_ARMED));
        }
    }
    CHECK(walked == cells);
    return checks_report(name);
}

#endif
