# SPDX-License-Identifier: Apache-2.0
"""`motord estop`: the emergency stop, also of a robot whose daemon hangs."""

from __future__ import annotations

import threading
from importlib import import_module
from pathlib import Path

import click

from motord.api.halting import found_rest, halt, request_all
from motord.api.stop_request import RECOVERS_WITHIN_S, DaemonHangs
from motord.cli.common import Exit, Failure, json_option, print_json
from motord.cli.running.talk import (
    report_hang,
    rest_report,
    robot_of,
    robot_option,
    say_rest,
    socket_option,
)
from motord.client import ClientError, find_sockets

OFF = "off"
"""State of a robot whose daemon was ended; its drives have confirmed that they have no power."""
STOP_ALL = "motord.cli.stop_all"
"""Module that stops drives without their daemon; imported only where it is needed."""


@click.command
@click.option(
    "--force",
    is_flag=True,
    help="If a daemon hangs, end it and send the stop to its drives without it.",
)
@json_option
@robot_option
@socket_option
def estop(robot: str | None, path: Path | None, force: bool, as_json: bool) -> None:
    """Emergency stop: all robots on this machine, or one with --robot.

    The stop is latched until you run motord reset. It does not replace a button that cuts the
    power. The exit status is 0 only if the robot was seen at rest. If a daemon hangs, you are shown
    its process after 0.2 s; with --force the command ends that process and stops its drives as
    motord stop-all does.

    \b
    Example: motord estop
             motord estop --robot cart --force
    """
    states: dict[str, str] = {}
    problems: list[str] = []
    status: int = Exit.FAILED
    try:
        sockets = [path] if path else find_sockets(robot)
    except ClientError as error:
        raise Failure(str(error)) from error
    request_all(sockets, "estop")
    if force:  # meanwhile: what reads a robot file takes half a second to import
        threading.Thread(target=import_module, args=(STOP_ALL,), daemon=True).start()
    for socket in sockets:  # if one robot does not answer, the others are stopped all the same
        name = robot_of(socket)
        try:
            states[name] = _stopped(socket, force=force)
        except ClientError as error:
            problems.append(str(error))
        except Failure as error:
            problems.append(error.message)
            status = error.exit_code
    if not as_json:
        for name, state in states.items():
            click.echo(state if len(sockets) == 1 else f"{name}: {state}")
    rests = {
        robot_of(socket): found_rest(socket)
        for socket in sockets
        if states.get(robot_of(socket), OFF) != OFF
    }
    if as_json and not problems:
        reports = {name: rest_report(found) for name, found in rests.items()}
        one = {"state": next(iter(states.values()))} if len(states) == 1 else {}
        one |= next(iter(reports.values())) if len(states) == len(reports) == 1 else {}
        print_json({**one, "robots": states, "rests": reports})
    seen = max((say_rest(found) for found in rests.values()), default=Exit.DONE)
    if problems:
        raise Failure("; ".join(problems), max(seen, Exit(status)))
    if seen is not Exit.DONE:
        raise click.exceptions.Exit(seen)


def _stopped(socket: Path, *, force: bool) -> str:
    """Stop one robot and return its state; OFF if its daemon had to be ended. Raises ClientError
    and Failure."""
    recovers_within_s = 0.0 if force else RECOVERS_WITHIN_S
    try:
        return halt(socket, "estop", report=report_hang, recovers_within_s=recovers_within_s)
    except DaemonHangs as error:
        if not force:
            raise
        import_module(STOP_ALL).force_stop(error.hang, socket.parent)
        return OFF
