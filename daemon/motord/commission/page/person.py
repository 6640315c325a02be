# SPDX-License-Identifier: Apache-2.0
"""The person at a page of the dashboard, for the procedures of `motord.commission`. Messages are
lines of JSON in both directions; motord-bus passes them between this process and the page.

The robot may move only while the page is present: it is visible, its connection lives, and it shows
the newest state. When that is no longer so, the robot comes to rest and the procedure ends."""

from __future__ import annotations

import json
import math
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any, TextIO, TypeVar

from motord.commission.page.pictures import Plot
from motord.commission.person import Aborted

PRESENT_S = 1.0
"""Longest time without a sign of the page before it counts as gone; long enough since the motions
are bounded and slow."""
PROGRESS_EVERY_S = 0.1
SILENT = "the connection to the page was interrupted: answer again"
_TEXT_MAX = 200
_T = TypeVar("_T")


class PagePerson:
    """A Person. The page sends `{"answer": number, "value": ...}`, `{"present_s": ...}` (the time
    at which it was present, on CLOCK_MONOTONIC), `{"stop": why}`. It receives `show`, `difference`,
    `picture`, `progress`, `question`, one a line."""

    def __init__(self, source: TextIO, sink: TextIO) -> None:
        self._source, self._sink = source, sink
        self._changed = threading.Condition()
        self._stopped = ""
        self._present_s = -math.inf
        self._asked = 0
        self._answer: dict[str, Any] | None = None
        self._progressed_s = -math.inf
        threading.Thread(target=self._read, daemon=True).start()

    @property
    def why(self) -> str:
        """Why the procedure was ended; empty: it was not ended."""
        return self._stopped

    # ----------------------------------------------------------------------------------- a Person
    def show(self, text: str) -> None:
        self.send({"show": text})

    def difference(self, text: str) -> None:
        self.send({"difference": text})

    def picture(self, plot: Plot) -> None:
        """Show a plot of what was measured."""
        self.send({"picture": plot})

    def progress(self, text: str) -> None:
        if time.monotonic() - self._progressed_s > PROGRESS_EVERY_S:
            self._progressed_s = time.monotonic()
            self.send({"progress": text})

    def confirm(self, question: str) -> bool:
        return self._ask(question, {"kind": "confirm"}, _truth)

    def choose(self, question: str, answers: Sequence[str]) -> str:
        def one(value: object) -> str:
            if value not in answers:
                raise ValueError(f"not one of {', '.join(answers)}")
            return str(value)

        return self._ask(question, {"kind": "choose", "answers": list(answers)}, one)

    def text(self, question: str, default: str) -> str:
        def line(value: object) -> str:
            if not isinstance(value, str) or len(value) > _TEXT_MAX or not value.isprintable():
                raise ValueError("not a line of text")
            return value.strip() or default

        return self._ask(question, {"kind": "text", "default": default}, line)

    def number(self, question: str, unit: str, low: float, high: float) -> float:
        def finite(value: object) -> float:
            if isinstance(value, bool) or not isinstance(value, int | float):
                raise ValueError("not a number")
            if not low <= value <= high:
                raise ValueError(f"not a number from {low:g} to {high:g} {unit}")
            return float(value)

        about = {"kind": "number", "unit": unit, "low": low, "high": high}
        return self._ask(question, about, finite)

    def aborted(self) -> bool:
        """Return whether the procedure was stopped or the page is gone; once true, it stays so."""
        with self._changed:
            silent_s = time.monotonic() - self._present_s
            if not self._stopped and not silent_s <= PRESENT_S:
                self._stopped = f"the page was silent for {silent_s:.1f} s"
            return bool(self._stopped)

    # ------------------------------------------------------------------------------------ messages
    def send(self, message: Mapping[str, Any]) -> None:
        """Send one line. If motord-bus is gone, the procedure ends."""
        try:
            self._sink.write(json.dumps(message, allow_nan=False) + "\n")
            self._sink.flush()
        except OSError:
            self._stop("motord-bus has ended")

    def _ask(self, question: str, about: Mapping[str, Any], judge: Callable[[object], _T]) -> _T:
        """Ask until `judge` accepts an answer, and return it; it raises ValueError for others.
        Raises Aborted."""
        problem = ""
        while True:
            with self._changed:
                self._asked, self._answer = self._asked + 1, None
                number = self._asked
            self.send(
                {"question": {"number": number, "text": question, "problem": problem, **about}}
            )
            with self._changed:
                while self._answer is None and not self._stopped:
                    self._changed.wait()
                if self._answer is None:
                    raise Aborted(f"{self._stopped}: nothing was written")
                value, silent_s = self._answer.get("value"), time.monotonic() - self._present_s
            if not silent_s <= PRESENT_S:  # the answer may have waited on an interrupted connection
                problem = SILENT
                continue
            try:
                return judge(value)
            except ValueError as error:
                problem = str(error)

    def _read(self) -> None:
        """Handle incoming messages until the end of input; runs in a thread of its own."""
        for line in self._source:
            message = json.loads(line)
            if "stop" in message:
                self._stop(message["stop"])
            elif "present_s" in message:
                self._present_s = max(self._present_s, message["present_s"])
            elif message.get("answer") == self._asked:
                with self._changed:
                    self._answer = message
                    self._changed.notify()
        self._stop("motord-bus has ended")

    def _stop(self, why: str) -> None:
        with self._changed:
            self._stopped = self._stopped or why
            self._changed.notify()


def _truth(value: object) -> bool:
    if not isinstance(value, bool):
        raise ValueError("yes or no")
    return value
