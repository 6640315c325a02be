# SPDX-License-Identifier: Apache-2.0
"""A terminal that gives each key at once and never blocks; as it was before when it is closed."""

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
    """The controlling terminal. Its file is our own: that it never blocks does not concern other
    programs that have the terminal open."""

    def __init__(self, path: str = "/dev/tty") -> None:
        """Raises NoTerminal."""
        try:
            self.fd = os.open(path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        except OSError as error:
            text = "it reads keys from a terminal, and has none: over SSH use ssh -t"
            raise NoTerminal(text) from error
        self._before = termios.tcgetattr(self.fd)

    def __enter__(self) -> Self:
        """No echo, no lines, no signals by keys, no Ctrl-S."""
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
        with contextlib.suppress(OSError, termios.error):  # it may be closed
            termios.tcflush(self.fd, termios.TCIFLUSH)  # no key for the shell
            termios.tcsetattr(self.fd, termios.TCSANOW, self._before)
        os.close(self.fd)

    def read(self) -> bytes:
        """What has come; empty: nothing. Raises EOFError: the terminal is gone."""
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
        """Whether all of it was taken. A terminal that takes nothing is not waited for."""
        try:
            return os.write(self.fd, data) == len(data)
        except OSError:
            return False

    @property
    def columns(self) -> int:
        """Its width; 80 where it has none."""
        with contextlib.suppress(OSError):
            return os.get_terminal_size(self.fd).columns or 80
        return 80

    def line(self, text: str) -> None:
        """One line, written over the one before."""
        self.write(b"\r\x1b[K" + text[: self.columns - 1].encode())

    def message(self, text: str) -> None:
        """A line that stays."""
        self.write(b"\r\x1b[K" + text.encode() + b"\r\n")
