/* SPDX-License-Identifier: Apache-2.0
 * rt.h: the api*.h for the C compiler; they have no preprocessor line, because cffi reads them too. */
#ifndef MOTORD_RT_H
#define MOTORD_RT_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "api_clock.h"
#include "api_imu.h"
#include "api_feedback.h"
#include "api_position.h"
#include "api_speed_loop.h"
#include "api_derating.h"
#include "api.h"
#include "api_loop.h"
#include "api_command.h"
#include "api_line.h"
#include "api_trace.h"
#include "api_drive.h"
#include "api_can.h"
#include "api_board.h"
#include "api_encoder.h"
#include "api_bridge.h"
#include "api_journal.h"

#endif
