# SPDX-License-Identifier: Apache-2.0
"""Recordings on pages: list and download them, start and stop them, run them again."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from aiohttp import web

from motord.bus.commands.gate import NotTaken, short
from motord.bus.web.processes.replaying import Replays
from motord.bus.web.recordings import Recordings
from motord.config import McapPublish

if TYPE_CHECKING:
    from motord.bus.runtime import Runtime

LOOKS = ("recordings", "ticket")
CHANGES = ("record.start", "record.stop", "replay", "replay.cancel")
"""Calls that a page needs the right to command for; a page that only watches may make those of
LOOKS."""


class Tape:
    """The recordings of one dashboard."""

    def __init__(self, runtime: Runtime, changed: Callable[[], None]) -> None:
        """`changed` is called when pages that show recordings have to list them again."""
        self._runtime, self._changed = runtime, changed
        self._files = Recordings(
            {
                key: runtime.beside_robot_file(found.folder)
                for key, found in runtime.robot.publish.items()
                if isinstance(found, McapPublish)
            }
        )
        self.replays = Replays(changed)

    async def look(self, method: str, params: Mapping[str, Any], *, has_token: bool) -> Any:
        """Answer one of LOOKS, for a page that has shown the token or one that has not. Raises
        NotTaken."""
        if method == "ticket":
            section, name = params.get("section"), params.get("name")
            return await asyncio.to_thread(self._files.ticket, section, name, has_token=has_token)
        return self._described(await asyncio.to_thread(self._files.listed))

    async def change(self, method: str, params: Mapping[str, Any]) -> dict[str, Any]:
        """Answer one of CHANGES. Raises NotTaken."""
        section, name = params.get("section"), params.get("name")
        if method.startswith("record."):
            recorder = self._runtime.recorders.get(str(section))
            if recorder is None:
                raise NotTaken(f"there is no [publish.*] of kind mcap named {short(section)}")
            recorder.start() if method == "record.start" else recorder.stop()
            self._changed()
            return {}
        path = await asyncio.to_thread(self._files.file, section, name)
        key = (str(section), str(name))
        if method == "replay.cancel":
            self.replays.cancel(key)
        elif path.name in self._open():
            raise NotTaken("it is still being written: stop it first")
        else:
            self.replays.start(key, path)
        return {}

    def redeem(self, request: web.BaseRequest) -> web.StreamResponse | None:
        """Return the download of an address; None: the address has expired."""
        path = self._files.redeem(request.path)
        if request.method != "GET" or path is None:
            return None
        headers = {"Content-Type": "application/octet-stream", "Cache-Control": "no-store"}
        return web.FileResponse(path, headers=headers)

    def _described(self, rows: list[dict[str, Any]]) -> dict[str, Any]:
        recorders = [
            {"section": name, **asdict(one.state)} for name, one in self._runtime.recorders.items()
        ]
        files = [
            row | {
                "writing": row["name"] in self._open(),
                "replay": self.replays.found.get((row["section"], row["name"])),
            }
            for row in rows
        ]  # fmt: skip
        return {"recorders": recorders, "files": files}

    def _open(self) -> set[str | None]:
        """Return the names of files that are being written."""
        return {one.state.file for one in self._runtime.recorders.values()}
