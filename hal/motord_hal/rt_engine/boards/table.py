# SPDX-License-Identifier: Apache-2.0
"""From a board and its joints to the table that its thread in C runs: pure; plain values, named as
in csrc/api_board.h.

Signs, gears and units are those of `motord_hal.modbus.plan`; here they become one factor a number.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from motord_hal.ascii.dialect import COUNT, CURRENT, GYRO_Z, VELOCITY, VOLTAGE, texts_of
from motord_hal.base.errors import ProfileError
from motord_hal.drives.profile import DriveProfile, Register, Step
from motord_hal.fieldbus.job import configure_steps, watchdog_time_s
from motord_hal.fieldbus.ports import JointSpec, LineSpec
from motord_hal.mcu.frames import FEEDBACK_HEAD_BYTES, setpoints_payload, size_bytes
from motord_hal.modbus.plan import DrivePlan
from motord_hal.realtime.table import FieldKind
from motord_hal.rt_engine.boards import text as board_text
from motord_hal.rt_engine.decoding import harmless_words, setpoint_scale, sources_of
from motord_hal.rt_engine.rs485.table import raw_limits, si_per_raw

Plain = dict[str, Any]

UNRESPONSIVE_ALLOWANCE_S = 0.12
"""On top of the feedback that may be lost: an adapter may be late."""
_FRAMES, _TEXT = 0, 1
_NS_PER_S = 1e9
_U32 = 0xFFFF_FFFF


@dataclass(frozen=True, slots=True)
class Layout:
    """Where registers stand in what goes to the board, and in what it sends."""

    sent: Mapping[str, Plain]
    reported: Mapping[str, Plain]
    dialect: Plain
    """What the table needs of the protocol itself."""
    rate_z: Plain | None = None
    """Of an inertial sensor in a text; None: there is none."""

    def raw(self, register: str, payload: bytes) -> int | None:
        """Its value in a word of the board; None: it is not in it."""
        place = self.reported.get(register)
        if place is None or len(payload) < place["byte"] + place["bytes"]:
            return None
        data = payload[place["byte"] :][: place["bytes"]]
        return int.from_bytes(data, "little", signed=bool(place["is_signed"]))


def layout_of(spec: LineSpec, plan: DrivePlan, period_s: float) -> Layout:
    """By the kind of the line. Raises ProfileError."""
    protocol = {"mcu": "mcu-frame", "ascii": "ascii"}[spec.kind]
    if plan.profile.protocol != protocol:
        raise ProfileError(f"{spec.name}: {plan.profile.name} speaks {plan.profile.protocol}")
    return _frames(plan, period_s) if spec.kind == "mcu" else _text(spec, plan)


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
    """Numbers stand in no order of the board's: one after the other."""
    sent, end = {}, 0
    for register in plan.profile.registers.values():
        if "w" in register.access:
            sent[register.name] = _place(register, end)
            end += size_bytes(register)
    dialect: Plain = {
        "dialect": _TEXT,
        "payload_bytes": end,
        "written": board_text.written(spec, [_setpoint_of(plan, j) for j in plan.joints]),
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
        "read": board_text.read(received, registers),
    }
    gyro = received.fields.index(GYRO_Z) if GYRO_Z in received.fields else None
    return Layout(sent, reported, dialect, None if gyro is None else board_text.place_of(gyro))


def _fields_of(plan: DrivePlan) -> dict[str, Register]:
    """Field of a template of feedback → register."""
    names = {VOLTAGE: plan.profile.bus_voltage}
    for joint in plan.joints:
        channel = plan.channel(joint)
        names[joint.name + COUNT] = channel.position
        names[joint.name + VELOCITY] = channel.velocity
        names[joint.name + CURRENT] = channel.current
    return {field: plan.profile.registers[name] for field, name in names.items() if name}


def _place(register: Register, byte: int) -> Plain:
    signed = int(register.type.signed)
    return {"byte": byte, "bytes": size_bytes(register), "is_signed": signed}


# ---------------------------------------------------------------------------------------- the table
def board_table(
    spec: LineSpec, plan: DrivePlan, layout: Layout, period_s: float, gap_s: float
) -> Plain:
    """`gap_s`: so long a frame is on the wire. C checks the table once more and names the first bad
    field."""
    profile = plan.profile
    tries = max(joint.tries for joint in plan.joints)
    parts: dict[str, Sequence[Plain]] = {
        "setpoint": [_setpoint(plan, joint, layout) for joint in plan.joints],
        "field": [*_joint_fields(plan, layout), *_board_fields(spec, profile, layout)],
        "quick_stop": writes(layout, profile.quick_stop),
        "disarm": writes(layout, profile.disarm),
    }
    watchdog_s = watchdog_time_s(profile, spec.watchdog_s) if profile.watchdog else 0.0
    return {
        "tries": tries,
        "period_ns": round(period_s * _NS_PER_S),
        "gap_ns": round(gap_s * _NS_PER_S),
        "silence_ns": round((tries * period_s + UNRESPONSIVE_ALLOWANCE_S) * _NS_PER_S),
        "setpoint_timeout_ns": round(spec.setpoint_timeout_s * _NS_PER_S),
        "rest_velocity_rad_s": spec.rest_velocity_rad_s,
        "watchdog_ns": round(watchdog_s * _NS_PER_S),
        **layout.dialect,
        "imu": _imu(spec, layout),
        **parts,
        **{f"{name}_count": len(part) for name, part in parts.items()},
    }


def _imu(spec: LineSpec, layout: Layout) -> Plain:
    if spec.imu is None:
        return {}
    sensor = spec.imu.to_base((1.0, 2.0, 3.0))
    return {
        "used": int(spec.kind == "mcu" or layout.rate_z is not None),
        "axis": [round(abs(along)) - 1 for along in sensor],
        "backward": [int(along < 0.0) for along in sensor],
        "rate_z": layout.rate_z or {},
    }


def write(layout: Layout, register: str, raw: int) -> Plain:
    return {"place": layout.sent[register], "raw": raw}


def writes(layout: Layout, steps: Iterable[Step]) -> list[Plain]:
    """The writes of a sequence, in order; what it waits for is left out."""
    return [write(layout, step.register, step.value) for step in steps if step.value is not None]


def _setpoint_of(plan: DrivePlan, joint: JointSpec) -> tuple[JointSpec, Register]:
    return joint, plan.profile.registers[plan.channel(joint).setpoint]


def _setpoint(plan: DrivePlan, joint: JointSpec, layout: Layout) -> Plain:
    channel = plan.channel(joint)
    _, register = _setpoint_of(plan, joint)
    return {
        "place": layout.sent[register.name],
        "scale": setpoint_scale(joint, channel, si_per_raw(register), raw_limits(register)),
    }


def _joint_fields(plan: DrivePlan, layout: Layout) -> Iterator[Plain]:
    for joint in plan.joints:
        channel = plan.channel(joint)
        for kind, name in sources_of(plan.profile, channel):
            if name in layout.reported:
                yield {
                    "place": layout.reported[name],
                    "meaning": {
                        "joint": joint.index,
                        "kind": int(kind),
                        **_meaning(plan, joint, kind, plan.profile.registers[name]),
                    },
                }


def _meaning(plan: DrivePlan, joint: JointSpec, kind: FieldKind, register: Register) -> Plain:
    if kind is FieldKind.COUNT:
        return {"counter_bits": plan.profile.counter_bits}
    if kind is FieldKind.FAULT:
        return harmless_words(plan.profile)
    own = (-1.0 if joint.inverted else 1.0) / joint.gear_ratio
    return {"si_per_raw": si_per_raw(register) * (own if kind is FieldKind.VELOCITY else 1.0)}


def _board_fields(spec: LineSpec, profile: DriveProfile, layout: Layout) -> Iterator[Plain]:
    """What its set-up waited for must stay so: a board that was restarted says it there."""
    waited = [step for step in configure_steps(profile, spec.watchdog_s) if step.value is None]
    wanted = [(FieldKind.KEPT, step.register, step.mask, step.equals or 0) for step in waited]
    if profile.enabled is not None:
        enabled = profile.enabled
        wanted.append((FieldKind.ENABLED, enabled.register, enabled.mask, enabled.equals))
    for kind, name, mask, equals in wanted:
        if name in layout.reported:
            yield {
                "place": layout.reported[name],
                "meaning": {
                    "kind": int(kind),
                    "equals_mask": mask & _U32,
                    "equals": equals & _U32,
                },
            }
