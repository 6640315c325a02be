# SPDX-License-Identifier: Apache-2.0
"""The guided procedures by name, each with its options, for the command line and the dashboard."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class Option:
    """A number that the person may choose before a procedure begins."""

    title: str
    unit: str
    usual: float
    low: float
    high: float


OPTIONS: Mapping[str, Option] = {
    "wheel_rad_s": Option(title="Speed of the wheel", unit="rad/s", usual=1.5, low=0.1, high=5.0),
    "seconds": Option(title="Time for each wheel", unit="s", usual=2.0, low=0.5, high=10.0),
    "distance_m": Option(title="Length of the line", unit="m", usual=3.0, low=0.1, high=50.0),
    "turns": Option(title="Turns on the spot", unit="1", usual=2.0, low=0.25, high=20.0),
    "side_m": Option(title="Side of the square", unit="m", usual=2.0, low=0.1, high=20.0),
    "speed_m_s": Option(title="Top speed", unit="m/s", usual=0.3, low=0.01, high=5.0),
    "rim_m_s": Option(title="Speed of the rim", unit="m/s", usual=0.3, low=0.02, high=1.0),
    "step_s": Option(title="Time for each step", unit="s", usual=1.5, low=0.5, high=4.0),
    "speed_rad_s": Option(title="Fastest turn", unit="rad/s", usual=0.8, low=0.01, high=10.0),
}
_LINE, _TURN = ("distance_m", "speed_m_s"), ("turns", "speed_rad_s")
_SQUARE = ("side_m", "speed_m_s", "speed_rad_s")
PROCEDURES: Mapping[str, tuple[str, ...]] = {
    "spin": ("wheel_rad_s", "seconds"),
    "straight": _LINE,
    "rotate": _TURN,
    "square": _SQUARE,
    "all": ("distance_m", "turns", *_SQUARE),
    "deadband": ("speed_m_s",),
    "feedforward": ("speed_m_s",),
    "gyro": _TURN,
    "tune": ("rim_m_s", "step_s"),
}
"""The options of `motord spin`, of each kind of `motord calibrate`, and of `motord tune`."""
CALIBRATIONS = tuple(name for name in PROCEDURES if name not in ("spin", "tune"))


def chosen(procedure: str, options: Mapping[str, object]) -> dict[str, float]:
    """Return a value for each option of the procedure: the given one, or the usual one. Raises
    KeyError for an unknown procedure, ValueError for an unknown option or a value out of range."""
    known = PROCEDURES[procedure]
    if unknown := [name for name in options if name not in known]:
        raise ValueError(f"{procedure} has no option {unknown[0]!r:.40}")
    found = {}
    for name in known:
        option, value = OPTIONS[name], options.get(name, OPTIONS[name].usual)
        number = isinstance(value, int | float) and not isinstance(value, bool)
        if not number or not option.low <= value <= option.high:  # type: ignore[operator]
            span = f"{option.low:g} to {option.high:g} {option.unit}"
            raise ValueError(f"{option.title}: {value!r:.40} is not a number from {span}")
        found[name] = float(value)  # type: ignore[arg-type]
    return found
