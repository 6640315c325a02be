# SPDX-License-Identifier: Apache-2.0
"""The model of a wheel from its answer to steps, and the gains that follow from it. Pure.

Plant: acceleration · dv/dt = u(t − dead time) − viscous · v − static · sign(v), at the wheel, where
u is the output of the speed loop (Lynch & Park, Modern Robotics, 2017, 8.9.1; the dead time as in
Åström & Hägglund, Advanced PID Control, 2006, 2.7): of the first order, with friction. The
parameters are those with the least difference between simulated and measured speed (output error,
Ljung, System Identification, 1999, 3.2 and 10.2: damped Gauss-Newton), so that a coarse encoder
makes no bias. Under a torque a wheel is nearly an integrator: a part that was not measured would
act on the rest of the run. So the simulation starts again, with the measured speed, after each gap.

Gains: Skogestad, Simple analytic rules for model reduction and PID controller tuning, Journal of
Process Control 13, 2003 (SIMC), a PI: gain = time constant / (steady gain · (τc + dead time)),
integral time = min(time constant, 4 (τc + dead time)). τc is the desired time constant of the
closed loop, in dead times: 1 is the "tight" choice of the paper."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from motord.commission.person import Failed

Array = npt.NDArray[np.float64]
HELD_UP = (
    "this computer was held up for too much of the time to see what the wheel does: end other "
    "programs (motord latency --suspects names them) and repeat"
)
Aggressiveness = Literal["gentle", "normal", "brisk"]
CLOSED_LOOP: dict[Aggressiveness, float] = {"gentle": 4.0, "normal": 2.0, "brisk": 1.0}
"""τc, in dead times."""
STEP_S = 0.002
DEAD_TIMES_S = tuple(0.01 * n for n in range(16))
ROUNDS = 25
MISFIT_MAX = 0.12
"""Greatest root mean square of the residuals, as a part of the greatest speed; with a greater one
the model does not fit the wheel."""
TURNED_PART = 0.2
POINTS_MIN = 30
GAP_S, GAP_SAMPLES = 0.05, 3.0
"""A gap: a longer time than GAP_S without a snapshot, or than GAP_SAMPLES usual intervals without a
measure. A program was held up, and what was sent to the wheel meanwhile is unknown."""
AFTER_GAP_S = 0.05
"""Time after a gap in which the wheel may still react to what was sent in it: a dead time."""
PIECE_S = 0.1
"""Least length of a piece; a shorter one shows little more than the speed at its beginning."""
BEGIN_POINTS = 5
SEEN_PART_MIN = 0.3
"""Least part of the time of all runs that has to be measured; less does not determine a wheel."""


@dataclass(frozen=True, slots=True)
class Run:
    """One motion, from rest to rest. Times are in s since its beginning, all on one clock."""

    time_s: Array
    """Times of set-points and outputs."""
    want_rad_s: Array
    output_u: Array
    measured_s: Array
    """Times of the measured speeds."""
    speed_rad_s: Array


@dataclass(frozen=True, slots=True)
class _Piece:
    """The measures between two gaps of a run, and the state in which the piece begins."""

    run: Run
    begin_s: float
    begin_rad_s: float

    @property
    def seconds(self) -> float:
        return float(self.run.measured_s[-1]) - self.begin_s


@dataclass(frozen=True, slots=True, kw_only=True)
class Plant:
    """The model of one wheel; u is N m or 1 (a duty)."""

    acceleration_u_s2_per_rad: float
    viscous_u_s_per_rad: float
    static_u: float
    dead_time_s: float
    misfit_rad_s: float
    sample_s: float
    """Interval between two measures."""

    @property
    def time_constant_s(self) -> float:
        return self.acceleration_u_s2_per_rad / self.viscous_u_s_per_rad

    @property
    def steady_rad_s_per_u(self) -> float:
        return 1.0 / self.viscous_u_s_per_rad


@dataclass(frozen=True, slots=True, kw_only=True)
class Gains:
    """Gains of a PI; the feed-forward gains are those of the plant."""

    gain_u_s_per_rad: float
    integral_u_per_rad: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Response:
    """Quality with which a wheel follows its set-point."""

    error_rad_s: float
    """Root mean square of the error while the wheel is to move."""
    overshoot_rad_s: float
    """How far the speed exceeds the greatest set-point."""
    off_rad_s: float
    """Mean distance from the set-point at the end of each step."""


def gains_of(plant: Plant, aggressiveness: Aggressiveness) -> Gains:
    """Return the gains by SIMC. The dead time counts as one interval of the measure at least."""
    dead_time_s = max(plant.dead_time_s, plant.sample_s)
    reach_s = (1.0 + CLOSED_LOOP[aggressiveness]) * dead_time_s
    gain = plant.acceleration_u_s2_per_rad / reach_s
    integral_s = min(plant.time_constant_s, 4.0 * reach_s)
    return Gains(gain_u_s_per_rad=gain, integral_u_per_rad=gain / integral_s)


def response_of(runs: Sequence[Run]) -> Response:
    """Return how the wheel follows its set-points. Raises Failed if all set-points are zero."""
    errors, beyond, off = [], [0.0], []
    for run in runs:
        want = np.interp(run.measured_s, run.time_s, run.want_rad_s)
        seen = _seen(run)
        moving = seen & (np.abs(want) > 0.0)
        most = float(np.max(np.abs(want), initial=0.0))
        if not moving.any() or most == 0.0:
            continue
        error = want - run.speed_rad_s
        errors.append(error[moving])
        beyond.append(float(np.max(np.abs(run.speed_rad_s[seen]))) - most)
        steady = np.abs(want) > 0.999 * most
        steady = steady & seen if (steady & seen).any() else steady
        off.append(abs(float(np.mean(error[steady][-max(int(steady.sum()) // 3, 1) :]))))
    if not errors:
        raise Failed("the wheel got no set-point: a limit or another program keeps it at rest")
    return Response(
        error_rad_s=float(np.sqrt(np.mean(np.concatenate(errors) ** 2))),
        overshoot_rad_s=max(beyond),
        off_rad_s=float(np.mean(off)),
    )


def identify(name: str, runs: Sequence[Run]) -> Plant:
    """Return the model of the wheel. Raises Failed if the data do not determine it or fit it."""
    points = sum(len(run.measured_s) for run in runs)
    fastest = max((float(np.max(np.abs(run.speed_rad_s), initial=0.0)) for run in runs), default=0)
    wanted = max((float(np.max(np.abs(run.want_rad_s), initial=0.0)) for run in runs), default=0)
    if points < POINTS_MIN or not fastest > TURNED_PART * wanted > 0.0:
        raise Failed(
            f"{name}: turned with {fastest:.2f} of {wanted:.2f} rad/s: charge the battery, let the "
            "wheels turn freely, or allow more speed (--speed-m-s)"
        )
    pieces = [piece for run in runs for piece in _pieces(run)]
    if sum(len(piece.run.measured_s) for piece in pieces) < POINTS_MIN:
        raise Failed(f"{name}: {HELD_UP}")
    parts = [piece.run for piece in pieces]
    start = min((_regressed(parts, dead_s) for dead_s in DEAD_TIMES_S), key=lambda one: one[1])[0]
    found, misfit = _refined(pieces, start)
    acceleration, viscous, static, dead_s = (float(one) for one in found)
    if misfit > MISFIT_MAX * fastest or not (acceleration > 0.0 and viscous > 0.0):
        raise Failed(
            f"{name}: answers as no motor with friction does (off by {misfit:.2f} rad/s): a slope, "
            "a slipping wheel, a sagging battery, or a drive that holds the speed by itself: "
            "repeat on level ground"
        )
    gaps = np.concatenate([np.diff(part.measured_s) for part in parts])
    return Plant(
        acceleration_u_s2_per_rad=acceleration,
        viscous_u_s_per_rad=viscous,
        static_u=max(static, 0.0),
        dead_time_s=max(dead_s, 0.0),
        misfit_rad_s=misfit,
        sample_s=float(np.median(gaps)),
    )


def seen_part(runs: Sequence[Run]) -> float:
    """Return the part of the time of all runs that is between gaps."""
    seen_s = sum(piece.seconds for run in runs for piece in _pieces(run))
    return seen_s / sum(float(run.time_s[-1]) for run in runs)


def _seen(run: Run) -> npt.NDArray[np.bool_]:
    """Return which measures lie outside gaps; if there are no such measures, all."""
    seen = np.zeros(len(run.measured_s), dtype=bool)
    for piece in _pieces(run):
        first_s, last_s = piece.run.measured_s[[0, -1]]
        seen |= (run.measured_s >= first_s) & (run.measured_s <= last_s)
    return seen if seen.any() else ~seen


def _pieces(run: Run) -> list[_Piece]:
    """Return the run without its gaps, and without the time right after them."""
    usual_s = float(np.median(np.diff(run.measured_s)))
    gaps = [
        (float(times_s[n]), float(times_s[n + 1]))
        for times_s, most_s in (
            (run.time_s, GAP_S),
            (run.measured_s, max(GAP_S, GAP_SAMPLES * usual_s)),
        )
        for n in np.flatnonzero(np.diff(times_s) > most_s)
    ]
    found, known_s = [], 0.0
    for begin_s, end_s in [*sorted(gaps), (math.inf, math.inf)]:
        inside = (run.measured_s >= known_s) & (run.measured_s <= begin_s)
        known_s, was_s = max(known_s, end_s + AFTER_GAP_S), known_s
        measured_s, speed_rad_s = run.measured_s[inside], run.speed_rad_s[inside]
        if len(measured_s) < BEGIN_POINTS or measured_s[-1] - measured_s[0] < PIECE_S:
            continue
        part = Run(run.time_s, run.want_rad_s, run.output_u, measured_s, speed_rad_s)
        if was_s == 0.0:
            found.append(_Piece(part, 0.0, 0.0))  # every run begins at rest
            continue
        since_s = measured_s[:BEGIN_POINTS] - measured_s[0]
        slope = np.polyfit(since_s, speed_rad_s[:BEGIN_POINTS], 1)
        found.append(_Piece(part, float(measured_s[0]), float(slope[1])))
    return found


def _regressed(runs: Sequence[Run], dead_s: float) -> tuple[Array, float]:
    """Return first parameters, and their residual, for a given dead time: least squares of the
    integrated equation over windows of some measures."""
    rows, sums = [], []
    for run in runs:
        inputs = _running(run.time_s, run.output_u)
        travel = _running(run.measured_s, run.speed_rad_s)
        rubbing = _running(run.measured_s, np.sign(run.speed_rad_s))
        moved = np.interp(run.measured_s - dead_s, run.time_s, inputs)
        width = 4
        turning = (run.speed_rad_s[width:] != 0.0) & (run.speed_rad_s[:-width] != 0.0)
        columns = (run.speed_rad_s, travel, rubbing)
        rows += [(column[width:] - column[:-width])[turning] for column in columns]
        sums.append((moved[width:] - moved[:-width])[turning])
    design = np.stack([np.concatenate(rows[part::3]) for part in range(3)], axis=1)
    target = np.concatenate(sums)
    if len(target) < POINTS_MIN // 2:
        return np.array([1.0, 1.0, 0.0, dead_s]), math.inf
    found, *_ = np.linalg.lstsq(design, target, rcond=None)
    residual = float(np.sum((target - design @ found) ** 2))
    return np.array([*np.maximum(found, [1e-6, 1e-6, 0.0]), dead_s]), residual


def _running(time_s: Array, values: Array) -> Array:
    """Return the integral from the first sample on, by trapezoids."""
    parts = np.diff(time_s) * (values[1:] + values[:-1]) / 2.0
    return np.concatenate([[0.0], np.cumsum(parts)])


def _refined(pieces: Sequence[_Piece], start: Array) -> tuple[Array, float]:
    """Return the refined parameters and their misfit in rad/s: damped Gauss-Newton
    (Levenberg-Marquardt) on the simulated speeds."""
    found, damping = start, 1e-3
    residual = _residual(pieces, found)
    for _ in range(ROUNDS):
        steps = np.maximum(np.abs(found) * 0.01, [1e-7, 1e-7, 1e-5, 0.001])
        jacobian = np.stack(
            [
                (_residual(pieces, found + np.eye(4)[part] * steps[part]) - residual) / steps[part]
                for part in range(4)
            ],
            axis=1,
        )
        normal = jacobian.T @ jacobian
        change = np.linalg.solve(
            normal + damping * np.diag(np.diag(normal) + 1e-12), -jacobian.T @ residual
        )
        tried = np.maximum(found + change, [1e-6, 1e-6, 0.0, 0.0])
        after = _residual(pieces, tried)
        gained = float(residual @ residual) - float(after @ after)
        if gained <= 0.0:
            damping *= 10.0
            if damping > 1e6:
                break
            continue
        done = gained < 1e-6 * float(residual @ residual)
        found, residual, damping = tried, after, max(damping / 10.0, 1e-6)
        if done:
            break
    return found, math.sqrt(float(residual @ residual) / len(residual))


def _residual(pieces: Sequence[_Piece], plant: Array) -> Array:
    return np.concatenate(
        [
            simulated(piece.run, plant, piece.begin_s, piece.begin_rad_s) - piece.run.speed_rad_s
            for piece in pieces
        ]
    )


def simulated(run: Run, plant: Array, begin_s: float = 0.0, begin_rad_s: float = 0.0) -> Array:
    """Return the simulated speeds at the times of the measures: backward Euler, with friction as
    the impulse that at most brings the wheel to rest (as in the simulator)."""
    acceleration, viscous, static, dead_s = (float(one) for one in plant)
    steps = math.ceil((float(run.measured_s[-1]) - begin_s) / STEP_S) + 2
    moments_s = begin_s + np.arange(steps) * STEP_S
    inputs = np.interp(moments_s - dead_s, run.time_s, run.output_u).tolist()
    drag = 1.0 / (1.0 + STEP_S * viscous / acceleration)
    pushes = STEP_S / acceleration * drag
    held = static * pushes
    speed, speeds = begin_rad_s, []
    for pushed in inputs:
        free = speed * drag + pushed * pushes
        speed = free - held if free > held else free + held if free < -held else 0.0
        speeds.append(speed)
    found: Array = np.interp(run.measured_s, moments_s, speeds)
    return found
