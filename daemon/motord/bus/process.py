# SPDX-License-Identifier: Apache-2.0
"""`motord-bus`: the second process. It has no devices and needs no privileges; it may crash, hang
or be slow."""

from __future__ import annotations

import asyncio
import contextlib
import fcntl
import json
import logging
import os
import signal
import sys
from pathlib import Path

import click

from motord.base import log
from motord.bus.runtime import Runtime
from motord.client import ClientError, find_socket
from motord.config import ConfigError, Robot, load_robot
from motord.config.robot_file import taken_over
from motord_hal.base.tasks import TaskGroup

BEAT_EVERY_S = 0.5
_FAILED, _USAGE = 1, 2

_log = logging.getLogger(__name__)


@click.command(context_settings={"help_option_names": ["-h", "--help"]})
@click.argument("robot_file", metavar="ROBOT.toml", type=click.Path(path_type=Path))
@click.option(
    "--set", "overrides", metavar="KEY=VALUE", multiple=True,
    help="Override a value of the robot file: limits.linear_m_s=0.3. Repeatable.",
)  # fmt: skip
@click.option(
    "--socket",
    "path",
    metavar="PATH",
    type=click.Path(path_type=Path, dir_okay=False),
    help="The daemon's socket, if it is not in the default place.",
)
@click.option(
    "--supervised",
    is_flag=True,
    help="Set by the daemon: end at the end of stdin, and write heartbeats to stdout.",
)
@click.option("--checked-fd", type=int, hidden=True, help="Descriptor of the robot's data.")
def main(
    robot_file: Path,
    overrides: tuple[str, ...],
    path: Path | None,
    checked_fd: int | None,
    *,
    supervised: bool,
) -> None:
    """Connect a running robot to the networks of its file: [publish.*] and [input.*].

    The daemon starts it. With motord run --no-bus, start it yourself.

    \b
    Example: motord-bus robot.toml
    """
    beats = _own_output() if supervised else None
    log.set_up()
    try:
        robot = load_robot(robot_file, overrides) if checked_fd is None else _checked(checked_fd)
    except ConfigError as error:
        click.echo(str(error), err=True)
        sys.exit(_USAGE)
    try:
        path = path or find_socket(robot.robot.name)
    except ClientError as error:
        _log.error("%s", error)
        sys.exit(_FAILED)
    asyncio.run(_run(robot, path, beats))


def _checked(fd: int) -> Robot:
    """Return the robot that the daemon runs, even if its file was edited since."""
    with os.fdopen(fd, "rb") as file:
        return taken_over(file.read())


def _own_output() -> int:
    """Return a descriptor of the daemon's pipe that nothing else writes to; redirect what libraries
    print to standard error."""
    fd = fcntl.fcntl(1, fcntl.F_DUPFD_CLOEXEC, 3)  # 2 is free without standard error
    elsewhere = os.open(os.devnull, os.O_WRONLY) if sys.stderr is None else 2
    os.dup2(elsewhere, 1)
    return fd


async def _run(robot: Robot, path: Path, beats: int | None) -> None:
    """Run the process until a signal ends it. `beats`: descriptor for heartbeats; None: the daemon
    reads none."""
    runtime, end = Runtime(robot, path), asyncio.Event()
    loop = asyncio.get_running_loop()
    for number in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(number, end.set)
    if beats is not None:
        loop.add_reader(sys.stdin.fileno(), _until_closed, sys.stdin.fileno(), end)
    async with TaskGroup() as tasks:
        work = [tasks.create_task(runtime.run())]
        if beats is not None:
            work.append(tasks.create_task(_beat(runtime, beats)))
        await end.wait()
        for task in work:
            task.cancel()


def _until_closed(fd: int, end: asyncio.Event) -> None:
    if not os.read(fd, 4096):
        asyncio.get_running_loop().remove_reader(fd)
        end.set()


async def _beat(runtime: Runtime, fd: int) -> None:
    """Write a line of figures twice a second: without them the daemon takes this process for hung.
    The first one comes when the adapters have begun, which may take long on a small computer."""
    os.set_blocking(fd, False)  # a pipe of our own
    while True:
        await asyncio.sleep(BEAT_EVERY_S)
        line = json.dumps(runtime.figures(), separators=(",", ":")).encode() + b"\n"
        with contextlib.suppress(BlockingIOError, BrokenPipeError):
            os.write(fd, line)
