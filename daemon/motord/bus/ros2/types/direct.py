# SPDX-License-Identifier: Apache-2.0
"""From a snapshot to CDR without a message in between, for the topics that come often.

What a field means is said in `motord.bus.messages.from_snapshot`, and what lies where in `cdr`;
here it is said once more for speed, and tests hold the bytes equal. What never changes (names,
frames, zeros) is laid out when the encoder is made. What is not the usual case goes the long way.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping
from math import cos, inf, isfinite, nan, sin
from typing import Any

from motord.bus.messages.from_snapshot import (
    NOT_MEASURED,
    NOT_TOLD,
    UNMEASURED,
    Body,
    power_supply_status,
    state_name,
)
from motord.bus.messages.topics import Topic, View
from motord.bus.ros2.types.cdr import HEADER, encode

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
    return long_way if make is None else make(topic, body, long_way)


def stamp_ns(topic: str, raw: bytes) -> int:
    """The sample's own moment in a message of that topic, as wall time."""
    sec, nanosec = _STAMP.unpack_from(raw, _STAMP_OFFSETS.get(topic, len(HEADER)))
    return int(sec * _NS + nanosec)


def _long_way(topic: Topic, body: Body) -> Encoder:
    def encoded(view: View, wall_offset_ns: int) -> bytes | None:
        message = topic.build(view, body, wall_offset_ns)
        return None if message is None else bytes(encode(topic.type_name, message))

    return encoded


def _written_out(parameters: str, arguments: str, count: int) -> Callable[..., bytes]:
    """A call of `pack` with the fields of so many `joints` by their names, for there is nothing
    faster: lists of them take twice the time. Both texts are ours, nothing of a robot file is in
    them."""
    names = "".join(f"j{place}," for place in range(count))
    source = (
        f"def packed(pack, {parameters}, joints):\n {names} = joints\n return pack({arguments})\n"
    )
    made: dict[str, Any] = {"HEADER": HEADER}
    exec(source, made)  # noqa: S102  our own text: names are numbers of joints
    packed: Callable[..., bytes] = made["packed"]
    return packed


def _column(field: str, count: int) -> str:
    return ", ".join(f"j{place}.{field}" for place in range(count))


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


def _odometry(topic: Topic, body: Body, long_way: Encoder) -> Encoder:
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
            x_m + y_m + half_rad + linear_m_s + angular_rad_s
        ):
            return long_way(view, wall_offset_ns)
        xx, xy, xh, yy, yh, hh = now.pose_covariance
        vv, vw, ww = now.twist_covariance
        wall_ns = now.odometry_stamp_ns + wall_offset_ns
        sec = wall_ns // _NS
        try:
            return pack(
                HEADER, sec, wall_ns - sec * _NS, between,
                x_m, y_m, sin(half_rad), cos(half_rad),
                xx, xy, xh, xy, yy, yh, pose_untold, xh, yh, hh,
                linear_m_s, angular_rad_s, vv, vw, vv, twist_untold, vw, ww,
            )  # fmt: skip
        except struct.error as error:
            raise ValueError(f"{topic.type_name}: {error}") from error

    return encoded


def _transforms(topic: Topic, body: Body, long_way: Encoder) -> Encoder:
    one = HEADER + struct.pack("<I", 1)
    frames = _Constant(_AFTER_COUNT).string(body.odom_frame).string(body.base_frame)
    between = frames.align(_ALIGNMENT).raw
    pack = struct.Struct(f"<{len(one)}siI{len(between)}s2d24x2d").pack

    def encoded(view: View, wall_offset_ns: int) -> bytes | None:
        now = view.snapshot
        x_m, y_m, half_rad = now.x_m, now.y_m, 0.5 * now.heading_rad
        if not now.odometry_stamp_ns or not isfinite(x_m + y_m + half_rad):
            return long_way(view, wall_offset_ns)
        wall_ns = now.odometry_stamp_ns + wall_offset_ns
        sec = wall_ns // _NS
        try:
            return pack(
                one, sec, wall_ns - sec * _NS, between, x_m, y_m, sin(half_rad), cos(half_rad)
            )
        except struct.error as error:
            raise ValueError(f"{topic.type_name}: {error}") from error

    return encoded


def _joint_states(topic: Topic, body: Body, long_way: Encoder) -> Encoder:
    """Of joints that have all been heard."""
    count = len(body.joints)
    if count == 0:
        return long_way
    names = _Constant(_AFTER_STAMP).string("").strings(body.joints)
    before = names.number("I", count).align(_ALIGNMENT).raw
    between = struct.pack("<I4x", count)
    pack = struct.Struct(f"<4siI{len(before)}s{count}d8s{count}d4x").pack
    packed = _written_out(
        "sec, nanosec, before, between",
        f"HEADER, sec, nanosec, before, {_column('position_rad', count)},"
        f" between, {_column('velocity_rad_s', count)}",
        count,
    )

    def encoded(view: View, wall_offset_ns: int) -> bytes | None:
        now = view.snapshot
        joints = now.joints
        total, oldest_s = 0.0, -inf
        for joint in joints:
            age_s = joint.feedback_age_s
            total += joint.position_rad + age_s
            if age_s > oldest_s:
                oldest_s = age_s
        if not isfinite(total):
            return long_way(view, wall_offset_ns)
        wall_ns = now.stamp_ns - round(oldest_s * _NS) + wall_offset_ns
        sec = wall_ns // _NS
        try:
            return packed(pack, sec, wall_ns - sec * _NS, before, between, joints)
        except (struct.error, ValueError) as error:  # other values, other joints
            raise ValueError(f"{topic.type_name}: {error}") from error

    return encoded


def _imu(topic: Topic, body: Body, long_way: Encoder) -> Encoder:
    """Of a sensor that measures all six axes and knows its zero."""
    turned = _Constant(_AFTER_STAMP).string(body.base_frame)
    turned.number("4d", 0.0, 0.0, 0.0, 1.0).number("9d", *NOT_MEASURED)
    before = turned.raw
    pack = struct.Struct(f"<4siI{len(before)}s3dd24xd24xd3d72x").pack

    def encoded(view: View, wall_offset_ns: int) -> bytes | None:
        found = view.snapshot.imu
        if found is None or found.state in NOT_TOLD:
            return None
        x, y, z = found.angular_rad_s
        forward, left, up = found.acceleration_m_s2
        variance = found.rate_variance_rad2_s2 + found.bias_variance_rad2_s2
        if not isfinite(x + y + z + forward + left + up + variance):
            return long_way(view, wall_offset_ns)
        wall_ns = found.stamp_ns + wall_offset_ns
        sec = wall_ns // _NS
        try:
            return pack(
                HEADER, sec, wall_ns - sec * _NS, before,
                x, y, z, variance, variance, variance, forward, left, up,
            )  # fmt: skip
        except struct.error as error:
            raise ValueError(f"{topic.type_name}: {error}") from error

    return encoded


def _battery_state(topic: Topic, _body: Body, long_way: Encoder) -> Encoder:
    """Of a [battery]; its number of cells does not change."""
    before = _Constant(_AFTER_STAMP).string("").align(4).raw
    unknown = struct.pack("<2f", nan, nan)
    after_status = _AFTER_STAMP + len(before) + 7 * 4 + 1
    pack = struct.Struct("<4siI8s3f8sf4sB").pack
    cells, tail = 0, _battery_tail(after_status, 0)

    def encoded(view: View, wall_offset_ns: int) -> bytes | None:
        nonlocal cells, tail
        battery = view.battery()
        if battery is None:
            return long_way(view, wall_offset_ns)
        voltage_v, current_a = battery["voltage_v"], battery["current_a"]
        if voltage_v is None:
            return None
        temperature_c, capacity_ah = battery["temperature_c"], battery["capacity_ah"]
        if battery["cells"] != cells:
            cells = battery["cells"]
            tail = _battery_tail(after_status, cells or 0)
        wall_ns = view.snapshot.stamp_ns + wall_offset_ns
        sec = wall_ns // _NS
        try:
            return pack(
                HEADER, sec, wall_ns - sec * _NS, before, voltage_v,
                nan if temperature_c is None else temperature_c,
                nan if current_a is None else current_a,
                unknown, nan if capacity_ah is None else capacity_ah, unknown,
                power_supply_status(current_a),
            ) + tail  # fmt: skip
        except (struct.error, OverflowError) as error:
            raise ValueError(f"{topic.type_name}: {error}") from error

    return encoded


def _battery_tail(at: int, cells: int) -> bytes:
    """Health and technology unknown, present, so many cells that nobody measures, no name."""
    tail = (
        _Constant(at).number("3B", 0, 0, 1).number("I", cells).number(f"{cells}f", *[nan] * cells)
    )
    return tail.number("I", 0).string("").string("").align(4).raw


def _loop_statistics(topic: Topic, _body: Body, _long_way: Encoder) -> Encoder:
    before = _Constant(_AFTER_STAMP).string("").align(_ALIGNMENT).raw
    policy, words = "", b""
    pack = struct.Struct("").pack

    def encoded(view: View, wall_offset_ns: int) -> bytes | None:
        nonlocal policy, words, pack
        if view.status is None:
            return None
        loop = view.status["loop"]
        late, step = loop["lateness_us"], loop["step_ns"]
        if loop["policy"] != policy or not words:
            policy = loop["policy"]
            at = _AFTER_STAMP + len(before) + 8
            words = _Constant(at).string(policy).align(_ALIGNMENT).raw
            pack = struct.Struct(f"<4siI{len(before)}sd{len(words)}s3Q8d").pack
        wall_ns = view.status_ns + wall_offset_ns
        sec = wall_ns // _NS
        try:
            return pack(
                HEADER, sec, wall_ns - sec * _NS, before, loop["rate_hz"], words,
                loop["ticks"], loop["overruns"], loop["page_faults"],
                late["p50"], late["p99"], late["p99_9"], late["max"],
                step["p50"], step["p99"], step["p99_9"], step["max"],
            )  # fmt: skip
        except struct.error as error:
            raise ValueError(f"{topic.type_name}: {error}") from error

    return encoded


class _MotorStatus:
    """Its words are laid out anew when one of them is another."""

    def __init__(self, topic: Topic, body: Body) -> None:
        count = len(body.joints)
        self._type_name, self._body = topic.type_name, body
        self._known: tuple[object, ...] = ()
        self._status: Mapping[str, Any] | None = None
        self._words = self._names = b""
        self._in_another_second(0)
        self._pack = struct.Struct("").pack
        self._length = struct.pack("<I4x", count)
        self._short_length = self._length[:4]
        columns = [", length, ".join(_column(field, count) for field in _MEASURED)]
        columns += [_column(field, count) for field in ("drive_faults", "stale")]
        self._packed = _written_out(
            "head, nanosec, words, names, length, short_length, now",
            "head, nanosec, words, now.command_age_s, now.setpoint_linear_m_s,"
            f" now.setpoint_angular_rad_s, names, {', short_length, '.join(columns)}",
            count,
        )

    def encoded(self, view: View, wall_offset_ns: int) -> bytes | None:
        now = view.snapshot
        said = (now.machine_state, now.armed, now.at_rest, now.owner, now.faults, now.reasons)
        if said != self._known or view.status is not self._status:
            self._lay_out(view)
            self._known, self._status = said, view.status
        nanosec = now.stamp_ns + wall_offset_ns - self._second_ns
        try:
            if not 0 <= nanosec < _NS:
                nanosec = self._in_another_second(self._second_ns + nanosec)
            return self._packed(
                self._pack, self._head, nanosec, self._words, self._names,
                self._length, self._short_length, now, now.joints,
            )  # fmt: skip
        except (struct.error, ValueError) as error:  # other values, other joints
            raise ValueError(f"{self._type_name}: {error}") from error

    def _in_another_second(self, wall_ns: int) -> int:
        """The moment in it. Raises struct.error for one that a stamp cannot hold."""
        sec, nanosec = divmod(wall_ns, _NS)
        self._head = HEADER + struct.pack("<i", sec)
        self._second_ns = wall_ns - nanosec
        return nanosec

    def _lay_out(self, view: View) -> None:
        now, commander, joints = view.snapshot, view.commander(), self._body.joints
        words = _Constant(_AFTER_STAMP).string(self._body.base_frame).string(state_name(now))
        words.number("2?", now.armed, now.at_rest).strings(now.faults)
        words.strings(view.why()).strings(now.reasons)
        words.string(commander.owner if commander else "")
        words.number("i", commander.priority if commander else 0)
        words.string(commander.why if commander else "").align(_ALIGNMENT)
        names = _Constant(words.end + 3 * _ALIGNMENT).strings(joints)
        names.number("I", len(joints)).align(_ALIGNMENT)
        self._words, self._names = words.raw, names.raw
        count = len(joints)
        doubles = f"{count}d" + f"8s{count}d" * (len(_MEASURED) - 1)
        self._pack = struct.Struct(
            f"<8sI{len(self._words)}s3d{len(self._names)}s{doubles}4s{count}I4s{count}?"
            f"{-count % 4}x"
        ).pack


_MEASURED = (
    "setpoint_rad_s", "duty", "current_a", "voltage_v", "temperature_c", "feedback_age_s",
)  # fmt: skip
"""Of each joint in a MotorStatus, as float64."""


def _motor_status(topic: Topic, body: Body, long_way: Encoder) -> Encoder:
    return _MotorStatus(topic, body).encoded if body.joints else long_way


_DIRECT = {
    "odom": _odometry,
    "tf": _transforms,
    "joint_states": _joint_states,
    "motor_status": _motor_status,
    "imu": _imu,
    "battery_state": _battery_state,
    "loop_statistics": _loop_statistics,
}
