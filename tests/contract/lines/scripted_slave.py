# SPDX-License-Identifier: Apache-2.0
"""A Modbus RTU slave on a pty that a test scripts: real bytes, honest by default."""

from __future__ import annotations

import asyncio
import functools
import os
import time
import tty
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from motord_hal.modbus.codec import (
    Function,
    Request,
    build_exception,
    build_reply,
    parse_request,
    request_bytes,
)

Bytes = list[tuple[float, bytes]]
"""Pieces to send: for each a delay in seconds, and its bytes."""
Trick = Callable[[Request, bytes], Bytes]
"""Function that gets a request and the honest reply, and returns what is sent instead."""


@dataclass
class Received:
    at_s: float
    request: Request


@dataclass
class Unit:
    """Registers of one drive; `on_write(address, value)` may change them after a write."""

    registers: dict[int, int] = field(default_factory=dict)
    on_write: Callable[[int, int], None] | None = None
    silent: bool = False
    loses: int = 0
    """How many of its next requests are lost."""
    refuses: set[int] = field(default_factory=set)
    """Register addresses to which an access is answered with exception 2."""


class ScriptedSlave:
    """Slave that answers on `path` (a symlink to its pty) from the running event loop."""

    def __init__(self, path: Path, engine: str = "asyncio") -> None:
        self.path = path
        self.engine = engine
        """Engine of the line that the test runs against this slave."""
        self.kind = "modbus-rtu"
        self.units: dict[int, Unit] = {1: Unit()}
        self.tricks: deque[Trick] = deque()
        self.received: list[Received] = []
        self.answered_at_s: list[float] = []
        self._buffer = b""
        self._timers: list[asyncio.TimerHandle] = []
        self._master = -1
        self.plug()

    def plug(self) -> None:
        """Plug the adapter in: open a new pty and point the link to it."""
        self._master, slave = os.openpty()
        tty.setraw(slave)
        os.set_blocking(self._master, False)
        fresh = self.path.with_name(self.path.name + ".new")
        fresh.symlink_to(os.ttyname(slave))
        fresh.rename(self.path)
        self._slave = slave
        asyncio.get_running_loop().add_reader(self._master, self._readable)

    def pull(self) -> None:
        """Unplug the adapter: close the pty and remove the link."""
        if self._master < 0:
            return
        for timer in self._timers:
            timer.cancel()
        asyncio.get_running_loop().remove_reader(self._master)
        os.close(self._slave)
        os.close(self._master)
        self._master, self._buffer = -1, b""
        self.path.unlink()

    def send(self, data: bytes) -> None:
        self.answered_at_s.append(time.monotonic())
        os.write(self._master, data)

    def requests(self, unit: int | None = None) -> list[Request]:
        return [h.request for h in self.received if unit is None or h.request.unit == unit]

    def written(self, address: int, unit: int = 1) -> list[int]:
        """Return every value that was written to a register, in order."""
        values = []
        for request in self.requests(unit):
            both = request.function is Function.READ_WRITE
            offset = address - (request.write_address if both else request.address)
            if 0 <= offset < len(request.values):
                values.append(request.values[offset])
        return values

    def _readable(self) -> None:
        try:
            self._buffer += os.read(self._master, 4096)
        except (BlockingIOError, OSError):
            return  # no program has the other end open
        while (size := request_bytes(self._buffer)) and len(self._buffer) >= size:
            frame, self._buffer = self._buffer[:size], self._buffer[size:]
            self._serve(parse_request(frame))

    def _serve(self, request: Request) -> None:
        self.received.append(Received(time.monotonic(), request))
        if request.unit == 0:
            return
        unit = self.units.get(request.unit)
        if unit is None or unit.silent:
            return
        if unit.loses:
            unit.loses -= 1
            return
        honest = self._honest(unit, request)
        out = self.tricks.popleft()(request, honest) if self.tricks else [(0.0, honest)]
        for delay_s, data in out:
            if delay_s:
                self.later(delay_s, functools.partial(self.send, data))
            else:
                self.send(data)

    def later(self, delay_s: float, do: Callable[[], None]) -> None:
        """Call `do` after this time, unless the adapter is pulled before."""
        self._timers.append(asyncio.get_running_loop().call_later(delay_s, do))

    def _honest(self, unit: Unit, request: Request) -> bytes:
        count = request.count or len(request.values)
        span = range(request.address, request.address + count)
        if any(a not in unit.registers or a in unit.refuses for a in span):
            return build_exception(request.unit, request.function, 2)
        if request.function is Function.READ_HOLDING:
            return build_reply(request, tuple(unit.registers[a] for a in span))
        both = request.function is Function.READ_WRITE
        begin = request.write_address if both else request.address
        for address, value in enumerate(request.values, begin):
            unit.registers[address] = value
            if unit.on_write:
                unit.on_write(address, value)
        return build_reply(request, tuple(unit.registers[a] for a in span) if both else ())
