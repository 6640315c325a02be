# SPDX-License-Identifier: Apache-2.0
"""The measured speed of shipped robots with three counters: how exact it is, and whether the
published deviation is that of its error."""

import pytest
from tests.rt.odometry.twist_noise import COUNTERS, NAMES, Measured, run


@pytest.mark.parametrize("counter", COUNTERS)
def test_by_counters_alone_95_of_100_errors_are_within_two_deviations(counter):
    every = [error for name in NAMES for error in run(name, counter, reports=False).deviations]
    assert 92.0 <= Measured(every, []).within() <= 98.0


@pytest.mark.parametrize("counter", COUNTERS)
def test_a_reported_speed_is_not_more_exact_than_published(counter):
    every = [error for name in NAMES for error in run(name, counter).deviations]
    assert Measured(every, []).within() >= 92.0


@pytest.mark.parametrize("counter", COUNTERS)
@pytest.mark.parametrize("name", NAMES)
def test_a_drive_that_reports_its_speed_is_followed_whatever_its_counter(name, counter):
    """The simulated drives report their speed exactly, but for rounding."""
    assert run(name, counter).root_mean_square() < 0.005
