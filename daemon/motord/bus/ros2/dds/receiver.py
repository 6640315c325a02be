# SPDX-License-Identifier: Apache-2.0
"""Passes commands from DDS to the daemon without Python between them: the thread of Cyclone DDS
that receives a cmd_vel calls `_motord_bus`, which checks it as the command gate does, and sends it
under the input's lease (csrc/bus/bus_receiver.c). Python learns of the command afterwards, for the
log, the figures and the motions.
"""

from __future__ import annotations

import asyncio
import logging
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from importlib.metadata import PackageNotFoundError, version
from typing import Any, Protocol

from motord.api.deadline import within
from motord.bus.commands.gate import AHEAD, ZERO_STAMP, CommandGate
from motord.bus.commands.link import NO_LEASE, SOCKET_FULL
from motord.bus.ros2.dds.priority import before_python
from motord.bus.ros2.quality import Quality

TYPE = "geometry_msgs/msg/TwistStamped"
NEWEST_FEW = Quality(depth=8, reliable=False)
"""Quality of service of cmd_vel. The commands are passed on in their order, and each has a stamp,
so that an old one is refused."""
TRIED = ("11.",)
"""Beginnings of the binding's versions whose C library is known to have the functions that
`_motord_bus` calls."""
ALIVE_EVERY_S = 0.2
_HUNG = "the event loop of motord-bus did not run for 2 s, so a stop would not have been handled"
_BROKEN = "the daemon's command socket does not take it"

_log = logging.getLogger(__name__)


class Endpoint(Protocol):
    """A reader on DDS."""

    entity: Any


def library() -> Any | None:
    """Return `_motord_bus`, connected to the C library of the binding. If it cannot be used, log
    the reason and return None: commands go through Python then."""
    try:
        found = version("cyclonedds")
        if not found.startswith(TRIED):
            raise ImportError(f"cyclonedds {found} has not been tried")
        import _motord_bus
        from cyclonedds.internal import load_cyclonedds

        path = load_cyclonedds()._name  # noqa: SLF001  ctypes keeps it there
        if _motord_bus.lib.receiver_library(os.fsencode(path)) != 0:
            raise ImportError(f"{path} lacks a function that is needed")
    except (ImportError, PackageNotFoundError) as error:
        _log.warning("cmd_vel goes through Python and waits while Python is busy: %s", error)
        return None
    return _motord_bus


class Receiver:
    """Receiver of one topic under one lease, while it is open. It implements
    `motord.bus.commands.link.Outlet`."""

    def __init__(self, made: Any, entity: Any) -> None:
        """`made`: what `library` returned. `entity`: the reader."""
        self._ffi, self._lib = made.ffi, made.lib
        self._entity = entity
        self._number = -1
        self._event_fd = -1

    @contextmanager
    def open(self) -> Iterator[int]:
        """Take commands; yield a descriptor that becomes readable when a command arrives. Raises
        OSError."""
        self._event_fd = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
        try:
            self._number = self._checked(self._lib.receiver_claim(), "no receiver is left")
            reader = self._entity._ref  # noqa: SLF001  the binding has no name for it
            start = self._lib.receiver_start(self._number, reader, self._event_fd)
            self._checked(start, "DDS takes no listener for cmd_vel")
            yield self._event_fd
        finally:
            self._lib.receiver_stop(self._number)
            os.close(self._event_fd)
            self._lib.receiver_release(self._number)
            self._number = self._event_fd = -1

    @staticmethod
    def _checked(code: int, what: str) -> int:
        if code < 0:
            raise OSError(-code, f"{what} ({code})")
        return code

    # ------------------------------------------------------------------------------ what came
    def newest_report(self) -> Any:
        """Reset the descriptor of `open`, and return the newest receiver_report."""
        with suppress(BlockingIOError):
            os.eventfd_read(self._event_fd)
        report = self._ffi.new("receiver_report *")
        self._lib.receiver_read(self._number, report)
        return report

    def received(self) -> Any:
        """Return each received_twist that was not read yet. One call reads all of them, because
        each call waits for the GIL when other threads are busy."""
        room = self._lib.RECEIVED_TWISTS_MAX
        found = self._ffi.new("received_twist[]", room)
        return found[0 : self._lib.receiver_take_received(self._number, found, room)]

    # ------------------------------------------------------------------------------ its lease
    def alive(self) -> None:
        """Report that the event loop runs: without a report for 2 s the receiver passes nothing
        on."""
        self._lib.receiver_alive(self._number)

    @property
    def direct(self) -> int:
        """Implement `Outlet.direct`."""
        return int(self._lib.receiver_direct(self._number))

    def hold(self, fd: int, token: bytes, sequence: int) -> None:
        """Implement `Outlet.hold`."""
        self._lib.receiver_hold(self._number, fd, token, sequence)

    def let_go(self) -> int:
        """Implement `Outlet.let_go`."""
        return int(self._lib.receiver_let_go(self._number))

    def send(self, raw: bytes, seen: int) -> int:
        """Implement `Outlet.send`."""
        return int(
            self._lib.receiver_send(self._number, self._ffi.new("uint8_t[]", raw), len(raw), seen)
        )


class Twists:
    """Takes cmd_vel of one input from a `Receiver`."""

    def __init__(
        self,
        made: Any,
        reader: Endpoint,
        gate: CommandGate,
        taken: Callable[[int, tuple[float, float, float], float], None],
    ) -> None:
        """`taken` is called for each command that the daemon received: the writer's DDS handle, the
        twist in m/s, rad/s and m/s sideways, and the time (time.monotonic)."""
        self._receiver = Receiver(made, reader.entity)
        self._gate = gate
        self._taken = taken
        self._counts: dict[str, int] = {}

    async def run(self) -> None:
        """Receive until cancelled. Raises OSError when DDS fails."""
        loop = asyncio.get_running_loop()
        arrived = asyncio.Event()
        source = self._gate.source
        self._counts = {}
        with self._receiver.open() as fd:
            try:
                loop.add_reader(fd, arrived.set)
                source.lend(self._receiver)
                before_python()
                while True:
                    self._receiver.alive()
                    with suppress(TimeoutError):
                        async with within(ALIVE_EVERY_S):
                            await arrived.wait()
                    arrived.clear()
                    self.look()
            finally:
                source.lend(None)
                loop.remove_reader(fd)

    def look(self) -> None:
        """Report the commands and counts since the last call. Raises OSError when DDS fails."""
        report = self._receiver.newest_report()
        for one in self._receiver.received():
            command = (one.linear_m_s, one.angular_rad_s, one.lateral_m_s)
            self._taken(one.writer, command, one.taken_ns * 1e-9)
        source = self._gate.source
        source.sent += self._more("taken", report.taken)
        for why, count in (
            (NO_LEASE, report.unleased), (_HUNG, report.hung), (SOCKET_FULL, report.full),
            (_BROKEN, report.broken),
        ):  # fmt: skip
            more = self._more(why, count)
            source.lost += more
            self._gate.refuse(why, more)
        not_one = f"it is no {TYPE}"
        for why, count in zip((not_one, ZERO_STAMP, AHEAD), report.refused, strict=True):
            self._gate.refuse(why, self._more(why, count))
        if not report.running:
            raise OSError(f"reading cmd_vel from DDS failed ({report.error})")

    def _more(self, what: str, count: int) -> int:
        before, self._counts[what] = self._counts.get(what, 0), count
        return count - before
