# SPDX-License-Identifier: Apache-2.0
"""Limit for the motion that waits in the kernel's queue of a CAN bus that may be dead.

While a cable is pulled, the kernel's queue fills. It goes out when the cable is plugged in again,
whether motord runs or not. So little motion may wait there, with zero behind it."""

from __future__ import annotations

LEAVES_WITHIN_S = 0.005
"""Least time to wait: adapters on USB take milliseconds to report that a frame has left."""


class MotionGate:
    """The gate of one CAN bus. Times are those of `clock.now_s`."""

    def __init__(self, cycle_s: float, *, receives_own: bool) -> None:
        """Set the gate up. `receives_own`: the CAN bus reports when a set-point frame of motord's
        has left; otherwise the gate is always open."""
        self.receives_own = receives_own
        self._limit_s = max(cycle_s, LEAVES_WITHIN_S)
        self.opened()

    def opened(self) -> None:
        """Begin with a newly opened CAN bus, in which nothing waits."""
        self._since_s: float | None = None
        self._taken = self._refused = self._clogged = False

    def handed(self, *, taken: bool) -> None:
        """Note that a frame was handed to the CAN bus, and whether the bus took it."""
        self._taken |= taken
        self._refused |= not taken
        self._clogged &= not taken

    def cycle_ended(self, now_s: float, *, moving: bool) -> None:
        """End a cycle. `moving`: set-points that are not zero were handed over."""
        self._clogged |= self._refused and not self._taken
        self._taken = self._refused = False
        if moving and self._since_s is None:
            self._since_s = now_s

    def left(self) -> None:
        """Note that a set-point frame has left."""
        self._since_s = None

    @property
    def holds_motion(self) -> bool:
        """Whether motion was handed over and none of it is known to have left."""
        return self.receives_own and self._since_s is not None

    def is_shut(self, now_s: float) -> bool:
        """Whether only zero may go out: the CAN bus has taken nothing for a whole cycle, or motion
        waits for longer than a cycle."""
        waits = self._since_s is not None and now_s - self._since_s > self._limit_s
        return self.receives_own and (self._clogged or waits)
