# SPDX-License-Identifier: Apache-2.0
"""The signals of a simulated drive on a CAN bus, by name, and the frames that contain them."""

from __future__ import annotations

from motord_hal.can.codec import build, parse
from motord_hal.drives.can_profile import CanTable, Frame, Sender, Signal, signals_of
from motord_hal.drives.profile import DriveProfile
from motord_hal.sim.rs485.content import NamedContent


class CanContent(NamedContent):
    """The signals of a drive's profile, and its frames."""

    def __init__(self, profile: DriveProfile, table: CanTable) -> None:
        super().__init__(profile)
        self.table = table
        self._signals: dict[str, Signal] = {
            name: signal for name, signal in profile.registers.items() if isinstance(signal, Signal)
        }
        self._in = {name: signals_of(profile.registers, name) for name in table.frames}

    def written(self, frame: Frame, data: bytes) -> list[tuple[str, int]] | None:
        """Store a frame's signals and return them in the order of their places. A value that is out
        of range, or not a number, is left out. None: the data are another frame's."""
        values = parse(frame, self._in[frame.name], data)
        if values is None:
            return None
        taken = [(name, raw) for name, raw in values.items() if self._in_range(name, raw)]
        self._raw.update(taken)
        return taken

    def _in_range(self, name: str, raw: int) -> bool:
        signal = self._signals[name]
        low, high = signal.si_limits
        return low <= signal.to_si(raw) <= high  # false for NaN

    def sent(self, frame: Frame) -> bytes:
        """Return the frame with the drive's present values."""
        now = {
            signal.name: self._live[signal.name]()
            if signal.name in self._live
            else self._raw[signal.name]
            for signal in self._in[frame.name]
        }
        return build(frame, self._in[frame.name], now)

    def answers(self, asking: Frame) -> tuple[Frame, ...]:
        """Return the frames that this one requests, or that confirm it."""
        own = self.table.frames_from(Sender.DRIVE)
        return tuple(
            f for f in own if asking.name in (f.ask, f.answers) or asking.confirm == f.name
        )
