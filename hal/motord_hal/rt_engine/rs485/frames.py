# SPDX-License-Identifier: Apache-2.0
"""What a drive's protocol must provide so that its line can run in C."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

from motord_hal.drives.profile import DriveProfile, Step
from motord_hal.fieldbus.ports import JointSpec
from motord_hal.realtime.table import LineFrame


@dataclass(frozen=True, slots=True)
class PlannedFrame:
    """A request, its answer, and where registers stand in them: name → first byte."""

    frame: LineFrame
    writes: Mapping[str, int]
    reads: Mapping[str, int]


class DriveFrames(Protocol):
    """One unit in its own protocol."""

    joints: tuple[JointSpec, ...]
    profile: DriveProfile
    unit: int

    def cyclic(self) -> tuple[PlannedFrame, ...]:
        """The exchanges of each cycle, set-points first; these set-points are zero."""
        ...

    def extra(self) -> tuple[PlannedFrame, ...]:
        """Exchanges that may wait: one at a time, between cycles."""
        ...

    def idle(self) -> tuple[LineFrame, ...]:
        """What goes out in place of the first cyclic exchange while the drive is neither armed nor
        coming to rest; empty: that one, with zeros."""
        ...

    def zero_steps(self) -> tuple[Step, ...]:
        """Writes that set the set-point registers to zero."""
        ...

    def writes(self, raw: Mapping[str, int]) -> tuple[LineFrame, ...]:
        """Frames that write these registers (name → raw)."""
        ...

    def broadcasts(self, raw: Mapping[str, int]) -> tuple[LineFrame, ...]:
        """The same to all units at once; no unit answers. Empty: the protocol has no such thing."""
        ...

    def read(self, name: str) -> LineFrame:
        """The frame that requests a register."""
        ...

    def raw(self, name: str, reply: bytes) -> int:
        """The register's raw value in the answer to `read(name)`."""
        ...

    def cycle_time_s(self) -> float:
        """Wire time of one mean cycle."""
        ...

    def slowest_cycle_s(self) -> float:
        """Wire time of a cycle in which every reply begins at the last moment."""
        ...
