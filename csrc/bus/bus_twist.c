/* SPDX-License-Identifier: Apache-2.0
 * bus_twist.c: decodes geometry_msgs/TwistStamped in plain CDR (DDS-XTypes 1.3, 7.4.1: encoding
 * version 1), and computes its age.
 *
 *   0  int32   stamp.sec       from the end of the header of 4 bytes, which has the byte order
 *      (RTPS 2.5, 10.2.1.2)
 *   4  uint32  stamp.nanosec
 *   8  uint32  length of frame_id, with its end, then its bytes, then up to 7 bytes, so that what
 *      follows is aligned
 *      double  linear x, y, z, angular x, y, z */
#include <string.h>

#include "bus.h"

enum { HEADER_BYTES = 4, HEAD_BYTES = 12, DOUBLES = 6, LINEAR_Y = 1, ANGULAR_Z = 5 };

static const double AHEAD_MAX_S = 0.5, OLD_S = 3600.0;

/* Read a number byte by byte, independent of this machine's byte order. */
static uint64_t number_at(const uint8_t *at, uint32_t bytes, bool little)
{
    uint64_t value = 0;
    for (uint32_t i = 0; i < bytes; i++) {
        value = value << 8 | at[little ? bytes - 1 - i : i];
    }
    return value;
}

static double double_at(const uint8_t *at, bool little)
{
    uint64_t bits = number_at(at, sizeof bits, little);
    double value;
    memcpy(&value, &bits, sizeof value);
    return value;
}

int twist_parse(const uint8_t *raw, size_t bytes, stamped_twist *out)
{
    if (bytes < HEADER_BYTES + HEAD_BYTES || bytes > TWIST_RAW_MAX || raw[0] != 0 || raw[1] > 1) {
        return 1 + TWIST_NOT_ONE;
    }
    bool little = raw[1] == 1;
    const uint8_t *body = raw + HEADER_BYTES;
    size_t room = bytes - HEADER_BYTES;
    uint64_t frame_bytes = number_at(body + 8, 4, little);
    uint64_t twist_at = (HEAD_BYTES + frame_bytes + 7) & ~(uint64_t)7;
    if (twist_at + DOUBLES * sizeof(double) > room) {
        return 1 + TWIST_NOT_ONE;
    }
    *out = (stamped_twist){
        .stamp_s = (double)(int32_t)(uint32_t)number_at(body, 4, little) +
                   (double)number_at(body + 4, 4, little) * 1e-9,
        .linear_m_s = double_at(body + twist_at, little),
        .lateral_m_s = double_at(body + twist_at + LINEAR_Y * sizeof(double), little),
        .angular_rad_s = double_at(body + twist_at + ANGULAR_Z * sizeof(double), little),
    };
    return 0;
}

int stamp_age(double stamp_s, double wall_s, double *age_s)
{
    if (stamp_s == 0.0) {
        return 1 + TWIST_STAMP_ZERO;
    }
    double age = wall_s - stamp_s;
    if (!(age >= -AHEAD_MAX_S)) { /* also a NaN */
        return 1 + TWIST_STAMP_AHEAD;
    }
    *age_s = age < 0.0 ? 0.0 : age > OLD_S ? OLD_S : age;
    return 0;
}
