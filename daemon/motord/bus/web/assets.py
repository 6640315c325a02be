# SPDX-License-Identifier: Apache-2.0
"""The files of the page: read once, compressed once, and asked for again by their hash."""

from __future__ import annotations

import functools
import gzip
import hashlib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from http import HTTPStatus
from pathlib import Path

from aiohttp import web

FOLDER = Path(__file__).parent / "page"
_TYPES = {
    ".html": "text/html; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".css": "text/css; charset=utf-8",
    ".svg": "image/svg+xml",
    ".txt": "text/plain; charset=utf-8",
    ".json": "application/json",
}
_HEADERS = {
    "Cache-Control": "no-cache",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
}


@dataclass(frozen=True, slots=True)
class Asset:
    content_type: str
    etag: str
    raw: bytes
    packed: bytes


@functools.cache
def assets() -> Mapping[str, Asset]:
    """By path; "/" is the page itself."""
    found = {}
    for path in sorted(FOLDER.rglob("*")):
        if path.suffix in _TYPES:
            raw = path.read_bytes()
            etag = f'"{hashlib.sha256(raw).hexdigest()[:24]}"'
            name = f"/{path.relative_to(FOLDER).as_posix()}"
            found[name] = Asset(_TYPES[path.suffix], etag, raw, gzip.compress(raw, mtime=0))
    found["/"] = found["/index.html"]
    return found


def policy(fleet: Iterable[str]) -> str:
    """The page loads nothing but files of its own and connects to no other machine than those of
    the fleet (Content Security Policy Level 3, www.w3.org/TR/CSP3)."""
    others = [f"{address} ws{address.removeprefix('http')}" for address in fleet]
    connect = " ".join(("'self'", *others))
    return (
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; "
        f"connect-src {connect}; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    )


def answer(request: web.BaseRequest, fleet: Iterable[str]) -> web.Response:
    """To a request for a file."""
    asset = assets().get(request.path)
    if asset is None:
        return web.Response(status=HTTPStatus.NOT_FOUND, text="no such file\n")
    if request.method not in ("GET", "HEAD"):
        return web.Response(status=HTTPStatus.METHOD_NOT_ALLOWED, text="GET or HEAD\n")
    headers = {**_HEADERS, "ETag": asset.etag, "Vary": "Accept-Encoding"}
    headers["Content-Security-Policy"] = policy(fleet)
    if request.headers.get("If-None-Match") == asset.etag:
        return web.Response(status=HTTPStatus.NOT_MODIFIED, headers=headers)
    headers["Content-Type"] = asset.content_type
    body = asset.raw
    if "gzip" in request.headers.get("Accept-Encoding", ""):
        headers["Content-Encoding"], body = "gzip", asset.packed
    return web.Response(body=body, headers=headers)
