# SPDX-License-Identifier: Apache-2.0
"""Counters of the UART's driver, and what they show about an unresponsive drive.

Source: kernel, include/uapi/linux/serial.h (struct serial_icounter_struct), ioctl TIOCGICOUNT.
"""

from __future__ import annotations

import fcntl
import struct
from collections import deque
from dataclasses import dataclass

from motord_hal.base.clock import now_s

LOOK_EVERY_S = 0.2
LOOKS_KEPT = 10
"""Number of kept looks: errors of the last two seconds may explain an unresponsive drive."""

_TIOCGICOUNT = 0x545D
_ICOUNTER = struct.Struct("=20i")


@dataclass(frozen=True, slots=True)
class Counters:
    """Counts of the driver since it was loaded."""

    received: int
    framing: int
    overrun: int
    parity: int


def read_counters(fd: int) -> Counters | None:
    """Return the driver's counts; None: it does not count (pseudo-terminals, some adapters)."""
    try:
        raw = _ICOUNTER.unpack(fcntl.ioctl(fd, _TIOCGICOUNT, bytes(_ICOUNTER.size)))
    except OSError:
        return None
    return Counters(received=raw[4], framing=raw[6], overrun=raw[7], parity=raw[8])


def _times(count: int, what: str) -> str:
    return f"{count} {what} error{'' if count == 1 else 's'}"


@dataclass(frozen=True, slots=True)
class Traffic:
    """Traffic over the line since the port was opened."""

    noise_bytes: int = 0
    """Number of bytes that are neither a frame nor the copy of a request."""
    frames: int = 0
    """Number of good replies and refusals, of any drive."""
    late: int = 0
    """Number of good replies that came too late."""


NOTHING = Traffic()


def unresponsive_hint(
    before: Counters | None,
    after: Counters | None,
    seen: Traffic = NOTHING,
    now: Traffic = NOTHING,
) -> str:
    """Return why a drive may be unresponsive, to follow "is unresponsive"; "": no hint. `seen` is
    from the time of `before`."""
    if before is not None and after is not None:
        framing, parity = after.framing - before.framing, after.parity - before.parity
        if parity > 0 and parity >= framing:
            return f"{_times(parity, 'parity')}: parity or stop bits differ"
        if framing > 0:
            return f"{_times(framing, 'framing')}: baud rate or stop bits differ"
        if after.overrun > before.overrun:
            lost = _times(after.overrun - before.overrun, "overrun")
            return f"{lost}: this machine lost bytes"
    if now.late > seen.late:
        return (
            "replies come after their time: the drive or the adapter is slow, see reply_timeout_s"
        )
    if now.noise_bytes == seen.noise_bytes:
        return ""
    if now.frames > seen.frames:
        return (
            "torn or damaged replies came among good ones: wiring, noise, one address twice, "
            "or this drive's baud rate or parity?"
        )
    return "bytes came, but no frame: baud rate or parity?"


class Witness:
    """Memory of the latest counts of an open port, for the moment when a drive stops answering."""

    def __init__(self) -> None:
        self._seen: deque[tuple[float, Counters | None, Traffic]] = deque(maxlen=LOOKS_KEPT)

    def forget(self) -> None:
        """Begin anew after the port was opened again."""
        self._seen.clear()

    def look(self, fd: int, traffic: Traffic = NOTHING) -> None:
        """Read the driver's counters when that is due. Call this often."""
        now = now_s()
        if not self._seen or now - self._seen[-1][0] >= LOOK_EVERY_S:
            self._seen.append((now, read_counters(fd), traffic))

    def hint(self, fd: int, traffic: Traffic = NOTHING) -> str:
        """Return `unresponsive_hint` from the oldest stored counters to now."""
        if not self._seen:
            return ""
        _, before, seen = self._seen[0]
        return unresponsive_hint(before, read_counters(fd), seen, traffic)
