# SPDX-License-Identifier: Apache-2.0
"""The state of the core after a tick, as plain Python values.

The plain fields and the records are those of `robot_state` in api.h, from `motord.api.records`. A
snapshot is only read here, so the C core is not imported."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, get_args

from motord.api.records import DeratingSnapshot as DeratingSnapshot
from motord.api.records import DoubtSnapshot as DoubtSnapshot
from motord.api.records import ImuSnapshot as ImuSnapshot
from motord.api.records import JointSnapshot as JointSnapshot
from motord.api.records import SpeedLoopSnapshot as SpeedLoopSnapshot
from motord.api.records import SteeringSnapshot

SNAPSHOT_VERSION = 1
"""Version of the snapshot; it grows when a field is renamed, removed or changes its meaning, not
when one is added."""
STATES = ("off", "configuring", "idle", "armed", "moving", "stopping", "fault", "estop")
"""The states, indexed by `machine_state`."""
GYRO_STATES = ("none", "unbiased", "used", "stale", "reversed")
"""States of the gyro, indexed by GYRO_* of csrc/api/api_imu.h."""
DERATED_BY = ("temperature", "current", "voltage")
"""Causes of a derating, indexed by DERATED_BY_* of csrc/api/api_derating.h."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Snapshot(SteeringSnapshot):
    """The robot after one tick. `stamp_ns` is CLOCK_MONOTONIC; publishers add wall-clock time."""

    joints: tuple[JointSnapshot, ...]
    imu: ImuSnapshot | None = None
    """None: the robot has no IMU, or nothing was received from it yet."""
    doubt: DoubtSnapshot | None = None
    speed_loops: tuple[SpeedLoopSnapshot, ...] = ()
    """One for each joint, in their order."""
    derating: DeratingSnapshot | None = None
    """None: no joint derates the base."""
    reasons_since_ns: Mapping[str, int] = field(default_factory=dict)
    """Time since when each of `reasons` holds."""
    saturated_joint: int | None = None
    """While `wheel_saturated` is a reason: the index of the joint that is at its limit."""
    reason_joints: Mapping[str, tuple[int, ...]] = field(default_factory=dict)
    """Indices of the joints that cause a reason. Only for `reasons` about a duty, an unknown
    position or joints without a base."""
    version: int = SNAPSHOT_VERSION

    def to_json(self) -> dict[str, Any]:
        """Return a dict for json.dumps(allow_nan=False): NaN and infinity are None, tuples are
        lists."""
        return _record(self)


def derated_by(number: int) -> str:
    """Return the word for `by` of the C core's derating_shown."""
    return DERATED_BY[number] if number < len(DERATED_BY) else f"reason {number}"


def gyro_word(state: int) -> str:
    """Return the word for `state` of the C core's imu_state; with its number if it is unknown."""
    return GYRO_STATES[state] if state < len(GYRO_STATES) else f"state {state}"


_Record = (
    Snapshot | JointSnapshot | ImuSnapshot | DoubtSnapshot | SpeedLoopSnapshot | DeratingSnapshot
)


_NAMES = {kind: tuple(key.name for key in dataclasses.fields(kind)) for kind in get_args(_Record)}
"""Names of the fields of each class, kept here because `fields` computes them anew each time."""
_AS_IT_IS = frozenset((int, str, bool, type(None)))


def _record(record: _Record) -> dict[str, Any]:
    return {name: _plain(getattr(record, name)) for name in _NAMES[type(record)]}


def _plain(value: Any) -> Any:
    kind = type(value)
    if kind in _AS_IT_IS:
        return value
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if kind in _NAMES:
        return _record(value)
    if isinstance(value, tuple):
        return [_plain(item) for item in value]
    if isinstance(value, Mapping):
        return {key: _plain(item) for key, item in value.items()}
    return value
