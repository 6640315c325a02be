/* SPDX-License-Identifier: Apache-2.0
 * api_encoder.h: quadrature encoders of wheels whose drive does not count: by the edges of two GPIO
 * lines, by a counter of the kernel, or by the feedback of a board that another line runs. Pure
 * except encoder_read. cffi reads it, too. */

enum { ENCODER_NONE = 0, ENCODER_EDGES = 1, ENCODER_COUNTER = 2, ENCODER_REPORTED = 3 };

typedef struct {
    uint32_t kind; /* ENCODER_* */
    int32_t fd; /* not blocking. EDGES: a GPIO v2 request of A and B with both edges; COUNTER: its
                   count file */
    uint32_t a_offset; /* EDGES: offset on the chip, as in the events */
    uint32_t b_offset;
    uint32_t levels; /* EDGES: 2 A + B at the start */
    uint32_t reserved;
    uint64_t ceiling; /* COUNTER, REPORTED: last count before 0; UINT64_MAX: the widest possible */
    double rad_per_count; /* angle of the wheel for a count; signed, finite, not 0 */
} encoder_config;

typedef struct {
    int64_t count;   /* edges since the start: four to a period of A */
    int64_t edge_ns; /* time of the newest edge; for a counter, of the look that found another
                        count */
    uint64_t raw;    /* COUNTER: newest raw count */
    uint32_t seeded;
    uint32_t levels;    /* EDGES: 2 A + B */
    uint32_t sequence;  /* EDGES: of the newest event; 0: no event yet */
    uint32_t epoch;     /* another number: edges were lost, so the count has a new origin */
    uint64_t illegal;   /* edges to the level that the line already had: the pulse was too short */
    uint64_t lost;      /* events that the kernel could not keep */
    int64_t from_count; /* count at the end of the last speed measurement */
    int64_t from_ns;
    double counts_per_s;
    int64_t reported_ns; /* REPORTED: stamp of the newest sample; 0: no sample yet */
    uint32_t origin;     /* REPORTED: `origin` of the newest sample */
    uint32_t reserved;
} encoder_state;

typedef struct {
    int64_t count;    /* runs on without wrapping */
    int64_t stamp_ns; /* time of this count on the board */
    uint32_t origin;  /* another number: the board has restarted */
    uint32_t reserved;
} encoder_sample;

void encoder_init(encoder_state *state, const encoder_config *config);
/* Take an event of a line: its level now, the kernel's number of the event, its time. */
void encoder_edge(encoder_state *state, const encoder_config *config, uint32_t offset, bool high,
                  uint32_t sequence, int64_t stamp_ns);
/* Take the present count of a counter. */
void encoder_counter(encoder_state *state, const encoder_config *config, uint64_t raw,
                     int64_t now_ns);
/* Take a count of the board (REPORTED). */
void encoder_reported(encoder_state *state, const encoder_config *config,
                      const encoder_sample *sample);
/* Return the wheel's velocity since the last call. */
double encoder_velocity_rad_s(encoder_state *state, const encoder_config *config, int64_t now_ns);
/* Take the descriptor's events, a limited number of them. Returns 0 or -errno. */
int encoder_read(encoder_state *state, const encoder_config *config, int64_t now_ns);
int encoder_config_check(const encoder_config *config); /* 0 or -EINVAL */
