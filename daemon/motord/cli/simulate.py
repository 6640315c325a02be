# SPDX-License-Identifier: Apache-2.0
"""`motord simulate`: be a robot's drives."""

from __future__ import annotations

import secrets
import signal
import sys
import threading
from pathlib import Path

import click

from motord.cli.common import (
    Exit,
    Failure,
    json_option,
    load_or_exit,
    print_json,
    robot_argument,
    set_option,
)
from motord.config import Joint, Robot
from motord.config.wheels import profile_of
from motord.config.wiring import line_specs
from motord_hal.sim.faults import FaultError
from motord_hal.sim.rig import Rig, RigSpec, WheelSpec

SEED_MAX = 1 << 32
FULL_DUTY_RAD_S = 15.0
"""Of duty drives whose robot file does not say."""


@click.command
@robot_argument
@set_option
@click.option(
    "--fault",
    "faults",
    metavar="SPEC",
    multiple=True,
    help="Something that goes wrong, as in drop:p=0.05 or reboot:at_s=3,unit=1; may be repeated.",
)
@click.option(
    "--seed",
    type=click.IntRange(0, SEED_MAX),
    help="Of the faults; the same seed, the same faults.",
)
@click.option(
    "--link-dir",
    type=click.Path(path_type=Path, file_okay=False),
    help="Where each line's port appears under the line's name; a fresh folder otherwise.",
)
@click.option(
    "--control",
    type=click.Path(path_type=Path, dir_okay=False),
    help="Path of the control socket; control.sock beside the ports otherwise.",
)
@click.option("--stop-on-eof", is_flag=True, help="End when stdin does: for who starts it.")
@json_option
def simulate(
    robot_file: Path,
    overrides: tuple[str, ...],
    faults: tuple[str, ...],
    seed: int | None,
    link_dir: Path | None,
    control: Path | None,
    stop_on_eof: bool,
    as_json: bool,
) -> None:
    """Be the drives of a robot, with motors, wheels and ground, on ports of their own.

    Says where the ports are (with --json: one object, robot, ports, control, seed) and runs until
    SIGINT or SIGTERM. Faults are described in docs/simulator.md.

    \b
    Example: motord simulate robot.toml --link-dir /tmp/robot
             motord simulate robot.toml --fault drop:p=0.05 --fault unplug:at_s=10 --seed 7
    """
    robot = load_or_exit(robot_file, overrides)
    stopped = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stopped.set())
    spec = rig_spec(robot, faults, secrets.randbelow(SEED_MAX) if seed is None else seed)
    try:
        rig = Rig(spec, link_dir=link_dir, control=control)
    except FaultError as error:
        raise Failure(str(error), Exit.USAGE) from error
    except OSError as error:
        raise Failure(f"{error.filename}: {error.strerror}") from error
    with rig:
        _say_where(rig, robot_file, as_json=as_json)
        rig.run(stopped.is_set, sys.stdin.fileno() if stop_on_eof else None)


def rig_spec(robot: Robot, faults: tuple[str, ...], seed: int) -> RigSpec:
    """The robot file as the simulator wants to be told."""
    profiles = {joint.drive: profile_of(robot, joint.drive) for joint in robot.joint.values()}
    return RigSpec(
        robot=robot.robot.name,
        track_m=robot.base.effective_track_m,
        lines=line_specs(robot, profiles),
        wheels={name: _wheel(robot, name, joint) for name, joint in robot.joint.items()},
        seed=seed,
        faults=faults,
    )


def _wheel(robot: Robot, name: str, joint: Joint) -> WheelSpec:
    return WheelSpec(
        side=joint.side,
        wheel_radius_m=robot.wheel_radius_m(name),
        full_duty_rad_s=joint.full_duty_rad_s or FULL_DUTY_RAD_S,
        counts_per_turn=joint.counts_per_turn or 0,
    )


def _say_where(rig: Rig, robot_file: Path, *, as_json: bool) -> None:
    ports, control, seed = rig.ports(), str(rig.server.path), rig.script.seed
    if as_json:
        print_json({"robot": rig.spec.robot, "ports": ports, "control": control, "seed": seed})
        return
    click.echo(f"{rig.spec.robot} is here: seed {seed}, control socket {control}")
    for name, port in ports.items():
        click.echo(f"  line {name}: {port}")
    settings = " ".join(f"--set line.{name}.port={port}" for name, port in ports.items())
    click.echo(f"Drive it from another terminal: motord run {robot_file} {settings}")
    click.echo("Ctrl-C ends it.")
