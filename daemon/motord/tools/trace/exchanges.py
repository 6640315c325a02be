# SPDX-License-Identifier: Apache-2.0
"""Joins the trace entries of a line (bytes sent or received) to exchanges. Pure."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import can

from motord_hal.can.socket_frames import unpacked


@dataclass(frozen=True, slots=True, kw_only=True)
class Exchange:
    """The bytes that were sent, and those that came until the next were sent; on CAN one frame."""

    stamp_ns: int
    """Time of sending; of a frame that came without a request, time of its arrival."""
    sent: bytes = b""
    received: bytes = b""
    reply_ns: int | None = None
    """Time at which the last received part came; None: nothing came."""

    @property
    def outward(self) -> bool:
        return bool(self.sent)


class Joiner:
    """Joins trace entries to exchanges. On a serial line a reply comes in pieces."""

    def __init__(self, kind: str) -> None:
        self._one_by_one = kind == "can"
        self._open: Exchange | None = None

    def feed(self, entries: Sequence[Mapping[str, Any]]) -> Iterator[Exchange]:
        """Take entries; yield the exchanges that are complete."""
        for entry in entries:
            data, stamp_ns = bytes.fromhex(entry["data"]), int(entry["stamp_ns"])
            if entry["outward"]:
                yield from self.end()
                self._open = Exchange(stamp_ns=stamp_ns, sent=data)
            elif self._open is None or self._one_by_one:
                yield from self.end()
                yield Exchange(stamp_ns=stamp_ns, received=data, reply_ns=stamp_ns)
            else:
                self._open = Exchange(
                    stamp_ns=self._open.stamp_ns, sent=self._open.sent,
                    received=self._open.received + data, reply_ns=stamp_ns,
                )  # fmt: skip
            if self._one_by_one:
                yield from self.end()

    def end(self) -> Iterator[Exchange]:
        """Yield the exchange that is still open, if there is one."""
        if self._open is not None:
            found, self._open = self._open, None
            yield found


@dataclass(frozen=True, slots=True)
class Words:
    """The description of an exchange for a person: drive, content and result."""

    joint: str
    what: str
    result: str
    """"ok", "no reply", "exception ...", "bad CRC" and others; for a frame on CAN "out" or "in"."""


def can_message(exchange: Exchange, time_s: float, channel: str) -> can.Message:
    """Convert an exchange on CAN to a message for the writers of python-can."""
    message = unpacked(exchange.sent or exchange.received, time_s)
    message.channel, message.is_rx = channel, not exchange.outward
    return message
