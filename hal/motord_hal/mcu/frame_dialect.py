# SPDX-License-Identifier: Apache-2.0
"""The protocol `mcu-frame` on a stream line."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import replace

from motord_hal.base.errors import ProfileError
from motord_hal.drives.profile import DriveProfile
from motord_hal.fieldbus.ports import LineSpec
from motord_hal.mcu.dialect import BoardFeedback
from motord_hal.mcu.frames import (
    Frame,
    FrameError,
    Received,
    Splitter,
    Type,
    build,
    imu_in,
    newer,
    parse,
    pick,
    received_in,
    setpoints_payload,
    wire_bytes,
)
from motord_hal.mcu.pace import period_s
from motord_hal.realtime.board import BoardClock

NS_PER_US = 1000

SEQUENCES_KEPT = 256
HELD_TOLERANCE_S = 0.002
"""Received earlier than sent: the number is that of set-points of an earlier program."""


class FrameDialect:
    """dialect.Dialect for boards with motord_mcu.c."""

    answers = True

    def __init__(self, spec: LineSpec) -> None:
        profile: DriveProfile = spec.joints[0].profile
        self.bad = 0
        self._registers = tuple(profile.registers.values())
        self._read = tuple(r for r in self._registers if "r" in r.access)
        self._motors = max(profile.channels)
        self._has_imu = spec.imu is not None
        self._feedback_s = period_s(spec, self.wire_bytes())
        self._sequence = 0
        if spec.joints[0].profile.protocol != "mcu-frame":
            raise ProfileError(f"{spec.name}: {profile.name} speaks {profile.protocol}")
        self.reset()

    def reset(self) -> None:
        self._splitter = Splitter()
        self._clock = BoardClock()
        self._sent_ns: dict[int, int] = {}

    def setpoints(self, raw: Mapping[str, int], now_ns: int) -> bytes:
        payload = setpoints_payload(self._registers, raw, self._motors, self._feedback_s)
        self._sequence = self._sequence + 1 & 0xFFFF
        self._sent_ns[self._sequence] = now_ns
        if len(self._sent_ns) > SEQUENCES_KEPT:
            del self._sent_ns[next(iter(self._sent_ns))]
        return build(Frame(Type.SETPOINTS, self._sequence, now_ns // NS_PER_US, payload))

    def feed(self, data: bytes, now_ns: int) -> Iterator[BoardFeedback]:
        for piece in self._splitter.feed(data):
            try:
                frame = parse(piece)
                if frame.type != Type.FEEDBACK:
                    raise FrameError(f"type {frame.type:#x} is not for us")
                values = {r.name: pick(frame.payload, r) for r in self._read}
                received, imu = received_in(frame.payload), imu_in(frame.payload)
            except FrameError:
                self.bad += 1
                continue
            yield replace(self._feedback(frame, values, received, now_ns), imu=imu)

    def _feedback(
        self, frame: Frame, values: dict[str, int], received: Received, now_ns: int
    ) -> BoardFeedback:
        sent_ns = self._sent_ns.get(received.sequence)
        stamp_ns = self._clock.stamp_ns(frame.time_us, now_ns)
        trip_s = -math.inf if sent_ns is None else (now_ns - sent_ns) * 1e-9 - received.held_s
        if not newer(self._sequence + 1, received.sequence):  # the board would not take ours
            self._sequence = received.sequence
            self._sent_ns.clear()
        if sent_ns is None or trip_s < -HELD_TOLERANCE_S:
            return BoardFeedback(values, stamp_ns, 0, None)
        return BoardFeedback(values, stamp_ns, sent_ns, trip_s)

    def wire_bytes(self) -> int:
        return wire_bytes(self._motors, imu=self._has_imu)
