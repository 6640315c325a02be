# SPDX-License-Identifier: Apache-2.0
"""Starts the process that sends commands and stamps bytes (peer.py), and makes the port to it."""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import socket
import tty
from asyncio.subprocess import Process
from collections.abc import AsyncIterator, Iterator
from dataclasses import dataclass
from pathlib import Path

from motord.base.python_command import script_command
from motord.tools.latency.process import running
from motord.tools.latency.report import Spread
from motord_hal.base.clock import within

COMMAND_HZ = 100.0
PEER = Path(__file__).with_name("peer.py")
DEADLINE_S = 20.0
PRIORITY_BELOW_LOOP = 10


class LatencyError(RuntimeError):
    """The measurement failed; the message contains the reason."""


@dataclass(frozen=True, slots=True)
class Answers:
    commands_sent: int
    command_to_byte_us: Spread


class OtherEnd:
    """The process at the other end. Its commands come on `commands`; write the resulting bytes to
    the pty."""

    def __init__(self, process: Process, commands: socket.socket) -> None:
        self._process = process
        self.commands = commands

    def begin(self) -> None:
        self.commands.send(b"!")

    def end(self) -> None:
        """Let the process end: it sends no more commands."""
        self.commands.shutdown(socket.SHUT_WR)

    async def result(self) -> Answers:
        """Return the results of the process. Call it after `end`. Raise LatencyError if the process
        has failed."""
        async with within(DEADLINE_S):
            out, err = await self._process.communicate()
        if self._process.returncode != 0:
            raise LatencyError(f"the other end of the port died: {err.decode(errors='replace')}")
        found = json.loads(out)
        spread_ns = Spread.of_counts(dict(found["counts"]), found["samples"], found["max_ns"])
        return Answers(found["sent"], spread_ns.scaled(1e-3))


@contextlib.asynccontextmanager
async def other_end(far_fd: int, loop_priority: int) -> AsyncIterator[OtherEnd]:
    """Run the other end in this block; it is ready when the block begins, and has ended after it,
    whatever happened. Raise LatencyError if it does not start."""
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    priority = max(loop_priority - PRIORITY_BELOW_LOOP, 0)
    numbers = theirs.fileno(), far_fd, COMMAND_HZ, priority
    command = script_command(PEER, *map(str, numbers))
    with ours, theirs:
        ours.setblocking(False)  # noqa: FBT003 no keyword there
        async with running(command, pass_fds=(theirs.fileno(), far_fd)) as process:
            theirs.close()
            async with within(DEADLINE_S):
                ready = await asyncio.get_running_loop().sock_recv(ours, 1)
            if not ready:
                raise LatencyError("the other end of the port did not start")
            yield OtherEnd(process, ours)


@contextlib.contextmanager
def own_port() -> Iterator[tuple[int, int]]:
    """Open a raw pty; yield (the other end's file descriptor, ours)."""
    far_fd, near_fd = os.openpty()
    try:
        tty.setraw(near_fd)
        os.set_blocking(near_fd, False)
        yield far_fd, near_fd
    finally:
        os.close(near_fd)
        os.close(far_fd)
