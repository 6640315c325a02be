# SPDX-License-Identifier: Apache-2.0
"""What drive profiles say of numbers, for the tables of every medium: pure."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from motord_hal.drives.profile import Channel, DriveProfile
from motord_hal.fieldbus.ports import JointSpec
from motord_hal.realtime.table import FieldKind, SetpointKind


def sources_of(profile: DriveProfile, channel: Channel) -> Iterator[tuple[FieldKind, str]]:
    """What is known of a channel's joint, and the register that says it."""
    sources = {
        FieldKind.COUNT: channel.position,
        FieldKind.VELOCITY: channel.velocity,
        FieldKind.CURRENT: channel.current,
        FieldKind.VOLTAGE: profile.bus_voltage,
        FieldKind.TEMPERATURE: channel.temperature,
        FieldKind.FAULT: channel.fault,
    }
    return ((kind, name) for kind, name in sources.items() if name is not None)


def setpoint_kind(channel: Channel) -> SetpointKind:
    """What is reported of its joint."""
    if channel.torque_setpoint is not None:
        return SetpointKind.TORQUE
    return SetpointKind.VELOCITY if channel.velocity_setpoint else SetpointKind.DUTY


def setpoint_scale(
    joint: JointSpec, channel: Channel, si_per_raw: float, limits: tuple[float, float]
) -> dict[str, Any]:
    """setpoint_scale of csrc/api_line.h."""
    sign = -1.0 if joint.inverted else 1.0
    return {
        "joint": joint.index,
        "kind": int(setpoint_kind(channel)),
        "raw_per_si": sign * channel.to_motor(joint.gear_ratio) / si_per_raw,
        "raw_min": limits[0],
        "raw_max": limits[1],
    }


def harmless(profile: DriveProfile) -> tuple[int, tuple[int, ...] | None]:
    """Warnings: as bits, or as codes on drives that number their faults."""
    warnings = [fault for fault in profile.faults if fault.severity == "warning"]
    if any(fault.code is not None for fault in profile.faults):
        return 0, tuple(fault.code for fault in warnings if fault.code is not None)
    return sum(1 << fault.bit for fault in warnings if fault.bit is not None), None


def harmless_words(profile: DriveProfile) -> dict[str, Any]:
    """The same for field_meaning of csrc/api_line.h."""
    bits, codes = harmless(profile)
    listed = codes or ()
    return {
        "harmless_bits": bits,
        "is_code": int(codes is not None),
        "harmless_codes": len(listed),
        "harmless": list(listed),
    }
