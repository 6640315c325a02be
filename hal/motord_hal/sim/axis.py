# SPDX-License-Identifier: Apache-2.0
"""One motor of a simulated drive, between its registers and its wheel."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

from motord_hal.drives.profile import Channel, DriveProfile, FaultBit
from motord_hal.sim.plant import Encoder, Wheel


class Defect(NamedTuple):
    """A defect of a unit's motor."""

    kind: str
    channel: int | None
    """Number of the channel; None: all channels."""
    value: float
    """Parameter of the defect; 0 if the kind has none."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Axis:
    """Mechanical connection of a motor to its wheel."""

    wheel: Wheel
    gear_ratio: float = 1.0
    inverted: bool = False
    full_duty_rad_s: float = 15.0
    """Wheel speed at full duty, for drives whose set-point is a duty."""
    counts_per_turn: int = 0
    """Counts for one turn of this motor; 0: the profile's value."""

    @property
    def sign(self) -> float:
        return -1.0 if self.inverted else 1.0

    @property
    def motor_per_wheel(self) -> float:
        return self.sign * self.gear_ratio

    @property
    def shaft_rad(self) -> float:
        return self.wheel.position_rad * self.motor_per_wheel

    @property
    def shaft_rad_s(self) -> float:
        return self.wheel.velocity_rad_s * self.motor_per_wheel


@dataclass(slots=True)
class Motor:
    """A motor channel at run time."""

    channel: Channel
    axis: Axis
    encoder: Encoder | None
    counter_start: int = 0
    absolute: bool = False
    """Whether the counter means the same after each power-up."""
    faults: list[FaultBit] = field(default_factory=list)
    switched_on: bool = False
    braking: bool = False
    sent_raw: int | None = 0
    """Set-point in force, if one counts only with another register; None: no position since the
    motor got its power."""
    defects: Mapping[str, float] = field(default_factory=dict)
    """Present defects: kind → value. See `FaultScript.defects`."""
    _frozen: int = 0
    _turned_at_rad: float = 0.0
    _forward: bool = False

    @property
    def stopped_by_fault(self) -> bool:
        return any(fault.severity == "fault" for fault in self.faults)

    @property
    def count(self) -> int | None:
        """Present value of the position counter; None: there is no counter."""
        if self.encoder is None:
            return None
        if "frozen-counter" in self.defects or "unplugged-encoder" in self.defects:
            return self._frozen
        return self.encoder.count(self._shaft_rad)

    @property
    def shown_rad_s(self) -> float:
        """Velocity that the motor reports."""
        if "false-velocity" in self.defects:
            self._forward = not self._forward
            return self.defects["false-velocity"] * (1.0 if self._forward else -1.0)
        if "unplugged-encoder" in self.defects:
            return 0.0
        return self.axis.shaft_rad_s * (-1.0 if "turned-encoder" in self.defects else 1.0)

    @property
    def _shaft_rad(self) -> float:
        """Shaft angle as the encoder measures it."""
        shaft_rad = self.axis.shaft_rad
        if "turned-encoder" in self.defects:
            return 2.0 * self._turned_at_rad - shaft_rad
        return shaft_rad

    def suffer(self, defects: Mapping[str, float]) -> None:
        """Replace the present defects with these."""
        self._frozen = self.count or 0
        if "turned-encoder" not in self.defects:
            self._turned_at_rad = self.axis.shaft_rad
        self.axis.wheel.blocked = "blocked" in defects
        self.defects = defects

    def restart_counter(self) -> None:
        if self.encoder is not None and not self.absolute:
            self.encoder.restart(self.axis.shaft_rad, self.counter_start)

    def start_at(self, count: int) -> None:
        """Start the counter at `count`, now and at each power-up."""
        if self.encoder is not None:
            self.counter_start = count & self.encoder.mask
            self.restart_counter()

    def start_near_wrap(self, profile: DriveProfile) -> None:
        """Start the counter so that a quarter turn forward wraps it."""
        if self.encoder is None:
            return
        register = profile.registers[self.channel.position or ""]
        bits = profile.counter_bits
        low, high = register.raw_range
        signed = register.type.signed and high - low == (1 << bits) - 1
        edge = 1 << (bits - 1) if signed else 1 << bits
        quarter = (self.axis.counts_per_turn or profile.counts_per_turn) // 4
        self.start_at(edge + quarter if self.axis.inverted else edge - quarter)


def new_motor(profile: DriveProfile, number: int, axis: Axis) -> Motor:
    encoder = None
    if profile.counter_bits:
        counts_per_turn = axis.counts_per_turn or profile.counts_per_turn
        # an absolute encoder shows the middle of its turn where its joint is at rest
        middle = counts_per_turn // 2 if profile.absolute else 0
        encoder = Encoder(counts_per_turn, profile.counter_bits, middle)
    return Motor(profile.channels[number], axis, encoder, absolute=profile.absolute)
