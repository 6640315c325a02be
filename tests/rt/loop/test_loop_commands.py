# SPDX-License-Identifier: Apache-2.0
"""Effects of a datagram on the loop and the lines that wait for it. Tests wait for conditions."""

import contextlib
import os
import threading

import pytest
from _motord_rt import lib
from tests.rt.small_base import LIMITS, arm, lease_of, report_wheels, until

from motord.api.commands import Refusal
from motord.realtime import loop as rt

LATENESS = rt.HistogramKind.LATENESS


class Line:
    """Stands for the thread of a serial line, which the loop wakes."""

    def __init__(self, loop):
        self.loop = loop
        self.fd = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
        lib.exchange_set_line_wake(lib.loop_exchange(), 0, self.fd)

    def close(self):
        lib.exchange_set_line_wake(lib.loop_exchange(), 0, -1)
        ticks_pass(self.loop)  # the loop may have been about to write
        os.close(self.fd)

    def was_woken(self):
        with contextlib.suppress(BlockingIOError):
            return os.eventfd_read(self.fd) > 0
        return False

    def settle(self):
        """Wait until no earlier action can wake the line any more."""
        ticks_pass(self.loop)
        self.was_woken()


def ticks_pass(loop, count=10):
    seen = loop.status().ticks
    until(lambda: loop.status().ticks >= seen + count)


@pytest.fixture
def line(loop):
    made = Line(loop)
    yield made
    made.close()


def test_ticks_do_not_wake_a_line(loop, line):
    line.settle()
    ticks_pass(loop, 50)
    assert not line.was_woken()


def test_a_command_wakes_the_lines(loop, line):
    lease = lease_of(loop)
    for _ in range(3):
        line.settle()
        lease.send(0.0, 0.0)
        until(line.was_woken)


def test_a_refused_command_does_not_wake_a_line(loop, line):
    line.settle()
    for sent in range(1, 6):
        loop.send(b"go!")
        until(lambda sent=sent: loop.commands().refused[Refusal.FORM] == sent)
    ticks_pass(loop)
    assert not line.was_woken()


def test_a_stop_wakes_the_lines(loop, line):
    lease = arm(loop)
    lease.send(0.5, 0.0)
    until(lambda: loop.read_state().setpoint_linear_m_s == 0.5)
    report_wheels(velocity_rad_s=5.0)
    line.settle()
    loop.put_control(rt.Control(armed=True, estop=True, limits=LIMITS))
    until(lambda: loop.read_state().faults == ("estop",))
    until(line.was_woken)


def test_a_flood_of_datagrams_costs_at_most_one_more_tick_a_period(loop):
    ended = threading.Event()

    def flood():
        while not ended.is_set():
            with contextlib.suppress(BlockingIOError):
                loop.send(b"go!")

    flooding = threading.Thread(target=flood)
    flooding.start()
    try:
        until(lambda: loop.percentiles(LATENESS).samples >= 300)
    finally:
        ended.set()
        flooding.join()
    loop.stop()
    ticks, on_time = loop.status().ticks, loop.percentiles(LATENESS).samples
    assert on_time < ticks <= 2 * on_time
