# SPDX-License-Identifier: Apache-2.0
"""Interprets a joystick's events: its axes as a twist, and whether its dead-man button is held.

Events and the axes' ranges are those of the kernel (Documentation/input/event-codes.rst).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from motord.config import JoystickInput

EV_SYN, EV_KEY, EV_ABS = 0, 1, 3
SYN_DROPPED = 3
REPEATED = 2
"""include/uapi/linux/input-event-codes.h"""


@dataclass(frozen=True, slots=True)
class Codes:
    """The kernel's numbers of the axes and buttons that are used; None: not used."""

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
        """Whether the dead-man button is held. False after it was released or events were lost, and
        before it was first pressed: no command."""
        self.doubted = False
        """Whether events were lost. The e-stop button's may be among them: read the button from the
        device itself, and set this back."""

    def take(self, kind: int, code: int, value: int) -> bool:
        """Take one event; return whether it is an emergency stop."""
        if kind == EV_KEY and value == REPEATED:
            return False  # it is no new press: after `let_go` the button has to be released
        if kind == EV_KEY and code == self._codes.dead_man:
            self.held = value != 0
        elif kind == EV_ABS and code in self._values:
            self._values[code] = self._part(code, value)
        elif kind == EV_SYN and code == SYN_DROPPED:
            self.let_go()  # events were lost: whether it is held is not known any more
            self.doubted = True
        return kind == EV_KEY and code == self._codes.estop and value != 0

    def let_go(self) -> None:
        """Count the dead-man button as released until it is pressed again, and the axes as
        centred."""
        self.held = False
        self._values = dict.fromkeys(self._values, 0.0)

    def _part(self, axis: int, value: int) -> float:
        """Return the position of an axis, from -1 to 1, and 0 in the dead zone."""
        low, high = self._ranges[axis]
        part = min(max((2.0 * value - low - high) / (high - low), -1.0), 1.0)
        zone = self._section.dead_zone
        if abs(part) <= zone:
            return 0.0
        return (abs(part) - zone) / (1.0 - zone) * (1.0 if part > 0.0 else -1.0)

    def twist(self) -> tuple[float, float, float]:
        """Return linear m/s, rad/s and lateral m/s; zeros without the dead-man button. Values of
        axes grow backwards and to the right, so all signs change."""
        if not self.held:
            return 0.0, 0.0, 0.0
        lateral = 0.0 if self._codes.lateral is None else self._values[self._codes.lateral]
        return (
            -self._section.linear_m_s * self._values[self._codes.linear],
            -self._section.angular_rad_s * self._values[self._codes.angular],
            -self._section.lateral_m_s * lateral,
        )
