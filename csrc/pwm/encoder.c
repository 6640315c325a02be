/* SPDX-License-Identifier: Apache-2.0
 *
 * encoder.c: count and speed from edges, or from a counter.
 *
 * Speed is counts over the time between edges (the M/T method): Ohmae et al., A
 * microprocessor-controlled high-accuracy wide-range speed regulator for motor drives, IEEE
 * Transactions on Industrial Electronics IE-29(3), 1982. Without an edge it is at most one count in
 * the time since the last one. Events: kernel, include/uapi/linux/gpio.h (v2). */
#include <errno.h>
#include <linux/gpio.h>
#include <math.h>
#include <stdlib.h>
#include <unistd.h>

#include "rt.h"

enum { EVENTS_AT_ONCE = 64, READS_MAX = 16, LEVEL_A = 2, LEVEL_B = 1 };
static const int64_t STOPPED_NS = 250000000; /* time without an edge after which the wheel stands */
static const int64_t SHORTEST_NS = 1000;     /* least time between two measurements: closer edges
                                                are noise */

/* Step by 2 A + B before and now. One of the two lines changes at a time; A before B is forward. */
static const int8_t STEP[16] = {0, -1, 1, 0, 1, 0, 0, -1, -1, 0, 0, 1, 0, 1, -1, 0};

void encoder_init(encoder_state *state, const encoder_config *config)
{
    *state = (encoder_state){.levels = config->levels & (LEVEL_A | LEVEL_B)};
}

void encoder_edge(encoder_state *state, const encoder_config *config, uint32_t offset, bool high,
                  uint32_t sequence, int64_t stamp_ns)
{
    uint32_t missing = sequence - state->sequence - 1;
    if (state->sequence != 0 && missing != 0) {
        state->lost += missing;
        state->epoch++;
    }
    state->sequence = sequence;
    uint32_t line = offset == config->a_offset ? LEVEL_A : LEVEL_B;
    uint32_t now = high ? state->levels | line : state->levels & ~line;
    /* The kernel reads the level after the interrupt: after a short pulse, both events show the
     * level at its end. */
    if (now == state->levels) {
        state->illegal++;
        return;
    }
    state->count += STEP[state->levels << 2 | now];
    state->levels = now;
    state->edge_ns = stamp_ns;
}

/* Return the difference by the shorter of the two directions. */
static int64_t difference(uint64_t now, uint64_t before, uint64_t ceiling)
{
    uint64_t forward = now - before;
    if (now < before) {
        forward += ceiling + 1; /* 2^64 wraps to 0, as it must */
    }
    return forward > ceiling / 2 ? -(int64_t)(ceiling - forward) - 1 : (int64_t)forward;
}

void encoder_counter(encoder_state *state, const encoder_config *config, uint64_t raw,
                     int64_t now_ns)
{
    if (raw > config->ceiling) {
        state->illegal++;
        return;
    }
    int64_t counts = state->seeded ? difference(raw, state->raw, config->ceiling) : 0;
    state->raw = raw;
    state->seeded = 1;
    if (counts == 0) {
        return;
    }
    state->count = (int64_t)((uint64_t)state->count + (uint64_t)counts);
    state->edge_ns = now_ns;
}

void encoder_reported(encoder_state *state, const encoder_config *config,
                      const encoder_sample *sample)
{
    if (state->seeded && sample->origin != state->origin) {
        state->epoch++;
        state->seeded = 0;
    }
    state->origin = sample->origin;
    state->reported_ns = sample->stamp_ns;
    encoder_counter(state, config, (uint64_t)sample->count, sample->stamp_ns);
}

double encoder_velocity_rad_s(encoder_state *state, const encoder_config *config, int64_t now_ns)
{
    int64_t counts = (int64_t)((uint64_t)state->count - (uint64_t)state->from_count);
    int64_t elapsed_ns = state->edge_ns - state->from_ns;
    int64_t silent_ns = now_ns - state->from_ns;
    if (counts != 0 && elapsed_ns >= SHORTEST_NS) {
        if (state->from_ns != 0) {
            state->counts_per_s = (double)counts / ((double)elapsed_ns * 1e-9);
        }
        state->from_count = state->count;
        state->from_ns = state->edge_ns;
    } else if (silent_ns > STOPPED_NS) {
        state->counts_per_s = 0.0;
    } else if (silent_ns > 0 && fabs(state->counts_per_s) * (double)silent_ns * 1e-9 > 1.0) {
        state->counts_per_s = copysign(1e9 / (double)silent_ns, state->counts_per_s);
    }
    return state->counts_per_s * config->rad_per_count;
}

static int read_events(encoder_state *state, const encoder_config *config)
{
    struct gpio_v2_line_event event[EVENTS_AT_ONCE];
    for (int reads = 0; reads < READS_MAX; reads++) {
        ssize_t size = read(config->fd, event, sizeof event);
        if (size < 0) {
            return errno == EAGAIN || errno == EINTR ? 0 : -errno;
        }
        if (size == 0) {
            return -ENODEV;
        }
        size_t events = (size_t)size / sizeof event[0];
        for (size_t i = 0; i < events; i++) {
            encoder_edge(state, config, event[i].offset,
                         event[i].id == GPIO_V2_LINE_EVENT_RISING_EDGE, event[i].seqno,
                         (int64_t)event[i].timestamp_ns);
        }
        if (events < EVENTS_AT_ONCE) {
            return 0;
        }
    }
    return 0;
}

static int read_counter(encoder_state *state, const encoder_config *config, int64_t now_ns)
{
    char text[32], *end;
    ssize_t size = pread(config->fd, text, sizeof text - 1, 0);
    if (size < 0) {
        return errno == EINTR ? 0 : -errno;
    }
    text[size] = '\0';
    errno = 0;
    unsigned long long raw = strtoull(text, &end, 10);
    if (end == text || errno != 0) {
        return -EIO;
    }
    encoder_counter(state, config, raw, now_ns);
    return 0;
}

int encoder_read(encoder_state *state, const encoder_config *config, int64_t now_ns)
{
    if (config->kind == ENCODER_NONE || config->kind == ENCODER_REPORTED) {
        return 0;
    }
    return config->kind == ENCODER_EDGES ? read_events(state, config)
                                         : read_counter(state, config, now_ns);
}

int encoder_config_check(const encoder_config *config)
{
    if (config->kind == ENCODER_NONE) {
        return 0;
    }
    bool lines = config->kind != ENCODER_EDGES || config->a_offset != config->b_offset;
    bool range = config->kind == ENCODER_EDGES || config->ceiling > 0;
    bool file = config->kind == ENCODER_REPORTED || config->fd >= 0;
    bool good = config->kind <= ENCODER_REPORTED && file && lines && range &&
                isfinite(config->rad_per_count) && config->rad_per_count != 0.0;
    return good ? 0 : -EINVAL;
}
