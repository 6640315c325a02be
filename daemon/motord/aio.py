# SPDX-License-Identifier: Apache-2.0
"""Use a running motord from an asyncio program: motord.client with `await`.

    from motord.aio import Client

    async with Client() as robot:
        await robot.arm()
        await robot.move(1.0)
        await robot.disarm()

Every call has a deadline. Several tasks may use one Client: calls go one after the other, and a
stop request goes to the real-time loop at once, whatever call is in progress.
"""

from __future__ import annotations

import asyncio
import contextlib
import functools
import os
import socket
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Self

from motord.api import moving, stop_request
from motord.api.deadline import within
from motord.api.local_rpc import (
    ClientError,
    Refused,
    answer_to,
    drive_params,
    joints_params,
    request_line,
    result_of,
)
from motord.api.motion import Goal
from motord.api.moving import Moved, MoveFailed
from motord.api.status import Status
from motord.client import (
    ANSWER_BYTES_MAX,
    CONNECT_AGAIN_S,
    STOP_WITHIN_S,
    TIMEOUT_S,
    find_socket,
    why_unreachable,
)

__all__ = ["Client", "ClientError", "MoveFailed", "Moved", "Refused", "Status"]

CLOSE_WITHIN_S = 1.0
LOOK_EVERY_S = 10.0


class Client:
    """One connection to a daemon; `async with` opens and closes it."""

    def __init__(
        self, path: str | os.PathLike[str] | None = None, *, timeout_s: float = TIMEOUT_S
    ) -> None:
        """`path`: the daemon's socket; None: the only one there is."""
        self._given = None if path is None else Path(path)
        self._path: Path | None = None
        self.timeout_s = timeout_s
        self._number = 0
        self._turn = asyncio.Lock()
        self._streams: tuple[asyncio.StreamReader, asyncio.StreamWriter] | None = None

    @property
    def path(self) -> Path:
        """The daemon's socket. Raises ClientError before it is open."""
        if self._path is None:
            raise ClientError("not connected: use it as async with Client() as robot")
        return self._path

    async def __aenter__(self) -> Self:
        """Connect. Raises ClientError."""
        await self.open()
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.close()

    async def open(self) -> None:
        """Connect. Raises ClientError."""
        try:
            async with within(self.timeout_s):
                self._path = self._given
                if self._path is None:
                    self._path = await asyncio.to_thread(find_socket)
                await self._connect(self._path)
        except TimeoutError as error:
            where = self._path or "the daemon's socket"
            raise ClientError(f"{where}: no connection within {self.timeout_s:g} s") from error

    async def _connect(self, path: Path) -> None:
        """Connect; retry while the daemon's queue of connections is full. The caller sets the
        deadline."""
        try:
            with contextlib.ExitStack() as unless_kept:
                connection = socket.socket(
                    socket.AF_UNIX, socket.SOCK_STREAM | socket.SOCK_NONBLOCK
                )
                unless_kept.callback(connection.close)
                while True:
                    try:
                        connection.connect(str(path))
                        break
                    except BlockingIOError:
                        await asyncio.sleep(CONNECT_AGAIN_S)
                self._streams = await asyncio.open_unix_connection(
                    sock=connection, limit=ANSWER_BYTES_MAX
                )
                unless_kept.pop_all()
        except OSError as error:
            raise ClientError(why_unreachable(path, error)) from error

    async def close(self) -> None:
        """Close the connection, which ends all its leases."""
        streams, self._streams = self._streams, None
        if streams is None:
            return
        streams[1].close()
        with contextlib.suppress(OSError, TimeoutError):
            async with within(CLOSE_WITHIN_S):
                await streams[1].wait_closed()

    async def ended(self) -> None:
        """Return when the daemon has closed the connection. Make no call meanwhile. Raises
        ClientError."""
        if self._streams is None:
            raise ClientError(f"the connection to {self.path} is closed")
        try:
            while True:
                with contextlib.suppress(TimeoutError):
                    async with within(LOOK_EVERY_S):
                        if not await self._streams[0].read(ANSWER_BYTES_MAX):
                            return
        except OSError as error:
            raise ClientError(f"{self.path}: {error.strerror or error}") from error

    async def call(self, method: str, /, **params: Any) -> Any:
        """Call any method by name and return its result. Raises Refused, or ClientError for
        everything else."""
        try:
            async with within(self.timeout_s), self._turn:
                return await self._ask(method, params)
        except TimeoutError as error:
            raise ClientError(f"{method}: no answer within {self.timeout_s:g} s") from error
        except (asyncio.IncompleteReadError, asyncio.LimitOverrunError) as error:
            ends = "an answer without end"
            if isinstance(error, asyncio.IncompleteReadError):
                ends = "the daemon has closed the connection"
            raise ClientError(f"{method}: {self.path}: {ends}") from error
        except OSError as error:
            raise ClientError(f"{method}: {self.path}: {error.strerror or error}") from error

    async def _ask(self, method: str, params: dict[str, Any]) -> Any:
        """Send a request and return its result. It is sent whole even if its caller is cancelled;
        the next call then drops its answer."""
        path = self.path
        if self._streams is None:
            raise ClientError(f"{method}: the connection to {path} is closed")
        reader, writer = self._streams
        self._number += 1
        number = self._number
        writer.write(request_line(number, method, params))
        await writer.drain()
        while True:
            answer = answer_to(number, await reader.readuntil(b"\n"), path)
            if answer is not None:
                return result_of(answer)

    async def status(self) -> Status:
        """Return everything the daemon knows about itself and the robot, typed; also a dict."""
        return Status.of(await self.call("status"))

    async def drive(
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
        return dict(await self.call("drive", **params))

    async def joints(
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
        return dict(await self.call("joints", **params))

    async def move(
        self,
        distance_m: float,
        direction_rad: float = 0.0,
        *,
        speed_m_s: float | None = None,
        tolerance_m: float | None = None,
        timeout_s: float | None = None,
        owner: str | None = None,
    ) -> Moved:
        """Drive a distance: see motord.client.Client.move."""
        goal = moving.goal_of(
            "linear", distance_m, speed_m_s, tolerance_m, timeout_s, direction_rad
        )
        return await self.carry_out(goal, owner=owner)

    async def turn(
        self,
        angle_rad: float,
        *,
        speed_rad_s: float | None = None,
        tolerance_rad: float | None = None,
        timeout_s: float | None = None,
        owner: str | None = None,
    ) -> Moved:
        """Turn on the spot: see motord.client.Client.turn."""
        goal = moving.goal_of("angular", angle_rad, speed_rad_s, tolerance_rad, timeout_s)
        return await self.carry_out(goal, owner=owner)

    async def carry_out(
        self,
        goal: Goal,
        *,
        owner: str | None = None,
        watch: moving.Watch = moving.unwatched,
        canceled: moving.Canceled = moving.never_canceled,
    ) -> Moved:
        """Carry out a goal: see motord.client.Client.carry_out. A task that is cancelled gives the
        lease back, and the robot comes to rest by its ramp."""
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
                    onward = functools.partial(steps.send, await self._perform(step))
                except ClientError as error:
                    onward = functools.partial(steps.throw, error)
        finally:
            steps.close()
            with contextlib.suppress(ClientError):  # the lease expires by itself
                await self.release(owner)

    async def _perform(self, step: moving.Call | moving.Pause) -> Any:
        if isinstance(step, moving.Call):
            return await self.call(step.method, **step.params)
        await asyncio.sleep(step.until_s - asyncio.get_running_loop().time())
        return None

    async def release(self, owner: str | None = None) -> None:
        """Give the lease back before it expires."""
        await self.call("release", **({} if owner is None else {"owner": owner}))

    async def arm(self, *, release_held: bool = False) -> str:
        """Put the drives under power at zero speed. Returns the state, like all methods below that
        return a str. `release_held`: if the robot is armed already, let the sources go on that a
        stop holds (`status().held`): for a person who has seen which they are."""
        params = {"release_held": True} if release_held else {}
        return str((await self.call("arm", **params))["state"])

    async def disarm(self) -> str:
        """Come to rest and remove the power."""
        return await self._surely("disarm")

    async def stop(self) -> str:
        """Come to rest and stay armed."""
        return await self._surely("stop")

    async def estop(self) -> str:
        """Trigger an emergency stop, which stays until `reset`."""
        return await self._surely("estop")

    async def _surely(self, method: str) -> str:
        """Request it by datagram first, which the real-time loop reads even if other requests wait.
        The answer comes over a connection of its own, which no other call can block. Raises
        DaemonHangs, a ClientError, 1.2 s after it if the daemon hangs."""
        with contextlib.suppress(OSError), stop_request.open_sender() as sender:  # or no descriptor
            await send_stop(sender, self.path, method)
        await until_tick(self.path, method)
        async with Client(self.path, timeout_s=self.timeout_s) as own:
            return str((await own.call(method))["state"])

    async def reset(self) -> str:
        """Clear a fault or an emergency stop. The robot stays disarmed."""
        return str((await self.call("reset"))["state"])

    async def reset_odometry(self) -> str:
        """Make the present pose the origin of the odometry."""
        return str((await self.call("reset_odometry"))["state"])

    async def params_list(self) -> dict[str, dict[str, Any]]:
        """Return every parameter with value, unit and range."""
        return dict(await self.call("params.list"))

    async def params_get(self, *names: str) -> dict[str, float | None]:
        """Return the values by name, all if no name is given. None: no limit."""
        return dict(await self.call("params.get", names=names))

    async def params_set(self, **values: float | None) -> dict[str, float | None]:
        """Set limits and gains, all or none, or registers of drives, one after the other:
        `params_set(**{"limits.linear_m_s": 0.3})`. None: no limit. A limit beyond the robot file is
        refused, unless `force=True` is among the values."""
        return dict(await self.call("params.set", **values))

    async def latency(self) -> dict[str, Any]:
        """Return the loop's histograms since its start, as percentiles and as buckets."""
        return dict(await self.call("latency"))


async def until_tick(path: Path, method: str) -> None:
    """Wait until the daemon is seen to tick: `stop_request.until_tick`. Raises DaemonHangs."""
    with contextlib.closing(stop_request.until_tick(path, method)) as looks:
        for _ in looks:
            await asyncio.sleep(stop_request.LOOK_EVERY_S)


async def send_stop(sender: socket.socket, path: Path, method: str) -> bool:
    """Send the request; retry while the receive queue is full. False: the daemon is gone."""
    with contextlib.suppress(OSError, TimeoutError):
        async with within(STOP_WITHIN_S):
            while not stop_request.try_send(  # noqa: ASYNC110  nothing says when it has room
                sender, path, method
            ):
                await asyncio.sleep(stop_request.AGAIN_S)
        return True
    return False
