# SPDX-License-Identifier: Apache-2.0
"""The summary of a robot file in `motord check`, for a person to read at a glance."""

from __future__ import annotations

import itertools
from collections.abc import Iterator

from motord.cli.status_text import commanders_text
from motord.config import Robot
from motord.config.rules.wiring.times import Reaction, Watchdog
from motord.config.understood import FreeJoint, Understood, Wheel, Wire, understood

KM_H = 3.6
_WIDTH = 14


def understood_rows(robot: Robot) -> Iterator[str]:
    """Return the lines of the summary: a subject, and what follows for it from the file."""
    found = understood(robot)
    base: list[tuple[str, str]] = [
        ("top speed", _speed(found)),
        *_grouped("wheel", ((wheel.joint, _wheel(wheel)) for wheel in found.wheels)),
        ("stops", _stops(found, robot)),
    ]
    rows: list[tuple[str, str]] = [
        *_grouped("joint", ((joint.joint, _joint(joint)) for joint in found.joints)),
        *(() if found.joints else base),
        *((f"line {wire.line}", _wire(wire)) for wire in found.wires),
        ("may command", commanders_text(robot.commanders())),
        *(("reacts after", _reaction(one)) for one in found.reactions),
        *(("kill -9", _watchdog(watchdog)) for watchdog in found.watchdogs),
        *((f"default {name}", _defaults(values)) for name, values in found.defaults.items()),
    ]
    for name, text in rows:
        yield f"{name:{_WIDTH}}  {text}"


def _grouped(what: str, rows: Iterator[tuple[str, str]]) -> Iterator[tuple[str, str]]:
    """Put joints with the same text on one line."""
    for text, group in itertools.groupby(sorted(rows, key=lambda row: row[1]), lambda row: row[1]):
        names = ", ".join(name for name, _ in group)
        yield what if "," not in names else f"{what}s", f"{names}: {text}"


def _speed(found: Understood) -> str:
    return (
        f"{found.top_m_s:.3g} m/s ({found.top_m_s * KM_H:.3g} km/h), "
        f"{found.on_spot_rad_s:.3g} rad/s on the spot"
    )


def _wheel(wheel: Wheel) -> str:
    text = f"radius {wheel.wheel_radius_m * 1e3:.4g} mm, {wheel.velocity_rpm:.3g} rpm at top speed"
    if abs(wheel.motor_rpm - wheel.velocity_rpm) > 1e-6:
        text += f" (motor {wheel.motor_rpm:.4g} rpm)"
    if wheel.travel_per_count_mm is None:
        return f"{text}, no counter"
    return f"{text}, {wheel.travel_per_count_mm:.3g} mm per count"


def _joint(joint: FreeJoint) -> str:
    where = f"{joint.velocity_min_rad_s:.3g} to {joint.velocity_max_rad_s:.3g} rad/s"
    if joint.position_min_rad is not None and joint.position_max_rad is not None:
        where = (
            f"{joint.position_min_rad:.3g} to {joint.position_max_rad:.3g} rad, at "
            f"{joint.velocity_max_rad_s:.3g} rad/s"
        )
    return f"{joint.takes}, {where}, at rest from full speed in {joint.stop_time_s:.2f} s"


def _stops(found: Understood, robot: Robot) -> str:
    return (
        f"from top speed in {found.stop_distance_m:.2f} m ({found.stop_time_s:.2f} s); "
        f"{found.lost_distance_m:.2f} m when commands end "
        f"(noticed after {robot.safety.command_timeout_s:g} s)"
    )


def _wire(wire: Wire) -> str:
    if not wire.share:
        return f"{wire.cycle_hz:g} updates/s"
    carried = f"{wire.most_hz:.0f}/s"
    if wire.least_hz < wire.most_hz:
        carried = f"at most {carried}, and {wire.least_hz:.0f}/s if drives answer at the latest"
    return (
        f"{wire.cycle_hz:g} updates/s are {100 * wire.share:.0f} % of the wire "
        f"(it carries {carried})"
    )


def _watchdog(watchdog: Watchdog) -> str:
    joints = ", ".join(watchdog.joints)
    if not watchdog.known:
        return f"{joints}: UNKNOWN whether {watchdog.drive} stops: {watchdog.note}"
    if watchdog.stops_within_s is None:
        return f"{joints}: NOTHING stops {watchdog.drive}: {watchdog.note}"
    return (
        f"{joints}: {watchdog.drive} stops by itself within {watchdog.stops_within_s:g} s "
        f"({watchdog.note})"
    )


def _reaction(one: Reaction) -> str:
    if one.travel_m is None:
        went = f"{one.turn_rad:.2g} rad of the fastest joint"
    else:
        went = f"{one.travel_m:.2g} m at top speed"
    return f"{one.time_s:g} s ({went}): {one.key}"


def _defaults(values: dict[str, float | str | bool | None]) -> str:
    return ", ".join(f"{key} {_value(value)}" for key, value in values.items())


def _value(value: float | str | bool | None) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, float):
        return f"{value:g}"
    return "inf" if value is None else str(value)
