# SPDX-License-Identifier: Apache-2.0
"""`motord move` and `motord turn`: a way that is given, by the odometry (motord.bus.motion). The
command is this program's: when it ends, or hangs, its lease lapses and the robot stops."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from typing import Any

import click

from motord.bus.motion import (
    STOPS_EVERY_S,
    End,
    Goal,
    Motion,
    Wish,
    bounds_of,
    limit_names,
    obstacle,
    planned,
    problem,
)
from motord.cli.common import Exit, Failure, json_option, print_json
from motord.cli.talk import interruptible, talking
from motord.client import Client, Refused
from motord.snapshot import Snapshot
from motord.state_page import NoPage, StatePage

LOOK_EVERY_S = 0.02
STALE_S = 0.5
OWNER = "motord-move"
_UNITS = {"linear": "m", "angular": "rad"}

_timeout = click.option(
    "--timeout-s",
    type=float,
    default=0.0,
    help="Give up after; otherwise after twice what it should take, and 5 s.",
)


def _at_most(unit: str) -> Callable[[Any], Any]:
    return click.option(
        f"--speed-{unit}", "velocity_u_s", type=float, default=0.0,
        help="At most; otherwise the robot's limit.",
    )  # fmt: skip


def _near(unit: str, usual: str) -> Callable[[Any], Any]:
    return click.option(
        f"--tolerance-{unit}", "tolerance_u", type=float, default=0.0,
        help=f"How near is there; otherwise {usual}.",
    )  # fmt: skip


@click.command(context_settings={"ignore_unknown_options": True})
@click.argument("distance_m", metavar="M", type=float)
@_at_most("m-s")
@_near("m", "0.01 m")
@_timeout
@json_option
@talking
def move(client: Client, distance_m: float, as_json: bool, **asked: float) -> None:
    """Drive M metres along the odometry, backwards for a negative number. The robot has to be
    armed. Ctrl-C brings it to rest.

    \b
    Example: motord move 1
             motord move -0.5 --speed-m-s 0.1
    """
    _carry_out(client, Goal(axis="linear", way_u=distance_m, **asked), as_json=as_json)


@click.command(context_settings={"ignore_unknown_options": True})
@click.argument("angle_rad", metavar="RAD", type=float)
@_at_most("rad-s")
@_near("rad", "0.02 rad")
@_timeout
@json_option
@talking
def turn(client: Client, angle_rad: float, as_json: bool, **asked: float) -> None:
    """Turn on the spot by RAD radians (left is positive). The robot has to be armed. Ctrl-C brings
    it to rest.

    \b
    Example: motord turn 1.5708
             motord turn -6.2832 --speed-rad-s 0.5
    """
    _carry_out(client, Goal(axis="angular", way_u=angle_rad, **asked), as_json=as_json)


def _carry_out(client: Client, goal: Goal, *, as_json: bool) -> None:
    limits = client.params_get(*limit_names(goal.axis))
    try:
        plan = planned(goal, bounds_of(goal.axis, limits))
    except ValueError as error:
        raise click.UsageError(str(error)) from error
    begin_s = time.monotonic()
    try:
        before = client.status()
        with StatePage.open(before["robot"]) as page:
            start = _start(page)
            lease = _lease(client)
            now_ns = time.monotonic_ns()
            motion = Motion(
                plan, start, now_ns, lease=lease, stale_s=STALE_S, stops=before["stops"]
            )
            wish = _follow(client, motion, start, page)
    except NoPage as error:
        raise Failure(str(error)) from error
    finally:
        client.release(OWNER)
    _say(motion, wish, time.monotonic() - begin_s, as_json=as_json)
    if wish.end is not End.SUCCEEDED:
        latched = client.status()["state"] in ("fault", "estop")
        raise Failure(wish.why, Exit.FAULT if latched else Exit.FAILED)


def _start(page: StatePage) -> Snapshot:
    """Where it begins. Raises Failure where it may not."""
    start = page.read()
    if start is None:
        raise Failure("there is no state yet")
    why = problem(start, time.monotonic_ns(), STALE_S) or obstacle(start)
    if why is not None:
        raise Failure(why, Exit.FAULT if start.faults else Exit.FAILED)
    return start


def _lease(client: Client) -> int:
    """The number of ours, with a command of zero. Raises Failure where another's counts."""
    answer = client.drive(0.0, 0.0, owner=OWNER)
    if not answer["in_command"]:
        raise Failure(f"{answer['owner']} is in command")
    mine = [lease["number"] for lease in client.status()["leases"] if lease["owner"] == OWNER]
    if not mine:
        raise Failure("the lease has lapsed: this machine is too busy")
    return int(mine[0])


def _follow(client: Client, motion: Motion, newest: Snapshot, page: StatePage) -> Wish:
    due_s = count_s = time.monotonic()
    with interruptible() as interrupts:
        while True:
            if time.monotonic() >= count_s:
                asked_ns, count_s = time.monotonic_ns(), time.monotonic() + STOPS_EVERY_S
                motion.counted(client.status()["stops"], asked_ns)
            newest = page.read() or newest
            if interrupts:
                motion.cancel(time.monotonic_ns())
            wish = motion.step(newest, time.monotonic_ns())
            try:
                client.drive(wish.linear_m_s, wish.angular_rad_s, owner=OWNER)
            except Refused as error:
                return wish if wish.end else Wish(end=End.ABORTED, why=str(error))
            if wish.end is not None:
                return wish
            _progress(motion, newest)
            due_s = max(due_s + LOOK_EVERY_S, time.monotonic())
            time.sleep(max(due_s - time.monotonic(), 0.0))


def _progress(motion: Motion, newest: Snapshot) -> None:
    """One line on a terminal's stderr, written over."""
    if not sys.stderr.isatty():
        return
    unit = _UNITS[motion.plan.axis]
    text = (
        f"{motion.way_u:8.3f} {unit} of {motion.plan.way_u:g}   "
        f"{newest.linear_m_s:6.2f} m/s {newest.angular_rad_s:6.2f} rad/s"
    )
    click.echo(f"\r\033[K{text}", nl=False, err=True)


def _say(motion: Motion, wish: Wish, duration_s: float, *, as_json: bool) -> None:
    assert wish.end is not None
    told: dict[str, Any] = {
        "end": wish.end.value,
        "why": wish.why,
        "distance_m": motion.travel.distance_m,
        "angle_rad": motion.travel.angle_rad,
        "duration_s": duration_s,
    }
    if as_json:
        print_json(told)
        return
    if sys.stderr.isatty():
        click.echo(err=True)
    unit = _UNITS[motion.plan.axis]
    click.echo(f"{wish.end.value}: {motion.way_u:.3f} {unit} in {duration_s:.1f} s")
