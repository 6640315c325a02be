# SPDX-License-Identifier: Apache-2.0
"""Rules for [battery], by itself and with the profiles of the drives that report it."""

from __future__ import annotations

from collections.abc import Iterator

from motord.config.finding import Finding
from motord.config.sections.battery import READING_UNITS, DrivesBattery
from motord.config.sections.joint.wheels import Profiles
from motord.config.sections.model import Robot
from motord_hal.base.nearest import nearest
from motord_hal.drives.profile import SI_UNITS
from motord_hal.i2c.ina import CHIPS


def battery_alone(robot: Robot) -> Iterator[Finding]:
    """Check thresholds, joints, and what the chip can do."""
    battery, forbids = robot.battery, robot.safety.on_battery_critical == "stop"
    if battery is None:
        if forbids:
            at = (("safety", "on_battery_critical"), ("battery",))
            yield Finding(at, "there is no [battery] that could be critical")
        return
    if battery.critical_v >= battery.low_v:
        text = f"must be below low_v ({battery.low_v:g} V)"
        yield Finding((("battery", "critical_v"), ("battery", "low_v")), text)
    if isinstance(battery, DrivesBattery):
        yield from _joints(robot, battery)
    elif battery.chip_at_pack and CHIPS[battery.source].temperature is None:
        paths = (("battery", "chip_at_pack"), ("battery", "source"))
        yield Finding(paths, f"{battery.source} does not measure its temperature")


def _joints(robot: Robot, battery: DrivesBattery) -> Iterator[Finding]:
    named = [("joints", name) for name in battery.joints]
    named += [(key, where.partition(".")[0]) for key, where in battery.readings.items()]
    for key, name in named:
        if name not in robot.joint:
            yield Finding((("battery", key), ("joint",)), f'there is no joint "{name}"')
    if battery.voltage_from and battery.joints:
        paths = (("battery", "joints"), ("battery", "voltage_from"))
        yield Finding(paths, "the voltage is that of voltage_from")


def battery_readings(robot: Robot, profiles: Profiles) -> Iterator[Finding]:
    """Check that each reading is a register that can be read, of the right unit."""
    battery = robot.battery
    for key, where in battery.readings.items() if isinstance(battery, DrivesBattery) else ():
        joint, _, name = where.partition(".")
        if joint not in robot.joint:
            continue  # another rule reports that
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
