# SPDX-License-Identifier: Apache-2.0
"""Frames between motord and a board, as pure functions. docs/mcu-frame.md describes them. The line
and the simulator share them.

A frame is version, type, sequence, time stamp, payload and CRC, stuffed by `cobs` and put between
zeros. In a drive profile with `protocol = "mcu-frame"` a register's address is a position in the
payload: access "w" in the set-points, "r" in the feedback, "rw" at the same place in both. Numbers
stand low byte first, as in all usual microcontrollers.
"""

from __future__ import annotations

import binascii
import enum
import math
import struct
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass

from motord_hal.drives.profile import Register
from motord_hal.mcu import cobs

VERSION = 1
FRAME_BYTES_MAX = 200
"""Limit without stuffing. 8 motors need 106."""
SETPOINTS_HEAD_BYTES = 6
SETPOINTS_MOTOR_BYTES = 6
FEEDBACK_HEAD_BYTES = 16
FEEDBACK_MOTOR_BYTES = 10
RESTARTED = 8
"""Bit of status that a board sets when it starts, until the same bit of control is set."""
HAS_IMU = 16
"""Bit of status: an inertial sensor's sample follows the motors."""
HELD_UNIT_S = 0.0001
RATE_UNIT_RAD_S = 1e-6
ACCELERATION_UNIT_M_S2 = 1e-3
IMU_SATURATED = 1
"""Bit of the sensor's flags: a rate is at the end of its scale."""

_HEAD = struct.Struct("<BBHI")
_CRC = struct.Struct("<H")
_IMU = struct.Struct("<3i3hH")
_NO_RATE, _NO_ACCELERATION = -(1 << 31), -(1 << 15)
"""Raw values that mean "not measured"."""
_TIME_US = 1 << 32


class FrameError(ValueError):
    """Bytes that are no frame."""


class Type(enum.IntEnum):
    SETPOINTS = 0x01
    FEEDBACK = 0x81


@dataclass(frozen=True, slots=True)
class Frame:
    type: int
    sequence: int
    time_us: int
    """Time of the sender's clock, modulo 2^32."""
    payload: bytes


def crc16(data: bytes, start: int = 0xFFFF) -> int:
    """Return a CRC with polynomial 0x1021, not reflected: CRC-16/IBM-3740 (start 0xFFFF),
    CRC-16/XMODEM (start 0)."""
    return binascii.crc_hqx(data, start)


def build(frame: Frame) -> bytes:
    """Return the bytes on the wire: a zero, the stuffed frame, a zero. The first zero ends noise
    that came before."""
    head = _HEAD.pack(VERSION, frame.type, frame.sequence & 0xFFFF, frame.time_us % _TIME_US)
    body = head + frame.payload
    if len(body) + _CRC.size > FRAME_BYTES_MAX:
        raise ValueError(f"a payload of {len(frame.payload)} bytes is too long")
    return b"\0" + cobs.encode(body + _CRC.pack(crc16(body))) + b"\0"


def parse(stuffed: bytes) -> Frame:
    """Return the frame that stood between two zeros. Raises FrameError."""
    try:
        raw = cobs.decode(stuffed)
    except ValueError as error:
        raise FrameError(f"not stuffed: {error}") from error
    if not _HEAD.size + _CRC.size <= len(raw) <= FRAME_BYTES_MAX:
        raise FrameError(f"{len(raw)} bytes are no frame")
    body, (crc,) = raw[: -_CRC.size], _CRC.unpack(raw[-_CRC.size :])
    if crc16(body) != crc:
        raise FrameError("wrong CRC")
    version, kind, sequence, time_us = _HEAD.unpack_from(body)
    if version != VERSION:
        raise FrameError(f"frames of version {version}, not {VERSION}")
    return Frame(kind, sequence, time_us, body[_HEAD.size :])


class Splitter:
    """Splitter of a stream of bytes at its zeros. Of bytes without an end, only a limited number is
    kept."""

    def __init__(self) -> None:
        self._tail = bytearray()
        self._too_long = False

    def feed(self, data: bytes) -> Iterator[bytes]:
        """Yield the non-empty pieces between zeros. A piece that is too long is cut, so that it is
        no valid frame."""
        for number, piece in enumerate(data.split(b"\0")):
            if number and (self._tail or self._too_long):
                yield bytes(self._tail)
                self._tail.clear()
                self._too_long = False
            room = FRAME_BYTES_MAX + 2 - len(self._tail)
            self._too_long |= len(piece) > room
            self._tail += piece[:room]


def wire_bytes(motors: int, *, imu: bool = False) -> int:
    """Return the bytes of the longer of both frames, with the zeros and the stuffing's byte."""
    setpoints = SETPOINTS_HEAD_BYTES + SETPOINTS_MOTOR_BYTES * motors
    feedback = FEEDBACK_HEAD_BYTES + FEEDBACK_MOTOR_BYTES * motors + imu * _IMU.size
    return _HEAD.size + max(setpoints, feedback) + _CRC.size + 3


def size_bytes(register: Register) -> int:
    return register.type.bits // 8


def place(payload: bytearray, register: Register, raw: int) -> None:
    """Write a raw value at its register's place. Raises ValueError if it does not fit."""
    low, high = register.raw_range
    if not low <= raw <= high:
        raise ValueError(f"{register.name}: {raw} does not fit {register.type.value}")
    size = size_bytes(register)
    word = raw & (1 << 8 * size) - 1
    payload[register.address : register.address + size] = word.to_bytes(size, "little")


def pick(payload: bytes, register: Register) -> int:
    """Return the register's raw value. Raises FrameError if the payload is too short."""
    size = size_bytes(register)
    data = payload[register.address : register.address + size]
    if len(data) != size:
        raise FrameError(f"{len(payload)} bytes of payload end before {register.name}")
    return int.from_bytes(data, "little", signed=register.type.signed)


def setpoints_payload(
    registers: Iterable[Register], raw: Mapping[str, int], motors: int, feedback_s: float
) -> bytes:
    """Return the payload to the board. Registers without a value are 0."""
    payload = bytearray(SETPOINTS_HEAD_BYTES + SETPOINTS_MOTOR_BYTES * motors)
    for register in registers:
        if "w" in register.access:
            place(payload, register, raw.get(register.name, 0))
    payload[1] = motors
    payload[4:6] = min(max(round(feedback_s * 1000), 1), 0xFFFF).to_bytes(2, "little")
    return bytes(payload)


@dataclass(frozen=True, slots=True)
class Received:
    """The board's report on the newest set-points that it received."""

    sequence: int
    held_s: float
    """Time from receiving them to this feedback."""


def feedback_payload(
    registers: Iterable[Register],
    raw: Mapping[str, int],
    motors: int,
    period_ms: int,
    received: Received,
) -> bytes:
    """Return the payload that a board sends, for the simulator."""
    payload = bytearray(FEEDBACK_HEAD_BYTES + FEEDBACK_MOTOR_BYTES * motors)
    for register in registers:
        if "r" in register.access:
            place(payload, register, raw[register.name])
    payload[1] = motors
    held = min(round(received.held_s / HELD_UNIT_S), 0xFFFF)
    struct.pack_into("<HHH", payload, 4, period_ms, received.sequence, held)
    return bytes(payload)


@dataclass(frozen=True, slots=True)
class BoardImu:
    """A sample of an inertial sensor on the board, about the sensor's own axes. NaN: not
    measured."""

    angular_rad_s: tuple[float, ...]
    acceleration_m_s2: tuple[float, ...]
    saturated: bool


def imu_payload(imu: BoardImu) -> bytes:
    """Return the bytes that a board appends to its feedback, for the simulator."""
    rates = (_count(rate, RATE_UNIT_RAD_S, _NO_RATE) for rate in imu.angular_rad_s)
    accelerations = (
        _count(value, ACCELERATION_UNIT_M_S2, _NO_ACCELERATION) for value in imu.acceleration_m_s2
    )
    return _IMU.pack(*rates, *accelerations, IMU_SATURATED if imu.saturated else 0)


def _count(value: float, unit: float, nothing: int) -> int:
    if not math.isfinite(value):
        return nothing
    return min(max(round(value / unit), nothing + 1), -nothing - 1)
