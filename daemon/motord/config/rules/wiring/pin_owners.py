# SPDX-License-Identifier: Apache-2.0
"""Every pin that a robot file names, with its users: no pin may serve two of them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from motord.config.finding import Finding
from motord.config.sections.joint.wheels import Profiles
from motord.config.sections.line import PwmLine, SerialLine
from motord.config.sections.model import Robot
from motord.config.toml_lines import Path
from motord.config.wiring import line_specs
from motord_hal.fieldbus.ports import EdgesEncoder, LineSpec
from motord_hal.pwm.pins import places_of


@dataclass(frozen=True, slots=True)
class _Claim:
    chip: str
    pin: str
    """GPIO line, or "pwmN"."""
    owner: str
    at: Path
    key: str = ""
    """Key in `at` that names the pin, if `at` is a whole table."""


def pins_have_one_owner(robot: Robot, profiles: Profiles) -> Iterator[Finding]:
    """Check that no pin has two users. Chips are compared as the file writes them."""
    owners: dict[tuple[str, str], str] = {}
    for claim in _claims(robot, profiles):
        owner = owners.setdefault((claim.chip, claim.pin), claim.owner)
        if owner != claim.owner:
            what = f"{claim.key}: " if claim.key else ""
            yield Finding((claim.at,), f"{what}{claim.pin} is taken already ({owner})")


def _claims(robot: Robot, profiles: Profiles) -> Iterator[_Claim]:
    specs = line_specs(robot, profiles)
    for spec in specs:
        if isinstance(robot.line[spec.name], PwmLine):
            yield from _of_bridges(spec)
    for spec in specs:
        yield from _of_encoders(spec)
    yield from _of_directions(robot)
    for key, pin in (("estop", robot.safety.estop), ("watchdog", robot.safety.watchdog)):
        if pin is not None:
            at: Path = ("safety", key, "gpio_line")
            yield _Claim(pin.gpio_chip, pin.gpio_line, f"safety.{key}", at)


def _of_bridges(spec: LineSpec) -> Iterator[_Claim]:
    for number, joint in enumerate(spec.joints):
        try:
            places = places_of(number, joint) if joint.profile.bridge else []
        except ValueError:
            continue  # another rule reports that
        for place in places:
            at, key = ("joint", joint.name, "pins"), f"pin {place.pin}"
            if place.channel is None:
                yield _Claim(spec.pins.gpio_chip, place.gpio, place.purpose, at, key)
            else:
                pin = f"pwm{place.channel}"
                yield _Claim(spec.pins.pwm_chip, pin, place.purpose, at, key)


def _of_encoders(spec: LineSpec) -> Iterator[_Claim]:
    for joint in spec.joints:
        if isinstance(joint.encoder, EdgesEncoder):
            for key, pin in (("a", joint.encoder.a), ("b", joint.encoder.b)):
                owner = f"joint {joint.name}, encoder's {key}"
                at: Path = ("joint", joint.name, "encoder")
                yield _Claim(joint.encoder.gpio_chip, pin, owner, at, key)


def _of_directions(robot: Robot) -> Iterator[_Claim]:
    for name, line in robot.line.items():
        if isinstance(line, SerialLine) and line.direction == "gpio":
            chip, pin = line.direction_gpio_chip, line.direction_gpio_line
            if chip and pin:
                at: Path = ("line", name, "direction_gpio_line")
                yield _Claim(chip, pin, f"line {name}, direction", at)
