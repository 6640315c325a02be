# SPDX-License-Identifier: Apache-2.0
"""The local socket: JSON-RPC 2.0, one object a line, on a Unix stream socket.

SO_PEERCRED identifies a client: root, the daemon's own user and members of the socket's group may
command, every other user may only read. No client can do harm: lines, answers not yet read, calls
in progress and connections are all bounded, and what is beyond a bound is dropped."""

from __future__ import annotations

import asyncio
import contextlib
import errno
import inspect
import itertools
import json
import logging
import math
import os
import socket
import stat
import struct
from collections.abc import Callable, Coroutine, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from motord.api.local_rpc import NOT_ALLOWED, REFUSED
from motord.client import socket_folders
from motord.local_socket.params import Params, checked
from motord.local_socket.peer_process import Process, process_of
from motord_hal.base.tasks import TaskGroup

PARSE_ERROR, INVALID_REQUEST, METHOD_NOT_FOUND, INVALID_PARAMS = -32700, -32600, -32601, -32602
INTERNAL_ERROR = -32603
LINE_BYTES_MAX = 16384
UNREAD_BYTES_MAX = 1 << 20
CALLS_MAX = 4
CONNECTIONS_MAX = 32
CALLS_IN_ALL_MAX = 2 * CALLS_MAX * CONNECTIONS_MAX
"""Most calls of all connections, including those that ended while a call of theirs goes on."""
NO_MEMORY = "no memory is left for its request"
SOCKET_MODE = 0o660
_SO_PEERGROUPS = 59
"""include/uapi/asm-generic/socket.h, since Linux 4.13"""
_GROUP_BYTES_MAX = 1024
"""Most bytes that Python's getsockopt takes: 256 groups."""

_log = logging.getLogger(__name__)


class RpcError(Exception):
    """Error that goes back to the client as a JSON-RPC error."""

    def __init__(self, message: str, code: int) -> None:
        super().__init__(message)
        self.code = code


class Refused(RpcError):
    """A call that was understood and refused; the message gives the reason and what to do."""

    def __init__(self, reason: str) -> None:
        super().__init__(reason, REFUSED)


class _NoMemory(Exception):
    """No memory is left for a request that only reads, or is not understood yet."""


class SocketInUse(RuntimeError):
    """The path is in use: a program listens there, or it is not a socket."""


@dataclass(frozen=True, slots=True)
class Caller:
    """The process at the other end. `connection` is never given twice."""

    connection: int
    pid: int
    uid: int
    may_command: bool
    process: Process | None = None
    """The process itself, as it was when it connected; None: not known."""


@dataclass(frozen=True, slots=True)
class Method:
    """A method. `call` returns the result, or a coroutine that does; it may raise RpcError."""

    call: Callable[[Caller, Any], Any]
    params: type[Params] | None = Params
    """None: parameters with any names, as a dictionary."""
    commands: bool = True
    """Whether it is only for callers that may command."""
    urgent: bool = False
    """Whether it is accepted however many calls are running."""


# --------------------------------------------------------------------------------- the socket file
def socket_path(robot: str, folders: Sequence[Path] = ()) -> Path:
    """Return the path of this robot's socket, in the first folder that can be used; none given: the
    usual ones. Raises OSError."""
    system, *own = folders or socket_folders()
    if os.geteuid() == 0:
        with contextlib.suppress(OSError):
            system.mkdir(mode=0o755, exist_ok=True)
    if os.access(system, os.W_OK):
        return system / f"{robot}.sock"
    for folder in own:
        with contextlib.suppress(OSError):
            folder.mkdir(mode=0o700, exist_ok=True)
            info = folder.lstat()
            if stat.S_ISDIR(info.st_mode) and info.st_uid == os.geteuid():
                folder.chmod(0o700)
                return folder / f"{robot}.sock"
    raise PermissionError(errno.EACCES, "no folder for the socket can be made", str(own[-1]))


@contextlib.contextmanager
def listening(path: Path) -> Iterator[socket.socket]:
    """Open a listening socket at `path`, and remove it afterwards. A socket that a dead daemon left
    there is replaced.

    Raises SocketInUse if a program listens there, or if it is something else than a socket; OSError
    for a path that cannot be used."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM | socket.SOCK_NONBLOCK) as listener:
        _clear_away(path)
        # The file is made with this mode: no other user connects before the chmod.
        os.fchmod(listener.fileno(), SOCKET_MODE)
        try:
            listener.bind(str(path))
        except OSError as error:
            number = error.errno or errno.ENAMETOOLONG  # Python has no number for it
            raise OSError(number, error.strerror or str(error), str(path)) from error
        made = path.stat()
        try:
            path.chmod(SOCKET_MODE)
            listener.listen(CONNECTIONS_MAX)
            yield listener
        finally:
            with contextlib.suppress(FileNotFoundError):
                if os.path.samestat(path.stat(), made):
                    path.unlink()


def _clear_away(path: Path) -> None:
    try:
        mode = path.lstat().st_mode
    except FileNotFoundError:
        return
    if not stat.S_ISSOCK(mode):
        raise SocketInUse(f"{path} is there and is not a socket: give another --socket")
    with socket.socket(socket.AF_UNIX) as probe:
        probe.settimeout(1.0)
        try:
            probe.connect(str(path))
        except ConnectionRefusedError:
            path.unlink(missing_ok=True)
            return
        except FileNotFoundError:
            return
    raise SocketInUse(f"a daemon listens at {path} already: stop it, or give another --socket")


def _caller(connection: int, peer: socket.socket) -> Caller:
    """Identify the caller and whether it may command. The group is that of the socket file at this
    moment."""
    credentials = peer.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, struct.calcsize("3i"))
    pid, uid, gid = struct.unpack("3i", credentials)
    member_of = {gid}
    with contextlib.suppress(OSError):
        groups = peer.getsockopt(socket.SOL_SOCKET, _SO_PEERGROUPS, _GROUP_BYTES_MAX)
        member_of.update(struct.unpack(f"{len(groups) // 4}I", groups))
    with contextlib.suppress(OSError):
        if os.stat(peer.getsockname()).st_gid in member_of:
            return Caller(connection, pid, uid, may_command=True, process=process_of(pid))
    may_command = uid in (0, os.geteuid())
    return Caller(connection, pid, uid, may_command=may_command, process=process_of(pid))


# -------------------------------------------------------------------------------------- the server
async def serve(
    listener: socket.socket,
    methods: Mapping[str, Method],
    on_close: Callable[[int], None],
    stays: Callable[[int], bool] = lambda _: False,
) -> None:
    """Accept connections and answer until cancelled. `on_close` gets the number of each connection
    that ends, at once, whatever it is waiting for. `stays`: whether the connection with this number
    is never dropped to make room; this must be so for fewer than CONNECTIONS_MAX."""
    connections: dict[int, _Connection] = {}
    numbers = itertools.count(1)

    def is_full() -> bool:
        return sum(one.calls for one in connections.values()) >= CALLS_IN_ALL_MAX

    try:
        async with TaskGroup() as tasks:
            while True:
                await _readable(listener)
                if (peer := await _accepted(listener, connections, stays)) is not None:
                    number = next(numbers)
                    _make_room(connections, stays)
                    connections[number] = _Connection(number, peer, methods, on_close, is_full)
                    tasks.create_task(_attend(number, connections))
    finally:
        for connection in connections.values():  # cancelled before their task began
            connection.close()


async def _readable(listener: socket.socket) -> None:
    loop, arrived = asyncio.get_running_loop(), asyncio.Event()
    loop.add_reader(listener, arrived.set)
    try:
        await arrived.wait()
    finally:
        loop.remove_reader(listener)


async def _accepted(
    listener: socket.socket, connections: Mapping[int, _Connection], stays: Callable[[int], bool]
) -> socket.socket | None:
    """Accept a connection; None: there was no connection to accept. This does not use
    loop.sock_accept, which loses the connection if it is cancelled in the wrong moment."""
    for tried in (False, True):
        try:
            peer, _ = listener.accept()
        except BlockingIOError:
            return None
        except OSError as error:  # out of file descriptors: the robot goes on
            if not tried and error.errno == errno.EMFILE and _dropped_one(connections, stays):
                await asyncio.sleep(0)  # its descriptor is closed
                continue
            _log.warning("no new connection: %s", error.strerror)
            await asyncio.sleep(1.0)
            return None
        peer.settimeout(0.0)
        return peer
    return None


def _make_room(connections: Mapping[int, _Connection], stays: Callable[[int], bool]) -> None:
    """Drop silent connections until there is room for one. A dropped connection stays here while a
    call of it goes on, and has no descriptor."""
    while sum(not one.dropped for one in connections.values()) >= CONNECTIONS_MAX:
        if not _dropped_one(connections, stays):
            return


def _dropped_one(connections: Mapping[int, _Connection], stays: Callable[[int], bool]) -> bool:
    """Drop the connection that has been silent for longest. False: no connection may be dropped."""
    idle = [one for number, one in connections.items() if not one.dropped and not stays(number)]
    if idle:
        min(idle, key=lambda one: one.received_s).drop("room for another")
    return bool(idle)


async def _attend(number: int, connections: dict[int, _Connection]) -> None:
    try:
        await connections[number].run()
    finally:
        del connections[number]


class _Connection:
    """One connection: reads requests in order, answers each when it is done."""

    def __init__(
        self,
        number: int,
        peer: socket.socket,
        methods: Mapping[str, Method],
        on_close: Callable[[int], None],
        is_full: Callable[[], bool],
    ) -> None:
        self._caller = _caller(number, peer)
        self._peer = peer
        self._methods = methods
        self._on_close = on_close
        self._is_full = is_full
        self.calls = 0
        """Number of its calls that are running."""
        self._writer: asyncio.StreamWriter | None = None
        self.received_s = asyncio.get_running_loop().time()
        self.dropped = False

    def drop(self, why: str) -> None:
        """End the connection without waiting for anything."""
        self.dropped = True
        if self._writer is not None:
            self._writer.transport.abort()
        _log.warning("connection of process %d dropped: %s", self._caller.pid, why)

    async def run(self) -> None:
        """Take requests until the peer ends the connection."""
        # if cancelled here, asyncio closes the peer
        reader, self._writer = await asyncio.open_unix_connection(
            sock=self._peer, limit=LINE_BYTES_MAX
        )
        if self.dropped:  # dropped while it was opened
            self._writer.transport.abort()
        try:
            async with TaskGroup() as calls:
                while (line := await self._read(reader)) is not None:
                    self.received_s = asyncio.get_running_loop().time()
                    self._take(line, calls)
                    # a connection that floods the daemon waits for all others
                    await asyncio.sleep(0)
                self._on_close(self._caller.connection)
        finally:
            self._on_close(self._caller.connection)
            self.close()

    def close(self) -> None:
        """Close the connection without waiting for answers that the kernel has not taken."""
        if self._writer is None:
            self._peer.close()
        elif self._writer.transport.get_write_buffer_size():
            self._writer.transport.abort()
        else:
            self._writer.close()

    async def _read(self, reader: asyncio.StreamReader) -> bytes | None:
        """Return a line; None at the end, and after a line that is too long."""
        try:
            return await reader.readuntil(b"\n")
        except asyncio.LimitOverrunError:
            self._fail(None, f"a line has at most {LINE_BYTES_MAX} bytes", INVALID_REQUEST)
        except (asyncio.IncompleteReadError, OSError):
            pass
        except MemoryError:
            self.drop(NO_MEMORY)
        return None

    def _take(self, line: bytes, calls: TaskGroup) -> None:
        """Answer one request; a call that has to wait becomes a task of its own."""
        number: Any = None
        try:
            request = _request(line)
            number = request.get("id", _NOBODY)
            result = self._call(request["method"], request.get("params", {}))
            if inspect.iscoroutine(result):
                self._admit(result, urgent=self._methods[request["method"]].urgent)
                calls.create_task(self._finish(number, result))
            else:
                self._answer(number, {"result": result})
        except RpcError as error:
            self._fail(number, str(error), error.code)
        except _NoMemory:
            self.drop(NO_MEMORY)

    def _call(self, name: str, raw: dict[str, Any]) -> Any:
        method = self._methods.get(name)
        if method is None:
            known = ", ".join(self._methods)
            raise RpcError(f"no method {name!r}; there are: {known}", METHOD_NOT_FOUND)
        if method.commands and not self._caller.may_command:
            raise RpcError(
                f"{name} is for root, the daemon's user and the group of its socket", NOT_ALLOWED
            )
        try:
            params = raw if method.params is None else checked(method.params, raw)
            if not method.commands:
                return method.call(self._caller, params)
        except ValueError as error:
            raise RpcError(f"{name}: {error}", INVALID_PARAMS) from error
        except MemoryError as error:
            raise _NoMemory from error
        # a MemoryError of an act ends the daemon, which takes the power off: it may be half done
        return method.call(self._caller, params)

    def _admit(self, call: Coroutine[Any, Any, Any], *, urgent: bool) -> None:
        why = ""
        if self.calls >= CALLS_MAX:
            why = f"{CALLS_MAX} of your calls are running: wait for them"
        elif self._is_full():
            why = f"{CALLS_IN_ALL_MAX} calls of all programs are running: try again"
        if why and not urgent:
            call.close()
            raise Refused(why)
        self.calls += 1

    async def _finish(self, number: Any, call: Coroutine[Any, Any, Any]) -> None:
        try:
            self._answer(number, {"result": await call})
        except RpcError as error:
            self._fail(number, str(error), error.code)
        finally:
            self.calls -= 1

    def _fail(self, number: Any, message: str, code: int) -> None:
        self._answer(number, {"error": {"code": code, "message": message}})

    def _answer(self, number: Any, content: dict[str, Any]) -> None:
        try:
            self._write(number, content)
        except MemoryError:
            self.drop(NO_MEMORY)

    def _write(self, number: Any, content: dict[str, Any]) -> None:
        writer = self._writer
        if writer is None or writer.is_closing() or number is _NOBODY:
            return
        answer = {"jsonrpc": "2.0", "id": number, **content}
        try:
            reply = json.dumps(answer, allow_nan=False)
        except ValueError as error:  # our own mistake: the daemon goes on
            _log.exception("an answer to process %d", self._caller.pid)
            problem = {"code": INTERNAL_ERROR, "message": f"the answer is not JSON: {error}"}
            reply = json.dumps({"jsonrpc": "2.0", "id": number, "error": problem})
        writer.write(reply.encode() + b"\n")
        if writer.transport.get_write_buffer_size() > UNREAD_BYTES_MAX:
            self.drop("it does not read its answers")


# ----------------------------------------------------------------------------------------- framing
_NOBODY = object()
"""The id of a notification: a request that expects no answer."""


def _request(line: bytes) -> dict[str, Any]:
    """Return the request in a line. Raises RpcError."""
    try:
        request = json.loads(line, parse_constant=_no_constant)
    except MemoryError as error:
        raise _NoMemory from error
    except (ValueError, RecursionError) as error:
        raise RpcError(f"not a JSON object on one line: {error}", PARSE_ERROR) from error
    if not isinstance(request, dict) or request.get("jsonrpc") != "2.0":
        raise RpcError('not a JSON-RPC 2.0 object: "jsonrpc": "2.0" is missing', INVALID_REQUEST)
    if not isinstance(request.get("id"), str | int | None):
        raise RpcError("id must be a whole number or a string", INVALID_REQUEST)
    if not isinstance(request.get("method"), str):
        raise RpcError("method is the name of a method", INVALID_REQUEST)
    if not isinstance(request.get("params", {}), dict):
        raise RpcError("params is an object: parameters go by name", INVALID_PARAMS)
    return request


def _no_constant(name: str) -> float:
    raise ValueError(f"{name} is not JSON")


def json_number(value: float) -> float | None:
    """Return the number; None for NaN and infinity: JSON has neither, and a drive may report
    them."""
    return value if math.isfinite(value) else None
