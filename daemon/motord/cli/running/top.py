# SPDX-License-Identifier: Apache-2.0
"""`motord top`: show the running robot on a full screen."""

from __future__ import annotations

import sys
from pathlib import Path

import click

from motord.base.extras import how_to_install
from motord.cli.common import Exit, Failure
from motord.cli.running.talk import robot_option, socket_option
from motord.client import find_socket


@click.command
@robot_option
@socket_option
def top(robot: str | None, path: Path | None) -> None:
    """Watch the robot on a full screen, also over SSH; 80 × 24 characters are enough.

    It shows the state and what to do about it, the joints, the lines, the loop, which source
    commands, and the log. The space bar is an emergency stop, without a question.

    \b
    Example: motord top
             ssh -t robot motord top
    """
    try:
        from motord.tui.top import Top
    except ModuleNotFoundError as error:
        text = f"motord top needs the package {error.name}: {how_to_install('tui')}"
        raise Failure(text, Exit.USAGE) from error
    if not (sys.stdin.isatty() and sys.stdout.isatty()):
        raise Failure("it shows a full screen on a terminal: over SSH use ssh -t", Exit.USAGE)

    def find() -> Path:
        return path or find_socket(robot)

    find()  # report a missing robot before the screen is taken
    Top(find).run()
