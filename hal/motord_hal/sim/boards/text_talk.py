# SPDX-License-Identifier: Apache-2.0
"""Lines of text, from the board's side: the templates of the robot file in the opposite roles."""

from __future__ import annotations

import math
from collections.abc import Iterator

from motord_hal.ascii.dialect import (
    COUNT,
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
)
from motord_hal.ascii.text import Lines
from motord_hal.ascii.twist import LINEAR, wheels_of
from motord_hal.fieldbus.ports import LineSpec
from motord_hal.sim.gyro import SimulatedGyro
from motord_hal.sim.rs485.content import NamedContent


class TextTalk:
    """`line.Talk` of a board that reads text."""

    def __init__(self, spec: LineSpec, gyro: SimulatedGyro | None = None) -> None:
        """Set the board up. `gyro` is a sensor on the board."""
        self._gyro = gyro
        self._spec, self._feedback_text, self._received = texts_of(spec)
        self._prefix = set(Lines.whole(self._spec.prefix.encode("ascii")))
        self._joints = spec.joints
        self._profile = spec.joints[0].profile
        self._feedback_s = 1.0 / spec.cycle_hz if self._received else math.inf
        self.power_up()

    def power_up(self) -> None:
        self.feedback_s = self._feedback_s
        self._lines = Lines()

    def feed(self, data: bytes, now_s: float) -> Iterator[dict[str, int] | None]:
        del now_s
        for line in self._lines.feed(data):
            if line in self._prefix:
                continue
            numbers = self._feedback_text.read(line)
            yield None if numbers is None else self._written(numbers)

    def _written(self, numbers: dict[str, float]) -> dict[str, int]:
        if LINEAR in numbers:
            wheels = wheels_of(self._spec, numbers)
            motors = {
                j.name: wheels[j.name] * j.gear_ratio * (-1.0 if j.inverted else 1.0)
                for j in self._joints
            }
        elif set(numbers) == set(rim_fields(tuple(joint.name for joint in self._joints))):
            motors = {
                joint.name: numbers[joint.name + RIM_SPEED] * motor_rad_per_m(self._spec, joint)
                for joint in self._joints
            }
        else:
            motors = {name: number / self._spec.scale for name, number in numbers.items()}
        written = {}
        for joint in self._joints:
            channel = self._profile.channels[joint.channel]
            name = channel.setpoint
            written[name] = self._profile.registers[name].from_si(motors[joint.name])
        return written

    def feedback(self, content: NamedContent, now_s: float) -> bytes:
        del now_s
        assert self._received is not None  # without feedback there is no period
        rate_rad_s = self._gyro.measure().angular_rad_s[2] if self._gyro else 0.0
        numbers = {VOLTAGE: self._si(content, self._profile.bus_voltage), GYRO_Z: rate_rad_s}
        for joint in self._joints:
            channel = self._profile.channels[joint.channel]
            numbers[joint.name + COUNT] = self._si(content, channel.position)
            numbers[joint.name + VELOCITY] = self._si(content, channel.velocity)
            numbers[joint.name + CURRENT] = self._si(content, channel.current)
            rad_per_m, per_m = motor_rad_per_m(self._spec, joint), counts_per_m(self._spec, joint)
            numbers[joint.name + RIM_SPEED] = numbers[joint.name + VELOCITY] / rad_per_m
            numbers[joint.name + RIM_DISTANCE] = (
                numbers[joint.name + COUNT] / per_m if per_m else 0.0
            )
        scale = self._spec.feedback_scale
        return self._received.say({n: v * scale.get(n, 1.0) for n, v in numbers.items()})

    def _si(self, content: NamedContent, name: str | None) -> float:
        return self._profile.registers[name].to_si(content.value(name)) if name else 0.0
