# SPDX-License-Identifier: Apache-2.0
"""From a snapshot to CDR without a message in between, for the topics that come often.

What a field means is said in `motord.bus.messages`, and what lies where in `cdr`; here it is said
once more for speed, and tests hold the bytes equal. What never changes (names, frames, zeros) is
laid out when the encoder is made. What is not the usual case goes the long way.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from math import cos, hypot, isfinite, sin

from motord.bus.messages import UNMEASURED, Body, Commander, state_name
from motord.bus.ros2.cdr import HEADER, encode
from motord.bus.topics import Topic, View

Encoder = Callable[[View, int], "bytes | None"]
"""From a view and the wall clock's offset; None: there is no such message to be had."""
_NS = 1_000_000_000
_ALIGNMENT = 8
_STAMP = struct.Struct("<iI")
_STAMP_OFFSETS = {"tf": 8}
"""Where it is not the first field."""
_UNTOLD = tuple(UNMEASURED * (place in (14, 21, 28)) for place in range(36))
"""Height, roll and pitch on the diagonal of a covariance: `messages.pose_covariance`."""


def encoder(topic: Topic, body: Body) -> Encoder:
    """Its calls raise ValueError for what does not fit the message."""
    long_way = _long_way(topic, body)
    make = _DIRECT.get(topic.name)
    return long_way if make is None else _checked(make(body, long_way), topic)


def stamp_ns(topic: str, raw: bytes) -> int:
    """The sample's own moment in a message of that topic, as wall time."""
    sec, nanosec = _STAMP.unpack_from(raw, _STAMP_OFFSETS.get(topic, len(HEADER)))
    return int(sec * _NS + nanosec)


def _long_way(topic: Topic, body: Body) -> Encoder:
    def encoded(view: View, wall_offset_ns: int) -> bytes | None:
        message = topic.build(view, body, wall_offset_ns)
        return None if message is None else bytes(encode(topic.type_name, message))

    return encoded


def _checked(direct: Encoder, topic: Topic) -> Encoder:
    def encoded(view: View, wall_offset_ns: int) -> bytes | None:
        try:
            return direct(view, wall_offset_ns)
        except struct.error as error:
            raise ValueError(f"{topic.type_name}: {error}") from error

    return encoded


class _Constant:
    """What stands between two numbers that change: strings, lengths and zeros, aligned."""

    def __init__(self, at: int) -> None:
        """`at`: where it begins, counted from the end of the header."""
        self.raw = b""
        self._begin = at

    @property
    def end(self) -> int:
        """Where the next byte goes."""
        return self._begin + len(self.raw)

    def string(self, text: str) -> _Constant:
        raw = text.encode() + b"\0"
        return self.number("I", len(raw)).add(raw)

    def strings(self, texts: tuple[str, ...]) -> _Constant:
        self.number("I", len(texts))
        for text in texts:
            self.string(text)
        return self

    def number(self, code: str, *values: float) -> _Constant:
        size = struct.calcsize(f"<{code[-1]}")
        return self.align(size).add(struct.pack(f"<{code}", *values))

    def align(self, size: int) -> _Constant:
        return self.add(bytes(-self.end % size))

    def add(self, raw: bytes) -> _Constant:
        self.raw += raw
        return self


_AFTER_STAMP = _STAMP.size
_AFTER_COUNT = 4 + _STAMP.size


def _odometry(body: Body, long_way: Encoder) -> Encoder:
    frames = _Constant(_AFTER_STAMP).string(body.odom_frame).string(body.base_frame)
    between = frames.align(_ALIGNMENT).raw
    pose_untold = struct.pack("<18d", *_UNTOLD[12:30])
    twist_untold = struct.pack("<22d", *_UNTOLD[8:30])
    pack = struct.Struct(
        f"<4siI{len(between)}s"
        "2d24x2d"  # x, y; z and two of the quaternion are zero
        f"2d24x3d24xd{len(pose_untold)}s2d24xd"
        "d32xd"  # forward, four zeros, about z
        f"d32xd8xd{len(twist_untold)}sd32xd"
    ).pack

    def encoded(view: View, wall_offset_ns: int) -> bytes | None:
        now = view.snapshot
        x_m, y_m, half_rad = now.x_m, now.y_m, 0.5 * now.heading_rad
        linear_m_s, angular_rad_s = now.linear_m_s, now.angular_rad_s
        if not now.odometry_stamp_ns or not isfinite(
            hypot(x_m, y_m, half_rad, linear_m_s, angular_rad_s)
        ):
            return long_way(view, wall_offset_ns)
        xx, xy, xh, yy, yh, hh = now.pose_covariance
        vv, vw, ww = now.twist_covariance
        wall_ns = now.odometry_stamp_ns + wall_offset_ns
        sec = wall_ns // _NS
        return pack(
            HEADER, sec, wall_ns - sec * _NS, between,
            x_m, y_m, sin(half_rad), cos(half_rad),
            xx, xy, xh, xy, yy, yh, pose_untold, xh, yh, hh,
            linear_m_s, angular_rad_s, vv, vw, vv, twist_untold, vw, ww,
        )  # fmt: skip

    return encoded


def _transforms(body: Body, long_way: Encoder) -> Encoder:
    one = HEADER + struct.pack("<I", 1)
    frames = _Constant(_AFTER_COUNT).string(body.odom_frame).string(body.base_frame)
    between = frames.align(_ALIGNMENT).raw
    pack = struct.Struct(f"<{len(one)}siI{len(between)}s2d24x2d").pack

    def encoded(view: View, wall_offset_ns: int) -> bytes | None:
        now = view.snapshot
        x_m, y_m, half_rad = now.x_m, now.y_m, 0.5 * now.heading_rad
        if not now.odometry_stamp_ns or not isfinite(hypot(x_m, y_m, half_rad)):
            return long_way(view, wall_offset_ns)
        wall_ns = now.odometry_stamp_ns + wall_offset_ns
        sec = wall_ns // _NS
        return pack(one, sec, wall_ns - sec * _NS, between, x_m, y_m, sin(half_rad), cos(half_rad))

    return encoded


def _joint_states(body: Body, long_way: Encoder) -> Encoder:
    """Of joints that have all been heard."""
    count = len(body.joints)
    if count == 0:
        return long_way
    names = _Constant(_AFTER_STAMP).string("").strings(body.joints)
    before = names.number("I", count).align(_ALIGNMENT).raw
    between = struct.pack("<I4x", count)
    pack = struct.Struct(f"<4siI{len(before)}s{count}d8s{count}d4x").pack

    def encoded(view: View, wall_offset_ns: int) -> bytes | None:
        now = view.snapshot
        positions, velocities, ages_s = [], [], []
        for joint in now.joints:  # a third of what zip(*map(attrgetter)) takes
            positions.append(joint.position_rad)
            velocities.append(joint.velocity_rad_s)
            ages_s.append(joint.feedback_age_s)
        if not isfinite(hypot(*positions, *ages_s)):
            return long_way(view, wall_offset_ns)
        wall_ns = now.stamp_ns - round(max(ages_s) * _NS) + wall_offset_ns
        sec = wall_ns // _NS
        return pack(HEADER, sec, wall_ns - sec * _NS, before, *positions, between, *velocities)

    return encoded


class _MotorStatus:
    """Its words are laid out anew when one of them is another."""

    def __init__(self, body: Body) -> None:
        count = len(body.joints)
        self._body = body
        self._length = struct.pack("<I4x", count)
        self._short_length = self._length[:4]
        self._known: tuple[object, ...] = ()
        self._words = self._names = b""
        self._pack = struct.Struct("").pack

    def encoded(self, view: View, wall_offset_ns: int) -> bytes | None:
        now, commander = view.snapshot, view.commander()
        said = (now.machine_state, now.armed, now.at_rest, now.faults, now.reasons, commander)
        if said != self._known:
            self._lay_out(view, commander)
            self._known = said
        setpoints, duties, currents, voltages = [], [], [], []
        temperatures, ages, faults, stale = [], [], [], []
        for joint in now.joints:
            setpoints.append(joint.setpoint_rad_s)
            duties.append(joint.duty)
            currents.append(joint.current_a)
            voltages.append(joint.voltage_v)
            temperatures.append(joint.temperature_c)
            ages.append(joint.feedback_age_s)
            faults.append(joint.drive_faults)
            stale.append(joint.stale)
        wall_ns = now.stamp_ns + wall_offset_ns
        sec = wall_ns // _NS
        length = self._length
        return self._pack(
            HEADER, sec, wall_ns - sec * _NS, self._words, now.command_age_s,
            now.setpoint_linear_m_s, now.setpoint_angular_rad_s, self._names,
            *setpoints, length, *duties, length, *currents, length, *voltages,
            length, *temperatures, length, *ages, self._short_length, *faults,
            self._short_length, *stale,
        )  # fmt: skip

    def _lay_out(self, view: View, commander: Commander | None) -> None:
        now, joints = view.snapshot, self._body.joints
        words = _Constant(_AFTER_STAMP).string(self._body.base_frame).string(state_name(now))
        words.number("2?", now.armed, now.at_rest).strings(now.faults).strings(now.reasons)
        words.string(commander.owner if commander else "")
        words.number("i", commander.priority if commander else 0).align(_ALIGNMENT)
        names = _Constant(words.end + 3 * _ALIGNMENT).strings(joints)
        names.number("I", len(joints)).align(_ALIGNMENT)
        self._words, self._names = words.raw, names.raw
        count = len(joints)
        doubles = f"{count}d" + f"8s{count}d" * 5
        self._pack = struct.Struct(
            f"<4siI{len(self._words)}s3d{len(self._names)}s{doubles}4s{count}I4s{count}?"
            f"{-count % 4}x"
        ).pack


def _motor_status(body: Body, long_way: Encoder) -> Encoder:
    return _MotorStatus(body).encoded if body.joints else long_way


_DIRECT = {
    "odom": _odometry,
    "tf": _transforms,
    "joint_states": _joint_states,
    "motor_status": _motor_status,
}
