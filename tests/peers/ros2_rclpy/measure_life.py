# SPDX-License-Identifier: Apache-2.0
"""How often each step of the life cycle is answered as it has to be, when a node of a real rclpy
makes each call at once after the answer before:

python -m tests.peers.ros2_rclpy.measure_life [--runs N] [--server bus|bridge] PYTHON...

PYTHON are the words that run the Python of ROS 2. motord-bus answers only rmw_cyclonedds.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import tempfile
from pathlib import Path

from tests.peers.ros2.life_steps import STEPS, never_old
from tests.peers.ros2.ros2_stage import DOMAIN, NAMESPACE
from tests.peers.ros2_rclpy.measure_stops import served
from tests.sim.daemon_stage import becomes_idle

PEER = Path(__file__).with_name("rclpy_peer.py")


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--runs", type=int, default=100)
    parser.add_argument("--server", choices=("bus", "bridge"), default="bus")
    parser.add_argument("python", nargs=argparse.REMAINDER)
    given = parser.parse_args()
    settings = never_old("ros2" if given.server == "bus" else "ros")
    with (
        tempfile.TemporaryDirectory() as folder,
        served(given.server, Path(folder), *settings) as stage,
    ):
        becomes_idle(stage)
        domain = os.environ.get("ROS_DOMAIN_ID", str(DOMAIN))
        words = [domain, "walk", NAMESPACE, json.dumps(STEPS), str(given.runs)]
        subprocess.run([*given.python, str(PEER), *words], check=True)
        logged = (stage.bridge if given.server == "bridge" else stage).logged()
        print(*(line for line in logged.splitlines() if "lifecycle:" in line), sep="\n")


if __name__ == "__main__":
    main()
