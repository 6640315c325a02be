# SPDX-License-Identifier: Apache-2.0
"""A profile's [bridge]: which level each pin has in each mode."""

from __future__ import annotations

from motord.config.drives.problems import Problems
from motord.config.drives.tables import LevelLine, MotorBridge
from motord_hal.drives.profile import BRIDGE_MODES, Bridge

_WORDS = {"low": (0.0, 0.0), "high": (1.0, 0.0), "duty": (0.0, 1.0), "inverse": (1.0, -1.0)}
"""(base, slope): "duty" is high for as much of the period as the duty, "inverse" for the rest."""


def bridge_of(table: MotorBridge, problems: Problems) -> Bridge:
    """Return the bridge; add every problem that its parts have with each other."""
    levels: dict[str, dict[str, tuple[float, float]]] = {}
    for mode in BRIDGE_MODES:
        for pin, level in getattr(table, mode).items():
            levels.setdefault(pin, {})[mode] = _level(level, f"bridge.{mode}.{pin}", problems)
    bridge = Bridge(
        pwm_hz=table.pwm_hz,
        pwm_min_hz=table.pwm_min_hz,
        pwm_max_hz=table.pwm_max_hz,
        rest=table.rest,
        levels=levels,
    )
    for pin, modes in levels.items():
        missing = [mode for mode in BRIDGE_MODES if mode not in modes]
        if missing:
            problems.add("bridge", f'pin "{pin}" has no level in {", ".join(missing)}')
    _check_alone(bridge, problems)
    if not bridge.pwm_min_hz <= bridge.pwm_hz <= bridge.pwm_max_hz:
        problems.add("bridge", "pwm_hz is not within pwm_min_hz and pwm_max_hz")
    return bridge


def _check_alone(bridge: Bridge, problems: Problems) -> None:
    """Check that a failed write gives no power. Two channels cannot be written at once, and a write
    can fail: of the pins that give no power when they are low, only one may be above low in a
    mode."""
    pins = [
        pin
        for pin, modes in bridge.levels.items()
        if bridge.needs_pwm(pin) and modes.get("coast") == (0.0, 0.0)
    ]
    for mode in BRIDGE_MODES:
        levels = {pin: bridge.levels[pin].get(mode, (0.0, 0.0)) for pin in pins}
        up = [pin for pin, (base, slope) in levels.items() if max(base, base + slope) > 0.0]
        if len(up) > 1:
            problems.add(
                f"bridge.{mode}",
                f'PWM pins "{up[0]}" and "{up[1]}" are both above low: they are written one after '
                "the other, and one of them alone may give the motor full power in one direction",
            )


def _level(level: str | LevelLine, key: str, problems: Problems) -> tuple[float, float]:
    if isinstance(level, str):
        return _WORDS[level]
    if not 0.0 <= level.base + level.slope <= 1.0:
        problems.add(key, "base + slope is not within 0 and 1")
    return level.base, level.slope
