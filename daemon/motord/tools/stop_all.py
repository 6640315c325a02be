# SPDX-License-Identifier: Apache-2.0
"""Stops all drives of a robot whose daemon has died, on all lines at once, with a deadline."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Collection
from dataclasses import dataclass

from motord.api.snapshot import Rest, rest_text
from motord.client import ClientError, find_socket
from motord.config import Robot
from motord.config.sections.joint.wheels import reports_motion
from motord.control.assembly import line_specs
from motord_hal.base.clock import within
from motord_hal.base.errors import HalError
from motord_hal.fieldbus.halt import SeenAtRest, halt_line
from motord_hal.fieldbus.ports import LineSpec

LAST_TRY_S = 3.0
"""Time in which a line ends that was opened at the last moment: the longest quick stop, and the
report of its drives."""


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
    rest_unknown: tuple[str, ...] = ()
    """Joints that measure their motion, and were not seen at rest."""
    rest_unmeasured: tuple[str, ...] = ()
    """Joints whose motion nothing measures."""

    @property
    def confirmed(self) -> bool:
        """Whether the power is off, and no joint may turn that could be seen."""
        return not self.problems and not self.rest_unknown

    @property
    def rest_text(self) -> str:
        """What a person has to know about the rest of these joints; empty: it was seen."""
        if self.rest_unknown:
            return rest_text(Rest.UNKNOWN, self.rest_unknown)
        return rest_text(Rest.AT_REST, (), self.rest_unmeasured)


async def stop_all(
    robot: Robot, within_s: float, say: Callable[[str], None] = lambda _: None
) -> tuple[Halted, ...]:
    """Stop all drives of a robot. Lines that cannot be opened, or are lost, are tried again for
    `within_s`; `say` gets the first reason of each. Raise DaemonRuns, or ProfileError for profiles
    that cannot be read."""
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
    resting = [_measured(robot, spec) for spec in specs]
    measured = [frozenset(watched) for watched in resting]
    # exceptions of any kind come back as values: an unforeseen one on one line must not leave the
    # motors of the other lines running
    results = await asyncio.gather(
        *(
            _problems(spec, within_s, say, watched)
            for spec, watched in zip(specs, resting, strict=True)
        ),
        return_exceptions=True,
    )
    return tuple(
        _halted(spec, result, tuple(watched), seen)
        for spec, result, watched, seen in zip(specs, results, resting, measured, strict=True)
    )


def _measured(robot: Robot, spec: LineSpec) -> dict[str, SeenAtRest]:
    """Return the joints of a line that measure their motion."""
    return {
        joint.name: SeenAtRest(robot.safety.rest_velocity_rad_s)
        for joint in spec.joints
        if spec.kind != "pwm" and reports_motion(robot, joint.name, joint.profile)
    }


async def _problems(
    spec: LineSpec, within_s: float, say: Callable[[str], None], resting: dict[str, SeenAtRest]
) -> list[str]:
    limit_s = within_s + LAST_TRY_S
    try:
        async with within(limit_s):
            return await halt_line(spec, within_s, say, resting)
    except HalError as error:  # before TimeoutError: NoReply is both
        return [str(error)]
    except TimeoutError:
        return [f"{spec.name}: not everything was sent within {limit_s:g} s"]


def _halted(
    spec: LineSpec,
    results: list[str] | BaseException,
    unknown: tuple[str, ...],
    measured: Collection[str],
) -> Halted:
    if isinstance(results, BaseException):
        results = [f"{spec.name}: {type(results).__name__}: {results}"]
    names = tuple(joint.name for joint in spec.joints)
    unmeasured = tuple(name for name in names if name not in measured)
    return Halted(spec.name, names, tuple(results), unknown, unmeasured)
