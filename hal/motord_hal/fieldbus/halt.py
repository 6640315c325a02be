# SPDX-License-Identifier: Apache-2.0
"""Stop the drives of a line whose program has died. For this an ordinary line runs that begins with
a quick stop instead of a set-up; it is shut down when its drives report that they have no power."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, cast

from motord_hal.base.clock import now_s, within
from motord_hal.base.errors import HalError, PortError
from motord_hal.base.tasks import TaskGroup
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
from motord_hal.fieldbus.set_up import readable_now
from motord_hal.fieldbus.units import joints_by_unit
from motord_hal.realtime.drive_state import STOPPING_WITHIN_S
from motord_hal.realtime.exchange import Exchange, Feedback, is_fresh

CONFIRM_WITHIN_S = 0.75
"""Time after the longest quick stop in which a drive has to report that it has no power."""
LOOK_EVERY_S = 0.01
REST_WITHIN_S = 2.0
"""Time after the power-off in which the joints have to be seen at rest."""
FRESH_S = 0.5
COUNTER_STILL_S = 0.1
REST_AGAIN_S = 0.2
"""Time after which pins that could not be brought to rest are tried again."""


@dataclass(slots=True)
class SeenAtRest:
    """Judges by its feedback whether a joint rests."""

    rest_velocity_rad_s: float
    _count: int | None = None
    _since_ns: int = 0

    def take(self, found: Feedback) -> bool:
        """Take the newest feedback; return whether the joint was seen at rest by it: by the speed
        that its drive measures or, where it measures none, by a counter that stands still."""
        if not is_fresh(found.stamp_ns, FRESH_S):
            self._count = None
            return False
        if math.isfinite(found.velocity_rad_s):
            return abs(found.velocity_rad_s) < self.rest_velocity_rad_s
        if found.count != self._count:
            self._count, self._since_ns = found.count, found.stamp_ns
        return found.stamp_ns - self._since_ns >= COUNTER_STILL_S * 1e9


async def halt_line(
    spec: LineSpec,
    within_s: float = 0.0,
    say: Callable[[str], None] = lambda _: None,
    resting: dict[str, SeenAtRest] | None = None,
) -> list[str]:
    """Send a quick stop, then a power-off, to every drive of a line that no daemon runs. Read
    nothing before the stop is sent, and write nothing else. Return a text for each drive whose
    power-off is not confirmed. A line that cannot be opened, or is lost, is tried again for
    `within_s`, once at least; `say` gets the reason of the first failure. `resting`: the joints
    that measure their motion; those that are then seen at rest are removed. Raise PortError if the
    line was never open."""
    end_s = now_s() + within_s
    if spec.kind == "pwm":
        return await _rest_pins(spec, end_s, say)
    events = _Events(say)
    exchange = Exchange.private()
    line = cast("DriveLine[Any]", open_line(_left_running(spec), exchange, events.take))
    async with TaskGroup() as tasks:
        running = tasks.create_task(line.run())
        try:
            problems = await _until_off(line, events, end_s)
            if resting:
                await _until_at_rest(spec, exchange, resting)
        finally:
            running.cancel()
    if not events.opens:
        raise PortError(events.lost)
    for names, text in events.left_on.items():
        if names not in _drives_that_report(spec):  # if it can report, its report counts
            problems.setdefault(names, text)
    return list(problems.values())


async def _rest_pins(spec: LineSpec, end_s: float, say: Callable[[str], None]) -> list[str]:
    from motord_hal.pwm.pins import rest_pins  # imported only if there is such a line

    reported = False
    while (problems := await rest_pins(spec)) and now_s() + REST_AGAIN_S < end_s:
        if not reported:
            reported = True
            say(problems[0])
        await asyncio.sleep(REST_AGAIN_S)
    return problems


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

    say: Callable[[str], None]
    first: asyncio.Event = field(default_factory=asyncio.Event)
    opens: int = 0
    """How often the medium was opened."""
    opened_s: float = 0.0
    lost: str = ""
    """Newest reason why the medium was lost or could not be opened; empty: it never was."""
    left_on: dict[tuple[str, ...], str] = field(default_factory=dict)
    """Names of a drive's joints → reason why the drive may still have power."""

    def take(self, event: LineEvent) -> None:
        self.first.set()
        match event.kind:
            case EventKind.LINE_OPEN:
                self.opens += 1
                self.opened_s = now_s()
            case EventKind.LINE_LOST:
                if not self.lost:
                    self.say(event.text)
                self.lost = event.text
            case EventKind.DRIVE_LEFT_ON:
                self.left_on[event.joints] = event.text
            case _:
                pass


async def _until_off(
    line: DriveLine[Any], events: _Events, end_s: float
) -> dict[tuple[str, ...], str]:
    """Wait until all drives have stopped and have no power, or time is up. Return a dictionary of
    the drives for which that is not confirmed: names of the drive's joints → reason."""
    await events.first.wait()
    drives = list(joints_by_unit(line.spec))
    doubts = await asyncio.gather(*(_until_drive_off(line, each, events, end_s) for each in drives))
    named = zip((tuple(joint.name for joint in each) for each in drives), doubts, strict=True)
    return {names: doubt for names, doubt in named if doubt}


async def _until_at_rest(
    spec: LineSpec, exchange: Exchange, resting: dict[str, SeenAtRest]
) -> None:
    """Watch the joints for REST_WITHIN_S at most; remove those that were seen at rest."""
    end_s = now_s() + REST_WITHIN_S
    while resting and now_s() < end_s:
        for joint in spec.joints:
            watched = resting.get(joint.name)
            if watched is not None and watched.take(exchange.take_feedback(joint.index)):
                del resting[joint.name]
        await asyncio.sleep(LOOK_EVERY_S)


async def _until_drive_off(
    line: DriveLine[Any], joints: Sequence[JointSpec], events: _Events, end_s: float
) -> str:
    """Wait until one drive is off, or time is up: of a line that is open, STOPPING_WITHIN_S and
    CONFIRM_WITHIN_S after it was opened, of one that is lost, at `end_s`. Return the reason why the
    drive may still have power; empty: it is off."""
    names = ", ".join(joint.name for joint in joints)
    report, failure = "", "did not report whether it has power"
    while True:
        is_open = line.state is not LineState.CLOSED
        until_s = events.opened_s + STOPPING_WITHIN_S + CONFIRM_WITHIN_S if is_open else end_s
        try:
            if is_open:
                async with within(until_s - now_s()):
                    report = await _report(line, joints[0])
                if not report:
                    return ""
        except HalError as error:
            failure = str(error)
        except TimeoutError:
            pass
        if line.state is LineState.CLOSED:
            report, failure = "", "the line was lost before it was stopped"
        elif not is_open:
            continue  # it has just been opened: its drives get their time
        if now_s() >= until_s:
            break
        await asyncio.sleep(LOOK_EVERY_S)
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
    if joint.profile.can is not None or nothing_answers(line.spec):
        return "the stop was sent; the drive cannot report whether it has power"
    return ""


def nothing_answers(spec: LineSpec) -> bool:
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
    register = readable_now(joint.profile, place.register)
    raw = registers[register].from_si(await line.read_register(joint.name, register))
    return raw & place.mask == place.equals
