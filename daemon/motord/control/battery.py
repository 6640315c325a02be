# SPDX-License-Identifier: Apache-2.0
"""The level of the battery from measurements, with hysteresis. Pure: time is an argument.

Nothing is guessed: a value that is not a number is no measurement, and without measurements the
level is unknown."""

from __future__ import annotations

import enum
import math
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

from motord.api.snapshot import Snapshot
from motord.config import Battery, DrivesBattery


class BatteryLevel(enum.StrEnum):
    """Level of the battery, from unknown to the worst."""

    UNKNOWN = "unknown"
    NORMAL = "normal"
    WARNING = "warning"
    CRITICAL = "critical"


@dataclass(frozen=True, slots=True, kw_only=True)
class Measure:
    """One measurement of the battery; a value that was not measured is NaN. `current_a` is negative
    while the battery is discharged, as in sensor_msgs/BatteryState."""

    stamp_ns: int
    voltage_v: float
    current_a: float = math.nan
    temperature_c: float = math.nan

    @property
    def counts(self) -> bool:
        """Whether it is a measurement: a battery that drives a robot is not at zero volts."""
        return math.isfinite(self.voltage_v) and self.voltage_v > 0.0


def of_drives(
    section: DrivesBattery,
    joints: tuple[str, ...],
    snapshot: Snapshot,
    readings: Mapping[str, float] = MappingProxyType({}),
) -> Measure:
    """Return the drives' measurement of the battery: the lowest voltage among those that respond,
    or the voltage in `readings`. Current and temperature come from `readings` alone, as a motor's
    current and a drive's temperature are not the battery's. `readings`: values of the pack in V, A
    and °C, by the section's keys; a missing one is NaN."""
    volts = [
        joint.voltage_v
        for name, joint in zip(joints, snapshot.joints, strict=True)
        if (not section.joints or name in section.joints)
        and not joint.stale
        and math.isfinite(joint.voltage_v)
    ]
    voltage_v = min(volts, default=math.nan)
    if section.voltage_from is not None:
        voltage_v = readings.get("voltage_from", math.nan)
    drawn_a = readings.get("current_from", math.nan)
    return Measure(
        stamp_ns=snapshot.stamp_ns,
        voltage_v=voltage_v,
        current_a=drawn_a if section.inverted else -drawn_a,
        temperature_c=readings.get("temperature_from", math.nan),
    )


class BatteryWatch:
    """The newest measurement of the battery, and the level that follows from it."""

    def __init__(self, section: Battery, now_ns: int) -> None:
        self._section = section
        self._measure: Measure | None = None
        self._received_ns = now_ns
        self._towards = BatteryLevel.UNKNOWN
        self._since_ns = now_ns
        self._reported_silent = False
        self.level = BatteryLevel.UNKNOWN

    def take(self, measure: Measure | None, now_ns: int) -> str | None:
        """Take a measurement; None: there was no measurement. Returns a line for the log, or
        None."""
        if measure is None or not measure.counts:
            return self._miss(now_ns)
        self._measure, self._received_ns, self._reported_silent = measure, now_ns, False
        wanted = self._judge(measure.voltage_v)
        if wanted is not self._towards:
            self._towards, self._since_ns = wanted, now_ns
        settled = now_ns - self._since_ns >= self._section.settle_s * 1e9
        if wanted is self.level or not (settled or self.level is BatteryLevel.UNKNOWN):
            return None
        before, self.level = self.level, wanted
        return f"the battery is {wanted}: {measure.voltage_v:.2f} V (was {before})"

    def _judge(self, voltage_v: float) -> BatteryLevel:
        """Return the level for a voltage. It worsens at the threshold, and improves only at the
        threshold plus the hysteresis."""
        section, rise_v = self._section, self._section.hysteresis_v
        critical = self.level is BatteryLevel.CRITICAL
        low = critical or self.level is BatteryLevel.WARNING
        if voltage_v < section.critical_v + (rise_v if critical else 0.0):
            return BatteryLevel.CRITICAL
        if voltage_v < section.low_v + (rise_v if low else 0.0):
            return BatteryLevel.WARNING
        return BatteryLevel.NORMAL

    def _miss(self, now_ns: int) -> str | None:
        silent_s = (now_ns - self._received_ns) / 1e9
        if silent_s < self._section.silent_s:
            return None
        self._measure, self.level = None, BatteryLevel.UNKNOWN
        self._towards = BatteryLevel.UNKNOWN
        if self._reported_silent:
            return None
        self._reported_silent = True
        return f"the battery is unknown: nothing was measured for {silent_s:.1f} s"

    def report(self, now_ns: int) -> dict[str, Any]:
        """Return the state, ready for JSON; unknown values are None. `stamp_ns`, `age_s`:
        CLOCK_MONOTONIC and age of the measurement."""
        measure = self._measure
        return {
            "state": self.level.value,
            "voltage_v": _plain(measure.voltage_v) if measure else None,
            "current_a": _plain(measure.current_a) if measure else None,
            "temperature_c": _plain(measure.temperature_c) if measure else None,
            "stamp_ns": measure.stamp_ns if measure else None,
            "age_s": (now_ns - measure.stamp_ns) / 1e9 if measure else None,
            "cells": self._section.cells,
            "capacity_ah": self._section.capacity_ah,
        }


def _plain(value: float) -> float | None:
    return value if math.isfinite(value) else None
