# SPDX-License-Identifier: Apache-2.0
"""What a stream line asks of a protocol: set-points into bytes, bytes into feedback."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Protocol

from motord_hal.mcu.frames import BoardImu


@dataclass(frozen=True, slots=True)
class BoardFeedback:
    """One good feedback of the board."""

    values: dict[str, int]
    """Register → raw."""
    stamp_ns: int
    """When it was true, CLOCK_MONOTONIC."""
    received_ns: int
    """When the newest set-points that the board had received by then were sent; where the protocol
    cannot say, when the feedback came."""
    round_trip_s: float | None
    """From sending those set-points to this feedback, without the time that the board held it."""
    imu: BoardImu | None = None
    """None: nothing of an inertial sensor is in this feedback."""


class Dialect(Protocol):
    """One protocol over one port. `reset` is called for each new connection."""

    answers: bool
    """Whether feedback comes at all."""
    bad: int
    """Pieces that were no feedback, since start."""

    def reset(self) -> None: ...

    def setpoints(self, raw: Mapping[str, int], now_ns: int) -> bytes:
        """What to send: every register that is written, set-points among them."""
        ...

    def feed(self, data: bytes, now_ns: int) -> Iterator[BoardFeedback]:
        """The feedback that these bytes complete."""
        ...

    def wire_bytes(self) -> int:
        """Of the longer of the two directions, for a set-point and a feedback."""
        ...
