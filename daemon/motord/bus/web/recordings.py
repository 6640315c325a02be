# SPDX-License-Identifier: Apache-2.0
"""Lists recordings of the robot file's [publish.*] of kind "mcap", and gives them to clients with a
ticket. A link to a file can carry no header, and a token in an address would stay in logs: so a
page requests an address that is valid for one download."""

from __future__ import annotations

import secrets
import time
from collections import OrderedDict
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from motord.bus.commands.gate import NotTaken

SUFFIX = ".mcap"
TICKET_S = 60.0
TICKETS_MAX = 64
ADDRESS = "/recordings/"


class Recordings:
    def __init__(self, folders: Mapping[str, Path]) -> None:
        """`folders`: folders of recordings by the name of their section."""
        self._folders = folders
        self._tickets: dict[bool, OrderedDict[str, tuple[float, Path]]] = {
            has_token: OrderedDict() for has_token in (False, True)
        }
        """Tickets of pages without the token and of those with it: the ones do not push out the
        others."""

    def listed(self) -> list[dict[str, Any]]:
        """Return the recordings, newest first."""
        found = []
        for section, folder in self._folders.items():
            for path in folder.glob(f"*{SUFFIX}"):
                try:
                    about = path.stat()
                except OSError:  # deleted meanwhile to make room
                    continue
                row = {"section": section, "name": path.name, "bytes": about.st_size}
                found.append(row | {"wall_time_s": about.st_mtime})
        return sorted(found, key=lambda row: -row["wall_time_s"])

    def file(self, section: object, name: object) -> Path:
        """Return the path of a recording. Raises NotTaken for a file that is not listed."""
        known = [(row["section"], row["name"]) for row in self.listed()]  # a page sends any type
        if (section, name) not in known:
            raise NotTaken("there is no such recording")
        return self._folders[str(section)] / str(name)

    def ticket(self, section: object, name: object, *, has_token: bool) -> str:
        """Return the address of one download. Raises NotTaken for a file that is not listed."""
        path = self.file(section, name)
        ticket = secrets.token_urlsafe(24)
        tickets = self._tickets[has_token]
        tickets[ticket] = (time.monotonic(), path)
        while len(tickets) > TICKETS_MAX:
            tickets.popitem(last=False)
        return f"{ADDRESS}{ticket}/{name}"

    def redeem(self, address: str) -> Path | None:
        """Return the file of an address, once; None: the ticket is unknown, used, or too old."""
        ticket = address.removeprefix(ADDRESS).partition("/")[0]
        for tickets in self._tickets.values():
            given_s, path = tickets.pop(ticket, (0.0, None))
            if path is not None:
                return path if time.monotonic() - given_s <= TICKET_S else None
        return None
