# SPDX-License-Identifier: Apache-2.0
"""What a drive sends and receives on a CAN bus, as values: frames, and signals as places in them.

A signal is a register whose address is its frame. Its raw value is the whole number that stands in
the frame; of a floating-point number that is its IEEE 754 pattern.
"""

from __future__ import annotations

import enum
import math
import struct
from dataclasses import dataclass
from typing import Literal

from motord_hal.drives.profile import SI_UNITS, Register, RegisterType

FLOAT_MAX = struct.unpack("<f", b"\xff\xff\x7f\x7f")[0]
"""The greatest finite number of 32 bits (IEEE 754, binary32)."""
STANDARD_ID_MAX, EXTENDED_ID_MAX = 0x7FF, 0x1FFF_FFFF
NODE_MAX = 255
ABORT_FRAME, ABORT_CODE = "sdo_abort", "sdo_abort_code"
"""Of a drive with objects: the frame by which it refuses a transfer, and the signal in it."""
SIZES_FD = (*range(9), 12, 16, 20, 24, 32, 48, 64)
"""Bytes that a frame may carry: ISO 11898-1, 8.4.2.4 (a classic frame: up to 8)."""


class Sender(enum.StrEnum):
    MOTORD = "motord"
    DRIVE = "drive"


@dataclass(frozen=True, slots=True, kw_only=True)
class Frame:
    """One kind of frame. Its identifier is base + node << node_shift."""

    name: str
    base: int
    node_shift: int
    extended: bool
    """29 bits of identifier, not 11."""
    fd: bool
    """A frame of CAN FD, its data at the data bit rate where the CAN bus has one."""
    size_bytes: int
    sender: Sender
    begins: bytes
    """What its data begin with: of a frame that is sent, under the signals; of one that comes, what
    distinguishes it from others with the same identifier."""
    ask: str
    """How motord requests it: "" not at all, "rtr" by a remote frame, else the name of the frame
    that requests it."""
    period_s: float
    """How often the drive sends it by itself; 0: never."""
    silence_s: float
    """After so long without this frame the drive is unresponsive; 0: the frame may be missing."""
    source: str
    addressed: bool = True
    """False: the identifier is the same for all nodes (CANopen's NMT and SYNC)."""
    node_byte: int | None = None
    """The byte of the data that holds the node; None: no byte does."""
    open_at: frozenset[int] = frozenset()
    """Bytes of `begins` that may be anything when it comes: signals stand there. Where it is sent
    they are 0 under the signals."""
    short: bool = False
    """Of an extended one: an identifier that fits 11 bits is sent with 11."""
    or_begins: bytes = b""
    """As long as `begins`: another beginning that identifies it; empty: there is no other."""
    answers: str = ""
    """The frame of motord's that it always answers; "": none."""
    confirm: str = ""
    """The frame with which the drive confirms this one; "": it does not confirm it."""

    def identifier(self, node: int) -> int:
        return self.base + (node << self.node_shift) if self.addressed else self.base

    def is_extended(self, node: int) -> bool:
        """Whether this node's identifier goes with 29 bits."""
        return self.extended and not (self.short and self.identifier(node) <= STANDARD_ID_MAX)

    def matches(self, data: bytes) -> bool:
        """Whether data that came may be this frame's."""
        if len(data) < self.size_bytes or not self.open_at:
            sent = data.startswith(self.or_begins) if self.or_begins else False
            return len(data) >= self.size_bytes and (sent or data.startswith(self.begins))
        return all(
            data[at] == byte for at, byte in enumerate(self.begins) if at not in self.open_at
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class Signal(Register):
    """A place in a frame."""

    frame: str
    start_bit: int
    """Little-endian: from the least significant bit of byte 0 upward. Big-endian: from the most
    significant bit of byte 0 on."""
    length: int
    """Bits."""
    big_endian: bool
    offset: float = 0.0
    """In `unit`: the value of raw 0."""
    reply_frame: str = ""
    """Of a signal that is written and read: the frame in which it is read."""
    object: str = ""
    """The object with the same value, which can be read also when its frame does not come; "":
    there is none."""

    @property
    def is_float(self) -> bool:
        return self.type is RegisterType.F32

    @property
    def raw_range(self) -> tuple[int, int]:
        """Smallest and largest whole number; of a floating-point number all patterns."""
        if self.type.signed and not self.is_float:
            return -(1 << self.length - 1), (1 << self.length - 1) - 1
        return 0, (1 << self.length) - 1

    @property
    def si_limits(self) -> tuple[float, float]:
        per_unit = SI_UNITS[self.unit][1]
        if self.is_float:
            ends = sorted((-FLOAT_MAX * self.scale, FLOAT_MAX * self.scale))
        else:
            ends = sorted(raw * self.scale + self.offset for raw in self.raw_range)
        low = ends[0] if self.minimum is None else max(ends[0], self.minimum)
        high = ends[1] if self.maximum is None else min(ends[1], self.maximum)
        return low * per_unit, high * per_unit

    def to_si(self, raw: int) -> float:
        """NaN and infinity pass: the caller judges what a drive reports."""
        number: float = raw
        if self.is_float:
            number = struct.unpack("<f", raw.to_bytes(4, "little"))[0]
        return (number * self.scale + self.offset) * SI_UNITS[self.unit][1]

    def from_si(self, value: float) -> int:
        """As Register.from_si; zero is always +0."""
        if not math.isfinite(value):
            raise ValueError(f"{self.name}: {value} cannot be written")
        low, high = self.si_limits
        number = (min(max(value, low), high) / SI_UNITS[self.unit][1] - self.offset) / self.scale
        if not self.is_float:
            least, most = self.raw_range
            return min(max(round(number), least), most)
        number = min(max(number, -FLOAT_MAX), FLOAT_MAX) + 0.0  # -0.0 + 0.0 is +0.0
        return int.from_bytes(struct.pack("<f", number), "little")

    def insert(self, data: bytearray, raw: int) -> None:
        """Write the raw value to its place. ValueError: it does not fit."""
        low, high = self.raw_range
        if not low <= raw <= high:
            raise ValueError(f"{self.name}: {raw} does not fit {self.length} bits")
        mask = (1 << self.length) - 1
        shift, order = self._shift(len(data))
        whole = int.from_bytes(data, order) & ~(mask << shift) | (raw & mask) << shift
        data[:] = whole.to_bytes(len(data), order)

    def extract(self, data: bytes) -> int:
        """The raw value as it stands in the frame."""
        shift, order = self._shift(len(data))
        raw = int.from_bytes(data, order) >> shift & (1 << self.length) - 1
        negative = self.type.signed and not self.is_float and raw >> (self.length - 1)
        return raw - (1 << self.length) if negative else raw

    def _shift(self, size_bytes: int) -> tuple[int, Literal["little", "big"]]:
        if self.big_endian:
            return 8 * size_bytes - self.start_bit - self.length, "big"
        return self.start_bit, "little"


@dataclass(frozen=True, slots=True, kw_only=True)
class CanTable:
    """The frames of one drive, by name."""

    frames: dict[str, Frame]
    node_min: int
    node_max: int
    idle_setpoints: bool
    """Whether a drive that is not armed gets zero set-points; not if a set-point itself switches
    the motor on."""
    hello: str = ""
    """The signal that is read until the drive is set up, if its frames come only after that."""
    sync: str = ""
    """The frame that the line sends once in each of its cycles, for all drives at once, after their
    set-points: so they act and measure at one moment."""
    abort: str = ""
    """The frame with which the drive refuses another one."""

    def frames_from(self, sender: Sender) -> tuple[Frame, ...]:
        return tuple(frame for frame in self.frames.values() if frame.sender is sender)


def signals_of(registers: dict[str, Register], frame: str) -> tuple[Signal, ...]:
    """The signals of a frame, in the order of their places."""
    signals = [register for register in registers.values() if isinstance(register, Signal)]
    found = [one for one in signals if frame in (one.frame, one.reply_frame)]
    return tuple(sorted(found, key=lambda signal: signal.start_bit))
