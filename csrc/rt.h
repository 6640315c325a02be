/* SPDX-License-Identifier: Apache-2.0
 * rt.h: api.h for the C compiler. api.h itself has no preprocessor line, because cffi reads it too. */
#ifndef MOTORD_RT_H
#define MOTORD_RT_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "api.h"

#endif
