# SPDX-License-Identifier: Apache-2.0
"""Rules for motor bridges on pins."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from motord.config.finding import Finding
from motord.config.rules.wiring.pin_owners import pins_have_one_owner
from motord.config.sections.joint.encoder import BoardEncoder, GpioEncoder
from motord.config.sections.joint.wheels import Profiles
from motord.config.sections.line import PwmLine
from motord.config.sections.model import Joint, Robot
from motord.config.toml_lines import Path
from motord.config.wiring import line_specs
from motord_hal.fieldbus.ports import EdgesEncoder, JointSpec, LineSpec
from motord_hal.gpio.pinmux import why_no_pull
from motord_hal.pwm.pins import Place, bridge_of, places_of, servo_range_rad
from motord_hal.serial.sysfs import port_identity


def _pins(robot: Robot, profiles: Profiles) -> Iterator[Finding]:
    for spec in line_specs(robot, profiles):
        kind = robot.line[spec.name].kind
        for number, joint in enumerate(spec.joints):
            at: Path = ("joint", joint.name, "pins")
            if not isinstance(robot.line[spec.name], PwmLine):
                if joint.pins:
                    text = f'is only for a line of kind "pwm": this one is "{kind}"'
                    yield Finding((at, ("line", spec.name, "kind")), text)
            elif joint.profile.bridge is not None:  # else another rule reports the protocol
                yield from _bridge(robot, spec, number, joint)


def _bridge(robot: Robot, spec: LineSpec, number: int, joint: JointSpec) -> Iterator[Finding]:
    at: Path = ("joint", joint.name, "pins")
    try:
        places = places_of(number, joint)
    except ValueError as error:
        yield Finding((at, ("joint", joint.name, "drive")), str(error))
        return
    yield from _chips(spec, places)
    yield from _carrier(spec, joint)
    yield from _servo(joint, robot.joint[joint.name])


def _chips(spec: LineSpec, places: list[Place]) -> Iterator[Finding]:
    for key, given, needed in (
        ("pwm_chip", spec.pins.pwm_chip, [p for p in places if p.channel is not None]),
        ("gpio_chip", spec.pins.gpio_chip, [p for p in places if p.channel is None]),
    ):
        if needed and not given:
            at: tuple[Path, ...] = (("line", spec.name, key), ("line", spec.name, "kind"))
            yield Finding(at, f"is missing: {needed[0].purpose} needs it")


def _carrier(spec: LineSpec, joint: JointSpec) -> Iterator[Finding]:
    bridge, requested_hz = bridge_of(joint), spec.pins.pwm_hz
    if requested_hz is not None and not bridge.pwm_min_hz <= requested_hz <= bridge.pwm_max_hz:
        span = f"{bridge.pwm_min_hz:g} to {bridge.pwm_max_hz:g} Hz"
        text = f'{requested_hz:g} Hz is out of range for drive "{joint.profile.name}" ({span})'
        yield Finding((("line", spec.name, "pwm_hz"), ("joint", joint.name, "drive")), text)


def _servo(spec: JointSpec, joint: Joint) -> Iterator[Finding]:
    """Check that the joint's range is within that of the servo's pulses."""
    most_rad = servo_range_rad(spec)
    for key in ("position_min_rad", "position_max_rad") if most_rad else ():
        if abs(getattr(joint, key) or 0.0) > most_rad * (1 + 1e-9):
            text = f"the servo's pulses reach {most_rad:.3g} rad at this joint, to either side"
            at: tuple[Path, ...] = (("joint", spec.name, key), ("joint", spec.name, "drive"))
            yield Finding(at, text)


def _encoders(robot: Robot, profiles: Profiles) -> Iterator[Finding]:
    for spec in line_specs(robot, profiles):
        line = robot.line[spec.name]
        for joint in spec.joints:
            encoder, at = robot.joint[joint.name].encoder, ("joint", joint.name, "encoder")
            if encoder is None:
                continue
            if not isinstance(line, PwmLine):
                text = f'is only for a line of kind "pwm": this one is "{line.kind}"'
                yield Finding((at, ("line", spec.name)), text)
            elif isinstance(encoder, GpioEncoder):
                yield from _edges(line, joint, encoder)
            if robot.joint[joint.name].counts_per_turn is not None:
                path: Path = ("joint", joint.name, "counts_per_turn")
                yield Finding((path, at), "belongs to the encoder: set it there")


def _edges(line: PwmLine, joint: JointSpec, encoder: GpioEncoder) -> Iterator[Finding]:
    at: Path = ("joint", joint.name, "encoder")
    if not (encoder.gpio_chip or line.gpio_chip):
        yield Finding((at,), "gpio_chip is missing, here and on the line")


def _boards(robot: Robot, _: Profiles) -> Iterator[Finding]:
    """Check that no line uses the port of a board with encoders, and no two joints the same motor
    of it."""
    lines = {port_identity(line.address): name for name, line in robot.line.items()}
    seen: dict[tuple[str, int], str] = {}
    rates: dict[str, tuple[str, int]] = {}
    for name, joint in robot.joint.items():
        encoder = joint.encoder
        if not isinstance(encoder, BoardEncoder):
            continue
        at: Path = ("joint", name, "encoder")
        port = port_identity(encoder.port)
        if port in lines:
            text = f"{encoder.port} is the port of line {lines[port]}"
            yield Finding((at, ("line", lines[port])), text)
        first = seen.setdefault((port, encoder.motor), name)
        if first != name:
            text = f"motor {encoder.motor} of that board is counted for joint {first} already"
            yield Finding((at, ("joint", first, "encoder")), text)
        other, baudrate = rates.setdefault(port, (name, encoder.baudrate))
        if baudrate != encoder.baudrate:
            text = f"baudrate is not that of joint {other} on the same port ({baudrate})"
            yield Finding((at, ("joint", other, "encoder")), text)


def _pulls(robot: Robot, profiles: Profiles) -> Iterator[Finding]:
    """Check that a chip has pull resistors, if its label names it. The daemon alone identifies a
    chip by its device file."""
    estop = robot.safety.estop
    if estop is not None and estop.pull and (text := why_no_pull(estop.gpio_chip)):
        yield Finding((("safety", "estop", "pull"), ("safety", "estop", "gpio_chip")), text)
    for spec in line_specs(robot, profiles):
        for joint in spec.joints:
            encoder, at = joint.encoder, ("joint", joint.name, "encoder")
            if not isinstance(encoder, EdgesEncoder) or encoder.pull == "none":
                continue
            if text := why_no_pull(encoder.gpio_chip):
                yield Finding((at,), text)


PIN_RULES: tuple[Callable[[Robot, Profiles], Iterator[Finding]], ...] = (
    _pins,
    _encoders,
    _boards,
    _pulls,
    pins_have_one_owner,
)
