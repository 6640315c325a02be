# SPDX-License-Identifier: Apache-2.0
"""Rules between a CAN bus of a robot file and the drives on it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

from motord.config.finding import Finding
from motord.config.sections.joint.wheels import Profiles
from motord.config.sections.line import AsciiLine, CanLine
from motord.config.sections.model import Robot
from motord.config.toml_lines import Path
from motord.config.wiring import line_specs
from motord_hal.base.errors import ProfileError
from motord_hal.can.identifiers import clashes
from motord_hal.can.plan import CanPlan, with_cycle
from motord_hal.fieldbus.ports import JointSpec, LineSpec
from motord_hal.fieldbus.units import drive_key

LOAD_MAX = 1.0
LOAD_WARNING = 0.8
"""Load above which frames of low priority wait long: they go only when no other node sends."""
_BITRATES = (125_000, 250_000, 500_000, 800_000, 1_000_000)


def _specs(robot: Robot, profiles: Profiles) -> Iterator[LineSpec]:
    for spec in line_specs(robot, profiles):
        joints = tuple(joint for joint in spec.joints if joint.profile.can is not None)
        if spec.kind == "can" and joints:
            yield replace(spec, joints=joints)


def _plans(spec: LineSpec) -> list[CanPlan]:
    """Return a plan for each drive, with one joint a channel. Another rule reports more joints on
    one."""
    nodes: dict[object, dict[int, JointSpec]] = {}
    for joint in spec.joints:
        nodes.setdefault(drive_key(joint), {})[joint.channel] = joint
    return [CanPlan(channels.values()) for channels in nodes.values()]


def bus_load(spec: LineSpec) -> tuple[float, float]:
    """Return the part of the CAN bus that the drives take by themselves, and the part that one
    cycle a second takes; at worst, with all stuff bits."""
    wire = (spec.baudrate, spec.data_baudrate)
    plans = _plans(spec)
    return (
        sum(plan.own_load(*wire) for plan in plans),
        sum(plan.cycle_time_s(*wire) for plan in plans),
    )


def _identifiers(robot: Robot, profiles: Profiles) -> Iterator[Finding]:
    """Check that no two drives send or obey the same identifier."""
    for spec in _specs(robot, profiles):
        for clash in clashes(_plans(spec)):
            paths = tuple(
                ("joint", plan.joints[0].name, key)
                for key in ("unit", "drive", "line")
                for plan in (clash.other, clash.one)
            )
            yield Finding(paths, f"{clash.text}: give one of them another node")


def _load(robot: Robot, profiles: Profiles) -> Iterator[Finding]:
    for spec in _specs(robot, profiles):
        own, cycle_s = bus_load(spec)
        share = own + cycle_s * spec.cycle_hz
        if share <= LOAD_WARNING:
            continue
        most_hz = max(LOAD_WARNING - own, 0.0) / cycle_s
        text = f"line {spec.name}: {spec.cycle_hz:g} Hz load the CAN bus with {100 * share:.0f} %"
        text += f" ({100 * own:.0f} % is what the drives send by themselves)"
        text += f"; with at most {100 * LOAD_WARNING:.0f} % it is {most_hz:.3g} Hz{_faster(spec)}"
        paths: tuple[Path, ...] = tuple(
            ("line", spec.name, key) for key in ("cycle_hz", "bitrate", "data_bitrate")
        )
        yield Finding(paths, text, warning=share <= LOAD_MAX)


def _faster(spec: LineSpec) -> str:
    for bitrate in _BITRATES:
        own, cycle_s = bus_load(replace(spec, baudrate=bitrate))
        if bitrate > spec.baudrate and own + cycle_s * spec.cycle_hz <= LOAD_WARNING:
            return f"; or bitrate = {bitrate}"
    return ""


def slowest_sample_s(spec: LineSpec) -> float:
    """Return the longest period at which a drive of this bus sends its measurements by itself; 0:
    none does."""
    joints = tuple(joint for joint in spec.joints if joint.profile.can is not None)
    plans = _plans(replace(spec, joints=joints))
    return max((frame.period_s for plan in plans for frame in plan.measuring), default=0.0)


def _cycles(robot: Robot, profiles: Profiles) -> Iterator[Finding]:
    """Check that a drive that interpolates between set-points can learn how far apart they are."""
    for name, joint in robot.joint.items():
        line, profile = robot.line[joint.line], profiles[joint.drive]
        if not isinstance(line, CanLine):
            continue
        try:
            with_cycle(profile, 1.0 / line.cycle_hz)
        except ProfileError as error:
            yield Finding((("line", joint.line, "cycle_hz"), ("joint", name, "drive")), str(error))


def _frames(robot: Robot, profiles: Profiles) -> Iterator[Finding]:
    for name, joint in robot.joint.items():
        line, table = robot.line[joint.line], profiles[joint.drive].can
        if not isinstance(line, CanLine) or table is None:
            continue
        if line.data_bitrate is None and any(frame.fd for frame in table.frames.values()):
            paths = (("line", joint.line, "data_bitrate"), ("joint", name, "drive"))
            yield Finding(paths, f'is missing: drive "{joint.drive}" speaks CAN FD')


def _counts(robot: Robot, profiles: Profiles) -> Iterator[Finding]:
    for name, joint in robot.joint.items():
        profile = profiles[joint.drive]
        position = profile.registers.get(profile.channels[joint.channel].position or "")
        own = joint.counts_per_turn
        if position is None or position.unit != "turn" or own in (None, profile.counts_per_turn):
            continue
        text = f'is not used: drive "{joint.drive}" reports its position in turns'
        yield Finding((("joint", name, "counts_per_turn"), ("joint", name, "drive")), text)


def _watchdogs(robot: Robot, profiles: Profiles) -> Iterator[Finding]:
    """Check the watchdog that was set with the maker's tool, or by a text's prefix. motord cannot
    read it, but counts on safety.drive_watchdog_s: for this long a wheel may go on when motord
    dies, and a drive that received nothing for this long has stopped by itself."""
    wanted_s = robot.safety.drive_watchdog_s
    for name, joint in robot.joint.items():
        own_s, line = joint.drive_watchdog_s, robot.line[joint.line]
        if own_s is None:
            continue
        path: Path = ("joint", name, "drive_watchdog_s")
        if not isinstance(line, CanLine | AsciiLine):
            yield Finding((path,), "is only for a drive on a CAN bus, or a board that reads text")
        elif profiles[joint.drive].watchdog is not None:
            text = f'is not used: motord sets that of drive "{joint.drive}" itself'
            yield Finding((path,), f"{text}, to safety.drive_watchdog_s")
        elif own_s != wanted_s:
            text = f"{own_s:g} s is not safety.drive_watchdog_s ({wanted_s:g} s), on which motord"
            yield Finding((path, ("safety", "drive_watchdog_s")), f"{text} counts: make them one")


CAN_RULES: tuple[Callable[[Robot, Profiles], Iterator[Finding]], ...] = (
    _identifiers,
    _load,
    _cycles,
    _frames,
    _counts,
    _watchdogs,
)
