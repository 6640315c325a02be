# SPDX-License-Identifier: Apache-2.0
"""The lines' interface to the C core: the clock, and the mailboxes between lines and loop.

A mailbox keeps only the newest value. A put never waits; a take returns the newest value, also if
it was taken before. The meaning of each field is in csrc/api/api.h.
"""

from __future__ import annotations

import asyncio
import contextlib
import functools
import math
import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar, get_type_hints

from _motord_rt import ffi, lib

JOINTS_MAX: int = lib.JOINTS_MAX
LINES_MAX: int = lib.LINES_MAX

_U32 = 0xFFFF_FFFF
_U64 = 0xFFFF_FFFF_FFFF_FFFF
_UNKNOWN = 2
"""Value of a yes-or-no field that the drive does not report: csrc/api/api.h."""
_ALIGNMENT_BYTES = 64
_WAKE_FDS: dict[tuple[int, int], int] = {}
"""(Exchange, line) → eventfd. They are never closed: the loop may write to one at any time."""
Value = TypeVar("Value")
_types_of = functools.cache(get_type_hints)


def value_of(kind: Callable[..., Value], raw: Any, **own: Any) -> Value:
    """Convert a struct of C to a plain value of class `kind`, whose fields have the same names.
    `own` holds the values of the other fields."""
    made = {n: of(getattr(raw, n)) for n, of in _types_of(kind).items() if n not in own}
    return kind(**made, **own)


def first_bad(check: Callable[[Any, Any], Any], value: Any) -> str:
    """Run a check in C; return the name of the first bad field, or "" if all are good."""
    name = ffi.new("char[]", lib.FIELD_NAME_BYTES)
    found = check(value, name)
    return "" if found == ffi.NULL else str(ffi.string(found).decode("ascii"))


def now_ns() -> int:
    """Return CLOCK_MONOTONIC in nanoseconds, the clock of every stamp in motord."""
    return int(lib.clock_now_ns())


def is_fresh(stamp_ns: int, timeout_s: float) -> bool:
    """Whether a stamp is not older than the timeout, not from the future and not from before a
    suspend of the computer. Lines in C and the core use the same rule."""
    return bool(lib.clock_stamp_is_fresh(stamp_ns, round(timeout_s * 1e9)))


@dataclass(frozen=True, slots=True)
class JointSetpoint:
    """The set-point of one joint: its speed, the same as a duty in -1..1, and as a torque if its
    drive takes torques. `position_rad` None: there is no target angle, the joint does not move."""

    velocity_rad_s: float
    duty: float
    torque_n_m: float = 0.0
    position_rad: float | None = None


@dataclass(frozen=True, slots=True)
class Setpoints:
    """The set-points of all joints; the index in `joints` is the joint's index in the core.

    If none were ever written: stamp 0, not enabled, no joints. The caller has to check `stamp_ns`:
    a loop that died leaves its last set-points behind.
    """

    stamp_ns: int
    tick: int
    enabled: bool
    joints: tuple[JointSetpoint, ...]


@dataclass(frozen=True, slots=True)
class Feedback:
    """The newest feedback of a joint. NaN: the drive does not report this value. `referenced`: the
    position counter has a reference. `enabled` or `referenced` None: the drive cannot report it."""

    stamp_ns: int
    count: int
    velocity_rad_s: float
    current_a: float
    voltage_v: float
    temperature_c: float
    epoch: int
    enabled: bool | None
    drive_faults: int
    referenced: bool | None = None


@dataclass(frozen=True, slots=True)
class ImuSample:
    """The newest sample of the inertial sensor, in the base's axes. Stamp 0: there was none."""

    stamp_ns: int
    angular_rad_s: tuple[float, ...]
    acceleration_m_s2: tuple[float, ...]
    saturated: bool
    epoch: int


class Exchange:
    """Access to the mailboxes from one thread (the object has one buffer for each kind of value).

    A mailbox has one writer and one reader. Bad indices raise IndexError.
    """

    def __init__(self, handle: object, memory: object = None) -> None:
        """Call `of_loop` or `private` instead. `memory` is kept alive as long as the object."""
        self._exchange = handle
        self._memory = memory
        self._setpoints = ffi.new("setpoints *")
        self._feedback = ffi.new("joint_feedback *")
        self._imu = ffi.new("imu_sample *")

    @classmethod
    def of_loop(cls) -> Exchange:
        """Return the exchange that the loop of this process reads and writes."""
        return cls(lib.loop_exchange())

    @classmethod
    def private(cls) -> Exchange:
        """Make a separate, empty exchange, for tests and tools."""
        memory = ffi.new("uint8_t[]", lib.exchange_bytes() + _ALIGNMENT_BYTES)
        address = int(ffi.cast("uintptr_t", memory))
        aligned = -(-address // _ALIGNMENT_BYTES) * _ALIGNMENT_BYTES
        handle = ffi.cast("exchange *", aligned)
        lib.exchange_init(handle)
        return cls(handle, memory)

    @property
    def handle(self) -> object:
        """The C pointer to the mailboxes, valid as long as this object exists."""
        return self._exchange

    def take_setpoints(self, line: int) -> Setpoints:
        """Return the newest set-points of all joints. Lines call it."""
        raw = self._setpoints
        _check(lib.exchange_take_setpoints(self._exchange, line, raw), "line", line)
        joints = range(min(raw.joint_count, JOINTS_MAX))
        return Setpoints(
            stamp_ns=raw.stamp_ns,
            tick=raw.tick,
            enabled=raw.enabled != 0,
            joints=tuple(
                JointSetpoint(
                    raw.joint[i].velocity_rad_s,
                    raw.joint[i].duty,
                    raw.joint[i].torque_n_m,
                    raw.position_rad[i] if raw.positioned >> i & 1 else None,
                )
                for i in joints
            ),
        )

    def enabled_count(self, line: int) -> int:
        """Return how often a line's set-points have become enabled. It shows a line also a change
        too short to be seen in a take. Read it before the take."""
        return int(lib.exchange_enabled_count(self._exchange, line))

    @contextlib.contextmanager
    def waking(self, line: int, call: Callable[[], object]) -> Iterator[None]:
        """Make the event loop call `call` when a line in asyncio has a new command or a stop to
        send, until the end of the block. Raise OSError if there is no free file descriptor."""
        place = int(ffi.cast("uintptr_t", self._exchange)), line
        if (fd := _WAKE_FDS.get(place)) is None:
            fd = _WAKE_FDS[place] = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)

        def answer() -> None:
            with contextlib.suppress(BlockingIOError):
                os.eventfd_read(fd)
            call()

        events = asyncio.get_running_loop()
        _check(lib.exchange_set_line_wake(self._exchange, line, fd), "line", line)
        try:
            events.add_reader(fd, answer)
            yield
        finally:
            lib.exchange_set_line_wake(self._exchange, line, -1)
            events.remove_reader(fd)

    def wake_line(self, line: int) -> None:
        """Wake a line as the loop does, for tests."""
        if (fd := lib.exchange_line_wake(self._exchange, line)) >= 0:
            os.eventfd_write(fd, 1)

    def put_setpoints(self, line: int, value: Setpoints) -> None:
        """Write set-points as the loop does, for tests and tools. Raise ValueError for more than
        JOINTS_MAX joints."""
        if len(value.joints) > JOINTS_MAX:
            raise ValueError(f"{len(value.joints)} joints, at most {JOINTS_MAX}")
        raw = self._setpoints
        raw.stamp_ns = value.stamp_ns
        raw.tick = value.tick
        raw.enabled = value.enabled
        raw.joint_count = len(value.joints)
        raw.positioned = 0
        for i, joint in enumerate(value.joints):
            place = raw.joint[i]
            place.velocity_rad_s = joint.velocity_rad_s
            place.duty = joint.duty
            place.torque_n_m = joint.torque_n_m
            raw.position_rad[i] = 0.0 if joint.position_rad is None else joint.position_rad
            raw.positioned |= (joint.position_rad is not None) << i
        _check(lib.exchange_put_setpoints(self._exchange, line, raw), "line", line)

    def put_feedback(
        self,
        joint: int,
        *,
        stamp_ns: int,
        count: int,
        velocity_rad_s: float = math.nan,
        current_a: float = math.nan,
        voltage_v: float = math.nan,
        temperature_c: float = math.nan,
        epoch: int,
        enabled: bool | None,
        drive_faults: int,
        referenced: bool | None = None,
    ) -> None:
        """Write the feedback of a joint. Lines call it. Whole numbers wrap at their width in C: a
        counter may be negative."""
        raw = self._feedback
        raw.stamp_ns = stamp_ns
        raw.count = count & _U64
        raw.velocity_rad_s = velocity_rad_s
        raw.current_a = current_a
        raw.voltage_v = voltage_v
        raw.temperature_c = temperature_c
        raw.epoch = epoch & _U32
        raw.enabled = _UNKNOWN if enabled is None else int(enabled)
        raw.drive_faults = drive_faults & _U32
        raw.referenced = _UNKNOWN if referenced is None else int(referenced)
        _check(lib.exchange_put_feedback(self._exchange, joint, raw), "joint", joint)

    def put_imu(
        self,
        *,
        stamp_ns: int,
        angular_rad_s: Sequence[float],
        acceleration_m_s2: Sequence[float],
        saturated: bool,
        epoch: int,
    ) -> None:
        """Write a sample of the inertial sensor, in the base's axes x, y, z."""
        raw = self._imu
        raw.stamp_ns = stamp_ns
        raw.angular_rad_s = angular_rad_s
        raw.acceleration_m_s2 = acceleration_m_s2
        raw.saturated = saturated
        raw.epoch = epoch & _U32
        lib.exchange_put_imu(self._exchange, raw)

    def take_imu(self) -> ImuSample:
        """Read the newest sample of the inertial sensor, for tests and tools."""
        raw = self._imu
        lib.exchange_take_imu(self._exchange, raw)
        return ImuSample(
            stamp_ns=raw.stamp_ns,
            angular_rad_s=tuple(raw.angular_rad_s),
            acceleration_m_s2=tuple(raw.acceleration_m_s2),
            saturated=raw.saturated != 0,
            epoch=raw.epoch,
        )

    def take_feedback(self, joint: int) -> Feedback:
        """Read the newest feedback of a joint as the loop does, for tests and tools."""
        raw = self._feedback
        _check(lib.exchange_take_feedback(self._exchange, joint, raw), "joint", joint)
        return Feedback(
            stamp_ns=raw.stamp_ns,
            count=raw.count,
            velocity_rad_s=raw.velocity_rad_s,
            current_a=raw.current_a,
            voltage_v=raw.voltage_v,
            temperature_c=raw.temperature_c,
            epoch=raw.epoch,
            enabled=None if raw.enabled == _UNKNOWN else raw.enabled != 0,
            drive_faults=raw.drive_faults,
            referenced=None if raw.referenced == _UNKNOWN else raw.referenced != 0,
        )


def _check(code: int, what: str, index: int) -> None:
    if code < 0:
        raise IndexError(f"no {what} {index} in the exchange")
