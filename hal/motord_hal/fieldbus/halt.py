# SPDX-License-Identifier: Apache-2.0
"""Stopping the drives of a line whose program has died: an ordinary line, which begins with a quick
stop instead of a set-up, and is shut down when its drives report no power."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any, cast

from motord_hal.base.clock import now_s, within
from motord_hal.base.errors import HalError, PortError
from motord_hal.drives.can_profile import Signal
from motord_hal.drives.profile import Enabled
from motord_hal.fieldbus.line import DriveLine
from motord_hal.fieldbus.open_line import open_line
from motord_hal.fieldbus.ports import (
    DriveState,
    EventKind,
    JointSpec,
    LineEvent,
    LineSpec,
    LineState,
)
from motord_hal.fieldbus.units import joints_by_unit
from motord_hal.realtime.drive_state import STOPPING_WITHIN_S
from motord_hal.realtime.exchange import Exchange

CONFIRM_WITHIN_S = 0.75
"""After the longest quick stop: time for a drive to report that it has no power."""
LOOK_EVERY_S = 0.01


async def halt_line(spec: LineSpec) -> list[str]:
    """Quick stop, then power off, on every drive of a line that no daemon runs. Nothing is read
    before the stop is sent, and nothing else is written. Returns what was not confirmed, in words.
    Raises PortError if the line cannot be opened."""
    if spec.kind == "pwm":
        from motord_hal.pwm.pins import rest_pins  # a robot loads only the lines that it has

        return await rest_pins(spec)
    events = _Events()
    line = cast("DriveLine[Any]", open_line(_left_running(spec), Exchange.private(), events.take))
    async with asyncio.TaskGroup() as tasks:
        running = tasks.create_task(line.run())
        try:
            problems = await _until_off(line, events)
        finally:
            running.cancel()
    if events.lost and not events.opened:
        raise PortError(events.lost)
    for names, text in events.left_on.items():
        if names not in _drives_that_report(spec):  # for such a drive its own report counts
            problems.setdefault(names, text)
    return list(problems.values())


def _drives_that_report(spec: LineSpec) -> set[tuple[str, ...]]:
    """The names of each drive's joints. The end of a line knows less than a read: it uses only
    frames that come by themselves, and a node that is not operational sends none."""
    return {
        tuple(joint.name for joint in joints)
        for joints in joints_by_unit(spec)
        if joints[0].profile.enabled is not None or joints[0].profile.power_off is not None
    }


def _left_running(spec: LineSpec) -> LineSpec:
    """The same line, with nothing to set up."""
    joints = (
        replace(joint, profile=replace(joint.profile, configure=(), watchdog=None))
        for joint in spec.joints
    )
    return replace(spec, left_running=True, joints=tuple(joints))


@dataclass(slots=True)
class _Events:
    """What the line reports."""

    first: asyncio.Event = field(default_factory=asyncio.Event)
    opened: bool = False
    lost: str = ""
    """Why the medium is not there."""
    left_on: dict[tuple[str, ...], str] = field(default_factory=dict)
    """Names of a drive's joints → why it may still have power."""

    def take(self, event: LineEvent) -> None:
        self.first.set()
        match event.kind:
            case EventKind.LINE_OPEN:
                self.opened = True
            case EventKind.LINE_LOST:
                self.lost = event.text
            case EventKind.DRIVE_LEFT_ON:
                self.left_on[event.joints] = event.text
            case _:
                pass


async def _until_off(line: DriveLine[Any], events: _Events) -> dict[tuple[str, ...], str]:
    """Wait until all drives have stopped and have no power, or time is up. Returns the drives for
    which that is not confirmed, by the names of their joints, with the reason."""
    await events.first.wait()
    until_s = now_s() + STOPPING_WITHIN_S + CONFIRM_WITHIN_S
    drives = list(joints_by_unit(line.spec))
    doubts = await asyncio.gather(*(_until_drive_off(line, each, until_s) for each in drives))
    named = zip((tuple(joint.name for joint in each) for each in drives), doubts, strict=True)
    return {names: doubt for names, doubt in named if doubt}


async def _until_drive_off(
    line: DriveLine[Any], joints: Sequence[JointSpec], until_s: float
) -> str:
    """Returns why it may still have power; empty: it is off."""
    names = ", ".join(joint.name for joint in joints)
    report, failure = "", "did not report whether it has power"
    while line.state is not LineState.CLOSED:
        try:
            async with within(until_s - now_s()):
                report = await _report(line, joints[0])
        except HalError as error:
            failure = str(error)
        except TimeoutError:
            break
        else:
            if not report:
                return ""
        if now_s() > until_s:
            break
        await asyncio.sleep(LOOK_EVERY_S)
    else:
        failure = "the line was lost before it was stopped"
    doubt = report or failure
    return doubt if names in doubt else f"{names}: {doubt}"


async def _report(line: DriveLine[Any], joint: JointSpec) -> str:
    """Why the drive may have power, or may turn, by its own report; empty: it is off. Raises
    HalError."""
    profile = joint.profile
    if profile.enabled is not None or profile.power_off is not None:
        # some drives are not enabled while they brake: only a report after the power-off counts
        stopping = line.is_stopping(joint.name)
        if profile.enabled is not None and await _holds(line, joint, profile.enabled):
            return "reports that it is still enabled"
        if profile.power_off is not None and not await _holds(line, joint, profile.power_off):
            return "reports that it still has power"
        return "is still stopping" if stopping else ""
    if line.drive_states[joint.name] is DriveState.UNRESPONSIVE:
        return "is unresponsive"
    if line.is_stopping(joint.name):
        return "is still stopping"
    # a sent frame is not an acknowledgement
    if joint.profile.can is not None or _nothing_answers(line.spec):
        return "the stop was sent; the drive cannot report whether it has power"
    return ""


def _nothing_answers(spec: LineSpec) -> bool:
    """Such a line knows only that its port has taken the bytes."""
    return spec.kind == "sabertooth" or (
        spec.kind == "ascii" and spec.text is not None and not spec.text.feedback
    )


async def _holds(line: DriveLine[Any], joint: JointSpec, place: Enabled) -> bool:
    """Whether the drive reports it. Of a CAN drive the object is read, which works also when its
    frames do not come. Raises HalError."""
    registers = joint.profile.registers
    found = registers[place.register]
    register = (isinstance(found, Signal) and found.object) or place.register
    raw = registers[register].from_si(await line.read_register(joint.name, register))
    return raw & place.mask == place.equals
