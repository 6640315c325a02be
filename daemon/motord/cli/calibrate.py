# SPDX-License-Identifier: Apache-2.0
"""`motord calibrate`: what a tape measure knows better than the robot file."""

from __future__ import annotations

import importlib.util
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from motord.cli.common import (
    POSITIVE,
    Exit,
    Failure,
    dry_run_option,
    file_option,
    json_option,
    load_or_exit,
    print_json,
    yes_option,
)
from motord.client import Client, ClientError, find_socket

if TYPE_CHECKING:
    from motord.api.geometry_fit import Free
    from motord.cli.terminal import Terminal
    from motord.commission.robot_file_edit import RobotFileEdit

GEOMETRY = ("straight", "rotate", "square")
KINDS = (*GEOMETRY, "deadband", "feedforward", "gyro", "all")


@click.command
@click.argument("what", type=click.Choice(KINDS), required=False)
@click.option(
    "--from", "log", metavar="LOG", type=click.Path(path_type=Path),
    help="Fit the geometry to a recording with external poses; nothing moves.",
)  # fmt: skip
@click.option(
    "--pose-topic", default="/ground_truth", show_default=True,
    help="Of a LOG.mcap: topic of the external poses (PoseStamped or Odometry).",
)  # fmt: skip
@click.option(
    "--distance-m", type=POSITIVE, default=3.0, show_default=True, help="Length of straight."
)
@click.option(
    "--turns", type=POSITIVE, default=2.0, show_default=True, help="Turns of rotate and gyro."
)
@click.option("--side-m", type=POSITIVE, default=2.0, show_default=True, help="Side of square.")
@click.option("--speed-m-s", type=POSITIVE, default=0.3, show_default=True, help="Top speed.")
@click.option("--speed-rad-s", type=POSITIVE, default=0.8, show_default=True, help="Fastest turn.")
@click.option(
    "--robot", metavar="NAME", help="The robot's name. Needed if several run on this machine."
)
@click.option(
    "--socket", "path", metavar="PATH", type=click.Path(path_type=Path),
    help="The daemon's socket, if it is not in the default place.",
)  # fmt: skip
@file_option
@click.option(
    "--plot", metavar="FILE.png", type=click.Path(path_type=Path, dir_okay=False),
    help="Draw the paths by the old and the new geometry. Needs the plot extra.",
)  # fmt: skip
@yes_option
@dry_run_option
@json_option
def calibrate(what: str | None, log: Path | None, as_json: bool, **options: Any) -> None:
    """Measure wheel radii, track, dead band, feed-forward or gyro, and write the robot file.

    The robot drives bounded motions; you say with a tape measure where it is. Any key, Ctrl-C or
    the emergency stop brings it to rest and disarms it. Radii and track are fitted by least
    squares; data that contradict each other are refused, and nothing is written without a yes.

    straight: both radii. rotate: track. square: ratio of the radii, and track (UMBmark). all: these
    three together, then dead band and feed-forward where the drives take a duty. gyro:
    offset, scale and variance of the gyro. Radii and track are for bases with wheels on two sides.

    \b
    Example: motord calibrate all
             motord calibrate straight --distance-m 2
             motord calibrate --from capture.csv --file robot.toml
    """
    if (what is None) == (log is None):
        raise click.UsageError("name what to calibrate, or give --from LOG")
    if importlib.util.find_spec("numpy") is None:
        from motord.base.extras import how_to_install

        raise Failure(f"numpy is not installed: {how_to_install('calibrate')}")
    from motord.api.geometry_fit import BadData
    from motord.cli.terminal import Terminal, failing

    try:
        with failing(), Terminal(yes=options["yes"]) as person:
            result = _from_log(person, log, options) if log else _live(person, what or "", options)
    except BadData as error:
        raise Failure(f"{error}; nothing was written") from error
    if as_json:
        print_json(result)


def _live(person: Terminal, what: str, options: dict[str, Any]) -> dict[str, Any]:
    from motord.commission.duty import drive_levels, duty_changes, duty_words
    from motord.commission.geometry import require_same
    from motord.commission.gyro import gyro_changes, measure_gyro
    from motord.commission.robot_file_edit import RobotFileEdit

    with Client(options["path"] or find_socket(options["robot"])) as client:
        described = client.call("robot")
        edit = RobotFileEdit(options["robot_file"] or Path(described["file"]))
        robot = edit.before
        require_same(robot, described)
        found: dict[str, Any] = {"what": what}
        if what in (*GEOMETRY, "all"):
            found["geometry"] = _geometry(client, person, edit, what, options)
        if what in ("deadband", "feedforward") or (what == "all" and _takes_duty(robot)):
            fits = drive_levels(client, person, robot, options["speed_m_s"])
            for text in duty_words(robot, fits):
                person.show(text)
            edit.update(duty_changes(robot, fits, feed_forward=what != "deadband"))
            found["duty"] = {name: asdict(fit) for name, fit in fits.items()}
        if what == "gyro":
            gyro = measure_gyro(client, person, robot, options["turns"], options["speed_rad_s"])
            person.show(
                f"gyro: offset {gyro.bias_rad_s:+.5f} rad/s, scale {gyro.scale:.4f} "
                f"± {gyro.difference:.4f}; the robot file holds the variance that follows"
            )
            edit.update(gyro_changes(gyro))
            found["gyro"] = asdict(gyro)
    return found | {"backup": _written(person, edit, options)}


def _takes_duty(robot: Any) -> bool:
    from motord.config.sections.wheels import takes_duty

    profiles = robot.profiles
    return any(takes_duty(joint, profiles[joint.drive]) for joint in robot.joint.values())


def _geometry(
    client: Client, person: Terminal, edit: RobotFileEdit, what: str, options: dict[str, Any]
) -> dict[str, Any]:
    from motord.commission.geometry import free_of
    from motord.commission.runs import Bounds, Runs

    free = free_of(edit.before, what)
    bounds = Bounds(
        distance_m=options["distance_m"],
        turns=options["turns"],
        side_m=options["side_m"],
        linear_m_s=options["speed_m_s"],
        angular_rad_s=options["speed_rad_s"],
    )
    runs = Runs(client, person, bounds)
    kinds = GEOMETRY if what == "all" else (what,)
    measures = [measure for kind in kinds for measure in getattr(runs, kind)()]
    return _fitted(person, edit, free, measures, options)


def _fitted(
    person: Terminal,
    edit: RobotFileEdit,
    free: tuple[Free, ...],
    measures: list[Any],
    options: dict[str, Any],
    *,
    robust: bool = False,
) -> dict[str, Any]:
    from motord.api.geometry_fit import fit
    from motord.commission.geometry import changes, words

    robot = edit.before
    found = fit(measures, robot.base.effective_track_m, free, robust=robust)
    for text in words(robot, found, measures):
        person.show(text)
    if options["plot"] is not None:
        from motord.commission.plots import plot_paths

        plot_paths(options["plot"], measures, robot.base.effective_track_m, found)
        person.show(f"{options['plot']}: written")
    edit.update(changes(robot, found, free))
    return {
        "factors": asdict(found.factors),
        "deviations": asdict(found.deviations),
        "measures": len(measures),
    }


def _from_log(person: Terminal, log: Path, options: dict[str, Any]) -> dict[str, Any]:
    from motord.commission.geometry import free_of
    from motord.commission.log_fit import read_csv, windows
    from motord.commission.robot_file_edit import RobotFileEdit

    file = options["robot_file"] or _file_of_daemon(options)
    load_or_exit(file, warn=lambda _: None)
    edit = RobotFileEdit(file)
    robot, free = edit.before, free_of(edit.before, "log")
    from motord.config.sections.bases import side_of

    sides: dict[str, str] = {n: side_of(robot.base, j) for n, j in robot.joint.items()}
    radii_m = {name: robot.wheel_radius_m(name) for name in robot.joint}
    if log.suffix == ".mcap":
        from motord.commission.mcap_log import read_mcap

        read = read_mcap(log, options["pose_topic"], sides, radii_m)
    else:
        read = read_csv(log, sides, radii_m)
    measures = windows(read)
    geometry = _fitted(person, edit, free, measures, options, robust=True)
    found = {"what": "log", "geometry": geometry}
    return found | {"backup": _written(person, edit, options)}


def _file_of_daemon(options: dict[str, Any]) -> Path:
    try:
        with Client(options["path"] or find_socket(options["robot"])) as client:
            return Path(client.call("robot")["file"])
    except ClientError as error:
        raise Failure(f"{error}; or name the file: --file ROBOT.toml", Exit.USAGE) from error


def _written(person: Terminal, edit: RobotFileEdit, options: dict[str, Any]) -> str | None:
    from motord.cli.terminal import write_asking

    backup = write_asking(person, edit, dry_run=options["dry_run"])
    if backup is not None:
        person.show("Start the daemon again: it runs by the new file then.")
    return None if backup is None else str(backup)
