/* SPDX-License-Identifier: Apache-2.0
 * tape.h: the input of a fuzz target as choices, one byte each, and rules for the modes of every
 * machine. */
#ifndef MOTORD_TESTS_TAPE_H
#define MOTORD_TESTS_TAPE_H

#include "check.h"
#include "rt.h"

static const uint8_t *tape;
static size_t tape_left;

static inline void put_tape(const uint8_t *data, size_t size)
{
    tape = data;
    tape_left = size;
}

/* Returns the next byte of the tape, 0 at its end. */
static inline uint8_t next_byte(void)
{
    if (tape_left == 0) {
        return 0;
    }
    tape_left--;
    return *tape++;
}

/* From OFF or BACK, only a request of READY leads to READY. Both requests may have come since the
 * last look. */
static inline void judge_mode(uint32_t before, uint32_t now, const mode_request *asked)
{
    if (now != before) {
        CHECK(now != DRIVE_ARMED || (before == DRIVE_READY && asked->mode == DRIVE_ARMED));
        CHECK(now != DRIVE_READY || before == DRIVE_ARMED || asked->mode == DRIVE_READY);
        CHECK(now != DRIVE_BACK || before == DRIVE_UNRESPONSIVE);
    }
}

#endif
