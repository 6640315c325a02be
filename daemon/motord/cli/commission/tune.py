# SPDX-License-Identifier: Apache-2.0
"""`motord tune`: find the gains for the speed loop of a wheel."""

from __future__ import annotations

import math
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from motord.api.procedures import OPTIONS
from motord.base.extras import numpy_missing
from motord.cli.common import (
    Exit,
    Failure,
    dry_run_option,
    file_option,
    json_option,
    plot_option,
    print_json,
    usual_option,
    yes_option,
)
from motord.cli.complete import joint_names
from motord.cli.running.talk import talking
from motord.client import Client

if TYPE_CHECKING:
    from motord.cli.terminal import Terminal
    from motord.commission.tune.procedure import Tuned

SPEED, STEP = OPTIONS["rim_m_s"], OPTIONS["step_s"]


@click.command
@click.argument("joint", shell_complete=joint_names)
@click.option(
    "--aggressiveness", type=click.Choice(["gentle", "normal", "brisk"]), default="normal",
    show_default=True, help="How fast the closed loop is: 4, 2 or 1 dead times of the wheel.",
)  # fmt: skip
@usual_option(
    "--speed-m-s", click.FloatRange(SPEED.low, SPEED.high), SPEED.usual,
    "Speed of the wheel's rim at most.",
)  # fmt: skip
@usual_option(
    "--step-s", click.FloatRange(STEP.low, STEP.high), STEP.usual, "How long each step lasts."
)
@click.option(
    "--current-max-a", type=click.FloatRange(0.0, min_open=True), default=math.inf,
    help="More current of the wheel stops the robot. Default: no bound of this command's own.",
)  # fmt: skip
@file_option
@plot_option("Draw the step before and after. Needs the plot extra.")
@yes_option
@dry_run_option
@json_option
@talking
def tune(client: Client, joint: str, as_json: bool, **options: Any) -> None:
    """Find the gains of a wheel's speed loop, and write the robot file.

    For drives that take a duty (PWM bridges, duty boards) or a torque; other drives hold the speed
    by themselves. The robot drives bounded steps on the floor, forward and back; from the wheel's
    answer the command identifies friction, inertia and dead time, computes the gains (SIMC),
    drives the same steps with them, and shows both. Any key, Ctrl-C or the emergency stop brings
    the robot to rest and disarms it. Gains that are not written are put back.

    \b
    Example: motord tune left
             motord tune left --aggressiveness gentle --plot left.png
    """
    if why := numpy_missing():
        raise Failure(why)
    from motord.cli.terminal import Terminal, failing

    with failing(), Terminal(yes=options["yes"]) as person:
        tuned, backup = _tuned(client, person, joint, options)
    if as_json:
        print_json(
            {
                "joint": joint,
                "plant": asdict(tuned.plant),
                "gains": dict(tuned.gains),
                "before": asdict(tuned.before),
                "after": asdict(tuned.after),
                "better": tuned.better,
                "backup": backup and str(backup),
            }
        )
    if not tuned.better:
        raise click.exceptions.Exit(Exit.FAILED)


def _tuned(
    client: Client, person: Terminal, joint: str, options: dict[str, Any]
) -> tuple[Tuned, Path | None]:
    from motord.commission.page.tune_pictures import plot_responses, sparklines
    from motord.commission.robot_file_edit import RobotFileEdit
    from motord.commission.tune.procedure import Bounds
    from motord.commission.tune.procedure import tune as procedure

    def pictured(tuned: Tuned) -> None:
        for text in sparklines(tuned):
            person.show(text)
        if options["plot"] is not None:
            plot_responses(options["plot"], tuned)
            person.show(f"{options['plot']}: written")

    bounds = Bounds(
        speed_m_s=options["speed_m_s"],
        step_s=options["step_s"],
        current_max_a=options["current_max_a"],
    )
    edit = RobotFileEdit(options["robot_file"] or Path(client.call("robot")["file"]))
    return procedure(
        client, person, edit, joint, bounds, options["aggressiveness"], pictured,
        dry_run=options["dry_run"],
    )  # fmt: skip
