# SPDX-License-Identifier: Apache-2.0
"""The command line. Commands are named in a table of strings: only the one that runs is
imported."""

from __future__ import annotations

import difflib
import importlib
import json
import sys
from collections.abc import Sequence
from typing import Any

import click

INTERRUPTED = 130
"""Exit status after Ctrl-C, as shells have it: 128 + SIGINT."""

COMMANDS: dict[str, tuple[str, str]] = {
    "demo": ("motord.cli.demo:demo", "Drive a simulated robot over a course, and measure it."),
    "run": ("motord.cli.run:run", "The daemon, in the foreground."),
    "check": ("motord.cli.check:check", "Every problem of a robot file at once."),
    "simulate": ("motord.cli.simulate:simulate", "Be a robot's drives, on ports of their own."),
    "status": ("motord.cli.talk:status", "How the running robot does."),
    "arm": ("motord.cli.talk:arm", "Let the running robot move."),
    "disarm": ("motord.cli.talk:disarm", "Come to rest and take the power off the drives."),
    "drive": ("motord.cli.talk:drive", "Drive at V m/s and W rad/s."),
    "move": ("motord.cli.move:move", "Drive by so many metres."),
    "turn": ("motord.cli.move:turn", "Turn by so many radians."),
    "stop": ("motord.cli.talk:stop", "Come to rest, stay armed."),
    "estop": ("motord.cli.talk:estop", "Emergency stop; stays until reset."),
    "stop-all": ("motord.cli.stop_all:stop_all", "After a crash: tell every drive to stop."),
    "reset": ("motord.cli.talk:reset", "Clear a fault or an emergency stop; stays disarmed."),
    "reset-odometry": ("motord.cli.talk:reset_odometry", "Here is the origin of the pose."),
    "params": ("motord.cli.talk:params", "List, get and set limits of the running robot."),
    "scan": ("motord.cli.scan:scan", "Who answers on an RS485 line, and which drive it may be."),
    "drives": ("motord.cli.drives:drives", "Drive profiles: list, show, check."),
    "robots": ("motord.cli.robots:robots", "Robot files to begin with: list, print."),
    "unit": ("motord.cli.unit:unit", "What systemd need allow a robot: its devices."),
    "schema": ("motord.cli.schema:schema", "JSON Schema of the robot file, for editors."),
    "ros2-msgs": ("motord.cli.ros2_msgs:ros2_msgs", "The ROS 2 package of motord's own types."),
    "replay": ("motord.cli.replay:replay", "A recording through the core again, bit for bit."),
    "latency": ("motord.cli.latency:latency", "Measure the loop and its handovers."),
}
"""Name → where it is, and its line in the help; in the order of the help."""


class LazyGroup(click.Group):
    """A group that knows its commands by name and imports one when it is asked for. Under --json
    an error is one JSON object too, and Ctrl-C ends without a word."""

    def main(
        self,
        args: Sequence[str] | None = None,
        prog_name: str | None = None,
        complete_var: str | None = None,
        standalone_mode: bool = True,
        **extra: Any,
    ) -> Any:
        """As click has it; exits the process."""
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
            near = difflib.get_close_matches(name, COMMANDS, n=1)
            hint = f" Did you mean '{near[0]}'?" if near else ""
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
    """In words on stderr; or as an object on stdout: error and exit_status."""
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
    """Make motors on RS485 behave as one robot base: safe, on time, and visible.

    \b
    Example: motord demo
             motord check robot.toml && motord run robot.toml

    Exit status: 0 done, 1 it failed, 2 wrong usage or robot file, 3 a fault is latched or hardware
    is missing, 130 after Ctrl-C. With --json an error is an object too: error, exit_status.
    """
