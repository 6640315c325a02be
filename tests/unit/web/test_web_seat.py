# SPDX-License-Identifier: Apache-2.0
"""The seat decides which page drives; after a pause no command of the old hold counts."""

import time

import pytest
from tests.unit.bus.gate_rig import DEMO

from motord.bus.commands.gate import CommandGate, NotTaken
from motord.bus.runtime import Runtime
from motord.bus.web.frames import DriveFrame
from motord.bus.web.seat import SEEN_MAX_S, Driver, Seat
from motord.config import WebInput, load_robot

LEASE_S = 0.3


class Clock:
    """The clock of this process, which the test sets."""

    def __init__(self, monkeypatch):
        self.now_s = 1000.0
        monkeypatch.setattr(time, "monotonic", lambda: self.now_s)
        monkeypatch.setattr(time, "monotonic_ns", lambda: round(self.now_s * 1e9))
        monkeypatch.setattr(time, "clock_gettime", lambda _: self.now_s)
        monkeypatch.setattr(time, "clock_gettime_ns", lambda _: round(self.now_s * 1e9))


@pytest.fixture
def clock(monkeypatch):
    return Clock(monkeypatch)


@pytest.fixture
def seat(clock, tmp_path):
    section = WebInput(kind="web", trust_loopback=True)
    gate = CommandGate("web", section, Runtime(load_robot(DEMO), tmp_path / "no.sock"))
    gate.commands = []
    source = gate.source
    source.drive = lambda linear, angular, *_, **__: gate.commands.append((linear, angular)) or True
    source.release = lambda **_: gate.commands.append("release") or True
    clock.now_s += 100.0  # the next line makes this no pause: both gaps have looked just now
    gate._gap._looked_s = gate.gap._looked_s = clock.now_s
    made = Seat(gate, LEASE_S)
    made.commands = gate.commands
    made.gaps = (gate._gap, gate.gap)
    return made


def frame(clock, press=1, linear_m_s=0.2, waited_s=0.0, seen_ago_s=0.02):
    sent_ms = (clock.now_s - waited_s) * 1e3
    return DriveFrame(press, sent_ms, clock.now_s - seen_ago_s, linear_m_s, 0.0, 0.1)


def passes(seat, clock, seconds):
    """Advance the clock, without a pause of this process."""
    clock.now_s += seconds
    for gap in seat.gaps:
        gap._looked_s = clock.now_s


def test_commands_of_one_hold_are_passed_on(seat, clock):
    driver = Driver("page 1")
    for _ in range(10):
        seat.drive(driver, frame(clock))
        passes(seat, clock, 0.05)
    assert seat.commands == [(0.2, 0.1)] * 10
    assert seat.driver == "page 1"


def test_after_a_pause_the_same_hold_never_counts_again(seat, clock):
    driver = Driver("page 1")
    seat.drive(driver, frame(clock))
    passes(seat, clock, LEASE_S + 0.01)
    for _ in range(3):
        with pytest.raises(NotTaken, match="release the pad"):
            seat.drive(driver, frame(clock))
        passes(seat, clock, 0.05)
    assert seat.commands == [(0.2, 0.1), (0.0, 0.0), "release"]
    seat.drive(driver, frame(clock, press=2))
    assert seat.commands[-1] == (0.2, 0.1)


def test_a_command_that_was_delayed_ends_the_hold(seat, clock):
    driver = Driver("page 1")
    seat.drive(driver, frame(clock))
    passes(seat, clock, 0.1)
    with pytest.raises(NotTaken):
        seat.drive(driver, frame(clock, waited_s=LEASE_S + 0.01))
    with pytest.raises(NotTaken):
        seat.drive(driver, frame(clock))
    assert seat.commands[-2:] == [(0.0, 0.0), "release"]


def test_a_page_that_sees_an_old_state_does_not_drive(seat, clock):
    driver = Driver("page 1")
    with pytest.raises(NotTaken, match="too slow"):
        seat.drive(driver, frame(clock, seen_ago_s=SEEN_MAX_S + 0.1))
    with pytest.raises(NotTaken):
        seat.drive(driver, frame(clock, press=2, seen_ago_s=float("nan")))
    with pytest.raises(NotTaken):  # a stamp in the future: from before a restart of the computer
        seat.drive(driver, frame(clock, press=3, seen_ago_s=-3600.0))
    assert (0.2, 0.1) not in seat.commands


def test_a_second_page_does_not_drive_until_the_first_one_has_released(seat, clock):
    first, second = Driver("page 1"), Driver("page 2")
    seat.drive(first, frame(clock))
    passes(seat, clock, 0.05)
    with pytest.raises(NotTaken, match="page 1 is driving"):
        seat.drive(second, frame(clock, linear_m_s=-0.3))
    seat.release(first, 1)
    with pytest.raises(NotTaken):  # this hold began while another page drove
        seat.drive(second, frame(clock, linear_m_s=-0.3))
    seat.drive(second, frame(clock, press=2, linear_m_s=-0.3))
    assert seat.commands == [(0.2, 0.1), (0.0, 0.0), "release", (-0.3, 0.1)]


def test_a_release_holds_also_for_commands_that_arrive_after_it(seat, clock):
    driver = Driver("page 1")
    seat.drive(driver, frame(clock))
    seat.release(driver, 1)
    with pytest.raises(NotTaken):
        seat.drive(driver, frame(clock))
    assert seat.commands == [(0.2, 0.1), (0.0, 0.0), "release"]


def test_a_page_that_goes_away_releases_and_no_other_page_does(seat, clock):
    first, second = Driver("page 1"), Driver("page 2")
    seat.drive(first, frame(clock))
    seat.leave(second)
    assert seat.commands == [(0.2, 0.1)]
    seat.leave(first)
    assert seat.commands[-2:] == [(0.0, 0.0), "release"]
    assert seat.driver is None
