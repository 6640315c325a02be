# SPDX-License-Identifier: Apache-2.0
"""The frames of a Modbus drive (implements frames.DriveFrames)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from motord_hal.drives.profile import Step
from motord_hal.modbus.codec import (
    BROADCAST_UNIT,
    Function,
    Request,
    build_request,
    reply_bytes,
)
from motord_hal.modbus.plan import DrivePlan, ReadRange
from motord_hal.realtime.table import LineFrame, Seal
from motord_hal.rt_engine.rs485.frames import PlannedFrame

_WRITE_ECHO_BYTES = 6
_READ_HEAD_BYTES = 3
# Bytes before the first word (MODBUS Application Protocol V1.1b3, 6.6, 6.12, 6.17).
_VALUES_BEGIN = {Function.WRITE_SINGLE: 4, Function.WRITE_MULTIPLE: 7, Function.READ_WRITE: 11}


def modbus_frame(request: Request) -> LineFrame:
    """Return a request with the form of its answer: the echo of a write (V1.1b3, 6.6, 6.12), or the
    head of a read's data (6.3, 6.17)."""
    reads = request.function not in (Function.WRITE_SINGLE, Function.WRITE_MULTIPLE)
    alone = request.unit == BROADCAST_UNIT
    head = bytes((request.unit, request.function, 2 * request.count)) if reads else b""
    return LineFrame(
        request=build_request(request),
        reply_bytes=reply_bytes(request),
        echo_bytes=0 if reads or alone else _WRITE_ECHO_BYTES,
        match=b"" if alone else head,
        request_seal=Seal.CRC16,
        reply_seal=Seal.CRC16,
        has_exceptions=int(not alone),
    )


class ModbusFrames:
    """Implements DriveFrames for a Modbus drive, with the same plan as in the asyncio engine."""

    def __init__(self, plan: DrivePlan) -> None:
        self.plan = plan
        self.joints = plan.joints
        self.profile = plan.profile
        self.unit = plan.unit
        self.cycle_time_s = plan.cycle_time_s
        self.slowest_cycle_s = plan.slowest_cycle_s

    def cyclic(self) -> tuple[PlannedFrame, ...]:
        """Implement `DriveFrames.cyclic`."""
        return tuple(
            PlannedFrame(
                modbus_frame(exchange.request),
                self._written(exchange.request),
                {} if exchange.reads is None else _places(exchange.reads),
            )
            for exchange in self.plan.cyclic(self.plan.setpoints({}))
        )

    def extra(self) -> tuple[PlannedFrame, ...]:
        """Implement `DriveFrames.extra`."""
        return tuple(
            PlannedFrame(modbus_frame(span.request(self.unit)), {}, _places(span))
            for span in self.plan.extra
        )

    def idle(self) -> tuple[LineFrame, ...]:
        return ()

    def zero_steps(self) -> tuple[Step, ...]:
        return self.plan.zero_steps()

    def writes(self, raw: Mapping[str, int]) -> tuple[LineFrame, ...]:
        return tuple(map(modbus_frame, self.plan.writes(raw)))

    def broadcasts(self, raw: Mapping[str, int]) -> tuple[LineFrame, ...]:
        requests = (replace(request, unit=BROADCAST_UNIT) for request in self.plan.writes(raw))
        return tuple(map(modbus_frame, requests))

    def read(self, name: str) -> LineFrame:
        register = self.profile.registers[name]
        span = ReadRange(register.address, register.type.words, (register,))
        return modbus_frame(span.request(self.unit))

    def raw(self, name: str, reply: bytes) -> int:
        data = reply[_READ_HEAD_BYTES:-2]
        words = (int.from_bytes(data[i : i + 2], "big") for i in range(0, len(data), 2))
        return self.profile.registers[name].decode(tuple(words))

    def _written(self, request: Request) -> dict[str, int]:
        """Return set-point register → first byte in the request; empty if it writes none."""
        if not request.values:
            return {}
        both = request.function is Function.READ_WRITE
        first = request.write_address if both else request.address
        offsets = {
            name: self.profile.registers[name].address - first
            for name in (self.plan.channel(joint).setpoint for joint in self.joints)
        }
        return {
            name: _VALUES_BEGIN[request.function] + 2 * offset
            for name, offset in offsets.items()
            if 0 <= offset < len(request.values)
        }


def _places(span: ReadRange) -> dict[str, int]:
    return {
        register.name: _READ_HEAD_BYTES + 2 * (register.address - span.address)
        for register in span.registers
    }
