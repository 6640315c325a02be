# SPDX-License-Identifier: Apache-2.0
"""Groups the joints of a line by the drive that they share."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from motord_hal.base.errors import ProfileError
from motord_hal.fieldbus.ports import JointSpec, LineSpec

DriveKey = tuple[int, Path | None]
"""What distinguishes a drive from the others of its line."""


def drive_key(joint: JointSpec) -> DriveKey:
    """Return what distinguishes the joint's drive from the others of its line: its unit, and on a
    CAN bus its profile, too. There identifiers count, and two kinds of drives may have the same
    number."""
    return joint.unit, joint.profile.path if joint.profile.can is not None else None


def joints_by_unit(spec: LineSpec) -> Iterable[list[JointSpec]]:
    """Group the joints of a line by drive. Raise ProfileError if joints cannot share their unit, or
    their drive has no such channel."""
    units: dict[DriveKey, list[JointSpec]] = {}
    for joint in spec.joints:
        others = units.setdefault(drive_key(joint), [])
        for other in others:
            if other.profile.name != joint.profile.name:
                raise ProfileError(
                    f"{spec.name}: {other.name} and {joint.name} share unit {joint.unit} "
                    f"but not the drive: {other.profile.name}, {joint.profile.name}"
                )
            if other.channel == joint.channel:
                raise ProfileError(
                    f"{spec.name}: {other.name} and {joint.name} are both channel "
                    f"{joint.channel} of unit {joint.unit}"
                )
        if joint.channel not in joint.profile.channels:
            raise ProfileError(f"{joint.name}: {joint.profile.name} has no channel {joint.channel}")
        others.append(joint)
    return units.values()
