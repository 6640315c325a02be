# SPDX-License-Identifier: Apache-2.0
"""Makes the table for the thread of a board in C from the board and its joints. The table consists
of plain values with the names of csrc/api/line/api_board.h. Pure.

Signs, gears and units are those of `motord_hal.modbus.plan`; here they become one factor for each
number.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

from motord_hal.drives.profile import DriveProfile, Register, Step
from motord_hal.fieldbus.job import configure_steps, watchdog_time_s
from motord_hal.fieldbus.ports import JointSpec, LineSpec
from motord_hal.modbus.plan import DrivePlan
from motord_hal.realtime.table import FieldKind
from motord_hal.rt_engine.boards.layout import Layout, Plain, setpoint_of
from motord_hal.rt_engine.decoding import harmless_words, setpoint_scale, sources_of, wheel_factor
from motord_hal.rt_engine.rs485.table import raw_limits, si_per_raw

UNRESPONSIVE_ALLOWANCE_S = 0.12
"""Time that a late adapter may add to the cycles without feedback that are allowed."""
_NS_PER_S = 1e9
_U32 = 0xFFFF_FFFF


# ---------------------------------------------------------------------------------------- the table
def board_table(
    spec: LineSpec, plan: DrivePlan, layout: Layout, period_s: float, gap_s: float
) -> Plain:
    """Return the table of a board. `gap_s` is the time of a frame on the wire. C checks the table
    once more and names the first bad field."""
    profile = plan.profile
    tries = max(joint.tries for joint in plan.joints)
    parts: dict[str, Sequence[Plain]] = {
        "setpoint": [_setpoint(plan, joint, layout) for joint in plan.joints],
        "field": [*_joint_fields(plan, layout), *_board_fields(spec, profile, layout)],
        "quick_stop": writes(layout, profile.quick_stop),
        "disarm": writes(layout, profile.disarm),
    }
    own_s = profile.watchdog_fixed_s
    watchdog_s = watchdog_time_s(profile, spec.watchdog_s) if profile.watchdog else own_s
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


def writes(layout: Layout, steps: Iterable[Step]) -> list[Plain]:
    """Return the writes of a sequence, in order and each to all boards, without its waits."""
    return [
        {"place": place, "raw": step.value}
        for step in steps
        if step.value is not None
        for place in layout.places(step.register)
    ]


def _setpoint(plan: DrivePlan, joint: JointSpec, layout: Layout) -> Plain:
    channel = plan.channel(joint)
    _, register = setpoint_of(plan, joint)
    return {
        "place": layout.place(register.name, joint.unit),
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
    return {"si_per_raw": si_per_raw(register) * wheel_factor(joint, kind)}


def _board_fields(spec: LineSpec, profile: DriveProfile, layout: Layout) -> Iterator[Plain]:
    """Yield the fields of the board as a whole: whether it is enabled, and the waits of its set-up.
    The waits have to stay true; one that is not shows that the board was restarted."""
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
