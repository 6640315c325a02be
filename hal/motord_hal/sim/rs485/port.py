# SPDX-License-Identifier: Apache-2.0
"""The end of a line where bytes come in and go out, and the usual one: a pseudo-terminal."""

from __future__ import annotations

import errno
import math
import os
import termios
import tty
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Protocol

ABSENT_RETRY_S = 0.005
"""Interval between looks whether a program has opened the port."""

_RATES = (300, 600, 1200, 2400, 4800, 9600, 19200, 57600, 115200, 230400, 460800, 500000, 576000)
_FAST_RATES = (921600, 1000000, 1152000, 1500000, 2000000, 2500000, 3000000, 3500000, 4000000)
_BAUDRATES = MappingProxyType({getattr(termios, f"B{r}"): r for r in (*_RATES, *_FAST_RATES)})
"""Baud rates by termios constant, without 38400, the rate of a pseudo-terminal that was never set
up."""


@dataclass(frozen=True, slots=True)
class MasterSettings:
    """Settings that the other side has made on its port."""

    baudrate: int
    odd_parity: bool


class Port(Protocol):
    """One end of a line. `take_in` and `put` never wait."""

    segments_s: float
    """Pause between the pieces of what is sent. Only TCP has pieces."""

    @property
    def address(self) -> str:
        """Name of the port in a robot file."""

    @property
    def plugged(self) -> bool: ...

    def plug(self) -> None:
        """Open the port. Raises OSError."""

    def pull(self) -> None:
        """Remove the port. A connected program gets a hang-up."""

    def filenos(self, now_s: float) -> list[int]:
        """Return the descriptors to wait for with select."""

    def due_s(self, now_s: float) -> float:
        """Return the time at which `take_in` has to be called without a ready file."""

    def take_in(self, now_s: float) -> bytes | None:
        """Return the bytes that have come; None: no program is connected."""

    def put(self, data: bytes, now_s: float) -> int:
        """Send bytes; return how many were sent. Bytes without a reader are lost, as in a UART's
        full buffer."""

    def settings(self) -> MasterSettings | None:
        """Return the master's settings; None: they were never set, or the port has none."""

    def hold_reply(self) -> bool:
        """Hold the next reply back until the next request. Return False if the port does not pair
        them."""

    def stall(self, until_s: float) -> None:
        """Let nothing pass until `until_s`."""

    def forget(self) -> None:
        """Drop the connections silently."""


class PtyPort:
    """A pty master, half-duplex. `link` is the path that a robot file would name as its port."""

    def __init__(self, link: Path) -> None:
        self.link = link
        self.segments_s = 0.0
        self._fd: int | None = None
        self._absent_until_s = -math.inf

    @property
    def address(self) -> str:
        return str(self.link)

    @property
    def plugged(self) -> bool:
        return self._fd is not None

    def plug(self) -> None:
        """Make a new pty, and the link to it."""
        if self.link.exists() and not self.link.is_symlink():
            raise FileExistsError(errno.EEXIST, "is in the place of a line's port", str(self.link))
        try:
            self._fd, slave_fd = os.openpty()
        except OSError as error:  # the error has no file name
            why = f"{error.strerror}: a simulated port is a pseudo-terminal; is devpts mounted?"
            raise OSError(error.errno, why, "/dev/ptmx") from None
        os.set_blocking(self._fd, False)
        # The master sets a pty's modes, too: nothing keeps the other side open, and a client
        # that goes away is seen.
        tty.setraw(self._fd)
        fresh = self.link.with_name(f".{self.link.name}.{os.getpid()}")
        fresh.unlink(missing_ok=True)
        fresh.symlink_to(os.ttyname(slave_fd))
        fresh.replace(self.link)
        os.close(slave_fd)
        self._absent_until_s = -math.inf

    def pull(self) -> None:
        """Remove the adapter and its device file. A program that has the port open gets a
        hang-up."""
        if self._fd is None:
            return
        os.close(self._fd)
        self._fd = None
        self.link.unlink(missing_ok=True)

    def filenos(self, now_s: float) -> list[int]:
        return [] if self._fd is None or now_s < self._absent_until_s else [self._fd]

    def due_s(self, now_s: float) -> float:
        del now_s
        return math.inf if self._absent_until_s == -math.inf else self._absent_until_s

    def take_in(self, now_s: float) -> bytes | None:
        if self._fd is None or now_s < self._absent_until_s:
            return None
        self._absent_until_s = -math.inf
        try:
            return os.read(self._fd, 4096)
        except BlockingIOError:
            return b""
        except OSError:  # no program has the other side open
            self._absent_until_s = now_s + ABSENT_RETRY_S
            return None

    def put(self, data: bytes, now_s: float) -> int:
        del now_s
        if self._fd is None:
            return 0
        try:
            return os.write(self._fd, data)
        except BlockingIOError:
            return 0

    def settings(self) -> MasterSettings | None:
        """Return the modes in the kernel's pty. It keeps speed, stop bits and PARODD, but clears
        PARENB (drivers/tty/pty.c, pty_set_termios), so even parity looks like none."""
        if self._fd is None:
            return None
        modes = termios.tcgetattr(self._fd)
        baudrate = _BAUDRATES.get(modes[5])
        odd = bool(modes[2] & termios.PARODD)
        return None if baudrate is None else MasterSettings(baudrate, odd)

    def hold_reply(self) -> bool:
        return False

    def stall(self, until_s: float) -> None:
        """Do nothing: a serial port does not stall."""

    def forget(self) -> None:
        """Do nothing: a serial port has no connections."""
