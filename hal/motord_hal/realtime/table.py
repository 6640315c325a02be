# SPDX-License-Identifier: Apache-2.0
"""The table of a serial line in C, as plain values. api_line.h has the same names, and the meaning
of each field. To make a table you do not need the C extension."""

from __future__ import annotations

import enum
from dataclasses import dataclass


class Seal(enum.IntEnum):
    """Kind of check sum at the end of a frame."""

    NONE = 0
    CRC16 = 1
    CRC8 = 2
    XMODEM = 3
    WITH_REQUEST = 4
    SUM = 5
    STUFFED = 6


class Form(enum.IntEnum):
    """Width, sign and byte order of a number in a frame."""

    U8 = 0
    I8 = 1
    U16 = 2
    I16 = 3
    U32 = 4
    I32 = 5
    U32_LOW_FIRST = 6
    I32_LOW_FIRST = 7
    U16_LE = 8
    I16_LE = 9
    U32_LE = 10
    I32_LE = 11
    M16_LE = 13
    M16_BIT10 = 15

    @property
    def bits(self) -> int:
        return int(self.name[1:].split("_")[0])


class SetpointKind(enum.IntEnum):
    VELOCITY = 0
    DUTY = 1
    TORQUE = 2
    """On CAN buses only."""
    POSITION = 3


class FieldKind(enum.IntEnum):
    COUNT = 0
    VELOCITY = 1
    CURRENT = 2
    VOLTAGE = 3
    TEMPERATURE = 4
    FAULT = 5
    ENABLED = 6
    KEPT = 7
    REFERENCED = 8
    TAKEN = 9
    """On CAN buses only."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LineFrame:
    request: bytes
    reply_bytes: int
    echo_bytes: int = 0
    match: bytes = b""
    request_seal: Seal
    reply_seal: Seal
    has_exceptions: int = 0
    exact: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class LineSetpoint:
    joint: int
    kind: SetpointKind
    byte: int
    form: Form
    magnitude: int
    raw_per_si: float
    raw_offset: float = 0.0
    raw_min: float
    raw_max: float
    raw_per_s: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class LineField:
    joint: int = 0
    kind: FieldKind
    byte: int
    form: Form
    mask: int = 0
    equals_mask: int = 0
    equals: int = 0
    direction: int = 0
    si_per_raw: float = 1.0
    harmless_bits: int = 0
    is_code: int = 0
    harmless: tuple[int, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class LineExchange:
    frame: LineFrame
    setpoint: tuple[LineSetpoint, ...] = ()
    field: tuple[LineField, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class LineDirection:
    joint: int
    kind: SetpointKind
    inverted: int
    rest: LineFrame
    forward: LineFrame
    reverse: LineFrame


@dataclass(frozen=True, slots=True, kw_only=True)
class LineDrive:
    tries: int
    extra_every: int
    period_ns: int
    turnaround_ns: int
    reply_timeout_ns: int
    watchdog_ns: int
    probe: int
    cyclic: tuple[LineExchange, ...]
    extra: tuple[LineExchange, ...]
    direction: tuple[LineDirection, ...]
    quick_stop: tuple[LineFrame, ...]
    disarm: tuple[LineFrame, ...]
    idle: tuple[LineFrame, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class LineGroup:
    data_byte: int
    write: bytes
    read: bytes
    fast: int = 0


NO_GROUP = LineGroup(data_byte=0, write=b"", read=b"")


@dataclass(frozen=True, slots=True, kw_only=True)
class LineTable:
    echo: int
    character_ns: float
    gap_ns: int
    late_ns: int
    setpoint_timeout_ns: int
    rest_velocity_rad_s: float
    broadcast_stop: tuple[LineFrame, ...]
    group: LineGroup = NO_GROUP
    drive: tuple[LineDrive, ...]
