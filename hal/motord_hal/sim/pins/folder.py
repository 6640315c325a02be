# SPDX-License-Identifier: Apache-2.0
"""A folder with the files of a PWM chip and of a counter: the part of /sys that a robot on pins
uses.

Source of names and contents: kernel, Documentation/ABI/testing/sysfs-class-pwm and
sysfs-bus-counter. When a plain file is written, it keeps the tail of a longer number, and is empty
for a moment: if the text is not a number, the number read before stays.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

COUNTER_BITS = 16
"""Width of the counters, like those of many timers: a run of some minutes goes across the wrap."""
COUNT_DIGITS = 7
"""Digits of a count. With the newline they are eight bytes, written at once: no reader gets half a
number."""
NUMBER_BYTES = 24
_CHANNEL = {"period": "0", "duty_cycle": "0", "enable": "0", "polarity": "normal"}
_COUNT = {
    "function": "quadrature x4",
    "enable": "1",
    "ceiling": str((1 << COUNTER_BITS) - 1),
    "count": "0".zfill(COUNT_DIGITS),
}


@dataclass(slots=True)
class _Number:
    """A file with a number that another program writes."""

    fd: int
    value: int = 0

    def read(self) -> int:
        text = os.pread(self.fd, NUMBER_BYTES, 0).partition(b"\n")[0]
        if text.isdigit():
            self.value = int(text)
        return self.value


class PinFolder:
    """`pwmN` for each channel and `countN` for each counter. While they are pulled, the pins are
    not connected to the bridges; the files stay, as on a real machine."""

    def __init__(self, folder: Path, channels: Iterable[int], counters: int) -> None:
        self.folder = folder
        self._numbers: dict[int, tuple[_Number, _Number, _Number]] = {}
        self._counts: list[int] = []
        self._sent = [-1] * counters
        self._plugged = False
        self._channels = tuple(channels)

    @property
    def address(self) -> str:
        """Path of the folder: the pwm_chip of a robot file, and the counter of an encoder."""
        return str(self.folder)

    @property
    def plugged(self) -> bool:
        return self._plugged

    def plug(self) -> None:
        """Connect the bridges; make the files the first time. Raises OSError."""
        if not self._numbers:
            for channel in self._channels:
                folder = _made(self.folder / f"pwm{channel}", _CHANNEL)
                period, duty, enable = (
                    _Number(os.open(folder / name, os.O_RDONLY | os.O_CLOEXEC))
                    for name in ("period", "duty_cycle", "enable")
                )
                self._numbers[channel] = period, duty, enable
            for number in range(len(self._sent)):
                folder = _made(self.folder / f"count{number}", _COUNT)
                self._counts.append(os.open(folder / "count", os.O_WRONLY | os.O_CLOEXEC))
        self._plugged = True

    def pull(self) -> None:
        self._plugged = False

    def remove(self) -> None:
        """Remove the files. A program that has one open keeps it."""
        self.pull()
        for numbers in self._numbers.values():
            for number in numbers:
                os.close(number.fd)
        for fd in self._counts:
            os.close(fd)
        self._numbers.clear()
        self._counts.clear()
        shutil.rmtree(self.folder, ignore_errors=True)

    def level(self, channel: int) -> float | None:
        """Return the part of its period for which a channel is high; None: no pulses."""
        period, duty, enable = (number.read() for number in self._numbers[channel])
        return min(duty / period, 1.0) if enable and period else None

    def put_count(self, number: int, count: int) -> None:
        if count != self._sent[number]:
            self._sent[number] = count
            os.pwrite(self._counts[number], b"%0*d\n" % (COUNT_DIGITS, count), 0)

    def filenos(self, now_s: float) -> list[int]:
        """Return no descriptors: nothing reports that a file was written."""
        del now_s
        return []

    def stall(self, until_s: float) -> None:
        """Do nothing: pins do not stall."""

    def forget(self) -> None:
        """Do nothing: pins have no connections."""


def _made(folder: Path, files: dict[str, str]) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    for name, value in files.items():
        (folder / name).write_text(f"{value}\n", encoding="ascii")
    return folder
