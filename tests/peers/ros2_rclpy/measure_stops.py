# SPDX-License-Identifier: Apache-2.0
"""How often and how fast a stop arrives that a fresh ROS 2 process sends:

python -m tests.peers.ros2_rclpy.measure_stops [--runs N] [--server bus|bridge] [--fork]
                                               BY METHOD WORDS...

BY is `topic` or `service`, METHOD `estop` or `stop`. WORDS run ROS 2's command line: each run
types what docs/ros2.md shows, in a process of its own. With --fork WORDS run ROS's Python: each
run does the same by rclpy, in a process that has loaded rclpy but is new to the other nodes. A run
counts when the daemon shows the emergency stop, or the held source; by service also the answer has
to come. The command line of ROS 2 has no wheel, so no test of CI runs this.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import signal
import statistics
import subprocess
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from tests.peers.ros2.ros2_stage import DOMAIN, NAMESPACE, Peer, ros2_stage
from tests.sim.daemon_stage import UNHURRIED, armed, becomes_idle, wait_until

from motord.client import ClientError

PEER = Path(__file__).with_name("rclpy_peer.py")
WITHIN_S = 60.0
_EVERY_S = 0.02
_DRIVE_EVERY_S = 0.05


def typed(by: str, method: str) -> list[str]:
    """Return what a person types after `ros2`, as docs/ros2.md has it."""
    name = f"{NAMESPACE}/motord/{method}"
    if by == "service":
        return ["service", "call", name, "std_srvs/srv/Trigger"]
    text = "{data: a person is too close}"
    return ["topic", "pub", "--rate", "50", name, "std_msgs/msg/String", text]


@contextlib.contextmanager
def driving(stage: Any) -> Iterator[None]:
    """Command motion from another source, until the end of the context."""
    ends = threading.Event()

    def drive() -> None:
        with stage.client() as robot:
            robot.drive(0.0, 0.0)  # a stop before holds the source
            while not ends.wait(_DRIVE_EVERY_S):
                with contextlib.suppress(ClientError):
                    robot.drive(0.1, 0.0)

    thread = threading.Thread(target=drive)
    thread.start()
    try:
        yield
    finally:
        ends.set()
        thread.join()


@contextlib.contextmanager
def ready(stage: Any, method: str) -> Iterator[Callable[[], bool]]:
    """Bring the robot to where a stop shows. Yield the function that returns whether it came."""
    if method == "estop":
        becomes_idle(stage)
        yield lambda: stage.state() == "estop"
        return
    with armed(stage), driving(stage):
        wait_until(lambda: stage.state() == "moving", "moving")
        yield lambda: bool(stage.robot.status()["held"])


class Typed:
    """Each run is a command of its own."""

    def __init__(self, words: list[str], by: str, method: str) -> None:
        self._words, self._by = [*words, *typed(by, method)], by

    def start(self) -> None:
        environ = {"ROS_DOMAIN_ID": str(DOMAIN), **os.environ}
        self._command = subprocess.Popen(
            self._words, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, env=environ
        )

    def answered(self) -> bool:
        """End the command; return whether it ended as it has to."""
        if self._by == "topic":
            self._command.send_signal(signal.SIGINT)  # what a person does who sees the stop
        try:
            output, _ = self._command.communicate(timeout=WITHIN_S)
        except subprocess.TimeoutExpired:
            self._command.kill()
            output, _ = self._command.communicate()
        right = self._by == "topic" or "success=True" in output
        if not right:
            print(output)
        return right

    def close(self) -> None:
        pass


class Forked:
    """Each run is a process that one process of ROS's Python forks."""

    def __init__(self, words: list[str], by: str, method: str) -> None:
        name = f"{NAMESPACE}/motord/{method}"
        self._by = by
        self._line = ["call", name] if by == "service" else ["say", name, "too close", "watcher"]
        domain = os.environ.get("ROS_DOMAIN_ID", str(DOMAIN))
        self._peer = Peer([*words, str(PEER), domain, "forks"], json.loads)

    def start(self) -> None:
        self._peer.received.clear()
        self._peer.say(json.dumps(self._line))

    def answered(self) -> bool:
        right = self._by == "topic"
        if not right:
            right = self._peer.find(lambda sent: "success" in sent, "an answer")["success"]
        self._peer.say("[]")
        return right

    def close(self) -> None:
        self._peer.process.stdin.close()
        self._peer.process.wait(WITHIN_S)
        self._peer.close()


def run(stage: Any, method: str, sender: Typed | Forked) -> float | None:
    """Return the seconds from the start of the process to the stop; None: it did not come."""
    with ready(stage, method) as came:
        began_s = time.monotonic()
        sender.start()
        took_s = None
        while took_s is None and time.monotonic() - began_s < WITHIN_S:
            if came():
                took_s = time.monotonic() - began_s
            time.sleep(_EVERY_S)
        return took_s if sender.answered() else None


@contextlib.contextmanager
def served(server: str, folder: Path, *settings: str) -> Iterator[Any]:
    """Run a robot with motord-bus, or with the bridge."""
    if server == "bus":
        with ros2_stage(folder, *UNHURRIED, *settings) as stage:
            yield stage
        return
    from tests.peers.ros2_rclpy import rclpy_stage

    with rclpy_stage.bridged(folder, *UNHURRIED, *settings) as stage:
        yield stage


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--runs", type=int, default=100)
    parser.add_argument("--server", choices=("bus", "bridge"), default="bus")
    parser.add_argument("by", choices=("topic", "service"))
    parser.add_argument("method", choices=("estop", "stop"))
    parser.add_argument("--fork", action="store_true")
    parser.add_argument("words", nargs=argparse.REMAINDER)
    given = parser.parse_args()
    took_s: list[float] = []
    with tempfile.TemporaryDirectory() as folder, served(given.server, Path(folder)) as stage:
        sender = (Forked if given.fork else Typed)(given.words, given.by, given.method)
        for number in range(given.runs):
            found = run(stage, given.method, sender)
            if found is None:
                print(f"run {number}: did not arrive", flush=True)
            else:
                took_s.append(found)
                print(f"run {number}: {found:.1f} s", flush=True)
        sender.close()
    ordered = sorted(took_s)
    print(
        f"{given.server} {given.by} {given.method}: {len(took_s)} of {given.runs} arrived; s:"
        f" {ordered[0]:.1f} least, {statistics.median(ordered):.1f} median, {ordered[-1]:.1f} most"
    )


if __name__ == "__main__":
    main()
