# SPDX-License-Identifier: Apache-2.0
"""Plots of measured values that any user interface can draw: plain values, ready for JSON."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Any, Literal

from motord.commission.spin.procedure import Turned

Plot = dict[str, Any]
"""A plot: title, x and y (title and unit), series; `equal`: both axes have the same scale. With
`bars`, the categories of a bar chart, there is no x."""
Style = Literal["line", "dashed", "points", "crosses"]


def picture_of_turns(turns: Sequence[Turned]) -> Plot:
    """Return a plot of `spin`: the angle that each encoder has counted, and the commanded angle."""
    joints = list(turns[0].counted_rad)
    return {
        "bars": [f"{turned.joint} turns" for turned in turns],
        "title": "Commanded and counted angles",
        "y": axis("angle", "rad"),
        "series": [
            {"title": "commanded", "y": plain(turned.commanded_rad for turned in turns)},
            *(
                {
                    "title": f"counted by {name}",
                    "y": plain(turned.counted_rad[name] for turned in turns),
                }
                for name in joints
            ),
        ],
    }


def axis(title: str, unit: str) -> dict[str, str]:
    """Return an axis of a plot."""
    return {"title": title, "unit": unit}


def series(title: str, style: Style, x: Iterable[float], y: Iterable[float]) -> dict[str, Any]:
    """Return a series of a plot that has an x."""
    return {"title": title, "style": style, "x": plain(x), "y": plain(y)}


def plain(values: Iterable[float]) -> list[float | None]:
    """Return the values rounded, with None for NaN and infinity, which JSON does not have."""
    return [round(float(value), 6) if math.isfinite(value) else None for value in values]
