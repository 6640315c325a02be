# SPDX-License-Identifier: Apache-2.0
"""Replies that come too late. A slow drive is not a silent drive, and its late reply is not
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
"""Limit for kept bytes: more than a late reply and its successor."""


class LateReplies:
    """The newest request of each unit that was not answered in time, and a count of late answers. A
    late reply is only counted, never used as an answer."""

    def __init__(self) -> None:
        self.count = 0
        self._owed: dict[int, Request] = {}
        self._bytes = b""

    def forget(self) -> None:
        """Begin anew after the port was opened again."""
        self.count, self._bytes = 0, b""
        self._owed.clear()

    def sent(self) -> None:
        """Note that a request goes out: bytes before it do not belong to it or to later ones."""
        self._bytes = b""

    def came(self, data: bytes) -> None:
        """Keep received bytes, from a drive or noise."""
        self._bytes = (self._bytes + data)[-KEPT_BYTES:]

    def answered(self, request: Request) -> None:
        """Note that the unit has answered, and forget its older requests: their answers may look
        the same."""
        self._owed.pop(request.unit, None)
        self.look()

    def failed(self, request: Request) -> None:
        """Note that the request has failed: an answer is late from now on. The answer to a single
        write equals its echo, so such a request is not kept."""
        self.look()
        if request.unit != BROADCAST_UNIT and request.function is not Function.WRITE_SINGLE:
            self._owed[request.unit] = request

    def look(self) -> None:
        """Count the late replies among the bytes since the last request."""
        late = [unit for unit, request in self._owed.items() if _holds(self._bytes, request)]
        for unit in late:
            del self._owed[unit]
        self.count += len(late)


def _holds(data: bytes, request: Request) -> bool:
    return any(_answers(request, frame) for frame in _frames(data, request))


def _frames(data: bytes, request: Request) -> Iterator[bytes]:
    """Yield every part of the data that may be the answer, by unit and length."""
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
