# SPDX-License-Identifier: Apache-2.0
"""A guided procedure that a page conducts: one at a time. It runs in a process of its own, which
may load packages that this one does without, and commands the daemon by itself
(motord/commission/page/procedure.py). This module passes messages between it and its page.

The page guards what moves: the procedure ends at rest when the page stops it, is hidden or closed,
or is silent. While a question is open the robot rests without power, and the page may be away.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import logging
import os
import secrets
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from motord.api.deadline import within
from motord.api.procedures import PROCEDURES, chosen
from motord.bus.commands.gate import NotTaken, short
from motord.bus.messages import json_form
from motord.bus.web.processes.command import started
from motord.bus.web.seat import SEEN_AHEAD_S, SEEN_MAX_S
from motord_hal.base.tasks import TaskGroup

if TYPE_CHECKING:
    from motord.bus.web.viewer import Viewer

SHOWN_MAX = 200
LINE_BYTES_MAX = 1 << 20
ENDS_WITHIN_S = 25.0
"""Time for a procedure to end after a stop: the longest stop that a robot file may have, and the
power-off."""
ABANDONED_S = 900.0
"""How long a question waits for its page to come back."""
LOOK_EVERY_S = 0.5
BUFFERED_MAX = 16384
FAILED = "the procedure failed: see the log of motord-bus"

_log = logging.getLogger(__name__)


class Commissioning:
    """Runs procedures for pages. `publish` is called whenever `record` has changed, `progress` with
    each new text about the procedure's progress."""

    def __init__(
        self, local_socket: Path, publish: Callable[[], None], progress: Callable[[str], None]
    ) -> None:
        self._socket = local_socket
        self._publish, self._progress = publish, progress
        self._requested = asyncio.Event()
        self._process: asyncio.subprocess.Process | None = None
        self._stopped_s: float | None = None
        self._left_s: float | None = None
        self._request: dict[str, Any] = {}
        self.owner: Viewer | None = None
        """The page that conducts the procedure; None: it is gone, or no procedure was started."""
        self.record: dict[str, Any] | None = None
        """What pages show of the newest procedure: `run`, which is unique, `procedure`, `page`,
        `shown`, `question`, and `end` (None until the procedure is over). None: no procedure
        was started."""

    @property
    def running(self) -> str | None:
        """Name of the procedure that runs now; None: no procedure runs."""
        if self.record is None or self.record["end"] is not None:
            return None
        return str(self.record["procedure"])

    # -------------------------------------------------------------------------------- from a page
    def start(self, viewer: Viewer, params: Mapping[str, Any]) -> None:
        """Begin a procedure. Raises NotTaken."""
        self.require_none()
        what, options = params.get("procedure"), params.get("options", {})
        joints = params.get("joints", [])
        if not isinstance(what, str) or what not in PROCEDURES:
            raise NotTaken(f"no procedure {short(what)}: there are {', '.join(PROCEDURES)}")
        if not isinstance(joints, list) or not all(isinstance(one, str) for one in joints):
            raise NotTaken("joints is a list of names")
        try:
            numbers = chosen(what, options if isinstance(options, Mapping) else {})
        except ValueError as error:
            raise NotTaken(str(error)) from error
        self.owner, self._stopped_s, self._left_s = viewer, None, None
        self._request = {
            "socket": str(self._socket), "procedure": what, "options": numbers, "joints": joints,
        }  # fmt: skip
        self.record = {
            "run": secrets.token_hex(8), "procedure": what, "page": viewer.name, "shown": [],
            "question": None, "end": None,
        }  # fmt: skip
        self._requested.set()
        self._publish()

    def answer(self, viewer: Viewer, params: Mapping[str, Any]) -> None:
        """Answer the procedure's open question. Raises NotTaken."""
        question = self._of(viewer)["question"]
        if question is None or params.get("number") != question["number"]:
            raise NotTaken("this question is not open any more")
        value = params.get("value")
        if not isinstance(value, str | int | float):
            raise NotTaken("an answer is a text, a number or yes or no")
        record = self._of(viewer)
        self._show({"question": question["text"], "answer": value})
        record["question"] = None
        self._send({"answer": question["number"], "value": value})
        self._publish()

    def stop(self, why: str) -> None:
        """Make the procedure end at rest."""
        if self.running is None:
            return
        if self._stopped_s is None:
            self._stopped_s = time.monotonic()
        self._send({"stop": why})

    def take(self, viewer: Viewer) -> None:
        """Conduct the procedure from this page on, if its own page is gone. Raises NotTaken."""
        if self.record is None or self.running is None:
            raise NotTaken("no procedure is running")
        if self.owner is not None:
            raise NotTaken(f"{self.owner.name} runs this procedure")
        self.owner, self._left_s = viewer, None
        self.record["page"] = viewer.name
        self._publish()

    def present(self, viewer: Viewer, waited_s: float, seen_s: float) -> None:
        """Report that the page is present. `waited_s`: transit time of the page's message;
        `seen_s`: time of the newest state that the page has shown."""
        now_s = time.monotonic()
        if viewer is self.owner and -SEEN_AHEAD_S <= now_s - seen_s <= SEEN_MAX_S:
            self._send({"present_s": now_s - waited_s})

    def leave(self, viewer: Viewer) -> None:
        """Note that the connection of a page has ended."""
        if viewer is not self.owner:
            return
        self.owner, self._left_s = None, time.monotonic()
        if self.record is not None and self.running is not None:
            self.record["page"] = None
            if self.record["question"] is None:
                self.stop("the page is gone")
            self._publish()

    def require_none(self) -> None:
        """Raise NotTaken while a procedure runs."""
        if self.running is not None:
            raise NotTaken(f"{self.running} is running: stop it, or wait for its end")

    def _of(self, viewer: Viewer) -> dict[str, Any]:
        if self.record is None or self.running is None or viewer is not self.owner:
            raise NotTaken("this page does not run the procedure")
        return self.record

    # ------------------------------------------------------------------------------------ at work
    async def run(self) -> None:
        """Carry out the procedures that pages start, until cancelled. May be run again."""
        if self.running is not None:  # when another part of the dashboard failed
            self._end({"good": False, "text": FAILED})
        while True:
            await self._requested.wait()
            self._requested.clear()
            try:
                end = await self._carry_out()
            except NotTaken as error:
                end = {"good": False, "text": str(error)}
            self._end(end)

    def _end(self, end: dict[str, Any]) -> None:
        assert self.record is not None
        self.record |= {"question": None, "end": end}
        self._publish()

    async def _carry_out(self) -> dict[str, Any]:
        """Run a procedure and return its end. Raises NotTaken if it cannot be started."""
        self._process = process = await started(
            "the procedure", "motord.commission.page.procedure",
            stdin=asyncio.subprocess.PIPE, stdout=asyncio.subprocess.PIPE, process_group=0,
            limit=LINE_BYTES_MAX, env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},
        )  # fmt: skip
        end: list[dict[str, Any]] = []
        try:
            self._send(self._request)
            if self._stopped_s is not None:
                self._send({"stop": "stopped"})
            async with TaskGroup() as tasks:
                watch = tasks.create_task(self._watch(process))
                await self._follow(process, end)
                watch.cancel()
        finally:
            await _ended(process)
            self._process = None
        return end[0] if end else {"good": False, "text": FAILED}

    async def _follow(self, process: asyncio.subprocess.Process, end: list[dict[str, Any]]) -> None:
        """Take what the procedure sends, until it has ended."""
        assert process.stdout is not None
        assert self.record is not None
        while message := await _next(process.stdout):
            if "progress" in message:
                self._progress(message["progress"])
                continue
            if "end" in message:
                end.append(message["end"])
                return
            if "question" in message:
                self.record["question"] = message["question"]
            else:
                self._show(message)
            self._publish()

    async def _watch(self, process: asyncio.subprocess.Process) -> None:
        """Stop a procedure whose page does not come back, and kill one that does not end."""
        while True:
            await asyncio.sleep(LOOK_EVERY_S)
            now_s = time.monotonic()
            if self._left_s is not None and now_s - self._left_s > ABANDONED_S:
                self.stop("no page came back")
            if self._stopped_s is not None and now_s - self._stopped_s > ENDS_WITHIN_S:
                _log.error("a procedure did not end within %g s: killed", ENDS_WITHIN_S)
                with contextlib.suppress(ProcessLookupError):  # it has just ended
                    process.kill()  # its dead man disarms the robot
                return

    def _show(self, message: dict[str, Any]) -> None:
        assert self.record is not None
        self.record["shown"] = [*self.record["shown"], message][-SHOWN_MAX:]

    def _send(self, message: Mapping[str, Any]) -> None:
        """Send a message without waiting: a procedure that does not read takes its page for silent,
        and ends."""
        if self._process is None or self._process.stdin is None:
            return
        transport = self._process.stdin.transport
        if not transport.is_closing() and transport.get_write_buffer_size() < BUFFERED_MAX:
            self._process.stdin.write(json.dumps(message).encode() + b"\n")


async def _next(output: asyncio.StreamReader) -> dict[str, Any] | None:
    """Return what a procedure sends next; None: its end."""
    try:
        line = await output.readline()
        message = json_form.decode(line) if line else None
        if message is not None and not isinstance(message, dict):
            raise ValueError("no object")
    except ValueError as error:  # killed in the middle of a line, perhaps
        _log.error("a procedure sent a line that is not valid JSON: %s", error)
        return None
    return message


async def _ended(process: asyncio.subprocess.Process) -> None:
    """End a procedure by the end of its stdin. What it still sends is read, or it could not end."""
    assert process.stdin is not None
    assert process.stdout is not None
    process.stdin.close()
    try:
        with contextlib.suppress(TimeoutError):
            async with within(ENDS_WITHIN_S):
                while await process.stdout.read(LINE_BYTES_MAX):
                    pass
                await process.wait()
    finally:
        if process.returncode is None:
            with contextlib.suppress(ProcessLookupError):
                process.kill()
