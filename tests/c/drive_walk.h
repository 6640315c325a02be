/* SPDX-License-Identifier: Apache-2.0
 * drive_walk.h: one table of what becomes of a drive in every mode after every event, for the machines of all media. */
#ifndef MOTORD_TESTS_DRIVE_WALK_H
#define MOTORD_TESTS_DRIVE_WALK_H

#include "check.h"
#include "drive_state.h"

typedef enum { FROM_OFF, FROM_READY, FROM_ARMED, FROM_STOPPING, FROM_UNRESPONSIVE, FROM_COUNT } walk_from;

typedef enum {
    SETPOINTS_OLD,
    SETPOINTS_NOT_ENABLED,
    REQUESTED_OFF,
    REQUESTED_READY,
    REQUESTED_ARMED,
    REQUESTED_STAND_DOWN,
    FALLS_SILENT,
    LINE_ENDS,
    EVENT_COUNT
} walk_event;

/* One drive whose wheel turns whatever it is sent. The core's set-points are fresh, enabled, and not zero. */
typedef struct {
    void (*begin)(void); /* OFF */
    void (*set_up)(void);
    void (*arm)(void); /* from READY; where it is not allowed, the request alone */
    void (*request)(uint32_t mode);
    void (*old)(void);
    void (*not_enabled)(void);
    void (*silent)(void); /* NULL: it has neither a set-up nor a reply, and begins READY */
    void (*end)(void);
    void (*go_on)(int64_t for_ns);
    const drive_state *(*state)(void);
    uint64_t (*motion)(void); /* frames with a set-point that is not zero, so far */
} walk_medium;

/* A quick stop goes on for a second: the wheel turns. */
static const uint32_t WALK_LEADS_TO[EVENT_COUNT][FROM_COUNT] = {
    [SETPOINTS_OLD] = {DRIVE_OFF, DRIVE_READY, DRIVE_READY, DRIVE_READY, DRIVE_UNRESPONSIVE},
    [SETPOINTS_NOT_ENABLED] = {DRIVE_OFF, DRIVE_READY, DRIVE_READY, DRIVE_READY, DRIVE_UNRESPONSIVE},
    [REQUESTED_OFF] = {DRIVE_OFF, DRIVE_OFF, DRIVE_OFF, DRIVE_OFF, DRIVE_OFF},
    [REQUESTED_READY] = {DRIVE_READY, DRIVE_READY, DRIVE_ARMED, DRIVE_READY, DRIVE_UNRESPONSIVE},
    [REQUESTED_ARMED] = {DRIVE_OFF, DRIVE_ARMED, DRIVE_ARMED, DRIVE_READY, DRIVE_UNRESPONSIVE},
    [REQUESTED_STAND_DOWN] = {DRIVE_OFF, DRIVE_READY, DRIVE_READY, DRIVE_READY, DRIVE_UNRESPONSIVE},
    [FALLS_SILENT] = {DRIVE_OFF, DRIVE_UNRESPONSIVE, DRIVE_UNRESPONSIVE, DRIVE_UNRESPONSIVE, DRIVE_UNRESPONSIVE},
    [LINE_ENDS] = {DRIVE_OFF, DRIVE_READY, DRIVE_READY, DRIVE_READY, DRIVE_UNRESPONSIVE},
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
    } else if (from == FROM_UNRESPONSIVE) {
        medium->silent();
        medium->go_on(WALK_SETTLES_NS);
        CHECK(medium->state()->mode == DRIVE_UNRESPONSIVE);
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
    default: medium->end(); break;
    }
}

/* Only a drive that is ARMED is sent motion. */
static inline int walk_all(const walk_medium *medium, const char *name)
{
    for (uint32_t from = 0; from < FROM_COUNT; from++) {
        for (uint32_t event = 0; event < EVENT_COUNT; event++) {
            bool replies = from == FROM_OFF || from == FROM_UNRESPONSIVE || event == FALLS_SILENT;
            if (replies && medium->silent == NULL) {
                continue;
            }
            walk_to(medium, (walk_from)from);
            walk_happens(medium, (walk_event)event);
            medium->go_on(WALK_SETTLES_NS);
            uint32_t mode = WALK_LEADS_TO[event][from];
            if (medium->state()->mode != mode) {
                fprintf(stderr, "%s: from %u by event %u: mode %u, not %u\n", name, from, event, medium->state()->mode, mode);
            }
            CHECK(medium->state()->mode == mode);
            uint64_t motion = medium->motion();
            medium->go_on(WALK_WATCHED_NS);
            CHECK((medium->motion() > motion) == (mode == DRIVE_ARMED));
        }
    }
    return checks_report(name);
}

#endif
