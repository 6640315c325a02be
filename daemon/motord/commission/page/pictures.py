# SPDX-License-Identifier: Apache-2.0
"""What was measured, as plots that any user interface can draw: plain values, ready for JSON."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Any, Literal

from motord.commission.spin.procedure import Turned

Plot = dict[str, Any]
"""title, x and y (title and unit), series; `equal`: both axes have one scale. Where it has `bars`,
these are its categories, and there is no x."""
Style = Literal["line", "dashed", "points", "crosses"]


def picture_of_turns(turns: Sequence[Turned]) -> Plot:
    """Of `spin`: the angle that each encoder has counted, and the one that was commanded."""
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
    """Of a plot."""
    return {"title": title, "unit": unit}


def series(title: str, style: Style, x: Iterable[float], y: Iterable[float]) -> dict[str, Any]:
    """Of a plot that has an x."""
    return {"title": title, "style": style, "x": plain(x), "y": plain(y)}


def plain(values: Iterable[float]) -> list[float | None]:
    """JSON has no NaN."""
    return [round(float(value), 6) if math.isfinite(value) else None for value in values]
