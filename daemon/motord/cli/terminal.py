# SPDX-License-Identifier: Apache-2.0
"""The person at a terminal, for the procedures of `motord.commission`."""

from __future__ import annotations

import contextlib
import math
import os
import select
import signal
import sys
import termios
import time
import tty
from collections.abc import Iterator, Sequence
from types import FrameType
from typing import Any, Self

import click

from motord.cli.common import Exit, Failure
from motord.client import ClientError, Refused
from motord.commission.person import Aborted, Failed
from motord.commission.robot_file_edit import EditError
from motord.config import ConfigError

SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
PROGRESS_EVERY_S = 0.2
STOPPED_EVERY_S = 0.1
ABORTED_TEXT = "aborted: nothing was written"


class Terminal:
    """A Person. Answers come from stdin; all text goes to stderr. Between two questions any key
    aborts. It is a context manager that restores the terminal and the signal handlers."""

    def __init__(self, *, yes: bool = False) -> None:
        """`yes`: answer every yes-or-no question with yes; other questions still need an answer."""
        self._yes = yes
        self._keys = sys.stdin.isatty()
        self._cooked: list[Any] | None = None
        self._asking = False
        self._stopped = False
        self._before: dict[int, Any] = {}
        self._line_open = False
        self._shown_s = 0.0

    def __enter__(self) -> Self:
        self._before = {number: signal.signal(number, self._signal) for number in SIGNALS}
        return self

    def __exit__(self, *_: object) -> None:
        self._cook()
        self._end_line()
        for number, handler in self._before.items():
            signal.signal(number, handler)

    # ----------------------------------------------------------------------------------- a Person
    def show(self, text: str) -> None:
        self._end_line()
        with contextlib.suppress(OSError):  # a terminal that is gone: `aborted` detects it
            click.echo(text, err=True)

    def difference(self, text: str) -> None:
        self.show(text)

    def progress(self, text: str) -> None:
        if sys.stderr.isatty() and time.monotonic() > self._shown_s + PROGRESS_EVERY_S:
            self._shown_s = time.monotonic()
            with contextlib.suppress(OSError):
                click.echo(f"\r\033[K{text}; any key stops it", nl=False, err=True)
            self._line_open = True

    def confirm(self, question: str) -> bool:
        if self._yes:
            self.show(f"{question} yes")
            return True
        while True:
            answer = self._ask(f"{question} [y/n] ").lower()
            if answer in ("y", "yes"):
                return True
            if answer in ("n", "no"):
                return False

    def choose(self, question: str, answers: Sequence[str]) -> str:
        while True:
            answer = self._ask(f"{question} [{'/'.join(answers)}] ").lower()
            found = [one for one in answers if answer and one.lower().startswith(answer)]
            if answer in found or len(found) == 1:
                return answer if answer in found else found[0]

    def number(self, question: str, unit: str, low: float, high: float) -> float:
        while True:
            text = self._ask(f"{question} [{unit}] ")
            try:
                value = float(text.replace(",", "."))
            except ValueError:
                value = math.nan
            if low <= value <= high:
                return value
            self.show(f'"{text}" is not a number from {low:g} to {high:g} {unit}')

    def text(self, question: str, default: str) -> str:
        """Return a line of text; the default if it is empty."""
        return self._ask(f"{question} [{default}] " if default else f"{question} ") or default

    def aborted(self) -> bool:
        if self._keys and not self._stopped:
            self._uncook()
            # a key, or the end of a terminal that is gone
            if select.select([sys.stdin], [], [], 0.0)[0]:
                self._stopped = True  # and never False: a signal may have set it meanwhile
                with contextlib.suppress(OSError):
                    os.read(sys.stdin.fileno(), 1024)
        return self._stopped

    # ------------------------------------------------------------------------------------ terminal
    def _signal(self, _number: int, _frame: FrameType | None) -> None:
        self._stopped = True
        if self._asking:
            raise Aborted(ABORTED_TEXT)

    def _ask(self, prompt: str) -> str:
        self._asking = True  # before the look at `_stopped`: a signal between them would be lost
        try:
            if self._stopped or (self._cooked is not None and self.aborted()):
                raise Aborted(ABORTED_TEXT)  # a key since the last look is no answer
            self._cook()
            self._end_line()
            click.echo(prompt, nl=False, err=True)
            line = self._line()
        except OSError as error:
            raise Aborted(f"the terminal is gone ({error.strerror})") from error
        finally:
            self._asking = False
        if not line:
            raise Aborted("there is no answer: give it as an option, or use a terminal")
        return line.strip()

    def _line(self) -> str:
        """Return the answer. At a terminal it checks `_stopped` meanwhile, since the exception of
        the signal handler is lost if it cannot be raised (in a finalizer)."""
        while self._keys and not select.select([sys.stdin], [], [], STOPPED_EVERY_S)[0]:
            if self._stopped:
                raise Aborted(ABORTED_TEXT)
        return sys.stdin.readline()

    def _uncook(self) -> None:
        """Make the terminal deliver keys without Enter and without showing them."""
        if self._cooked is not None:
            return
        try:
            self._cooked = termios.tcgetattr(sys.stdin)
            tty.setcbreak(sys.stdin, termios.TCSAFLUSH)  # keys that were typed before do not count
        except termios.error:
            self._stopped = True

    def _cook(self) -> None:
        if self._cooked is not None:
            with contextlib.suppress(termios.error):
                termios.tcsetattr(sys.stdin, termios.TCSAFLUSH, self._cooked)
            self._cooked = None

    def _end_line(self) -> None:
        if self._line_open:
            self._line_open = False
            with contextlib.suppress(OSError):
                click.echo(err=True)


@contextlib.contextmanager
def failing() -> Iterator[None]:
    """Convert the exceptions of a procedure to the end of a command."""
    try:
        yield
    except Aborted as error:
        raise Failure(str(error) or ABORTED_TEXT) from error
    except ConfigError as error:
        raise Failure(str(error), Exit.USAGE) from error
    except Refused as error:
        raise Failure(str(error), Exit.FAULT) from error
    except (Failed, EditError, ClientError) as error:
        raise Failure(str(error)) from error
