# SPDX-License-Identifier: Apache-2.0
"""`motord schema`: print the JSON Schemas of the robot file and of drive profiles."""

from __future__ import annotations

import json

import click

from motord.cli.common import json_option, print_json
from motord.config.schema import drive_schema, robot_schema


@click.command
@click.argument("file", type=click.Choice(["robot", "drive"]), default="robot")
@json_option
def schema(file: str, as_json: bool) -> None:
    """Print the JSON Schema of the robot file, or of drive profiles, for editors.

    It has the unit of each number.

    The output is indented; with --json it is on one line.

    \b
    Example: motord schema > robot.schema.json
             motord schema drive > drive.schema.json
    """
    found = drive_schema() if file == "drive" else robot_schema()
    if as_json:
        print_json(found)
    else:
        click.echo(json.dumps(found, indent=2, ensure_ascii=False, allow_nan=False))
