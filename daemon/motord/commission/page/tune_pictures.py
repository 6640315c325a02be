# SPDX-License-Identifier: Apache-2.0
"""Step responses before and after: as a picture, which needs the extra `plot`, as plots for a user
interface, or as a line of text."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from motord.commission.page.pictures import Plot, axis, series
from motord.commission.page.plots import picture
from motord.commission.tune.fit import Run, simulated
from motord.commission.tune.procedure import Tuned

BARS = "▁▂▃▄▅▆▇█"
COLUMNS = 60


def plot_responses(file: Path, tuned: Tuned) -> None:
    """Draw the fastest step, before and after. Raises Failed."""
    with picture(file, 2, (8.0, 6.0)) as (speed, output):
        for runs, name, style in (
            (tuned.before_runs, "before", "--"),
            (tuned.after_runs, "after", "-"),
        ):
            run = _fastest(runs)
            speed.plot(run.measured_s, run.speed_rad_s, style, linewidth=1, label=name)
            output.plot(run.time_s, run.output_u, style, linewidth=1, label=name)
        run = _fastest(tuned.after_runs)
        speed.plot(run.time_s, run.want_rad_s, "k:", linewidth=1, label="set-point")
        speed.set_ylabel(f"{tuned.joint} [rad/s]")
        output.set_ylabel("output [1 or N·m]")
        output.set_xlabel("time [s]")
        speed.legend(fontsize=8)


def pictures_of_steps(tuned: Tuned) -> Iterator[Plot]:
    """Return plots of the fastest step before and after, and of the error of the model."""
    before, after = _fastest(tuned.before_runs), _fastest(tuned.after_runs)
    time, speed = axis("time", "s"), axis("speed of the wheel", "rad/s")
    yield {
        "title": f"A step of {tuned.joint}, before and after", "x": time, "y": speed,
        "series": [
            series("set-point", "dashed", after.time_s, after.want_rad_s),
            series("before", "line", before.measured_s, before.speed_rad_s),
            series("after", "line", after.measured_s, after.speed_rad_s),
        ],
    }  # fmt: skip
    plant = tuned.plant
    model = np.array(
        [
            plant.acceleration_u_s2_per_rad,
            plant.viscous_u_s_per_rad,
            plant.static_u,
            plant.dead_time_s,
        ]
    )
    off_rad_s = after.speed_rad_s - simulated(after, model)
    yield {
        "title": "Measured minus the identified wheel, after", "x": time,
        "y": axis("left over", "rad/s"),
        "series": [series("left over", "points", after.measured_s, off_rad_s)],
    }  # fmt: skip


def sparklines(tuned: Tuned) -> list[str]:
    """Return the fastest step as text: set-point, before, after; all on one scale."""
    before, after = _fastest(tuned.before_runs), _fastest(tuned.after_runs)
    rows = {
        "set-point": (after.time_s, after.want_rad_s),
        "before": (before.measured_s, before.speed_rad_s),
        "after": (after.measured_s, after.speed_rad_s),
    }
    end_s = min(float(times_s[-1]) for times_s, _ in rows.values())
    most = max(float(np.max(speeds)) for _, speeds in rows.values())
    moments_s = np.linspace(0.0, end_s, COLUMNS)
    found = []
    for name, (times_s, speeds) in rows.items():
        heights = np.interp(moments_s, times_s, np.maximum(speeds, 0.0)) / (most or 1.0)
        bars = "".join(BARS[min(int(height * len(BARS)), len(BARS) - 1)] for height in heights)
        found.append(f"{name:>9} {bars}")
    return found


def _fastest(runs: tuple[Run, ...]) -> Run:
    return max(runs, key=lambda run: float(np.max(run.want_rad_s)))
