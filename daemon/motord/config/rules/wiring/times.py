# SPDX-License-Identifier: Apache-2.0
"""Rules for the times of [safety]: long enough for the lines, short enough for the robot."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass

from motord.config.finding import Finding
from motord.config.rules.limits import ROUNDING, ceiling
from motord.config.rules.wiring.wire import cycle_limit_hz, slowest_cycle_s
from motord.config.sections.bases import JointsBase
from motord.config.sections.joint.wheels import Profiles, velocity_range_rad_s
from motord.config.sections.line import AsciiLine, CanLine
from motord.config.sections.model import Robot
from motord.config.toml_lines import Path
from motord.config.wiring import line_specs
from motord_hal.fieldbus.open_line import engine_of
from motord_hal.fieldbus.ports import LineSpec
from motord_hal.modbus.timing import lost_reply_s

CYCLES_MIN = 3
"""Cycles that a time-out lasts at least: one reply may be lost and the next one late by up to a
cycle."""
TRAVEL_WARNING_M = 0.5
"""Longest travel before a time-out acts without a warning: a robot of this length leaves its own
place."""
NO_REPLIES = ("can", "pwm", "mcu", "ascii", "hoverboard", "sabertooth")
"""Kinds of lines on which nothing waits for a reply."""
TURN_WARNING_RAD = math.tau
"""The same for a joint without a base: one turn."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Reaction:
    """A time after which something stops the robot, and how far it goes until then at its limit."""

    key: str
    """The key as in the robot file."""
    time_s: float
    travel_m: float | None
    """None: the robot has no base."""
    turn_rad: float | None
    """Travel of the fastest joint without a base; None: the robot has a base."""
    paths: tuple[Path, ...]
    fixed: bool = False
    """Whether the drive has this time by itself and motord cannot change it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Watchdog:
    """What a drive does when motord is killed (`kill -9`) or the computer dies."""

    drive: str
    joints: tuple[str, ...]
    stops_within_s: float | None
    """None: the drive does not stop, or that is not known."""
    note: str
    known: bool
    """Whether the profile has an answer; False: the drive may stop or not."""


def drive_watchdogs(robot: Robot, profiles: Profiles) -> Iterator[Watchdog]:
    """Yield what each drive does by itself."""
    for drive in dict.fromkeys(joint.drive for joint in robot.joint.values()):
        profile = profiles[drive]
        joints = tuple(name for name, joint in robot.joint.items() if joint.drive == drive)
        within_s, note = None, profile.watchdog_note
        if profile.watchdog is not None:
            within_s, note = robot.safety.drive_watchdog_s, profile.watchdog.action
        elif profile.watchdog_fixed_s:
            within_s = profile.watchdog_fixed_s
        elif all(robot.joint[name].drive_watchdog_s for name in joints):
            within_s = max(robot.joint[name].drive_watchdog_s or 0.0 for name in joints)
            note = "as the robot file has it"
        known = within_s is not None or "watchdog" not in profile.unknown
        yield Watchdog(drive=drive, joints=joints, stops_within_s=within_s, note=note, known=known)


def reactions(robot: Robot, profiles: Profiles) -> Iterator[Reaction]:
    """Yield every time that decides how long the robot goes on when something fails."""
    speed_m_s = turn_rad_s = None
    if isinstance(robot.base, JointsBase):
        joints = robot.joint.values()
        turn_rad_s = max(velocity_range_rad_s(one, profiles[one.drive])[1] for one in joints)
    else:
        speed_m_s = min(robot.limits.linear_m_s, ceiling(robot, profiles).linear_m_s)

    def reaction(key: str, time_s: float, *paths: Path, fixed: bool = False) -> Reaction:
        return Reaction(
            key=key,
            time_s=time_s,
            travel_m=None if speed_m_s is None else speed_m_s * time_s,
            turn_rad=None if turn_rad_s is None else turn_rad_s * time_s,
            paths=(*paths, ("limits", "linear_m_s")),
            fixed=fixed,
        )

    for key in ("command_timeout_s", "feedback_timeout_s", "heartbeat_timeout_s"):
        yield reaction(key, getattr(robot.safety, key), ("safety", key))
    for found in drive_watchdogs(robot, profiles):
        if found.stops_within_s is None:
            continue  # reported for what it is, by another rule
        at: Path = ("joint", found.joints[0], "drive")
        paths: tuple[Path, ...]
        if profiles[found.drive].watchdog is not None:
            key, paths = "drive_watchdog_s", (("safety", "drive_watchdog_s"), at)
        elif profiles[found.drive].watchdog_fixed_s:
            key, paths = f"the watchdog of {found.drive}", (at,)
        else:
            key = f"drive_watchdog_s of {', '.join(found.joints)}"
            paths = (("joint", found.joints[0], "drive_watchdog_s"), at)
        fixed = key.startswith("the ")
        yield reaction(key, found.stops_within_s, *paths, fixed=fixed)


def _short_enough(robot: Robot, profiles: Profiles) -> Iterator[Finding]:
    """Judge each time by how far the robot goes in it at its limit."""
    most_m = robot.safety.timeout_travel_max_m
    for one in reactions(robot, profiles):
        if one.turn_rad is not None and one.turn_rad > TURN_WARNING_RAD * (1 + ROUNDING):
            text = (
                f"in {one.time_s:g} s the fastest joint turns by {one.turn_rad:.1f} rad: is there "
                "so much room? shorten the time or lower velocity_max_rad_s"
            )
            yield Finding(one.paths, text, warning=True)
        if one.travel_m is None or one.travel_m <= TRAVEL_WARNING_M * (1 + ROUNDING):
            continue
        text = f"in {one.time_s:g} s the robot goes {one.travel_m:.2g} m at its limit"
        if one.fixed:
            what = f"{one.key} is fixed: {text} when motord is gone; lower linear_m_s"
            yield Finding(one.paths, what, warning=True)
        elif one.travel_m < most_m:
            text += " before this stops it: is there so much room? shorten it or lower linear_m_s"
            yield Finding(one.paths, text, warning=True)
        else:
            text += (
                f" before this stops it (it must be less than {most_m:g} m): shorten it, lower "
                "linear_m_s, or set safety.timeout_travel_max_m if that is meant"
            )
            yield Finding(one.paths, text)


def _long_enough(robot: Robot, profiles: Profiles) -> Iterator[Finding]:
    """Check that one lost and one late reply are no fault, and do not let a drive stop."""
    for spec in line_specs(robot, profiles):
        if not spec.joints:
            continue
        cycle_s = _cycle_s(spec)
        least_s = CYCLES_MIN * cycle_s
        watched = any(joint.profile.watchdog for joint in spec.joints)
        keys = ["feedback_timeout_s", *(["drive_watchdog_s"] if watched else ())]
        own: list[tuple[Path, float]] = [
            (("safety", key), getattr(robot.safety, key)) for key in keys
        ]
        own += [
            (("joint", joint.name, "drive_watchdog_s"), own_s)
            for joint in spec.joints
            if (own_s := robot.joint[joint.name].drive_watchdog_s) is not None
            and isinstance(robot.line[spec.name], CanLine | AsciiLine)
        ]
        on: tuple[Path, ...] = tuple(
            ("line", spec.name, key) for key in ("cycle_hz", "baudrate", "gap_s")
        )
        lost_s = longest_gap_s(spec)
        for path, time_s in own:
            if least_s * (1 - ROUNDING) <= time_s < lost_s * (1 - ROUNDING):
                text = (
                    f'{time_s:g} s is short for line "{spec.name}": when a reply is lost or late, '
                    f"a drive is without an exchange for up to {lost_s:.3g} s (three cycles, and "
                    "the time in which the reply may still come)"
                )
                yield Finding((path, *on), text, warning=True)
            if time_s < least_s * (1 - ROUNDING):
                text = (
                    f'{time_s:g} s is shorter than three cycles of line "{spec.name}" (at least '
                    f"{least_s:.3g} s): one lost reply and a late one would stop the robot"
                )
                yield Finding((path, *on), text)


def longest_gap_s(spec: LineSpec) -> float:
    """Return for how long a drive is without an exchange, at worst, when one of its replies is
    lost, damaged or late. On CAN and from boards feedback comes without requests: nothing waits."""
    cycle_s = _cycle_s(spec)
    if spec.kind in NO_REPLIES:
        return CYCLES_MIN * cycle_s
    # in one of these cycles, every other drive may answer at the last moment
    cycles_s = (CYCLES_MIN - 1) * cycle_s + max(cycle_s, slowest_cycle_s(spec))
    return cycles_s + lost_reply_s(spec, rt=engine_of(spec) == "rt")


def _cycle_s(spec: LineSpec) -> float:
    """Return the longest time from one feedback of a drive on this line to its next."""
    if spec.kind == "can":
        from motord.config.rules.wiring.can import slowest_sample_s

        return max(slowest_sample_s(spec), 1.0 / spec.cycle_hz)
    own_hz = [joint.cycle_hz for joint in spec.joints if joint.cycle_hz is not None]
    return 1.0 / min(spec.cycle_hz, cycle_limit_hz(spec), *own_hz)


TIME_RULES: tuple[Callable[[Robot, Profiles], Iterator[Finding]], ...] = (
    _long_enough,
    _short_enough,
)
