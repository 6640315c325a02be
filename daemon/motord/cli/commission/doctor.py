# SPDX-License-Identifier: Apache-2.0
"""`motord doctor`: find problems of this machine and this robot, and how to fix them."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from pathlib import Path

import click

from motord.cli.common import Exit, Failure, json_option, load_or_exit, print_json, set_option
from motord.cli.running.talk import socket_option
from motord.client import Client, ClientError, find_socket
from motord.config import Robot
from motord.tools.doctor import devices, heartbeats, machine, trial
from motord.tools.doctor.finding import Finding, Root
from motord_hal.can.netlink import bit_rate

_COLOURS = {"ok": "green", "warn": "yellow", "fail": "red"}
_HARDWARE = ("device", "drive")


@click.command
@click.argument(
    "robot_file", metavar="[ROBOT.toml]", type=click.Path(path_type=Path), required=False
)
@set_option
@socket_option
@click.option("--no-drives", is_flag=True, help="Start no daemon to see the drives.")
@click.option("--fix", is_flag=True, help="Apply the safe fixes, each after a question.")
@click.option("--yes", is_flag=True, help="With --fix: do not ask.")
@click.option(
    "--root",
    metavar="FOLDER",
    type=click.Path(exists=True, file_okay=False, path_type=Path),
    default="/",
    help="Look at another machine's /proc, /sys, /dev and /etc, copied to this folder.",
)
@json_option
def doctor(
    robot_file: Path | None,
    overrides: tuple[str, ...],
    path: Path | None,
    no_drives: bool,
    fix: bool,
    yes: bool,
    root: Path,
    as_json: bool,
) -> None:
    """Check this machine, the devices and drives of a robot file, and the running daemon.

    Each line is ok, warn or fail, with the command that fixes it. If no daemon runs for the robot
    file, one is started for some seconds: it configures the drives and stays disarmed, so nothing
    moves. The exit status is 3 if a device or a drive fails or a fault is latched, 1 if something
    else fails.

    \b
    Example: motord doctor
             motord doctor robot.toml
             sudo motord doctor robot.toml --fix
    """
    if as_json and fix and not yes:
        raise click.UsageError("--json asks no questions: add --yes to --fix")
    robot = load_or_exit(robot_file, overrides) if robot_file is not None else None
    found: list[Finding] = []
    for finding in _all(Root(root, bit_rate), robot, path, drives=not no_drives):
        found.append(finding)
        if not as_json:
            _show(finding)
    fixed = _fix(found, ask=not yes, show=not as_json) if fix else []
    failed = [each for each in found if each.verdict == "fail" and each.check not in fixed]
    if as_json:
        rows = [each.to_json() | {"fixed": each.check in fixed} for each in found]
        print_json({"ok": not failed, "findings": rows})
    else:
        _sum_up(found, failed)
    if failed:
        hardware = any(each.group in _HARDWARE or each.check == "state" for each in failed)
        raise click.exceptions.Exit(Exit.FAULT if hardware else Exit.FAILED)


def _all(root: Root, robot: Robot | None, path: Path | None, *, drives: bool) -> Iterator[Finding]:
    yield from machine.look(root)
    if not root.real:
        yield from devices.look(root, robot)
        return
    with contextlib.ExitStack() as cleanup:
        client = _running(robot, path, cleanup)
        pids = [client.status().pid] if client is not None else []
        usable = True
        for finding in devices.look(root, robot, pids):
            usable = usable and (finding.group, finding.verdict) != ("device", "fail")
            yield finding
        if not usable and client is None:
            yield Finding(
                group="drive", check="drives", verdict="warn",
                text="not checked: a device fails", mend="fix the device first",
            )  # fmt: skip
            return
        try:
            if client is None and robot is not None and drives:
                click.echo("starting a disarmed daemon to see the drives ...", err=True)
                client = cleanup.enter_context(trial.daemon(robot.path, robot.overrides))
            if client is not None:
                yield from heartbeats.judge(root, heartbeats.observe(client))
            elif robot is None:
                yield Finding(
                    group="daemon", check="daemon", verdict="ok", text="none runs on this machine",
                )  # fmt: skip
        except ClientError as error:
            yield Finding(
                group="daemon", check="daemon", verdict="fail", text=str(error),
                mend="motord run ROBOT.toml shows its log",
            )  # fmt: skip


def _running(
    robot: Robot | None, path: Path | None, cleanup: contextlib.ExitStack
) -> Client | None:
    """Return the daemon of the robot file, or the only one on this machine; None: no daemon."""
    try:
        where = path or find_socket(robot.robot.name if robot is not None else None)
        return cleanup.enter_context(Client(where))
    except ClientError as error:
        if path is not None:
            raise Failure(str(error)) from error
        return None


def _show(finding: Finding) -> None:
    verdict = click.style(f"{finding.verdict:4}", fg=_COLOURS[finding.verdict])
    click.echo(f"{verdict}  {finding.group:8} {finding.check:22} {finding.text}")
    if finding.mend:
        click.echo(f"{'':16}→ {finding.mend}")


def _fix(found: Sequence[Finding], *, ask: bool, show: bool) -> list[str]:
    """Apply the fixes, and return the checks whose fixes have all been applied."""
    done = []
    for finding in found:
        if not finding.fixes:
            continue
        words = "\n".join(f"  {step}" for step in finding.fixes)
        if ask and not click.confirm(f"{finding.check}: {finding.text}\n{words}\nDo it?"):
            continue
        problems = [problem for step in finding.fixes if (problem := step.apply())]
        if not problems:
            done.append(finding.check)
        if show:
            click.echo(f"{finding.check}: {problems[0] if problems else 'done'}", err=True)
    return done


def _sum_up(found: Sequence[Finding], failed: Sequence[Finding]) -> None:
    warned = sum(each.verdict == "warn" for each in found)
    click.echo(f"{len(found)} checks: {len(failed)} failed, {warned} warnings")
    if any(each.fixes for each in found):
        click.echo("motord doctor --fix applies the safe fixes")
