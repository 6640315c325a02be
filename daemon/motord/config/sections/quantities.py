# SPDX-License-Identifier: Apache-2.0
"""Keys that are right except for their unit, or that give a diameter where a radius is needed: the
key that is meant, and what its value becomes. A new name alone would change the robot's size."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Conversion:
    """A conversion. `key` is what motord takes; its value is `factor` times the given one, `how` in
    words."""

    key: str
    factor: float
    how: str


_UNITS: dict[str, tuple[str, float]] = {
    "rpm": ("rad_s", 2.0 * math.pi / 60.0),
    "rps": ("rad_s", 2.0 * math.pi),
    "deg_s2": ("rad_s2", math.pi / 180.0),
    "deg_s": ("rad_s", math.pi / 180.0),
    "deg": ("rad", math.pi / 180.0),
    "mm_s": ("m_s", 0.001),
    "cm_s": ("m_s", 0.01),
    "km_h": ("m_s", 1.0 / 3.6),
    "kmh": ("m_s", 1.0 / 3.6),
    "mm": ("m", 0.001),
    "cm": ("m", 0.01),
    "inch": ("m", 0.0254),
    "in": ("m", 0.0254),
    "ms": ("s", 0.001),
    "us": ("s", 1e-6),
    "khz": ("hz", 1000.0),
    "mv": ("v", 0.001),
    "ma": ("a", 0.001),
}
"""Unit at the end of a key → motord's unit, and the factor to it."""


def conversion(key: str, known: Iterable[str]) -> Conversion | None:
    """Return the known key of the same quantity in another unit; None: there is no such key."""
    keys = set(known)
    stem, unit, factor, how = key, "", 1.0, ""
    for ending, (si_unit, per_unit) in _UNITS.items():
        if key.endswith(f"_{ending}"):
            stem, unit, factor = key.removesuffix(ending), si_unit, per_unit
            how = f"multiply by {per_unit:.4g}"
            break
    if "diameter" in stem:
        stem, factor = stem.replace("diameter", "radius"), factor * 0.5
        how = "halve it" if not unit else f"multiply by {factor:.4g}"
    if not how:
        return None
    meant = f"{stem}{unit}"
    if meant in keys:
        return Conversion(meant, factor, how)
    return None
