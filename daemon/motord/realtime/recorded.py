# SPDX-License-Identifier: Apache-2.0
"""Checks of what a recording holds of the core, before the core gets it: each number of a recorded
state and of a recorded input has to be one that the core can have. A recording may be damaged, or
come from a stranger."""

from __future__ import annotations

import math
import struct
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from _motord_rt import ffi, lib

_STAMP_MAX_NS = 1 << 62
"""146 years: no sum or difference of two such stamps leaves 64 bits."""
_TICK_MAX = 1 << 62
_JOINTS = (1 << lib.JOINTS_MAX) - 1
_ANGLE_MAX_RAD = 1e9
_CODES = {"uint32_t": "I", "int64_t": "q", "uint64_t": "Q", "double": "d"}
_CONSTANT = (
    "config.", "command_window_ns", "feedback_window_ns", "heartbeat_window_ns",
    "odometry.joint.constant.", "steer.pace_rad_s", "steer.curvature_", "steer.turns_on_spot",
    "snapshot.joint_count", "slewed", "axes", "steered", "positions", "derates",
)  # fmt: skip
"""Beginnings of the names of what core_init() computes from the configuration, and no step
changes."""
_ANY_COUNT = (
    "epoch", "jumps", "jumps_before", "owner", "drive_faults", "sensor_epoch", "used_epoch",
    "refused", "machine_state", "reset_seen", "odometry_reset_seen", "gains_seen",
    "joint_limits_seen", "odometry_epoch", "reasons", "command_reasons", "faults", "fault",
    "count", "window_samples", "sequence", "reset_count", "odometry_reset_count", "gains_count",
    "joint_limits_count", "named",
)  # fmt: skip
"""Last parts of the names of integers that may have any value: counts and sets of bits that the
core only copies, compares or increments."""
_RANGES = {
    "odometry.joint.last": 2,
    "odometry.joint.fresh": 7,
    "odometry.used.joints": _JOINTS,
    "odometry.distrusted": _JOINTS,
    "odometry.speed.newest": lib.LOOKS - 1,
    "odometry.speed.looks": lib.LOOKS,
    "odometry.speed.seen": 1000,
    "plausible.suspicious": 31,
    "steer.unknown": _JOINTS,
    "loops": _JOINTS,
    "extras": _JOINTS,
    "snapshot.joint.enabled": 2,
    "snapshot.imu.state": lib.GYRO_REVERSED,
    "snapshot.doubt.joint": lib.JOINTS_MAX - 1,
    "snapshot.steering.position_joints": _JOINTS,
    "snapshot.steering.position_unknown": _JOINTS,
    "snapshot.derating.joint": lib.JOINTS_MAX - 1,
    "snapshot.derating.by": lib.DERATINGS - 1,
    "snapshot.rest.rest": lib.REST_AT_REST,
    "snapshot.rest.rest_unmeasured": _JOINTS,
    "rest": lib.REST_AT_REST,
    "joints_rest": lib.REST_AT_REST,
    "doubted": _JOINTS,
    "snapshot.counters.counter_coarse": _JOINTS,
    "snapshot.counters.counter_distrusted": _JOINTS,
    "snapshot.reason.saturated_joint": _JOINTS,
    "snapshot.reason.duty_clamped": _JOINTS,
    "snapshot.reason.duty_slew": _JOINTS,
    "snapshot.reason.joint_velocity": _JOINTS,
    "snapshot.reason.joint_acceleration": _JOINTS,
    "snapshot.reason.joint_position": _JOINTS,
    "input.feedback.enabled": 2,
    "input.feedback.referenced": 2,
}
"""Greatest values of integers; of all others that are no count it is 1: they are flags."""
_NOT_FINITE = (
    "snapshot.", "goal.command_u_s", "limits.linear.jerk_u_s3", "limits.angular.jerk_u_s3",
    "limits.lateral.jerk_u_s3", "joint_limits.jerk_u_s3", "odometry.joint.velocity_rad_s",
    "odometry.angle_rad", "odometry.arc_rad", "joints.target_rad", "derating.measured",
    "steer.unsure_s", "steer.misaligned_rad",
)  # fmt: skip
"""Beginnings of the names of values that may be NaN or infinite: not measured, or no limit."""


class Damaged(ValueError):
    """A number of a recording is not one that the core can have."""


@dataclass(frozen=True, slots=True)
class _Number:
    """A number within a structure, and its range. `finite`: neither NaN nor infinite."""

    path: str
    offset: int
    code: str
    low: float
    high: float
    finite: bool = True


def _numbers(kind: Any, offset: int = 0, path: str = "") -> Iterator[tuple[str, str, int]]:
    """Yield path, C type and offset of each number of a structure."""
    if kind.kind == "struct":
        for name, field in kind.fields:
            inner = f"{path}.{name}" if path else name
            yield from _numbers(field.type, offset + field.offset, inner)
    elif kind.kind == "array":
        for index in range(kind.length):
            yield from _numbers(kind.item, offset + index * ffi.sizeof(kind.item), path)
    else:
        yield path, kind.cname, offset


def _rule(path: str, code: str) -> tuple[float, float, bool]:
    """Return the least and the greatest value of a number, and whether it has to be finite."""
    last = path.rpartition(".")[2]
    if code == "d":
        wide = _ANGLE_MAX_RAD if last.endswith("_rad") else sys.float_info.max
        return -wide, wide, not path.startswith(_NOT_FINITE)
    if last.endswith("_ns"):
        return 0, _STAMP_MAX_NS, True
    if last == "tick":
        return 0, _TICK_MAX, True
    if last.startswith("reserved"):
        return 0, 0, True
    if last in _ANY_COUNT:
        return 0, math.inf, True
    return 0, _RANGES.get(path, 1), True


class _Form:
    """Numbers of a structure that are checked together."""

    def __init__(self, numbers: list[_Number]) -> None:
        self._numbers = numbers
        form, at = "=", 0
        for number in numbers:
            form += f"{number.offset - at}x{number.code}"
            at = number.offset + struct.calcsize(f"={number.code}")
        self._struct = struct.Struct(form)

    def check(self, data: bytes) -> None:
        """Raises Damaged for the first number out of its range."""
        for number, value in zip(self._numbers, self._struct.unpack_from(data), strict=True):
            within = number.low <= value <= number.high
            if not within and (number.finite or math.isfinite(value)):
                raise Damaged(f"{number.path} is {value!r}")


def _state_form() -> tuple[_Form, list[tuple[str, slice]]]:
    """Return the variables of struct core_state, and the places of its constants."""
    variables, constants = [], []
    for path, name, offset in _numbers(ffi.typeof("core_state")):
        code = _CODES.get(name, "I")  # an enumeration
        if path.startswith(_CONSTANT):
            constants.append((path, slice(offset, offset + struct.calcsize(f"={code}"))))
        else:
            variables.append(_Number(path, offset, code, *_rule(path, code)))
    return _Form(variables), constants


def _input_form() -> _Form:
    """Return the integers of struct journal_record that the core reads, and dt_s. Of its other
    numbers the core takes any: it is built for input that is NaN or infinite."""
    numbers = [
        _Number(path, offset, code, *_rule(path, code))
        for path, name, offset in _numbers(ffi.typeof("journal_record"))
        if path.startswith(("tick", "input.")) and (code := _CODES[name]) != "d"
    ]
    dt_s = _Number("dt_s", ffi.offsetof("journal_record", "dt_s"), "d", 1e-9, 1e3)
    return _Form(sorted([*numbers, dt_s], key=lambda number: number.offset))


_STATE, _CONSTANTS = _state_form()
_INPUT = _input_form()


def checked_state(initial: bytes, recorded: bytes) -> None:
    """Check the recorded bytes of struct core_state. `initial`: the same of a core that was set up
    by the recording's own configuration. Raises Damaged."""
    for path, place in _CONSTANTS:
        if initial[place] != recorded[place]:
            raise Damaged(f"{path} is not that of the robot file in the recording")
    _STATE.check(recorded)


def checked_input(record: bytes) -> None:
    """Check the recorded bytes of struct journal_record. Raises Damaged."""
    _INPUT.check(record)
