# SPDX-License-Identifier: Apache-2.0
"""Converts templates of text to the pieces that a board's thread in C writes and reads. Pure."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import Any

from motord_hal.ascii.dialect import (
    CURRENT,
    GYRO_Z,
    RIM_DISTANCE,
    RIM_SPEED,
    VELOCITY,
    VOLTAGE,
    counts_per_m,
    motor_rad_per_m,
    rim_fields,
    texts_of,
    why_not_possible,
)
from motord_hal.ascii.text import Text
from motord_hal.ascii.twist import ANGULAR, LINEAR, twist_of
from motord_hal.base.errors import ProfileError
from motord_hal.drives.profile import Register
from motord_hal.fieldbus.ports import JointSpec, LineSpec
from motord_hal.mcu.frames import RATE_UNIT_RAD_S
from motord_hal.rt_engine.rs485.table import si_per_raw

Plain = dict[str, Any]

NUMBER_BYTES = 6
"""Width of the place of a number that is read. It holds more than any signed counter of 32 bits."""
_FORMS = MappingProxyType({"d": 1, "f": 2, "g": 3})
_NO_NUMBER, _CONSTANT = 0, 4
_PRECISION = 6
"""Decimals if a format gives none: the default of printf and of Python."""
_FORMAT = re.compile(
    r"(?P<sign>[+ ]?)(?P<zeros>0?)(?P<width>\d*)(\.(?P<precision>\d+))?(?P<form>[dfg])"
)


def written(spec: LineSpec, setpoints: Sequence[tuple[JointSpec, Register]]) -> Plain:
    """Return the struct board_text of the set-points, whose raw values are in this order. Raise
    ProfileError if the templates are not possible."""
    _, sent, received = texts_of(spec)
    if why := why_not_possible(sent, received):
        raise ProfileError(f"{spec.name}: {why}")
    factors = _factors(spec, setpoints)

    def number(name: str, form: str) -> Plain:
        found = _FORMAT.fullmatch(form)
        assert found is not None  # why_not_possible has checked it
        precision = found["precision"]
        return {
            "form": _FORMS[found["form"]],
            "sign": ord(found["sign"] or "\0"),
            "zeros": int(bool(found["zeros"])),
            "width": int(found["width"] or 0),
            "precision": _PRECISION if precision is None else int(precision),
            "number_per_raw": factors[name],
        }

    assert spec.text is not None  # texts_of has checked it
    return _pieces(sent, number, spec.text.prefix)


def _factors(
    spec: LineSpec, setpoints: Sequence[tuple[JointSpec, Register]]
) -> dict[str, list[float]]:
    """Return field → the factors from the raw set-points to the number of the field, which is the
    sum of raw × factor."""
    text, sent, _ = texts_of(spec)
    steps = {joint.name: si_per_raw(register) for joint, register in setpoints}
    if set(sent.fields) == set(rim_fields(tuple(steps))):
        return {
            joint.name + RIM_SPEED: [
                steps[name] / motor_rad_per_m(text, joint) * (name == joint.name) for name in steps
            ]
            for joint, _ in setpoints
        }
    if set(sent.fields) != {LINEAR, ANGULAR}:
        return {
            name: [step * text.scale * (name == one) for one, step in steps.items()]
            for name in sent.fields
        }
    at_wheel = {joint.name: steps[joint.name] * joint.velocity_factor for joint, _ in setpoints}
    alone = [twist_of(text, dict.fromkeys(steps, 0.0) | {n: at_wheel[n]}) for n in steps]
    return {name: [twist[name] for twist in alone] for name in sent.fields}


def place_of(number: int) -> Plain:
    """Return the place in the payload of field number `number` of the feedback."""
    return {"byte": NUMBER_BYTES * number, "bytes": NUMBER_BYTES, "is_signed": 1}


def read(
    received: Text,
    registers: Mapping[str, Register],
    factors: Mapping[str, float] = MappingProxyType({}),
) -> Plain:
    """Return the struct board_text of the feedback. `registers`: field → register, for the fields
    that belong to a register; `factors`: result of `feedback_factors`."""

    def number(name: str, form: str) -> Plain:
        del form
        scaled = name == VOLTAGE or name.endswith((VELOCITY, CURRENT, RIM_SPEED))
        factor = 1.0 / si_per_raw(registers[name]) if scaled and name in registers else 1.0
        factor = 1.0 / RATE_UNIT_RAD_S if name == GYRO_Z else factor
        factor *= factors.get(name, 1.0)
        place = place_of(received.fields.index(name))
        return {"form": _FORMS["f"], "place": place, "raw_per_number": factor}

    return _members(received, number) if received.members else _pieces(received, number)


def feedback_factors(spec: LineSpec) -> dict[str, float]:
    """Return field → value in the field's unit that the number 1 in the text means; for speeds and
    distances of the wheel's rim, in rad/s and counts of the motor."""
    text, _, received = texts_of(spec)
    rims = {joint.name + RIM_SPEED: motor_rad_per_m(text, joint) for joint in spec.joints}
    rims |= {joint.name + RIM_DISTANCE: counts_per_m(text, joint) for joint in spec.joints}
    fields = received.fields if received else ()
    return {name: rims.get(name, 1.0) / text.feedback_scale.get(name, 1.0) for name in fields}


def _members(text: Text, number: Callable[[str, str], Plain]) -> Plain:
    parts = [
        {"literal_bytes": len(name)}
        | (
            number(member, "")
            if isinstance(member, str)
            else {"form": _CONSTANT, "raw_per_number": member}
        )
        for name, member in text.members.items()
    ]
    literal = "".join(text.members).encode("ascii")
    return {"part_count": len(parts), "part": parts, "literal": list(literal), "json": 1}


def _pieces(text: Text, number: Callable[[str, str], Plain], prefix: str = "") -> Plain:
    pieces = [(prefix + text.parts[0][0], *text.parts[0][1:]), *text.parts[1:]]
    parts = [
        {"literal_bytes": len(literal), "form": _NO_NUMBER}
        | ({} if name is None else number(name, form))
        for literal, name, form in pieces
    ]
    literal = "".join(literal for literal, _, _ in pieces).encode("ascii")
    return {"part_count": len(parts), "part": parts, "literal": list(literal)}
