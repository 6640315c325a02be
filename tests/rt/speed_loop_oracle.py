# SPDX-License-Identifier: Apache-2.0
"""Oracle for the speed loop: the textbook's formulae, for whole runs at once (NumPy).

Feed-forward: friction and inertia (Lynch & Park, Modern Robotics, 2017, 8.9.1). PID with the
derivative of the filtered measure and conditional integration: Åström & Hägglund, Advanced PID
Control, 2006, 3.3 and 3.5.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


CUT_OFF_LEAST = 1e-9


class OnTheEdge(ValueError):
    """Rounding alone decides whether a limit has cut something off, and so whether the integral is
    held."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Gains:
    proportional: float = 0.0
    integral: float = 0.0
    derivative: float = 0.0
    static: float = 0.0
    viscous: float = 0.0
    acceleration: float = 0.0
    filter_s: float = 0.05
    correction_max: float = np.inf
    low: float = -np.inf
    high: float = np.inf


def filtered(measured: Array, filter_s: float, dt_s: float) -> Array:
    """Return `measured` after a low pass of the first order (backward Euler) that has settled on
    the first sample: the convolution with its impulse response."""
    keep = filter_s / (filter_s + dt_s)
    steps = np.arange(len(measured))
    weights = np.tril(keep ** np.clip(steps[:, None] - steps[None, :], 0, None)) * (1.0 - keep)
    return measured[0] + weights @ (measured - measured[0])


def outputs(gains: Gains, want: Array, measured: Array, dt_s: float) -> Array:
    """Return the outputs of a loop whose set-point was 0 before the first sample, while the wheel
    already turned as in that sample. Raise OnTheEdge."""
    rise = np.diff(want, prepend=0.0) / dt_s
    feed = gains.static * np.sign(want) + gains.viscous * want + gains.acceleration * rise
    feed[want == 0.0] = 0.0
    slow = filtered(measured, gains.filter_s, dt_s)
    before = np.concatenate([measured[:1], slow[:-1]])
    slope = (measured - before) / (gains.filter_s + dt_s)
    error = want - measured
    fast = gains.proportional * error - gains.derivative * slope
    found, total = np.empty_like(want), 0.0
    for step in range(len(want)):
        summed = total + gains.integral * error[step] * dt_s
        summed = np.clip(summed, -gains.correction_max, gains.correction_max)
        asked = feed[step] + (fast[step] + summed)
        correction = np.clip(fast[step] + summed, -gains.correction_max, gains.correction_max)
        found[step] = np.clip(feed[step] + correction, gains.low, gains.high)
        cut_off = asked - found[step]
        if 0.0 < abs(cut_off) < CUT_OFF_LEAST:
            raise OnTheEdge
        if cut_off == 0.0 or np.sign(cut_off) != np.sign(error[step]):
            total = summed
    return found
