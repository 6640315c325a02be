# SPDX-License-Identifier: Apache-2.0
"""The files of the page, and the schema of the robot file. They are read once and compressed once,
and browsers compare their hashes.

The style and script that the first paint needs are in the page itself, where the policy permits
them by hash: it takes one request.
"""

from __future__ import annotations

import base64
import functools
import gzip
import hashlib
import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from http import HTTPStatus
from pathlib import Path

from aiohttp import web

from motord_hal.base.paths import config_dir

FOLDER = Path(__file__).parent / "page"
SCHEMA = "robot.schema.json"
_INLINE = {
    "style.css": ('<link rel="stylesheet" href="style.css" />', "style"),
    "theme.js": ('<script src="theme.js"></script>', "script"),
}
"""Files that become part of the page: the text that each replaces, and the element that holds
it."""
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
    """Return the files by path; "/" is the page itself."""
    found = {}
    for path in sorted(FOLDER.rglob("*")):
        if path.suffix in _TYPES and path.name not in _INLINE:
            raw = _with_inline(path) if path.suffix == ".html" else path.read_bytes()
            name = f"/{path.relative_to(FOLDER).as_posix()}"
            found[name] = _asset(raw, path.suffix)
    schema = json.loads((config_dir() / "schema" / SCHEMA).read_bytes())
    found[f"/{SCHEMA}"] = _asset(json.dumps(schema, separators=(",", ":")).encode(), ".json")
    found["/"] = found["/index.html"]
    return found


def _asset(raw: bytes, suffix: str) -> Asset:
    etag = f'"{hashlib.sha256(raw).hexdigest()[:24]}"'
    return Asset(_TYPES[suffix], etag, raw, gzip.compress(raw, mtime=0))


def _with_inline(path: Path) -> bytes:
    """Return the page with the files that are part of it."""
    page = path.read_text(encoding="utf-8")
    for name, (place, element) in _INLINE.items():
        text = (FOLDER / name).read_text(encoding="utf-8")
        assert page.count(place) == 1
        page = page.replace(place, f"<{element}>{text}</{element}>")
    return page.encode()


@functools.cache
def _hash_of(name: str) -> str:
    """Return the hash by which the policy permits an element with that file's content."""
    digest = hashlib.sha256((FOLDER / name).read_bytes()).digest()
    return f"'sha256-{base64.b64encode(digest).decode()}'"


def policy(fleet: Iterable[str]) -> str:
    """Return the policy: the page loads only files of its own and connects to no other machine than
    those of the fleet (Content Security Policy Level 3, www.w3.org/TR/CSP3)."""
    others = [f"{address} ws{address.removeprefix('http')}" for address in fleet]
    connect = " ".join(("'self'", *others))
    return (
        f"default-src 'none'; script-src 'self' {_hash_of('theme.js')}; "
        f"style-src 'self' {_hash_of('style.css')}; img-src 'self' data:; "
        f"connect-src {connect}; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    )


def answer(request: web.BaseRequest, fleet: Iterable[str]) -> web.Response:
    """Return the answer to a request for a file."""
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
