# SPDX-License-Identifier: Apache-2.0
"""Replies that come too late: a slow drive is not a silent drive, and its late reply is not
noise."""

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
    """Keeps the newest request of each unit that was not answered in time, and counts late answers.
    It only counts: a late reply is never used as an answer."""

    def __init__(self) -> None:
        self.count = 0
        self._owed: dict[int, Request] = {}
        self._bytes = b""

    def forget(self) -> None:
        """The port was opened again."""
        self.count, self._bytes = 0, b""
        self._owed.clear()

    def sent(self) -> None:
        """A request goes out: bytes before it do not belong to it or to later ones."""
        self._bytes = b""

    def came(self, data: bytes) -> None:
        """Bytes came, from a drive or noise."""
        self._bytes = (self._bytes + data)[-KEPT_BYTES:]

    def answered(self, request: Request) -> None:
        """The unit has answered: forget its older requests, whose answers may look the same."""
        self._owed.pop(request.unit, None)
        self.look()

    def failed(self, request: Request) -> None:
        """From now on its answer is late. The answer to a single write equals its echo."""
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
    """Every place where the answer may be, by unit and length."""
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
