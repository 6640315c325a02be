# SPDX-License-Identifier: Apache-2.0
"""Registers of a drive that a user may read and write, and the values allowed for them. Pure."""

from __future__ import annotations

import math

from motord_hal.drives.profile import SI_UNITS, DriveProfile, Register, Step
from motord_hal.fieldbus.job import read_back


def readable(profile: DriveProfile, name: str) -> Register:
    """Return a register by its name. Raise LookupError if it does not exist or cannot be read."""
    register = profile.registers.get(name)
    if register is None:
        raise LookupError(f'{profile.name} has no register "{name}"')
    if "r" not in register.access:
        raise LookupError(f"{profile.name}: {name} can only be written")
    return register


def kept_back(profile: DriveProfile) -> frozenset[str]:
    """Return the registers that motord itself writes, for set-points, directions, steps and the
    watchdog. A user must not write them."""
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
    """Convert a value in SI to the raw value to write. LookupError: the register does not exist or
    cannot be read; ValueError: it must not be written, or not with this value."""
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
    """Return the steps that write a value in SI and read it back. Errors as in `raw_to_write`."""
    write = Step(register=name, value=raw_to_write(profile, name, value))
    return write, read_back(write)
