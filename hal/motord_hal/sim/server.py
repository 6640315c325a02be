# SPDX-License-Identifier: Apache-2.0
"""The simulator's control socket, served from the poll loop of its lines. Each line is one JSON
object: `{"method": ..., "params": {...}}` in, `{"result": ...}` or `{"error": ...}` out."""

from __future__ import annotations

import errno
import json
import os
import socket
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

LINE_BYTES_MAX = 65536
Handler = Callable[[Mapping[str, Any]], Any]


class ControlServer:
    """Server that answers each request at once. It drops a client that sends too much or reads
    nothing."""

    def __init__(self, path: Path, methods: Mapping[str, Handler]) -> None:
        self.path = path
        self._methods = methods
        self._clients: dict[int, tuple[socket.socket, bytearray]] = {}
        self._listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        if path.is_socket():  # left by a simulator that was killed; nothing else may be removed
            path.unlink()
        try:
            self._listener.bind(os.fspath(path))
        except OSError as error:
            self._listener.close()
            number = error.errno or errno.ENAMETOOLONG  # Python has no constant for it
            raise OSError(number, error.strerror or str(error), os.fspath(path)) from error
        path.chmod(0o600)
        self._listener.listen()
        self._listener.settimeout(0.0)

    def filenos(self) -> list[int]:
        return [self._listener.fileno(), *self._clients]

    def work(self, ready: set[int]) -> None:
        if self._listener.fileno() in ready:
            client, _ = self._listener.accept()
            client.settimeout(0.0)
            self._clients[client.fileno()] = (client, bytearray())
        for fd in ready & self._clients.keys():
            self._take_in(fd)

    def close(self) -> None:
        for fd in list(self._clients):
            self._drop(fd)
        self._listener.close()
        self.path.unlink(missing_ok=True)

    def _drop(self, fd: int) -> None:
        client, _ = self._clients.pop(fd)
        client.close()

    def _take_in(self, fd: int) -> None:
        client, buffer = self._clients[fd]
        try:
            data = client.recv(LINE_BYTES_MAX)
            buffer += data
            while b"\n" in buffer:
                line, _, rest = buffer.partition(b"\n")
                buffer[:] = rest
                client.sendall(json.dumps(self._answer(bytes(line))).encode() + b"\n")
        except OSError:
            self._drop(fd)
            return
        if not data or len(buffer) > LINE_BYTES_MAX:
            self._drop(fd)

    def _answer(self, line: bytes) -> dict[str, Any]:
        try:
            request = json.loads(line)
            method, params = request["method"], request.get("params", {})
            if method not in self._methods:
                known = ", ".join(self._methods)
                return {"error": f'no method "{method}"; known: {known}'}
            return {"result": self._methods[method](params)}
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            return {"error": str(error) or type(error).__name__}
