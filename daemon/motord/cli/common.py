# SPDX-License-Identifier: Apache-2.0
"""Common parts of the commands: options, exit statuses, JSON on stdout, problems on stderr."""

from __future__ import annotations

import enum
import json
import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

import click

from motord.cli import INTERRUPTED

if TYPE_CHECKING:
    from motord.config import Robot


class Exit(enum.IntEnum):
    """Exit statuses of every command."""

    DONE = 0
    FAILED = 1
    USAGE = 2
    """Wrong usage, or a file that cannot be used."""
    FAULT = 3
    """A fault is latched, or hardware is missing."""
    INTERRUPTED = INTERRUPTED
    """Ended by Ctrl-C before the command had done its work."""


class Failure(click.ClickException):
    """The failure of a command: `Error: message` on stderr, and the exit status."""

    def __init__(
        self,
        message: str,
        status: Exit = Exit.FAILED,
        result: Mapping[str, Any] | None = None,
    ) -> None:
        """`result`: partial results, which join the error in the one object of --json."""
        super().__init__(message)
        self.result = dict(result or {})
        self.exit_code = int(status)  # type: ignore[misc]  # click reads it from the instance


class _Finite(click.ParamType):  # type: ignore[type-arg]  # generic in newer clicks only
    """A number that is neither NaN nor infinite, and greater than `above`."""

    name = "float"

    def __init__(self, above: float = -math.inf) -> None:
        self._above = above

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> float:
        """Convert a value: see click.ParamType.convert."""
        try:
            number = float(value)
        except ValueError:
            number = math.nan
        if not math.isfinite(number):
            self.fail(f"{value!r} is not a finite number, as 0.3 or -1.", param, ctx)
        if number <= self._above:
            self.fail(f"{value!r} has to be more than {self._above:g}.", param, ctx)
        return number


FINITE = _Finite()
POSITIVE = _Finite(above=0.0)


class BadRobotFile(Failure):
    """The problems of a robot file, one a line."""

    def __init__(self, message: str) -> None:
        super().__init__(message, Exit.USAGE)

    def show(self, file: IO[Any] | None = None) -> None:
        """Print the lines without a prefix, since each names its file."""
        click.echo(self.message, file=file, err=file is None)


robot_argument = click.argument("robot_file", metavar="ROBOT.toml", type=click.Path(path_type=Path))
set_option = click.option(
    "--set",
    "overrides",
    metavar="KEY=VALUE",
    multiple=True,
    help="Override a value of the robot file: limits.linear_m_s=0.3. Repeatable.",
)
json_option = click.option(
    "--json", "as_json", is_flag=True, help="Print one JSON object on stdout."
)

file_option = click.option(
    "--file",
    "robot_file",
    metavar="ROBOT.toml",
    type=click.Path(path_type=Path),
    help="Robot file to change. Default: the one that the daemon uses.",
)
yes_option = click.option("--yes", is_flag=True, help="Answer every yes-or-no question with yes.")
dry_run_option = click.option(
    "--dry-run", is_flag=True, help="Show the difference and write nothing."
)


def usual_option(name: str, kind: Any, usual: Any, text: str) -> Callable[[Any], Any]:
    """Return an option whose help shows the default."""
    return click.option(name, type=kind, default=usual, show_default=True, help=text)


def plot_option(text: str) -> Callable[[Any], Any]:
    """Return the option for a picture of what was measured."""
    kind = click.Path(path_type=Path, dir_okay=False)
    return click.option("--plot", metavar="FILE.png", type=kind, help=text)


def print_json(value: Any) -> None:
    """Print one JSON object on stdout. Raises ValueError for NaN and infinity, which JSON does not
    have: a program error."""
    click.echo(json.dumps(value, ensure_ascii=False, allow_nan=False))


def _to_stderr(text: str) -> None:
    click.echo(text, err=True)


def load_or_exit(
    robot_file: Path,
    overrides: Sequence[str] = (),
    warn: Callable[[str], None] = _to_stderr,
) -> Robot:
    """Load the robot file. Its problems end the command, on stderr; its warnings go to `warn`."""
    from motord.config import ConfigError, load_robot

    try:
        robot = load_robot(robot_file, overrides)
    except ConfigError as error:
        raise BadRobotFile(str(error)) from None
    for warning in robot.warnings:
        warn(str(warning.as_warning()))
    return robot
