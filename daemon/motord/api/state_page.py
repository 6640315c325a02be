# SPDX-License-Identifier: Apache-2.0
"""Read the state page of a running daemon with the standard library alone: docs/state-page.md.

For processes that do not load the C core. The slot that is read is written again three ticks later
at the soonest, and every load from it depends on the number that was published. So a copy is whole
if its sequence is the same before and after."""

from __future__ import annotations

import mmap
import os
import struct
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Self

from motord.api.page_file import find_page, slots_fit
from motord.api.records import (
    PAGE_LAYOUT_VERSION,
    CountersSnapshot,
    LateralSnapshot,
    PlainSnapshot,
    RestSnapshot,
    SteeringSnapshot,
)
from motord.api.snapshot import (
    GYRO_STATES,
    DeratingSnapshot,
    DoubtSnapshot,
    ImuSnapshot,
    JointSnapshot,
    Snapshot,
    SpeedLoopSnapshot,
    derated_by,
    gyro_word,
    rest_word,
)
from motord.api.words import FAULTS, REASONS

_MAGIC = b"MOTORD\0\1"
_ENABLED_UNKNOWN = 2
_PAGE_BYTES = 16384
_LAYOUT = struct.Struct("=8s5I")
"""Beginning of the header: what does not change while daemons of one layout write the page."""
_LAYOUT_BYTES = _LAYOUT.size
_PUBLISHED = struct.Struct("=Q")
_PUBLISHED_OFFSET = 32
_TRIES = 8


def _words(bits: int, names: Mapping[int, str]) -> tuple[str, ...]:
    return tuple(name for bit, name in names.items() if bits >> bit & 1)


def _reasons(bits: int) -> tuple[str, ...]:
    return _words(bits, REASONS)


def _faults(bits: int) -> tuple[str, ...]:
    return _words(bits, FAULTS)


def _first_fault(bits: int) -> str:
    return next(iter(_faults(bits)), "")


def _known(number: int) -> bool | None:
    return None if number == _ENABLED_UNKNOWN else number != 0


_FORMS: Mapping[str, tuple[str, Callable[[Any], Any] | None]] = {
    "I64": ("q", None),
    "U64": ("Q", None),
    "U32": ("I", None),
    "float": ("d", None),
    "bool": ("I", bool),
    "bool | None": ("I", _known),
    "Doubles3": ("3d", None),
    "Doubles6": ("6d", None),
    "Doubles8": ("8d", None),
    "Stamps8": ("8q", None),
    "Reasons": ("I", _reasons),
    "Faults": ("I", _faults),
    "FirstFault": ("I", _first_fault),
    "GyroState": ("I", gyro_word),
    "DeratedBy": ("I", derated_by),
    "RestWord": ("I", rest_word),
}
"""For each type of a dataclass field: its struct format in csrc/api/api.h, and the conversion of
its value to Python."""


class _Record:
    """Decoder of a structure of csrc/api/api.h: the fields of its dataclass, in their order."""

    def __init__(self, kind: type, *, hidden: tuple[str, str] = ("", "")) -> None:
        """`kind`: the dataclass; a structure has the fields of its own, not those of its base.
        `hidden`: a field that only the structure has, and the field before which it stands."""
        names = [(name, form) for name, form in kind.__annotations__.items() if form in _FORMS]
        if hidden[0]:
            names.insert([name for name, _ in names].index(hidden[1]), (hidden[0], "U32"))
        self._struct = struct.Struct("=" + "".join(_FORMS[form][0] for _, form in names))
        self._places: list[tuple[str, int | slice, Callable[[Any], Any] | None]] = []
        at = 0
        for name, form in names:
            code, meaning = _FORMS[form]
            count = int(code[:-1] or 1)
            self._places.append((name, slice(at, at + count) if code[:-1] else at, meaning))
            at += count
        self.bytes = self._struct.size

    def values(self, payload: bytes, at: int) -> dict[str, Any]:
        """Return the values by the names of the fields."""
        raw = self._struct.unpack_from(payload, at)
        return {
            name: raw[place] if meaning is None else meaning(raw[place])
            for name, place, meaning in self._places
        }


_JOINT, _IMU, _DOUBT = map(_Record, (JointSnapshot, ImuSnapshot, DoubtSnapshot))
_STATE = _Record(PlainSnapshot, hidden=("joint_count", "odometry_degraded"))
_LATERAL = _Record(LateralSnapshot)
_STEERING = _Record(SteeringSnapshot)
_SPEED_LOOP = _Record(SpeedLoopSnapshot)
_JOINTS_MAX = 8
_IMU_OFFSET = _STATE.bytes + _JOINTS_MAX * _JOINT.bytes
_DOUBT_OFFSET = _IMU_OFFSET + _IMU.bytes
_LATERAL_OFFSET = _DOUBT_OFFSET + _DOUBT.bytes
_STEERING_OFFSET = _LATERAL_OFFSET + _LATERAL.bytes
_SPEED_LOOP_OFFSET = _STEERING_OFFSET + _STEERING.bytes
_DERATING = _Record(DeratingSnapshot)
_DERATING_OFFSET = _SPEED_LOOP_OFFSET + _JOINTS_MAX * _SPEED_LOOP.bytes
_JOINT_REASONS = (
    "duty_clamped", "duty_slew", "joint_velocity", "joint_acceleration", "joint_position",
)  # fmt: skip
"""Reasons that come from joints: each has a mask of the joints in reasons_shown, in this order."""
_REASON = struct.Struct(f"=32qI{len(_JOINT_REASONS)}I")
_REASON_OFFSET = _DERATING_OFFSET + _DERATING.bytes
_REST = _Record(RestSnapshot)
_REST_OFFSET = _REASON_OFFSET + _REASON.size
_COUNTERS = _Record(CountersSnapshot)
_COUNTERS_OFFSET = _REST_OFFSET + _REST.bytes
_PAYLOAD_BYTES = _COUNTERS_OFFSET + _COUNTERS.bytes


def decode(payload: bytes) -> Snapshot:
    """Decode a `robot_state` from the bytes of the page."""
    state = _STATE.values(payload, 0)
    imu, doubt = _IMU.values(payload, _IMU_OFFSET), _DOUBT.values(payload, _DOUBT_OFFSET)
    derating = _DERATING.values(payload, _DERATING_OFFSET)
    shown = _REASON.unpack_from(payload, _REASON_OFFSET)
    since_ns, saturated_joint = shown[:32], shown[32]
    steering = _STEERING.values(payload, _STEERING_OFFSET)
    joints_of = dict(zip(_JOINT_REASONS, shown[33:], strict=True))
    joints_of["position_unknown"] = steering["position_unknown"]
    places = range(min(state.pop("joint_count"), _JOINTS_MAX))
    return Snapshot(
        joints=tuple(
            JointSnapshot(**_JOINT.values(payload, _STATE.bytes + place * _JOINT.bytes))
            for place in places
        ),
        speed_loops=tuple(
            SpeedLoopSnapshot(
                **_SPEED_LOOP.values(payload, _SPEED_LOOP_OFFSET + place * _SPEED_LOOP.bytes)
            )
            for place in places
        ),
        imu=ImuSnapshot(**imu) if imu["state"] != GYRO_STATES[0] else None,
        doubt=DoubtSnapshot(**doubt) if doubt["fault"] else None,
        derating=DeratingSnapshot(**derating) if derating["since_ns"] else None,
        reasons_since_ns={
            word: since_ns[bit] for bit, word in REASONS.items() if since_ns[bit] != 0
        },
        saturated_joint=saturated_joint if "wheel_saturated" in state["reasons"] else None,
        reason_joints={
            word: tuple(place for place in places if mask >> place & 1)
            for word, mask in joints_of.items()
            if word in state["reasons"]
        },
        **state,
        **_LATERAL.values(payload, _LATERAL_OFFSET),
        **steering,
        **_REST.values(payload, _REST_OFFSET),
        **_COUNTERS.values(payload, _COUNTERS_OFFSET),
    )


class NoPage(Exception):
    """There is no page to be read; the message is the reason."""


class StatePage:
    """The newest snapshot of one robot. It stays attached when its daemon is killed and another one
    takes the page over. `open` it again when the file was removed (`gone`)."""

    def __init__(self, path: Path, inode: int, memory: mmap.mmap) -> None:
        """Raise NoPage if the memory does not hold a page of this layout."""
        self._path = path
        self._inode = inode
        self._memory = memory
        self._layout = memory[:_LAYOUT_BYTES]
        magic, version, payload_bytes, self._slots, self._stride, self._offset = (
            _LAYOUT.unpack(self._layout)
        )  # fmt: skip
        known = magic == _MAGIC and version == PAGE_LAYOUT_VERSION
        slot_bytes = _PUBLISHED.size + payload_bytes
        if (
            not known
            or payload_bytes < _PAYLOAD_BYTES
            or not slots_fit(_PAGE_BYTES, self._slots, self._stride, self._offset, slot_bytes)
        ):
            raise NoPage(f"{path} is not a page of layout {PAGE_LAYOUT_VERSION}, or is being made")

    @classmethod
    def open(cls, robot: str, owner: int | None = None) -> Self:
        """Attach to the page of that robot; `owner` as in find_page. Raises NoPage."""
        path = find_page(robot, owner=owner)
        try:
            fd = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC)
        except OSError as error:
            raise NoPage(f"{path}: {error.strerror}") from None
        try:
            file = os.fstat(fd)
            if file.st_size < _PAGE_BYTES:
                raise NoPage(f"{path} is being made")
            memory = mmap.mmap(fd, _PAGE_BYTES, mmap.MAP_SHARED, mmap.PROT_READ)
        finally:
            os.close(fd)
        try:
            return cls(path, file.st_ino, memory)
        except NoPage:
            memory.close()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Release the page."""
        self._memory.close()

    @property
    def path(self) -> Path:
        """Path of the file."""
        return self._path

    @property
    def gone(self) -> bool:
        """Whether the file was removed or replaced, or its layout is not that of `open` any
        more."""
        try:
            return self._path.stat().st_ino != self._inode or not self._is_as_opened()
        except FileNotFoundError:
            return True

    def _is_as_opened(self) -> bool:
        return self._memory[:_LAYOUT_BYTES] == self._layout

    @property
    def published(self) -> int:
        """Number of snapshots so far; 0: none. If it has changed, there is a newer snapshot."""
        number: int = _PUBLISHED.unpack_from(self._memory, _PUBLISHED_OFFSET)[0]
        return number

    def read(self) -> Snapshot | None:
        """Return the newest snapshot; None: there is no snapshot yet, the daemon overwrote it
        during each try, or a daemon of another layout has taken the page over (`gone`)."""
        for _ in range(_TRIES):
            number = self.published
            if number == 0 or not self._is_as_opened():
                return None
            at = self._offset + (number - 1) % self._slots * self._stride
            size = _PAYLOAD_BYTES
            before = _PUBLISHED.unpack_from(self._memory, at)[0]
            payload = self._memory[at + _PUBLISHED.size : at + _PUBLISHED.size + size]
            after = _PUBLISHED.unpack_from(self._memory, at)[0]
            if before == after == 2 * number:
                return decode(payload)
        return None
