# SPDX-License-Identifier: Apache-2.0
"""Stop, emergency stop and disarm as a datagram that the real-time loop itself reads:
docs/commands.md. It needs no connection, so no other client can block it. The state page shows
whether the loop can read it: a daemon that hangs lives, but its loop does not tick.

It needs the standard library alone. Layout: stop_request in csrc/api/api.h."""

from __future__ import annotations

import contextlib
import errno
import os
import socket
import struct
import time
from collections.abc import Generator
from dataclasses import dataclass
from pathlib import Path

from motord.api.local_rpc import ClientError
from motord.api.page_file import PAGE, writer_lives, writer_pid
from motord.api.state_page import NoPage, StatePage

MAGIC = 0x5153544D
VERSION = 1
KINDS = {"stop": 0, "estop": 1, "disarm": 2}
"""Number of each request, by the method of the local socket."""
AGAIN_S = 0.001
RECOVERS_WITHIN_S = 1.0
"""Time in which a daemon that does not tick may still answer."""
STANDS_STILL_S = 0.2
"""Time without a tick after which a daemon counts as hung."""
PERIODS = 3
"""Periods of the loop in that time, at least: the slowest loop ticks every 0.1 s."""
PERIODS_MAX_S = 0.5
LOOK_EVERY_S = 0.005
LOOK_COUNTS_S = 0.02
"""Time that one look adds at most: if this process was held up, the daemon may have been, too."""
_STATES = {
    "T": "stopped by a signal",
    "t": "stopped by a debugger",
    "D": "waits in the kernel",
    "Z": "is ending",
}
"""Meaning of a letter in /proc/PID/stat, if it explains a hang (proc_pid_stat(5))."""
_LAYOUT = struct.Struct("=IHH")
_FULL = (errno.EAGAIN, errno.ENOBUFS, errno.ENOMEM, errno.EINTR)


def datagram(method: str) -> bytes:
    """Return the datagram for a method of KINDS."""
    return _LAYOUT.pack(MAGIC, VERSION, KINDS[method])


def stop_socket(local_socket: Path) -> Path:
    """Return the socket for stop requests of the daemon with this local socket."""
    return local_socket.with_name(f"{local_socket.name.removesuffix('.sock')}.stop.sock")


def page_link(local_socket: Path) -> Path:
    """Return the link to the daemon's state page, beside its local socket."""
    return local_socket.with_name(f"{local_socket.name.removesuffix('.sock')}.page")


def open_sender() -> socket.socket:
    """Return an unconnected socket: it stays usable when the daemon restarts, and sending needs no
    further descriptor."""
    return socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK)


def try_send(sender: socket.socket, local_socket: Path, method: str) -> bool:
    """Send the request once. False: the receive queue is full, try again. Raises OSError for any
    other failure: no daemon receives there, or this user may not stop it."""
    try:
        sender.sendto(datagram(method), str(stop_socket(local_socket)))
    except OSError as error:
        if error.errno in _FULL:
            return False
        raise
    return True


def send(local_socket: Path, method: str, within_s: float) -> None:
    """Send the request; retry while the receive queue is full. Raises OSError and TimeoutError."""
    end_s = time.monotonic() + within_s
    with open_sender() as sender:
        while not try_send(sender, local_socket, method):
            if time.monotonic() > end_s:
                raise TimeoutError(errno.ETIMEDOUT, "the receive queue stays full")
            time.sleep(AGAIN_S)


@dataclass(frozen=True, slots=True)
class Hang:
    """A daemon that hangs."""

    page: Path
    """Path of its state page."""
    pid: int | None
    """Its process. None: /proc does not show it here."""
    stamp_ns: int
    """Stamp of its last tick."""
    age_s: float
    """Time since that tick."""

    @property
    def robot(self) -> str:
        """Name of the robot."""
        return self.page.name.removesuffix(PAGE)

    def __str__(self) -> str:
        process = "process not visible to this user"
        if self.pid is not None:
            process = ", ".join(filter(None, (f"process {self.pid}", _state_of(self.pid))))
        return (
            f"the daemon of {self.robot} hangs ({process}): its state page has stood still for "
            f"{self.age_s:.1f} s"
        )


class Standstill:
    """Watches a page for ticks: `look` every LOOK_EVERY_S. `now_s`: CLOCK_MONOTONIC."""

    def __init__(self, page: StatePage, now_s: float) -> None:
        self._page = page
        self._published = page.published
        self._looked_s = now_s
        self._still_s = 0.0
        self.ticked = False
        """Whether a tick was seen."""

    def look(self, now_s: float) -> None:
        """Count the time since the last look, or begin again after a tick."""
        published = self._page.published
        if published != self._published:
            self._published, self._still_s, self.ticked = published, 0.0, True
        else:
            self._still_s += min(now_s - self._looked_s, LOOK_COUNTS_S)
        self._looked_s = now_s

    @property
    def is_still(self) -> bool:
        """Whether no tick was seen for STANDS_STILL_S."""
        return self._still_s >= STANDS_STILL_S

    def hang(self) -> Hang | None:
        """Return the hang, if there was no tick for long enough and the daemon lives. None also
        before its first tick, when nothing is armed yet."""
        if not self.is_still or (snapshot := self._page.read()) is None:
            return None
        age_s = (time.monotonic_ns() - snapshot.stamp_ns) * 1e-9
        periods_s = min(PERIODS * snapshot.dt_s, PERIODS_MAX_S)
        if not age_s >= max(STANDS_STILL_S, periods_s):
            return None
        if not writer_lives(self._page.path):
            return None
        return Hang(self._page.path, writer_pid(self._page.path), snapshot.stamp_ns, age_s)


def _state_of(pid: int) -> str:
    """Return why a process may hang; empty: the kernel shows no reason."""
    with contextlib.suppress(OSError, IndexError):
        stat = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8", errors="replace")
        return _STATES.get(stat.rpartition(")")[2].split()[0], "")
    return ""


class NoAnswer(ClientError):
    """The daemon does not answer."""


class DaemonHangs(NoAnswer):
    """The daemon lives, but does not tick."""

    def __init__(self, method: str, hang: Hang) -> None:
        super().__init__(
            f"{method}: not confirmed: {hang}: cut the power by hand, or motord estop --force "
            f"--robot {hang.robot}, which ends the daemon and stops the drives"
        )
        self.hang = hang


def page_of(local_socket: Path) -> StatePage:
    """Open the state page of the daemon with this socket. Raises NoPage and OSError."""
    link, robot = page_link(local_socket), local_socket.name.removesuffix(".sock")
    with contextlib.suppress(OSError):
        robot = Path(os.readlink(link)).name.removesuffix(PAGE)
    return StatePage.open(robot, owner=stop_socket(local_socket).lstat().st_uid)


def until_tick(local_socket: Path, method: str) -> Generator[None]:
    """Yield until the daemon's loop is seen to tick: sleep for LOOK_EVERY_S after each. Ends at
    once where nothing shows it: there is no page, or no daemon any more. Raises DaemonHangs if
    there is no tick for STANDS_STILL_S, and for RECOVERS_WITHIN_S after it."""
    with contextlib.suppress(NoPage, OSError), page_of(local_socket) as page:
        standstill, given_up_s = Standstill(page, time.monotonic()), None
        while not standstill.ticked and page.read() is not None:
            yield
            now_s = time.monotonic()
            standstill.look(now_s)
            if standstill.is_still and not writer_lives(page.path):
                return
            if (hang := standstill.hang()) is not None:
                given_up_s = given_up_s or now_s + RECOVERS_WITHIN_S
                if now_s >= given_up_s:
                    raise DaemonHangs(method, hang)
