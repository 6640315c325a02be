/* SPDX-License-Identifier: Apache-2.0
 * api_trace.h: the bytes that went over a line, for `motord trace`. Like api.h: typedefs, enums,
 * comments and prototypes, no preprocessor line. The line's thread writes, any thread reads; the
 * oldest entries are overwritten. */
enum { TRACE_BYTES_MAX = 256, TRACE_ENTRIES = 256 };

typedef struct {
    int64_t stamp_ns; /* CLOCK_MONOTONIC */
    uint32_t bytes;   /* number of bytes in `data` */
    uint32_t outward; /* 1: to the drives; 0: from them */
    uint8_t data[TRACE_BYTES_MAX];
} trace_entry;

int line_trace_switch(uint32_t line, int on); /* 0 or -EINVAL: no such line */
uint64_t line_trace_newest(uint32_t line);    /* number of the newest entry; the first is 1 */
/* Returns 1, or 0: the entry is overwritten, or not there yet. */
int line_trace_read(uint32_t line, uint64_t number, trace_entry *out);
