# SPDX-License-Identifier: Apache-2.0
"""Histograms with fixed buckets, compared with sorted lists."""

import math

import pytest
from _motord_rt import ffi, lib
from hypothesis import given
from hypothesis import strategies as st

WIDEST = 1 / lib.HISTOGRAM_SUB_BUCKETS
TOP_NS = lib.histogram_bucket_floor_ns(lib.HISTOGRAM_BUCKETS - 1)
inside_ns = st.integers(0, TOP_NS - 1)
any_ns = st.integers(-(2**63), 2**63 - 1)


def filled(values_ns):
    h = ffi.new("histogram *")
    lib.histogram_clear(h)
    for value_ns in values_ns:
        lib.histogram_add(h, value_ns)
    return h


@given(inside_ns)
def test_a_value_lies_in_its_bucket_and_the_bucket_is_narrow(value_ns):
    bucket = lib.histogram_bucket(value_ns)
    low_ns = lib.histogram_bucket_floor_ns(bucket)
    high_ns = lib.histogram_bucket_floor_ns(bucket + 1)
    assert low_ns <= value_ns < high_ns
    assert high_ns - low_ns <= max(1, WIDEST * value_ns)


@given(any_ns, any_ns)
def test_buckets_are_in_the_order_of_their_values(one_ns, other_ns):
    low_ns, high_ns = sorted((one_ns, other_ns))
    assert lib.histogram_bucket(low_ns) <= lib.histogram_bucket(high_ns) < lib.HISTOGRAM_BUCKETS


@given(st.lists(inside_ns, min_size=1, max_size=200), st.floats(0, 1))
def test_a_percentile_is_the_nearest_rank_and_never_too_low(values_ns, fraction):
    exact_ns = sorted(values_ns)[max(math.ceil(fraction * len(values_ns)), 1) - 1]
    got_ns = lib.histogram_percentile_ns(filled(values_ns), fraction)
    assert exact_ns <= got_ns <= min(max(values_ns), exact_ns * (1 + WIDEST))


@given(st.lists(any_ns, min_size=1, max_size=100))
def test_percentiles_rise_and_end_at_the_maximum(values_ns):
    h = filled(values_ns)
    fractions = (0.0, 0.1, 0.5, 0.9, 0.99, 0.999, 1.0)
    got_ns = [lib.histogram_percentile_ns(h, fraction) for fraction in fractions]
    assert got_ns == sorted(got_ns)
    assert got_ns[-1] == h.max_ns == max(0, *values_ns)
    assert h.min_ns == max(0, min(values_ns))
    assert h.samples == sum(h.bucket) == len(values_ns)


@pytest.mark.parametrize("fraction", [math.nan, -math.inf, -1.0])
def test_a_fraction_that_is_nan_or_negative_is_read_as_zero(fraction):
    assert lib.histogram_percentile_ns(filled([3, 9]), fraction) == 3


@pytest.mark.parametrize("fraction", [1.5, math.inf])
def test_a_fraction_beyond_one_is_the_maximum(fraction):
    assert lib.histogram_percentile_ns(filled([3, 9]), fraction) == 9


def test_an_empty_histogram_has_no_percentile():
    assert lib.histogram_percentile_ns(filled([]), 0.99) == 0


@given(st.lists(any_ns, max_size=50))
def test_a_copy_is_the_same_and_a_cleared_one_is_empty(values_ns):
    h, copy = filled(values_ns), ffi.new("histogram *")
    lib.histogram_copy(copy, h)
    assert bytes(ffi.buffer(copy)) == bytes(ffi.buffer(h))
    lib.histogram_clear(h)
    assert not any(bytes(ffi.buffer(h)))
