# SPDX-License-Identifier: Apache-2.0
"""One motor of a drive, between its registers and its wheel."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

from motord_hal.drives.profile import Channel, DriveProfile, FaultBit
from motord_hal.sim.plant import Encoder, Wheel


class Defect(NamedTuple):
    """What is wrong with a motor of a unit."""

    kind: str
    channel: int | None
    """None: all of them."""
    value: float
    """0 where the kind has none."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Axis:
    """How a motor turns its wheel."""

    wheel: Wheel
    gear_ratio: float = 1.0
    inverted: bool = False
    full_duty_rad_s: float = 15.0
    """Wheel speed at full duty, of drives whose set-point is a duty."""
    counts_per_turn: int = 0
    """Of this motor; 0: the profile's."""

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
    """A channel at run time."""

    channel: Channel
    axis: Axis
    encoder: Encoder | None
    counter_start: int = 0
    absolute: bool = False
    """Its counter means the same after each power-up."""
    faults: list[FaultBit] = field(default_factory=list)
    switched_on: bool = False
    braking: bool = False
    sent_raw: int | None = 0
    """The set-point in force, if one counts only with a register beside it; None: no position since
    it got its power."""
    defects: Mapping[str, float] = field(default_factory=dict)
    """Its present defects: `FaultScript.defects`."""
    _frozen: int = 0
    _turned_at_rad: float = 0.0
    _forward: bool = False

    @property
    def stopped_by_fault(self) -> bool:
        return any(fault.severity == "fault" for fault in self.faults)

    @property
    def count(self) -> int | None:
        """The position counter as it is now; None: it has none."""
        if self.encoder is None:
            return None
        if "frozen-counter" in self.defects or "unplugged-encoder" in self.defects:
            return self._frozen
        return self.encoder.count(self._shaft_rad)

    @property
    def shown_rad_s(self) -> float:
        """The velocity that it reports."""
        if "false-velocity" in self.defects:
            self._forward = not self._forward
            return self.defects["false-velocity"] * (1.0 if self._forward else -1.0)
        if "unplugged-encoder" in self.defects:
            return 0.0
        return self.axis.shaft_rad_s * (-1.0 if "turned-encoder" in self.defects else 1.0)

    @property
    def _shaft_rad(self) -> float:
        """As its encoder sees it."""
        shaft_rad = self.axis.shaft_rad
        if "turned-encoder" in self.defects:
            return 2.0 * self._turned_at_rad - shaft_rad
        return shaft_rad

    def suffer(self, defects: Mapping[str, float]) -> None:
        """From now on it has these defects and no others."""
        self._frozen = self.count or 0
        if "turned-encoder" not in self.defects:
            self._turned_at_rad = self.axis.shaft_rad
        self.axis.wheel.blocked = "blocked" in defects
        self.defects = defects

    def restart_counter(self) -> None:
        if self.encoder is not None and not self.absolute:
            self.encoder.restart(self.axis.shaft_rad, self.counter_start)

    def start_at(self, count: int) -> None:
        """Let the counter start there, now and at each power-up."""
        if self.encoder is not None:
            self.counter_start = count & self.encoder.mask
            self.restart_counter()

    def start_near_wrap(self, profile: DriveProfile) -> None:
        """Let the counter start where a quarter turn forward wraps it."""
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
        # an absolute one shows the middle of its turn where its joint is at rest
        middle = counts_per_turn // 2 if profile.absolute else 0
        encoder = Encoder(counts_per_turn, profile.counter_bits, middle)
    return Motor(profile.channels[number], axis, encoder, absolute=profile.absolute)
