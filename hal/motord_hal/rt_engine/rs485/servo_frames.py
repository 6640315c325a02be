# SPDX-License-Identifier: Apache-2.0
"""The frames of a bus servo (implements frames.DriveFrames), and the cycle of all servos."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

from motord_hal.drives.profile import DriveProfile, Register, Step
from motord_hal.fieldbus.plan import present_positions
from motord_hal.fieldbus.ports import JointSpec
from motord_hal.modbus.plan import WireTime, wanted_registers
from motord_hal.realtime.table import LineFrame, LineGroup, Seal
from motord_hal.rt_engine.rs485.frames import DriveFrames, PlannedFrame
from motord_hal.servo.packets import (
    BROADCAST_UNIT,
    INSTRUCTION_ADDRESS,
    Instruction,
    decode,
    encode,
    has_no_sync_read,
    packets_of,
    size_bytes,
)

EXTRA_EVERY_CYCLES = 8
"""Number of cycles between two reads of torque, mode, watchdog and the like. Servos have several
times as many cycles a second as a Modbus drive."""
_SEALS = {"feetech": Seal.SUM, "dynamixel": Seal.STUFFED}
_CYCLIC_HOLE_BYTES = 4
"""Longest gap of unused bytes that a cyclic exchange reads along with the registers around it."""
_EXTRA_HOLE_BYTES = 30
"""The same for extra exchanges: another exchange would cost a request and the head of a reply."""


class _Span:
    """The adjacent bytes that one request reads."""

    def __init__(self, registers: Sequence[Register]) -> None:
        self.registers = tuple(registers)
        self.address = registers[0].address
        self.count = _end(registers[-1]) - self.address


class ServoFrames:
    """Implements DriveFrames for one unit with one motor."""

    def __init__(self, joints: Iterable[JointSpec], gap_s: float, wire_time_s: WireTime) -> None:
        self.joints = tuple(sorted(joints, key=lambda joint: joint.channel))
        self.profile: DriveProfile = self.joints[0].profile
        self.unit = self.joints[0].unit
        self._packets = packets_of(self.profile.protocol)
        self._seal = _SEALS[self.profile.protocol]
        self._gap_s, self._wire_time_s = gap_s, wire_time_s
        fast, slow = wanted_registers(self.profile, self.joints)
        channel = self.profile.channels[self.joints[0].channel]
        moving = [self.profile.registers[n] for n in (channel.position, channel.velocity) if n]
        # of a servo that measures no motion, other values are read: they show its answer's age
        self._cyclic = _around(moving or fast[:1] or slow[-1:], [*fast, *slow])
        rest = [r for r in dict.fromkeys([*fast, *slow]) if r not in self._cyclic.registers]
        self._extra = _spans(rest, _EXTRA_HOLE_BYTES)

    def cyclic(self) -> tuple[PlannedFrame, ...]:
        """Implement `DriveFrames.cyclic`: one exchange writes the set-point, one reads."""
        setpoint = self._setpoint()
        head = self._packets.head_bytes + 1 + len(self._packets.number(0))
        written = self._write(setpoint.address, encode(setpoint, 0))
        return (PlannedFrame(written, {setpoint.name: head}, {}), self._planned(self._cyclic))

    def extra(self) -> tuple[PlannedFrame, ...]:
        return tuple(map(self._planned, self._extra))

    def idle(self) -> tuple[LineFrame, ...]:
        return ()

    def zero_steps(self) -> tuple[Step, ...]:
        channel = self.profile.channels[self.joints[0].channel]
        present = tuple(present_positions([channel]))
        return present or (Step(register=self._setpoint().name, value=0),)

    def writes(self, raw: Mapping[str, int]) -> tuple[LineFrame, ...]:
        """Return one frame for each register."""
        return tuple(self._written(name, value, self.unit) for name, value in raw.items())

    def broadcasts(self, raw: Mapping[str, int]) -> tuple[LineFrame, ...]:
        return tuple(self._written(name, value, BROADCAST_UNIT) for name, value in raw.items())

    def read(self, name: str) -> LineFrame:
        return self._planned(_Span([self.profile.registers[name]])).frame

    def raw(self, name: str, reply: bytes) -> int:
        return decode(self.profile.registers[name], reply[self._packets.status_head_bytes :])

    # --------------------------------------------------------------------------------------- times
    def cycle_time_s(self, late_part: float = 0.0) -> float:
        """Implement `DriveFrames.cycle_time_s`: a cycle in which the servo is written and read
        alone."""
        cyclic_s = sum(self._frame_s(planned.frame, late_part) for planned in self.cyclic())
        return cyclic_s + self._extra_s(late_part)

    def heads_s(self) -> float:
        """Return the wire time of the two requests in a cycle of all servos, without their parts
        for each servo."""
        heads = 2 * (self._group_head_bytes() + self._packets.seal_bytes)
        return self._wire_time_s(heads) + self._gap_s

    def share_s(self, late_part: float) -> float:
        """Return the time that this servo adds to such a cycle: its set-point, its reply, and its
        mean share of extra exchanges."""
        asked = size_bytes(self._setpoint()) + 2
        late_s = late_part * self.profile.turnaround_s
        cyclic_s = self._wire_time_s(asked + self._reply_bytes(self._cyclic.count))
        return late_s + cyclic_s + self._extra_s(late_part)

    def slowest_cycle_s(self) -> float:
        """Implement `DriveFrames.slowest_cycle_s`."""
        exchanges = [self._cyclic, *self._extra[:1]]
        return sum(self._exchange_s(each) + self.profile.turnaround_s for each in exchanges)

    def group(self) -> LineGroup | None:
        """Return the sync write and sync read for all servos that are written and read at the same
        addresses as this one; None: its series has no sync read."""
        if has_no_sync_read(self.profile):
            return None
        setpoint, packets = self._setpoint(), self._packets
        return LineGroup(
            data_byte=packets.head_bytes + 1 + len(packets.number(0)),
            write=self._group_head(Instruction.SYNC_WRITE, setpoint.address, size_bytes(setpoint)),
            read=self._group_head(Instruction.SYNC_READ, self._cyclic.address, self._cyclic.count),
        )

    # --------------------------------------------------------------------------------------- parts
    def _group_head(self, code: Instruction, address: int, count: int) -> bytes:
        numbers = self._packets.number(address) + self._packets.number(count)
        return self._packets.build(BROADCAST_UNIT, code, numbers)[: -self._packets.seal_bytes]

    def _group_head_bytes(self) -> int:
        return self._packets.head_bytes + 1 + 2 * len(self._packets.number(0))

    def _setpoint(self) -> Register:
        return self.profile.registers[self.profile.channels[self.joints[0].channel].setpoint]

    def _reply_bytes(self, count: int) -> int:
        return self._packets.status_head_bytes + count + self._packets.seal_bytes

    def _extra_s(self, late_part: float) -> float:
        frames = [planned.frame for planned in self.extra()]
        times_s = [self._frame_s(frame, late_part) for frame in frames]
        return sum(times_s) / max(len(times_s), 1) / EXTRA_EVERY_CYCLES

    def _frame_s(self, frame: LineFrame, late_part: float) -> float:
        late_s = late_part * self.profile.turnaround_s
        wire_s = self._wire_time_s(len(frame.request) + frame.reply_bytes)
        return wire_s + self._gap_s + max(self._gap_s, late_s)

    def _exchange_s(self, span: _Span) -> float:
        sent = self._group_head_bytes() + self._packets.seal_bytes
        return self._wire_time_s(sent + self._reply_bytes(span.count)) + 2 * self._gap_s

    def _planned(self, span: _Span) -> PlannedFrame:
        numbers = self._packets.number(span.address) + self._packets.number(span.count)
        frame = self._frame(Instruction.READ, numbers, span.count)
        begin = self._packets.status_head_bytes - span.address
        return PlannedFrame(frame, {}, {r.name: begin + r.address for r in span.registers})

    def _written(self, name: str, raw: int, unit: int) -> LineFrame:
        register = self.profile.registers[name]
        if register.address >= INSTRUCTION_ADDRESS:
            return self._frame(register.address & 0xFF, b"", 0, unit)
        return self._write(register.address, encode(register, raw), unit)

    def _write(self, address: int, data: bytes, unit: int | None = None) -> LineFrame:
        parameters = self._packets.number(address) + data
        return self._frame(Instruction.WRITE, parameters, 0, unit)

    def _frame(
        self, code: int, parameters: bytes, count: int, unit: int | None = None
    ) -> LineFrame:
        """Return a request with the form of its answer, a status with `count` bytes of data."""
        unit = self.unit if unit is None else unit
        answered = unit != BROADCAST_UNIT
        status = self._packets.build_status(unit, 0, bytes(count))
        return LineFrame(
            request=self._packets.build(unit, code, parameters),
            reply_bytes=self._reply_bytes(count) if answered else 0,
            match=status[: self._packets.match_bytes] if answered else b"",
            request_seal=self._seal,
            reply_seal=self._seal if answered else Seal.NONE,
            has_exceptions=int(answered and self._seal is Seal.STUFFED),
        )


def group_of(drives: Sequence[ServoFrames]) -> LineGroup | None:
    """Return the sync write and read that all servos share; None: they differ or lack it."""
    groups = {each.group() for each in drives}
    return groups.pop() if len(groups) == 1 else None


def cycle_of_all_s(drives: Sequence[DriveFrames], late_part: float = 0.0) -> float:
    """Return the time of a mean cycle of all drives on the wire. Servos with a common sync read
    are read together, all others one after the other. `late_part`: as for
    `DriveFrames.cycle_time_s`."""
    servos = [each for each in drives if isinstance(each, ServoFrames)]
    if not servos or group_of(servos) is None:
        return sum(each.cycle_time_s(late_part) for each in drives)
    return servos[0].heads_s() + sum(each.share_s(late_part) for each in servos)


def _end(register: Register) -> int:
    return register.address + size_bytes(register)


def _around(begin: Sequence[Register], others: Iterable[Register]) -> _Span:
    """Return one span with the registers of `begin`, and with those of the others that are near
    enough."""
    inside = sorted(begin, key=lambda r: r.address)
    for register in sorted(dict.fromkeys(others), key=lambda r: r.address):
        if register in inside:
            continue
        after = register.address - _end(inside[-1]) <= _CYCLIC_HOLE_BYTES
        if register.address > inside[0].address and after:
            inside = sorted([*inside, register], key=lambda r: r.address)
    for register in sorted(dict.fromkeys(others), key=lambda r: -r.address):
        if register not in inside and 0 <= inside[0].address - _end(register) <= _CYCLIC_HOLE_BYTES:
            inside = [register, *inside]
    return _Span(inside)


def _spans(registers: Iterable[Register], hole_bytes: int) -> list[_Span]:
    groups: list[list[Register]] = []
    for register in sorted(registers, key=lambda r: r.address):
        if groups and register.address - _end(groups[-1][-1]) <= hole_bytes:
            groups[-1].append(register)
        else:
            groups.append([register])
    return [_Span(group) for group in groups]
