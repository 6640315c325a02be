# SPDX-License-Identifier: Apache-2.0
"""Lines of text on a stream line: docs/mcu/line-ascii.md is their description."""

from __future__ import annotations

from motord_hal.ascii.text import Text
from motord_hal.ascii.twist import ANGULAR, LINEAR
from motord_hal.base.errors import ProfileError
from motord_hal.fieldbus.ports import LineSpec, TextSpec

COUNT, VELOCITY, CURRENT, VOLTAGE = "_count", "_rad_s", "_current_a", "voltage_v"
GYRO_Z = "gyro_z_rad_s"


def setpoint_fields(joints: tuple[str, ...]) -> tuple[str, ...]:
    """What a template of set-points may name: all joints, or the twist."""
    return (*joints, LINEAR, ANGULAR)


def feedback_fields(joints: tuple[str, ...]) -> tuple[str, ...]:
    """What a template of feedback may name."""
    return (
        *(name + what for name in joints for what in (COUNT, VELOCITY, CURRENT)),
        VOLTAGE,
        GYRO_Z,
    )


def check_setpoints(text: Text, joints: tuple[str, ...]) -> None:
    """Raises ValueError for a template that does not say everything."""
    sent = set(text.fields)
    if sent not in (set(joints), {LINEAR, ANGULAR}):
        raise ValueError(f"it must contain {', '.join(joints)}, or v and w, and nothing else")


def texts_of(spec: LineSpec) -> tuple[TextSpec, Text, Text | None]:
    """Raises ProfileError."""
    names = tuple(joint.name for joint in spec.joints)
    if spec.text is None:
        raise ProfileError(f"{spec.name}: no template")
    try:
        sent = Text(spec.text.setpoints, setpoint_fields(names))
        check_setpoints(sent, names)
        received = Text(spec.text.feedback, feedback_fields(names)) if spec.text.feedback else None
    except ValueError as error:
        raise ProfileError(f"{spec.name}: {error}") from error
    return spec.text, sent, received


def why_not_possible(sent: Text, received: Text | None) -> str:
    """What of the templates cannot be written or read, and what to write instead; empty:
    nothing."""
    for _, name, form in sent.parts:
        if name is not None and form[-1] not in "dfg":
            return (
                f'the format "{form}" of {{{name}}} has no letter d, f or g: write {{{name}:d}}, '
                f"{{{name}:.3f}} or {{{name}:g}}"
            )
    after = [literal for literal, _, _ in received.parts[1:]] if received else []
    joined = [literal for literal in after if literal[0] in "0123456789.eE"]
    if not joined:
        return ""
    return f'"{joined[0]}" may go on with the number before it: put a space or a comma between them'


def text_bytes(spec: LineSpec) -> int:
    """Of the longer of both lines of text, with numbers of a usual size."""
    _, sent, received = texts_of(spec)
    size = len(sent.say(dict.fromkeys(sent.fields, -999.0)))
    if received is None:
        return size
    return max(size, len(received.say(dict.fromkeys(received.fields, -99999.0))))
