# SPDX-License-Identifier: Apache-2.0
"""What must hold between [battery] and the profiles of the drives that it asks."""

from __future__ import annotations

from collections.abc import Iterator

from motord.config.battery_section import READING_UNITS, DrivesBattery
from motord.config.finding import Finding
from motord.config.model import Robot
from motord.config.problems import nearest
from motord.config.wheels import Profiles
from motord_hal.drives.profile import SI_UNITS


def battery_readings(robot: Robot, profiles: Profiles) -> Iterator[Finding]:
    """Each is a register that can be read, of the right unit."""
    battery = robot.battery
    for key, where in battery.readings.items() if isinstance(battery, DrivesBattery) else ():
        joint, _, name = where.partition(".")
        if joint not in robot.joint:
            continue  # that is said by another rule
        drive, unit = robot.joint[joint].drive, READING_UNITS[key]
        registers = profiles[drive].registers
        readable = [each for each, register in registers.items() if "r" in register.access]
        paths = (("battery", key), ("joint", joint, "drive"))
        if name not in readable:
            near = nearest(name, readable)
            hint = f' (did you mean "{joint}.{near}"?)' if near else ""
            yield Finding(paths, f'drive "{drive}" has no register "{name}" to read{hint}')
        elif (found := SI_UNITS[registers[name].unit][0]) != unit:
            yield Finding(paths, f'register "{name}" is in {found or "no unit"}, not in {unit}')
