# SPDX-License-Identifier: Apache-2.0
"""Conversion between raw values of a drive and SI values of its joints by the drive's profile, on
any medium. Pure."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass

from motord_hal.drives.profile import Channel, DriveProfile, Step
from motord_hal.fieldbus.ports import JointSpec
from motord_hal.realtime.exchange import JointSetpoint

Wanted = Mapping[int, JointSetpoint]
"""Joint index → requested set-point; a joint that is missing gets zero."""
REST = JointSetpoint(0.0, 0.0)


def of_kind(channel: Channel, setpoint: JointSetpoint) -> float:
    """Return the part of a set-point that the channel takes, at the wheel."""
    if channel.torque_setpoint is not None:
        return setpoint.torque_n_m
    if channel.position_setpoint is not None:
        return setpoint.position_rad or 0.0
    return setpoint.velocity_rad_s if channel.velocity_setpoint is not None else setpoint.duty


@dataclass(frozen=True, slots=True)
class Reading:
    """The report of a drive for one joint, at the wheel, in SI; NaN or None for a value that it
    does not report."""

    count: int
    velocity_rad_s: float
    current_a: float
    voltage_v: float
    temperature_c: float
    enabled: bool | None
    fault_word: int


def present_positions(channels: Iterable[Channel]) -> Iterator[Step]:
    """Yield the writes that set each position target to the present position, so that the drive
    stays at rest when it gets its power."""
    for channel in channels:
        if channel.position_setpoint is not None and channel.position is not None:
            yield Step(
                register=channel.position_setpoint, value=0, copy_of=channel.position, verify=False
            )


class Plan:
    """Converts the values of one drive, which has one or more joints on its channels."""

    def __init__(self, joints: Iterable[JointSpec]) -> None:
        self.joints = tuple(sorted(joints, key=lambda joint: joint.channel))
        self.profile: DriveProfile = self.joints[0].profile
        self.unit = self.joints[0].unit

    def channel(self, joint: JointSpec) -> Channel:
        return self.profile.channels[joint.channel]

    def enabled(self, values: Mapping[str, int]) -> bool | None:
        """Whether the drive reports by these raw values that it is enabled; None: it cannot report
        it, or has not yet."""
        enabled = self.profile.enabled
        if enabled is None or enabled.register not in values:
            return None
        return values[enabled.register] & enabled.mask == enabled.equals

    def _reading(
        self, joint: JointSpec, values: Mapping[str, int], count: int, sign: float = 1.0
    ) -> Reading:
        """Convert the raw values of a joint. `sign` is the sign of a velocity that is sent without
        one."""
        channel = self.channel(joint)
        return Reading(
            count=count,
            velocity_rad_s=self._si(channel.velocity, values) * joint.velocity_factor * sign,
            current_a=self._si(channel.current, values) * joint.current_factor,
            voltage_v=self._si(self.profile.bus_voltage, values),
            temperature_c=self._si(channel.temperature, values),
            enabled=self.enabled(values),
            fault_word=values.get(channel.fault or "", 0),
        )

    def _si(self, name: str | None, values: Mapping[str, int]) -> float:
        if name is None or name not in values:
            return math.nan
        value = self.profile.registers[name].to_si(values[name])
        return value if math.isfinite(value) else math.nan

    def wants_motion(self, wanted: Wanted) -> bool:
        """Whether a joint of this drive has to move. Any angle is a target, also 0."""
        for joint in self.joints:
            channel, setpoint = self.channel(joint), wanted.get(joint.index, REST)
            if channel.position_setpoint is not None and setpoint.position_rad is not None:
                return True
            value = of_kind(channel, setpoint)
            if math.isfinite(value) and value != 0.0:
                return True
        return False

    def setpoints(self, wanted: Wanted) -> dict[str, int]:
        """Return register → raw value for the set-points and for the registers written with them. A
        set-point that is missing, NaN or infinite is zero; if another register holds the direction,
        the value is the magnitude."""
        raw = {}
        for joint in self.joints:
            channel = self.channel(joint)
            value = of_kind(channel, wanted.get(joint.index, REST))
            value *= channel.to_motor(joint.gear_ratio) * joint.sign
            if not math.isfinite(value):
                value = 0.0
            if channel.direction is not None:
                value = abs(value)
            register = self.profile.registers[channel.setpoint]
            raw[register.name] = register.from_si(value)
            raw.update(channel.setpoint_with)
        return raw
