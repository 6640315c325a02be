/* SPDX-License-Identifier: Apache-2.0
 * ending.h: the end of a line on every medium: armed drives come to rest, all lose their power,
 * then the line is silent. */
#ifndef MOTORD_ENDING_H
#define MOTORD_ENDING_H

#include "drive_state.h"

/* Time limits: until the wheels are at rest, and until all drives have got their power-off. */
static const int64_t END_REST_NS = 350 * 1000000, END_OFF_NS = 480 * 1000000;

typedef enum { END_NOT = 0, END_RESTING = 1, END_POWER_OFF = 2, END_SILENT = 3 } end_stage;

typedef struct {
    uint32_t stage; /* end_stage */
    int64_t rest_by_ns;
    int64_t off_by_ns;
} line_ending;

/* Begin the end if requested. True: it begins now, and each drive is to be stopped by
 * end_stop(). */
static inline bool end_begins(line_ending *end, bool requested, int64_t now_ns)
{
    if (!requested || end->stage != END_NOT) {
        return false;
    }
    *end = (line_ending){
        .stage = END_RESTING, .rest_by_ns = now_ns + END_REST_NS, .off_by_ns = now_ns + END_OFF_NS};
    return true;
}

/* Return the stop of a drive at the end. Its power goes off at the latest with that of the
 * others. */
static inline drive_stop end_stop(const line_ending *end, drive_state *drive, int64_t now_ns)
{
    if (drive->mode != DRIVE_ARMED) {
        return STOP_NOTHING;
    }
    drive_stop stop = drive_quick_stop(drive, 0, now_ns);
    drive->off_by_ns = end->rest_by_ns;
    return stop;
}

/* Whether all drives are to lose their power now. */
static inline bool end_takes_power(line_ending *end, bool stopping, int64_t now_ns)
{
    bool takes = end->stage == END_RESTING && (!stopping || now_ns >= end->rest_by_ns);
    end->stage = takes ? END_POWER_OFF : end->stage;
    return takes;
}

/* Whether the line is silent from now on. `longer_ns`: time beyond its limit, for frames that have
 * to be sent first. */
static inline bool end_is_over(line_ending *end, bool stopping, int64_t longer_ns, int64_t now_ns)
{
    bool over = end->stage == END_POWER_OFF && (!stopping || now_ns >= end->off_by_ns + longer_ns);
    end->stage = over ? END_SILENT : end->stage;
    return over;
}

#endif
