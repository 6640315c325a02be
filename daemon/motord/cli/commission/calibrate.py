# SPDX-License-Identifier: Apache-2.0
"""`motord calibrate`: measure the robot, and write the results into the robot file."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from motord.api.procedures import CALIBRATIONS, OPTIONS
from motord.base.extras import numpy_missing
from motord.cli.common import (
    POSITIVE,
    Exit,
    Failure,
    dry_run_option,
    file_option,
    json_option,
    load_or_exit,
    plot_option,
    print_json,
    usual_option,
    yes_option,
)
from motord.cli.running.talk import robot_option, socket_option
from motord.client import Client, ClientError, find_socket

if TYPE_CHECKING:
    from collections.abc import Sequence

    from motord.api.geometry_fit import Fit, Measure
    from motord.cli.terminal import Terminal
    from motord.commission.robot_file_edit import RobotFileEdit


@click.command
@click.argument("what", type=click.Choice(CALIBRATIONS), required=False)
@click.option(
    "--from", "log", metavar="LOG", type=click.Path(path_type=Path),
    help="Fit the geometry to a recording with external poses; nothing moves.",
)  # fmt: skip
@click.option(
    "--pose-topic", default="/ground_truth", show_default=True,
    help="Of a LOG.mcap: topic of the external poses (PoseStamped or Odometry).",
)  # fmt: skip
@usual_option("--distance-m", POSITIVE, OPTIONS["distance_m"].usual, "Length of straight.")
@usual_option("--turns", POSITIVE, OPTIONS["turns"].usual, "Turns of rotate and gyro.")
@usual_option("--side-m", POSITIVE, OPTIONS["side_m"].usual, "Side of square.")
@usual_option("--speed-m-s", POSITIVE, OPTIONS["speed_m_s"].usual, "Top speed.")
@usual_option("--speed-rad-s", POSITIVE, OPTIONS["speed_rad_s"].usual, "Fastest turn.")
@robot_option
@socket_option
@file_option
@plot_option("Draw the paths by the old and the new geometry. Needs the plot extra.")
@yes_option
@dry_run_option
@json_option
def calibrate(what: str | None, log: Path | None, as_json: bool, **options: Any) -> None:
    """Measure wheel radii, track, dead band, feed-forward or gyro, and write the robot file.

    The robot drives bounded motions; you say with a tape measure where it is. Any key, Ctrl-C or
    the emergency stop brings it to rest and disarms it. Radii and track are fitted by least
    squares; data that contradict each other are refused, and nothing is written without a yes.

    straight: both radii. rotate: track. square: ratio of the radii, and track (UMBmark). all: these
    three together, then dead band and feed-forward where motord holds the speed. feedforward:
    static, viscous and acceleration part of a duty or a torque. gyro: offset, scale and variance of
    the gyro. On bases without two sides, straight measures the radius of all wheels.

    \b
    Example: motord calibrate all
             motord calibrate straight --distance-m 2
             motord calibrate --from capture.csv --file robot.toml
    """
    if (what is None) == (log is None):
        raise click.UsageError("name what to calibrate, or give --from LOG")
    if why := numpy_missing():
        raise Failure(why)
    from motord.api.geometry_fit import BadData
    from motord.cli.terminal import Terminal, failing

    try:
        with failing(), Terminal(yes=options["yes"]) as person:
            result = _from_log(person, log, options) if log else _live(person, what or "", options)
    except BadData as error:
        if log is not None:
            raise Failure(f"{log}: {error}; nothing was written", Exit.USAGE) from error
        raise Failure(f"{error}; nothing was written") from error
    if as_json:
        print_json(result)


def _live(person: Terminal, what: str, options: dict[str, Any]) -> dict[str, Any]:
    from motord.commission.calibrate.procedure import calibrated
    from motord.commission.robot_file_edit import RobotFileEdit

    with Client(options["path"] or find_socket(options["robot"])) as client:
        described = client.call("robot")
        edit = RobotFileEdit(options["robot_file"] or Path(described["file"]))
        measured = calibrated(client, person, edit, what, options)
    found: dict[str, Any] = {"what": what}
    if measured.fit is not None:
        _plot(person, edit, measured.measures, measured.fit, options)
        found["geometry"] = _numbers(measured.measures, measured.fit)
    if measured.duty:
        found["duty"] = {name: asdict(fit) for name, fit in measured.duty.items()}
    if measured.plants:
        found["feed_forward"] = {name: asdict(plant) for name, plant in measured.plants.items()}
    if measured.gyro is not None:
        found["gyro"] = asdict(measured.gyro)
    return found | {"backup": _written(person, edit, options)}


def _plot(
    person: Terminal,
    edit: RobotFileEdit,
    measures: Sequence[Measure],
    fit: Fit,
    options: dict[str, Any],
) -> None:
    if options["plot"] is not None:
        from motord.commission.page.plots import plot_paths

        plot_paths(options["plot"], measures, edit.before.base.effective_track_m, fit)
        person.show(f"{options['plot']}: written")


def _numbers(measures: Sequence[Measure], fit: Fit) -> dict[str, Any]:
    return {
        "factors": asdict(fit.factors),
        "deviations": asdict(fit.deviations),
        "measures": len(measures),
    }


def _from_log(person: Terminal, log: Path, options: dict[str, Any]) -> dict[str, Any]:
    from motord.commission.calibrate.geometry import free_of
    from motord.commission.calibrate.log_fit import read_csv, windows
    from motord.commission.calibrate.procedure import fitted
    from motord.commission.person import Failed
    from motord.commission.robot_file_edit import RobotFileEdit

    file = options["robot_file"] or _file_of_daemon(options)
    load_or_exit(file, warn=lambda _: None)
    edit = RobotFileEdit(file)
    robot, free = edit.before, free_of(edit.before, "log")
    from motord.config.sections.bases import side_of

    sides: dict[str, str] = {n: side_of(robot.base, j) for n, j in robot.joint.items()}
    radii_m = {name: robot.wheel_radius_m(name) for name in robot.joint}
    try:
        if log.suffix == ".mcap":
            from motord.commission.calibrate.mcap_log import read_mcap

            read = read_mcap(log, options["pose_topic"], sides, radii_m)
        else:
            read = read_csv(log, sides, radii_m)
        measures = windows(read)
    except Failed as error:
        raise Failure(str(error), Exit.USAGE) from error
    fit = fitted(person, edit, free, measures, robust=True)
    _plot(person, edit, measures, fit, options)
    found = {"what": "log", "geometry": _numbers(measures, fit)}
    return found | {"backup": _written(person, edit, options)}


def _file_of_daemon(options: dict[str, Any]) -> Path:
    try:
        with Client(options["path"] or find_socket(options["robot"])) as client:
            return Path(client.call("robot")["file"])
    except ClientError as error:
        raise Failure(f"{error}; or name the file: --file ROBOT.toml", Exit.USAGE) from error


def _written(person: Terminal, edit: RobotFileEdit, options: dict[str, Any]) -> str | None:
    from motord.commission.robot_file_edit import write_asking

    backup = write_asking(person, edit, dry_run=options["dry_run"])
    if backup is not None:
        person.show("Restart the daemon to use the new file.")
    return None if backup is None else str(backup)
