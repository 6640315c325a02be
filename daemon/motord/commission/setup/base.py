# SPDX-License-Identifier: Apache-2.0
"""Questions of `motord init` about the base: kind, sizes, and which drive turns which wheel."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from motord.commission.person import Failed, Person
from motord.commission.setup.robot_text import Wheel

if TYPE_CHECKING:
    from motord.commission.setup.procedure import Given

KINDS = ("differential", "skid", "mecanum", "omni", "ackermann", "tricycle", "swerve")
STRAFING = ("mecanum", "omni", "swerve")
"""Kinds of bases that also move sideways."""
WITH_WHEELBASE = ("mecanum", "ackermann", "tricycle", "swerve")
RADIUS_USUAL_M, TRACK_USUAL_M = (0.02, 0.4), (0.08, 3.0)
WHEELS_OF_OMNI = (3, 8)
ENDS = ("front", "rear")
PLACES = ("front-left", "front-right", "rear-left", "rear-right")
SKID_SLIP_FACTOR = 1.5
"""Initial value: a base whose wheels scrub turns less than its track suggests."""


def base_of(person: Person, given: Given) -> dict[str, Any]:
    """Request the keys of [base] and return them, kind first. Raises Failed, Aborted."""
    kind = given.base or person.choose(
        "Which base? differential: two driven sides, casters follow. skid: wheels on two sides "
        "that scrub. mecanum: four wheels with rollers at 45 degrees. omni: three or more wheels "
        "with rollers across. ackermann: a car. tricycle: one steered wheel. swerve: two to four "
        "wheels that are driven and steered each.",
        KINDS,
    )
    if kind not in KINDS:
        raise Failed(f'base "{kind}" is not one of {", ".join(KINDS)}: begin with an example '
                     "(motord robots)")  # fmt: skip
    radius_m = plausible(
        person, given.wheel_radius_m, "Radius of a loaded wheel, from axle to floor?",
        RADIUS_USUAL_M, (0.005, 5.0),
        lambda value: f"{value:g} m: a wheel of {2 * value:.3g} m across?",
    )  # fmt: skip
    base = {"kind": kind, "wheel_radius_m": radius_m}
    usual = (max(TRACK_USUAL_M[0], radius_m), TRACK_USUAL_M[1])
    if kind == "omni":
        base["radius_m"] = plausible(
            person, given.radius_m, "Distance from the middle of the base to a wheel?",
            usual, (0.02, 10.0), lambda value: f"{100 * value:.3g} cm from the middle to a wheel?",
        )  # fmt: skip
        return base
    base["track_m"] = plausible(
        person, given.track_m, "Distance from the middle of a left tyre to that of a right one?",
        usual, (0.02, 20.0),
        lambda value: f"{100 * value:.3g} cm between left and right wheels?",
    )  # fmt: skip
    if kind in WITH_WHEELBASE:
        base["wheelbase_m"] = plausible(
            person, given.wheelbase_m, "Distance from the front axle to the rear one?",
            usual, (0.02, 20.0),
            lambda value: f"{100 * value:.3g} cm between front and rear axle?",
        )  # fmt: skip
    if kind == "mecanum":
        base["rollers"] = "x"
        person.show(
            "seen from above, the upper rollers of the four wheels have to form an X; if they form "
            'an O, swap the front wheels with the rear ones, or write rollers = "o"'
        )
    if kind in ("ackermann", "tricycle"):
        base["steered"] = given.steered or person.choose("Which axle is steered?", ENDS)
    if kind == "skid":
        base["track_slip_factor"] = SKID_SLIP_FACTOR
    return base


def wheels_of(
    person: Person,
    given: Given,
    base: Mapping[str, Any],
    units: Sequence[int],
    channels: Sequence[int],
    more: Mapping[str, Any],
) -> tuple[Wheel, ...]:
    """Return each wheel with the drive that turns it. `units`: those that answered the scan;
    `channels`: those of one drive. Raises Failed, Aborted."""
    places = _places(person, given, base["kind"])
    if unknown := sorted(given.addresses.keys() - {name for name, _ in places}):
        names = ", ".join(name for name, _ in places)
        raise Failed(f"--unit {unknown[0]}=...: no such wheel; this base has {names}")
    proposed = usual_addresses(len(places), units, channels)
    wheels = []
    for (name, placed), usual in zip(places, proposed, strict=True):
        option = given.addresses.get(name, {"left": given.left, "right": given.right}.get(name))
        unit, channel = option or ask_address(person, name, usual)
        # motors that face each other turn opposite directions; spin shows whether these do
        inverted = name.endswith("right") and base["kind"] != "omni"
        wheels.append(Wheel(name=name, placed=placed, unit=unit, channel=channel,
                            inverted=inverted, more=more))  # fmt: skip
    return tuple(wheels)


def _places(person: Person, given: Given, kind: str) -> list[tuple[str, dict[str, Any]]]:
    """Return the name of each wheel, and the keys that place it."""
    if kind == "mecanum":
        return [(place.replace("-", "_"), {"place": place}) for place in PLACES]
    if kind != "omni":
        return [(side, {"side": side}) for side in ("left", "right")]
    low, high = WHEELS_OF_OMNI
    count = given.wheel_count
    if count is None:
        count = int(person.choose("How many wheels?", [str(n) for n in range(low, high + 1)]))
    if not low <= count <= high:
        raise Failed(f"an omni base has {low} to {high} wheels, not {count}")
    person.show(
        f"wheel_1 is {180 / count:.0f} degrees left of straight ahead, the others follow "
        "counterclockwise at even distances; change angle_rad where yours are elsewhere"
    )
    step_rad = math.tau / count
    return [(f"wheel_{n + 1}", {"angle_rad": round((n + 0.5) * step_rad, 6)}) for n in range(count)]


def usual_addresses(
    count: int, units: Sequence[int], channels: Sequence[int]
) -> list[tuple[int, int]]:
    """Return the usual addresses: all channels of the first unit, then those of the next one."""
    each = channels if len(channels) > 1 else channels[:1]
    needed = math.ceil(count / len(each))
    found = list(units)[:needed]
    after = max(found, default=0) + 1
    found += range(after, after + needed - len(found))
    return [(unit, channel) for unit in found for channel in each][:count]


def ask_address(person: Person, name: str, proposed: tuple[int, int]) -> tuple[int, int]:
    wheel = name.replace("_", " ").removesuffix(" wheel")
    of = wheel if wheel.startswith("wheel") else f"the {wheel} wheel"
    of = f"joint {name}" if name.endswith(("drive", "steering")) else of
    text = person.text(f"Unit and channel of {of}'s drive, as 1.2?", f"{proposed[0]}.{proposed[1]}")
    return unit_and_channel(text)


def unit_and_channel(text: str) -> tuple[int, int]:
    """Parse `1.2`, or `1` for the first channel. Raises Failed."""
    unit, _, channel = text.partition(".")
    if not unit.isascii() or not unit.isdigit() or not (channel or "1").isdigit():
        raise Failed(f'"{text}" is not a unit and channel, as 1.2')
    return int(unit), int(channel or 1)


# ------------------------------------------------------------------------------------------ numbers
def asked(
    person: Person, given: float | None, question: str, unit: str, low: float, high: float
) -> float:
    """Return a number: the given option, or the person's answer. Raises Failed, Aborted."""
    if given is None:
        return person.number(question, unit, low, high)
    if not low <= given <= high:
        raise Failed(f"{question} {given:g} is out of range ({low:g} to {high:g} {unit})")
    return given


def plausible(
    person: Person,
    given: float | None,
    question: str,
    usual: tuple[float, float],
    span: tuple[float, float],
    aloud: Callable[[float], str],
) -> float:
    """Request a length like `plausible_number`."""
    return plausible_number(person, given, question, "m", usual, span, aloud)


def plausible_number(
    person: Person,
    given: float | None,
    question: str,
    unit: str,
    usual: tuple[float, float],
    span: tuple[float, float],
    aloud: Callable[[float], str],
) -> float:
    """Request a number, and confirm an unusual one. An unusual option is only shown."""
    while True:
        value = asked(person, given, question, unit, *span)
        if usual[0] <= value <= usual[1]:
            return value
        if given is not None:
            person.show(aloud(value))
            return value
        if person.confirm(aloud(value)):
            return value
