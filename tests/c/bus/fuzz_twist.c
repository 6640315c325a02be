/* SPDX-License-Identifier: Apache-2.0
 * fuzz_twist.c: for any bytes received on DDS as a TwistStamped, nothing beyond them is read, and
 * the age is valid. */
#include <math.h>
#include <string.h>

#include "bus.h"
#include "check.h"

#define FUZZ_NAME "fuzz_twist"
enum { FUZZ_MAX = 160 };

static void once(const uint8_t *data, size_t size)
{
    static uint8_t room[FUZZ_MAX];
    uint8_t *last = room + sizeof room - size; /* at the very end: the sanitizer sees a read beyond
                                                  it */
    memcpy(last, data, size);
    if (size > 16 && data[size - 1] % 2 != 0) {
        last[0] = 0;
        last[1] &= 1;
        last[last[1] == 1 ? 13 : 14] = last[last[1] == 1 ? 14 : 13] = last[last[1] == 1 ? 15 : 12] =
            0;
    }
    stamped_twist twist = {0};
    double age_s = -1.0;
    int code = twist_parse(last, size, &twist);
    CHECK(code == 0 || code == 1 + TWIST_NOT_ONE);
    CHECK(code != 0 || size >= 68 - 8);
    code = stamp_age(twist.stamp_s, 1.8e9, &age_s);
    CHECK(code == 0 ? age_s >= 0.0 && age_s <= 3600.0 : code <= TWIST_REFUSALS);
    CHECK(code != 0 || (isfinite(twist.stamp_s) && twist.stamp_s <= 1.8e9 + 0.5));
}

#include "fuzz.h"
