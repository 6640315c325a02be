# SPDX-License-Identifier: Apache-2.0
"""Supervisor of the second process: starts it by exec, watches it by a pipe, ends it by force when
it is silent, and starts it again. Whatever it does costs the daemon no more than a line of the
log."""

from __future__ import annotations

import asyncio
import contextlib
import json
import logging
import os
import signal
import sys
import time
from asyncio.subprocess import PIPE, Process
from collections.abc import AsyncIterator, Iterator
from pathlib import Path
from typing import Any

from motord.base.python_command import module_command
from motord.base.rate_limited_log import RateLimitedLog
from motord.config import Robot
from motord.config.robot_file import handed_over
from motord_hal.base.clock import within

SILENT_S = 2.0
"""Longest silence after the first heartbeat; the process sends two a second. Meanwhile no state
reaches a page, and no stop of a page arrives."""
START_WITHIN_S = 60.0
"""Time for the first heartbeat: a small computer that is busy starting takes long, and a process
that is ended before it is ready would start again for ever."""
READ_BYTES, READ_EVERY_S = 4096, 0.02
"""How much of its output is read at a time, and how often, so that a flooded pipe costs no more."""
LOOK_EVERY_S = 0.1
"""Longest wait for its output. Silence is counted in such waits: when the daemon stands still, or
the computer does, one of them takes long, and the process is not to blame."""
BEAT_BYTES_MAX = 65536
BEATS_A_READ_MAX = 8
END_WITHIN_S = 2.0
AGAIN_MIN_S, AGAIN_MAX_S = 0.5, 30.0
WELL_AFTER_S = 60.0
"""A process that has run for this long is started again after AGAIN_MIN_S."""

_log = logging.getLogger(__name__)


class BusSupervisor:
    """Supervisor of the second process of one robot."""

    def __init__(self, robot: Robot, path: Path) -> None:
        """`path`: the local socket."""
        options = [part for option in robot.overrides for part in ("--set", option)]
        self._command = [
            *module_command("motord.bus", str(robot.path), *options),
            *("--socket", str(path), "--supervised"),
        ]
        self._checked = handed_over(robot)
        self._figures: dict[str, Any] = {}
        self._pid: int | None = None
        self._restarts = 0
        self._again_s = AGAIN_MIN_S
        self._voice = RateLimitedLog(_log)

    def report(self) -> dict[str, Any]:
        """Return its part of `status`: process number (None: not running), restarts, its own
        figures."""
        return {**self._figures, "pid": self._pid, "restarts": self._restarts}

    async def run(self) -> None:
        """Keep the process running until cancelled; then end it."""
        with _without_a_thread():
            while True:
                began_s = time.monotonic()
                try:
                    why = await self._live()
                except OSError as error:
                    why = f"cannot be started: {error.strerror or error}"
                if time.monotonic() - began_s > WELL_AFTER_S:
                    self._again_s = AGAIN_MIN_S
                self._restarts += 1
                _log.warning(
                    "motord-bus %s; it is started again in %g s, the robot goes on without it",
                    why,
                    self._again_s,
                )
                await asyncio.sleep(self._again_s)
                self._again_s = min(2.0 * self._again_s, AGAIN_MAX_S)

    async def _live(self) -> str:
        """Run the process once, and return how it ended."""
        async with self._started() as (process, output):
            _log.info("motord-bus runs as process %d", process.pid)
            try:
                await self._listen(output)
            except TimeoutError:
                with contextlib.suppress(ProcessLookupError):  # it has just ended
                    process.kill()  # who is silent ends no sooner for a request
                return f"was silent for {SILENT_S if self._figures else START_WITHIN_S:g} s"
            finally:
                self._pid, self._figures = None, {}
            await _end(process)
            return _how_it_ended(process.returncode)

    @contextlib.asynccontextmanager
    async def _started(self) -> AsyncIterator[tuple[Process, asyncio.StreamReader]]:
        """Start the process; yield it and its output. A session of its own keeps the terminal's
        signals from it."""
        async with _pipe() as (output, write_end):
            try:
                with _in_memory(self._checked) as fd:
                    process = await asyncio.create_subprocess_exec(
                        *self._command, "--checked-fd", str(fd), pass_fds=(fd,),
                        stdin=PIPE, stdout=write_end, start_new_session=True,
                    )  # fmt: skip
            finally:
                os.close(write_end)
            self._pid = process.pid
            try:
                yield process, output
            finally:
                await _end(process)

    async def _listen(self, output: asyncio.StreamReader) -> None:
        """Read the output to its end. Raises TimeoutError when no valid figures come in time."""
        rest, silent_s, silent_max_s = b"", 0.0, START_WITHIN_S
        while silent_s < silent_max_s:
            try:
                async with within(LOOK_EVERY_S):
                    chunk = await output.read(READ_BYTES)
            except TimeoutError:
                silent_s += LOOK_EVERY_S
                continue
            if not chunk:
                return
            *lines, rest = (rest + chunk).split(b"\n")
            rest = rest[-BEAT_BYTES_MAX:]
            silent_s += READ_EVERY_S
            if lines and self._receive(lines[-BEATS_A_READ_MAX:]):
                silent_s, silent_max_s = 0.0, SILENT_S
            await asyncio.sleep(READ_EVERY_S)
        raise TimeoutError

    def _receive(self, lines: list[bytes]) -> bool:
        """Keep the newest figures among the lines; return whether there are any."""
        for line in reversed(lines):
            try:
                self._figures = _figures(line)
            except (ValueError, RecursionError):
                self._voice.say(f"motord-bus sent a line that is not its figures: {line[:80]!r}")
            else:
                return True
        return False


def _figures(line: bytes) -> dict[str, Any]:
    """Return the figures in a line. Raises ValueError or RecursionError if they could not be passed
    on as they are."""
    figures = json.loads(line)
    if not isinstance(figures, dict):
        raise ValueError("no object")
    json.dumps(figures, allow_nan=False)
    return figures


@contextlib.contextmanager
def _in_memory(content: bytes) -> Iterator[int]:
    """Yield a file in memory with this content, at its beginning. Only a child can open it."""
    with os.fdopen(os.memfd_create("robot"), "r+b") as file:
        file.write(content)
        file.seek(0)
        yield file.fileno()


@contextlib.asynccontextmanager
async def _pipe() -> AsyncIterator[tuple[asyncio.StreamReader, int]]:
    """Yield the end of a pipe to read from, and the end to write to, which the caller closes.
    asyncio's own pipe of a child has to be read to its end before the child counts as gone: a flood
    would never be read out."""
    reading, writing = os.pipe()
    output = asyncio.StreamReader(READ_BYTES)
    transport, _ = await asyncio.get_running_loop().connect_read_pipe(
        lambda: asyncio.StreamReaderProtocol(output), os.fdopen(reading, "rb", 0)
    )
    try:
        yield output, writing
    finally:
        transport.close()


@contextlib.contextmanager
def _without_a_thread() -> Iterator[None]:
    """Wait for children without a thread. Until Python 3.11 asyncio waits for each child in a
    thread, whose whole stack of 8 MB the loop's mlockall would pin; later versions use a pidfd by
    themselves (Linux 5.3)."""
    watcher = None
    if sys.version_info < (3, 12):
        with contextlib.suppress(OSError):
            os.close(os.pidfd_open(os.getpid()))
            watcher = asyncio.PidfdChildWatcher()
    if watcher is None:
        yield
        return
    policy = asyncio.get_event_loop_policy()
    watcher.attach_loop(asyncio.get_running_loop())
    policy.set_child_watcher(watcher)
    try:
        yield
    finally:
        policy.set_child_watcher(asyncio.ThreadedChildWatcher())  # the pidfd one was for this loop


async def _end(process: Process) -> None:
    """End the process: close its standard input, and kill it if it goes on. The wait is short."""
    if process.returncode is not None:
        return
    assert process.stdin is not None  # made by stdin=PIPE
    process.stdin.close()
    try:
        async with within(END_WITHIN_S):
            await process.wait()
    except TimeoutError:
        with contextlib.suppress(ProcessLookupError):  # it has just ended
            process.kill()
        with contextlib.suppress(TimeoutError):  # the kernel may hold it for longer
            async with within(END_WITHIN_S):
                await process.wait()


def _how_it_ended(status: int | None) -> str:
    if status is None or status >= 0:
        return f"ended with status {status}"
    try:
        return f"was ended by {signal.Signals(-status).name}"
    except ValueError:
        return f"was ended by signal {-status}"
