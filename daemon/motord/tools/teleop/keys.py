# SPDX-License-Identifier: Apache-2.0
"""Decodes the bytes of a terminal to keys, and decides which motion they request. No I/O, no clock.

A terminal does not report that a key was released: it repeats the key that is held, after a delay
(250 to 660 ms), about 30 times a second. So the motion ends when the repeats end.
"""

from __future__ import annotations

import re
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass

KEY_AGE_MAX_S = 0.4
"""Age from which a key does not move the robot, because the network has delayed it."""
BURST = 8
BURST_WITHIN_S = 0.1
"""BURST keys within this time come from a buffer: no keyboard repeats faster than 50 Hz."""
SILENCE_S = 0.25
"""Time without any key that has to pass after keys from a buffer before a key moves the robot."""
PINGS_MAX = 20
UNANSWERED_AFTER_S = 1.0
PING = b"\x1b[5n"
"""Request of a device status report (ECMA-48, DSR 5); the answer PONG comes in order with keys."""
PONG = "\x1b[0n"

_SEQUENCE = re.compile(
    rb"\x1b(?:\[[0-?]*+[ -/]*+(?:[@-~]|(?=[^@-~]))|O(?:[@-~]|(?=[^@-~]))|[^\[O\x1b]|(?=\x1b))"
    rb"|[^\x1b]",
    re.DOTALL,
)
"""An escape sequence (ECMA-48, 5.4), a sequence that another byte breaks off, or a byte."""
_SEQUENCE_BYTES_MAX = 32
_ARROWS = {"A": "w", "B": "s", "C": "d", "D": "a"}


@dataclass(frozen=True, slots=True)
class Motion:
    """A motion as parts of the full speed: -1, 0 or 1; forward and left are positive."""

    linear: float
    angular: float
    lateral: float = 0.0


MOTIONS = {
    "w": Motion(1.0, 0.0), "s": Motion(-1.0, 0.0),
    "a": Motion(0.0, 1.0), "d": Motion(0.0, -1.0),
    "q": Motion(1.0, 1.0), "e": Motion(1.0, -1.0),
    "z": Motion(0.0, 0.0, 1.0), "c": Motion(0.0, 0.0, -1.0),
}  # fmt: skip


class Decoder:
    """Decodes bytes to keys. It keeps an incomplete escape sequence until the rest comes."""

    def __init__(self) -> None:
        self._rest = b""

    def feed(self, data: bytes) -> Iterator[str]:
        """Yield each key: a letter in lower case, PONG, or another sequence unchanged. Arrows
        become w, a, s and d."""
        data, end = self._rest + data, 0
        while found := _SEQUENCE.match(data, end):
            end = found.end()
            text = found[0].decode("latin-1")
            arrow = _ARROWS.get(text[-1]) if text[:2] in ("\x1b[", "\x1bO") else None
            yield arrow or (text.lower() if len(text) == 1 else text)
        self._rest = data[end:]
        if len(self._rest) > _SEQUENCE_BYTES_MAX:  # noise
            self._rest = b""


class Link:
    """Estimates the greatest possible age of a key. Terminals answer in order, so a key that comes
    after the answer to a ping was pressed after that ping was sent."""

    def __init__(self, now_s: float) -> None:
        self._began_s = now_s
        self._sent_s: deque[float] = deque()
        self._proved_s: float | None = None
        self.round_trip_s: float | None = None

    @property
    def may_ping(self) -> bool:
        """Whether a ping may be sent; False: PINGS_MAX are unanswered. These stay in the list,
        because a late answer must not count as the answer to a later ping."""
        return len(self._sent_s) < PINGS_MAX

    def pinged(self, now_s: float) -> None:
        self._sent_s.append(now_s)

    def answered(self, now_s: float) -> None:
        """Take an answer. Without an unanswered ping it shows nothing and is ignored."""
        if self._sent_s:
            self._proved_s = self._sent_s.popleft()
            self.round_trip_s = now_s - self._proved_s

    @property
    def pending(self) -> bool:
        """Whether an answer is still to come."""
        return bool(self._sent_s)

    def answers(self, now_s: float) -> bool | None:
        """Whether this terminal answers; None: not known yet."""
        if self._proved_s is not None:
            return True
        return False if now_s - self._began_s > UNANSWERED_AFTER_S else None

    def key_age_s(self, now_s: float) -> float:
        """Return the greatest possible age of a key that is read now. It is 0 for a terminal that
        never answers: then only bursts show a slow link."""
        if self._proved_s is None:
            return 0.0 if self.answers(now_s) is False else now_s - self._began_s + KEY_AGE_MAX_S
        return now_s - self._proved_s


class DeadMan:
    """Requests the motion of a key while the key is held, and no longer."""

    def __init__(self, *, hold_s: float, first_s: float) -> None:
        """`hold_s`: time for which a repeated key counts. `first_s`: the same for the first press
        of a key, until the terminal repeats it."""
        self._hold_s, self._first_s = hold_s, first_s
        self._key = ""
        self._until_s = -1.0
        self._recent_s: deque[float] = deque(maxlen=BURST)
        self._barred_until_s = -1.0

    def take(self, keys: list[str], now_s: float, age_s: float) -> None:
        """Take motion keys that were read together, the newest last, and the age that they may
        have. Only the newest key counts."""
        self._recent_s.extend([now_s] * len(keys))
        full = len(self._recent_s) == BURST
        if age_s > KEY_AGE_MAX_S or (full and now_s - self._recent_s[0] < BURST_WITHIN_S):
            self.bar(now_s)
        elif now_s < self._barred_until_s:
            self._barred_until_s = now_s + SILENCE_S
        else:
            held = keys[-1] == self._key and now_s < self._until_s
            first = len(keys) == 1 and not held
            self._key = keys[-1]
            self._until_s = now_s + (self._first_s if first else self._hold_s)

    def bar(self, now_s: float) -> None:
        """End the motion, and allow no other until no key has come for SILENCE_S."""
        self.let_go()
        self._barred_until_s = now_s + SILENCE_S

    def let_go(self) -> None:
        """End the motion until the next key."""
        self._until_s = -1.0

    def barred(self, now_s: float) -> bool:
        """Whether motion is barred after keys from a buffer: release the key and press it again."""
        return now_s < self._barred_until_s

    def motion(self, now_s: float) -> Motion | None:
        """Return the requested motion; None: no key is held."""
        return MOTIONS[self._key] if now_s < self._until_s else None
