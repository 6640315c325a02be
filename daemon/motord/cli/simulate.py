# SPDX-License-Identifier: Apache-2.0
"""`motord simulate`: simulate the drives of a robot."""

from __future__ import annotations

import dataclasses
import itertools
import json
import secrets
import shlex
import signal
import sys
import threading
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click

from motord.cli.common import (
    POSITIVE,
    Exit,
    Failure,
    json_option,
    load_or_exit,
    print_json,
    set_option,
)
from motord.config import Joint, Robot
from motord.config.sections.bases import (
    CarBase,
    JointsBase,
    SteeredBase,
    WheelRow,
    side_of,
    wheel_modules,
    wheel_row,
)
from motord.config.wiring import line_specs
from motord_hal.modbus.codec import UNIT_MAX
from motord_hal.modbus.timing import TCP_KINDS
from motord_hal.sim.fault_kinds import KINDS, FaultError, list_kinds
from motord_hal.sim.ground import Module
from motord_hal.sim.pins.line import channels_of
from motord_hal.sim.plant import WheelModel
from motord_hal.sim.rig import AnySimulatedLine, PortSpec, Rig, RigSpec, WheelSpec
from motord_hal.sim.runner import SPIN_S, run, set_pace

SEED_MAX = 1 << 32
PORT_MAX = 65535
FULL_DUTY_RAD_S = 15.0
"""Speed at full duty of drives for which the robot file does not give it."""


@dataclass(frozen=True, slots=True)
class _Address:
    host: str
    port: int


class _AddressType(click.ParamType[_Address]):
    name = "address"

    def convert(self, value: Any, param: Any, ctx: Any) -> _Address:
        host, _, port = str(value).rpartition(":")
        if not port.isascii() or not port.isdigit() or int(port) > PORT_MAX:
            self.fail(f'expected [HOST:]PORT, got "{value}"', param, ctx)
        return _Address(host or "127.0.0.1", int(port))


class _WheelType(click.ParamType[tuple[str, str, float]]):
    name = "wheel"

    def convert(self, value: Any, param: Any, ctx: Any) -> tuple[str, str, float]:
        name, _, number = str(value).partition("=")
        joint, _, key = name.rpartition(".")
        known = [field.name for field in dataclasses.fields(WheelModel)]
        if not joint or key not in known:
            self.fail(f'"{value}" is not JOINT.KEY=VALUE; keys: {", ".join(known)}', param, ctx)
        return joint, key, POSITIVE.convert(number, param, ctx)


@click.command(epilog=f"Faults: {', '.join(KINDS)}.")
@click.argument("robot_file", metavar="ROBOT.toml", type=click.Path(path_type=Path), required=False)
@set_option
@click.option(
    "--fault",
    "faults",
    metavar="SPEC",
    multiple=True,
    help="A fault to simulate: drop:p=0.05 or reboot:at_s=3,unit=1. Repeatable.",
)
@click.option(
    "--wheel",
    "wheels",
    metavar="JOINT.KEY=VALUE",
    multiple=True,
    type=_WheelType(),
    help="Physics of a wheel: left.coulomb_n_m=0.5 (docs/simulator.md). Repeatable.",
)
@click.option(
    "--gyro-scale", type=click.FloatRange(0.5, 2.0), default=1.0,
    help="Rate of turn that a simulated gyro measures, over the true one.",
)  # fmt: skip
@click.option("--list-faults", is_flag=True, help="List the faults with their keys and exit.")
@click.option(
    "--seed",
    type=click.IntRange(0, SEED_MAX),
    help="Seed of the faults; the same seed gives the same faults.",
)
@click.option(
    "--tcp",
    type=_AddressType(),
    metavar="[HOST:]PORT",
    help="Serve each line as a Modbus TCP gateway, on this port and the next ones; 0: free ports.",
)
@click.option(
    "--rtu-over-tcp",
    type=_AddressType(),
    metavar="[HOST:]PORT",
    help="Serve the RTU frames of each line over TCP, on this port and the next ones.",
)
@click.option(
    "--can",
    metavar="INTERFACE:CHANNEL",
    default="",
    help="Interface of the CAN lines: socketcan:vcan0. Default: the line's own if it is of kind "
    "unix, a unix socket if drives go to positions, else UDP datagrams.",
)
@click.option(
    "--units",
    type=click.IntRange(0, UNIT_MAX),
    default=0,
    help="Simulate at least this many drives on each line; extra ones turn no wheel.",
)
@click.option(
    "--tagged",
    is_flag=True,
    help="Encode the unit in the counters and keep the answers for the control socket.",
)
@click.option(
    "--priority",
    type=click.IntRange(0, 98),
    default=0,
    help="SCHED_FIFO priority with precise wake-ups; 0: normal scheduling.",
)
@click.option(
    "--link-dir",
    type=click.Path(path_type=Path, file_okay=False),
    help="Folder for the ports, one link named after each line. Default: a new folder.",
)
@click.option(
    "--control",
    type=click.Path(path_type=Path, dir_okay=False),
    help="Path of the control socket. Default: control.sock beside the ports.",
)
@click.option("--stop-on-eof", is_flag=True, help="Exit at the end of stdin, for a parent process.")
@json_option
def simulate(
    robot_file: Path | None,
    overrides: tuple[str, ...],
    faults: tuple[str, ...],
    wheels: tuple[tuple[str, str, float], ...],
    gyro_scale: float,
    list_faults: bool,
    seed: int | None,
    tcp: _Address | None,
    rtu_over_tcp: _Address | None,
    can: str,
    units: int,
    tagged: bool,
    priority: int,
    link_dir: Path | None,
    control: Path | None,
    stop_on_eof: bool,
    as_json: bool,
) -> None:
    """Simulate the drives of a robot, with motors, wheels and ground, on ports of their own.

    Prints where the ports are and runs until SIGINT or SIGTERM. With --json it prints one object:
    robot, ports, settings, control, seed. docs/simulator.md describes the faults.

    \b
    Example: motord simulate robot.toml --link-dir ports
             motord simulate robot.toml --fault drop:p=0.05 --fault unplug:at_s=10 --seed 7
             motord simulate robot.toml --tcp 1502
    """
    if list_faults:
        _say_faults(as_json=as_json)
        return
    if robot_file is None:
        raise click.UsageError("Missing argument 'ROBOT.toml'.")
    if tcp is not None and rtu_over_tcp is not None:
        raise click.UsageError("give either --tcp or --rtu-over-tcp")
    robot = load_or_exit(robot_file, overrides)
    stopped = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stopped.set())
    spec = dataclasses.replace(
        rig_spec(robot, faults, secrets.randbelow(SEED_MAX) if seed is None else seed),
        ports=_ports(robot, tcp or rtu_over_tcp, raw=rtu_over_tcp is not None),
        can=can,
        gyro_scale=gyro_scale,
        units=units,
        tagged=tagged,
    )
    spec = _with_wheels(spec, wheels)
    with _rig(spec, link_dir, control) as rig:
        _set_pace(priority)
        _say_where(rig, robot, robot_file, as_json=as_json)
        until_fd_ends = sys.stdin.fileno() if stop_on_eof else None
        run(rig, stopped.is_set, until_fd_ends, spin_s=SPIN_S if priority else 0.0)


def _with_wheels(spec: RigSpec, changes: tuple[tuple[str, str, float], ...]) -> RigSpec:
    """Return the spec with changed physics of its wheels."""
    wheels = dict(spec.wheels)
    for joint, key, value in changes:
        if joint not in wheels:
            text = f'--wheel: no joint "{joint}"; known: {", ".join(wheels)}'
            raise click.UsageError(text)
        model = dataclasses.replace(wheels[joint].model, **{key: value})
        wheels[joint] = dataclasses.replace(wheels[joint], model=model)
    return dataclasses.replace(spec, wheels=wheels)


def _set_pace(priority: int) -> None:
    try:
        set_pace(priority)
    except PermissionError as error:
        raise Failure(f"--priority {priority}: {error.strerror}", Exit.USAGE) from error


def _rig(spec: RigSpec, link_dir: Path | None, control: Path | None) -> Rig:
    try:
        return Rig(spec, link_dir=link_dir, control=control)
    except FaultError as error:
        raise Failure(str(error), Exit.USAGE) from error
    except OSError as error:
        raise Failure(f"{error.filename}: {error.strerror or error}") from error


def _ports(robot: Robot, first: _Address | None, *, raw: bool) -> dict[str, PortSpec]:
    """Return the socket of each line; the ports follow one another."""
    if first is None:
        return {}
    return {
        name: PortSpec(host=first.host, port=first.port and first.port + place, raw=raw)
        for place, name in enumerate(robot.line)
    }


def rig_spec(robot: Robot, faults: tuple[str, ...], seed: int) -> RigSpec:
    """Return the robot file in the form of the simulator."""
    profiles = robot.profiles
    return RigSpec(
        robot=robot.robot.name,
        track_m=robot.base.effective_track_m or 1.0,  # without a base nothing rolls on it
        lines=line_specs(robot, profiles),
        wheels={name: _wheel(robot, name, joint) for name, joint in robot.joint.items()},
        modules=tuple(_modules(robot)),
        seed=seed,
        faults=faults,
    )


def _modules(robot: Robot) -> Iterator[Module]:
    """Return the wheels of a base with steered wheels; the fixed axle of a car has wheels even if
    no joint drives them."""
    for module in wheel_modules(robot.base, robot.joint):
        yield Module(
            x_m=module.x_m,
            y_m=module.y_m,
            steering="".join(module.steering),
            traction="".join(module.traction),
        )
    if isinstance(robot.base, CarBase):
        yield Module(x_m=0.0, y_m=0.0)


def _wheel(robot: Robot, name: str, joint: Joint) -> WheelSpec:
    return WheelSpec(
        side=side_of(robot.base, joint),
        wheel_radius_m=robot.wheel_radius_m(name),
        row=_row(robot, joint),
        rolls=not (joint.steers or isinstance(robot.base, JointsBase)),
        full_duty_rad_s=joint.full_duty_rad_s or FULL_DUTY_RAD_S,
        counts_per_turn=joint.counts_per_turn or 0,
    )


def _row(robot: Robot, joint: Joint) -> WheelRow | None:
    """Return the wheel's row if the base moves sideways by its rollers; None: another base."""
    rollers = robot.base.strafes and not isinstance(robot.base, SteeredBase)
    return wheel_row(robot.base, joint) if rollers else None


def _say_faults(*, as_json: bool) -> None:
    if as_json:
        print_json(list_kinds())
        return
    for name, kind in KINDS.items():
        click.echo(f"{name}: {kind.text}")
        for key, limits in kind.keys.items():
            default = (
                "" if limits.default is None else f", {limits.default:g} unless you give another"
            )
            needed = ", needed" if limits.needed else ""
            click.echo(f"    {key}= {limits.low:g} to {limits.high:g}{default}{needed}")


def _say_where(rig: Rig, robot: Robot, robot_file: Path, *, as_json: bool) -> None:
    ports, control, seed = rig.ports(), str(rig.server.path), rig.script.seed
    settings = [setting for line in rig.lines.values() for setting in _settings(line, robot)]
    if as_json:
        where = {"robot": rig.spec.robot, "ports": ports, "settings": settings}
        print_json({**where, "control": control, "seed": seed})
        return
    click.echo(f"{rig.spec.robot} is here: seed {seed}, control socket {control}")
    for name, port in ports.items():
        click.echo(f"  line {name}: {port}")
    options = " ".join(f"--set {shlex.quote(setting)}" for setting in settings)
    click.echo(f"Drive it from another terminal: motord run {robot_file} {options}")
    click.echo("Ctrl-C ends it.")


def _settings(line: AnySimulatedLine, robot: Robot) -> tuple[str, ...]:
    """Return the settings with which a robot file finds this line."""
    name, address = line.spec.name, line.port.address
    if line.spec.kind == "can":
        interface, _, channel = address.partition(":")
        return f"line.{name}.interface={interface}", f"line.{name}.channel={channel}"
    if line.spec.kind == "pwm":
        return (f"line.{name}.pwm_chip={json.dumps(address)}", *_pin_settings(line, robot))
    if line.spec.kind not in TCP_KINDS:
        return (f"line.{name}.port={address}",)
    host, _, port = address.rpartition(":")
    return f"line.{name}.host={host}", f"line.{name}.tcp_port={port}"


def _pin_settings(line: AnySimulatedLine, robot: Robot) -> Iterator[str]:
    """Return settings for each pin, as a channel of the simulated chip, and for each encoder, as a
    counter beside them."""
    counters = itertools.count()
    for joint, places in zip(line.spec.joints, channels_of(line.spec.joints), strict=True):
        pins = ", ".join(
            f'{place.pin} = "{"!" if place.inverted else ""}pwm{place.channel}"' for place in places
        )
        yield f"joint.{joint.name}.pins={{ {pins} }}"
        encoder = robot.joint[joint.name].encoder
        if encoder is not None:
            keys = [
                'kind = "counter"',
                f"counter = {json.dumps(line.port.address)}",
                f"count = {next(counters)}",
                f"counts_per_turn = {encoder.counts_per_turn}",
                f"reversed = {json.dumps(encoder.reversed)}",
            ]
            yield f"joint.{joint.name}.encoder={{ {', '.join(keys)} }}"
