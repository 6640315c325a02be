# SPDX-License-Identifier: Apache-2.0
"""`motord joints`: move the joints of a robot without a base."""

from __future__ import annotations

import math
import time
from typing import Any

import click

from motord.cli.common import Exit, Failure, json_option, print_json
from motord.cli.running.talk import SEND_PERIOD_S, interruptible, owner_option, talking
from motord.client import Client

ARRIVED_RAD = 0.02
WITHIN_S = 30.0


class JointValue(click.ParamType[tuple[str, float]]):
    """NAME=VALUE, with a finite value."""

    name = "NAME=VALUE"

    def convert(self, value: Any, param: Any, ctx: Any) -> tuple[str, float]:
        name, given, text = str(value).partition("=")
        try:
            number = float(text)
        except ValueError:
            number = math.nan
        if not name or not given or not math.isfinite(number):
            self.fail(f"{value!r} is not NAME=VALUE with a finite number", param, ctx)
        return name, number


@click.command("joints")
@click.argument("wanted", metavar="NAME=VALUE...", type=JointValue(), nargs=-1, required=True)
@click.option(
    "--seconds",
    type=click.FloatRange(0.0, min_open=True),
    help="Command for this long. Default: until all positions are reached; with a speed, until "
    "Ctrl-C.",
)
@click.option("--clamp", is_flag=True, help="Go to the end of the range for a position beyond it.")
@owner_option("motord-joints")
@json_option
@talking
def joints(
    client: Client,
    wanted: tuple[tuple[str, float], ...],
    seconds: float | None,
    clamp: bool,
    owner: str,
    as_json: bool,
) -> None:
    """Move joints of a robot without a base: a pan-tilt head, a lift, a conveyor.

    A joint that takes positions goes to VALUE in rad, another one turns at VALUE rad/s. Joints that
    are not named rest. The robot must be armed. A position beyond the joint's range is refused.
    Without --seconds it is an error if a position is
    not reached within 30 s.

    \b
    Example: motord joints pan=0.5 tilt=-0.2
             motord joints belt=3 --seconds 5
    """
    takes_position = set(client.call("robot").get("takes_position", ()))
    position_rad = {name: value for name, value in wanted if name in takes_position}
    velocity_rad_s = {name: value for name, value in wanted if name not in takes_position}
    turns = any(velocity_rad_s.values())
    end_s = WITHIN_S if seconds is None and not turns else seconds
    arrived, start_s = False, time.monotonic()
    with interruptible() as interrupts:
        while not interrupts and (end_s is None or time.monotonic() - start_s < end_s):
            client.joints(position_rad, velocity_rad_s, clamp=clamp, owner=owner)
            arrived = _arrived(client.status(), position_rad)
            if arrived and seconds is None and not turns:
                break
            time.sleep(SEND_PERIOD_S)
    client.release(owner)
    found = client.status()
    result = {"state": found["state"], "arrived": arrived, "joints": found["joints"]}
    if found["state"] in ("fault", "estop"):
        raise Failure("; ".join(found["why"]), Exit.FAULT, result)
    if not arrived and seconds is None and not turns and not interrupts:
        text = f"not there within {WITHIN_S:g} s: a limit, or another source (motord status)"
        raise Failure(text, Exit.FAILED, result)
    if as_json:
        print_json(result)


def _arrived(status: dict[str, Any], position_rad: dict[str, float]) -> bool:
    """Return whether the robot is at rest with all joints at their positions."""
    at = {name: joint["position_rad"] for name, joint in status["joints"].items()}
    there = (
        at[name] is not None and abs(at[name] - goal) <= ARRIVED_RAD
        for name, goal in position_rad.items()
    )
    return bool(status["at_rest"]) and all(there)
