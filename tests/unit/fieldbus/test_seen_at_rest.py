# SPDX-License-Identifier: Apache-2.0
"""What `motord stop-all` knows of a joint's rest, and its words and exit status for it."""

import math

import pytest

from motord.cli.stop_all import say
from motord.tools.stop_all import Halted
from motord_hal.fieldbus.halt import COUNTER_STILL_S, FRESH_S, SeenAtRest
from motord_hal.realtime.exchange import Feedback, now_ns

NOTHING = {"current_a": math.nan, "voltage_v": math.nan, "temperature_c": math.nan}


def feedback(velocity_rad_s=math.nan, count=0, age_s=0.0):
    return Feedback(
        stamp_ns=now_ns() - round(age_s * 1e9), count=count, velocity_rad_s=velocity_rad_s,
        epoch=0, enabled=None, drive_faults=0, **NOTHING,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("velocity_rad_s", "age_s", "seen"),
    [(0.0, 0.0, True), (-0.04, 0.0, True), (0.06, 0.0, False), (0.0, FRESH_S + 0.1, False)],
)
def test_a_joint_is_seen_at_rest_by_a_fresh_slow_speed(velocity_rad_s, age_s, seen):
    assert SeenAtRest(0.05).take(feedback(velocity_rad_s, age_s=age_s)) == seen


def test_a_joint_without_a_speed_is_seen_at_rest_by_a_counter_that_stands_still():
    watched = SeenAtRest(0.05)
    ages_s = (0.4, 0.4 - COUNTER_STILL_S / 2, 0.3 - COUNTER_STILL_S, 0.0)
    found = [
        watched.take(feedback(count=count, age_s=age_s))
        for count, age_s in zip((7, 7, 8, 8), ages_s, strict=True)
    ]
    assert found == [False, False, False, True]


@pytest.mark.parametrize(
    ("halted", "text", "confirmed"),
    [
        ({}, "l: a, b: stopped and without power\n", True),
        (
            {"rest_unmeasured": ("b",)},
            (
                "l: a, b: without power\n"
                "l: at rest by the set-points: nothing measures whether b turns\n"
            ),
            True,
        ),
        (
            {"rest_unknown": ("a",)},
            (
                "l: a, b: without power\n"
                "l: motord cannot see whether a turns: keep away, cut the power\n"
            ),
            False,
        ),
    ],
)
def test_the_words_claim_only_what_was_seen(capsys, halted, text, confirmed):
    found = Halted("l", ("a", "b"), (), **halted)
    say([found])
    assert (capsys.readouterr().err, found.confirmed) == (text, confirmed)
