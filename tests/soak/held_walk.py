# SPDX-License-Identifier: Apache-2.0
"""A seeded random walk: sources whose commands come too seldom, or with gaps, drive a simulated
robot, and stops of every kind come in between. After each stop, and after each arming, no joint
moves until a source has sent zero.

    python -m tests.soak.held_walk --seed 7 --seconds 3600 --robots demo pan-tilt skid4
"""

from __future__ import annotations

import argparse
import contextlib
import random
import sys
import tempfile
import time
from pathlib import Path

from tests.sim.command_source import free_udp_port
from tests.sim.daemon_stage import ROOT, Stage, becomes_idle, running, wait_until
from tests.sim.uncertain_source import BASE, DENSE_S, JOINTS, LEASE_S, Sending, settings

from motord.client import ClientError, Refused
from motord.realtime.loop import SOURCE_SILENT_S

ROBOTS = ("demo", "pan-tilt", "skid4", "mecanum4", "forward-only", "two-bus-servos", "omni3")
ACTS = ("stop", "disarm", "estop")
VAIN_COMMANDS = 6
STILL_RAD = 0.005
SILENT_S = SOURCE_SILENT_S - 0.5
"""Less than the daemon's: it receives a command some time after it was sent."""


def places(stage: Stage) -> list[float]:
    return [joint.position_rad for joint in stage.sim.truth().joints.values()]


def armed(stage: Stage) -> bool:
    with contextlib.suppress(ClientError):
        if stage.state() in ("fault", "estop"):
            stage.robot.reset()
        return stage.state() == "armed" or stage.robot.arm() == "armed"
    return False


def moved(stage: Stage, before: list[float]) -> bool:
    return any(abs(now - old) > STILL_RAD for now, old in zip(places(stage), before, strict=True))


def step(stage: Stage, dice: random.Random, sources: list[Sending]) -> list[str]:
    """Take one step of the walk; return the violations."""
    for sending in sources:
        sending.period_s = dice.choice((DENSE_S, dice.uniform(LEASE_S, 4.0 * LEASE_S), None))
    act = dice.choice(ACTS)
    time.sleep(dice.uniform(0.0, 2.0 * LEASE_S))  # a random time: the walk, not a condition
    with contextlib.suppress(Refused):
        getattr(stage.robot, act)()
    gaps = [sending for sending in sources if dice.random() < 0.5]
    for sending in gaps:
        sending.period_s = None
    if stage.state() not in ("armed", "moving"):
        for sending in sources:  # arming is refused while a command is alive
            sending.period_s = sending.period_s and dice.uniform(1.2, 3.0) * LEASE_S
        wait_until(lambda: armed(stage), f"armed after {act}")
    if any(sending.silent_s >= SILENT_S for sending in sources):
        return []  # arming lets such a source go on
    wait_until(lambda: stage.sim.truth().at_rest, f"rest after {act}")
    before, sent = places(stage), [sending.sent for sending in sources]
    for sending in sources:
        sending.period_s = dice.choice((DENSE_S, dice.uniform(1.1, 3.0) * LEASE_S))
    wait_until(
        lambda: all(
            sending.sent >= count + VAIN_COMMANDS
            for sending, count in zip(sources, sent, strict=True)
        ),
        "commands in vain",
    )
    return [f"motion after {act}: {stage.robot.status().held}"] if moved(stage, before) else []


def walk(name: str, seed: int, steps: int, seconds: float, folder: Path) -> tuple[int, list[str]]:
    """Walk with one robot; return the number of steps and the violations."""
    dice, violations, taken = random.Random(f"{seed} {name}"), [], 0
    robot, end_s = ROOT / f"config/robots/{name}.toml", time.monotonic() + seconds
    with running(folder, *settings(free_udp_port()), robot=robot) as stage:
        stage.wait_for("idle")
        kinds = JOINTS if name == "pan-tilt" else BASE
        chosen = dice.sample([kind for kind in kinds if "wheels" not in kind], 2)
        made = [kinds[kind](stage) for kind in chosen]
        for number, source in enumerate(made):
            source.owner = f"source-{number}" if hasattr(source, "_anew") else source.owner
        with contextlib.ExitStack() as ends:
            sources = [ends.enter_context(Sending(source, None)) for source in made]
            wait_until(lambda: armed(stage), "armed")
            for sending in sources:
                sending.period_s = DENSE_S
                wait_until(lambda one=sending: one.sent > 0, "a command")
            while taken < steps and time.monotonic() < end_s and not violations:
                violations += step(stage, dice, sources)
                taken += 1
        becomes_idle(stage)
    return taken, [f"{name}, seed {seed}, step {taken}: {text}" for text in violations]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--steps", type=int, default=1 << 31, help="of each robot, at most")
    parser.add_argument("--seconds", type=float, default=60.0, help="for all robots together")
    parser.add_argument("--robots", nargs="+", choices=ROBOTS, default=ROBOTS)
    arguments = parser.parse_args()
    found: list[str] = []
    for name in arguments.robots:
        with tempfile.TemporaryDirectory() as folder:
            share_s = arguments.seconds / len(arguments.robots)
            steps, more = walk(name, arguments.seed, arguments.steps, share_s, Path(folder))
        print(f"{name}: {steps} steps, {len(more)} violations", file=sys.stderr, flush=True)
        found += more
    print("\n".join(found) or "no motion after a stop")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
