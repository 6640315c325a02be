/* SPDX-License-Identifier: Apache-2.0
 * drive_state.h: api_drive.h for the lines in C, and parts that only they use. */
#ifndef MOTORD_DRIVE_STATE_H
#define MOTORD_DRIVE_STATE_H

#include <stdbool.h>
#include <stdint.h>

#include "rt.h"

static inline bool drive_is_cycled(const drive_state *drive)
{
    return drive->mode == DRIVE_READY || drive->mode == DRIVE_ARMED;
}

#endif
