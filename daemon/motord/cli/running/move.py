# SPDX-License-Identifier: Apache-2.0
"""`motord move` and `motord turn`: drive a distance or turn by an angle, measured by the odometry
(motord.api.moving)."""

from __future__ import annotations

import contextlib
import math
import sys
from collections.abc import Callable, Mapping
from dataclasses import asdict
from typing import Any

import click

from motord.api.motion import Goal, Motion
from motord.api.moving import Moved, MoveFailed
from motord.api.snapshot import Snapshot
from motord.cli.common import FINITE, POSITIVE, Exit, Failure, json_option, print_json
from motord.cli.running.talk import interruptible, status_of_refusal, talking
from motord.client import Client

OWNER = "motord-move"
_UNITS = {"linear": "m", "angular": "rad"}

_timeout = click.option(
    "--timeout-s",
    type=POSITIVE,
    help="Give up after this time. Default: twice the expected time, plus 5 s.",
)


def _at_most(unit: str) -> Callable[[Any], Any]:
    return click.option(
        f"--speed-{unit}", "velocity_u_s", type=POSITIVE,
        help="Maximum speed. Default: the robot's limit.",
    )  # fmt: skip


def _near(unit: str, usual: str) -> Callable[[Any], Any]:
    return click.option(
        f"--tolerance-{unit}", "tolerance_u", type=POSITIVE,
        help=f"Accepted distance to the goal. Default: {usual}.",
    )  # fmt: skip


@click.command(context_settings={"ignore_unknown_options": True})
@click.argument("distance_m", metavar="M", type=FINITE)
@click.option(
    "--direction-rad",
    type=FINITE,
    help="Where to, on a mecanum, omni or swerve base: 0 is forward, positive is left. Default: 0.",
)
@_at_most("m-s")
@_near("m", "0.01 m")
@_timeout
@json_option
@talking
def move(client: Client, distance_m: float, as_json: bool, **asked: float | None) -> None:
    """Drive M metres by odometry; a negative number drives backwards.

    The robot must be armed. Ctrl-C brings it to rest.

    \b
    Example: motord move 1
             motord move -0.5 --speed-m-s 0.1
             motord move 0.3 --direction-rad 1.5708
    """
    _carry_out(client, Goal(axis="linear", distance_u=distance_m, **_given(asked)), as_json=as_json)


@click.command(context_settings={"ignore_unknown_options": True})
@click.argument("angle_rad", metavar="RAD", type=FINITE)
@_at_most("rad-s")
@_near("rad", "0.02 rad")
@_timeout
@json_option
@talking
def turn(client: Client, angle_rad: float, as_json: bool, **asked: float | None) -> None:
    """Turn on the spot by RAD radians; positive is left.

    The robot must be armed. Ctrl-C brings it to rest.

    \b
    Example: motord turn 1.5708
             motord turn -6.2832 --speed-rad-s 0.5
    """
    _carry_out(client, Goal(axis="angular", distance_u=angle_rad, **_given(asked)), as_json=as_json)


def _given(asked: Mapping[str, float | None]) -> dict[str, float]:
    """Return the options that were given."""
    return {name: value for name, value in asked.items() if value is not None}


def _carry_out(client: Client, goal: Goal, *, as_json: bool) -> None:
    try:
        with interruptible() as interrupts, contextlib.closing(_Display(goal)) as display:
            moved = client.carry_out(
                goal, owner=OWNER, watch=display, canceled=lambda: bool(interrupts)
            )
    except ValueError as error:
        raise click.UsageError(str(error)) from error
    except MoveFailed as error:
        if error.moved is not None and not as_json:
            click.echo(_words(goal, error.moved))
        if error.latched:
            status = Exit.FAULT
        else:
            status = Exit.INTERRUPTED if interrupts else status_of_refusal(client)
        result = _plain(error.moved) if error.moved else None
        raise Failure(str(error), status, result) from error
    if as_json:
        print_json(_plain(moved))
    else:
        click.echo(_words(goal, moved))


class _Display:
    """Progress on a terminal: one line with the distance so far, which is overwritten and which
    `close` ends."""

    def __init__(self, goal: Goal) -> None:
        self._unit = _UNITS[goal.axis]
        self._began = False

    def __call__(self, motion: Motion, newest: Snapshot) -> None:
        self._began = True
        if not sys.stderr.isatty():
            return
        text = (
            f"{motion.distance_u:8.3f} {self._unit} of {motion.plan.distance_u:g}   "
            + ("speed not known" if math.isnan(newest.linear_m_s) else
               f"{newest.linear_m_s:6.2f} m/s {newest.angular_rad_s:6.2f} rad/s")
        )  # fmt: skip
        click.echo(f"\r\033[K{text}", nl=False, err=True)

    def close(self) -> None:
        if self._began and sys.stderr.isatty():
            click.echo(err=True)


def _plain(moved: Moved) -> dict[str, Any]:
    return {**asdict(moved), "end": moved.end.value}


def _words(goal: Goal, moved: Moved) -> str:
    distance_u = moved.distance_m if goal.axis == "linear" else moved.angle_rad
    return f"{moved.end.value}: {distance_u:.3f} {_UNITS[goal.axis]} in {moved.duration_s:.1f} s"
