# SPDX-License-Identifier: Apache-2.0
"""The state of the core after a tick, as plain Python values.

The plain fields and the records are those of `robot_state` in api.h, from `motord.api.records`. A
snapshot is only read here, so the C core is not imported."""

from __future__ import annotations

import dataclasses
import enum
import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, get_args

from motord.api.records import CountersSnapshot
from motord.api.records import DeratingSnapshot as DeratingSnapshot
from motord.api.records import DoubtSnapshot as DoubtSnapshot
from motord.api.records import ImuSnapshot as ImuSnapshot
from motord.api.records import JointSnapshot as JointSnapshot
from motord.api.records import SpeedLoopSnapshot as SpeedLoopSnapshot

SNAPSHOT_VERSION = 2
"""Version of the snapshot; it grows when a field is renamed, removed or changes its meaning, not
when one is added."""
_STAMP_AHEAD_NS = 10_000_000
"""STAMP_AHEAD_NS of csrc/base/fresh.h."""
KEEP_AWAY = "keep away, cut the power"
STATES = ("off", "configuring", "idle", "armed", "moving", "stopping", "fault", "estop")
"""The states, indexed by `machine_state`."""
GYRO_STATES = ("none", "unbiased", "used", "stale", "reversed")
"""States of the gyro, indexed by GYRO_* of csrc/api/api_imu.h."""
DERATED_BY = ("temperature", "current", "voltage")
"""Causes of a derating, indexed by DERATED_BY_* of csrc/api/api_derating.h."""


class Rest(enum.StrEnum):
    """Whether the robot rests, in the order of REST_* of csrc/api/api.h."""

    UNKNOWN = "unknown"
    """Nothing is known to turn, but a joint was not seen at rest."""
    TURNING = "turning"
    AT_REST = "at_rest"


_RESTS = tuple(Rest)


@dataclass(frozen=True, slots=True, kw_only=True)
class Snapshot(CountersSnapshot):
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


def rest_word(number: int) -> Rest:
    """Return the word for `rest` of the C core's rest_shown; UNKNOWN for a number that this version
    does not know."""
    return _RESTS[number] if number < len(_RESTS) else Rest.UNKNOWN


def joints_of(bits: int, names: Sequence[str]) -> list[str]:
    """Return the names of the joints whose bits are set."""
    return [name for place, name in enumerate(names) if bits >> place & 1]


def rest_report(snapshot: Snapshot, names: Sequence[str]) -> dict[str, Any]:
    """Return the values about rest of the answer of `status`; `names` are those of the joints."""
    since_ns = zip(names, snapshot.rest_unknown_since_ns, strict=False)
    return {
        "rest": snapshot.rest,
        "rest_unknown_s": {
            name: (snapshot.stamp_ns - begin_ns) / 1e9 for name, begin_ns in since_ns if begin_ns
        },
        "rest_unmeasured": joints_of(snapshot.rest_unmeasured, names),
    }


def rest_text(
    rest: str, rest_unknown_s: Collection[str], rest_unmeasured: Collection[str] = ()
) -> str:
    """Return what a person has to know about the rest of the robot: a warning if it is unknown, and
    that it was not measured. Empty: the robot is at rest, or turns. The arguments are the values of
    `rest_report`, of which the names of the joints count."""
    if rest == Rest.UNKNOWN:
        return f"motord cannot see whether {_turns(rest_unknown_s or ('a wheel',))}: {KEEP_AWAY}"
    if rest == Rest.AT_REST and rest_unmeasured:
        return f"at rest by the set-points: nothing measures whether {_turns(rest_unmeasured)}"
    return ""


def stamp_is_fresh(now_ns: int, stamp_ns: int, timeout_s: float) -> bool:
    """Return whether a stamp is neither older than the timeout nor from the future: the rule of
    csrc/base/fresh.h, for programs that only read the state page."""
    return stamp_ns > 0 and -_STAMP_AHEAD_NS <= now_ns - stamp_ns <= round(timeout_s * 1e9)


def not_known(age_s: float | None) -> str:
    """Return the text for a value whose newest measurement is that old; None or infinity: nothing
    was measured yet."""
    if age_s is None or not math.isfinite(age_s):
        return "not known yet"
    return f"not known since {age_s:.1f} s"


def stop_answer(method: str, answer: Mapping[str, Any]) -> tuple[bool, str]:
    """Return whether `method` has succeeded, and a text on it, from the daemon's answer. A stop and
    a disarm have not while rest is unknown; an emergency stop has when it is latched."""
    state = str(answer["state"])
    unknown = rest_text(answer["rest"], answer["rest_unknown_s"]) if "rest" in answer else ""
    return method == "estop" or not unknown, f"{state}; {unknown}" if unknown else state


def _turns(names: Collection[str]) -> str:
    *first, last = names
    return f"{', '.join(first)} and {last} turn" if first else f"{last} turns"


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
