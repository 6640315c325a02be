# SPDX-License-Identifier: Apache-2.0
"""`motord unit`: print the permissions that the systemd unit of a robot needs."""

from __future__ import annotations

from pathlib import Path

import click

from motord.cli.common import json_option, load_or_exit, print_json, robot_argument, set_option
from motord.tools.unit import devices, drop_in


@click.command
@robot_argument
@set_option
@json_option
def unit(robot_file: Path, overrides: tuple[str, ...], as_json: bool) -> None:
    """Print a drop-in for motord@ROBOT.service that allows only the devices of this robot file.

    Without a drop-in the unit allows every kind of device that motord can use.

    \b
    Example: motord unit robot.toml > robot.conf    (docs/service.md says where it goes)
    """
    robot = load_or_exit(robot_file, overrides)
    if as_json:
        print_json({"robot": robot.robot.name, "devices": devices(robot)})
    else:
        click.echo(drop_in(robot), nl=False)
