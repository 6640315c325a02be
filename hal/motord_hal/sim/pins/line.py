# SPDX-License-Identifier: Apache-2.0
"""A line of simulated motor bridges on the files of a PWM chip, with encoders on those of a
counter. Files do not report writes, so the line reads them often."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

from motord_hal.fieldbus.ports import JointSpec, LineSpec
from motord_hal.pwm.pins import Place, bridge_of, may_be_left_out, places_of
from motord_hal.sim.pins.bridge import SimulatedBridge, mode_of
from motord_hal.sim.pins.folder import PinFolder
from motord_hal.sim.rs485.wire import Clock

LOOK_EVERY_S = 0.001
"""Interval between readings: the step of the physics."""


def channels_of(joints: Sequence[JointSpec]) -> list[list[Place]]:
    """Return, by joint, the pins of its bridge that are PWM channels here. GPIO lines that only
    give power count as wired to the supply. A line that selects the direction gets a channel of its
    own, above those of the robot file: its duty is 0 or all of a period, which is a level."""
    every = [places_of(number, joint) for number, joint in enumerate(joints)]
    used = [place.channel for places in every for place in places if place.channel is not None]
    free = itertools.count(max(used, default=-1) + 1)
    return [
        [
            place if place.channel is not None else replace(place, channel=next(free), gpio="")
            for place in places
            if place.channel is not None or selects_direction(joint, place)
        ]
        for joint, places in zip(joints, every, strict=True)
    ]


def selects_direction(joint: JointSpec, place: Place) -> bool:
    """Whether a pin of the bridge, not `fault` or `pump`, does more than give it power."""
    bridge = bridge_of(joint)
    return place.pin in bridge.levels and not may_be_left_out(bridge, place.pin)


@dataclass(slots=True)
class PinCounters:
    looks: int = 0
    no_mode: int = 0
    """Readings of levels that are no mode of a bridge, for example between the writes to two pins.
    The bridge gives no power meanwhile."""
    plugged: int = 0


class SimulatedPins:
    """A line like `SimulatedLine`. While it is pulled, bridges get no pulses, without an error;
    encoders count."""

    def __init__(
        self, spec: LineSpec, drives: Mapping[int, SimulatedBridge], port: PinFolder
    ) -> None:
        self.spec = spec
        self.drives = drives
        self.port = port
        self.counters = PinCounters()
        self._places = channels_of(spec.joints)
        self._counted = [joint for joint in spec.joints if joint.encoder is not None]
        for joint in self._counted:
            if joint.encoder is not None:
                drives[joint.unit].count_edges(joint.channel, joint.encoder.rad_per_count)
        self._looked_s = -math.inf

    # ---------------------------------------------------------------------------------- plugging
    def plug(self) -> None:
        """Plug the line in, unless it is plugged. Raises OSError."""
        if not self.port.plugged:
            self.port.plug()
            self.counters.plugged += 1

    def pull(self) -> None:
        self.port.pull()
        for drive in self.drives.values():
            drive.follow("coast", 0.0)

    # ------------------------------------------------------------------------------- the poll loop
    def due_s(self, now_s: float) -> float:
        """Return the time of the next call of `work`."""
        del now_s
        return self._looked_s + LOOK_EVERY_S

    def work(self, now_s: float, clock: Clock | None = None) -> None:
        """Follow the pins, and write the encoders' counts."""
        del clock
        self._looked_s = now_s
        if self.port.plugged:
            self.counters.looks += 1
            for joint, places in zip(self.spec.joints, self._places, strict=True):
                self.drives[joint.unit].follow(*self._read(joint, places))
        for number, joint in enumerate(self._counted):
            count = self.drives[joint.unit].count(joint.channel)
            if count is not None:
                self.port.put_count(number, count)

    def stats(self) -> dict[str, Any]:
        return {
            **asdict(self.counters),
            "units": {str(unit): asdict(drive.stats) for unit, drive in self.drives.items()},
        }

    def _read(self, joint: JointSpec, places: list[Place]) -> tuple[str, float]:
        bridge = bridge_of(joint)
        levels = dict.fromkeys(bridge.levels, 1.0)  # a pin that is left out is wired to the supply
        for place in places:
            assert place.channel is not None  # channels_of chose only such places
            level = self.port.level(place.channel)
            if level is None:
                return "coast", 0.0
            levels[place.pin] = 1.0 - level if place.inverted else level
        found = mode_of(bridge, levels)
        self.counters.no_mode += found is None
        return found or ("coast", 0.0)
