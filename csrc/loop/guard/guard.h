/* SPDX-License-Identifier: Apache-2.0
 * guard.h: the safety pins. guard.c decides, and is pure; output_guard.c reads and writes. */
#ifndef MOTORD_GUARD_H
#define MOTORD_GUARD_H

#include "rt.h"

/* Reading of the emergency stop's input in one tick. */
typedef struct {
    bool known;  /* false: the level could not be read, or the device is gone */
    bool high;   /* present level */
    bool opened; /* an edge to the stopping level since the previous tick */
} estop_reading;

/* Input to the watchdog, once a tick. */
typedef struct {
    int64_t now_ns;
    int64_t heartbeat_ns;      /* time of asyncio's newest heartbeat; 0: never */
    bool enabled;              /* drives are to be enabled */
    uint64_t takes[LINES_MAX]; /* number of times that each line has taken its set-points */
} watchdog_input;

typedef struct {
    uint64_t takes[LINES_MAX];
    int64_t taken_ns[LINES_MAX];
    bool watched[LINES_MAX]; /* it had enabled drives, and has not been seen to work since they were
                                disabled */
    bool was_enabled;
    bool high;
    uint32_t ticks; /* since the last edge */
} watchdog_state;

typedef struct {
    guard_config config;
    watchdog_state watchdog;
    bool lost;                    /* the input's device is lost, permanently */
    _Atomic uint32_t estop_input; /* ESTOP_* */
    _Atomic uint32_t watchdog_well;
    _Atomic uint64_t watchdog_edges;
    _Atomic int32_t watchdog_errno;
} guard;

int guard_config_check(const guard_config *config); /* 0 or -EINVAL */
/* Return ESTOP_*: any sign of a stop is a stop. */
uint32_t estop_judge(const guard_config *config, const estop_reading *reading);
/* Do a step. True: all threads work, and the pin's new level is in state->high. */
bool watchdog_step(watchdog_state *state, const guard_config *config, const watchdog_input *input);

void guard_init(guard *g, const guard_config *config);
/* Read the input. True: stop now. */
bool guard_read_estop(guard *g);
void guard_drive_watchdog(guard *g, const watchdog_input *input);
/* Set the watchdog's last level: low. */
void guard_rest(guard *g);

#endif
