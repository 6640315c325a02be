/* SPDX-License-Identifier: Apache-2.0
 * finding.h: the first bad field of a table, with the path to it. */
#ifndef MOTORD_FINDING_H
#define MOTORD_FINDING_H

#include <math.h>
#include <stdio.h>

#include "rt.h"

typedef struct {
    char *name;
    char path[FIELD_NAME_BYTES];
    bool bad;
} finding;

static inline void need(finding *f, bool good, const char *field)
{
    if (!good && !f->bad) {
        f->bad = true;
        (void)snprintf(f->name, FIELD_NAME_BYTES, "%.40s%.23s", f->path, field);
    }
}

/* Check a set-point's range: it includes 0, which is rest, except for positions, which may be
 * any. */
static inline void check_span(finding *f, uint32_t kind, double offset, double raw_min,
                              double raw_max, double raw_per_s)
{
    bool anywhere = kind == SETPOINT_POSITION;
    need(f, anywhere ? isfinite(offset) : offset == 0.0, "setpoint.raw_offset");
    need(f, raw_min <= (anywhere ? raw_max : 0.0), "setpoint.raw_min");
    need(f, raw_max >= (anywhere ? raw_min : 0.0), "setpoint.raw_max");
    need(f, anywhere ? raw_per_s > 0.0 && isfinite(raw_per_s) : raw_per_s == 0.0,
         "setpoint.raw_per_s");
}

static inline void check_scale(finding *f, const setpoint_scale *scale, uint32_t last_kind,
                               double least, double most)
{
    need(f, scale->joint < JOINTS_MAX, "setpoint.joint");
    need(f, scale->kind <= last_kind, "setpoint.kind");
    need(f, isfinite(scale->raw_per_si) && scale->raw_per_si != 0.0, "setpoint.raw_per_si");
    check_span(f, scale->kind, scale->raw_offset, scale->raw_min, scale->raw_max, scale->raw_per_s);
    need(f, scale->raw_min >= least, "setpoint.raw_min");
    need(f, scale->raw_max <= most, "setpoint.raw_max");
}

static inline void check_meaning(finding *f, const field_meaning *meaning, uint32_t last_kind)
{
    bool counts = meaning->kind == FIELD_COUNT;
    need(f, meaning->joint < JOINTS_MAX, "field.joint");
    need(f, meaning->kind <= last_kind, "field.kind");
    need(f, isfinite(meaning->si_per_raw), "field.si_per_raw");
    need(f, meaning->counter_bits <= 64 && (!counts || meaning->counter_bits >= 1),
         "field.counter_bits");
    need(f, meaning->harmless_codes <= FIELD_HARMLESS_MAX, "field.harmless_codes");
}

#endif
