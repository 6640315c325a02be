# SPDX-License-Identifier: Apache-2.0
"""`motord teleop`: drive by hand, also over SSH, with the keyboard or a gamepad."""

from __future__ import annotations

import asyncio
from pathlib import Path

import click

from motord.aio import Client
from motord.base.extras import how_to_install
from motord.cli.common import POSITIVE, Exit, Failure, usual_option
from motord.cli.running.talk import located
from motord.client import ClientError
from motord.tools.teleop.keys import DeadMan
from motord.tools.teleop.session import Gamepad, Speeds, Teleop
from motord.tools.teleop.terminal import NoTerminal, Terminal

ANSWER_WITHIN_S = 2.0
USUAL_M_S, USUAL_RAD_S = 0.5, 1.0
"""Full speeds of a robot that has no limit."""


@click.command
@click.option("--linear-m-s", type=POSITIVE, help="Full speed. Default: the robot's limit.")
@click.option("--angular-rad-s", type=POSITIVE, help="Full turn rate. Default: the robot's limit.")
@usual_option(
    "--hold-s", click.FloatRange(0.05, 1.0), 0.2,
    "The robot stops this long after the last key repeat.",
)  # fmt: skip
@usual_option(
    "--first-s",
    click.FloatRange(0.05, 1.0),
    0.6,
    "The first press moves the robot this long: the delay until your terminal repeats it.",
)
@click.option(
    "--gamepad",
    metavar="DEVICE",
    help="Drive with this gamepad, too: its device file, or a part of its name.",
)
@click.option(
    "--dead-man", metavar="BTN", default="BTN_TL", show_default=True,
    help="The gamepad's dead-man button: hold it to drive.",
)  # fmt: skip
@click.option("--estop-button", metavar="BTN", help="The gamepad's button for an emergency stop.")
@located
def teleop(
    path: Path,
    linear_m_s: float | None,
    angular_rad_s: float | None,
    hold_s: float,
    first_s: float,
    gamepad: str | None,
    dead_man: str,
    estop_button: str | None,
) -> None:
    """Drive with the keyboard: hold a key to move, release it to stop.

    It begins at 30 % of the full speed; + and - change that. The space bar is an emergency stop.
    Keys that a slow connection holds back do not move the robot: the terminal's answers show how
    old a key can be, and after 0.4 s it is too old. However the program ends, the robot comes to
    rest; if you armed it here, it is disarmed.

    \b
    Example: motord teleop
             ssh -t robot motord teleop --linear-m-s 0.3
             motord teleop --gamepad Xbox --estop-button BTN_EAST
    """
    speeds = (linear_m_s, angular_rad_s)
    try:
        keys, pad = DeadMan(hold_s=hold_s, first_s=first_s), (gamepad, dead_man, estop_button)
        why, state = asyncio.run(_session(path, Terminal(), speeds, keys, pad))
    except NoTerminal as error:
        raise Failure(str(error), Exit.USAGE) from error
    if state in ("fault", "estop"):
        raise Failure(f"{state} is latched: motord status, then motord reset", Exit.FAULT)
    if why:
        raise Failure(why)


async def _session(
    path: Path,
    terminal: Terminal,
    asked: tuple[float | None, float | None],
    dead_man: DeadMan,
    pad: tuple[str | None, str, str | None],
) -> tuple[str, str]:
    """Return why teleop ended, and the robot's last state; "": the daemon does not answer."""
    async with (
        Client(path, timeout_s=ANSWER_WITHIN_S) as robot,
        Client(path, timeout_s=ANSWER_WITHIN_S) as watcher,
    ):
        limits = await robot.params_get()
        speeds = Speeds(
            linear_m_s=asked[0] or limits["limits.linear_m_s"] or USUAL_M_S,
            angular_rad_s=asked[1] or limits["limits.angular_rad_s"] or USUAL_RAD_S,
            lateral_m_s=limits.get("limits.lateral_m_s") or 0.0,
        )
        gamepad = _gamepad(*pad, speeds) if pad[0] is not None else None
        why = await Teleop(robot, watcher, terminal, speeds, dead_man, gamepad).run()
        try:
            return why, (await watcher.status()).state
        except ClientError as error:
            return why or str(error), ""


def _gamepad(device: str | None, dead_man: str, estop: str | None, speeds: Speeds) -> Gamepad:
    """Open the gamepad. Raises Failure if it or its package is missing."""
    from motord.config import JoystickInput

    try:
        from motord.tools.teleop.gamepad import EvdevGamepad
    except ModuleNotFoundError as error:
        text = f"a gamepad needs the package {error.name}: {how_to_install('joystick')}"
        raise Failure(text, Exit.USAGE) from error
    try:
        section = JoystickInput(
            kind="joystick", device=device or "", dead_man=dead_man, estop_button=estop,
            linear_m_s=speeds.linear_m_s, angular_rad_s=speeds.angular_rad_s,
        )  # fmt: skip
    except ValueError as error:
        raise click.UsageError(str(error)) from error
    try:
        return EvdevGamepad(section)
    except OSError as error:
        raise Failure(f"--gamepad {device}: {error}", Exit.FAULT) from error
    except ValueError as error:
        raise click.UsageError(f"--gamepad {device}: {error}") from error
