# SPDX-License-Identifier: Apache-2.0
"""The cyclic table of one drive on a CAN bus, built once from its profile: which frames carry the
set-points, which ones the drive sends by itself, which are requested and how often. Pure."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

from motord_hal.base.errors import ProfileError
from motord_hal.can.codec import build, frame_time_s, parse
from motord_hal.drives.can_profile import CanTable, Frame, Sender, Signal, signals_of
from motord_hal.drives.profile import DriveProfile, Register, Step
from motord_hal.fieldbus.parameter import readable
from motord_hal.fieldbus.plan import Plan, Reading
from motord_hal.fieldbus.ports import JointSpec, LineSpec

SLOW_EVERY_CYCLES = 8
"""Values that may wait (current, voltage, temperature) are requested once in so many cycles, one
frame at a time."""

FIRST_WORD_S = 0.2
"""Time for a drive's first frame after opening, beyond its longest silence."""

STEADY_S = 1.0
"""Time after which a line that worked is reopened at once when it fails again."""

CYCLE_TOLERANCE = 0.001
"""Greatest relative error of the cycle time that a drive is given. The drive interpolates over it:
with a larger error it drifts by a whole cycle in less than a thousand."""


@dataclass(frozen=True, slots=True)
class Sent:
    """A frame to send to the CAN bus."""

    identifier: int
    extended: bool
    fd: bool
    data: bytes
    remote_bytes: int | None = None
    """For a remote frame: the length that it requests; None: a data frame."""


def with_node(profile: DriveProfile, node: int) -> DriveProfile:
    """Return the profile for this node: the node number is added in steps with `plus_node`."""

    def own(steps: tuple[Step, ...]) -> tuple[Step, ...]:
        return tuple(
            replace(step, value=step.value + node, plus_node=False)
            if step.plus_node and step.value is not None
            else step
            for step in steps
        )

    return replace(
        profile,
        configure=own(profile.configure),
        arm=own(profile.arm),
        disarm=own(profile.disarm),
        quick_stop=own(profile.quick_stop),
        clear_fault=own(profile.clear_fault),
    )


def with_cycle(profile: DriveProfile, cycle_s: float) -> DriveProfile:
    """Return the profile for this cycle time. Raises ProfileError if a register cannot hold it."""

    def own(step: Step) -> Step:
        if not step.cycle:
            return step
        register = profile.registers[step.register]
        raw = register.from_si(cycle_s)
        if abs(register.to_si(raw) - cycle_s) > CYCLE_TOLERANCE * cycle_s:
            problem = f"{step.register} cannot hold the line's cycle, {cycle_s * 1e3:.4g} ms"
            raise ProfileError(f"{profile.name}: {problem}: choose another cycle_hz")
        return replace(step, value=raw, cycle=False)

    return replace(profile, configure=tuple(own(step) for step in profile.configure))


class CanPlan(Plan):
    """One node with one or more joints on its channels."""

    def __init__(self, joints: Iterable[JointSpec]) -> None:
        super().__init__(joints)
        self.profile = with_node(self.profile, self.unit)
        if self.profile.can is None:
            raise ProfileError(
                f"{self.joints[0].name}: {self.profile.name} is no drive on a CAN bus"
            )
        self.table: CanTable = self.profile.can
        self.node = self.unit
        self._signals = {
            name: signals_of(self.profile.registers, name) for name in self.table.frames
        }
        names = self._setpoint_names()
        self.setpoint_frames = tuple(dict.fromkeys(self.frame_of(name) for name in names))
        """Frames that are sent in every cycle."""
        self.fast = self._frames_of(self._fast_names())
        """Frames with the feedback of each cycle."""
        slow = self._frames_of(self._slow_names())
        self.slow = tuple(frame for frame in slow if frame not in self.fast)
        self.watched = tuple(
            frame
            for frame in self.table.frames.values()
            if frame.silence_s and (frame.period_s or frame in self.fast)
        )
        """Frames whose absence makes the drive unresponsive."""
        self.answering = {
            name: tuple(frame for frame in self.watched if name in (frame.answers, frame.ask))
            for name in self.table.frames
        }
        """Name of a sent frame → the watched frames that answer it."""
        self.held = tuple(
            signal.name
            for frame in self.setpoint_frames
            for signal in self._signals[frame.name]
            if signal.name not in names
        )
        """Signals that go out with the set-points at their last written value: a control word."""
        self.hello = self.read_frame_of(self.table.hello) if self.table.hello else None
        sync = self.table.frames.get(self.table.sync)
        self.sync = self.write(sync, {}) if sync else None
        """The SYNC frame, which the line sends once a cycle for all its drives."""
        self.measuring = self._frames_of(self._measuring_names())
        """Frames with the feedback for the odometry."""
        self.probed = tuple(frame for frame in self.fast if not frame.period_s)
        """Frames that are requested when the drive is silent."""
        regular = self.table.idle_setpoints and not self.profile.goes_to_positions
        sent = {frame.name for frame in self.setpoint_frames if regular}
        self.asked_fast = tuple(frame for frame in self.probed if frame.answers not in sent)
        """Frames that are requested in every cycle, because they do not answer the set-points."""
        self.asked_slow = tuple(
            frame
            for frame in self.slow
            if frame.ask and not frame.period_s and frame.answers not in sent
        )
        self._by_identifier: dict[tuple[int, bool], list[Frame]] = {}
        for frame in self.table.frames_from(Sender.DRIVE):
            key = (frame.identifier(self.node), frame.is_extended(self.node))
            self._by_identifier.setdefault(key, []).append(frame)

    # ------------------------------------------------------------------------------------ building
    def _setpoint_names(self) -> list[str]:
        return [self.channel(joint).setpoint for joint in self.joints]

    def _fast_names(self) -> list[str]:
        places = (self.profile.enabled, self.profile.homed)
        names = [place.register for place in places if place is not None]
        for joint in self.joints:
            channel = self.channel(joint)
            names += [n for n in (channel.position, channel.velocity, channel.fault) if n]
            names += [channel.handshake.acknowledged] if channel.handshake else []
        return names

    def _measuring_names(self) -> list[str]:
        channels = [self.channel(joint) for joint in self.joints]
        return [name for c in channels if (name := c.position or c.velocity) is not None]

    def _slow_names(self) -> list[str]:
        names = [self.profile.bus_voltage]
        for joint in self.joints:
            channel = self.channel(joint)
            names += [channel.current, channel.temperature]
        return [name for name in names if name]

    def _frames_of(self, names: Iterable[str]) -> tuple[Frame, ...]:
        return tuple(dict.fromkeys(self.read_frame_of(name) for name in names))

    def signal(self, name: str) -> Signal:
        signal = self.profile.registers[name]
        assert isinstance(signal, Signal)  # profiles of CAN drives have signals
        return signal

    def frame_of(self, signal: str) -> Frame:
        """Return the frame in which the signal is written; for a read-only one, that in which it
        comes."""
        return self.table.frames[self.signal(signal).frame]

    def read_frame_of(self, signal: str) -> Frame:
        """Return the frame in which the signal comes."""
        found = self.signal(signal)
        return self.table.frames[found.reply_frame or found.frame]

    def readable(self, signal: str) -> Register:
        """Return a signal that can be read. Raises LookupError if it does not exist or cannot be
        read."""
        found = readable(self.profile, signal)
        frame = self.read_frame_of(signal)
        if not frame.period_s and not frame.ask:
            raise LookupError(f"{signal}: the drive neither sends it nor answers a request for it")
        return found

    @property
    def identifiers(self) -> tuple[tuple[int, bool], ...]:
        """Identifiers of frames that this node may send; True: extended."""
        return tuple(self._by_identifier)

    @property
    def setpoint_identifiers(self) -> tuple[tuple[int, bool], ...]:
        """Identifiers of frames that carry the node's set-points; True: extended."""
        frames = self.setpoint_frames
        return tuple((one.identifier(self.node), one.is_extended(self.node)) for one in frames)

    # ------------------------------------------------------------------------------------- sending
    def write(self, frame: Frame, raw: Mapping[str, int]) -> Sent:
        """Return the frame with these signals in it."""
        data = build(frame, self._signals[frame.name], raw)
        if frame.node_byte is not None:
            data = data[: frame.node_byte] + bytes((self.node,)) + data[frame.node_byte + 1 :]
        identifier = frame.identifier(self.node)
        return Sent(identifier, frame.is_extended(self.node), frame.fd, data)

    def question(self, frame: Frame) -> Sent | None:
        """Return the frame that requests this one; None: no frame does."""
        if frame.ask == "rtr":
            identifier = frame.identifier(self.node)
            extended, size_bytes = frame.is_extended(self.node), frame.size_bytes
            return Sent(identifier, extended, fd=False, data=b"", remote_bytes=size_bytes)
        return self.write(self.table.frames[frame.ask], {}) if frame.ask else None

    # ----------------------------------------------------------------------------------- receiving
    def parse(
        self, identifier: int, data: bytes, *, extended: bool
    ) -> tuple[Frame, dict[str, int]] | None:
        """Return the received frame and its signals; None: it is not one of this drive's."""
        for frame in self._by_identifier.get((identifier, extended), ()):
            values = parse(frame, self._signals[frame.name], data)
            if values is not None:
                return frame, values
        return None

    def reading(self, joint: JointSpec, values: Mapping[str, int]) -> Reading | None:
        """Return a joint's reading from the raw values; None: a value is not a number."""
        count = self._count(self.channel(joint).position, values)
        return None if count is None else self._reading(joint, values, count)

    def _count(self, name: str | None, values: Mapping[str, int]) -> int | None:
        """Return the position counter; for a position in turns, converted by the profile's
        counts."""
        if name is None or name not in values:
            return 0
        signal, mask = self.signal(name), (1 << self.profile.counter_bits) - 1
        if signal.unit == "count":
            return values[name] & mask
        turns = signal.to_si(values[name]) / (2.0 * math.pi)
        return round(turns * self.profile.counts_per_turn) & mask if math.isfinite(turns) else None

    # ------------------------------------------------------------------------------------ bus load
    def cycle_time_s(self, bitrate: int, data_bitrate: int | None) -> float:
        """Return the longest time that the frames of one cycle hold the CAN bus: set-points, the
        requests of every cycle, and a part of those that may wait."""

        def time_s(frame: Frame, *, remote: bool = False) -> float:
            return frame_time_s(frame, bitrate, data_bitrate, remote=remote)

        def asked_s(frame: Frame) -> float:
            asking = self.table.frames.get(frame.ask)
            question_s = time_s(asking) if asking else time_s(frame, remote=True)
            return question_s + time_s(frame)

        cycle_s = sum(time_s(frame) for frame in self.setpoint_frames)
        names = [frame.name for frame in self.setpoint_frames]
        answers = [
            frame for frame in self.table.frames.values() if {frame.ask, frame.answers} & {*names}
        ]
        cycle_s += sum(time_s(frame) for frame in answers)
        cycle_s += sum(asked_s(frame) for frame in self.asked_fast)
        if self.asked_slow:
            slow_s = sum(asked_s(frame) for frame in self.asked_slow) / len(self.asked_slow)
            cycle_s += slow_s / SLOW_EVERY_CYCLES
        return cycle_s

    def own_load(self, bitrate: int, data_bitrate: int | None) -> float:
        """Return the part of the CAN bus that the drive uses for frames without a request."""
        return sum(
            frame_time_s(frame, bitrate, data_bitrate) / frame.period_s
            for frame in self.table.frames_from(Sender.DRIVE)
            if frame.period_s
        )


def wire_limit_hz(spec: LineSpec, plans: Sequence[CanPlan]) -> float:
    """Return the greatest cycle rate beside what the drives send by themselves."""
    wire = (spec.baudrate, spec.data_baudrate)
    free = 1.0 - sum(plan.own_load(*wire) for plan in plans)
    return max(free, 0.0) / sum(plan.cycle_time_s(*wire) for plan in plans)
