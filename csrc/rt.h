/* SPDX-License-Identifier: Apache-2.0
 * rt.h: includes the api*.h for the C compiler. They have no preprocessor line, because cffi reads
 * them, too. */
#ifndef MOTORD_RT_H
#define MOTORD_RT_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "api/api_clock.h"
#include "api/api_imu.h"
#include "api/api_feedback.h"
#include "api/api_position.h"
#include "api/api_speed_loop.h"
#include "api/api_derating.h"
#include "api/api.h"
#include "api/api_core.h"
#include "api/api_loop.h"
#include "api/api_command.h"
#include "api/line/api_line.h"
#include "api/api_trace.h"
#include "api/line/api_drive.h"
#include "api/line/api_can.h"
#include "api/line/api_board.h"
#include "api/api_encoder.h"
#include "api/line/api_bridge.h"
#include "api/api_journal.h"

#endif
