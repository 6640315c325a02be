# SPDX-License-Identifier: Apache-2.0
"""Frames of the DDSM direct-drive hub motors as pure functions. Shared by the line and the
simulator.

Ten bytes in each direction: unit, command, seven or eight bytes of content, and the CRC-8/MAXIM of
the first nine. Sources: the makers' protocol tables of DDSM115 and DDSM210 (Waveshare wiki pages of
the same names): 0x64 sets and is answered, 0x74 requests more, 0xA0 switches the mode, has its
value where the check sum would be and is not answered.

In a drive profile with `protocol = "ddsm"` a register's address is command << 8 | byte in the
frame; access "w" is a place in the request, "r" one in the reply. Numbers stand high byte first.
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import IntEnum

from motord_hal.base.crc import reflected_table
from motord_hal.drives.profile import Register

FRAME_BYTES = 10
_SEAL_BYTE = 9
_CONTENT_BEGIN = 2
_POLYNOMIAL = 0x8C
"""The polynomial 0x31 with its bits reflected."""


class Command(IntEnum):
    SET = 0x64
    QUERY = 0x74
    MODE = 0xA0


_CRC_TABLE = reflected_table(_POLYNOMIAL)


def crc8(data: bytes) -> int:
    """CRC-8/MAXIM: polynomial 0x31, reflected, start 0."""
    crc = 0
    for byte in data:
        crc = _CRC_TABLE[crc ^ byte]
    return crc


def is_answered(command: int) -> bool:
    """Whether a request is answered; such requests also carry a check sum."""
    return command != Command.MODE


def command_of(register: Register) -> int:
    return register.address >> 8


def byte_of(register: Register) -> int:
    """Return the position of the register's first byte in the frame."""
    return register.address & 0xFF


def size_bytes(register: Register) -> int:
    return int(register.type.value.split("-")[0][1:]) // 8


def seal(frame: bytes) -> bytes:
    """Return the frame with its check sum filled in."""
    return frame[:_SEAL_BYTE] + bytes((crc8(frame[:_SEAL_BYTE]),))


def sealed(frame: bytes) -> bool:
    """Whether the frame is whole and its last byte is the check sum of the ones before."""
    return len(frame) == FRAME_BYTES and crc8(frame[:_SEAL_BYTE]) == frame[_SEAL_BYTE]


def build_request(unit: int, command: int, raw: Mapping[Register, int]) -> bytes:
    """Return a request. Bytes of content without a value are 0. Raises ValueError for a value that
    does not fit."""
    frame = bytearray((unit, command, *bytes(FRAME_BYTES - _CONTENT_BEGIN)))
    for register, value in raw.items():
        place(frame, register, value)
    return seal(bytes(frame)) if is_answered(command) else bytes(frame)


def build_reply(unit: int, second: int, raw: Mapping[Register, int]) -> bytes:
    """Return a reply. `second` is its second byte if no register stands there: DDSM115 puts its
    mode there, DDSM210 the command."""
    frame = bytearray((unit, second, *bytes(FRAME_BYTES - _CONTENT_BEGIN)))
    for register, value in raw.items():
        place(frame, register, value)
    return seal(bytes(frame))


def place(frame: bytearray, register: Register, raw: int) -> None:
    """Write a raw value at its register's place. Raises ValueError if it does not fit."""
    low, high = register.raw_range
    if not low <= raw <= high:
        raise ValueError(f"{register.name}: {raw} does not fit {register.type.value}")
    size, begin = size_bytes(register), byte_of(register)
    frame[begin : begin + size] = (raw & (1 << 8 * size) - 1).to_bytes(size, "big")


def pick(frame: bytes, register: Register) -> int:
    """Return the register's raw value in a frame."""
    size, begin = size_bytes(register), byte_of(register)
    value, bits = int.from_bytes(frame[begin : begin + size], "big"), 8 * size
    if register.mask is not None:
        value = (value & register.mask) // (register.mask & -register.mask)
        bits = register.mask.bit_count()
    return value - (1 << bits) if register.type.signed and value >> (bits - 1) else value
