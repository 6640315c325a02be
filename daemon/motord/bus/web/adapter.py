# SPDX-License-Identifier: Apache-2.0
"""The server of the dashboard: files of the page, a WebSocket for each page that is open, and
downloads of recordings. Without a page it does nothing but note events."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import time
from collections.abc import Mapping
from dataclasses import asdict
from http import HTTPStatus
from typing import TYPE_CHECKING, Any

from aiohttp import web

from motord.api.procedures import OPTIONS, PROCEDURES
from motord.base.rate_limited_log import RateLimitedLog
from motord.bus.commands.gate import TRIGGERS, URGENT, CommandGate, NotTaken, short
from motord.bus.http_server import HttpServer, tls_context
from motord.bus.messages import json_form
from motord.bus.messages.topics import View
from motord.bus.secret import Token
from motord.bus.web import tape
from motord.bus.web.access import PROTOCOL, Access, Right, Stranger
from motord.bus.web.assets import answer as asset
from motord.bus.web.description import description
from motord.bus.web.events import Event, Events
from motord.bus.web.frames import Packer
from motord.bus.web.processes import robot_file
from motord.bus.web.processes.commissioning import Commissioning
from motord.bus.web.processes.robot_file import FileEditor
from motord.bus.web.processes.saving import save
from motord.bus.web.processes.tracing import Traces
from motord.bus.web.recordings import ADDRESS
from motord.bus.web.seat import Seat
from motord.bus.web.tape import Tape
from motord.bus.web.viewer import Viewer
from motord.client import ClientError
from motord.config import WebInput, WebServer
from motord_hal.base.tasks import TaskGroup

if TYPE_CHECKING:
    from motord.bus.runtime import Runtime

SOCKET = "/socket"
VIEWERS_MAX = 64
"""Largest number of pages with the token, and of pages without it."""
_WHOSE = {True: "with", False: "without"}
MESSAGE_BYTES_MAX = 65536
PING_EVERY_S = 5.0
"""Time between two pings. A page that does not answer within half of it counts as gone."""
CLOSE_WITHIN_S = 2.0
NO_VIEWER_S = 1.0
LOG_EVERY_S = 1.0
LOOKED_AT_S = 0.5
"""Time in which the same call goes to the daemon only once, however many pages show its answer."""
REFUSED = 4401
"""Close code: the page may not watch."""
LOOKS = ("status", "latency", "params.list")
CHANGES = ("params.get", "params.set")
SAVES = ("params.diff", "params.save")
"""Calls beside those of every bus, with LOOKS and CHANGES. None of them reads a register, which
would cost a turn on the line."""
COMMISSION = ("commission.start", "commission.answer", "commission.stop", "commission.take")
NEEDS_TOKEN = "only a page that has shown the token may write the robot file"  # noqa: S105
AT_ANY_TIME = (
    *(*URGENT, "disarm", "params.get"), *tape.CHANGES, *COMMISSION, *robot_file.LOOKS,
)  # fmt: skip
"""Calls that are accepted while a procedure runs."""

_log = logging.getLogger(__name__)


class WebAdapter:
    """The adapter of the dashboard. It takes views as a motord.bus.feed.Sink."""

    def __init__(self, name: str, section: WebServer, runtime: Runtime) -> None:
        """Raises OSError and ValueError for files that cannot be used."""
        self._section, self._runtime = section, runtime
        self._gate: CommandGate | None = None
        self._seat: Seat | None = None
        table, fits = "publish", None
        if isinstance(section, WebInput):
            table, self._gate = "input", CommandGate(name, section, runtime)
            self._seat = Seat(self._gate, section.lease_s)
        if section.token_file is not None:
            fits = Token(runtime.beside_robot_file(section.token_file)).fits
        self._where = where = f"{table}.{name}"
        self._full = RateLimitedLog(_log)
        self._access = Access(section, fits)
        self._events = Events(self._publish_event)
        self._tape = Tape(runtime, lambda: self._publish({"recordings": "changed"}))
        self._traces = Traces(runtime.path)
        self._packer = Packer(len(runtime.robot.joint))
        self._viewers: set[Viewer] = set()
        self._pages = self._frames = 0
        self._status_ns = 0
        self._saving = asyncio.Lock()
        self._editor = FileEditor(runtime, self._saving)
        self._commissioning = Commissioning(
            runtime.path, self._publish_commissioning, self._publish_progress
        )
        self._looked: dict[str, tuple[float, Any]] = {}
        self.taken = self.dropped = 0
        runtime.feeds[where if self._gate else name] = self
        tls = tls_context(section.cert_file, section.key_file, runtime.beside_robot_file)
        self._server = HttpServer(where, section.host, section.port, self._answer, tls)

    async def run(self) -> None:
        """Implement `Adapter.run`."""
        with self._events.log.listening():
            async with TaskGroup() as tasks:
                if self._gate is not None:
                    tasks.create_task(self._gate.source.run())
                    tasks.create_task(self._commissioning.run())
                tasks.create_task(self._server.run())
                tasks.create_task(self._traces.run())
                tasks.create_task(self._tape.replays.run())
                tasks.create_task(self._follow_log())

    async def _follow_log(self) -> None:
        while True:
            await asyncio.sleep(LOG_EVERY_S)
            if self._viewers:
                with contextlib.suppress(ClientError):  # it is ending, or not there yet
                    events = self._events
                    events.note_log(await self._runtime.call("log", after=events.log_number))

    # ------------------------------------------------------------------------------------- states
    @property
    def period_s(self) -> float:
        """Period of the fastest page; NO_VIEWER_S without a page."""
        return 1.0 / max((one.rate_hz for one in self._viewers), default=1.0 / NO_VIEWER_S)

    def offer(self, view: View) -> None:
        """Note the events of a view, and make one frame for all pages whose time has come."""
        self._events.look(view)
        if not self._viewers:
            return
        if view.status is not None and view.status_ns != self._status_ns:
            self._status_ns = view.status_ns
            self._publish({"status": self._status(view.status)})
            for viewer in self._viewers:
                viewer.say(json_form.encode({"dropped": viewer.dropped}).decode())
        stamp_ns = view.snapshot.stamp_ns
        due = [viewer for viewer in self._viewers if viewer.due(stamp_ns)]
        if due and (frame := self._packer.pack(view.snapshot, self._frames + 1)) is not None:
            self._frames += 1
            self.taken += len(due)
            self.dropped += sum(one.offer(self._frames, frame, stamp_ns) for one in due)

    def _status(self, status: Mapping[str, Any]) -> dict[str, Any]:
        driver = self._seat.driver if self._seat is not None else None
        record = self._commissioning.record if self._commissioning.running else None
        running = record and {"procedure": record["procedure"], "page": record["page"]}
        return {**status, "pages": len(self._viewers), "driver": driver, "commissioning": running}

    def _publish(self, message: dict[str, Any]) -> None:
        text = json_form.encode(message).decode()
        for viewer in self._viewers:
            viewer.say(text)

    def _publish_event(self, event: Event) -> None:
        if self._viewers:
            self._publish({"event": event})

    def _publish_commissioning(self) -> None:
        """Show pages the procedure. Every page gets at once whether one runs; only those that may
        command get the rest, because it may contain parts of the robot file."""
        running = self._commissioning.running
        if self._seat is not None:
            self._seat.reserved_for = running
        self._status_ns = 0
        for viewer in self._viewers:
            self._show_commissioning(viewer)

    def _show_commissioning(self, viewer: Viewer) -> None:
        record = self._commissioning.record
        if record is not None and viewer.may_command:
            yours = viewer is self._commissioning.owner
            viewer.say(json_form.encode({"commissioning": {**record, "yours": yours}}).decode())

    def _publish_progress(self, text: str) -> None:
        for viewer in self._viewers:
            if viewer.may_command:
                viewer.say(json_form.encode({"progress": text}).decode())

    # -------------------------------------------------------------------------------------- pages
    async def _answer(self, request: web.BaseRequest) -> web.StreamResponse:
        if request.path.startswith(ADDRESS):
            return self._download(request)
        if request.path != SOCKET:
            return asset(request, self._section.fleet)
        try:
            self._access.check_origin(request)
        except Stranger as error:
            return web.Response(status=HTTPStatus.FORBIDDEN, text=f"{error}\n")
        right = self._access.right(request)
        # Pages with the token have places of their own: others do not keep them out.
        if sum(one.has_token == right.token for one in self._viewers) >= VIEWERS_MAX:
            text = f"too many pages: {VIEWERS_MAX} are open {_WHOSE[right.token]} the token\n"
            self._full.say(f"{self._where}: {text.strip()}; one more was refused")
            return web.Response(status=HTTPStatus.SERVICE_UNAVAILABLE, text=text)
        longest = robot_file.MESSAGE_BYTES_MAX if right.command else MESSAGE_BYTES_MAX
        connection = web.WebSocketResponse(
            heartbeat=PING_EVERY_S, timeout=CLOSE_WITHIN_S, max_msg_size=longest,
            compress=False, protocols=(PROTOCOL,),
        )  # fmt: skip
        if not connection.can_prepare(request).ok:
            return web.Response(status=HTTPStatus.UPGRADE_REQUIRED, text="a WebSocket, please\n")
        await connection.prepare(request)
        if right.watch:
            await self._serve_page(connection, request.remote or "this machine", right)
        else:
            await self._turn_away(connection, right.why)
        return connection

    async def _turn_away(self, connection: web.WebSocketResponse, why: str) -> None:
        """Refuse a page. It gets the reason by a message, because a page cannot read that of a
        refused request."""
        if self._gate is not None:
            self._gate.refuse(why)
        await connection.send_json({"refused": why})
        await connection.close(code=REFUSED)

    async def _serve_page(
        self, connection: web.WebSocketResponse, remote: str, right: Right
    ) -> None:
        self._pages += 1
        seat = self._seat if right.command else None
        name = f"page {self._pages} at {remote}"
        viewer = Viewer(
            connection, name, self._section.rate_hz, seat, self._commissioning, self._call
        )
        viewer.has_token = right.token
        viewer.may_write = right.command and right.token
        viewer.say(json_form.encode({"hello": self._hello(viewer)}).decode())
        self._show_commissioning(viewer)
        self._viewers.add(viewer)
        self._status_ns = 0
        try:
            await viewer.run()
        except* OSError:
            pass  # it went away
        finally:
            self._viewers.discard(viewer)
            self._traces.leave(viewer)

    def _hello(self, viewer: Viewer) -> dict[str, Any]:
        section = self._section
        return description(self._runtime.robot) | {
            "page": viewer.name,
            "may_command": viewer.may_command,
            "may_write": viewer.may_write,
            "takes_commands": self._gate is not None,
            "rate_max_hz": section.rate_hz,
            "lease_s": section.lease_s if isinstance(section, WebInput) else None,
            "fleet": section.fleet,
            "procedures": PROCEDURES,
            "options": {name: asdict(option) for name, option in OPTIONS.items()},
            "events": list(self._events.kept),
        }

    def _download(self, request: web.BaseRequest) -> web.StreamResponse:
        answer = self._tape.redeem(request)
        if answer is not None:
            return answer
        text = "this address was good for one download\n"
        return web.Response(status=HTTPStatus.NOT_FOUND, text=text)

    # -------------------------------------------------------------------------------------- calls
    async def _call(self, viewer: Viewer, method: str, params: Mapping[str, Any]) -> Any:
        """Answer a call of a page. Raises NotTaken and ClientError."""
        match method:
            case "trace":
                return self._trace(viewer, params.get("line"))
            case _ if method in LOOKS:
                return await self._look(method)
            case _ if method in tape.LOOKS:
                return await self._tape.look(method, params, has_token=viewer.has_token)
        if self._gate is None:
            raise NotTaken("this dashboard only shows the robot: the robot file has no [input.*]")
        if not viewer.may_command:
            self._gate.refuse("the token is missing")
            raise NotTaken("this page may only watch: it has not shown the token")
        if method not in AT_ANY_TIME:
            self._commissioning.require_none()
        if method in COMMISSION:
            return self._commission(viewer, method, params)
        if method in TRIGGERS:
            self._events.note(viewer.name, method)
            # a person sees on the page who is held, and presses its button
            by_person = {"release_held": True} if method == "arm" else {}
            return await self._gate.act(method, viewer.name, **by_person)
        if method in SAVES:
            return await self._save(viewer, dry_run=method == "params.diff")
        if method in robot_file.CALLS:
            return await self._edit(viewer, method, params)
        if method in tape.CHANGES:
            what = short(params.get("name", params.get("section")))
            self._events.note(viewer.name, f"{method} {what}")
            return await self._tape.change(method, params)
        if method not in CHANGES:
            raise NotTaken(f"no call {short(method)}")
        if method == "params.set":
            rows = ", ".join(f"{name} = {value}" for name, value in params.items())
            self._events.note(viewer.name, rows[:200])
        answer = await self._gate.ask(method, **params)
        if method == "params.set":
            self._publish({"parameters": answer})  # before the next status shows it
        return answer

    def _trace(self, viewer: Viewer, line: object) -> dict[str, object]:
        """Show a page the exchanges of a line; None: stop showing them. Raises NotTaken."""
        if line is None:
            self._traces.leave(viewer)
        elif isinstance(line, str) and line in self._runtime.robot.line:
            self._traces.show(viewer, line)
        else:
            raise NotTaken(f"there is no line {short(line)}")
        return {"line": line}

    def _commission(self, viewer: Viewer, method: str, params: Mapping[str, Any]) -> None:
        """Carry out one of COMMISSION. Raises NotTaken."""
        match method:
            case "commission.start":
                if self._seat is not None and self._seat.driver is not None:
                    raise NotTaken(f"{self._seat.driver} is driving")
                self._commissioning.start(viewer, params)
                self._events.note(viewer.name, f"{self._commissioning.running} begins")
            case "commission.answer":
                self._commissioning.answer(viewer, params)
            case "commission.stop":
                self._events.note(viewer.name, f"{self._commissioning.running} is stopped")
                hidden = params.get("why") == "hidden"
                why = (
                    "the page was hidden, left or without the focus"
                    if hidden
                    else "stopped on a page"
                )
                self._commissioning.stop(why)
            case _:
                self._commissioning.take(viewer)

    async def _save(self, viewer: Viewer, *, dry_run: bool) -> Any:
        """Save the limits, or with `dry_run` return what would be saved. Raises NotTaken."""
        if self._saving.locked():
            raise NotTaken("the robot file is being written by another page: try again")
        async with self._saving:
            saved = await save(self._runtime.path, dry_run=dry_run)
        if not dry_run:
            self._events.note(viewer.name, f"limits saved in {saved['file']}")
        return saved

    async def _edit(self, viewer: Viewer, method: str, params: Mapping[str, Any]) -> Any:
        """Answer a call of the robot file's editor. Raises NotTaken and ClientError."""
        if method == robot_file.SAVE and not viewer.may_write:
            raise NotTaken(NEEDS_TOKEN)
        found = await self._editor.serve(method, params)
        if found.get("backup"):
            self._events.note(viewer.name, f"{found['file']} written")
        return found

    async def _look(self, method: str) -> Any:
        looked_s, found = self._looked.get(method, (0.0, None))
        if time.monotonic() - looked_s > LOOKED_AT_S:
            found = await self._runtime.call(method)
            self._looked[method] = (time.monotonic(), found)
        return found
