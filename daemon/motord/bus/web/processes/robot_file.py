# SPDX-License-Identifier: Apache-2.0
"""The robot file in the editor of a page: read, checked, compared and written by a process of its
own (motord/commission/page/robot_file.py), one at a time and at most one in CHECK_EVERY_S."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from motord.bus.commands.gate import NotTaken
from motord.bus.web.processes.command import asked
from motord_hal.base.bounded import TOML_BYTES_MAX

if TYPE_CHECKING:
    from motord.bus.runtime import Runtime

LOOKS = ("file.read", "file.check", "file.diff")
SAVE = "file.save"
CALLS = (*LOOKS, SAVE)
MESSAGE_BYTES_MAX = 3 * TOML_BYTES_MAX + 4096
"""Largest message of a page. JSON has at most three bytes for one of a robot file, such as \\u00e4
for two."""
MODULE = "motord.commission.page.robot_file"
WITHIN_S = 30.0
CHECK_EVERY_S = 0.5
WAITING_MAX = 4
_SHA256_DIGITS = 64


class FileEditor:
    """Serves the editor. `writing` is a lock that is held while the file is written, here and
    elsewhere."""

    def __init__(self, runtime: Runtime, writing: asyncio.Lock) -> None:
        self._runtime, self._writing = runtime, writing
        self._one = asyncio.Lock()
        self._waiting = 0
        self._began_s = -CHECK_EVERY_S

    async def serve(self, method: str, params: Mapping[str, Any]) -> dict[str, Any]:
        """Return the answer of the process. Raises NotTaken and ClientError."""
        request = _request(method, params)
        if self._waiting >= WAITING_MAX:
            raise NotTaken("too many pages check the robot file: try again")
        self._waiting += 1
        try:
            async with self._one:
                return await self._carry_out(request)
        finally:
            self._waiting -= 1

    async def _carry_out(self, request: dict[str, Any]) -> dict[str, Any]:
        await asyncio.sleep(self._began_s + CHECK_EVERY_S - time.monotonic())
        self._began_s = time.monotonic()
        request["file"] = (await self._runtime.call("robot"))["file"]
        if request["file"] is None:
            raise NotTaken("the daemon does not name its robot file")
        if request["do"] != "save":
            found = await asked(MODULE, request, within_s=WITHIN_S)
        elif self._writing.locked():
            raise NotTaken("the robot file is being written by another page: try again")
        else:
            async with self._writing:
                found = await asked(MODULE, request, within_s=WITHIN_S)
        if "failed" in found:
            raise NotTaken(found["failed"])
        answer: dict[str, Any] = found
        return answer


def _request(method: str, params: Mapping[str, Any]) -> dict[str, Any]:
    """Return what the process is sent. Raises NotTaken."""
    request: dict[str, Any] = {"do": method.removeprefix("file.")}
    if method != "file.read":
        text = params.get("text")
        if not isinstance(text, str):
            raise NotTaken("text is what the robot file should have")
        if len(text.encode()) > TOML_BYTES_MAX:
            raise NotTaken(f"a robot file has at most {TOML_BYTES_MAX} bytes")
        request["text"] = text
    if method in ("file.diff", SAVE):
        sha256 = params.get("sha256")
        if not isinstance(sha256, str) or len(sha256) != _SHA256_DIGITS:
            raise NotTaken("sha256 is that of the file that the text was made from")
        request["sha256"] = sha256
    return request
