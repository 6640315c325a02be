# SPDX-License-Identifier: Apache-2.0
"""`motord spin`: turn each wheel for the first time."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

import click

from motord.api.procedures import OPTIONS
from motord.cli.common import (
    Exit,
    Failure,
    dry_run_option,
    file_option,
    json_option,
    print_json,
    usual_option,
    yes_option,
)
from motord.cli.complete import joint_names
from motord.cli.running.talk import talking
from motord.client import Client

SPEED, SECONDS = OPTIONS["wheel_rad_s"], OPTIONS["seconds"]


@click.command
@click.argument("joints", metavar="[JOINT]...", nargs=-1, shell_complete=joint_names)
@click.option("--all", "all_joints", is_flag=True, help="Every joint, one after the other.")
@usual_option(
    "--speed-rad-s", click.FloatRange(SPEED.low, SPEED.high), SPEED.usual, "Speed of the wheel."
)
@usual_option(
    "--seconds", click.FloatRange(SECONDS.low, SECONDS.high), SECONDS.usual,
    "How long each wheel turns.",
)  # fmt: skip
@file_option
@yes_option
@dry_run_option
@json_option
@talking
def spin(
    client: Client,
    joints: tuple[str, ...],
    all_joints: bool,
    speed_rad_s: float,
    seconds: float,
    robot_file: Path | None,
    yes: bool,
    dry_run: bool,
    as_json: bool,
) -> None:
    """Turn one wheel at a time, and put its direction and channel right in the robot file.

    The wheels have to be off the ground. The command asks what you saw, compares it with the
    encoders, finds swapped wheels, inverted and unplugged encoders, and offers to write what a
    robot file can correct. Any key, Ctrl-C or the emergency stop brings the wheel to rest and
    disarms the robot. The exit status is 1 if something is wrong and 0 if every wheel is right.

    A base moves as a whole, so some wheels cannot turn alone: a mecanum wheel turns twice, each
    time with another one, and is the wheel that turns both times. What cannot be turned is refused
    before anything is asked.

    On a base with steered wheels all wheels move at once: the command points them straight ahead
    and to the sides, then rolls them. You say where each one points, and what rolls. The command
    puts inverted, zero_count and swapped drives right.

    \b
    Example: motord spin --all
             motord spin left --seconds 1
    """
    if bool(joints) == all_joints:
        raise click.UsageError("name the joints, or give --all")
    from motord.cli.terminal import Terminal, failing
    from motord.commission.robot_file_edit import RobotFileEdit, write_asking
    from motord.commission.spin.findings import findings
    from motord.commission.spin.steered import procedure_for

    with failing(), Terminal(yes=yes) as person:
        described = client.call("robot")
        edit = RobotFileEdit(robot_file or Path(described["file"]))
        names = described["joints"] if all_joints else joints
        procedure = procedure_for(described)
        turns = procedure(client, person, names, speed_rad_s, seconds)
        found = findings(edit.before, turns)
        for text in found.texts:
            person.show(text)
        edit.update(found.changes)
        backup = write_asking(person, edit, dry_run=dry_run) if found.changes else None
    if as_json:
        print_json(
            {
                "good": found.good,
                "turns": [asdict(turned) for turned in turns],
                "findings": found.texts,
                "changes": {".".join(path): value for path, value in found.changes.items()},
                "backup": backup and str(backup),
            }
        )
    if found.good:
        click.echo("every wheel turns as the robot file has it", err=True)
        return
    if backup:
        click.echo("Start the daemon again with the new file, then: motord spin --all", err=True)
    if as_json:
        raise click.exceptions.Exit(Exit.FAILED)
    raise Failure("; ".join(found.texts) if len(found.texts) == 1 else "see above")
