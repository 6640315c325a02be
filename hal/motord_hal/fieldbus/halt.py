# SPDX-License-Identifier: Apache-2.0
"""Stopping a drive whose program has died and whose wheels may turn.

Nothing is known of the drive and nothing is read before the stop is sent: quick stop, zero, and
power off when its wheels rest. None of these can make a motor turn.
"""

from __future__ import annotations

import asyncio
from collections.abc import Mapping
from typing import Protocol

from motord_hal.base.clock import now_s
from motord_hal.base.errors import BadReply, HalError, NoReply
from motord_hal.drives.profile import DriveProfile, Step

STOPPING_WITHIN_S = 1.0
"""After the quick stop the power stays on until the wheels rest, so long at most."""
TRIES = 3
PAUSE_S = 0.02


class Unit(Protocol):
    """One drive that can be written to and read from, once each. Both raise HalError."""

    name: str
    profile: DriveProfile
    rest_velocity_rad_s: float
    """A wheel slower than this is at rest."""

    async def write(self, raw: Mapping[str, int]) -> None: ...

    async def read(self, register: str) -> int: ...


async def halt_unit(unit: Unit) -> str:
    """Tells it all of it, whatever it does not answer. Returns the first thing that it did not
    acknowledge, in words; empty: it has stopped and is without power."""
    problems = [await _write_all(unit, _writes(unit.profile.quick_stop))]
    problems.append(await _write_all(unit, [{name: 0} for name in _setpoints(unit.profile)]))
    await _wait_for_rest(unit)
    problems.append(await _write_all(unit, _writes(unit.profile.disarm)))
    return next((f"{unit.name}: {problem}" for problem in problems if problem), "")


def _writes(steps: tuple[Step, ...]) -> list[dict[str, int]]:
    """What a sequence writes; its waits are left out."""
    return [{step.register: step.value} for step in steps if step.value is not None]


def _setpoints(profile: DriveProfile) -> list[str]:
    return [channel.setpoint for channel in profile.channels.values()]


async def _write_all(unit: Unit, writes: list[dict[str, int]]) -> str:
    """Each of them, also when the one before it failed. Returns the first problem."""
    problems = [await _write(unit, raw) for raw in writes]
    return next((problem for problem in problems if problem), "")


async def _write(unit: Unit, raw: dict[str, int]) -> str:
    problem = ""
    for _ in range(TRIES):
        try:
            await unit.write(raw)
        except (NoReply, BadReply) as error:
            problem = str(error)
        except HalError as error:
            return str(error)  # refused, or the port has gone: asking again changes nothing
        else:
            return ""
    return problem


async def _wait_for_rest(unit: Unit) -> None:
    """Until every wheel is seen at rest. One that cannot say so gets the whole time; one that is
    silent gets none: the next frame may be all that it receives."""
    names = [channel.velocity for channel in unit.profile.channels.values()]
    until_s = now_s() + STOPPING_WITHIN_S
    while now_s() < until_s:
        try:
            moving = [await _moves(unit, name) for name in names]
        except HalError:
            return
        if not any(moving):
            return
        await asyncio.sleep(PAUSE_S)


async def _moves(unit: Unit, velocity: str | None) -> bool:
    """True also where there is no such register."""
    if velocity is None:
        return True
    velocity_rad_s = unit.profile.registers[velocity].to_si(await unit.read(velocity))
    return not abs(velocity_rad_s) < unit.rest_velocity_rad_s
