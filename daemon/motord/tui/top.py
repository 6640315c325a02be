# SPDX-License-Identifier: Apache-2.0
"""The screen of `motord top`. It connects again by itself when the daemon is restarted."""

from __future__ import annotations

import asyncio
import signal
import time
from collections import deque
from collections.abc import Callable, Coroutine
from pathlib import Path
from typing import Any, ClassVar

from rich.text import Text
from textual.app import App, ComposeResult
from textual.binding import BindingType
from textual.containers import VerticalScroll
from textual.events import Key
from textual.screen import ModalScreen
from textual.widgets import Footer, Label, Static

from motord.aio import Client, ClientError
from motord.api.halting import halt
from motord.api.status import Status
from motord.tui import view

LOOK_PERIOD_S = 0.25
AGAIN_S = 1.0
ANSWER_WITHIN_S = 3.0
LOG_ROWS = 200
Find = Callable[[], Path]
"""A function that returns the daemon's present socket. It raises ClientError."""


class Confirm(ModalScreen[bool]):
    """One question; y is yes, any other key is no."""

    CSS = """
    Confirm { align: center middle; }
    Confirm Label { border: heavy yellow; padding: 1 2; background: $surface; }
    """

    def __init__(self, question: str) -> None:
        super().__init__()
        self._question = question
        self._answered = False

    def compose(self) -> ComposeResult:
        yield Label(f"{self._question}\n\ny: yes    any other key: no", markup=False)

    def on_key(self, event: Key) -> None:
        if not self._answered:  # further keys may be in transit
            self._answered = True
            self.dismiss(event.key == "y")


class Top(App[None]):
    """The screen for one robot. It exits on request in every state of the robot."""

    CSS = """
    Static { height: auto; margin: 0 0 1 0; }
    #header { margin: 0 0 1 0; }
    VerticalScroll { height: auto; max-height: 8; scrollbar-size-vertical: 1; }
    #log { height: 1fr; margin: 0; overflow: hidden; }
    #message { margin: 0; color: yellow; }
    """
    ENABLE_COMMAND_PALETTE = False
    BINDINGS: ClassVar[list[BindingType]] = [
        ("space", "estop", "E-STOP"),
        ("s", "stop", "stop"),
        ("a", "arm", "arm"),
        ("d", "disarm", "disarm"),
        ("r", "reset", "reset"),
        ("q", "quit", "quit"),
    ]

    def __init__(self, find: Find) -> None:
        super().__init__()
        self._find = find
        self._path: Path | None = None
        self._history = view.History()
        self._records: deque[dict[str, Any]] = deque(maxlen=LOG_ROWS)
        self._newest = 0
        self.found: Status | None = None
        """The newest answer; None: there was no answer yet, or the daemon does not answer."""

    def compose(self) -> ComposeResult:
        yield Static("connecting ...", id="header", markup=False)
        with VerticalScroll(can_focus=False):
            yield Static(id="joints")
        yield Static(id="lines")
        yield Static(id="leases")
        yield Static(id="log")
        yield Static(id="message", markup=False)
        yield Footer()

    def on_mount(self) -> None:
        for number in (signal.SIGTERM, signal.SIGHUP):
            asyncio.get_running_loop().add_signal_handler(number, self.exit)
        self.run_worker(self._follow(), name="follow")

    # ------------------------------------------------------------------------------------- looking
    async def _follow(self) -> None:
        while True:
            try:
                self._path = await asyncio.to_thread(self._find)
                async with Client(self._path, timeout_s=ANSWER_WITHIN_S) as robot:
                    self._say("")
                    while True:
                        await self._look(robot)
                        await asyncio.sleep(LOOK_PERIOD_S)
            except ClientError as error:
                self.found = None
                self._show("#header", Text(f" NO ANSWER  {error}", "bold white on red"))
                await asyncio.sleep(AGAIN_S)

    async def _look(self, robot: Client) -> None:
        found = await robot.status()
        recent = await robot.call("log", after=self._newest)
        if recent["newest"] < self._newest:  # the daemon was restarted
            recent = await robot.call("log")
        self._newest = recent["newest"]
        self._records.extend(recent["records"])
        now_s = time.monotonic()
        self._history.add(found, now_s)
        self.found = found
        self._show("#header", view.header(found))
        self._show("#joints", view.joints(found, self._history))
        self._show("#lines", view.lines(found, self._history, now_s))
        self._show("#leases", view.leases(found))
        rows = self.query_one("#log", Static).size.height
        self._show("#log", view.log_tail(list(self._records), rows))

    def _show(self, where: str, text: Text) -> None:
        self.query_one(where, Static).update(text)

    def _say(self, text: str) -> None:
        self._show("#message", Text(text, "bold yellow"))

    # -------------------------------------------------------------------------------------- acting
    def action_estop(self) -> None:
        """Request it at once, without a question."""
        self._perform("emergency stop", self._halt("estop"))

    def action_stop(self) -> None:
        self._perform("stop", self._halt("stop"))

    def action_disarm(self) -> None:
        self._perform("disarm", self._halt("disarm"))

    def action_reset(self) -> None:
        self._perform("reset", self._call("reset"))

    def action_arm(self) -> None:
        def answered(yes: bool | None) -> None:
            if yes:
                self._perform("arm", self._call("arm", release_held=True))

        self.push_screen(Confirm("Power the drives? Then commands move the robot."), answered)

    def _perform(self, words: str, call: Coroutine[Any, Any, str]) -> None:
        async def perform() -> None:
            self._say(f"{words} ...")
            try:
                self._say(f"{words}: {await call}")
            except ClientError as error:
                self._say(f"{words}: {error}")

        self.run_worker(perform(), name=words)

    async def _halt(self, method: str) -> str:
        """Request it by datagram, confirmed by the state page if the daemon does not answer."""
        return await asyncio.to_thread(halt, self._where(), method)

    async def _call(self, method: str, **params: bool) -> str:
        async with Client(self._where()) as robot:
            return str((await robot.call(method, **params))["state"])

    def _where(self) -> Path:
        return self._path if self._path is not None else self._find()
