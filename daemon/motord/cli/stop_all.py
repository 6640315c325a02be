# SPDX-License-Identifier: Apache-2.0
"""`motord stop-all`: stop the drives of a robot whose daemon has crashed."""

from __future__ import annotations

import asyncio
import contextlib
from dataclasses import asdict
from pathlib import Path

import click

from motord.cli.common import (
    Exit,
    Failure,
    json_option,
    load_or_exit,
    print_json,
    robot_argument,
    set_option,
    usual_option,
)
from motord.config import ConfigError, Robot, load_robot
from motord.daemon.running_file import find, forget
from motord.tools.stop_all import DaemonRuns, Halted
from motord.tools.stop_all import stop_all as stop_everything
from motord_hal.base import bounded
from motord_hal.base.errors import ProfileError

WITHIN_S = 5.0


@click.command("stop-all")
@robot_argument
@set_option
@usual_option(
    "--within-s", click.FloatRange(0.1, 60.0), WITHIN_S,
    "Give up after this time.",
)  # fmt: skip
@json_option
def stop_all(robot_file: Path, overrides: tuple[str, ...], within_s: float, as_json: bool) -> None:
    """Stop every drive of the robot, then power it off once it is at rest.

    Use it after a crash. It opens the lines itself, so it refuses while the daemon runs. It sends
    quick stop, zero and power-off to each drive, even if the drive does not answer. It uses the
    robot file as it was when the daemon started, unless you pass --set. The exit status is 3 if a
    drive did not acknowledge everything. A board that sends nothing and a CAN drive that does not
    report its power get the same stop, but cannot acknowledge it: then the exit status is 3, too.

    \b
    Example: motord stop-all robot.toml
    """
    robot = (None if overrides else _as_it_ran(robot_file)) or load_or_exit(robot_file, overrides)
    try:
        halted = asyncio.run(stop_everything(robot, within_s))
    except ProfileError as error:
        raise Failure(str(error), Exit.USAGE) from error
    except DaemonRuns as error:
        raise Failure(str(error)) from error
    ok = not any(each.problems for each in halted)
    if as_json:
        print_json({"robot": robot.robot.name, "ok": ok, "lines": [asdict(h) for h in halted]})
    else:
        for each in halted:
            _say(each)
    if ok:
        forget(robot_file)
    else:
        raise click.exceptions.Exit(Exit.FAULT)


def _as_it_ran(robot_file: Path) -> Robot | None:
    """Return the robot as its file was when the crashed daemon started. None: no copy was kept."""
    ran = find(robot_file)
    if ran is None:
        return None
    try:
        robot = load_robot(robot_file, ran.overrides, text=ran.text)
    except ConfigError:  # a copy from another version
        return None
    if _now(robot_file) != ran.text.encode():
        click.echo(
            f"{robot_file} has changed since motord started: the stop goes to the drives that it "
            "had then",
            err=True,
        )
    return robot


def _now(robot_file: Path) -> bytes | None:
    with contextlib.suppress(OSError):
        return bounded.read(robot_file)
    return None


def _say(halted: Halted) -> None:
    if not halted.problems:
        joints = ", ".join(halted.joints)
        click.echo(f"{halted.line}: {joints}: stopped and without power", err=True)
    for problem in halted.problems:
        click.echo(f"{halted.line}: {problem}", err=True)
