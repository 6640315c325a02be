# SPDX-License-Identifier: Apache-2.0
"""`motord stop-all`: stop the drives of a robot whose daemon has crashed."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

import click

from motord.api.stop_request import Hang
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
from motord.control.assembly import line_specs
from motord.daemon.running_file import RunningFile, find, forget, of_daemon
from motord.tools.hung_daemon import end, hang_of
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
    "Try again for this time where a line cannot be opened or is lost.",
)  # fmt: skip
@json_option
def stop_all(robot_file: Path, overrides: tuple[str, ...], within_s: float, as_json: bool) -> None:
    """Stop every drive of the robot, then power it off once it is at rest.

    Use it after a crash. It opens the lines itself, so it refuses while the daemon runs; a daemon
    of this robot that hangs (its state page stands still) is ended first. It sends quick stop, zero
    and power-off to each drive, even if the drive does not answer. It uses the
    robot file as it was when the daemon started, unless you pass --set. The exit status is 3 if a
    drive did not acknowledge everything, or a joint that measures its motion was not seen at rest.
    A board that sends nothing and a CAN drive that does not report its power get the same stop, but
    cannot acknowledge it: then the exit status is 3, too.

    \b
    Example: motord stop-all robot.toml
    """
    ran = find(robot_file)
    robot = _as_it_ran(robot_file, ran) if ran and not overrides else None
    robot = robot or load_or_exit(robot_file, overrides)
    try:
        _end_if_hung(robot, ran)
        halted = asyncio.run(stop_everything(robot, within_s, _say_failure))
    except ProfileError as error:
        raise Failure(str(error), Exit.USAGE) from error
    except DaemonRuns as error:
        raise Failure(str(error)) from error
    ok = all(each.confirmed for each in halted)
    if as_json:
        print_json({"robot": robot.robot.name, "ok": ok, "lines": [asdict(h) for h in halted]})
    else:
        say(halted)
    if ok:
        forget(robot_file)
    else:
        raise click.exceptions.Exit(Exit.FAULT)


def _end_if_hung(robot: Robot, ran: RunningFile | None) -> None:
    """End the daemon if it hangs and was started with this robot file: the stop must go to the
    drives that it had. Raises DaemonRuns, and ProfileError before anything is ended."""
    hang = hang_of((ran and ran.robot) or robot.robot.name)
    if hang is None:
        return
    if hang.pid is not None and (ran is None or ran.pid != hang.pid):
        raise DaemonRuns(
            f"{hang}; it was not started with this robot file: motord estop --force --robot "
            f"{hang.robot}"
        )
    _end(hang, robot)


def _end(hang: Hang, robot: Robot) -> None:
    line_specs(robot, robot.profiles)  # raises ProfileError
    end(hang)
    click.echo(f"process {hang.pid} ended; now the stop goes to its drives", err=True)


def force_stop(hang: Hang, folder: Path) -> None:
    """End a daemon that hangs, and stop the drives of the robot file that it was started with.
    `folder`: that of its local socket. Raises Failure."""
    ran = of_daemon(hang.pid or 0, hang.robot, folder)
    if ran is None:
        raise Failure(
            f"{hang}; its robot file is not known: end that process, then motord stop-all "
            "ROBOT.toml"
        )
    try:
        robot = load_robot(Path(ran.file), ran.overrides, text=ran.text)
        _end(hang, robot)
        halted = asyncio.run(stop_everything(robot, WITHIN_S))
    except (ConfigError, ProfileError) as error:
        raise Failure(str(error), Exit.USAGE) from error
    except DaemonRuns as error:
        raise Failure(str(error)) from error
    say(halted)
    if problems := [text for each in halted if not each.confirmed for text in _doubts(each)]:
        raise Failure(f"{hang.robot}: {'; '.join(problems)}", Exit.FAULT)
    forget(Path(ran.file))


def _as_it_ran(robot_file: Path, ran: RunningFile) -> Robot | None:
    """Return the robot as its file was when the crashed daemon started. None: another version kept
    the copy."""
    try:
        robot = load_robot(robot_file, ran.overrides, text=ran.text)
    except ConfigError:
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


def _say_failure(text: str) -> None:
    click.echo(f"{text}: trying again", err=True)


def say(halted: Sequence[Halted]) -> None:
    """Show the result for each line."""
    for each in halted:
        if not each.problems:
            joints, stopped = ", ".join(each.joints), "" if each.rest_text else "stopped and "
            click.echo(f"{each.line}: {joints}: {stopped}without power", err=True)
        for text in _doubts(each):
            click.echo(f"{each.line}: {text}", err=True)


def _doubts(halted: Halted) -> list[str]:
    """Return what a person has to know about one line; empty: it is at rest, without power."""
    return [*halted.problems, *filter(None, (halted.rest_text,))]
