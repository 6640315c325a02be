# SPDX-License-Identifier: Apache-2.0
"""How much of its wire a line needs, and how often the wire can carry it: frame arithmetic."""

from __future__ import annotations

import operator
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from motord_hal.base.errors import ProfileError
from motord_hal.drives.profile import Gap
from motord_hal.fieldbus.ports import JointSpec, LineSpec
from motord_hal.mcu.pace import WIRE_SHARE_MAX
from motord_hal.modbus.codec import Function, frame_time_s
from motord_hal.modbus.timing import line_gap_s
from motord_hal.servo.packets import KINDS as SERVO_KINDS

if TYPE_CHECKING:
    from motord_hal.rt_engine.rs485.frames import DriveFrames

_BAUDRATES = (19200, 38400, 57600, 115200, 230400, 460800, 921600)
_SERVO_BAUDRATES = {
    "feetech": (115200, 250_000, 500_000, 1_000_000),
    "dynamixel": (115200, 1_000_000, 2_000_000, 3_000_000, 4_000_000, 4_500_000),
}
_STREAMS = ("mcu", "ascii", "hoverboard", "sabertooth")
"""Kinds without acyclic exchanges, and without a gap between frames."""
_WORTH_SAYING = 1.02
_AT_ONCE, _AT_THE_LATEST = 0.0, 1.0
"""When drives answer, as parts of the longest turn-around in their profiles."""


@dataclass(frozen=True, slots=True)
class Budget:
    """What a line needs of its wire at the requested rates, if its drives answer at once."""

    drives: int
    cycle_hz: float
    """The highest requested rate."""
    share: float
    """Part of the wire's time; 1: all of it."""
    latest_share: float
    """The same if each drive answers as late as its profile allows."""

    @property
    def most_hz(self) -> float:
        """The rate at which all of the wire is needed; drives with less keep their proportion."""
        return self.cycle_hz / self.share

    @property
    def least_hz(self) -> float:
        """The same rate if each drive answers as late as its profile allows."""
        return self.cycle_hz / self.latest_share


def cycle_limit_hz(spec: LineSpec) -> float:
    """Return the highest cyclic rate of a line whose drives answer at once, without acyclic
    exchanges."""
    if spec.kind == "pwm":
        return spec.cycle_hz  # pins have no wire
    return 1 / sum(_cycle_times_s(spec, _AT_ONCE))


def budget(spec: LineSpec) -> Budget:
    """Return what a line needs of its wire for its cycles alone; acyclic requests come on top."""
    if spec.kind == "pwm":
        return Budget(len(spec.joints), spec.cycle_hz, 0.0, 0.0)
    rates_hz = [_rate_hz(spec, joints) for joints in _units(spec)]
    shares = [
        sum(map(operator.mul, _cycle_times_s(spec, late_part), rates_hz))
        for late_part in (_AT_ONCE, _AT_THE_LATEST)
    ]
    return Budget(len(rates_hz), max(rates_hz), *shares)


def helps(spec: LineSpec) -> Iterator[tuple[str, float]]:
    """Yield each change by which the wire would carry more, and the rate then, in Hz."""
    now_hz = budget(spec).most_hz
    for words, changed in _changes(spec):
        then_hz = budget(changed).most_hz
        if then_hz > now_hz * _WORTH_SAYING:
            yield words, then_hz


def _changes(spec: LineSpec) -> Iterator[tuple[str, LineSpec]]:
    if spec.kind not in ("ddsm", *SERVO_KINDS, *_STREAMS):
        joints = tuple(map(_with_read_write, spec.joints))
        yield "function 23 where the drives have it", replace(spec, joints=joints)
    short = replace(spec, gap=Gap.CHARACTERS, gap_s=None)
    if spec.kind not in _STREAMS and line_gap_s(short) < line_gap_s(spec):
        yield 'gap = "3.5char"', short
    rates = _SERVO_BAUDRATES.get(spec.kind, _BAUDRATES)
    faster = [replace(spec, baudrate=rate) for rate in rates if rate > spec.baudrate]
    if faster:
        enough = (one for one in faster if budget(one).share <= 1)
        better = next(enough, faster[-1])
        yield f"baudrate = {better.baudrate}", better


def _with_read_write(joint: JointSpec) -> JointSpec:
    profile = replace(joint.profile, read_write_function=int(Function.READ_WRITE))
    return replace(joint, profile=profile)


def _units(spec: LineSpec) -> list[list[JointSpec]]:
    """Return the joints of each unit, one a channel. Another rule reports more joints on one
    channel."""
    units: dict[int, dict[int, JointSpec]] = {}
    for joint in spec.joints:
        units.setdefault(joint.unit, {})[joint.channel] = joint
    return [list(channels.values()) for channels in units.values()]


def _rate_hz(spec: LineSpec, joints: list[JointSpec]) -> float:
    own_hz = [joint.cycle_hz for joint in joints if joint.cycle_hz is not None]
    return max(own_hz, default=spec.cycle_hz)


def slowest_cycle_s(spec: LineSpec) -> float:
    """Return the time of a cycle of a line that waits for replies, if every drive answers at the
    last moment, with an acyclic exchange of each."""
    if spec.kind in SERVO_KINDS:
        longest_s = sum(joints[0].profile.turnaround_s for joints in _units(spec))
        return 1 / cycle_limit_hz(spec) + longest_s
    return sum(frames.slowest_cycle_s() for frames in _frames(spec))


def _cycle_times_s(spec: LineSpec, late_part: float) -> list[float]:
    """Return the time of each unit's cycle."""
    units = _units(spec)
    if spec.kind in _STREAMS:
        sizes_bytes = [_stream_bytes(spec, joints) for joints in units]
        return [_wire_time_s(spec, size) / WIRE_SHARE_MAX / len(units) for size in sizes_bytes]
    frames = _frames(spec)
    if spec.kind in SERVO_KINDS:
        from motord_hal.rt_engine.rs485.servo_frames import cycle_of_all_s

        return [cycle_of_all_s(frames, late_part) / len(units)] * len(units)
    return [each.cycle_time_s(late_part) for each in frames]


def _frames(spec: LineSpec) -> list[DriveFrames]:
    from motord_hal.rt_engine.rs485.protocols import frames_for  # boards do without

    return [frames_for(spec, joints) for joints in _units(spec)]


def _stream_bytes(spec: LineSpec, joints: list[JointSpec]) -> int:
    from motord_hal.rt_engine.boards.layout import wire_bytes  # only robots with a board need it

    try:
        return wire_bytes(spec, joints[0].profile.channels)
    except ProfileError:
        return 1  # a wrong template, which another rule reports


def _wire_time_s(spec: LineSpec, size_bytes: int) -> float:
    return frame_time_s(size_bytes, spec.baudrate, spec.parity, spec.stop_bits)
