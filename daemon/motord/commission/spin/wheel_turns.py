# SPDX-License-Identifier: Apache-2.0
"""Twists by which a base turns one of its wheels. Pure.

A base moves by twists alone, so four mecanum wheels cannot turn one by one. Two twists that turn
the wheel with different partners name it all the same: it is the one that turns both times.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TypeAlias

Vector: TypeAlias = tuple[float, float, float]
RESTS = 1e-6
"""A rim that moves by less than this part of the wheel's rim rests."""
FASTER_MAX = 3.0
"""How much faster than the wheel's rim another one may be."""


@dataclass(frozen=True, slots=True)
class Turn:
    """A twist in which the wheel's rim moves at 1 m/s: m/s, m/s to the left, rad/s; and all joints
    that turn in it."""

    linear: float
    lateral: float
    angular: float
    joints: tuple[str, ...]
    rims: Mapping[str, float]
    """Speed of each rim, m/s."""


def turns_of(rows: Mapping[str, Vector], name: str, *, strafes: bool) -> tuple[Turn, ...]:
    """One twist, or two, in which as few other wheels as possible turn both times; empty: no twist
    turns this wheel. `rows`: speed of each rim by linear, lateral and angular velocity
    (motord.config.sections.bases)."""
    found: dict[tuple[str, ...], Turn] = {}
    for twist in _candidates(rows, name, strafes=strafes):
        turn = _turn(rows, name, twist)
        if turn is not None:
            found.setdefault(turn.joints, turn)
    choices: list[tuple[Turn, ...]] = [(turn,) for turn in found.values()]
    choices += itertools.combinations(found.values(), 2)
    return min(choices, key=_effort, default=())


def together(turns: Sequence[Turn]) -> tuple[str, ...]:
    """The joints that turn every time, the wheel itself among them."""
    return tuple(j for j in turns[0].joints if all(j in turn.joints for turn in turns))


def _effort(turns: tuple[Turn, ...]) -> tuple[int, int, int]:
    return len(together(turns)), len(turns), sum(len(turn.joints) for turn in turns)


def _candidates(rows: Mapping[str, Vector], name: str, *, strafes: bool) -> list[Vector]:
    """Twists in which one other wheel, or two of a base that strafes, rest: what is across their
    rows."""
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
