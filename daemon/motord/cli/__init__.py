# SPDX-License-Identifier: Apache-2.0
"""The command line. A table of strings names the commands, so only the module of the command that
runs is imported."""

from __future__ import annotations

import importlib
import json
import sys
from collections.abc import Sequence
from typing import Any

import click
from click.shell_completion import CompletionItem

from motord_hal.base.nearest import nearest

INTERRUPTED = 130
"""Exit status after Ctrl-C, as in shells: 128 + SIGINT."""

COMMANDS: dict[str, tuple[str, str]] = {
    "demo": ("motord.cli.demo:demo", "Drive a simulated robot over a test course."),
    "run": ("motord.cli.run:run", "Run the daemon in the foreground."),
    "init": ("motord.cli.commission.init:init", "Find the drives and write a robot file."),
    "check": ("motord.cli.files.check:check", "Check a robot file and list every problem."),
    "doctor": ("motord.cli.commission.doctor:doctor", "Find problems and how to fix them."),
    "simulate": ("motord.cli.simulate:simulate", "Simulate the drives of a robot."),
    "status": ("motord.cli.running.talk:status", "Show the state of the running robot."),
    "top": ("motord.cli.running.top:top", "Watch the running robot on a full screen."),
    "arm": ("motord.cli.running.talk:arm", "Power the drives; the robot may move."),
    "disarm": ("motord.cli.running.talk:disarm", "Come to rest and power the drives off."),
    "drive": ("motord.cli.running.talk:drive", "Drive at a speed and a turn rate."),
    "joints": ("motord.cli.running.joints:joints", "Move joints of a robot without a base."),
    "move": ("motord.cli.running.move:move", "Drive a distance in metres."),
    "turn": ("motord.cli.running.move:turn", "Turn by an angle in radians."),
    "teleop": ("motord.cli.running.teleop:teleop", "Drive with the keyboard or a gamepad."),
    "spin": ("motord.cli.commission.spin:spin", "Turn one wheel at a time and check its wiring."),
    "calibrate": (
        "motord.cli.commission.calibrate:calibrate",
        "Measure radii, track and dead band; write the file.",
    ),
    "tune": ("motord.cli.commission.tune:tune", "Find the gains of a wheel's speed loop."),
    "stop": ("motord.cli.running.talk:stop", "Come to rest and stay armed."),
    "estop": ("motord.cli.running.estop:estop", "Emergency stop; latched until reset."),
    "stop-all": ("motord.cli.stop_all:stop_all", "Stop every drive after the daemon crashed."),
    "reset": ("motord.cli.running.talk:reset", "Clear a fault or an emergency stop."),
    "reset-odometry": ("motord.cli.running.talk:reset_odometry", "Set the pose to zero."),
    "params": (
        "motord.cli.running.params:params",
        "List, get, set and save parameters of the robot.",
    ),
    "scan": ("motord.cli.commission.scan:scan", "Find the drives on a serial line or CAN bus."),
    "trace": ("motord.cli.running.trace:trace", "Show every exchange of a line, decoded."),
    "drives": ("motord.cli.files.drives:drives", "List, show, check or create drive profiles."),
    "robots": ("motord.cli.files.robots:robots", "List the example robot files, or print one."),
    "unit": ("motord.cli.files.unit:unit", "Print the systemd settings for a robot's devices."),
    "schema": (
        "motord.cli.files.schema:schema",
        "Print the JSON Schema of robot files or profiles.",
    ),
    "ros2-msgs": ("motord.cli.files.ros2_msgs:ros2_msgs", "Write the ROS 2 package of motord."),
    "replay": ("motord.cli.replay:replay", "Run a recording through the core again."),
    "completion": ("motord.cli.completion:completion", "Complete commands and names with TAB."),
    "latency": ("motord.cli.latency:latency", "Measure the timing of this machine."),
}
"""Module and function of each command, and its line in the help; in the order of the help."""


class LazyGroup(click.Group):
    """A group that imports a command only when it is used. With --json an error is one JSON object,
    too, and Ctrl-C ends without a message."""

    def main(
        self,
        args: Sequence[str] | None = None,
        prog_name: str | None = None,
        complete_var: str | None = None,
        standalone_mode: bool = True,
        **extra: Any,
    ) -> Any:
        """Run a command like click.Group.main, and exit the process."""
        words = list(sys.argv[1:] if args is None else args)
        try:
            status = super().main(words, prog_name, complete_var, standalone_mode=False, **extra)
        except click.ClickException as error:
            if not standalone_mode:
                raise
            show_error(error, as_json="--json" in words)
            sys.exit(error.exit_code)
        except (click.Abort, KeyboardInterrupt):
            sys.exit(INTERRUPTED)
        if standalone_mode:
            sys.exit(status if isinstance(status, int) else 0)
        return status

    def list_commands(self, ctx: click.Context) -> list[str]:  # noqa: ARG002  # click's signature
        return list(COMMANDS)

    def shell_complete(self, ctx: click.Context, incomplete: str) -> list[CompletionItem]:
        """Complete names of commands from the table, without an import of any command."""
        names = [
            CompletionItem(name, help=text)
            for name, (_, text) in COMMANDS.items()
            if name.startswith(incomplete)
        ]
        return names + click.Command.shell_complete(self, ctx, incomplete)

    def get_command(
        self,
        ctx: click.Context,  # noqa: ARG002  # click's signature
        cmd_name: str,
    ) -> click.Command | None:
        if cmd_name not in COMMANDS:
            return None
        module, name = COMMANDS[cmd_name][0].split(":")
        command: click.Command = getattr(importlib.import_module(module), name)
        return command

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        name = args[0]
        if name not in COMMANDS and not name.startswith("-"):
            near = nearest(name, COMMANDS)
            hint = f" Did you mean '{near}'?" if near else ""
            ctx.fail(f"No such command '{name}'.{hint}")
        return super().resolve_command(ctx, args)

    def format_commands(
        self,
        ctx: click.Context,  # noqa: ARG002  # click's signature
        formatter: click.HelpFormatter,
    ) -> None:
        with formatter.section("Commands"):
            formatter.write_dl([(name, text) for name, (_, text) in COMMANDS.items()])


def show_error(error: click.ClickException, *, as_json: bool) -> None:
    """Show an error: in words on stderr, or as an object with error and exit_status on stdout."""
    if as_json:
        found = {"error": error.format_message(), "exit_status": error.exit_code}
        found |= getattr(error, "result", {})
        click.echo(json.dumps(found, ensure_ascii=False))
    else:
        error.show()


def _print_version(ctx: click.Context, _: click.Parameter, wanted: bool) -> None:
    if not wanted:
        return
    from importlib import metadata

    try:
        version = metadata.version("motord")
    except metadata.PackageNotFoundError:
        version = "of a checkout that is not installed"
    click.echo(f"motord {version}")
    ctx.exit()


@click.group("motord", cls=LazyGroup, context_settings={"help_option_names": ["-h", "--help"]})
@click.option(
    "--version",
    is_flag=True,
    is_eager=True,
    expose_value=False,
    callback=_print_version,
    help="Show the version and exit.",
)
def cli() -> None:
    """Drive the motors of a robot as one base, on RS485, CAN, PWM pins, boards or bus servos.

    \b
    Example: motord demo
             motord check robot.toml && motord run robot.toml

    Exit status: 0 success, 1 failure, 2 wrong usage or a wrong robot file, 3 a latched fault or
    missing hardware, 130 Ctrl-C. With --json, errors are JSON objects with the keys error and
    exit_status.
    """
