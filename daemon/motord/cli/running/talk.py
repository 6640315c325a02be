# SPDX-License-Identifier: Apache-2.0
"""Commands for a running daemon; they need its local socket alone."""

from __future__ import annotations

import contextlib
import functools
import signal
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import click

from motord.api.halting import RestFound, found_rest, halt
from motord.api.local_rpc import WrongParams
from motord.api.snapshot import Rest
from motord.api.stop_request import Hang
from motord.cli.common import FINITE, Exit, Failure, json_option, print_json, usual_option
from motord.cli.complete import robot_names
from motord.cli.status_text import held_text, show_status, speed_text
from motord.client import Client, ClientError, Refused, find_socket

SEND_PERIOD_S = 0.05
WHY_WITHIN_S = 1.0
_LATCHED = ("fault", "estop")
_HINDERED = ("configuring", *_LATCHED)


robot_option = click.option(
    "--robot",
    metavar="NAME",
    shell_complete=robot_names,
    help="The robot's name. Needed if several run on this machine.",
)
socket_option = click.option(
    "--socket",
    "path",
    metavar="PATH",
    type=click.Path(path_type=Path),
    help="The daemon's socket, if it is not in the default place.",
)


def owner_option(usual: str) -> Callable[[Any], Any]:
    """Return the option for the name of a lease."""
    return usual_option("--owner", str, usual, "The name under which this command holds its lease.")


def talking(command: Callable[..., None]) -> Callable[..., None]:
    """Give the command a connected client, and report an error in one sentence."""

    @robot_option
    @socket_option
    @functools.wraps(command)
    def connected(*, robot: str | None, path: Path | None, **options: Any) -> None:
        try:
            with Client(path or find_socket(robot)) as client:
                try:
                    command(client, **options)
                except Refused as error:
                    raise Failure(str(error), status_of_refusal(client)) from error
        except WrongParams as error:
            raise Failure(str(error), Exit.USAGE) from error
        except ClientError as error:
            raise Failure(str(error)) from error

    return connected


def located(command: Callable[..., None]) -> Callable[..., None]:
    """Give the command the daemon's socket, for a command that makes its own connections. A command
    that stops the robot needs no connection, since other programs may occupy all of them."""

    @robot_option
    @socket_option
    @functools.wraps(command)
    def with_socket(*, robot: str | None, path: Path | None, **options: Any) -> None:
        try:
            command(path or find_socket(robot), **options)
        except Refused as error:
            raise Failure(str(error), _status_of_refusal_at(path or find_socket(robot))) from error
        except ClientError as error:
            raise Failure(str(error)) from error

    return with_socket


def status_of_refusal(client: Client) -> Exit:
    """Return the exit status of a refused request: FAULT while a fault or an emergency stop is
    latched or the drives are being configured, otherwise FAILED."""
    return Exit.FAULT if client.status()["state"] in _HINDERED else Exit.FAILED


def _status_of_refusal_at(path: Path) -> Exit:
    with contextlib.suppress(ClientError), Client(path) as client:
        return status_of_refusal(client)
    return Exit.FAILED


def report_hang(hang: Hang) -> None:
    """Show at once that the daemon hangs."""
    click.echo(hang, err=True)


def _halted(path: Path, state: str, *, as_json: bool) -> None:
    """Show the resulting state, why it is latched and who is held if the daemon still answers, and
    what is known of the robot's rest. The status is 0 only if the robot was seen at rest."""
    if not as_json:
        click.echo(state)
    rest = found_rest(path)
    status: dict[str, Any] = {}
    with contextlib.suppress(ClientError), Client(path, timeout_s=WHY_WITHIN_S) as client:
        status = client.status()
    held = status.get("held", [])
    if as_json:
        print_json({"state": state, **rest_report(rest), "held": held})
    elif held:
        click.echo(held_text(held), err=True)
    if state in _LATCHED:
        for reason in status.get("why", []):
            click.echo(reason, err=True)
    exit_status = say_rest(rest)
    if state in _LATCHED or exit_status is not Exit.DONE:
        raise click.exceptions.Exit(Exit.FAULT if state in _LATCHED else exit_status)


def robot_of(socket: Path) -> str:
    return socket.name.removesuffix(".sock")


def rest_report(found: RestFound) -> dict[str, Any]:
    return {"rest": found.rest, "rest_unknown_s": found.unknown_s}


def say_rest(found: RestFound) -> Exit:
    """Show what a person has to know of the robot's rest; return the exit status that follows."""
    if found.text:
        click.echo(found.text, err=True)
    return {Rest.AT_REST: Exit.DONE, Rest.TURNING: Exit.FAILED, Rest.UNKNOWN: Exit.FAULT}[
        found.rest
    ]


def _print_state(client: Client, state: str, *, as_json: bool) -> None:
    """Show the resulting state, with the reason if it is latched."""
    _show_state(state, client.status()["why"] if state in _LATCHED else [], as_json=as_json)


def _show_state(
    state: str, why: list[str], *, as_json: bool, held: list[dict[str, Any]] | None = None
) -> None:
    """`held`: the sources that are held; None: this command does not say."""
    if as_json:
        print_json({"state": state} | ({} if held is None else {"held": held}))
    else:
        click.echo(state)
        if held:
            click.echo(held_text(held), err=True)
    if state in _LATCHED:
        for reason in why:
            click.echo(reason, err=True)
        raise click.exceptions.Exit(Exit.FAULT)


@click.command
@json_option
@talking
def status(client: Client, as_json: bool) -> None:
    """Show the state of the running robot.

    The exit status is 3 if a fault or an emergency stop is latched.

    \b
    Example: motord status
             motord status --json | jq .odometry
    """
    found = client.status()
    if as_json:
        print_json(found)
    else:
        show_status(found)
    if found["state"] in _LATCHED:
        raise click.exceptions.Exit(Exit.FAULT)


@click.command
@json_option
@talking
def arm(client: Client, as_json: bool) -> None:
    """Power the drives at zero speed. After this, a command moves the robot.

    A source that requested motion in the 5 s before, and has not sent zero since, is held. If the
    robot is armed already, this command lets all that are held go on.

    \b
    Example: motord arm && motord drive 0.2 0
    """
    answer = client.call("arm", release_held=True)
    if answer["released"]:
        click.echo(f"not held any more: {', '.join(answer['released'])}", err=True)
    _show_state(answer["state"], [], as_json=as_json, held=answer["held"])


@click.command
@json_option
@located
def disarm(path: Path, as_json: bool) -> None:
    """Come to rest, then power the drives off.

    \b
    Example: motord disarm
    """
    _halted(path, halt(path, "disarm", report=report_hang), as_json=as_json)


@click.command
@json_option
@located
def stop(path: Path, as_json: bool) -> None:
    """Come to rest and stay armed.

    A program that requests motion before, during or after it is held: it moves nothing until it
    sends zero once or is started anew, or until you run motord arm again. A pause changes nothing.

    \b
    Example: motord stop
    """
    _halted(path, halt(path, "stop", report=report_hang), as_json=as_json)


@click.command
@json_option
@talking
def reset(client: Client, as_json: bool) -> None:
    """Clear a fault or an emergency stop, also in the drives. The robot stays disarmed.

    \b
    Example: motord status; motord reset && motord arm
    """
    _print_state(client, client.reset(), as_json=as_json)


@click.command("reset-odometry")
@json_option
@talking
def reset_odometry(client: Client, as_json: bool) -> None:
    """Set the pose to zero: x, y and heading start at 0 here.

    \b
    Example: motord reset-odometry && motord move 1
    """
    _print_state(client, client.reset_odometry(), as_json=as_json)


@click.command(context_settings={"ignore_unknown_options": True})
@click.argument("speeds", metavar="VX [VY] WZ", type=FINITE, nargs=-1, required=True)
@click.option(
    "--seconds",
    type=click.FloatRange(0.0, min_open=True),
    help="Drive this long. Default: until Ctrl-C.",
)
@owner_option("motord-drive")
@json_option
@talking
def drive(
    client: Client,
    speeds: tuple[float, ...],
    seconds: float | None,
    owner: str,
    as_json: bool,
) -> None:
    """Drive at VX m/s, turn at WZ rad/s (positive is left) until Ctrl-C.

    VY, in m/s to the left, is for mecanum, omni and swerve bases. The robot must be armed.

    \b
    Example: motord drive 0.3 0
             motord drive -0.1 0.5 --seconds 2
             motord drive 0 0.2 0
    """
    if len(speeds) not in (2, 3):
        raise click.UsageError(f"VX WZ or VX VY WZ, not {len(speeds)} numbers")
    linear_m_s, angular_rad_s = speeds[0], speeds[-1]
    lateral_m_s = speeds[1] if len(speeds) == 3 else 0.0
    _say_limited(client, linear_m_s, angular_rad_s, lateral_m_s)
    start_s = due_s = time.monotonic()
    sent, commanded, commander = 0, False, None
    with interruptible() as interrupts:
        while not interrupts and (seconds is None or time.monotonic() - start_s < seconds):
            answer = client.drive(linear_m_s, angular_rad_s, lateral_m_s, owner=owner)
            commanded, commander = commanded or answer["in_command"], answer["owner"]
            if sent % 5 == 0:
                _progress(client, answer, owner)
            sent += 1
            due_s = max(due_s + SEND_PERIOD_S, time.monotonic())
            time.sleep(max(due_s - time.monotonic(), 0.0))
    client.release(owner)
    _progress(client, None, owner, last=True)
    found = client.status()
    result = {"state": found["state"], "sent": sent, "odometry": found["odometry"]}
    if found["state"] in _LATCHED:
        raise Failure("; ".join(found["why"]), Exit.FAULT, result)
    if sent and not commanded:
        raise Failure(f"{commander} is in command", Exit.FAILED, result)
    if as_json:
        print_json(result)


def _say_limited(
    client: Client, linear_m_s: float, angular_rad_s: float, lateral_m_s: float
) -> None:
    """Show which speed is above a limit, and what the robot does instead."""
    wanted = {"limits.linear_m_s": linear_m_s, "limits.angular_rad_s": angular_rad_s}
    if lateral_m_s != 0.0:
        if not client.call("robot").get("strafes"):
            click.echo("this base cannot move sideways: VY counts as 0", err=True)
        else:
            wanted["limits.lateral_m_s"] = lateral_m_s
    for name, most in client.params_get(*wanted).items():
        asked, unit = wanted[name], "rad/s" if name == "limits.angular_rad_s" else "m/s"
        if most is not None and abs(asked) > most:
            text = f"{asked:g} {unit} is above {name}: limited to {most:g} {unit}"
            click.echo(f"{text} (motord params set {name}=...)", err=True)


@contextlib.contextmanager
def interruptible() -> Iterator[list[int]]:
    """Yield a list that grows with the first Ctrl-C; the second one ends the program. An exception
    instead would be lost if it could not be raised (in a finalizer)."""
    interrupts: list[int] = []

    def interrupted(number: int, _: object) -> None:
        if interrupts:
            raise KeyboardInterrupt
        interrupts.append(number)

    before = signal.signal(signal.SIGINT, interrupted)
    try:
        yield interrupts
    finally:
        signal.signal(signal.SIGINT, before)


def _progress(
    client: Client, answer: dict[str, Any] | None, owner: str, *, last: bool = False
) -> None:
    """Show one line on a terminal's stderr, which the next one overwrites."""
    if not sys.stderr.isatty():
        return
    found = client.status()
    at = found["odometry"]
    text = (
        f"{found['state']:9} {speed_text(at)}   "
        f"x {at['x_m']:.2f} m  y {at['y_m']:.2f} m  heading {at['heading_rad']:.2f} rad"
    )
    if answer is not None and not answer["in_command"]:
        text += f"   {answer['owner']} is in command, not {owner}"
    click.echo(f"\r\033[K{text}", nl=last, err=True)
