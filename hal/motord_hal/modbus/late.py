# SPDX-License-Identifier: Apache-2.0
"""Replies that come after their time: a drive that is slow is not one that is silent, and what it
sends is not noise."""

from __future__ import annotations

from collections.abc import Iterator

from motord_hal.modbus.codec import (
    BROADCAST_UNIT,
    EXCEPTION_BYTES,
    FrameError,
    Function,
    Request,
    parse_reply,
    reply_bytes,
)

KEPT_BYTES = 512
"""More than a late reply and its successor."""


class LateReplies:
    """Remembers of each unit the newest request that was not answered in time, and counts the
    answers that came later. It only counts: no late reply is ever an answer."""

    def __init__(self) -> None:
        self.count = 0
        self._owed: dict[int, Request] = {}
        self._bytes = b""

    def forget(self) -> None:
        """The port is another one."""
        self.count, self._bytes = 0, b""
        self._owed.clear()

    def sent(self) -> None:
        """A request goes out: what came before it belongs to none after it."""
        self._bytes = b""

    def came(self, data: bytes) -> None:
        """Bytes of any drive, or noise."""
        self._bytes = (self._bytes + data)[-KEPT_BYTES:]

    def answered(self, request: Request) -> None:
        """Whatever this unit owed before: an answer to it may look like this one."""
        self._owed.pop(request.unit, None)
        self.look()

    def failed(self, request: Request) -> None:
        """From now on its answer is late. A single write has none that differs from its echo."""
        self.look()
        if request.unit != BROADCAST_UNIT and request.function is not Function.WRITE_SINGLE:
            self._owed[request.unit] = request

    def look(self) -> None:
        """Count what has come since the last request."""
        late = [unit for unit, request in self._owed.items() if _holds(self._bytes, request)]
        for unit in late:
            del self._owed[unit]
        self.count += len(late)


def _holds(data: bytes, request: Request) -> bool:
    return any(_answers(request, frame) for frame in _frames(data, request))


def _frames(data: bytes, request: Request) -> Iterator[bytes]:
    """Whatever may be the answer, by unit and length."""
    for begin in (place for place, byte in enumerate(data) if byte == request.unit):
        for size in (reply_bytes(request), EXCEPTION_BYTES):
            if begin + size <= len(data):
                yield data[begin : begin + size]


def _answers(request: Request, frame: bytes) -> bool:
    try:
        parse_reply(request, frame)
    except FrameError:
        return False
    return True
