# SPDX-License-Identifier: Apache-2.0
"""Stop the drives of a line whose program has died. For this an ordinary line runs that begins with
a quick stop instead of a set-up; it is shut down when its drives report that they have no power."""

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
"""Time after the longest quick stop in which a drive has to report that it has no power."""
LOOK_EVERY_S = 0.01


async def halt_line(spec: LineSpec) -> list[str]:
    """Send a quick stop, then a power-off, to every drive of a line that no daemon runs. Read
    nothing before the stop is sent, and write nothing else. Return a text for each drive whose
    power-off is not confirmed. Raise PortError if the line cannot be opened."""
    if spec.kind == "pwm":
        from motord_hal.pwm.pins import rest_pins  # imported only if there is such a line

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
        if names not in _drives_that_report(spec):  # if it can report, its report counts
            problems.setdefault(names, text)
    return list(problems.values())


def _drives_that_report(spec: LineSpec) -> set[tuple[str, ...]]:
    """Return the joint names of each drive that can report whether it has power. For these a read
    counts more than the event at the end of the line, which follows only from frames that come by
    themselves: a node that is not operational sends none."""
    return {
        tuple(joint.name for joint in joints)
        for joints in joints_by_unit(spec)
        if joints[0].profile.enabled is not None or joints[0].profile.power_off is not None
    }


def _left_running(spec: LineSpec) -> LineSpec:
    """Return the spec of the same line, with drives left running and nothing to set up."""
    joints = (
        replace(joint, profile=replace(joint.profile, configure=(), watchdog=None))
        for joint in spec.joints
    )
    return replace(spec, left_running=True, joints=tuple(joints))


@dataclass(slots=True)
class _Events:
    """Collects the events that the line reports."""

    first: asyncio.Event = field(default_factory=asyncio.Event)
    opened: bool = False
    lost: str = ""
    """Reason why the medium is lost or cannot be opened; empty: it is neither."""
    left_on: dict[tuple[str, ...], str] = field(default_factory=dict)
    """Names of a drive's joints → reason why the drive may still have power."""

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
    """Wait until all drives have stopped and have no power, or time is up. Return a dictionary of
    the drives for which that is not confirmed: names of the drive's joints → reason."""
    await events.first.wait()
    until_s = now_s() + STOPPING_WITHIN_S + CONFIRM_WITHIN_S
    drives = list(joints_by_unit(line.spec))
    doubts = await asyncio.gather(*(_until_drive_off(line, each, until_s) for each in drives))
    named = zip((tuple(joint.name for joint in each) for each in drives), doubts, strict=True)
    return {names: doubt for names, doubt in named if doubt}


async def _until_drive_off(
    line: DriveLine[Any], joints: Sequence[JointSpec], until_s: float
) -> str:
    """Wait until one drive is off, or time is up. Return the reason why it may still have power;
    empty: it is off."""
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
    """Return the reason why the drive may have power, or may turn, by its own report; empty: it is
    off. Raise HalError if the report cannot be read."""
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
    """Whether the line's board sends nothing, so that the line knows only that its port has taken
    the bytes."""
    return spec.kind == "sabertooth" or (
        spec.kind == "ascii" and spec.text is not None and not spec.text.feedback
    )


async def _holds(line: DriveLine[Any], joint: JointSpec, place: Enabled) -> bool:
    """Read whether the register of `place` has the value that `place` demands. For a signal of a
    CAN drive read its object, which works also when its frames do not come. Raise HalError if the
    read fails."""
    registers = joint.profile.registers
    found = registers[place.register]
    register = (isinstance(found, Signal) and found.object) or place.register
    raw = registers[register].from_si(await line.read_register(joint.name, register))
    return raw & place.mask == place.equals
