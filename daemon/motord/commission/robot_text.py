# SPDX-License-Identifier: Apache-2.0
"""A robot file from answers: commented, without a publisher, as fast as its line carries."""

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
"""The fastest that the line carries is taken."""
_DECELERATION, _ACCELERATION_S = 1.5, 1.0
"""Braking is harder than speeding up, which takes a second to full speed."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Wheel:
    """One joint: name, side, where its motor is, and further keys."""

    name: str
    side: str
    unit: int
    channel: int
    inverted: bool
    more: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, kw_only=True)
class Answers:
    """All that `motord init` asks."""

    name: str
    base: str
    wheel_radius_m: float
    track_m: float
    linear_m_s: float
    angular_rad_s: float
    line: Mapping[str, Any]
    """Keys of the line, but for cycle_hz."""
    drive: str
    wheels: tuple[Wheel, ...]


def robot_text(answers: Answers, file: Path) -> tuple[str, Robot]:
    """The text of the file, and the robot that it describes. Raises ConfigError."""
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
    slip = ["track_slip_factor = 1.5      # turn ten times on the spot: counted over made turns"]
    three_s = 3.0 / cycle_hz
    parts = [
        f"#:schema {schema}",
        "# Written by motord init. Every key, with unit and range: motord schema",
        f"[robot]\nname = {json.dumps(answers.name)}\n",
        "# Measure both on the floor; motord calibrate makes them exact.",
        "[base]",
        f"kind = {json.dumps(answers.base)}",
        f"wheel_radius_m = {answers.wheel_radius_m:g}      # loaded, from axle to floor",
        f"track_m = {answers.track_m:g}      # from middle to middle of the tyres",
        *(slip if answers.base == "skid" else []),
        "",
        "# What the base may do at most. At run time: motord params set, then save.",
        "[limits]",
        *_limits("linear", "m_s", answers.linear_m_s),
        *_limits("angular", "rad_s", answers.angular_rad_s),
        "",
        "# When the robot stops by itself.",
        "[safety]",
        "command_timeout_s = 0.3      # an older command is ignored",
        f"feedback_timeout_s = {max(0.25, three_s):g}      # no feedback for so long is a fault",
        f"drive_watchdog_s = {max(0.5, three_s):g}      # the drives stop when motord is gone",
        "",
        "[line.main]",
        *(f"{key} = {json.dumps(value)}" for key, value in answers.line.items()),
        f"cycle_hz = {cycle_hz:g}      # set-points and feedback, so often a second",
        "",
        "# motord spin --all shows whether unit, channel and inverted are right.",
    ]
    return "\n".join([*parts, *(_joint(answers, wheel) for wheel in answers.wheels)])


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
        'line = "main"',
        f"drive = {json.dumps(answers.drive)}",
        f"unit = {wheel.unit}",
        f"channel = {wheel.channel}",
        f"side = {json.dumps(wheel.side)}",
        *(["inverted = true      # it faces the other side"] if wheel.inverted else []),
        *(f"{key} = {_toml(value)}" for key, value in wheel.more.items()),
    ]
    return "\n".join([*rows, ""])


def _toml(value: Any) -> str:
    if isinstance(value, float):
        return "inf" if value == math.inf else repr(value)
    return json.dumps(value)
