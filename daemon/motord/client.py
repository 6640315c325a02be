# SPDX-License-Identifier: Apache-2.0
"""Use a running motord from any Python program: the standard library alone, no asyncio.

    from motord.client import Client

    with Client() as robot:
        robot.arm()
        robot.drive(0.2, 0.0)   # again within lease_s, or the robot stops
        robot.disarm()

A lease of `drive` ends with the connection: a program that dies stops the robot.
"""

from __future__ import annotations

import contextlib
import functools
import os
import re
import socket
import stat
import tempfile
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Self

from motord.api import moving, stop_request
from motord.api.local_rpc import (
    ClientError,
    Refused,
    WrongParams,
    answer_to,
    drive_params,
    joints_params,
    request_line,
    result_of,
)
from motord.api.motion import Goal
from motord.api.moving import Moved, MoveFailed
from motord.api.status import Status

__all__ = [
    "Client", "ClientError", "MoveFailed", "Moved", "Refused", "Status", "WrongParams",
    "find_socket", "find_sockets",
]  # fmt: skip

TIMEOUT_S = 10.0
STOP_WITHIN_S = 1.0
"""Time within which the daemon's queue has to have room for a stop request."""
CONNECT_AGAIN_S = 0.01
ANSWER_BYTES_MAX = 1 << 20
_OTHERS = re.compile(r"\.(stop|cmd\.\d+)\.sock$")
"""Ending of the sockets beside the local one that take datagrams."""


def socket_folders(environ: Mapping[str, str] = os.environ, uid: int | None = None) -> list[Path]:
    """Return the folders that sockets may be in, best first: the system's, the user's, and one for
    when neither exists."""
    uid = os.geteuid() if uid is None else uid
    folders = [Path("/run/motord")]
    if runtime := environ.get("XDG_RUNTIME_DIR"):
        folders.append(Path(runtime) / "motord")
    folders.append(Path(tempfile.gettempdir()) / f"motord-{uid}")
    return folders


def find_socket(
    robot: str | None = None, folders: list[Path] | None = None, *, barred: bool = True
) -> Path:
    """Return the socket of the running daemon of `robot`, or of the only one that runs. `folders`
    and `barred`: see `find_sockets`. Raises ClientError."""
    found = find_sockets(robot, folders, barred=barred)
    if robot is None and len(found) > 1:
        names = ", ".join(sorted({path.name.removesuffix(".sock") for path in found}))
        raise ClientError(f"several robots run here: name one with --robot NAME ({names})")
    return found[0]


def find_sockets(
    robot: str | None = None, folders: list[Path] | None = None, *, barred: bool = True
) -> list[Path]:
    """Return the sockets of all running daemons, or of those of `robot`. `barred`: also return a
    socket to which this user may not connect; the kernel refuses before it looks whether a program
    listens (unix(7)), so its daemon may be dead. Raises ClientError if there is no socket."""
    found: list[Path] = []
    for folder in socket_folders() if folders is None else folders:
        with contextlib.suppress(OSError):
            found += [
                path
                for path in sorted(folder.glob(f"{robot or '*'}.sock"))
                if not _OTHERS.search(path.name) and _lives(path, barred)
            ]
    if not found:
        what = f"robot {robot}" if robot else "robot"
        raise ClientError(f"no {what} runs here: motord run ROBOT.toml")
    return found


def why_unreachable(path: Path, error: OSError) -> str:
    """Return why the socket cannot be used, and the remedy."""
    if isinstance(error, PermissionError):
        cure = "run this with sudo"
        with contextlib.suppress(OSError, KeyError, ImportError):
            import grp

            group = grp.getgrgid(path.stat().st_gid).gr_name
            if group != "root":
                cure += f", or join its group (sudo usermod -aG {group} $USER) and log in again"
        return f"{path}: this user may not command the robot: {cure}"
    if isinstance(error, FileNotFoundError):
        return f"{path}: no daemon has this socket: motord run ROBOT.toml"
    if isinstance(error, ConnectionRefusedError):
        return (
            f"{path}: its daemon has ended without closing it: if a wheel still turns, "
            "motord stop-all ROBOT.toml; then motord run ROBOT.toml"
        )
    return f"{path}: {error.strerror or error}"


def trusted_owners(folder: Path) -> set[int]:
    """Return the users whose files in the folder are trusted: root, this user and, if only root can
    write to the parent folder, the owner to which root has given the folder (a service's
    /run/motord)."""
    above = folder.parent.stat()
    by_root = above.st_uid == 0 and not above.st_mode & (stat.S_IWGRP | stat.S_IWOTH)
    return {0, os.geteuid()} | ({folder.lstat().st_uid} if by_root else set())


def _lives(path: Path, barred: bool) -> bool:
    """Whether a program listens at the socket, and its owner is trusted."""
    info = path.stat()
    if not stat.S_ISSOCK(info.st_mode) or info.st_uid not in trusted_owners(path.parent):
        return False
    with socket.socket(socket.AF_UNIX) as probe:
        probe.settimeout(1.0)
        try:
            probe.connect(str(path))
        except PermissionError:
            return barred
        except BlockingIOError:  # its queue of connections is full
            return True
        except OSError:
            return False
    return True


class Client:
    """One connection to a daemon. Every call has a deadline. For one thread at a time."""

    def __init__(
        self, path: str | os.PathLike[str] | None = None, *, timeout_s: float = TIMEOUT_S
    ) -> None:
        """`path`: the daemon's socket; None: the only one there is. Raises ClientError."""
        self.path = Path(path) if path is not None else find_socket()
        self.timeout_s = timeout_s
        self._number = 0
        self._buffer = b""
        try:
            with contextlib.ExitStack() as unless_kept:
                self._socket = unless_kept.enter_context(socket.socket(socket.AF_UNIX))
                self._connect(time.monotonic() + timeout_s)
                unless_kept.pop_all()
        except OSError as error:
            raise ClientError(why_unreachable(self.path, error)) from error

    def _connect(self, end_s: float) -> None:
        """Connect; retry while the daemon's queue of connections, shared with other programs, is
        full."""
        self._socket.settimeout(self.timeout_s)
        while True:
            try:
                self._socket.connect(str(self.path))
            except BlockingIOError:
                if time.monotonic() > end_s:
                    raise
                time.sleep(CONNECT_AGAIN_S)
            else:
                return

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the connection, which ends all its leases."""
        self._socket.close()

    @property
    def connected(self) -> bool:
        """Whether the daemon has not closed this connection. Does not wait."""
        self._socket.settimeout(0.0)
        try:
            return self._socket.recv(1, socket.MSG_PEEK) != b""
        except BlockingIOError:
            return True
        except OSError:
            return False

    def call(self, method: str, /, **params: Any) -> Any:
        """Call any method by name and return its result. Raises Refused, or ClientError for
        everything else."""
        end_s = time.monotonic() + self.timeout_s
        self._number += 1
        line = request_line(self._number, method, params)
        try:
            self._socket.settimeout(self.timeout_s)
            self._socket.sendall(line)
            return self._answer(end_s)
        except TimeoutError as error:
            raise ClientError(f"{method}: no answer within {self.timeout_s:g} s") from error
        except OSError as error:
            raise ClientError(f"{method}: {self.path}: {error.strerror or error}") from error

    def _answer(self, end_s: float) -> Any:
        """Return the result of the request in flight; drop late answers to other requests."""
        while True:
            answer = answer_to(self._number, self._line(end_s), self.path)
            if answer is not None:
                return result_of(answer)

    def _line(self, end_s: float) -> bytes:
        while b"\n" not in self._buffer:
            left_s = end_s - time.monotonic()
            if left_s <= 0.0:
                raise TimeoutError
            self._socket.settimeout(left_s)
            chunk = self._socket.recv(65536)
            if not chunk:
                raise ClientError(f"{self.path}: the daemon has closed the connection")
            self._buffer += chunk
            if len(self._buffer) > ANSWER_BYTES_MAX:
                raise ClientError(f"{self.path}: an answer without end")
        line, _, self._buffer = self._buffer.partition(b"\n")
        return line

    def status(self) -> Status:
        """Return everything the daemon knows about itself and the robot, typed; also a dict."""
        return Status.of(self.call("status"))

    def drive(
        self,
        linear_m_s: float,
        angular_rad_s: float,
        lateral_m_s: float = 0.0,
        *,
        owner: str | None = None,
        priority: int | None = None,
        lease_s: float | None = None,
    ) -> dict[str, Any]:
        """Request a speed; `lateral_m_s` is to the left, for a base that moves sideways. None: the
        value in the robot file's [input]. Returns the source in command."""
        lease = {"owner": owner, "priority": priority, "lease_s": lease_s}
        params = drive_params(linear_m_s, angular_rad_s, lateral_m_s, **lease)
        return dict(self.call("drive", **params))

    def joints(
        self,
        position_rad: Mapping[str, float] | None = None,
        velocity_rad_s: Mapping[str, float] | None = None,
        *,
        clamp: bool = False,
        owner: str | None = None,
        priority: int | None = None,
        lease_s: float | None = None,
    ) -> dict[str, Any]:
        """Request positions and speeds of joints without a base, by their names. A joint that is
        left out comes to rest or, if it takes positions, goes on to its last position from this
        owner, as long as commands come. A position beyond its range is refused; `clamp`: it means
        the end of the range. Returns the source in command."""
        lease = {"owner": owner, "priority": priority, "lease_s": lease_s}
        params = joints_params(position_rad, velocity_rad_s, clamp=clamp, **lease)
        return dict(self.call("joints", **params))

    def move(
        self,
        distance_m: float,
        direction_rad: float = 0.0,
        *,
        speed_m_s: float | None = None,
        tolerance_m: float | None = None,
        timeout_s: float | None = None,
        owner: str | None = None,
    ) -> Moved:
        """Drive this distance by the odometry, backward for a negative one, and come to rest.
        `direction_rad`: counterclockwise from straight ahead, for a base that moves sideways. The
        robot has to be armed. None: the robot's own limit, 0.01 m, twice the expected time and 5 s
        more. Raises MoveFailed if it does not get there, ValueError for an impossible goal."""
        goal = moving.goal_of(
            "linear", distance_m, speed_m_s, tolerance_m, timeout_s, direction_rad
        )
        return self.carry_out(goal, owner=owner)

    def turn(
        self,
        angle_rad: float,
        *,
        speed_rad_s: float | None = None,
        tolerance_rad: float | None = None,
        timeout_s: float | None = None,
        owner: str | None = None,
    ) -> Moved:
        """Turn on the spot by this angle, to the left for a positive one; otherwise like `move`,
        with a tolerance of 0.02 rad."""
        goal = moving.goal_of("angular", angle_rad, speed_rad_s, tolerance_rad, timeout_s)
        return self.carry_out(goal, owner=owner)

    def carry_out(
        self,
        goal: Goal,
        *,
        owner: str | None = None,
        watch: moving.Watch = moving.unwatched,
        canceled: moving.Canceled = moving.never_canceled,
    ) -> Moved:
        """Carry out the goal of a `move` or `turn`. `watch` is called at each look, 50 times a
        second; when `canceled` returns true the robot comes to rest and MoveFailed is raised."""
        lease = {} if owner is None else {"owner": owner}
        uid = self.path.stat().st_uid
        steps = moving.procedure(goal, owner=lease, daemon_uid=uid, watch=watch, canceled=canceled)
        onward: Callable[[], moving.Call | moving.Pause] = functools.partial(next, steps)
        try:
            while True:
                try:
                    step = onward()
                except StopIteration as end:
                    moved: Moved = end.value
                    return moved
                try:
                    onward = functools.partial(steps.send, self._perform(step))
                except ClientError as error:
                    onward = functools.partial(steps.throw, error)
        finally:
            steps.close()
            with contextlib.suppress(ClientError):  # the lease expires by itself
                self.release(owner)

    def _perform(self, step: moving.Call | moving.Pause) -> Any:
        if isinstance(step, moving.Call):
            return self.call(step.method, **step.params)
        time.sleep(max(step.until_s - time.monotonic(), 0.0))
        return None

    def release(self, owner: str | None = None) -> None:
        """Give the lease back before it expires."""
        self.call("release", **({} if owner is None else {"owner": owner}))

    def arm(self, *, release_held: bool = False) -> str:
        """Put the drives under power at zero speed. Returns the state, like all methods below that
        return a str. `release_held`: if the robot is armed already, let the sources go on that a
        stop holds (`status().held`): for a person who has seen which they are."""
        params = {"release_held": True} if release_held else {}
        return str(self.call("arm", **params)["state"])

    def disarm(self) -> str:
        """Come to rest and remove the power."""
        return self._surely("disarm")

    def stop(self) -> str:
        """Come to rest and stay armed."""
        return self._surely("stop")

    def estop(self) -> str:
        """Trigger an emergency stop, which stays until `reset`."""
        return self._surely("estop")

    def _surely(self, method: str) -> str:
        """Request it by datagram first, which the real-time loop reads even if other requests wait.
        The answer comes over a new connection if the daemon has closed this one to make room for
        others. Raises DaemonHangs, a ClientError, 1.2 s after it if the daemon hangs."""
        with contextlib.suppress(OSError):  # the daemon has no such socket, or has ended
            stop_request.send(self.path, method, STOP_WITHIN_S)
        for _ in stop_request.until_tick(self.path, method):
            time.sleep(stop_request.LOOK_EVERY_S)
        if not self.connected:
            again = Client(self.path, timeout_s=self.timeout_s)
            self._socket.close()
            self._socket, self._buffer = again._socket, b""
        return str(self.call(method)["state"])

    def reset(self) -> str:
        """Clear a fault or an emergency stop. The robot stays disarmed."""
        return str(self.call("reset")["state"])

    def reset_odometry(self) -> str:
        """Make the present pose the origin of the odometry."""
        return str(self.call("reset_odometry")["state"])

    def params_list(self) -> dict[str, dict[str, Any]]:
        """Return every parameter with value, unit and range."""
        return dict(self.call("params.list"))

    def params_get(self, *names: str) -> dict[str, float | None]:
        """Return the values by name, all if no name is given. None: no limit."""
        return dict(self.call("params.get", names=names))

    def params_set(self, **values: float | None) -> dict[str, float | None]:
        """Set limits and gains, all or none, or registers of drives, one after the other:
        `params_set(**{"limits.linear_m_s": 0.3})`. None: no limit. A limit beyond the robot file is
        refused, unless `force=True` is among the values."""
        return dict(self.call("params.set", **values))

    def latency(self) -> dict[str, Any]:
        """Return the loop's histograms since its start, as percentiles and as buckets."""
        return dict(self.call("latency"))
