# SPDX-License-Identifier: Apache-2.0
"""Modbus RTU frames as pure functions: building, parsing, and times on the wire.

Sources: MODBUS Application Protocol Specification V1.1b3 (functions, limits, exceptions) and
MODBUS over Serial Line V1.02 (frame, CRC in 2.5.1.2, silent intervals in 2.5.1.1).
Shared by the line (a client) and by the simulator (a server).
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from enum import IntEnum
from types import MappingProxyType

from motord_hal.base.crc import reflected_table

BROADCAST_UNIT = 0
UNIT_MAX = 247
EXCEPTION_FLAG = 0x80

READ_REGISTERS_MAX = 125
WRITE_REGISTERS_MAX = 123
READ_WRITE_WRITE_REGISTERS_MAX = 121
"""Greatest number of registers in one request: V1.1b3, 6.3, 6.12, 6.17."""

SILENT_CHARACTERS = 3.5
SILENT_FIXED_S = 1.75e-3
SILENT_FIXED_ABOVE_BAUDRATE = 19200
"""Silent interval, Serial Line V1.02, 2.5.1.1: 3.5 characters, above 19200 baud a fixed 1.750
ms."""

EXCEPTION_TEXT = MappingProxyType(
    {
        1: "illegal function",
        2: "illegal data address",
        3: "illegal data value",
        4: "server device failure",
        5: "acknowledge",
        6: "server device busy",
        8: "memory parity error",
        10: "gateway path unavailable",
        11: "gateway target did not respond",
    }
)


class Function(IntEnum):
    READ_HOLDING = 3
    READ_INPUT = 4
    WRITE_SINGLE = 6
    WRITE_MULTIPLE = 16
    READ_WRITE = 23


class FrameError(ValueError):
    """These bytes are not a frame of the expected kind."""


class CrcError(FrameError):
    """The check sum does not fit the bytes."""


_CRC_TABLE = reflected_table(0xA001)


def crc16(data: bytes) -> int:
    """Return the CRC-16/MODBUS (polynomial 0xA001 reflected, start 0xFFFF)."""
    crc = 0xFFFF
    for byte in data:
        crc = crc >> 8 ^ _CRC_TABLE[(crc ^ byte) & 0xFF]
    return crc


def seal(body: bytes) -> bytes:
    """Return the body with its CRC appended, low byte first."""
    return body + crc16(body).to_bytes(2, "little")


def sealed(frame: bytes) -> bool:
    """Whether the last two bytes are the CRC of the bytes before."""
    return len(frame) >= 4 and crc16(frame[:-2]) == int.from_bytes(frame[-2:], "little")


@dataclass(frozen=True, slots=True)
class Request:
    """One request. `values` are the words to write, `count` the registers to read."""

    unit: int
    function: Function
    address: int
    count: int = 0
    write_address: int = 0
    """Only for READ_WRITE: the address of `values`; `address` and `count` are for the read."""
    values: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        if problem := _request_problem(self):
            raise FrameError(f"{self.function.name} of unit {self.unit}: {problem}")


def _span_problem(address: int, count: int, most: int) -> str:
    if not 1 <= count <= most:
        return f"{count} registers (1 to {most})"
    if not 0 <= address <= 0x10000 - count:
        return f"registers {address:#06x}+{count} leave the address space"
    return ""


def _request_problem(request: Request) -> str:
    if not 0 <= request.unit <= UNIT_MAX:
        return f"unit {request.unit} (0 to {UNIT_MAX})"
    if any(not 0 <= word <= 0xFFFF for word in request.values):
        return "a word is not 16 bit"
    match request.function:
        case Function.READ_HOLDING | Function.READ_INPUT:
            return _span_problem(request.address, request.count, READ_REGISTERS_MAX)
        case Function.WRITE_SINGLE:
            return _span_problem(request.address, len(request.values), 1)
        case Function.WRITE_MULTIPLE:
            return _span_problem(request.address, len(request.values), WRITE_REGISTERS_MAX)
        case Function.READ_WRITE:
            written = len(request.values)
            return _span_problem(
                request.address, request.count, READ_REGISTERS_MAX
            ) or _span_problem(request.write_address, written, READ_WRITE_WRITE_REGISTERS_MAX)


def build_request(request: Request) -> bytes:
    """Return the request's frame."""
    head = struct.pack(">BB", request.unit, request.function)
    words = struct.pack(f">{len(request.values)}H", *request.values)
    match request.function:
        case Function.READ_HOLDING | Function.READ_INPUT:
            body = struct.pack(">HH", request.address, request.count)
        case Function.WRITE_SINGLE:
            body = struct.pack(">H", request.address) + words
        case Function.WRITE_MULTIPLE:
            body = struct.pack(">HHB", request.address, len(request.values), len(words)) + words
        case Function.READ_WRITE:
            read = struct.pack(">HH", request.address, request.count)
            written = struct.pack(">HHB", request.write_address, len(request.values), len(words))
            body = read + written + words
    return seal(head + body)


def request_bytes(head: bytes) -> int | None:
    """Return the length of the whole request that begins with these bytes; None: too few bytes.
    Raises FrameError for an unknown function."""
    if len(head) < 2:
        return None
    function = head[1]
    if function in (Function.READ_HOLDING, Function.READ_INPUT, Function.WRITE_SINGLE):
        return 8
    if function == Function.WRITE_MULTIPLE:
        return None if len(head) < 7 else 9 + head[6]
    if function == Function.READ_WRITE:
        return None if len(head) < 11 else 13 + head[10]
    raise FrameError(f"function {function} is not supported")


def parse_request(frame: bytes) -> Request:
    """Return the request in a whole frame. Raises CrcError, or FrameError if it is not a
    request."""
    if len(frame) < 4:
        raise FrameError(f"{len(frame)} bytes are no frame")
    if not sealed(frame):
        raise CrcError(f"bad CRC in {frame.hex(' ')}")
    if request_bytes(frame) != len(frame):
        raise FrameError(f"wrong length {len(frame)} for function {frame[1]}")
    unit, function, address = struct.unpack_from(">BBH", frame)
    function = Function(function)
    if function in (Function.READ_HOLDING, Function.READ_INPUT):
        return Request(unit, function, address, count=_words(frame, 4, 1)[0])
    if function is Function.WRITE_SINGLE:
        return Request(unit, function, address, values=_words(frame, 4, 1))
    if function is Function.WRITE_MULTIPLE:
        values = _counted_words(frame, 4)
        return Request(unit, function, address, values=values)
    count, write_address = _words(frame, 4, 2)
    return Request(unit, function, address, count, write_address, _counted_words(frame, 8))


def _words(frame: bytes, offset: int, count: int) -> tuple[int, ...]:
    return struct.unpack_from(f">{count}H", frame, offset)


def _counted_words(frame: bytes, offset: int) -> tuple[int, ...]:
    count, size = struct.unpack_from(">HB", frame, offset)
    if size != 2 * count:
        raise FrameError(f"{count} registers in {size} bytes")
    return _words(frame, offset + 3, count)


@dataclass(frozen=True, slots=True)
class Reply:
    """A drive's answer: the words of a read, nothing for a write, or an exception code."""

    values: tuple[int, ...] = ()
    exception: int | None = None
    """Exception code; None: no exception. Code 0 is not in the standard, but counts as a refusal,
    too."""


def reply_bytes(request: Request) -> int:
    """Return the length of the good reply's frame; 0 to a broadcast, which is not answered."""
    if request.unit == BROADCAST_UNIT:
        return 0
    if request.function in (Function.WRITE_SINGLE, Function.WRITE_MULTIPLE):
        return 8
    return 5 + 2 * request.count


EXCEPTION_BYTES = 5


def build_reply(request: Request, values: tuple[int, ...] = ()) -> bytes:
    """Return the good reply to a request. `values` are the read words."""
    head = struct.pack(">BB", request.unit, request.function)
    match request.function:
        case Function.WRITE_SINGLE:
            body = struct.pack(">HH", request.address, request.values[0])
        case Function.WRITE_MULTIPLE:
            body = struct.pack(">HH", request.address, len(request.values))
        case _:
            if len(values) != request.count:
                raise FrameError(f"{len(values)} words for a read of {request.count}")
            body = struct.pack(f">B{len(values)}H", 2 * len(values), *values)
    return seal(head + body)


def build_exception(unit: int, function: int, code: int) -> bytes:
    return seal(struct.pack(">BBB", unit, function | EXCEPTION_FLAG, code))


def parse_reply(request: Request, frame: bytes) -> Reply:
    """Return the answer to exactly this request: unit, function, length, write echo and CRC all
    fit. Raises CrcError or FrameError with the first mismatch."""
    if len(frame) < EXCEPTION_BYTES:
        raise FrameError(f"{len(frame)} bytes are no reply")
    if not sealed(frame):
        raise CrcError(f"bad CRC in {frame.hex(' ')}")
    if frame[0] != request.unit:
        raise FrameError(f"unit {frame[0]} answered for unit {request.unit}")
    if frame[1] == request.function | EXCEPTION_FLAG and len(frame) == EXCEPTION_BYTES:
        return Reply(exception=frame[2])
    if frame[1] != request.function:
        raise FrameError(f"function {frame[1]} answered for {request.function}")
    if len(frame) != reply_bytes(request):
        raise FrameError(f"{len(frame)} bytes, {reply_bytes(request)} were due")
    if request.function in (Function.WRITE_SINGLE, Function.WRITE_MULTIPLE):
        if frame != build_reply(request):
            raise FrameError("the echo names another register, value or count")
        return Reply()
    if frame[2] != 2 * request.count:
        raise FrameError(f"{frame[2]} bytes announced, {2 * request.count} were due")
    return Reply(_words(frame, 3, request.count))


def character_bits(parity: str, stop_bits: int) -> int:
    """Return the bits of one character on the wire: start, eight data, parity, stop."""
    return 9 + (parity != "none") + stop_bits


def frame_time_s(size_bytes: int, baudrate: int, parity: str, stop_bits: int) -> float:
    """Return the time for which a frame of `size_bytes` occupies the wire."""
    return size_bytes * character_bits(parity, stop_bits) / baudrate


def silent_interval_s(baudrate: int, bits: int) -> float:
    """Return the silence required before a frame. `bits` is that of one character."""
    if baudrate > SILENT_FIXED_ABOVE_BAUDRATE:
        return SILENT_FIXED_S
    return SILENT_CHARACTERS * bits / baudrate
