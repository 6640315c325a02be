# SPDX-License-Identifier: Apache-2.0
"""Stops all drives of a robot whose daemon has died, on all lines at once, with a deadline."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass

from motord.client import ClientError, find_socket
from motord.config import Robot
from motord.control.assembly import line_specs
from motord_hal.base.clock import within
from motord_hal.base.errors import HalError
from motord_hal.fieldbus.halt import halt_line
from motord_hal.fieldbus.ports import LineSpec


class DaemonRuns(Exception):
    """A daemon runs for this robot: send it the stop instead."""


@dataclass(frozen=True, slots=True)
class Halted:
    """The result for one line."""

    line: str
    joints: tuple[str, ...]
    problems: tuple[str, ...]
    """The stops that are not confirmed; empty: every drive has acknowledged that it stopped and
    that its power is off."""


async def stop_all(robot: Robot, within_s: float) -> tuple[Halted, ...]:
    """Stop all drives of a robot, `within_s` at most for each line. Raise DaemonRuns, or
    ProfileError for profiles that cannot be read."""
    name = robot.robot.name
    try:
        # a socket that this user may not check does not count, because its daemon may be dead;
        # if it is not, the locked port of the line shows that
        socket = find_socket(name, barred=False)
    except ClientError:
        pass
    else:
        raise DaemonRuns(f"the daemon of {name} runs ({socket}): use motord estop")
    specs = line_specs(robot, robot.profiles)
    # exceptions of any kind come back as values: an unforeseen one on one line must not leave the
    # motors of the other lines running
    results = await asyncio.gather(
        *(_problems(spec, within_s) for spec in specs), return_exceptions=True
    )
    return tuple(_halted(spec, result) for spec, result in zip(specs, results, strict=True))


async def _problems(spec: LineSpec, within_s: float) -> list[str]:
    try:
        async with within(within_s):
            return await halt_line(spec)
    except HalError as error:  # before TimeoutError: NoReply is both
        return [str(error)]
    except TimeoutError:
        return [f"{spec.name}: not everything was sent within {within_s:g} s"]


def _halted(spec: LineSpec, results: list[str] | BaseException) -> Halted:
    if isinstance(results, BaseException):
        results = [f"{spec.name}: {type(results).__name__}: {results}"]
    return Halted(spec.name, tuple(joint.name for joint in spec.joints), tuple(results))
