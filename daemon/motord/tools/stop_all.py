# SPDX-License-Identifier: Apache-2.0
"""After a daemon has died: every drive of its robot gets a stop. All lines at once, bounded."""

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
    """A daemon drives this robot: the request belongs there."""


@dataclass(frozen=True, slots=True)
class Halted:
    """What came of a line."""

    line: str
    joints: tuple[str, ...]
    problems: tuple[str, ...]
    """Empty: every drive has acknowledged that it stopped and that its power is off."""


async def stop_all(robot: Robot, within_s: float) -> tuple[Halted, ...]:
    """Raises DaemonRuns; ProfileError for profiles that cannot be read."""
    name = robot.robot.name
    try:
        # its daemon may be dead: the port shows whether it lives
        socket = find_socket(name, barred=False)
    except ClientError:
        pass
    else:
        raise DaemonRuns(f"the daemon of {name} runs ({socket}): use motord estop")
    specs = line_specs(robot, robot.profiles)
    # exceptions come back as values, of whatever kind: one that was not foreseen on one line must
    # not leave the motors of the other lines running
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
