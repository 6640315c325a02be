# SPDX-License-Identifier: Apache-2.0
"""Fingers on a page: real touch events of Chromium, by its DevTools protocol."""

import contextlib
import time

SWIPE_S = 0.05
"""Time that a swipe of a test takes, by the stamps of its events."""


class Fingers:
    """Fingers by their number. Stamps of events are given by the test: the time that a busy machine
    takes to send them does not count. Between two events pass `step_s`."""

    def __init__(self, page, step_s=0.5):
        self._session = page.context.new_cdp_session(page)
        self._points = {}
        self._now_s = time.time()
        self.step_s = step_s

    def press(self, finger, x, y):
        self._points[finger] = (x, y)
        self._send("touchStart")

    def move(self, finger, x, y):
        self._points[finger] = (x, y)
        self._send("touchMove")

    def lift(self, finger):
        """Lift a finger, if it is down."""
        if finger in self._points:
            self._send("touchEnd", [finger])
            del self._points[finger]

    def tap(self, finger, x, y):
        self.press(finger, x, y)
        self.lift(finger)

    def swipe(self, begin, end, steps=8):
        """Move a finger that does not rest anywhere from one point to another, and lift it."""
        with self.quick(steps):
            self.press(0, *begin)
            for step in range(1, steps + 1):
                ends = zip(begin, end, strict=True)
                self.move(0, *(a + (b - a) * step / steps for a, b in ends))
        self.lift(0)

    @contextlib.contextmanager
    def quick(self, steps):
        usual_s, self.step_s = self.step_s, SWIPE_S / steps
        yield
        self.step_s = usual_s

    def end(self):
        with contextlib.suppress(Exception):  # the page is closed
            if self._points:
                none = {"type": "touchCancel", "touchPoints": []}
                self._session.send("Input.dispatchTouchEvent", none)
            self._session.detach()

    def _send(self, kind, fingers=None):
        self._now_s += self.step_s
        named = {one: self._points[one] for one in fingers or self._points}
        points = [{"x": x, "y": y, "id": one} for one, (x, y) in named.items()]
        self._session.send(
            "Input.dispatchTouchEvent",
            {"type": kind, "touchPoints": points, "timestamp": self._now_s},
        )
