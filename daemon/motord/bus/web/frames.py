# SPDX-License-Identifier: Apache-2.0
"""The binary frames between the robot and its pages: little-endian, without padding. The page is
sent this layout when it connects and decodes by it: docs/dashboard.md."""

from __future__ import annotations

import dataclasses
import math
import struct
from collections.abc import Iterator
from typing import Any, NamedTuple

from motord.api.snapshot import STATES, JointSnapshot, Rest, Snapshot
from motord.api.words import FAULTS, REASONS

STATE, DRIVE, ACKNOWLEDGE, RELEASE, PRESENT = 1, 1, 2, 3, 4
"""First byte of a frame. STATE: to the page; all others: from the page."""
VERSION = 1
FLAGS = ("armed", "enabled", "at_rest", "odometry_degraded")
"""Names of the bits of `flags`, lowest first."""

Fields = tuple[tuple[str, str], ...]
_HEAD: Fields = (
    *(("kind", "B"), ("version", "B"), ("joints", "B"), ("state", "B"), ("flags", "B")),
    ("rest", "B"),
    *(("sequence", "I"), ("owner", "I"), ("reasons", "I"), ("faults", "I"), ("stamp_s", "d")),
)
_MEASURES: Fields = (
    *(("x_m", "d"), ("y_m", "d"), ("heading_rad", "d"), ("distance_m", "d")),
    *(("command_age_s", "f"), ("saturation", "f")),
    *(("wanted_linear_m_s", "f"), ("wanted_lateral_m_s", "f"), ("wanted_angular_rad_s", "f")),
    *(("setpoint_linear_m_s", "f"), ("setpoint_lateral_m_s", "f"), ("setpoint_angular_rad_s", "f")),
    *(("linear_m_s", "f"), ("lateral_m_s", "f"), ("angular_rad_s", "f")),
)
_CODES = {"float": "f", "U32": "I", "bool": "B", "bool | None": "B"}
_JOINT = tuple(
    (key.name, "d" if key.name == "position_rad" else _CODES[str(key.type)])
    for key in dataclasses.fields(JointSnapshot)
)
_RESTS = tuple(Rest)
_UNKNOWN = 2
"""Value of `enabled` for a drive that cannot report it."""
_F32_MAX = struct.unpack("<f", b"\xff\xff\x7f\x7f")[0]
_BITS = {word: 1 << bit for bit, word in REASONS.items()}
_FAULT_BITS = {word: 1 << bit for bit, word in FAULTS.items()}
TIME_MAX = 1e15
"""Greatest time of a page, in ms or s: thirty thousand years in ms."""
_DRIVE = struct.Struct("<BIddddd")
_NUMBERED = struct.Struct("<BI")
_PRESENT = struct.Struct("<Bdd")


def layout() -> dict[str, Any]:
    """Return what a page has to know to read STATE frames: names and types of the fields in their
    order (B and I: unsigned, of 1 and 4 bytes; f and d: floats of 4 and 8), those of each joint
    after them, and the words of numbers and bits."""
    return {
        "version": VERSION,
        "state": [*_HEAD, *_MEASURES],
        "joint": list(_JOINT),
        "states": STATES,
        "rests": _RESTS,
        "flags": FLAGS,
        "reasons": REASONS,
        "faults": FAULTS,
    }


class Packer:
    """Makes STATE frames for a robot with a number of joints."""

    def __init__(self, joints: int) -> None:
        codes = [code for _, code in (*_HEAD, *_MEASURES, *_JOINT * joints)]
        self._frame = struct.Struct("<" + "".join(codes))
        self._joints = joints

    def pack(self, now: Snapshot, sequence: int) -> bytes | None:
        """Return a STATE frame; None: the daemon runs another robot file of this name."""
        if len(now.joints) != self._joints:
            return None
        flags = sum(1 << bit for bit, name in enumerate(FLAGS) if getattr(now, name))
        joints = (value for joint in now.joints for value in _values(joint, _JOINT))
        return self._frame.pack(
            *(STATE, VERSION, self._joints, now.machine_state, flags),
            _RESTS.index(Rest(now.rest)),
            sequence & 0xFFFFFFFF,
            now.owner & 0xFFFFFFFF,
            sum(_BITS.get(word, 0) for word in now.reasons),
            sum(_FAULT_BITS.get(word, 0) for word in now.faults),
            now.stamp_ns / 1e9,
            *_values(now, _MEASURES),
            *joints,
        )


def _values(record: Snapshot | JointSnapshot, fields: Fields) -> Iterator[float]:
    for name, code in fields:
        value = getattr(record, name)
        yield _f32(value) if code == "f" else _UNKNOWN if value is None else value


def _f32(value: float) -> float:
    """Return a value for 4 bytes; one that does not fit becomes infinite. A client may request any
    number."""
    return math.copysign(math.inf, value) if abs(value) > _F32_MAX else value


class DriveFrame(NamedTuple):
    """One command of a page."""

    press: int
    """Number of this hold of the pad; each hold has a new one."""
    sent_ms: float
    """Time of sending by the page's clock, which may begin at any time."""
    seen_s: float
    """`stamp_s` of the newest state that the page has shown."""
    linear_m_s: float
    lateral_m_s: float
    angular_rad_s: float


def drive_frame(raw: bytes) -> DriveFrame:
    """Decode a DRIVE frame. Raises ValueError for data that is no such frame. Velocities may be NaN
    and infinity: the loop takes them for zero, and the command gate names their sender."""
    if len(raw) != _DRIVE.size:
        raise ValueError(f"a command has {_DRIVE.size} bytes")
    _, *fields = _DRIVE.unpack(raw)
    found = DriveFrame(*fields)
    _check_times(found.sent_ms, found.seen_s)
    return found


def number_of(raw: bytes) -> int:
    """Return the number in an ACKNOWLEDGE or a RELEASE frame. Raises ValueError for data that is no
    such frame."""
    if len(raw) != _NUMBERED.size:
        raise ValueError(f"such a frame has {_NUMBERED.size} bytes")
    return int(_NUMBERED.unpack(raw)[1])


def present_frame(raw: bytes) -> tuple[float, float]:
    """Return `sent_ms` and `seen_s` of a PRESENT frame; see `DriveFrame`. Raises ValueError for
    data that is no such frame."""
    if len(raw) != _PRESENT.size:
        raise ValueError(f"such a frame has {_PRESENT.size} bytes")
    _, sent_ms, seen_s = _PRESENT.unpack(raw)
    _check_times(sent_ms, seen_s)
    return sent_ms, seen_s


def _check_times(*times: float) -> None:
    """Raise ValueError for times that no clock shows: further arithmetic would overflow."""
    if not all(abs(time) <= TIME_MAX for time in times):
        raise ValueError(f"times are finite, at most {TIME_MAX:g}")
