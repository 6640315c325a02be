/* SPDX-License-Identifier: Apache-2.0
 * api_encoder.h: quadrature encoders of wheels whose drive does not count: by the edges of two GPIO
 * lines, by a counter of the kernel, or by the feedback of a board that another line runs. Pure
 * but for encoder_read. Read by cffi too. */

enum { ENCODER_NONE = 0, ENCODER_EDGES = 1, ENCODER_COUNTER = 2, ENCODER_REPORTED = 3 };

typedef struct {
    uint32_t kind; /* ENCODER_* */
    int32_t fd; /* not blocking. EDGES: a GPIO v2 request of A and B with both edges; COUNTER: its
                   count file */
    uint32_t a_offset; /* EDGES: on the chip, as the events name the lines */
    uint32_t b_offset;
    uint32_t levels; /* EDGES: 2 A + B when it begins */
    uint32_t reserved;
    uint64_t ceiling; /* COUNTER, REPORTED: after this count comes 0; UINT64_MAX: as wide as it can
                         be */
    double rad_per_count; /* of the wheel; signed, finite, not 0 */
} encoder_config;

typedef struct {
    int64_t count;   /* edges since the start: four to a period of A */
    int64_t edge_ns; /* the newest one; of a counter, the look that found another count */
    uint64_t raw;    /* COUNTER: what it gave last */
    uint32_t seeded;
    uint32_t levels;    /* EDGES: 2 A + B */
    uint32_t sequence;  /* EDGES: of the newest event; 0: none yet */
    uint32_t epoch;     /* another number: edges were lost, so the count has a new origin */
    uint64_t illegal;   /* edges to the level that the line already had: the pulse was too short */
    uint64_t lost;      /* events that the kernel could not keep */
    int64_t from_count; /* where the last measure of the speed ended */
    int64_t from_ns;
    double counts_per_s;
    int64_t reported_ns; /* REPORTED: stamp of the newest sample; 0: none yet */
    uint32_t origin;     /* REPORTED: as the newest sample has it */
    uint32_t reserved;
} encoder_state;

typedef struct {
    int64_t count;    /* running on for ever */
    int64_t stamp_ns; /* when the board counted so far */
    uint32_t origin;  /* another number: the board has restarted */
    uint32_t reserved;
} encoder_sample;

void encoder_init(encoder_state *state, const encoder_config *config);
/* An event of a line: its level now, the kernel's number of the event, its time. */
void encoder_edge(encoder_state *state, const encoder_config *config, uint32_t offset, bool high,
                  uint32_t sequence, int64_t stamp_ns);
/* The present count of a counter. */
void encoder_counter(encoder_state *state, const encoder_config *config, uint64_t raw,
                     int64_t now_ns);
/* REPORTED: the board's count. */
void encoder_reported(encoder_state *state, const encoder_config *config,
                      const encoder_sample *sample);
/* Of the wheel, since the last call. */
double encoder_velocity_rad_s(encoder_state *state, const encoder_config *config, int64_t now_ns);
/* Takes the descriptor's events, a bounded number of them. 0 or -errno. */
int encoder_read(encoder_state *state, const encoder_config *config, int64_t now_ns);
int encoder_config_check(const encoder_config *config); /* 0 or -EINVAL */
