# SPDX-License-Identifier: Apache-2.0
"""The frames of docs/mcu-frame.md, from the board's side."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from motord_hal.drives.profile import DriveProfile
from motord_hal.mcu.frames import (
    HAS_IMU,
    RESTARTED,
    Frame,
    FrameError,
    Received,
    Splitter,
    Type,
    build,
    feedback_payload,
    imu_payload,
    parse,
    pick,
)
from motord_hal.sim.gyro import SimulatedGyro
from motord_hal.sim.rs485.content import NamedContent

FIRST_FEEDBACK_S = 0.1
US_PER_S = 1e6


class FrameTalk:
    """`line.Talk` of a board with motord_mcu.c."""

    def __init__(
        self, profile: DriveProfile, true_s: Callable[[], float], gyro: SimulatedGyro | None = None
    ) -> None:
        """Set the board up. `true_s` returns the time of its registers. `gyro` is a sensor on the
        board."""
        self._true_s = true_s
        self._gyro = gyro
        self._registers = tuple(profile.registers.values())
        self._motors = max(profile.channels)
        self.power_up()

    def power_up(self) -> None:
        self.feedback_s = FIRST_FEEDBACK_S
        self._splitter = Splitter()
        self._restarted = True
        self._sequence = 0
        self._received_sequence = 0
        self._received_s = 0.0

    def feed(self, data: bytes, now_s: float) -> Iterator[dict[str, int] | None]:
        for piece in self._splitter.feed(data):
            try:
                frame = parse(piece)
                written = {
                    r.name: pick(frame.payload, r) for r in self._registers if "w" in r.access
                }
            except FrameError:
                yield None
                continue
            if frame.type != Type.SETPOINTS:
                yield None
                continue
            self._received_sequence, self._received_s = frame.sequence, now_s
            self.feedback_s = int.from_bytes(frame.payload[4:6], "little") / 1000
            self._restarted &= not frame.payload[0] & RESTARTED
            yield written

    def feedback(self, content: NamedContent, now_s: float) -> bytes:
        raw = {r.name: content.value(r.name) for r in self._registers if "r" in r.access}
        received = Received(self._received_sequence, now_s - self._received_s)
        period_ms = round(self.feedback_s * 1000)
        payload = bytearray(
            feedback_payload(self._registers, raw, self._motors, period_ms, received)
        )
        payload[0] |= RESTARTED if self._restarted else 0
        if self._gyro is not None:
            payload[0] |= HAS_IMU
            payload += imu_payload(self._gyro.measure())
        self._sequence = self._sequence + 1 & 0xFFFF
        time_us = round(self._true_s() * US_PER_S)
        return build(Frame(Type.FEEDBACK, self._sequence, time_us, bytes(payload)))
