# SPDX-License-Identifier: Apache-2.0
"""Write a robot file from answers: commented, without a publisher, as fast as its line carries."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from motord.config import ConfigError, Robot, load_robot
from motord_hal.base.paths import config_dir

CYCLES_HZ = (50.0, 30.0, 20.0, 10.0, 5.0, 3.0, 2.0)
"""Cycle rates to try; the fastest one that the line carries is taken."""
_DECELERATION, _ACCELERATION_S = 1.5, 1.0
"""Deceleration as a multiple of the acceleration, and the time to accelerate to full speed."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Wheel:
    """One joint: its name, the keys of its place on the base, its motor's address, further keys."""

    name: str
    placed: Mapping[str, Any]
    """Keys that place it on the base, such as {"side": "left"}."""
    unit: int
    channel: int
    inverted: bool = False
    line: str = "main"
    drive: str = ""
    """Name of its profile; empty: that of Answers."""
    more: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, kw_only=True)
class Answers:
    """All answers to the questions of `motord init`."""

    name: str
    base: Mapping[str, Any]
    """Keys of the base, kind first."""
    linear_m_s: float
    angular_rad_s: float
    lateral_m_s: float | None
    """None: the base cannot move sideways."""
    line: Mapping[str, Any]
    """Keys of the line, without cycle_hz."""
    drive: str
    wheels: tuple[Wheel, ...]
    other_lines: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    """Keys of each other line, by its name."""


def robot_text(answers: Answers, file: Path) -> tuple[str, Robot]:
    """Return the text of the file and the robot that it describes. Raises ConfigError."""
    problem: ConfigError | None = None
    for cycle_hz in CYCLES_HZ:
        text = _text(answers, cycle_hz)
        try:
            return text, load_robot(file, text=text)
        except ConfigError as error:
            problem = problem or error
    assert problem is not None
    raise problem


def _text(answers: Answers, cycle_hz: float) -> str:
    schema = (config_dir() / "schema" / "robot.schema.json").as_uri()
    three_s = 3.0 / cycle_hz
    parts = [
        f"#:schema {schema}",
        "# Written by motord init. Every key, with unit and range: motord schema",
        f"[robot]\nname = {json.dumps(answers.name)}\n",
        "# Measured on the floor; motord calibrate makes radii and track of two sides exact.",
        "[base]",
        *(_commented(key, value) for key, value in answers.base.items()),
        "",
        "# What the base may do at most. At run time: motord params set, then save.",
        "[limits]",
        *_limits("linear", "m_s", answers.linear_m_s),
        *([] if answers.lateral_m_s is None else _limits("lateral", "m_s", answers.lateral_m_s)),
        *_limits("angular", "rad_s", answers.angular_rad_s),
        "",
        "# When the robot stops by itself.",
        "[safety]",
        "command_timeout_s = 0.3      # an older command is ignored",
        f"feedback_timeout_s = {max(0.25, three_s):g}      # no feedback for this long is a fault",
        f"drive_watchdog_s = {max(0.5, three_s):g}      # the drives stop when motord is gone",
        "",
        *_line("main", answers.line, cycle_hz),
        *(row for name, keys in answers.other_lines.items() for row in _line(name, keys, cycle_hz)),
        "# motord spin --all shows whether unit, channel and inverted are right.",
    ]
    return "\n".join([*parts, *(_joint(answers, wheel) for wheel in answers.wheels)])


def _line(name: str, keys: Mapping[str, Any], cycle_hz: float) -> list[str]:
    return [
        f"[line.{name}]",
        *(f"{key} = {json.dumps(value)}" for key, value in keys.items()),
        f"cycle_hz = {cycle_hz:g}      # cycles of set-points and feedback a second",
        "",
    ]


def _limits(axis: str, unit: str, most: float) -> list[str]:
    acceleration = most / _ACCELERATION_S
    return [
        f"{axis}_{unit} = {most:g}",
        f"{axis}_{unit}2 = {acceleration:g}",
        f"{axis}_deceleration_{unit}2 = {_DECELERATION * acceleration:g}",
    ]


def _joint(answers: Answers, wheel: Wheel) -> str:
    rows = [
        f"[joint.{wheel.name}]",
        f"line = {json.dumps(wheel.line)}",
        f"drive = {json.dumps(wheel.drive or answers.drive)}",
        f"unit = {wheel.unit}",
        f"channel = {wheel.channel}",
        *(f"{key} = {_toml(value)}" for key, value in wheel.placed.items()),
        *(["inverted = true      # it faces the other side"] if wheel.inverted else []),
        *(_commented(key, value) for key, value in wheel.more.items()),
    ]
    return "\n".join([*rows, ""])


_COMMENTS = {
    "wheel_radius_m": "loaded, from axle to floor",
    "track_m": "from middle to middle of the tyres, across",
    "wheelbase_m": "from the front axle to the rear one",
    "radius_m": "from the middle of the base to the wheels",
    "track_slip_factor": "turn ten times on the spot: counted over made turns",
    "steered": "the axle whose wheels are steered",
    "position_min_rad": "to the right, from straight ahead",
    "position_max_rad": "to the left",
    "zero_count": "its counter straight ahead; motord spin --all measures it",
    "rollers": "what the upper rollers form, seen from above",
}


def _commented(key: str, value: Any) -> str:
    comment = f"      # {_COMMENTS[key]}" if key in _COMMENTS else ""
    return f"{key} = {_toml(value)}{comment}"


def _toml(value: Any) -> str:
    if isinstance(value, float):
        return "inf" if value == math.inf else repr(value)
    return json.dumps(value)
