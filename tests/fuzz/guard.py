# SPDX-License-Identifier: Apache-2.0
"""A hostile Modbus slave, on a serial port, behind a Modbus TCP gateway or behind a serial server,
against a whole line of the asyncio engine.

Whatever it answers, no exception leaves the line but the cancellation at its end. The line recovers
once the slave answers correctly again, and it sends the power-off at its end.
"""

from __future__ import annotations

import asyncio
import random
import struct
import tempfile
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from loop_side import Rig, running, until
from modbus_rig import registers_of, spec_of
from mutate import mutated
from scripted_gateway import GATEWAYS, ScriptedGateway, peer_on
from scripted_slave import Bytes, ScriptedSlave, Unit

from motord.config.drives.load import find_profile
from motord_hal.base.clock import now_s
from motord_hal.fieldbus.ports import DriveState, JointSpec, LineState
from motord_hal.modbus.codec import Request, build_exception, seal

MEDIA = ("asyncio", *GATEWAYS)
PROFILES = ("zlac8015d", "duty-register", "speed-register", "bld-305s")
REPLIES = 40
HOSTILE_S = 5.0
"""Number of hostile replies in a life; fewer if HOSTILE_S ends first, because a line polls a drive
without valid replies ever more rarely."""
LIVES_AT_ONCE = 4
HONEST_PARTS = (0.0, 0.3, 0.7, 0.9)
"""Parts of valid replies in a life: if it is large, hostile ones meet every kind of request."""
SPEED_RAD_S = 6.0
WORDS = (b"\x00", b"\xff" * 4, bytes(300), b"\x01\x83\x00", b"\x01\x03\x02", b"\x55" * 600)


def run(seed: int, runs: int) -> Iterator[tuple[str, bytes]]:
    """Yield each problem with the replies that caused it."""
    yield from asyncio.run(_lives(seed, runs))


async def _lives(seed: int, runs: int) -> list[tuple[str, bytes]]:
    problems: list[tuple[str, bytes]] = []
    numbers = iter(range(runs))

    async def some() -> None:
        for number in numbers:
            problems.extend(await _live(seed, number))

    loop = asyncio.get_running_loop()
    loop.set_exception_handler(lambda _, context: problems.append((f"a callback: {context}", b"")))
    async with asyncio.TaskGroup() as group:
        for _ in range(LIVES_AT_ONCE):
            group.create_task(some())
    return problems


@dataclass
class Hostile:
    """Turns valid replies into hostile ones, and records what it sends."""

    dice: random.Random
    peer: ScriptedSlave
    honest_part: float
    sent: list[Bytes] = field(default_factory=list)

    def begin(self) -> None:
        self.peer.tricks.append(self._trick)

    def _trick(self, request: Request, honest: bytes) -> Bytes:
        self.peer.tricks.append(self._trick)
        replies = self._replies(request, honest)
        self.sent.append(replies)
        honestly = replies == [(0.0, honest)]
        if isinstance(self.peer, ScriptedGateway) and not honestly and self.dice.random() < 0.3:
            raw = b"".join(data for _, data in replies)
            self.peer.send_raw(mutated(self.dice, self._adu(raw), WORDS))
            return []
        return replies

    def _adu(self, frame: bytes) -> bytes:
        assert isinstance(self.peer, ScriptedGateway)
        if self.peer.kind == "rtu-over-tcp":
            return frame
        body = frame[:-2]
        return struct.pack(">HHH", self.peer.transaction, 0, len(body) & 0xFFFF) + body

    def _replies(self, request: Request, honest: bytes) -> Bytes:
        dice = self.dice
        if dice.random() < self.honest_part:
            return [(0.0, honest)]
        late_s = dice.choice((0.0, 0.0, 0.0, 0.01, 0.03, 0.06, 0.1))
        match dice.randrange(8):
            case 0:
                return []
            case 1:
                code = dice.choice((0, 0, 1, 4, 6, 11, dice.randrange(256)))
                return [(late_s, build_exception(request.unit, request.function, code))]
            case 2:  # wrong, under a good check sum
                return [(late_s, seal(mutated(dice, honest[:-2], WORDS)))]
            case 3:
                return [(late_s, mutated(dice, honest, WORDS))]
            case 4:
                return [(late_s, dice.randbytes(dice.choice((1, 4, 20, 270, 5000))))]
            case 5:
                return [(late_s, honest)]
            case 6:  # in two pieces
                cut = dice.randint(0, len(honest))
                return [(late_s, honest[:cut]), (late_s + 0.01, honest[cut:])]
            case _:  # several times
                return [(late_s, mutated(dice, honest, WORDS)), (late_s, honest), (0.04, honest)]


@asynccontextmanager
async def _slave(medium: str, profile: str) -> AsyncIterator[ScriptedSlave]:
    with tempfile.TemporaryDirectory(prefix="fuzz-") as folder:
        peer = peer_on(medium, Path(folder))
        peer.units = {1: Unit(registers_of(profile), on_write=lambda *_: _follow(peer, profile))}
        try:
            yield peer
        finally:
            peer.pull()


def _follow(peer: ScriptedSlave, profile: str) -> None:
    """Copy `enable` of a speed-register drive to `status`, which reports whether it is enabled."""
    if profile == "speed-register":
        registers, known = peer.units[1].registers, find_profile(profile).registers
        registers[known["status"].address] = registers[known["enable"].address]


async def _live(seed: int, number: int) -> list[tuple[str, bytes]]:
    """Run one line: arm and drive it, send it hostile replies, end it during them or later."""
    dice = random.Random(f"{seed} {number}")
    medium, name = dice.choice(MEDIA), dice.choice(PROFILES)
    ends_hostile = dice.random() < 0.5
    what = f"life {number}, {medium}, {name}, ends {'hostile' if ends_hostile else 'honest'}"
    problem = ""
    async with _slave(medium, name) as peer:
        hostile = Hostile(dice, peer, dice.choice(HONEST_PARTS))
        profile = find_profile(name)
        wheel = JointSpec(index=0, name="wheel", profile=profile, unit=1)
        try:
            async with running(spec_of(peer, [wheel])) as rig:
                await _suffer(rig, peer, hostile)
                if not ends_hostile:
                    await _recover(rig, peer, name)
                was_open, mark = rig.line.state is not LineState.CLOSED, len(peer.received)
        except* Exception as errors:  # noqa: BLE001  # any exception is a finding
            problem = repr(errors.exceptions)
        else:
            if was_open and not _switched_off(peer.requests()[mark:], profile):
                problem = "no power-off at the end"
    return [(f"{what}: {problem}", repr(hostile.sent).encode())] if problem else []


async def _suffer(rig: Rig, peer: ScriptedSlave, hostile: Hostile) -> None:
    await rig.arm()
    rig.loop.enabled = True
    rig.loop.velocity_rad_s, rig.loop.duty = {0: SPEED_RAD_S}, {0: 0.5}
    hostile.begin()
    end_s = now_s() + HOSTILE_S
    await until(
        lambda: len(hostile.sent) >= REPLIES or now_s() > end_s or rig.task.done(),
        "hostile replies",
    )
    if rig.task.done():
        raise AssertionError(f"the line has ended: {rig.task.exception()!r}")


async def _recover(rig: Rig, peer: ScriptedSlave, profile: str) -> None:
    peer.tricks.clear()
    peer.units[1].registers.update(registers_of(profile))
    rig.loop.enabled = False
    await until(
        lambda: rig.task.done() or rig.states() <= {DriveState.READY, DriveState.ARMED},
        "the line recovers",
    )
    if rig.task.done():
        raise AssertionError(f"the line has ended: {rig.task.exception()!r}")


def _switched_off(requests: list[Request], profile: Any) -> bool:
    """Return whether these requests contain every write of the profile's power-off."""
    sent = {
        (address, value)
        for request in requests
        for address, value in enumerate(request.values, request.address)
    }
    steps = [step for step in profile.disarm if step.value is not None]
    return all(
        (profile.registers[step.register].address + number, word) in sent
        for step in steps
        for number, word in enumerate(profile.registers[step.register].encode(step.value))
    )
