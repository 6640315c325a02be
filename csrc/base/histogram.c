/* SPDX-License-Identifier: Apache-2.0
 * histogram.c: log-linear buckets, as in G. Tene's HdrHistogram: one for each nanosecond below 16
 * ns, and 16 to each octave above it, so a bucket is never wider than 1/16 of its value. */
#include <math.h>

#include "rt.h"

enum { SUB_BITS = 4 };
_Static_assert(1 << SUB_BITS == HISTOGRAM_SUB_BUCKETS, "buckets of an octave");
_Static_assert((40 - SUB_BITS + 2) * HISTOGRAM_SUB_BUCKETS == HISTOGRAM_BUCKETS,
               "the last octave begins at 2^40 ns");

/* One writer, so load and store suffice. cffi reads the types, so they are plain, and builtins make
 * the accesses atomic. */
static void add_one(uint64_t *counter)
{
    __atomic_store_n(counter, __atomic_load_n(counter, __ATOMIC_RELAXED) + 1, __ATOMIC_RELEASE);
}

uint32_t histogram_bucket(int64_t value_ns)
{
    if (value_ns < HISTOGRAM_SUB_BUCKETS) {
        return value_ns < 0 ? 0 : (uint32_t)value_ns;
    }
    uint64_t value = (uint64_t)value_ns;
    uint32_t shift = 63 - (uint32_t)__builtin_clzll(value) - SUB_BITS;
    uint32_t sub = (uint32_t)(value >> shift) & (HISTOGRAM_SUB_BUCKETS - 1);
    uint32_t bucket = (shift + 1) * HISTOGRAM_SUB_BUCKETS + sub;
    return bucket < HISTOGRAM_BUCKETS ? bucket : HISTOGRAM_BUCKETS - 1;
}

int64_t histogram_bucket_floor_ns(uint32_t bucket)
{
    if (bucket >= HISTOGRAM_BUCKETS) {
        bucket = HISTOGRAM_BUCKETS - 1;
    }
    if (bucket < HISTOGRAM_SUB_BUCKETS) {
        return bucket;
    }
    uint32_t shift = bucket / HISTOGRAM_SUB_BUCKETS - 1;
    int64_t leading = HISTOGRAM_SUB_BUCKETS + bucket % HISTOGRAM_SUB_BUCKETS;
    return leading << shift;
}

void histogram_clear(histogram *h)
{
    __atomic_store_n(&h->samples, 0, __ATOMIC_RELAXED);
    __atomic_store_n(&h->max_ns, 0, __ATOMIC_RELAXED);
    __atomic_store_n(&h->min_ns, 0, __ATOMIC_RELAXED);
    for (uint32_t i = 0; i < HISTOGRAM_BUCKETS; i++) {
        __atomic_store_n(&h->bucket[i], 0, __ATOMIC_RELAXED);
    }
}

/* The extremes are written before the bucket: a reader that sees a sample in a bucket sees extremes
 * that include it. */
void histogram_add(histogram *h, int64_t value_ns)
{
    int64_t value = value_ns < 0 ? 0 : value_ns;
    bool first = __atomic_load_n(&h->samples, __ATOMIC_RELAXED) == 0;
    if (first || value > __atomic_load_n(&h->max_ns, __ATOMIC_RELAXED)) {
        __atomic_store_n(&h->max_ns, value, __ATOMIC_RELAXED);
    }
    if (first || value < __atomic_load_n(&h->min_ns, __ATOMIC_RELAXED)) {
        __atomic_store_n(&h->min_ns, value, __ATOMIC_RELAXED);
    }
    add_one(&h->samples);
    add_one(&h->bucket[histogram_bucket(value)]);
}

/* `samples` of the copy is the sum of its buckets, even if the writer adds meanwhile. */
void histogram_copy(histogram *to, const histogram *from)
{
    uint64_t samples = 0;
    for (uint32_t i = 0; i < HISTOGRAM_BUCKETS; i++) {
        to->bucket[i] = __atomic_load_n(&from->bucket[i], __ATOMIC_ACQUIRE);
        samples += to->bucket[i];
    }
    to->samples = samples;
    to->max_ns = __atomic_load_n(&from->max_ns, __ATOMIC_RELAXED);
    to->min_ns = __atomic_load_n(&from->min_ns, __ATOMIC_RELAXED);
}

/* Nearest rank. The value is the upper edge of the bucket, so no percentile is too low. */
int64_t histogram_percentile_ns(const histogram *h, double fraction)
{
    if (h->samples == 0) {
        return 0;
    }
    double wanted = ceil((fraction > 0 ? fraction : 0) * (double)h->samples);
    uint64_t seen = 0;
    for (uint32_t i = 0; i + 1 < HISTOGRAM_BUCKETS; i++) {
        seen += h->bucket[i];
        if (seen > 0 && (double)seen >= wanted) {
            int64_t edge_ns = histogram_bucket_floor_ns(i + 1) - 1;
            return edge_ns < h->max_ns ? edge_ns : h->max_ns;
        }
    }
    return h->max_ns;
}
