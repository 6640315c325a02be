# SPDX-License-Identifier: Apache-2.0
"""`motord demo`: drive a simulated robot over a course and measure it."""

from __future__ import annotations

import signal
import sys
import time
from pathlib import Path
from typing import Any

import click

from motord.cli.common import (
    Exit,
    Failure,
    json_option,
    load_or_exit,
    print_json,
    set_option,
    usual_option,
)
from motord.client import ClientError
from motord.tools.course import DISTANCE_ERROR_MAX_PERCENT, HEADING_ERROR_MAX_RAD, draw
from motord.tools.demo import DemoError, Result, Stage, run_demo, show_dashboard
from motord.tools.demo_words import error_words, held_up_words, overrun_words
from motord.tools.joint_demo import ERROR_MAX_RAD, JointResult, run_joint_demo
from motord_hal.base.paths import config_dir
from motord_hal.sim.control import ControlError


@click.command
@usual_option("--seconds", click.FloatRange(5.0, 3600.0), 20.0, "Duration of the course.")
@click.option(
    "--robot",
    default="demo",
    show_default=True,
    metavar="NAME|FILE",
    help="An example robot (see motord robots) or a robot file.",
)
@set_option
@click.option("--stay", is_flag=True, help="Keep the drives and the daemon running until Ctrl-C.")
@click.option("--web", is_flag=True, help="Show a dashboard until Ctrl-C instead of the course.")
@usual_option("--port", click.IntRange(1, 65535), 8088, "TCP port of the dashboard.")
@json_option
def demo(
    seconds: float,
    robot: str,
    overrides: tuple[str, ...],
    stay: bool,
    web: bool,
    port: int,
    as_json: bool,
) -> None:
    """Drive a simulated robot over a test course and measure how well it does.

    The demo simulates the drives in a second process, with motors, wheels and ground. They speak
    the protocol of their line: Modbus RTU on a pseudo-terminal, paced at the baud rate, unless you
    choose another robot. The demo starts the daemon on them and drives as any program does. Then it
    compares the odometry with the true position of the simulated robot. You need no hardware and no
    root. Without position counters the odometry is an estimate, and the demo only reports its
    error. On a robot without a base the demo moves the joints.

    \b
    Example: motord demo
             motord demo --json --seconds 20
             motord demo --robot skid4 --stay
             motord demo --web
    """
    path = Path(robot) if "/" in robot or robot.endswith(".toml") else robot_path(robot)
    loaded = load_or_exit(path, overrides)
    for number in (signal.SIGTERM, signal.SIGHUP):  # so the daemon ends with it
        signal.signal(number, signal.default_int_handler)
    try:
        if web:
            show_dashboard(
                path, loaded, port, lambda stage: stay_with_dashboard(stage, port, as_json)
            )
            return
        run = run_joint_demo if loaded.base.kind == "joints" else run_demo
        result = run(path, loaded, seconds, progress, stay_up if stay else None)
    except (DemoError, ControlError, ClientError) as error:
        progress("")
        raise Failure(str(error)) from error
    progress("")
    if as_json:
        print_json(result.to_json())
    else:
        show(result)
    if not result.ok:
        raise click.exceptions.Exit(Exit.FAILED)


def robot_path(name: str) -> Path:
    folder = config_dir() / "robots"
    path = folder / f"{name}.toml"
    if not path.exists():
        known = ", ".join(sorted(found.stem for found in folder.glob("*.toml")))
        raise Failure(f"no robot {name!r} in {folder}; there are: {known}", Exit.USAGE)
    return path


def progress(text: str) -> None:
    """Show one line on stderr, which the next one overwrites; only on a terminal."""
    if sys.stderr.isatty():
        click.echo(f"\r\033[K{text}", nl=False, err=True)


def stay_up(stage: Stage) -> None:
    """Show how to use the robot, and wait for Ctrl-C."""
    progress("")
    click.echo(f"the robot stays up. In another terminal: motord status --socket {stage.socket}")
    click.echo("Ctrl-C ends it.")
    wait_for_end(stage)


def stay_with_dashboard(stage: Stage, port: int, as_json: bool) -> None:
    """Show the address of the dashboard, and wait for Ctrl-C."""
    progress("")
    address = f"http://127.0.0.1:{port}"
    if as_json:
        print_json({"address": address, "socket": str(stage.socket)})
    else:
        click.echo(f"dashboard: {address}\nCtrl-C ends it.")
    sys.stdout.flush()
    wait_for_end(stage)


def wait_for_end(stage: Stage) -> None:
    """Wait for Ctrl-C, and show the robot's state on a terminal."""
    try:
        while True:
            stage.check()
            status = stage.robot.status()
            odometry = status["odometry"]
            progress(f"{status['state']:12} {odometry['x_m']:7.3f} m {odometry['y_m']:7.3f} m")
            time.sleep(0.5)
    except KeyboardInterrupt:
        return


def show(result: Result | JointResult) -> None:
    """Print the result for a person: the path, then what was measured and what it means."""
    report = result.to_json()
    if isinstance(result, Result):
        show_odometry(result, report["odometry"], report)
    else:
        show_joints(result, report)
    show_machine(result, report)
    if isinstance(result, Result):
        busy = (result.drives_held_up_s, result.program_held_up_s, result.daemon_waited_part)
        row("", held_up_words(*busy))
    click.echo("ok" if report["ok"] else "NOT ok")


def show_joints(result: JointResult, report: dict[str, Any]) -> None:
    click.echo(f"{result.robot}: {len(result.joints)} joints in {report['seconds']:.1f} s")
    for name, score in result.joints.items():
        what = "from its positions" if score.takes == "position" else "of its travel"
        row(
            name,
            f"{score.travel_rad:.2f} rad, {score.error_rad:.4f} rad off {what} by the truth "
            f"(at most {ERROR_MAX_RAD} rad)",
        )
        if score.source != "counters":
            row("", "nothing measures its angle: motord reports an estimate from its set-points")


def show_odometry(result: Result, odometry: dict[str, Any], report: dict[str, Any]) -> None:
    click.echo(draw(result.path))
    click.echo()
    click.echo(f"{report['robot']}: {odometry['distance_m']:.2f} m in {report['seconds']:.1f} s")
    limit = f" (at most {DISTANCE_ERROR_MAX_PERCENT} %, {HEADING_ERROR_MAX_RAD} rad)"
    row(
        "odometry",
        f"{odometry['position_error_m'] * 1000:.1f} mm and "
        f"{odometry['heading_error_rad']:.4f} rad from the truth: "
        f"{odometry['drift_percent']:.3f} % of the distance{limit if odometry['judged'] else ''}",
    )
    row("", report["worth"])
    if result.chip_imu:
        row("", "the demo does not simulate the gyro on I2C: the heading comes from the wheels")


def show_machine(result: Result | JointResult, report: dict[str, Any]) -> None:
    """Print the results of the loop, the lines and the safety checks."""
    loop = report["loop"]
    late = loop["lateness_us"]
    row(
        "loop",
        f"{loop['rate_hz']:.0f} Hz {loop['policy']}: late {late['p50']:.0f} µs p50, "
        f"{late['p99']:.0f} p99, {late['max']:.0f} max; {loop['overruns']} of {loop['ticks']} "
        f"ticks overran; {loop['step_ns']['p50']:.0f} ns a step",
    )
    for text in (*loop.get("refusals", {}).values(), overrun_words(loop)):
        row("", text)
    for name, line in report["lines"].items():
        trip = line["round_trip_us"]
        errors = ", ".join(f"{count} {kind}" for kind, count in line["errors"].items() if count)
        row(
            name,
            f"{line['exchanges']} exchanges on the {line['engine']} engine, "
            f"{line['cycle_hz']:.0f} of {line['requested_hz']:.0f} cycles/s, "
            f"{trip['p50'] / 1000:.1f} ms a round trip, errors: {errors or 'none'}",
        )
        for text in error_words(line):
            row("", text)
    safety = report["safety"]
    faults = ", ".join(safety["faults"]) or "none"
    row(
        "safety",
        f"ends {safety['final_state']}, faults: {faults}, "
        f"daemon {'ended well' if report['clean_exit'] else 'had to be killed'}",
    )
    if safety["faults"]:
        for text in result.status["why"]:
            row("", text)


def row(name: str, text: str) -> None:
    """Print a row, or nothing for an empty text."""
    if text:
        click.echo(f"  {name:10} {text}")
