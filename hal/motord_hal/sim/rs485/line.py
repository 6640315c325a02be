# SPDX-License-Identifier: Apache-2.0
"""One line of a simulated robot: drives behind a port whose bytes come at the pace of a UART.

A request ends when its bytes would have passed the wire; the reply begins after the drive's
turn-around. Modbus frames end and begin by silence: MODBUS over Serial Line V1.02, 2.5.1.1.
"""

from __future__ import annotations

import abc
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

from motord_hal.drives.profile import Gap
from motord_hal.fieldbus.ports import LineSpec
from motord_hal.modbus.codec import character_bits, silent_interval_s
from motord_hal.modbus.timing import drive_gap_s, line_gap_s
from motord_hal.sim.faults import FaultScript, Spoiled
from motord_hal.sim.rs485.drive import SimulatedDrive
from motord_hal.sim.rs485.framing import framing_of
from motord_hal.sim.rs485.noise import disturb
from motord_hal.sim.rs485.port import MasterSettings, Port
from motord_hal.sim.rs485.wire import Clock, Wire

TURNAROUND_PART = 0.5
"""Part of the longest turn-around in the manual that drives take."""
GAP_TOLERANCE = 0.97
"""Least part of the due silence that is long enough: the clocks of both sides round."""
BABBLE_BYTES_MAX = 3


@dataclass(slots=True)
class WireCounters:
    frames: int = 0
    bad_crc: int = 0
    """Number of frames with a wrong check sum, torn ones, merged ones, and those at a baud rate or
    parity of no unit here; for boards, pieces that were no set-points."""
    replies: int = 0
    gap_violations: int = 0
    """Number of frames after too short a silence. Boards have 0: zeros separate their frames."""
    bits_hit: int = 0
    """Number of bits that noise has changed."""
    plugged: int = 0


@dataclass(slots=True)
class LineCounters(WireCounters):
    unanswered: int = 0
    """Number of requests for units that are absent, without power or silenced."""


class SimulatedWire(abc.ABC):
    """A master on the port, and drives or boards on the wire behind it."""

    def __init__(
        self,
        spec: LineSpec,
        drives: Mapping[int, SimulatedDrive],
        script: FaultScript,
        port: Port,
        counters: WireCounters,
    ) -> None:
        self.spec = spec
        self.drives = drives
        self.port = port
        self.counters = counters
        self._script = script
        self._bits = character_bits(spec.parity, spec.stop_bits)
        self.wire = Wire(port, self._bits / spec.baudrate)

    @abc.abstractmethod
    def _unresponsive(self) -> None:
        """Drop bytes in transit."""

    def plug(self) -> None:
        """Plug the line in, unless it is plugged. Raises OSError."""
        if not self.port.plugged:
            self.port.plug()
            self.counters.plugged += 1
            self._unresponsive()

    def pull(self) -> None:
        self.port.pull()
        self._unresponsive()

    def stats(self) -> dict[str, Any]:
        return {
            **asdict(self.counters),
            "bytes_sent": self.wire.bytes_sent,
            "reply_lateness_us": self.wire.lateness.percentiles(),
            "units": {str(unit): asdict(drive.stats) for unit, drive in self.drives.items()},
        }

    def _disturbed(self, data: bytes, now_s: float) -> bytes:
        for fault in self._script.states("noise", None, now_s):
            data, hits = disturb(data, fault.values["ber"], self._bits, fault.random)
            self.counters.bits_hit += hits
        return data


class SimulatedLine(SimulatedWire):
    """A half-duplex line."""

    counters: LineCounters

    def __init__(
        self,
        spec: LineSpec,
        drives: Mapping[int, SimulatedDrive],
        script: FaultScript,
        port: Port,
    ) -> None:
        super().__init__(spec, drives, script, port, LineCounters())
        self._framing = framing_of(spec.kind)
        self._master: MasterSettings | None = None
        self._unresponsive()

    def _unresponsive(self) -> None:
        self._request = bytearray()
        self._frame_ends_s = math.inf
        self._gap_s = math.inf
        self.wire.unresponsive()
        self._held: list[bytes] = []

    # ------------------------------------------------------------------------------- the poll loop
    def due_s(self, now_s: float) -> float:
        """Return the time of the next call of `work`, with or without bytes."""
        if not self.port.plugged:
            return math.inf
        due_s = min(self._frame_ends_s, self.wire.due_s(), self.port.due_s(now_s))
        for fault in self._script.faults:
            if fault.kind == "babble":
                due_s = min(due_s, fault.waits_until_s)
        return due_s

    def work(self, now_s: float, clock: Clock | None = None) -> None:
        """Take in what has come, and do what is due. `clock` returns the time meanwhile; without
        it, the time stands still."""
        if not self.port.plugged:
            return
        clock = clock or (lambda: now_s)
        connected = self._take_in(now_s, clock)
        if now_s >= self._frame_ends_s:
            self._end_frame(now_s)
        self._babble(now_s, connected=connected)
        self.wire.work(clock)

    # ----------------------------------------------------------------------------- from the master
    def _take_in(self, now_s: float, clock: Clock) -> bool:
        """Take in bytes. Return whether a master is connected. Bytes are stamped after the read, so
        that a silence is never measured shorter than it was."""
        data = self.port.take_in(now_s)
        if data is None:
            self._unresponsive()
        elif data:
            self._receive(data, clock())
        return data is not None

    def _receive(self, data: bytes, now_s: float) -> None:
        if not self._request:
            self._gap_s = now_s - self.wire.free_s
            self._follow_settings()
        starts_s = max(self.wire.free_s, now_s)
        self.wire.receive(len(data), now_s)
        for _ in self._script.states("echo", None, now_s):
            self.wire.send(self._disturbed(data, now_s), starts_s)
        self._request += self._disturbed(data, now_s)
        whole = self._is_whole(bytes(self._request))
        self._frame_ends_s = self.wire.free_s + (0.0 if whole else self._silence_s())

    def _is_whole(self, frame: bytes) -> bool:
        return self._framing.whole(frame)

    def _follow_settings(self) -> None:
        """Make the wire run at the master's baud rate."""
        self._master = self.port.settings()
        baudrate = self.spec.baudrate if self._master is None else self._master.baudrate
        self.wire.character_s = self._bits / baudrate

    def _silence_s(self) -> float:
        return silent_interval_s(round(self._bits / self.wire.character_s), self._bits)

    def _end_frame(self, now_s: float) -> None:
        frame, ended_s = bytes(self._request), self.wire.free_s
        self._request.clear()
        self._frame_ends_s = math.inf
        self.counters.frames += 1
        drive = self.drives.get(frame[0]) if frame else None
        too_early = self._gap_s < GAP_TOLERANCE * self._due_gap_s(drive)
        self.counters.gap_violations += too_early
        for held in self._held:
            self._reply(held, now_s)
        self._held.clear()
        good = self._framing.good(frame) and (drive is None or self._understands(drive, now_s))
        if not good:
            self.counters.bad_crc += 1
            return
        if drive is not None:
            drive.stats.gap_violations += too_early
        self._answer(frame, ended_s, now_s)

    def _due_gap_s(self, drive: SimulatedDrive | None) -> float:
        """Return the silence of the drive's profile, else of the robot file, else of the
        standard."""
        if drive is None or (drive.profile.gap is Gap.SPEC and drive.profile.gap_s is None):
            return line_gap_s(self.spec)
        return drive_gap_s(drive.profile, self.spec)

    def _understands(self, drive: SimulatedDrive, now_s: float) -> bool:
        """Whether the master sends at the drive's baud rate and parity. A port that was never set
        up counts as right."""
        baudrate = self.spec.baudrate
        for fault in self._script.states("wrong-baud", drive.unit, now_s):
            baudrate = int(fault.values["baudrate"])
        if any(True for _ in self._script.states("wrong-parity", drive.unit, now_s)):
            return False
        if self._master is None:
            return baudrate == self.spec.baudrate
        odd_fits = self._master.odd_parity == (self.spec.parity == "odd")
        return self._master.baudrate == baudrate and odd_fits

    # ----------------------------------------------------------------------------- from the drives
    def _answer(self, frame: bytes, ended_s: float, now_s: float) -> None:
        broadcast = self._framing.is_broadcast(frame)
        hearing = {
            unit: drive
            for unit, drive in self.drives.items()
            if (broadcast or unit == frame[0])
            and drive.receives(now_s)
            and self._understands(drive, now_s)
            and not self._script.silent(unit, now_s)
        }
        answered = self._framing.answer(frame, hearing, now_s)
        for unit, drive in hearing.items():
            if drive.takes_setting() and (fault := self._script.flash(unit, now_s)):
                drive.flash(now_s + fault.values["ms"] / 1000.0, busy=bool(fault.values["busy"]))
        if answered is None:
            self.counters.unanswered += not broadcast and self._framing.is_answered(frame)
            return
        unit = answered.drive.unit
        spoiled = self._script.spoil(unit, answered.frame, self._framing, now_s)
        self._send_spoiled(spoiled, answered.drive, ended_s, now_s)

    def _send_spoiled(
        self, spoiled: Spoiled, drive: SimulatedDrive, ended_s: float, now_s: float
    ) -> None:
        self.port.segments_s = spoiled.segments_s
        if spoiled.held and not self.port.hold_reply():
            self._held.append(spoiled.frame)
            return
        starts_s = ended_s + self._turnaround_s(drive, now_s) + spoiled.delay_s
        muted_s = ended_s + spoiled.deafening_s - starts_s
        lost = max(0, math.ceil(muted_s / self.wire.character_s))
        if lost < len(spoiled.frame):
            received = self._disturbed(spoiled.frame[lost:], now_s)
            self._reply(received, starts_s + lost * self.wire.character_s)

    def _turnaround_s(self, drive: SimulatedDrive, now_s: float) -> float:
        given_s = self._script.turnaround_s(drive.unit, now_s)
        return TURNAROUND_PART * drive.profile.turnaround_s if given_s is None else given_s

    def _reply(self, frame: bytes, starts_s: float) -> None:
        self.wire.send(frame, starts_s)
        self.counters.replies += 1

    def _babble(self, now_s: float, *, connected: bool) -> None:
        """Put random bytes on the wire if a fault demands it. The master receives them, and so do
        the drives while a request comes in."""
        for fault in self._script.faults:
            if fault.kind != "babble" or now_s < fault.waits_until_s:
                continue
            if connected and fault.matches(None, now_s):
                fault.fired += 1
                data = fault.random.randbytes(fault.random.randint(1, BABBLE_BYTES_MAX))
                self.wire.send(data, now_s)
                if self._request:
                    self._request += data
            fault.waits_until_s = now_s + fault.random.expovariate(fault.values["hz"])
