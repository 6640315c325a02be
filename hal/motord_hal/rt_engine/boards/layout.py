# SPDX-License-Identifier: Apache-2.0
"""Places of a board's registers in what it receives and sends, by the kind of its line. Pure."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

from motord_hal.ascii.dialect import (
    COUNT,
    CURRENT,
    GYRO_Z,
    RIM_DISTANCE,
    RIM_SPEED,
    VELOCITY,
    VOLTAGE,
    text_bytes,
    texts_of,
)
from motord_hal.base.errors import ProfileError
from motord_hal.drives.profile import Register
from motord_hal.fieldbus.ports import JointSpec, LineSpec
from motord_hal.hoverboard import codec as hoverboard
from motord_hal.mcu.frames import FEEDBACK_HEAD_BYTES, setpoints_payload, size_bytes
from motord_hal.mcu.frames import wire_bytes as frame_bytes
from motord_hal.modbus.plan import DrivePlan
from motord_hal.rt_engine.boards import text as board_text
from motord_hal.sabertooth import codec as sabertooth

Plain = dict[str, Any]

_FRAMES, _TEXT, _HOVERBOARD, _SABERTOOTH = range(4)
_PROTOCOLS = MappingProxyType(
    {
        "mcu": ("mcu-frame",),
        "ascii": ("ascii",),
        "hoverboard": hoverboard.PROTOCOLS,
        "sabertooth": ("sabertooth",),
    }
)
"""Kind of line → protocols of the profiles that it can use."""


@dataclass(frozen=True, slots=True)
class Layout:
    """Places of the registers in the payload that the board receives (`sent`), and in its feedback
    (`reported`), by their names."""

    sent: Mapping[str, Plain]
    reported: Mapping[str, Plain]
    dialect: Plain
    """Entries of the table that depend on the protocol."""
    rate_z: Plain | None = None
    """Place of an inertial sensor's rate about z in a text; None: the text has no sensor."""
    units: tuple[int, ...] = ()
    """Addresses of several drivers on one wire, each with its own part of the payload; empty: there
    is one board."""

    def place(self, register: str, unit: int) -> Plain:
        """Return the register's place in the payload for the board with this address."""
        first = self.sent[register]
        part = self.units.index(unit) if self.units else 0
        return {**first, "byte": first["byte"] + part * sabertooth.ADDRESSES}

    def places(self, register: str) -> list[Plain]:
        """Return the register's places for all boards on the line."""
        return [self.place(register, unit) for unit in self.units or (0,)]

    def raw(self, register: str, payload: bytes) -> int | None:
        """Return the register's raw value in a board's feedback; None: it is not in there."""
        place = self.reported.get(register)
        if place is None or len(payload) < place["byte"] + place["bytes"]:
            return None
        data = payload[place["byte"] :][: place["bytes"]]
        return int.from_bytes(data, "little", signed=bool(place["is_signed"]))


def layout_of(spec: LineSpec, plan: DrivePlan, period_s: float) -> Layout:
    """Return the layout for the kind of line. Raise ProfileError if the profile does not fit."""
    if plan.profile.protocol not in _PROTOCOLS[spec.kind]:
        raise ProfileError(f"{spec.name}: {plan.profile.name} speaks {plan.profile.protocol}")
    if spec.kind == "mcu":
        return _frames(plan, period_s)
    if spec.kind == "ascii":
        return _text(spec, plan)
    return _hoverboard(plan) if spec.kind == "hoverboard" else _sabertooth(spec, plan)


def _frames(plan: DrivePlan, period_s: float) -> Layout:
    registers = plan.profile.registers.values()
    payload = setpoints_payload(registers, {}, max(plan.profile.channels), period_s)
    sent = {one.name: _place(one, one.address) for one in registers if "w" in one.access}
    reported = {one.name: _place(one, one.address) for one in registers if "r" in one.access}
    ends = [place["byte"] + place["bytes"] for place in reported.values()]
    dialect = {
        "dialect": _FRAMES,
        "answers": 1,
        "payload_bytes": len(payload),
        "feedback_bytes": max(FEEDBACK_HEAD_BYTES, *ends),
        "payload": list(payload),
    }
    return Layout(sent, reported, dialect)


def _text(spec: LineSpec, plan: DrivePlan) -> Layout:
    """Return the layout of a text. A text has no places of its own: its numbers are stored one
    after the other in a payload."""
    sent, end = {}, 0
    for register in plan.profile.registers.values():
        if "w" in register.access:
            sent[register.name] = _place(register, end)
            end += size_bytes(register)
    dialect: Plain = {
        "dialect": _TEXT,
        "payload_bytes": end,
        "written": board_text.written(spec, [setpoint_of(plan, j) for j in plan.joints]),
    }
    _, _, received = texts_of(spec)
    if received is None:
        return Layout(sent, {}, dialect)
    registers = _fields_of(plan)
    reported = {
        registers[field].name: board_text.place_of(number)
        for number, field in enumerate(received.fields)
        if field in registers
    }
    dialect |= {
        "answers": 1,
        "feedback_bytes": board_text.NUMBER_BYTES * len(received.fields),
        "read": board_text.read(received, registers, board_text.feedback_factors(spec)),
    }
    gyro = received.fields.index(GYRO_Z) if GYRO_Z in received.fields else None
    return Layout(sent, reported, dialect, None if gyro is None else board_text.place_of(gyro))


def _hoverboard(plan: DrivePlan) -> Layout:
    registers = plan.profile.registers.values()
    dialect = {
        "dialect": _HOVERBOARD,
        "answers": 1,
        "payload_bytes": hoverboard.SETPOINT_BYTES,
        "feedback_bytes": hoverboard.VALUE_BYTES,
        "mixed": int(hoverboard.is_mixed(plan.profile)),
    }
    sent = {one.name: _place(one, one.address) for one in registers if "w" in one.access}
    reported = {one.name: _place(one, one.address) for one in registers if "r" in one.access}
    return Layout(sent, reported, dialect)


def _sabertooth(spec: LineSpec, plan: DrivePlan) -> Layout:
    units = _units(spec)
    for unit in units:
        if unit not in sabertooth.UNITS:
            raise ProfileError(f"unit {unit} is no address of a Sabertooth (128 to 135)")
    sent = {one.name: _place(one, one.address) for one in plan.profile.registers.values()}
    dialect = {
        "dialect": _SABERTOOTH,
        "payload_bytes": sabertooth.ADDRESSES * len(units),
        "unit_count": len(units),
        "unit": list(units),
    }
    return Layout(sent, {}, dialect, units=units)


def _units(spec: LineSpec) -> tuple[int, ...]:
    return tuple(sorted({joint.unit for joint in spec.joints}))


def _fields_of(plan: DrivePlan) -> dict[str, Register]:
    """Return field of the feedback template → register."""
    names = {VOLTAGE: plan.profile.bus_voltage}
    for joint in plan.joints:
        channel = plan.channel(joint)
        names[joint.name + COUNT] = channel.position
        names[joint.name + VELOCITY] = channel.velocity
        names[joint.name + CURRENT] = channel.current
        names[joint.name + RIM_SPEED] = channel.velocity
        names[joint.name + RIM_DISTANCE] = channel.position
    return {field: plan.profile.registers[name] for field, name in names.items() if name}


def _place(register: Register, byte: int) -> Plain:
    signed = int(register.type.signed)
    return {"byte": byte, "bytes": size_bytes(register), "is_signed": signed}


def setpoint_of(plan: DrivePlan, joint: JointSpec) -> tuple[JointSpec, Register]:
    return joint, plan.profile.registers[plan.channel(joint).setpoint]


def wire_bytes(spec: LineSpec, channels: Iterable[int]) -> int:
    """Return the bytes of a cycle in the direction that has more of them. Raise ProfileError if the
    templates of a text are bad."""
    if spec.kind == "mcu":
        return frame_bytes(max(channels), imu=spec.imu is not None)
    if spec.kind == "ascii":
        return text_bytes(spec)
    if spec.kind == "hoverboard":
        return hoverboard.FEEDBACK_BYTES
    return sabertooth.CYCLE_BYTES * len(_units(spec))
