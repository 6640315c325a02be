# SPDX-License-Identifier: Apache-2.0
"""`motord stop-all`: the drives of a robot whose daemon has died."""

from __future__ import annotations

import asyncio
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
)
from motord.tools.stop_all import DaemonRuns, Halted
from motord.tools.stop_all import stop_all as stop_everything
from motord_hal.errors import ProfileError

WITHIN_S = 5.0


@click.command("stop-all")
@robot_argument
@set_option
@click.option(
    "--within-s", type=click.FloatRange(0.1, 60.0), default=WITHIN_S, show_default=True,
    help="Longest time; what was not said by then is not said.",
)  # fmt: skip
@json_option
def stop_all(robot_file: Path, overrides: tuple[str, ...], within_s: float, as_json: bool) -> None:
    """Tell every drive of the robot to stop, and take its power off when it rests.

    For after a crash: opens the lines itself, so it refuses while the daemon runs. Sends quick
    stop, zero and power off, whatever a drive does not answer. Exit status 3 where a drive did not
    acknowledge all of it.

    \b
    Example: motord stop-all robot.toml
    """
    robot = load_or_exit(robot_file, overrides)
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
    if not ok:
        raise click.exceptions.Exit(Exit.FAULT)


def _say(halted: Halted) -> None:
    if not halted.problems:
        joints = ", ".join(halted.joints)
        click.echo(f"{halted.line}: {joints}: stopped and without power", err=True)
    for problem in halted.problems:
        click.echo(f"{halted.line}: {problem}", err=True)
