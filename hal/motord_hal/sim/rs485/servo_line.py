# SPDX-License-Identifier: Apache-2.0
"""A line of simulated bus servos. Packets end by their length, not by silence, and many servos may
answer one request."""

from __future__ import annotations

import functools
import math

from motord_hal.servo.packets import BROADCAST_UNIT, Packet, packets_of, take_all
from motord_hal.sim.rs485.framing import ServoFraming
from motord_hal.sim.rs485.line import SimulatedLine
from motord_hal.sim.rs485.servo import answer_servos


class SimulatedServoLine(SimulatedLine):
    """A half-duplex line of servos."""

    @functools.cached_property
    def _servo_framing(self) -> ServoFraming:
        return ServoFraming(self.spec.kind)

    def _is_whole(self, frame: bytes) -> bool:
        return self._servo_framing.whole(frame)

    def _end_frame(self, now_s: float) -> None:
        data, ended_s = bytes(self._request), self.wire.free_s
        self._request.clear()
        self._frame_ends_s = math.inf
        for held in self._held:
            self._reply(held, now_s)
        self._held.clear()
        for packet in take_all(packets_of(self.spec.kind), data):
            self.counters.frames += 1
            if packet is None:
                self.counters.bad_crc += 1
            else:
                ended_s = self._execute(packet, ended_s, now_s)

    def _execute(self, packet: Packet, ended_s: float, now_s: float) -> float:
        """Make the servos answer; return the time when they have ended."""
        hearing = {
            unit: drive
            for unit, drive in self.drives.items()
            if drive.receives(now_s)
            and self._understands(drive, now_s)
            and not self._script.silent(unit, now_s)
        }
        replies = answer_servos(packet, hearing, now_s)
        if not replies and packet.unit != BROADCAST_UNIT:
            self.counters.unanswered += 1
        for servo, frame in replies:
            spoiled = self._script.spoil(servo.unit, frame, self._servo_framing, now_s)
            self._send_spoiled(spoiled, servo, ended_s, now_s)
            ended_s += self._turnaround_s(servo, now_s) + len(frame) * self.wire.character_s
        return ended_s
