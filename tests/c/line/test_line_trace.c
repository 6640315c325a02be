/* SPDX-License-Identifier: Apache-2.0
 * The trace of a line: switched off it keeps no entries, switched on it keeps the newest ones, and
 * a reader sees that an entry was overwritten. */
#include <errno.h>
#include <string.h>

#include "check.h"
#include "line_trace.h"

static const uint8_t BYTES[] = {1, 3, 0xF6};

static void while_it_is_off_nothing_is_kept(void)
{
    uint64_t newest = line_trace_newest(0);
    trace_bytes(0, true, 5, BYTES, sizeof BYTES);
    CHECK(line_trace_newest(0) == newest);
}

static void an_entry_is_read_as_it_was_put(void)
{
    trace_entry found;
    CHECK(line_trace_switch(1, 1) == 0);
    trace_bytes(1, true, 5, BYTES, sizeof BYTES);
    trace_bytes(1, false, 6, BYTES, 2);
    CHECK(line_trace_newest(1) == 2 && line_trace_newest(0) == 0);
    CHECK(line_trace_read(1, 1, &found) == 1 && found.stamp_ns == 5 && found.outward == 1 &&
          found.bytes == 3);
    CHECK(memcmp(found.data, BYTES, sizeof BYTES) == 0);
    CHECK(line_trace_read(1, 2, &found) == 1 && found.stamp_ns == 6 && found.outward == 0 &&
          found.bytes == 2);
    CHECK(line_trace_read(1, 3, &found) == 0 && line_trace_read(1, 0, &found) == 0);
}

static void the_oldest_entries_are_overwritten(void)
{
    trace_entry found;
    CHECK(line_trace_switch(2, 1) == 0);
    for (int i = 1; i <= TRACE_ENTRIES + 1; i++) {
        trace_bytes(2, true, i, BYTES, 1);
    }
    CHECK(line_trace_read(2, 1, &found) == 0);
    CHECK(line_trace_read(2, 2, &found) == 1 && found.stamp_ns == 2);
    CHECK(line_trace_read(2, TRACE_ENTRIES + 1, &found) == 1 &&
          found.stamp_ns == TRACE_ENTRIES + 1);
}

static void the_first_bytes_of_an_entry_that_is_too_long_are_kept(void)
{
    static const uint8_t many[TRACE_BYTES_MAX + 1] = {7, [TRACE_BYTES_MAX - 1] = 8,
                                                      [TRACE_BYTES_MAX] = 9};
    trace_entry found;
    CHECK(line_trace_switch(3, 1) == 0);
    trace_bytes(3, false, 1, many, sizeof many);
    CHECK(line_trace_read(3, 1, &found) == 1 && found.bytes == TRACE_BYTES_MAX);
    CHECK(memcmp(found.data, many, TRACE_BYTES_MAX) == 0);
    CHECK(line_trace_switch(3, 0) == 0);
    trace_bytes(3, false, 1, many, 1);
    CHECK(line_trace_newest(3) == 1);
}

static void a_line_that_does_not_exist_has_no_trace(void)
{
    trace_entry found;
    CHECK(line_trace_switch(LINES_MAX, 1) == -EINVAL);
    CHECK(line_trace_newest(LINES_MAX) == 0 && line_trace_read(LINES_MAX, 1, &found) == 0);
}

int main(void)
{
    while_it_is_off_nothing_is_kept();
    an_entry_is_read_as_it_was_put();
    the_oldest_entries_are_overwritten();
    the_first_bytes_of_an_entry_that_is_too_long_are_kept();
    a_line_that_does_not_exist_has_no_trace();
    return checks_report("test_line_trace");
}
