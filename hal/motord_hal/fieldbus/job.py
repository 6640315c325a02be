# SPDX-License-Identifier: Apache-2.0
"""A job is a sequence of steps for a drive. It is done in acyclic slots, one exchange a slot."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

from motord_hal.base.errors import HalError
from motord_hal.drives.profile import DriveProfile, Step

if TYPE_CHECKING:
    import asyncio

_ALL_BITS = 0xFFFFFFFF
VERIFY_WITHIN_S = 0.5
"""Longest time until a written value reads back."""


class Job:
    """A job: its steps, the current step, and the future of the caller that waits for the end."""

    def __init__(self, name: str, steps: Sequence[Step], *, urgent: bool = False) -> None:
        from asyncio import get_running_loop  # reading a robot file needs no asyncio

        self.name = name
        self.steps = tuple(steps)
        self.urgent = urgent
        self.failures = 0
        self.done: asyncio.Future[None] = get_running_loop().create_future()
        self.raw = 0
        """The raw value that the newest wait has read."""
        self.wait_until_s: float | None = None
        """Deadline of the current wait; None: the wait has not begun."""
        self.refused: HalError | None = None
        """The drive's refusal of a step after which the other steps were still done; None: no
        step was refused."""
        self._index = 0

    @property
    def step(self) -> Step | None:
        """The current step; None when all are done."""
        return self.steps[self._index] if self._index < len(self.steps) else None

    @property
    def steps_ahead(self) -> tuple[Step, ...]:
        """The steps from the current one on."""
        return self.steps[self._index :]

    def advance(self) -> None:
        self._index += 1
        self.failures = 0
        self.wait_until_s = None

    def finish(self) -> None:
        if self.refused is not None:
            self.fail(self.refused)
        elif not self.done.done():
            self.done.set_result(None)

    def fail(self, error: HalError) -> None:
        if not self.done.done():
            self.done.set_exception(error)
            self.done.exception()  # its caller may have given up

    def limit_s(self, slot_s: float, tries: int) -> float:
        """Return the longest time that the job may take if there is a slot every `slot_s`."""
        return sum(step.within_s + slot_s * (tries + 1) for step in self.steps) + slot_s


def watchdog_time_s(profile: DriveProfile, wanted_s: float) -> float:
    """Return the time without requests after which the drive stops by itself: `wanted_s`, within
    the limits of the drive; infinity if it has no watchdog."""
    watchdog = profile.watchdog
    if watchdog is None:
        return math.inf
    return min(max(wanted_s, watchdog.minimum_s), watchdog.maximum_s)


def configure_steps(profile: DriveProfile, watchdog_s: float) -> tuple[Step, ...]:
    """Return the set-up steps: those of the profile, then the watchdog. Values that stay in force
    (levels) are read back if the drive can report them."""
    watchdog = profile.watchdog
    steps = (*profile.configure, *(read_back(step) for step in _unverified(profile)))
    if watchdog is None:
        return steps
    raw = profile.registers[watchdog.register].from_si(watchdog_time_s(profile, watchdog_s))
    write = Step(register=watchdog.register, value=raw)
    readable = "r" in profile.registers[watchdog.register].access
    return (*steps, write, read_back(write)) if readable else (*steps, write)


def read_back(write: Step) -> Step:
    """Return the step that waits until the register reads as it was written."""
    assert write.value is not None  # a write
    return Step(register=write.register, equals=write.value & _ALL_BITS, within_s=VERIFY_WITHIN_S)


def _unverified(profile: DriveProfile) -> tuple[Step, ...]:
    """Return the last write of each level that the profile's own steps do not wait for. Set-points
    and registers that other sequences write, too, are no levels: later writes change them."""
    others = (profile.arm, profile.disarm, profile.quick_stop, profile.clear_fault)
    commands = {step.register for steps in others for step in steps if step.value is not None}
    for channel in profile.channels.values():
        commands |= channel.commands
    waited = {step.register for step in profile.configure if step.value is None}
    last = {step.register: step for step in profile.configure if step.value is not None}
    return tuple(
        step
        for name, step in last.items()
        if step.verify and name not in commands | waited and "r" in profile.registers[name].access
    )


def kept_steps(steps: Sequence[Step]) -> tuple[Step, ...]:
    """Return the waits for values that the same steps have written. They stay true until the drive
    loses its set-up, for example by a power cut too short to be noticed."""
    written = {(step.register, step.value & _ALL_BITS) for step in steps if step.value is not None}
    return tuple(step for step in steps if (step.register, step.equals) in written)


def kept_registers(profile: DriveProfile) -> tuple[str, ...]:
    """Return the registers that the `kept_steps` of the drive's set-up read."""
    return tuple(step.register for step in kept_steps(configure_steps(profile, 0.0)))


def clear_steps(profile: DriveProfile) -> tuple[Step, ...]:
    """Return the fault-clearing steps: those of the profile, then a check that the faults are gone
    (warnings may stay)."""
    warnings = sum(
        1 << fault.bit
        for fault in profile.faults
        if fault.severity == "warning" and fault.bit is not None
    )
    verify = tuple(
        Step(
            register=channel.fault,
            mask=0xFFFFFFFF & ~warnings,
            equals=0,
            within_s=VERIFY_WITHIN_S,
        )
        for channel in profile.channels.values()
        if channel.fault
    )
    return (*profile.clear_fault, *verify)
