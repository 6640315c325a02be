# SPDX-License-Identifier: Apache-2.0
"""Templates of the lines of text on a stream line. docs/mcu/line-ascii.md describes them."""

from __future__ import annotations

import math
from collections.abc import Iterable

from motord_hal.ascii.text import Text
from motord_hal.ascii.twist import ANGULAR, LINEAR
from motord_hal.base.errors import ProfileError
from motord_hal.fieldbus.ports import JointSpec, LineSpec, TextSpec

COUNT, VELOCITY, CURRENT, VOLTAGE = "_count", "_rad_s", "_current_a", "voltage_v"
RIM_SPEED, RIM_DISTANCE = "_m_s", "_m"
"""Speed and distance of a wheel's rim: positive where the robot drives forward."""
GYRO_Z = "gyro_z_rad_s"


def setpoint_fields(joints: tuple[str, ...]) -> tuple[str, ...]:
    """Return the fields that a set-point template may name: joints, rim speeds, or the twist."""
    return (*joints, *rim_fields(joints), LINEAR, ANGULAR)


def rim_fields(joints: tuple[str, ...]) -> tuple[str, ...]:
    return tuple(name + RIM_SPEED for name in joints)


def feedback_fields(joints: tuple[str, ...]) -> tuple[str, ...]:
    """Return the fields that a feedback template may name."""
    return (
        *(
            name + what
            for name in joints
            for what in (COUNT, VELOCITY, CURRENT, RIM_SPEED, RIM_DISTANCE)
        ),
        VOLTAGE,
        GYRO_Z,
    )


def check_setpoints(text: Text, joints: tuple[str, ...]) -> None:
    """Check a set-point template. Raises ValueError unless its fields are all joints, all rim
    speeds, or the twist."""
    sent = set(text.fields)
    if sent not in (set(joints), set(rim_fields(joints)), {LINEAR, ANGULAR}):
        each = f"{', '.join(joints)}, or {', '.join(rim_fields(joints))}"
        raise ValueError(f"it must contain {each}, or v and w, and nothing else")


def check_feedback(text: Text, joints: tuple[str, ...], scaled: Iterable[str] = ()) -> None:
    """Check a feedback template. `scaled` are the fields that have a scale. Raises ValueError for a
    value that is there twice, and for a scale without its field."""
    for name in joints:
        for pair in ((COUNT, RIM_DISTANCE), (VELOCITY, RIM_SPEED)):
            if {name + what for what in pair} <= set(text.fields):
                raise ValueError(f"{' and '.join(name + what for what in pair)} are the same value")
    for name in scaled:
        if name not in text.fields:
            raise ValueError(f"feedback_scale: there is no {{{name}}} in it")


def motor_rad_per_m(spec: TextSpec, joint: JointSpec) -> float:
    """Return the angle of the motor's shaft for each metre that the wheel's rim goes forward."""
    return joint.sign * joint.gear_ratio / spec.wheels[joint.name].radius_m


def counts_per_m(spec: TextSpec, joint: JointSpec) -> float:
    """Return the counts for each metre that the wheel's rim goes forward."""
    turns_per_m = motor_rad_per_m(spec, joint) / (2.0 * math.pi)
    return spec.wheels[joint.name].counts_per_turn * turns_per_m


def texts_of(spec: LineSpec) -> tuple[TextSpec, Text, Text | None]:
    """Return the line's text settings, its set-point template, and its feedback template or None.
    Raises ProfileError if a template is missing or wrong."""
    names = tuple(joint.name for joint in spec.joints)
    if spec.text is None:
        raise ProfileError(f"{spec.name}: no template")
    try:
        sent = Text(spec.text.setpoints, setpoint_fields(names))
        check_setpoints(sent, names)
        received = Text(spec.text.feedback, feedback_fields(names)) if spec.text.feedback else None
        if received is not None:
            check_feedback(received, names, spec.text.feedback_scale)
    except ValueError as error:
        raise ProfileError(f"{spec.name}: {error}") from error
    return spec.text, sent, received


def why_not_possible(sent: Text, received: Text | None) -> str:
    """Return what in the templates cannot be written or read, and what to write instead; "": all
    can."""
    for _, name, form in sent.parts:
        if name is not None and form[-1] not in "dfg":
            return (
                f'the format "{form}" of {{{name}}} has no letter d, f or g: write {{{name}:d}}, '
                f"{{{name}:.3f}} or {{{name}:g}}"
            )
    if received is None or received.members:
        return ""
    after = [literal for literal, _, _ in received.parts[1:]]
    joined = [literal for literal in after if literal[0] in "0123456789.eE"]
    if not joined:
        return ""
    return f'"{joined[0]}" may go on with the number before it: put a space or a comma between them'


def text_bytes(spec: LineSpec) -> int:
    """Return the size of the longer of both lines of text, with numbers of a usual size."""
    _, sent, received = texts_of(spec)
    size = len(spec.text.prefix if spec.text else "")
    size += len(sent.say(dict.fromkeys(sent.fields, -999.0)))
    if received is None:
        return size
    return max(size, len(received.say(dict.fromkeys(received.fields, -99999.0))))
