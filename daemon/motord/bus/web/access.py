# SPDX-License-Identifier: Apache-2.0
"""Decides which page may connect, and which may command: by its token, its origin and the name by
which it reached us.

A browser permits every site to open a WebSocket to this machine, and names that site in the header
Origin. A site can also make its own name mean 127.0.0.1, and then has our origin. So without a
token only names of this machine are accepted, and nothing that a proxy forwards.
"""

from __future__ import annotations

import base64
import binascii
from collections.abc import Callable
from dataclasses import dataclass

from aiohttp import web

from motord.config import WebInput, WebServer

PROTOCOL, TOKEN_PREFIX = "motord.1", "token."
"""Subprotocols of the WebSocket. The second one carries the token, as base64url without padding:
a page cannot set a header."""
WRONG_TOKEN = "the token is wrong"  # noqa: S105  a sentence
NEEDS_TOKEN = "this dashboard needs the token of the robot"  # noqa: S105  a sentence
_LOCAL_NAMES = ("127.0.0.1", "[::1]", "localhost")
_FORWARDED = ("Forwarded", "X-Forwarded-For", "X-Forwarded-Host", "X-Real-IP", "Via")


class Stranger(Exception):
    """A request from another site; the text is the reason of its refusal."""


@dataclass(frozen=True, slots=True)
class Right:
    """Rights of a page."""

    watch: bool
    command: bool
    why: str = ""
    """Why the page may not watch; empty if it may."""
    token: bool = False
    """Whether the page has shown the token."""


class Access:
    def __init__(self, section: WebServer, fits: Callable[[object], bool] | None) -> None:
        """`fits` returns whether a token is the right one; None: the robot file names no token."""
        self._fits = fits
        self._commands = isinstance(section, WebInput)
        self._trusts = isinstance(section, WebInput) and section.trust_loopback
        self._local = f"[{section.host}]" if ":" in section.host else section.host
        self._fleet = {_plain(address) for address in section.fleet}

    def check_origin(self, request: web.BaseRequest) -> None:
        """Check the origin of a request. Raises Stranger for a page that is neither ours nor of the
        fleet."""
        origin = request.headers.get("Origin")
        if origin is None:
            return
        own = origin.lower().partition("://")[2]
        if own != request.headers.get("Host", "").lower() and _plain(origin) not in self._fleet:
            raise Stranger("pages of other sites may not connect: see `fleet` in the robot file")

    def right(self, request: web.BaseRequest) -> Right:
        """Return the rights of a request whose origin was checked."""
        shown = token_of(request)
        if shown is not None and self._fits is not None:
            if self._fits(shown):
                return Right(watch=True, command=self._commands, token=True)
            return Right(watch=False, command=False, why=WRONG_TOKEN)
        if self._local not in _LOCAL_NAMES or not _from_here(request):
            return Right(watch=False, command=False, why=NEEDS_TOKEN)
        return Right(watch=True, command=self._trusts)


def token_of(request: web.BaseRequest) -> str | None:
    """Return the token in the subprotocol, or in the header "Authorization: Bearer ..."; None: no
    token."""
    kind, _, shown = request.headers.get("Authorization", "").partition(" ")
    if kind.lower() == "bearer":
        return shown.strip()
    for name in request.headers.get("Sec-WebSocket-Protocol", "").split(","):
        found = name.strip()
        if found.startswith(TOKEN_PREFIX):
            return _decoded(found.removeprefix(TOKEN_PREFIX))
    return None


def _decoded(text: str) -> str:
    """Decode a token; empty, which is no valid token, for text that is not base64url."""
    try:
        return base64.urlsafe_b64decode(text + "=" * (-len(text) % 4)).decode()
    except (binascii.Error, ValueError):
        return ""


def _from_here(request: web.BaseRequest) -> bool:
    """Return whether a request was sent to a name of this machine, and not forwarded by a proxy."""
    host = request.headers.get("Host", "").lower()
    name = host.rpartition(":")[0] if not host.endswith("]") and ":" in host else host
    return name in _LOCAL_NAMES and not any(key in request.headers for key in _FORWARDED)


def _plain(address: str) -> str:
    """Return an origin as browsers send it: without the default port."""
    return address.lower().removesuffix(":80" if address.startswith("http:") else ":443")
