# SPDX-License-Identifier: Apache-2.0
"""`motord init`: make a robot file for the connected drives."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Any

import click

from motord.cli.common import POSITIVE, dry_run_option, json_option, print_json, usual_option

KINDS = ("differential", "skid", "mecanum", "omni", "ackermann", "tricycle", "swerve")


@click.command
@click.argument("robot_file", metavar="ROBOT.toml", type=click.Path(path_type=Path))
@click.option("--name", help="The robot's name. Default: that of the file.")
@click.option(
    "--at", "place", metavar="PLACE",
    help="Serial port (a path or usb:SERIAL), CAN interface (can0, or KIND:CHANNEL), or simulated.",
)  # fmt: skip
@click.option("--drive", help="Drive profile (motord drives).")
@click.option(
    "--base", type=click.Choice(KINDS),
    help="Casters that follow, wheels that scrub, wheels with rollers, or steered wheels.",
)  # fmt: skip
@click.option("--wheel-radius-m", type=POSITIVE, help="Radius of the loaded wheel.")
@click.option("--track-m", type=POSITIVE, help="From the left wheels to the right ones.")
@click.option("--wheelbase-m", type=POSITIVE, help="From the front axle to the rear one.")
@click.option("--radius-m", type=POSITIVE, help="Omni: from the middle of the base to a wheel.")
@click.option(
    "--wheel-count", type=click.IntRange(2, 8), help="Omni: number of wheels. Swerve: of modules."
)
@click.option("--linear-m-s", type=POSITIVE, help="Top speed.")
@click.option("--lateral-m-s", type=POSITIVE, help="Top speed sideways (mecanum, omni, swerve).")
@click.option("--angular-rad-s", type=POSITIVE, help="Fastest turn.")
@click.option("--gear-ratio", type=POSITIVE, help="Motor turns for a wheel turn.")
@click.option(
    "--counts-per-turn", type=click.IntRange(0, 1 << 30), help="Encoder counts for a motor turn."
)
@click.option("--full-duty-rad-s", type=POSITIVE, help="A wheel's speed at full duty.")
@click.option(
    "--baudrate", type=click.IntRange(300, 4_500_000), help="Baud rate, or bit rate of CAN."
)
@click.option("--parity", type=click.Choice(["none", "even", "odd"]), help="Of a serial port.")
@click.option("--left", metavar="UNIT[.CHANNEL]", help="Drive of the left wheel.")
@click.option("--right", metavar="UNIT[.CHANNEL]", help="Drive of the right wheel.")
@click.option(
    "--unit", "addresses", metavar="WHEEL=UNIT[.CHANNEL]", multiple=True,
    help="Drive of a wheel, such as front_left=1.2 or wheel_1=3. Repeatable.",
)  # fmt: skip
@click.option("--steered", type=click.Choice(["front", "rear"]), help="Of a car: the axle.")
@click.option(
    "--driven", type=click.Choice(["axle", "pair", "steered"]),
    help="Of a car: one motor for the fixed axle, one for each of its wheels, or those of the "
    "steered wheels.",
)  # fmt: skip
@click.option(
    "--steering-count", type=click.IntRange(1, 2), help="Of a car: how many drives steer."
)
@click.option("--steering-drive", help="Drive profile of the drives that steer.")
@click.option(
    "--steering-at", "steering_place", metavar="PLACE",
    help="Where they are connected: as --at, or same.",
)  # fmt: skip
@click.option("--steering-max-rad", type=POSITIVE, help="How far a wheel steers to each side.")
@click.option("--steering-rad-s", type=POSITIVE, help="How fast it steers.")
@click.option(
    "--steering-gear-ratio", type=POSITIVE, help="Its drive's turns for one of the wheel."
)
@click.option("--zero-count", type=int, help="What its counter shows straight ahead.")
@click.option("--scan/--no-scan", default=True, help="Look for drives on a port or CAN bus.")
@usual_option("--scan-within-s", POSITIVE, 60.0, "End the scan of a serial port after this time.")
@dry_run_option
@json_option
def init(robot_file: Path, dry_run: bool, as_json: bool, **options: Any) -> None:
    """Find the drives, ask what cannot be found, and write a robot file with comments.

    Every question has an option, so a script can answer them all. A scan only reads; on a CAN bus
    it listens first. The file is not written if it is there already or would not pass motord check.

    Bridges and servos on pins, and drives that take a torque, need more answers than this asks:
    print the nearest example, change its pins and sizes, and check it (last two lines).

    \b
    Example: motord init robot.toml
             motord init robot.toml --at simulated --drive zlac8015d --base differential
             motord init robot.toml --at can0 --base mecanum
             motord init car.toml --base ackermann --steering-drive sts3215-position
             motord robots pi5-bts7960 > robot.toml
             motord check robot.toml
    """
    from motord.cli.files.check_text import understood_rows
    from motord.cli.terminal import Terminal, failing
    from motord.commission.robot_file_edit import EditError, write_new
    from motord.commission.setup.procedure import Given, set_up, simulated_ports, unit_and_channel
    from motord.commission.setup.robot_text import robot_text

    with failing(), Terminal() as person:
        if robot_file.exists():
            raise EditError(f"{robot_file}: is there already: name another file")
        for side in ("left", "right"):
            if options[side] is not None:
                options[side] = unit_and_channel(options[side])
        options["addresses"] = {
            name: unit_and_channel(address)
            for name, _, address in (one.partition("=") for one in options["addresses"])
        }
        answers = set_up(person, Given(**options), robot_file)
        text, robot = robot_text(answers, robot_file)
        if not dry_run:
            write_new(robot_file, text.encode())
    if as_json:
        written = None if dry_run else str(robot_file)
        print_json({"file": written, "robot": answers.name, "drive": answers.drive, "text": text})
        return
    if dry_run:
        click.echo(text)
        return
    for warning in robot.warnings:
        click.echo(str(warning.as_warning()))
    click.echo(f"{robot_file}: written")
    for row in understood_rows(robot):
        click.echo(row)
    name = shlex.quote(str(robot_file))
    ports = shlex.quote(str(simulated_ports(robot_file)))
    port = answers.line.get("port", answers.line.get("channel", ""))
    if port.startswith(str(simulated_ports(robot_file))):
        click.echo(f"Next, in another terminal: motord simulate {name} --link-dir {ports}")
    what = "all" if robot.base.kind in ("differential", "skid") else "straight"
    click.echo(f"Next: motord run {name}, then motord spin --all, then motord calibrate {what}")
