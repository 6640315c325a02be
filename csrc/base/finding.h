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

static inline void check_scale(finding *f, const setpoint_scale *scale, uint32_t last_kind, double least, double most)
{
    need(f, scale->joint < JOINTS_MAX, "setpoint.joint");
    need(f, scale->kind <= last_kind, "setpoint.kind");
    need(f, isfinite(scale->raw_per_si) && scale->raw_per_si != 0.0, "setpoint.raw_per_si");
    need(f, scale->raw_min <= 0.0 && scale->raw_min >= least, "setpoint.raw_min");
    need(f, scale->raw_max >= 0.0 && scale->raw_max <= most, "setpoint.raw_max");
}

static inline void check_meaning(finding *f, const field_meaning *meaning, uint32_t last_kind)
{
    bool counts = meaning->kind == FIELD_COUNT;
    need(f, meaning->joint < JOINTS_MAX, "field.joint");
    need(f, meaning->kind <= last_kind, "field.kind");
    need(f, isfinite(meaning->si_per_raw), "field.si_per_raw");
    need(f, meaning->counter_bits <= 64 && (!counts || meaning->counter_bits >= 1), "field.counter_bits");
    need(f, meaning->harmless_codes <= FIELD_HARMLESS_MAX, "field.harmless_codes");
}

#endif
