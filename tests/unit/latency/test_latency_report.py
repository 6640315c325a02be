# SPDX-License-Identifier: Apache-2.0
"""The numbers of `motord latency`: percentiles, tallies, classes, arrivals."""

import json
import math
import platform

import pytest
from hypothesis import given
from hypothesis import strategies as st

from motord.tools.latency.causes.machine import (
    CpuTimes,
    cpu_model,
    is_preempt_rt,
    is_virtual,
    machine_facts,
)
from motord.tools.latency.peer import Tally
from motord.tools.latency.report import NOTHING, Spread, latency_class
from motord.tools.latency.rig import Arrivals

values_ns = st.lists(st.integers(min_value=0, max_value=2**50), min_size=1, max_size=300)


def counted(values):
    return {value: values.count(value) for value in set(values)}


@given(values_ns)
def test_percentiles_are_those_of_the_nearest_rank(values):
    ordered = sorted(values)
    spread = Spread.of_counts(counted(values), len(values), max(values))
    for fraction, sent in ((0.5, spread.p50), (0.99, spread.p99), (0.999, spread.p99_9)):
        assert sent == ordered[math.ceil(fraction * len(values)) - 1]
    assert spread.p50 <= spread.p99 <= spread.p99_9 <= spread.max == ordered[-1]


def test_uncounted_samples_are_reported_as_the_maximum():
    spread = Spread.of_counts({10: 50}, samples=100, maximum=700.0)
    assert (spread.p50, spread.p99, spread.max) == (10.0, 700.0, 700.0)


def test_nothing_measured_is_null_in_json():
    found = NOTHING.to_json()
    assert found == {"samples": 0, "p50": None, "p99": None, "p99_9": None, "max": None}
    assert Spread.of_counts({}, 0, 0.0) is NOTHING
    assert math.isnan(NOTHING.scaled(1e-3).max)


@given(values_ns)
def test_a_tally_reports_no_value_too_low_and_none_much_too_high(values):
    tally = Tally()
    for value in values:
        tally.add(value)
    assert tally.samples == sum(tally.counts.values()) == len(values)
    assert tally.max_ns == max(values)
    ordered = sorted(values)
    sent = sorted(step for step, count in tally.counts.items() for _ in range(count))
    assert all(
        value <= step < value * (1 + 1 / 64) + 1 for value, step in zip(ordered, sent, strict=True)
    )


@given(values_ns)
def test_a_tally_gives_ordered_percentiles_that_stay_below_its_maximum(values):
    tally = Tally()
    for value in values:
        tally.add(value)
    spread = Spread.of_counts(tally.counts, tally.samples, tally.max_ns)
    assert spread.p50 <= spread.p99 <= spread.p99_9 <= spread.max


@pytest.mark.parametrize(
    ("worst_us", "name"),
    [
        (0.0, "good"),
        (20.0, "good"),
        (math.nextafter(20.0, 21.0), "usable"),
        (50.0, "usable"),
        (math.nextafter(50.0, 51.0), "hardware stepping only"),
        (500.0, "hardware stepping only"),
        (math.nextafter(500.0, 501.0), "unusable"),
        (math.inf, "unusable"),
        (math.nan, "unusable"),
    ],
)
def test_a_border_belongs_to_the_better_class_and_nan_to_the_worst(worst_us, name):
    assert latency_class(worst_us).name == name


def test_a_class_is_shown_with_its_bound_in_text_and_json():
    assert str(latency_class(33.0)) == "usable (≤ 50 µs)"
    assert str(latency_class(501.0)) == "unusable (> 500 µs)"
    found = json.loads(json.dumps(latency_class(501.0).to_json(), allow_nan=False))
    assert found["limit_us"] is None
    assert found["meaning"]


def ages(arrivals):
    return sorted(s for s, n in arrivals.age.counts.items() for _ in range(n))


def test_each_notified_tick_is_counted_once_with_its_age():
    arrivals = Arrivals(every_ticks=1)
    arrivals.take(tick=10, stamp_ns=1000, taken_ns=1005)
    arrivals.take(tick=11, stamp_ns=2000, taken_ns=2030)
    arrivals.take(tick=11, stamp_ns=2000, taken_ns=2900)
    arrivals.take(tick=12, stamp_ns=3000, taken_ns=3001)
    assert ages(arrivals) == [1, 30]


def test_ticks_that_asyncio_slept_through_count_with_the_age_that_they_had():
    arrivals = Arrivals(every_ticks=1)
    arrivals.take(tick=1, stamp_ns=0, taken_ns=0)
    arrivals.take(tick=5, stamp_ns=40, taken_ns=41)
    assert ages(arrivals) == [1, 11, 21, 31]


def test_ticks_between_notifications_wake_nothing_and_are_not_counted():
    arrivals = Arrivals(every_ticks=4)
    arrivals.take(tick=6, stamp_ns=60, taken_ns=60)
    arrivals.take(tick=7, stamp_ns=70, taken_ns=99)
    assert ages(arrivals) == []
    arrivals.take(tick=13, stamp_ns=130, taken_ns=133)
    assert ages(arrivals) == [13, 53]


@given(
    every=st.integers(1, 20),
    steps=st.lists(st.tuples(st.integers(0, 50), st.integers(0, 2000)), min_size=1, max_size=40),
)
def test_no_notified_tick_is_lost_or_counted_twice_and_no_age_is_negative(every, steps):
    arrivals = Arrivals(every)
    first = tick = 1000
    stamp_ns = 10**9
    arrivals.take(tick, stamp_ns, stamp_ns)
    for ticks, late_ns in steps:
        tick, stamp_ns = tick + ticks, stamp_ns + 1000 * ticks
        arrivals.take(tick, stamp_ns, stamp_ns + late_ns)
    assert arrivals.age.samples == tick // every - first // every
    assert all(step >= 0 for step in arrivals.age.counts)


@pytest.mark.parametrize(
    ("version", "sys_realtime", "expected"),
    [
        ("#1 SMP PREEMPT_DYNAMIC Debian 6.1.147-1", "", False),
        ("#1 SMP PREEMPT_RT Debian 6.1.147-1", "", True),
        ("#1 SMP PREEMPT RT Sat Mar 1", "", True),
        ("#1 SMP PREEMPT Sat Mar 1", "1\n", True),
        ("#1 SMP PREEMPT Sat Mar 1", "0\n", False),
    ],
)
def test_a_real_time_kernel_is_recognized_by_its_version_or_by_sysfs(
    version, sys_realtime, expected
):
    assert is_preempt_rt(version, sys_realtime) is expected


def test_a_board_names_itself_in_the_device_tree_and_a_pc_in_cpuinfo():
    cpuinfo = "processor\t: 0\nmodel name\t: Some CPU: 3 GHz\nflags\t\t: fpu hypervisor avx\n"
    assert cpu_model(cpuinfo, "") == "Some CPU: 3 GHz"
    assert cpu_model("processor\t: 0\n", "A Board Model B Rev 1.0\0") == "A Board Model B Rev 1.0"
    assert cpu_model("", "") == ""
    assert is_virtual(cpuinfo)
    assert not is_virtual(cpuinfo.replace("hypervisor ", ""))
    assert not is_virtual("")


def test_steal_is_a_share_of_all_processor_time_between_two_readings():
    before = CpuTimes.parse("cpu  100 0 50 800 10 5 5 30 7 0\ncpu0 1 2 3\n")
    after = CpuTimes.parse("cpu  150 0 60 930 10 5 5 40 99 0\ncpu0 1 2 3\n")
    assert before == CpuTimes(total=1000, steal=30)
    assert after.steal_percent_since(before) == pytest.approx(5.0)
    assert after.steal_percent_since(after) == 0.0
    assert CpuTimes.parse("cpu  1 2 3 4\n") == CpuTimes(total=10, steal=0)
    assert CpuTimes.now().total > 0


def test_the_machine_is_described_but_not_named():
    facts = machine_facts()
    assert facts["kernel"] == platform.release()
    assert facts["cpu_count"] >= facts["cpus_allowed"] >= 1
    assert platform.node() not in facts.values()
    json.dumps(facts, allow_nan=False)
