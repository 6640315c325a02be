# SPDX-License-Identifier: Apache-2.0
"""From the second process to the daemon: calls on its local socket, and commands under a lease.

Every call has a connection and a deadline of its own; a request to stop the robot is sent as a
datagram first. A lease lives as long as its connection; when the daemon ends it, this process
requests another one. A command gets no answer: docs/commands.md.
"""

from __future__ import annotations

import asyncio
import contextlib
import errno
import logging
import os
import socket
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Protocol

from motord.aio import Client, send_stop
from motord.api.commands import RELEASE, TWIST, datagram, joint_datagram, position_datagram
from motord.api.local_rpc import ClientError
from motord.api.stop_request import open_sender

CALL_WITHIN_S = 10.0
LEASE_WITHIN_S = 5.0
LEASE_AGAIN_S = 0.5

_log = logging.getLogger(__name__)


REASON_CHARS_MAX = 300
"""Largest length of an emergency stop's reason; the daemon refuses longer ones."""


def reason(text: str) -> dict[str, str]:
    """Return the parameters of an emergency stop with that reason."""
    return {"why": text[:REASON_CHARS_MAX]}


NO_LEASE = "there is no lease: the daemon does not take commands now"
SOCKET_FULL = (
    "the daemon's command socket is full: commands come faster than its loop takes them; the next "
    "one counts"
)


ALL_SEEN = -1
"""Value of `seen`: send the command even if other commands were sent meanwhile."""


async def call(path: Path, method: str, **params: Any) -> Any:
    """Call a method, on a connection of its own. Raises Refused and ClientError."""
    async with Client(path, timeout_s=CALL_WITHIN_S) as daemon:
        return await daemon.call(method, **params)


class StopSender:
    """Sends stop requests (motord.api.stop_request) from a socket that is opened beforehand, so
    that a stop needs no new descriptor."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._socket: socket.socket | None = None

    @contextlib.contextmanager
    def open(self) -> Iterator[None]:
        """Open the socket, and keep it while the context lasts."""
        with open_sender() as self._socket:
            try:
                yield
            finally:
                self._socket = None

    async def send(self, method: str) -> bool:
        """Send a request; return False if the daemon does not receive it."""
        return self._socket is not None and await send_stop(self._socket, self._path, method)


class Outlet(Protocol):
    """Sends commands under a lease in place of `Source`, and commands of its own among them: it
    numbers all of them."""

    @property
    def direct(self) -> int:
        """Number of commands of its own that it has sent."""
        ...

    def hold(self, fd: int, token: bytes, sequence: int) -> None:
        """Begin a lease. `fd`: its connected socket; `sequence`: the number of its newest
        command."""
        ...

    def let_go(self) -> int:
        """End the lease and return the number of its newest command. The socket of the lease is not
        used any more."""
        ...

    def send(self, raw: bytes, seen: int) -> int:
        """Send a datagram, in which it fills in token and number. `seen` >= 0: send only while
        `direct` has that value. Return 0; -ENOTCONN: no lease; -ESTALE: `direct` has grown;
        -EAGAIN: the socket is full; or another -errno."""
        ...


class Source:
    """One input's right to command. `run` keeps the lease; `drive` and `release` never wait."""

    def __init__(self, path: Path, owner: str) -> None:
        """`owner`: name of the input in the robot file, whose priority and lifetime apply."""
        self._path = path
        self.owner = owner
        self._token: bytes | None = None
        self.number = 0
        """Number of the lease on the state page; 0: no lease."""
        self._sequence = 0
        self._failing = False
        self._sender: socket.socket | None = None
        self._outlet: Outlet | None = None
        self.sent = 0
        self.lost = 0
        """Number of commands for which there was no lease, or that the socket did not take."""
        self.why_lost = NO_LEASE
        """Why the newest lost command was lost."""
        self.rivals: Callable[[], dict[str, Any]] = dict
        """Returns the senders of this input that command against each other, by topic."""
        self.refused = 0
        """Number of commands and calls that were not passed on; the input counts them."""

    @property
    def ready(self) -> bool:
        """Whether there is a lease."""
        return self._token is not None

    async def run(self) -> None:
        """Keep a lease until cancelled."""
        while True:
            try:
                async with Client(self._path, timeout_s=LEASE_WITHIN_S) as daemon:
                    await self._hold(await self._grant(daemon), daemon)
            except (ClientError, OSError) as error:
                self._say(str(error))
            await asyncio.sleep(LEASE_AGAIN_S)

    async def _grant(self, daemon: Client) -> dict[str, Any]:
        """Request a lease on a connection. Raises ClientError."""
        grant: dict[str, Any] = await daemon.call("lease", owner=self.owner)
        return grant

    async def _hold(self, grant: dict[str, Any], daemon: Client) -> None:
        """Send commands under the lease until the daemon ends it."""
        kind = socket.SOCK_DGRAM | socket.SOCK_NONBLOCK
        with socket.socket(socket.AF_UNIX, kind) as sender:
            sender.connect(grant["socket"])
            self._token, self._sequence = bytes.fromhex(grant["token"]), 0
            self.number = grant["number"]
            self._sender = sender
            self._hand_over()
            if self._failing:
                self._failing = False
                _log.info("input.%s: has its lease again", self.owner)
            try:
                await daemon.ended()
            finally:
                if self._outlet is not None:
                    self._outlet.let_go()
                self._token = self._sender = None
                self.number = 0

    def lend(self, outlet: Outlet | None) -> None:
        """Send commands through `outlet` from now on; None: through this object again."""
        if self._outlet is not None:
            self._sequence = max(self._sequence, self._outlet.let_go())
        self._outlet = outlet
        self._hand_over()

    def _hand_over(self) -> None:
        if self._outlet is not None and self._token is not None and self._sender is not None:
            self._outlet.hold(self._sender.fileno(), self._token, self._sequence)

    @property
    def direct(self) -> int:
        """Number of commands under this lease that the outlet has sent by itself, not through
        `drive`."""
        return 0 if self._outlet is None else self._outlet.direct

    def drive(
        self,
        linear_m_s: float,
        angular_rad_s: float,
        stamp_ns: int | None = None,
        *,
        lateral_m_s: float = 0.0,
        sender: int = 0,
        seen: int = ALL_SEEN,
    ) -> bool:
        """Send one command; return whether it was sent. `stamp_ns`: when it was given,
        CLOCK_MONOTONIC; now unless given. `sender`: its number among those of this input; 0: the
        input itself. `seen`: do not send if `direct` has grown beyond this."""
        stamp_ns = time.monotonic_ns() if stamp_ns is None else stamp_ns
        twist = (linear_m_s, angular_rad_s, lateral_m_s)
        return self._send_twist(TWIST, twist, stamp_ns, sender, seen)

    def drive_joints(self, velocity_rad_s: Sequence[float], stamp_ns: int, sender: int = 0) -> bool:
        """Send one command of all wheels, in the order of the robot file; see `drive`."""
        return self._send(
            lambda token, sequence: joint_datagram(
                token, sequence, stamp_ns, velocity_rad_s, sender=sender
            )
        )

    def drive_free_joints(
        self,
        joint_count: int,
        velocity_rad_s: Mapping[int, float],
        position_rad: Mapping[int, float],
        stamp_ns: int,
        sender: int = 0,
    ) -> bool:
        """Send one command of joints without a base; its numbers are by place in the robot file.
        See `drive`."""
        return self._send(
            lambda token, sequence: position_datagram(
                token, sequence, stamp_ns, joint_count, velocity_rad_s, position_rad, sender=sender
            )
        )

    def release(self, *, sender: int = 0, seen: int = ALL_SEEN) -> bool:
        """Give the command back before its lifetime ends; the next command takes it again. See
        `drive`."""
        return self._send_twist(RELEASE, (0.0, 0.0, 0.0), time.monotonic_ns(), sender, seen)

    def _send_twist(
        self,
        kind: int,
        twist: tuple[float, float, float],
        stamp_ns: int,
        sender: int,
        seen: int,
    ) -> bool:
        linear_m_s, angular_rad_s, lateral_m_s = twist
        return self._send(
            lambda token, sequence: datagram(
                token, sequence, stamp_ns, linear_m_s, angular_rad_s,
                lateral_m_s=lateral_m_s, kind=kind, sender=sender,
            ),
            seen,
        )  # fmt: skip

    def _send(self, made: Callable[[bytes, int], bytes], seen: int = ALL_SEEN) -> bool:
        if self._token is None or self._sender is None:
            return self._lose(NO_LEASE)
        if self._outlet is not None:
            error = -self._outlet.send(made(self._token, 0), seen)
        else:
            self._sequence += 1
            error = _sent(self._sender, made(self._token, self._sequence))
        match error:
            case 0:
                self.sent += 1
                return True
            case errno.ESTALE:
                return False  # another source has meanwhile requested something else
            case errno.EAGAIN:  # the next command replaces it
                return self._lose(SOCKET_FULL)
            case errno.ENOTCONN:
                return self._lose(NO_LEASE)
        # the daemon is gone: the connection ends, too
        return self._lose(f"the daemon's command socket does not take it: {os.strerror(error)}")

    def _lose(self, why: str) -> bool:
        self.lost += 1
        self.why_lost = why
        return False

    def _say(self, text: str) -> None:
        if not self._failing:
            self._failing = True
            _log.warning("input.%s: no lease: %s", self.owner, text)


def _sent(sender: socket.socket, raw: bytes) -> int:
    """Send a datagram; return 0 or errno."""
    try:
        sender.send(raw)
    except OSError as error:
        return error.errno or errno.EIO
    return 0
