# SPDX-License-Identifier: Apache-2.0
"""Packets of the hoverboard FOC firmware as pure functions, from the board's side, for the
simulator. The line builds its own in csrc/fieldbus/board/board_packets.c.

Source: EFeru/hoverboard-firmware-hack-FOC: `usart_process_command` and `readCommand` in Src/util.c,
the feedback in Src/main.c, `SERIAL_START_FRAME` and `SERIAL_TIMEOUT` in Inc/config.h. Words of 16
bits, low byte first: a start word, values, and the exclusive or of all words before it.

In a drive profile with `protocol = "hoverboard"` a register's address is a byte behind the start
word: access "w" in the command (0 left, 2 right), "r" in the feedback. With `protocol =
"hoverboard-steer"` it is the same, and motord sends steer and speed: left = speed + steer / 2,
right = speed - steer / 2, the firmware's mixer with its default coefficients.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator

from motord_hal.drives.profile import DriveProfile, Register

START_WORD = 0xABCD
COMMAND_BYTES = 8
FEEDBACK_BYTES = 18
SETPOINT_BYTES = 4
VALUE_BYTES = 14
SETPOINT_MAX = 1000
FEEDBACK_S = 0.01
PLAIN, MIXED = "hoverboard", "hoverboard-steer"
PROTOCOLS = (PLAIN, MIXED)

_START = START_WORD.to_bytes(2, "little")
_WORD = "<H"


def _sum(packet: bytes) -> int:
    """Return the exclusive or of the packet's words."""
    total = 0
    for (word,) in struct.iter_unpack(_WORD, packet):
        total ^= word
    return total


def build(values: bytes) -> bytes:
    """Return a packet with these values."""
    body = _START + values
    return body + struct.pack(_WORD, _sum(body))


def parse(packet: bytes) -> bytes | None:
    """Return the values of a packet; None: it is not a packet. The halves of two equal packets have
    a good sum, too, but contain the start word, and no value comes near that."""
    if not packet.startswith(_START) or _sum(packet[:-2]) != int.from_bytes(packet[-2:], "little"):
        return None
    values = packet[2:-2]
    return None if _START in values else values


class Splitter:
    """Splitter of a stream into packets of one length. Bytes that begin no good packet are dropped
    one by one: a packet may begin among them."""

    def __init__(self, size: int) -> None:
        self._size = size
        self._tail = b""
        self._synced = False

    def feed(self, data: bytes) -> Iterator[bytes | None]:
        """Yield the values of each packet; None: bytes were dropped."""
        self._tail += data
        while True:
            begin = self._begin()
            if begin and self._synced:
                self._synced = False
                yield None
            self._tail = self._tail[begin:]
            if len(self._tail) < self._size:
                return
            values = parse(self._tail[: self._size])
            if values is None:
                if self._synced:
                    yield None
                self._synced, self._tail = False, self._tail[1:]
                continue
            self._synced, self._tail = True, self._tail[self._size :]
            yield values

    def _begin(self) -> int:
        """Return where the next packet may begin."""
        found = self._tail.find(_START)
        if found >= 0:
            return found
        return len(self._tail) - self._tail.endswith(_START[:1])


def is_mixed(profile: DriveProfile) -> bool:
    return profile.protocol == MIXED


def size_bytes(register: Register) -> int:
    return register.type.bits // 8


def place(values: bytearray, register: Register, raw: int) -> None:
    size = size_bytes(register)
    word = raw & (1 << 8 * size) - 1
    values[register.address : register.address + size] = word.to_bytes(size, "little")


def pick(values: bytes, register: Register) -> int:
    data = values[register.address : register.address + size_bytes(register)]
    return int.from_bytes(data, "little", signed=register.type.signed)


def _with_access(profile: DriveProfile, access: str) -> list[Register]:
    return [each for each in profile.registers.values() if access in each.access]


def _held(value: int) -> int:
    return min(max(value, -SETPOINT_MAX), SETPOINT_MAX)


def commanded(profile: DriveProfile, values: bytes) -> dict[str, int]:
    """Return register → raw value of each motor, as the firmware understands a command."""
    one, other = map(_held, struct.unpack("<hh", values))
    if is_mixed(profile):
        one, other = _held(int(other + one / 2)), _held(int(other - one / 2))
    motors = struct.pack("<hh", one, other)
    return {each.name: pick(motors, each) for each in _with_access(profile, "w")}


def feedback(profile: DriveProfile, raw: Callable[[str], int]) -> bytes:
    """Return the packet that a board sends. `raw` returns a register's value."""
    values = bytearray(VALUE_BYTES)
    for register in _with_access(profile, "r"):
        low, high = register.raw_range
        place(values, register, min(max(raw(register.name), low), high))
    return build(bytes(values))
