# SPDX-License-Identifier: Apache-2.0
"""The first turn of each wheel: which one turns, in which direction, and what its encoder counts.

A wheel turns by a twist of the base in which as few other wheels as possible turn (wheel_turns):
the motors are reached only through the same commands as always. Bases with steered wheels:
steered.py."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal

from motord.api.procedures import OPTIONS
from motord.api.snapshot import Snapshot
from motord.client import Client
from motord.commission.person import Failed, Person
from motord.commission.session import Held, Session, armed, require_idle
from motord.commission.spin.wheel_turns import Turn, together, turns_of

Direction = Literal["forward", "backward", "not at all"]
OWNER = "motord-spin"
TURNED_RAD = 0.2
"""If an encoder counts less than this, it has not seen the wheel turn."""
RATIO_MIN, RATIO_MAX = 0.8, 1.25
"""Range of counted over commanded angle for a drive that holds its speed; outside it
counts_per_turn or gear_ratio is wrong."""
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
    """One joint, with its values in the daemon."""

    name: str
    index: int
    wheel_radius_m: float
    turns: tuple[Turn, ...]
    """Twists that turn the wheel, one after the other; empty: no twist turns it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Turned:
    """Measures from while one joint was commanded forward, and what the person saw."""

    joint: str
    commanded_rad: float
    """Commanded angle: the integral of the set-points."""
    counted_rad: Mapping[str, float]
    """Counted angle of every joint, from its feedback; NaN: it measures no position."""
    current_max_a: float | None
    faults: tuple[str, ...] = ()
    together: tuple[str, ...] = ()
    """Joints that were commanded every time, including the joint itself."""
    seen: str = ""
    """Joint that the person saw turn; empty: no joint."""
    direction: Direction = "not at all"
    steers: bool = False
    """Whether the joint points its wheel; `forward` then means to the correct side."""
    off_straight_rad: Mapping[str, float] = field(default_factory=dict)
    """For a joint that steers: by wheel, how far to the left it pointed when it should have pointed
    straight ahead."""
    note: str = ""
    """Contradiction in the person's answers, in words; empty: no contradiction."""


def wheels_of(robot: Mapping[str, Any]) -> dict[str, Wheel]:
    """Return the wheels from the daemon's answer of `robot`."""
    rows = {name: tuple(row) for name, row in robot["wheel_rows"].items()}
    return {
        name: Wheel(
            name=name,
            index=index,
            wheel_radius_m=robot["wheel_radii_m"].get(name, math.nan),
            turns=turns_of(rows, name, strafes=robot["strafes"]) if name in rows else (),
        )
        for index, name in enumerate(robot["joints"])
    }


def known(wheels: dict[str, Wheel], names: Sequence[str]) -> dict[str, Wheel]:
    """Return the wheels, after a check that these names are among them. Raises Failed."""
    if unknown := [name for name in names if name not in wheels]:
        raise Failed(f'no joint "{unknown[0]}": known are {", ".join(wheels)}')
    return wheels


def turn_wheel(session: Session, wheel: Wheel, speed_rad_s: float, seconds: float) -> Turned:
    """Turn one wheel forward and watch all encoders. Raises Failed, Aborted."""
    radii_m, joints = session.robot["wheel_radii_m"], tuple(session.robot["joints"])
    found = []
    for number, turn in enumerate(wheel.turns, 1):
        times = f", time {number} of {len(wheel.turns)}" if len(wheel.turns) > 1 else ""
        session.person.progress(f"{wheel.name} turns{times}")
        fastest = max(abs(rim) / radii_m[name] for name, rim in turn.rims.items())
        twist = (turn.linear, turn.lateral, turn.angular)
        rim_m_s = rim_within_limits(session, twist, speed_rad_s / fastest)
        held = session.hold(
            turn.linear * rim_m_s, turn.angular * rim_m_s, seconds,
            lateral_m_s=turn.lateral * rim_m_s,
        )  # fmt: skip
        require_only(DOUBTS, session, held)
        found.append(measured(wheel, joints, held))
        if held.faults:
            break
    return replace(both_times(found), together=together(wheel.turns[: len(found)]))


def require_only(faults: Iterable[str], session: Session, held: Held) -> None:
    """Check that no other faults ended the motion; after another fault its measures prove nothing.
    Raises Failed."""
    if not set(held.faults) <= set(faults):
        raise Failed(f"{session.stopped_by(held.faults)}; nothing was written")


def rim_within_limits(session: Session, twist: tuple[float, float, float], rim_m_s: float) -> float:
    """Return the greatest rim speed, at most `rim_m_s`, by which this twist (linear, lateral,
    angular; for 1 m/s) can be multiplied within the limits of the base."""
    names = ("limits.linear_m_s", "limits.lateral_m_s", "limits.angular_rad_s")
    strafes = session.robot["strafes"]
    limits = session.client.params_get(*(n for n in names if strafes or "lateral" not in n))
    for name, part in zip(names, twist, strict=True):
        most = limits.get(name)
        if most and part:
            rim_m_s = min(rim_m_s, most / abs(part))
    return rim_m_s


def both_times(turns: Sequence[Turned]) -> Turned:
    """Combine turns of one wheel: the least angles that were commanded and counted."""
    first = turns[0]
    currents_a = [one.current_max_a for one in turns if one.current_max_a is not None]
    return replace(
        first,
        commanded_rad=min((one.commanded_rad for one in turns), key=abs),
        counted_rad={
            name: min((one.counted_rad[name] for one in turns), key=abs)
            for name in first.counted_rad
        },
        current_max_a=max(currents_a, default=None),
        faults=tuple(fault for one in turns for fault in one.faults),
    )


def measured(wheel: Wheel, joints: Sequence[str], held: Held) -> Turned:
    """Return the angles that all joints counted while one of them was commanded."""
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
    """Return the angle between two snapshots; NaN: the drive measures no position."""
    return last.joints[index].position_rad - first.joints[index].position_rad


def ask_what_turned(
    person: Person, turned: Turned, others: Sequence[str], every_time: str = ""
) -> Turned:
    """Return the same with the person's answer. `every_time`: words for a wheel that turns
    twice."""
    answers = ["forward", "backward", "none", *(["other"] if others else [])]
    answer = person.choose(f"Did the {turned.joint} wheel turn forward{every_time}?", answers)
    if answer == "none":
        return turned
    seen = turned.joint
    if answer == "other":
        seen = (
            others[0]
            if len(others) == 1
            else (person.choose(f"Which wheel turned{every_time}?", others))
        )
        answer = person.choose(f"Did the {seen} wheel turn forward?", ["forward", "backward"])
    return replace(turned, seen=seen, direction="forward" if answer == "forward" else "backward")


def require_idle_ground(client: Client, person: Person, speed_rad_s: float, seconds: float) -> None:
    """Check that the robot is idle, and confirm that its wheels are free. Raises Failed."""
    require_idle(client)
    fastest_rad_s, longest_s = OPTIONS["wheel_rad_s"].high, OPTIONS["seconds"].high
    if not 0.0 < speed_rad_s <= fastest_rad_s or not 0.0 < seconds <= longest_s:
        raise Failed(f"a wheel is turned with at most {fastest_rad_s:g} rad/s for {longest_s:g} s")
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
    wheels = known(wheels_of(client.call("robot")), names)
    if fixed := [name for name in names if not wheels[name].turns]:
        raise Failed(f"no motion of this base turns {fixed[0]}: nothing was turned")
    require_idle_ground(client, person, speed_rad_s, seconds)
    found = []
    for name in names:
        wheel = wheels[name]
        _announce(person, wheel)
        with armed(client, person, OWNER) as session:
            turned = turn_wheel(session, wheel, speed_rad_s, seconds)
        person.show(words(turned))
        every_time = " both times" if len(wheel.turns) > 1 else ""
        others = [each for each in wheels if each != name]
        found.append(ask_what_turned(person, turned, others, every_time))
    return found


def _announce(person: Person, wheel: Wheel) -> None:
    """Show that other wheels turn, too."""
    if len(wheel.turns) > 1:
        partners = [" and ".join(j for j in turn.joints if j != wheel.name) for turn in wheel.turns]
        person.show(
            f"{wheel.name}: this base does not turn it alone. It turns twice, with {partners[0]}, "
            f"then with {partners[1]}: look which wheel turns both times"
        )
    elif len(wheel.turns[0].joints) > 1:
        person.show(
            f"{wheel.name}: the wheels {', '.join(wheel.turns[0].joints)} turn together: this base "
            f"drives its sides; look at {wheel.name} alone"
        )


def words(turned: Turned) -> str:
    """Return the measures in one line."""
    counted = ", ".join(
        f"{name} {angle_rad:+.2f} rad" for name, angle_rad in turned.counted_rad.items()
    )
    current = "" if turned.current_max_a is None else f", at most {turned.current_max_a:.2f} A"
    return f"{turned.joint}: commanded {turned.commanded_rad:+.2f} rad, counted {counted}{current}"
