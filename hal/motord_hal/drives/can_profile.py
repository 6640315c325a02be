# SPDX-License-Identifier: Apache-2.0
"""Frames that a drive on a CAN bus sends and receives, and the signals (places) in them, as values.

A signal is a register whose address is a place in a frame. Its raw value is the whole number that
stands there; for a floating-point number it is the IEEE 754 bit pattern.
"""

from __future__ import annotations

import enum
import math
import struct
from dataclasses import dataclass
from typing import Literal

from motord_hal.drives.profile import SI_UNITS, Register, RegisterType

FLOAT_MAX = struct.unpack("<f", b"\xff\xff\x7f\x7f")[0]
"""Greatest finite 32-bit floating-point number (IEEE 754, binary32)."""
STANDARD_ID_MAX, EXTENDED_ID_MAX = 0x7FF, 0x1FFF_FFFF
NODE_MAX = 255
ABORT_FRAME, ABORT_CODE = "sdo_abort", "sdo_abort_code"
"""Frame by which a drive with objects refuses a transfer, and the signal in it with the code."""
SIZES_FD = (*range(9), 12, 16, 20, 24, 32, 48, 64)
"""Data sizes that a frame may have: ISO 11898-1, 8.4.2.4. A classic frame has up to 8 bytes."""


class Sender(enum.StrEnum):
    MOTORD = "motord"
    DRIVE = "drive"


@dataclass(frozen=True, slots=True, kw_only=True)
class Frame:
    """One kind of frame. Its identifier is base + (node << node_shift)."""

    name: str
    base: int
    node_shift: int
    extended: bool
    """Whether the identifier has 29 bits instead of 11."""
    fd: bool
    """Whether it is a CAN FD frame. Its data go at the data bit rate where the CAN bus has one."""
    size_bytes: int
    sender: Sender
    begins: bytes
    """First bytes of the data. In a sent frame the signals are written over them. In a received
    frame they distinguish it from others with the same identifier."""
    ask: str
    """How motord requests the frame: "" not at all, "rtr" by a remote frame, else the name of the
    frame that requests it."""
    period_s: float
    """Period at which the drive sends the frame without a request; 0: never."""
    silence_s: float
    """Time without this frame after which the drive is unresponsive; 0: the frame may be
    missing."""
    source: str
    addressed: bool = True
    """False: the identifier is the same for all nodes (CANopen's NMT and SYNC)."""
    node_byte: int | None = None
    """Position of the data byte that holds the node number; None: no byte does."""
    open_at: frozenset[int] = frozenset()
    """Positions in `begins` that are not compared on reception, because signals stand there. In a
    sent frame these bytes are 0 under the signals."""
    short: bool = False
    """For an extended frame: an identifier that fits 11 bits is sent with 11."""
    or_begins: bytes = b""
    """Another beginning that identifies the frame, as long as `begins`; empty: there is no
    other."""
    answers: str = ""
    """Name of the frame of motord's that the drive always answers with this one; "": no such
    frame."""
    confirm: str = ""
    """Name of the frame with which the drive confirms this one; "": the drive does not confirm
    it."""

    def identifier(self, node: int) -> int:
        return self.base + (node << self.node_shift) if self.addressed else self.base

    def is_extended(self, node: int) -> bool:
        """Whether this node's identifier is sent with 29 bits."""
        return self.extended and not (self.short and self.identifier(node) <= STANDARD_ID_MAX)

    def matches(self, data: bytes) -> bool:
        """Whether received data may belong to this frame."""
        if len(data) < self.size_bytes or not self.open_at:
            sent = data.startswith(self.or_begins) if self.or_begins else False
            return len(data) >= self.size_bytes and (sent or data.startswith(self.begins))
        return all(
            data[at] == byte for at, byte in enumerate(self.begins) if at not in self.open_at
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class Reserved:
    """Identifiers that are a drive's on the CAN bus, though motord neither sends nor reads them:
    all whose bits under `mask` are those of `identifier`."""

    name: str
    base: int
    mask: int
    node_shift: int
    extended: bool
    sender: Sender
    """DRIVE: the drive may send them; MOTORD: it obeys them."""
    addressed: bool
    """False: they are the same for all nodes."""
    source: str

    def identifier(self, node: int) -> int:
        return self.base + (node << self.node_shift) if self.addressed else self.base


@dataclass(frozen=True, slots=True, kw_only=True)
class Signal(Register):
    """A place in a frame that holds one value."""

    frame: str
    start_bit: int
    """Little-endian: counted from the least significant bit of byte 0 upward. Big-endian: counted
    from the most significant bit of byte 0 on."""
    length: int
    """Number of bits."""
    big_endian: bool
    offset: float = 0.0
    """Value of raw 0, in `unit`."""
    reply_frame: str = ""
    """For a signal that is written and read: name of the frame in which it is read."""
    object: str = ""
    """Name of the object with the same value, which can be read even when the frame does not come;
    "": no such object."""

    @property
    def is_float(self) -> bool:
        return self.type is RegisterType.F32

    @property
    def raw_range(self) -> tuple[int, int]:
        """Smallest and largest raw number; a floating-point signal allows all bit patterns."""
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
        """Convert a raw value to SI. NaN and infinity pass: the caller judges what a drive
        reports."""
        number: float = raw
        if self.is_float:
            number = struct.unpack("<f", raw.to_bytes(4, "little"))[0]
        return (number * self.scale + self.offset) * SI_UNITS[self.unit][1]

    def from_si(self, value: float) -> int:
        """Convert as `Register.from_si` does; zero always becomes +0."""
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
        """Write the raw value to its place in the data. Raises ValueError if it does not fit."""
        low, high = self.raw_range
        if not low <= raw <= high:
            raise ValueError(f"{self.name}: {raw} does not fit {self.length} bits")
        mask = (1 << self.length) - 1
        shift, order = self._shift(len(data))
        whole = int.from_bytes(data, order) & ~(mask << shift) | (raw & mask) << shift
        data[:] = whole.to_bytes(len(data), order)

    def extract(self, data: bytes) -> int:
        """Return the raw value that stands in the frame's data."""
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
    """All frames of one drive, and their common properties."""

    frames: dict[str, Frame]
    node_min: int
    node_max: int
    idle_setpoints: bool
    """Whether a drive that is not armed gets set-points of zero. False if a set-point itself
    switches the motor on."""
    hello: str = ""
    """Signal that is read until the drive is set up, if its frames come only after the set-up."""
    sync: str = ""
    """Frame that the line sends once in each cycle to all drives, after their set-points, so that
    they act and measure at one moment."""
    abort: str = ""
    """Frame with which the drive refuses another one."""
    reserved: tuple[Reserved, ...] = ()
    """What the drive sends or obeys beside its frames."""

    def frames_from(self, sender: Sender) -> tuple[Frame, ...]:
        return tuple(frame for frame in self.frames.values() if frame.sender is sender)


def signals_of(registers: dict[str, Register], frame: str) -> tuple[Signal, ...]:
    """Return the signals of a frame, ordered by start bit."""
    signals = [register for register in registers.values() if isinstance(register, Signal)]
    found = [one for one in signals if frame in (one.frame, one.reply_frame)]
    return tuple(sorted(found, key=lambda signal: signal.start_bit))
