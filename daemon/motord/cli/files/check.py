# SPDX-License-Identifier: Apache-2.0
"""`motord check`: list every problem of a robot file at once."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

import click

from motord.cli.common import Exit, json_option, print_json, robot_argument, set_option
from motord.cli.files.check_text import understood_rows
from motord.config import ConfigError, Problem, Robot, load_robot
from motord.config.understood import understood


@click.command
@robot_argument
@set_option
@json_option
def check(robot_file: Path, overrides: tuple[str, ...], as_json: bool) -> None:
    """Check a robot file and print every problem as `file:line: key: problem`.

    A file without a problem is explained: top speed, stopping distance, travel per count, load of
    each line, which sources may command, what stops the drives after kill -9, and defaults in
    force.

    A warning (`file:line: key: warning: ...`) marks a setting that works but is probably not what
    you want. The exit status is 2 if there is a problem and 0 if there is none.

    \b
    Example: motord check robot.toml
             motord check robot.toml --set limits.linear_m_s=0.3
    """
    robot: Robot | None = None
    problems: tuple[Problem, ...] = ()
    try:
        robot = load_robot(robot_file, overrides)
    except ConfigError as error:
        problems = error.problems
    warnings = robot.warnings if robot else ()
    if as_json:
        print_json(
            {
                "ok": robot is not None,
                "file": str(robot_file),
                "robot": robot.robot.name if robot else None,
                "inputs": robot.commanders() if robot else [],
                "understood": asdict(understood(robot)) if robot else None,
                "problems": [asdict(problem) for problem in problems],
                "warnings": [asdict(warning) for warning in warnings],
            }
        )
    else:
        _print(robot_file, robot, problems, warnings)
    if robot is None:
        raise click.exceptions.Exit(Exit.USAGE)


def _print(
    robot_file: Path,
    robot: Robot | None,
    problems: tuple[Problem, ...],
    warnings: tuple[Problem, ...],
) -> None:
    for problem in problems:
        click.echo(str(problem))
    for warning in warnings:
        click.echo(str(warning.as_warning()))
    if robot:
        joints = ", ".join(robot.joint)
        base = "no base" if robot.base.kind == "joints" else f"{robot.base.kind} base"
        click.echo(f"{robot_file}: ok: {robot.robot.name}, {base}, joints {joints}")
        for row in understood_rows(robot):
            click.echo(row)
