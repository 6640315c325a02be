# SPDX-License-Identifier: Apache-2.0
"""What commands share: options, exit statuses, JSON on stdout, problems on stderr."""

from __future__ import annotations

import enum
import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

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


class Failure(click.ClickException):
    """Ends a command: `Error: message` on stderr, and the exit status."""

    def __init__(self, message: str, status: Exit = Exit.FAILED) -> None:
        super().__init__(message)
        self.exit_code = int(status)  # type: ignore[misc]  # click reads it from the instance


robot_argument = click.argument("robot_file", metavar="ROBOT.toml", type=click.Path(path_type=Path))
set_option = click.option(
    "--set",
    "overrides",
    metavar="KEY=VALUE",
    multiple=True,
    help="Replace a value of the robot file, as in limits.linear_m_s=0.3; may be repeated.",
)
json_option = click.option("--json", "as_json", is_flag=True, help="One JSON object on stdout.")


def print_json(value: Any) -> None:
    """One JSON object on stdout. NaN and infinity are our own mistake: JSON has neither."""
    click.echo(json.dumps(value, ensure_ascii=False, allow_nan=False))


def load_or_exit(robot_file: Path, overrides: Sequence[str] = ()) -> Robot:
    """The robot; its problems go to stderr and end the command, its warnings only go to stderr."""
    from motord.config import ConfigError, load_robot

    try:
        robot = load_robot(robot_file, overrides)
    except ConfigError as error:
        click.echo(str(error), err=True)
        raise click.exceptions.Exit(Exit.USAGE) from None
    for warning in robot.warnings:
        click.echo(str(warning.as_warning()), err=True)
    return robot
