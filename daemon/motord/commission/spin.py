# SPDX-License-Identifier: Apache-2.0
"""The first turn of each wheel: which one turns, in which direction, and what its encoder counts.

A wheel turns alone as the twist that turns the base about the wheels of the other side: no path to
the motors but that of every other command.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

from motord.api.snapshot import Snapshot
from motord.client import Client
from motord.commission.person import Failed, Person
from motord.commission.session import Held, Session, armed

Direction = Literal["forward", "backward", "not at all"]
OWNER = "motord-spin"
TURNED_RAD = 0.2
"""An encoder that counts less has not seen the wheel turn."""
SPEED_RAD_S, SPEED_MAX_RAD_S = 1.5, 5.0
SECONDS, SECONDS_MAX = 2.0, 10.0
RATIO_MIN, RATIO_MAX = 0.8, 1.25
"""Counted over commanded angle of a drive that holds its speed; else counts or gear are wrong."""
DOUBTS = {
    "direction": "the wheel turned against its set-point, as its encoder counts",
    "stall": "the encoder did not count although the wheel should turn",
    "following_error": "the wheel was much slower than its set-point",
    "runaway": "the wheel was much faster than its set-point",
    "implausible_feedback": "counter and reported velocity contradict each other",
}
"""Faults of the core's checks that a wrong encoder causes."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Wheel:
    """One joint as the daemon runs it."""

    name: str
    index: int
    side: str
    wheel_radius_m: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Turned:
    """What was measured while one joint was commanded forward, and what the person saw."""

    joint: str
    commanded_rad: float
    """By its set-points."""
    counted_rad: Mapping[str, float]
    """By every joint's feedback."""
    current_max_a: float | None
    faults: tuple[str, ...] = ()
    seen: str = ""
    """Joint that the person saw turn; empty: none."""
    direction: Direction = "not at all"


def wheels_of(robot: Mapping[str, object]) -> dict[str, Wheel]:
    """From the daemon's answer of `robot`."""
    sides, radii = robot["sides"], robot["wheel_radii_m"]
    assert isinstance(sides, dict)
    assert isinstance(radii, dict)
    return {
        name: Wheel(name=name, index=index, side=side, wheel_radius_m=radii[name])
        for index, (name, side) in enumerate(sides.items())
    }


def twist_of_side(wheel: Wheel, speed_rad_s: float, track_m: float) -> tuple[float, float]:
    """The twist in which the wheels of this wheel's side turn so and those of the other rest:
    v = r w / 2, and a turn about the other side's contact points."""
    rim_m_s = speed_rad_s * wheel.wheel_radius_m
    turn_rad_s = rim_m_s / track_m
    return rim_m_s / 2.0, -turn_rad_s if wheel.side == "left" else turn_rad_s


def turn_wheel(session: Session, wheel: Wheel, speed_rad_s: float, seconds: float) -> Turned:
    """Turn one wheel forward and watch all encoders. Raises Failed, Aborted."""
    if session.robot["strafes"]:
        raise Failed("motord spin turns wheels of bases with two sides only: nothing was turned")
    track_m = float(session.robot["effective_track_m"])
    linear_m_s, angular_rad_s = twist_of_side(wheel, speed_rad_s, track_m)
    limits = session.client.params_get("limits.linear_m_s", "limits.angular_rad_s")
    asked = (abs(linear_m_s), abs(angular_rad_s))
    scale = min(
        1.0, *(most / part for part, most in zip(asked, limits.values(), strict=True) if most)
    )
    session.person.progress(f"{wheel.name} turns; any key stops it")
    held = session.hold(linear_m_s * scale, angular_rad_s * scale, seconds)
    return measured(wheel, tuple(session.robot["joints"]), held)


def measured(wheel: Wheel, joints: Sequence[str], held: Held) -> Turned:
    """What the feedback of all joints has counted while one of them was commanded."""
    first, last = held.snapshots[0], held.snapshots[-1]
    currents = [
        abs(current)
        for snapshot in held.snapshots
        if math.isfinite(current := snapshot.joints[wheel.index].current_a)
    ]
    return Turned(
        joint=wheel.name,
        commanded_rad=_commanded_rad(held.snapshots, wheel.index),
        counted_rad={name: _counted_rad(first, last, index) for index, name in enumerate(joints)},
        current_max_a=max(currents, default=None),
        faults=held.faults,
    )


def _commanded_rad(snapshots: Sequence[Snapshot], index: int) -> float:
    total_rad = 0.0
    for before, after in itertools.pairwise(snapshots):
        elapsed_s = (after.stamp_ns - before.stamp_ns) * 1e-9
        total_rad += before.joints[index].setpoint_rad_s * elapsed_s
    return total_rad


def _counted_rad(first: Snapshot, last: Snapshot, index: int) -> float:
    """NaN: the drive measures no position."""
    return last.joints[index].position_rad - first.joints[index].position_rad


def ask_what_turned(person: Person, turned: Turned, others: Sequence[str]) -> Turned:
    """The same with the person's answer."""
    answers = ["forward", "backward", "none", *(["other"] if others else [])]
    answer = person.choose(f"Did the {turned.joint} wheel turn forward?", answers)
    if answer == "none":
        return turned
    seen = turned.joint
    if answer == "other":
        seen = others[0] if len(others) == 1 else person.choose("Which wheel turned?", others)
        answer = person.choose(f"Did the {seen} wheel turn forward?", ["forward", "backward"])
    return replace(turned, seen=seen, direction="forward" if answer == "forward" else "backward")


def require_idle_ground(person: Person, speed_rad_s: float, seconds: float) -> None:
    """Ask before anything turns. Raises Failed."""
    if not 0.0 < speed_rad_s <= SPEED_MAX_RAD_S or not 0.0 < seconds <= SECONDS_MAX:
        raise Failed(
            f"a wheel is turned with at most {SPEED_MAX_RAD_S:g} rad/s for {SECONDS_MAX:g} s"
        )
    question = (
        f"Each wheel turns for {seconds:g} s with at most {speed_rad_s:g} rad/s "
        f"({speed_rad_s * 60 / math.tau:.0f} rpm). Are all wheels off the ground, and is nothing "
        "in their reach?"
    )
    if not person.confirm(question):
        raise Failed("put the robot on blocks first: nothing was turned")


def spin(
    client: Client, person: Person, names: Sequence[str], speed_rad_s: float, seconds: float
) -> list[Turned]:
    """Turn these wheels, one after the other; the robot is disarmed while the person answers.
    Raises Failed, Aborted, ClientError."""
    wheels = wheels_of(client.call("robot"))
    if unknown := [name for name in names if name not in wheels]:
        raise Failed(f'no joint "{unknown[0]}": known are {", ".join(wheels)}')
    require_idle_ground(person, speed_rad_s, seconds)
    found = []
    for name in names:
        wheel = wheels[name]
        together = [each.name for each in wheels.values() if each.side == wheel.side]
        if len(together) > 1:
            person.show(
                f"{name}: the wheels {', '.join(together)} turn together: this base drives its "
                f"sides; look at {name} alone"
            )
        with armed(client, person, OWNER) as session:
            turned = turn_wheel(session, wheel, speed_rad_s, seconds)
        person.show(words(turned))
        found.append(ask_what_turned(person, turned, [each for each in wheels if each != name]))
    return found


def words(turned: Turned) -> str:
    """The measures, in a line."""
    counted = ", ".join(
        f"{name} {angle_rad:+.2f} rad" for name, angle_rad in turned.counted_rad.items()
    )
    current = "" if turned.current_max_a is None else f", at most {turned.current_max_a:.2f} A"
    return f"{turned.joint}: commanded {turned.commanded_rad:+.2f} rad, counted {counted}{current}"
