# SPDX-License-Identifier: Apache-2.0
"""Texts on what a line or a drive waits for before it can be armed, from the line's own events."""

from __future__ import annotations

from motord_hal.fieldbus.ports import DriveState, EventKind, Line, LineEvent, LineState

_PRESENT = (DriveState.READY, DriveState.ARMED)
_HERE_AGAIN = (EventKind.DRIVE_READY, EventKind.DRIVE_BACK)


class Waiting:
    """The newest event about each line and joint that is not ready."""

    def __init__(self) -> None:
        self._lost: dict[str, str] = {}
        """Text of the event by line."""
        self._unresponsive: dict[str, str] = {}
        """Text of the event by joint."""

    def note(self, event: LineEvent) -> None:
        """Remember an event of a line, or forget the one that it ends."""
        if event.kind is EventKind.LINE_LOST:
            self._lost[event.line] = event.text
        elif event.kind is EventKind.LINE_OPEN:
            self._lost.pop(event.line, None)
        for joint in event.joints:
            if event.kind is EventKind.DRIVE_UNRESPONSIVE:
                self._unresponsive[joint] = event.text
            elif event.kind in _HERE_AGAIN:
                self._unresponsive.pop(joint, None)

    def of(self, line: Line) -> str | None:
        """Return what this line waits for; None: it and all of its drives are ready."""
        if line.state is LineState.CLOSED:
            name, port = line.spec.name, line.spec.port
            return self._lost.get(name, f"{name}: {port} is being opened")
        absent = (name for name, state in line.drive_states.items() if state not in _PRESENT)
        texts = [
            self._unresponsive.get(name, f"{name}: the drive is being configured")
            for name in absent
        ]
        return "; ".join(dict.fromkeys(texts)) or None
