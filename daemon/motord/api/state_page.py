# SPDX-License-Identifier: Apache-2.0
"""Reads the state page of a running daemon with the standard library alone: docs/state-page.md.

For processes that do not load the C core. The slot that is read is written again three ticks later
at the soonest, and every load of it depends on the number that was published: a copy whose sequence
is the same before and after is whole.
"""

from __future__ import annotations

import mmap
import os
import struct
from pathlib import Path
from typing import Any, Self

from motord.api.page_file import find_page
from motord.api.snapshot import DoubtSnapshot, ImuSnapshot, JointSnapshot, Snapshot, gyro_word

REASONS = {
    0: "linear_velocity",
    1: "linear_acceleration",
    2: "linear_deceleration",
    3: "linear_jerk",
    4: "angular_velocity",
    5: "angular_acceleration",
    6: "angular_deceleration",
    7: "angular_jerk",
    8: "wheel_saturated",
    9: "duty_clamped",
    10: "duty_slew",
    16: "not_armed",
    17: "stop_requested",
    18: "command_stale",
    19: "command_not_finite",
    20: "fault",
}
"""By bit: REASON_* of csrc/api.h."""
FAULTS = {
    0: "estop",
    1: "heartbeat_lost",
    2: "feedback_stale",
    3: "drive",
    4: "drive_disabled",
    5: "time_step",
    6: "external",
    7: "state",
    8: "overspeed",
    9: "direction",
    10: "stall",
    11: "following_error",
    12: "runaway",
    13: "implausible_feedback",
    14: "suspended",
}
"""By bit: FAULT_* of csrc/api.h."""

_MAGIC = b"MOTORD\0\1"
_LAYOUT_VERSION = 1
_PAGE_BYTES = 16384
_HEADER = struct.Struct("=8s6I")
_PUBLISHED = struct.Struct("=Q")
_PUBLISHED_OFFSET = 32
_STATE = struct.Struct("=qQ10I7dq7d6d3d")
_JOINT = struct.Struct("=8d4I")
_IMU = struct.Struct("=q9d4I")
_DOUBT = struct.Struct("=q3d2I")
_JOINTS_MAX = 8
_IMU_OFFSET = _STATE.size + _JOINTS_MAX * _JOINT.size
_DOUBT_OFFSET = _IMU_OFFSET + _IMU.size
_PAYLOAD_BYTES = _DOUBT_OFFSET + _DOUBT.size
_ENABLED_UNKNOWN = 2
_TRIES = 8


class NoPage(Exception):
    """There is no page to be read; the text says why."""


class StatePage:
    """The newest snapshot of one robot. Stays attached when its daemon is killed and another takes
    the page over; `open` it again when the file was removed (`gone`)."""

    def __init__(self, path: Path, memory: mmap.mmap) -> None:
        self._path = path
        self._memory = memory
        self._inode = path.stat().st_ino
        _, _, _, self._slots, self._stride, self._offset, _ = _HEADER.unpack_from(memory)

    @classmethod
    def open(cls, robot: str, owner: int | None = None) -> Self:
        """Attach to the page of that robot; `owner` as find_page has it. Raises NoPage."""
        path = find_page(robot, owner=owner)
        try:
            fd = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_CLOEXEC)
        except OSError as error:
            raise NoPage(f"{path}: {error.strerror}") from None
        try:
            if os.fstat(fd).st_size < _PAGE_BYTES:
                raise NoPage(f"{path} is being made")
            memory = mmap.mmap(fd, _PAGE_BYTES, mmap.MAP_SHARED, mmap.PROT_READ)
        finally:
            os.close(fd)
        magic, version, payload_bytes, *_ = _HEADER.unpack_from(memory)
        known = _PAYLOAD_BYTES
        if magic != _MAGIC or version != _LAYOUT_VERSION or payload_bytes < known:
            memory.close()
            raise NoPage(f"{path} is not a page of layout {_LAYOUT_VERSION}, or is being made")
        return cls(path, memory)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Let go of the page."""
        self._memory.close()

    @property
    def gone(self) -> bool:
        """The file was removed, or there is another one of its name."""
        try:
            return self._path.stat().st_ino != self._inode
        except FileNotFoundError:
            return True

    @property
    def published(self) -> int:
        """Snapshots so far; 0: none. Another number than before: there is a newer one."""
        number: int = _PUBLISHED.unpack_from(self._memory, _PUBLISHED_OFFSET)[0]
        return number

    def read(self) -> Snapshot | None:
        """The newest snapshot; None: there is none, or each try was overtaken."""
        for _ in range(_TRIES):
            number = self.published
            if number == 0:
                return None
            at = self._offset + (number - 1) % self._slots * self._stride
            size = _PAYLOAD_BYTES
            before = _PUBLISHED.unpack_from(self._memory, at)[0]
            payload = self._memory[at + _PUBLISHED.size : at + _PUBLISHED.size + size]
            after = _PUBLISHED.unpack_from(self._memory, at)[0]
            if before == after == 2 * number:
                return decode(payload)
        return None


def decode(payload: bytes) -> Snapshot:
    """A `robot_state`, byte for byte as the page has it."""
    raw = _STATE.unpack_from(payload)
    state, owner, reasons, faults, armed, enabled, at_rest, count, degraded, epoch = raw[2:12]
    dt_s, age_s, wanted_v, wanted_w, setpoint_v, setpoint_w, saturation = raw[12:19]
    x_m, y_m, heading_rad, distance_m, turned_rad, linear_m_s, angular_rad_s = raw[20:27]
    return Snapshot(
        stamp_ns=raw[0],
        tick=raw[1],
        machine_state=state,
        owner=owner,
        reasons=_words(reasons, REASONS),
        faults=_words(faults, FAULTS),
        armed=armed != 0,
        enabled=enabled != 0,
        at_rest=at_rest != 0,
        odometry_degraded=degraded != 0,
        odometry_epoch=epoch,
        dt_s=dt_s,
        command_age_s=age_s,
        wanted_linear_m_s=wanted_v,
        wanted_angular_rad_s=wanted_w,
        setpoint_linear_m_s=setpoint_v,
        setpoint_angular_rad_s=setpoint_w,
        saturation=saturation,
        odometry_stamp_ns=raw[19],
        x_m=x_m,
        y_m=y_m,
        heading_rad=heading_rad,
        distance_m=distance_m,
        turned_rad=turned_rad,
        linear_m_s=linear_m_s,
        angular_rad_s=angular_rad_s,
        pose_covariance=raw[27:33],
        twist_covariance=raw[33:36],
        joints=tuple(
            _joint(_JOINT.unpack_from(payload, _STATE.size + index * _JOINT.size))
            for index in range(min(count, _JOINTS_MAX))
        ),
        imu=_imu(_IMU.unpack_from(payload, _IMU_OFFSET)),
        doubt=_doubt(_DOUBT.unpack_from(payload, _DOUBT_OFFSET)),
    )


def _words(bits: int, names: dict[int, str]) -> tuple[str, ...]:
    return tuple(name for bit, name in names.items() if bits >> bit & 1)


def _imu(raw: tuple[Any, ...]) -> ImuSnapshot | None:
    state, by_gyro, still, refused = raw[10:]
    if state == 0:
        return None
    return ImuSnapshot(
        stamp_ns=raw[0],
        angular_rad_s=raw[1:4],
        acceleration_m_s2=raw[4:7],
        bias_rad_s=raw[7],
        bias_variance_rad2_s2=raw[8],
        rate_variance_rad2_s2=raw[9],
        state=gyro_word(state),
        heading_by_gyro=by_gyro != 0,
        still=still != 0,
        refused=refused,
    )


def _doubt(raw: tuple[Any, ...]) -> DoubtSnapshot | None:
    words = _words(raw[4], FAULTS)
    if not words:
        return None
    return DoubtSnapshot(
        since_ns=raw[0],
        setpoint_rad_s=raw[1],
        measured_rad_s=raw[2],
        reported_rad_s=raw[3],
        fault=words[0],
        joint=raw[5],
    )


def _joint(raw: tuple[float, ...]) -> JointSnapshot:
    faults, enabled, stale, jumps = map(int, raw[8:])
    return JointSnapshot(
        position_rad=raw[0],
        velocity_rad_s=raw[1],
        setpoint_rad_s=raw[2],
        duty=raw[3],
        current_a=raw[4],
        voltage_v=raw[5],
        temperature_c=raw[6],
        feedback_age_s=raw[7],
        drive_faults=faults,
        enabled=None if enabled == _ENABLED_UNKNOWN else enabled != 0,
        stale=stale != 0,
        jumps=jumps,
    )
