# SPDX-License-Identifier: Apache-2.0
"""Lines of text on a stream line: docs/mcu/line-ascii.md is their description."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping

from motord_hal.ascii.text import Lines, Text
from motord_hal.ascii.twist import ANGULAR, LINEAR, twist_of
from motord_hal.base.errors import ProfileError
from motord_hal.fieldbus.ports import JointSpec, LineSpec, TextSpec
from motord_hal.mcu.dialect import BoardFeedback
from motord_hal.mcu.frames import BoardImu

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


class TextDialect:
    """dialect.Dialect for boards that read text."""

    def __init__(self, spec: LineSpec) -> None:
        self.bad = 0
        self._spec_of_line = spec
        self._spec, self._sent, self._received = texts_of(spec)
        self._joints = spec.joints
        self._profile = spec.joints[0].profile
        if self._profile.protocol != "ascii":
            raise ProfileError(f"{spec.name}: {self._profile.name} speaks {self._profile.protocol}")
        self.answers = self._received is not None
        self.reset()

    def reset(self) -> None:
        self._lines = Lines()

    def setpoints(self, raw: Mapping[str, int], now_ns: int) -> bytes:
        del now_ns
        motors = {joint.name: self._setpoint(joint, raw) for joint in self._joints}
        if set(self._sent.fields) == {LINEAR, ANGULAR}:
            wheels = {j.name: motors[j.name] * _sign(j) / j.gear_ratio for j in self._joints}
            return self._sent.say(twist_of(self._spec, wheels))
        return self._sent.say({name: value * self._spec.scale for name, value in motors.items()})

    def _setpoint(self, joint: JointSpec, raw: Mapping[str, int]) -> float:
        channel = self._profile.channels[joint.channel]
        name = channel.setpoint
        return self._profile.registers[name].to_si(raw.get(name, 0))

    def feed(self, data: bytes, now_ns: int) -> Iterator[BoardFeedback]:
        for line in self._lines.feed(data) if self._received else ():
            numbers = self._received.read(line) if self._received else None
            if numbers is None:
                self.bad += 1
                continue
            yield BoardFeedback(self._values(numbers), now_ns, now_ns, None, _imu(numbers))

    def _values(self, numbers: Mapping[str, float]) -> dict[str, int]:
        values: dict[str, int] = {}
        for joint in self._joints:
            channel = self._profile.channels[joint.channel]
            if (count := numbers.get(joint.name + COUNT)) is not None and channel.position:
                values[channel.position] = round(count)
            for what, register in ((VELOCITY, channel.velocity), (CURRENT, channel.current)):
                if (value := numbers.get(joint.name + what)) is not None and register:
                    values[register] = self._profile.registers[register].from_si(value)
        if (voltage := numbers.get(VOLTAGE)) is not None and self._profile.bus_voltage:
            register = self._profile.bus_voltage
            values[register] = self._profile.registers[register].from_si(voltage)
        return values

    def wire_bytes(self) -> int:
        return text_bytes(self._spec_of_line)


def _imu(numbers: Mapping[str, float]) -> BoardImu | None:
    if GYRO_Z not in numbers:
        return None
    rates = (math.nan, math.nan, numbers[GYRO_Z])
    return BoardImu(rates, (math.nan,) * 3, saturated=False)


def text_bytes(spec: LineSpec) -> int:
    """Of the longer of both lines of text, with numbers of a usual size."""
    _, sent, received = texts_of(spec)
    size = len(sent.say(dict.fromkeys(sent.fields, -999.0)))
    if received is None:
        return size
    return max(size, len(received.say(dict.fromkeys(received.fields, -99999.0))))


def _sign(joint: JointSpec) -> float:
    return -1.0 if joint.inverted else 1.0
