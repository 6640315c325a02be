# SPDX-License-Identifier: Apache-2.0
"""`motord replay`: run a recording through the core again, and publish it by a robot file."""

from __future__ import annotations

import contextlib
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

import click

from motord.base.extras import how_to_install
from motord.base.python_command import module_command
from motord.cli.common import Exit, Failure, json_option, load_or_exit, print_json, set_option

if TYPE_CHECKING:
    from motord.realtime.replay import ReplayedCore, ReplayPage
    from motord.tools.replay import Outcome

BUS_ENDS_WITHIN_S = 5.0
LAST_SHOWN_S = 1.0
"""Time for which the last state stays on the state page: the lowest rates are 1 Hz."""
UNWINDING = (signal.SIGTERM, signal.SIGHUP)
"""Signals that end the program like Ctrl-C."""


@click.command
@click.argument(
    "recording",
    metavar="F.mcap",
    type=click.Path(path_type=Path, dir_okay=False, exists=True),
)
@click.option(
    "--publish",
    "robot_file",
    metavar="ROBOT.toml",
    type=click.Path(path_type=Path, dir_okay=False),
    help="Publish the recording at its own pace on the buses of that robot file.",
)
@set_option
@json_option
def replay(
    *, recording: Path, robot_file: Path | None, overrides: tuple[str, ...], as_json: bool
) -> None:
    """Run the core again on a recording and compare the results bit by bit.

    The recording must come from [publish.NAME] with kind = "mcap" and journal = true. No line is
    opened and no motor moves. The exit status is 1 if a result differs, and 2 if the file cannot be
    used.

    \b
    Example: motord replay recordings/base-20260101T120000-000000000-all.mcap
             motord replay fault.mcap --publish robot.toml
    """
    try:
        from motord.tools.replay import ReplayError
        from motord.tools.replay import replay as run
    except ImportError as error:
        raise Failure(f"{error.name} is missing: {how_to_install('mcap')}") from error
    try:
        if robot_file is None:
            outcome = run(recording)
        else:
            with _unwinding(), _shown(robot_file, overrides) as player:
                outcome = run(recording, player.show)
    except (ReplayError, OSError) as error:
        raise Failure(str(error), Exit.USAGE) from error
    if as_json:
        print_json({**asdict(outcome), "identical": outcome.identical})
    else:
        click.echo(_words(outcome))
    if not outcome.identical:
        sys.exit(Exit.FAILED)


def _words(outcome: Outcome) -> str:
    whole = f"{outcome.ticks} ticks, {outcome.seconds:.1f} s"
    if outcome.gaps or outcome.skipped:
        whole += f", {outcome.gaps} gaps, {outcome.skipped} ticks that no recorded state leads to"
    if outcome.identical:
        return f"{whole}: bit-identical, {outcome.checkpoints} whole states among them"
    return f"{whole}: {outcome.differing_ticks} differ, the first at {outcome.first_difference}"


class _Player:
    """Shows each tick at its recorded time, shifted so that the first one is now."""

    def __init__(self, page: ReplayPage) -> None:
        self._page = page
        self._shift_ns: int | None = None

    def show(self, core: ReplayedCore) -> None:
        now_ns = time.monotonic_ns()
        if self._shift_ns is None:
            self._shift_ns = now_ns - core.now_ns()
        wait_ns = core.now_ns() + self._shift_ns - now_ns
        if wait_ns > 0:
            time.sleep(wait_ns * 1e-9)
        core.show(self._page, self._shift_ns)


@contextlib.contextmanager
def _shown(robot_file: Path, overrides: Sequence[str]) -> Iterator[_Player]:
    """Open a state page with that robot's name, and start the process that publishes it."""
    from motord.api.page_file import PageInUse
    from motord.realtime.replay import ReplayPage

    robot = load_or_exit(robot_file, overrides)
    options = [part for option in overrides for part in ("--set", option)]
    with contextlib.ExitStack() as cleanup:
        try:
            with _held_back():
                page = cleanup.enter_context(ReplayPage(robot.robot.name))
        except PageInUse as error:
            raise Failure(str(error)) from error
        # the socket does not exist, so a command to a recording fails: there is no daemon
        nobody = page.path.with_suffix(".replay")
        command = module_command("motord.bus", str(robot_file), *options)
        bus = cleanup.enter_context(
            subprocess.Popen(
                [*command, "--socket", str(nobody), "--supervised"],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
            )
        )
        try:
            assert bus.stdout is not None  # PIPE was given above
            if not bus.stdout.readline():
                raise Failure("motord-bus did not start: see above")
            yield _Player(page)
            time.sleep(LAST_SHOWN_S)
        finally:
            _end(bus)


@contextlib.contextmanager
def _held_back() -> Iterator[None]:
    """Hold signals back until the end of this context. Between the creation of a page and the note
    to remove it, an exception would leave the page behind."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, (signal.SIGINT, *UNWINDING))
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextlib.contextmanager
def _unwinding() -> Iterator[None]:
    """Make SIGTERM and SIGHUP end the program by an exception, like Ctrl-C, so that its files are
    removed, above all the state page."""

    def ended(number: int, _: object) -> None:
        for each in UNWINDING:
            signal.signal(each, signal.SIG_IGN)  # the clean-up is short and must complete
        sys.exit(128 + number)

    before = {number: signal.signal(number, ended) for number in UNWINDING}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _end(bus: subprocess.Popen[bytes]) -> None:
    """End motord-bus by the end of its standard input; kill it if it does not end in time."""
    assert bus.stdin is not None  # PIPE was given above
    bus.stdin.close()
    try:
        bus.wait(BUS_ENDS_WITHIN_S)
    except subprocess.TimeoutExpired:
        bus.kill()
