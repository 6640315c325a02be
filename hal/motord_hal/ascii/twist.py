# SPDX-License-Identifier: Apache-2.0
"""Conversion of wheel speeds to a base's two speeds and back, for boards that take those.

Source: Siegwart & Nourbakhsh, Autonomous Mobile Robots, 3.2: a differential base.
"""

from __future__ import annotations

from collections.abc import Mapping

from motord_hal.fieldbus.ports import TextSpec

LINEAR, ANGULAR = "v", "w"


def twist_of(spec: TextSpec, wheel_rad_s: Mapping[str, float]) -> dict[str, float]:
    """Return v in m/s and w in rad/s, from the mean rim speed of each side."""
    sides: dict[float, list[float]] = {-1.0: [], 1.0: []}
    for name, wheel in spec.wheels.items():
        sides[wheel.side].append(wheel_rad_s[name] * wheel.radius_m)
    left_m_s, right_m_s = (sum(rims) / len(rims) for rims in (sides[-1.0], sides[1.0]))
    return {
        LINEAR: (left_m_s + right_m_s) / 2.0,
        ANGULAR: (right_m_s - left_m_s) / spec.track_m,
    }


def wheels_of(spec: TextSpec, twist: Mapping[str, float]) -> dict[str, float]:
    """Return joint → rad/s of the wheel."""
    return {
        name: (twist[LINEAR] + wheel.side * twist[ANGULAR] * spec.track_m / 2.0) / wheel.radius_m
        for name, wheel in spec.wheels.items()
    }
