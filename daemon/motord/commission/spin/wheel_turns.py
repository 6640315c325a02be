# SPDX-License-Identifier: Apache-2.0
"""Twists by which a base turns one of its wheels. Pure.

A base moves by twists alone, so four mecanum wheels cannot turn one by one. Two twists that turn
the wheel with different partners still identify it: it is the one that turns both times."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TypeAlias

Vector: TypeAlias = tuple[float, float, float]
RESTS = 1e-6
"""A rim is at rest if it moves by less than this part of the wheel's rim speed."""
FASTER_MAX = 3.0
"""How many times faster than the wheel's rim another rim may be."""


@dataclass(frozen=True, slots=True)
class Turn:
    """A twist in which the wheel's rim moves at 1 m/s (in m/s, m/s to the left, rad/s), and all
    joints that turn in it."""

    linear: float
    lateral: float
    angular: float
    joints: tuple[str, ...]
    rims: Mapping[str, float]
    """Speed of each rim in m/s."""


def turns_of(rows: Mapping[str, Vector], name: str, *, strafes: bool) -> tuple[Turn, ...]:
    """Return one twist or two, chosen so that as few other wheels as possible turn every time;
    empty: no twist turns this wheel. `rows`: speed of each rim by linear, lateral and angular
    velocity (motord.config.sections.bases)."""
    found: dict[tuple[str, ...], Turn] = {}
    for twist in _candidates(rows, name, strafes=strafes):
        turn = _turn(rows, name, twist)
        if turn is not None:
            found.setdefault(turn.joints, turn)
    choices: list[tuple[Turn, ...]] = [(turn,) for turn in found.values()]
    choices += itertools.combinations(found.values(), 2)
    return min(choices, key=_effort, default=())


def together(turns: Sequence[Turn]) -> tuple[str, ...]:
    """Return the joints that turn every time, including the wheel's own."""
    return tuple(j for j in turns[0].joints if all(j in turn.joints for turn in turns))


def _effort(turns: tuple[Turn, ...]) -> tuple[int, int, int]:
    return len(together(turns)), len(turns), sum(len(turn.joints) for turn in turns)


def _candidates(rows: Mapping[str, Vector], name: str, *, strafes: bool) -> list[Vector]:
    """Return twists in which one other wheel rests, or two of a base that strafes: those orthogonal
    to the rows of these wheels."""
    others = [row for joint, row in rows.items() if joint != name]
    if strafes:
        return [_cross(*two) for two in itertools.combinations(others, 2)]
    return [(-lever, 0.0, x) for x, _, lever in others]


def _turn(rows: Mapping[str, Vector], name: str, twist: Vector) -> Turn | None:
    own = _rim(rows[name], twist)
    if abs(own) < RESTS * max(abs(part) for part in (*twist, 1e-300)):
        return None
    rims = {joint: _rim(row, twist) / own for joint, row in rows.items()}
    if max(abs(rim) for rim in rims.values()) > FASTER_MAX:
        return None
    linear, lateral, angular = (part / own for part in twist)
    joints = tuple(joint for joint, rim in rims.items() if abs(rim) > RESTS)
    return Turn(linear, lateral, angular, joints, rims)


def _rim(row: Vector, twist: Vector) -> float:
    return sum(part * speed for part, speed in zip(row, twist, strict=True))


def _cross(a: Vector, b: Vector) -> Vector:
    return (
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    )
