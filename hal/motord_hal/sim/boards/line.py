# SPDX-License-Identifier: Apache-2.0
"""Simulated boards on a serial port. Each receives a stream of set-points and sends a stream of
feedback."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator, Mapping
from typing import Protocol

from motord_hal.fieldbus.ports import LineSpec
from motord_hal.sim.faults import FaultScript
from motord_hal.sim.rs485.content import NamedContent
from motord_hal.sim.rs485.drive import SimulatedDrive
from motord_hal.sim.rs485.framing import Unaddressed
from motord_hal.sim.rs485.line import SimulatedWire, WireCounters
from motord_hal.sim.rs485.port import MasterSettings, Port
from motord_hal.sim.rs485.wire import Clock


class Talk(Protocol):
    """Protocol by which a board reads and writes bytes."""

    feedback_s: float
    """Time from one feedback to the next; infinity: no feedback."""

    def power_up(self) -> None: ...

    def feed(self, data: bytes, now_s: float) -> Iterator[dict[str, int] | None]:
        """Yield register → raw value for each set-points message; None for bytes that are no
        message."""
        ...

    def feedback(self, content: NamedContent, now_s: float) -> bytes: ...


class _Board:
    """One drive, and the protocol on its wire."""

    def __init__(self, drive: SimulatedDrive, talk: Talk) -> None:
        self.drive = drive
        self.talk = talk
        self._reboots = 0
        self._fed_back_s = 0.0

    @property
    def due_s(self) -> float:
        """Time at which the next feedback is due."""
        return self._fed_back_s + self.talk.feedback_s

    def is_awake(self) -> bool:
        """Whether the board has power. When it comes back, the board has lost its memory."""
        if self.drive.on and self.drive.stats.reboots != self._reboots:
            self._reboots = self.drive.stats.reboots
            self.talk.power_up()
        return self.drive.on

    def feedback(self, now_s: float, *, silent: bool) -> bytes:
        """Return the next feedback; empty: the board has no feedback, or is silent."""
        self._fed_back_s = now_s
        content = self.drive.registers
        if silent or not self.is_awake() or not isinstance(content, NamedContent):
            return b""
        return self.talk.feedback(content, now_s)


class SimulatedBoard(SimulatedWire):
    """A line like `SimulatedLine`, with one board on it, or several that only receive."""

    def __init__(
        self,
        spec: LineSpec,
        drives: Mapping[int, SimulatedDrive],
        script: FaultScript,
        port: Port,
        talks: Mapping[int, Talk],
    ) -> None:
        """Set the line up. `talks`: address of a board → its protocol."""
        super().__init__(spec, drives, script, port, WireCounters())
        self._boards = [_Board(drives[unit], talk) for unit, talk in talks.items()]
        self._incoming: deque[tuple[float, bytes]] = deque()

    def _unresponsive(self) -> None:
        self.wire.unresponsive()
        self._incoming.clear()

    # ------------------------------------------------------------------------------- the poll loop
    def due_s(self, now_s: float) -> float:
        """Return the time of the next call of `work`, with or without bytes."""
        if not self.port.plugged:
            return math.inf
        received_s = self._incoming[0][0] if self._incoming else math.inf
        port_s = self.port.due_s(now_s)
        return min(received_s, self.wire.due_s(), port_s, *(one.due_s for one in self._boards))

    def work(self, now_s: float, clock: Clock | None = None) -> None:
        """Take in what has come, and do what is due."""
        if not self.port.plugged:
            return
        data = self.port.take_in(now_s)
        if data is None:
            self._unresponsive()
        elif data:
            self._receive(data, now_s)
        while self._incoming and self._incoming[0][0] <= now_s:
            self._obey(self._incoming.popleft()[1], now_s)
        for board in self._boards:
            if now_s >= board.due_s:
                self._feed_back(board, now_s, connected=data is not None)
        self.wire.work(clock or (lambda: now_s))

    # -------------------------------------------------------------------------- what comes and goes
    def _receive(self, data: bytes, now_s: float) -> None:
        """Queue the bytes for the time when they would have passed the wire. Each direction has its
        own wire."""
        settings = self.port.settings()
        if not self._fits(settings):
            self.counters.bad_crc += 1
            return
        before_s = self._incoming[-1][0] if self._incoming else now_s
        over_s = max(before_s, now_s) + len(data) * self.wire.character_s
        self._incoming.append((over_s, self._disturbed(data, now_s)))

    def _fits(self, settings: MasterSettings | None) -> bool:
        return settings is None or settings.baudrate == self.spec.baudrate

    def _obey(self, data: bytes, now_s: float) -> None:
        """Hand the bytes to each board, which uses only its own."""
        for board in self._boards:
            if not board.is_awake():
                continue
            for written in board.talk.feed(data, now_s):
                self.counters.frames += 1
                if written is None:
                    self.counters.bad_crc += 1
                else:
                    board.drive.obey(written, now_s)

    def _feed_back(self, board: _Board, now_s: float, *, connected: bool) -> None:
        silent = not connected or self._script.silent(board.drive.unit, now_s)
        sent = board.feedback(now_s, silent=silent)
        if not sent:
            return
        spoiled = self._script.spoil(board.drive.unit, sent, Unaddressed(), now_s)
        if spoiled.frame:
            self.counters.replies += 1
            held_s = board.talk.feedback_s if spoiled.held else 0.0
            received = self._disturbed(spoiled.frame, now_s)
            self.wire.send(received, now_s + spoiled.delay_s + held_s)
