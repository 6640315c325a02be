# SPDX-License-Identifier: Apache-2.0
"""A relay between a program and a simulated line: it passes bytes in both directions, and resets
the program's connection where a test demands it."""

from __future__ import annotations

import contextlib
import os
import select
import socket
import struct
import threading
import tty
from pathlib import Path

READ_BYTES = 4096
LOOK_EVERY_MS = 2
TO_PEER, TO_PROGRAM = "to the peer", "to the program"


class Relay:
    """`medium`: "tcp" (ports are HOST:PORT), "pty" (paths) or "unix" (paths of SOCK_SEQPACKET).
    `back` is the port of the simulated line, `front` the one that the program opens.

    After a reset the front is there again at once: a gateway that listens, an adapter that is
    plugged in."""

    def __init__(self, medium: str, front: Path, back: str) -> None:
        self.front = str(front)
        self.resets = 0
        """How often a connection was reset."""
        self.connections = 0
        """How many connections the program has made."""
        self._medium, self._back_port = medium, back
        self._lock = threading.RLock()
        self._limits: dict[str, int] = {}
        self._at_accept = 0
        self._passed = {TO_PEER: 0, TO_PROGRAM: 0}
        self._listener: socket.socket | None = None
        self._front = self._back = -1
        self._accepted = False
        self._ended = threading.Event()
        self._begin()
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def __enter__(self) -> Relay:
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        self._thread.join()
        with self._lock:
            self._drop()
            if self._listener is not None:
                self._listener.close()

    # -------------------------------------------------------------------------- what a test demands
    def reset(self) -> None:
        """Reset the connection now; one that is being opened, too."""
        with self._lock:
            self._accept()
            self._reset()

    def reset_at_accept(self, times: int = 1) -> None:
        """Reset this many of the next connections as soon as they are accepted."""
        with self._lock:
            self._at_accept = times

    def reset_after(self, count: int, direction: str) -> None:
        """Reset the connection when this number of bytes has passed in it in this direction."""
        with self._lock:
            self._limits = {direction: count}

    def pass_all(self) -> None:
        """Reset nothing any more."""
        with self._lock:
            self._limits, self._at_accept = {}, 0

    # --------------------------------------------------------------------------------- in detail
    def _begin(self) -> None:
        """Offer the front to the program."""
        if self._medium == "pty":
            self._front, slave = os.openpty()
            os.set_blocking(self._front, False)
            tty.setraw(self._front)
            fresh = Path(f"{self.front}.fresh")
            fresh.symlink_to(os.ttyname(slave))
            fresh.replace(self.front)
            os.close(slave)
        elif self._listener is None:
            if self._medium == "tcp":
                self._listener = socket.create_server(("127.0.0.1", 0))
                self.front = f"127.0.0.1:{self._listener.getsockname()[1]}"
            else:
                self._listener = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
                self._listener.bind(self.front)
                self._listener.listen()
            self._listener.settimeout(0)

    def _accept(self) -> None:
        if self._accepted:
            return
        if self._listener is None:
            looking = select.poll()
            looking.register(self._front, 0)
            if looking.poll(0):  # a hang-up: no program has opened it
                return
        else:
            try:
                program, _ = self._listener.accept()
            except BlockingIOError:
                return
            program.settimeout(0)
            self._front = program.detach()
        self._accepted = True
        self.connections += 1
        self._passed = dict.fromkeys(self._passed, 0)
        self._back = _connected(self._medium, self._back_port)
        if self._at_accept:
            self._at_accept -= 1
            self._reset()

    def _reset(self) -> None:
        self._limits = {}
        self.resets += 1
        if self._accepted and self._medium == "tcp":
            program = socket.socket(fileno=self._front)
            program.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
            program.close()
            self._front = -1
        self._drop()
        self._begin()

    def _drop(self) -> None:
        for fd in (self._front, self._back):
            if fd >= 0:
                os.close(fd)
        self._front = self._back = -1
        self._accepted = False

    def _run(self) -> None:
        while not self._ended.is_set():
            with self._lock:
                self._accept()
                ends = [self._front, self._back] if self._accepted else []
            ready = _readable(ends)
            if not ends:
                self._ended.wait(LOOK_EVERY_MS * 1e-3)
            with self._lock:
                if ends == [self._front, self._back]:  # else it was reset meanwhile
                    for fd in ready:
                        if not self._pass(fd):
                            break

    def _pass(self, fd: int) -> bool:
        """Pass what can be read. Return False if the connection has ended."""
        direction = TO_PEER if fd == self._front else TO_PROGRAM
        room = self._limits.get(direction, READ_BYTES) - self._passed[direction]
        size = min(max(room, 0), READ_BYTES) if direction in self._limits else READ_BYTES
        if self._medium == "unix":  # frames are in one piece
            size = READ_BYTES if size else 0
        try:
            data = os.read(fd, size) if size else b""
        except BlockingIOError:
            return True
        except OSError:
            data = b""
        if size and not data:
            self._drop()
            self._begin()
            return False
        with contextlib.suppress(OSError):
            os.write(self._back if fd == self._front else self._front, data)
        self._passed[direction] += len(data)
        if direction in self._limits and self._passed[direction] >= self._limits[direction]:
            self._reset()
            return False
        return True


def _readable(ends: list[int]) -> list[int]:
    """Return the ends from which bytes can be read; none if a reset closes one meanwhile."""
    if not ends:
        return []
    try:
        return select.select(ends, [], [], LOOK_EVERY_MS * 1e-3)[0]
    except OSError:
        return []


def _connected(medium: str, port: str) -> int:
    """Return a non-blocking descriptor of the simulated line's port."""
    if medium == "pty":
        return os.open(port, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    if medium == "tcp":
        host, _, number = port.rpartition(":")
        end = socket.create_connection((host, int(number)))
    else:
        end = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        end.connect(port)
    end.settimeout(0)
    return end.detach()
