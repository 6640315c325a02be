# SPDX-License-Identifier: Apache-2.0
"""Lines of every kind whose peer resets the connection: at each step of opening, at accept, and at
each byte. The line is lost, reported, and opened again; its task never ends."""

import asyncio
import contextlib
import logging
import socket
import sys
import threading
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import pytest
from gateway_rig import served
from loop_side import GENEROUS_S, running, until
from sim_bench import simulated, spec_of
from tests.long_cases import long_but
from tests.relay import TO_PEER, TO_PROGRAM, Relay
from tests.shipped import shipped_profile

from motord_hal.base.errors import PortError
from motord_hal.fieldbus.ports import DriveState, EventKind, LineState
from motord_hal.modbus.codec import Function, Request
from motord_hal.modbus.tcp_guard import GatewayClient
from motord_hal.sim.control import SimControl

LINES = {
    "modbus-tcp": "zlac8015d",
    "rtu-over-tcp": "zlac8015d",
    "modbus-rtu asyncio": "zlac8015d",
    "modbus-rtu rt": "zlac8015d",
    "can asyncio": "odrive-0.6",
    "can rt": "odrive-0.6",
    "ddsm": "ddsm115",
    "roboclaw": "roboclaw",
    "feetech": "sts3215",
    "dynamixel": "xm430",
    "mcu": "mcu-velocity",
    "ascii": "ascii-velocity",
    "hoverboard": "hoverboard",
    "sabertooth": "sabertooth",
}
"""A drive for each kind of line that has a peer."""
FEW = ("modbus-tcp", "rtu-over-tcp", "modbus-rtu asyncio", "modbus-rtu rt", "can asyncio")
GATEWAYS = ("modbus-tcp", "rtu-over-tcp")
SYSTEM_CALLS = ("posix", "fcntl", "termios", "_socket")
"""Modules whose functions are system calls on a medium, beside the methods of a socket."""
STEPS_LEAST, STEPS_MAX = 4, 100
"""Fewest system calls that a line makes to be opened, and more than any makes."""
BYTES = 24
FAR_BYTES = 400
"""More bytes than any line needs to set its drives up."""


@dataclass
class Broken:
    """A line behind a relay that resets its connection."""

    rig: object
    relay: Relay
    sim: SimControl

    def losses(self):
        return self.rig.kinds().count(EventKind.LINE_LOST)

    def is_open(self):
        return self.rig.line.state is not LineState.CLOSED

    async def lost_once_more(self, before):
        await until(lambda: self.losses() > before or self.rig.task.done(), "the line is lost")
        assert not self.rig.task.done(), self.rig.task.exception()

    async def reset_once_more(self, before):
        """Wait for the reset. No loss need follow: a line that was being opened tries again."""
        await until(lambda: self.relay.resets > before or self.rig.task.done(), "it is reset")
        assert not self.rig.task.done(), self.rig.task.exception()

    def moves(self):
        """Whether a drive is armed or turns."""
        return DriveState.ARMED in self.rig.states() or not self.sim.truth().at_rest


@pytest.fixture(params=long_but(FEW, LINES))
def kind(request):
    return request.param


@pytest.fixture(autouse=True)
def no_pauses(monkeypatch):
    """Try again at once; only the time of these tests depends on it."""
    monkeypatch.setattr("motord_hal.fieldbus.line.REOPEN_FIRST_S", 0.005)
    monkeypatch.setattr("motord_hal.fieldbus.line.REOPEN_LIMIT_S", 0.01)


@pytest.fixture
async def broken(kind, tmp_path, caplog):
    profile = replace(shipped_profile(LINES[kind]), turnaround_s=0.002, parity="none")
    folder = tmp_path / ("rt" if profile.can is not None or kind.endswith("rt") else "asyncio")
    folder.mkdir()
    with contextlib.ExitStack() as cleanup:
        spec = spec_of(profile, folder)
        if "tcp" in kind:
            served_line = served(folder, raw=kind == "rtu-over-tcp")
            control, (host, port) = cleanup.enter_context(served_line)
            medium, back = "tcp", f"{host}:{port}"
        else:
            control = cleanup.enter_context(simulated(profile, folder))
            medium = "unix" if profile.can is not None else "pty"
            back = spec.port.removeprefix("unix:")
        relay = cleanup.enter_context(Relay(medium, tmp_path / "front", back))
        port = f"unix:{relay.front}" if medium == "unix" else relay.front
        engine = "asyncio" if medium == "tcp" or kind.endswith("asyncio") else "rt"
        spec = replace(spec, kind=kind.split()[0], port=port, engine=engine)
        async with running(spec) as rig:
            yield Broken(rig, relay, control)
        found = [*caplog.get_records("call"), *caplog.get_records("teardown")]
        assert not [record.exc_info for record in found if record.levelno >= logging.ERROR]


def is_system_call(function):
    owner = getattr(function, "__self__", None)
    return getattr(function, "__module__", None) in SYSTEM_CALLS or isinstance(owner, socket.socket)


@contextlib.contextmanager
def before_opening_step(broken, number):
    """Reset the connection right before the system call with this number that the line makes in the
    block while it is not open. Yield a function that returns how many it has made."""
    made = 0

    def watch(_frame, event, function):
        nonlocal made
        if event == "c_call" and is_system_call(function) and not broken.is_open():
            made += 1
            if made == number:
                broken.relay.reset()

    # threads that begin in the block are watched, too
    asyncio.get_running_loop().set_default_executor(executor := ThreadPoolExecutor())
    threading.setprofile(watch)
    sys.setprofile(watch)
    try:
        yield lambda: made
    finally:
        sys.setprofile(None)
        threading.setprofile(None)
        asyncio.get_running_loop().set_default_executor(ThreadPoolExecutor())
        executor.shutdown(wait=False)


async def test_a_reset_at_each_step_of_opening_loses_the_line_and_nothing_else(broken):
    for step in range(1, STEPS_MAX):
        await broken.rig.ready()
        before = broken.losses()
        with before_opening_step(broken, step) as made:
            broken.relay.reset()  # the line is opened again
            await broken.lost_once_more(before)
            await until(
                lambda step=step, made=made: made() >= step or broken.is_open(), "it is opened"
            )
        if made() < step:
            break
        assert not broken.rig.task.done()
    print(f"{step - 1} steps")
    assert STEPS_LEAST < step < STEPS_MAX - 1
    await broken.rig.ready()
    await broken.rig.arm()
    assert broken.sim.truth().at_rest


async def test_a_reset_at_accept_loses_the_line_and_nothing_else(broken):
    await broken.rig.ready()
    for _ in range(10):
        before = broken.losses()
        broken.relay.reset_at_accept()
        broken.relay.reset()
        await broken.lost_once_more(before)
        await broken.rig.ready()
    await broken.rig.arm()
    assert broken.sim.truth().at_rest


@pytest.mark.parametrize("direction", [TO_PEER, TO_PROGRAM])
@pytest.mark.parametrize(
    "counts",
    [range(1, BYTES), pytest.param(range(BYTES, FAR_BYTES, 3), marks=pytest.mark.long)],
    ids=["first", "all"],
)
async def test_a_reset_at_each_byte_loses_the_line_at_most(broken, kind, direction, counts):
    if kind == "sabertooth" and direction == TO_PROGRAM:
        pytest.skip("it sends nothing")
    await broken.rig.ready()
    for count in counts:
        resets = broken.relay.resets
        broken.relay.reset_after(count, direction)
        await broken.reset_once_more(resets)
        assert not broken.moves()
    broken.relay.pass_all()
    await broken.rig.ready()
    await broken.rig.arm()
    assert broken.sim.truth().at_rest


@pytest.mark.parametrize("kind", GATEWAYS, indirect=True)
async def test_only_an_urgent_request_on_a_dead_connection_opens_a_new_one(kind, tmp_path):
    profile = replace(shipped_profile(LINES[kind]), turnaround_s=0.002, parity="none")
    read = Request(1, Function.READ_HOLDING, profile.registers["control_word"].address, 1)
    with (
        served(tmp_path, raw=kind == "rtu-over-tcp") as (_, (host, port)),
        Relay("tcp", tmp_path / "front", f"{host}:{port}") as relay,
    ):
        spec = replace(spec_of(profile, tmp_path), kind=kind, port=relay.front)
        client = GatewayClient(spec)
        await client.open()
        try:
            await until(lambda: relay.connections == 1, "the gateway has accepted")
            relay.reset()
            await until(lambda: not client.connected, "the reset has arrived")
            with pytest.raises(PortError, match="went away"):
                await client.exchange(read, GENEROUS_S)
            assert relay.connections == 1
            await client.exchange(read, GENEROUS_S, urgent=True)
            assert relay.connections == 2
        finally:
            client.close()
