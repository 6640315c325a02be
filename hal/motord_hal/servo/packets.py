# SPDX-License-Identifier: Apache-2.0
"""Packets of bus servos as pure functions: Feetech's protocol 0 (STS and SMS series) and ROBOTIS'
Dynamixel protocol 2.0.

A packet is a head, the unit, a length, an instruction (or, in a status, the error), parameters and
a check sum. A servo's registers are bytes by address, low byte first. Feetech's SCS series has the
high byte first (profiles mark it by the register's type) and no sync read. Sources: the makers'
SDKs (`ftservo-python-sdk`, protocol_packet_handler.py; `dynamixel-sdk`,
protocol2_packet_handler.py) and the ROBOTIS e-Manual, DYNAMIXEL Protocol 2.0: instruction packet,
status packet, packet process.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from enum import IntEnum
from types import MappingProxyType
from typing import Literal, Protocol

from motord_hal.drives.profile import DriveProfile, Register

UNIT_MAX = 252
"""Greatest unit number of a bus servo; the least is 0: ROBOTIS e-Manual, DYNAMIXEL Protocol 2.0,
packet ID."""
BROADCAST_UNIT = 0xFE
KINDS = ("feetech", "dynamixel")
"""Kinds of lines, and protocols of drive profiles, that use such packets."""
INSTRUCTION_ADDRESS = 0xFF00
"""First register that is no address in the servo. A write to one sends the instruction in the
register's low byte, without parameters (0xFF08: reboot)."""


class Instruction(IntEnum):
    PING = 0x01
    READ = 0x02
    WRITE = 0x03
    REBOOT = 0x08
    STATUS = 0x55
    """Instruction of a Dynamixel's answer."""
    SYNC_READ = 0x82
    SYNC_WRITE = 0x83
    FAST_SYNC_READ = 0x8A
    """Instruction for Dynamixels: all answer in one packet."""


DYNAMIXEL_ERRORS = MappingProxyType(
    {
        1: "result fail",
        2: "instruction error",
        3: "CRC error",
        4: "data range error",
        5: "data length error",
        6: "data limit error",
        7: "access error",
    }
)
"""Texts by error number: ROBOTIS e-Manual, DYNAMIXEL Protocol 2.0, status packet, error."""


@dataclass(frozen=True, slots=True)
class Packet:
    """A good packet. `code` is the instruction; in a status, the error byte."""

    unit: int
    code: int
    parameters: bytes


class Packets(Protocol):
    """One of the two packet protocols."""

    head_bytes: int
    """Number of bytes before a packet's instruction."""
    status_head_bytes: int
    """Number of bytes before a status' data."""
    seal_bytes: int
    unit_byte: int
    match_bytes: int
    """Number of bytes that identify a status: with its unit, and its length if that is fixed."""

    def build(self, unit: int, code: int, parameters: bytes = b"") -> bytes:
        """Return a request as it is sent."""

    def build_status(self, unit: int, error: int, parameters: bytes = b"") -> bytes:
        """Return the answer of a servo."""

    def number(self, value: int) -> bytes:
        """Return an address, or a count of bytes, as bytes of a packet."""

    def take(self, data: bytes, *, status: bool = False) -> tuple[Packet | None, int]:
        """Return the first packet in the bytes, or None, and the number of used bytes; without a
        packet these are only garbage. Raises PacketError if a whole packet has a wrong check
        sum."""


class PacketError(ValueError):
    """A whole packet with a wrong check sum. `done` is the number of used bytes."""

    def __init__(self, done: int) -> None:
        super().__init__("wrong check sum")
        self.done = done


class FeetechPackets:
    """Packets of FF FF, unit, length, instruction or error, parameters, inverted sum."""

    head_bytes = 4
    status_head_bytes = 5
    seal_bytes = 1
    unit_byte = 2
    match_bytes = 4

    def build(self, unit: int, code: int, parameters: bytes = b"") -> bytes:
        """Implement `Packets.build`."""
        body = bytes((unit, len(parameters) + 2, code)) + parameters
        return b"\xff\xff" + body + bytes((~sum(body) & 0xFF,))

    build_status = build
    """Implements `Packets.build_status`: a status has the same form."""

    def number(self, value: int) -> bytes:
        return bytes((value,))

    def take(self, data: bytes, *, status: bool = False) -> tuple[Packet | None, int]:
        """Implement `Packets.take`."""
        del status
        at = data.find(b"\xff\xff")
        if at < 0:
            return None, len(data) - (data[-1:] == b"\xff")
        if len(data) < at + 4:
            return None, at
        unit, length = data[at + 2], data[at + 3]
        if unit == 0xFF or length < 2:
            return None, at + 1
        end = at + 4 + length
        if len(data) < end:
            return None, at
        body = data[at + 2 : end - 1]
        if ~sum(body) & 0xFF != data[end - 1]:
            raise PacketError(end)
        return Packet(unit, body[2], body[3:]), end


def _crc_table() -> tuple[int, ...]:
    rows = []
    for byte in range(256):
        crc = byte << 8
        for _ in range(8):
            crc = crc << 1 ^ 0x8005 if crc & 0x8000 else crc << 1
        rows.append(crc & 0xFFFF)
    return tuple(rows)


_CRC_TABLE = _crc_table()


def crc16(data: bytes) -> int:
    """Return the CRC with polynomial 0x8005, not reflected, start 0 (ROBOTIS e-Manual, CRC)."""
    crc = 0
    for byte in data:
        crc = (crc << 8 ^ _CRC_TABLE[crc >> 8 ^ byte]) & 0xFFFF
    return crc


class DynamixelPackets:
    """Packets of FF FF FD 00, unit, length, instruction, parameters (in a status the error first),
    CRC. After each FF FF FD in instruction and parameters, one more FD is inserted."""

    head_bytes = 7
    status_head_bytes = 9
    seal_bytes = 2
    unit_byte = 4
    match_bytes = 5

    def build(self, unit: int, code: int, parameters: bytes = b"") -> bytes:
        """Implement `Packets.build`."""
        body = (bytes((code,)) + parameters).replace(_HEAD, _HEAD + b"\xfd")
        length = (len(body) + 2).to_bytes(2, "little")
        packet = _HEAD + b"\0" + bytes((unit,)) + length + body
        return packet + crc16(packet).to_bytes(2, "little")

    def build_status(self, unit: int, error: int, parameters: bytes = b"") -> bytes:
        """Implement `Packets.build_status`."""
        return self.build(unit, Instruction.STATUS, bytes((error,)) + parameters)

    def number(self, value: int) -> bytes:
        return value.to_bytes(2, "little")

    def take(self, data: bytes, *, status: bool = False) -> tuple[Packet | None, int]:
        """Implement `Packets.take`."""
        at = data.find(_HEAD + b"\0")
        if at < 0:
            return None, max(len(data) - 3, 0)
        if len(data) < at + 7:
            return None, at
        length = int.from_bytes(data[at + 5 : at + 7], "little")
        if length < 3 + status:
            return None, at + 1
        end = at + 7 + length
        if len(data) < end:
            return None, at
        if crc16(data[at : end - 2]) != int.from_bytes(data[end - 2 : end], "little"):
            raise PacketError(end)
        body = data[at + 7 : end - 2].replace(_HEAD + b"\xfd", _HEAD)
        if status:
            return (Packet(data[at + 4], body[1], body[2:]) if body[0] == 0x55 else None), end
        return Packet(data[at + 4], body[0], body[1:]), end


_HEAD = b"\xff\xff\xfd"


def build_fast_status(asked: int, answers: Iterable[tuple[int, int, bytes]]) -> list[bytes]:
    """Return the bytes of each servo in the answer to a fast sync read of `asked` servos. `answers`
    are unit, error and data. The first servo sends the head, with the length of all bytes to come.
    Each ends with the CRC of the packet so far. Nothing is stuffed (`dynamixel-sdk`,
    group_sync_read.py)."""
    packet, parts = b"", []
    for unit, error, data in answers:
        begin = len(packet)
        if not packet:
            length = 1 + asked * (len(data) + 4)
            packet = _HEAD + bytes((0, BROADCAST_UNIT, *length.to_bytes(2, "little"), 0x55))
        packet += bytes((error, unit)) + data
        packet += crc16(packet).to_bytes(2, "little")
        parts.append(packet[begin:])
    return parts


def split_fast_status(status: Packet, count: int) -> Iterator[Packet]:
    """Yield the statuses of all servos, each with `count` bytes of data, from one answer to a fast
    sync read."""
    blocks = bytes((status.code,)) + status.parameters
    for at in range(0, len(blocks) - count - 1, count + 4):
        yield Packet(blocks[at + 1], blocks[at], blocks[at + 2 : at + 2 + count])


_PACKETS: Mapping[str, Packets] = MappingProxyType(
    {"feetech": FeetechPackets(), "dynamixel": DynamixelPackets()}
)


def packets_of(kind: str) -> Packets:
    """Return the packets of a line's kind, or of a profile's protocol."""
    return _PACKETS[kind]


def take_all(packets: Packets, data: bytes, *, status: bool = False) -> Iterator[Packet | None]:
    """Yield every packet in the bytes; None: one with a wrong check sum."""
    while data:
        try:
            packet, done = packets.take(data, status=status)
        except PacketError as error:
            packet, done = None, error.done
            yield None
        if done == 0:
            return
        data = data[done:]
        if packet is not None:
            yield packet


def is_whole(packets: Packets, data: bytes) -> bool:
    """Whether the bytes end with the end of a packet."""
    while data:
        try:
            done = packets.take(data)[1]
        except PacketError as error:
            done = error.done
        if done == 0:
            return False
        data = data[done:]
    return True


# ---------------------------------------------------------------------------------------- registers
def size_bytes(register: Register) -> int:
    return register.type.bits // 8


def has_no_sync_read(profile: DriveProfile) -> bool:
    """Whether the servo has no sync read, like Feetech's SCS series, which is recognised by numbers
    with the high byte first (`ftservo-python-sdk`, scscl.py: it reads servos one by one)."""
    return any(register.type.high_first for register in profile.registers.values())


def encode(register: Register, raw: int) -> bytes:
    """Return a raw value as bytes of a packet. Raises ValueError if it does not fit."""
    low, high = register.raw_range
    if not low <= raw <= high:
        raise ValueError(f"{register.name}: {raw} does not fit {register.type.value}")
    size = size_bytes(register)
    if register.type.magnitude and raw < 0:
        raw = -raw | 1 << register.type.sign_bit
    return (raw & (1 << 8 * size) - 1).to_bytes(size, _order(register))


def _order(register: Register) -> Literal["big", "little"]:
    return "big" if register.type.high_first else "little"


def decode(register: Register, data: bytes) -> int:
    """Return the raw value at the beginning of these bytes."""
    size = size_bytes(register)
    value, bits = int.from_bytes(data[:size], _order(register)), 8 * size
    if register.type.magnitude:
        sign = 1 << register.type.sign_bit
        value = -(value & ~sign) if value & sign else value
        return value if register.mask is None else value & register.mask
    if register.mask is not None:
        value = (value & register.mask) // (register.mask & -register.mask)
        bits = register.mask.bit_count()
    return value - (1 << bits) if register.type.signed and value >> (bits - 1) else value
