# SPDX-License-Identifier: Apache-2.0
"""`motord schema`: the JSON Schema of the robot file."""

from __future__ import annotations

import json

import click

from motord.cli.common import json_option, print_json
from motord.config.schema import robot_schema


@click.command
@json_option
def schema(as_json: bool) -> None:
    """Print the JSON Schema of the robot file, with the SI unit of each number, for editors.

    The output is indented; with --json it is on one line.

    \b
    Example: motord schema > robot.schema.json
    """
    if as_json:
        print_json(robot_schema())
    else:
        click.echo(json.dumps(robot_schema(), indent=2, ensure_ascii=False, allow_nan=False))
