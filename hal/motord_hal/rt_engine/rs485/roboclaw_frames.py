# SPDX-License-Identifier: Apache-2.0
"""The frames of a RoboClaw (implements frames.DriveFrames): packets of roboclaw.codec."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace

from motord_hal.drives.profile import DriveProfile, Register, RegisterType, Step
from motord_hal.fieldbus.ports import JointSpec
from motord_hal.modbus.codec import Function, Request
from motord_hal.modbus.plan import DrivePlan, ReadRange, WireTime
from motord_hal.realtime.table import LineFrame, Seal
from motord_hal.roboclaw import codec
from motord_hal.rt_engine.rs485.frames import PlannedFrame

_HEAD_BYTES = 2
"""Bytes of address and command, which precede the content of a write."""
_WORD_BYTES = 2


def packet_frame(request: Request) -> LineFrame:
    """Return a packet with the form of its answer. The answer names no unit, so no other byte may
    come with it."""
    reads = request.function is Function.READ_HOLDING
    return LineFrame(
        request=codec.build(request),
        reply_bytes=codec.reply_size(request),
        match=b"" if reads else codec.ACKNOWLEDGED,
        request_seal=Seal.NONE if reads else Seal.XMODEM,
        reply_seal=Seal.WITH_REQUEST if reads else Seal.NONE,
        exact=1,
    )


class RoboclawFrames:
    """Implements DriveFrames for one controller with one or two motors, with the plan of the
    asyncio engine."""

    def __init__(self, joints: Iterable[JointSpec], gap_s: float, wire_time_s: WireTime) -> None:
        self._plan = DrivePlan(
            [replace(joint, profile=_narrowed(joint.profile)) for joint in joints],
            gap_s,
            wire_time_s,
        )
        self.joints = self._plan.joints
        self.profile = self._plan.profile
        self.unit = self._plan.unit
        self.cycle_time_s = self._plan.cycle_time_s
        self.slowest_cycle_s = self._plan.slowest_cycle_s

    def cyclic(self) -> tuple[PlannedFrame, ...]:
        """Implement `DriveFrames.cyclic`."""
        return tuple(
            PlannedFrame(
                packet_frame(exchange.request),
                self._written(exchange.request),
                {} if exchange.reads is None else _places(exchange.reads),
            )
            for exchange in self._plan.cyclic(self._plan.setpoints({}))
        )

    def extra(self) -> tuple[PlannedFrame, ...]:
        """Implement `DriveFrames.extra`."""
        return tuple(
            PlannedFrame(packet_frame(span.request(self.unit)), {}, _places(span))
            for span in self._plan.extra
        )

    def idle(self) -> tuple[LineFrame, ...]:
        """Return a frame with duties of zero, which release the wheels; speeds of zero would hold
        them."""
        first = self._plan.cyclic(self._plan.setpoints({}))[0].request
        if first.address >> 8 != codec.SPEEDS:
            return ()
        return (packet_frame(replace(first, address=codec.DUTIES << 8, values=(0, 0))),)

    def zero_steps(self) -> tuple[Step, ...]:
        return self._plan.zero_steps()

    def writes(self, raw: Mapping[str, int]) -> tuple[LineFrame, ...]:
        return tuple(map(packet_frame, self._plan.writes(raw)))

    def broadcasts(self, raw: Mapping[str, int]) -> tuple[LineFrame, ...]:
        """Return no frames: every packet is for one address."""
        del raw
        return ()

    def read(self, name: str) -> LineFrame:
        return packet_frame(self._reading(self.profile.registers[name]))

    def raw(self, name: str, reply: bytes) -> int:
        register = self.profile.registers[name]
        return register.decode(codec.parse(self._reading(register), reply))

    def _reading(self, register: Register) -> Request:
        return ReadRange(register.address, register.type.words, (register,)).request(self.unit)

    def _written(self, request: Request) -> dict[str, int]:
        """Return set-point register → first byte in the packet; empty if it writes none."""
        if not request.values:
            return {}
        names = (self._plan.channel(joint).setpoint for joint in self.joints)
        registers = [self.profile.registers[name] for name in names]
        command = request.address >> 8
        return {
            register.name: _HEAD_BYTES + _byte_of(register)
            for register in registers
            if register.address >> 8 == command
        }


def _byte_of(register: Register) -> int:
    """Return the first byte of the register in the content of its command."""
    return _WORD_BYTES * (register.address & 0xFF)


def _places(span: ReadRange) -> dict[str, int]:
    return {register.name: _byte_of(register) for register in span.registers}


def _narrowed(profile: DriveProfile) -> DriveProfile:
    """Return the profile with the type U8 for registers whose command carries one byte; profile and
    codec have them as words."""
    sizes = codec.READ_BYTES | codec.WRITE_BYTES
    registers = {
        name: replace(one, type=RegisterType.U8) if sizes.get(one.address >> 8) == 1 else one
        for name, one in profile.registers.items()
    }
    return replace(profile, registers=registers)
