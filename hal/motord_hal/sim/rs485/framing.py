# SPDX-License-Identifier: Apache-2.0
"""Protocols of lines: when a request is whole and good, which unit answers it and how."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol

from motord_hal.ddsm import codec as ddsm
from motord_hal.modbus.codec import (
    BROADCAST_UNIT,
    FrameError,
    build_exception,
    request_bytes,
    seal,
    sealed,
)
from motord_hal.roboclaw import codec as roboclaw
from motord_hal.servo.packets import is_whole, packets_of
from motord_hal.sim.rs485.drive import SimulatedDrive
from motord_hal.sim.rs485.slave import Answer, answer, answer_ddsm, answer_roboclaw


class Rewriting(Protocol):
    """The part of a protocol that faults need."""

    def refusal(self, frame: bytes, code: int) -> bytes:
        """Return the refusal in place of this frame; empty: the protocol has no refusals."""

    def readdressed(self, frame: bytes, unit: int) -> bytes:
        """Return the frame, still good, with another unit's address."""


class Framing(Rewriting, Protocol):
    """One protocol of a line."""

    def whole(self, frame: bytes) -> bool:
        """Whether the request is complete without a silence after it."""

    def good(self, frame: bytes) -> bool:
        """Whether the frame's check sum fits."""

    def is_broadcast(self, frame: bytes) -> bool: ...

    def is_answered(self, frame: bytes) -> bool:
        """Whether the addressed unit answers this frame if it is good."""

    def answer(
        self, frame: bytes, drives: Mapping[int, SimulatedDrive], now_s: float
    ) -> Answer | None: ...


class ModbusFraming:
    def whole(self, frame: bytes) -> bool:
        try:
            return request_bytes(frame) == len(frame) and sealed(frame)
        except FrameError:
            return False

    def good(self, frame: bytes) -> bool:
        return sealed(frame)

    def is_broadcast(self, frame: bytes) -> bool:
        return frame[0] == BROADCAST_UNIT

    def is_answered(self, frame: bytes) -> bool:
        return frame[0] != BROADCAST_UNIT

    def answer(
        self, frame: bytes, drives: Mapping[int, SimulatedDrive], now_s: float
    ) -> Answer | None:
        return answer(frame, drives, now_s)

    def refusal(self, frame: bytes, code: int) -> bytes:
        return build_exception(frame[0], frame[1] & 0x7F, code)

    def readdressed(self, frame: bytes, unit: int) -> bytes:
        return seal(bytes((unit,)) + frame[1:-2])


class DdsmFraming:
    """Frames of ten bytes in each direction (motord_hal.ddsm.codec)."""

    def whole(self, frame: bytes) -> bool:
        return len(frame) == ddsm.FRAME_BYTES and self.good(frame)

    def good(self, frame: bytes) -> bool:
        """Whether the check sum fits, or none is due: commands that are not answered have none."""
        bare = len(frame) == ddsm.FRAME_BYTES and not ddsm.is_answered(frame[1])
        return bare or ddsm.sealed(frame)

    def is_broadcast(self, frame: bytes) -> bool:
        del frame
        return False

    def is_answered(self, frame: bytes) -> bool:
        return ddsm.is_answered(frame[1])

    def answer(
        self, frame: bytes, drives: Mapping[int, SimulatedDrive], now_s: float
    ) -> Answer | None:
        return answer_ddsm(frame, drives, now_s)

    def refusal(self, frame: bytes, code: int) -> bytes:
        del frame, code
        return b""

    def readdressed(self, frame: bytes, unit: int) -> bytes:
        return ddsm.seal(bytes((unit,)) + frame[1:])


class RoboclawFraming:
    """Packets of RoboClaw (motord_hal.roboclaw.codec)."""

    def whole(self, frame: bytes) -> bool:
        return roboclaw.packet_bytes(frame) == len(frame)

    def good(self, frame: bytes) -> bool:
        try:
            roboclaw.parse_packet(frame)
        except roboclaw.PacketError:
            return False
        return True

    def is_broadcast(self, frame: bytes) -> bool:
        del frame
        return False

    def is_answered(self, frame: bytes) -> bool:
        del frame
        return True

    def answer(
        self, frame: bytes, drives: Mapping[int, SimulatedDrive], now_s: float
    ) -> Answer | None:
        return answer_roboclaw(frame, drives, now_s)

    def refusal(self, frame: bytes, code: int) -> bytes:
        del frame, code
        return b""

    def readdressed(self, frame: bytes, unit: int) -> bytes:
        """Return the frame as another unit's. Only the check sum contains the address."""
        return frame[:-1] + bytes((frame[-1] ^ unit,))


class ServoFraming:
    """Packets of bus servos (motord_hal.servo.packets)."""

    def __init__(self, kind: str) -> None:
        self._packets = packets_of(kind)

    def whole(self, frame: bytes) -> bool:
        return is_whole(self._packets, frame)

    def refusal(self, frame: bytes, code: int) -> bytes:
        """Return an error number from a Dynamixel. A Feetech servo refuses nothing."""
        if not frame.startswith(_DYNAMIXEL_HEAD):
            return frame
        return self._packets.build_status(frame[self._packets.unit_byte], code)

    def readdressed(self, frame: bytes, unit: int) -> bytes:
        packet, _ = self._packets.take(frame, status=True)
        if packet is None:
            return frame
        return self._packets.build_status(unit, packet.code, packet.parameters)


class Unaddressed:
    """A board alone on its port. There is no other unit, and the board refuses nothing."""

    def refusal(self, frame: bytes, code: int) -> bytes:
        del frame, code
        return b""

    def readdressed(self, frame: bytes, unit: int) -> bytes:
        del unit
        return frame


_DYNAMIXEL_HEAD = b"\xff\xff\xfd\x00"


def framing_of(kind: str) -> Framing:
    """Return the framing of a line's kind."""
    if kind == "roboclaw":
        return RoboclawFraming()
    return DdsmFraming() if kind == "ddsm" else ModbusFraming()
