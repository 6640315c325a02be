# SPDX-License-Identifier: Apache-2.0
"""Conclusions from the first turns of the wheels: wrong wires, encoders and keys of the file."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from motord.commission.robot_file_edit import KeyPath
from motord.commission.spin.procedure import DOUBTS, RATIO_MAX, RATIO_MIN, TURNED_RAD, Turned
from motord.config import Robot
from motord.config.sections.joint.wheels import (
    counts_per_turn,
    rad_per_count,
    takes_duty,
    takes_torque,
)

ADDRESS_KEYS = ("line", "drive", "unit", "channel", "pins", "encoder")
"""Keys that say where a joint's motor is; they are swapped when two wheels are."""
CURRENT_A = 0.1
"""A motor that draws less current than this has no power."""
REACHED_RAD = 0.1
"""Greatest error of a joint that steers and has reached its goal."""
STRAIGHT_RAD = math.radians(1.0)
"""How exactly a person sees where a wheel points."""


@dataclass(slots=True)
class Findings:
    """Texts for the person, and keys that the robot file should have."""

    texts: list[str] = field(default_factory=list)
    changes: dict[KeyPath, Any] = field(default_factory=dict)

    @property
    def good(self) -> bool:
        """Whether nothing is wrong."""
        return not self.texts


def findings(robot: Robot, turns: Sequence[Turned]) -> Findings:
    """Return what is wrong, and what the robot file should have instead."""
    found = Findings()
    for turned in turns:
        if turned.note:
            found.texts.append(f"{turned.joint}: {turned.note}")
        elif turned.steers:
            _reached(turned, found)
        else:
            _encoder(robot, turned, found)
    _wheels(robot, [turned for turned in turns if not turned.note], found)
    for turned in turns:
        if turned.steers and turned.seen:
            _zero(robot, turned, found)
    return found


# ------------------------------------------------------------------------------------- the steering
def _reached(turned: Turned, found: Findings) -> None:
    name, commanded_rad = turned.joint, turned.commanded_rad
    reported_rad = turned.counted_rad[name]
    if not turned.seen:
        found.texts.append(
            f"{name}: its wheel did not turn, and its drive reports {reported_rad:+.2f} rad: is "
            "the linkage on, and are line and unit those of its drive? (motord scan PORT)"
        )
    elif abs(reported_rad - commanded_rad) > REACHED_RAD:
        found.texts.append(
            f"{name}: was to turn by {commanded_rad:+.2f} rad and reports {reported_rad:+.2f} rad: "
            "it is blocked or too weak, or gear_ratio or counts_per_turn is wrong"
        )


def _zero(robot: Robot, turned: Turned, found: Findings) -> None:
    """Find the counter value at which the wheel points straight ahead. The counter was at the
    joint's zero_count when the wheel was off by `off_rad`: angle = (count - zero_count) ·
    rad_per_count."""
    wheel, source = turned.seen, robot.joint[turned.joint]
    if wheel != turned.joint and not any(path[1] == wheel for path in found.changes):
        return  # it is not known which ones are swapped
    off_rad = turned.off_straight_rad[wheel]
    off_rad = off_rad if abs(off_rad) >= STRAIGHT_RAD else 0.0
    if off_rad:
        found.texts.append(
            f"{wheel}: points {abs(math.degrees(off_rad)):.1f} degrees to the "
            f"{'left' if off_rad > 0.0 else 'right'} instead of straight ahead"
        )
    profile = robot.profiles[source.drive]
    if not counts_per_turn(source, profile):
        if off_rad:
            found.texts.append(f"{wheel}: its drive measures no angle: turn its horn on the shaft")
        return
    inverted = found.changes.get(("joint", wheel, "inverted"), robot.joint[wheel].inverted)
    per_count_rad = abs(rad_per_count(source, profile)) * (-1.0 if inverted else 1.0)
    zero = source.zero_count - round(off_rad / per_count_rad)
    if zero != robot.joint[wheel].zero_count:
        found.changes["joint", wheel, "zero_count"] = zero


# -------------------------------------------------------------------------------------- the encoder
def _encoder(robot: Robot, turned: Turned, found: Findings) -> None:
    name, joint = turned.joint, robot.joint[turned.joint]
    own_rad = turned.counted_rad[name]
    if not turned.seen:
        found.texts.append(_stood(turned))
        return
    for fault in turned.faults:
        if fault in DOUBTS:
            text = f'the robot stopped by itself with the fault "{fault}": {DOUBTS[fault]}'
            found.texts.append(f"{name}: {text}")
    if not math.isfinite(own_rad):
        return
    counting = [k for k, rad in turned.counted_rad.items() if abs(rad) >= TURNED_RAD]
    others = [k for k in counting if k not in (name, *turned.together)]
    if abs(own_rad) < TURNED_RAD and turned.seen != name:
        return  # `_wheels` judges it
    if abs(own_rad) < TURNED_RAD and others:
        _crossed(robot, name, others[0], found)
    elif abs(own_rad) < TURNED_RAD:
        found.texts.append(
            f"{name}: the motor turned and its encoder did not count: look for an unplugged "
            "encoder, a broken wire, or a missing supply of the encoder"
        )
    elif own_rad < 0.0 and joint.encoder is not None:
        path = ("joint", name, "encoder", "reversed")
        found.changes[path] = not joint.encoder.reversed
        found.texts.append(f"{name}: its encoder counts against its motor: reversed is changed")
    elif own_rad < 0.0:
        found.texts.append(
            f"{name}: its encoder counts against its motor. No key of the robot file fixes that, "
            "for the drive itself needs both alike: swap A and B of the encoder, or set the "
            "drive's encoder direction with its maker's tool"
        )
    else:
        _scale(robot, turned, found)


def _stood(turned: Turned) -> str:
    name, current_a = turned.joint, turned.current_max_a
    if abs(turned.counted_rad[name]) >= TURNED_RAD:
        return (
            f"{name}: no wheel was seen turning, but its encoder counted "
            f"{turned.counted_rad[name]:+.2f} rad: look again, or find which axis it counts"
        )
    if current_a is not None and current_a > CURRENT_A:
        return (
            f"{name}: did not turn and drew up to {current_a:.1f} A: it is blocked, its brake is "
            "on, or its motor's phases or Hall sensors are not connected right"
        )
    return (
        f"{name}: did not turn and drew no current: is the motor connected, and are unit and "
        "channel of the robot file those of its drive? (motord scan PORT)"
    )


def _crossed(robot: Robot, name: str, other: str, found: Findings) -> None:
    one, two = robot.joint[name].encoder, robot.joint[other].encoder
    if one is None or two is None:
        found.texts.append(
            f"{name}: its motor turned, and the encoder of {other} counted: swap the plugs of the "
            "two encoders, or those of the two motors"
        )
        return
    found.texts.append(f"{name}: its motor turned, and the encoder of {other} counted: swapped")
    found.changes["joint", name, "encoder"] = two.model_dump(exclude_unset=True)
    found.changes["joint", other, "encoder"] = one.model_dump(exclude_unset=True)


def _scale(robot: Robot, turned: Turned, found: Findings) -> None:
    name, joint = turned.joint, robot.joint[turned.joint]
    profile = robot.profiles[joint.drive]
    if turned.faults or takes_duty(joint, profile) or takes_torque(joint, profile):
        return
    ratio = turned.counted_rad[name] / turned.commanded_rad
    if not RATIO_MIN <= ratio <= RATIO_MAX:
        found.texts.append(
            f"{name}: counted {ratio:.3g} times the commanded angle: counts_per_turn is that many "
            "times too small, or gear_ratio is wrong"
        )


# --------------------------------------------------------------------------------------- the wheels
def _wheels(robot: Robot, turns: Sequence[Turned], found: Findings) -> None:
    """Find out which joint's address turns which wheel, and give the file the right addresses."""
    seen = [turned for turned in turns if turned.seen]
    swapped = [turned for turned in seen if turned.seen != turned.joint]
    for turned in swapped:
        text = f"{turned.joint}: the {turned.seen} wheel turned instead"
        if turned.steers:
            text = f"{turned.joint}: the wheel of {turned.seen} was pointed instead"
        found.texts.append(text)
    if crossed := [turned for turned in swapped if not _counted(turned)]:
        found.texts.append(
            f"{crossed[0].joint}: the encoder of its drive is on its own wheel: swap the plugs of "
            "the two motors"
        )
        return
    joints, wheels = {turned.joint for turned in seen}, [turned.seen for turned in seen]
    if swapped and (set(wheels) != joints or len(set(wheels)) != len(wheels)):
        found.texts.append(
            "which wheels are swapped is only known after all have turned: motord spin --all"
        )
        return
    for turned in seen:
        _address(robot, turned, found)
        inverted = robot.joint[turned.joint].inverted != (turned.direction == "backward")
        if turned.direction == "backward":
            how = "pointed to the wrong side" if turned.steers else "turned backward"
            found.texts.append(f"{turned.seen}: {how}: inverted is changed")
        if robot.joint[turned.seen].inverted != inverted:
            found.changes["joint", turned.seen, "inverted"] = inverted


def _counted(turned: Turned) -> bool:
    """Return whether the joint's own encoder counted, or measures no position."""
    own_rad = turned.counted_rad[turned.joint]
    return not abs(own_rad) < TURNED_RAD


def _address(robot: Robot, turned: Turned, found: Findings) -> None:
    if turned.seen == turned.joint:
        return
    source, target = robot.joint[turned.joint], robot.joint[turned.seen]
    for key in ADDRESS_KEYS:
        value = getattr(source, key)
        if value != getattr(target, key):
            plain = value.model_dump(exclude_unset=True) if key == "encoder" and value else value
            if plain is not None:
                found.changes["joint", turned.seen, key] = plain
