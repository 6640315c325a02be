# SPDX-License-Identifier: Apache-2.0
"""The reader of a profile's [bridge]: which level each pin has in each mode."""

from __future__ import annotations

from motord_hal.drives.profile import BRIDGE_MODES, Bridge
from motord_hal.drives.toml_table import Table

_WORDS = {"low": (0.0, 0.0), "high": (1.0, 0.0), "duty": (0.0, 1.0), "inverse": (1.0, -1.0)}


def read_bridge(root: Table) -> Bridge:
    """[bridge]: carrier and rest; [bridge.MODE]: PIN = "low", "high", "duty" (as much of the period
    as the duty), "inverse" (the rest of it), or { base, slope } of the level."""
    table = root.table("bridge")
    levels: dict[str, dict[str, tuple[float, float]]] = {}
    for mode in BRIDGE_MODES:
        pins = table.table(mode)
        for pin in pins:
            levels.setdefault(pin, {})[mode] = _level(pins, pin)
        pins.finish()
    bridge = Bridge(
        pwm_hz=table.number("pwm_hz", 10.0, 1e6, 20000.0, unit="Hz"),
        pwm_min_hz=table.number("pwm_min_hz", 10.0, 1e6, 10.0, unit="Hz"),
        pwm_max_hz=table.number("pwm_max_hz", 10.0, 1e6, unit="Hz"),
        rest=table.text("rest", "brake", choices=("brake", "coast")),
        levels=levels,
    )
    table.finish()
    for pin, modes in levels.items():
        missing = [mode for mode in BRIDGE_MODES if mode not in modes]
        if missing:
            root.complain("bridge", f'pin "{pin}" has no level in {", ".join(missing)}')
    _check_alone(root, bridge)
    if not bridge.pwm_min_hz <= bridge.pwm_hz <= bridge.pwm_max_hz:
        root.complain("bridge", "pwm_hz is not within pwm_min_hz and pwm_max_hz")
    return bridge


def _check_alone(root: Table, bridge: Bridge) -> None:
    """Two channels cannot be written at once, and a write can fail: of those that give no power
    when they are low, none may count on another one to take its power back."""
    pins = [
        pin
        for pin, modes in bridge.levels.items()
        if bridge.needs_pwm(pin) and modes.get("coast") == (0.0, 0.0)
    ]
    for mode in BRIDGE_MODES:
        levels = {pin: bridge.levels[pin].get(mode, (0.0, 0.0)) for pin in pins}
        up = [pin for pin, (base, slope) in levels.items() if max(base, base + slope) > 0.0]
        if len(up) > 1:
            root.complain(
                f"bridge.{mode}",
                f'PWM pins "{up[0]}" and "{up[1]}" are both above low: they are written one after '
                "the other, and with one of them alone the motor may have full power one way",
            )


def _level(pins: Table, pin: str) -> tuple[float, float]:
    if pins.is_table(pin):
        table = pins.table(pin)
        base, slope = table.number("base", 0.0, 1.0), table.number("slope", -1.0, 1.0, 0.0)
        table.finish()
        if not 0.0 <= base + slope <= 1.0:
            pins.complain(pin, "base + slope is not within 0 and 1")
        return base, slope
    return _WORDS.get(pins.text(pin, choices=tuple(_WORDS)), (0.0, 0.0))
