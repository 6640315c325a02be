# SPDX-License-Identifier: Apache-2.0
"""What a procedure needs of the person at the robot. A terminal, a web page and a test each give
their own `Person`; procedures know no other user interface."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol


class Aborted(Exception):
    """The person has ended the procedure, or can no longer be reached: nothing is written."""


class Failed(Exception):
    """The procedure cannot give a result; the message says why and what to do."""


class Person(Protocol):
    """Questions may raise Aborted. While the robot may move, a procedure checks `aborted` at every
    look, 50 times a second, and comes to rest when it is true."""

    def show(self, text: str) -> None:
        """A result or a notice, one or more lines."""

    def difference(self, text: str) -> None:
        """What would change in a file, as `diff -u` shows it."""

    def progress(self, text: str) -> None:
        """What happens now; each text replaces the one before."""

    def confirm(self, question: str) -> bool:
        """Yes or no; without an answer, no."""

    def choose(self, question: str, answers: Sequence[str]) -> str:
        """One of the answers."""

    def text(self, question: str, default: str) -> str:
        """A line of text; the default where the person gives none."""

    def number(self, question: str, unit: str, low: float, high: float) -> float:
        """A finite number of that unit within low..high."""

    def aborted(self) -> bool:
        """Whether the robot has to come to rest now: a key, Ctrl-C, SIGTERM, a lost terminal. Does
        not wait."""
