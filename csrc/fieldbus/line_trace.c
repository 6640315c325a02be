/* SPDX-License-Identifier: Apache-2.0
 * line_trace.c: places that are overwritten in turn. The numbers of entries show a reader which
 * ones it missed. */
#include "line_trace.h"

#include <errno.h>
#include <string.h>

line_trace line_traces[LINES_MAX];

void line_trace_put(line_trace *t, bool outward, int64_t stamp_ns, const void *data, uint32_t bytes)
{
    trace_entry entry = {.stamp_ns = stamp_ns, .outward = outward};
    entry.bytes = bytes < TRACE_BYTES_MAX ? bytes : TRACE_BYTES_MAX;
    memcpy(entry.data, data, entry.bytes);
    uint64_t number = atomic_load_explicit(&t->newest, memory_order_relaxed) + 1;
    trace_place *place = &t->place[number % TRACE_ENTRIES];
    seqlock_write(&place->sequence, place->word, number, &entry, TRACE_WORDS);
    atomic_store_explicit(&t->newest, number, memory_order_release);
}

int line_trace_switch(uint32_t line, int on)
{
    if (line >= LINES_MAX) {
        return -EINVAL;
    }
    atomic_store_explicit(&line_traces[line].on, on != 0, memory_order_relaxed);
    return 0;
}

uint64_t line_trace_newest(uint32_t line)
{
    return line < LINES_MAX ? atomic_load_explicit(&line_traces[line].newest, memory_order_acquire)
                            : 0;
}

int line_trace_read(uint32_t line, uint64_t number, trace_entry *out)
{
    if (line >= LINES_MAX || number == 0) {
        return 0;
    }
    const trace_place *place = &line_traces[line].place[number % TRACE_ENTRIES];
    return seqlock_read(&place->sequence, place->word, number, out, TRACE_WORDS);
}
