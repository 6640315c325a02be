# SPDX-License-Identifier: Apache-2.0
"""What a joystick's events mean: its axes as a twist, and whether its dead-man button is held.

Events are the kernel's (Documentation/input/event-codes.rst), and so are the axes' ranges.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from motord.config import JoystickInput

EV_SYN, EV_KEY, EV_ABS = 0, 1, 3
SYN_DROPPED = 3
"""include/uapi/linux/input-event-codes.h"""


@dataclass(frozen=True, slots=True)
class Codes:
    """The numbers of what is looked at."""

    dead_man: int
    linear: int
    angular: int
    estop: int | None = None
    lateral: int | None = None


class Stick:
    """The state of one device since it was opened; nothing is held at first."""

    def __init__(
        self, section: JoystickInput, codes: Codes, ranges: Mapping[int, tuple[int, int]]
    ) -> None:
        """`ranges`: least and greatest value of each axis. Raises ValueError if the device lacks
        one."""
        self._section = section
        self._codes = codes
        axes = (codes.linear, codes.angular, codes.lateral)
        self._values = {axis: 0.0 for axis in axes if axis is not None}
        for axis in self._values:
            low, high = ranges.get(axis, (0, 0))
            if low >= high:
                raise ValueError(f"it has no axis {axis}")
        self._ranges = ranges
        self.held = False
        """Released, lost or never pressed: no command."""
        self.doubted = False
        """Events were lost, and the e-stop button's may be among them: look at the device itself,
        and set it back."""

    def take(self, kind: int, code: int, value: int) -> bool:
        """One event. Returns whether it is an emergency stop."""
        if kind == EV_KEY and code == self._codes.dead_man:
            self.held = value != 0
        elif kind == EV_ABS and code in self._values:
            self._values[code] = self._part(code, value)
        elif kind == EV_SYN and code == SYN_DROPPED:
            self.let_go()  # events were lost: whether it is held is not known any more
            self.doubted = True
        return kind == EV_KEY and code == self._codes.estop and value != 0

    def let_go(self) -> None:
        """Until it is pressed again; the axes are taken to be in their middle."""
        self.held = False
        self._values = dict.fromkeys(self._values, 0.0)

    def _part(self, axis: int, value: int) -> float:
        """-1 to 1, and 0 in the dead zone."""
        low, high = self._ranges[axis]
        part = min(max((2.0 * value - low - high) / (high - low), -1.0), 1.0)
        zone = self._section.dead_zone
        if abs(part) <= zone:
            return 0.0
        return (abs(part) - zone) / (1.0 - zone) * (1.0 if part > 0.0 else -1.0)

    def twist(self) -> tuple[float, float, float]:
        """Linear m/s, rad/s and lateral m/s. Axes grow away from forward and from left, so all
        signs turn."""
        if not self.held:
            return 0.0, 0.0, 0.0
        lateral = 0.0 if self._codes.lateral is None else self._values[self._codes.lateral]
        return (
            -self._section.linear_m_s * self._values[self._codes.linear],
            -self._section.angular_rad_s * self._values[self._codes.angular],
            -self._section.lateral_m_s * lateral,
        )
