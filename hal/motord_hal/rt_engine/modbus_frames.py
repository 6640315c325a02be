# SPDX-License-Identifier: Apache-2.0
"""One Modbus drive as frames for its line (frames.DriveFrames)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from motord_hal.modbus.codec import (
    BROADCAST_UNIT,
    READ_REGISTERS_MAX,
    READ_WRITE_WRITE_REGISTERS_MAX,
    Function,
    Request,
    build_request,
    reply_bytes,
)
from motord_hal.modbus.plan import DrivePlan, ReadRange
from motord_hal.rt_engine.frames import PlannedFrame
from motord_hal.rt_table import LineFrame, Seal

_WRITE_ECHO_BYTES = 6
_READ_HEAD_BYTES = 3
# Bytes before the first word (MODBUS Application Protocol V1.1b3, 6.6, 6.12, 6.17).
_VALUES_BEGIN = {Function.WRITE_SINGLE: 4, Function.WRITE_MULTIPLE: 7, Function.READ_WRITE: 11}


def modbus_frame(request: Request) -> LineFrame:
    """A request with what its answer must look like: the echo of a write (V1.1b3, 6.6, 6.12), the
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
    """DriveFrames of a Modbus drive, from the plan that the asyncio engine works by, too."""

    def __init__(self, plan: DrivePlan) -> None:
        self.plan = plan
        self.joints = plan.joints
        self.profile = plan.profile
        self.unit = plan.unit
        self.cycle_time_s = plan.cycle_time_s
        self.slowest_cycle_s = plan.slowest_cycle_s

    def cyclic(self) -> tuple[PlannedFrame, ...]:
        """As DriveFrames.cyclic; one exchange writes and reads where the drive can (23)."""
        writes = self.plan.writes(self.plan.setpoints({}))
        ranges = list(self.plan.fast)
        if len(writes) == 1 and ranges and self._fits_read_write(writes[0], ranges[0]):
            return (self._read_write(writes[0], ranges[0]), *map(self._ranged, ranges[1:]))
        return (*map(self._written, writes), *map(self._ranged, ranges))

    def extra(self) -> tuple[PlannedFrame, ...]:
        return tuple(map(self._ranged, self.plan.extra))

    def setpoint_names(self) -> tuple[str, ...]:
        return tuple(self.plan.setpoints({}))

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

    # -------------------------------------------------------------------------------- in detail
    def _fits_read_write(self, write: Request, span: ReadRange) -> bool:
        return (
            self.profile.read_write_function == Function.READ_WRITE
            and span.count <= min(READ_REGISTERS_MAX, self.profile.max_registers)
            and len(write.values) <= min(READ_WRITE_WRITE_REGISTERS_MAX, self.profile.max_registers)
        )

    def _read_write(self, write: Request, span: ReadRange) -> PlannedFrame:
        request = Request(
            self.unit,
            Function.READ_WRITE,
            span.address,
            count=span.count,
            write_address=write.address,
            values=write.values,
        )
        return PlannedFrame(modbus_frame(request), self._places(write, request), _places(span))

    def _written(self, request: Request) -> PlannedFrame:
        return PlannedFrame(modbus_frame(request), self._places(request, request), {})

    def _ranged(self, span: ReadRange) -> PlannedFrame:
        return PlannedFrame(modbus_frame(span.request(self.unit)), {}, _places(span))

    def _places(self, write: Request, request: Request) -> dict[str, int]:
        """Where in `request` the registers stand that `write` writes."""
        begin = _VALUES_BEGIN[request.function]
        return {
            name: begin + 2 * (self.profile.registers[name].address - write.address)
            for name in self.setpoint_names()
            if 0 <= self.profile.registers[name].address - write.address < len(write.values)
        }


def _places(span: ReadRange) -> dict[str, int]:
    return {
        register.name: _READ_HEAD_BYTES + 2 * (register.address - span.address)
        for register in span.registers
    }
