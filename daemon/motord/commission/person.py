# SPDX-License-Identifier: Apache-2.0
"""Interface between a procedure and the person at the robot. A terminal, a web page and a test each
have their own `Person`; procedures know no other user interface."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol


class Aborted(Exception):
    """The person has ended the procedure, or can no longer be reached: nothing is written."""


class Failed(Exception):
    """The procedure cannot give a result; the message says why and what to do."""


class Person(Protocol):
    """The person at the robot. Questions may raise Aborted. While the robot may move, a procedure
    checks `aborted` at every look, 50 times a second, and brings it to rest when it is true."""

    def show(self, text: str) -> None:
        """Show a result or a notice, one or more lines."""

    def difference(self, text: str) -> None:
        """Show what would change in a file, in the form of `diff -u`."""

    def progress(self, text: str) -> None:
        """Show what happens now; each text replaces the one before."""

    def confirm(self, question: str) -> bool:
        """Return the answer to a question, yes or no; no answer counts as no."""

    def choose(self, question: str, answers: Sequence[str]) -> str:
        """Return the one of the answers that the person chooses."""

    def text(self, question: str, default: str) -> str:
        """Return a line of text; the default if the person gives none."""

    def number(self, question: str, unit: str, low: float, high: float) -> float:
        """Return a finite number of that unit within low..high."""

    def aborted(self) -> bool:
        """Return whether the robot has to come to rest now: a key, Ctrl-C, SIGTERM, a lost
        terminal. Does not wait."""
