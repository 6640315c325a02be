/* SPDX-License-Identifier: Apache-2.0
 * Every line of histogram.c. */
#include <math.h>
#include <string.h>

#include "check.h"
#include "rt.h"

static void buckets_are_narrow_and_in_order(void)
{
    CHECK(histogram_bucket(INT64_MIN) == 0 && histogram_bucket(-1) == 0 &&
          histogram_bucket(0) == 0);
    CHECK(histogram_bucket(INT64_MAX) == HISTOGRAM_BUCKETS - 1);
    CHECK(histogram_bucket_floor_ns(HISTOGRAM_BUCKETS + 5) ==
          histogram_bucket_floor_ns(HISTOGRAM_BUCKETS - 1));
    for (uint32_t bucket = 0; bucket < HISTOGRAM_BUCKETS; bucket++) {
        int64_t floor_ns = histogram_bucket_floor_ns(bucket);
        CHECK(histogram_bucket(floor_ns) == bucket);
        if (bucket > 0) {
            CHECK(histogram_bucket(floor_ns - 1) == bucket - 1);
        }
        if (bucket + 1 < HISTOGRAM_BUCKETS && bucket >= HISTOGRAM_SUB_BUCKETS) {
            CHECK((histogram_bucket_floor_ns(bucket + 1) - floor_ns) * HISTOGRAM_SUB_BUCKETS <=
                  floor_ns);
        }
    }
}

static void percentiles_are_never_too_low(void)
{
    static histogram h, copy;
    histogram_clear(&h);
    CHECK(histogram_percentile_ns(&h, 0.5) == 0);
    for (int64_t value_ns = 1000; value_ns >= 1; value_ns--) {
        histogram_add(&h, value_ns);
    }
    histogram_copy(&copy, &h);
    CHECK(copy.samples == 1000 && copy.min_ns == 1 && copy.max_ns == 1000);
    for (int64_t rank = 1; rank <= 1000; rank++) {
        int64_t got_ns = histogram_percentile_ns(&copy, (double)rank / 1000);
        CHECK(got_ns >= rank - 1 && got_ns <= rank + rank / 16 + 1 && got_ns <= 1000);
    }
    CHECK(histogram_percentile_ns(&copy, NAN) == 1 && histogram_percentile_ns(&copy, -1) == 1);
    CHECK(histogram_percentile_ns(&copy, 2) == 1000);
    histogram_add(&h, INT64_MAX);
    histogram_add(&h, INT64_MIN);
    CHECK(h.min_ns == 0 && h.max_ns == INT64_MAX);
    CHECK(histogram_percentile_ns(&h, 1) == INT64_MAX);
}

static void a_histogram_that_is_cleared_holds_nothing(void)
{
    static histogram h, empty;
    memset(&h, 0xAA, sizeof h);
    histogram_clear(&h);
    CHECK(memcmp(&h, &empty, sizeof h) == 0);
}

static void few_samples_have_exact_percentiles_from_the_lowest_to_the_highest_bucket(void)
{
    static histogram h, copy;
    histogram_clear(&h);
    histogram_add(&h, 7);
    CHECK(histogram_percentile_ns(&h, 0.5) == 7 && histogram_percentile_ns(&h, 1.0) == 7);
    histogram_clear(&h);
    for (int64_t value_ns = 0; value_ns < 10; value_ns++) {
        histogram_add(&h, value_ns);
    }
    histogram_copy(&copy, &h);
    CHECK(copy.samples == 10 && histogram_percentile_ns(&copy, 0.1) == 0 &&
          histogram_percentile_ns(&copy, 0.5) == 4);
    const int64_t beyond_ns = INT64_C(1) << 41,
                  before_ns = histogram_bucket_floor_ns(HISTOGRAM_BUCKETS - 2);
    CHECK(histogram_bucket(beyond_ns) == HISTOGRAM_BUCKETS - 1);
    CHECK(histogram_bucket_floor_ns(HISTOGRAM_BUCKETS) ==
          histogram_bucket_floor_ns(HISTOGRAM_BUCKETS - 1));
    histogram_clear(&h);
    histogram_add(&h, before_ns);
    histogram_add(&h, beyond_ns);
    CHECK(histogram_percentile_ns(&h, 0.5) == histogram_bucket_floor_ns(HISTOGRAM_BUCKETS - 1) - 1);
}

int main(void)
{
    buckets_are_narrow_and_in_order();
    percentiles_are_never_too_low();
    a_histogram_that_is_cleared_holds_nothing();
    few_samples_have_exact_percentiles_from_the_lowest_to_the_highest_bucket();
    return checks_report("histogram");
}
