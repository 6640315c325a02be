/* SPDX-License-Identifier: Apache-2.0
 * line_trace.h: the writing side of a line's trace. While the trace is off, it costs one relaxed
 * load. */
#ifndef MOTORD_LINE_TRACE_H
#define MOTORD_LINE_TRACE_H

#include <stdatomic.h>

#include "rt.h"
#include "seqlock.h"

enum { TRACE_WORDS = sizeof(trace_entry) / WORD_BYTES };

typedef struct {
    _Atomic uint64_t sequence;
    _Atomic uint64_t word[TRACE_WORDS];
} trace_place;

typedef struct {
    _Atomic bool on;
    _Atomic uint64_t newest;
    trace_place place[TRACE_ENTRIES];
} line_trace;

extern line_trace line_traces[LINES_MAX];

/* Write an entry; only for the line's thread. No memory, no lock; keeps the first TRACE_BYTES_MAX
 * bytes. */
void line_trace_put(line_trace *t, bool outward, int64_t stamp_ns, const void *data,
                    uint32_t bytes);

static inline void trace_bytes(uint32_t line, bool outward, int64_t stamp_ns, const void *data,
                               uint32_t bytes)
{
    if (atomic_load_explicit(&line_traces[line].on, memory_order_relaxed)) {
        line_trace_put(&line_traces[line], outward, stamp_ns, data, bytes);
    }
}

#endif
