# SPDX-License-Identifier: Apache-2.0
"""Faults of drives, reported once when they change."""

from __future__ import annotations

from collections.abc import Callable

from motord_hal.drives.profile import DriveProfile
from motord_hal.fieldbus.ports import EventKind

Say = Callable[[EventKind, tuple[str, ...], str], None]

STILL_ENABLED_TEXT = "stays enabled though it is disarmed: it is held at zero speed"
"""Text for a drive that did not get a power-off, or refused it; it follows the drive's name."""


class FaultWatch:
    """The newest fault word of one joint; reports each change of it once."""

    def __init__(self, joint: str, profile: DriveProfile, say: Say) -> None:
        self.word = 0
        self._joint = joint
        self._profile = profile
        self._say = say

    @property
    def words(self) -> tuple[str, ...]:
        return tuple(fault.text for fault in self._profile.faults_in(self.word))

    @property
    def stopping(self) -> int:
        """The fault word without the bits or codes that are only warnings, for the core."""
        return self._profile.stopping_faults(self.word)

    def update(self, word: int) -> None:
        """Store the newest fault word; report new faults and warnings, and when all faults end."""
        if word == self.word:
            return
        before = set(self._profile.faults_in(self.word))
        self.word = word
        now = self._profile.faults_in(word)
        for severity, kind in (
            ("fault", EventKind.DRIVE_FAULT),
            ("warning", EventKind.DRIVE_WARNING),
        ):
            new = [f.text for f in now if f.severity == severity and f not in before]
            if new:
                self._say(kind, (self._joint,), f"{self._joint}: {severity}: {', '.join(new)}")
        was_fault = any(fault.severity == "fault" for fault in before)
        if was_fault and not any(fault.severity == "fault" for fault in now):
            self._say(
                EventKind.DRIVE_FAULT_GONE, (self._joint,), f"{self._joint}: no fault any more"
            )
