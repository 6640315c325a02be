# SPDX-License-Identifier: Apache-2.0
"""Numbers from drive profiles for the tables of every medium: kinds, factors and limits. Pure."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from motord_hal.drives.profile import Channel, DriveProfile
from motord_hal.fieldbus.ports import JointSpec
from motord_hal.fieldbus.positions import raw_offset, raw_per_rad, raw_per_s
from motord_hal.realtime.table import FieldKind, SetpointKind


def sources_of(profile: DriveProfile, channel: Channel) -> Iterator[tuple[FieldKind, str]]:
    """Return the kind of each value that a channel can report, and its register."""
    sources = {
        FieldKind.COUNT: channel.position,
        FieldKind.VELOCITY: channel.velocity,
        FieldKind.CURRENT: channel.current,
        FieldKind.VOLTAGE: profile.bus_voltage,
        FieldKind.TEMPERATURE: channel.temperature,
        FieldKind.FAULT: channel.fault,
    }
    return ((kind, name) for kind, name in sources.items() if name is not None)


def wheel_factor(joint: JointSpec, kind: FieldKind) -> float:
    """Return the factor from a value of the motor in SI to that of the joint."""
    if kind is FieldKind.VELOCITY:
        return joint.velocity_factor
    return joint.current_factor if kind is FieldKind.CURRENT else 1.0


def setpoint_kind(channel: Channel) -> SetpointKind:
    """Return the kind of set-point that the channel takes."""
    if channel.torque_setpoint is not None:
        return SetpointKind.TORQUE
    if channel.position_setpoint is not None:
        return SetpointKind.POSITION
    return SetpointKind.VELOCITY if channel.velocity_setpoint else SetpointKind.DUTY


def setpoint_scale(
    joint: JointSpec, channel: Channel, si_per_raw: float, limits: tuple[float, float]
) -> dict[str, Any]:
    """Return the struct setpoint_scale (csrc/api/line/api_line.h) of a joint. `limits`: least and
    greatest raw value."""
    factor = joint.sign * channel.to_motor(joint.gear_ratio) / si_per_raw
    takes_position = channel.position_setpoint is not None
    return {
        "joint": joint.index,
        "kind": int(setpoint_kind(channel)),
        "raw_per_si": raw_per_rad(joint, joint.profile) if takes_position else factor,
        "raw_offset": raw_offset(joint, joint.profile),
        "raw_min": limits[0],
        "raw_max": limits[1],
        "raw_per_s": raw_per_s(joint, joint.profile),
    }


def harmless(profile: DriveProfile) -> tuple[int, tuple[int, ...] | None]:
    """Return the faults that are only warnings: their bits and None, or, if the drive numbers its
    faults, 0 and their codes."""
    warnings = [fault for fault in profile.faults if fault.severity == "warning"]
    if any(fault.code is not None for fault in profile.faults):
        return 0, tuple(fault.code for fault in warnings if fault.code is not None)
    return sum(1 << fault.bit for fault in warnings if fault.bit is not None), None


def harmless_words(profile: DriveProfile) -> dict[str, Any]:
    """Return the faults that are only warnings as the fields of the struct field_meaning
    (csrc/api/line/api_line.h)."""
    bits, codes = harmless(profile)
    listed = codes or ()
    return {
        "harmless_bits": bits,
        "is_code": int(codes is not None),
        "harmless_codes": len(listed),
        "harmless": list(listed),
    }
