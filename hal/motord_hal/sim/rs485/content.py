# SPDX-License-Identifier: Apache-2.0
"""Registers by name alone, and the content of DDSM frames: there a name is a place in a command's
request or reply (motord_hal.ddsm.codec)."""

from __future__ import annotations

from collections.abc import Callable

from motord_hal.ddsm.codec import byte_of, command_of, pick, place, seal, size_bytes
from motord_hal.drives.profile import DriveProfile, Register

FRAME_CONTENT_BYTES = 8


class NamedContent:
    """What a drive's profile lists, by name. A live one is computed when it is read."""

    def __init__(self, profile: DriveProfile) -> None:
        self._registers = profile.registers
        self._raw: dict[str, int] = {}
        self._live: dict[str, Callable[[], int]] = {}
        self.power_up()

    def power_up(self) -> None:
        """All at their defaults."""
        self._raw = {name: register.default for name, register in self._registers.items()}

    def make_live(self, name: str, value: Callable[[], int]) -> None:
        self._live[name] = value

    def stored(self, name: str) -> int:
        return self._raw[name]

    def put(self, name: str, raw: int) -> None:
        self._raw[name] = raw

    def value(self, name: str) -> int:
        """The raw value as the drive reports it now."""
        live = self._live.get(name)
        return self._raw[name] if live is None else live()


class FrameContent(NamedContent):
    """Of DDSM motors."""

    def write(self, frame: bytes) -> list[tuple[str, int]]:
        """Store what a request sets; what is out of its range is left as it was."""
        written = []
        for name, register in self._registers.items():
            if command_of(register) != frame[1] or "w" not in register.access:
                continue
            raw = pick(frame, register)
            if _in_range(register, raw):
                self.put(name, raw)
                written.append((name, raw))
        return written

    def reply(self, unit: int, command: int) -> bytes | None:
        """What the drive answers to a command; None: it does not know it."""
        sent = [
            register
            for register in self._registers.values()
            if command_of(register) == command and "r" in register.access
        ]
        if not sent:
            return None
        frame = bytearray((unit, command, *bytes(FRAME_CONTENT_BYTES)))
        for register in sent:
            _put(frame, register, self.value(register.name))
        return seal(bytes(frame))


def _in_range(register: Register, raw: int) -> bool:
    value = raw * register.scale
    low, high = register.minimum, register.maximum
    return (low is None or value >= low) and (high is None or value <= high)


def _put(frame: bytearray, register: Register, raw: int) -> None:
    if register.mask is None:
        place(frame, register, raw)
        return
    begin, size = byte_of(register), size_bytes(register)
    word = int.from_bytes(frame[begin : begin + size], "big") & ~register.mask
    word |= raw * (register.mask & -register.mask) & register.mask
    frame[begin : begin + size] = word.to_bytes(size, "big")
