# SPDX-License-Identifier: Apache-2.0
"""Which registers of a drive a user may read and write, and with which values: pure."""

from __future__ import annotations

import math

from motord_hal.drives.profile import SI_UNITS, DriveProfile, Register, Step
from motord_hal.fieldbus.job import read_back


def readable(profile: DriveProfile, name: str) -> Register:
    """Raises LookupError for a register that does not exist or cannot be read."""
    register = profile.registers.get(name)
    if register is None:
        raise LookupError(f'{profile.name} has no register "{name}"')
    if "r" not in register.access:
        raise LookupError(f"{profile.name}: {name} can only be written")
    return register


def kept_back(profile: DriveProfile) -> frozenset[str]:
    """Registers that motord itself writes: set-points, directions, steps and the watchdog."""
    names = {profile.watchdog.register} if profile.watchdog else set()
    for channel in profile.channels.values():
        names |= channel.commands
    for steps in (
        profile.configure,
        profile.arm,
        profile.disarm,
        profile.quick_stop,
        profile.clear_fault,
    ):
        names |= {step.register for step in steps if step.value is not None}
    return frozenset(names)


def raw_to_write(profile: DriveProfile, name: str, value: float) -> int:
    """The raw value for a value in SI. LookupError: no such register; ValueError: it must not be
    written, or not with this value."""
    register = readable(profile, name)
    if "w" not in register.access:
        raise ValueError(f"{profile.name}: {name} can only be read")
    if name in kept_back(profile):
        raise ValueError(f"{profile.name}: {name} is written by motord itself")
    low, high = register.si_limits
    if not (math.isfinite(value) and low <= value <= high):
        unit = SI_UNITS[register.unit][0]
        raise ValueError(f"{name}: {value:g} is not within {low:g} to {high:g} {unit}".rstrip())
    return register.from_si(value)


def write_steps(profile: DriveProfile, name: str, value: float) -> tuple[Step, Step]:
    """Write a value in SI, and read it back. Raises as `raw_to_write`."""
    write = Step(register=name, value=raw_to_write(profile, name, value))
    return write, read_back(write)
