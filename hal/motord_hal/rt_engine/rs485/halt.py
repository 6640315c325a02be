# SPDX-License-Identifier: Apache-2.0
"""Stopping the drives of a serial line without a daemon, by the line's own thread: gaps, echo and
the transceiver's direction are its business."""

from __future__ import annotations

import asyncio
import contextlib
import os
from collections.abc import AsyncIterator, Mapping

from motord_hal.base.errors import PortError
from motord_hal.fieldbus.halt import halt_unit
from motord_hal.fieldbus.ports import LineSpec
from motord_hal.realtime.exchange import Exchange
from motord_hal.realtime.line import LineThread, ThreadSpec
from motord_hal.rt_engine.notifier import Notifier
from motord_hal.rt_engine.rs485.frames import DriveFrames
from motord_hal.rt_engine.rs485.protocols import frames_of
from motord_hal.rt_engine.rs485.request_queue import RequestQueue
from motord_hal.rt_engine.rs485.table import line_table
from motord_hal.serial.port import open_port

SLOT_WITHIN_S = 0.5
"""So long a request may wait for its turn on the wire."""


class _Unit:
    """halt.Unit by requests outside the cycle."""

    def __init__(
        self, index: int, frames: DriveFrames, queue: RequestQueue, rest_velocity_rad_s: float
    ) -> None:
        self.name = ", ".join(joint.name for joint in frames.joints)
        self.profile = frames.profile
        self.rest_velocity_rad_s = rest_velocity_rad_s
        self._index = index
        self._frames = frames
        self._queue = queue
        given_s = (joint.reply_timeout_s for joint in frames.joints)
        self._turnaround_s = max((s for s in given_s if s), default=self.profile.turnaround_s)

    async def write(self, raw: Mapping[str, int]) -> None:
        for frame in self._frames.writes(raw):
            await self._queue.send(self._index, frame, self._turnaround_s, urgent=True)

    async def read(self, register: str) -> int:
        frame = self._frames.read(register)
        reply = await self._queue.send(self._index, frame, self._turnaround_s)
        return self._frames.raw(register, reply)


async def halt_line(spec: LineSpec) -> list[str]:
    """All drives at once. Returns what was not acknowledged, in words. Raises HalError: PortError
    where the port cannot be had."""
    frames = frames_of(spec)
    thread = LineThread(spec.index, Exchange.private())
    queue = RequestQueue(spec.name, thread, SLOT_WITHIN_S)
    rest_rad_s = spec.rest_velocity_rad_s
    units = [_Unit(index, each, queue, rest_rad_s) for index, each in enumerate(frames)]
    async with _running(spec, thread, frames, queue):
        problems = await asyncio.gather(*map(halt_unit, units))
    return [problem for problem in problems if problem]


@contextlib.asynccontextmanager
async def _running(
    spec: LineSpec, thread: LineThread, frames: list[DriveFrames], queue: RequestQueue
) -> AsyncIterator[None]:
    """The thread on its port, with a task that hands out its answers."""
    notifier, port = Notifier(), open_port(spec)
    with contextlib.ExitStack() as undo:
        undo.callback(port.close)
        notifier.open()
        undo.callback(notifier.close)
        place = ThreadSpec.of(spec, fd=port.fd, de_fd=port.de_fd, event_fd=notifier.event_fd)
        thread.start(place, line_table(spec, frames))
        undo.callback(thread.stop)
        async with asyncio.TaskGroup() as tasks:
            attending = tasks.create_task(_attend(spec, thread, notifier, queue))
            yield
            attending.cancel()


async def _attend(
    spec: LineSpec, thread: LineThread, notifier: Notifier, queue: RequestQueue
) -> None:
    """Until the port goes away: then every caller that waits gets the error."""
    while (report := thread.report()).running:
        queue.take_answers()
        await notifier.wait()
    queue.lose(PortError(f"{spec.port} went away: {os.strerror(report.error)}"))
