# SPDX-License-Identifier: Apache-2.0
"""`motord schema`: the JSON Schema of the robot file."""

from __future__ import annotations

import json

import click

from motord.config.schema import robot_schema


@click.command
def schema() -> None:
    """JSON Schema of the robot file, each number with its SI unit: for editors.

    \b
    Example: motord schema > robot.schema.json
    """
    click.echo(json.dumps(robot_schema(), indent=2, ensure_ascii=False, allow_nan=False))
