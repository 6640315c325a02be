# SPDX-License-Identifier: Apache-2.0
"""Stop requests: datagrams that the loop reads and follows until asyncio acknowledges them."""

import array
import dataclasses
import os
import random
import socket
import struct

import pytest
from tests.rt.small_base import LIMITS, arm, core_config, report_wheels, settings, until

from motord.api.stop_request import MAGIC, VERSION, datagram
from motord.realtime import loop as rt
from motord.realtime.types import StopRequests

SPEED_M_S = 0.5


@pytest.fixture
def wire():
    """The sockets of the test and of the loop, through which stop requests go."""
    near, far = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
    far.setsockopt(socket.SOL_SOCKET, socket.SO_PASSCRED, 1)
    os.set_blocking(far.fileno(), False)
    with near, far:
        yield near, far


@pytest.fixture
def loop(wire):
    with rt.Loop(
        core_config(), dataclasses.replace(settings(), stop_fd=wire[1].fileno())
    ) as started:
        yield started


@pytest.fixture
def holding(wire):
    """A loop whose drives keep their power in a fault."""
    config = rt.CoreConfig(**{**core_config(), "on_fault": rt.StopAction.HOLD})
    with rt.Loop(config, dataclasses.replace(settings(), stop_fd=wire[1].fileno())) as started:
        yield started


def driving(loop):
    """Arm and drive to full speed; return the lease, whose command lasts."""
    lease = arm(loop)
    until(lambda: loop.read_state().reasons == ())
    lease.send(SPEED_M_S, 0.0)
    until(lambda: loop.read_state().setpoint_linear_m_s == SPEED_M_S)
    return lease


def later(loop, ticks=20):
    seen = loop.read_state().tick + ticks
    until(lambda: loop.read_state().tick > seen)
    return loop.read_state()


def rests(loop):
    state = loop.read_state()
    return state.at_rest and state.setpoint_linear_m_s == 0.0


def control(**levels):
    return rt.Control(limits=LIMITS, **levels)


def test_a_stop_holds_while_asyncio_still_requests_motion(loop, wire):
    lease = driving(loop)
    wire[0].send(datagram("stop"))
    until(lambda: rests(loop))
    loop.put_control(control(armed=True))
    lease.send(SPEED_M_S, 0.0)
    state = later(loop)
    assert state.setpoint_linear_m_s == 0.0
    assert "stop_requested" in state.reasons
    assert state.armed


def test_after_the_acknowledgement_asyncio_s_own_level_decides_the_stop(loop, wire):
    driving(loop)
    wire[0].send(datagram("stop"))
    until(lambda: rests(loop))
    loop.put_control(control(armed=True, stop=True))
    loop.acknowledge_stops(loop.stop_requests())
    assert "stop_requested" in later(loop).reasons
    loop.put_control(control(armed=True))
    assert "stop_requested" not in later(loop).reasons


def test_an_emergency_stop_is_latched_and_no_reset_clears_it_before_the_acknowledgement(loop, wire):
    driving(loop)
    wire[0].send(datagram("estop"))
    until(lambda: loop.read_state().faults == ("estop",))
    loop.put_control(control())
    until(lambda: rests(loop))
    loop.put_control(control(reset_count=1))
    assert later(loop).faults == ("estop",)
    loop.acknowledge_stops(loop.stop_requests())
    assert later(loop).faults == ("estop",)


def test_a_disarm_comes_to_rest_first_and_never_arms_again_by_itself(loop, wire):
    driving(loop)
    wire[0].send(datagram("disarm"))
    until(lambda: not loop.read_state().armed)
    assert rests(loop)
    report_wheels()
    for armed in (True, False, True):
        loop.put_control(control(armed=armed))
        assert not later(loop).armed


def test_a_disarm_also_takes_the_power_in_a_fault_that_holds(holding, wire):
    driving(holding)
    holding.put_control(control(armed=True, fault=True))
    until(lambda: rests(holding))
    report_wheels()
    assert later(holding).enabled
    wire[0].send(datagram("disarm"))
    until(lambda: not holding.read_state().enabled)
    holding.acknowledge_stops(holding.stop_requests())
    assert not later(holding).enabled


def test_requests_that_are_not_yet_acknowledged_stay_in_force(loop, wire):
    for method in ("stop", "stop", "disarm"):
        wire[0].send(datagram(method))
    until(lambda: loop.stop_requests().disarm == 1)
    requests = loop.stop_requests()
    assert (requests.stop, requests.estop, requests.pid) == (2, 0, os.getpid())
    loop.acknowledge_stops(StopRequests(stop=1, disarm=1))
    assert "stop_requested" in later(loop).reasons
    loop.acknowledge_stops(requests)
    assert "stop_requested" not in later(loop).reasons


def test_only_a_complete_request_counts(loop, wire):
    rng = random.Random(11)
    good = datagram("disarm")
    wrong = [
        *(good[:size] for size in range(len(good))),
        good + b"\0",
        good * 8,
        struct.pack("=IHH", MAGIC ^ 1, VERSION, 0),
        struct.pack("=IHH", MAGIC, VERSION + 1, 0),
        *(struct.pack("=IHH", MAGIC, VERSION, kind) for kind in (3, 4, 255, 65535)),
        *(rng.randbytes(rng.randrange(1, 200)) for _ in range(200)),
    ]
    for raw in wrong:
        wire[0].send(raw)
    wire[0].send(datagram("estop"))
    until(lambda: loop.stop_requests().estop)
    assert loop.stop_requests() == StopRequests(estop=1, pid=os.getpid())


def test_descriptors_sent_with_a_request_are_not_kept(loop, wire):
    before = len(os.listdir("/proc/self/fd"))
    with open("/dev/null", "rb") as file:
        fds = array.array("i", [file.fileno()] * 4)
        wire[0].sendmsg([datagram("stop")], [(socket.SOL_SOCKET, socket.SCM_RIGHTS, fds)])
    until(lambda: loop.stop_requests().stop)
    assert len(os.listdir("/proc/self/fd")) == before


def test_no_request_arms_or_moves_a_disarmed_robot(loop, wire):
    report_wheels()
    for method in ("stop", "disarm", "stop"):
        wire[0].send(datagram(method))
    until(lambda: loop.stop_requests().stop == 2)
    state = later(loop)
    assert not state.armed
    assert state.setpoint_linear_m_s == 0.0
