# SPDX-License-Identifier: Apache-2.0
"""The interface that each protocol of drives implements, so that a line with it can run in C."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

from motord_hal.drives.profile import DriveProfile, Step
from motord_hal.fieldbus.ports import JointSpec
from motord_hal.realtime.table import LineFrame


@dataclass(frozen=True, slots=True)
class PlannedFrame:
    """A request and the form of its answer. `writes`: register in the request → first byte;
    `reads`: register in the answer → first byte."""

    frame: LineFrame
    writes: Mapping[str, int]
    reads: Mapping[str, int]


class DriveFrames(Protocol):
    """The frames of one unit in its own protocol."""

    joints: tuple[JointSpec, ...]
    profile: DriveProfile
    unit: int

    def cyclic(self) -> tuple[PlannedFrame, ...]:
        """Return the exchanges of each cycle, set-points first. In these frames they are zero."""
        ...

    def extra(self) -> tuple[PlannedFrame, ...]:
        """Return the exchanges that may wait. The line makes one at a time, between cycles."""
        ...

    def idle(self) -> tuple[LineFrame, ...]:
        """Return the frame that replaces the first cyclic exchange while the drive is neither armed
        nor coming to rest; empty: that exchange is sent with zeros."""
        ...

    def zero_steps(self) -> tuple[Step, ...]:
        """Return the writes that set the set-point registers to zero, or, for positions, to the
        present position."""
        ...

    def writes(self, raw: Mapping[str, int]) -> tuple[LineFrame, ...]:
        """Return the frames that write these registers (name → raw)."""
        ...

    def broadcasts(self, raw: Mapping[str, int]) -> tuple[LineFrame, ...]:
        """Return the frames that write these registers on all units at once, which no unit answers;
        empty: the protocol has no broadcast."""
        ...

    def read(self, name: str) -> LineFrame:
        """Return the frame that requests a register."""
        ...

    def raw(self, name: str, reply: bytes) -> int:
        """Return the register's raw value in the answer to `read(name)`."""
        ...

    def cycle_time_s(self, late_part: float = 0.0) -> float:
        """Return the time of a mean cycle on the wire. `late_part`: when the drive answers, as a
        part of its longest turn-around; 0: at once."""
        ...

    def slowest_cycle_s(self) -> float:
        """Return the wire time of a cycle in which every reply begins at the last moment."""
        ...
