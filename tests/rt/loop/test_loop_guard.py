# SPDX-License-Identifier: Apache-2.0
"""The pins of safety in the running loop, on descriptors that are no GPIO lines: a lost input
stops the robot, and the watchdog pin stops when a part hangs. On real lines:
tests/vm/guest/pins/test_safety_pins.py."""

import dataclasses
import fcntl
import os

import pytest
from tests.rt.small_base import LIMITS, arm, core_config, report_wheels, settings, until

from motord.realtime import loop as rt
from motord_hal.realtime.exchange import Exchange

MS = 1_000_000
GPIO_V2_LINE_SET_VALUES_IOCTL = 0xC010B40F
"""Defined in include/uapi/linux/gpio.h."""


@pytest.fixture
def pipe():
    ends = os.pipe2(os.O_NONBLOCK | os.O_CLOEXEC)
    yield ends
    for fd in ends:
        os.close(fd)


def looped(**changes):
    """Return a loop with a guard (the pins of safety) that has these changes."""
    guard = {
        "estop": 0,
        "estop_fd": -1,
        "estop_high": 1,
        "watchdog": 0,
        "watchdog_fd": -1,
        "watchdog_every_ticks": 1,
        "heartbeat_timeout_ns": 10**13,
        "line_timeout_ns": [0, 0, 0, 0],
    }
    return rt.Loop(core_config(), dataclasses.replace(settings(), guard=guard | changes))


def later(loop, ticks=20):
    seen = loop.status().ticks + ticks
    until(lambda: loop.status().ticks > seen)


def stands_still(loop):
    """Wait until the watchdog pin is low; return whether it makes no more edges. A tick that has
    begun may still make one."""
    until(lambda: not loop.status().watchdog)
    before = loop.status().watchdog_edges
    later(loop)
    return loop.status().watchdog_edges == before


def test_without_pins_there_is_no_emergency_stop_input_and_no_watchdog():
    with rt.Loop(core_config(), settings()) as loop:
        later(loop)
        status = loop.status()
        assert (status.estop_input, status.watchdog, status.watchdog_edges) == ("none", False, 0)
        assert loop.read_state().faults == ()


def test_an_unreadable_input_is_an_emergency_stop_from_the_first_tick_on(pipe):
    with looped(estop=1, estop_fd=pipe[0]) as loop:
        assert loop.read_state().faults == ("estop",)
        assert loop.status().estop_input == "lost"


def test_no_reset_clears_it_while_the_input_reports_stop(pipe):
    with looped(estop=1, estop_fd=pipe[0]) as loop:
        report_wheels()
        loop.put_control(rt.Control(reset_count=1, limits=LIMITS))
        later(loop)
        assert loop.read_state().faults == ("estop",)
        loop.put_control(rt.Control(reset_count=1, armed=True, limits=LIMITS))
        later(loop)
        assert not loop.read_state().armed


def reason_of(fd):
    """Return the errno for a descriptor that is no GPIO line: ENOTTY, but another one in an
    emulator that does not know the request."""
    with pytest.raises(OSError) as refused:
        fcntl.ioctl(fd, GPIO_V2_LINE_SET_VALUES_IOCTL, bytes(16))
    return refused.value.errno


def test_the_watchdog_moves_with_the_heartbeat_and_stops_without_it(pipe):
    with looped(watchdog=1, watchdog_fd=pipe[1], heartbeat_timeout_ns=300 * MS) as loop:

        def moves():
            loop.beat()
            return loop.status().watchdog_edges > 50

        until(moves)
        assert loop.status().watchdog_errno == reason_of(pipe[1])
        assert stands_still(loop)
        loop.beat()
        before = loop.status().watchdog_edges
        until(lambda: loop.status().watchdog_edges > before)


def test_a_line_that_hangs_with_enabled_drives_stops_the_watchdog(pipe):
    with looped(watchdog=1, watchdog_fd=pipe[1], line_timeout_ns=[300 * MS, 0, 0, 0]) as loop:
        line = Exchange.of_loop()
        until(lambda: loop.status().watchdog_edges > 50)  # nothing is enabled: no line is missed
        arm(loop)
        assert stands_still(loop)
        line.take_setpoints(0)
        before = loop.status().watchdog_edges
        until(lambda: loop.status().watchdog_edges > before)


def test_invalid_settings_are_refused(pipe):
    with pytest.raises(ValueError, match="the loop refuses"):
        looped(watchdog=1, watchdog_every_ticks=0).start()
