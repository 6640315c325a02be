# SPDX-License-Identifier: Apache-2.0
"""Groups the joints of a line by the drive that they share."""

from __future__ import annotations

from collections.abc import Iterable

from motord_hal.base.errors import ProfileError
from motord_hal.fieldbus.ports import JointSpec, LineSpec


def joints_by_unit(spec: LineSpec) -> Iterable[list[JointSpec]]:
    """Group the joints of a line by unit. Raise ProfileError if joints cannot share their unit, or
    their drive has no such channel."""
    units: dict[int, list[JointSpec]] = {}
    for joint in spec.joints:
        others = units.setdefault(joint.unit, [])
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
