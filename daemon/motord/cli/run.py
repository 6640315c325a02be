# SPDX-License-Identifier: Apache-2.0
"""`motord run`: run the daemon."""

from __future__ import annotations

import asyncio
import logging
import os
from pathlib import Path

import click

from motord.api.page_file import own_page
from motord.base import log
from motord.cli.common import (
    Exit,
    Failure,
    json_option,
    load_or_exit,
    print_json,
    robot_argument,
    set_option,
)
from motord.daemon.app import run as run_daemon
from motord.local_socket.server import SocketInUse
from motord.realtime.loop import ConfigRefused, PageInUse
from motord_hal.base.errors import PortError, ProfileError

_log = logging.getLogger(__name__)


@click.command
@robot_argument
@set_option
@click.option(
    "--socket",
    "path",
    metavar="PATH",
    type=click.Path(path_type=Path, dir_okay=False),
    help="Local socket. Default: /run/motord/ROBOT.sock or the user's own folder.",
)
@click.option(
    "--bus/--no-bus",
    default=True,
    show_default=True,
    help="Start motord-bus for the networked buses of the file, or start none.",
)
@json_option
def run(
    robot_file: Path, overrides: tuple[str, ...], path: Path | None, bus: bool, as_json: bool
) -> None:
    """Run the daemon in the foreground. It logs to stderr.

    The robot starts disarmed; run motord arm to let it move. SIGINT and SIGTERM bring the robot to
    rest, power the drives off and end the daemon. A second signal does not wait for the ramp. The
    daemon notifies a service manager (sd_notify) when it is ready and feeds its watchdog. With
    --json it prints one object once it listens: robot, pid, socket, state_page. The exit status is
    3 if a power-off is not confirmed, or motord cannot see whether a wheel turns.

    \b
    Example: motord run robot.toml
             motord run robot.toml --set line.rs485.port=/dev/ttyUSB1
    """
    log.set_up()  # first: a full stderr must not keep the robot waiting
    robot = load_or_exit(robot_file, overrides, _log.warning)

    def say_ready(socket: Path) -> None:
        name = robot.robot.name
        page = own_page(name)
        try:
            print_json(
                {"robot": name, "pid": os.getpid(), "socket": str(socket), "state_page": str(page)}
            )
        except OSError as error:
            _log.warning("stdout: %s: the ready line cannot be written", error.strerror)

    try:
        on_ready = say_ready if as_json else lambda _: None
        known_off = asyncio.run(run_daemon(robot, path, on_ready, starts_bus=bus))
    except (ConfigRefused, ProfileError, LookupError) as error:
        raise Failure(str(error), Exit.USAGE) from error
    except PortError as error:  # without a pin of safety nothing is started
        raise Failure(str(error), Exit.FAULT) from error
    except (PageInUse, SocketInUse) as error:
        raise Failure(str(error)) from error
    except OSError as error:
        where = f"{error.filename}: " if error.filename else ""
        raise Failure(f"{where}{error.strerror or error}") from error
    if not known_off:  # the last line of the log has the reason
        raise click.exceptions.Exit(Exit.FAULT)
