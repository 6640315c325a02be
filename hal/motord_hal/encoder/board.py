# SPDX-License-Identifier: Apache-2.0
"""A board that only counts encoder edges: docs/mcu-frame.md, with its motors never enabled.

Its feedback has the board's own time stamps, so a wheel's travel is as old as they say. When the
board is silent, the feedback of its wheels gets old, and the core stops.
"""

from __future__ import annotations

import asyncio
import struct
from collections.abc import Callable, Mapping

from motord_hal.base.clock import now_ns, now_s
from motord_hal.base.errors import SYSTEM_ERRORS, PortError
from motord_hal.base.retry import Backoff
from motord_hal.fieldbus.ports import BoardEncoder, EventKind, LineSpec
from motord_hal.mcu.frames import (
    FEEDBACK_HEAD_BYTES,
    FEEDBACK_MOTOR_BYTES,
    Frame,
    FrameError,
    Splitter,
    Type,
    build,
    parse,
    setpoints_payload,
)
from motord_hal.mcu.link import Stream
from motord_hal.realtime.board import BoardClock
from motord_hal.realtime.pwm import EncoderConfig, EncoderKind

NS_PER_US = 1000

FEEDBACK_S = 0.01
ASK_EVERY_S = 0.05
SILENT_S = 0.25
REOPEN_FIRST_S = 0.1
REOPEN_LIMIT_S = 2.0
WIDEST = (1 << 64) - 1
_RESTARTED = _RESTART_NOTED = 8
_COUNT = struct.Struct("<i")
_COUNTS = 1 << 32

Report = Callable[[int, int, int, int], None]
"""`BridgeThread.report_count`."""
Say = Callable[[EventKind, str], None]


def board_encoder(encoder: BoardEncoder) -> EncoderConfig:
    """Return the encoder's configuration for the thread of the pins."""
    return EncoderConfig(
        kind=EncoderKind.REPORTED, fd=-1, ceiling=WIDEST, rad_per_count=encoder.rad_per_count
    )


class CountingBoard:
    """One board on a port. `wheels`: motor of the board → index of the joint on its line."""

    def __init__(
        self, encoder: BoardEncoder, wheels: Mapping[int, int], report: Report, say: Say
    ) -> None:
        self._wheels = dict(wheels)
        self._report = report
        self._say = say
        self._port = encoder.port
        self._stream = Stream(_spec(encoder), self._take_in)
        self._splitter = Splitter()
        self._clock = BoardClock()
        self._sequence = 0
        self._control = 0
        self._counts: dict[int, int] = {}
        self._origin = 0
        self._received_s = 0.0
        self._well = False
        self._problem = ""

    async def run(self) -> None:
        """Open the port, request and receive; open again with back-off. Never returns."""
        backoff = Backoff(REOPEN_FIRST_S, REOPEN_LIMIT_S)
        while True:
            try:
                await self._listen(backoff)
            except PortError as error:
                self._fail(str(error))
            except SYSTEM_ERRORS as error:
                self._fail(f"{self._port}: {error} (a bug of motord: please report it)")
            finally:
                self._stream.close()
            await asyncio.sleep(backoff.next_s())

    async def _listen(self, backoff: Backoff) -> None:
        """Receive until the port is lost. Raises PortError."""
        self._stream.open()
        self._splitter, self._clock = Splitter(), BoardClock()
        self._received_s = now_s()
        while True:
            self._stream.send(self._question())
            await asyncio.sleep(ASK_EVERY_S)
            if now_s() - self._received_s > SILENT_S:
                self._fail(f"{self._port}: the encoder board is silent")
            elif self._well:
                backoff.reset()

    def _question(self) -> bytes:
        """Return set-points of zero that enable nothing. They set how often the board sends."""
        payload = bytearray(setpoints_payload((), {}, max(self._wheels), FEEDBACK_S))
        payload[0] = self._control
        self._sequence = self._sequence + 1 & 0xFFFF
        return build(Frame(Type.SETPOINTS, self._sequence, now_ns() // NS_PER_US, bytes(payload)))

    def _take_in(self, data: bytes) -> None:
        came_ns = now_ns()
        for piece in self._splitter.feed(data):
            try:
                frame = parse(piece)
            except FrameError:
                continue  # the next frame has the counts, too
            last = FEEDBACK_HEAD_BYTES + FEEDBACK_MOTOR_BYTES * max(self._wheels)
            if frame.type == Type.FEEDBACK and len(frame.payload) >= last:
                self._count(frame, came_ns)

    def _count(self, frame: Frame, came_ns: int) -> None:
        if frame.payload[0] & _RESTARTED:
            if not self._control:
                self._origin += 1
            self._control = _RESTART_NOTED
            return  # its clock and counts restart: the next frame is the first one
        if self._control:
            self._control = 0
            self._clock = BoardClock()
            self._counts.clear()
        stamp_ns = self._clock.stamp_ns(frame.time_us, came_ns)
        for motor, place in self._wheels.items():
            at = FEEDBACK_HEAD_BYTES + FEEDBACK_MOTOR_BYTES * (motor - 1)
            (raw,) = _COUNT.unpack_from(frame.payload, at)
            before = self._counts.get(motor, raw)
            moved = (raw - before + _COUNTS // 2) % _COUNTS - _COUNTS // 2
            self._counts[motor] = before + moved
            self._report(place, self._counts[motor], stamp_ns, self._origin)
        self._receive()

    def _receive(self) -> None:
        self._received_s = now_s()
        if not self._well:
            self._well = True
            self._problem = ""
            self._say(EventKind.DRIVE_BACK, f"{self._port}: the encoder board sends counts")

    def _fail(self, problem: str) -> None:
        """Note that the board does not count. Each problem is reported once until the board is
        back."""
        self._well = False
        if problem != self._problem:
            self._problem = problem
            self._say(EventKind.DRIVE_WARNING, problem)


def _spec(encoder: BoardEncoder) -> LineSpec:
    """Return the part of a LineSpec that a stream needs."""
    return LineSpec(
        index=0,
        name="encoders",
        kind="mcu",
        port=encoder.port,
        baudrate=encoder.baudrate,
        parity="none",
        stop_bits=1,
        cycle_hz=1.0 / FEEDBACK_S,
        gap_s=None,
        engine="asyncio",
        joints=(),
        watchdog_s=0.0,
    )
