# SPDX-License-Identifier: Apache-2.0
"""Packets, from the board's side: the hoverboard FOC firmware and the Sabertooth."""

from __future__ import annotations

import math
from collections.abc import Iterator

from motord_hal.drives.profile import DriveProfile
from motord_hal.hoverboard.codec import (
    COMMAND_BYTES,
    FEEDBACK_S,
    Splitter,
    commanded,
    feedback,
)
from motord_hal.sabertooth.codec import Receiver
from motord_hal.sim.rs485.content import NamedContent


class HoverboardTalk:
    """`line.Talk` of a hoverboard's main board with the FOC firmware."""

    feedback_s = FEEDBACK_S

    def __init__(self, profile: DriveProfile) -> None:
        self._profile = profile
        self.power_up()

    def power_up(self) -> None:
        self._splitter = Splitter(COMMAND_BYTES)

    def feed(self, data: bytes, now_s: float) -> Iterator[dict[str, int] | None]:
        del now_s
        for values in self._splitter.feed(data):
            yield None if values is None else commanded(self._profile, values)

    def feedback(self, content: NamedContent, now_s: float) -> bytes:
        del now_s
        return feedback(self._profile, content.value)


class SabertoothTalk:
    """`line.Talk` of a Sabertooth, which sends nothing."""

    feedback_s = math.inf

    def __init__(self, profile: DriveProfile, unit: int) -> None:
        self._profile = profile
        self._unit = unit
        self.power_up()

    def power_up(self) -> None:
        self._receiver = Receiver(self._profile, self._unit)

    def feed(self, data: bytes, now_s: float) -> Iterator[dict[str, int] | None]:
        del now_s
        return self._receiver.feed(data)

    def feedback(self, content: NamedContent, now_s: float) -> bytes:
        del content, now_s
        return b""
