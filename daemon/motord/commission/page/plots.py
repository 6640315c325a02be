# SPDX-License-Identifier: Apache-2.0
"""Write pictures of measured values to files. Needs the extra `plot`."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from motord.api.geometry_fit import Factors, Fit, Measure
from motord.base.extras import how_to_install
from motord.commission.page.calibration_pictures import path
from motord.commission.person import Failed


@contextlib.contextmanager
def picture(file: Path, rows: int, size_in: tuple[float, float]) -> Iterator[Any]:
    """Return the axes of a new figure, one below the other with a common horizontal axis; write the
    figure to the file at the end. Raises Failed."""
    try:
        import matplotlib as mpl

        mpl.use("Agg")
        from matplotlib import pyplot as plt
    except ImportError as error:
        raise Failed(f"matplotlib is not installed: {how_to_install('plot')}") from error
    figure, axes = plt.subplots(rows, 1, sharex=True, figsize=size_in)
    try:
        yield axes
        figure.savefig(file)
    except OSError as error:
        raise Failed(f"{file}: cannot be written: {error.strerror}") from error
    finally:
        plt.close(figure)


def plot_paths(file: Path, measures: Sequence[Measure], track_m: float, found: Fit) -> None:
    """Draw each path by the geometry before and after, and its measured end. Raises Failed."""
    with picture(file, 1, (7.0, 7.0)) as axes:
        for measure in measures:
            for factors, style in ((Factors(), "--"), (found.factors, "-")):
                x_m, y_m = path(measure, track_m, factors)
                axes.plot(x_m, y_m, style, linewidth=1, label=f"{measure.name} {_WORDS[style]}")
            if math.isfinite(measure.found.x_m):
                axes.plot(measure.found.x_m, measure.found.y_m, "k+", markersize=12)
        axes.set_xlabel("x [m]")
        axes.set_ylabel("y [m]")
        axes.axis("equal")
        if len(measures) <= _NAMED_MAX:
            axes.legend(fontsize=7)


_WORDS = {"--": "before", "-": "after"}
_NAMED_MAX = 8
