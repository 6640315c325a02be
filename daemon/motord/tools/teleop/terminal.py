# SPDX-License-Identifier: Apache-2.0
"""A terminal that passes on each key at once and never blocks. When it is closed, its settings are
as before."""

from __future__ import annotations

import contextlib
import os
import termios
from types import TracebackType
from typing import Self

READ_BYTES_MAX = 4096


class NoTerminal(Exception):
    """This program has no terminal."""


class Terminal:
    """The controlling terminal. It is opened a second time, so that non-blocking access does not
    change other programs that have the terminal open."""

    def __init__(self, path: str = "/dev/tty") -> None:
        """Open the terminal. Raise NoTerminal if this program has none."""
        try:
            self.fd = os.open(path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        except OSError as error:
            text = "it reads keys from a terminal, and has none: over SSH use ssh -t"
            raise NoTerminal(text) from error
        self._before = termios.tcgetattr(self.fd)

    def __enter__(self) -> Self:
        """Switch off echo, line mode, signals by keys and Ctrl-S."""
        mode = termios.tcgetattr(self.fd)
        mode[0] &= ~(termios.IXON | termios.ICRNL)
        mode[3] &= ~(termios.ICANON | termios.ECHO | termios.ISIG | termios.IEXTEN)
        mode[6][termios.VMIN], mode[6][termios.VTIME] = 1, 0
        termios.tcsetattr(self.fd, termios.TCSANOW, mode)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:  # fmt: skip
        with contextlib.suppress(OSError, termios.error):  # the terminal may be closed
            termios.tcflush(self.fd, termios.TCIFLUSH)  # drop keys, which the shell would get
            termios.tcsetattr(self.fd, termios.TCSANOW, self._before)
        os.close(self.fd)

    def read(self) -> bytes:
        """Return the bytes that have come; empty: none. Raise EOFError if the terminal is gone."""
        try:
            data = os.read(self.fd, READ_BYTES_MAX)
        except BlockingIOError:
            return b""
        except OSError as error:
            raise EOFError from error
        if not data:
            raise EOFError
        return data

    def write(self, data: bytes) -> bool:
        """Write without waiting. Return whether the terminal took all of the data."""
        try:
            return os.write(self.fd, data) == len(data)
        except OSError:
            return False

    @property
    def columns(self) -> int:
        """Width of the terminal in characters; 80 if it is not known."""
        with contextlib.suppress(OSError):
            return os.get_terminal_size(self.fd).columns or 80
        return 80

    def line(self, text: str) -> None:
        """Show a text in place of the last line."""
        self.write(b"\r\x1b[K" + text[: self.columns - 1].encode())

    def message(self, text: str) -> None:
        """Show a text in a line that is not overwritten."""
        self.write(b"\r\x1b[K" + text.encode() + b"\r\n")
