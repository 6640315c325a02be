# SPDX-License-Identifier: Apache-2.0
"""Questions of `motord init` about steered wheels: which wheels are driven and steered, by which
drives, and how far and how fast they steer."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from motord.commission.person import Failed, Person
from motord.commission.setup.base import (
    ENDS,
    PLACES,
    ask_address,
    asked,
    plausible_number,
    usual_addresses,
)
from motord.commission.setup.robot_text import Wheel
from motord_hal.drives.profile import DriveProfile

if TYPE_CHECKING:
    from motord.commission.setup.procedure import Given

STEERED = ("ackermann", "tricycle", "swerve")
DRIVEN = ("axle", "pair", "steered")
LINE = "steering"
"""Name of the line of the drives that steer, if they are not on the line of those that drive."""
MODULES = {
    4: PLACES,
    3: ("front", "rear-left", "rear-right"),
    2: ("front-left", "rear-right"),
}
"""Usual places of the modules of a swerve base, by their number."""
_CAR_USUAL_RAD = (math.radians(10.0), math.radians(80.0))
_SWERVE_LEAST_RAD = math.pi / 2.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Steering:
    """The drives that steer."""

    drive: str
    profile: DriveProfile
    line: str
    """Name of their line."""


def steered_wheels(
    person: Person,
    given: Given,
    base: Mapping[str, Any],
    units: Sequence[int],
    channels: Sequence[int],
    more: Mapping[str, Any],
    steering: Steering,
) -> tuple[Wheel, ...]:
    """Return the joints that drive and the joints that steer. Raises Failed, Aborted."""
    driven, steered = _joints(person, given, base)
    known = [*driven, *steered]
    if unknown := sorted(given.addresses.keys() - set(known)):
        names = ", ".join(known)
        raise Failed(f"--unit {unknown[0]}=...: no such joint; this base has {names}")
    keys = _steering_keys(person, given, base, steering.profile)
    together = steering.line == "main"
    driving = usual_addresses(len(driven), units, channels)
    after = max(unit for unit, _ in driving) if together else 0
    left = [unit for unit in units if unit > after] if together else []
    after = max(left, default=after)
    left += range(after + 1, after + 1 + len(steered) - len(left))
    turning = [(unit, min(steering.profile.channels)) for unit in left]
    found = []
    for (name, place), usual in zip(driven.items(), driving, strict=True):
        unit, channel = given.addresses.get(name) or ask_address(person, name, usual)
        # motors that face each other turn opposite directions; spin shows whether these do
        inverted = name.endswith("right")
        found.append(Wheel(name=name, placed={"place": place}, unit=unit, channel=channel,
                           inverted=inverted, more=more))  # fmt: skip
    for (name, place), usual in zip(steered.items(), turning, strict=False):
        unit, channel = given.addresses.get(name) or ask_address(person, name, usual)
        placed = {"place": place, "steers": True}
        found.append(Wheel(name=name, placed=placed, unit=unit, channel=channel, more=keys,
                           line=steering.line, drive=steering.drive))  # fmt: skip
    return tuple(found)


def _joints(
    person: Person, given: Given, base: Mapping[str, Any]
) -> tuple[dict[str, str], dict[str, str]]:
    """Return the joints that drive and the joints that steer, with their places."""
    if base["kind"] == "swerve":
        names = {place.replace("-", "_"): place for place in _modules(person, given)}
        return names, {f"{name}_steering": place for name, place in names.items()}
    steered = base["steered"]
    fixed = ENDS[1 - ENDS.index(steered)]
    driven = given.driven or person.choose(
        f"Which motors drive it? axle: one for both {fixed} wheels. pair: one for each {fixed} "
        f"wheel. steered: those of the steered {steered} wheels.",
        DRIVEN,
    )
    count = given.steering_count or int(
        person.choose(
            "How many drives steer? 1: both wheels by a rod, or a single wheel. 2: one for each.",
            ("1", "2"),
        )
    )
    sides = {"left": f"{steered}-left", "right": f"{steered}-right"}
    steering = {"steering": steered}
    if count == 2:
        steering = {f"{side}_steering": place for side, place in sides.items()}
    if driven == "axle":
        return {"drive": fixed}, steering
    if driven == "pair":
        return {side: f"{fixed}-{side}" for side in sides}, steering
    return ({"drive": steered} if count == 1 else sides), steering


def _modules(person: Person, given: Given) -> tuple[str, ...]:
    """Return the places of the modules. Raises Failed."""
    count = given.wheel_count
    if count is None:
        count = int(
            person.choose(
                "How many modules? 4: one at each corner. 3: one in the middle of the front, two "
                "at the rear corners. 2: front left and rear right.",
                [str(number) for number in MODULES],
            )
        )
    if count not in MODULES:
        raise Failed(f"a swerve base has {min(MODULES)} to {max(MODULES)} modules, not {count}")
    if count < len(PLACES):
        person.show("change place, or write x_m and y_m, where your modules are elsewhere")
    return MODULES[count]


def _steering_keys(
    person: Person, given: Given, base: Mapping[str, Any], profile: DriveProfile
) -> dict[str, Any]:
    swerve = base["kind"] == "swerve"
    most_rad = plausible_number(
        person, given.steering_max_rad,
        "How far does a wheel steer to each side, from straight ahead?"
        + (" A swerve module needs 1.571 (a quarter turn) at least" if swerve else ""),
        "rad", (_SWERVE_LEAST_RAD, math.pi) if swerve else _CAR_USUAL_RAD, (0.05, 100.0),
        lambda value: f"{value:g} rad: {math.degrees(value):.0f} degrees to each side?",
    )  # fmt: skip
    fastest_rad_s = asked(
        person, given.steering_rad_s, "How fast does it steer? 4 is a small servo", "rad/s", 0.05,
        100.0,
    )  # fmt: skip
    ratio = asked(
        person, given.steering_gear_ratio,
        "Turns of its drive for a turn of the wheel about the vertical? 1: direct", "1", 0.001, 1e4,
    )  # fmt: skip
    keys: dict[str, Any] = {
        "position_min_rad": -most_rad, "position_max_rad": most_rad,
        "velocity_max_rad_s": fastest_rad_s,
    }  # fmt: skip
    if ratio != 1.0:
        keys["gear_ratio"] = ratio
    middle = profile.counts_per_turn // 2 if profile.absolute else 0
    zero = middle if given.zero_count is None else given.zero_count
    if profile.counter_bits:
        keys["zero_count"] = zero
    return keys
