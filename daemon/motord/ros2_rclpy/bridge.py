# SPDX-License-Identifier: Apache-2.0
"""What a ROS 2 node asks of the daemon, without ROS: calls on the local socket, and commands under
the lease of an [input.*] of kind "ros2-rclpy". The standard library alone, no asyncio."""

from __future__ import annotations

import contextlib
import math
import socket
import time
from collections.abc import Callable
from pathlib import Path

from motord.client import Client, ClientError
from motord.commands import TWIST, datagram

TRIGGERS = ("arm", "disarm", "stop", "estop", "reset", "reset_odometry")
"""Services, all of std_srvs/Trigger."""
LEASE_WITHIN_S = 2.0
LEASE_AGAIN_S = 0.5
DRAINED_AFTER_S = 1.0
"""What waited while this process stood still has been taken out of the queues by then."""
FUTURE_S = 0.5
"""A stamp from further ahead is of another clock: its age cannot be known."""
OLD_S = 3600.0
"""Whatever is older is as old as this: the loop does not obey it."""
Stamp = tuple[int, int]
"""builtin_interfaces/Time: seconds, nanoseconds."""


class NotTaken(Exception):
    """A command was not passed on; the text says why."""


class Bridge:
    """`call` may be used by several threads at once, `drive` by one."""

    def __init__(
        self,
        path: Path,
        owner: str,
        *,
        stamped: bool = True,
        wall_s: Callable[[], float] = time.time,
    ) -> None:
        """`path`: the daemon's socket. `owner`: the name of the input. `stamped`: every command
        has to say when it was given."""
        self._path = path
        self._owner = owner
        self._stamped = stamped
        self._wall_s = wall_s
        self._lease: _Lease | None = None
        self._again_s = 0.0
        self._asked_s = self._silence_ended_s = -math.inf

    def close(self) -> None:
        """The lease ends: the robot comes to rest if it was in command."""
        if self._lease is not None:
            self._lease.close()
            self._lease = None

    def call(self, method: str) -> tuple[bool, str]:
        """One of TRIGGERS: whether it was done, and the state or why not."""
        try:
            with Client(self._path) as daemon:
                params = (
                    {"why": f"input.{self._owner}: by a service call"} if method == "estop" else {}
                )
                return True, str(daemon.call(method, **params)["state"])
        except ClientError as error:
            return False, str(error)

    def drive(self, linear_m_s: float, angular_rad_s: float, stamp: Stamp | None = None) -> None:
        """One command. `stamp`: when it was given, wall time. Those without, after a
        silence in which their lifetime is over, are left out for so long again, DRAINED_AFTER_S at
        least: they may have waited in queues while this process stood still. Raises NotTaken."""
        stamp_ns = time.monotonic_ns() - round(self._age_s(stamp) * 1e9)
        now_s = time.clock_gettime(time.CLOCK_BOOTTIME)  # it goes on while the machine sleeps
        silent_s, self._asked_s = now_s - self._asked_s, now_s
        try:
            lease = self._held()
            if silent_s > lease.lifetime_s:
                self._silence_ended_s = now_s
            heard_s = now_s - self._silence_ended_s
            if stamp is not None or heard_s >= max(lease.lifetime_s, DRAINED_AFTER_S):
                lease.send(linear_m_s, angular_rad_s, stamp_ns)
        except BlockingIOError:  # the lease goes on, and the next command counts
            raise NotTaken("the daemon's command socket is full") from None
        except (ClientError, OSError) as error:
            self.close()
            raise NotTaken(f"no lease: {error}") from error

    def _age_s(self, stamp: Stamp | None) -> float:
        if stamp is None:
            if self._stamped:
                raise NotTaken("it has no stamp")
            return 0.0
        if stamp == (0, 0):
            raise NotTaken("its stamp is zero: when was it given?")
        age_s = self._wall_s() - (stamp[0] + stamp[1] * 1e-9)
        if age_s < -FUTURE_S:
            raise NotTaken("its stamp is in the future: do the clocks agree?")
        return min(max(age_s, 0.0), OLD_S)

    def _held(self) -> _Lease:
        """Raises ClientError and OSError."""
        if self._lease is not None and self._lease.ended:
            self.close()
        if self._lease is None:
            now_s = time.monotonic()
            if now_s < self._again_s:
                raise ClientError("the daemon ended it")
            self._again_s = now_s + LEASE_AGAIN_S
            self._lease = _Lease(self._path, self._owner)
        return self._lease


class _Lease:
    """As long as its connection."""

    def __init__(self, path: Path, owner: str) -> None:
        """Raises ClientError and OSError."""
        with contextlib.ExitStack() as cleanup:
            self._daemon = cleanup.enter_context(Client(path, timeout_s=LEASE_WITHIN_S))
            grant = self._daemon.call("lease", owner=owner)
            kind = socket.SOCK_DGRAM | socket.SOCK_NONBLOCK
            self._sender = cleanup.enter_context(socket.socket(socket.AF_UNIX, kind))
            self._sender.connect(grant["socket"])
            self._token, self._sequence = bytes.fromhex(grant["token"]), 0
            self.lifetime_s = float(grant["lease_s"])
            self._cleanup = cleanup.pop_all()

    def close(self) -> None:
        self._cleanup.close()

    @property
    def ended(self) -> bool:
        return not self._daemon.connected

    def send(self, linear_m_s: float, angular_rad_s: float, stamp_ns: int) -> None:
        """Raises OSError where it is not taken."""
        self._sequence += 1
        self._sender.send(
            datagram(self._token, self._sequence, stamp_ns, linear_m_s, angular_rad_s, kind=TWIST)
        )
