# SPDX-License-Identifier: Apache-2.0
"""Heartbeats: the part that stands still, the reports about it, and how often they come."""

from hypothesis import given
from hypothesis import strategies as st

from motord.control.health import Health, Heart

S = 1_000_000_000


def judge(health, at_s, *counts, within_s=1.0, excused=False):
    hearts = [
        Heart(name=f"heart {n}", count=count, within_s=within_s, excused=excused)
        for n, count in enumerate(counts)
    ]
    return health.judge(round(at_s * S), hearts)


def test_a_counter_that_moves_is_well():
    health = Health()
    assert all(judge(health, second, second).well for second in range(10))


def test_a_counter_that_stands_still_for_longer_than_its_time_is_not():
    health = Health()
    assert judge(health, 0.0, 7).well
    assert judge(health, 1.0, 7).well
    assert judge(health, 1.1, 7).stalled == ("heart 0",)


def test_one_stalled_heart_is_enough():
    health = Health()
    judge(health, 0, 1, 1)
    verdict = judge(health, 2, 2, 1)
    assert not verdict.well
    assert verdict.stalled == ("heart 1",)


def test_a_stop_is_reported_once_and_its_end_once():
    health = Health()
    reports = [judge(health, at_s, 5).messages for at_s in range(8)]
    reports += [judge(health, 8 + at_s, 6 + at_s).messages for at_s in range(4)]
    assert [len(messages) for messages in reports].count(1) == 2
    words = [message for messages in reports for message in messages]
    assert words == [
        "heart 0 has not moved for 2.0 s (at count 5)",
        "heart 0 moves again after 8.0 s (1 stops so far)",
    ]
    assert health.stalls() == {"heart 0": 1}


def test_an_excused_heart_does_not_fail_then_or_at_once_after():
    health = Health()
    judge(health, 0, 5)
    assert judge(health, 10, 5, excused=True).well
    assert judge(health, 10.5, 5).well
    assert not judge(health, 12, 5).well


def test_a_stalled_heart_that_is_excused_is_well_again():
    health = Health()
    judge(health, 0, 5)
    judge(health, 5, 5)
    verdict = judge(health, 6, 5, excused=True)
    assert verdict.well
    assert verdict.messages == ("heart 0 is excused after 6.0 s (1 stops so far)",)


@given(steps=st.lists(st.tuples(st.integers(0, 3), st.integers(0, 2), st.booleans()), max_size=30))
def test_the_report_and_the_verdict_always_agree(steps):
    health, at_s, count, before = Health(), 0, 0, True
    for wait_s, moved, excused in steps:
        at_s, count = at_s + wait_s, count + moved
        verdict = judge(health, at_s, count, excused=excused)
        assert bool(verdict.messages) == (verdict.well != before)
        assert verdict.well or (moved == 0 and not excused)
        before = verdict.well
