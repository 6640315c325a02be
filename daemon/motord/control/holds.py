# SPDX-License-Identifier: Apache-2.0
"""Holds that outlive their lease. A source that requested motion, and whose connection has ended
without a zero, is held when it comes back after a stop. A program that was started anew after the
stop is a new decision to move, but only when the source has been silent for SILENT_NS: a shell loop
that starts a program for each command decides nothing anew."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

from motord.local_socket.peer_process import Process
from motord.realtime.loop import SOURCE_SILENT_S

SILENT_NS = SOURCE_SILENT_S * 1_000_000_000
OWNERS_MAX = 64
"""Owners that are known by name. Beyond them, a hold counts for all owners."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Left:
    """What an owner left behind when its connection ended."""

    since_ns: int
    """When it was held, CLOCK_MONOTONIC; 0: it is not held, no stop has come since its request."""
    newest_ns: int
    """When its newest command came, CLOCK_MONOTONIC."""
    process: Process | None
    """None: not known, or a process that passes on the commands of others, which go on when it is
    started anew."""
    ended: bool = False
    """Whether it ended its request itself: then only other processes are held, for SILENT_NS."""
    serial: bool = False
    """Whether it was started less than SILENT_NS after another process of the same owner."""

    def holds(self, process: Process | None, now_ns: int) -> bool:
        """Return whether a lease of this process is held, too."""
        if self.since_ns == 0:
            return False
        if self.ended:
            return process != self.process and now_ns - self.newest_ns < SILENT_NS
        if self.process is None or process is None or now_ns - self.newest_ns < SILENT_NS:
            return True
        return not process.started_after(self.since_ns)


_NOBODY = Left(since_ns=0, newest_ns=0, process=None)


def _later(left: Left, before: Left) -> Left:
    return replace(
        left,
        since_ns=max(left.since_ns, before.since_ns),
        newest_ns=max(left.newest_ns, before.newest_ns),
    )


class Holds:
    """The owners that left without a zero."""

    def __init__(self) -> None:
        self._left: dict[str, Left] = {}
        self._others = _NOBODY
        """The owners that are not known by name any more."""

    def note(self, owner: str, left: Left) -> None:
        """Note an owner whose connection has ended."""
        self._left[owner] = _later(left, self._left.pop(owner, _NOBODY))
        while len(self._left) > OWNERS_MAX:
            oldest = self._left.pop(next(iter(self._left)))
            if oldest.ended:
                continue
            self._others = _later(replace(oldest, process=None), self._others)

    def note_end(self, owner: str, left: Left) -> None:
        """Note an owner that has ended its request itself. What another process of this owner left
        behind stays."""
        before = self._left.get(owner)
        if before is None or before.ended or before.process == left.process:
            self._left.pop(owner, None)
            self.note(owner, left)
        else:
            self._left[owner] = replace(before, newest_ns=max(before.newest_ns, left.newest_ns))

    def stop(self, now_ns: int) -> list[str]:
        """Hold all that are not held yet; return their owners. Of those that have ended their
        request, only a series of processes is held: a script that stops between two commands is
        none."""
        for owner, left in list(self._left.items()):
            recent = now_ns - left.newest_ns < SILENT_NS
            if left.ended and left.since_ns == 0 and not (left.serial and recent):
                del self._left[owner]
        found = [owner for owner, left in self._left.items() if left.since_ns == 0]
        for owner in found:
            self._left[owner] = replace(self._left[owner], since_ns=now_ns)
        if self._others.newest_ns > 0:
            self._others = replace(self._others, since_ns=now_ns)
        return found

    def since_ns(self, owner: str, process: Process | None, now_ns: int) -> int:
        """Return since when a new lease of this owner is held; 0: it is not held."""
        left = self._left.get(owner) or replace(self._others, process=process)
        return left.since_ns if left.holds(process, now_ns) else 0

    def follows(self, owner: str, process: Process | None, now_ns: int) -> bool:
        """Return whether this process was started less than SILENT_NS after another one of the
        owner."""
        left = self._left.get(owner)
        if left is None or process is None or left.process in (None, process):
            return False
        return now_ns - left.newest_ns < SILENT_NS

    def forget(self, owner: str) -> None:
        """Drop an owner that has sent zero since."""
        self._left.pop(owner, None)

    def clear(self) -> None:
        """Drop all: a person lets them go on."""
        self._left.clear()
        self._others = _NOBODY

    def arm(self, now_ns: int) -> None:
        """Drop those that have been silent for SILENT_NS: the robot was armed."""
        silent = [key for key, left in self._left.items() if now_ns - left.newest_ns >= SILENT_NS]
        for owner in silent:
            del self._left[owner]
        if now_ns - self._others.newest_ns >= SILENT_NS:
            self._others = _NOBODY

    def held(self, now_ns: int) -> Iterator[tuple[str, Left]]:
        """Yield the held owners whose program may come back."""
        for owner, left in list(self._left.items()):
            silent = now_ns - left.newest_ns >= SILENT_NS
            if silent and (left.ended or (left.process is not None and not left.process.lives)):
                del self._left[owner]  # only a program that is started anew can have this name
            elif left.since_ns > 0:
                yield owner, left
